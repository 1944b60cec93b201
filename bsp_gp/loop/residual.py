"""Question 1 of the loop: whether anything is left above the noise."""

from __future__ import annotations

import numpy as np

from bsp_gp.loop.outcome import Missing
from bsp_gp.physics.noise import TrackNoise
from bsp_gp.units import ACCELERATION

__all__ = ["LAGS", "examine_residual", "ljung_box", "orthonormal_rows"]

LAGS = 8
DEGREE = 6
"""Of the polynomials of time in which a residual force is looked for, track by track."""
POWER = 0.95
POWER_Z = 1.6448536269514722  # 95 % of a normal distribution lie below


def examine_residual(observation, fit, alpha):
    """Test the whitened residual of the fitted model against noise.

    On noisy data the residual is that of whole tracks (positions), otherwise of accelerations.

    Three tests, Bonferroni-corrected: the size of the residual (chi-squared against a declared
    noise level, an F test against an estimated one, whose own uncertainty counts), its
    autocorrelation along tracks (Ljung-Box), and on noisy data the size of its smooth part, in
    which forces are and noise hardly is.

    Parameters
    ----------
    observation : Observation
    fit : Fit
    alpha : float

    Returns
    -------
    Missing
    """
    if fit.whole is not None:
        size = fit.whole.chisqr
        dof = max(fit.whole.n_rows - fit.whole.n_free, 1)
        blocks = observation.track_blocks(fit.whole)
        p_lag = _ljung_box_of_tracks(fit.whole, blocks)
    else:
        size = float(fit.residual @ fit.residual)
        dof = max(observation.train_regression.n_rows - len(fit.parameters), 1)
        p_lag = ljung_box(observation.train_regression, fit.residual)
    size /= dof
    n_noise = _noise_dof(observation)
    tests = {"size": _p_of_size(size * dof, dof, n_noise), "autocorrelation": p_lag}
    smooth = None if fit.whole is None else _smooth_part(observation, fit.whole, blocks)
    if smooth is not None:
        tests["smooth part"] = _p_of_size(*smooth, n_noise)
    p_value = min(1.0, len(tests) * min(tests.values()))
    return Missing(
        statistic=size,
        p_value=p_value,
        detectable=_detectable(observation, fit, alpha, smooth),
        detectable_unit=observation.dataset.units.text(ACCELERATION),
        tests=tests,
        is_missing=bool(p_value <= alpha),
    )


def _p_of_size(square, dof, n_noise):
    """p-value of a whitened sum of squares; `n_noise` as of `_noise_dof`."""
    from scipy import stats

    if np.isfinite(n_noise):
        return float(stats.f.sf(square / dof, dof, n_noise))
    return float(stats.chi2.sf(square, dof))


def _smooth_part(observation, whole, blocks):
    """Sum of squares of the position residuals in low polynomials of time, and how many these are.

    What constants and initial states can take up is projected out of the polynomials of every
    track, so that under the law alone the coordinates are independent and of unit variance.
    """
    square, dof = 0.0, 0
    for batch, block in zip(whole.batches, blocks, strict=True):
        noise = TrackNoise(batch, observation.sigma, observation.memory)
        time = np.nan_to_num(batch.times - np.nanmin(batch.times, axis=0))
        time = 2 * time / np.maximum(time.max(axis=0), 1e-300) - 1
        powers = np.moveaxis(np.polynomial.legendre.legvander(time, DEGREE), -1, 0)
        n_scenes, n_receivers, n_dims = noise.seen.shape[1:]
        columns = np.zeros((n_receivers, n_dims, DEGREE + 1, *noise.seen.shape))
        for r, axis in np.ndindex(n_receivers, n_dims):
            columns[r, axis, :, :, :, r, axis] = powers
        columns = noise.whiten(columns).reshape(-1, *noise.seen.shape)
        for s, (residual, *taken) in enumerate(zip(*block, strict=True)):
            mine = columns[:, :, s].reshape(len(columns), -1)
            basis = _beside(mine, np.concatenate(taken))
            square += float(np.square(basis @ residual).sum())
            dof += len(basis)
    return (square, dof) if dof else None


def _beside(rows, taken):
    """Orthonormal basis of what the rows span beyond the rows `taken`, each of shape (k, n)."""
    rows = _scaled(rows)
    if not len(rows):
        return rows
    q = orthonormal_rows(taken)
    rows = rows - (rows @ q.T) @ q
    _, values, basis = np.linalg.svd(rows, full_matrices=False)
    return basis[values > 1e-6]


def orthonormal_rows(rows):
    """Orthonormal basis of what rows (k, n) span, shape (m, n)."""
    rows = _scaled(rows)
    if not len(rows):
        return rows
    _, values, q = np.linalg.svd(rows, full_matrices=False)
    return q[values > 1e-10 * values[0]]


