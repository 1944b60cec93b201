"""Smooth arcs of tracks, which slow forces leave in positions, and what is left beside them."""

from __future__ import annotations

import numpy as np

__all__ = ["orthonormal_rows", "polynomials", "scaled_rows"]


def polynomials(batch, noise, degree):
    """Polynomials of time in every coordinate of every track, whitened.

    Parameters
    ----------
    batch : Batch
    noise : TrackNoise
    degree : int

    Returns
    -------
    ndarray, shape (R d (degree + 1), S, T R d)
        By coordinate and degree, the degree running fastest.
    """
    time = np.nan_to_num(batch.times - np.nanmin(batch.times, axis=0))
    time = 2 * time / np.maximum(time.max(axis=0), 1e-300) - 1
    powers = np.moveaxis(np.polynomial.legendre.legvander(time, degree), -1, 0)
    n_scenes, n_receivers, n_dims = noise.seen.shape[1:]
    columns = np.zeros((n_receivers, n_dims, degree + 1, *noise.seen.shape))
    for r, axis in np.ndindex(n_receivers, n_dims):
        columns[r, axis, :, :, :, r, axis] = powers
    columns = noise.whiten(columns.reshape(-1, *noise.seen.shape))
    return np.moveaxis(columns, 2, 1).reshape(len(columns), n_scenes, -1)


def orthonormal_rows(rows):
    """Orthonormal basis of what rows (k, n) span, shape (m, n)."""
    rows = scaled_rows(rows)
    if not len(rows):
        return rows
    _, values, q = np.linalg.svd(rows, full_matrices=False)
    return q[values > 1e-10 * values[0]]


def scaled_rows(rows):
    """The rows that are not zero, at unit length; without those beyond all numbers."""
    with np.errstate(over="ignore", invalid="ignore"):  # of a law that runs away
        sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    known = np.isfinite(sizes[:, 0]) & (sizes[:, 0] > 0)
    return rows[known] / sizes[known]
