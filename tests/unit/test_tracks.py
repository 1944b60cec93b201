"""Fits of whole tracks: an oscillation far out of step is brought back."""

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.tracks import fit_tracks
from bsp_gp.units import UnitSystem
from tests.worlds import WEIGHT

HOOKE = (WEIGHT, "k0 * (p_j - p_i)", "f0 * normalize(p_i - p_j)")
STIFFNESS, MASS, HUNG, AMPLITUDE, SIGMA = 20.0, 0.11, 0.3, 0.026, 0.001
PRELOAD = STIFFNESS * HUNG - MASS * 9.81  # f0 = k0 times the rest length


def hanging(n_times=150, dt=1 / 30):
    """A block on a spring below a post, ten periods of it, with the noise of a camera."""
    times = dt * np.arange(n_times)
    y = -HUNG + AMPLITUDE * np.cos(np.sqrt(STIFFNESS / MASS) * times + 0.4)
    y = y + SIGMA * np.random.default_rng(4).standard_normal(n_times)
    positions = np.zeros((n_times, 2, 2))
    positions[:, 0, 1] = y
    bodies = [Entity("block", properties={"mass": MASS}), Entity("post", is_static=True)]
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    scene = Scene("hanging", times, positions, bodies)
    return Dataset("hanging", (scene,), up="y", units=units, noise=(SIGMA, SIGMA))


def observed():
    dataset = hanging()
    law = declared_law(dataset, HOOKE)
    return observe(dataset, law, np.random.default_rng(0), sources=True), law


@pytest.mark.parametrize("off", [0.75, 1.25])
def test_a_start_with_a_wrong_period_is_no_trap(off):
    observation, law = observed()
    k = STIFFNESS * off
    start = law.with_constants({"k0": k, "f0": k * HUNG - MASS * 9.81})
    trapped = fit_tracks(observation, start, is_sure=True)
    found = fit_tracks(observation, start)
    dof = found.n_rows - found.n_free
    assert trapped.chisqr > 10 * dof  # the premise: one fit alone ends in another minimum
    assert found.chisqr < 1.5 * dof
    se = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.values - [STIFFNESS, PRELOAD]) < 4 * se)


def test_a_fit_that_leaves_noise_alone_is_kept():
    observation, law = observed()
    start = law.with_constants({"k0": STIFFNESS, "f0": PRELOAD})
    one, two = (fit_tracks(observation, start, is_sure=sure) for sure in (True, False))
    np.testing.assert_array_equal(one.values, two.values)
