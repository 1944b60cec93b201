"""Measures of double stars: dates in years, separation and position angle, and the primary.

The table gives the place of a companion as seen from the primary. That one is added, at rest at
the origin, so that laws between two bodies can name it.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.extent import JULIAN, MODIFIED, YEARS
from bsp_gp.data.notes import listed, quoted
from bsp_gp.data.polar import POLAR_ALIASES, is_polar
from bsp_gp.data.polar_words import (
    date_unit,
    is_besselian,
    is_date,
    is_far,
    is_of_sky,
    is_position_angle,
    sky_unit,
)
from bsp_gp.data.scene import Entity, FirstState
from bsp_gp.data.sky import is_sky
from bsp_gp.errors import in_python

PRIMARY = "primary"
WIDEST = 30.0
"""Median separation above which numbers without a unit are milliarcseconds: of the pairs whose
motion anyone follows, few are wider than that in arcseconds."""
_DATES = (
    (YEARS, "yr", "decimal years"),
    (MODIFIED, "day", "modified Julian dates, in days"),
    (JULIAN, "day", "Julian dates, in days"),
)
"""Ranges of numbers that, in a table of the sky, are dates."""
_BESSEL_1900, _BESSEL_YEAR = 2415020.31352, 365.242198781
"""Julian date of the epoch B1900.0, and days of a Besselian year (Lieske 1979)."""


def read_stars(table, declaration):
    """Recognise a table of separations and position angles, and put in what it leaves unsaid.

    Returns
    -------
    table : Table
        Dates as numbers with a unit; of a double star without rows that have one coordinate only.
    declaration : Declaration
        With the units that were guessed, and from where and how the angle is counted.
    is_star : bool
        Whether the table is of a companion as seen from its primary.
    """
    columns = table.frame.columns
    if not (is_polar(columns) or is_sky(columns)):
        return table, declaration, False
    table, declaration = _own_names(table, declaration)
    table = with_date_unit(table, declaration)
    if not is_polar(columns) or not _is_star(table, declaration):
        return table, declaration, False
    table, declaration = _with_units(table, declaration)
    table = _with_both_errors(_without_halves(table))
    by_turns = {"angle_from": declaration.angle_from or "y",
                "angle_turns": declaration.angle_turns or "clockwise"}  # fmt: skip
    theirs = {_ALIAS.get(name, name): text for name, text in table.theirs.items()}
    options = " ".join(
        f"{name}={quoted(table.theirs[name])}" for name in ("distance", "angle")
        if name in table.theirs
    )  # fmt: skip
    note = in_python(
        "separation and position angle were read as the place of a companion, x to the east and y "
        f"to the north (angles from north through east), and its primary was added as {PRIMARY!r}, "
        "at rest at the origin; if nothing is at "
        f"the origin and angles count from x to y, say so: --columns {options}"
    )
    table = replace(table, theirs=theirs, title=table.title or "companion").noted(note)
    return table, replace(declaration, **by_turns), True


_ALIAS = {ours: alias for alias, ours in POLAR_ALIASES.items()}


def _own_names(table, declaration):
    """Units of a distance and an angle, of the header and declared, under our names of these."""
    ours = POLAR_ALIASES | {
        theirs: name for name, theirs in table.theirs.items() if name in _ALIAS
    }  # fmt: skip
    units = {ours.get(key, key): sky_unit(text) for key, text in declaration.units.items()}
    table = replace(table, units={key: sky_unit(text) for key, text in table.units.items()})
    return table, replace(declaration, units=units)


def with_named_dates(table, declaration):
    """The table with a unit of its times where they are called dates, and leave no doubt."""
    theirs = table.theirs.get("t", "t")
    is_told = "t" in table.frame and is_date(theirs) and not is_besselian(theirs)
    return with_date_unit(table, declaration) if is_told else table


def with_date_unit(table, declaration):
    """The table with a unit of its dates where they leave no doubt, and Julian years."""
    if "t" not in table.frame.columns or not np.issubdtype(table.frame["t"].dtype, np.number):
        return table
    theirs, notes = table.theirs.get("t", ""), []
    unit = declaration.units.get("t", declaration.units.get("time", table.units.get("t")))
    values = table.frame["t"].to_numpy(dtype=float)
    known = values[np.isfinite(values)]
    if unit is None:
        implied = date_unit(theirs)
        for (low, high), guess, words in _DATES:
            is_in = len(known) and low <= known.min() and known.max() <= high
            if is_in and implied in (None, "", guess):
                unit = guess
                notes = [in_python(
                    f"column {theirs or 't'!r} has no unit: its numbers were read as {words}; if "
                    "they are not, declare their unit: --units time=UNIT"
                )]  # fmt: skip
                table = replace(table, units={**table.units, "t": unit})
                break
    if is_besselian(theirs) and (unit or "").strip().lower() in ("yr", "year", "years", "a"):
        days = _BESSEL_1900 + _BESSEL_YEAR * (values - 1900)
        table = replace(table, frame=table.frame.assign(t=2000 + (days - 2451545) / 365.25))
        notes.append("Besselian years were put into Julian ones, of 365.25 days")
    return table.noted(*notes)


def _is_star(table, declaration):
    """Whether headings, units or dates say that this is a double star; our own words decide."""
    if {"angle", "distance"} & set(declaration.columns):
        return False
    if {"position_angle", "separation"} & set(declaration.columns):
        return True
    far, angle = table.heading("distance"), table.heading("angle")
    if "angle" in table.theirs and is_position_angle(angle):
        return True
    if (far, angle) == ("distance", "angle"):
        return False
    known = {**table.units, **declaration.units}
    unit = known.get("distance", known.get("length"))
    if unit is not None:
        return is_of_sky(unit)
    is_dated = known.get("t", known.get("time", "")) in ("yr", "day")
    return is_dated and is_far(far) and "angle" not in known


def _with_units(table, declaration):
    """The declaration with units that nobody says: those of every catalogue of double stars."""
    known = {**table.units, **declaration.units}
    said = {"distance": {"distance", "length", "x"} & set(known), "angle": {"angle"} & set(known)}
    far = np.nanmedian(table.frame["distance"].to_numpy(dtype=float))
    guesses = {"distance": "mas" if far > WIDEST else "arcsec", "angle": "deg"}
    missing = {name: unit for name, unit in guesses.items() if not said[name]}
    if not missing:
        return table, declaration
    told = " and ".join(f"{_ALIAS[name]} in {unit}" for name, unit in missing.items())
    options = " ".join(f"{_ALIAS[name]}=UNIT" for name in missing)
    note = in_python(f"no unit is given: {told}, as catalogues have it; if not, --units {options}")
    units = {**declaration.units, **missing}
    return table.noted(note), replace(declaration, units=units)


def _without_halves(table):
    """The table without rows of which only one coordinate was measured, and a note of them."""
    missing = table.frame[["distance", "angle"]].isna()
    half = (missing["distance"] != missing["angle"]).to_numpy()
    if not half.any():
        return table
    lines = listed(table.frame.index[half].tolist(), 8)
    note = (
        f"{int(half.sum())} row(s) with a separation or a position angle alone are left out "
        f"(line {lines})"
    )
    return table.of_rows(~half).noted(note)


def _with_both_errors(table):
    """The table without errors of one coordinate where the other has none at all."""
    given = [name for name in ("sdistance", "sangle") if name in table]
    if not given or (len(given) == 2 and table.frame[given].notna().any().all()):
        return table
    named = " and ".join(repr(table.heading(name)) for name in given)
    note = f"{named}: errors are used where separation and position angle both have one"
    return replace(table, frame=table.frame.drop(columns=given)).noted(note)


def with_primary(scene, roster):
    """The scene with the primary beside what it has, at rest at the origin.

    What is known of it may stand in the roster, or None.
    """
    row = roster.row(scene.name, PRIMARY) if roster is not None else None
    name = PRIMARY
    while name in scene.names:
        name += "_"
    known = Entity(name) if row is None else replace(roster.entities[row], name=name)

    def beside(values, fill):
        if values is None:
            return None
        shape = (len(scene.times), 1, *values.shape[2:])
        return np.concatenate([values, np.full(shape, fill)], axis=1)

    first = scene.first
    if first is not None:
        blank = np.full((1, scene.n_dims), np.nan)
        first = FirstState(
            np.concatenate([first.velocity, blank]), np.concatenate([first.velocity_error, blank]),
            first.is_placed,
        )  # fmt: skip
    return replace(
        scene, entities=(*scene.entities, replace(known, is_static=True)), first=first,
        positions=beside(scene.positions, 0.0), velocities=beside(scene.velocities, 0.0),
        sigma=beside(scene.sigma, np.nan),
        inputs={name: beside(values, np.nan) for name, values in scene.inputs.items()},
        logs={name: beside(values, np.nan) for name, values in scene.logs.items()},
    )  # fmt: skip
