"""Tables of velocities or accelerations without places: which columns are added up to places.

Velocities are what a radar gun, the encoder of a wheel or the gyroscope of a telephone writes,
accelerations what its accelerometer does.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from bsp_gp.data.clock import slope_on_clock
from bsp_gp.data.conversion import LENGTH, TIME, is_unit, size_of, unit_of
from bsp_gp.data.headings import is_acceleration, is_doubt, is_own_speed, is_rate, words_of
from bsp_gp.data.notes import quoted
from bsp_gp.data.scene import CHECK, SUMS
from bsp_gp.data.sight import along_sight, error_beside, sighted
from bsp_gp.data.summed import ACCELERATIONS, VELOCITIES, WHAT, Rates, has_swing, summed
from bsp_gp.data.table import PLACES, less
from bsp_gp.data.words import apart, words_for
from bsp_gp.errors import in_python
from bsp_gp.units import ACCELERATION, GRAVITIES, Unit, parse_unit

_SPEED, _RATE = LENGTH / TIME, Unit.of(s=-1)
_OF_TURNS = re.compile(r"rad|deg|°|rpm|[^\W\d]+/(?:min|мин)")
"""A rate is one of turns in these units; another may be anything."""
_WHOLE = words_for("whole")
_SENSORS = {
    "m/s^2": frozenset("accelerometer acceleration".split()),
    "rad/s": frozenset("gyroscope gyro gyroskop".split()),
    "": frozenset("gravity magnetometer magnetic".split()),
}
"""Unit of what the x, y and z of a telephone's sensor are, and words by which it calls the file."""
_OF_PHONES = "seconds_elapsed"
"""A column that only loggers of telephones write."""
_ON_MAPS = frozenset("lat latitude lon long longitude".split())
ALIKE, LEAST_ALIKE = 0.95, 10
"""Correlation of the steps of a column and of what a velocity foresees, and rows of it, from which
that column is its place."""
LONE = 0.1
"""Part of the variance of a gyroscope's axis that the others may have, if all turns about it; of
an accelerometer's, if all moves along it."""


def from_rates(table, declaration):
    """Put places in a table that has velocities or accelerations alone.

    Returns
    -------
    table : Table
    declaration : Declaration
        With ``velocity = "only"`` or ``"unseen"`` where places were made of velocities or of
        accelerations.

    Raises
    ------
    DataError
        Where several columns may be the velocity.
    """
    table = _by_its_file(table, declaration)
    columns = set(map(str, table.frame.columns))
    has_clock = "t" in columns or "frame" in columns
    if not has_clock or (columns & {*PLACES} and not _misnamed(table, declaration)):
        return table, declaration
    if "t" not in columns and not (declaration.fps or declaration.dt):
        return table, declaration  # the clock is asked for
    if column := sighted(table):
        return along_sight(table, declaration, column)
    for velocity, of_kind in ((VELOCITIES, _velocities), (ACCELERATIONS, _accelerations)):
        found = of_kind(table, declaration)
        if found:
            _require_no_places(table, declaration, found if velocity == VELOCITIES else {})
            # What shows nothing but noise beside another is not used.
            table = table.unread(sorted({*_misnamed(table, declaration)} - {*found.values()}))
            if velocity == VELOCITIES:
                table = _with_errors(table, found)
            else:
                told = (*_clocks_in(table, found), *_told_shaken(table, declaration, found))
                table = table.noted(*told)
            return summed(table, declaration, _rates(table, declaration, found, velocity))
    return table, declaration


