"""Velocities along the line of sight, of which no places are known: what a spectrograph gives.

They are sparse beside the turns of a star and add up to no places: they stand in the place of a
coordinate as they are, ``x`` in m/s or km/s, which stays as it is where nothing pulls the star.
"""

import re
from dataclasses import replace

import numpy as np
import pandas as pd

from bsp_gp.data.extent import JULIAN, YEARS, are_within
from bsp_gp.data.headings import (
    BY_WORDS,
    INSTRUMENTS,
    RADIAL_NAMES,
    is_doubt,
    is_error_of,
    is_own_speed,
    words_of,
)
from bsp_gp.data.notes import quoted
from bsp_gp.data.polar import POLAR_ALIASES
from bsp_gp.data.polar_words import is_julian
from bsp_gp.data.scene import CHECK, SIGHT
from bsp_gp.data.sniffing import MOST_SHOWN
from bsp_gp.data.stars import with_date_unit
from bsp_gp.data.table import PLACES, less
from bsp_gp.data.unnamed import LEAST_DATE, MOST_INSTRUMENTS
from bsp_gp.data.words import words_for
from bsp_gp.errors import in_python
from bsp_gp.units import is_speed

FEWEST = 4
"""Rows of an instrument that tell more than its zero."""
SIGHT_NAMES = ("rv", "srv")
"""How a caller names velocities along the line of sight, and their errors."""
UNEVEN = 3.0
"""Upper quartile of the steps between nights, in their lower one, at the least."""
SUREST = 0.1
"""Errors below which numbers without a unit are km/s: no spectrograph knows m/s so well."""


def sighted(table):
    """The column of such velocities; "" of a table without one.

    Raises
    ------
    DataError
        Where several columns are.
    """
    if SIGHT_NAMES[0] in table.frame:
        return SIGHT_NAMES[0]
    texts = {name: table.heading(name) for name in table.columns}
    named = {name: text for name, text in texts.items() if is_of_sight(text)}
    found = {
        name: text for name, text in named.items()
        if not any(_is_its_error(text, of) for of in named.values() if of != text)
    }  # fmt: skip
    if len(found) > 1:
        (name, text), listed = next(iter(found.items())), ", ".join(found.values())
        table.fail(
            f"several columns may be velocities along the line of sight: {listed}", name,
            f'say which is meant: --columns rv="{text}"',
        )  # fmt: skip
    return next(iter(found), "") or _of_nights(table, texts)


def instead_of_places(table, declaration):
    """The table with velocities along the line of sight alone, where the caller names them.

    Beside places of a companion people write those of its star, in rows of their own. Where nobody
    names them they are told if they are most of the table.

    Raises
    ------
    DataError
        Where the caller names places as well.
    """
    beside = [f"{s}{name}" for name in PLACES for s in ("", "s") if f"{s}{name}" in table]
    if SIGHT_NAMES[0] not in declaration.columns:
        return _told_of_velocities(table, [name for name in beside if name in PLACES])
    if SIGHT_NAMES[0] not in table.frame or not beside:
        return table
    theirs = {name: table.heading(name) for name in beside}
    named = {POLAR_ALIASES.get(name, name) for name in declaration.columns}
    said = [name for name in beside if name in named]
    if said:
        table.fail(
            f"{', '.join(theirs[name] for name in said)} and velocities along the line of sight "
            "are not read at once", said[0],
            "name the places, or the velocities, and leave the others out",
        )  # fmt: skip
    seen = table.frame[SIGHT_NAMES[0]].notna()
    note = f"not used, since velocities are named: {', '.join(theirs.values())}"
    note += f", and {int((~seen).sum())} row(s) without a velocity" * bool((~seen).any())
    # Places that are gone were guessed by their words.
    notes = tuple(note for note in table.notes if not note.startswith(BY_WORDS))
    return replace(table.of_rows(seen).without(beside), notes=(*notes, note))


