"""Tables of the sky: right ascension and declination, or angles in the place of lengths.

Places become offsets in the tangent plane, x to the east and y to the north. With a distance or a
parallax they are lengths; without one they stay angles, and lengths are not calibrated. Where each
row says how far it is, they are places in space, counted from where they are seen.
"""

import math
import re
from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import grid_steps
from bsp_gp.data.polar import scale_of_angle
from bsp_gp.data.scene import CHECK
from bsp_gp.data.table import less
from bsp_gp.errors import DataError, UnitError, in_python
from bsp_gp.units import OF_THE_SKY, Unit, parse_unit

SKY_COLUMNS = ("ra", "dec", "sra", "sdec")
SKY_NUMBERS = ("sra", "sdec", "distance")
"""Columns beside right ascension and declination that have numbers, and no angles as texts."""
_SEXAGESIMAL = re.compile(
    r"([+\-−]?)\s*(\d+)\s*[h:°d\s]\s*(\d+)\s*[m:'′\s]\s*(\d+(?:\.\d*)?)\s*[s\"″]?"
)
_AMOUNT = re.compile(r"\s*([-+.0-9]*(?:[eE][-+]?[0-9]+)?)\s*(.*?)\s*", re.DOTALL)
"""A number and its unit, with or without a blank between them."""
_HOURS, _DAY = 15.0, 24.0
"""Degrees of an hour of right ascension, and hours of a turn."""
HOURS = frozenset("h hr hrs hour hours hourangle".split())
"""Units of right ascensions that are told in hours."""
_WIDEST = 0.1
"""Radians from the middle beyond which a plane is no picture of the sky."""


def is_sky(columns):
    """Whether a table has a right ascension and a declination, and neither x nor y."""
    columns = set(columns)
    return {"ra", "dec"} <= columns and not {"x", "y"} & columns


def from_sky(table, declaration):
    """Put offsets in the place of right ascension and declination, and lengths in that of angles.

    Parameters
    ----------
    table : Table
    declaration : Declaration
        Without units of ``ra`` and ``dec`` these are degrees, or sexagesimal (hours and degrees);
        errors without units of ``sra`` and ``sdec`` are milliarcseconds, that of a right ascension
        already times the cosine of the declination. Its ``sky`` may say how far it is:
        ``distance = "8.2 kpc"`` or ``parallax = "379.2 mas"``.

    Returns
    -------
    table : Table
    declaration : Declaration
        With units of the places.

    Raises
    ------
    DataError
        For a cell that is no angle, places too far apart for a plane, or a distance that is none.
    """
    units = dict(declaration.units)
    if is_sky(table.frame.columns):
        found = {**table.units, **units}
        table = _without_idle_distance(table)
        table, units = (_in_space if "distance" in table else _offsets)(table, found, units)
    distance = _distance(declaration.sky, table.file)
    if distance is None:
        return table, replace(declaration, units=units)
    known = {**table.units, **units}
    places = [c for c in ("x", "y", "z", "sx", "sy", "sz") if c in table.frame.columns]
    lengths = {c: known.get(c, known.get("length", "")).strip() for c in places}
    lengths = {c: text for c, text in lengths.items() if text in OF_THE_SKY}
    if not lengths:
        table.fail("[sky] tells how far it is, but lengths are no angles", "length",
                   'write [units] length = "arcsec" (or mas)')  # fmt: skip
    au = parse_unit("au")[0]
    scales = {c: parse_unit(text)[0] * distance / au for c, text in lengths.items()}
    lengths = {c: table.numbers(c) * scale for c, scale in scales.items()}
    steps = {c: size * scales.get(c, 1.0) for c, size in table.steps.items()}
    note = f"angles are lengths at a distance of {distance / parse_unit('pc')[0]:.6g} pc, in au"
    table = replace(table.assigned(**lengths), units=less(table.units, lengths), steps=steps)
    units = less(units, lengths) | {"length": "au"}
    return table.noted(note), replace(declaration, units=units)


