"""What a made-up scene starts from: bodies with places and velocities, some of them unseen."""

import math
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.scene import Entity
from bsp_gp.errors import SettingsError


def _known(properties):
    return {k: float(v) for k, v in properties.items() if v is not None}


def disc(name, radius, mass, **properties):
    """A body that moves: a disc with a mass in kg and further properties."""
    properties = _known({"mass": mass, **properties})
    return Entity(name, "disc", radius=float(radius), properties=properties)


def point(name, **properties):
    """A place that does not move, such as the anchor of a spring."""
    return Entity(name, "point", is_static=True, properties=_known(properties))


def wall(name, width, height, **properties):
    """A rectangle that discs bounce off; it does not move."""
    return _rectangle(name, "rect_wall", width, height, properties)


def mat(name, width, height, friction, **properties):
    """A rectangle that discs slide over, with a friction coefficient."""
    return _rectangle(name, "rect_mat", width, height, {"friction": friction, **properties})


def _rectangle(name, shape, width, height, properties):
    size = {"width": float(width), "height": float(height)}
    return Entity(name, shape, **size, is_static=True, properties=_known(properties))


@dataclass(frozen=True, eq=False)
class World:
    """One scene before it moves.

    Attributes
    ----------
    entities : tuple of Entity, length N
        Moving ones need a known mass.
    positions, velocities : ndarray, shape (N, 2), metres and metres/second
    hidden : frozenset of str
        Names of entities that act but are never seen in the data.
    """

    entities: tuple[Entity, ...]
    positions: np.ndarray
    velocities: np.ndarray
    hidden: frozenset = frozenset()

    def __post_init__(self):
        object.__setattr__(self, "entities", tuple(self.entities))
        for attribute in ("positions", "velocities"):
            array = np.array(getattr(self, attribute), dtype=float)
            if array.shape != (len(self.entities), 2) or not np.all(np.isfinite(array)):
                raise SettingsError(
                    f"{attribute} of a world must be finite, of shape ({len(self.entities)}, 2), "
                    f"got shape {array.shape}"
                )
            array.setflags(write=False)
            object.__setattr__(self, attribute, array)
        for entity in self.entities:
            if not entity.is_static and not entity.mass > 0:
                raise SettingsError(f"body {entity.name!r} moves, so it needs a mass")
        names = {entity.name for entity in self.entities}
        if len(names) < len(self.entities):
            raise SettingsError("two entities of a world have one name")
        if not self.hidden <= names:
            raise SettingsError(f"hidden names no entity: {sorted(self.hidden - names)}")

    @property
    def seen(self):
        """Indices of the entities that the data show."""
        return np.array([k for k, e in enumerate(self.entities) if e.name not in self.hidden])

    def only(self, indices):
        """The same world with these entities alone."""
        entities = [self.entities[k] for k in indices]
        hidden = self.hidden & {entity.name for entity in entities}
        return World(entities, self.positions[indices], self.velocities[indices], hidden)

    def joined_by(self, entity, position, velocity=(0.0, 0.0), *, is_hidden=False):
        """The same world with one more entity."""
        return World(
            (*self.entities, entity), np.vstack([self.positions, [position]]),
            np.vstack([self.velocities, [velocity]]),
            self.hidden | ({entity.name} if is_hidden else frozenset()),
        )  # fmt: skip

    def with_property(self, name, values):
        """The same world with a further property of its moving bodies, in order."""
        values = iter(values)
        entities = [
            e if e.is_static else replace(e, properties={**e.properties, name: float(next(values))})
            for e in self.entities
        ]
        return World(entities, self.positions, self.velocities, self.hidden)


class Ensemble:
    """The entities of several worlds of equal size as arrays.

    Attributes
    ----------
    mass : ndarray, shape (S, N), kg
        1 where an entity does not move and has none.
    is_static : ndarray of bool, shape (S, N)
    size : ndarray, shape (S, N, 2), metres
        Width and height of rectangles, nan otherwise.
    is_mat : ndarray of bool, shape (S, N)
    radius : ndarray, shape (S, N), metres
        nan where an entity has none.
    """

    def __init__(self, worlds):
        self.worlds = tuple(worlds)
        self._properties = {}
        rows = [world.entities for world in self.worlds]
        self.is_static = np.array([[e.is_static for e in row] for row in rows])
        self.mass = np.where(self.is_static, 1.0, self.property("mass"))
        self.size = np.array([[(e.width, e.height) for e in row] for row in rows])
        self.is_mat = np.array([[e.shape == "rect_mat" for e in row] for row in rows])
        self.radius = np.array([[e.radius for e in row] for row in rows], dtype=float)

    def property(self, name):
        """Values of a property, shape (S, N); 0 where an entity has none."""
        if name not in self._properties:
            values = [
                [e.properties.get(name, math.nan) for e in world.entities] for world in self.worlds
            ]
            self._properties[name] = np.nan_to_num(np.array(values, dtype=float))
        return self._properties[name]


@dataclass(frozen=True, eq=False)
class States:
    """How worlds of equal size moved.

    Attributes
    ----------
    times : ndarray, shape (T,), seconds
    positions, velocities : ndarray, shape (S, T, N, 2), metres and metres/second
    touched : ndarray of bool, shape (S, T - 1, N)
        Whether a body was in contact within the interval that ends with the next frame.
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    touched: np.ndarray
