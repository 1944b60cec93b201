"""Engines that share no code with ours, to move the same worlds: rebound and mujoco.

``run_rebound`` and ``run_mujoco`` have the signature of `bsp_gp.simulate.engine.run_pymunk`. Where
an engine has a force of its own (gravity, damping, springs, contacts), that one is used; the rest
is written out here once more, body by body. Needs the extra ``engines``.
"""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.errors import MissingDependencyError, SettingsError
from bsp_gp.simulate import forces as F
from bsp_gp.simulate.world import States

REBOUND_FORCES = (F.PairForce, F.Drag, F.QuadraticDrag, F.Perpendicular, F.UniformField)
MUJOCO_FORCES = (
    *REBOUND_FORCES, F.PointSpring, F.PeriodicPush, F.SoftContact, F.ContactDamping
)  # fmt: skip
_STIFF = 2e6
"""Stiffness of mujoco's contacts over the mass, 1/s^2: a contact lasts about pi / sqrt of it."""


def run_rebound(worlds, motion):
    """Move worlds with rebound's IAS15 and hard spheres."""
    _require(motion, REBOUND_FORCES, "rebound")
    return _states([_rebound_world(world, motion) for world in worlds], motion)


def run_mujoco(worlds, motion):
    """Move worlds with mujoco: discs are balls on two slides, in the plane z = 0."""
    _require(motion, MUJOCO_FORCES, "mujoco")
    return _states([_mujoco_world(world, motion) for world in worlds], motion)


def _require(motion, known, engine):
    strangers = [type(f).__name__ for f in motion.forces if type(f) not in known]
    if strangers:
        raise SettingsError(f"{engine} is not taught {strangers[0]} here")
    if motion.contacts.surface_friction:
        raise SettingsError(f"{engine} is not taught friction of surfaces here")


def _imported(name):
    try:
        return __import__(name)
    except ImportError as error:
        raise MissingDependencyError(
            f"{name} is not installed; pip install 'bsp_gp[engines]'"
        ) from error


def _states(moved, motion):
    positions, velocities = (np.stack(parts) for parts in zip(*moved, strict=True))
    times = motion.dt * np.arange(motion.n_frames)
    # These engines do not tell in which frames there was contact.
    shape = (len(moved), motion.n_frames - 1, positions.shape[2])
    return States(times, positions, velocities, np.zeros(shape, dtype=bool))


def push(world, motion, p, v, t):
    """Forces on the bodies of one world that the engine itself has not, body by body, newtons."""
    out = np.zeros_like(p)
    for force in motion.forces:
        if isinstance(force, F.PairForce):
            out += _between_pairs(force, world, p)
            continue
        if isinstance(force, F.SoftContact | F.ContactDamping):
            out += _in_contact(force, world, p, v)
            continue
        for i, entity in enumerate(world.entities):
            if not entity.is_static:
                out[i] += _force_on(force, i, world, p, v, t)
    return out


def _between_pairs(force, world, p):
    a = np.array([e.properties.get(force.column, math.nan) for e in world.entities])
    gap = p[None] - p[:, None]
    r = np.sqrt((gap * gap).sum(-1))
    np.fill_diagonal(r, 1.0)  # a body does not pull itself: its gap is zero
    strength = np.nan_to_num(force.strength * a[:, None] * a) / r ** (force.power + 1)
    return (strength[..., None] * gap).sum(axis=1)


def _in_contact(force, world, p, v):
    out = np.zeros_like(p)
    for i, one in enumerate(world.entities):
        for j, other in enumerate(world.entities[:i]):
            gap = p[i] - p[j]
            r = math.hypot(*gap)
            overlap = one.radius + other.radius - r
            if not overlap > 0:  # not a number where one of them is a point
                continue
            if isinstance(force, F.SoftContact):
                size = force.stiffness * overlap
            else:
                size = -force.coefficient * float((v[i] - v[j]) @ gap) / r
            out[i] += size * gap / r
            out[j] -= size * gap / r
    return out


