"""Velocities at which laws are evaluated in the weak form: local polynomials, by no law.

A finite difference of noisy positions over one step makes a velocity as noisy as can be; a law
that is not linear in it then has a bias that no integral removes. The width of the test
functions says on which time scale the acceleration varies above the noise, so that polynomials
over that reach lose nothing that is seen. With the narrowest test functions these are the plain
differences.
"""

from __future__ import annotations

import numpy as np

__all__ = ["local_velocities"]

CUBIC_FROM = 7
"""Rows from which a cubic is fitted in the place of a parabola."""


def local_velocities(times, positions, *, reach, limit, is_stepped=False):
    """Slopes of local polynomials through the positions of every body.

    Parameters
    ----------
    times : ndarray, shape (T,), s
        Padded with nan.
    positions : ndarray, shape (T, N, d), m
        nan = not seen.
    reach : float
        Half of the window, s; at least one row on either side is used.
    limit : float
        Longest step over which a polynomial goes, s (rows, if stepped).
    is_stepped : bool
        Backward velocities: those in the middle of the last step.

    Returns
    -------
    ndarray, shape (T, N, d), m/s
        nan where a body is not seen on both sides (stepped: in the row before).
    """
    out = np.full(positions.shape, np.nan)
    seen = np.isfinite(positions).all(axis=-1) & np.isfinite(times)[:, None]
    known = {}
    for body in range(positions.shape[1]):
        key = seen[:, body].tobytes()
        if key not in known:
            known[key] = _slopes(times, seen[:, body], reach, limit, is_stepped)
        rows, matrix = known[key]
        out[rows, body] = matrix @ np.nan_to_num(positions[:, body])
    return out


def _slopes(times, seen, reach, limit, is_stepped):
    """Rows with a slope, and the weights of all positions in it."""
    rows = np.flatnonzero(seen)
    clock = rows if is_stepped else times[rows]
    found, weights = [], []
    for part in np.split(rows, np.flatnonzero(np.diff(clock) > limit) + 1):
        t = times[part]
        for k in range(1, len(part) if is_stepped else len(part) - 1):
            at = (t[k] + t[k - 1]) / 2 if is_stepped else t[k]
            first = min(np.searchsorted(t, at - reach * (1 + 1e-9)), k - 1)
            least = k if is_stepped else k + 1
            last = max(np.searchsorted(t, at + reach * (1 + 1e-9)) - 1, least)
            row = np.zeros(len(times))
            row[part[first : last + 1]] = _slope(t[first : last + 1] - at)
            found.append(part[k])
            weights.append(row)
    return np.array(found, dtype=int), np.array(weights).reshape(len(found), len(times))


def _slope(offsets):
    """Weights of a slope at 0 by least squares."""
    degree = 3 if len(offsets) >= CUBIC_FROM else min(2, len(offsets) - 1)
    size = np.max(np.abs(offsets))
    powers = (offsets / size)[:, None] ** np.arange(degree + 1)
    return np.linalg.pinv(powers)[1] / size