def _told_of_velocities(table, places):
    """The table with a check where more rows have such a velocity than a place."""
    own = [
        (name, text) for name, text in table.unused.items()
        if name in table and is_of_sight(text) and table.is_numeric(name)
    ]  # fmt: skip
    own = [each for each in own if not any(_is_its_error(each[1], of) for _, of in own
                                           if of != each[1])]  # fmt: skip
    if len(own) != 1 or not places:
        return table
    name, text = own[0]
    seen = table.frame[name].notna() & table.frame[places].isna().all(axis=1)
    n_placed = int(table.frame[places].notna().all(axis=1).sum())
    if seen.sum() <= n_placed:
        return table
    error = error_beside(table, name, text, table.units.get(name, ""))
    options = f"rv={quoted(text)}" + f" srv={quoted(table.unused[error])}" * (error in table.unused)
    note = in_python(
        f"{CHECK}{n_placed} row(s) with places are read, and {int(seen.sum())} with velocities "
        f"along the line of sight ({text!r}) are not: --columns {options} reads these instead"
    )
    return table.noted(note)


def _of_nights(table, texts):
    """The one speed beside its error or an instrument where times are those of nights; or ""."""
    errors = [t for t in texts.values() if any(_is_its_error(t, of) for of in texts.values())]
    speeds = {
        name: text for name, text in texts.items()
        if len(text) > 1 and is_own_speed(text) and text not in errors and name not in table.renamed
    }  # fmt: skip
    is_sure = any(words_of(text) & INSTRUMENTS for text in texts.values()) or any(
        _is_its_error(text, of) for of in speeds.values() for text in texts.values() if text != of
    )
    return next(iter(speeds)) if len(speeds) == 1 and is_sure and _are_nights(table) else ""


def _are_nights(table):
    """Whether times are Julian dates, whatever they count from, of nights and not of a clock."""
    times, is_told = table.frame.get("t"), is_julian(table.theirs.get("t", ""))
    if times is None or not pd.api.types.is_numeric_dtype(times) or len(times) < FEWEST:
        return False
    if table.is_dated or table.units.get("t", "day").lower() not in ("d", "day", "days", "jd"):
        return False
    if times.between(*JULIAN).all() or is_told:
        return True
    low, high = times.diff().quantile([0.25, 0.75])
    return bool(times.min() >= LEAST_DATE and high > UNEVEN * low)


def is_of_sight(heading):
    """Whether a heading is that of a velocity along the line of sight, and of nothing else."""
    words = {word.rstrip("0123456789") for word in words_of(heading)}
    is_named = bool(words & RADIAL_NAMES) or {"radial", "velocity"} <= words
    return is_named and not (is_doubt(heading) or words & words_for("spectrum"))


def along_sight(table, declaration, column):
    """The table with a column of such velocities as its one coordinate, and its declaration.

    Raises
    ------
    DataError
        If their unit is none of a speed, or no instrument has rows enough.
    """
    heading = table.heading(column)
    said = declaration.units
    unit = said.get(column, said.get("velocity", table.units.get(column, "")))
    notes = [f"{heading!r} is read as velocities along the line of sight: no places are known, and "
             "companions are sought in these"]  # fmt: skip
    error = error_beside(table, column, heading, unit)
    if not unit:
        sure = np.nanmedian(table.frame[error]) if error else np.inf
        unit, other = ("m/s", "km/s") if sure >= SUREST else ("km/s", "m/s")
        notes.append(in_python(
            f"{CHECK}{heading!r} has no unit: {unit} is taken"
            f"{'' if unit == 'm/s' else ', since errors as small are of none in m/s'}; "
            f"--units velocity={other} says otherwise"
        ))  # fmt: skip
    elif not is_speed(unit):
        table.fail(
            f"{heading!r} is read as a velocity along the line of sight, and {unit!r} is no unit "
            "of one", column, "give it, --units velocity=km/s",
        )  # fmt: skip
    table = _with_days(with_date_unit(table, declaration), declaration)
    own = {column: "x"}
    if error:
        own[error] = "sx"
        notes.append(f"{table.heading(error)!r} is taken as its error")
    table = replace(
        table, frame=table.frame.rename(columns=own), theirs={**table.theirs, "x": heading},
        units=less(table.units, own), unused=less(table.unused, own),
    ).noted(*notes)  # fmt: skip
    kept = less(said, (*own, "velocity"))
    return _by_instruments(table), replace(
        declaration, velocity=SIGHT, first_velocity="rest", units={**kept, "length": unit}
    )


