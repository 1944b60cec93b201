"""The layout of a delimited file, guessed from its first lines."""

import math
import re
import sys
from dataclasses import dataclass

import numpy as np

from bsp_gp.data.clock import slope_on_clock
from bsp_gp.data.conversion import is_unit
from bsp_gp.data.extent import JULIAN, MODIFIED, YEARS, are_within
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
    is_ignored,
    number_columns,
)
from bsp_gp.data.horizons import vectors_among
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import DataError, in_python

MOST_ABOVE = 12
"""Lines of a title above rows without headings."""
LEAST_STEPS, RISES, ROUNDED = 4, 0.95, 2.01
"""Steps of a column that may be a clock, the part of them that goes up, and last digits by which
those of an even one differ."""
MOST_EVEN = 60
"""Rows in which a clock is even, if it is: further down it may pause or begin anew."""
ANY_RISE = 0.65
"""Part of the steps of no column that goes up, where none is a clock: half do of what wanders."""
MOST_POWER = 300
"""Of ten that a number can have."""
_UNITS_OF_TIME = tuple(math.log(n) for n in (1, 1e3, 1e6, 1e9, 60, 3600, 86400))
_SAME_UNIT = 1e-3
"""How many of one unit another of a time is, and the part by which a clock may be off that."""
OLD, UNEVEN = 5.0, 2.0
"""How many times the span of a clock its first value is from 0 at least, if that is a date; and the
upper quartile of its steps, in the lower one, at least."""
LEAST_DATE, SMALL, MOST_JITTER = 1000.0, 0.3, 5.0
"""Days that Julian dates count from a later zero, at the least; errors in the span of what is
measured, and one for all rows in the size of its noise, at the most."""
MOST_SHOWN = 6
"""Cells of a row that a complaint shows."""
MOST_INSTRUMENTS = 12
"""Names in a column of texts, of what velocities of one star were measured by."""
_DELIMITERS = (",", ";", "\t", None)
DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", None: "white space"}
_BRACKETS = re.compile(r"[(\[].*[)\]]")
_VELOCITIES = "--columns t=1 rv=2 srv=3 of velocities along the line of sight"
_OF_CALENDAR = re.compile(
    r"\d{1,2}:\d\d(?::\d\d(?:\.\d*)?)?|(?:jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*",
    re.IGNORECASE,
)
"""A part of a date in a column of its own."""
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
        for delimiter in _DELIMITERS:
            cells = names_in(head, number, delimiter, said)
            cells = _without_idle_end(head, number, delimiter, cells)
            if is_track and (len(cells) < 2 or not _is_even(head, number, delimiter, cells)):
                continue
            found = headings(cells, rename, is_track=is_track)
            if {h.name for h in found} & set(marks) and (not is_track or has_place(found)):
                return _finish(head, number, delimiter, found)
    ruled = ruled_names(head) if is_track else None
    if ruled is not None:
        return _finish(head, ruled[0], None, headings(ruled[1], rename))
    number, delimiter = _likely_header(head)
    cells = names_in(head, number, delimiter, said)
    cells = _without_idle_end(head, number, delimiter, cells)
    found = headings(cells, rename, is_track=is_track)
    if COMMENT.match(head[number]) and is_track:
        _require_names_of_all(head, number, found, path, whole)
    n_numbers, n_filled = sum(map(_is_number, cells)), len(list(filter(None, cells)))
    if n_numbers and (n_numbers == n_filled or 2 * n_numbers > len(cells) > 2):
        raise DataError(
            f"the first line holds {n_numbers} number(s) where the names of the columns are "
            "expected",
            file=path, row=number + 1,
            remedy=_remedy_of_numbers(cells, whole()[number:], delimiter),
        )  # fmt: skip
    return _finish(head, number, delimiter, found)


