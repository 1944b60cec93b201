"""Sizes of the errors that single points quote, beside the typical one."""

import numpy as np


def relative_sizes(batch, sigma):
    """Errors of points as parts of the typical one, (T, S, N); None where no point quotes one."""
    return None if batch.sigma is None else sizes_of(batch.sigma, sigma)


def sizes_of(quoted, sigma):
    """Quoted errors (..., d) as parts of the typical ones (d,), axes averaged; 1 where none is."""
    with np.errstate(invalid="ignore"):
        ratio = np.where(quoted > 0, quoted / np.asarray(sigma), np.nan)
    known = np.isfinite(ratio)
    squares = np.where(known, np.square(np.where(known, ratio, 0.0)), 0.0).sum(axis=-1)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), 1.0)


