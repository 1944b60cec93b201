"""A force that knows no physics: what it makes of tracks, and of the noise beside a wrong law."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.free_force import FreeForce, in_units
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.links import less_exact
from bsp_gp.loop.view import View
from tests.fitted_tracks import body, dataset_of, scene_of

SIGMA = 1e-3
TIMES = np.linspace(0.0, 8.0, 241)


def oscillator(seed=0):
    """A mass on a spring in water, along x: its data set, places and velocities."""
    rng = np.random.default_rng(seed)
    true = solve_ivp(
        lambda t, y: [y[1], -25 * y[0] - 0.4 * y[1] - 3 * abs(y[1]) * y[1]], (0.0, 8.0),
        [0.3, 0.0], t_eval=TIMES, rtol=1e-9, atol=1e-11,
    ).y  # fmt: skip
    seen = np.stack([true[0] + SIGMA * rng.standard_normal(TIMES.size), np.zeros(TIMES.size)], 1)
    return dataset_of([scene_of(TIMES, (body("mass"),), seen[:, None])]), *true


@pytest.fixture(scope="module")
def swinging():
    data, places, velocities = oscillator()
    hypothesis = Hypothesis.from_laws(data, [])
    found = fit(hypothesis, data)
    return View(found, hypothesis, data, np.random.default_rng(1)), places, velocities


@pytest.mark.slow
def test_noise_beside_a_law_that_is_far_off_is_the_pure_error(swinging):
    view, *_ = swinging
    assert view.fit.noise.levels[0] == pytest.approx(SIGMA, rel=0.2)


def test_smoothed_tracks_have_the_velocities_of_the_motion(swinging):
    """Differences of rows have errors of 20 mm/s; a white force smooths no better."""
    view, places, velocities = swinging
    (nodes,) = view.response.nodes
    assert np.std(nodes[0, 0, 0, :, 0] - places) < 0.6 * SIGMA
    assert np.std(nodes[1, 0, 0, :, 0] - velocities) < 6e-3
    assert view.near.nodes[0].shape == view.fit.nodes[0].shape


def test_forces_at_places_in_error_leave_no_more_than_noise(swinging):
    """Of uniform motion as the law, errors of places add up over every turn of a swing."""
    view, *_ = swinging
    (batch, *_) = view.response.regression.batches
    places = batch.positions[:, :, batch.bodies.receivers]
    velocities = batch.velocities[:, :, batch.bodies.receivers]
    force = -25 * places - 0.4 * velocities - 3 * np.abs(velocities) * velocities
    left = view.left - view.beside(batch.whiten(force).reshape(len(view.left), 1))[:, 0]
    assert left @ left < 5 * view.n_left
    assert view.left @ view.left > 1000 * view.n_left


def moments(count=3, m=24, n=40, seed=0):
    rng = np.random.default_rng(seed)
    times = np.tile(np.linspace(0.0, 4.0, n)[:, None], count)
    by_force = np.cumsum(np.cumsum(rng.standard_normal((count, m, n)), axis=2), axis=2) / n
    return by_force, times


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_a_force_is_as_smooth_as_it_was(memory):
    by_force, times = moments(count=12)
    rng = np.random.default_rng(3)
    force = rng.standard_normal((12, times.shape[0]))
    if memory:
        apart = np.abs(times[:, 0, None] - times[:, 0]) / memory
        force = force @ np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-9 * np.eye(len(apart))).T
    left = 10.0 * (by_force @ force[..., None])[..., 0] + rng.standard_normal(by_force.shape[:2])
    chosen = FreeForce(by_force, times).chosen(left)
    assert (chosen.memory > 0.2) == (memory > 0.2)


def test_noise_alone_asks_for_no_force():
    by_force, times = moments()
    left = np.random.default_rng(4).standard_normal(by_force.shape[:2])
    assert FreeForce(by_force, times).smoothest(left) is None


def test_values_are_told_in_those_that_show_best():
    scaled, top = in_units(np.array([[1.0, 4.0], [0.0, 0.0]]))
    assert scaled.tolist() == [[0.25, 1.0], [0.0, 0.0]] and top.ravel().tolist() == [4.0, 0.0]


def test_errors_of_forces_make_moments_less_exact():
    by_force, _ = moments()
    left = np.random.default_rng(5).standard_normal((*by_force.shape[:2], 1))
    assert less_exact(by_force, left, np.zeros((3, 40))) is left
    rng = np.random.default_rng(6)
    error = np.full((3, 40), 0.3)
    drawn = np.sqrt(error)[:, :, None] * rng.standard_normal((3, 40, 4000))
    noisy = rng.standard_normal((3, by_force.shape[1], 4000)) + by_force @ drawn
    white = less_exact(by_force, noisy, error)
    covariance = white @ np.swapaxes(white, 1, 2) / 4000
    assert np.abs(covariance - np.eye(by_force.shape[1])).max() < 0.12
