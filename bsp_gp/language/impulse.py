"""The impulse: a brief push of unit integral, one function to write and two thresholds within."""

from bsp_gp.errors import UnitError
from bsp_gp.language.formula import Call, Number
from bsp_gp.units import SECOND


def impulse(since, duration):
    """``impulse(since, duration)``: 1 / duration while |since| < duration / 2, else nothing, 1/s.

    Times a velocity and the mass it is a kick, a jump of the velocity by that much.

    Raises
    ------
    UnitError
        If the duration is no number of seconds above zero.
    """
    is_time = isinstance(duration, Number) and duration.type.unit == SECOND
    if not (is_time and duration.value > 0):
        raise UnitError("impulse(when, duration) takes a duration in s above zero, a number")
    half, second = Number(duration.value / 2, SECOND), Number(1.0, SECOND)
    edges = [Call("sign", Call("div", Call(way, since, half), second)) for way in ("add", "sub")]
    return Call("div", Call("sub", *edges), Number(2 * duration.value, SECOND))


def impulse_of(node):
    """What an impulse was made of, (since, duration in s); None if a node is none."""
    match node:
        case Call(
            operator="div",
            args=(
                Call(
                    operator="sub",
                    args=(Call(operator="sign", args=(Call(args=(Call(args=(since, _)), _)),)), _),
                ),
                Number(value=twice),
            ),
        ):
            duration = Number(twice / 2, SECOND)
            is_one = twice > 0 and impulse(since, duration) == node
            return (since, duration.value) if is_one else None
    return None