def _without_header(head, rename, whole):
    """The layout of a file of numbers alone, called by the numbers of their columns; or None.

    Where nobody says which column is which, they are t, x, y and z, if the first is a time.
    """
    first = next((k for k, s in enumerate(head) if s.strip() and not COMMENT.match(s)), len(head))
    said = {theirs.strip() for theirs in rename.values() if _is_number(theirs)}
    names = {theirs for ours, theirs in rename.items() if ours in (*TEXT_COLUMNS, *INSTRUMENTS)}
    filled = [k for k in range(first, len(head)) if head[k].strip()]
    lines = [head[k] for k in filled]
    rows, delimiter = _rows_of_numbers(lines, said - names)
    n_above = 0 if rows or not said else _n_above(lines, said - names)
    if n_above:
        first = filled[n_above]
        rows, delimiter = _rows_of_numbers(lines[n_above:], said - names)
    numbers = [str(k + 1) for k in range(len(rows[0]))] if rows else []
    is_headed = any(COMMENT.match(line) and not is_sentence(line) for line in head)
    named = {} if said or is_headed else _named_by_place(rows, rename)
    constant = _constant_error(named, lambda: whole()[first:], delimiter)
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
    notes += (_told_of_constant(constant, named),) if constant else ()
    notes += (f"lines of a title above the rows: {n_above}",) if n_above else ()
    return Layout(
        delimiter, headings(numbers, {**named, **rename}), ("",) * len(numbers), header_line=-1,
        data_line=first, decimal=_decimal(head[first:], delimiter), notes=notes,
    )  # fmt: skip


def _n_above(lines, said):
    """Lines above the rows of numbers whose columns are said by their numbers; 0 of other files."""
    numbers = [int(k) for k in said if k.isdecimal()]
    for n in range(1, min(MOST_ABOVE, len(lines) - 2)):
        if any(set(split_line(lines[n - 1], mark)) & said for mark in _DELIMITERS):
            return 0  # they are names
        rows, _ = _rows_of_numbers(lines[n:], said)
        widths = set(map(len, rows))
        if len(widths) == 1 and numbers and max(numbers) <= widths.pop():
            return n
    return 0


def _rows_of_numbers(lines, said):
    """Rows of lines that begin with one of numbers, and the delimiter; none of other lines.

    Where it is said by their numbers which columns have them, others may be texts, unless these
    numbers are names in that line.
    """
    for delimiter in _DELIMITERS if lines else ():
        cells = split_line(lines[0], delimiter)
        by_number = [cells[int(k) - 1] for k in said if k.isdecimal() and 0 < int(k) <= len(cells)]
        is_told = len(by_number) == len(said) > 0 and not said <= set(cells)
        if all(_is_number(cell or "0") for cell in (by_number if is_told else cells)):
            if any(by_number if is_told else cells):
                return [split_line(line, delimiter) for line in lines], delimiter
    return [], None


def _named_by_place(rows, rename):
    """Our names of two to four columns of numbers, the first of which increases; {} of others."""
    is_even = len(set(map(len, rows))) == 1
    if not is_even or not all(_is_number(cell or "0") for row in rows for cell in row):
        return {}
    columns = {str(k + 1): cells for k, cells in enumerate(zip(*rows, strict=True))}
    kept = [n for n in columns if any(columns[n]) and not is_ignored(rename.get(n, ""), columns)]
    times = _numbers(columns[kept[0]]) if kept else []
    is_timed = all(early < late for early, late in zip(times, times[1:], strict=False))
    if not 2 <= len(kept) <= 4 or not is_timed or _are_places(rows[0]):
        return {}
    if are_within(times[0], times[-1], (JULIAN,)) or _are_velocities([columns[n] for n in kept]):
        return {}  # what stands beside dates is asked for
    clocks = clocks_among([columns[n] for n in kept])
    if clock_among([columns[n] for n in kept]) not in (0, None) or len(clocks) > 1:
        return {}  # asked for
    return dict(zip("txyz", kept, strict=False))


