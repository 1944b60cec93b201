"""Places that a sensor shows in a unit of its own, such as volts."""

from dataclasses import replace

from bsp_gp.data.conversion import is_unit, unit_of
from bsp_gp.data.scene import CHECK
from bsp_gp.data.table import less
from bsp_gp.errors import in_python
from bsp_gp.units import ACCELERATION, DIMENSIONLESS, Unit

_LENGTH, _TIME = Unit.of(m=1), Unit.of(s=1)
_SPEED, _RATE = _LENGTH / _TIME, Unit.of(s=-1)
_OWN = {_SPEED: "v", ACCELERATION: "a"}
"""Before an axis, of what is no place and has a name of its own."""


def without_other_units(table, declaration):
    """The table with places that the caller named and whose unit is no length as plain numbers.

    Raises
    ------
    DataError
        If such a place is a velocity or an acceleration.
    """
    if "length" in declaration.units:
        return table
    out = {}
    for axis in "xyz":
        unit = table.units.get(axis, "")
        is_said = any(name == axis or name.endswith(f"_{axis}") for name in table.renamed)
        if axis in table.frame and is_said and axis not in declaration.units and is_unit(unit):
            out |= {axis: unit} if _is_other(table, axis, unit) else {}
    if not out:
        return table
    theirs = [text for name, text in table.theirs.items() if name.partition(" of ")[0] in out]
    axis, unit = next(iter(out.items()))
    note = in_python(
        f"{CHECK}{', '.join(map(repr, theirs))}: {unit} is no unit of length; the numbers are "
        f"read as places that are not calibrated; --units {axis}='0.5 mm' would say what 1 {unit} "
        "stands for"
    )
    return replace(table, units=less(table.units, out)).noted(note)


def _is_other(table, axis, text):
    """Whether a unit is none of a place, an angle or a time: a sensor shows a place in it."""
    unit = unit_of(text)
    if unit in _OWN:
        heading = table.heading(axis)
        what = "a velocity" if unit == _SPEED else "an acceleration"
        table.fail(
            f"{heading!r} is named as a place, and {text} is the unit of {what}", axis,
            f'name it as that: --columns {_OWN[unit]}{axis}="{heading}"',
        )  # fmt: skip
    return unit not in (_LENGTH, _TIME, _RATE, DIMENSIONLESS)
