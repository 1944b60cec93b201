"""Question 1 of the loop: whether anything is left above the noise."""

from __future__ import annotations

import numpy as np

from bsp_gp.loop.outcome import Missing
from bsp_gp.units import ACCELERATION

__all__ = ["LAGS", "examine_residual", "ljung_box"]

LAGS = 8
POWER_Z = 1.6448536269514722  # 95 % power


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
        n += int(batch.valid.sum())
    return _pooled_ljung_box(parts, n, lags)


def _ljung_box_of_tracks(observation, whole, lags=LAGS):
    """The same for the position residuals of a fit to whole tracks."""
    parts = []
    for batch, predicted in zip(whole.batches, whole.predicted, strict=True):
        left = batch.positions[:, :, batch.bodies.receivers] - predicted
        with np.errstate(invalid="ignore"):
            parts.append(np.nan_to_num(left / observation.sigma))
    n_states = whole.n_free / max(whole.n_rows, 1)
    return _pooled_ljung_box(parts, whole.n_rows, lags, n_states)


def _pooled_ljung_box(parts, n, lags, fitted=0.0):
    """Ljung-Box over tracks that all start anew; `fitted` is the share of fitted parameters.

    Fitted initial states make residuals slightly anticorrelated: the expectation of every
    lagged product under the null is subtracted, -1/T of the sum of squares per parameter.
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
    variance = bottom / n
    z = (tops / variance + fitted * counts) / np.sqrt(counts)
    return float(stats.chi2.sf(float(z @ z), lags))


def _detectable(observation, fit, alpha):
    """Smallest uniform acceleration that would have been seen with 95 % power.

    Along the worst axis on which anything moves, after the law's own constants are refitted.
    """
    from scipy import stats

    regression = observation.train_regression
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
            size = (stats.norm.isf(alpha / 2) + POWER_Z) / np.sqrt(left @ left)
            worst = max(worst, float(size) * scale)
    return worst if worst else float("nan")


def _live(columns):
    columns = columns[:, np.any(columns, axis=0)]
    return columns / np.linalg.norm(columns, axis=0) if columns.size else columns
