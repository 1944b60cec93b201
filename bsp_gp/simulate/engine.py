"""Worlds moved by pymunk: it drifts and kicks the bodies and resolves their contacts.

Between contacts a sub-step is the leapfrog that pymunk's own order of work makes: places first,
with the velocity of the half step before, then velocities, with the force at the new places. The
forces are computed for all worlds at once and handed to pymunk, one space per world.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.simulate.forces import Force
from bsp_gp.simulate.world import Ensemble, States

BLOCK = 256
"""Worlds moved together: enough to share the cost of NumPy's calls."""
_JUMP = 1e-9
_SPARE_ROWS = 8


@dataclass(frozen=True)
class Contacts:
    """How pymunk resolves contacts.

    Parameters
    ----------
    restitution : float, 0 to 1
        Of every pair of surfaces; 1 is elastic.
    surface_friction : float
        Tangential friction of surfaces; above 0 discs turn.
    iterations : int
        Of the solver, per sub-step; several contacts at once need more.
    overlap_correction : float, 0 to 1
        Share of an overlap that is taken away per sub-step by shifting places. 0 leaves the
        motion to impulses alone.
    has_contacts : bool
        False lets bodies pass through each other.
    """

    restitution: float = 1.0
    surface_friction: float = 0.0
    iterations: int = 20
    overlap_correction: float = 0.0
    has_contacts: bool = True

    def __post_init__(self):
        most = {"restitution": 1, "overlap_correction": 1, "surface_friction": np.inf}
        for name, high in most.items():
            value = getattr(self, name)
            if not 0 <= value <= high:
                raise SettingsError(f"{name} of contacts must be from 0 to {high}, got {value}")
        if self.iterations < 1:
            raise SettingsError(f"iterations must be at least 1, got {self.iterations}")


@dataclass(frozen=True)
class Motion:
    """What moves worlds, and how finely.

    Parameters
    ----------
    n_frames : int
        At least 3.
    dt : float, seconds
        Between frames.
    substeps : int
        Steps of the engine per frame.
    """

    forces: tuple[Force, ...] = ()
    n_frames: int = 51
    dt: float = 0.02
    substeps: int = 20
    contacts: Contacts = Contacts()

    def __post_init__(self):
        if self.n_frames < 3:
            raise SettingsError(f"n_frames must be at least 3, got {self.n_frames}")
        if not (self.dt > 0 and np.isfinite(self.dt)):
            raise SettingsError(f"dt must be positive, got {self.dt}")
        if self.substeps < 1:
            raise SettingsError(f"substeps must be at least 1, got {self.substeps}")


def run_pymunk(worlds, motion):
    """The `States` of worlds, all of as many entities, that are moved with pymunk.

    Raises
    ------
    SettingsError
        If a world leaves the range of numbers (a body at the very place of a source of force).
    """
    worlds = tuple(worlds)
    if len({len(world.entities) for world in worlds}) > 1:
        raise SettingsError("worlds moved together must have the same number of entities")
    blocks = [_Block(worlds[k : k + BLOCK], motion).run() for k in range(0, len(worlds), BLOCK)]
    positions, velocities, touched = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    lost = ~np.isfinite(positions).all(axis=(1, 2, 3))
    if lost.any():
        raise SettingsError(
            f"world {int(np.argmax(lost)) + 1} left the range of numbers; "
            "use more substeps, or start bodies further apart"
        )
    times = motion.dt * np.arange(motion.n_frames)
    return States(times, positions, velocities, touched)


def acceleration(forces, bodies, p, v, t, h):
    """Mean acceleration over a kick of length h at fixed places, second order in h.

    Forces of the velocity are taken at the middle of the kick; dry friction stops a body but
    never turns it round.

    Returns
    -------
    ndarray, shape (S, N, 2), m/s^2
        0 for entities that do not move.
    """
    mass = bodies.mass[..., None]
    free = np.where(bodies.is_static, 0.0, 1.0)[..., None]
    still = np.zeros_like(p)
    for force in forces:
        if not force.needs_velocity:
            still += force.on(bodies, p, v, t) / (np.sqrt(h) if force.is_random else 1.0)
    still *= free / mass
    wet = [force for force in forces if force.needs_velocity and not force.is_dry]
    a = still
    if wet:
        for _ in range(2):
            middle = v + a * (h / 2)
            a = still + free / mass * sum(force.on(bodies, p, middle, t) for force in wet)
    dry = [force for force in forces if force.is_dry]
    if dry:
        limit = sum(force.limit(bodies, p) for force in dry)[..., None] * free / mass
        after, middle = v + a * h, v + a * (h / 2)
        speed = np.sqrt((after**2).sum(axis=-1, keepdims=True))
        size = np.sqrt((middle**2).sum(axis=-1, keepdims=True))
        stops = (limit > 0) & (limit * h >= speed)
        a = np.where(stops, -v / h, a - limit * middle / np.where(size > 0, size, 1.0))
    return a


