"""What of a table is not read, and what it may be: told, with the option that makes it so."""

from bsp_gp.data.headings import bodies_beside, is_ignored
from bsp_gp.data.notes import listed, quoted
from bsp_gp.data.polar import POLAR_ALIASES
from bsp_gp.data.polar_words import plain_words
from bsp_gp.data.properties import LEFT_OUT
from bsp_gp.data.words import words_for
from bsp_gp.errors import DataError, in_python

MOST_TOLD = 12
"""Columns whose meaning is told."""


def told_unused(table, inputs):
    """A note of what is not read of a table, and of what of it may be an input."""
    unused = {name: theirs for name, theirs in table.unused.items() if name not in inputs}
    names = list(unused.values())
    able = [theirs for name, theirs in unused.items() if name in table.frame]  # of bodies none is
    able = [theirs for theirs in able if theirs.isidentifier()]
    note = [f"not used: {listed(names, MOST_TOLD)}"] if names else []
    where = [name for name in able if plain_words(name) & words_for("turned")]
    if where:
        note.append(
            f"column {where[0]} may say how the body is turned: --units {where[0]}=deg makes it an "
            "input of laws, which may then act along and across the body's own axis"
        )
    driving = [n for n in able if plain_words(n.rstrip("0123456789")) & words_for("drive")]
    if driving:
        note.append(f"column {driving[0]} may drive the motion: --units {driving[0]}=UNIT makes it "
                    "an input of laws")  # fmt: skip
    return note + _left_out_bodies(table, inputs)


def _left_out_bodies(table, inputs):
    """A note of columns that are not used and look like the places of more bodies, and the remedy.

    It is one of those that `with_properties` tells again where a body is missed.
    """
    taken = {*inputs, *table.renamed}  # or left out by the caller
    unused = {name: theirs for name, theirs in table.unused.items() if name not in taken}
    found = bodies_beside(unused, table.units) if "entity" not in table.frame.columns else {}
    if not found:
        return []
    columns = [column for axes in found.values() for column in axes.values()][:MOST_TOLD]
    own = {axis: table.heading(axis) for axis in table.axes}
    sides = {"ONE": own, "OTHER": next(iter(found.values()))}
    options = " ".join(f"{body}_{axis}={quoted(column)}" for body, axes in sides.items()
                       for axis, column in sorted(axes.items()))  # fmt: skip
    return [
        in_python(f"{LEFT_OUT}{', '.join(map(repr, columns))}; bodies side by side are named "
                  f"--columns {options}, with names of yours for ONE and OTHER")
    ]  # fmt: skip


def require_renames(declaration, tables):
    """DataError where the caller names a column that no table has."""
    found = frozenset().union(*(table.renamed for table in tables))
    for ours, theirs in declaration.columns.items():
        if POLAR_ALIASES.get(ours, ours) not in found:
            present = [column for table in tables for column in table.present]
            is_out = is_ignored(theirs, present)
            what = ours if is_out else theirs
            options = "ONE_OF_THESE=ignore" if is_out else f"{ours}=ONE_OF_THESE"
            raise DataError(
                f"[columns] {ours} = {theirs!r}: there is no column {what!r}; present are "
                f"{', '.join(present)}", file=declaration.file or tables[0].file, column=ours,
                remedy=f"write --columns {options}; the only other key is velocity (measured or "
                "ignore)",
            )  # fmt: skip