def _scaled(rows):
    """The rows that are not zero, at unit length."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    known = np.isfinite(sizes[:, 0]) & (sizes[:, 0] > 0)
    return rows[known] / sizes[known]


def _noise_dof(observation):
    """Degrees of freedom behind the noise level; infinite for a declared one."""
    if observation.noise.source != "estimated" and observation.method != "derivative":
        return np.inf
    counts = [n for n in observation.noise.n_effective if np.isfinite(n)]
    return float(sum(counts)) if counts else np.inf


def ljung_box(regression, residual, lags=LAGS):
    """p-value of the pooled autocorrelation of whitened residuals along tracks.

    The statistic of Ljung and Box (1978), with products pooled over tracks and axes.
    """
    parts, start, n = [], 0, 0
    for batch in regression.batches:
        parts.append(residual[start : start + batch.target.size].reshape(batch.target.shape))
        start += batch.target.size
        n += int(batch.kept.sum())
    return _pooled_ljung_box(parts, n, lags)


def _ljung_box_of_tracks(whole, blocks, lags=LAGS):
    """The same for the position residuals of a fit to whole tracks."""
    mean, covariance = np.zeros(lags), np.zeros((lags, lags))
    for errors, (_, _, by_state) in zip(whole.whitened, blocks, strict=True):
        n_times, n_segments = errors.shape[:2]
        for s in range(n_segments):
            basis = orthonormal_rows(by_state[s]).reshape(-1, n_times, errors[0, s].size)
            moments = _taken_by_state(basis, errors[:, s].reshape(n_times, -1) != 0, lags)
            mean, covariance = mean + moments[0], covariance + moments[1]
    return _pooled_ljung_box(whole.whitened, whole.n_rows - whole.n_free, lags, mean, covariance)


def _taken_by_state(basis, seen, lags):
    """What fitting initial states does to the lagged products of white noise.

    With the projection C = I - QQ' on the residuals, a product r'Sr has the expectation tr(SC),
    and two of them the covariance 2 tr(SCS'C). The basis Q has the shape (m, T, tracks).
    """
    moved = np.zeros((lags, *basis.shape))
    for lag in range(1, lags + 1):
        moved[lag - 1, :, lag:] += basis[:, :-lag] / 2
        moved[lag - 1, :, :-lag] += basis[:, lag:] / 2
    moved[:, :, ~seen] = 0.0
    inner = np.einsum("itk,ljtk->lij", basis, moved, optimize=True)
    covariance = 2 * np.einsum("lij,mji->lm", inner, inner)
    covariance -= 4 * np.einsum("litk,mitk->lm", moved, moved, optimize=True)
    return -np.trace(inner, axis1=1, axis2=2), covariance


def _pooled_ljung_box(parts, n, lags, mean=0.0, covariance=0.0):
    """Ljung-Box over tracks that all start anew.

    `mean` and `covariance` are what a fit does to the products; white noise itself gives them
    the mean 0 and the variance of their count.
    """
    from scipy import stats

    tops, counts, bottom = np.zeros(lags), np.zeros(lags), 0.0
    for part in parts:
        bottom += float((part * part).sum())
        for lag in range(1, lags + 1):
            if len(part) > lag:
                product = part[lag:] * part[:-lag]
                tops[lag - 1] += float(product.sum())
                counts[lag - 1] += int(np.count_nonzero(product))
    if bottom <= 0 or n <= 3 * lags or not counts.all():
        return 1.0
    z = tops * n / bottom - mean
    # The level is that of the same residuals: less scatter where the mean is not zero.
    spread = np.diag(counts) + covariance - 2 / n * np.outer(mean, mean)
    return float(stats.chi2.sf(float(z @ np.linalg.pinv(spread) @ z), lags))


def _detectable(observation, fit, alpha, smooth):
    """Smallest uniform acceleration that would have been seen with 95 % power.

    All of it is in the smooth part. Along the worst axis on which anything moves, after the law's
    own constants are refitted.
    """
    regression = observation.train_regression
    needed = _needed(observation, fit, alpha, smooth)
    q = (
        np.linalg.qr(_live(fit.jacobian))[0]
        if fit.jacobian.size
        else np.zeros((len(fit.residual), 0))
    )
    worst = 0.0
    scale = np.sqrt(max(float(fit.residual @ fit.residual) / max(regression.n_rows, 1), 1.0))
    for axis in range(regression.sigma.shape[0]):
        if not np.isfinite(regression.sigma[axis]):
            continue
        parts = []
        for batch in regression.batches:
            push = np.zeros_like(batch.target)
            push[..., axis] = 1.0
            parts.append(batch.whiten(push).ravel())
        column = np.concatenate(parts)
        left = column - q @ (q.T @ column)
        # A column that the law's constants can imitate says nothing.
        if left @ left > 1e-8 * (column @ column):
            size = np.sqrt(needed / (left @ left))
            worst = max(worst, float(size) * scale)
    return worst if worst else float("nan")


def _needed(observation, fit, alpha, smooth):
    """Whitened sum of squares that the tests of size, which know no direction, see with 95 %."""
    from scipy import optimize, stats

    whole = fit.whole
    n_rows = whole.n_rows - whole.n_free if whole else observation.train_regression.n_rows
    dof, n_noise, n_tests = max(n_rows, 1), _noise_dof(observation), 2
    if smooth is not None:
        dof, n_tests = smooth[1], 3
    bar = stats.chi2.isf(alpha / n_tests, dof)
    if np.isfinite(n_noise):
        # The level may have been estimated too high, by as much as its own error.
        bar = dof * stats.f.isf(alpha / n_tests, dof, n_noise)
        bar *= 1 + POWER_Z * np.sqrt(2 / n_noise)
    return optimize.brentq(lambda x: stats.ncx2.sf(bar, dof, x) - POWER, 0.0, 10 * bar + 100)


def _live(columns):
    columns = columns[:, np.any(columns, axis=0)]
    return columns / np.linalg.norm(columns, axis=0) if columns.size else columns
