"""One table of a recording as it was read: its columns under our names, and what they are called.

Whatever happens between the reading of a file and the making of scenes takes such a table and gives
back another one, with a note of what was done.
"""

import re
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from bsp_gp.data.conversion import LENGTH, is_unit, unit_of
from bsp_gp.errors import DataError

GAP = "leave the whole row out to mark a gap in the track"
"""What to do about a cell that has no number."""
PLACES = ("x", "y", "z", "ra", "dec", "distance", "angle")
"""Columns that say where something is; those of errors have an s before them."""
_IN_BRACKETS = re.compile(r"(.*?)\s*[(\[]([^()\[\]]+)[)\]]\s*")


@dataclass(frozen=True)
class Table:
    """A delimited file as read.

    Attributes
    ----------
    frame : pandas.DataFrame
        Known columns under our names; the index is the line number in the file.
    units : dict of str to str
        Units found in the header.
    renamed : frozenset of str
        The renames of the caller that applied.
    digest : str
        SHA-256 of the file.
    title : str or None
        The single title line above the header (Tracker writes the name of the mass there).
    theirs : dict of str to str
        Our name of a column -> what the file calls it, of every one that is used.
    present : tuple of str
        All columns of the file, as it calls them.
    up : str or None
        Axis that is a height by its name.
    unused : dict of str to str
        Names of columns that mean nothing to us -> what the file calls them.
    untimed : str
        Of a table without a column of times: the remedy where rows are no frames of a known rate.
    is_dated : bool
        Whether its times, in seconds, were dates.
    steps : dict of str to float
        Axis -> step of the grid that what its places were made of was printed on, in their unit.
    """

    frame: pd.DataFrame
    units: dict = field(default_factory=dict)
    renamed: frozenset = frozenset()
    file: str | None = None
    digest: str = ""
    title: str | None = None
    decimal: str = "."
    notes: tuple[str, ...] = ()
    theirs: dict = field(default_factory=dict)
    present: tuple[str, ...] = ()
    up: str | None = None
    unused: dict = field(default_factory=dict)
    untimed: str = ""
    is_dated: bool = False
    steps: dict = field(default_factory=dict)

    def __contains__(self, column):
        return column in self.frame

    @property
    def columns(self):
        """Names of the columns, as texts."""
        return list(map(str, self.frame.columns))

    @property
    def axes(self):
        """Those of x, y and z that it has."""
        return [axis for axis in "xyz" if axis in self.frame]

    @property
    def owners(self):
        """Names of its columns that tell tracks apart."""
        return [name for name in ("scene", "entity") if name in self.frame]

    @property
    def tracks(self):
        """Numbers of the rows of each track, by its name, a dict."""
        if not self.owners:
            return {"": np.arange(len(self.frame))}
        return self.frame.groupby(self.owners, sort=False, dropna=False).indices

    def track_by_track(self, column):
        """The cells of a column in each track."""
        return [self.frame[column].iloc[rows] for rows in self.tracks.values()]

    def heading(self, column):
        """What the file calls a column."""
        return self.theirs.get(column) or self.unused.get(column, column)

    def is_numeric(self, column):
        return pd.api.types.is_numeric_dtype(self.frame[column])

    def numbers(self, column):
        """A column as floats, nan where a cell is empty, shape (n,); DataError for texts."""
        try:
            return self.frame[column].to_numpy(dtype=float, na_value=np.nan)
        except (ValueError, TypeError) as error:
            self.fail(f"expected numbers: {error}", column)

    def fail(self, problem, column=None, remedy=None, *, row=None):
        """Raise a DataError about this table, or about its k-th row."""
        line = None if row is None else int(self.frame.index[row])
        raise DataError(problem, file=self.file, row=line, column=column, remedy=remedy)

    def noted(self, *notes):
        """The same with more notes; empty ones are none."""
        return replace(self, notes=(*self.notes, *filter(None, notes)))

    def of_rows(self, kept):
        """The same with some of its rows alone, by a mask."""
        return replace(self, frame=self.frame[kept])

    def assigned(self, **columns):
        """The same with other columns, or more of them."""
        return replace(self, frame=self.frame.assign(**columns))

    def without(self, columns):
        """The same without columns and what is known of them."""
        gone = [name for name in columns if name in self.frame]
        return replace(
            self, frame=self.frame.drop(columns=gone), units=less(self.units, columns),
            theirs=less(self.theirs, columns), unused=less(self.unused, columns),
        )  # fmt: skip

    def instead(self, gone, columns, units):
        """The same with columns, and their units, in the place of others that may be there.

        What the file calls those that are gone is still known: it tells where the new ones are
        from.
        """
        frame = self.frame.drop(columns=list(gone), errors="ignore").assign(**columns)
        return replace(self, frame=frame, units=less(self.units, gone) | units)

    def unread(self, columns):
        """The same without columns that are not used after all."""
        left = {name: self.heading(name) for name in columns}
        table = self.without(columns)
        return replace(table, unused={**table.unused, **left})

    def called(self, names):
        """The same with columns, their units and headings under other names (old -> new)."""
        own = {new: self.heading(old) for old, new in names.items() if old in self.frame}
        return replace(
            self, frame=self.frame.rename(columns=names), unused=less(self.unused, names),
            units={names.get(name, name): unit for name, unit in self.units.items()},
            theirs={names.get(name, name): text for name, text in self.theirs.items()} | own,
        )  # fmt: skip

    def require(self, needed, along=()):
        """Complain about the first column that is missing.

        `along` are headings that may be places of several bodies.
        """
        missing = [column for column in needed if column not in self.frame]
        if not missing:
            return
        present = self.present or tuple(self.columns)
        options = " ".join(f'{column}="..."' for column in missing)
        lengths = [text for name, text in self.unused.items()
                   if unit_of(self.units.get(name, "1")) == LENGTH]  # fmt: skip
        if missing == ["x", "y"] and len(lengths) == 1:
            options = f'x="{lengths[0]}" (or y= of a height)'
        elif "x" in missing:
            named = [*along, '"..."', '"..."']
            options += f" (of bodies side by side, BODY_x={named[0]} OTHER_x={named[1]}"
            options += '; of speeds alone, vx="...")'
        is_data = sum(map(is_number, present)) >= len(present) / 2
        strange = "".join(f"; {h!r} has no unit that is known" for h in present if _is_strange(h))
        self.fail(
            f"the header has no column {missing[0]!r}; present are {', '.join(present)}"
            + ("; it looks like a row of data, so line 1 is no header" if is_data else "")
            + strange,
            missing[0],
            f"add it, or say which it is: --columns {options}, in dataset.toml [columns]",
        )


def less(mapping, keys):
    """A mapping without some of its keys, a dict."""
    return {key: value for key, value in mapping.items() if key not in keys}


def is_number(text):
    """Whether a text is a number as Python writes it."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_strange(heading):
    """Whether what a heading has in the place of a unit is none, beside the name of a place."""
    match = _IN_BRACKETS.fullmatch(heading)
    return bool(match and re.search(r"(?i)(^|[\W_])[xyz]$", match[1]) and not is_unit(match[2]))
