"""Times that are written as dates or as times of the day, in seconds."""

import re
import time
from dataclasses import replace

import numpy as np
import pandas as pd

from bsp_gp.errors import UnitError
from bsp_gp.units import Unit, parse_unit

_IN_SECONDS = "times are in seconds since"
"""What a note of dates says, where no other unit is declared."""
_DAYS = {
    r"\d{4}/\d\d/\d\d": "%Y/%m/%d", r"\d{1,2} [A-Za-z]{3} \d{4}": "%d %b %Y",
    r"\d{1,2}-[A-Za-z]{3}-\d{4}": "%d-%b-%Y", r"\d{4}-[A-Za-z]{3}-\d{2}": "%Y-%b-%d",
    r"\d{1,2}\.\d{1,2}\.\d{4}": "%d.%m.%Y",
}  # fmt: skip
"""Ways of writing a date in which day and month cannot be mistaken for each other."""
_TIMES = {"": "", r" \d\d:\d\d": " %H:%M", r" \d\d:\d\d:\d\d": " %H:%M:%S"}
_FORMATS = {r"\d{4}-\d\d(-\d\d.*)?": "ISO8601"} | {
    f"{day}{clock}": f"{date}{time}" for day, date in _DAYS.items()
    for clock, time in _TIMES.items()
}  # fmt: skip
_PARTS = r"(?<=:\d\d)[.,]\d+$"
"""Of a second, at the end of a date."""
_TURNED = r"\d{1,2}/\d{1,2}/\d{4} \d{1,2}:\d\d:\d\d(\.\d+)?"
"""A date in which day and month may be mistaken for each other, which matters where it changes."""
_ERA = r"^(?:A\.?D\.?|C\.?E\.?)\s+(?=\d)"
"""Before a year of ours: ``A.D. 2025-Jul-01 00:00:00.0000``, as Horizons writes it."""
_OF_JAVA = r"^[A-Z][a-z]{2} ([A-Z][a-z]{2}) +(\d{1,2}) (\d\d:\d\d:\d\d)(?: ([A-Z]\S*))? (\d{4})$"
"""``Wed Feb 23 06:37:13 GMT+08:00 2022``, of Java, and of C without a zone."""
_CLOCK = r"\d{1,3}:\d\d:\d\d(?:[.,]\d+)?"
_MINUTES = r"\d{1,3}:\d\d[.,]\d+"
"""``38:05.6``, as spreadsheets show a time of the day with parts of a second; ``12:30`` is none."""
HOUR, DAY = 3600.0, 86_400.0
EARLIEST = 1.0e9
"""Seconds since 1970 of the year 2001."""
_TICKS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def since_1970(times, unit=""):
    """Unix times in seconds since the first of them, and the unit they count; None of others.

    What would be in the future counts from another instant. `unit` is that which is said of them,
    if any.
    """
    known = times[np.isfinite(times)]
    for name, ticks in _TICKS.items():
        low, high = EARLIEST * ticks, (time.time() + DAY) * ticks
        if len(known) and unit in ("", name) and low <= known.min() and known.max() < high:
            return (times - known.min()) / ticks, name
    return None


def seconds_of(cells):
    """Times in seconds, and since when; None if they are no dates.

    Blank cells are missing.

    Returns
    -------
    seconds : ndarray
        Since `start`; nan where there is none.
    start : str
        The first of the dates, "midnight", or "the full hour".
    """
    is_known = cells.notna().to_numpy()
    known = cells[is_known]
    if not len(known):
        return None
    if not pd.api.types.is_datetime64_any_dtype(known):
        known = known.astype(str).str.strip().str.replace(_ERA, "", regex=True)
        if _are(known, _CLOCK):
            return _spread(is_known, _of_parts(known, [3600.0, 60.0, 1.0])), "midnight"
        if _are(known, _MINUTES):
            return _spread(is_known, going_on(_of_parts(known, [60.0, 1.0]), HOUR)), "the full hour"
        if _are(known, _TURNED):
            known = _either_way(known)
            if known is None:
                return None
        of_java = known.str.extract(_OF_JAVA)
        if of_java[3].nunique() < 2:  # another zone may be that of the summer
            known = known.str.replace(_OF_JAVA, r"\2 \1 \5 \3", regex=True)
        whole = known.str.replace(_PARTS, "", regex=True)
        form = next((form for regex, form in _FORMATS.items() if _are(whole, regex)), None)
        if form is None:
            return None
        if form.endswith("%S") and (whole != known).any():  # full seconds may have no parts
            known, form = known.where(whole != known, known + ".0"), f"{form}.%f"
        try:
            known = pd.to_datetime(known.str.replace(",", "."), format=form, utc=True)
        except (ValueError, OverflowError):
            return None
    start = known.min()
    seconds = (known - start) / pd.Timedelta(seconds=1)
    return _spread(is_known, seconds.to_numpy(dtype=float)), f"{start:%Y-%m-%d %H:%M:%S}"


def _are(cells, regex):
    """Whether all cells are written so; most are known by the first one."""
    return bool(re.fullmatch(regex, cells.iloc[0])) and cells.str.fullmatch(regex).all()


def _of_parts(cells, sizes):
    """Seconds of what stands between colons, each of some size."""
    parts = cells.str.replace(",", ".").str.split(":", expand=True).astype(float)
    return parts.to_numpy() @ sizes


def going_on(seconds, turn):
    """Seconds (n,) of an hour, or of a day (`turn`), that go on where another begins."""
    return seconds + turn * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -turn / 2)


def _either_way(cells):
    """Dates with the day first, or the month, in ISO; None where both can be and differ."""
    parts = cells.str.extract(r"(\d+)/(\d+)/(\d+) (.*)")
    found = []
    for day, month in ((0, 1), (1, 0)):
        if parts[month].astype(int).max() > 12 or parts[day].astype(int).max() > 31:
            continue
        text = [f"{y}-{m:>02}-{d:>02} {clock:>08}" for d, m, y, clock in
                parts[[day, month, 2, 3]].itertuples(index=False)]  # fmt: skip
        found.append(pd.Series(text, cells.index))
    is_one_day = (parts[[0, 1, 2]].nunique() == 1).all()
    return found[0] if len(found) == 1 or (found and is_one_day) else None


def _spread(is_known, values):
    out = np.full(len(is_known), np.nan)
    out[is_known] = values
    return out


def with_unix_times(table, units):
    """Unix times, whatever they count, in seconds since the first."""
    if "t" not in table or table.is_dated or not table.is_numeric("t"):
        return table
    said = units.get("t", units.get("time", table.units.get("t", "")))
    found = since_1970(table.frame["t"].to_numpy(dtype=float), said)
    if found is None:
        return table
    times, unit = found
    table = replace(table.assigned(t=times), units={**table.units, "t": "s"}, is_dated=True)
    return table.noted(f"times count {unit} since 1970: they are in seconds since the first")


def as_declared(table, units):
    """Times that were dates in the unit that is declared: they are in none of their own."""
    text = units.get("t", units.get("time"))
    if not table.is_dated or text is None:
        return table
    try:
        scale, unit = parse_unit(text)
    except UnitError:  # told where all units are read
        return table
    if unit != Unit.of(s=1):
        return table
    frame = table.frame.assign(t=table.frame["t"] / scale)
    notes = tuple(note.replace(_IN_SECONDS, f"times are in {text} since") for note in table.notes)
    return replace(table, frame=frame, units={**table.units, "t": text}, notes=notes)