def _constant_error(named, lines, delimiter):
    """What all rows have in the third of three columns, if it may be the error of the second.

    That is above 0, small beside what the second spans, and not far above what this jitters by.
    """
    if "".join(named) != "txy":
        return ""
    rows = [split_line(line, delimiter) for line in lines() if line.strip()]
    x, y = (int(named[axis]) - 1 for axis in "xy")
    own = {row[y] for row in rows if len(row) > y}
    if len(own) != 1 or not all(_is_number(row[x] or "0") for row in rows if len(row) > y):
        return ""
    (constant,) = own
    size = _numbers([constant])[0] if _is_number(constant) else 0.0
    places = np.array(_numbers([row[x] for row in rows if len(row) > y]))
    if len(places) <= LEAST_STEPS or not 0 < size < SMALL * np.ptp(places):
        return ""
    jitter = np.median(np.abs(np.diff(places, 3))) / (0.6745 * math.sqrt(20))
    return constant if size < MOST_JITTER * jitter else ""


def _told_of_constant(constant, named):
    return in_python(
        f"{CHECK}column {named['sx']} is {_numbers([constant])[0]:g} in every row: taken as the "
        f"error of x; if it is a place, --columns t={named['t']} x={named['x']} y={named['sx']}; "
        "if x is a velocity along the line of sight, --columns "
        f"t={named['t']} rv={named['x']} srv={named['sx']}"
    )


def _numbers(cells):
    return [float(cell.replace(",", ".").replace("\u2212", "-") or "nan") for cell in cells]


def _steps(cells):
    values = _numbers(cells)
    return [late - early for early, late in zip(values, values[1:], strict=False)]


def clock_among(columns):
    """Which of some columns of texts is the clock: it alone increases, or does so evenly; or None.

    What counts rows is one only where nothing else increases.
    """
    rising, even = [], []
    for k, cells in enumerate(columns):
        steps = _steps(cells)
        if len(steps) < LEAST_STEPS or not _rises(cells, RISES):
            continue
        rising.append(k)
        if not all(step == 1 for step in steps) and _is_even_clock(cells):
            even.append(k)
    found = even or rising
    return found[0] if len(found) == 1 else None


def _is_even_clock(cells):
    """Whether the steps of a column are one but for its last digits."""
    steps = _steps(cells)
    least = 16 * sys.float_info.epsilon * max(map(abs, _numbers(cells)))  # of a difference
    return max(steps) - min(steps) <= max(ROUNDED * _last_digit(cells), least)


def clocks_among(columns):
    """Which of some columns of texts are one clock in several units, that nearest to 0 first.

    What increases, and counts no rows, is the clock if nothing else does, or all of it is.
    """
    known = clock_among(columns)
    rising = [
        k for k, cells in enumerate(columns)
        if len(steps := _steps(cells)) >= LEAST_STEPS and _rises(cells, RISES)
        and not all(step == 1 for step in steps)
    ]  # fmt: skip
    first = rising[0] if known is None and rising else known
    if first is None:
        return []
    same = [k for k in rising if k == first or _is_same_clock(columns[first], columns[k])]
    if known is None and same != rising:
        return []
    return sorted(same or [first], key=lambda k: _age(columns[k]))


def _is_same_clock(one, other):
    """Whether two columns go up together, in two units of time."""
    slope = slope_on_clock(*(np.array(_numbers(cells)) for cells in (one, other)))
    off = [abs(abs(math.log(slope)) - size) for size in _UNITS_OF_TIME] if slope else [1.0]
    return min(off) < _SAME_UNIT


def _age(cells):
    """How far the first value of a clock is from 0, in what it goes up."""
    first, last = _ends(cells)
    return abs(first) / max(abs(last - first), sys.float_info.min)


def _rises(cells, part):
    """Whether so large a part of the steps of a column goes up."""
    steps = _steps(cells)
    return sum(step > 0 for step in steps) >= part * len(steps)


