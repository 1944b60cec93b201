"""Whitening of tracks' errors, against dense covariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_triangular

from bsp_gp.errors import FitError
from bsp_gp.fitting.whitening import Whitener, gaps_of, log_likelihood

TIMES = st.sampled_from([0.0, 1e-9, 1e-3, 0.3, 1.0, 40.0, 1e9, np.inf])
AMPLITUDES = st.sampled_from([0.0, 1e-9, 0.1, 1.0, 10.0])


def covariance(times, variance, amplitude, correlation_time):
    gaps = np.abs(times[:, None] - times)
    with np.errstate(divide="ignore", invalid="ignore"):
        ages = np.where(gaps == 0, 0.0, gaps / correlation_time)
    scale = np.broadcast_to(amplitude, times.shape)
    return np.diag(variance) + scale[:, None] * scale * np.exp(-ages)


@st.composite
def tracks(draw):
    """Irregular times, gaps, and a variance of its own for every row."""
    n_rows = draw(st.integers(1, 20) | st.integers(64, 150))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (n_rows, draw(st.integers(1, 3)))
    times = np.cumsum(10.0 ** rng.uniform(-3, 1, shape), axis=0)
    variance = 10.0 ** rng.uniform(-2, 2, shape)
    variance[rng.random(shape) < draw(st.sampled_from([0.0, 0.2, 0.9]))] = np.nan
    n_missing = draw(st.integers(0, n_rows // 2))
    times[n_rows - n_missing :, 0] = np.nan  # a shorter track is filled up
    return times, variance, rng.standard_normal((2, *shape))


@settings(max_examples=100, deadline=None)
@given(tracks(), AMPLITUDES, TIMES)
def test_the_likelihood_is_that_of_what_is_whitened(track, amplitude, memory):
    times, variance, (errors, _) = track
    whitener = Whitener(times, variance, amplitude, memory)
    expected = -0.5 * (np.square(whitener.whiten(errors)).sum() + whitener.log_det)
    amplitudes = np.full(times.shape, amplitude)
    found = log_likelihood(errors, whitener.seen, gaps_of(times), variance, amplitudes, memory)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_the_likelihood_of_no_noise_is_none():
    one = np.ones((3, 1))
    gaps, seen = gaps_of(np.arange(3.0)[:, None]), np.full((3, 1), True)
    assert log_likelihood(one, seen, gaps, 0 * one, 0 * one, 1.0) == -np.inf


@settings(max_examples=150, deadline=None)
@given(tracks(), AMPLITUDES, TIMES, st.booleans())
def test_whitening_is_that_of_the_dense_covariance(track, amplitude, memory, by_row):
    times, variance, errors = track
    amplitude = amplitude * (1 + np.arange(times.size if by_row else times.shape[1]) % 3)
    amplitude = amplitude.reshape(times.shape if by_row else -1)
    whitener = Whitener(times, variance, amplitude, memory)
    whitened, coloured = whitener.whiten(errors), whitener.colour(errors)
    seen = np.isfinite(variance) & np.isfinite(times)
    assert not whitened[:, ~seen].any() and not coloured[:, ~seen].any()
    for c in range(times.shape[1]):
        rows = seen[:, c]
        size = amplitude[rows, c] if by_row else amplitude[c]
        dense = covariance(times[rows, c], variance[rows, c], size, memory)
        lower = np.linalg.cholesky(dense)
        expected = solve_triangular(lower, errors[:, rows, c].T, lower=True).T
        # The dense factorisation has no more digits than its condition leaves.
        lost = np.finfo(float).eps * len(dense) * np.linalg.cond(dense) if rows.any() else 0.0
        slack = max(1e-10, lost)
        np.testing.assert_allclose(whitened[:, rows, c], expected, rtol=slack, atol=slack)
        expected = errors[:, rows, c] @ lower.T
        np.testing.assert_allclose(coloured[:, rows, c], expected, rtol=1e-10, atol=1e-10)
        expected = 2 * np.log(np.diag(lower)).sum()
        assert whitener.log_dets[c] == pytest.approx(expected, rel=1e-10, abs=1e-9)
    assert whitener.log_det == pytest.approx(whitener.log_dets.sum())


def test_without_a_correlated_part_errors_are_divided_to_the_last_bit():
    rng = np.random.default_rng(0)
    sizes = rng.uniform(0.1, 3, (50, 4))
    errors = rng.standard_normal((3, 50, 4))
    times = np.arange(50.0)[:, None]
    assert np.array_equal(Whitener(times, sizes**2).whiten(errors), errors / np.sqrt(sizes**2))
    mixed = Whitener(times, sizes**2, [0.0, 0.0, 1.0, 0.0], 3.0).whiten(errors)
    np.testing.assert_allclose(mixed[..., :2], errors[..., :2] / sizes[:, :2], rtol=1e-14)


def test_long_tracks_one_by_one_and_many_at_once_are_the_same():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.01, 2, (301, 200)), axis=0)
    variance = 10.0 ** rng.uniform(-6, 2, times.shape)
    memory = 10.0 ** rng.uniform(-3, 6, 200)
    errors = rng.standard_normal(times.shape)
    together = Whitener(times, variance, 1.0 + np.arange(200.0), memory)
    for c in (0, 77, 199):
        at = slice(c, c + 1)
        alone = Whitener(times[:, at], variance[:, at], [1.0 + c], memory[at])
        np.testing.assert_allclose(
            alone.whiten(errors[:, at]), together.whiten(errors)[:, at], rtol=1e-9, atol=1e-12
        )
        assert alone.log_det == pytest.approx(together.log_dets[c], rel=1e-12)


def test_digits_are_kept_where_a_tridiagonal_precision_loses_them():
    n_rows, memory = 400, 1e9
    times = np.arange(float(n_rows))[:, None]
    whitener = Whitener(times, np.full((n_rows, 1), 1e4), [1.0], memory)
    # In the limit of no decay: a common offset, whose determinant is known.
    expected = n_rows * np.log(1e4) + np.log1p(n_rows / 1e4)
    assert whitener.log_det == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("times", "variance", "amplitude", "words"),
    [
        ([0.0, 1.0], [1.0, -1.0], 0.0, "negative"),
        ([0.0, 1.0], [1.0, 1.0], np.nan, "negative or nan"),
        ([0.0, 1.0], [1.0, 0.0], 0.0, "zero"),
        ([1.0, 0.0], [1.0, 1.0], 1.0, "increase"),
        ([0.0, 0.0], [0.0, 0.0], 1.0, "zero"),
    ],
)
def test_noise_that_is_none_is_refused(times, variance, amplitude, words):
    with pytest.raises(FitError, match=words):
        Whitener(np.array(times)[:, None], np.array(variance)[:, None], [amplitude], 1.0)


def test_no_columns_are_whitened_to_none():
    """LAPACK was handed no right-hand side and wrote beyond its end: later allocations crashed."""
    times = np.linspace(0.0, 1.0, 50)[:, None]
    whitener = Whitener(times, np.full((50, 1), 0.5), np.full((50, 1), 0.7), 0.1)
    for _ in range(2000):
        assert whitener.whiten(np.zeros((0, 50, 1))).shape == (0, 50, 1)
        np.zeros(100)
