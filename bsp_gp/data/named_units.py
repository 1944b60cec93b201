"""Units by whatever names they are declared or written, under our names of the columns."""

import re
from dataclasses import replace

from bsp_gp.data.conversion import COLUMN_KINDS, KINDS, ratio_of
from bsp_gp.data.headings import is_angle, is_angle_name, one_blank
from bsp_gp.data.notes import quoted
from bsp_gp.data.scene import CHECK
from bsp_gp.data.table import less
from bsp_gp.errors import DataError, in_python

_ARBITRARY, _ON_EARTH = ("au", "a.u."), ("s", "ms", "min")
"""Units of lengths, arbitrary ones beside such of times: no orbit is told in these."""


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
