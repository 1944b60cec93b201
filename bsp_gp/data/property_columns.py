"""Columns of a table of tracks that say what bodies are: ``Masse in g`` is the mass.

A column is taken for one where its word and its unit agree and it does not change along a track;
what only may be one is named where a mass turns out to be needed.
"""


from bsp_gp.data.headings import property_of_words
from bsp_gp.data.notes import quoted
from bsp_gp.data.roster import WITHIN, tracks_of
from bsp_gp.errors import in_python


def with_properties_by_words(table, units):
    """The table with such columns under the names that properties have with us, and notes of them.

    Parameters
    ----------
    units : mapping of str to str
        That are declared; a column with a unit under its own name is an input of laws.
    """
    for name in (name for name in WITHIN if name not in table.frame.columns):
        found = [column for column in table.unused if _may_be(table, column, name, units)]
        if len(found) == 1:
            table = _renamed(table, found[0], name)
    return table


def _may_be(table, column, name, units):
    unit = table.units.get(column, "")
    return (
        column in table.frame.columns and column not in units and (unit or name in units)
        and property_of_words(column, unit) == name and _is_constant(table.frame, column)
    )  # fmt: skip


def _renamed(table, column, name):
    theirs = table.unused[column]
    note = in_python(
        f"{theirs!r} is taken for the {name} of the bodies; if it is not that: --columns "
        f"{quoted(theirs)}=ignore"
    )
    return table.called({column: name}).noted(note)


def _is_constant(frame, column):
    return all(part.nunique(dropna=False) <= 1 for part in tracks_of(frame, column))


def unread_masses(table):
    """Which columns that are not used may be masses, and the option; empty without any."""
    found = [
        theirs for column, theirs in table.unused.items()
        if property_of_words(column, table.units.get(column, "")) == "mass"
        and (column not in table.frame.columns or _is_constant(table.frame, column))
    ]  # fmt: skip
    if not found:
        return ""
    return in_python(
        f"the column {found[0]!r}, which is not used, looks like one: --columns "
        f"mass={quoted(found[0])} --units mass=g (or kg)"
    )
