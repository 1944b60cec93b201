"""Frequencies of tracks: sums over an even grid are those over rows one by one."""

import numpy as np
import pytest

from bsp_gp.fitting.periodogram import _power, _rates


def fallen(times, x, variance, rate, fading):
    """Fall of chi-squared by a wave of one rate beside a parabola, by least squares."""
    weight = 1 / np.sqrt(variance)
    parabola = np.stack([times**0, times, times**2], axis=1)
    fade = np.exp(-fading * (times - times[0]))
    waves = np.stack([np.cos(rate * times) * fade, np.sin(rate * times) * fade], axis=1)
    left = []
    for columns in (parabola, np.concatenate([parabola, waves], axis=1)):
        weighted = weight[:, None] * columns
        amounts = np.linalg.lstsq(weighted, weight * x, rcond=1e-9)[0]
        left.append(np.square(weight * x - weighted @ amounts).sum())
    return left[0] - left[1]


@pytest.mark.parametrize("fading", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["even", "gaps", "uneven"])
def test_the_power_of_a_rate_is_the_fall_of_chi_squared(kind, fading):
    rng = np.random.default_rng(3)
    times = 0.1 * np.arange(120.0)
    if kind == "gaps":
        times = np.delete(times, rng.choice(120, 30, replace=False))
    if kind == "uneven":
        times = np.sort(rng.uniform(0.0, 12.0, 120))
    x = np.cos(3 * times) + 0.2 * times**2 + 0.1 * rng.standard_normal(len(times))
    variance = rng.uniform(0.005, 0.02, len(times))
    rates = _rates(np.ptp(times), np.median(np.diff(times)))
    power = _power(times, x, variance, rates, fading)
    for k in (0, 1, len(rates) // 3, len(rates) - 1):
        expected = fallen(times, x, variance, rates[k], fading)
        assert power[k] == pytest.approx(expected, rel=1e-4, abs=1e-4)
