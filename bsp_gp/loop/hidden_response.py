"""How small pushes move a track: the equation of motion linearised along it, step by step."""

from __future__ import annotations

import numpy as np

__all__ = ["MOST_NODES", "curve_of", "gradient_along", "interpolation", "nodes_of", "propagated"]

MOST_NODES = 150
LEAST_NODES = 100
"""Instants of a track between which a push is taken as linear in time."""


def nodes_of(times):
    """Instants along a track: its rows, fewer of many, more between few."""
    n = len(times)
    if n > MOST_NODES:
        index = np.linspace(0, n - 1, MOST_NODES)
    else:
        between = max(1, -(-LEAST_NODES // (n - 1)))
        index = np.arange((n - 1) * between + 1) / between
    return np.interp(index, np.arange(n), times)


def curve_of(times, values, wanted):
    """Position and velocity along a tabulated track, (n, d) each; straight on beyond its ends."""
    from scipy.interpolate import make_interp_spline

    seen = np.isfinite(values).all(axis=-1)
    rows = np.flatnonzero(seen)
    if not len(rows) or (values[rows] == values[rows[0]]).all():
        still = values[rows[0]] if len(rows) else np.full(values.shape[-1], np.nan)
        return np.tile(still, (len(wanted), 1)), np.zeros((len(wanted), values.shape[-1]))
    degree = 5 if len(rows) > 5 else 1 if len(rows) < 4 else 3
    curve = make_interp_spline(times[rows], values[rows], k=degree)
    inside = np.clip(wanted, times[rows[0]], times[rows[-1]])
    slope = curve.derivative()(inside)
    return curve(inside) + slope * (wanted - inside)[:, None], slope


def interpolation(nodes, times):
    """Matrix (T, n) from values at nodes to values at rows."""
    from scipy.interpolate import make_interp_spline

    place = np.searchsorted(nodes, times).clip(0, len(nodes) - 1)
    if np.array_equal(nodes[place], times):
        return np.eye(len(nodes))[place]
    return make_interp_spline(nodes, np.eye(len(nodes)), k=3)(times)


def gradient_along(law, positions, velocities, times, receivers):
    """Derivatives of the accelerations by the states of the receivers, (n, R d, 2 R d)."""
    n, n_dims = len(times), positions.shape[-1]
    size = len(receivers) * n_dims
    extent = np.ptp(positions[:, receivers], axis=(0, 1)).max() or 1.0
    speed = np.abs(velocities[:, receivers]).max() or 1.0
    p = np.broadcast_to(positions, (4 * size, *positions.shape)).copy()
    v = np.broadcast_to(velocities, (4 * size, *velocities.shape)).copy()
    steps = np.repeat([1e-6 * extent, 1e-6 * speed], size)
    for q in range(2 * size):
        target = p if q < size else v
        r, d = divmod(q % size, n_dims)
        target[2 * q, :, receivers[r], d] += steps[q]
        target[2 * q + 1, :, receivers[r], d] -= steps[q]
    a = law.acceleration(p[:, :, None], v[:, :, None], times[:, None])[:, :, 0]
    slopes = (a[0::2] - a[1::2]).reshape(2 * size, n, size) / (2 * steps)[:, None, None]
    return np.nan_to_num(np.transpose(slopes, (1, 2, 0)), posinf=0.0, neginf=0.0)


def propagated(times, gradient):
    """Displacements at nodes by unit pushes at nodes and by initial states.

    Returns
    -------
    push : ndarray, shape (n, R d, n R d)
    start : ndarray, shape (n, R d, 2 R d)
    """
    n, size = gradient.shape[:2]
    h = np.diff(times)[:, None, None]
    motion = np.zeros((n, 2 * size, 2 * size))
    motion[:, :size, size:] = np.eye(size)
    motion[:, size:] = gradient
    motion = (motion[1:] + motion[:-1]) / 2
    kick = np.zeros((2 * size, size))
    kick[size:] = np.eye(size)
    # Series of the flow over a step, and of a push that changes linearly over it.
    flow = np.broadcast_to(np.eye(2 * size), motion.shape).copy()
    power, scale = flow.copy(), 1.0
    both = h * kick
    late = h / 2 * kick
    for j in range(1, 6):
        power = power @ motion * h
        scale = scale / j
        flow = flow + scale * power
        both = both + scale / (j + 1) * h * (power @ kick)
        late = late + scale / ((j + 1) * (j + 2)) * h * (power @ kick)
    state = np.zeros((2 * size, n * size + 2 * size))
    state[:, n * size :] = np.eye(2 * size)
    out = np.zeros((n, size, n * size + 2 * size))
    out[0] = state[:size]
    for k in range(n - 1):
        state = flow[k] @ state
        state[:, k * size : (k + 1) * size] += both[k] - late[k]
        state[:, (k + 1) * size : (k + 2) * size] += late[k]
        out[k + 1] = state[:size]
    return out[..., : n * size], out[..., n * size :]
