"""How the scenes of a preset are drawn: who is there, where, and how fast. Ranges are uniform.

NBODY, BOUNCE and MAT have the ranges of the paper's own generator (section 4; appendix C.1).
"""

import math
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.simulate.forces import AnchorSpring, MatFriction, PairForce, SoftContact, UniformField
from bsp_gp.simulate.world import World, disc, mat, point, wall

Range = tuple[float, float]
_TRIES = 1000


def uniform(rng, bounds, size=None):
    """Draw from a range (low, high)."""
    low, high = bounds
    return low + (high - low) * rng.random(size)


def polar(length, angle):
    """Vectors of given length and angle in radians, shape (..., 2)."""
    return np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)


class Layout:
    """Base of all layouts; a frozen dataclass whose `draw(rng)` returns a World."""

    positive: ClassVar[tuple[str, ...]] = ()
    is_declared = True
    """Whether the forces are those of the declared model; otherwise nothing is declared."""

    def __post_init__(self):
        for item in fields(self):
            value = getattr(self, item.name)
            if item.type == Range:
                bounds = value if isinstance(value, tuple | list) else (value, value)
                if len(bounds) != 2 or not -math.inf < bounds[0] <= bounds[1] < math.inf:
                    raise SettingsError(
                        f"{item.name} must be a number or a range (low, high), got {value!r}"
                    )
                object.__setattr__(self, item.name, (float(bounds[0]), float(bounds[1])))
            low = np.min(getattr(self, item.name)) if item.type in (Range, int, float) else 1
            if item.name in self.positive and low <= 0:
                raise SettingsError(f"{item.name} must be positive, got {value!r}")
            if item.type is int and (isinstance(value, bool) or int(value) != value):
                raise SettingsError(f"{item.name} must be a whole number, got {value!r}")

    @property
    def forces(self):
        """Forces that act in such scenes besides contacts, and are declared."""
        return ()

    def draw(self, rng):
        """Draw one world."""
        raise NotImplementedError


@dataclass(frozen=True)
class NBody(Layout):
    """Light bodies on circular orbits, if each were alone, around a heavy one, and a push each.

    Parameters
    ----------
    n_bodies : int
        The heavy one included.
    central_mass, pull : float
        kg, and the gravitational constant, m^3/(kg s^2).
    mass, radius, distance, jitter : range
        Of the light bodies: kg, m, m; m/s on every component of every velocity.
    angle : range, degrees
    """

    n_bodies: int = 4
    central_mass: float = 1000.0
    pull: float = 8167.007
    mass: Range = (0.02, 9.0)
    radius: Range = (1.0, 1.0)
    distance: Range = (10.0, 100.0)
    angle: Range = (0.0, 180.0)
    jitter: Range = (-20.0, 20.0)
    positive = ("n_bodies", "central_mass", "mass", "radius", "distance")

    @property
    def forces(self):
        return (PairForce(self.pull),)

    def draw(self, rng):
        n = self.n_bodies - 1
        radii = uniform(rng, self.radius, n + 1)
        masses = [self.central_mass, *uniform(rng, self.mass, n)]
        angle = np.radians(uniform(rng, self.angle, n))
        distance = uniform(rng, self.distance, n)
        speed = np.sqrt(max(self.pull, 0.0) * self.central_mass / distance)
        speed *= rng.choice([-1.0, 1.0], n)
        p, v = np.zeros((n + 1, 2)), uniform(rng, self.jitter, (n + 1, 2))
        p[1:] = polar(distance, angle)
        v[1:] += polar(speed, angle + math.pi / 2)
        bodies = [disc(str(k + 1), radii[k], masses[k]) for k in range(n + 1)]
        return World(bodies, p, v)


def separate(rng, radii, place):
    """Places of discs drawn by `place()` until none overlap."""
    for _ in range(_TRIES):
        p = place()
        gap = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.diag([math.inf] * len(p))
        if np.all(gap > radii[:, None] + radii[None]):
            return p
    raise SettingsError(
        f"{len(radii)} discs found no places without overlap in {_TRIES} draws; "
        "take fewer or smaller ones, or more room"
    )


def box(width, height, thickness, **properties):
    """Four walls around the origin with free space `width` x `height`, and their places."""
    x, y = (width + thickness) / 2, (height + thickness) / 2
    across, upright = (width + 2 * thickness, thickness), (thickness, height + 2 * thickness)
    sizes = {"top": across, "bottom": across, "right": upright, "left": upright}
    walls = [wall(name, *size, **properties) for name, size in sizes.items()]
    return walls, [(0.0, y), (0.0, -y), (x, 0.0), (-x, 0.0)]


