"""Columns of numbers that have no names: what they are by their order, or how a user says it.

Two to four columns of which the first is a clock are t, x, y and z. Of others the complaint says
which column is a clock, as far as the numbers tell it, and what the rest may be.
"""

import math
import re
import sys
from functools import cached_property

import numpy as np

from bsp_gp.data.clock import slope_on_clock
from bsp_gp.data.extent import JULIAN, MODIFIED, YEARS, are_within
from bsp_gp.data.header_lines import split_line
from bsp_gp.data.headings import is_ignored
from bsp_gp.data.horizons import vectors_among
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import in_python

DELIMITERS = (",", ";", "\t", None)
"""None is white space."""
LEAST_STEPS, RISES, ROUNDED = 4, 0.95, 2.01
"""Steps of a column that may be a clock, the part of them that goes up, and last digits by which
those of an even one differ."""
MOST_EVEN = 60
"""Rows in which a clock is even, if it is: further down it may pause or begin anew."""
ANY_RISE = 0.65
"""Part of the steps of no column that goes up, where none is a clock: half do of what wanders."""
MOST_POWER = 300
"""Of ten that a number can have."""
_UNITS_OF_TIME = np.log([1, 1e3, 1e6, 1e9, 60, 3600, 86400])
_SAME_UNIT = 1e-3
"""How many of one unit another of a time is, and the part by which a clock may be off that."""
OLD, UNEVEN = 5.0, 2.0
"""How many times the span of a clock its first value is from 0 at least, if that is a date; and the
upper quartile of its steps, in the lower one, at least."""
LEAST_DATE, SMALL, MOST_JITTER = 1000.0, 0.3, 5.0
"""Days that Julian dates count from a later zero, at the least; errors in the span of what is
measured, and one for all rows in the size of its noise, at the most."""
MOST_INSTRUMENTS = 12
"""Names in a column of texts, of what velocities of one star were measured by."""
_VELOCITIES = "--columns t=1 rv=2 srv=3 of velocities along the line of sight"
_OF_CALENDAR = re.compile(
    r"\d{1,2}:\d\d(?::\d\d(?:\.\d*)?)?|(?:jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*",
    re.IGNORECASE,
)
"""A part of a date in a column of its own."""


def is_number(text):
    """Whether a text is a number, also with a decimal comma or the minus of typesetters."""
    try:
        float(_plain(text))
    except ValueError:
        return False
    return True


def _plain(text):
    return text.replace(",", ".").replace("\u2212", "-")


