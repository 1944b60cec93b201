"""States at which laws are evaluated on noisy data: the fitted track plus its smoothed residual.

A law evaluated at measured positions feels their noise (errors in variables), which sums up in
generalised least squares to more than the noise itself. The fitted model takes up the bulk of
the motion, contacts included; what it leaves is small and smooth, so that smoothing *that* (a
Whittaker-Henderson smoother, its strength chosen by generalised cross-validation; Eilers 2003,
Anal. Chem. 75, 3631) removes the noise without rounding off anything.
"""

from __future__ import annotations

import numpy as np

__all__ = ["smooth", "states_of", "tracks_of"]

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
        Scene name -> positions and velocities, shape (T, R, d). Scenes whose rollout ran away
        are missing: the measured states are kept there.
    """
    return _kept("_smoothed", whole, scenes, lambda times, left: smooth(times, left))


def tracks_of(whole, scenes):
    """The fitted tracks themselves, as `states_of` gives them."""
    return _kept("_unsmoothed", whole, scenes, lambda times, left: 0.0)


def _kept(name, whole, scenes, beside):
    """States by scene, kept with the fit: a search asks again for every noise that it tries."""
    kept = whole.__dict__.setdefault(name, {})
    key = tuple((scene.name, len(scene.times)) for scene in scenes)
    if key not in kept:
        kept[key] = _gathered(whole, scenes, beside)
    return kept[key]


def _gathered(whole, scenes, beside):
    """States by scene, its segments put together again; `beside` is added to the tracks."""
    pieces = {}
    for batch, predicted in zip(whole.batches, whole.predicted, strict=True):
        for s, scene in enumerate(batch.scenes):
            track = predicted[: len(scene.times), s]
            if np.isfinite(track).all():
                left = scene.positions[:, scene.dynamic] - track
                positions = track + beside(scene.times, left)
                name = scene.name.partition("[")[0]
                pieces.setdefault(name, []).append((scene.times, positions))
    out = {}
    for scene in scenes:
        parts = sorted(pieces.get(scene.name.partition("[")[0], []), key=lambda part: part[0][0])
        if sum(len(times) for times, _ in parts) == len(scene.times):
            out[scene.name] = (
                np.concatenate([p for _, p in parts]),
                np.concatenate([_velocities(times, p) for times, p in parts]),
            )
    return out


def _velocities(times, positions):
    from scipy.interpolate import make_interp_spline

    degree = 5 if len(times) > 5 else 3 if len(times) > 3 else 1
    return make_interp_spline(times, positions, k=degree).derivative()(times)


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
