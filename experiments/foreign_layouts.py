"""Scenes without their foreign force: bodies, where they start, what is declared of them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bsp_gp.data.scene import Entity

G_EARTH, STIFFNESS = 9.81, 4.0
PULL = "G * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def unit(vectors):
    """Vectors (..., d) at unit length, 0 where they have none."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(size > 0, size, 1.0)


@dataclass(frozen=True)
class Layout:
    """A scene without its foreign force.

    Attributes
    ----------
    declared : callable
        ``declared(n_dims) -> tuple of str``.
    force : callable
        ``force(at)``: the declared force, N.
    start : callable
        ``start(rng, n_dims, crew) -> p, v`` of all bodies.
    crew : callable
        ``crew(rng) -> list of lists of Entity``; scenes take them in turn.
    sigma : float, metres
    span : float, s
    closest : float, metres
        Nearer than this bodies do not come under the declared force.
    has_up : bool
    """

    declared: Callable
    force: Callable
    start: Callable
    crew: Callable
    sigma: float
    span: float
    closest: float = 0.0
    has_up: bool = False


def _bodies(rng, n, low, high):
    """Bodies with a mass, a charge and a spin, evenly spread and in any order."""
    masses = rng.permutation(np.geomspace(low, high, n)) * rng.uniform(0.9, 1.1, n)
    charges, spins = rng.uniform(1.0, 3.0, n), rng.uniform(0.5, 3.0, n)
    return [
        Entity("abcdef"[k], properties={"mass": m, "charge": q, "spin": s})
        for k, (m, q, s) in enumerate(zip(masses, charges, spins, strict=True))
    ]


def _in_turn(low, high):
    """Four bodies, one or two of them in a scene."""

    def crew(rng):
        pool, n = _bodies(rng, 4, low, high), int(rng.integers(1, 3))
        return [[pool[(k + j) % 4] for j in range(n)] for k in range(4)]

    return crew


def _tied_crew(rng):
    post = Entity("post", is_static=True)
    return [[body, post] for body in _bodies(rng, 3, 0.3, 1.0)]


def _star_crew(rng):
    star = Entity("star", properties={"mass": 1000.0, "charge": 1.0, "spin": 1.0})
    return [[*_bodies(rng, 2, 1.0, 5.0), star]]


def _direction(rng, n_dims, n=1):
    return unit(rng.standard_normal((n, n_dims)))


def _thrown(rng, n_dims, crew):
    p = rng.uniform(-1, 1, (len(crew), n_dims)) + 3.0 * np.arange(len(crew))[:, None]
    v = rng.uniform(-5, 5, (len(crew), n_dims))
    v[:, -1] = rng.uniform(0, 6, len(crew))
    return p, v


def _sliding(rng, n_dims, crew):
    p = rng.uniform(-1, 1, (len(crew), n_dims)) + 2.0 * np.arange(len(crew))[:, None]
    return p, rng.uniform(0.4, 1.6, (len(crew), 1)) * _direction(rng, n_dims, len(crew))


def _swung(rng, n_dims, crew):
    p, v = np.zeros((2, n_dims)), np.zeros((2, n_dims))
    p[0] = rng.uniform(0.5, 1.0) * _direction(rng, n_dims)
    v[0] = rng.uniform(0.5, 1.5) * _direction(rng, n_dims)
    return p, v


def _orbiting(rng, n_dims, crew):
    p, v = np.zeros((3, n_dims)), np.zeros((3, n_dims))
    for k, r in enumerate(rng.permutation([rng.uniform(14, 18), rng.uniform(22, 30)])):
        out = _direction(rng, n_dims)[0]
        ahead = _direction(rng, n_dims)[0]
        ahead = unit(ahead - (ahead @ out) * out)
        p[k], v[k] = r * out, rng.uniform(0.8, 1.1) * np.sqrt(1000.0 / r) * ahead
    return p, v


def _ring(size, speed):
    """Three bodies about the middle, none faster than `speed`."""

    def start(rng, n_dims, crew):
        turn = rng.uniform(0, 2 * np.pi) + 2 * np.pi / 3 * np.arange(3)
        p = np.zeros((3, n_dims))
        p[:, :2] = size * rng.uniform(0.7, 1.3, (3, 1)) * np.stack([np.cos(turn), np.sin(turn)], 1)
        return p, rng.uniform(0.2, 1.0, (3, 1)) * speed * _direction(rng, n_dims, 3)

    return start


def weight(at):
    return -G_EARTH * at.m * np.eye(at.p.shape[1])[-1]


def _attraction(at):
    return (at.m[:, None] * at.m[None] * at.apart / at.distance**3).sum(axis=1)


def _repulsion(at):
    q = at.props["charge"]
    return -(q[:, None] * q[None] * at.apart / at.distance**3).sum(axis=1)


LAYOUTS = {
    "thrown": Layout(
        lambda d: ("9.81 [m/s^2] * m_i * down",), weight, _thrown, _in_turn(0.1, 0.6), 0.005, 1.0,
        has_up=True,
    ),
    "sliding": Layout(
        lambda d: (), lambda at: np.zeros_like(at.p), _sliding, _in_turn(0.2, 1.5), 0.002, 2.5,
    ),
    "tied": Layout(
        lambda d: ("k * (p_j - p_i)",), lambda at: STIFFNESS * at.to_post, _swung, _tied_crew,
        0.003, 5.0,
    ),
    "orbiting": Layout(
        lambda d: (PULL,), _attraction, _orbiting, _star_crew, 0.01, 8.0, closest=4.0,
    ),
    "trio": Layout(
        lambda d: (PULL,), _attraction, _ring(10.0, 2.0), lambda rng: [_bodies(rng, 3, 20.0, 80.0)],
        0.01, 4.0, closest=4.0,
    ),
    "charged": Layout(
        lambda d: ("k * charge_i * charge_j / norm(p_i - p_j)^2 * normalize(p_i - p_j)",),
        _repulsion, _ring(2.5, 0.8), lambda rng: [_bodies(rng, 3, 0.8, 2.5)], 0.003, 3.0,
        closest=1.0,
    ),
}  # fmt: skip
