"""Recordings that begin before a body is let go, or go on after it has landed or is gone.

Rows that stand still at the beginning, and rows behind a break, show something else than the
motion. Each alone may gain little, since the others still bend the fit: of every body both ends are
left out at once, and of all scenes together.
"""

import numpy as np

from bsp_gp.fitting.parts.defects import LeftOut
from bsp_gp.loop.proposers.stuck import is_broken, still_rows

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
DETERMINED = 1e-7
"""Least eigenvalue of what the rows that are left say of first states, in that of all rows."""


def untrimmed(chains, levels):
    """Ends of tracks that pay for being left out together.

    Parameters
    ----------
    chains : sequence of _Chain
        Of `defects`.
    levels : ndarray, shape (d,), metres
        Of the noise; nan = an axis along which nothing moves.

    Returns
    -------
    parts : list of LeftOut
    gain : float
        Of chi-squared, less what the rows cost.
    n_tried : int
    """
    parts, total, n_tried = [], 0.0, 0
    for chain in chains:
        square = float(np.square(chain.targets[0]).sum())
        if square <= LEFT_MUCH * max(int(chain.seen.sum()) - len(chain.local), 1):
            continue
        for name in np.unique(chain.names):
            paid, own, n = _best_ends(chain, name, levels)
            n_tried += n
            if paid > 0:
                parts, total = [*parts, *own], total + paid
    return parts, total, n_tried


def _best_ends(chain, name, levels):
    """What the best head and tail of a body pay, the parts, and how many pairs were tried."""
    scene, used = chain.scene, chain.names == name
    n, best = len(scene.times), (0.0, ())
    heads, tails = _heads(scene, name, levels), _tails(scene, name)
    for head in heads:
        for tail in tails:
            rows = np.arange(len(chain.seen))
            is_out = (rows < head) | (rows >= tail)
            if not is_out.any() or tail - head < LEAST_KEPT:
                continue
            paid, counts = _paid(chain, used, is_out, head)
            if paid > best[0]:
                ends = ((0, head, counts[0]), (tail, n, counts[1]))
                best = paid, [(a, b, count) for a, b, count in ends if b > a]
    parts = [
        LeftOut(scene.name, a, b, str(name), n_left_out=count, extent=chain.extent)
        for a, b, count in best[1]
    ]
    return best[0], parts, len(heads) * len(tails)


def _heads(scene, name, levels):
    """Rows with which the motion may begin, the first among them."""
    places = scene.positions[:, scene.names.index(name)][:, np.isfinite(levels)]
    places = places / np.maximum(levels[np.isfinite(levels)], np.finfo(float).tiny)
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
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
    rows = np.unique(np.concatenate([seen[near + k] for k in range(3)])) if len(near) else []
    broken = [int(row) for row in rows if is_broken(scene, name, row)]
    strength = {row: bend[max(np.searchsorted(seen, row) - 2, 0) :][:2].max() for row in broken}
    broken.sort(key=lambda row: -strength[row])
    return [len(scene.times), *broken[:MOST_BREAKS]]


def _paid(chain, used, is_out, head):
    """Fall of chi-squared without some rows, less their price; numbers left out at either end."""
    own, seen = chain.local[:, is_out][:, :, used], chain.seen[is_out][:, used]
    rest = chain.targets[0][is_out][:, used]
    taken = np.einsum("itu,jtu->ij", own, own)
    left = np.eye(len(own)) - taken
    if np.linalg.eigvalsh(left)[0] <= DETERMINED:
        return -np.inf, (0, 0)
    along = np.einsum("itu,tu->i", own, rest)
    gain = float(np.square(rest).sum() + along @ np.linalg.solve(left, along))
    spread = chain.spread[is_out][:, used]
    price = float(np.log(chain.extent / spread[seen]).sum() - 0.5 * np.log(2 * np.pi) * seen.sum())
    first = int(chain.seen[:head][:, used].sum())
    return gain - 2 * price, (first, int(seen.sum()) - first)
