"""How far into an experiment laws foresee where bodies are.

After a close pass what is unknown of a constant leads to anywhere: laws seem far apart there, and
no law is fitted to such rows. Rows are measured against the way to the next body.
"""

import numpy as np

CALM = 0.4
"""Part of the distance to the next body within which forces may have led a body off."""
REACH = 10.0
"""Times that what is foreseen may be off by more than the draws show."""


def n_calm(departure, near):
    """Leading rows in which forces have not yet led any body far off.

    Parameters
    ----------
    departure : ndarray, shape (T,), m
        How far they have.
    near : ndarray, shape (T,), m
        From `nearest`.
    """
    return _n_leading(departure < CALM * near)


def n_foreseen(track, near):
    """Leading rows up to which a law foresees places, its constants as they may be.

    Parameters
    ----------
    track : ndarray, shape (D, T, R, d), m
        Moving bodies under draws of the constants, the best first.
    near : ndarray, shape (T,), m
    """
    spread = np.linalg.norm(track[1:] - track[0], axis=-1).max(axis=(0, 2), initial=0.0)
    return _n_leading(REACH * np.nan_to_num(spread, nan=np.inf) < CALM * near)


def nearest(positions, moving):
    """How near any moving body has been to another one, m, shape (T,); inf where there is none.

    Parameters
    ----------
    positions : ndarray, shape (T, N, d), m
    moving : sequence of int
    """
    moving = list(moving)
    gaps = np.linalg.norm(positions[:, moving, None] - positions[:, None], axis=-1)
    gaps[:, np.arange(len(moving)), moving] = np.inf
    return np.minimum.accumulate(np.fmin.reduce(gaps.reshape(len(gaps), -1), axis=1))


def _n_leading(flags):
    return len(flags) if flags.all() else int(np.argmin(flags))
