"""Units by whatever names they are declared or written, under our names of the columns.

Angles may be declared in counts of an encoder, and places be shown in what a sensor writes: volts.
"""

import math
import re
from dataclasses import replace

from bsp_gp.data.conversion import COLUMN_KINDS, KINDS, LENGTH, TIME, is_unit, ratio_of, unit_of
from bsp_gp.data.headings import is_angle, is_angle_name, one_blank
from bsp_gp.data.notes import quoted
from bsp_gp.data.scene import CHECK
from bsp_gp.data.table import less
from bsp_gp.data.words import words_for
from bsp_gp.errors import DataError, in_python
from bsp_gp.units import ACCELERATION, ANGLES, DIMENSIONLESS, Unit

_ARBITRARY, _ON_EARTH = ("au", "a.u."), ("s", "ms", "min")
"""Units of lengths, arbitrary ones beside such of times: no orbit is told in these."""
_NUMBER = r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)"
_COUNT = re.compile(rf"(?:{_NUMBER}\s*)?([^\W\d_]+|°)\s*(?:/\s*{_NUMBER})?")
"""``0.09 deg``, ``rev/4000``, ``2 rev / 8192``."""
_SPEED, _RATE = LENGTH / TIME, Unit.of(s=-1)
_OWN = {_SPEED: "v", ACCELERATION: "a"}
"""Before an axis, of what is no place and has a name of its own."""


def with_their_names(table, declaration):
    """The declaration with units under our names that are declared under those of the file."""
    used = [(name, theirs) for name, theirs in table.theirs.items() if name in table.frame]
    ours = {theirs: name for name, theirs in (*table.unused.items(), *used)}
    ours |= {re.sub(r"\s*[\[(].*", "", theirs).strip(): name for name, theirs in used}
    taken = {*table.frame.columns, *KINDS}
    ours = ours if "t" in taken or "time" in declaration.units else {**ours, "t": "time"}
    return replace(declaration, units={
        ours.get(one_blank(name), name) if name not in taken else name: unit
        for name, unit in declaration.units.items()
    })  # fmt: skip


def with_inputs(table, declaration):
    """The declaration with the units of further columns that laws name; notes of these.

    A law that names a column means it: it would be a constant to be fitted otherwise.
    """
    named = [n for n in table.unused if n in table.frame and n not in declaration.units]
    named = [n for n in named if {n, re.sub("_[xyz]$", "", n)} & set(declaration.uses)]
    told = {name: table.units[name] for name in named if name in table.units}
    notes = [
        f"laws name {name!r}: a measured input, in {unit} as its heading has it"
        for name, unit in told.items()
    ]
    notes += [
        f"laws name {name!r}, and so is a column called that is not used: --units {name}=UNIT "
        "makes it an input of laws"
        for name in named if name not in told
    ]  # fmt: skip
    units = {**told, **declaration.units}
    return replace(declaration, units=units), list(map(in_python, notes))


def with_angles(table, declaration):
    """The declaration with the unit that angles are declared in under their own names."""
    own = {
        name: unit for name, unit in declaration.units.items()
        if name not in table.frame and is_angle(unit) and _names_angles(table, name)
    }  # fmt: skip
    theirs = table.theirs.get("x", "")
    known = {*declaration.units, *table.units}
    if not own and is_angle_name(theirs) and not known & {"x", "length"}:
        clock = "" if known & {"t", "time"} else " t=s"
        table.fail(
            f"{theirs!r} is an angle in an unknown unit", theirs,
            f"declare it: --units {quoted(theirs)}=rad{clock}, or {quoted(theirs)}=deg, or "
            f"of counts of an encoder what one is, {quoted(theirs)}=rev/4000",
        )  # fmt: skip
    if not own or "x" not in table.frame:
        return declaration
    if len(set(own.values())) > 1:
        raise DataError(
            f"angles must be in one unit, got {own}", file=declaration.file or table.file,
            column=list(own)[1], remedy="convert one of the columns",
        )  # fmt: skip
    units = less(declaration.units, own) | {"length": next(iter(own.values()))}
    return replace(declaration, units=units)


