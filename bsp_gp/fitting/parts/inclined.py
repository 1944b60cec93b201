"""A plane of motion that is inclined to the picture: what is seen of it is foreshortened."""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.hypothesis import Parameter, Valued
from bsp_gp.units import DIMENSIONLESS

STEEPEST = 1.56
"""Inclination up to which a plane is no line, rad."""


@dataclass(frozen=True)
class Inclined(Valued):
    """Places in a plane through the origin, seen from afar at an angle.

    ``X = x + (1 / cos i - 1) n (n . x)`` undoes it, where n is across the line of nodes. The plane
    and its mirror image look alike.

    Attributes
    ----------
    values : tuple of float, rad
        Where a fit begins: the inclination i, and the angle of the line of nodes from x to y.
    """

    values: tuple = (0.0, 0.0)
    names = angles = ("inclination", "node")
    code = "inclined"
    kind = "instrument"

    @property
    def own(self):
        return dict(zip(self.names, self.values, strict=True))

    @property
    def parameters(self):
        """The two angles; of a plane that lies in the picture, none would be known."""
        bounds = ((0.0, STEEPEST), (-math.inf, math.inf))
        return tuple(
            Parameter(name, "", DIMENSIONLESS, low, high, float(value))
            for name, (low, high), value in zip(self.names, bounds, self.values, strict=True)
        )

    def undo(self, g, place, time, is_driven):
        """Place in its plane, and the time, nodes of a graph."""
        inclination, node = (g.constant(name) for name in self.names)
        across = (g.neg(g.call("sin", node)), g.call("cos", node))
        growth = g.sub(g.div(g.one, g.call("cos", inclination)), g.one)
        by = g.mul(growth, g.dot(across, place))
        return tuple(g.add(x, g.mul(by, n)) for x, n in zip(place, across, strict=True)), time

    def matrix(self, values):
        """What makes places in the plane of what is seen at some values, (2, 2)."""
        inclination, node = (values[name] for name in self.names)
        across = np.array([-math.sin(node), math.cos(node)])
        return np.eye(2) + (1 / math.cos(inclination) - 1) * np.outer(across, across)

    def describe(self):
        return "x = X cos(inclination) across the line of nodes"


def stretched(law):
    """What makes places in the plane of a motion of what is seen, (2, 2); None: they are seen."""
    part = next((p for p in law.frame if isinstance(p, Inclined)), None)
    return None if part is None else part.matrix(law.constants)
