"""Tables of JPL Horizons as plain ones.

Their layouts are those of its manual: below a preamble and a line of names rows stand between
``$$SOE`` and ``$$EOE``, separated by commas or in columns of fixed width. Vector tables have
places and velocities; of observer tables right ascension and declination are read, or heliocentric
longitude, latitude and distance.
"""

import math
import re
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.data.sky import is_sky
from bsp_gp.errors import DataError, in_python

BEGIN, END = "$$SOE", "$$EOE"
_VECTORS = ("JDTDB", "VX", "VY", "VZ", "X", "Y", "Z")
_UNITS = {"AU-D": ("au", "day"), "KM-S": ("km", "s"), "KM-D": ("km", "day")}
_RECORD = re.compile(r"\s*(\d+\.\d+)\s*=\s*(?:A\.D\.|B\.C\.|\d)")
_TIME = "t (day)"
_ELEMENT = re.compile(r"\s*EC\s*=")
_ENTRY = re.compile(r"\b(V?[XYZ])\s*=\s*([-+]?\d\.\d+E[-+]\d+)")


def plain_horizons(text, path):
    """Rows with units, the body and the one from which places count, and a note of that.

    What is none of Horizons' stays as it is.

    Raises
    ------
    DataError
        Where an observer table says no place.
    """
    begin = re.search(rf"^(.*?){re.escape(BEGIN)}[\s,]*$", text, re.M)
    if begin is None:
        return text
    mark = begin[1].strip()  # someone's sign of a comment
    lines = [line.removeprefix(mark) if mark else line for line in text.splitlines()]
    lines = [line.rstrip(", ") for line in lines]  # of a spreadsheet that has saved it again
    at = next(k for k, line in enumerate(lines) if line.strip() == BEGIN)
    end = next((k for k in range(at, len(lines)) if lines[k].strip() == END), len(lines))
    above, named = "\n".join(lines[:at]), [line for line in lines[:at] if line.strip("* ")]
    rows = [line for line in lines[at + 1 : end] if line.strip() and line.strip("* ")]
    name = _target(above)
    units = re.search(r"Output units\s*:\s*([\w-]+)", above)
    length, time = _UNITS.get(units[1] if units else "", ("", ""))
    if not (rows and named):
        return text
    if _RECORD.match(rows[0]):
        header, cells = list(_VECTORS), _records(rows, _unnamed(named))
    elif "," in named[-1]:
        header, cells = _separated(named[-1], rows)
    else:
        header, cells = _by_width(named[-1].rstrip(), rows)
    if "EC" in header or any(map(_ELEMENT.match, rows[:2])):
        raise DataError(
            "this table of Horizons has osculating elements of an orbit (EC, QR, IN, ...), and no "
            "places at times", file=path,
            remedy="ask Horizons for a vector table (Ephemeris Type: Vector Table)",
        )  # fmt: skip
    if "JDTDB" in header:
        made, cells = _vectors(header, cells, length, time)
    else:
        unit = re.search(r"Range units\s*:\s*(\w+)", above)
        made, cells = _seen(header, cells, path, unit[1].lower() if unit else "au")
    table = [["entity", *made], *([name, *row] for row in cells)]
    centre = _centre(above) if "JDTDB" in header else "Sun" * ("x (au)" in made)
    if centre and centre != name:
        table += [[centre, row[0], *["0"] * (len(made) - 1)] for row in cells]
    notes = (f"places count from {centre}, which is at rest at the origin",) * bool(centre)
    if "ra" in made and len(made) > len(("t", "ra", "dec")):
        seen_from = re.search(_CENTRE_NAME, above)
        notes += (f"places are those that are seen from {seen_from[1]}",) if seen_from else ()
    return table, notes


_CENTRE_NAME = re.compile(r"Center body name:\s*(.*?)\s*(?:\(\d+\)\s*)?(?:\{|$)", re.M)


def _target(above):
    """The body that the table is of, without the designation in brackets behind its name.

    What has a provisional designation alone, ``(2024 YR4)``, is called so.
    """
    line = re.search(r"Target body name:[ \t]*([^{\n]*)", above)
    text = line[1].strip() if line else ""
    name = re.sub(r"\s*\(.*", "", text) or text.strip("() ")
    return name or "body"


def _centre(above):
    """The body in whose middle places begin; "" where that is another point."""
    name = re.search(_CENTRE_NAME, above)
    site = re.search(r"Center-site name:\s*(.*?)\s*$", above, re.M)
    is_body = name is not None and site is not None and "barycent" not in name[1].lower()
    return name[1] if is_body and site[1].upper() in ("BODY CENTER", "BODYCENTRIC") else ""


