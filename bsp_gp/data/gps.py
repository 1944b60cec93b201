"""Files of receivers of satellites as plain tables: GPX, TCX, KML, IGC, sentences of NMEA.

Elements are those of the published schemas (GPX 1.1 of Topografix, TrainingCenterDatabase v2 of
Garmin, ``gx:Track`` of KML), records those of the flight recorders of the FAI (IGC). Every unbroken
piece of a track is a run where there are several.
"""

import re
from datetime import UTC, datetime
from xml.etree import ElementTree

import numpy as np

from bsp_gp.data.dates import DAY, going_on
from bsp_gp.errors import DataError

ENDINGS = (".gpx", ".tcx", ".kml")
OF_GLIDERS = ".igc"
NMEA = ("$GP", "$GN", "$GL", "$GA", "$P")
"""How sentences of receivers begin, and those of devices among them ("$P")."""
_HEADER = ("run", "t (s)", "latitude", "longitude", "altitude (m)")
_REMEDY = "export the track with times, as GPX or as a table with times, latitudes and longitudes"
_SENTENCE = re.compile(r"\$G[PNLA](RMC|GGA|GLL),([^*\n]*)")
_FIELDS = {"RMC": (0, 2, None), "GGA": (0, 1, 8), "GLL": (4, 0, None)}
"""Where sentences have the time of the day, the latitude (and the longitude), the altitude."""


_FIX = re.compile(
    r"B(\d\d)(\d\d)(\d\d)(\d\d)(\d{5})([NS])(\d{3})(\d{5})([EW])([AV])(-\d{4}|\d{5})(-\d{4}|\d{5})"
)
"""A fix of a flight recorder: time of the day, latitude and longitude in degrees and thousandths of
minutes, whether the height is one of satellites (A), pressure altitude and height of these, m."""


def of_xml(text, path):
    """The points of a GPX, TCX or KML file as rows, the header first, and notes.

    Raises
    ------
    DataError
        If this is no such XML, declares entities, or no point has a time.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DataError("an XML file with a DOCTYPE is not read", file=path, remedy=_REMEDY)
    try:
        root = ElementTree.fromstring(text.lstrip("\ufeff").strip())
    except ElementTree.ParseError as error:
        raise DataError(f"this is no XML ({error})", file=path, remedy=_REMEDY) from None
    pieces = {"trkseg": _gpx, "Track": _kml if _name(root) == "kml" else _tcx}
    runs = [pieces[_name(e)](e) for e in root.iter() if _name(e) in pieces]
    runs = [rows for run in runs if (rows := [row for row in run if row[0] and row[1]])]
    if not runs:
        raise DataError("no point of a track has a time", file=path, remedy=_REMEDY)
    return _table([(str(k), *row) for k, run in enumerate(runs, 1) for row in run])


def of_nmea(text, path):
    """The fixes among sentences of NMEA 0183 as rows, the header first, and notes.

    Times of the day go on over midnight; sentences of one instant say one place.
    """
    clocks, places = [], []
    for kind, body in _SENTENCE.findall(text):
        cells = body.split(",")
        at, place, above = _FIELDS[kind]
        if len(cells) <= max(at, place + 3, above or 0) or not (cells[at] and cells[place]):
            continue
        clock = float(cells[at])
        clocks.append(clock // 10_000 * 3600 + clock % 10_000 // 100 * 60 + clock % 100)
        lat, north, lon, east = cells[place : place + 4]
        height = cells[above] if above else ""
        places.append((_degrees(lat, north == "S"), _degrees(lon, east == "W"), height))
    if not places:
        raise DataError("no sentence has a time and a place", file=path, remedy=_REMEDY)
    fixes = {}
    for seconds, place in zip(going_on(np.array(clocks), DAY).tolist(), places, strict=True):
        if seconds not in fixes or place[-1]:
            fixes[seconds] = place
    return _table([("1", f"{t:.9g}", *fix) for t, fix in fixes.items()])


def of_igc(text, path):
    """The fixes of a flight recorder as rows, the header first, and notes.

    Heights are those of satellites, or of the pressure where most fixes have none of these.
    """
    found = [fix.groups() for line in text.splitlines() if (fix := _FIX.match(line.strip()))]
    if not found:
        raise DataError("no record B says a time and a place", file=path, remedy=_REMEDY)
    whole = [fix for fix in found if fix[9] == "A" and int(fix[11])]
    has_heights = 2 * len(whole) > len(found)
    fixes, used = {}, whole if has_heights else found
    clocks = [3600 * int(fix[0]) + 60 * int(fix[1]) + int(fix[2]) for fix in used]
    for seconds, fix in zip(going_on(np.array(clocks), DAY).tolist(), used, strict=True):
        lat, lon = (int(fix[k]) + int(fix[k + 1]) / 60_000 for k in (3, 6))
        lat, lon = lat * (-1) ** (fix[5] == "S"), lon * (-1) ** (fix[8] == "W")
        height = fix[11 if has_heights else 10]
        fixes.setdefault(seconds, (f"{lat:.7f}", f"{lon:.7f}", str(int(height))))
    out, notes = _table([("1", f"{t:.9g}", *fix) for t, fix in fixes.items()])
    if not has_heights:
        return out, (*notes, "heights are those of the pressure: few fixes have one of satellites")
    lost = len(found) - len(whole)
    return out, (*notes, *((f"fixes without a height are left out: {lost}",) if lost else ()))


def _table(rows):
    """Rows of a table, without runs where there is one and heights where few have any; notes.

    Where most have a height, those without are no places in space.
    """
    high = [row for row in rows if row[-1]]
    has_heights = 2 * len(high) > len(rows)
    note = f"fixes without a height are left out: {len(rows) - len(high)}"
    notes = (note,) if has_heights and len(high) < len(rows) else ()
    rows = high if has_heights else rows
    first = 0 if len({row[0] for row in rows}) > 1 else 1
    stop = len(_HEADER) - (not has_heights)
    return [row[first:stop] for row in (_HEADER, *rows)], notes


def _name(element):
    """Of an element, without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _own(element, *names):
    """The text of the first of what is within that has a name; "" without."""
    found = (e.text for e in element.iter() if _name(e) in names and e.text)
    return next(found, "").strip()


def _gpx(piece):
    for point in piece:
        if _name(point) == "trkpt":
            time, height = _own(point, "time"), _own(point, "ele")
            yield _seconds(time), point.get("lat", ""), point.get("lon", ""), height


def _tcx(piece):
    for point in piece:
        lat, lon = _own(point, "LatitudeDegrees"), _own(point, "LongitudeDegrees")
        yield _seconds(_own(point, "Time")), lat, lon, _own(point, "AltitudeMeters")


def _kml(piece):
    times = [e.text or "" for e in piece if _name(e) == "when"]
    places = [(e.text or "").split() for e in piece if _name(e) == "coord"]
    for time, (lon, lat, *height) in zip(times, filter(None, places), strict=False):
        yield _seconds(time.strip()), lat, lon, height[0] if height else ""


def _seconds(date):
    """Seconds since 1970 of a date in ISO 8601, as a text; "" of none."""
    try:
        found = datetime.fromisoformat(date)
    except ValueError:
        return ""
    return f"{found.replace(tzinfo=found.tzinfo or UTC).timestamp():.3f}"


def _degrees(text, is_negative):
    """Degrees of degrees and minutes, ``4154.930``, as a text."""
    value = float(text)
    value = value // 100 + value % 100 / 60
    return f"{-value if is_negative else value:.9f}"
