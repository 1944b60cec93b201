"""Errors that people read: the paper's nRMSE, and residual accelerations."""

import numpy as np

from bsp_gp.physics.bodies import stack
from bsp_gp.physics.likelihood import build_regression

METRICS = ("residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint", "endpoint_mean")
"""Errors of a model on held-out data, as `Errors` has them."""


def error_of(metric, rows):
    """An error of some held-out scenes, one of `METRICS`; nan where there is nothing to score.

    Parameters
    ----------
    rows : sequence of dict
        A row per scene, with the fields of `ERRORS`: nan where there is nothing.
    """
    field, told_by, error = ERRORS[metric]
    return error([told_by(row[field]) for row in rows])


def one_step_errors(scenes, law, up=None, sources=True):
    """Euclidean one-step errors, as in the paper's metric.

    From finite-difference velocities, one symplectic Euler step (paper, equation 1).

    Parameters
    ----------
    sources : bool
        Whether rows where any body is lost are left out, as they must be where laws name others.

    Returns
    -------
    list of ndarray, one per scene, shape (T - 2, N), metres
        Static entities included, with error 0; nan where a track has a gap, inf where the law
        has no finite value.
    """
    errors = {}
    for batch in stack(scenes, up):
        regression = build_regression(batch.scenes, up=up, sources=sources, may_be_empty=True)
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
    """Root mean square of observed minus predicted acceleration over bodies and instants, m/s^2.

    nan where no row is looked at.
    """
    total, count = 0.0, 0
    for part in regression.raw_residuals(law):
        seen = np.isfinite(part).any(axis=-1)
        total += float(np.nansum(np.square(part)))
        count += int(seen.sum())
    return float(np.sqrt(total / count)) if count else float("nan")


def _squares(field):
    """Sum of squared sizes and their number."""
    squares = np.square(field).sum(axis=-1)
    squares = squares[~np.isnan(squares)]
    return float(squares.sum()), len(squares)


def _sizes(field):
    sizes = np.linalg.norm(field, axis=-1).ravel()
    return sizes[~np.isnan(sizes)]


def _root_mean_square(scenes):
    total, n = map(sum, zip(*scenes, strict=True))
    return (total / n) ** 0.5 if n else float("nan")


def _mean_of_scenes(scenes):
    return sum(scenes) / len(scenes)


def _average(average):
    def error(scenes):
        sizes = np.concatenate(scenes)
        return float(average(sizes)) if len(sizes) else float("nan")

    return error


def _mean_size(field):
    sizes = _sizes(field)
    return float(sizes.mean()) if len(sizes) else float("nan")


ERRORS = {
    "residual_acceleration": ("accelerations", _squares, _root_mean_square),
    "one_step_nrmse": ("steps", _mean_size, _mean_of_scenes),
    "rollout_rmse": ("track", _squares, _root_mean_square),
    "endpoint": ("ends", _sizes, _average(np.median)),
    "endpoint_mean": ("ends", _sizes, _average(np.mean)),
}
"""The field of a scene's row, what of a scene tells, and the error of scenes."""