_OF_DATE = re.compile(r"(?:A\.D\.|B\.C\.) ?\d+-[A-Z][a-z]{2}-\d\d\b.*")
_STEADY = 1e-3
"""Part of it by which the difference of two clocks changes."""


def vectors_among(columns, texts):
    """How rows of a vector table without its names are said by the numbers of their columns; or "".

    Behind Julian days and dates in words may stand how far apart two clocks are (delta-T).
    `columns` have the cells of columns of numbers, `texts` those of others, by their numbers from
    1.
    """
    dates = next((k for k, own in texts.items() if all(map(_OF_DATE.fullmatch, own))), None)
    numbers = {k: [float(cell) for cell in own] for k, own in columns.items() if all(own)}
    if dates is None or dates - 1 not in numbers:
        return ""
    behind = [k for k in numbers if k > dates]
    if behind and np.ptp(numbers[behind[0]]) < _STEADY * np.median(numbers[behind[0]]):
        behind = behind[1:]
    if len(behind) < len("xyz"):
        return ""
    named = " ".join(f"{axis}={k}" for axis, k in zip("xyz", behind, strict=False))
    return (f"--columns t={dates - 1} {named} --units time=day length=au (or km): dates are those "
            "of JPL Horizons, whose whole output, as it is, tells the units and from which body "
            "places count")  # fmt: skip


_DAY, _FAR = 86_400.0, 1e4
"""Seconds of a day, and au beyond which nobody asks for the places of bodies."""


def without_header(table, declaration):
    """The units of a table that has kept Horizons' headings, or astroquery's for what it sends.

    Days are those of its dates; whether places are in km or au, and velocities per second or per
    day, is told by their steps. Distances of astroquery are in au, its angles in degrees. Units
    that are declared are not asked for.
    """
    clock, others = table.theirs.get("t", ""), {text.split(" ")[0] for text in table.present}
    is_query = clock == "datetime_jd" and {"targetname", "datetime_str"} <= others
    if not is_query and not (clock.upper() == "JDTDB" and "Calendar" in others):
        return table
    if is_query and is_sky(table.frame):
        units = {"t": "day", "ra": "deg", "dec": "deg", "distance": "au"}
        own = {name: units[name] for name in units if name in table.frame}
        note = "headings are those of astroquery: angles in degrees, distances in au"
        return replace(table, units=own | table.units).noted(note)
    if "x" not in table.frame:
        return table
    length, speed = _by_steps(table) if "vx" in table.frame else ("", "")
    units = {"t": "day"} | {a: length for a in "xyz" if length} | {
        f"v{a}": speed for a in "xyz" if speed
    }  # fmt: skip
    said, known = declaration.units, {**table.units}
    for name, unit in units.items():
        if name in table.frame and not {name, "time" if name == "t" else "length"} & set(said):
            known.setdefault(name, unit)
    told = f"places in {length} and velocities in {speed}, by their steps" if length else (
        "the unit of places is not known: --units length=km (or au)"
    )  # fmt: skip
    whose = "astroquery" if is_query else "JPL Horizons"
    notes = (
        f"headings are those of {whose}: times in days, {told}",
        f"{CHECK}the file does not say from which body places count: a pull of that body is one "
        "towards the origin; the whole output of Horizons, as it is, says which it is",
    )
    return replace(table, units=known).noted(*map(in_python, notes))


def _by_steps(table):
    """Units of places and velocities; "" where steps and velocities do not agree in any."""
    times, place, speed = (table.numbers(name) for name in ("t", "x", "vx"))
    gone = np.diff(place) / np.diff(times)
    ratio = float(np.nanmedian(np.abs(gone)) / np.nanmedian(np.abs(speed)))
    if abs(ratio / _DAY - 1) < 0.5:
        return "km", "km/s"
    if abs(ratio - 1) < 0.5:
        length = "au" if float(np.nanmax(np.abs(place))) < _FAR else "km"
        return length, f"{length}/day"
    return "", ""


def _unnamed(lines):
    """Names of what the lines of a record have, as they stand below ``JDCT`` or ``JDTDB``."""
    at = next((k for k, line in enumerate(lines) if re.match(r"\s*JD(CT|TDB)\b", line)), None)
    return [] if at is None else [line.split() for line in lines[at + 1 :]]


def _records(rows, unnamed):
    """Cells of a vector table that has several lines for every time."""
    out, k = [], 0
    for line in rows:
        start = _RECORD.match(line)
        if start:
            out.append({"JDTDB": start[1]})
            k = 0
        elif out:
            found = _ENTRY.findall(line)
            if not found and k < len(unnamed):
                found = [*zip(unnamed[k], line.split(), strict=False)]
            out[-1].update(found)
            k += 1
    return [[own.get(name, "") for name in _VECTORS] for own in out]