def _without_idle_distance(table):
    """The table without a distance that is the same in all rows, or has no say beside errors."""
    if "distance" not in table.frame:
        return table
    far = table.numbers("distance")
    is_idle = not np.nanmax(far) > np.nanmin(far) if np.isfinite(far).any() else True
    if not (is_idle or {"sra", "sdec"} & set(table.frame.columns)):
        return table
    text = table.heading("distance")
    return table.without(["distance"]).noted(in_python(
        f"not used: {text}; --sky distance='8.2 kpc' says how far all of it is"
    ))  # fmt: skip


def _in_space(table, found, units):
    """Places x, y, z of right ascension, declination and a distance, in the unit of that."""
    ra, dec = (_angles(table, name, found.get(name, "")) for name in ("ra", "dec"))
    far = table.numbers("distance")
    if (far <= 0).any():
        k = int((far <= 0).argmax())
        table.fail(f"a distance must be positive, got {far[k]:g}", "distance",
                   "leave the cell empty where it is not known", row=k)  # fmt: skip
    flat = far * np.cos(dec)
    places = {"x": flat * np.cos(ra), "y": flat * np.sin(ra), "z": far * np.sin(dec)}
    gone = (*SKY_COLUMNS, "distance")
    of_ra, of_dec, of_far = _printed(table, found, ra=ra, dec=dec, distance=far)
    east, north = of_ra * flat, of_dec * far
    aside = (north * np.sin(dec)) ** 2 + (of_far * np.cos(dec)) ** 2  # of the axis
    squares = {
        "x": (east * np.sin(ra)) ** 2 + aside * np.cos(ra) ** 2,
        "y": (east * np.cos(ra)) ** 2 + aside * np.sin(ra) ** 2,
        "z": (north * np.cos(dec)) ** 2 + (of_far * np.sin(dec)) ** 2,
    }
    steps = {axis: math.sqrt(np.nanmean(own)) for axis, own in squares.items()}
    unit = found.get("distance", "")
    own = dict.fromkeys(places, unit) if unit and "length" not in units else {}
    note = (
        f"{CHECK}right ascension, declination and distance are read as places x, y and z in space, "
        "counted from where they are seen: if that moves, so do they"
    )
    table = replace(table, steps=steps).noted(note, _may_be_hours(table, found))
    return table.instead(gone, places, own), less(units, gone)


def _printed(table, found, **columns):
    """Steps of the grids on which columns (n,) were printed, 0.0 of one that is on none.

    Places in a plane or in space, which are made of them, are on no grid. Of what is sexagesimal
    the last digit tells it.
    """
    steps = grid_steps([
        [(own[known], values[own][known]) for own in table.tracks.values()
         if (known := np.isfinite(values[own])).any()] for values in columns.values()
    ])  # fmt: skip
    for k, name in enumerate(columns):
        if _plain_numbers(table.frame[name]) is None:
            cells = [_SEXAGESIMAL.fullmatch(str(cell).strip()) for cell in table.frame[name]]
            n_digits = max(len(cell[4].partition(".")[2]) for cell in cells)
            size = _degrees_of_one(name, found.get(name, ""))
            steps[k] = math.radians(size * 10.0**-n_digits / 3600)
    return steps


def _offsets(table, found, units):
    """Offsets in the tangent plane at the middle of the places, in arcseconds."""
    ra = _angles(table, "ra", found.get("ra", ""))
    dec = _angles(table, "dec", found.get("dec", ""))
    middle = np.arctan2(np.nanmean(np.sin(ra)), np.nanmean(np.cos(ra))), float(np.nanmean(dec))
    turn = ra - middle[0]
    depth = np.sin(middle[1]) * np.sin(dec) + np.cos(middle[1]) * np.cos(dec) * np.cos(turn)
    away = np.arccos(np.clip(depth, -1, 1))
    if np.nanmax(away) > _WIDEST:
        k = int(np.nanargmax(away))
        table.fail(
            f"{np.degrees(away[k]):.3g} degrees from the middle of all places: a plane is no "
            "picture of so much of the sky", "ra",
            "keep the rows of fewer nights, add a column of how far each is (of JPL Horizons "
            "delta), or give offsets x and y; of JPL Horizons ask for a vector table, or for "
            "another centre, such as the Sun", row=k,
        )  # fmt: skip
    arcsec = parse_unit("arcsec")[0]
    x = np.cos(dec) * np.sin(turn) / depth / arcsec
    y = (np.cos(middle[1]) * np.sin(dec) - np.sin(middle[1]) * np.cos(dec) * np.cos(turn)) / depth
    new = {"x": x, "y": y / arcsec}
    if {"sra", "sdec"} & set(table.frame.columns):
        table.require(["sra", "sdec"])
        for ours, theirs in (("sx", "sra"), ("sy", "sdec")):
            scale = _scale(table, theirs, found.get(theirs, "mas"))
            new[ours] = table.numbers(theirs) * scale / arcsec
    of_ra, of_dec = _printed(table, found, ra=ra, dec=dec)
    steps = {"x": of_ra * np.cos(middle[1]) / arcsec, "y": of_dec / arcsec}
    degrees = f"{math.degrees(middle[0]) % 360:.8f}, {math.degrees(middle[1]):+.8f}"
    note = f"right ascension and declination are offsets to the east and north of ({degrees}) deg"
    table = replace(table, steps=steps).noted(note, _may_be_hours(table, found))
    return table.instead(SKY_COLUMNS, new, {}), less(units, SKY_COLUMNS) | {"length": "arcsec"}