def _by_its_file(table, declaration):
    """The table with x, y, z without a unit as what a sensor shows, where the file is called so.

    DataError if the sensor says nothing of a motion.
    """
    name = re.sub(r"([a-z])([A-Z])", r"\1 \2", Path(table.file or "").stem)
    unit = _sensor_called(name, is_of_phone=_OF_PHONES in table.present)
    said = {*"xyz"} & {*declaration.columns, *declaration.units, *table.units}
    if said or not {*"xyz"} <= set(table.frame.columns):
        return table
    if unit is None:
        _refuse_unknown_sensor(table)
        return table
    if unit:
        note = f"the file is called {name!r}: x, y and z are taken as what it shows, in {unit}"
        return _as_shown(table, unit).noted(note)
    if _OF_PHONES in table.present:
        table.fail(
            f"x, y and z of a file that is called {name!r} are no places", "x",
            "give what the accelerometer or the gyroscope has logged; if they are places, say so: "
            "--columns x=x y=y z=z",
        )  # fmt: skip
    return table


def _as_shown(table, unit):
    """The table with x, y and z as columns of a sensor, of which nobody has said what they are."""
    shown = {f"shown {axis}": table.heading(axis) for axis in "xyz"}
    table = table.called({axis: f"shown {axis}" for axis in "xyz"})
    return replace(
        table, units={**table.units, **dict.fromkeys(shown, unit)},
        unused={**table.unused, **shown}, theirs=less(table.theirs, shown),
    )  # fmt: skip


def _sensor_called(name, is_of_phone):
    """The unit of what a file shows that is called so; None where that is no sensor.

    What the logger of a telephone has written may be called more than that: the ride, the project.
    """
    words = re.findall(r"[a-z]+", name.lower())
    words = [word for word in words if word not in words_for("of_sensors")]
    if is_of_phone:
        sensors = frozenset().union(*_SENSORS.values())
        words = [word for word in words if word in sensors]
    return next((unit for unit, known in _SENSORS.items() if words and known >= {*words}), None)


def _refuse_unknown_sensor(table):
    """DataError where a telephone's sensor has written its axes, and nothing says which it is."""
    axes = [text for text in table.present if text in ("x", "y", "z")]
    if _OF_PHONES in table.present and axes == ["z", "y", "x"]:
        units = " ".join(f"{axis}=m/s^2" for axis in "xyz")
        table.fail(
            "z, y and x are what a sensor of a telephone shows, and the file is not called as one",
            "x", f"say which it is by its unit: --units {units} of an accelerometer, rad/s of a "
            "gyroscope; if they are places, --columns x=x y=y z=z",
        )  # fmt: skip


def _require_no_places(table, declaration, found):
    """DataError where a column under another name changes from row to row as a velocity says."""
    columns, said = set(table.frame.columns), {f"v{axis}" for axis in found}
    if "t" not in columns or {"scene", "entity"} & columns or said & set(declaration.columns):
        return
    steps, places = np.diff(table.numbers("t")), {}
    others = [n for n in table.unused if n in columns and not table.units.get(n)]
    for axis, column in found.items():
        speed = table.numbers(column)
        gone = (speed[1:] + speed[:-1]) / 2 * steps
        alike = {n: _likeness(np.diff(table.numbers(n)), gone) for n in others
                 if n != column and table.is_numeric(n)}  # fmt: skip
        best = max(alike, key=alike.get, default="")
        if best and alike[best] > ALIKE:
            places[axis] = table.unused[best]
    if places:
        options = " ".join(f'{axis}="{text}"' for axis, text in places.items())
        table.fail(
            f"there are velocities, and {', '.join(map(repr, places.values()))} changes as they "
            "say: these are the places", next(iter(places)),
            f"name them: --columns {options}; or leave them out: "
            f'--columns "{next(iter(places.values()))}"=ignore',
        )  # fmt: skip


def _likeness(one, other):
    """Correlation of two columns where both are known; 0 of few rows, or where one is constant."""
    known = np.isfinite(one) & np.isfinite(other)
    one, other = one[known], other[known]
    if len(one) < LEAST_ALIKE or not (np.ptp(one) > 0 and np.ptp(other) > 0):
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _clocks_in(table, found):
    """Checks of what is named as an acceleration and goes up with the time from row to row."""
    if "t" not in table.frame.columns:
        return ()
    times = table.numbers("t")
    theirs = {axis: table.heading(name) for axis, name in found.items()}
    return tuple(
        f"{CHECK}{theirs[axis]!r} increases with the time from row to row: it is a clock rather "
        f"than an acceleration a{axis}, and the axes may be the columns behind it"
        for axis, name in found.items() if slope_on_clock(times, table.numbers(name))
    )  # fmt: skip


