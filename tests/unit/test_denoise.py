from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.loop.close import declared_law
from bsp_gp.loop.denoise import smooth, states_of
from bsp_gp.loop.preparing import observe
from bsp_gp.physics.shooting import cut_segments
from tests.throws import C1, GRAVITY, MASS, throws

RNG_TIMES = np.sort(np.random.default_rng(7).uniform(0, 3, 30))
MORE_TIMES = np.sort(np.random.default_rng(8).uniform(0, 3, 60))


@pytest.mark.parametrize("times", [np.linspace(0, 3, 30), RNG_TIMES], ids=["even", "uneven"])
def test_quadratics_pass_unchanged(times):
    values = np.stack([np.full(30, 4.0), 2 - 3 * times, 1 + times - 5 * times**2], axis=1)
    np.testing.assert_allclose(smooth(times, values), values, rtol=0, atol=1e-7)


@pytest.mark.parametrize("times", [np.linspace(0, 3, 60), MORE_TIMES], ids=["even", "uneven"])
def test_white_noise_is_killed(times):
    noise = np.random.default_rng(1).standard_normal((60, 200))
    left = smooth(times, noise)
    # Three free numbers are kept of 60; the choice of strength keeps a few more.
    assert np.mean(left**2) < 0.25
    assert np.median(np.mean(left**2, axis=0)) < 0.12


def test_a_slow_signal_is_kept_and_its_noise_reduced():
    times = np.linspace(0, 4, 80)
    signal = np.sin(2 * times)[:, None] * np.ones(100)
    sigma = 0.1
    noise = sigma * np.random.default_rng(2).standard_normal((80, 100))
    error = smooth(times, signal + noise) - signal
    assert np.sqrt(np.mean(error**2)) < 0.5 * sigma
    assert np.abs(error.mean(axis=1)).max() < 5 * sigma / np.sqrt(100)


def test_axes_are_smoothed_one_by_one():
    times = np.linspace(0, 1, 20)
    values = np.random.default_rng(3).standard_normal((20, 2, 3))
    whole = smooth(times, values)
    assert whole.shape == values.shape
    np.testing.assert_array_equal(whole[:, 1, 2], smooth(times, values[:, 1, 2]))


def test_gaps_are_bridged():
    times = np.linspace(0, 2, 40)
    line = 1.0 + 2.0 * times
    broken = line.copy()
    broken[10:15] = np.nan
    np.testing.assert_allclose(smooth(times, broken), line, atol=1e-8)
    assert not smooth(times, np.full(40, np.nan)).any()


def test_too_short_a_track_is_left_as_it_is():
    values = np.array([1.0, np.nan, 3.0, 4.0])
    np.testing.assert_array_equal(smooth(np.arange(4.0), values), [1.0, 0.0, 3.0, 4.0])


@pytest.fixture(scope="module")
def exact_and_fit():
    """Noise-free throws, and a law without the drag fitted to noisy copies."""
    noisy, exact = (throws(n_scenes=5, n_times=40, sigma=s, noise=(0.01,)) for s in (0.01, 0.0))
    law = declared_law(noisy, [GRAVITY])
    observation = observe(noisy, law, np.random.default_rng(0))
    return exact, observation, law


def true_velocity(scene):
    rate, fall = C1 / MASS, np.array([0.0, -9.81 * MASS / C1])
    v = np.array([3.0 + int(scene.name[1:]), 4.0 - int(scene.name[1:])])
    return fall + (v - fall) * np.exp(-rate * scene.times)[:, None]


def test_states_are_better_than_the_measured_ones(exact_and_fit):
    exact, observation, law = exact_and_fit
    states = states_of(observation.fit(law).whole, observation.train)
    assert set(states) == {s.name for s in observation.train}
    errors, rough = [], []
    for scene in observation.train:
        p, v = states[scene.name]
        true = exact.scene(scene.name)
        errors.append((p - true.positions)[:, 0])
        inner = slice(3, -3)
        rough.append((v[:, 0] - true_velocity(scene))[inner])
    # Though the law fitted lacks the drag: half the noise, and a tenth of the velocity error
    # of central differences, 0.01 * sqrt(2) / (2 * 0.05).
    assert np.sqrt(np.mean(np.square(errors))) < 0.005
    assert np.sqrt(np.mean(np.square(rough))) < 0.3 * 0.01 * np.sqrt(2) / 0.1


def test_states_of_segments_are_put_together(exact_and_fit):
    exact, observation, law = exact_and_fit
    segments = cut_segments(observation.train, 13)
    assert len(segments) == 4 * 3
    assert all("[" in s.name for s in segments)
    fit = replace(observation, segments=tuple(segments)).fit(law)
    states = states_of(fit.whole, observation.train)
    for scene in observation.train:
        p, v = states[scene.name]
        assert p.shape == v.shape == (40, 1, 2)
        error = p[:, 0] - exact.scene(scene.name).positions[:, 0]
        assert np.abs(error).max() < 0.05


def test_scenes_that_were_not_fitted_or_ran_away_have_no_states(exact_and_fit):
    _, observation, law = exact_and_fit
    whole = observation.fit(law).whole
    assert states_of(whole, observation.test) == {}
    (batch,) = whole.batches
    gone = whole.predicted[0].copy()
    gone[5:, 0] = np.nan
    states = states_of(replace(whole, predicted=(gone,)), observation.train)
    assert set(states) == {s.name for s in batch.scenes[1:]}