def _force_on(force, i, world, p, v, t):
    entity = world.entities[i]
    if isinstance(force, F.UniformField):
        turn = math.radians(force.angle)
        size = force.strength * (entity.mass if force.per_mass else 1.0)
        return size * np.array([math.cos(turn), math.sin(turn)])
    if isinstance(force, F.PeriodicPush):
        turn = math.radians(force.angle)
        phase = 2 * math.pi * t / force.period + math.radians(force.phase)
        size = force.strength * math.cos(phase) * (entity.mass if force.per_mass else 1.0)
        return size * np.array([math.cos(turn), math.sin(turn)])
    if isinstance(force, F.Perpendicular):
        b = force.strength * (entity.properties[force.column] if force.column else 1.0)
        return b * np.array([-v[i, 1], v[i, 0]])
    if isinstance(force, F.PointSpring):
        gap = p[i] - (force.x, force.y)
        r = math.hypot(*gap)
        return -force.stiffness * (r - force.rest) * gap / r
    turn = math.radians(force.angle)
    u = v[i] - force.wind * np.array([math.cos(turn), math.sin(turn)])
    return -force.coefficient * (math.hypot(*u) if isinstance(force, F.QuadraticDrag) else 1.0) * u


# --- rebound --------------------------------------------------------------------------------------


def _rebound_world(world, motion):
    rebound = _imported("rebound")
    moving = [k for k, e in enumerate(world.entities) if not e.is_static]
    if any(e.shape == "rect_wall" for e in world.entities):
        raise SettingsError("rebound has no walls")
    has_contacts = motion.contacts.has_contacts and any(e.radius > 0 for e in world.entities)
    sim = rebound.Simulation()
    native = _native_gravity(world, motion)
    rest = replace(motion, forces=tuple(f for f in motion.forces if f is not native))
    sim.G = native.strength if native else 0.0
    sim.gravity = "basic" if native else "none"
    for k in moving:
        entity = world.entities[k]
        (x, y), (vx, vy) = world.positions[k], world.velocities[k]
        radius = entity.radius if entity.radius > 0 else 0.0
        sim.add(m=entity.mass, x=x, y=y, vx=vx, vy=vy, r=radius)
    # IAS15 estimates its step from the forces, and complains where there are none.
    sim.integrator = "ias15" if motion.forces else "leapfrog"
    sim.dt = motion.dt / motion.substeps
    if has_contacts:
        sim.collision = "direct"
        sim.collision_resolve = "hardsphere"
        sim.coefficient_of_restitution = lambda sim, speed: motion.contacts.restitution
    p, v = np.array(world.positions), np.zeros((len(world.entities), 2))

    def read():
        for row, k in enumerate(moving):
            particle = sim.particles[row]
            p[k], v[k] = (particle.x, particle.y), (particle.vx, particle.vy)

    def extra(_):
        read()
        force = push(world, rest, p, v, sim.t)
        for row, k in enumerate(moving):
            sim.particles[row].ax += force[k, 0] / world.entities[k].mass
            sim.particles[row].ay += force[k, 1] / world.entities[k].mass

    if any(force is not native for force in motion.forces):
        sim.additional_forces = extra
        sim.force_is_velocity_dependent = 1
    positions, velocities = [], []
    for frame in range(motion.n_frames):
        # Contacts are looked for after steps, so that these must not be long.
        for k in range(motion.substeps if frame and has_contacts else 1):
            share = (k + 1) / motion.substeps if frame and has_contacts else 1
            sim.integrate((max(frame - 1, 0) + share * (frame > 0)) * motion.dt)
        read()
        positions.append(p.copy())
        velocities.append(v.copy())
    return np.array(positions), np.array(velocities)


def _native_gravity(world, motion):
    """The force that rebound's own gravity computes, if all of its sources move."""
    static = [e for e in world.entities if e.is_static and "mass" in e.properties]
    for force in motion.forces:
        is_gravity = isinstance(force, F.PairForce) and force.column == "mass" and force.power == 2
        if is_gravity and not static:
            return force
    return None


# --- mujoco ---------------------------------------------------------------------------------------


