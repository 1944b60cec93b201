"""The maximum of a smooth function of a few numbers that is expensive, with a cheap likeness of it.

The likeness gives the start and the curvature, the function itself the slopes: a few Newton steps
where a search from anew would take fifty evaluations.
"""

import math

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import minimize

_STEP = 1e-6
"""Of slopes; the numbers are logarithms, of which half of it is far below their errors."""
_STEP_OF_CURVATURE = 1e-3
_HUGE = 1e100
_SMALL_GAIN = 1e-4
_N_NEWTON = 12
_NEAR, _LONGEST = 0.3, 1.0
"""Longest steps: from a start that should be the maximum, and at all."""


def maximise(function, start, bounds, likeness=None):
    """Maximise a function of a few numbers of unit size: where that is, (k,), and what it reaches.

    Parameters
    ----------
    function : callable
        Of an array (k,); -inf where it cannot be computed.
    start : array-like, shape (k,)
    bounds : sequence of (low, high)
    likeness : callable, optional
        A cheaper function that differs from `function` by less than it varies.
    """
    low, high = np.array(bounds, dtype=float).T
    start = np.clip(start, low, high)
    if likeness is None:
        found = _newton(function, function, start, low, high)
    else:
        found = _newton(function, likeness, start, low, high, is_near=True)
        if found is None:
            near = _climb(likeness, start, bounds)[0]
            found = _newton(function, likeness, near, low, high)
    if found is not None:
        return found
    return _climb(function, start, bounds)


def _slope(function, values, high):
    """Value and slope, by differences that stay within bounds."""
    at = function(values)
    steps = np.where(values + _STEP > high, -_STEP, _STEP)
    moved = [function(values + step) for step in np.diag(steps)]
    with np.errstate(invalid="ignore"):
        return at, (np.array(moved) - at) / steps


def _climb(function, start, bounds):
    """By L-BFGS-B, from the start."""
    high = np.array(bounds)[:, 1]

    def loss(values):
        at, slope = _slope(function, values, high)
        if not math.isfinite(at) or not np.all(np.isfinite(slope)):
            return _HUGE, np.zeros_like(values)
        return -at, -slope

    options = {"maxiter": 60, "ftol": 1e-10, "gtol": 1e-3}
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return found.x, -float(found.fun)


def _curvature(function, values, low, high):
    """Negative second derivatives, or None where they are not finite."""
    step = _STEP_OF_CURVATURE
    at = np.clip(values, low + step, high - step)
    shifts = step * np.eye(len(at))
    middle = function(at)
    up = np.array([function(at + s) for s in shifts])
    down = np.array([function(at - s) for s in shifts])
    second = np.diag(up + down - 2.0 * middle)
    for i in range(len(at)):
        for j in range(i):
            both = function(at + shifts[i] + shifts[j])
            second[i, j] = second[j, i] = both - up[i] - up[j] + middle
    return -second / step**2 if np.all(np.isfinite(second)) else None


def _newton(function, likeness, values, low, high, is_near=False):
    """Newton steps with the curvature of a likeness, mended on the way; None where they fail."""
    curvature = _curvature(likeness, values, low, high)
    if curvature is None:
        return None
    at, slope = _slope(function, values, high)
    for _ in range(_N_NEWTON):
        if not math.isfinite(at) or not np.all(np.isfinite(slope)):
            return None
        free = ~((values >= high) & (slope > 0)) & ~((values <= low) & (slope < 0))
        step = np.zeros_like(values)
        try:  # along a bound that holds a number it may be bent in any way
            lower = np.linalg.cholesky(curvature[np.ix_(free, free)])
        except np.linalg.LinAlgError:
            return None
        step[free] = cho_solve((lower, True), slope[free])
        if 0.5 * float(slope @ step) < _SMALL_GAIN:
            return values, at
        length = float(np.abs(step).max())
        if is_near and length > _NEAR:
            return None
        step *= min(1.0, _LONGEST / length)
        before, slope_before, here = at, slope, values
        values = np.clip(values + step, low, high)
        at, slope = _slope(function, values, high)
        if at < before:
            return None
        curvature = _mended(curvature, values - here, slope_before - slope)
    return None


def _mended(curvature, step, change):
    """The curvature that agrees with how the slope changed along a step (BFGS)."""
    along, bent = float(change @ step), curvature @ step
    if not along > 0:
        return curvature
    return curvature + np.outer(change, change) / along - np.outer(bent, bent) / float(step @ bent)
