"""Tables written as JSON: a list of records, records line by line, or columns by name."""

import json
from pathlib import Path

import numpy as np

from bsp_gp.data.arrays import longest
from bsp_gp.data.header_lines import tabbed
from bsp_gp.errors import DataError

ENDINGS = (".json", ".jsonl", ".ndjson")
_REMEDY = (
    'give one record a row, {"t": 0.1, "entity": "ball", "x": 0.2, "y": 0.3}, as a list or line by '
    "line, or columns by name"
)


def as_table(text, path):
    """The rows of a JSON file as text with tabs, the header first.

    What is nested has the names of what it is in before it, ``{"pos": {"x": 1}}`` as ``pos_x``; two
    or three numbers in a list are the coordinates of a place, ``{"pos": [1, 2]}`` as ``pos_x`` and
    ``pos_y``. Objects by name, each with a list of records, are recordings of these names.

    Raises
    ------
    DataError
        If this is no JSON, or none of these tables.
    """
    try:
        records = [_flat(record, path) for record in _records(text, path)]
    except RecursionError:
        raise DataError("the JSON is nested too deeply", file=path, remedy=_REMEDY) from None
    names = list(dict.fromkeys(name for record in records for name in record))
    if not names:
        raise DataError("the file has no records", file=path, remedy=_REMEDY)
    return tabbed([names, *([record.get(name, "") for name in names] for record in records)])


def told_of_record(error, path):
    """An error about a line of the table that was made of a file, as one of its record."""
    if Path(path).suffix.lower() not in ENDINGS or error.row is None:
        return error
    where = f", record {error.row - 1}" if error.row > 1 else ""  # the first line has the names
    return DataError(
        error.problem, file=f"{error.file}{where}", column=error.column, remedy=error.remedy
    )


def _records(text, path):
    """The records of a file, dicts."""
    try:
        found = json.loads(text)
    except ValueError:
        return [_of_line(line, number, path)
                for number, line in enumerate(text.splitlines(), 1) if line.strip()]  # fmt: skip
    if isinstance(found, dict):
        named = {name: _records_within(value) for name, value in found.items()}
        if found and all(named.values()):
            return [{"scene": name, **each} for name, rows in named.items() for each in rows]
        lists = {name: value for name, value in found.items() if isinstance(value, list)}
        if len(lists) == 1 and all(isinstance(each, dict) for each in next(iter(lists.values()))):
            return next(iter(lists.values()))  # records under a name, beside what is said of them
        sizes = {len(value) for value in found.values()} if len(lists) == len(found) else set()
        if len(sizes) == 1:
            return [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
        found = _of_arrays(found, path) or [found]
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise DataError("this JSON is no table", file=path, remedy=_REMEDY)
    return found


def _of_arrays(found, path):
    """Rows of an object with lists of numbers for times and for tracks, as NumPy saves them; []."""
    try:
        columns, _ = longest(_as_arrays(found), path)
    except (DataError, ValueError):
        return []
    rows = zip(*(own.tolist() for own in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows] if "t" in columns else []


def _as_arrays(value):
    """The same with arrays for lists; ValueError for lists of unequal length."""
    if isinstance(value, dict):
        return {name: _as_arrays(own) for name, own in value.items()}
    return np.array(value) if isinstance(value, list) else value


def _records_within(found):
    """The records of an object that holds one list of them, beside what is said of them; or []."""
    values = found.values() if isinstance(found, dict) else ()
    lists = [value for value in values if isinstance(value, list) and value]
    is_one = len(lists) == 1 and all(isinstance(each, dict) for each in lists[0])
    return lists[0] if is_one else []


def _of_line(line, number, path):
    try:
        found = json.loads(line)
    except ValueError as error:
        raise DataError(
            f"this is no JSON ({error.msg})", file=f"{path}, line {number}", remedy=_REMEDY
        ) from None
    if not isinstance(found, dict):
        raise DataError("this line is no record", file=f"{path}, line {number}", remedy=_REMEDY)
    return found


def _flat(record, path, before=""):
    """A record with names of columns and texts."""
    out = {}
    for name, value in record.items():
        name = f"{before}{name}"
        if isinstance(value, dict):
            out |= _flat(value, path, f"{name}_")
        elif isinstance(value, list):
            if not 2 <= len(value) <= 3 or any(isinstance(v, list | dict) for v in value):
                raise DataError(
                    f"{name} is a list that is no place in two or three dimensions", file=path,
                    remedy=_REMEDY,
                )  # fmt: skip
            out |= {f"{name}_{axis}": _text(v) for axis, v in zip("xyz", value, strict=False)}
        else:
            out[name] = _text(value)
    return out


def _text(value):
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