def _last_digit(cells):
    """Size of the last digit of the numbers that are written to the most places."""
    numbers = [re.split("[eE]", cell.replace(",", ".")) for cell in cells]
    ends = [int(power[0] if power else 0) - len(whole.partition(".")[2])
            for whole, *power in numbers]  # fmt: skip
    return 10.0 ** min(*ends, MOST_POWER)


def _require_names_of_all(head, number, found, path, whole):
    """DataError where a comment names others than the columns of numbers: nobody knows which."""
    lines = [line for line in head[number:] if line.strip() and not COMMENT.match(line)]
    rows, delimiter = _rows_of_numbers(lines, set())
    is_named = any(h.sure != UNKNOWN or h.is_renamed for h in found)
    if rows and len(rows[0]) > 1 and not (is_named and len(rows[0]) <= len(found)):
        row = rows[0]
        raise DataError(
            f"the comment above has {len(found)} name(s), of columns or of anything, and the rows "
            f"have {len(row)} columns; the first row is {' '.join(row[:MOST_SHOWN])}"
            f"{' ...' if len(row) > MOST_SHOWN else ''}",
            file=path, row=number + 1,
            remedy=_remedy_of_numbers(row, [line for line in whole()[number:] if line.strip()
                                            and not COMMENT.match(line)], delimiter),
        )  # fmt: skip


def _remedy_of_numbers(cells, lines, delimiter):
    if len(cells) == 1:
        return (
            "a table has a column of times as well; of rows that are evenly spaced, say how many "
            "there are in a second: --columns x=1 --fps 25 (of speeds vx=1, of accelerations ax=1)"
        )
    remedy = "add a header such as t,x,y, or say which column is which by its number: "
    columns, texts = _columns_of(lines, delimiter, cells)
    # A column that turns back further down is no clock, however it begins.
    few = {k: own[:MOST_EVEN] for k, own in columns.items()}
    able = [k for k, own in columns.items() if _rises(own, RISES)]
    clocks = [able[k] for k in clocks_among([few[k] for k in able])]
    unit = _unit_of_dates(columns.get(1, ())) if len(columns) > 2 else ""
    if _is_calendar(columns) or (len(texts) > 1 and any(map(_has_clock, texts.values()))):
        return ("write what stands in several columns into one, dates as 2024-01-31T12:00:00 and "
                "angles as 12:34:56.7, below names such as t,ra,dec or t,x,y")  # fmt: skip
    clock = next((k for k, own in texts.items() if _has_clock(own)), None)
    if clock is not None:
        return f"column {clock} has times of a day: a header such as t,x,y reads them"
    if vectors := vectors_among(columns, texts):
        return remedy + vectors
    if not unit and _are_velocities([columns[k] for k in (1, 2, 3) if k in columns]):
        by_number = f"{_VELOCITIES} and their errors, or --columns t=1 x=2 y=3 of places"
        by_number += _of_instruments(texts)
    elif unit:
        by_number = _beside_dates(columns)
        by_number += " with --units t=yr where dates are years" if unit == "yr" else ""
        by_number += _of_instruments(texts) if "rv=" in by_number else ""
    elif len(clocks) == 1 and _may_be_place(columns, few, *clocks):
        by_number = _without_clock(columns)
        by_number += f"; or t={clocks[0]} if column {clocks[0]}, which increases from row to row, "
        by_number += "is a clock"
    elif clocks:
        by_number = _by_clock(columns, clocks)
        by_number += _of_instruments(texts) if "rv=" in by_number else ""
    elif columns and not any(_rises(own, ANY_RISE) for own in columns.values()):
        by_number = _without_clock(columns)
    else:
        moved = {k: _steps(own) for k, own in columns.items()}
        t = next((k for k, own in columns.items() if _rises(own, RISES)), 1)
        x = min(columns.keys() - {t}, default=2,
                key=lambda k: (not any(n % 1 for n in moved[k]), not any(moved[k]), k))  # fmt: skip
        by_number = f"--columns t={t} x={x} (t=2 x=3 where the first counts rows or bodies"
        by_number += "; t=1 ax=2 ay=3 az=4 of accelerations)" if len(cells) > 3 else ")"
    if _are_places(cells):
        by_number += ", if that line is a row; if it numbers the columns itself, --columns t=0 x=1"
    return remedy + by_number


