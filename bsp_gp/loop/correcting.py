"""The numbers of a correction of the measurement, fitted jointly with the law and its states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.seeing import Linearised, corrected, corrected_train, train_tracks
from bsp_gp.physics.shooting import fit_rollout

__all__ = ["fit_correction", "inflation", "linear_step", "states_of_fit"]

MOST_STEPS = 8
ENOUGH = 0.01
"""Fall of chi-squared that is too small for another step."""


def fit_correction(observation, fit, correction, start):
    """Fit the numbers of a correction jointly with the law that it is to save.

    The law's constants and initial states are fitted at every step, so that the steps see the
    profile of chi-squared.

    Parameters
    ----------
    observation : Observation
        As measured.
    fit : Fit
        Of the law, as measured.
    correction : Correction
    start : ndarray
        First values, of the screening.

    Returns
    -------
    values, covariance : ndarray
    observation : Observation
        As it was by the correction.
    fit : Fit
    """
    bounds = sign_bounds(observation, fit.law)
    values, best = np.array(start, dtype=float), None
    here = fit
    for _ in range(MOST_STEPS):
        here = _fit_at(observation, here, correction, values, bounds)
        if not np.isfinite(here.chisqr) or (best and here.chisqr > best[1].chisqr):
            if best is None:
                values = values / 2
                here = fit
                continue
            if abs(here.chisqr - best[1].chisqr) < ENOUGH:
                break
            values, here = (values + best[0]) / 2, best[1]
            continue
        linear = Linearised(observation, here, correction, values)
        columns, _ = linear.columns(correction, values)
        best = (values, here, columns)
        step, gain = linear_step(columns, linear.residual)
        moved = np.clip(values + step, correction.low, correction.high)
        if gain < ENOUGH or np.array_equal(moved, values):
            break
        values = moved
    if best is None:
        return np.zeros(len(correction)), np.zeros((len(correction),) * 2), observation, fit
    values, here, columns = best
    seen = corrected(observation, correction, values, here)
    done = seen.fit(here.law, bounds, start=here.law, states=states_of_fit(here))
    covariance = np.linalg.pinv(columns @ columns.T, hermitian=True)
    return values, covariance * inflation(done), seen, done


def _fit_at(observation, near, correction, values, bounds):
    """The law fitted to positions corrected by these values."""
    tracks = train_tracks(near, observation.train) if correction.needs_track else {}
    seen = corrected_train(observation, correction, values, tracks)
    if near.whole is None:
        return replace(seen, train_regression=seen.regression(seen.train)).fit(near.law, bounds)
    whole = fit_rollout(
        seen.segments, near.law, seen.sigma, integrator=seen.integrator, substeps=seen.substeps,
        up=seen.dataset.up, bounds=bounds, memory=seen.memory, states=states_of_fit(near),
    )  # fmt: skip
    return replace(
        near, law=whole.law, values=whole.values, covariance=whole.covariance,
        chisqr=whole.chisqr, whole=whole,
    )  # fmt: skip


def states_of_fit(fit):
    """Initial states of a fit to whole tracks, to start another from.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    dict of str to (ndarray, ndarray) or None
        By the name of scene or segment; None without a fit to tracks.
    """
    if fit.whole is None:
        return None
    return {
        scene.name: (p[s], v[s])
        for batch, p, v in zip(
            fit.whole.batches, fit.whole.positions, fit.whole.velocities, strict=True
        )
        for s, scene in enumerate(batch.scenes)
    }


def inflation(fit):
    """By what misfit beyond the noise inflates the variance of a correction's numbers."""
    free = fit.whole.n_free if fit.whole is not None else len(fit.parameters)
    misfit = max(fit.chisqr / max(fit.n_rows - free, 1), 1.0)
    return misfit * (max(fit.n_rows / fit.n_effective, 1.0) if misfit > 1.5 else 1.0)


def linear_step(columns, residual):
    """Numbers that leave least to first order, and by how much chi-squared falls.

    Parameters
    ----------
    columns : ndarray, shape (k, n)
        Derivatives of the residual.
    residual : ndarray, shape (n,)
    """
    step = -np.linalg.lstsq(columns.T, residual, rcond=1e-10)[0]
    left = residual + step @ columns
    return step, float(residual @ residual - left @ left)
