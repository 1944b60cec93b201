"""Calibration: ranks of true values among posterior draws, and how often intervals cover.

Simulation-based calibration (Talts et al. 2018, arXiv:1804.06788): if data are drawn from the
prior predictive, ranks are uniform.
"""

from __future__ import annotations

import numpy as np


def rank_of(truth, draws, weights, *, rng):
    """Weighted rank of a true value among draws, uniform on (0, 1) if calibrated; ties at random.

    Parameters
    ----------
    truth : float
    draws, weights : ndarray, shape (S,)
    rng : numpy.random.Generator

    Returns
    -------
    float
    """
    n = len(draws)
    below = float(weights[draws < truth].sum())
    equal = float(weights[draws == truth].sum())
    rank = below + equal * rng.random()
    # The truth is one more draw: its own place is spread over the gap it sits in.
    return float((rank * n + rng.random()) / (n + 1))


def simultaneous_band(n, probability=0.99):
    """Half-width that an empirical distribution of n uniform numbers keeps within everywhere.

    The exact quantile of the Kolmogorov-Smirnov statistic.
    """
    from scipy.stats import kstwo

    return float(kstwo.ppf(probability, n))


def coverage(inside, groups):
    """Share of intervals that cover, and its standard error with members of a group dependent.

    Parameters
    ----------
    inside : sequence of bool
    groups : sequence
        Label of the data set of every interval.

    Returns
    -------
    share, error : float
    """
    inside = np.asarray(inside, dtype=float)
    _, index = np.unique(np.asarray(groups), return_inverse=True)
    counts = np.bincount(index)
    sums = np.bincount(index, weights=inside)
    share = inside.mean()
    residual = sums - share * counts
    n = len(counts)
    error = np.sqrt(np.square(residual).sum() * n / max(n - 1, 1)) / counts.sum()
    return float(share), float(max(error, 1e-12))
