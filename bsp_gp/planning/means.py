"""What can be done in an experiment, and experiments as scenes.

A file of means, TOML; all numbers are SI. ``"a..b"`` is a range, a list a choice, a number fixed::

    [bodies.probe]
    x = "-5..5"
    vx = 0
    mass = "0.1..10"
    [bodies.source]
    dynamic = 0
    x = 0
    charge = [1, 2, 5]
    [look]
    until = "0.5..10"
    rows = 10
    noise = 0.05
    at_once = 4

Where an apparatus has settings, numbers of bodies may follow from them::

    [settings]
    speed = "0.5..3"
    angle = "0..1.5"
    [bodies.ball]
    x = 0
    vx = "speed * cos(angle)"
    vy = "speed * sin(angle)"
"""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bsp_gp.data.conversion import unit_of
from bsp_gp.data.scene import Dataset, Entity, FirstState, Scene
from bsp_gp.data.toml import TomlError, parse_toml
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.planning.settings import RESERVED, Following
from bsp_gp.units import UnitSystem

AXES = "xyz"
_RANGE = re.compile(r"\s*([^\s.]+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*\.\.\s*(\S+)\s*")
WIDE = 8.0
"""Ranges of positive numbers whose ends differ by this factor are even in the logarithm."""
FIRST = 0.02
"""Part of the time of an experiment after which its second row is: rows are dense at its begin."""
_LOOK = {"until", "rows", "noise", "noise_share", "at_once", "position_error", "velocity_error"}


@dataclass(frozen=True)
class Body:
    """A body as an experiment begins with it; the probe has a velocity, others may have none."""

    name: str
    position: tuple
    velocity: tuple
    properties: Mapping = field(default_factory=dict)
    is_static: bool = False


@dataclass(frozen=True)
class Experiment:
    """Bodies and the times at which they are looked at, s; the first is the begin.

    ``settings`` are those of the apparatus, by name, if the means have any.
    """

    bodies: tuple[Body, ...]
    times: tuple
    settings: Mapping = field(default_factory=dict)

    def to_dict(self):
        """As `Apparatus` sends it."""
        settings = {"settings": dict(self.settings)} if self.settings else {}
        return settings | {
            "entities": [
                {
                    "name": b.name, "position": list(b.position), "velocity": list(b.velocity),
                    "properties": dict(b.properties), "dynamic": not b.is_static,
                }
                for b in self.bodies
            ],
            "times": list(self.times),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, record):
        """The inverse of `to_dict`."""
        bodies = tuple(
            Body(b["name"], tuple(b["position"]), tuple(b["velocity"]), b["properties"],
                 not b.get("dynamic", True))
            for b in record["entities"]
        )  # fmt: skip
        return cls(bodies, tuple(record["times"]), dict(record.get("settings", {})))

    def scene(self, name, positions=None, errors=(0.0, 0.0), sigma=None):
        """The experiment as a scene.

        Parameters
        ----------
        name : str
        positions : ndarray, shape (T, N, d), optional
            What was seen, m; by default all stay where they begin.
        errors : (float, float)
            Of the first places and velocities, m and m/s.
        sigma : ndarray, shape (T, N, d), optional
        """
        places = np.array([b.position for b in self.bodies], dtype=float)
        speeds = np.array([b.velocity for b in self.bodies], dtype=float)
        if places.shape[1] == 1:  # scenes are planes or rooms
            places, speeds = (np.pad(a, ((0, 0), (0, 1))) for a in (places, speeds))
        if positions is None:
            positions = np.repeat(places[None], len(self.times), axis=0)
        elif positions.shape[-1] < places.shape[1]:
            positions = np.pad(positions, ((0, 0), (0, 0), (0, 1)))
        entities = tuple(
            Entity(b.name, is_static=b.is_static, properties=b.properties) for b in self.bodies
        )
        if not errors[0]:
            positions = np.array(positions)
            positions[0] = places
            held = [k for k, body in enumerate(self.bodies) if body.is_static]
            positions[:, held] = places[held]  # whatever was measured of them
        error = np.where(np.isfinite(speeds), errors[1], np.nan)
        first = FirstState(speeds, error, not errors[0])
        return Scene(name, np.array(self.times), positions, entities, sigma=sigma, first=first)


