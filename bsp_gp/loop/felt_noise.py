"""The noise of states that a law feels, in the smooth view.

A law evaluated at denoised positions still feels what noise the smoother has let through, slow as
it is: with forces that change with place, a spring or gravity, it adds to the noise of the second
differences. To first order the error of a residual is ``(D - A P - C V) e``: second differences D,
places P and velocities V of the noise e, A and C the slopes of all forces by place and velocity of
the body itself. The coordinates of every track are made white again under that covariance, that of
the errors themselves (their memory, and their sizes where points quote them) included.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.loop.denoise import tracks_of
from bsp_gp.loop.leftover import Leftover
from bsp_gp.physics.noise import sizes_of
from bsp_gp.search.constants import fit_constants

__all__ = ["linear_residual", "slopes_of", "whole_sizes", "whole_times", "with_felt_noise"]

STEP = 1e-4
"""Shift for slopes, in typical ranges of places and of velocities."""
WORTH = 0.05
"""Change of a variance below which coordinates are left as they are."""


def slopes_of(batch, field):
    """Slopes of a field of accelerations by place and velocity of each receiver.

    Parameters
    ----------
    batch : RegressionBatch
    field : callable
        ``field(batch) -> ndarray, shape (n, S, R, d)``.

    Returns
    -------
    ndarray, shape (2, n, S, R, d, d)
        By place and by velocity; the last axis is that of the shift.
    """
    receivers = batch.bodies.receivers
    n_dims = batch.target.shape[3]
    out = np.zeros((2, *batch.target.shape, n_dims))
    for k, name in enumerate(("positions", "velocities")):
        values = getattr(batch, name)
        step = STEP * (float(np.nanmax(np.abs(values - np.nanmean(values)))) or 1.0)
        for r, receiver in enumerate(receivers):
            for axis in range(n_dims):
                ends = []
                for sign in (1.0, -1.0):
                    shifted = np.array(values)
                    shifted[:, :, receiver, axis] += sign * step
                    ends.append(field(replace(batch, **{name: shifted}))[:, :, r])
                out[k, :, :, r, :, axis] = (ends[0] - ends[1]) / (2 * step)
    return np.nan_to_num(out, posinf=0.0, neginf=0.0)


def with_felt_noise(view, slopes, sigma):
    """The view with coordinates that are white where the noise of states is felt as well.

    Parameters
    ----------
    view : SmoothView
        Nothing taken out of it.
    slopes : list of ndarray
        Per group, of `slopes_of`; of all forces together.
    sigma : ndarray, shape (d,)
        Standard deviation of positions.

    Returns
    -------
    SmoothView
        The same one where next to nothing would change.
    """
    mixings = [_mixing(view, g, s, sigma) for g, s in zip(view.groups, slopes, strict=True)]
    if all(mixing is None for mixing in mixings):
        return view
    filled = [
        np.broadcast_to(np.eye(g.shape[2]), (*g.shape, g.shape[2])) if m is None else m
        for g, m in zip(view.groups, mixings, strict=True)
    ]
    return view.mixed(filled)


def linear_residual(observation, fit, along, scenes):
    """What a model leaves, to first order about tracks of a law nearer to the truth.

    With e the measured positions less the track, ``(D - A P - C V) e`` has the noise that
    `with_felt_noise` counts and nothing else where the nearer law is right; what that law has more
    than the model is added.

    Parameters
    ----------
    observation : Observation
    fit, along : Fit
        Of the model, and of the nearer law.
    scenes : sequence of Scene

    Returns
    -------
    regression : Regression
        With the tracks as states.
    residual : ndarray, shape (n,)
        Whitened.
    jacobian : ndarray, shape (n, k)
        Whitened columns of the model's constants.
    slopes : list of ndarray
        Of the nearer law along the tracks.

    Raises
    ------
    EvaluationError
        If a track ran away, or a law has no finite value along the tracks.
    """
    tracks = tracks_of(along.whole, observation.train)
    if any(scene.name not in tracks for scene in scenes):
        raise EvaluationError("a track ran away")
    leftover = Leftover(observation, along, use_tracks=True)
    regression = leftover.regression(scenes)
    residual, _ = leftover.residual(regression, along.law)
    jacobian = fit_constants(regression, fit.law).jacobian
    by_name = {scene.name: scene for scene in scenes}
    slopes, felt = [], []
    for batch in regression.batches:
        own = slopes_of(batch, lambda moved: regression.predict(moved, along.law))
        more = regression.predict(batch, along.law) - regression.predict(batch, fit.law)
        times = whole_times(batch, scenes)
        for s, name in enumerate(batch.scene_names):
            scene = by_name[name]
            error = np.zeros((len(times), *batch.target.shape[2:]))
            error[: len(scene.times)] = np.nan_to_num(
                scene.positions[:, scene.dynamic] - tracks[name][0]
            )
            _, place, speed = _stencils(times[:, s])
            for stencil, slope in zip((place, speed), own[:, :, s], strict=True):
                moved = np.einsum("nt,trd->nrd", stencil, error)
                more[:, s] -= np.einsum("nrde,nre->nrd", slope, moved)
        slopes.append(own)
        felt.append(batch.whiten(np.nan_to_num(more)).ravel())
    return regression, residual + np.concatenate(felt), jacobian, slopes


def whole_sizes(batch, scenes, sigma):
    """Errors of all points of the receivers as parts of sigma, (n + 2, S, R).

    None where no point quotes its own, or where they do not count in the regression.
    """
    by_name = {scene.name: scene for scene in scenes}
    own = [by_name[name] for name in batch.scene_names]
    is_one = batch.whitener is None or batch.whitener.ndim == 2
    if is_one or all(scene.sigma is None for scene in own):
        return None
    out = np.ones((len(batch.times) + 2, len(own), batch.target.shape[2]))
    for s, scene in enumerate(own):
        if scene.sigma is not None:
            sizes = sizes_of(scene.sigma[:, scene.dynamic], sigma)
            out[: len(sizes), s] = sizes
    return out


def whole_times(batch, scenes):
    """Times of the scenes of a batch with those of their first and last rows, (n + 2, S)."""
    by_name = {scene.name: scene.times for scene in scenes}
    out = np.full((len(batch.times) + 2, len(batch.scene_names)), np.nan)
    for s, name in enumerate(batch.scene_names):
        out[: len(by_name[name]), s] = by_name[name]
    return out


def _mixing(view, group, slopes, sigma):
    """Inverse Cholesky factors of the covariance of the coordinates, (S, R, D, D)."""
    batch = group.batch
    n_scenes, n_receivers, size = group.shape
    n, n_dims = len(batch.times), len(sigma)
    scale = np.where(np.isfinite(sigma), sigma, 0.0) * np.sqrt(view.level)
    identity = np.eye(n_dims)
    out = np.broadcast_to(np.eye(size), (n_scenes, n_receivers, size, size)).copy()
    changed = False
    for s in range(n_scenes):
        second, place, speed = _stencils(group.times[:, s])
        remembered = _remembered(group.times[:, s], view.memory)
        for r in range(n_receivers):
            a, c = slopes[:, :, s, r]  # (n, d, d) each
            felt = place[:, None, :, None] * a[:, :, None, :]
            felt = felt + speed[:, None, :, None] * c[:, :, None, :]
            if group.bend is not None:
                change = felt[2:] - 2 * felt[1:-1] + felt[:-2]
                felt[1:-1] += group.bend[1:-1, s, r, None, None, None] * change
            noise = second[:, None, :, None] * identity[None, :, None, :]
            noise = (noise - felt) * scale
            if group.sizes is not None:
                noise = noise * group.sizes[:, s, r, None]
            vectors = noise.reshape(n, n_dims, -1).transpose(0, 2, 1)  # (n, T d, d)
            felt = group.coordinates_of(vectors, s, r)
            if view.memory > 0:
                felt = felt.reshape(size, -1, n_dims)
                felt = np.tensordot(felt, remembered, axes=(1, 0)).reshape(size, -1)
            covariance = felt @ felt.T
            dead = np.diag(covariance) < 1e-12
            covariance[dead, dead] = 1.0
            if np.max(np.abs(covariance - np.eye(size))) > WORTH:
                changed = True
                out[s, r] = np.linalg.inv(_factor(covariance, felt.shape[1]))
    return out if changed else None


def _factor(covariance, n_summed):
    """Cholesky factor of sums of so many products, also where rounding left no positive matrix."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        rounding = 4 * len(covariance) * n_summed * np.finfo(float).eps  # relative to the diagonal
        return np.linalg.cholesky(covariance + np.diag(rounding * np.diag(covariance)))


def _remembered(times, memory):
    """Matrix that gives white noise its memory (T, T): a Cholesky factor of the correlations."""
    if not memory > 0:
        return None
    gaps = np.abs(times[:, None] - times)
    correlation = np.exp(-np.where(np.isfinite(gaps), gaps, np.inf) / memory)
    np.fill_diagonal(correlation, 1.0)
    return np.linalg.cholesky(correlation)


def _stencils(times):
    """Matrices (n, n + 2) of second differences, places and central velocities; nan gives 0."""
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    n = len(times) - 2
    rows = np.arange(n)
    second, place, speed = (np.zeros((n, n + 2)) for _ in range(3))
    second[rows, rows] = 2 / (before * (before + after))
    second[rows, rows + 2] = 2 / (after * (before + after))
    second[rows, rows + 1] = -second[rows, rows] - second[rows, rows + 2]
    place[rows, rows + 1] = 1.0
    speed[rows, rows] = -after / (before * (before + after))
    speed[rows, rows + 2] = before / (after * (before + after))
    speed[rows, rows + 1] = -speed[rows, rows] - speed[rows, rows + 2]
    return np.nan_to_num(second), place, np.nan_to_num(speed)
