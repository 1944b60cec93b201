"""Effects that a made-up world may have beyond its preset, declared in the data set's model or not.

`effect("drag", 0.1)` builds one; `parse_effect("push=2,period=0.5")` reads one. `EFFECTS` says
which there are.
"""

import inspect
import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.data.scene import Entity
from bsp_gp.errors import SettingsError
from bsp_gp.simulate.forces import (
    ContactDamping,
    Drag,
    DryFriction,
    Force,
    MatFriction,
    PairForce,
    PeriodicPush,
    Perpendicular,
    PointSpring,
    QuadraticDrag,
    UniformField,
)
from bsp_gp.simulate.layouts import polar, uniform
from bsp_gp.simulate.world import mat


@dataclass(frozen=True)
class ExtraBody:
    """A further entity in every scene.

    Parameters
    ----------
    place : (float, float) or None
        None: drawn anew in every scene, so far from the middle of the bodies that `distance`
        (low, high) times their spread lies between.
    speed : range, m/s
        In any direction; only of bodies that move.
    is_hidden : bool
        Acts, but is not in the data.
    """

    entity: Entity
    place: tuple[float, float] | None = None
    distance: tuple[float, float] = (1.0, 2.0)
    speed: tuple[float, float] = (0.0, 0.0)
    is_hidden: bool = True

    def added_to(self, world, rng):
        """The world with this entity in it."""
        drawn = polar(uniform(rng, self.distance), uniform(rng, (0, 2 * math.pi)))
        v = polar(uniform(rng, self.speed), uniform(rng, (0, 2 * math.pi)))
        place = self.place
        if place is None:
            moving = world.positions[[not e.is_static for e in world.entities]]
            middle = moving.mean(axis=0)
            spread = np.sqrt(((moving - middle) ** 2).sum(axis=1).mean())
            place = middle + drawn * (spread if spread > 0 else 1.0)
        return world.joined_by(self.entity, place, v, is_hidden=self.is_hidden)


@dataclass(frozen=True)
class NewProperty:
    """A property of every moving body, drawn anew in every scene and shown in the data."""

    name: str
    size: tuple[float, float] = (0.5, 2.0)
    positive_share: float = 0.5

    def added_to(self, world, rng):
        """The world with this property, unless its bodies have it already."""
        moving = [e for e in world.entities if not e.is_static]
        values = uniform(rng, self.size, len(moving))
        values *= np.where(rng.random(len(moving)) < self.positive_share, 1.0, -1.0)
        if all(self.name in e.properties for e in moving):
            return world
        return world.with_property(self.name, values)


@dataclass(frozen=True)
class Effect:
    """One thing that is different from the preset.

    Attributes
    ----------
    parameters : tuple of (str, value)
        What it was built with.
    is_declared : bool
        Whether the model that goes with the data set has it.
    forces : tuple of Force
        Forces that it adds.
    power : float or None
        New exponent of the preset's pair force.
    restitution : float or None
        New restitution of contacts.
    """

    name: str
    parameters: tuple = ()
    is_declared: bool = True
    forces: tuple[Force, ...] = ()
    power: float | None = None
    restitution: float | None = None
    body: ExtraBody | None = None
    new_property: NewProperty | None = None


def _wind(value, angle=0.0):
    return UniformField(value, angle, per_mass=False)


def _field(value, angle=0.0):
    return UniformField(value, angle)


def _magnetic(value, column="charge", low=0.5, high=2.0, positive=0.5):
    new = NewProperty(column, (low, high), positive)
    return {"forces": (Perpendicular(value, column),), "new_property": new}


def _push(value, period=1.0, angle=0.0, phase=0.0):
    return PeriodicPush(value, period, angle, phase)


def _mat(value, width=1.0, height=1.0, x=0.0, y=0.0, grip=1.0, hidden=False):
    body = ExtraBody(mat("patch", width, height, value), (x, y), is_hidden=bool(hidden))
    return {"forces": (MatFriction(grip),), "body": body}