class _Column:
    """A column of numbers as it stands there: its cells, some of which may be empty."""

    def __init__(self, cells):
        self.cells = cells

    @cached_property
    def values(self):
        return np.array([float(_plain(cell) or "nan") for cell in self.cells])

    @cached_property
    def steps(self):
        return np.diff(self.values)

    @property
    def ends(self):
        return (self.values[0], self.values[-1]) if len(self.values) else (0.0, 0.0)

    @property
    def age(self):
        """How far the first value of a clock is from 0, in what it goes up."""
        first, last = self.ends
        return abs(first) / max(abs(last - first), sys.float_info.min)

    @property
    def counts(self):
        """Whether it goes up by one from row to row."""
        return bool((self.steps == 1).all())

    @property
    def may_be_clock(self):
        return len(self.steps) >= LEAST_STEPS and self.rises(RISES)

    @property
    def is_even(self):
        """Whether its steps are one but for its last digits."""
        least = 16 * sys.float_info.epsilon * np.abs(self.values).max()  # of a difference
        return bool(np.ptp(self.steps) <= max(ROUNDED * self._last_digit, least))

    @property
    def _last_digit(self):
        """Size of the last digit of the numbers that are written to the most places."""
        numbers = [re.split("[eE]", _plain(cell)) for cell in self.cells]
        ends = [int(power[0] if power else 0) - len(whole.partition(".")[2])
                for whole, *power in numbers]  # fmt: skip
        return 10.0 ** min(*ends, MOST_POWER)

    @property
    def unit_of_dates(self):
        """What its numbers count if they are dates: Julian days, or years; or ""."""
        if are_within(*self.ends, (JULIAN,)):
            return "day"
        steps = np.sort(self.steps)
        is_even = not len(steps) or steps[3 * len(steps) // 4] < UNEVEN * steps[len(steps) // 4]
        if is_even or self.age < OLD or (self.values == np.round(self.values)).all():
            return ""  # a clock
        spans = (YEARS, "yr"), (MODIFIED, "day")
        return next((unit for span, unit in spans if are_within(*self.ends, (span,))), "")

    def rises(self, part):
        """Whether so large a part of its steps goes up."""
        return bool((self.steps > 0).sum() >= part * len(self.steps))

    def first(self, count):
        return _Column(self.cells[:count])

    def is_clock_of(self, other):
        """Whether two columns go up together, in two units of time."""
        slope = slope_on_clock(other.values, self.values)
        return bool(slope) and np.abs(np.abs(math.log(slope)) - _UNITS_OF_TIME).min() < _SAME_UNIT

    def may_be_error_of(self, other):
        """Whether all numbers are above 0, and small beside what another column spans."""
        is_small = np.median(self.values) < SMALL * np.ptp(other.values)
        return bool((self.values > 0).all() and is_small)


def clock_among(columns):
    """Which of some columns is the clock: it alone increases, or does so evenly; or None.

    What counts rows is one only where nothing else increases.
    """
    rising = [k for k, own in enumerate(columns) if own.may_be_clock]
    even = [k for k in rising if not columns[k].counts and columns[k].is_even]
    found = even or rising
    return found[0] if len(found) == 1 else None


def clocks_among(columns):
    """Which of some columns are one clock in several units, that nearest to 0 first.

    What increases, and counts no rows, is the clock if nothing else does, or all of it is.
    """
    known = clock_among(columns)
    rising = [k for k, own in enumerate(columns) if own.may_be_clock and not own.counts]
    first = rising[0] if known is None and rising else known
    if first is None:
        return []
    same = [k for k in rising if k == first or columns[k].is_clock_of(columns[first])]
    if known is None and same != rising:
        return []
    return sorted(same or [first], key=lambda k: columns[k].age)


def rows_of_numbers(lines, said):
    """Rows of lines that begin with one of numbers, and the delimiter; none of other lines.

    Where it is said by their numbers which columns have them, others may be texts, unless these
    numbers are names in that line.
    """
    for delimiter in DELIMITERS if lines else ():
        cells = split_line(lines[0], delimiter)
        by_number = [cells[int(k) - 1] for k in said if k.isdecimal() and 0 < int(k) <= len(cells)]
        is_told = len(by_number) == len(said) > 0 and not said <= set(cells)
        asked = by_number if is_told else cells
        if any(asked) and all(is_number(cell or "0") for cell in asked):
            return [split_line(line, delimiter) for line in lines], delimiter
    return [], None


@np.errstate(all="ignore")  # cells may hold inf, or any power of ten
def named_by_place(rows, rename):
    """Our names of two to four columns of numbers, the first of which increases; {} of others."""
    is_even = len(set(map(len, rows))) == 1
    if not is_even or not all(is_number(cell or "0") for row in rows for cell in row):
        return {}
    columns = {str(k): _Column(cells) for k, cells in enumerate(zip(*rows, strict=True), 1)}
    kept = {number: own for number, own in columns.items()
            if any(own.cells) and not is_ignored(rename.get(number, ""), columns)}  # fmt: skip
    own = [*kept.values()]
    if not 2 <= len(own) <= 4 or not (own[0].steps > 0).all() or are_places(rows[0]):
        return {}
    if are_within(*own[0].ends, (JULIAN,)) or _are_velocities(own):
        return {}  # what stands beside dates is asked for
    if clock_among(own) not in (0, None) or len(clocks_among(own)) > 1:
        return {}  # asked for
    return dict(zip("txyz", kept, strict=False))


@np.errstate(all="ignore")
def constant_error(named, lines, delimiter):
    """What all rows have in the third of three columns, if it may be the error of the second.

    That is above 0, small beside what the second spans, and not far above what this jitters by.
    """
    if "".join(named) != "txy":
        return ""
    x, y = (int(named[axis]) - 1 for axis in "xy")
    rows = [split_line(line, delimiter) for line in lines() if line.strip()]
    rows = [row for row in rows if len(row) > y]
    own = {row[y] for row in rows}
    if len(own) != 1 or not all(is_number(row[x] or "0") for row in rows):
        return ""
    (constant,), places = own, _Column([row[x] for row in rows]).values
    size = float(_plain(constant)) if is_number(constant) else 0.0
    if len(places) <= LEAST_STEPS or not 0 < size < SMALL * np.ptp(places):
        return ""
    jitter = np.median(np.abs(np.diff(places, 3))) / (0.6745 * math.sqrt(20))
    return constant if size < MOST_JITTER * jitter else ""


def told_of_constant(constant, named):
    """A check that a column is taken as the error of the one before it."""
    return in_python(
        f"{CHECK}column {named['sx']} is {float(_plain(constant)):g} in every row: taken as the "
        f"error of x; if it is a place, --columns t={named['t']} x={named['x']} y={named['sx']}; "
        "if x is a velocity along the line of sight, --columns "
        f"t={named['t']} rv={named['x']} srv={named['sx']}"
    )


@np.errstate(all="ignore")
def remedy_of_numbers(cells, lines, delimiter):
    """How a user says which of the columns is which, by what their numbers may be.

    `cells` are those of the first row, `lines` that one and those below it.
    """
    if len(cells) == 1:
        return (
            "a table has a column of times as well; of rows that are evenly spaced, say how many "
            "there are in a second: --columns x=1 --fps 25 (of speeds vx=1, of accelerations ax=1)"
        )
    columns, texts = _columns_of(lines, delimiter, cells)
    if _is_calendar(columns) or (len(texts) > 1 and any(map(_has_clock, texts.values()))):
        return ("write what stands in several columns into one, dates as 2024-01-31T12:00:00 and "
                "angles as 12:34:56.7, below names such as t,ra,dec or t,x,y")  # fmt: skip
    clock = next((k for k, own in texts.items() if _has_clock(own)), None)
    if clock is not None:
        return f"column {clock} has times of a day: a header such as t,x,y reads them"
    remedy = "add a header such as t,x,y, or say which column is which by its number: "
    if vectors := vectors_among({k: own.cells for k, own in columns.items()}, texts):
        return remedy + vectors
    by_number = _by_number(columns, len(cells))
    by_number += _of_instruments(texts) if "rv=" in by_number else ""
    if are_places(cells):
        by_number += ", if that line is a row; if it numbers the columns itself, --columns t=0 x=1"
    return remedy + by_number


def _by_number(columns, n_cells):
    """The options that say which of some columns is which; `columns` are by number, from 1."""
    # A column that turns back further down is no clock, however it begins.
    few = {k: own.first(MOST_EVEN) for k, own in columns.items()}
    able = [k for k, own in columns.items() if own.rises(RISES)]
    clocks = [able[k] for k in clocks_among([few[k] for k in able])]
    unit = columns[1].unit_of_dates if len(columns) > 2 and 1 in columns else ""
    if unit:
        return _beside_dates(columns) + " with --units t=yr where dates are years" * (unit == "yr")
    if _are_velocities([columns[k] for k in (1, 2, 3) if k in columns]):
        return f"{_VELOCITIES} and their errors, or --columns t=1 x=2 y=3 of places"
    if len(clocks) == 1 and _may_be_place(columns, few, *clocks):
        return (f"{_without_clock(columns)}; or t={clocks[0]} if column {clocks[0]}, which "
                "increases from row to row, is a clock")  # fmt: skip
    if clocks:
        return _by_clock(columns, clocks)
    if columns and not any(own.rises(ANY_RISE) for own in columns.values()):
        return _without_clock(columns)
    t = next(iter(able), 1)
    x = min(columns.keys() - {t}, default=2, key=lambda k: (
        not (columns[k].steps % 1).any(), not columns[k].steps.any(), k
    ))  # fmt: skip
    more = "; t=1 ax=2 ay=3 az=4 of accelerations" if n_cells > 3 else ""
    return f"--columns t={t} x={x} (t=2 x=3 where the first counts rows or bodies{more})"


def _has_clock(cells):
    """Whether texts are hours, minutes and seconds, or names of months: parts of dates."""
    return all(map(_OF_CALENDAR.fullmatch, cells))


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
    others = [own.steps for k, own in columns.items() if k != clock]
    all_fall = all((steps < 0).sum() >= RISES * len(steps) for steps in others)
    is_first = clock == next(iter(columns))
    return len(columns) in (2, 3) and all_fall and not (is_first or few[clock].is_even)


def _of_instruments(texts):
    """A column of texts that may name instruments, and how that is said."""
    for k, cells in texts.items():
        names = [*dict.fromkeys(filter(None, cells))]
        if 1 < len(names) <= MOST_INSTRUMENTS:
            shown = ", ".join(names[:3]) + " ..." * (len(names) > 3)
            return f"; with instrument={k} where column {k} ({shown}) names what measured each"
    return ""


def _beside_dates(columns):
    """How columns are said by their numbers beside dates: of errors none is below 0."""
    sure = {k for k, own in columns.items() if (own.values > 0).all()}
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
    if len(columns) < 3 or len(columns[0].cells) <= LEAST_STEPS:
        return False
    dates, values, errors = columns[:3]
    low, high = np.quantile(dates.steps, [0.25, 0.75])
    is_dated = dates.values[0] >= LEAST_DATE and high > UNEVEN * low and (dates.values % 1).any()
    return bool(is_dated and errors.may_be_error_of(values))


def _is_calendar(columns):
    """Whether years, months and days stand side by side."""
    ranges = {1: (1800, 2100), 2: (1, 12), 3: (1, 31)}
    return ranges.keys() <= columns.keys() and all(
        ((low <= own) & (own <= high) & (own % 1 == 0)).all()
        for own, (low, high) in ((columns[k].values, span) for k, span in ranges.items())
    )


def _by_clock(columns, clocks):
    """How columns are said by their numbers beside one clock, which may be there in several units.

    `columns` are by their numbers, from 1; `clocks` those of what is the clock.
    """
    moving = [k for k, own in columns.items()
              if k not in clocks and {*own.steps.tolist()} - {0.0, 1.0}]  # fmt: skip
    clock = clocks[0]
    x = moving[0] if moving else next(k for k in (2, 1) if k != clock)
    pushes = " ".join(f"a{axis}={k}" for axis, k in zip("xyz", moving, strict=False))
    again = "".join(f"; column {k} is the same clock" for k in clocks[1:])
    sides = zip(("a_x", "a_y", "b_x", "b_y"), moving, strict=False)
    beside = " ".join(f"{name}={k}" for name, k in sides)
    beside = f"; of bodies side by side {beside}" if len(moving) > 3 else ""
    back = int((columns[clock].steps < 0).sum())
    back = f", but for {back} where it falls back" * bool(back)
    rate, error = clock + 1, clock + 2
    is_seen = {rate, error} <= {*columns} and len(columns) == 3
    is_seen = is_seen and columns[error].may_be_error_of(columns[rate])
    sight = f"; t={clock} rv={rate} srv={error} of velocities along the line of sight" * is_seen
    return (f"--columns t={clock} x={x} (column {clock} increases from row to row{back}{again}; "
            f"y=, z= of further axes; t={clock} {pushes} of accelerations{beside}"
            f"{sight})")  # fmt: skip


def _columns_of(lines, delimiter, cells):
    """Columns of numbers, and the cells of those of texts, by their numbers from 1.

    Looked at are rows as long as the first. Numbers may lack in rows; what is empty in all, as
    behind a comma at the end, is no column.
    """
    rows = [split_line(line, delimiter) for line in lines if line.strip()]
    columns = zip(*(row for row in rows if len(row) == len(cells)), strict=True)
    numbers, texts = {}, {}
    for k, own in enumerate(columns, 1):
        if all(is_number(cell or "0") for cell in own):
            numbers[k] = _Column(own)
        else:
            texts[k] = own
    return {k: own for k, own in numbers.items() if any(own.cells)} or numbers, texts


def are_places(cells):
    """Whether a row is 0, 1, 2, as a header of pandas is, and hardly one of data."""
    return len(cells) > 1 and tuple(cells) == tuple(map(str, range(len(cells))))
