"""Equations of motion: single steps and rollouts, vectorised over scenes and copies.

``euler`` is the paper's symplectic Euler (equation 1); ``leapfrog`` is kick-drift-kick, with the
velocity extrapolated to the end of the step in velocity-dependent forces; ``rk4`` is the
classical fourth-order rule, the default for smooth laws. Entities that forces do not move follow
their measured track.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError, SettingsError
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.engine.driven import curve_through
from bsp_gp.physics.evaluation import PreparedLaw
from bsp_gp.physics.masses import with_unit_masses
from bsp_gp.physics.series import Series

_HEAD = 6
"""First rows to which a start is fitted that is not given."""


def step_euler(acceleration, p, v, t, h):
    """One symplectic Euler step (paper, equation 1): v += a h, then p += v h."""
    v = v + acceleration(p, v, t, 0) * h
    return p + v * h, v


def step_leapfrog(acceleration, p, v, t, h):
    """One kick-drift-kick step."""
    half = v + acceleration(p, v, t, 0) * (h / 2)
    p = p + half * h
    return p, half + acceleration(p, 2 * half - v, t, 2) * (h / 2)


def step_rk4(acceleration, p, v, t, h):
    """One classical Runge-Kutta step of fourth order."""
    a1 = acceleration(p, v, t, 0)
    v2 = v + a1 * (h / 2)
    a2 = acceleration(p + v * (h / 2), v2, t, 1)
    v3 = v + a2 * (h / 2)
    a3 = acceleration(p + v2 * (h / 2), v3, t, 1)
    v4 = v + a3 * h
    a4 = acceleration(p + v3 * h, v4, t, 2)
    return p + (v + 2 * v2 + 2 * v3 + v4) * (h / 6), v + (a1 + 2 * a2 + 2 * a3 + a4) * (h / 6)


INTEGRATORS = {"euler": step_euler, "leapfrog": step_leapfrog, "rk4": step_rk4}


def step_of(integrator):
    """The step of an integrator; SettingsError if there is none of this name."""
    if integrator not in INTEGRATORS:
        raise SettingsError(
            f"integrator must be one of {', '.join(INTEGRATORS)}, got {integrator!r}"
        )
    return INTEGRATORS[integrator]


class Tracks:
    """Where entities that forces do not move are, between the measured rows as well.

    The places asked for are rows and the halves of every sub-step.
    """

    def __init__(self, batch, substeps):
        n = batch.positions.shape[2]
        receivers = set(batch.bodies.receivers.tolist())
        self.driven = np.array([k for k in range(n) if k not in receivers], dtype=int)
        self.points = 2 * substeps
        self.positions = self.velocities = None
        if len(self.driven):
            self._interpolate(batch)

    def _interpolate(self, batch):
        track = batch.positions[:, :, self.driven]
        seen = np.isfinite(track).all(axis=-1)
        first = np.take_along_axis(track, np.argmax(seen, axis=0)[None, ..., None], axis=0)
        shape = (batch.times.shape[0] - 1, self.points + 1, *track.shape[1:])
        self.positions, self.velocities = np.broadcast_to(first, shape), np.zeros(shape)
        moving = np.any((track != first) & seen[..., None], axis=(0, -1))
        if not moving.any():
            return
        self.positions = self.positions.copy()
        fractions = np.arange(self.points + 1) / self.points
        for s, k in np.argwhere(moving):
            times = batch.times[:, s]
            n = int(np.isfinite(times).sum())
            rows = np.flatnonzero(seen[:, s, k])
            given = batch.velocities
            given = None if given is None else given[rows, s, self.driven[k]]
            curve = curve_through(times[rows], track[rows, s, k], given)
            places = times[: n - 1, None] + np.diff(times[:n])[:, None] * fractions
            # Before the first and after the last seen row: straight on.
            inside = np.clip(places, times[rows[0]], times[rows[-1]])
            slope = curve.derivative()(inside)
            self.positions[: n - 1, :, s, k] = curve(inside) + slope * (places - inside)[..., None]
            self.velocities[: n - 1, :, s, k] = slope

    def place(self, p, v, k, point):
        """Put the driven entities where they are at step `k`, half-sub-step `point`."""
        if not len(self.driven):
            return p, v
        p, v = p.copy(), v.copy()
        p[..., self.driven, :] = self.positions[k, point]
        v[..., self.driven, :] = self.velocities[k, point]
        return p, v


def rollout(law, batch, positions, velocities, *, integrator="rk4", substeps=1, values=None):
    """Integrate the equations of motion from given initial states.

    Parameters
    ----------
    batch : Batch
        Scenes to roll out: their times, bodies, and the tracks of entities that are not moved.
    positions, velocities : ndarray, shape (..., S, R, d)
        Initial states of the receivers, metres and metres/second; leading axes are copies.
    integrator : str
        One of `INTEGRATORS`.
    substeps : int
        Steps per measured interval.
    values : dict, optional
        Constants as `ForceLaw.values` gives them, with leading axes for copies.

    Returns
    -------
    ndarray, shape (T, ..., S, R, d)
        Positions at the measured times; nan after the last row of shorter scenes, or where the
        motion has left the range of numbers.
    """
    step = step_of(integrator)
    bodies = batch.bodies
    receivers = bodies.receivers
    tracks = Tracks(batch, substeps)
    n_entities, n_dims = batch.positions.shape[2:]
    lead = positions.shape[:-2]
    p = np.zeros((*lead, n_entities, n_dims))
    v = np.zeros_like(p)
    p[..., receivers, :] = positions
    v[..., receivers, :] = velocities
    law = PreparedLaw(law, bodies, values, skips=True)
    out = np.empty((len(batch.times), *positions.shape))
    out[0] = positions
    with np.errstate(all="ignore"):
        for k in range(len(batch.times) - 1):
            h = (batch.times[k + 1] - batch.times[k]) / substeps
            for m in range(substeps):
                p, v = _advance(step, law, tracks, p, v, batch.times[k], h, k, m)
            out[k + 1] = p[..., receivers, :]
    return out


def _advance(step, law, tracks, p, v, t, h, k, m):
    """One sub-step; `point` counts halves of the sub-step for the tracks."""
    receivers = law.bodies.receivers

    def acceleration(p, v, t, point):
        p, v = tracks.place(p, v, k, 2 * m + point)
        a = law.acceleration(p, v, t + (m + point / 2) * h)
        if len(receivers) == p.shape[-2]:
            return a
        full = np.zeros_like(p)
        full[..., receivers, :] = a
        return full

    return step(acceleration, p, v, t, h[:, None, None])


def simulated_scene(law, scene, states=None, times=None, *, up=None, substeps=16):
    """The motion of a scene under a law from any start; see `ForceLaw.simulate`."""
    names = [scene.names[k] for k in scene.dynamic]
    unknown = sorted(set(states or {}) - set(names))
    if unknown:
        raise SettingsError(
            f"states name {unknown[0]!r}, which is no moving body; moving are {', '.join(names)}"
        )
    starts = [
        (states or {}).get(name) or _first_state(scene, k)
        for name, k in zip(names, scene.dynamic, strict=True)
    ]
    starts = np.array(starts, dtype=float)
    if starts.shape != (len(names), 2, scene.n_dims) or not np.isfinite(starts).all():
        raise SettingsError(
            f"states must hold a position and a velocity of {scene.n_dims} numbers for each body"
        )
    scene = _at_times(scene, starts[:, 0], times)
    (batch,) = stack((with_unit_masses(scene),), up)
    track = rollout(law, batch, starts[None, :, 0], starts[None, :, 1], substeps=substeps)[:, 0]
    if not np.isfinite(track).all():
        raise EvaluationError("under this law the motion leaves the range of numbers")
    positions = np.array(scene.positions)
    positions[:, scene.dynamic] = track
    return replace(scene, positions=positions, velocities=None, sigma=None)


def _first_state(scene, k):
    """Place and velocity of a body at the first row: as known, or by a parabola through rows."""
    first = scene.first
    if first is not None and first.is_placed and np.isfinite(first.velocity[k]).all():
        return scene.positions[0, k], first.velocity[k]
    seen = np.isfinite(scene.positions[:, k]).all(axis=1)
    t, x = scene.times[seen][:_HEAD] - scene.times[0], scene.positions[seen, k][:_HEAD]
    if len(t) < 3:
        raise SettingsError(f"body {scene.names[k]!r} has too few rows for a start; give states")
    rows = np.stack([t**0, t, t**2], axis=1)
    place, speed, _ = np.linalg.lstsq(rows, x, rcond=None)[0]
    return place, speed


def _at_times(scene, places, times):
    """The scene at other times: what forces do not move goes on as it was seen."""
    times = scene.times if times is None else np.asarray(times, dtype=float)
    positions = np.empty((len(times), len(scene.entities), scene.n_dims))
    for k in range(len(scene.entities)):
        seen = np.isfinite(scene.positions[:, k]).all(axis=1)
        for axis in range(scene.n_dims):
            track = scene.positions[seen, k, axis]
            positions[:, k, axis] = np.interp(times, scene.times[seen], track)
    # Only places that are overwritten are made up; bodies may not stand in one point meanwhile.
    positions[:, scene.dynamic] = places + np.zeros((len(times), 1, 1))
    # Inputs at the new times are those of the old ones, as between rows everywhere.
    series, names = Series.of([scene]), [scene.names]
    inputs = {n: series.at(n, [scene.name], names, times[:, None])[:, 0] for n in scene.inputs}
    return replace(
        scene, times=times, positions=positions, velocities=None, sigma=None, inputs=inputs
    )
