"""Columns of a table of tracks that say what bodies are: ``Masse in g`` is the mass.

A column is taken for one where its word and its unit agree and it does not change along a track;
what only may be one is named where a mass turns out to be needed.
"""

from dataclasses import replace

from bsp_gp.data.headings import property_of_words
from bsp_gp.data.notes import quoted
from bsp_gp.data.table import less
from bsp_gp.errors import in_python

WITHIN = ("mass", "charge")
"""Properties that a table of tracks may say itself, where it says their unit."""


def roster_within(table, units):
    """The bodies of a table of tracks that says itself what their masses are.

    `units` are those that are declared; a column with a unit under its own name is an input of
    laws.

    Returns
    -------
    roster : Table or None
        None where no column is a property of bodies.
    table : Table
        Without those columns.

    Raises
    ------
    DataError
        If a column whose unit is declared changes along a track.
    """
    for name in (name for name in WITHIN if name not in table):
        able = [column for column in table.unused if _may_be(table, column, name, units)]
        if len(able) == 1:
            theirs = table.unused[able[0]]
            table = table.called({able[0]: name}).noted(in_python(
                f"{theirs!r} is taken for the {name} of the bodies; if it is not that: --columns "
                f"{quoted(theirs)}=ignore"
            ))  # fmt: skip
    found = []
    for column in (name for name in WITHIN if name in table and name in {*units, *table.units}):
        moved = _moved(table, column)  # without a unit, of trackpy, a mass is a brightness
        if not moved:
            found.append(column)
        elif column in units:
            line = moved[0].index[(moved[0] != moved[0].iloc[0]).to_numpy()][0]
            table.fail(
                f"{column} changes along a track", column,
                "it is a property of a body; what changes is an input of laws and needs "
                f"another name, such as {column}_now", row=table.frame.index.get_loc(line),
            )  # fmt: skip
    if not found:
        return None, table
    owners, frame = table.owners, table.frame
    bodies = frame[[*owners, *found]].drop_duplicates(owners) if owners else frame[found].iloc[:1]
    if "entity" not in owners:
        bodies = bodies.assign(entity=table.title or "object")
    own = {column: unit for column, unit in table.units.items() if column in found}
    rest = replace(table, frame=frame.drop(columns=found), unused=less(table.unused, found))
    return replace(table, frame=bodies, units=own, notes=()), rest


def _may_be(table, column, name, units):
    unit = table.units.get(column, "")
    return (
        column in table and column not in units and (unit or name in units)
        and property_of_words(column, unit) == name and not _moved(table, column)
    )  # fmt: skip


def _moved(table, column):
    """Tracks along which a column changes."""
    return [own for own in table.track_by_track(column) if own.nunique(dropna=False) > 1]


def unread_masses(table):
    """Which columns that are not used may be masses, and the option; empty without any."""
    found = [
        theirs for column, theirs in table.unused.items()
        if property_of_words(column, table.units.get(column, "")) == "mass"
        and (column not in table or not _moved(table, column))
    ]  # fmt: skip
    if not found:
        return ""
    return in_python(
        f"the column {found[0]!r}, which is not used, looks like one: --columns "
        f"mass={quoted(found[0])} --units mass=g (or kg)"
    )