@dataclass(frozen=True)
class Bounce(Layout):
    """Balls in a box.

    Parameters
    ----------
    n_bodies : int
    mass, radius, distance, speed : range
        kg, m; m from the middle; m/s in any direction.
    room, thickness, wall_mass : float
        Free width and height, and thickness of the walls, m; their nominal mass, kg.
    """

    n_bodies: int = 4
    mass: Range = (0.02, 9.0)
    radius: Range = (10.0, 10.0)
    distance: Range = (5.0, 50.0)
    speed: Range = (60.0, 100.0)
    room: float = 150.0
    thickness: float = 50.0
    wall_mass: float = 1000.0
    positive = ("n_bodies", "mass", "radius", "room", "thickness", "wall_mass")

    def draw(self, rng):
        n = self.n_bodies
        radii, masses = uniform(rng, self.radius, n), uniform(rng, self.mass, n)
        if np.max(radii) + self.distance[1] > self.room / 2:
            raise SettingsError("the balls must fit into the room: distance + radius <= room / 2")

        def place():
            return polar(uniform(rng, self.distance, n), uniform(rng, (0, 2 * math.pi), n))

        p = separate(rng, radii, place)
        v = polar(uniform(rng, self.speed, n), uniform(rng, (0, 2 * math.pi), n))
        walls, places = box(self.room, self.room, self.thickness, mass=self.wall_mass)
        bodies = [disc(str(k + 1), radii[k], masses[k]) for k in range(n)]
        return World([*bodies, *walls], np.vstack([p, places]), np.vstack([v, np.zeros((4, 2))]))


@dataclass(frozen=True)
class Mat(Layout):
    """Discs sent from the origin over the middle of a mat each.

    Parameters
    ----------
    n_bodies : int
        Discs; each has a mat of its own, further ones start on a ring where they do not overlap.
    mass, radius, speed : range
        kg, m, m/s.
    width, height, distance, friction : range
        Of mats: m, m, m from the disc; coefficient.
    mat_mass : float, kg
        Nominal.
    grip : float, m/s^2
        The force is grip * mass * friction.
    """

    n_bodies: int = 1
    mass: Range = (0.02, 9.0)
    radius: Range = (5.0, 5.0)
    speed: Range = (10.0, 100.0)
    width: Range = (20.0, 50.0)
    height: Range = (20.0, 50.0)
    distance: Range = (10.0, 50.0)
    friction: Range = (5.0, 20.0)
    mat_mass: float = 1.0
    grip: float = 0.8
    positive = ("n_bodies", "mass", "radius", "width", "height", "mat_mass")

    @property
    def forces(self):
        return (MatFriction(self.grip),)

    def draw(self, rng):
        n = self.n_bodies
        radii, masses = uniform(rng, self.radius, n), uniform(rng, self.mass, n)
        angle = uniform(rng, (0, 2 * math.pi), n)
        start = np.zeros((n, 2))
        if n > 1:
            ring = 1.1 * np.max(radii) / math.sin(math.pi / n)
            angle = 2 * math.pi * np.arange(n) / n
            start = polar(ring, angle)
        place = start + polar(uniform(rng, self.distance, n), angle)
        v = polar(uniform(rng, self.speed, n), angle)
        sizes = zip(
            uniform(rng, self.width, n), uniform(rng, self.height, n),
            uniform(rng, self.friction, n), strict=True,
        )  # fmt: skip
        mats = [mat(str(n + k + 1), *size, mass=self.mat_mass) for k, size in enumerate(sizes)]
        bodies = [disc(str(k + 1), radii[k], masses[k]) for k in range(n)]
        return World([*bodies, *mats], np.vstack([start, place]), np.vstack([v, 0 * v]))


@dataclass(frozen=True)
class Magnet(Layout):
    """Charged discs, apart at first and slow.

    Parameters
    ----------
    n_bodies : int
    mass, radius, charge : range
        kg, m, C (the size of it).
    positive_share : float, 0 to 1
        Probability that a charge is positive.
    half_width : float, m
        Discs start in a square of twice this width.
    speed : range, m/s
    spacing : float
        Least distance of two discs at the start, over the sum of their radii.
    repulsion : float, N m^2/C^2
        Of like charges, at 1 m.
    """

    n_bodies: int = 4
    mass: Range = (0.5, 5.0)
    radius: Range = (0.2, 0.2)
    charge: Range = (0.5, 2.0)
    positive_share: float = 0.5
    half_width: float = 5.0
    speed: Range = (0.0, 1.0)
    spacing: float = 4.0
    repulsion: float = 10.0
    positive = ("n_bodies", "mass", "radius", "half_width", "spacing")

    @property
    def forces(self):
        return (PairForce(-self.repulsion, "charge"),)

    def draw(self, rng):
        n = self.n_bodies
        radii, masses = uniform(rng, self.radius, n), uniform(rng, self.mass, n)
        sign = np.where(rng.random(n) < self.positive_share, 1.0, -1.0)
        charges = uniform(rng, self.charge, n) * sign
        span = (-self.half_width, self.half_width)
        p = separate(rng, self.spacing * radii, lambda: uniform(rng, span, (n, 2)))
        v = polar(uniform(rng, self.speed, n), uniform(rng, (0, 2 * math.pi), n))
        bodies = [disc(str(k + 1), radii[k], masses[k], charge=charges[k]) for k in range(n)]
        return World(bodies, p, v)


