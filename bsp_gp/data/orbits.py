"""Orbits of satellites in the formats in which their services and programs exchange them.

Layouts are those of the IGS ("The Extended Standard Product 3 Orbit Format": below a head that
begins with ``#`` and ``##`` a line ``*`` says an epoch, and a line ``P`` below it where each
satellite is, in km, on axes that turn with the Earth), of the CCSDS (orbit ephemeris messages), of
STK (``.e``), and of the service Miriade of the IMCCE, whose comments say from where places count.
The body from which they do is at rest at the origin.
"""

import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.errors import DataError

OF_SP3 = r"#[a-d][PV]\s*\d{4}[^\n]*\n##"
OF_ELEMENTS = (
    r"(?:[^\n]*\n)?1 [ \w]{5}[UCS ] .{8} [ \d]{5}\.\d{8} [^\n]*\n2 [ \w]{5} [ \d]{3}\.\d{4} "
)
"""How such files begin; of elements a line with the name may stand above."""
_TURN = 7.2921151467e-5
"""Of the Earth, rad/s."""
_TURNING = re.compile(r"(?i)fixed|ITRF.*|TDR|GRC|WGS.*|ECEF|EFG")
"""Axes that turn with the body from which places count."""
_MESSAGE = re.compile(
    r"\s*(?:(\w+)\s*=\s*(\S.*?)|(\d{4}-[\d-]+T[\d:]+(?:\.\d{1,6})?)\d*Z?((?:\s+[-+.\dEe]+){3,9}))\s*"
)
"""A line of a message: what it says of what, or a date and numbers."""
_FROM_SUN, _PLACE = re.compile(r"(?i)helio|sun\b"), re.compile(r"[XYZ] ?\(")
"""Where places of Miriade begin, and their columns."""
_STK = re.compile(r"^\s*(CentralBody|CoordinateSystem|DistanceUnit)\s+(\S.*?)\s*$", re.M)


def of_sp3(text, path):
    """A table of satellites about the Earth, on axes that keep their directions."""
    first, seconds, rows = None, 0.0, []
    for line in text.splitlines():
        if line.startswith("* "):
            year, month, day, hour, minute, second = line[1:].split()[:6]
            epoch = datetime(*map(int, (year, month, day, hour, minute)))
            epoch += timedelta(seconds=float(second))
            first = first or epoch
            seconds = (epoch - first) / timedelta(seconds=1)
        elif line.startswith("P") and first is not None:
            place = [float(line[a : a + 14]) for a in (4, 18, 32)]
            if any(place):  # zeros stand where nothing is known
                rows.append((line[1:4].strip(), seconds, place))
    return _table(rows, "Earth", "km", "SP3")


def of_message(text, path):
    """A table of the bodies of an orbit ephemeris message of the CCSDS."""
    about, first, rows = {}, None, []
    for line in filter(None, map(_MESSAGE.fullmatch, text.splitlines())):
        name, value, date, numbers = line.groups()
        if name:
            about[name] = value
            continue
        form = "%Y-%jT%H:%M:%S" if date.count("-") == 1 else "%Y-%m-%dT%H:%M:%S"
        epoch = datetime.strptime(date, form + ".%f" * ("." in date))
        first = first or epoch
        place = [float(number) for number in numbers.split()[:3]]
        rows.append((about["OBJECT_NAME"], (epoch - first) / timedelta(seconds=1), place))
    return _table(rows, about["CENTER_NAME"].title(), "km", about["REF_FRAME"])


def of_stk(text, path):
    """A table of the one body of an ephemeris of STK, which is called as its file."""
    about = dict(_STK.findall(text))
    _, _, body = re.split(r"^\s*(EphemerisTimePos(?:Vel|VelAcc)?)\s*$", text, flags=re.M)
    lines = [line.split() for line in body.partition("END")[0].splitlines() if line.strip()]
    rows = [(Path(path).stem, float(t), [*map(float, place[:3])]) for t, *place in lines]
    unit = "km" if about.get("DistanceUnit", "").lower().startswith("kilo") else "m"
    frame = about.get("CoordinateSystem", "Fixed")
    return _table(rows, about.get("CentralBody", "Earth"), unit, frame)


def of_miriade(text, path):
    """The table of Miriade with its body by name, and the Sun, if places count from it.

    Others, and places on the sky, stay as they are.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    above = " ".join(line for line in lines if line.startswith("#"))
    header, *rows = ([cell.strip() for cell in line.split(",")]
                     for line in lines if not line.startswith("#"))  # fmt: skip
    centre = re.search(r"frameCentre:\s*(\w+)", above, re.IGNORECASE)
    is_of_places = "rectangular" in above and header[:2] == ["Target", "Date"]
    if not is_of_places or centre is None or not _FROM_SUN.match(centre[1]):
        return text
    names = ["entity", "Date", *header[2:]]
    if any(len(row) != len(header) for row in rows):
        raise ValueError("rows and names of columns are not as many")
    kept = [0, 1, *(k for k, name in enumerate(header) if _PLACE.match(name))]
    dates = dict.fromkeys(row[1] for row in rows)
    still = [["Sun", date, *["0"] * (len(kept) - 2)] for date in dates]
    out = [[row[k] for k in kept] for row in ([names] + rows)] + still
    left = [name for k, name in enumerate(header) if k not in kept]
    notes = ("places count from the Sun, which is at rest at the origin",)
    return out, notes + (f"not used: {', '.join(left)}",) * bool(left)


def elements(text, path):
    """DataError: elements are no table of a motion."""
    raise DataError(
        "these are two-line elements of an orbit (TLE): what a model was fitted to, and no places "
        "at times", file=path,
        remedy="tabulate the orbit with a program that reads them (sgp4 or skyfield of Python) as "
        "t,x,y,z and give that table: what is found is then in that model",
    )  # fmt: skip


def _table(rows, centre, unit, frame):
    """Rows of a table of (body, seconds, place), with the centre at rest; and a note."""
    is_turning = frame == "SP3" or _TURNING.fullmatch(frame.strip()) is not None
    if is_turning and centre != "Earth":
        raise ValueError(f"axes that turn with {centre}")
    header = ["entity", "t (s)", *(f"{axis} ({unit})" for axis in "xyz")]
    out = [[name, seconds, *(_turned(place, seconds) if is_turning else place)]
           for name, seconds, place in rows]  # fmt: skip
    is_body = "barycent" not in centre.lower()
    note = f"places count from {centre}" + ", which is at rest at the origin" * is_body
    if is_turning:
        note = (
            f"{CHECK}places of {frame} turn with the Earth: they are turned back by its turn since "
            "the first epoch, so that axes keep their directions; the Earth is at rest at the "
            "origin"
        )
    if is_body:
        out = [[centre, s, 0, 0, 0] for s in dict.fromkeys(row[1] for row in out)] + out
    return [header, *out], (note,)


def _turned(place, seconds):
    """A place on axes of the Earth, on those that these had at the first epoch."""
    cosine, sine = np.cos(_TURN * seconds), np.sin(_TURN * seconds)
    x, y, z = place
    return float(cosine * x - sine * y), float(sine * x + cosine * y), float(z)
