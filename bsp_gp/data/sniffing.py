"""The layout of a delimited file, guessed from its first lines."""

import re
from dataclasses import dataclass

from bsp_gp.data.conversion import is_unit
from bsp_gp.data.header_lines import (
    COMMENT,
    below,
    has_row_of,
    header_cells,
    is_rule,
    is_sentence,
    names_in,
    ruled_names,
    split_line,
)
from bsp_gp.data.headings import (
    INSTRUMENTS,
    TEXT_COLUMNS,
    UNKNOWN,
    Heading,
    has_place,
    headings,
    number_columns,
)
from bsp_gp.data.unnamed import (
    DELIMITERS,
    constant_error,
    is_number,
    named_by_place,
    remedy_of_numbers,
    rows_of_numbers,
    told_of_constant,
)
from bsp_gp.errors import DataError, in_python

MOST_ABOVE = 12
"""Lines of a title above rows without headings."""
MOST_SHOWN = 6
"""Cells of a row that a complaint shows."""
DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", None: "white space"}
_BRACKETS = re.compile(r"[(\[].*[)\]]")
_DIALECT = re.compile(r"^\ufeff?\"?sep=", re.IGNORECASE)
"""The line by which Excel is told of a delimiter."""


@dataclass(frozen=True)
class Layout:
    """Where the parts of a delimited file are; lines count from 0, and no header is at -1.

    Attributes
    ----------
    delimiter : str or None
        None is white space.
    units : tuple of str
        Of every column; may be empty.
    title_cells : tuple of str
        Cells of the line above the header.
    notes : tuple of str
        What was taken for granted.
    """

    delimiter: str | None
    headings: tuple[Heading, ...]
    units: tuple[str, ...]
    header_line: int
    data_line: int
    decimal: str = "."
    title_cells: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def names(self):
        return tuple(heading.name for heading in self.headings)


def sniff(head, rename, marks, path, whole=None):
    """Guess the layout of a file.

    Parameters
    ----------
    head : list of str
        The first lines, without their ends.
    rename : mapping of str to str
        Our name of a column -> its name in the file, or its number where no column has a name.
    marks : tuple of str
        A line is the header if it has one of these columns (and, for tracks, x or y, or a
        distance and an angle).
    path : path-like
        For complaints.
    whole : callable, optional
        What gives more lines than the first ones, where something is told of columns without
        names.
    """
    is_track = marks != ("entity",)
    whole = whole or (lambda: head)
    bare = _without_header(head, rename, whole) if is_track else None
    if bare is not None:
        return bare
    said = {*rename, *rename.values()}
    for number in range(len(head)):
        for delimiter in DELIMITERS:
            cells = _names(head, number, delimiter, said)
            if is_track and (len(cells) < 2 or not _is_even(head, number, delimiter, cells)):
                continue
            found = headings(cells, rename, is_track=is_track)
            if {h.name for h in found} & set(marks) and (not is_track or has_place(found)):
                return _finish(head, number, delimiter, found)
    ruled = ruled_names(head) if is_track else None
    if ruled is not None:
        return _finish(head, ruled[0], None, headings(ruled[1], rename))
    number, delimiter = _likely_header(head)
    cells = _names(head, number, delimiter, said)
    found = headings(cells, rename, is_track=is_track)
    if COMMENT.match(head[number]) and is_track:
        _require_names_of_all(head, number, found, path, whole)
    n_numbers, n_filled = sum(map(is_number, cells)), len(list(filter(None, cells)))
    if n_numbers and (n_numbers == n_filled or 2 * n_numbers > len(cells) > 2):
        raise DataError(
            f"the first line holds {n_numbers} number(s) where the names of the columns are "
            "expected", file=path, row=number + 1,
            remedy=remedy_of_numbers(cells, whole()[number:], delimiter),
        )  # fmt: skip
    return _finish(head, number, delimiter, found)


def _rows(lines):
    """Lines with something in them, and no comments."""
    return [line for line in lines if line.strip() and not COMMENT.match(line)]


