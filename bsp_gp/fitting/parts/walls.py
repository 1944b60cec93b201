"""A wall, floor or cushion that bodies bounce off, as a part of a hypothesis."""

import re
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import LawError
from bsp_gp.fitting.hypothesis import Numbered, Parameter
from bsp_gp.fitting.parts.constraints import extent_of, metres_of
from bsp_gp.language.formula import Number
from bsp_gp.language.parse import parse_formula
from bsp_gp.units import DIMENSIONLESS, METRE

_CALL = re.compile(r"\s*bounce\s*\((.*)\)\s*", re.DOTALL)
_SIDE = re.compile(r"\s*([xyz])_i\s*([<>])\s*([^\s<>,\[\]]+(?:\s*\[[^\[\]]*\])?)\s*")
TILTED = 0.05
"""Radians by which a wall is likely to stand askew of an axis."""
MOST_TILT = 0.5
HIGHEST = 1.5
"""Part of its speed that a body may keep: more than all where it is driven."""
START = 0.8


@dataclass(frozen=True)
class Wall(Numbered):
    """A plane that turns bodies back.

    Attributes
    ----------
    axis : int
        Across which it stands, but for a tilt.
    side : int
        1: bodies are where the coordinate is larger, -1: where it is smaller.
    numbers : tuple of Parameter
        Its coordinate, the part of the speed across it that bodies keep; where they move along it
        as well the part of that; in a plane its tilt, about the origin.
    """

    axis: int
    side: int
    n_dims: int
    numbers: tuple = ()
    kind = "wall"

    def normal_at(self, values):
        """Unit vectors away from it, (d, M), for values (k, M) of its numbers."""
        out = np.zeros((self.n_dims, values.shape[1]), dtype=values.dtype)
        out[self.axis] = self.side
        if len(self.numbers) > 3:
            c, s = np.cos(values[3]), np.sin(values[3])
            out = np.stack([c * out[0] - s * out[1], s * out[0] + c * out[1]])
        return out

    def kept_at(self, values):
        """Part of the velocity along it that bodies keep."""
        return values[2] if len(self.numbers) > 2 else 1.0

    def describe(self):
        return (
            f"bounce({'xyz'[self.axis]}_i {'>' if self.side > 0 else '<'} {', '.join(self.names)})"
        )


def places_of(dataset):
    """Where bodies that move were seen, (n, d), nan where they were not."""
    scenes = dataset.scenes
    return np.concatenate([s.positions[:, s.dynamic].reshape(-1, s.n_dims) for s in scenes])


def count_of(dataset):
    """How many numbers a wall has: along axes on which nothing moves it tells nothing."""
    places = places_of(dataset)
    n_moving = int((np.nanmax(places, axis=0) > np.nanmin(places, axis=0)).sum())
    return 2 if n_moving < 2 else 4 if dataset.n_dims == 2 else 3


def wall_of(names, axis, side, n_dims, values, extent):
    """A wall with numbers that begin at values, SI, of tracks of an extent in m.

    Parameters
    ----------
    names : sequence of str
        As many as `count_of` says.
    values : sequence of float
        The coordinate, and so on; missing ones are usual.
    """
    usual = (0.0, START, 1.0, 0.0)
    values = [*values, *usual[len(values) :]]
    numbers = (
        Parameter(names[0], "", METRE, start=values[0], prior=(values[0], extent)),
        Parameter(names[1], "", DIMENSIONLESS, 0.0, HIGHEST, values[1], (START, 0.5)),
        *(
            Parameter(name, "", DIMENSIONLESS, low, high, start, prior)
            for name, low, high, start, prior in zip(
                names[2:], (-1.0, -MOST_TILT), (HIGHEST, MOST_TILT), values[2:],
                ((1.0, 0.5), (0.0, TILTED)), strict=False,
            )
        ),
    )  # fmt: skip
    return Wall(axis, side, n_dims, numbers)


def _place(dataset, text, number, axis):
    """Where a wall is said to be, m."""
    try:
        return float(number) * metres_of(dataset, axis)
    except ValueError:
        pass
    try:
        place, why = parse_formula(number, {}, units=dataset.units), ""
    except LawError as error:
        place, why = None, f"; {error}"
    if not isinstance(place, Number) or place.type.unit != METRE:
        raise LawError(
            f"{text!r}: the place {number!r} is neither a name nor a length, as in "
            f"{axis}_i > 0.12 [m]{why}"
        )
    return place.value


def is_wall(text):
    """Whether a typed law is one."""
    return re.match(r"\s*bounce\s*\(", text) is not None


def read_wall(dataset, text):
    """Read ``bounce(y_i > h, e)``: bodies stay where that holds, and bounce off where it ends.

    Parameters
    ----------
    text : str
        The place is a name, or a number where the fit begins, ``0.12 [m]`` or in the unit of the
        data; then follow names of what is fitted as well: the parts of the speed across and along
        the wall that are kept, and its tilt in rad.

    Raises
    ------
    LawError
    """
    n_dims = dataset.n_dims
    parts = match[1].split(",") if (match := _CALL.fullmatch(text)) else [""]
    side, more = _SIDE.fullmatch(parts[0]), [part.strip() for part in parts[1:]]
    count = count_of(dataset)
    good = side and "xyz".index(side[1]) < n_dims and len(more) < count
    if not good or not all(map(str.isidentifier, more)):
        raise LawError(
            f"{text!r} must say where bodies stay and name what they keep, as in "
            f"bounce({'xyz'[n_dims - 1]}_i > h, e); at the most {count - 1} names follow the place"
        )
    axis, way = "xyz".index(side[1]), 1 if side[2] == ">" else -1
    start, name = way * float(np.nanmin(way * places_of(dataset)[:, axis])), side[3]
    if not name.isidentifier():
        start = _place(dataset, text, side[3], side[1])
        name = f"{side[1]}_wall"
    usual = (name, f"kept_{name}", f"along_{name}", f"tilt_{name}")
    names = (name, *more, *usual[1 + len(more) :])[:count]
    return wall_of(names, axis, way, n_dims, (start,), extent_of(dataset)[1])
