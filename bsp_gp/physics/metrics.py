"""Errors that people read: the paper's nRMSE, and residual accelerations."""

from __future__ import annotations

import numpy as np

from bsp_gp.physics.bodies import stack
from bsp_gp.physics.likelihood import build_regression

__all__ = [
    "one_step_errors", "one_step_nrmse", "residual_acceleration", "residual_accelerations",
]  # fmt: skip


def one_step_errors(scenes, law, up=None):
    """Euclidean one-step errors, as in the paper's metric.

    From finite-difference velocities, one symplectic Euler step (paper, equation 1).

    Returns
    -------
    list of ndarray, one per scene, shape (T - 2, N), metres
        Static entities included, with error 0; nan where a track has a gap, inf where the law
        has no finite value.
    """
    errors = {}
    for batch in stack(scenes, up):
        regression = build_regression(batch.scenes, up=up)
        part = regression.batches[0]
        residual = part.target - regression.predict(part, law)
        residual = np.where(np.isfinite(residual), residual, np.inf)
        scale = np.where(part.valid, part.scale, np.nan)
        size = np.linalg.norm(residual * scale, axis=-1)
        n_entities = part.positions.shape[2]
        for s, scene in enumerate(batch.scenes):
            full = np.zeros((len(scene.times) - 2, n_entities))
            full[:, part.bodies.receivers] = size[: len(scene.times) - 2, s]
            errors[scene.name] = full
    return [errors[scene.name] for scene in scenes]


def one_step_nrmse(scenes, law, up=None):
    """The paper's nRMSE: mean over entities and times of the Euclidean error, then over scenes.

    Not divided by any scale, despite its name. Verified: zero force on SYNTH test scenes gives
    1.768 / 0.05984 / 0.001199 (NBODY / BOUNCE / MAT).
    """
    return float(np.mean([np.nanmean(errors) for errors in one_step_errors(scenes, law, up)]))


def residual_accelerations(regression, law):
    """Observed minus predicted accelerations by scene, {name: (n, R, d)}, m/s^2; nan = no row."""
    return {
        name: part[:, s]
        for batch, part in zip(regression.batches, regression.raw_residuals(law), strict=True)
        for s, name in enumerate(batch.scene_names)
    }


def residual_acceleration(regression, law):
    """Root mean square of observed minus predicted acceleration over bodies and instants, m/s^2."""
    total, count = 0.0, 0
    for part in regression.raw_residuals(law):
        seen = np.isfinite(part).any(axis=-1)
        total += float(np.nansum(np.square(part)))
        count += int(seen.sum())
    return float(np.sqrt(total / count))