def _without_header(head, rename, whole):
    """The layout of a file of numbers alone, called by the numbers of their columns; or None.

    Where nobody says which column is which, they are t, x, y and z, if the first is a time.
    """
    first = next((k for k, s in enumerate(head) if s.strip() and not COMMENT.match(s)), len(head))
    said = {theirs.strip() for theirs in rename.values() if is_number(theirs)}
    names = {theirs for ours, theirs in rename.items() if ours in (*TEXT_COLUMNS, *INSTRUMENTS)}
    filled = [k for k in range(first, len(head)) if head[k].strip()]
    lines = [head[k] for k in filled]
    rows, delimiter = rows_of_numbers(lines, said - names)
    n_above = 0 if rows or not said else _n_above(lines, said - names)
    if n_above:
        first = filled[n_above]
        rows, delimiter = rows_of_numbers(lines[n_above:], said - names)
    numbers = [str(k + 1) for k in range(len(rows[0]))] if rows else []
    is_headed = any(COMMENT.match(line) and not is_sentence(line) for line in head)
    named = {} if said or is_headed else named_by_place(rows, rename)
    constant = constant_error(named, lambda: whole()[first:], delimiter)
    named = named | {"sx": named["y"]} if constant else named
    named = {ours: number for ours, number in named.items() if not (constant and ours == "y")}
    if not named and not (said and said <= set(numbers)):
        return None
    options = " ".join(f"{name}={number}" for name, number in named.items())
    note = in_python(
        f"no header: columns read as {', '.join(named)}; if they are not that, say which is which "
        f"by its number: --columns {options}"
    )
    notes = (note,) if named else ()
    notes += (told_of_constant(constant, named),) if constant else ()
    notes += (f"lines of a title above the rows: {n_above}",) if n_above else ()
    return Layout(
        delimiter, headings(numbers, {**named, **rename}), ("",) * len(numbers), header_line=-1,
        data_line=first, decimal=_decimal(head[first:], delimiter), notes=notes,
    )  # fmt: skip


def _n_above(lines, said):
    """Lines above the rows of numbers whose columns are said by their numbers; 0 of other files."""
    numbers = [int(k) for k in said if k.isdecimal()]
    for n in range(1, min(MOST_ABOVE, len(lines) - 2)):
        if any(set(split_line(lines[n - 1], mark)) & said for mark in DELIMITERS):
            return 0  # they are names
        rows, _ = rows_of_numbers(lines[n:], said)
        widths = set(map(len, rows))
        if len(widths) == 1 and numbers and max(numbers) <= widths.pop():
            return n
    return 0


def _require_names_of_all(head, number, found, path, whole):
    """DataError where a comment names others than the columns of numbers: nobody knows which."""
    rows, delimiter = rows_of_numbers(_rows(head[number:]), set())
    is_named = any(h.sure != UNKNOWN or h.is_renamed for h in found)
    if rows and len(rows[0]) > 1 and not (is_named and len(rows[0]) <= len(found)):
        row = rows[0]
        raise DataError(
            f"the comment above has {len(found)} name(s), of columns or of anything, and the rows "
            f"have {len(row)} columns; the first row is {' '.join(row[:MOST_SHOWN])}"
            f"{' ...' if len(row) > MOST_SHOWN else ''}",
            file=path, row=number + 1,
            remedy=remedy_of_numbers(row, _rows(whole()[number:]), delimiter),
        )  # fmt: skip


def _is_even(head, number, delimiter, cells):
    """Whether white space tells cells apart: the rows below have as many, and no quotes hold it.

    Tabs do so unless they are mixed with blanks, and any white space would be even.
    """
    if delimiter == "\t":
        rows = _rows(head[number:])
        tabs, blanks = ({len(split_line(row, mark)) for row in rows} for mark in ("\t", None))
        return len(tabs) < 2 or len(blanks) > 1
    row = below(head, number).split()
    return delimiter is not None or not row or len(row) == len(cells)


def _names(head, number, delimiter, said):
    """Names of a header without the delimiter at its end, where no row below has as many cells."""
    cells = names_in(head, number, delimiter, said)
    n_below = len(split_line(below(head, number), delimiter))
    is_idle = bool(cells) and not cells[-1] and 0 < n_below < len(cells)
    return cells[:-1] if is_idle and not has_row_of(head, number, delimiter, len(cells)) else cells


def _likely_header(head):
    """Number and delimiter of the line above the first row of numbers, else of the first line.

    Titles that are padded to the length of the rows are no names. Of comments above the rows the
    last one that has as many words as these have cells is it. Where rows hold words as well, the
    first line that is no comment is it, if it has none but names, one for every cell below.
    """
    first = next((k for k, s in enumerate(head) if s.strip() and not COMMENT.match(s)), len(head))
    comments = [k for k in reversed(range(first)) if not is_sentence(head[k])]
    for number in [*comments, *range(first, len(head) - 1)]:
        for delimiter in DELIMITERS:
            cells = names_in(head, number, delimiter)
            row = split_line(below(head, number), delimiter)
            is_row = len(row) == len(cells) > 1 and all(is_number(c or "0") for c in row)
            is_named = not any(map(is_number, cells)) and not is_rule(head[number])
            if is_row and any(row) and is_named:
                above = header_cells(head[number - 1], delimiter) if number else ()
                is_of_units = all(_BRACKETS.fullmatch(cell) for cell in cells if cell) or (
                    len(above) == len(cells) and all(map(is_unit, filter(None, cells)))
                )
                return (number - 1 if is_of_units and number else number), delimiter
    filled = [k for k, line in enumerate(head) if line.strip()]
    is_plain = comments and any(_names_cells(head, first, mark) for mark in DELIMITERS)
    filled = filled[filled.index(first) :] if is_plain else filled
    first = number = next((k for k in filled if not is_sentence(head[k])), filled[0])
    counts = {mark: len(split_line(head[number], mark)) for mark in DELIMITERS}
    marked = [mark for mark in DELIMITERS[:-1] if counts[mark] > 1]
    delimiter = max(marked or DELIMITERS, key=counts.get)
    while number < len(head) - 1 and _is_padded(split_line(head[number], delimiter)):
        number += 1
    return (first if _is_padded(split_line(head[number], delimiter)) else number), delimiter


