"""Positions that are less sure than the others: gross outliers, and bodies that are seen worse.

Both are found before any law is fitted, so that no law can profit from what is left out. Such
points are kept, with an error of their own (`Scene.sigma`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import estimate_noise

__all__ = ["gross_errors", "with_point_errors"]

REACH = 5
"""Points before and after by which a point is predicted."""
FAR = 5.0
"""Deviations, in standard deviations of what is predicted from neighbours, of a gross error."""
MOST_GROSS = 0.2
"""Part of a track; where more points are off, the motion itself is rough."""
UNLIKE = 1.4
"""Ratio of a body's noise to that of all at which it is given its own."""
SURE = 4.0
"""And its distance from 1 in standard errors of the ratio."""


def with_point_errors(dataset, noise):
    """The data set with errors of single points where these differ from the common one.

    Parameters
    ----------
    dataset : Dataset
    noise : NoiseEstimate
        Of all bodies together.

    Returns
    -------
    dataset : Dataset
        The same object where nothing differs.
    notes : tuple of str
        What was found, for the report.
    """
    sigma = np.array(noise.sigma, dtype=float)
    own = _own_noise(dataset, noise) if noise.source == "estimated" else {}
    scenes, found = [], []
    for scene in dataset.scenes:
        size = np.broadcast_to(sigma, scene.positions.shape)
        if scene.sigma is not None:
            size = np.where(scene.sigma > 0, scene.sigma, size)
        size = np.array(size)
        changed = False
        for k in scene.dynamic:
            factor = own.get(scene.names[k], 1.0)
            size[:, k] *= factor
            off = gross_errors(scene.times, scene.positions[:, k], sigma * factor)
            far = off > 1
            # As far off as twice their own error: they hardly count.
            size[:, k] *= np.where(far, np.maximum(off / 2, 1.0), 1.0)[:, None]
            found += [(scene.name, scene.names[k], scene.times[row]) for row in np.flatnonzero(far)]
            changed |= factor != 1.0 or far.any()
        scenes.append(replace(scene, sigma=size) if changed else scene)
    notes = [f"{name} is seen with {factor:.2g} times the noise" for name, factor in own.items()]
    if found:
        listed = ", ".join(f"{name} of {scene} at t = {t:.4g}" for scene, name, t in found[:5])
        more = f" and {len(found) - 5} more" if len(found) > 5 else ""
        notes.append(f"far off their neighbours, and given little weight: {listed}{more}")
    if not notes:
        return dataset, ()
    return replace(dataset, scenes=tuple(scenes)), tuple(notes)


def _own_noise(dataset, noise):
    """Factor of every body whose noise is clearly unlike that of all."""
    names = dict.fromkeys(s.names[k] for s in dataset.scenes for k in s.dynamic)
    factors = {}
    for name in names if len(names) > 1 else ():
        alone = [_only(scene, name) for scene in dataset.scenes if name in scene.names]
        alone = [scene for scene in alone if len(scene.dynamic)]
        if sum(np.isfinite(s.positions[:, s.dynamic[0], 0]).sum() for s in alone) < 20:
            continue
        mine = estimate_noise(alone)
        ratios, counts = [], []
        for one, all_, n in zip(mine.sigma, noise.sigma, mine.n_effective, strict=True):
            if np.isfinite(one) and np.isfinite(all_) and np.isfinite(n) and n > 0:
                ratios.append(one / all_)
                counts.append(n)
        if not ratios:
            continue
        ratio = float(np.exp(np.mean(np.log(np.maximum(ratios, 1e-12)))))
        error = 1 / np.sqrt(2 * sum(counts))
        if max(ratio, 1 / ratio) > UNLIKE and abs(np.log(ratio)) > SURE * error:
            factors[name] = ratio
    return factors


def _only(scene, name):
    entities = tuple(replace(e, is_static=e.is_static or e.name != name) for e in scene.entities)
    return replace(scene, entities=entities)


def gross_errors(times, positions, sigma):
    """Deviation of gross errors from their neighbours, in sigma; 1 elsewhere.

    A point counts as a gross error if the two points before and the two after it, the five
    before it and the five after it all predict another place. Where a body is hit, one of the
    two sides still predicts it, and so a collision is no error. The first and the last five
    points are not judged.

    Parameters
    ----------
    times : ndarray, shape (T,)
    positions : ndarray, shape (T, d)
        nan where not seen.
    sigma : ndarray, shape (d,)

    Returns
    -------
    ndarray, shape (T,)
    """
    off = np.ones(len(times))
    axes = np.isfinite(sigma) & (sigma > 0)
    rows = np.flatnonzero(np.isfinite(positions[:, axes]).all(axis=1))
    if not axes.any() or len(rows) < 2 * REACH + 3:
        return off
    most = max(int(MOST_GROSS * len(rows)), 1)
    for _ in range(most + 1):
        size, far = _deviations(times[rows], positions[np.ix_(rows, axes)], sigma[axes])
        worst = int(np.argmax(far))
        if far[worst] <= FAR:
            return off
        off[rows[worst]] = max(size[worst], 1.0)
        rows = np.delete(rows, worst)
        if len(rows) < 2 * REACH + 3:
            break
    return np.ones(len(times))  # so many are off that the motion itself is rough


def _deviations(times, x, sigma):
    """Deviation from the neighbours, in sigma, and how many standard errors it is."""
    n = len(times)
    inner = np.arange(REACH, n - REACH)
    before, after = np.arange(-REACH, 0), np.arange(1, REACH + 1)
    sizes, fars = [], []
    for offsets, degree in ((np.array([-2, -1, 1, 2]), 3), (before, 2), (after, 2)):
        nodes = inner[:, None] + offsets
        weights = _predicting(times[nodes], times[inner], degree)
        gap = np.abs(x[inner] - np.einsum("nk,nkd->nd", weights, x[nodes])) / sigma
        z = gap / np.sqrt(1 + np.square(weights).sum(axis=1))[:, None]
        # The motion itself is no polynomial: what is usual on this track is no error.
        usual = np.maximum(1.4826 * np.median(z, axis=0), 1.0)
        sizes.append(gap.max(axis=1))
        fars.append((z / usual).max(axis=1))
    size, far = np.ones(n), np.zeros(n)
    size[inner] = sizes[0]
    far[inner] = np.min(fars, axis=0)
    return size, far


def _predicting(nodes, at, degree):
    """Weights of the least squares polynomial through nodes (n, k) at places (n,), (n, k)."""
    s = (nodes - at[:, None]) / np.ptp(nodes, axis=1)[:, None]
    return np.linalg.pinv(s[..., None] ** np.arange(degree + 1))[:, 0]