def _mujoco_world(world, motion):
    mujoco = _imported("mujoco")
    moving = [k for k, e in enumerate(world.entities) if not e.is_static]
    model = mujoco.MjModel.from_xml_string(_mujoco_xml(world, motion))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qvel[:] = world.velocities[moving].ravel()
    start = world.positions[moving]
    p, v = np.array(world.positions), np.zeros((len(world.entities), 2))
    own = tuple(f for f in motion.forces if not _is_native(f))
    rest = replace(motion, forces=own)
    positions, velocities = [], []

    def read():
        p[moving] = start + data.qpos.reshape(-1, 2)
        v[moving] = data.qvel.reshape(-1, 2)

    def control(_model, now):
        read()
        now.qfrc_applied[:] = push(world, rest, p, v, now.time)[moving].ravel()

    try:
        if own:
            mujoco.set_mjcb_control(control)  # called at every stage of the Runge-Kutta rule
        for frame in range(motion.n_frames):
            for _ in range(motion.substeps if frame else 0):
                mujoco.mj_step(model, data)
            read()
            positions.append(p.copy())
            velocities.append(v.copy())
    finally:
        mujoco.set_mjcb_control(None)
    return np.array(positions), np.array(velocities)


def _is_native(force):
    """Whether mujoco computes a force itself: its gravity, and damping and springs of slides."""
    if isinstance(force, F.UniformField):
        return force.per_mass
    if isinstance(force, F.Drag):
        return force.wind == 0
    return isinstance(force, F.PointSpring) and force.rest == 0


def _mujoco_xml(world, motion):
    """The world in mujoco's own format."""
    native = [f for f in motion.forces if _is_native(f)]
    gravity = [0.0, 0.0]
    for f in native:
        if isinstance(f, F.UniformField):
            turn = math.radians(f.angle)
            gravity[0] += f.strength * math.cos(turn)
            gravity[1] += f.strength * math.sin(turn)
    damping = sum(f.coefficient for f in native if isinstance(f, F.Drag))
    springs = [f for f in native if isinstance(f, F.PointSpring)]
    if len(springs) > 1:
        raise SettingsError("mujoco is taught one spring to a point here")
    bodies = []
    for entity, (x, y) in zip(world.entities, world.positions.tolist(), strict=True):
        if entity.shape == "rect_wall":
            size = f"{entity.width / 2!r} {entity.height / 2!r} 1"
            bodies.append(f'<geom type="box" pos="{x!r} {y!r} 0" size="{size}"/>')
        if entity.is_static:
            continue
        joints = ""
        for axis, at, goal in (("1 0 0", x, "x"), ("0 1 0", y, "y")):
            spring = "".join(
                f' stiffness="{f.stiffness!r}" springref="{getattr(f, goal) - at!r}"'
                for f in springs
            )
            joints += f'<joint type="slide" axis="{axis}" damping="{damping!r}"{spring}/>'
        radius = entity.radius if entity.radius > 0 else 1e-3
        touches = int(entity.shape == "disc" and motion.contacts.has_contacts)
        bodies.append(
            f'<body pos="{x!r} {y!r} 0">{joints}<geom type="sphere" size="{radius!r}" '
            f'mass="{entity.mass!r}" contype="{touches}" conaffinity="{touches}"/></body>'
        )
    h = motion.dt / motion.substeps
    return f"""
<mujoco>
  <option timestep="{h!r}" gravity="{gravity[0]} {gravity[1]} 0" integrator="RK4"
          solver="Newton" iterations="100" tolerance="1e-14" cone="elliptic"/>
  <default><geom condim="1" friction="0 0 0" margin="0" solimp="0.999 0.9999 1e-6"
                 solref="{-_STIFF!r} {-_contact_damping(motion.contacts.restitution)!r}"/></default>
  <worldbody>{"".join(bodies)}</worldbody>
</mujoco>"""


def _contact_damping(restitution):
    """Damping of an oscillator of stiffness `_STIFF` that gives back this share of the speed.

    exp(-pi z / sqrt(1 - z^2)) = restitution, with the damping 2 z sqrt(stiffness), which holds
    as long as the contact pushes only.
    """
    if restitution >= 1:
        return 0.0
    log = -math.log(max(restitution, 1e-6))
    z = log / math.hypot(math.pi, log)
    return 2 * z * math.sqrt(_STIFF)
