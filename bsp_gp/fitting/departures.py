"""Where a track departs at its ends from the motion that it shows between, whatever moves the body.

Between, the acceleration of a body goes on as it is, and drifts: it is a Wiener process whose
strength the track tells, and places are that integrated twice (a Kalman filter of place, velocity
and acceleration). A row that is apart goes on from the two beside it, straight up to errors as
large as such rows have. Of all rows at an end as many are apart as makes all rows likeliest.
"""

import math

import numpy as np

from bsp_gp.compiling import compiled

STRENGTHS = np.logspace(-4, 8, 37)
"""Of the drift, in units of the noise and of the step between rows."""
MOST_APART, LEAST_BETWEEN = 1 / 2, 8
"""Part of a track that may be apart at one end, and rows that are not, of three quarters of it."""
LIKELIER = 10.0
"""Nats by which rows at an end must be likelier apart."""


def departures(times, places, levels):
    """How many rows at the beginning and at the end of a track are apart.

    Parameters
    ----------
    times : ndarray, shape (T,), s
    places : ndarray, shape (T, a), m
        All seen.
    levels : ndarray, shape (a,), m
        Standard deviations of the noise.
    """
    n = len(times)
    most = min(int(MOST_APART * n), n - n // 4 - LEAST_BETWEEN)
    if most < 1:
        return [0, 0]
    t, x = (times - times[0]) / np.median(np.diff(times)), (places - places.mean(axis=0)) / levels
    # From the middle outwards: each end is asked of three quarters of the track.
    ends = [(-t[: n - n // 4][::-1], x[: n - n // 4][::-1]), (t[n // 4 :], x[n // 4 :])]
    apart = [_apart(*end, most) for end in ends]
    best, found = -math.inf, [0, 0]
    for strength in STRENGTHS:
        own = [_split(*end, more, strength) for end, more in zip(ends, apart, strict=True)]
        total = sum(height for height, *_ in own)
        if total > best:
            best, found = total, [rows if gain > LIKELIER else 0 for _, gain, rows in own]
    return found


def going_on(times, places):
    """By how much rows at the beginning fail to go on straight from the two beside them.

    Root mean square of the first one, of the first two, ... along all axes, (T - 2,).
    """
    steps = np.diff(times)
    early, late = np.diff(places, axis=0)[:-1], np.diff(places, axis=0)[1:]
    left = np.square(early - late * (steps[:-1] / steps[1:])[:, None]).sum(axis=1)
    return np.sqrt(np.cumsum(left) / (np.arange(1, len(left) + 1) * places.shape[1]))


def _apart(times, places, most):
    """Log-density of as many rows at the end of a track as are apart, one to `most`, (most,)."""
    sizes = np.maximum(going_on(-times[::-1], places[::-1])[:most], 1.0)
    counts = places.shape[1] * np.arange(1, most + 1)
    dense = -counts * (np.log(sizes) + 0.5 * (math.log(2 * math.pi) + 1))
    return dense - 0.5 * np.log(counts) - math.log(most)


def _split(times, places, apart, strength):
    """Log-likelihood of a track of which rows at the end are apart, what that gains, and rows."""
    along = np.cumsum(_heights(times, places, strength))
    n, most = len(along), len(apart)
    totals = np.concatenate([along[-1:], along[n - 1 - most : n - 1][::-1] + apart])
    rows = int(np.argmax(totals))
    return float(totals[rows]), float(totals[rows] - totals[0]), rows


@compiled
def _heights(times, places, strength):
    """Log-densities of rows, each as those before it foresee it, (T,).

    Number by number: matrices would take seconds to compile where the package is new.
    """
    n, n_axes = places.shape
    out = np.zeros(n)
    place, speed, pull = np.zeros(n_axes), np.zeros(n_axes), np.zeros(n_axes)
    xx, xv, xa, vv, va, aa = 1e12, 0.0, 0.0, 1e8, 0.0, 1e4  # covariances of these
    for k in range(n):
        if k:
            h = times[k] - times[k - 1]
            half = h * h / 2
            place += h * speed + half * pull
            speed += h * pull
            ox, ov, oa = xx + h * xv + half * xa, xv + h * vv + half * va, xa + h * va + half * aa
            xx = ox + h * ov + half * oa + strength * h**5 / 20
            xv = ov + h * oa + strength * h**4 / 8
            xa = oa + strength * h**3 / 6
            vv = vv + 2 * h * va + h * h * aa + strength * h**3 / 3
            va = va + h * aa + strength * half
            aa = aa + strength * h
        size = xx + 1.0
        for c in range(n_axes):
            left = places[k, c] - place[c]
            out[k] -= 0.5 * (left * left / size + math.log(2 * math.pi * size))
            place[c] += xx / size * left
            speed[c] += xv / size * left
            pull[c] += xa / size * left
        vv, va, aa = vv - xv * xv / size, va - xv * xa / size, aa - xa * xa / size
        xx, xv, xa = xx / size, xv / size, xa / size
    return out