def _with_days(table, declaration):
    """The table with days for times without a unit, and a check of such as may be years."""
    theirs = table.theirs.get("t", "t")
    if "t" not in table.frame or table.is_dated or {"t", "time"} & {*declaration.units}:
        return table
    if {"t", "time"} & {*table.units}:
        times = table.numbers("t")
        if not is_julian(theirs) or not are_within(np.nanmin(times), np.nanmax(times), (YEARS,)):
            return table
        note = in_python(f"{CHECK}{theirs!r} is taken as days, and has numbers such as decimal "
                         "years: if they are these, --units t=yr")  # fmt: skip
        return table.noted(note)
    note = in_python(f"{CHECK}column {theirs!r} has no unit: days are taken; --units time=UNIT "
                     "says otherwise")  # fmt: skip
    return replace(table, units={**table.units, "t": "day"}).noted(note)


def error_beside(table, column, heading, unit):
    """The one column of numbers that says how sure each velocity is; "" where none does."""
    if SIGHT_NAMES[1] in table or "sx" in table:
        return SIGHT_NAMES[1] if SIGHT_NAMES[1] in table else ""
    found = [
        name for name, text in table.unused.items()
        if name != column and name in table.frame and _is_its_error(text, heading)
        and (not unit or table.units.get(name, unit) == unit) and table.is_numeric(name)
    ]  # fmt: skip
    return found[0] if len(found) == 1 else ""


def _is_its_error(text, heading):
    """Whether a heading is that of the error: ``errvel`` beside ``mnvel`` too."""
    word = re.sub(r"[^a-z]", "", text.lower())
    return is_error_of(text, heading) or word in words_for("error_of_radial")


def _by_instruments(table):
    """The table with the velocities of each instrument as a recording of its own."""
    if "scene" in table.frame:
        return table
    named = [n for n in table.renamed if n in INSTRUMENTS and n in table.frame]
    of = {n: words_of(text) for n, text in table.unused.items() if n in table.frame}
    names = named or [n for n, words in of.items() if words & INSTRUMENTS]
    names = names or [n for n, words in of.items() if words == {"source"}]
    if len(names) > 1 and "t" in table.frame:  # one that tells apart what was published twice
        names = [n for n in names if not table.frame.duplicated(["t", n]).any()]
    if len(names) != 1:
        return _told_of_instruments(table)
    (name,) = names
    heading = table.heading(name)
    counts = table.frame[name].astype(str).value_counts()
    if not 1 < len(counts) <= MOST_INSTRUMENTS:
        return table
    few = sorted(counts.index[counts < FEWEST])
    if len(few) == len(counts):
        return table
    told = f"{heading!r} says by what each was measured: each has a zero of its own"
    if few:
        told += f"; left out, since few: {', '.join(f'{k} ({counts[k]})' for k in few)}"
    of = table.frame[name].astype(str)
    frame = table.frame.assign(scene=of)[~of.isin(few)].drop(columns=name)
    return replace(
        table, frame=frame, theirs={**table.theirs, "scene": heading},
        unused=less(table.unused, [name]),
    ).noted(told)  # fmt: skip


def with_zeros_apart(table, declaration):
    """The table with instruments that the caller names as recordings, of other velocities too."""
    named = [name for name in declaration.columns if name in INSTRUMENTS and name in table.frame
             and name not in declaration.units]  # fmt: skip
    if len(named) != 1 or "scene" in table.frame or declaration.velocity == SIGHT:
        return table
    return table.called({named[0]: "scene"})


def _told_of_instruments(table):
    """The table with a check of the one column of texts that may name instruments."""
    able = {
        name: table.frame[name].dropna().astype(str).unique() for name in table.unused
        if name in table.frame and table.frame[name].dtype.kind not in "fiub"
    }  # fmt: skip
    able = {name: own for name, own in able.items()  # who writes headings says it there
            if table.unused[name].isdecimal() and 1 < len(own) <= MOST_INSTRUMENTS}  # fmt: skip
    if len(able) != 1:
        return table
    ((name, own),) = able.items()
    heading = table.unused[name]
    listed = ", ".join(own[:MOST_SHOWN]) + " ..." * (len(own) > MOST_SHOWN)
    note = in_python(
        f"{CHECK}column {heading!r} has {listed}: where these are the instruments that measured "
        f"each velocity, every one has a zero of its own: --columns instrument={quoted(heading)}"
    )
    return table.noted(note)
