"""Tables below a preamble, as programs of motion capture and loggers write them, as plain ones.

What reads a kind of file gives rows, or a text where it has only taken something off it, and may
give notes beside these.

Layouts are those of the programs' own documentation: the TRC files of Motion Analysis and OpenSim,
the exports of OptiTrack's Motive, of Vicon's Nexus and of Qualisys' QTM (in mm), TOA5 of Campbell's
loggers, the enhanced CSV of Astropy, machine-readable tables of the AAS and the CDS, LabVIEW's
measurement files, the texts of Leybold's CASSY Lab, measures of double stars as the US Naval
Observatory mails them and Tokovinin's ORBIT takes them, sentences of NMEA 0183 (`bsp_gp.data.gps`),
orbits of satellites (`bsp_gp.data.orbits`), observations of the Minor Planet Center
(`bsp_gp.data.minor_planets`), and tables of JPL Horizons (`bsp_gp.data.horizons`).
"""

import csv
import math
import re
from collections import Counter
from itertools import takewhile

from bsp_gp.data.gps import NMEA, of_nmea
from bsp_gp.data.header_lines import split_line, tabbed
from bsp_gp.data.horizons import plain_horizons
from bsp_gp.data.minor_planets import OF_OBSERVATIONS, of_observations
from bsp_gp.data.notes import listed
from bsp_gp.data.orbits import OF_ELEMENTS, OF_SP3, elements, of_message, of_miriade, of_sp3, of_stk
from bsp_gp.errors import DataError


def _long(rows, time, owners, unit, path):
    """Rows of markers side by side as one row per time and marker; owners: (column of X, name)."""
    names = [name for _, name in owners]
    if not owners or len(set(names)) < len(names):
        raise DataError(
            f"the header must name markers, each once, got {names[:6]}", file=path,
            remedy="export markers with labels, or a table with columns t, entity, x, y, z",
        )  # fmt: skip
    behind = f" ({unit})" if unit else ""
    out = [["entity", "t (s)", *(f"{axis}{behind}" for axis in "xyz")]]
    for row in rows:
        for start, name in owners:
            place = [*row[start : start + 3], "", "", ""][:3]
            if any(place):
                out.append([name, time(row), *place])
    return out


def _trc(text, path):
    lines = text.splitlines()
    about = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    names = split_line(lines[3], "\t")
    owners = [(k, name) for k, name in enumerate(names) if name and k > 1]
    rows = [split_line(line, "\t") for line in lines[5:] if line.strip()]
    return _long(rows, lambda row: row[1], owners, about["Units"].strip(), path)


def _motive(text, path):
    lines = text.splitlines()
    about = split_line(lines[0], ",")
    unit = about[about.index("Length Units") + 1].lower() if "Length Units" in about else ""
    start = next(k for k, line in enumerate(lines) if line.startswith("Frame,Time"))
    above = [split_line(line, ",") for line in lines[1:start]]
    kinds = next(row for row in above if "Position" in row)
    named = next(row for row in above if "Name" in row)
    owners = [
        (k, named[k]) for k, axis in enumerate(split_line(lines[start], ","))
        if axis == "X" and kinds[k] == "Position"
    ]  # fmt: skip
    rows = [split_line(line, ",") for line in lines[start + 1 :] if line.strip()]
    return _long(rows, lambda row: row[1], owners, unit, path)


def _tracking_tools(text, path):
    """The rows of frames that OptiTrack's Tracking Tools wrote, with as many markers as were seen.

    What is told apart is called by the names, which are numbers where nobody gave any.
    """
    rows = (split_line(line, ",") for line in text.splitlines())
    rows = [row for row in rows if row[:1] == ("frame",)]
    out = [["entity", "t (s)", *(f"{axis} (m)" for axis in "xyz")]]
    for row in rows:
        bodies, markers = int(row[3]), row[4:]
        markers = markers[11 * bodies :]  # of a rigid body: its number, place and turn
        for k in range(int(markers[0]) if markers else 0):
            *place, _, name = markers[1 + 5 * k : 6 + 5 * k]
            out.append([name, row[2], *place])
    return out


def _vicon(text, path):
    lines = text.splitlines()
    rate = float(lines[1].split(",")[0])
    owners = [(k, name.split(":")[-1]) for k, name in enumerate(split_line(lines[2], ",")) if name]
    unit = next((cell for cell in split_line(lines[4], ",") if cell), "")
    # Other sections come after a blank line.
    rows = [split_line(line, ",") for line in takewhile(lambda s: s.strip(" ,"), lines[5:])]
    return _long(rows, lambda row: f"{(float(row[0]) - 1) / rate:.9g}", owners, unit, path)