@dataclass(frozen=True)
class Fall(Layout):
    """Discs thrown above a table.

    Parameters
    ----------
    n_bodies : int
        Side by side, `gap` apart.
    mass, radius, height : range
        kg, m; m above the table (of the lowest point of a disc).
    speed_x, speed_y : range, m/s
    has_table : bool
    gap : float, m
    gravity : float, m/s^2
    """

    n_bodies: int = 1
    mass: Range = (0.05, 0.5)
    radius: Range = (0.05, 0.05)
    height: Range = (3.0, 6.0)
    speed_x: Range = (-1.0, 1.0)
    speed_y: Range = (-1.0, 1.0)
    has_table: bool = True
    gap: float = 3.0
    gravity: float = 9.81
    positive = ("n_bodies", "mass", "radius", "gap")

    @property
    def forces(self):
        return (UniformField(self.gravity),)

    def draw(self, rng):
        n = self.n_bodies
        radii, masses = uniform(rng, self.radius, n), uniform(rng, self.mass, n)
        x = self.gap * (np.arange(n) - (n - 1) / 2)
        p = np.stack([x, radii + uniform(rng, self.height, n)], axis=-1)
        v = np.stack([uniform(rng, self.speed_x, n), uniform(rng, self.speed_y, n)], axis=-1)
        world = World([disc(str(k + 1), radii[k], masses[k]) for k in range(n)], p, v)
        if not self.has_table:
            return world
        return world.joined_by(wall("table", 10.0 + self.gap * n, 1.0), (0.0, -0.5))


@dataclass(frozen=True)
class Spring(Layout):
    """A disc that hangs from a fixed point by a spring.

    Parameters
    ----------
    mass, radius, stiffness, rest_length : range
        kg, m, N/m, m.
    stretch, angle, speed : range
        Start: length over rest length, degrees from straight down, m/s in any direction.
    gravity : float, m/s^2
    """

    mass: Range = (0.1, 0.5)
    radius: Range = (0.03, 0.03)
    stiffness: Range = (5.0, 20.0)
    rest_length: Range = (0.3, 0.6)
    stretch: Range = (1.1, 1.6)
    angle: Range = (-40.0, 40.0)
    speed: Range = (0.0, 0.5)
    gravity: float = 9.81
    positive = ("mass", "radius", "stiffness", "rest_length")

    @property
    def forces(self):
        return (AnchorSpring(), UniformField(self.gravity))

    def draw(self, rng):
        radius, mass = uniform(rng, self.radius), uniform(rng, self.mass)
        rest = uniform(rng, self.rest_length)
        anchor = point("anchor", stiffness=uniform(rng, self.stiffness), rest_length=rest)
        length = rest * uniform(rng, self.stretch)
        p = polar(length, math.radians(uniform(rng, self.angle) - 90))
        v = polar(uniform(rng, self.speed), uniform(rng, (0, 2 * math.pi)))
        return World([disc("1", radius, mass), anchor], [p, (0, 0)], [v, (0, 0)])


@dataclass(frozen=True)
class Pucks(Layout):
    """Soft discs on a ring, sent at its middle, or past it by an offset.

    Parameters
    ----------
    n_bodies : int
    mass, radius, distance, speed, offset : range
        kg, m; m from the middle; m/s towards it; m beside it.
    stiffness : float, N/m
        Of contacts, which last about pi times the root of the reduced mass over it.
    """

    n_bodies: int = 2
    mass: Range = (0.5, 2.0)
    radius: Range = (0.5, 0.5)
    distance: Range = (1.5, 2.5)
    speed: Range = (1.0, 2.0)
    offset: Range = (-0.3, 0.3)
    stiffness: float = 60.0
    positive = ("n_bodies", "mass", "radius", "distance", "stiffness")

    @property
    def forces(self):
        return (SoftContact(self.stiffness),)

    def draw(self, rng):
        n = self.n_bodies
        radii, masses = uniform(rng, self.radius, n), uniform(rng, self.mass, n)
        angle = uniform(rng, (0, 2 * math.pi)) + 2 * math.pi * np.arange(n) / n

        def place():
            beside = polar(uniform(rng, self.offset, n), angle + math.pi / 2)
            return polar(uniform(rng, self.distance, n), angle) + beside

        p = separate(rng, radii, place)
        v = polar(-uniform(rng, self.speed, n), angle)
        return World([disc(str(k + 1), radii[k], masses[k]) for k in range(n)], p, v)