def _names_cells(head, number, delimiter):
    """Whether a line has a name, and no number, for every cell of the row below, which has some."""
    names = names_in(head, number, delimiter)
    row = split_line(below(head, number), delimiter)
    return len(names) == len(row) > 1 and any(map(is_number, row)) > any(map(is_number, names))


def _is_padded(cells):
    """Whether most cells of a line are empty."""
    return len(cells) > 2 and 2 * sum(map(bool, cells)) < len(cells)


def _finish(head, number, delimiter, found):
    units = [h.unit for h in found]
    names, data_line = [h.name for h in found], number + 1
    delimiter = _of_rows(head, number, delimiter, len(found))
    # Below the names there may be others (symbols; a program's own words) and the units.
    for line in range(number + 1, min(number + 4, len(head))):
        row = header_cells(head[line], delimiter)
        if len(row) != len(found) and delimiter is None and COMMENT.match(head[line]):
            row = _under(head[number], head[line])
        is_marked = all(_BRACKETS.fullmatch(cell) for cell in row if cell)
        row = tuple(cell.strip("()[] ") for cell in row)
        if _is_unit_row(row, names, is_marked):
            units = [cell or unit for cell, unit in zip(row, units, strict=True)]
            data_line = line + 1
            break
        if len(row) != len(found) or any(map(is_number, row)):
            break
    if COMMENT.match(head[number]):  # the names stand in a comment, and more may follow
        while data_line < len(head) and COMMENT.match(head[data_line]):
            data_line += 1
    cells = split_line(head[data_line], delimiter) if data_line < len(head) else ()
    if cells and all(is_rule(cell) for cell in cells):  # a rule under the header
        data_line += 1
    has_title = number and not _DIALECT.match(head[number - 1])
    title = split_line(COMMENT.sub("", head[number - 1]), delimiter) if has_title else ()
    if number > 1 and len(title) == len(found):
        title = _of_individuals(split_line(head[number - 2], delimiter), title)
    decimal = _decimal(head[data_line:], delimiter)
    return Layout(delimiter, found, tuple(units), number, data_line, decimal, title)


def _of_rows(head, number, delimiter, n_cells):
    """What tells cells of rows apart, where that is another than in the header."""
    row = below(head, number)
    others = [mark for mark in DELIMITERS[:-1] if len(split_line(row, mark)) == n_cells > 1]
    is_other = others and len(split_line(row, delimiter)) == 1
    return others[0] if is_other else delimiter


def _of_individuals(above, title):
    """Titles of several animals: whose a part of a body is, as DeepLabCut tells above the parts."""
    if len(above) != len(title) or above[0].lower() != "individuals":
        return title
    is_one = len(set(title[1:])) == 1
    return tuple(who if is_one else f"{who} {part}" for who, part in zip(above, title, strict=True))


def _under(names, units):
    """Cells of a line that has not one for every name above it: each is below the nearest name."""
    above, below = (
        [(m.start() + m.end(), m[0]) for m in re.finditer(r"[^\s#%]+", line)]
        for line in (names, units)
    )
    row = [""] * len(above)
    for middle, cell in below:
        row[min(range(len(above)), key=lambda k: abs(above[k][0] - middle))] = cell
    return tuple(row)


def _decimal(lines, delimiter):
    """The decimal sign: a comma where cells have one and none has a point."""
    if delimiter == "," and '"' not in "".join(lines):
        return "."
    cells = [cell for line in lines for cell in split_line(line, delimiter)]
    has_comma = any(re.search(r"\d,\d", cell) for cell in cells)
    has_point = any(re.search(r"\d\.\d", cell) for cell in cells)
    return "," if has_comma and not has_point else "."


def _is_unit_row(row, names, is_marked=False):
    """Whether a row below the names has units of all numbers that we know; others say anything.

    Where all is in brackets, any unit tells that it is such a row.
    """
    if len(row) != len(names) or any(map(is_number, row)):
        return False
    if is_marked and any(map(is_unit, filter(None, row))):
        return True
    numeric = [cell for cell, name in zip(row, names, strict=True) if name in number_columns(names)]
    return any(numeric) and all(map(is_unit, filter(None, numeric)))
