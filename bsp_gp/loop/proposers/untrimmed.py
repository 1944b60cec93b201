"""Recordings that begin before a body is let go, or go on after it has landed or is gone.

Rows that stand still at the beginning, and rows behind a break, show something else than the
motion. Each alone may gain little, since the others still bend the fit: of every body both ends are
left out at once, and of all scenes together.
"""

from itertools import product

import numpy as np

from bsp_gp.fitting.rests import in_levels, still_rows
from bsp_gp.loop.proposers.stuck import are_broken

LEAST_STILL = 3
"""Rows that stand still before a body is let go, at least."""
AROUND = 2
"""Rows about the last of these, one of which may be the last before the motion."""
MOST_STILL, LEAST_KEPT = 0.75, 5
"""Part of a track that may stand still before the motion, and rows that are left of it."""
MOST_LOOKED_AT, MOST_BREAKS = 64, 12
"""Rows at which a track bends most, and breaks among them behind which all may be left out."""
LEFT_MUCH = 1.5
"""Chi-squared of a chain, for each degree of freedom, from which on it is asked."""


def is_open(chain):
    """Whether the law leaves so much of a chain of `defects` that its ends are asked."""
    square = float(np.square(chain.targets[0]).sum())
    return square > LEFT_MUCH * max(int(chain.seen.sum()) - len(chain.local), 1)


def ends_of(scene, name, levels):
    """First rows and rows behind the last of the parts of a track that may be the motion.

    Parameters
    ----------
    levels : ndarray, shape (d,), metres
        Of the noise; nan = an axis along which nothing moves.

    Returns
    -------
    heads, tails : ndarray of int, shape (K,)
        The whole track is none of them.
    """
    pairs = np.array(list(product(_heads(scene, name, levels), _tails(scene, name))))
    heads, tails = pairs.T
    kept = (tails - heads >= LEAST_KEPT) & ((heads > 0) | (tails < len(scene.times)))
    return heads[kept], tails[kept]


def _heads(scene, name, levels):
    """Rows with which the motion may begin, the first among them."""
    places, seen = in_levels(scene, scene.names.index(name), levels)
    n = still_rows(places[seen])
    if not LEAST_STILL <= n <= MOST_STILL * len(seen):
        return [0]
    near = range(max(n - AROUND, 1), min(n + AROUND, len(seen)))
    return [0, *(int(seen[k]) for k in near)]


def _tails(scene, name):
    """Rows from which on all may be left out, and the end."""
    places = scene.positions[:, scene.names.index(name)]
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    bend = np.square(np.diff(places[seen], 2, axis=0)).sum(axis=1)
    near = np.argsort(-bend)[:MOST_LOOKED_AT]
    if not len(near):
        return [len(scene.times)]
    rows = np.unique(np.concatenate([seen[near + k] for k in range(3)]))
    broken = rows[are_broken(scene, name, rows)].tolist()
    strength = {row: bend[max(np.searchsorted(seen, row) - 2, 0) :][:2].max() for row in broken}
    broken.sort(key=lambda row: -strength[row])
    return [len(scene.times), *broken[:MOST_BREAKS]]
