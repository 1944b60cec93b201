"""Data that lack nothing: how often does the loop adopt an effect?"""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from tests.planted import GRAVITY, orbit_dataset
from tests.worlds import WEIGHT, flights, heavy_noise, nothing, red_noise

pytestmark = pytest.mark.slow
ALPHA = 0.01


def is_missing(report):
    """Whether something is missing beside noise of another kind."""
    asked = next((r for r in report.rounds if not is_noise(r)), report.rounds[-1])
    return asked.missing.p_value <= ALPHA


def is_noise(done):
    return done.effect is not None and done.effect.code == "noise"


def is_adopted(report):
    return any(r.adopted and not is_noise(r) for r in report.rounds)


@pytest.mark.long
def test_at_most_four_of_a_hundred():
    """Level 0.01: four or more of 100 would happen by chance in 1.8 % of all series."""
    adopted, missing = [], []
    for seed in range(100):
        data = orbit_dataset(seed, drag=0.0, n_train=3, n_test=3)
        report = close_loop(data, [GRAVITY], rng=np.random.default_rng(seed))
        missing.append(is_missing(report))
        if is_adopted(report):
            adopted.append((seed, report.law_text))
    print("adopted", adopted, "missing", sum(missing))
    assert len(adopted) <= 4
    assert sum(missing) <= 4


def test_many_short_scenes_lack_nothing():
    """The autocorrelation that fitted initial states leave must not count as a finding."""
    missing = []
    for seed in range(20):
        data = flights(seed, nothing, n_train=40, n_test=5, n_times=12, noise=None)
        report = close_loop(data, [WEIGHT], rng=np.random.default_rng(seed), max_levels=4)
        missing.append(is_missing(report))
        assert not is_adopted(report)
    print("missing", sum(missing))
    assert sum(missing) <= 2


@pytest.mark.parametrize("noise", [red_noise, heavy_noise])
def test_noise_of_another_kind_is_no_force(noise):
    """Errors with a memory or with outliers may be seen as something, but never as a law."""
    for seed in range(10):
        data = flights(seed, nothing, noise=noise)
        report = close_loop(data, [WEIGHT], rng=np.random.default_rng(seed))
        assert not is_adopted(report), (seed, report.law_text)


@pytest.mark.parametrize("seed", [0, 2])
def test_positions_in_whole_pixels(seed):
    pixel = 0.02
    data = flights(
        seed,
        nothing,
        noise=lambda rng, shape: np.zeros(shape),
        warp=lambda t, p: (t, np.round(p / pixel) * pixel),
    )
    report = close_loop(data, [WEIGHT], rng=np.random.default_rng(seed), max_levels=4)
    assert report.noise["sigma"] == pytest.approx([pixel / np.sqrt(12)] * 2, rel=0.3)
    assert report.rounds[0].missing.statistic < 10
