"""The nouns of measured motion: Entity, Scene, Dataset. Frozen, validated, arrays read-only.

Axes are always ``[time, entity, xy(z)]``; numbers are SI, or the data's own unit where the data
set is not calibrated (`Dataset.units` says which).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from types import MappingProxyType

import numpy as np

from bsp_gp.errors import DataError
from bsp_gp.units import DIMENSIONLESS, Unit, UnitSystem

SUMS = {"only": 1, "unseen": 2}
"""What `Dataset.velocity` is where places are sums, and how often was added up."""
SIGHT = "sight"
"""What `Dataset.velocity` is where what stands in the place of places are velocities along the line
of sight, of which no places are known."""
CHECK = "check: "
"""Beginning of the notes that doubt the data or the law: every account of a result shows them."""
SHAPES = ("point", "disc", "rect_wall", "rect_mat")
POINTLIKE = ("point", "disc")
PROPERTY_UNITS = MappingProxyType({
    "mass": Unit.of(kg=1), "friction": DIMENSIONLESS, "charge": Unit.of(A=1, s=1),
    "radius": Unit.of(m=1), "stiffness": Unit.of(kg=1, s=-2), "rest_length": Unit.of(m=1),
})  # fmt: skip
"""Units of the properties that the grammars know by name; other columns declare theirs."""


@dataclass(frozen=True)
class Entity:
    """One body, wall, mat or anchor.

    Attributes
    ----------
    name : str
        Unique within a scene.
    shape : str
        One of `SHAPES`; a point has no extent and never touches anything.
    radius, width, height : float
        Metres; nan where it does not apply.
    is_static : bool
        True for entities that forces do not move. They still act on others, and may move along
        a prescribed track (their measured one).
    properties : mapping of str to float or tuple of float
        Named properties (``mass``, ``charge``, any further column); nan = unknown.
    """

    name: str
    shape: str = "point"
    radius: float = math.nan
    width: float = math.nan
    height: float = math.nan
    is_static: bool = False
    properties: Mapping = field(default_factory=dict)

    def __post_init__(self):
        if self.shape not in SHAPES:
            problem = f"shape of entity {self.name!r} must be one of {', '.join(SHAPES)}"
            raise DataError(f"{problem}, got {self.shape!r}", column="shape")
        object.__setattr__(self, "properties", MappingProxyType(dict(self.properties)))
        mass = self.properties.get("mass", math.nan)
        if not self.is_static and mass <= 0:
            raise DataError(
                f"mass of entity {self.name!r} must be positive, got {mass:g}", column="mass",
                remedy="leave the cell empty if the mass is unknown, or set dynamic to 0",
            )  # fmt: skip

    @property
    def mass(self):
        """Mass in kg, nan if unknown."""
        return self.properties.get("mass", math.nan)


def _readonly(array):
    array = np.array(array, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class FirstState:
    """What is known of the first row of a scene beyond that its places were measured.

    Attributes
    ----------
    velocity, velocity_error : ndarray, shape (N, d), m/s
        nan = unknown; an error of 0 = exact.
    is_placed : bool
        Whether the places of the first row are exact.
    """

    velocity: np.ndarray
    velocity_error: np.ndarray
    is_placed: bool = False

    def __post_init__(self):
        for attribute in ("velocity", "velocity_error"):
            object.__setattr__(self, attribute, _readonly(getattr(self, attribute)))


@dataclass(frozen=True, eq=False)
class Scene:
    """One recording: the same entities over strictly increasing times.

    Attributes
    ----------
    name : str
    times : ndarray, shape (T,), seconds
    positions : ndarray, shape (T, N, d), metres
        d is 2 or 3; nan marks a gap in the track of an entity.
    entities : tuple of Entity, length N
    velocities : ndarray, shape (T, N, d) or None, metres/second
        Only if they were *measured* (not differences of positions).
    sigma : ndarray, shape (T, N, d) or None, metres
        Quoted standard errors per point; nan where none is quoted.
    inputs : mapping of str to ndarray, shape (T, N) or (T, N, d)
        What was logged beside the tracks, SI, for laws to name; nan = not logged there.
    logs : mapping of str to ndarray, shape (T, N)
        Further columns that no law names, see `Dataset.logged`.
    first : FirstState or None
    may_meet : bool
        Whether two entities may have the same coordinates, as angles of two arms do.
    part_of : str
        Name of the recording of which it is a stretch; "" = a recording of its own.
    """

    name: str
    times: np.ndarray
    positions: np.ndarray
    entities: tuple[Entity, ...]
    velocities: np.ndarray | None = None
    sigma: np.ndarray | None = None
    inputs: Mapping = field(default_factory=dict)
    first: FirstState | None = None
    may_meet: bool = False
    logs: Mapping = field(default_factory=dict)
    part_of: str = ""

    def __post_init__(self):
        for attribute in ("inputs", "logs"):
            known = {name: _readonly(values) for name, values in getattr(self, attribute).items()}
            object.__setattr__(self, attribute, known)
        for attribute in ("times", "positions", "velocities", "sigma"):
            value = getattr(self, attribute)
            if value is not None:
                object.__setattr__(self, attribute, _readonly(value))
        object.__setattr__(self, "entities", tuple(self.entities))
        self._validate()

    def _validate(self):
        where = f"scene {self.name!r}"
        n_times = len(self.times)
        expected = (n_times, len(self.entities))
        if self.positions.ndim != 3 or self.positions.shape[:2] != expected:
            raise DataError(
                f"{where}: positions must have the shape (times, entities, 2 or 3) = "
                f"{expected} + (d,), got {self.positions.shape}"
            )
        if self.positions.shape[2] not in (2, 3):
            n_axes = self.positions.shape[2]
            raise DataError(f"{where}: positions must have 2 or 3 axes, got {n_axes}")
        if n_times < 3:
            raise DataError(
                f"{where} has {n_times} frame(s); a force needs at least 3 to be seen",
                remedy="record more frames or leave the scene out",
            )
        if not np.all(np.isfinite(self.times)):
            raise DataError(f"{where}: times must be finite")
        steps = np.diff(self.times)
        if np.any(steps <= 0):
            k = int(np.argmax(steps <= 0))
            kind = "duplicate" if steps[k] == 0 else "unsorted"
            raise DataError(
                f"{where}: times must increase strictly, got {kind} times "
                f"{self.times[k]:g} then {self.times[k + 1]:g}"
            )
        if np.any(np.isinf(self.positions)):
            raise DataError(f"{where}: positions must be finite, got an infinite value")
        names = [entity.name for entity in self.entities]
        if len(set(names)) != len(names):
            raise DataError(f"{where}: entity names must be unique, got {names}")
        for attribute in ("velocities", "sigma"):
            value = getattr(self, attribute)
            if value is not None and value.shape != self.positions.shape:
                raise DataError(
                    f"{where}: {attribute} must have the shape of positions "
                    f"{self.positions.shape}, got {value.shape}"
                )
        if self.first is not None and self.first.velocity.shape != self.positions.shape[1:]:
            raise DataError(f"{where}: first velocities must be one per entity and axis")
        if self.sigma is not None and np.any(self.sigma < 0):
            raise DataError(f"{where}: quoted errors must not be negative")
        if not self.may_meet:
            self._reject_coincident()

    def _reject_coincident(self):
        bodies = [k for k, e in enumerate(self.entities) if e.shape in POINTLIKE]
        points = self.positions[:, bodies]
        if len(bodies) < 2:
            return
        order = np.lexsort(points.transpose(2, 0, 1), axis=-1)
        ordered = np.take_along_axis(points, order[:, :, None], axis=1)
        same = np.all(ordered[:, 1:] == ordered[:, :-1], axis=2)
        if np.any(same):
            row, column = (int(k[0]) for k in np.nonzero(same))
            pair = sorted(order[row, column : column + 2])
            a, b = (self.entities[bodies[k]].name for k in pair)
            raise DataError(
                f"scene {self.name!r}: entities {a!r} and {b!r} are at one point "
                f"at t = {self.times[row]:g}",
                remedy="no force between them has a direction there; "
                "mend the track or leave one of them out",
            )

    @property
    def n_dims(self):
        return self.positions.shape[2]

    @property
    def names(self):
        return tuple(entity.name for entity in self.entities)

    @property
    def dynamic(self):
        """Indices of the entities that forces move, shape (n,)."""
        return np.array([k for k, e in enumerate(self.entities) if not e.is_static], dtype=int)

    def on_track(self, track):
        """The same scene with its dynamic entities on a track (T, n, d), where they were seen."""
        positions = np.array(self.positions)
        seen = np.isfinite(positions[:, self.dynamic])
        positions[:, self.dynamic] = np.where(seen, track, np.nan)
        return replace(self, positions=positions)

    def rows(self, start, stop):
        """The same scene cut to rows ``start:stop`` of time."""
        return self.of_rows(slice(start, stop), has_first=start in (0, None))

    def of_rows(self, cut, has_first=False):
        """The same scene cut to some rows, a slice or bools (T,), with its first state or not."""
        arrays = {n: getattr(self, n) for n in ("times", "positions", "velocities", "sigma")}
        return replace(
            self, **{n: None if values is None else values[cut] for n, values in arrays.items()},
            inputs={name: values[cut] for name, values in self.inputs.items()},
            logs={name: values[cut] for name, values in self.logs.items()},
            first=self.first if has_first else None,
        )  # fmt: skip


@dataclass(frozen=True)
class LatentDeclaration:
    """A property declared unknown, as read from ``[latent.NAME]``; priors are made elsewhere.

    `mean` and `sd` are those of a truncated normal before it is cut to `low` and `high`.
    """

    name: str
    prior: str = "uniform"
    low: float = math.nan
    high: float = math.nan
    entities: tuple[str, ...] = ()
    share: str = "entity"
    values: tuple[float, ...] = ()
    mean: float = math.nan
    sd: float = math.nan


@dataclass(frozen=True)
class Evaluation:
    """How held-out scenes are scored.

    Attributes
    ----------
    initial_rows : int or None
        The initial state of a held-out scene is fitted on this many first rows, which do not
        count in its error. None: a third of the rows, at least 3 and at most 12.
    endpoint_row : int or None
        1-based row whose error is reported as the end-point error. None: the last row.
    """

    initial_rows: int | None = None
    endpoint_row: int | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Scenes with their split, units, noise and provenance.

    Attributes
    ----------
    name : str
    scenes : tuple of Scene
    train, test : tuple of str
        Names of scenes. Both empty: `bsp_gp.data.split` chooses.
    units : UnitSystem
    property_units : mapping of str to Unit
        Unit of every property column.
    up : str or None
        Axis that points up: "x", "y", "z", "-x", "-y" or "-z"; None if not declared.
    noise : tuple of float or None
        Declared standard deviation of a position, one value or one per axis, metres. 0 = exact.
    noise_memory : float or None
        Declared correlation time of the position noise, s; 0 = white.
    velocity : str
        "measured" if the velocity columns are data in their own right, "only" if places are sums of
        them, "unseen" if both are sums of measured accelerations (`bsp_gp.data.summed`), "sight" if
        velocities along the line of sight stand in the place of one coordinate
        (`bsp_gp.data.sight`), else "ignore".
    latents : tuple of LatentDeclaration
    evaluation : Evaluation
    provenance : mapping of str to str
        Where the data come from: source, description, file and its SHA-256.
    notes : tuple of str
        What was noticed while reading (dropped axes, ignored columns); shown in the report.
    logged : mapping of str to (str, Unit)
        Further columns beside the tracks that nobody declared, by their names in laws: heading and
        unit. Those in `Scene.logs` are not asked yet, see `bsp_gp.data.logged`.
    is_film : bool
        Whether times are those of frames, so that a shutter may have read rows one by one.
    steps : tuple of float, metres
        Per axis the step of the grid that what places were made of was printed on (right ascension
        and declination), where places themselves are on none; empty, or 0 without one.
    """

    name: str
    scenes: tuple[Scene, ...]
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    units: UnitSystem = field(default_factory=lambda: UnitSystem.from_declared({}))
    property_units: Mapping = field(default_factory=dict)
    up: str | None = None
    noise: tuple[float, ...] | None = None
    velocity: str = "ignore"
    latents: tuple[LatentDeclaration, ...] = ()
    evaluation: Evaluation = field(default_factory=Evaluation)
    provenance: Mapping = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    noise_memory: float | None = None
    logged: Mapping = field(default_factory=dict)
    is_film: bool = False
    steps: tuple[float, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "scenes", tuple(self.scenes))
        object.__setattr__(self, "property_units", {**PROPERTY_UNITS, **self.property_units})
        for attribute in ("logged", "property_units", "provenance"):
            known = MappingProxyType(dict(getattr(self, attribute)))
            object.__setattr__(self, attribute, known)
        if not self.scenes:
            raise DataError(f"data set {self.name!r} has no scenes")
        names = [scene.name for scene in self.scenes]
        if len(set(names)) != len(names):
            raise DataError(f"data set {self.name!r}: scene names must be unique")
        if len({scene.n_dims for scene in self.scenes}) > 1:
            raise DataError(f"data set {self.name!r} mixes 2-D and 3-D scenes")
        for side in ("train", "test"):
            unknown = sorted(set(getattr(self, side)) - set(names))
            if unknown:
                raise DataError(f"{side} names unknown scenes {unknown}; present are {names[:20]}")
        overlap = sorted(set(self.train) & set(self.test))
        if overlap:
            raise DataError(
                f"scenes {overlap[:5]} are both in train and in test",
                remedy="a held-out scene must not be trained on",
            )

    def __repr__(self):
        bodies = list(dict.fromkeys(name for scene in self.scenes for name in scene.names))
        listed = ", ".join(bodies[:6]) + (" ..." if len(bodies) > 6 else "")
        units = ", ".join(f"{kind} in {unit}" for kind, unit in self.units.declared.items())
        n_rows, n = sum(len(scene.times) for scene in self.scenes), len(self.scenes)
        return "\n".join([
            f"Dataset {self.name!r}: {n} scene{'s' * (n > 1)}, {n_rows} rows, {self.n_dims}-D",
            f"  bodies: {listed}", f"  properties: {', '.join(self.property_names) or 'none'}",
            f"  units: {units or 'none declared'}; up: {self.up or 'not declared'}",
            f"  notes: {len(self.notes)}",
        ])  # fmt: skip

    def _repr_html_(self):
        return f"<pre>{escape(repr(self))}</pre>"

    def plot(self, axes=None, *, scene=None):
        """Draw the tracks of one scene, by default the first; returns the axes."""
        from bsp_gp.data.drawn import plot_tracks

        length, time = (self.units.text(Unit.of(**{base: 1})) for base in ("m", "s"))
        shown = self.scenes[0] if scene is None else self.scene(scene)
        return plot_tracks(shown, axes, length=length, time=time)

    @property
    def n_dims(self):
        return self.scenes[0].n_dims

    @property
    def n_moving_axes(self):
        """Axes along which any body that forces move changes its place."""
        moving = np.zeros(self.n_dims, dtype=bool)
        for scene in self.scenes:
            places = scene.positions[:, scene.dynamic]
            low, high = np.fmin.reduce(places, axis=0), np.fmax.reduce(places, axis=0)
            moving |= (high > low).any(axis=0)
        return int(moving.sum())

    @property
    def is_summed(self):
        """Whether places are sums of what was measured, so that errors add up."""
        return self.n_sums > 0

    @property
    def is_of_sight(self):
        """Whether velocities along the line of sight stand in the place of a coordinate."""
        return self.velocity == SIGHT

    @property
    def n_sums(self):
        """How often was added up what was measured: velocities once, accelerations twice."""
        return SUMS.get(self.velocity, 0)

    @cached_property
    def typical_step(self):
        """Median time from row to row, s."""
        return float(np.median(np.concatenate([np.diff(scene.times) for scene in self.scenes])))

    @property
    def property_names(self):
        """Names of all properties that any entity has a known value of, sorted."""
        entities = (entity for scene in self.scenes for entity in scene.entities)
        known = {name for entity in entities for name, value in entity.properties.items()
                 if np.all(np.isfinite(value))}  # fmt: skip
        return tuple(sorted(known))

    def scene(self, name):
        """Look a scene up by name; DataError if there is none."""
        return self.select([name])[0]

    def select(self, names):
        """Scenes by name, in the order given; DataError for one that there is not."""
        known = {scene.name: scene for scene in self.scenes}
        for name in (name for name in names if name not in known):
            raise DataError(f"unknown scene {name!r}; present are {list(known)[:20]}")
        return tuple(known[name] for name in names)

    @classmethod
    def from_frames(cls, frames, entities=None, **settings):
        """Make a data set of DataFrames; see `bsp_gp.data.tables.dataset_from_frames`.

        Parameters
        ----------
        frames : DataFrame or mapping of str to DataFrame
            Long tables with the columns of ``trajectories.csv``, or those of trackpy; or bodies
            side by side, ``red_x, red_y, blue_x, blue_y``; a mapping gives the names of the scenes.
        entities : DataFrame or sequence of Entity, optional
        **settings
            name, units, columns, properties, fps, dt, train, test, up, noise, provenance.
            ``columns={"red_x": "P1", "red_y": "P2", "blue_x": ...}`` names bodies side by side
            whose headings do not; ``properties={"mass": {"red": 69.3, "blue": 127.9}}`` says what
            no column does.
        """
        from bsp_gp.data.tables import dataset_from_frames  # tables import the nouns

        return dataset_from_frames(frames, entities, **settings)
