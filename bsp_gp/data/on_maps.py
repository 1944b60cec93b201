"""Tables that say where on the globe something is, as receivers of satellites write them."""

import re
from dataclasses import replace

import numpy as np

from bsp_gp.data.headings import BY_WORDS
from bsp_gp.data.notes import LISTED, listed
from bsp_gp.data.polar_words import plain_words
from bsp_gp.data.scene import CHECK
from bsp_gp.data.sky import is_sky
from bsp_gp.data.table import GAP, less
from bsp_gp.data.words import words_for
from bsp_gp.units import parse_unit

_WAYS = words_for("way")
EQUATOR, FLATTENING = 6_378_137.0, 1 / 298.257223563
"""Radius of the equator, m, and flattening of the ellipsoid of WGS 84."""


def from_maps(table, declaration):
    """Put places in a table that has latitudes and longitudes, and heights if it has any.

    Places are those in the plane that touches the ellipsoid where the table begins, x to the east
    and y to the north, in metres; a height is z. Beside right ascension and declination they are
    where someone looks from.

    Raises
    ------
    DataError
        For a latitude beyond the poles.
    """
    latitude, longitude = _of(table, words_for("latitude")), _of(table, words_for("longitude"))
    if not (latitude and longitude) or is_sky(table.frame):
        return table
    way = plain_words(table.theirs.get("x", "")) & _WAYS  # of the same motion, and it says less
    if way and "x" in table and "x" not in declaration.columns:
        table = table.unread(["x"])
    lat, lon = table.numbers(latitude), table.numbers(longitude)
    is_lost = (lat == 0) & (lon == 0)
    if 0 < np.count_nonzero(is_lost) < len(lat) - 1:  # a receiver without a fix
        lines = table.frame.index[is_lost].tolist()
        told = (f"{CHECK}{len(lines)} row(s) say that latitude and longitude are 0, as receivers "
                f"do that see no satellites: left out (line {listed(lines, LISTED)})")  # fmt: skip
        table = table.of_rows(~is_lost).noted(told)
        lat, lon = lat[~is_lost], lon[~is_lost]
    if "x" in table.frame or ("y" in table.frame and np.ptp(lat) == np.ptp(lon) == 0):
        return table  # all that moves is seen
    if (np.abs(lat) > 90).any():
        row = int((np.abs(lat) > 90).argmax())
        table.fail(f"a latitude is between -90 and 90, got {lat[row]:g}", latitude, GAP, row=row)
    length = declaration.units.get("length")
    scale = parse_unit(length)[0] if length else 1.0
    x, y = (way / scale for way in _in_plane(np.radians(lat), np.radians(lon)))
    height = "y" if table.up == "y" else _of(table, words_for("height_on_maps"))
    names = {name: table.heading(name) for name in (latitude, longitude)}
    gone = (*names, height) if height else (*names,)
    places = {"x": x, "y": y} | ({"z": table.numbers(height)} if height else {})
    own = {} if length else {"x": "m", "y": "m", "z": table.units.get(height, "m")}
    units = less(table.units, (*gone, "x", "y"))
    units |= {axis: own[axis] for axis in places if axis in own}
    is_timed = "t" in table.frame and not {"t", "time"} & {*declaration.units, *table.units}
    units |= {"t": "s"} if is_timed and not length else {}
    theirs = {**table.theirs, "x": names[longitude], "y": names[latitude]}
    if height:
        theirs["z"] = table.heading(height)
    note = "latitude and longitude were read as places east (x) and north (y) of where it begins"
    is_taken = height and not (length or table.units.get(height) or "z" in declaration.units)
    return replace(
        table, frame=table.frame.drop(columns=list(gone)).assign(**places), units=units,
        theirs=theirs, unused=less(table.unused, gone),
        notes=(*_without_guesses(table.notes, "xy"), f"{note}, in m on the ellipsoid of WGS 84"
               + (f"; {theirs['z']!r} as the height (z)" if height else "")
               + ("; it has no unit and is taken as in m: --units z=ft says another"
                  if is_taken else "")
               + ("; times have no unit and are taken as in s: --units time=ms says another"
                  if is_timed and not length else "")),
        up="z" if height else None,
    )  # fmt: skip


def _without_guesses(notes, axes):
    """Notes of guessed columns without those that something else is read for."""
    guesses = [note for note in notes if note.startswith(BY_WORDS)]
    out = [re.sub(rf"(?:, )?'[^']*' as [{axes}](?=[,;])", "", note) for note in guesses]
    out = [re.sub(rf" [{axes}]=NAME", "", note).replace(": ,", ":") for note in out]
    return [
        *(note for note in notes if note not in guesses),
        *(note for note in out if f"{BY_WORDS}: ;" not in note),
    ]


def _of(table, words):
    """The column that is called so; "" where there is none.

    That of satellites is before others, and what has the most values before what has few.
    """
    found = []
    said = {name: name for name in map(str, table.frame.columns) if name in table.renamed}
    for name, heading in {**table.unused, **said}.items():
        own = plain_words(re.sub(r"^.*\w{3}\.(?=\w{3})", "", heading))  # a path of names
        if name in table.frame and own & words and own <= words | words_for("with_latitude"):
            found.append((not own & {"gps", "gnss"}, -table.frame[name].nunique(), name))
    return min(found)[2] if found else ""


def _in_plane(lat, lon):
    """Ways to the east and to the north of the first place that is known, m, (n,) each."""
    first = int(np.isfinite(lat).argmax())
    squared = FLATTENING * (2 - FLATTENING)
    radius = EQUATOR / np.sqrt(1 - squared * np.sin(lat) ** 2)
    x = radius * np.cos(lat) * np.cos(lon - lon[first])
    y = radius * np.cos(lat) * np.sin(lon - lon[first])
    z = radius * (1 - squared) * np.sin(lat)
    x, z = x - x[first], z - z[first]
    return y, -np.sin(lat[first]) * x + np.cos(lat[first]) * z
