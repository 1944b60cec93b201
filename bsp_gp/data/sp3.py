"""Orbits of satellites in SP3, the format in which the services of navigation exchange them.

The layout is that of the IGS ("The Extended Standard Product 3 Orbit Format"): below a head that
begins with ``#`` and ``##`` a line ``*`` says an epoch, and a line ``P`` below it where each
satellite is, in km, on axes that turn with the Earth.
"""

import re
from datetime import datetime, timedelta

import numpy as np

from bsp_gp.data.scene import CHECK

HEADS = tuple(f"#{version}{kind}" for version in "abcd" for kind in "PV")
"""How such files begin."""
_HEAD = re.compile(r"#[a-d][PV]\s*\d{4}[^\n]*\n##")
_TURN = 7.2921151467e-5
"""Of the Earth, rad/s."""
_CENTRE = "Earth"


def of_sp3(text, path):
    """A table of satellites about the Earth at rest, on axes that keep their directions.

    What is none of SP3 stays as it is.
    """
    if not _HEAD.match(text):
        return text
    first, seconds, out = None, 0.0, []
    for line in text.splitlines():
        if line.startswith("* "):
            epoch = _epoch(line)
            first = first or epoch
            seconds = (epoch - first) / timedelta(seconds=1)
            out.append([_CENTRE, repr(seconds), "0", "0", "0"])
        elif line.startswith("P") and first is not None:
            place = np.array([float(line[a : a + 14]) for a in (4, 18, 32)])
            if place.any():  # zeros stand where nothing is known
                out.append([line[1:4].strip(), repr(seconds), *map(repr, _turned(place, seconds))])
    table = [["entity", "t (s)", *(f"{axis} (km)" for axis in "xyz")], *out]
    note = (
        f"{CHECK}places of SP3 turn with the Earth: they are turned back by its turn since the "
        f"first epoch, {first}, so that axes keep their directions; the Earth is at rest at the "
        "origin"
    )
    return "\n".join("\t".join(row) for row in table) + "\n", (note,)


def _epoch(line):
    year, month, day, hour, minute, second = line[1:].split()[:6]
    start = datetime(int(year), int(month), int(day), int(hour), int(minute))
    return start + timedelta(seconds=float(second))


def _turned(place, seconds):
    """A place on axes of the Earth, on those that these had at the first epoch."""
    cosine, sine = np.cos(_TURN * seconds), np.sin(_TURN * seconds)
    x, y, z = place
    return float(cosine * x - sine * y), float(sine * x + cosine * y), float(z)
