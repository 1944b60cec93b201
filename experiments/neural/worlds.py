"""Scenes as padded arrays for the networks, and what of a one-step prediction there is to learn.

In a world the bodies that move come first, then walls and mats, then padding. What is to be
predicted is the *excess* of a step: next position minus this one minus dt times the
finite-difference velocity, which is dt^2 times the acceleration. It is formed in double
precision, so that single precision is enough for the networks.
"""

from dataclasses import dataclass, fields

import numpy as np

WALL, MAT = "rect_wall", "rect_mat"


@dataclass(frozen=True)
class Bodies:
    """Properties of bodies, leading axes as wanted, then N; masks are 1.0 and 0.0."""

    mass: np.ndarray
    friction: np.ndarray
    shape: np.ndarray  # (..., N, 4): the paper's code of the kind, then two sizes
    is_wall: np.ndarray
    is_wide: np.ndarray
    moves: np.ndarray
    exists: np.ndarray

    def of(self, scenes):
        """The bodies of some scenes, by index."""
        return Bodies(*(getattr(self, field.name)[scenes] for field in fields(self)))

    def tree(self):
        """As a dict of arrays, for jax."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class Worlds:
    """S scenes padded to N bodies, of which the first R may move, and T instants.

    Attributes
    ----------
    bodies : Bodies of arrays (S, N)
    positions : ndarray, shape (S, T, N, 2), metres
    weights : ndarray, shape (S, T - 2, R)
        Of the one-step errors in the paper's nRMSE: they sum to the share of moving bodies.
    n_bodies : ndarray of int, shape (S,)
        Without padding.
    n_moving : int
        R, the same or larger than in any scene.
    dt : float, seconds
    """

    bodies: Bodies
    positions: np.ndarray
    weights: np.ndarray
    n_bodies: np.ndarray
    n_moving: int
    dt: float

    @property
    def n_scenes(self):
        return len(self.positions)


@dataclass(frozen=True)
class Rows:
    """One-step predictions to make: B instants of any scenes.

    Attributes
    ----------
    bodies : Bodies of arrays (B, N)
    p, v : ndarray, shape (B, N, 2), metres, metres/second
    excess : ndarray, shape (B, R, 2), metres
    weights : ndarray, shape (B, R)
    dt : float
    """

    bodies: Bodies
    p: np.ndarray
    v: np.ndarray
    excess: np.ndarray
    weights: np.ndarray
    dt: float

    def __len__(self):
        return len(self.p)

    def some(self, index):
        """Some of the rows, their weights scaled to the sum of all."""
        weights = self.weights[index]
        weights = weights * (self.weights.sum() / weights.sum())
        rows = (self.p[index], self.v[index], self.excess[index])
        return Rows(self.bodies.of(index), *rows, weights, self.dt)

    def tree(self):
        """As a dict of single-precision arrays, for jax."""
        mine = {"p": self.p, "v": self.v, "excess": self.excess, "weights": self.weights,
                **self.bodies.tree()}  # fmt: skip
        return {name: np.asarray(value, np.float32) for name, value in mine.items()}


def load_worlds(scenes, n_bodies=None, n_moving=None):
    """Stack scenes of equal length and time step.

    Parameters
    ----------
    scenes : sequence of bsp_gp.data.scene.Scene
    n_bodies, n_moving : int, optional
        To pad to; by default the most of any scene.

    Returns
    -------
    Worlds
    """
    orders = [sorted(range(len(s.entities)), key=lambda k, s=s: s.entities[k].is_static)
              for s in scenes]  # fmt: skip
    n = n_bodies or max(map(len, orders))
    r = n_moving or max(sum(not e.is_static for e in s.entities) for s in scenes)
    n_times = len(scenes[0].times)
    steps = np.concatenate([np.diff(s.times) for s in scenes])
    if any(len(s.times) != n_times for s in scenes) or np.ptp(steps) > 1e-9 * steps[0]:
        raise ValueError("the networks want scenes of equal length and time step")
    positions = np.zeros((len(scenes), n_times, n, 2))
    for k, (scene, order) in enumerate(zip(scenes, orders, strict=True)):
        positions[k, :, : len(order)] = scene.positions[:, order]
    bodies = [
        _padded([s.entities[k] for k in order], n) for s, order in zip(scenes, orders, strict=True)
    ]
    bodies = Bodies(*(np.array([getattr(b, f.name) for b in bodies]) for f in fields(Bodies)))
    count = np.array([len(order) for order in orders])
    weights = np.zeros((len(scenes), n_times - 2, r))
    weights += (bodies.moves[:, :r] / (count[:, None] * (n_times - 2) * len(scenes)))[:, None]
    return Worlds(bodies, positions, weights, count, r, float(steps[0]))


def _padded(entities, n):
    """Properties of the bodies of a scene; padding has mass 1 and does not exist."""
    blank = n - len(entities)
    column = {
        "mass": [e.mass for e in entities] + [1.0] * blank,
        "friction": [e.properties.get("friction", 0.0) for e in entities] + [0.0] * blank,
        "shape": [_shape(e) for e in entities] + [[0.0] * 4] * blank,
        "is_wall": [e.shape == WALL for e in entities] + [False] * blank,
        "is_wide": [e.shape == WALL and e.width > e.height for e in entities] + [False] * blank,
        "moves": [not e.is_static for e in entities] + [False] * blank,
        "exists": [True] * len(entities) + [False] * blank,
    }
    return Bodies(**{name: np.array(values, float) for name, values in column.items()})


def _shape(entity):
    """Two digits that tell disc, wall and mat apart, and the sizes, as in the paper's code."""
    if entity.shape in (WALL, MAT):
        return [float(entity.shape == MAT), float(entity.shape == WALL), entity.width,
                entity.height]  # fmt: skip
    return [0.0, 0.0, entity.radius, entity.radius]


def rows_of(worlds):
    """All one-step predictions of scenes, scene by scene."""
    p = worlds.positions
    v = (p[:, 1:-1] - p[:, :-2]) / worlds.dt
    excess = (p[:, 2:] - 2 * p[:, 1:-1] + p[:, :-2])[:, :, : worlds.n_moving]
    scene = np.repeat(np.arange(worlds.n_scenes), p.shape[1] - 2)

    def flat(values):
        return values.reshape(-1, *values.shape[2:])

    return Rows(worlds.bodies.of(scene), flat(p[:, 1:-1]), flat(v), flat(excess),
                flat(worlds.weights), worlds.dt)  # fmt: skip
