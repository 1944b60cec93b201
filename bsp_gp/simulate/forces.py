"""The forces of made-up worlds, each with its numbers, and its law in words that the CLI reads.

They are written apart from `bsp_gp.physics`, so that data made with them test it. All of them
work on several worlds at once: positions and velocities have the shape (S, N, 2).
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.errors import SettingsError
from bsp_gp.language.inputs import SHORT
from bsp_gp.units import DIMENSIONLESS, FORCE, Unit


def unit_vector(angle):
    """Direction at an angle in degrees from x towards y, exact along the axes."""
    turn = math.radians(angle)
    return np.array([math.cos(turn), math.sin(turn)]).round(15) + 0.0


def components(size, angle, unit, factor=""):
    """Laws of a constant vector: one text per axis along which it points."""
    vector = size * unit_vector(angle)
    return tuple(
        f"{value:.12g} [{unit}] * {factor}{axis}"
        for value, axis in zip(vector, ("e_x", "e_y"), strict=True)
        if value
    )


def _norm(a):
    return np.sqrt(a[..., 0] ** 2 + a[..., 1] ** 2)


@dataclass(frozen=True)
class Force:
    """Base of all forces.

    Subclasses give `on`; `laws` are texts of laws, () where the language has no words for it.
    """

    needs_velocity: ClassVar[bool] = False
    is_dry: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    kind: ClassVar[str] = "field"

    def __post_init__(self):
        for name, value in vars(self).items():
            if isinstance(value, float | int) and not math.isfinite(value):
                raise SettingsError(f"{name} of {type(self).__name__} must be finite, got {value}")

    @property
    def laws(self):
        return ()

    def on(self, bodies, p, v, t):
        """Force on every entity in newtons, shape (S, N, 2).

        Parameters
        ----------
        p, v : ndarray, shape (S, N, 2), metres and metres/second
        t : float, seconds
        """
        raise NotImplementedError


@dataclass(frozen=True)
class UniformField(Force):
    """``strength * m_i`` along a direction; ``per_mass=False`` pushes alike whatever the mass.

    Parameters
    ----------
    strength : float, m/s^2 (or N)
    angle : float, degrees
    """

    strength: float
    angle: float = -90.0
    per_mass: bool = True

    @property
    def laws(self):
        if self.per_mass:
            return components(self.strength, self.angle, "m/s^2", "m_i * ")
        return components(self.strength, self.angle, "N")

    def on(self, bodies, p, v, t):
        size = bodies.mass if self.per_mass else np.ones_like(bodies.mass)
        return (self.strength * size)[..., None] * unit_vector(self.angle)


@dataclass(frozen=True)
class Kicks(Force):
    """Random kicks of a surrounding of some temperature, with the drag that it makes.

    `on` gives the force times the root of the time for which it is the same.

    Parameters
    ----------
    temperature : float, K
    coefficient : float, kg/s
        Of the drag.
    seed : int
        Kicks at one time are those of a generator of this seed and time.
    """

    temperature: float
    coefficient: float
    seed: int = 0
    is_random: ClassVar[bool] = True
    BOLTZMANN: ClassVar[float] = 1.380649e-23

    def on(self, bodies, p, v, t):
        rng = np.random.default_rng([self.seed, int(np.float64(t).view(np.uint64))])
        size = math.sqrt(2 * self.coefficient * self.BOLTZMANN * self.temperature)
        return size * rng.standard_normal(p.shape)


@dataclass(frozen=True)
class Drag(Force):
    """Linear drag ``-c (v - w)``; w is the velocity of the air.

    Parameters
    ----------
    coefficient : float, kg/s
    wind : float, m/s
    angle : float, degrees
        Where the wind blows to.
    """

    coefficient: float
    wind: float = 0.0
    angle: float = 0.0
    needs_velocity: ClassVar[bool] = True

    @property
    def laws(self):
        still = f"-{self.coefficient:.12g} [kg/s] * v_i"
        return (still, *components(self.coefficient * self.wind, self.angle, "N"))

    def on(self, bodies, p, v, t):
        return -self.coefficient * (v - self.wind * unit_vector(self.angle))


@dataclass(frozen=True)
class QuadraticDrag(Force):
    """Quadratic drag ``-c |v - w| (v - w)``; c in kg/m, w as in `Drag`."""

    coefficient: float
    wind: float = 0.0
    angle: float = 0.0
    needs_velocity: ClassVar[bool] = True

    @property
    def laws(self):
        if self.wind:
            return ()  # no single law without the vector w inside of a norm
        return (f"-{self.coefficient:.12g} [kg/m] * norm(v_i) * v_i",)

    def on(self, bodies, p, v, t):
        u = v - self.wind * unit_vector(self.angle)
        return -self.coefficient * _norm(u)[..., None] * u


@dataclass(frozen=True)
class Perpendicular(Force):
    """Across the velocity, ``b * property_i`` times v turned by +90 degrees.

    With a charge it is the magnetic force, without a property that of Magnus at fixed spin.

    Parameters
    ----------
    strength : float, kg/s (over the unit of the property)
    column : str
        "" for none.
    """

    strength: float
    column: str = ""
    needs_velocity: ClassVar[bool] = True

    @property
    def laws(self):
        unit, factor = Unit.of(kg=1, s=-1), ""
        if self.column:
            unit = unit / PROPERTY_UNITS.get(self.column, DIMENSIONLESS)
            factor = f"{SHORT.get(self.column, self.column)}_i * "
        return (f"{self.strength:.12g} [{unit.text()}] * {factor}perp(v_i)",)

    def on(self, bodies, p, v, t):
        size = self.strength * (bodies.property(self.column) if self.column else 1.0)
        return np.asarray(size)[..., None] * np.stack([-v[..., 1], v[..., 0]], axis=-1)


@dataclass(frozen=True)
class PeriodicPush(Force):
    """A push that changes with time alone: ``strength cos(2 pi t / period + phase)``.

    Parameters
    ----------
    strength : float, N (m/s^2 if `per_mass`)
    period : float, seconds
    angle, phase : float, degrees
    """

    strength: float
    period: float = 1.0
    angle: float = 0.0
    phase: float = 0.0
    per_mass: bool = False

    def __post_init__(self):
        super().__post_init__()
        if self.period <= 0:
            raise SettingsError(f"period of a push must be positive, got {self.period:g}")

    def on(self, bodies, p, v, t):
        size = self.strength * math.cos(2 * math.pi * t / self.period + math.radians(self.phase))
        mass = bodies.mass if self.per_mass else np.ones_like(bodies.mass)
        return (size * mass)[..., None] * unit_vector(self.angle)


@dataclass(frozen=True)
class DryFriction(Force):
    """Coulomb friction everywhere, ``strength * m_i`` against the velocity; stops, never reverses.

    Parameters
    ----------
    strength : float, m/s^2
        Coefficient of friction times g.
    """

    strength: float
    needs_velocity: ClassVar[bool] = True
    is_dry: ClassVar[bool] = True

    @property
    def laws(self):
        return (f"-{self.strength:.12g} [m/s^2] * m_i * normalize(v_i)",)

    def limit(self, bodies, p):
        """Largest friction on every entity, N, shape (S, N)."""
        return self.strength * bodies.mass

    def on(self, bodies, p, v, t):
        speed = _norm(v)
        direction = v / np.where(speed > 0, speed, 1.0)[..., None]
        return -self.limit(bodies, p)[..., None] * direction


@dataclass(frozen=True)
class MatFriction(DryFriction):
    """Coulomb friction of mats, ``strength * m_i * mu_j`` while the centre of i is over mat j."""

    strength: float = 0.8
    kind: ClassVar[str] = "pair"

    @property
    def laws(self):
        return (
            f"-{self.strength:.12g} [m/s^2] * m_i * mu_j * normalize(v_i) "
            "* is_on(s_i, p_i, s_j, p_j)",
        )

    def limit(self, bodies, p):
        gap = np.abs(p[:, :, None] - p[:, None])
        inside = np.all(gap <= np.nan_to_num(bodies.size[:, None] / 2, nan=-1.0), axis=-1)
        mu = np.where(bodies.is_mat, bodies.property("friction"), 0.0)
        return self.strength * bodies.mass * (inside * mu[:, None]).sum(axis=-1)


@dataclass(frozen=True)
class PairForce(Force):
    """``strength * a_i a_j / r^power`` along the line between two bodies.

    Every entity that has the property is a source, those that do not move included.

    Parameters
    ----------
    strength : float
        N m^power over the square of the property's unit; positive attracts like masses do,
        negative repels.
    column : str
    power : float
    """

    strength: float
    column: str = "mass"
    power: float = 2.0
    kind: ClassVar[str] = "pair"

    @property
    def laws(self):
        a = SHORT.get(self.column, self.column)
        own = PROPERTY_UNITS.get(self.column, DIMENSIONLESS)
        unit = FORCE * Unit.of(m=1) ** self.power / own**2
        # A power that is no simple fraction has a unit that no text says exactly.
        if abs(float(unit.exponents[1]) - 1 - self.power) > 1e-12 or self.power % 0.5:
            return ()
        toward = "p_j - p_i" if self.strength >= 0 else "p_i - p_j"
        return (
            f"{abs(self.strength):.12g} [{unit.text()}] * {a}_i * {a}_j "
            f"/ norm(p_i - p_j)^{self.power:g} * normalize({toward})",
        )

    def on(self, bodies, p, v, t):
        a = bodies.property(self.column)
        gap = p[:, None] - p[:, :, None]
        square = gap[..., 0] ** 2 + gap[..., 1] ** 2
        n = p.shape[1]
        square[:, range(n), range(n)] = 1.0
        square[square == 0] = np.inf  # two at one place: no direction, no force
        steep = square * np.sqrt(square) if self.power == 2 else square ** ((self.power + 1) / 2)
        size = self.strength * a[:, :, None] * a[:, None] / steep
        return (size[..., None] * gap).sum(axis=2)


@dataclass(frozen=True)
class AnchorSpring(Force):
    """A spring to every entity j that has a stiffness: ``k_j (r - l_j)`` towards it."""

    kind: ClassVar[str] = "pair"

    @property
    def laws(self):
        return ("k_j * (norm(p_i - p_j) - l_j) * normalize(p_j - p_i)",)

    def on(self, bodies, p, v, t):
        gap = p[:, None] - p[:, :, None]
        r = _norm(gap)
        k, rest = bodies.property("stiffness")[:, None], bodies.property("rest_length")[:, None]
        size = k * (r - rest) / np.where(r > 0, r, 1.0)
        return (size[..., None] * gap).sum(axis=2)


@dataclass(frozen=True)
class SoftContact(Force):
    """Discs that overlap push each other apart: ``stiffness`` times the overlap.

    Parameters
    ----------
    stiffness : float, N/m
    """

    stiffness: float
    kind: ClassVar[str] = "pair"

    @property
    def laws(self):
        return (
            f"{self.stiffness:.12g} [N/m] * (R_i + R_j - norm(p_i - p_j)) * normalize(p_i - p_j) "
            "* does_collide(s_i, p_i, s_j, p_j)",
        )

    def on(self, bodies, p, v, t):
        direction, overlap = _overlaps(bodies, p)
        return (self.stiffness * np.maximum(overlap, 0.0)[..., None] * direction).sum(axis=2)


@dataclass(frozen=True)
class ContactDamping(Force):
    """Discs that overlap lose speed along the line of their centres (a dashpot).

    Parameters
    ----------
    coefficient : float, kg/s
    """

    coefficient: float
    needs_velocity: ClassVar[bool] = True
    kind: ClassVar[str] = "pair"

    @property
    def laws(self):
        return (
            f"-{self.coefficient:.12g} [kg/s] * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j) "
            "* does_collide(s_i, p_i, s_j, p_j)",
        )

    def on(self, bodies, p, v, t):
        direction, overlap = _overlaps(bodies, p)
        along = ((v[:, :, None] - v[:, None]) * direction).sum(axis=-1)
        size = np.where(overlap > 0, -self.coefficient * along, 0.0)
        return (size[..., None] * direction).sum(axis=2)


def _overlaps(bodies, p):
    """From j to i: directions (S, N, N, 2), and overlaps of discs (S, N, N), metres."""
    gap = p[:, :, None] - p[:, None]
    r = _norm(gap)
    overlap = bodies.radius[:, :, None] + bodies.radius[:, None] - r
    n = p.shape[1]
    overlap[:, range(n), range(n)] = 0.0
    overlap = np.nan_to_num(overlap)  # what has no radius is no disc
    return gap / np.where(r > 0, r, 1.0)[..., None], overlap


@dataclass(frozen=True)
class PointSpring(Force):
    """A spring to a place where nothing is seen.

    Parameters
    ----------
    stiffness : float, N/m
    x, y, rest : float, metres
    """

    stiffness: float
    x: float = 0.0
    y: float = 0.0
    rest: float = 0.0

    def on(self, bodies, p, v, t):
        gap = np.array([self.x, self.y]) - p
        r = _norm(gap)
        size = self.stiffness * (1 - self.rest / np.where(r > 0, r, np.inf))
        return size[..., None] * gap