def _has_clock(cells):
    """Whether texts are hours, minutes and seconds, or names of months: parts of dates."""
    return all(_OF_CALENDAR.fullmatch(cell) for cell in cells)


def _without_clock(columns):
    """How columns are said by their numbers where each row is a frame."""
    axes = "xyz" if len(columns) == len("xyz") else "xy"
    named = " ".join(f"{axis}={k}" for axis, k in zip(axes, columns, strict=False))
    return (f"--columns {named} --fps 25 (no column is a clock for sure: if every row is a frame, "
            "that says how many are in a second; --dt says the time of one)")  # fmt: skip


def _may_be_place(columns, few, clock):
    """Whether the one column that increases may be a coordinate: unevenly, while all others fall.

    The first of columns is no coordinate but a clock.
    """
    others = [_steps(own) for k, own in columns.items() if k != clock]
    is_first = clock == next(iter(columns))
    all_fall = all(sum(step < 0 for step in steps) >= RISES * len(steps) for steps in others)
    return len(columns) in (2, 3) and all_fall and not (is_first or _is_even_clock(few[clock]))


def _of_instruments(texts):
    """A column of texts that may name instruments, and how that is said."""
    for k, cells in texts.items():
        names = dict.fromkeys(filter(None, cells))
        if 1 < len(names) <= MOST_INSTRUMENTS:
            listed = ", ".join([*names][:3]) + " ..." * (len(names) > 3)
            return f"; with instrument={k} where column {k} ({listed}) names what measured each"
    return ""


def _beside_dates(columns):
    """How columns are said by their numbers beside dates: of errors none is below 0."""
    sure = {k for k, own in columns.items() if all(n > 0 for n in _numbers(own))}
    own = [each for each in ((3, 5), (4, 5), (3,)) if 2 in columns and {*each} <= sure]
    errors = next(iter(own), ())
    places = [k for k in columns if k not in (1, *errors)][: len(errors) or 2]
    named = [f"{axis}={k}" for axis, k in zip("xy", places, strict=False)]
    named = [f"{own} s{own[0]}={k}" for own, k in zip(named, errors, strict=True)] or named
    options = [f"--columns t=1 {' '.join(named)}"]
    if {2, 3} <= {*columns} and 3 in sure:
        options.insert(len(errors) - 1, _VELOCITIES)
    told = f" ({' and '.join(map(str, errors))} being errors)" if errors else ""
    return ", or ".join(options) + told


def _are_velocities(columns):
    """Whether columns may be dates of nights, what is measured then, and its small errors."""
    if len(columns) < 3 or len(columns[0]) <= LEAST_STEPS:
        return False
    dates, values, errors = (np.array(_numbers(cells)) for cells in columns[:3])
    low, high = np.quantile(np.diff(dates), [0.25, 0.75])
    is_dated = dates[0] >= LEAST_DATE and high > UNEVEN * low and (dates % 1).any()
    return bool(is_dated and (errors > 0).all() and np.median(errors) < SMALL * np.ptp(values))


def _is_calendar(columns):
    """Whether years, months and days stand side by side."""
    ranges = zip((1, 2, 3), ((1800, 2100), (1, 12), (1, 31)), strict=True)
    return all(k in columns and all(low <= n <= high and n % 1 == 0 for n in _numbers(columns[k]))
               for k, (low, high) in ranges)  # fmt: skip