class _Block:
    """Worlds that are moved together."""

    def __init__(self, worlds, motion):
        self.motion = motion
        self.bodies = Ensemble(worlds)
        self.h = motion.dt / motion.substeps
        self.spaces = [_Space(world, motion.contacts, self.h) for world in worlds]

    def run(self):
        """Positions, velocities and contacts of every frame."""
        motion, bodies, h = self.motion, self.bodies, self.h
        p = np.stack([world.positions for world in bodies.worlds])
        v = np.stack([world.velocities for world in bodies.worlds])
        v = np.where(bodies.is_static[..., None], 0.0, v)
        n_worlds, n_entities = p.shape[:2]
        positions = np.empty((n_worlds, motion.n_frames, n_entities, 2))
        velocities = np.empty_like(positions)
        touched = np.zeros((n_worlds, motion.n_frames - 1, n_entities), dtype=bool)
        positions[:, 0], velocities[:, 0] = p, v
        with np.errstate(all="ignore"):
            # Velocities live at the middle of sub-steps.
            v = v + acceleration(motion.forces, bodies, p, v, 0.0, h / 2) * (h / 2)
            for space, v_world in zip(self.spaces, v, strict=True):
                space.start(v_world)
            for frame in range(1, motion.n_frames):
                for k in range(motion.substeps):
                    t = ((frame - 1) * motion.substeps + k + 1) * h
                    p, v, a, hit = self._step(p, v, t)
                    touched[:, frame - 1] |= hit
                positions[:, frame] = p
                # Half a kick back, but not out of a contact.
                velocities[:, frame] = v - np.where(hit[..., None], 0.0, a * (h / 2))
        return positions, velocities, touched

    def _step(self, p, v, t):
        h = self.h
        a = acceleration(self.motion.forces, self.bodies, p + v * h, v, t, h)
        force = a * self.bodies.mass[..., None]
        p, expected, v = p.copy(), v + a * h, v.copy()
        for s, space in enumerate(self.spaces):
            space.step(h, force[s], p[s], v[s])
        jump = np.abs(v - expected).max(axis=-1)
        return p, v, a, jump > _JUMP * (1 + np.abs(expected).max(axis=-1))


class _Space:
    """One world in pymunk, with its arrays read and written in place."""

    def __init__(self, world, contacts, h):
        import pymunk
        from pymunk import batch

        self.space = pymunk.Space()
        self.space.iterations = contacts.iterations
        self.space.collision_slop = 0.0
        # pymunk keeps (its bias)^h of an overlap.
        self.space.collision_bias = (1.0 - contacts.overlap_correction) ** (1.0 / h)
        self.batch = batch
        moving = [k for k, e in enumerate(world.entities) if not e.is_static]
        self.moving = np.array(moving, dtype=int)
        self.placed = []
        for entity, place in zip(world.entities, world.positions, strict=True):
            self._add(pymunk, entity, tuple(place.tolist()), contacts)
        # pymunk walks over the bodies in the order in which they were added, then over its
        # static body if that has walls; spare rows, since it moves an array that is full.
        n_rows = len(self.moving) + _SPARE_ROWS
        self.force = np.zeros((n_rows, 2))
        self.state = np.zeros((n_rows, 4))
        self.to_space, self.from_space = batch.Buffer(), batch.Buffer()
        self.to_space.set_float_buf(self.force)
        self.from_space.set_float_buf(self.state)
        self.written = batch.BodyFields.FORCE
        self.read = batch.BodyFields.POSITION | batch.BodyFields.VELOCITY

    def _add(self, pymunk, entity, place, contacts):
        shape = None
        if entity.is_static:
            if entity.shape == "rect_wall" and contacts.has_contacts:
                (x, y), w, h = place, entity.width / 2, entity.height / 2
                corners = [(x - w, y - h), (x + w, y - h), (x + w, y + h), (x - w, y + h)]
                shape = pymunk.Poly(self.space.static_body, corners)
        else:
            has_size = entity.shape == "disc" and contacts.has_contacts
            turns = has_size and contacts.surface_friction > 0
            inertia = entity.mass * entity.radius**2 / 2 if turns else float("inf")
            body = pymunk.Body(entity.mass, inertia)
            body.position = place
            self.placed.append(body)
            self.space.add(body)
            if has_size:
                shape = pymunk.Circle(body, entity.radius)
        if shape is not None:
            # pymunk multiplies those of the two shapes.
            shape.elasticity = contacts.restitution**0.5
            shape.friction = contacts.surface_friction**0.5
            self.space.add(shape)

    def start(self, v):
        for body, k in zip(self.placed, self.moving, strict=True):
            body.velocity = tuple(v[k].tolist())

    def step(self, h, force, p, v):
        """One sub-step; `p` and `v` are overwritten."""
        moving, batch, n = self.moving, self.batch, len(self.moving)
        self.force[:n] = force[moving]
        batch.set_space_bodies(self.space, self.written, self.to_space)
        self.space.step(h)
        self.from_space.clear()
        batch.get_space_bodies(self.space, self.read, self.from_space)
        p[moving] = self.state[:n, :2]
        v[moving] = self.state[:n, 2:]
