"""Sines of places that are angles, as the data of a sensor on an axle have them.

There angles stand in the place of places, radians in that of metres: the sine of one is that of the
number of its radians, and nobody writes that division.
"""

from bsp_gp.language.formula import Call, Number
from bsp_gp.units import Unit

RADIAN = Number(1.0, Unit.of(m=1), "1 [rad]")
OF_ANGLES = frozenset(("sin", "cos"))
"""Functions that take angles."""


def in_radians(argument):
    """What a function takes of an angle."""
    return Call("div", argument, RADIAN)


def as_angle(argument):
    """The angle of which a function takes the radians; the argument itself of another one."""
    if isinstance(argument, Call) and argument.operator == "div":
        angle, by = argument.args
        if isinstance(by, Number) and by.text == RADIAN.text:  # one metre is as much, and no angle
            return angle
    return argument