def _with_errors(table, found):
    """The table with the error of its one velocity under our name, where one column says it."""
    (axis, own), *more = found.items()
    unit, heading = table.units.get(own, ""), table.unused.get(own, own)
    error = error_beside(table, own, heading, unit)
    if more or not error or f"sv{axis}" in table:
        return table
    note = f"{table.unused[error]!r} is taken as the error of the velocity"
    return replace(
        table, frame=table.frame.rename(columns={error: f"sv{axis}"}),
        units=less(table.units, [error]), unused=less(table.unused, [error]),
    ).noted(note)  # fmt: skip


def _misnamed(table, declaration):
    """Axis -> unit of columns x, y, z where all have units of a sensor's: no places of a body."""
    if "length" in declaration.units or ({*PLACES} - {*"xyz"}) & {*table.columns}:
        return {}
    units = _units_of(table, declaration, table.axes)
    is_sensed = all(_is(unit, ACCELERATION) or _is_turn("", unit) for unit in units.values())
    return units if is_sensed and len(set(map(unit_of, units.values()))) == 1 else {}


def _units_of(table, declaration, columns):
    """Units of columns as declared, or as in the header; "" where there is none."""
    return {name: declaration.units.get(name, table.units.get(name, "")) for name in columns}


def _of_sensor(table, declaration, is_kind):
    """Columns x, y, z of a sensor of one kind, by their axes; {} of others."""
    return {axis: axis for axis, unit in _misnamed(table, declaration).items() if is_kind(unit)}


def _velocities(table, declaration):
    """Axis -> column of velocities; empty where there is none."""
    columns = table.columns
    known = {axis: f"v{axis}" for axis in "xyz" if f"v{axis}" in columns}
    if known:  # along one axis it does not matter which it is
        return {"x": known["z"]} if list(known) == ["z"] else known
    if turned := _of_sensor(table, declaration, lambda unit: _is_turn("", unit)):
        return _moved(table, turned)
    units = _units_of(table, declaration, columns)
    theirs = {name: table.heading(name) for name in columns}
    others = [n for n in table.unused if n in columns and not is_own_speed(theirs[n])]
    if any(_is(units[n], LENGTH) or _words(theirs[n]) & _ON_MAPS for n in others):
        return {}  # they may be the places
    named = [n for n in columns if n in table.unused and is_own_speed(theirs[n])]
    named = [n for n in named if not units[n] or unit_of(units[n]) == _SPEED]
    of_unit = [n for n in table.unused if n in columns and _is(units[n], _SPEED)]
    speeds = named or [n for n in of_unit if not is_doubt(theirs[n])]
    _require_right_unit(table, declaration, {n: theirs[n] for n in speeds})
    turns = [n for n in table.unused if n in columns and _is_turn(theirs[n], units[n])]
    found = speeds or turns
    if len(found) > 1:
        parts = [n for n in found if not _words(theirs[n]) & _WHOLE]
        found = _lone(table, parts) if found is turns else parts
    if len(found) > 1:
        _refuse_several(table, [theirs[n] for n in found], VELOCITIES)
    return {"x": found[0]} if found else {}


def _require_right_unit(table, declaration, theirs):
    """DataError where a heading speaks of an acceleration and its unit is that of a velocity.

    `theirs` has the heading of each column, by its name.
    """
    odd = {
        n: text for n, text in theirs.items()
        if is_acceleration(re.sub(r"\s*[\[(].*", "", text)) and n not in declaration.units
        and not words_of(text) & words_for("speed")
    }  # fmt: skip
    if not odd:
        return
    (name, first), *_ = odd.items()
    unit = table.units.get(name, "m/s")
    options = " ".join(f"{quoted(n)}={unit}^2" for n in odd)
    table.fail(
        f"{first!r} speaks of an acceleration, and {unit} is a unit of velocities", first,
        f"say which it is: --units {options} of accelerations, or --units "
        f"{options.replace('^2', '')} of velocities",
    )  # fmt: skip