def _qualisys(text, path):
    lines = text.splitlines()
    start = next((k for k, line in enumerate(lines) if line.startswith("MARKER_NAMES")), None)
    if start is None:  # what was computed of markers, below its own names
        blank = next(k for k, line in enumerate(lines) if not line.strip())
        return "\n".join([*lines[blank + 1 :], ""])
    about = dict(cells for line in lines[:start] if len(cells := line.split("\t")[:2]) == 2)
    names = [name for name in split_line(lines[start], "\t")[1:] if name]
    rows = [split_line(line, "\t") for line in lines[start + 1 :] if line.strip(" ")]
    first = next(
        k for k, row in enumerate(rows) if any(row) and all(_is_number(c or "0") for c in row)
    )
    # Above them are the headings, or what else is said of every marker.
    header = rows[first - 1] if first and len(rows[first - 1]) >= 3 * len(names) else ()
    rows = rows[first:]
    while header and not header[-1]:  # rows end with a tab
        header = header[:-1]
    before = len(header or rows[0]) - 3 * len(names)
    rate = float(about["FREQUENCY"])
    at = header.index("Time") if "Time" in header else None
    rows = [[f"{k / rate:.9g}" if at is None else row[at], *row] for k, row in enumerate(rows)]
    owners = [(1 + before + 3 * k, name) for k, name in enumerate(names)]
    lost = Counter()
    for row in rows:  # what no camera sees is written as the origin, on which no marker is exactly
        for start, name in owners:
            if all(_is_number(cell) and float(cell) == 0 for cell in row[start : start + 3]):
                row[start : start + 3] = ["", "", ""]
                lost[name] += 1
    told = ", ".join(f"{name} ({count})" for name, count in lost.items())
    note = f"rows in which a marker is at 0, 0, 0, as QTM writes what it has lost, are gaps: {told}"
    return _long(rows, lambda row: row[0], owners, "mm", path), (note,) * bool(lost)


