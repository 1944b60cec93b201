"""Rows that are far off their neighbours, found before any law is fitted.

Fits begin without them. Where the noise is estimated its tails weigh them in the end; beside known
noise, which has no tails, they stay out, and that is told.
"""

from collections import defaultdict
from dataclasses import replace
from functools import lru_cache

import numpy as np

from bsp_gp.data.point_errors import are_smooth, gross_errors

EXACT = 1e-9
"""Noise below this part of the extent is numerical."""
RESOLUTION = 1e-7
"""Part of the extent by which neighbours of exact rows are taken to predict one."""
TOGETHER = 10_000
"""Rows of tracks that are looked at at once."""


def is_exact(scenes, sigma):
    """Whether the noise of scenes is numerical, as it is where nothing moves."""
    known = np.asarray(sigma, dtype=float)
    known = known[np.isfinite(known)]
    return not known.max(initial=0.0) > EXACT * _extent(scenes)


def _extent(scenes):
    return max(float(np.nanmax(s.positions) - np.nanmin(s.positions)) for s in scenes)


def without_outliers(scenes, sigma):
    """Scenes in which gross errors are not seen.

    Parameters
    ----------
    sigma : array-like, shape (d,), metres
        Standard deviation of a position; nan = an axis that is left out.

    Returns
    -------
    found : tuple of (str, str, float)
        What is not seen any more: body, scene, and when, s.
    """
    return _without_outliers(tuple(scenes), tuple(np.asarray(sigma, dtype=float).tolist()))


@lru_cache(maxsize=2)
def _without_outliers(scenes, sigma):
    """The same; every fit of a run asks it of the same scenes."""
    sigma = np.array(sigma)
    exact = is_exact(scenes, sigma)
    if exact:
        sigma = np.where(np.isfinite(sigma), RESOLUTION * _extent(scenes), sigma)
    out, found = [], []
    smooth = set() if exact else _smooth(scenes, sigma)
    for scene in scenes:
        positions = scene.positions.copy()
        for k in scene.dynamic:
            if (id(scene), k) in smooth:
                continue
            track = scene.times, scene.positions[:, k], sigma
            is_far = gross_errors(*track, is_exact=exact) > 1
            positions[is_far, k] = np.nan
            found += [(scene.names[k], scene.name, float(time)) for time in scene.times[is_far]]
        is_same = np.array_equal(positions, scene.positions, equal_nan=True)
        out.append(scene if is_same else replace(scene, positions=positions))
    return tuple(out), tuple(found)


def _smooth(scenes, sigma):
    """Tracks that surely have no gross error, as scenes' ids and numbers of bodies."""
    groups = defaultdict(list)
    for scene in scenes:
        groups[len(scene.times)] += [(scene, k) for k in scene.dynamic]
    out = set()
    for n_rows, tracks in groups.items():
        n_tracks = max(TOGETHER // max(n_rows, 1), 1)
        for first in range(0, len(tracks), n_tracks) if n_tracks > 1 else ():
            some = tracks[first : first + n_tracks]
            is_smooth = are_smooth(
                np.stack([scene.times for scene, _ in some]),
                np.stack([scene.positions[:, k] for scene, k in some]), sigma,
            )  # fmt: skip
            out |= {(id(some[at][0]), some[at][1]) for at in np.flatnonzero(is_smooth)}
    return out