def _may_be_hours(table, found):
    """A check where numbers of right ascensions have no unit and none is beyond a day."""
    values = _plain_numbers(table.frame["ra"])
    if found.get("ra") or values is None or np.nanmin(values) < 0 or np.nanmax(values) >= _DAY:
        return ""
    return in_python(
        f"{CHECK}right ascensions have no unit, and all are between 0 and {_DAY:g}: taken as "
        "degrees; if they are hours, --units ra=h, and if they are degrees, --units ra=deg"
    )


def _angles(table, column, unit):
    """A column in radians: numbers in a unit (degrees without one), or sexagesimal."""
    values = _plain_numbers(table.frame[column])
    if values is None:
        degrees = [_degrees(table, column, k, cell) for k, cell in enumerate(table.frame[column])]
        return np.radians(_degrees_of_one(column, unit) * np.array(degrees))
    if unit.strip().lower() in HOURS:
        return np.radians(_HOURS * values)
    return values * _scale(table, column, unit or "deg")


def _degrees_of_one(column, unit):
    """Degrees of what is counted in sexagesimal cells: hours of a right ascension."""
    return _HOURS if column == "ra" and unit.strip() not in ("deg", "°") else 1.0


def _plain_numbers(cells):
    """A column as floats; None where its cells are sexagesimal."""
    try:
        return cells.to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError):
        return None


def _degrees(table, column, k, cell):
    match = _SEXAGESIMAL.fullmatch(str(cell).strip())
    if match is None:
        remedy = "write degrees, or 17:45:40.04 and -29:00:28.1"
        table.fail(f"{str(cell)!r:.40} is no angle", column, remedy, row=k)
    size = sum(float(part) / 60**n for n, part in enumerate(match.groups()[1:]))
    return -size if match[1] in ("-", "−") else size


def _scale(table, column, text):
    """Radians of a unit of angles."""
    remedy = 'give deg, h, arcsec or mas in [units], as in ra = "deg"'
    return scale_of_angle(table, column, text, remedy)


def _distance(about, file):
    """Metres to what is seen; None if nobody says."""
    if not about:
        return None
    if {"distance", "parallax"} <= set(about):
        raise DataError("[sky] has a distance and a parallax", file=file, remedy="keep one")
    (key, text), = about.items()
    number, unit = _AMOUNT.fullmatch(text).groups()
    try:
        value, (scale, of) = float(number), parse_unit(unit)
    except (ValueError, UnitError) as error:
        raise DataError(
            f'[sky] {key} must be a number and its unit, got {text!r}: {error}', file=file,
            column=key, remedy='write distance = "8.2 kpc" or parallax = "379.2 mas"',
        ) from error  # fmt: skip
    is_right = of == (Unit.of(m=1) if key == "distance" else Unit()) and value > 0
    if not is_right or not unit:
        raise DataError(
            f"[sky] {key} must be a positive {'length' if key == 'distance' else 'angle'}, "
            f"got {text!r}", file=file, column=key,
        )  # fmt: skip
    return value * scale if key == "distance" else parse_unit("au")[0] / (value * scale)
