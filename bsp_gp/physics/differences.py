"""Divided differences on any grid, and the covariance that they give to white noise."""

import numpy as np

from bsp_gp.errors import DataError

DENSE_LIMIT = 1500
"""Longest track (rows) whose whitening matrix is kept dense."""


MOST_NUMBERS = 4e7
"""Largest size of all whitening matrices together, numbers, at which single points count."""


def difference_weights(offsets, order):
    """Weights of a derivative at 0 by values at offsets (Fornberg 1988, Math. Comp. 51, 699)."""
    # Scaled to unit spacing, so that the powers stay near one.
    width = np.max(np.abs(offsets))
    x = np.asarray(offsets, dtype=float) / width
    n = len(x)
    weights = np.zeros((n, order + 1))
    weights[0, 0] = 1.0
    c1, c4 = 1.0, x[0]
    for i in range(1, n):
        top = min(i, order)
        c2, c5, c4 = 1.0, c4, x[i]
        for j in range(i):
            c3 = x[i] - x[j]
            c2 *= c3
            if j == i - 1:
                for k in range(top, 0, -1):
                    weights[i, k] = c1 * (k * weights[i - 1, k - 1] - c5 * weights[i - 1, k]) / c2
                weights[i, 0] = -c1 * c5 * weights[i - 1, 0] / c2
            for k in range(top, 0, -1):
                weights[j, k] = (c4 * weights[j, k] - k * weights[j, k - 1]) / c3
            weights[j, 0] = c4 * weights[j, 0] / c3
        c1 = c2
    return weights[:, order] / width**order


def difference_matrix(times):
    """Rows of the second difference of positions, shape (T - 2, T), for one grid of times."""
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    n = len(times) - 2
    matrix = np.zeros((n, n + 2))
    rows = np.arange(n)
    matrix[rows, rows] = 2 / (before * (before + after))
    matrix[rows, rows + 2] = 2 / (after * (before + after))
    matrix[rows, rows + 1] = -matrix[rows, rows] - matrix[rows, rows + 2]
    return matrix


def too_many(n_times, n_tracks):
    """Whether errors of single points of so many like tracks cannot all be heeded."""
    return n_tracks * n_times**2 > MOST_NUMBERS


def gls_whitener(times, valid, sizes=None, memory=0.0):
    """Inverse Cholesky factors of the covariance of second differences, per unit sigma.

    `sizes` (T, S, R) are the errors of the points as parts of sigma.
    """
    n_times, n_scenes = times.shape
    rows_valid = valid.any(axis=-1)  # (n, S, R)
    same_grid = np.all(times == times[:, :1])
    if same_grid and sizes is None and rows_valid.all():
        return _whitening_block(times[:, 0], rows_valid[:, 0, 0], None, memory)
    if n_times > DENSE_LIMIT:
        raise DataError(
            f"tracks of {n_times} rows with gaps, differing times or errors of single points are "
            "too long for the exact covariance; split them into scenes of at most 1500 rows"
        )
    if sizes is not None and too_many(n_times, n_scenes * valid.shape[2]):
        # One error for all then, or memory would run out; fits to whole tracks heed them still.
        return gls_whitener(times, valid, None, memory)
    blocks = np.zeros((n_scenes, valid.shape[2], n_times - 2, n_times - 2))
    for s in range(n_scenes):
        for r in range(valid.shape[2]):
            size = None if sizes is None else sizes[:, s, r]
            blocks[s, r] = _whitening_block(times[:, s], rows_valid[:, s, r], size, memory)
    return blocks


def _whitening_block(times, rows, size, memory):
    from scipy.linalg import solve_triangular

    n = len(times) - 2
    block = np.zeros((n, n))
    if not rows.any():
        return block
    matrix = np.nan_to_num(difference_matrix(times))[rows]
    if size is not None:
        matrix = matrix * size
    covariance = matrix @ matrix.T
    if memory > 0:
        gaps = np.nan_to_num(np.abs(times[:, None] - times))
        covariance = matrix @ np.exp(-gaps / memory) @ matrix.T
    factor = np.linalg.cholesky(covariance)
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
    block[np.ix_(rows, rows)] = inverse
    return block
