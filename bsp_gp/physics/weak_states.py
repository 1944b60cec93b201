"""States at which laws are evaluated in the weak form: the spline that its test functions see.

The test functions of one width see of a track what its least squares spline has (see
`weak_tracks`). Evaluating laws at this spline makes both sides of the equation of motion speak of
one motion. Evaluated at finite differences of noisy positions, a law that depends on velocity
would feel their noise, which integrals sum up to more than the noise of the positions itself.
"""

import numpy as np

from bsp_gp.physics.weak_tracks import DEGREE, design, knots_of

LEAST_ROWS_PER_SPLINE = 2.0
"""With fewer rows a spline follows the noise, and its slope at the ends is worse than a step."""


def states_of(times, positions, sigma, *, spacing, limit, is_stepped=False):
    """Positions and velocities of every body of a scene, (T, N, d) each.

    Velocities are nan where a body is not seen on both sides (stepped: in the row before).

    Parameters
    ----------
    times : ndarray, shape (T,), s
        Padded with nan.
    positions : ndarray, shape (T, N, d), m
        nan = not seen.
    sigma : ndarray, shape (T, N, d), m
        nan or 0 counts as 1.
    spacing : float
        Between knots, s. Where that is less than two rows, states are the measured positions and
        their differences.
    limit : float
        Longest step that a spline bridges, s (rows, if stepped).
    is_stepped : bool
        Backward velocities, of the step before a row.
    """
    places, velocities = np.array(positions), np.full(positions.shape, np.nan)
    seen = np.isfinite(positions).all(axis=-1) & np.isfinite(times)[:, None]
    weights = 1 / np.where(sigma > 0, sigma, 1.0)
    for body in range(positions.shape[1]):
        rows = np.flatnonzero(seen[:, body])
        clock = rows if is_stepped else times[rows]
        for part in np.split(rows, np.flatnonzero(np.diff(clock) > limit) + 1):
            if len(part) < 2:
                continue
            x, v = _states(
                times[part], positions[part, body], weights[part, body], spacing, is_stepped
            )
            places[part, body], velocities[part, body] = x, v
    return places, velocities


def _states(times, x, weights, spacing, is_stepped):
    """States of one body over rows in succession."""
    from scipy.interpolate import BSpline

    slopes = np.full(x.shape, np.nan)
    knots = knots_of(times, spacing) if spacing else np.zeros(0)
    n_splines = len(knots) - DEGREE - 1
    is_fitted = spacing and len(times) >= LEAST_ROWS_PER_SPLINE * n_splines
    if is_fitted:
        x = np.array(x)
        splines = design(times, knots)
        for axis in range(x.shape[1]):
            w = weights[:, axis]
            middle = x[:, axis].mean()
            fit, *_ = np.linalg.lstsq(splines * w[:, None], (x[:, axis] - middle) * w, rcond=1e-12)
            x[:, axis] = middle + splines @ fit
            slopes[:, axis] = BSpline(knots, fit, DEGREE).derivative()(times)
    steps = np.diff(times)[:, None]
    backward = np.diff(x, axis=0) / steps
    if is_stepped:
        slopes[1:] = backward
        slopes[0] = np.nan
    elif not is_fitted and len(times) > 2:
        before, after = steps[:-1], steps[1:]
        slopes[1:-1] = (before * backward[1:] + after * backward[:-1]) / (before + after)
    return x, slopes