def _pair(value, column="charge", power=2.0, low=0.5, high=2.0, positive=0.5):
    new = NewProperty(column, (low, high), positive)
    return {"forces": (PairForce(value, column, power),), "new_property": new}


def _hidden(value, x=None, y=None, near=1.0, far=2.0, moves=False, speed=0.0, column="mass"):
    if (x is None) != (y is None):
        raise SettingsError("a hidden body needs both x and y, or neither")
    properties = {"mass": value} if column == "mass" or moves else {}
    entity = Entity("hidden", is_static=not moves, properties={**properties, column: value})
    place = None if x is None else (x, y)
    return {"body": ExtraBody(entity, place, (near, far), (speed, speed))}


EFFECTS = {
    "drag": (Drag, "linear drag -c v, c in kg/s; wind=, angle= of the air"),
    "quadratic_drag": (QuadraticDrag, "drag -c |v| v, c in kg/m; wind=, angle= of the air"),
    "wind": (_wind, "a push in N, the same on every body; angle= in degrees from x"),
    "field": (_field, "a uniform acceleration in m/s^2; angle="),
    "perpendicular": (
        lambda value: Perpendicular(value), "b times v turned by +90 degrees (Magnus), b in kg/s",
    ),
    "magnetic": (_magnetic, "the same times a charge; column=, low=, high=, positive= share"),
    "push": (_push, "a periodic push in N; period= in s, angle=, phase="),
    "friction": (DryFriction, "Coulomb friction everywhere, mu g in m/s^2"),
    "mat": (_mat, "a mat of that friction; width=, height=, x=, y=, grip=, hidden=1"),
    "spring": (PointSpring, "a spring to an unseen point, in N/m; x=, y=, rest="),
    "pair": (_pair, "a pair force of a new property; column=, power=, low=, high=, positive="),
    "exponent": (lambda value: {"power": value}, "another exponent of the pair force"),
    "hidden": (_hidden, "an unseen body of that mass; x=, y= or near=, far=; moves=1, speed="),
    "dashpot": (ContactDamping, "loss of speed between discs that overlap, in kg/s"),
    "inelastic": (lambda value: {"restitution": value}, "another restitution of contacts, 0 to 1"),
}
"""Name -> builder, of a force or of fields of `Effect`, and what its value and options are."""


def effect(name, value, *, is_declared=True, **options):
    """Build an effect.

    Parameters
    ----------
    name : str
        One of `EFFECTS`.
    value : float
        Its main number; see `EFFECTS`.
    **options
        Further numbers of that effect.

    Raises
    ------
    SettingsError
        If there is no such effect or option, or a number is not allowed.

    Examples
    --------
    >>> effect("drag", 0.1).forces[0].laws
    ('-0.1 [kg/s] * v_i',)
    """
    if name not in EFFECTS:
        raise SettingsError(f"effect must be one of {', '.join(EFFECTS)}, got {name!r}")
    build = EFFECTS[name][0]
    allowed = list(inspect.signature(build).parameters)[1:]
    for option in options:
        if option not in allowed:
            raise SettingsError(
                f"effect {name!r} has no option {option!r}; it has {', '.join(allowed) or 'none'}"
            )
    made = build(value, **options)
    parts = {"forces": (made,)} if isinstance(made, Force) else made
    return Effect(name, (("value", value), *options.items()), is_declared, **parts)


def parse_effect(text, is_declared=True):
    """Read ``NAME=VALUE[,OPTION=VALUE...]``, such as ``push=2,period=0.5``."""
    pairs = []
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise SettingsError(f"effect must be NAME=VALUE[,OPTION=VALUE...], got {text!r:.80}")
        if key in dict(pairs):
            raise SettingsError(f"effect {text!r:.80} gives {key!r} twice")
        pairs.append((key, value))
    (name, value), *options = pairs
    options = {k: v if k == "column" else read_number(f"{k} of an effect", v) for k, v in options}
    value = read_number(f"{name} of an effect", value)
    return effect(name, value, is_declared=is_declared, **options)


def read_number(what, text):
    """A finite number from a text; SettingsError for others."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SettingsError(f"{what} must be a finite number, got {text[:40]!r}")
    return value
