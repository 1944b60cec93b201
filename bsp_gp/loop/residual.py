"""Question 1 of the loop: whether anything is left above the noise."""

from __future__ import annotations

import numpy as np

from bsp_gp.loop.outcome import Missing
from bsp_gp.physics.noise import TrackNoise
from bsp_gp.units import ACCELERATION

__all__ = ["LAGS", "examine_residual", "ljung_box"]

LAGS = 8
POWER = 0.95
POWER_Z = 1.6448536269514722  # 95 % of a normal distribution lie below


def examine_residual(observation, fit, alpha):
    """Test the whitened residual of the fitted model against noise.

    On noisy data the residual is that of whole tracks (positions), otherwise of accelerations.

    Two tests, Bonferroni-corrected: the size of the residual (chi-squared against a declared
    noise level, an F test against an estimated one, whose own uncertainty counts) and its
    autocorrelation along tracks (Ljung-Box).

    Parameters
    ----------
    observation : Observation
    fit : Fit
    alpha : float

    Returns
    -------
    Missing
    """
    from scipy import stats

    if fit.whole is not None:
        size = fit.whole.chisqr
        dof = max(fit.whole.n_rows - fit.whole.n_free, 1)
        p_lag = _ljung_box_of_tracks(observation, fit.whole)
    else:
        size = float(fit.residual @ fit.residual)
        dof = max(observation.train_regression.n_rows - len(fit.parameters), 1)
        p_lag = ljung_box(observation.train_regression, fit.residual)
    size /= dof
    n_noise = _noise_dof(observation)
    if np.isfinite(n_noise):
        p_size = float(stats.f.sf(size, dof, n_noise))
    else:
        p_size = float(stats.chi2.sf(size * dof, dof))
    p_value = min(1.0, 2 * min(p_size, p_lag))
    return Missing(
        statistic=size,
        p_value=p_value,
        detectable=_detectable(observation, fit, alpha),
        detectable_unit=observation.dataset.units.text(ACCELERATION),
        tests={"size": p_size, "autocorrelation": p_lag},
        is_missing=bool(p_value <= alpha),
    )


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


def _ljung_box_of_tracks(observation, whole, lags=LAGS):
    """The same for the position residuals of a fit to whole tracks."""
    mean, covariance = np.zeros(lags), np.zeros((lags, lags))
    for batch in whole.batches:
        noise = TrackNoise(batch, observation.sigma, observation.memory)
        clock = np.broadcast_to(np.nan_to_num(batch.times)[..., None, None], noise.seen.shape)
        basis = noise.whiten(np.stack([np.ones_like(clock), clock]))  # (2, T, S, R, d)
        for track in np.ndindex(noise.seen.shape[1:]):
            seen = noise.seen[(slice(None), *track)]
            if seen.sum() > 2:
                moments = _taken_by_state(basis[(slice(None), slice(None), *track)].T, seen, lags)
                mean, covariance = mean + moments[0], covariance + moments[1]
    return _pooled_ljung_box(whole.whitened, whole.n_rows - whole.n_free, lags, mean, covariance)


def _taken_by_state(basis, seen, lags):
    """What fitting a place and a velocity does to the lagged products of white noise.

    With the projection C = I - QQ' on the residuals, a product r'Sr has the expectation tr(SC),
    and two of them the covariance 2 tr(SCS'C).
    """
    q = np.linalg.qr(basis)[0]
    moved = np.zeros((lags, *q.shape))
    for lag in range(1, lags + 1):
        moved[lag - 1, lag:] += q[:-lag] / 2
        moved[lag - 1, :-lag] += q[lag:] / 2
    moved[:, ~seen] = 0.0
    inner = np.swapaxes(q, 0, 1) @ moved
    covariance = 2 * np.einsum("lij,mji->lm", inner, inner)
    covariance -= 4 * np.einsum("ltk,mtk->lm", moved, moved)
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


def _detectable(observation, fit, alpha):
    """Smallest uniform acceleration that would have been seen with 95 % power.

    Along the worst axis on which anything moves, after the law's own constants are refitted.
    """
    regression = observation.train_regression
    needed = _needed(observation, fit, alpha)
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


def _needed(observation, fit, alpha):
    """Whitened sum of squares that the test of size, which knows no direction, sees with 95 %."""
    from scipy import optimize, stats

    whole = fit.whole
    n_rows = whole.n_rows - whole.n_free if whole else observation.train_regression.n_rows
    dof, n_noise = max(n_rows, 1), _noise_dof(observation)
    bar = stats.chi2.isf(alpha / 2, dof)
    if np.isfinite(n_noise):
        # The level may have been estimated too high, by as much as its own error.
        bar = dof * stats.f.isf(alpha / 2, dof, n_noise) * (1 + POWER_Z * np.sqrt(2 / n_noise))
    return optimize.brentq(lambda x: stats.ncx2.sf(bar, dof, x) - POWER, 0.0, 10 * bar + 100)


def _live(columns):
    columns = columns[:, np.any(columns, axis=0)]
    return columns / np.linalg.norm(columns, axis=0) if columns.size else columns
