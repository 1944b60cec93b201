"""Forces that repeat along an axis: found with their period, and where there are none, not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.loop.proposers.ripples import Ripples
from bsp_gp.loop.view import selected
from tests.loop_views import throws, view_of
from tests.throws import SI

PERIOD, SIGMA = 0.3, 2e-3


def crate(strength, n_scenes=4):
    """A ball that rolls over hollows in rows along x and y, and slows down a little."""
    rng, scenes, t = np.random.default_rng(6), [], np.linspace(0.0, 2.0, 121)

    def rate(t, state):
        return np.concatenate([
            state[2:], strength * np.sin(2 * np.pi * state[:2] / PERIOD) - 0.2 * state[2:]
        ])  # fmt: skip

    for k in range(n_scenes):
        first = np.concatenate([rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0, 2)])
        path = solve_ivp(rate, (0, 2), first, t_eval=t, rtol=1e-9, atol=1e-12).y[:2].T
        path = path + SIGMA * rng.standard_normal(path.shape)
        scenes.append(Scene(str(k), t, path[:, None], (Entity("ball"),)))
    return Dataset("crate", tuple(scenes), noise=(SIGMA,), units=SI)


def test_an_egg_crate_is_found_with_its_period():
    data = crate(0.6)
    view = view_of(data, "-0.2 [1/s] * m_i * v_i")
    family = Ripples().propose(view)
    assert selected(family.gain, family.rank, family.null, view.noise_dof) < 1e-9
    best = family.proposals[0]
    assert best.code == "ripple"
    assert "e_x" in best.text
    assert "e_y" in best.text
    found = fit(best.hypothesis, data, starts=best.starts, bounds=best.bounds)
    assert found.chi2_red == pytest.approx(1.0, abs=0.15)
    assert found.law.constants["q1"] == pytest.approx(2 * np.pi / PERIOD, rel=3e-3)
    assert found.law.constants["b1"] == pytest.approx(0.6, rel=0.05)
    assert found.law.constants["h1"] == pytest.approx(0.6, rel=0.05)


def test_noise_alone_repeats_along_no_axis():
    chances = []
    for seed in range(8):
        view = view_of(throws(np.random.default_rng([31, seed])), seed=seed)
        family = Ripples().propose(view)
        chances.append(
            selected(family.gain, family.rank, family.null, view.noise_dof, family.is_continuum)
        )
    assert min(chances) > 0.002