@dataclass(frozen=True)
class Means:
    """What may be chosen.

    Attributes
    ----------
    bodies : mapping of str to dict
        Per body what may be chosen of ``x, y, z, vx, vy, vz`` and of every property: a number, a
        tuple of numbers (one of them), `Range`, or `Following` where the settings decide.
    static : frozenset of str
        Bodies that are not moved.
    until : number, tuple or Range
        Last time of an experiment, s.
    rows : int
        At most so many times, the begin among them.
    noise, noise_share : float
        Standard deviation of a coordinate: m, and as a part of it; the greater counts.
    at_once : int
        Experiments between two looks at the results.
    position_error, velocity_error : float
        With which bodies are put and set off; 0 = exact.
    units : mapping of str to str
        Of properties that are not known by name.
    settings : mapping of str to number, tuple or Range
        Of the apparatus, from which numbers of bodies may follow.
    """

    bodies: Mapping
    static: frozenset
    until: object
    rows: int = 10
    noise: float = 0.0
    noise_share: float = 0.0
    at_once: int = 1
    position_error: float = 0.0
    velocity_error: float = 0.0
    units: Mapping = field(default_factory=dict)
    settings: Mapping = field(default_factory=dict)

    @property
    def errors(self):
        return self.position_error, self.velocity_error

    @property
    def axes(self):
        """Those that any body names."""
        named = {key for chosen in self.bodies.values() for key in chosen}
        return tuple(a for a in AXES if a in named or f"v{a}" in named)

    @property
    def n_choices(self):
        """How many numbers of the bodies, and settings, may be chosen."""
        chosen = (v for each in (self.settings, *self.bodies.values()) for v in each.values())
        return sum(isinstance(value, (tuple, Range)) for value in chosen)

    @property
    def longest(self):
        """The latest that can be looked, s."""
        if isinstance(self.until, Range):
            return self.until.high
        return float(np.max(self.until))

    def draw(self, rng, part=1.0):
        """An experiment by chance, as even as the ranges are.

        Parameters
        ----------
        rng : numpy.random.Generator
        part : float
            Of the time that is drawn.
        """
        axes, bodies = self.axes, []
        settings = {name: _drawn(value, rng) for name, value in self.settings.items()}
        for name, chosen in self.bodies.items():
            drawn = {key: _drawn(value, rng, settings) for key, value in chosen.items()}
            place = tuple(drawn.pop(a, 0.0) for a in axes)
            speed = tuple(drawn.pop(f"v{a}", 0.0) for a in axes)
            bodies.append(Body(name, place, speed, drawn, name in self.static))
        until = part * _drawn(self.until, rng)
        times = (0.0, *np.geomspace(FIRST * until, until, self.rows - 1).tolist())
        return Experiment(tuple(bodies), times, settings)

    def sigma(self, positions):
        """Standard deviations of coordinates that are seen, m, of any shape."""
        return np.maximum(self.noise, self.noise_share * np.abs(positions))

    def dataset(self, scenes):
        """Scenes as a data set."""
        units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg", **self.units})
        names = {p for s in scenes for e in s.entities for p in e.properties}
        own = {name: unit_of(text) for name, text in self.units.items() if name in names}
        is_declared = self.noise > 0 and not self.noise_share
        return Dataset(
            "experiments", tuple(scenes), units=units, property_units=own,
            noise=(self.noise,) if is_declared else None,
        )  # fmt: skip


@dataclass(frozen=True)
class Range:
    """From .. to."""

    low: float
    high: float

    @property
    def is_wide(self):
        return 0 < self.low and self.high / self.low >= WIDE

    def __post_init__(self):
        if not self.low < self.high or not math.isfinite(self.high - self.low):
            raise SettingsError(f"a range must be LOW..HIGH, got {self.low:g}..{self.high:g}")


def _drawn(value, rng, settings=None):
    if isinstance(value, Following):
        return value(settings)
    if isinstance(value, Range):
        if value.is_wide:
            return float(np.exp(rng.uniform(math.log(value.low), math.log(value.high))))
        return float(rng.uniform(value.low, value.high))
    if isinstance(value, tuple):
        return float(value[rng.integers(len(value))])
    return value


