"""States at which laws are evaluated on noisy data: the fitted track plus its smoothed residual.

A law evaluated at measured positions feels their noise (errors in variables), which sums up in
generalised least squares to more than the noise itself. The fitted model takes up the bulk of
the motion, contacts included; what it leaves is small and smooth, so that smoothing *that* (a
Whittaker-Henderson smoother, its strength chosen by generalised cross-validation; Eilers 2003,
Anal. Chem. 75, 3631) removes the noise without rounding off anything.
"""

from __future__ import annotations

import numpy as np

__all__ = ["smooth", "states_of"]

STRENGTHS = 10.0 ** np.arange(-1.0, 9.1, 0.5)
MAX_FREEDOM = 0.35
"""Greatest number of effective parameters of the smoother, as a part of the rows."""


def states_of(whole, scenes):
    """Denoised states of the receivers of some scenes.

    Parameters
    ----------
    whole : RolloutFit
        A fit to these scenes, or to segments of them named ``scene[start:stop]``.
    scenes : sequence of Scene

    Returns
    -------
    dict of str to (ndarray, ndarray)
        Scene name -> positions and velocities, shape (T, R, d).
    """
    pieces = {}
    for batch, predicted in zip(whole.batches, whole.predicted, strict=True):
        for s, scene in enumerate(batch.scenes):
            n = len(scene.times)
            track = predicted[:n, s]
            left = scene.positions[:, scene.dynamic] - track
            if not np.isfinite(track).all():
                continue  # a rollout that ran away; the measured states are kept
            positions, velocities = _denoised(scene.times, track, left)
            pieces.setdefault(scene.name.partition("[")[0], []).append(
                (scene.times[0], positions, velocities)
            )
    out = {}
    for scene in scenes:
        parts = sorted(pieces.get(scene.name.partition("[")[0], []), key=lambda part: part[0])
        if sum(len(p) for _, p, _ in parts) == len(scene.times):
            out[scene.name] = (
                np.concatenate([p for _, p, _ in parts]),
                np.concatenate([v for _, _, v in parts]),
            )
    return out


def _denoised(times, track, left):
    from scipy.interpolate import make_interp_spline

    n = len(times)
    smoothed = smooth(times, left)
    degree = 5 if n > 5 else 3 if n > 3 else 1
    positions = track + smoothed
    return positions, make_interp_spline(times, positions, k=degree).derivative()(times)


def smooth(times, values):
    """Whittaker-Henderson smoother of every column, strength by generalised cross-validation.

    Parameters
    ----------
    times : ndarray, shape (T,)
    values : ndarray, shape (T, ...)
        nan = not seen.

    Returns
    -------
    ndarray, shape (T, ...)
    """
    values = np.asarray(values, dtype=float)
    n = len(times)
    flat = values.reshape(n, -1)
    if n < 6:
        return np.nan_to_num(values)
    step = np.diff(times) / np.mean(np.diff(times))
    first = np.diff(np.eye(n), axis=0) / step[:, None]
    # Divided differences, so that quadratics have no third one on uneven times either.
    second = np.diff(first, axis=0) / (step[1:] + step[:-1])[:, None] * 2
    third = np.diff(second, axis=0) / (step[2:] + step[1:-1] + step[:-2])[:, None] * 3
    roughness = third.T @ third
    eigenvalues, vectors = np.linalg.eigh(roughness)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    eigenvalues[:3] = 0.0  # straight and quadratic motion are not rough
    out = np.zeros_like(flat)
    for column in range(flat.shape[1]):
        seen = np.isfinite(flat[:, column])
        filled = np.where(seen, flat[:, column], _bridge(times, flat[:, column], seen))
        out[:, column] = _by_gcv(filled, eigenvalues, vectors)
    return out.reshape(values.shape)


def _bridge(times, column, seen):
    """Straight lines over gaps."""
    return np.interp(times, times[seen], column[seen]) if seen.any() else np.zeros(len(times))


def _by_gcv(values, eigenvalues, vectors):
    n = len(values)
    rotated = vectors.T @ values
    best, chosen = np.inf, None
    for strength in STRENGTHS:
        shrink = 1.0 / (1.0 + strength * eigenvalues)
        freedom = shrink.sum()
        if freedom > max(MAX_FREEDOM * n, 4.0):
            continue
        misfit = float(np.square((1 - shrink) * rotated).sum())
        score = n * misfit / (n - freedom) ** 2
        if score < best:
            best, chosen = score, shrink
    return vectors @ (chosen * rotated)
