"""Two swinging bodies tied to each other, each seen at times of its own."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.swings import _modes, are_coupled
from bsp_gp.loop.view import View

STIFFNESS, COUPLING, DRAG, RESTS = 19.8, 0.9, 0.04, (0.4, 0.48)
LAW = ["c1 * (origin - p_i)", "c2 * (p_j - p_i)", "c3 * v_i", "c4[body] * e_x"]


def coupled(n=500, step=0.05, lag=0.025, sigma=5e-4, masses=(1.0, 1.0), seed=0):
    """Two pendulums with a soft spring between them, the second seen later by a lag."""
    light = np.array(masses) / masses[0]

    def rate(_, z):
        x, v = z[:2], z[2:]
        between = COUPLING * ((x - RESTS)[::-1] - (x - RESTS)) / light
        return [*v, *(STIFFNESS * (RESTS - x) + between - DRAG * v)]

    def seen(times, body):
        z = solve_ivp(
            rate, (0, times[-1]), [0.64, 0.5, 0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-11
        ).y[body]
        return z + sigma * rng.standard_normal(n)

    rng, times = np.random.default_rng(seed), step * np.arange(n)
    tables = [
        pd.DataFrame({"t": t, "entity": name, "x": seen(t, k)})
        for k, (name, t) in enumerate((("A", times), ("B", times + lag)))
    ]
    units = {"length": "m", "time": "s"}
    return bsp_gp.Dataset.from_frames(
        pd.concat(tables), units=units, properties={"mass": "1[kg]"}
    )


def test_bodies_that_are_seen_at_times_of_their_own_are_fitted():
    """No three rows showed one body, so that sizes and first states were read off none."""
    data = coupled(n=300)
    found = fit(Hypothesis.from_laws(data, LAW), data)
    assert found.status == "converged"
    told = dict(zip(found.parameters, found.values, strict=True))
    assert told["c1", ""] == pytest.approx(STIFFNESS, rel=2e-3)
    assert told["c2", ""] == pytest.approx(COUPLING, rel=0.02)
    assert told["c3", ""] == pytest.approx(-DRAG, rel=0.05)
    assert found.noise.levels[0] == pytest.approx(5e-4, rel=0.15)


def test_what_ties_bodies_firmly_begins_at_both_rates_of_the_swing(monkeypatch):
    """Two carts on three springs swing 1.8 times as fast against each other as together."""
    monkeypatch.setattr(f"{__name__}.COUPLING", 22.0)
    data = coupled(n=400, lag=0.0)
    hypothesis = Hypothesis.from_laws(data, "nothing")
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(0))
    together, apart = _modes(view, 8.0)
    assert together == pytest.approx(np.sqrt(STIFFNESS), rel=0.02)
    assert apart == pytest.approx(np.sqrt(STIFFNESS + 44.0), rel=0.02)


@pytest.mark.slow
def test_bodies_that_are_tied_firmly_are_told_so(monkeypatch):
    monkeypatch.setattr(f"{__name__}.COUPLING", 22.0)
    report = close_loop(coupled(n=300, lag=0.0), "nothing", rng=0, n_bootstrap=0)
    told = {c.name.split("[")[0]: c.value for c in report.constants}
    assert told["k1"] == pytest.approx(22.0, rel=0.1)
    assert told["c1"] == pytest.approx(STIFFNESS, rel=0.1)


def test_two_bodies_that_swing_about_as_fast_may_be_tied():
    scenes = coupled(n=20).scenes
    assert are_coupled({"A": 4.4, "B": 4.6}, scenes)
    assert not are_coupled({"A": 4.4, "B": 9.0}, scenes)
    assert not are_coupled({"A": 4.4, "B": 4.4, "C": 4.4}, scenes)


@pytest.mark.parametrize(
    "masses", [(1.0, 1.0), pytest.param((1.0, 0.6), marks=pytest.mark.slow)]
)
def test_beats_are_told_by_springs_and_what_ties_the_bodies(masses):
    """They had been a push with a period."""
    report = close_loop(coupled(n=300, masses=masses), "nothing", rng=0, n_bootstrap=0)
    first = report.rounds[0]
    assert first.adopted
    assert "(p_j - p_i)" in first.effect.law
    own = [c.value for c in first.effect.constants if c.name.startswith("k1")]
    if masses[1] == 1.0:
        assert own == pytest.approx([COUPLING], rel=0.05)
    else:
        assert own == pytest.approx([COUPLING, COUPLING / 0.6], rel=0.05)
    assert report.rounds[0].ratio.value < 0.05