def _is_number(text):
    return bool(re.fullmatch(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?", text))


def _campbell(text, path):
    lines = text.splitlines()
    names, units = (split_line(line, ",") for line in lines[1:3])
    named = [name if unit in ("", "TS", "RN") else f"{name} ({unit})"
             for name, unit in zip(names, units, strict=True)]  # fmt: skip
    return "\n".join([",".join(f'"{name}"' for name in named), *lines[4:]]) + "\n"


def _labview(text, path):
    """A measurement file: a header of the file, and headers and tables of its segments.

    Of several segments each is a run. Times stand before all channels, before each of them, or
    follow from a first one and a step.
    """
    whole, head, *bodies = text.split(_LVM_END)
    about, out = dict(_pair(line) for line in whole.splitlines()), []
    delimiter = "," if about.get("Separator", "Tab").lower() == "comma" else "\t"
    kind = about.get("X_Columns", "One")
    for number, body in enumerate(bodies, 1):
        own = dict(_pair(line, delimiter) for line in head.splitlines())
        lines = [line for line in body.splitlines() if line.strip()]
        end = next((k for k, line in enumerate(lines) if line.startswith("Channels")), len(lines))
        lines, head = lines[:end], "\n".join(lines[end:])
        names, *rows = (split_line(line, delimiter) for line in lines)
        count = int(own.get("Channels", "1").split(delimiter)[0])
        at = [1 + (2 if kind == "Multi" else 1) * k for k in range(count)]
        if not out:
            units = own.get("Y_Unit_Label", "").split(delimiter)
            is_time = own.get("X_Dimension", "Time").split(delimiter)[0] == "Time"
            told = [_named(names[a], units, k) for k, a in enumerate(at)]
            out.append(["run", f"{names[0]} (s)" if is_time else names[0], *told])
        first, step = (_first(own, name, delimiter) for name in ("X0", "Delta_X"))
        for k, row in enumerate(rows):
            time = f"{first + k * step:.9g}" if kind == "No" or not row[0] else row[0]
            cells = [row[a] if a < len(row) else "" for a in at]
            out.append([str(number), *(cell.replace(",", ".") for cell in (time, *cells))])
    return [row[1:] for row in out] if len(bodies) == 1 else out


_LVM_END = "***End_of_Header***"


def _pair(line, delimiter=None):
    """A name and what is said of it."""
    name, _, value = line.partition(delimiter or ("\t" if "\t" in line else ","))
    return name.strip(), value.strip("\t, ")


def _first(about, name, delimiter):
    return float(about.get(name, "0").split(delimiter)[0].replace(",", ".") or 0)


def _named(name, units, k):
    unit = units[k].strip() if k < len(units) else ""
    return f"{name} ({unit})" if unit and "(" not in name else name


def _cassy(text, path):
    found = re.search(r"^DEF=(.*)$", text, re.MULTILINE)
    header = found[1].replace('"', "").strip()
    return f"{header}\n{text[found.end() :].lstrip()}"


_MEASURE = (slice(7, 18), slice(18, 26), slice(26, 33), slice(33, 44), slice(44, 53))
"""Where a line of the Washington catalogue has date, angle, its error, separation, its error."""
_MEASURED = ("Besselian epoch", "theta (deg)", "theta_err", "rho (arcsec)", "rho_err")


def _washington(text, path):
    """The measures of pairs of stars, each a run where they are several; lines stay where they are.

    What is no number but a limit (``<  0.020``) is no value, and told.
    """
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("MEASURES"))
    end = next(k for k in range(start, len(lines)) if lines[k].startswith("---"))
    pairs, limits, out = [], [], [[] for _ in lines[:end]]
    for k, line in enumerate(lines[start + 1 : end], start + 1):
        if line[:1].strip():  # of a pair, and what is known of it
            pairs.append(" ".join(line[:12].split()))
        elif line.strip():
            if any(len(line[p.stop - 1 : p.stop + 1].strip()) > 1 for p in _MEASURE):
                raise ValueError(f"line {k + 1} has other columns")
            cells = [line[part].strip() for part in _MEASURE]
            plain = [cell if _is_number(cell) else "" for cell in cells]
            limits += [k + 1] * (not {*cells} <= {"", ".", *plain})
            out[k] = [pairs[-1], *plain]
    out[start] = ["run" if len(set(pairs)) > 1 else "designation", *_MEASURED]
    note = f"in {len(limits)} row(s) limits, or numbers with a mark, are no values: line"
    return out, (f"{note} {listed(limits, 8)}",) if limits else ()


def _orbit_input(text, path):
    """Measures of a double star in the input of Tokovinin's ORBIT, below elements and settings.

    What is measured of angle and separation has one error, in the unit of the separation. Lines
    that begin with C are comments. Velocities are beside them, dates of which count from JD
    2400000; of the secondary they are left out.
    """
    rows, others = [["epoch (yr)", *_MEASURED[1:], "RV (km/s)", "RV_err"]], 0
    for line in text.splitlines():
        cells = line.split()
        if len(cells) > 4 and cells[4].startswith("I") and all(map(_is_number, cells[:4])):
            year, angle, far, error = cells[:4]
            turn = repr(math.degrees(math.atan2(float(error), float(far))))
            rows.append([year, angle, turn, far, error, "", ""])
        elif len(cells) > 3 and cells[3] == "Va" and all(map(_is_number, cells[:3])):
            year = repr(2000 + (float(cells[0]) - 51545) / 365.25)
            rows.append([year, "", "", "", "", *cells[1:3]])
        others += cells[3:4] == ["Vb"]
    if len(rows) == 1:
        return text
    kept = [k for k in range(7) if any(row[k] for row in rows[1:])]
    note = f"velocities of the secondary (Vb) are not read: {others}"
    return [[row[k] for k in kept] for row in rows], (note,) * bool(others)


_CDS_BEGINS = "Byte-by-byte Description"
_CDS_COLUMN = re.compile(
    r"\s*(?:(\d+)\s*-)?\s*(\d+)\s+[AIFED]\d*(?:\.\d+)?\s+(\S+)\s+(\S+)(?:\s+(?:\[\S*\])?\?=(\S+))?.*"
)
"""First and last byte of a column, its unit and label, and what stands for no value."""


def _machine_readable(text, path):
    """The rows of a machine-readable table of the AAS or the CDS; lines stay where they are.

    Above them stands which bytes of a line are which column. Blanks that lines have lost at their
    beginning are put back where their words cross columns without them.
    """
    lines = text.splitlines()
    heads = [k for k, line in enumerate(lines) if line.startswith(_CDS_BEGINS)]
    if len(heads) != 1:
        return text
    rules = [k for k, line in enumerate(lines) if len(line) > 40 and not line.strip("-= ")]
    top, end = [k for k in rules if k > heads[0]][1], rules[-1]
    told = [_CDS_COLUMN.fullmatch(line) for line in lines[top + 1 : end]]
    columns = [(int(m[1] or m[2]) - 1, int(m[2]), *m.group(3, 4, 5)) for m in told if m]
    header = [label if unit == "---" else f"{label} ({unit})" for _, _, unit, label, _ in columns]
    out, shifted = [[] for _ in lines], []
    out[end] = header
    for k, line in enumerate(lines[end + 1 :], end + 1):
        lost = next((n for n in range(columns[0][1]) if _fits(" " * n + line, columns)), None)
        if lost is None:
            raise ValueError(f"words of line {k + 1} cross the columns that are described")
        shifted += [k + 1] * (lost > 0)
        cells = [(" " * lost + line)[a:b].strip() for a, b, *_ in columns]
        nones = [none for *_, none in columns]
        out[k] = ["" if c == n else c for c, n in zip(cells, nones, strict=True)]
    note = f"{len(shifted)} row(s) have lost blanks at their beginning: {listed(shifted, 8)}"
    return out, (note,) * bool(shifted)


def _fits(line, columns):
    """Whether a line has nothing between its columns, nor behind them."""
    seen = {byte for start, stop, *_ in columns for byte in range(start, stop)}
    return all(k in seen for k, sign in enumerate(line) if sign != " ")


_ECSV_COLUMN = re.compile(r"#\s*-\s*\{(name:.*)\}\s*")
_ECSV_PAIR = re.compile(r"(name|unit):\s*(?:![\w.]+\s*\{\s*unit:\s*)?('[^']*'|\"[^\"]*\"|[^,{}]*)")
_ECSV_POWER = re.compile(r"(?<=[A-Za-z])(-?\d)\b")
_ECSV_DELIMITER = re.compile(r"#\s*delimiter:\s*(\S+)")


def _ecsv(text, path):
    """A table below the YAML in which Astropy says what its columns are: names with their units."""
    units, lines, delimiter = {}, text.splitlines(), " "
    above = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    for line in lines[:above]:
        if found := _ECSV_COLUMN.fullmatch(line):
            about = {key: value.strip("'\" ") for key, value in _ECSV_PAIR.findall(found[1])}
            units[about["name"]] = _ECSV_POWER.sub(r"^\1", about.get("unit", ""))
        elif found := _ECSV_DELIMITER.fullmatch(line.rstrip()):
            delimiter = found[1].strip("'\"")
    names, *rows = csv.reader([line for line in lines[above:] if line.strip()], delimiter=delimiter)
    header = [f"{name} ({units[name]})" if units.get(name) else name for name in names]
    return [header, *rows]


_KNOWN = {
    "PathFileType": _trc, "Format Version,": _motive, "Trajectories": _vicon,
    "NO_OF_FRAMES": _qualisys, "FILE_VERSION": _qualisys, '"TOA5"': _campbell, "MIN=": _cassy,
    "CCSDS_OEM_VERS": of_message, "# Miriade": of_miriade, "stk.v.": of_stk,
    "LabVIEW Measurement": _labview,
    "USNO Double Star": _washington, "Object:": _orbit_input, "# %ECSV": _ecsv,
    "Title:": _machine_readable, 'comment,"OptiTrack Export': _tracking_tools,
    **dict.fromkeys(NMEA, of_nmea),
    **dict.fromkeys(
        ("API", "Ephemeris", "JPL", "{", "*" * 10, "@ " + "*" * 8, "# " + "*" * 8), plain_horizons
    ),
}  # fmt: skip
_LINES = {
    re.compile(OF_SP3): of_sp3, re.compile(OF_ELEMENTS): elements,
    re.compile(OF_OBSERVATIONS): of_observations,
}  # fmt: skip
"""How such files begin: words, and lines, of which the places of their signs matter."""


def _rule(text):
    """What reads a text that begins so, None of others; and the text from there on."""
    begin, lines = text.lstrip(), text.lstrip("\r\n")
    named = ((rule, begin) for head, rule in _KNOWN.items() if begin.startswith(head))
    of_lines = ((rule, lines) for line, rule in _LINES.items() if line.match(lines))
    return next(named, None) or next(of_lines, (None, text))


def has_preamble(text):
    """Whether a text begins as a program writes it."""
    return _rule(text)[0] is not None


def without_preamble(text, path):
    """The plain table in a text that has a preamble, and notes; else the text itself.

    Raises
    ------
    DataError
        If the preamble is not as the program writes it, or markers have no names.
    """
    plain, text = _rule(text)
    try:
        made = plain(text, path)
        made, notes = made if isinstance(made, tuple) else (made, ())
        return made if isinstance(made, str) else tabbed(made), notes
    except (LookupError, ValueError, StopIteration, TypeError) as error:
        raise DataError(
            f"the file begins as {text.splitlines()[0][:30]!r}, and its preamble cannot be read "
            f"({error!r})", file=path, remedy="give a table with the columns t, x, y (and entity)",
        ) from error  # fmt: skip