def load_means(path: str | os.PathLike) -> Means:
    """Read a file of means.

    Raises
    ------
    DataError
        If there is none, or what it says cannot be.
    """
    path = Path(path)
    try:
        tables = parse_toml(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError("there are no means", file=path, remedy="give a .toml file") from error
    except (OSError, TomlError, UnicodeDecodeError) as error:
        raise DataError(f"this is no file of means ({error})", file=path) from error
    try:
        return means_from(tables)
    except SettingsError as error:
        raise DataError(str(error), file=path) from error


def means_from(tables):
    """`Means` of a mapping with the tables ``bodies``, ``look``, ``settings`` and ``units``."""
    unknown = sorted(set(tables) - {"bodies", "look", "settings", "units"})
    if unknown:
        raise SettingsError(
            f"[{unknown[0]}] is unknown; there are [bodies.NAME], [look], [settings], [units]"
        )
    bodies, static, settings = {}, set(), _settings(_table(tables, "settings"))
    for name, chosen in _table(tables, "bodies").items():
        chosen = dict(_table({name: chosen}, name))
        if not chosen.pop("dynamic", 1):
            static.add(name)
        bodies[name] = {
            k: _choice(v, f"[bodies.{name}] {k}", settings) for k, v in chosen.items()
        }
    if not set(bodies) - static:
        raise SettingsError("no body moves; give [bodies.NAME] with x = \"LOW..HIGH\"")
    look = _table(tables, "look")
    unknown = sorted(set(look) - _LOOK)
    if unknown or "until" not in look:
        found = f"{unknown[0]!r} is unknown" if unknown else "until is missing"
        raise SettingsError(f"[look] {found}; it has {', '.join(sorted(_LOOK))}")
    numbers = {k: look[k] for k in look if k != "until"}
    for key, value in numbers.items():
        is_whole = key in ("rows", "at_once")
        least = {"rows": 4, "at_once": 1}.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int if is_whole else (int, float)) \
                or not least <= value < math.inf:  # fmt: skip
            kind = "a whole number" if is_whole else "a number"
            raise SettingsError(f"[look] {key} must be {kind} of at least {least}, got {value!r}")
    until = _choice(look["until"], "[look] until")
    ends = (until.low,) if isinstance(until, Range) else until
    if min(ends if isinstance(ends, tuple) else (ends,)) <= 0:
        raise SettingsError("[look] until must be later than the begin, 0 s")
    means = Means(bodies, frozenset(static), until, **numbers, units=_table(tables, "units"),
                  settings=settings)  # fmt: skip
    if not means.axes:
        raise SettingsError("no body has a place; give x, y or z")
    return means


def _table(tables, name):
    table = tables.get(name, {})
    if not isinstance(table, Mapping):
        raise SettingsError(f"[{name}] must be a table, got {table!r:.60}")
    return table


def _settings(table):
    """Choices by name."""
    for name in table:
        if not name.isidentifier() or name in RESERVED:
            raise SettingsError(f"[settings] {name!r} is no name that a formula could use")
    return {name: _choice(value, f"[settings] {name}") for name, value in table.items()}


def _choice(value, where, settings=()):
    """A number, a tuple of numbers, a Range, or what follows from settings."""
    if isinstance(value, str):
        match = _RANGE.fullmatch(value)
        if not match and settings:
            try:
                return Following(value, settings)
            except SettingsError as error:
                raise SettingsError(f"{where}: {error}") from error
        try:
            return Range(float(match[1]), float(match[2]))
        except (TypeError, ValueError):
            raise SettingsError(f'{where} must be "LOW..HIGH", got {value!r}') from None
    numbers = value if isinstance(value, list) else [value]
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, (int, float)) \
                or not math.isfinite(number):  # fmt: skip
            raise SettingsError(
                f'{where} must be a number, a list of numbers or "LOW..HIGH", got {value!r:.60}'
            )
    if not numbers:
        raise SettingsError(f"{where} is an empty list")
    return tuple(map(float, value)) if isinstance(value, list) else float(value)


def moved(experiment, means, rng, share=0.15):
    """An experiment near another one: every number that may be chosen is moved a little."""
    fresh = means.draw(rng)
    axes, bodies = means.axes, []

    def near(value, old, new):
        if isinstance(value, Following):
            return value(settings)
        if isinstance(value, Range) and value.is_wide:
            return float(old ** (1 - share) * new**share)
        if isinstance(value, Range):
            return float((1 - share) * old + share * new)
        return new if rng.random() < share else old

    settings = {
        name: near(value, experiment.settings[name], fresh.settings[name])
        for name, value in means.settings.items()
    }
    for body, other in zip(experiment.bodies, fresh.bodies, strict=True):
        chosen = means.bodies[body.name]
        places = zip(axes, body.position, other.position, strict=True)
        speeds = zip(axes, body.velocity, other.velocity, strict=True)
        place = tuple(near(chosen.get(a, 0.0), old, new) for a, old, new in places)
        speed = tuple(near(chosen.get(f"v{a}", 0.0), old, new) for a, old, new in speeds)
        properties = {
            k: near(chosen.get(k, 0.0), v, other.properties[k]) for k, v in body.properties.items()
        }
        bodies.append(replace(body, position=place, velocity=speed, properties=properties))
    until = experiment.times[-1] ** (1 - share) * fresh.times[-1] ** share
    times = np.array(experiment.times) * (until / experiment.times[-1])
    return Experiment(tuple(bodies), tuple(times.tolist()), settings)
