"""Question 1 of the loop: whether anything is left above the noise."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from bsp_gp.loop.arcs import orthonormal_rows, polynomials, scaled_rows
from bsp_gp.loop.directed import directed_test
from bsp_gp.loop.outcome import Missing
from bsp_gp.loop.periodic import rhythm_of
from bsp_gp.physics.noise import TrackNoise
from bsp_gp.search.columns import balanced
from bsp_gp.units import ACCELERATION, FORCE

__all__ = ["LAGS", "durbin_watson", "examine_residual", "ljung_box"]

LAGS = 8
DEGREES = (2, 3, 6)
"""Of the polynomials of time in which a residual force is looked for, track by track. What a slow
force does lies in the first few, and stands out more the fewer are looked at."""
POWER = 0.95
POWER_Z = 1.6448536269514722  # 95 % of a normal distribution lie below


def examine_residual(observation, fit, alpha):
    """Test the whitened residual of the fitted model against noise.

    On noisy data the residual is that of whole tracks (positions), otherwise of accelerations.

    Tests, Bonferroni-corrected: the size of the residual (chi-squared against a declared
    noise level, an F test against an estimated one, whose own uncertainty counts), its
    autocorrelation along tracks (Ljung-Box); on noisy data also the size of its smooth part, in
    which forces are and noise hardly is, for three degrees of smoothness, its part along common
    effects, and the best of all periods.

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
        if not _is_finite(size, blocks):
            return _failed(size / dof)
        p_lag = _ljung_box_of_tracks(fit.whole, blocks)
    else:
        size = float(fit.residual @ fit.residual)
        dof = max(observation.train_regression.n_rows - len(fit.parameters), 1)
        if not _is_finite(size, [[fit.jacobian]]):
            return _failed(size / dof)
        p_lag = ljung_box(observation.train_regression, fit.residual)
    size /= dof
    n_noise = observation.noise_dof
    tests = {"size": _p_of_size(size * dof, dof, n_noise), "autocorrelation": p_lag}
    smooth = [] if fit.whole is None else _smooth_parts(observation, fit.whole, blocks)
    for degree, square, n in smooth:
        tests[f"smooth part, degree {degree}"] = _p_of_size(square, n, n_noise)
    rhythm, directions, together = None, (), ()
    if fit.whole is not None:
        p_of_size = partial(_p_of_size, n_noise=n_noise)
        rhythm = rhythm_of(observation, fit.whole, blocks, p_of_size)
        directions, together = directed_test(observation, fit, blocks, p_of_size)
        if directions:
            tests[f"common effects ({directions[0].name})"] = directions[0].p_value
    if rhythm is not None:
        tests["a period"] = rhythm.p_value
    # `min` passes over what is not a number.
    p_value = float(np.minimum(1.0, len(tests) * np.min(list(tests.values()))))
    detectable = _detectable(observation, fit, alpha / len(tests), len(directions))
    return Missing(
        statistic=size,
        p_value=p_value,
        detectable=detectable.acceleration,
        detectable_unit=observation.dataset.units.text(ACCELERATION),
        detectable_force=detectable.force,
        detectable_force_unit=observation.dataset.units.text(FORCE),
        detectable_share=detectable.share,
        tests=tests,
        is_missing=bool(p_value <= alpha),
        rhythm=rhythm,
        directions=directions,
        together=together,
        durbin_watson=math.nan if fit.whole is None else durbin_watson(fit.whole.whitened),
    )


def _is_finite(size, blocks):
    return math.isfinite(size) and all(np.isfinite(p).all() for block in blocks for p in block)


def _failed(statistic):
    """Nothing was tested: what a fit that failed leaves says nothing."""
    return Missing(float(statistic), math.nan, math.nan, is_missing=False)


def _p_of_size(square, dof, n_noise):
    """p-value of a whitened sum of squares; `n_noise` as of `Observation.noise_dof`."""
    from scipy import stats

    if np.isfinite(n_noise):
        return float(stats.f.sf(square / dof, dof, n_noise))
    return float(stats.chi2.sf(square, dof))