def _unit_of_dates(cells):
    """What the numbers of a first column count if they are dates: Julian days, or years; or ""."""
    ends = _ends(cells) if len(cells) else (0.0, 0.0)
    if are_within(*ends, (JULIAN,)):
        return "day"
    steps = sorted(_steps(cells))
    is_even = not steps or steps[3 * len(steps) // 4] < UNEVEN * steps[len(steps) // 4]
    if is_even or _age(cells) < OLD or all(value == round(value) for value in _numbers(cells)):
        return ""  # a clock
    return "yr" if are_within(*ends, (YEARS,)) else "day" if are_within(*ends, (MODIFIED,)) else ""


def _by_clock(columns, clocks):
    """How columns are said by their numbers beside one clock, which may be there in several units.

    Parameters
    ----------
    columns : mapping of int to list of str
        Number of a column, from 1 -> its cells.
    clocks : list of int
        Numbers of those that are the clock.
    """
    moving = [k for k, own in columns.items() if k not in clocks and {*_steps(own)} - {0.0, 1.0}]
    clock = clocks[0]
    x = moving[0] if moving else next(k for k in (2, 1) if k != clock)
    pushes = " ".join(f"a{axis}={k}" for axis, k in zip("xyz", moving, strict=False))
    again = "".join(f"; column {k} is the same clock" for k in clocks[1:])
    sides = zip(("a_x", "a_y", "b_x", "b_y"), moving, strict=False)
    beside = " ".join(f"{name}={k}" for name, k in sides)
    beside = f"; of bodies side by side {beside}" if len(moving) > 3 else ""
    back = sum(step < 0 for step in _steps(columns[clock]))
    back = f", but for {back} where it falls back" * bool(back)
    sight = f"; t={clock} rv={clock + 1} srv={clock + 2} of velocities along the line of sight"
    sight *= _are_errors(columns, clock + 1)
    return (f"--columns t={clock} x={x} (column {clock} increases from row to row{back}{again}; "
            f"y=, z= of further axes; t={clock} {pushes} of accelerations{beside}"
            f"{sight})")  # fmt: skip


def _are_errors(columns, k):
    """Whether of three columns the last holds errors of one: above 0, and small beside its span."""
    if not {k, k + 1} <= {*columns} or len(columns) != 3:
        return False
    values, errors = (np.array(_numbers(columns[n])) for n in (k, k + 1))
    return bool((errors > 0).all() and np.median(errors) < SMALL * np.ptp(values))


def _columns_of(lines, delimiter, cells):
    """Columns of numbers, and those of texts, by their numbers from 1.

    Looked at are rows as long as the first. Numbers may lack in rows; what is empty in all, as
    behind a comma at the end, is no column.
    """
    rows = [split_line(line, delimiter) for line in lines if line.strip()]
    columns = zip(*(row for row in rows if len(row) == len(cells)), strict=True)
    numbers, texts = {}, {}
    for k, own in enumerate(columns, 1):
        if all(_is_number(cell or "0") for cell in own):
            numbers[k] = own
        else:
            texts[k] = own
    return {k: own for k, own in numbers.items() if any(own)} or numbers, texts


def _ends(cells):
    numbers = _numbers(cells)
    return numbers[0], numbers[-1]


def _are_places(cells):
    """Whether a row is 0, 1, 2, as a header of pandas is, and hardly one of data."""
    return len(cells) > 1 and tuple(cells) == tuple(map(str, range(len(cells))))


def _is_even(head, number, delimiter, cells):
    """Whether white space tells cells apart: the rows below have as many, and no quotes hold it.

    Tabs do so unless they are mixed with blanks, and any white space would be even.
    """
    if delimiter == "\t":
        rows = [line for line in head[number:] if line.strip() and not COMMENT.match(line)]
        tabs, blanks = ({len(split_line(row, mark)) for row in rows} for mark in ("\t", None))
        return len(tabs) < 2 or len(blanks) > 1
    row = below(head, number).split()
    return delimiter is not None or not row or len(row) == len(cells)


def _without_idle_end(head, number, delimiter, cells):
    """Names of a header without the delimiter at its end, where no row below has as many cells."""
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
        for delimiter in _DELIMITERS:
            cells = names_in(head, number, delimiter)
            row = split_line(below(head, number), delimiter)
            is_row = len(row) == len(cells) > 1 and all(_is_number(c or "0") for c in row)
            is_named = not any(map(_is_number, cells)) and not is_rule(head[number])
            if is_row and any(row) and is_named:
                above = header_cells(head[number - 1], delimiter) if number else ()
                is_of_units = all(_BRACKETS.fullmatch(cell) for cell in cells if cell) or (
                    len(above) == len(cells) and all(map(is_unit, filter(None, cells)))
                )
                return (number - 1 if is_of_units and number else number), delimiter
    filled = [k for k, line in enumerate(head) if line.strip()]
    is_plain = comments and any(_names_cells(head, first, mark) for mark in _DELIMITERS)
    filled = filled[filled.index(first) :] if is_plain else filled
    first = number = next((k for k in filled if not is_sentence(head[k])), filled[0])
    counts = {mark: len(split_line(head[number], mark)) for mark in _DELIMITERS}
    marked = [mark for mark in _DELIMITERS[:-1] if counts[mark] > 1]
    delimiter = max(marked or _DELIMITERS, key=counts.get)
    while number < len(head) - 1 and _is_padded(split_line(head[number], delimiter)):
        number += 1
    return (first if _is_padded(split_line(head[number], delimiter)) else number), delimiter


def _names_cells(head, number, delimiter):
    """Whether a line has a name, and no number, for every cell of the row below, which has some."""
    names = names_in(head, number, delimiter)
    row = split_line(below(head, number), delimiter)
    return len(names) == len(row) > 1 and any(map(_is_number, row)) > any(map(_is_number, names))


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
        if len(row) != len(found) or any(map(_is_number, row)):
            break
    if COMMENT.match(head[number]):  # the names stand in a comment, and more may follow
        while data_line < len(head) and COMMENT.match(head[data_line]):
            data_line += 1
    cells = split_line(head[data_line], delimiter) if data_line < len(head) else ()
    if cells and all(is_rule(cell) for cell in cells):  # a rule under the header
        data_line += 1
    title = split_line(COMMENT.sub("", head[number - 1]), delimiter) if number else ()
    if number and _DIALECT.match(head[number - 1]):
        title = ()
    if number > 1 and len(title) == len(found):
        title = _of_individuals(split_line(head[number - 2], delimiter), title)
    decimal = _decimal(head[data_line:], delimiter)
    return Layout(delimiter, found, tuple(units), number, data_line, decimal, title)


def _of_rows(head, number, delimiter, n_cells):
    """What tells cells of rows apart, where that is another than in the header."""
    row = below(head, number)
    others = [mark for mark in _DELIMITERS[:-1] if len(split_line(row, mark)) == n_cells > 1]
    is_other = others and len(split_line(row, delimiter)) == 1
    return others[0] if is_other else delimiter


def _of_individuals(above, title):
    """Titles of several animals: whose a part of a body is, as DeepLabCut tells above the parts."""
    if len(above) != len(title) or above[0].lower() != "individuals":
        return title
    is_one = len(set(title[1:])) == 1
    names = (who if is_one else f"{who} {part}" for who, part in zip(above, title, strict=True))
    return tuple(names)


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
    if len(row) != len(names) or any(map(_is_number, row)):
        return False
    if is_marked and any(map(is_unit, filter(None, row))):
        return True
    numeric = [cell for cell, name in zip(row, names, strict=True) if name in number_columns(names)]
    return any(numeric) and all(map(is_unit, filter(None, numeric)))


def _is_number(text):
    try:
        float(text.replace(",", ".").replace("\u2212", "-"))
    except ValueError:
        return False
    return True
