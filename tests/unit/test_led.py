"""Many bodies that act on each other: each led by where the others were seen."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import predictions
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.physics.engine import chains
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.driven import Driven
from tests.throws import SI

N, SIGMA = 4, 0.002
TRAP = "-4 [1/s^2] * m_i * (p_i - origin)"
LAWS = [TRAP, "G * m_i * m_j / norm(p_j - p_i)^2 * normalize(p_j - p_i)"]


@pytest.fixture(scope="module")
def crowd():
    """Bodies of 1 kg in one trap that attract each other."""
    rng, t = np.random.default_rng(3), np.linspace(0.0, 3.0, 80)
    k = np.arange(1.0, N + 1)
    places = 0.5 * np.sqrt(k)[:, None] * np.stack([np.cos(2.4 * k), np.sin(2.4 * k)], axis=-1)

    def rate(t, state):
        p, v = state.reshape(2, N, 2)
        apart = p[None] - p[:, None]
        cube = (np.square(apart).sum(axis=-1) + np.eye(N)) ** 1.5
        pull = 0.1 * (apart / cube[..., None]).sum(axis=1)
        return np.concatenate([v.ravel(), (pull - 4 * p).ravel()])

    first = np.concatenate([places.ravel(), (2.0 * places[:, ::-1] * (-1, 1)).ravel()])
    path = solve_ivp(rate, (0, 3), first, t_eval=t, rtol=1e-10, atol=1e-10).y[: 2 * N]
    path = path.reshape(N, 2, -1).transpose(2, 0, 1) + SIGMA * rng.standard_normal((80, N, 2))
    path[30:34, 1] = np.nan
    bodies = tuple(Entity(f"b{k}", properties={"mass": 1.0}) for k in range(N))
    return Dataset("crowd", (Scene("1", t, path, bodies),), noise=(SIGMA,), units=SI)


def test_a_fit_of_many_is_that_of_one_common_state(crowd, monkeypatch):
    hypothesis = Hypothesis.from_laws(crowd, LAWS)
    whole = fit(hypothesis, crowd)
    monkeypatch.setattr(chains, "MOST_TOGETHER", N - 1)
    led = fit(hypothesis, crowd)
    assert [c.n_moving for c in whole.groups] == [N] and [c.n_moving for c in led.groups] == [1]
    assert led.groups[0].fixed[1] == ("b0", "b2", "b3")
    assert led.chi2_red == pytest.approx(1.0, abs=0.15)
    (k,) = np.flatnonzero([name == "G" for name, _ in whole.parameters])
    error = float(whole.errors[k])
    assert led.values[k] == pytest.approx(whole.values[k], abs=0.5 * error)
    assert float(led.errors[k]) == pytest.approx(error, rel=0.3)
    # What is foreseen is foreseen of all together.
    foreseen, same = (predictions(f, crowd, crowd.scenes)[0] for f in (led, whole))
    assert np.nanmax(np.abs(foreseen - same)) < 5 * SIGMA


def test_curves_that_many_follow_are_made_once(crowd, monkeypatch):
    monkeypatch.setattr(chains, "MOST_TOGETHER", 1)
    law = Hypothesis.from_laws(crowd, LAWS).law
    (led,) = build_chains(law, crowd.scenes, may_lead=True)
    driven = Driven(led)
    assert driven.curves.count == N
    times, chain = np.array([0.011, 1.23, 2.9]), np.arange(N)
    asked, of = np.tile(times, N), np.repeat(chain, len(times))
    together = driven.at(asked, of)
    for m, (time, c) in enumerate(zip(asked, of, strict=True)):
        alone = driven.at(np.array([time]), np.array([c]))
        np.testing.assert_allclose(together[..., m], alone[..., 0], rtol=1e-12, atol=1e-12)
