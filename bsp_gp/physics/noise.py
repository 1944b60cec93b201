"""Sizes of the errors that single points quote, beside the typical one."""

import numpy as np


def relative_sizes(batch, sigma):
    """Size of the error of every point as a part of the typical one, shape (T, S, N).

    Returns
    -------
    ndarray or None
        None where no point quotes its own.
    """
    return None if batch.sigma is None else sizes_of(batch.sigma, sigma)


def sizes_of(quoted, sigma):
    """Quoted errors (..., d) as parts of the typical ones (d,), axes averaged; 1 where none is."""
    with np.errstate(invalid="ignore"):
        ratio = np.where(quoted > 0, quoted / np.asarray(sigma), np.nan)
    known = np.isfinite(ratio)
    squares = np.where(known, np.square(np.where(known, ratio, 0.0)), 0.0).sum(axis=-1)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), 1.0)


