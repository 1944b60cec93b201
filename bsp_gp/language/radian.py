"""Sines of places that are angles, as the data of a sensor on an axle have them.

There angles stand in the place of places, radians in that of metres: the sine of one is that of the
number of its radians.
"""

from bsp_gp.language.formula import Call, Number
from bsp_gp.units import METRE

RADIAN = Number(1.0, METRE, "1 [rad]")
OF_ANGLES = frozenset(("sin", "cos"))
"""Functions that take angles."""


def in_radians(argument):
    """What a function takes of an angle."""
    return Call("div", argument, RADIAN)