def _names_angles(table, name):
    """Whether a name is that of a column, or stands for several: theta for theta1 and theta2."""
    several = re.compile(rf"{re.escape(name)}[\s_-]?\w+")
    return name in table.present or (
        is_angle_name(name) and any(map(several.fullmatch, table.present))
    )


def units_of(tables, declared):
    """Units of the headers and the declared ones, which win, with notes where the two differ."""
    units, notes = {}, []
    for column, text in ((c, text) for table in tables for c, text in table.units.items()):
        kind = COLUMN_KINDS.get(column, column)
        if column in declared or kind not in declared:
            units[column] = text
        elif ratio_of(text, declared[kind]) != 1.0:
            notes.append(f"{column} is in {declared[kind]!r} as declared, not in {text!r}")
    said = {**units, **declared}
    time = None if any(t.is_dated for t in tables) else said.get("t", said.get("time"))
    for column in [c for c, text in units.items() if text.lower() in _ARBITRARY]:
        if time in _ON_EARTH and COLUMN_KINDS.get(column, column) == "length":
            notes.append(
                f"{CHECK}{column} is in {units[column]!r} with times in {time!r}: taken as "
                "arbitrary units, told as px; if astronomical ones, --units length=au"
            )
            units[column] = "px"
    units |= declared
    more = [axis for axis in "yz" if axis in tables[0] and axis not in units]
    if more and "x" in units and "length" not in units:
        notes.append(f"{' and '.join(more)} without a unit: taken as that of x, {units['x']}")
    return units, notes


def half_said(table, units):
    """A note where the unit of lengths or that of times is told, and not both."""
    has_length, has_time = ({"length", *"xyz"} & set(units), bool({"time", "t"} & set(units)))
    if bool(has_length) == has_time or "t" not in table.frame.columns:
        return []
    kind, unit = ("length", "m") if has_time else ("time", "s")
    return [in_python(
        f"{CHECK}no unit of {kind} is given: {kind}s stay numbers of the file, told in "
        f"'{kind}'; --units {kind}={unit} says what they are in"
    )]  # fmt: skip


def count_of(text):
    """What one count of such a unit is: a number and a unit of angles; None for any other unit.

    >>> count_of("0.09 deg"), count_of("rev/4000")[1], count_of("deg"), count_of("0.17 um")
    ((0.09, 'deg'), 'rad', None, None)
    """
    match = _COUNT.fullmatch(text.strip().lower())
    if match is None:
        return None
    times, word, parts = match.groups()
    if word in ANGLES and (times or parts):
        size, unit = 1.0, word
    elif word in words_for("whole_turn"):
        size, unit = 2 * math.pi, "rad"
    else:
        return None
    number = float(times or 1) / float(parts or 1) if float(parts or 1) else 0.0
    return (number * size, unit) if number else None


def with_counted_angles(table, declaration):
    """The table with angles in the place of their counts, and the declaration with their unit."""
    frame, units, notes = table.frame, dict(declaration.units), []
    is_flat = "y" not in frame and "z" not in frame
    for name, text in declaration.units.items():
        count = count_of(text)
        stands_for_x = name in ("x", "length") or (name not in frame and is_angle_name(name))
        column = name if name == "angle" and name in frame else "x" if stands_for_x else ""
        if count is None or column not in frame or (column == "x" and not is_flat):
            continue
        own = [c for c in (column, f"s{column}") if c in frame]
        frame = frame.assign(**{c: count[0] * table.numbers(c) for c in own})
        units[name] = count[1]
        notes.append(f"{table.heading(column)!r} counts {text}: it is read in {count[1]}")
    if not notes:
        return table, declaration
    return replace(table, frame=frame).noted(*notes), replace(declaration, units=units)


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
    return unit not in (LENGTH, TIME, _RATE, DIMENSIONLESS)