def _accelerations(table, declaration):
    """Axis -> column of accelerations along which something moves; empty where there is none."""
    found = _all_accelerations(table, declaration)
    is_said = any(f"a{axis}" in declaration.columns for axis in "xyz")
    return found if is_said or _is_shaken(table, found) else _moved(table, found)


def _is_shaken(table, found):
    """Whether the one axis of most accelerations is not that along which most adds up.

    A cart that rattles is shaken up and down by more than what makes it roll. What swings along an
    axis moves along it, whatever adds up beside that.
    """
    names = list(found.values())
    lone = _lone(table, names)
    if len(names) < 2 or len(lone) > 1:
        return False
    values = np.stack([table.numbers(name) for name in names], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    own = names.index(lone[0])
    if len(values) < LEAST_ALIKE or has_swing(values[:, [own]]):
        return False
    sums = np.cumsum(values - values.mean(axis=0), axis=0).var(axis=0)
    return bool(np.delete(sums, own).max() >= LONE * sums[own])


def _told_shaken(table, declaration, found):
    """A note of axes that are all kept since the one of most accelerations is only shaken."""
    is_said = any(f"a{axis}" in declaration.columns for axis in "xyz")
    if is_said or not _is_shaken(table, found):
        return ()
    (name,) = _lone(table, list(found.values()))
    text = table.heading(name)
    return (in_python(
        f"accelerations are by far the largest in {text!r}, but what adds up is along others as "
        f"well: all axes are kept; --columns ax={quoted(text)} takes one"
    ),)  # fmt: skip


def _all_accelerations(table, declaration):
    """Axis -> column of accelerations, of all axes of a sensor; empty where there is none."""
    columns = table.columns
    known = {axis: f"a{axis}" for axis in "xyz" if f"a{axis}" in declaration.columns}
    known = known or _of_sensor(table, declaration, lambda unit: _is(unit, ACCELERATION))
    if known:
        return known
    units = _units_of(table, declaration, columns)
    theirs = {name: table.heading(name) for name in columns}
    rest = [name for name in columns if name in table.unused]
    if any(_is(units[n], LENGTH) or _is(units[n], _SPEED) for n in rest):
        return {}  # they say more
    found = [n for n in rest if _is(units[n], ACCELERATION)] or [
        n for n in rest  # `A_x` without a unit may be a place of A
        if is_acceleration(re.sub(r"\s*[\[(].*", "", theirs[n]))
        and units[n] in ("", *GRAVITIES)
        and not (theirs[n].startswith("A_") and not units[n])
    ]  # fmt: skip
    parts = [name for name in found if not _words(theirs[name]) & _WHOLE] or found
    axes = [_axis_in(theirs[name]) or _axis_in(name) for name in parts]
    if len(set(axes) - {""}) < len(axes):
        lone = _lone(table, parts)
        if len(lone) > 1:
            _refuse_several(table, [theirs[n] for n in parts], ACCELERATIONS)
        return {"x": lone[0]} if lone else {}
    return dict(sorted(zip(axes, parts, strict=True)))


def _moved(table, found):
    """The one axis, called x, along which or about which all moves; all where there is none."""
    lone = _lone(table, list(found.values()))
    return {"x": lone[0]} if len(lone) == 1 else found


def _refuse_several(table, headings, velocity):
    """DataError where it is not known which column is the velocity, or the acceleration."""
    one, _ = WHAT[velocity]
    x, y, z = (one[0] + axis for axis in "xyz")
    table.fail(
        f"there are no places, and several columns may be the {one}: {', '.join(headings)}", x,
        f'say which is: --columns {x}="{headings[0]}" (and {y}=, {z}=)',
    )  # fmt: skip


def _axis_in(text):
    """The axis that a heading names: the last of its letters x, y, z that stand alone; or ""."""
    before = r"(?:(?<![a-z])|(?<=\ba)|(?<=\bacc)|(?<=\baccel)|(?<=\bgf))"
    found = re.findall(rf"{before}([xyz])(?![a-z])", apart(text).lower())
    return found[-1] if found else ""


def _words(text):
    return set(text.lower().replace("(", " ").replace("_", " ").split())


def _is(text, unit):
    return bool(text) and unit_of(text) == unit


def _is_turn(heading, unit):
    """Whether a column is a rate at which something turns."""
    is_angular = _is(unit, _RATE) and bool(_OF_TURNS.search(unit.lower()))
    return is_angular or (not unit and is_rate(heading))


def _lone(table, columns):
    """The axis about which all turns, if that is one; else all of them."""
    sizes = [float(np.nanvar(table.numbers(name))) for name in columns]
    best = int(np.argmax(sizes)) if sizes else 0
    rest = [size for k, size in enumerate(sizes) if k != best]
    is_lone = sizes and max(rest, default=0.0) < LONE * sizes[best]
    return [columns[best]] if is_lone else columns


def _rates(table, declaration, found, velocity):
    """What columns are added up, in which units."""
    headings = tuple(map(table.heading, found.values()))
    scale, units = _scale(table, declaration, found, velocity)
    if velocity == VELOCITIES:
        return Rates(found, velocity, scale, units, headings)
    sensed = _all_accelerations(table, declaration).values()
    sensed = {name: table.heading(name) for name in sensed}
    metric = _metric(table, declaration, found)
    return Rates(found, velocity, scale, units, headings, sensed, metric)


def _metric(table, declaration, found):
    """What a value of accelerations is in m/s^2; 0 of what turns, or is in pixels.

    What has no unit is in the unit of lengths, or in that of which gravity is 9.81.
    """
    said = declaration.units
    plain = said.get("acceleration", "")
    text = next((said.get(n, plain or table.units.get(n, "")) for n in found.values()), "")
    if text in GRAVITIES:
        return GRAVITIES[text]
    text, unit = (text, ACCELERATION) if text else (said.get("length", "m"), LENGTH)
    return parse_unit(text)[0] if _is(text, unit) and "px" not in text.lower() else 0.0


def _scale(table, declaration, found, velocity):
    """Place per value and (squared) time in numbers, and units of the places."""
    said, order, (one, many) = declaration.units, SUMS[velocity], WHAT[velocity]
    plain = said.get(one, "")
    texts = {said.get(n, plain or table.units.get(n, "")) for n in found.values()} - {""}
    time = said.get("t", said.get("time", table.units.get("t", "s")))
    clock = (parse_unit(time)[0] if is_unit(time) and "t" in table.frame else 1.0) ** order
    if not texts:
        return clock, {}  # what has no unit is per second
    if len(texts) > 1:
        table.fail(
            f"{many} have different units: {', '.join(sorted(texts))}", next(iter(found.values())),
            "give all of them in one",
        )  # fmt: skip
    (text,) = texts
    of_turns = _RATE if order == 1 else _RATE / TIME
    if order == 2 and text in GRAVITIES:
        value = GRAVITIES[text] / (parse_unit(said["length"])[0] if "length" in said else 1.0)
        return value * clock, {} if "length" in said else dict.fromkeys(found, "m")
    if not (_is(text, _SPEED if order == 1 else ACCELERATION) or _is(text, of_turns)):
        return 1.0, {}
    is_turn, scale = unit_of(text) == of_turns, size_of(text) * clock
    if "px" in text.lower():
        return scale, dict.fromkeys(found, "px")
    if "length" in said and not is_turn:
        return scale / parse_unit(said["length"])[0], {}
    return scale, dict.fromkeys(found, "rad" if is_turn else "m")