def _separated(line, rows):
    """Names and cells of a table in CSV form."""
    names = [cell.strip() for cell in line.split(",")]
    cells = [[cell.strip() for cell in row.split(",")] for row in rows]
    return names, [[*row, *[""] * len(names)][: len(names)] for row in cells]


def _by_width(line, rows):
    """Names and cells of a table in columns, each of which ends below its name."""
    ends = [(m.end(), m[0]) for m in re.finditer(r"\S+", line)]
    starts = [0, *(end for end, _ in ends[:-1])]
    cells = [[row[a:b].strip() for a, (b, _) in zip(starts, ends, strict=True)] for row in rows]
    return [name for _, name in ends], cells


def _vectors(names, cells, length, time):
    """Columns of a vector table: their headings with units, and their cells."""
    kept = [k for k, name in enumerate(names) if name in _VECTORS and any(row[k] for row in cells)]
    own = {"J": "day", "V": f"{length}/{time}" if time else ""}
    header = []
    for name in (names[k] for k in kept):
        unit = own.get(name[0], length)
        header.append(f"{name} ({unit})" if unit else name)
    return header, [[row[k] for k in kept] for row in cells]


def _seen(names, cells, path, length):
    """Columns of an observer table: a time, and what says a place; `length`, unit of distances."""
    columns = {re.sub(r"_+", "_", name): k for k, name in enumerate(names)}
    dates = [k for name, k in columns.items() if name.startswith("Date")]
    julian = [k for name, k in columns.items() if "JD" in name]
    column = (julian or dates or [0])[-1]
    cells = [[row[column] if julian else _days(row[column], path), *row] for row in cells]
    columns = {name: k + 1 for name, k in columns.items()}
    both = [k for name, k in columns.items() if name.startswith("R.A.") and name.endswith("DEC")]
    far = [columns[name] for name in ("delta",) if name in columns]
    header = [_TIME, "ra", "dec", *[f"distance ({length})"] * len(far)]
    if both:
        cut = [(*_angles(row[both[0]]), *(row[k] for k in far)) for row in cells]
        return header, [[row[0], *p] for row, p in zip(cells, cut, strict=True)]
    alone = [[k for n, k in columns.items() if n.startswith(w)] for w in ("R.A.", "DEC")]
    if all(alone):
        at = [*(k[0] for k in alone), *far]
        return header, [[row[0], *(row[k] for k in at)] for row in cells]
    spherical = [columns.get(name) for name in ("hEcl-Lon", "hEcl-Lat", "r")]
    if None not in spherical:
        header = [_TIME, *(f"{axis} (au)" for axis in "xyz")]
        return header, [[row[0], *_place(*(row[k] for k in spherical))] for row in cells]
    raise DataError(
        f"this observer table of Horizons says no place; its columns are {', '.join(names)}",
        file=path,
        remedy="ask Horizons for a vector table, or for right ascension and declination "
        "(quantity 1), or for heliocentric longitude, latitude and distance (18 and 19)",
    )  # fmt: skip


def _days(text, path):
    """Days of a date such as ``2022-Sep-01 21:14``, counted from the year 1, as a text."""
    for form in ("%Y-%b-%d %H:%M", "%Y-%b-%d %H:%M:%S", "%Y-%b-%d %H:%M:%S.%f", "%Y-%b-%d"):
        try:
            date = datetime.strptime(text.removeprefix("A.D. ").strip(), form)
        except ValueError:
            continue
        clock = date - datetime(date.year, date.month, date.day)
        return repr(date.toordinal() + clock / timedelta(days=1))
    problem = f"no date is known in {text!r}"
    raise DataError(problem, file=path, remedy="ask Horizons for Julian days")


def _angles(text):
    """Right ascension and declination of one cell, without the marks of sun and moon before it."""
    parts = re.sub(r"^[^\d+-]+", "", text).split()
    half = len(parts) // 2
    return " ".join(parts[:half]), " ".join(parts[half:])


def _place(longitude, latitude, distance):
    """Places x, y, z of angles in degrees and a distance, as texts."""
    if not (longitude and latitude and distance):
        return "", "", ""
    lon, lat, far = math.radians(float(longitude)), math.radians(float(latitude)), float(distance)
    flat = far * math.cos(lat)
    return tuple(map(repr, (flat * math.cos(lon), flat * math.sin(lon), far * math.sin(lat))))
