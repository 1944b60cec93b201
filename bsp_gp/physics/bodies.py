"""Scenes of one build as stacked arrays, and what they supply to a law.

Scenes with the same number of entities, the same receivers and the same dimensions are stacked
into a `Batch`; leading axes of arrays are ``[time, scene, entity, xy(z)]``, shorter scenes are
padded with nan. `PairInputs` and `FieldInputs` look up what a formula names, computed on demand.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import LawError
from bsp_gp.language.inputs import DIRECTIONS, input_types, property_of
from bsp_gp.language.operators import Type
from bsp_gp.physics.geometry import Shapes, contact_point
from bsp_gp.physics.series import Series
from bsp_gp.units import ANGLES, DIMENSIONLESS, KILOGRAM


@dataclass(frozen=True, eq=False)
class Bodies:
    """What the entities of S like-built scenes are.

    Attributes
    ----------
    names : tuple of tuple of str, S x N
    receivers : ndarray of int, shape (R,)
        Indices of the dynamic entities.
    properties : dict of str to ndarray
        Column -> shape (S, N), or (S, N, d) for vectors; nan = unknown.
    shapes : Shapes of arrays (S, N)
    scenes : tuple of str
        Their names; empty = of no matter.
    series : Series
        Measured inputs.
    """

    names: tuple
    receivers: np.ndarray
    properties: dict
    shapes: Shapes
    n_dims: int
    up: str | None = None
    scenes: tuple = ()
    series: Series = field(default_factory=lambda: Series({}))
    others: np.ndarray = field(init=False)

    def __post_init__(self):
        n = len(self.names[0])
        others = [[j for j in range(n) if j != i] for i in self.receivers]
        object.__setattr__(self, "others", np.array(others, dtype=int).reshape(len(others), n - 1))

    @property
    def n_scenes(self):
        return len(self.names)

    @property
    def receiver_names(self):
        """Names of the receivers, S tuples of R."""
        return tuple(tuple(names[i] for i in self.receivers) for names in self.names)

    def column(self, name):
        """A property as an array (S, N) or (S, N, d); nan where no entity knows it."""
        if name in self.properties:
            return self.properties[name]
        return np.full((self.n_scenes, len(self.names[0])), np.nan)

    def direction(self, name):
        """Unit vector of a lab axis, shape (d,)."""
        vector = np.zeros(self.n_dims)
        if name.startswith("e_"):
            vector["xyz".index(name[2])] = 1.0
            return vector
        if self.up is None:
            raise LawError(f"{name!r} needs a declared vertical axis ([axes] up)")
        sign = (-1.0 if self.up.startswith("-") else 1.0) * (-1.0 if name == "down" else 1.0)
        vector["xyz".index(self.up[-1])] = sign
        return vector


def under(law, bodies):
    """The bodies with their measured inputs as late as a law with values has them."""
    series = bodies.series.under(law)
    return bodies if series is bodies.series else replace(bodies, series=series)


def subset(bodies, scenes):
    """The bodies of some of the scenes, by their numbers (S,)."""
    return replace(
        bodies,
        names=tuple(bodies.names[s] for s in scenes),
        properties={name: values[scenes] for name, values in bodies.properties.items()},
        shapes=bodies.shapes[scenes],
        scenes=tuple(bodies.scenes[s] for s in scenes) if bodies.scenes else (),
    )


class _Inputs(Mapping):
    """Base of the two lookups; values are computed when first asked for."""

    def __init__(self, bodies, positions, velocities, times):
        self.bodies = bodies
        self.positions = positions
        self.velocities = velocities
        self.times = times
        self._values = {}

    def __getitem__(self, name):
        if name not in self._values:
            self._values[name] = self._compute(name)
        return self._values[name]

    def __iter__(self):
        return iter(self._values)

    def __len__(self):
        return len(self._values)

    def _compute(self, name):
        if name in DIRECTIONS:
            return self.bodies.direction(name)
        if name == "origin":
            return np.zeros(self.bodies.n_dims)
        if name in ("p_i", "p_j", "v_i", "v_j"):
            return self._state(self.positions if name[0] == "p" else self.velocities, name[-1])
        if name in ("s_i", "s_j"):
            return self.bodies.shapes.map(lambda values: self._property(values, name[-1]))
        if name == "t":
            return np.asarray(self.times)[(...,) + (None,) * self.tail]
        if name == "p_c":
            return contact_point(self["p_i"], self["s_j"], self["p_j"])
        if name in self.bodies.series.names:
            return self._series(name)
        known = property_of(name)
        if known is None:
            raise LawError(f"unknown input {name!r}")
        return self._property(self.bodies.column(known[0]), known[1])

    def _series(self, name):
        """A measured input of the receivers, the axis of sources being added behind them."""
        bodies = self.bodies
        value = bodies.series.at(name, bodies.scenes, bodies.receiver_names, self.times)
        at = np.ndim(self.times) + 1
        return value if self.tail == 1 else np.expand_dims(value, at)


class PairInputs(_Inputs):
    """Inputs of every receiver and source, shape (..., S, R, N - 1) and a trailing d for vectors.

    States have the shape (..., S, N, d), times (..., S).
    """

    tail = 2

    def _state(self, values, role):
        if role == "i":
            return values.take(self.bodies.receivers, axis=-2)[..., None, :]
        return values.take(self.bodies.others, axis=-2)

    def _property(self, values, role):
        if role == "i":
            return values[:, self.bodies.receivers, None]
        return values[:, self.bodies.others]


class FieldInputs(_Inputs):
    """Inputs of every receiver alone, shape (..., S, R) and a trailing d for vectors."""

    tail = 1

    def _state(self, values, role):
        self._no_source(role)
        return values.take(self.bodies.receivers, axis=-2)

    def _property(self, values, role):
        self._no_source(role)
        return values[:, self.bodies.receivers]

    def _no_source(self, role):
        if role == "j":
            raise LawError("a field law acts on i alone and cannot name a source j")


def law_inputs(kind, bodies, positions, velocities, times):
    """The lookup for a law of this kind ("pair" or "field")."""
    lookup = PairInputs if kind == "pair" else FieldInputs
    return lookup(bodies, positions, velocities, times)


@dataclass(frozen=True, eq=False)
class Batch:
    """Like-built scenes stacked.

    Attributes
    ----------
    times : ndarray, shape (T, S), padded with nan
    positions : ndarray, shape (T, S, N, d)
    velocities : ndarray, shape (T, S, N, d) or None
        Measured ones only.
    sigma : ndarray, shape (T, S, N, d) or None
        Quoted standard deviations of the positions; nan where a point quotes none.
    """

    scenes: tuple
    bodies: Bodies
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None
    sigma: np.ndarray | None = None

    @property
    def is_still(self):
        """Which entities are no receivers and stay where they are, in all scenes, (N,)."""
        p = self.positions
        static = np.array([i not in set(self.bodies.receivers) for i in range(p.shape[2])])
        return static & np.all((p == p[:1]) | np.isnan(p), axis=(0, 1, 3))


def stack(scenes, up=None, velocity="ignore"):
    """Group scenes by build and stack each group; the order of scenes is kept within a group.

    Parameters
    ----------
    velocity : str
        "measured" keeps the scenes' velocities.
    """
    groups = {}
    for scene in scenes:
        measured = velocity == "measured" and scene.velocities is not None
        key = (len(scene.entities), tuple(scene.dynamic), scene.n_dims, measured)
        groups.setdefault(key, []).append(scene)
    return [_batch(tuple(group), key, up) for key, group in groups.items()]


def _batch(scenes, key, up):
    n_entities, receivers, n_dims, measured = key
    n_times = max(len(scene.times) for scene in scenes)
    times = np.full((n_times, len(scenes)), np.nan)
    positions = np.full((n_times, len(scenes), n_entities, n_dims), np.nan)
    velocities = np.full_like(positions, np.nan) if measured else None
    is_quoted = any(scene.sigma is not None for scene in scenes)
    sigma = np.full_like(positions, np.nan) if is_quoted else None
    for s, scene in enumerate(scenes):
        times[: len(scene.times), s] = scene.times
        positions[: len(scene.times), s] = scene.positions
        if measured:
            velocities[: len(scene.times), s] = scene.velocities
        if scene.sigma is not None:
            sigma[: len(scene.times), s] = scene.sigma
    shapes = [Shapes.of(scene.entities) for scene in scenes]
    fields = ("code", "radius", "width", "height")
    stacked = Shapes(*(np.stack([getattr(s, name) for s in shapes]) for name in fields))
    bodies = Bodies(
        names=tuple(scene.names for scene in scenes),
        receivers=np.array(receivers, dtype=int),
        properties=_columns(scenes, stacked, n_dims),
        shapes=stacked,
        n_dims=n_dims,
        up=up,
        scenes=tuple(scene.name for scene in scenes),
        series=Series.of(scenes),
    )
    return Batch(scenes, bodies, times, positions, velocities, sigma)


def _columns(scenes, shapes, n_dims):
    columns = {}
    names = {name for scene in scenes for e in scene.entities for name in e.properties}
    for name in sorted(names):
        is_vector = any(
            np.ndim(e.properties.get(name, 0.0)) for scene in scenes for e in scene.entities
        )
        blank = (np.nan,) * n_dims if is_vector else np.nan
        columns[name] = np.array(
            [[e.properties.get(name, blank) for e in scene.entities] for scene in scenes],
            dtype=float,
        )
    columns.setdefault("radius", shapes.radius)
    return columns


def input_types_of(dataset):
    """Types of the measured inputs of a data set, by name."""
    found = {name: v.ndim for scene in dataset.scenes for name, v in scene.inputs.items()}
    units = dataset.property_units
    return {
        name: Type("vector" if n == 3 else "scalar", units.get(name, DIMENSIONLESS))
        for name, n in found.items()
    }


def angles_of(dataset):
    """Names of measured inputs that are angles, as of a compass or of a camera."""
    units = dataset.units.declared
    return tuple(
        name for name, type_ in input_types_of(dataset).items()
        if type_.shape == "scalar" and str(units.get(name, "")).strip().lower() in ANGLES
    )  # fmt: skip


def signed_of(dataset):
    """Names of measured inputs that are numbers both above and below zero: spins, currents."""
    return tuple(
        name for name, type_ in input_types_of(dataset).items()
        if type_.shape == "scalar" and {-1.0, 1.0} <= {
            sign for scene in dataset.scenes for sign in np.unique(np.sign(scene.inputs[name]))
        }
    )  # fmt: skip


def dataset_types(dataset):
    """Types of the inputs that a data set supplies, for parsing laws and masking grammars."""
    present = set(dataset.property_names)
    entities = [entity for scene in dataset.scenes for entity in scene.entities]
    if any(np.isfinite(entity.radius) for entity in entities):
        present.add("radius")
    dynamic = {name for e in entities if not e.is_static for name in e.properties}
    vectors = {name for e in entities for name, value in e.properties.items() if np.ndim(value)}
    types = input_types(
        {name: dataset.property_units.get(name) for name in sorted(present | (dynamic & {"mass"}))},
        vectors=vectors,
        n_dims=dataset.n_dims,
        up=dataset.up,
        has_contact=any(entity.shape != "point" for entity in entities),
    )
    if all(len(scene.entities) == 1 for scene in dataset.scenes):
        for name in [n for n in types if n.endswith("_j") or n in ("p_c", "s_i")]:
            del types[name]
    types |= input_types_of(dataset)
    # A bare mass is always speakable: accelerations are what is fitted, and m_i may cancel.
    for name in ("m_i", "mass_i"):
        types.setdefault(name, input_types({"mass": KILOGRAM})[name])
    return types
