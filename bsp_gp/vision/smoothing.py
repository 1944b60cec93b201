"""Kalman filter and Rauch-Tung-Striebel smoother for tracks; covariances checked on the data.

State: position and velocity; the velocity does a random walk (a white force of power q). The
measurement covariance of a tracker is right in shape (which direction is unsure, which frame is
worse) but not always in size, since neighbouring pixels err together. Its factor comes from the
track's own third differences, q from the likelihood of the innovations (Harvey 1989, ch. 3).
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

FLOOR = 4e-6  # px²: least variance of a measured coordinate (8-bit pixels)
LOSSY_FLOOR = 2.25e-4  # px²: what block compression leaves at best, from renders (0.015 px)
LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e4
CUT = 0.5
LONGEST = 600  # frames that tell the power of the force


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Smoothed positions and velocities with covariances.

    Attributes
    ----------
    positions, velocities : ndarray, shape (T, 2)
        px, px/frame. In a gap they are the smoother's bridge, with a covariance to match; whoever
        wants gaps marked looks at the measured track.
    covariances : ndarray, shape (T, 2, 2)
    q : float
        Power of the white force, px²/frame³.
    """

    positions: np.ndarray
    velocities: np.ndarray
    covariances: np.ndarray
    q: float


STEP = np.kron(np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(2))


def _filter(z, r, q, keep=False):
    """Kalman filter from a diffuse start: log likelihood, and the passes if `keep`."""
    start = int(np.flatnonzero(np.isfinite(z[:, 0]))[0])
    x = np.concatenate([z[start], np.zeros(2)])
    p = np.diag([1e4, 1e4, 1e4, 1e4])
    noise = np.kron(q * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]), np.eye(2))
    value, seen = 0.0, 0
    passes = []
    for k in range(len(z)):
        if k:
            x, p = STEP @ x, STEP @ p @ STEP.T + noise
        before = (x, p)
        if np.isfinite(z[k, 0]):
            s = p[:2, :2] + r[k]
            inverse = np.linalg.inv(s)
            e = z[k] - x[:2]
            gain = p[:, :2] @ inverse
            x, p = x + gain @ e, p - gain @ p[:2]
            p = 0.5 * (p + p.T)
            seen += 1
            if seen > 2:  # the first two only start the velocity
                value -= 0.5 * (e @ inverse @ e + np.log(np.linalg.det(s)))
        if keep:
            passes.append((before, (x, p)))
    return value, passes


def _regular(covariances):
    """Measurement covariances with a floor, positive definite."""
    r = np.where(np.isfinite(covariances), covariances, 1.0)
    return r + FLOOR * np.eye(2)


def measurement_factor(z, covariances):
    """Factor of the measurement covariance, from third differences of the positions.

    Third differences (1, -3, 3, -1) vanish for uniform acceleration; what is left is measurement
    error, of variance 20 times its own, except at the few bounces: the larger half is left
    out, and the mean of the rest is compared with that of a chi-squared variable cut likewise.

    Parameters
    ----------
    z : ndarray, shape (..., T, 2)
        Measured positions, nan in gaps.
    covariances : ndarray, shape (..., T, 2, 2)

    Returns
    -------
    float
        1 if fewer than 12 differences are known.
    """
    limit = chi2.ppf(1 - CUT, 1)
    expected_mean = chi2.cdf(limit, 3) / (1 - CUT)
    ratio = _third_differences(z, _regular(covariances))
    if len(ratio) < 12:
        return 1.0
    kept = np.sort(ratio)[: int(np.ceil((1 - CUT) * len(ratio)))]
    return float(np.clip(kept.mean() / expected_mean, LEAST_FACTOR, MOST_FACTOR))


def _third_differences(z, covariances):
    """Squared third differences over the variance they should have, finite ones, shape (k,)."""
    weights = np.array([1.0, -3.0, 3.0, -1.0])
    variances = np.einsum("...tii->...ti", covariances)
    n = z.shape[-2] - 3
    if n < 1:
        return np.zeros(0)
    third = sum(w * z[..., k : n + k, :] for k, w in enumerate(weights))
    expected = sum(w**2 * variances[..., k : n + k, :] for k, w in enumerate(weights))
    return (third**2 / expected)[np.isfinite(third)]


def _process_power(z, covariances):
    """Power q of the white force that makes the innovations most likely (maximum likelihood)."""
    if np.isfinite(z[:, 0]).sum() < 8:
        return 1.0
    z, r = z[:LONGEST], _regular(covariances)[:LONGEST]
    fit = minimize_scalar(
        lambda p: -_filter(z, r, np.exp(p))[0], bounds=(-16.0, 8.0), method="bounded"
    )
    return float(np.exp(fit.x))


def calibrated(track):
    """The track with its covariances rescaled by `measurement_factor`.

    Errors of lossy compression last for several frames and hide from differences in time: there
    the factor may widen the tracker's own covariance, never narrow it.
    """
    z = np.moveaxis(track.positions, 1, 0)
    regular = np.moveaxis(_regular(track.covariances), 1, 0)
    covariances = track.covariances.copy()
    kinds = [track.kinds.get(name, "") for name in track.names]
    for kind in set(kinds):
        # Objects of one kind share the factor: one that bounces all the time says little.
        mine = [k for k, other in enumerate(kinds) if other == kind]
        factor = measurement_factor(z[mine], track.covariances[:, mine].swapaxes(0, 1))
        if track.lossy:
            factor = max(factor, 1.0)
        floor = LOSSY_FLOOR * np.eye(2) if track.lossy else 0.0
        covariances[:, mine] = (regular[mine] * factor + floor).swapaxes(0, 1)
    covariances[np.isnan(track.positions[..., 0])] = np.nan
    return replace(track, covariances=covariances)


def smooth_track(track, name):
    """Rauch-Tung-Striebel smoother of one object; see `Smoothed`.

    Contacts are smeared over a few frames: for finding forces use the measured positions.
    """
    k = track.of(name)
    z, r = track.positions[:, k], _regular(track.covariances[:, k])
    q = _process_power(z, r)
    _, passes = _filter(z, r, q, keep=True)
    x, p = passes[-1][1]
    states, spreads = [x], [p]
    for (_, (x_now, p_now)), ((x_next, p_next), _) in reversed(list(pairwise(passes))):
        gain = p_now @ STEP.T @ np.linalg.inv(p_next)
        x = x_now + gain @ (states[-1] - x_next)
        p = p_now + gain @ (spreads[-1] - p_next) @ gain.T
        states.append(x)
        spreads.append(0.5 * (p + p.T))
    x, p = np.array(states[::-1]), np.array(spreads[::-1])
    return Smoothed(x[:, :2], x[:, 2:], p[:, :2, :2], float(q))
