"""How an unseen body may move: at rest, straight on, or as the declared law itself commands.

A motion is a function of its parameters: the place, and the velocity where it has one, at the
middle of the training data (there both are known best). Recordings with nothing in common in time
can share a place only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.language.inputs import property_of
from bsp_gp.loop.denoise import states_of
from bsp_gp.loop.hidden_pull import TOUCHING, hidden_entity
from bsp_gp.loop.hidden_response import curve_of
from bsp_gp.physics.bodies import Bodies, stack
from bsp_gp.physics.dynamics import rollout, step_rk4
from bsp_gp.physics.evaluation import PreparedLaw
from bsp_gp.physics.force import ForceLaw

__all__ = ["ORBIT", "REST", "UNIFORM", "Motion", "motions_of"]

REST, UNIFORM, ORBIT = "at rest", "moving straight on", "moving under the declared law"
WIDEST_GAP = 10
"""Gap between stretches of one clock, in rows, over which sources are interpolated."""
FIRST_STEPS, MOST_STEPS = 25, 400
"""Steps of the integration over the whole clock."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A kind of motion; call it with parameters (C, k) and times (n,).

    Attributes
    ----------
    kind : str
        `REST`, `UNIFORM` or `ORBIT`.
    n_dims : int
    epoch : float
        Instant of the place and the velocity, s.
    field : _Field or None
        What moves an unseen body under the law.
    """

    kind: str
    n_dims: int
    epoch: float
    field: object = None

    @property
    def n_parameters(self):
        return self.n_dims if self.kind == REST else 2 * self.n_dims

    def settled(self, parameters, tolerance):
        """The motion with as few steps of integration as keep to the tolerance, metres."""
        if self.field is None:
            return self
        times = self.field.scene.times
        n_steps, tracks = FIRST_STEPS, None
        while n_steps < MOST_STEPS:
            motion = replace(self, field=replace(self.field, n_steps=n_steps, _made={}))
            before, (tracks, _) = tracks, motion(parameters, times)
            if before is not None:
                with np.errstate(invalid="ignore"):
                    change = np.nanmax(np.abs(tracks - before), axis=(1, 2))
                if np.nanmedian(change) < tolerance:
                    return motion
            n_steps *= 2
        return motion

    def __call__(self, parameters, times):
        """Places and velocities, (C, n, d) each."""
        parameters = np.atleast_2d(parameters)
        place = parameters[:, None, : self.n_dims]
        shape = (len(parameters), len(times), self.n_dims)
        if self.kind == REST:
            return np.broadcast_to(place, shape), np.zeros(shape)
        velocity = parameters[:, None, self.n_dims :]
        if self.kind == UNIFORM:
            since = np.asarray(times)[:, None] - self.epoch
            return place + velocity * since, np.broadcast_to(velocity, shape)
        return self.field.track(place[:, 0], velocity[:, 0], self.epoch, times)


@dataclass(frozen=True, eq=False)
class _Field:
    """Visible sources along the whole clock, and the law by which they move an unseen body."""

    law: ForceLaw
    scene: object
    hidden: object
    up: str | None
    n_steps: int = 4 * FIRST_STEPS
    _made: dict = field(default_factory=dict, repr=False)

    def circular(self, centre, offsets, normal, time):
        """Places and velocities of circular motion about a visible body, (C, d) each.

        Parameters
        ----------
        centre : int
            Its number among the visible bodies.
        offsets : ndarray, shape (C, d), metres
        normal : ndarray, shape (d,) or None
            Of the plane, in 3-D; the sense of the motion follows it.
        time : float
        """
        p, v = (values[0, centre] for values in self._sources(np.array([time])))
        law = self._law()
        pull = law.acceleration(*self._states(p + offsets, 0 * offsets, time))[:, 0, 0]
        radius = np.linalg.norm(offsets, axis=1, keepdims=True)
        inward = np.maximum(-(pull * offsets).sum(axis=1, keepdims=True) / radius, 0.0)
        if offsets.shape[1] == 2:
            along = np.stack([-offsets[:, 1], offsets[:, 0]], axis=1)
        else:
            along = np.cross(normal, offsets)
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        return p + offsets, v + along * np.sqrt(inward * radius)

    def place_of(self, centre, time):
        """Where a visible body is, (d,)."""
        return self._sources(np.array([time]))[0][0, centre]

    def _law(self):
        if "law" not in self._made:
            entities = (*self.scene.entities, self.hidden)
            n = len(entities)
            gap = np.arange(float(n))[:, None] * 10.0
            still = np.broadcast_to(gap, (3, n, self.scene.n_dims))
            scene = type(self.scene)("all", np.arange(3.0), still, entities)
            bodies = stack([scene], self.up)[0].bodies
            alone = Bodies(
                bodies.names, np.array([n - 1]), bodies.properties, bodies.shapes,
                bodies.n_dims, self.up,
            )  # fmt: skip
            self._made["law"] = PreparedLaw(self.law, alone)
        return self._made["law"]

    def _states(self, places, velocities, time):
        """States of all bodies, the unseen one last; the sources at one instant."""
        p, v = self._sources(np.array([time]))
        shape = (len(places), 1, p.shape[1] + 1, p.shape[2])
        positions, moved = np.empty(shape), np.empty(shape)
        positions[:, 0, :-1], moved[:, 0, :-1] = p, v
        positions[:, 0, -1], moved[:, 0, -1] = places, velocities
        return positions, moved, np.full(1, time)

    def _sources(self, times):
        states = [
            curve_of(self.scene.times, self.scene.positions[:, k], times)
            for k in range(len(self.scene.names))
        ]
        return np.stack([p for p, _ in states], axis=1), np.stack([v for _, v in states], axis=1)

    def track(self, places, velocities, epoch, times):
        """Integrated from the epoch both ways, (C, n, d) each; nan where it ran away."""
        key = ("grid", epoch)
        if key not in self._made:
            self._made[key] = self._grid(epoch)
        steps, sources, source_velocities = self._made[key]
        law = self._law()
        p = np.empty((len(places), len(steps), places.shape[1]))
        v = np.empty_like(p)
        middle = int(np.argmin(np.abs(steps - epoch)))
        p[:, middle], v[:, middle] = places, velocities

        def acceleration(at, moved, t, point):
            shape = (len(at), 1, sources.shape[1] + 1, at.shape[1])
            positions, all_moved = np.empty(shape), np.empty(shape)
            positions[:, 0, :-1] = sources[row + sign * point]
            all_moved[:, 0, :-1] = source_velocities[row + sign * point]
            positions[:, 0, -1], all_moved[:, 0, -1] = at, moved
            return law.acceleration(positions, all_moved, np.full(1, t))[:, 0, 0]

        with np.errstate(all="ignore"):
            for sign, stop in ((1, len(steps) - 1), (-1, 0)):
                for k in range(middle, stop, sign):
                    row = 2 * k  # sources stand at steps and half-steps
                    h = steps[k + sign] - steps[k]
                    p[:, k + sign], v[:, k + sign] = step_rk4(
                        acceleration, p[:, k], v[:, k], steps[k], h
                    )
        return _hermite(steps, p, v, np.asarray(times))

    def _grid(self, epoch):
        """Steps with the epoch among them, and the sources at steps and half-steps."""
        first, last = self.scene.times[0], self.scene.times[-1]
        step = (last - first) / self.n_steps
        before = max(int(np.ceil((epoch - first) / step)), 1)
        after = max(int(np.ceil((last - epoch) / step)), 1)
        steps = np.concatenate(
            [np.linspace(first, epoch, before + 1)[:-1], np.linspace(epoch, last, after + 1)]
        )
        halves = np.interp(np.arange(2 * len(steps) - 1) / 2, np.arange(len(steps)), steps)
        return steps, *self._sources(halves)


def _hermite(steps, p, v, times):
    """Cubic Hermite interpolation of tracks (C, m, d) at times (n,)."""
    k = np.clip(np.searchsorted(steps, times, side="right") - 1, 0, len(steps) - 2)
    h = (steps[k + 1] - steps[k])[:, None]
    x = ((times - steps[k])[:, None]) / h
    a, b, va, vb = p[:, k], p[:, k + 1], v[:, k] * h, v[:, k + 1] * h
    c2, c3 = 3 * (b - a) - 2 * va - vb, 2 * (a - b) + va + vb
    return a + x * (va + x * (c2 + x * c3)), (va + x * (2 * c2 + 3 * x * c3)) / h


def motions_of(observation, model, pull):
    """The motions that the recordings allow.

    Returns
    -------
    list of Motion
        At rest first.
    """
    scenes = (*observation.train, *observation.test)
    n_dims = scenes[0].n_dims
    epoch = _middle(observation.train)
    out = [Motion(REST, n_dims, epoch)]
    spans = sorted((s.times[0], s.times[-1]) for s in scenes)
    if any(b[0] < a[1] for a, b in zip(spans[:-1], spans[1:], strict=True)):
        return out
    out.append(Motion(UNIFORM, n_dims, epoch))
    orbit = _orbit_field(observation, model, pull)
    if orbit is not None:
        out.append(Motion(ORBIT, n_dims, epoch, orbit))
    return out


def _middle(scenes):
    return float((min(s.times[0] for s in scenes) + max(s.times[-1] for s in scenes)) / 2)


def _orbit_field(observation, model, pull):
    """Sources along one clock, or None where the law or the recordings do not tell the motion."""
    terms = [term for term in model.law.terms if _moves_anything(term, model.law)]
    if not any(term.kind == "pair" for term in terms):
        return None
    clock = _one_clock(observation, model)
    if clock is None:
        return None
    constants = {n: model.law.constants[n] for t in terms for n in t.formula.constants}
    hidden = hidden_entity(pull, 1.0, "the unseen body itself")
    up = observation.dataset.up
    return _Field(ForceLaw(tuple(terms), constants), clock, hidden, up)


def _moves_anything(term, law):
    """Whether the acceleration by a term depends on no property of the body that is moved."""
    inputs = term.acceleration_formula.inputs
    own = any((property_of(name) or ("", ""))[1] == "i" for name in inputs)
    return not (own or term.needs_mass or inputs & TOUCHING or law.is_per_entity(term))


def _one_clock(observation, model):
    """All rows of one clock as a scene: measured sources, receivers as the model has them.

    What is held out is not looked at: beyond the training rows, receivers move as the model says.
    """
    scenes = sorted(observation.dataset.scenes, key=lambda s: s.times[0])
    if len({s.names for s in scenes}) > 1:
        return None
    steps = np.concatenate([np.diff(s.times) for s in scenes])
    gaps = [b.times[0] - a.times[-1] for a, b in zip(scenes[:-1], scenes[1:], strict=True)]
    if gaps and (min(gaps) <= 0 or max(gaps) > WIDEST_GAP * np.median(steps)):
        return None
    times = np.concatenate([s.times for s in scenes])
    positions = np.concatenate([s.positions for s in scenes])
    if observation.is_exact:
        return _scene_like(scenes[0], times, positions)
    states = states_of(model.fit.whole, observation.train)
    start = min(observation.train, key=lambda s: s.times[0])
    if start.name not in states or start.times[0] != times[0]:
        return None
    dynamic = scenes[0].dynamic
    tracks = _rolled(observation, model, scenes[0], times, positions, states[start.name])
    if not np.isfinite(tracks).all():
        return None
    for scene in observation.train:
        if scene.name in states:
            rows = np.searchsorted(times, scene.times)
            tracks[rows] = states[scene.name][0]
    positions[:, dynamic] = tracks
    return _scene_like(scenes[0], times, positions)


def _rolled(observation, model, scene, times, positions, start):
    """The receivers as the model moves them from the first row on, (T, R, d)."""
    batch = stack([_scene_like(scene, times, positions)], observation.dataset.up)[0]
    p, v = start
    rolled = rollout(
        model.law, batch, p[:1], v[:1], integrator=observation.integrator,
        substeps=observation.substeps,
    )  # fmt: skip
    return rolled[:, 0]


def _scene_like(scene, times, positions):
    return type(scene)("one clock", times, positions, scene.entities)
