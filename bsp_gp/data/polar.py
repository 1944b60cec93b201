"""Tables that give a distance and an angle in the place of x and y, as of double stars."""

from dataclasses import replace

import numpy as np

from bsp_gp.data.conversion import ratio_of
from bsp_gp.data.table import GAP, less
from bsp_gp.errors import UnitError
from bsp_gp.units import parse_unit

POLAR_COLUMNS = ("distance", "angle", "sdistance", "sangle")
POLAR_ALIASES = {
    "separation": "distance", "position_angle": "angle", "sseparation": "sdistance",
    "sposition_angle": "sangle",
}  # fmt: skip
"""The same as those who measure double stars call them."""


def is_polar(columns):
    """Whether a table has a distance and an angle, and neither x nor y."""
    columns = set(columns)
    return {"distance", "angle"} <= columns and not {"x", "y"} & columns


def from_polar(table, declaration):
    """Put x and y in the place of a distance and an angle.

    An angle counts modulo a turn. Standard errors are carried over axis by axis; what they have in
    common is left out.

    Parameters
    ----------
    table : Table
    declaration : Declaration
        Its ``angle_from`` is the axis on which the angle is 0 (x), its ``angle_turns`` the sense in
        which it counts (counter-clockwise). Position angles, from north through east, run clockwise
        from y where x points to the east.

    Returns
    -------
    table : Table
        With columns x, y, and sx, sy where errors are given.
    declaration : Declaration
        With units of these.

    Raises
    ------
    DataError
        Without a unit of the angle; for a distance below zero, a cell that is empty beside one that
        is not, or an error of only one of the two.
    """
    if not is_polar(table.frame.columns):
        return table, declaration
    found = {**table.units, **declaration.units}
    angle = table.numbers("angle") * _scale_of_angle(table, found, "angle")
    distance = table.numbers("distance")
    _check(table, distance < 0, "distance", "a distance must not be negative", distance)
    half = np.isnan(distance) != np.isnan(angle)
    _check(table, half, "angle", "a distance without an angle, or an angle without a distance")
    angle = -angle if declaration.angle_turns == "clockwise" else angle
    angle = angle + np.pi / 2 if declaration.angle_from == "y" else angle
    cosine, sine = np.cos(angle), np.sin(angle)
    new = {"x": distance * cosine, "y": distance * sine}
    if {"sdistance", "sangle"} & set(table.columns):
        table.require(["sdistance", "sangle"])
        key = "sangle" if "sangle" in found else "angle"
        across = distance * table.numbers("sangle") * _scale_of_angle(table, found, key)
        along = table.numbers("sdistance") * _ratio_of_errors(table, found)
        for name, error in (("sdistance", along), ("sangle", across)):
            _check(table, error < 0, name, "a standard error must not be negative", error)
        new["sx"] = np.hypot(cosine * along, sine * across)
        new["sy"] = np.hypot(sine * along, cosine * across)

    def of_places(texts):
        """Units of x, y and their errors: that of the distance."""
        return dict.fromkeys(new, texts["distance"]) if "distance" in texts else {}

    note = "distance and angle were read as x and y"
    note += ", with the errors of each axis by itself" if "sx" in new else ""
    made = table.instead(POLAR_COLUMNS, new, of_places(table.units)).noted(note)
    units = less(declaration.units, POLAR_COLUMNS) | of_places(declaration.units)
    return made, replace(declaration, units=units)


def _check(table, bad, column, problem, values=None):
    if bad.any():
        k = int(bad.argmax())
        got = "" if values is None else f", got {values[k]:g}"
        table.fail(problem + got, column, GAP, row=k)


def _ratio_of_errors(table, units):
    """What errors of the distance are multiplied by to be in its unit."""
    own, of = units.get("sdistance"), units.get("distance", units.get("length"))
    if own is None or of is None:
        return 1.0
    ratio = ratio_of(own, of)
    if ratio is None:
        table.fail(
            f"errors of the distance are in {own!r}, the distance is in {of!r}", "sdistance",
            "give both in units of one kind",
        )  # fmt: skip
    return ratio


def _scale_of_angle(table, units, column):
    remedy = 'give angle = "deg" in [units] (or "rad", "turn", "arcmin")'
    if column not in units:
        table.fail("the angle has no unit", column, remedy)
    return scale_of_angle(table, column, units[column], remedy)


def scale_of_angle(table, column, text, remedy):
    """Radians of a unit of angles; DataError about the column if it is none."""
    try:
        scale, unit = parse_unit(text)
    except UnitError as error:
        table.fail(str(error), column, remedy)
    if not unit.is_dimensionless:
        table.fail(f"{text!r} is no unit of an angle", column, remedy)
    return scale
