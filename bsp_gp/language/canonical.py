"""One identity for laws that are equal up to algebra, however they are written.

Two formulas are the same law if they take the same values, up to one factor, wherever they are
evaluated; points at random settle that to as many digits as are compared (Schwartz 1980).
"""

import hashlib
from functools import lru_cache

import numpy as np

from bsp_gp.language.formula import Constant, evaluate, factors, input_types_of, product
from bsp_gp.language.inputs import property_of

N_POINTS, N_DRAWS = 24, 4
"""Values of inputs, and of constants inside: a threshold lies beyond all values of some input."""
DIGITS = 9
"""Values that agree to this many digits are one."""


def canonical_key(formula, n_dims=2):
    """A key that equal laws share, of the same length for all laws.

    The value of a constant that multiplies the whole law does not matter, nor do the names of
    others, which are told apart by the order in which they appear.
    """
    above, below = factors(formula)
    inner = [
        c for part in (*above, *below) if not isinstance(part, Constant) for c in part.constants
    ]
    free = [p for p in above if not (isinstance(p, Constant) and p.name not in inner)]
    rest, points, mark = product(free), _points(formula, n_dims), hashlib.sha256()
    rng = np.random.default_rng(20)
    for _ in range(N_DRAWS if inner else 1):
        constants = dict(zip(dict.fromkeys(inner), rng.uniform(0.1, 1.9, len(inner)), strict=False))
        values = np.asarray(_ratio(rest, below, points, constants))
        values = np.broadcast_to(values, np.broadcast_shapes(values.shape, (N_POINTS, n_dims)))
        mark.update(_digits(np.where(np.isfinite(values), values, 0.0).ravel()).tobytes())
        mark.update(np.isfinite(values).tobytes())
    return mark.hexdigest()[:24]


def _digits(values):
    """Values in terms of the first that is not small, with as many digits as are compared."""
    size = np.abs(values).max()
    if not size > 0:
        return values + 0.0
    values = values / values[np.argmax(np.abs(values) > 1e-3 * size)]
    with np.errstate(divide="ignore"):
        step = 10.0 ** (np.floor(np.log10(np.abs(values))) - DIGITS + 1)
    values = np.where(values == 0, 0.0, np.round(values / np.where(step > 0, step, 1)) * step)
    return np.array([float(f"{x:.{DIGITS - 2}g}") for x in values.tolist()]) + 0.0


def _ratio(above, below, points, constants):
    value = evaluate(above, points, constants)
    for part in below:
        with np.errstate(all="ignore"):
            under = evaluate(part, points, constants)
            value = value / (under[..., None] if np.ndim(value) > np.ndim(under) else under)
    return value


def _points(formula, n_dims):
    """Random values of all inputs of a formula, the same for an input in every formula."""
    types = input_types_of(formula)
    return {name: _value(name, type_, n_dims) for name, type_ in types.items()}


class _Discs:
    """Bodies with an extent, as the conditions of contact ask for them."""

    def __init__(self, radius):
        self.radius = radius

    def collides(self, own, other, place):
        gap = np.square(np.asarray(own) - place).sum(axis=-1)
        return (gap < np.square(self.radius + other.radius)).astype(float)

    def is_on(self, own, other, place):
        gap = np.abs(np.asarray(own) - place)
        return (gap < other.radius[..., None]).all(axis=-1).astype(float)


@lru_cache(maxsize=4096)
def _value(name, type_, n_dims):
    known = property_of(name)
    key = "_".join(known) if known else name
    seed = int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "big")
    rng = np.random.default_rng(seed)
    if name in ("origin",):
        return np.zeros(n_dims)
    if name[:2] == "e_":
        return np.eye(n_dims)["xyz".index(name[2])]
    if name in ("up", "down"):
        return np.eye(n_dims)[1] * (1.0 if name == "up" else -1.0)
    if type_.shape == "shape":
        return _Discs(rng.uniform(0.3, 0.9, N_POINTS))
    if type_.shape in ("vector", "point"):
        return rng.uniform(-1.0, 1.0, (N_POINTS, n_dims))
    return rng.uniform(0.2, 2.5, N_POINTS)