def _smooth_parts(observation, whole, blocks):
    """Sums of squares of the position residuals in low polynomials of time: (degree, square, dof).

    What constants and initial states can take up is projected out of the polynomials of every
    track, so that under the law alone the coordinates are independent and of unit variance.
    """
    square, dof = np.zeros(len(DEGREES)), np.zeros(len(DEGREES), dtype=int)
    for batch, block in zip(whole.batches, blocks, strict=True):
        noise = TrackNoise(batch, observation.sigma, observation.memory)
        columns = polynomials(batch, noise, DEGREES[-1])
        degrees = np.tile(np.arange(DEGREES[-1] + 1), len(columns) // (DEGREES[-1] + 1))
        for s, (residual, *taken) in enumerate(zip(*block, strict=True)):
            known = orthonormal_rows(np.concatenate(taken))
            for k, degree in enumerate(DEGREES):
                basis = _beside(columns[degrees <= degree, s], known)
                square[k] += float(np.square(basis @ residual).sum())
                dof[k] += len(basis)
    return [(d, *both) for d, *both in zip(DEGREES, square, dof, strict=True) if both[1]]


def _beside(rows, q):
    """Orthonormal basis of what rows (k, n) span beyond the orthonormal rows `q`."""
    rows = scaled_rows(rows)
    if not len(rows):
        return rows
    rows = rows - (rows @ q.T) @ q
    _, values, basis = np.linalg.svd(rows, full_matrices=False)
    return basis[values > 1e-6]


def durbin_watson(parts):
    """Statistic of Durbin and Watson (1950), pooled over tracks.

    Parameters
    ----------
    parts : sequence of ndarray, shape (T, ...)
        Whitened residuals, time first; 0 where nothing was seen.

    Returns
    -------
    float
    """
    steps = squares = 0.0
    for part in parts:
        both = (part[1:] != 0) & (part[:-1] != 0)
        steps += float(np.square(np.diff(part, axis=0))[both].sum())
        # A step has two ends: half of the squares of each, so that white noise gives 2.
        squares += float((np.square(part[1:]) + np.square(part[:-1]))[both].sum()) / 2
    return steps / squares if squares > 0 else math.nan


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


class _Detectable(NamedTuple):
    """Smallest effect that would have been seen.

    As the acceleration of a body of typical mass, m/s^2; as a force, and in parts of the declared
    force (nan where a mass is not known).
    """

    acceleration: float
    force: float
    share: float


def _detectable(observation, fit, alpha, n_effects):
    """Smallest constant force, one for all bodies, seen with 95 % power at level `alpha`.

    On whole tracks it is one of the common effects that are looked for. Along the worst axis on
    which anything moves, after the law's own constants are refitted. Where a mass is not known it
    is an acceleration that is one for all.
    """
    regression = observation.train_regression
    masses = [b.bodies.column("mass")[:, b.bodies.receivers] for b in regression.batches]
    is_known = observation.has_masses and all(np.isfinite(m).all() for m in masses)
    if not is_known:
        masses = [np.ones_like(m) for m in masses]
    typical = float(np.median(np.concatenate([np.ravel(m) for m in masses])))
    needed = _needed(observation, fit, alpha, n_effects)
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
        for batch, mass in zip(regression.batches, masses, strict=True):
            push = np.zeros_like(batch.target)
            push[..., axis] = typical / mass
            parts.append(batch.whiten(push).ravel())
        column = np.concatenate(parts)
        left = column - q @ (q.T @ column)
        # A column that the law's constants can imitate says nothing.
        if left @ left > 1e-8 * (column @ column):
            size = np.sqrt(needed / (left @ left))
            worst = max(worst, float(size) * scale)
    if not worst:
        return _Detectable(*(float("nan"),) * 3)
    if not is_known:
        return _Detectable(worst, float("nan"), float("nan"))
    force, declared = worst * typical, _declared_force(regression, fit.law, masses)
    return _Detectable(worst, force, force / declared if declared > 0 else float("nan"))


def _declared_force(regression, law, masses):
    """Root mean square of what the declared terms say acts on a body, newtons."""
    declared = replace(law, terms=tuple(term for term in law.terms if term.is_declared))
    squares = [np.zeros(0)]
    for batch, mass in zip(regression.batches, masses, strict=True):
        force = regression.predict(batch, declared) * mass[..., None]
        squares.append(np.square(force).sum(axis=-1)[batch.valid.any(axis=-1)])
    squares = np.concatenate(squares)
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _needed(observation, fit, alpha, n_effects):
    """Whitened sum of squares that is seen with 95 %, in one direction of several or in all."""
    from scipy import optimize, stats

    whole = fit.whole
    n_rows = whole.n_rows - whole.n_free if whole else observation.train_regression.n_rows
    dof, n_noise = max(n_rows, 1), observation.noise_dof
    if n_effects:
        dof, alpha = 1, alpha / n_effects
    bar = stats.chi2.isf(alpha, dof)
    if np.isfinite(n_noise):
        # The level may have been estimated too high, by as much as its own error.
        bar = dof * stats.f.isf(alpha, dof, n_noise)
        bar *= 1 + POWER_Z * np.sqrt(2 / n_noise)
    return optimize.brentq(lambda x: stats.ncx2.sf(bar, dof, x) - POWER, 0.0, 10 * bar + 100)


def _live(columns):
    columns = balanced(columns[:, np.any(columns, axis=0)])
    return columns / np.linalg.norm(columns, axis=0) if columns.size else columns
