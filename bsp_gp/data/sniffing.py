"""The layout of a delimited file, guessed from its first lines."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass

from bsp_gp.data.conversion import is_unit, unit_of
from bsp_gp.data.polar import POLAR_COLUMNS, is_polar
from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.errors import DataError
from bsp_gp.units import Unit

__all__ = [
    "NUMBER_COLUMNS", "TEXT_COLUMNS", "Layout", "normalise_columns", "number_columns", "sniff",
    "split_line",
]  # fmt: skip

NUMBER_COLUMNS = (
    "t", "frame", "x", "y", "z", "vx", "vy", "vz", "sx", "sy", "sz",
)  # fmt: skip
TEXT_COLUMNS = ("scene", "entity")
ALIASES = {"particle": "entity", "object": "entity", "track": "entity"}
_DELIMITERS = (",", ";", "\t", None)
DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", None: "white space"}
_WITH_UNIT = re.compile(r"(.*?)\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]")
_AFTER_MARK = re.compile(r"(.+?)(?:\s*[/,]\s*|\s+in\s+)[(\[]?([^()\[\]]+)[)\]]?")
"""``t / s``, ``t in s``, ``t, s`` and ``v / (m/s)``: the part after the mark may be a unit."""
_TIME_WORDS = frozenset({"time", "elapsed", "zeit", "temps", "tiempo", "tempo"})
_PLACE_WORDS = frozenset(
    "position pos coordinate coord coordinates koordinate ort lage weg location posición"
    " posizione displacement".split()
)
_SPEED_WORDS = frozenset({"velocity", "speed", "geschwindigkeit", "vitesse", "v"})
_LENGTH, _TIME = Unit.of(m=1), Unit.of(s=1)
_UNIT_OF = PROPERTY_UNITS | {
    name: {"t": _TIME, "v": _LENGTH / _TIME}.get(name[0], _LENGTH)
    for name in NUMBER_COLUMNS if name != "frame"
}  # fmt: skip


def number_columns(names):
    """Columns that hold numbers in a table with these columns, a tuple of str."""
    return NUMBER_COLUMNS + (POLAR_COLUMNS if is_polar(names) else ())


@dataclass(frozen=True)
class Layout:
    """Where the parts of a delimited file are; lines count from 0.

    Attributes
    ----------
    delimiter : str or None
        None is white space.
    names : tuple of str
        Our names of the columns.
    units : dict of str to str
        Units found in the header.
    renamed : frozenset of str
        The renames of the caller that applied.
    header_line, data_line : int
    decimal : str
    title_cells : tuple of str
        Cells of the line above the header.
    """

    delimiter: str | None
    names: tuple[str, ...]
    units: dict
    renamed: frozenset
    header_line: int
    data_line: int
    decimal: str = "."
    title_cells: tuple[str, ...] = ()


def normalise_columns(columns, rename=None):
    """Find our names of the columns of a file or frame, and the units in its header.

    Parameters
    ----------
    columns : sequence of str
    rename : mapping of str to str, optional
        Our name -> the file's name, which may or may not occur.

    Returns
    -------
    names : tuple of str
    units : dict of str to str
    renamed : frozenset of str
        The keys of `rename` that occurred.
    """
    back = {theirs.strip(): ours for ours, theirs in (rename or {}).items()}
    cells = [str(cell).strip().strip('"').strip() for cell in columns]
    stems, texts = (
        zip(*(_split_unit(cell, back) for cell in cells), strict=True) if cells else ((), ())
    )
    names = [back.get(c, back.get(stem, stem)) for c, stem in zip(cells, stems, strict=True)]
    renamed = frozenset(n for n, stem in zip(names, stems, strict=True) if n in (rename or {}))
    renamed = frozenset(n for n in renamed if rename[n].strip() in (*cells, *stems))
    for k, name in enumerate(names):
        ours = _our_name(name)
        if name not in renamed and ours not in names:
            names[k] = ours
    units = {name: text for name, text in zip(names, texts, strict=True) if text}
    return tuple(names), units, renamed


def _split_unit(cell, back):
    """Name and unit of one cell of a header; without a unit (cell, "").

    After a mark that other names have too (``/``, ``in``), only what fits the column counts.
    """
    match = _WITH_UNIT.fullmatch(cell)
    if match and match[1] and not match[1].endswith("/") and is_unit(match[2]):
        return match[1], match[2]
    match = _AFTER_MARK.fullmatch(cell)
    if match:
        name = back.get(cell, back.get(match[1], _our_name(match[1])))
        if name in _UNIT_OF and unit_of(match[2]) == _UNIT_OF[name]:
            return match[1], match[2].strip()
    return cell, ""


def _our_name(name):
    """Our name of a column that people call ``Time``, ``Zeit t``, ``x-position`` or ``v_x``."""
    lower = name.lower()
    if lower in NUMBER_COLUMNS + TEXT_COLUMNS:
        return lower
    words = re.split(r"[\s_-]+", lower)
    symbols = [word for word in words if word in ("t", "x", "y", "z")]
    about = {word for word in words if word not in symbols}
    if about and about <= _TIME_WORDS and symbols in ([], ["t"]):
        return "t"
    if about and len(symbols) == 1 and symbols != ["t"]:
        if about <= _PLACE_WORDS:
            return symbols[0]
        if about <= _SPEED_WORDS:
            return f"v{symbols[0]}"
    return ALIASES.get(lower, name)


def split_line(line, delimiter):
    """Cells of one line; the delimiter None is white space."""
    if delimiter is None:
        return tuple(line.split())
    return tuple(cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), []))


def sniff(head, rename, marks, path):
    """Guess the layout of a file.

    Parameters
    ----------
    head : list of str
        The first lines, without their ends.
    rename : mapping of str to str
        Our name of a column -> its name in the file.
    marks : tuple of str
        A line is the header if it has one of these columns (and, for tracks, x or y, or a
        distance and an angle).
    path : path-like
        For complaints.

    Returns
    -------
    Layout
    """
    for number, line in enumerate(head):
        for delimiter in _DELIMITERS:
            cells = split_line(line, delimiter)
            if len(cells) < 2 and marks != ("entity",):
                continue
            names = normalise_columns(cells, rename)[0]
            has_place = set(names) & {"x", "y"} or is_polar(names)
            if set(names) & set(marks) and (marks == ("entity",) or has_place):
                return _finish(head, number, delimiter, rename)
    number = next(k for k, line in enumerate(head) if line.strip())
    delimiter = max(_DELIMITERS, key=lambda mark: len(split_line(head[number], mark)))
    cells = split_line(head[number], delimiter)
    if cells and all(_is_number(cell) for cell in cells if cell):
        raise DataError(
            "the first line holds numbers where the names of the columns are expected",
            file=path, row=number + 1, remedy="add a header such as t,x,y",
        )  # fmt: skip
    return _finish(head, number, delimiter, rename)


def _finish(head, number, delimiter, rename):
    names, units, renamed = normalise_columns(split_line(head[number], delimiter), rename)
    data_line = number + 1
    row = split_line(head[data_line], delimiter) if data_line < len(head) else ()
    row = tuple(cell.strip("()[] ") for cell in row)
    if _is_unit_row(row, names):
        units |= {name: unit for name, unit in zip(names, row, strict=True) if unit}
        data_line += 1
    body = " ".join(head[data_line:])
    has_comma = delimiter != "," and re.search(r"\d,\d", body) and not re.search(r"\d\.\d", body)
    title = split_line(head[number - 1], delimiter) if number else ()
    decimal = "," if has_comma else "."
    return Layout(delimiter, names, units, renamed, number, data_line, decimal, title)


def _is_unit_row(row, names):
    if len(row) != len(names) or not any(row):
        return False
    numeric = [cell for cell, name in zip(row, names, strict=True) if name in number_columns(names)]
    if not any(numeric):
        return False
    return all(is_unit(cell) and not _is_number(cell) for cell in row)


def _is_number(text):
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
