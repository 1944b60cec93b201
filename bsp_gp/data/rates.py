"""Tables of velocities without places: sums of these, of which errors add up.

What a radar gun, the encoder of a wheel or the gyroscope of a telephone writes. Every row stands
for the time up to the middles between it and its neighbours; what is gone in that time is added to
the place. Where a track lies is not known, and its middle counts as 0.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import ndimage
from scipy.interpolate import CubicSpline

from bsp_gp.data.conversion import is_unit, unit_of
from bsp_gp.data.headings import is_own_speed, is_rate
from bsp_gp.data.point_errors import gross_errors
from bsp_gp.data.roster import fail_at, numbers_of
from bsp_gp.errors import DataError
from bsp_gp.units import Unit, parse_unit

ONLY = "only"
"""``[columns] velocity``: places are sums of measured velocities."""
_LENGTH, _SPEED, _RATE = Unit.of(m=1), Unit.of(m=1, s=-1), Unit.of(s=-1)
_WHOLE = frozenset("absolute absolut abs magnitude betrag total norm".split())
PLACES = frozenset(("x", "y", "z", "ra", "dec", "distance", "angle"))
_ON_MAPS = frozenset("lat latitude lon long longitude".split())
GAP = 3.5
"""Typical steps of a gap behind which a track begins anew: what is gone in it is not known."""
NEIGHBOURS = 15
"""Steps among which the usual one is told."""
LONE = 0.1
"""Part of the variance of a gyroscope's axis that the others may have, if all turns about it."""
CURVED = 0.1
"""Part of the error of a row up to which its velocity is taken as the mean over its time."""
LEAST_ROWS, LISTED = 4, 5


def from_rates(table, declaration):
    """Put places in a table that has velocities alone.

    Returns
    -------
    table : Table
    declaration : Declaration
        With ``velocity = "only"`` where places were made.

    Raises
    ------
    DataError
        Where several columns may be the velocity.
    """
    columns = set(map(str, table.frame.columns))
    has_clock = "t" in columns or "frame" in columns
    if columns & PLACES or not has_clock:
        return table, declaration
    if "t" not in columns and not (declaration.fps or declaration.dt):
        return table, declaration  # the clock is asked for
    found = _velocities(table, declaration)
    return _summed(table, declaration, found) if found else (table, declaration)


def _velocities(table, declaration):
    """Axis -> column of velocities; empty where there is none."""
    columns = list(map(str, table.frame.columns))
    known = {axis: f"v{axis}" for axis in "xyz" if f"v{axis}" in columns}
    if known:
        return known
    units = {name: declaration.units.get(name, table.units.get(name, "")) for name in columns}
    theirs = {name: table.theirs.get(name, table.unused.get(name, name)) for name in columns}
    others = [n for n in table.unused if n in columns and not is_own_speed(theirs[n])]
    if any(_is(units[n], _LENGTH) or _words(theirs[n]) & _ON_MAPS for n in others):
        return {}  # they may be the places
    named = [n for n in columns if n in table.unused and is_own_speed(theirs[n])]
    named = [n for n in named if not units[n] or unit_of(units[n]) == _SPEED]
    speeds = named or [n for n in table.unused if n in columns and _is(units[n], _SPEED)]
    turns = [n for n in table.unused if n in columns and _is_turn(theirs[n], units[n])]
    found = speeds or turns
    if len(found) > 1:
        parts = [n for n in found if not _words(theirs[n]) & _WHOLE]
        found = _lone(table, parts) if found is turns else parts
    if len(found) > 1:
        names = ", ".join(theirs[n] for n in found)
        raise DataError(
            f"there are no places, and several columns may be the velocity: {names}",
            file=table.file, column="vx",
            remedy=f'say which is: --columns vx="{theirs[found[0]]}" (and vy=, vz=)',
        )  # fmt: skip
    return {"x": found[0]} if found else {}


def _words(text):
    return set(text.lower().replace("(", " ").replace("_", " ").split())


def _is(text, unit):
    return bool(text) and is_unit(text) and unit_of(text) == unit


def _is_turn(heading, unit):
    """Whether a column is a rate at which something turns."""
    is_angular = _is(unit, _RATE) and any(part in unit.lower() for part in ("rad", "deg", "°"))
    return is_angular or (not unit and is_rate(heading))


def _lone(table, columns):
    """The axis about which all turns, if that is one; else all of them."""
    sizes = [float(np.nanvar(numbers_of(table, name))) for name in columns]
    best = int(np.argmax(sizes)) if sizes else 0
    rest = [size for k, size in enumerate(sizes) if k != best]
    is_lone = sizes and max(rest, default=0.0) < LONE * sizes[best]
    return [columns[best]] if is_lone else columns


def _summed(table, declaration, found):
    """The table with places, row by row of its tracks."""
    scale, units, told = _scales(table, declaration, found)
    times = numbers_of(table, "t") if "t" in table.frame else _of_frames(table, declaration)
    lost = np.isnan(times)
    if lost.any():
        fail_at(table, "empty cell or NaN where a time is needed", int(lost.argmax()), "t")
    values = np.stack([numbers_of(table, name) for name in found.values()], axis=1)
    keys = [name for name in ("scene", "entity") if name in table.frame]
    groups = table.frame.groupby(keys, sort=False, dropna=False).indices if keys else {
        "": np.arange(len(times))
    }  # fmt: skip
    pieces, far, good = [], [], np.isfinite(values).all(axis=1)
    for rows in groups.values():
        rows = rows[good[rows]]
        back = np.flatnonzero(np.diff(times[rows]) <= 0)
        if len(back):
            problem = "times must increase from velocity to velocity of a body"
            fail_at(table, problem, int(rows[back[0] + 1]), "t", "sort the rows; keep one per time")
        is_far = _are_far(times[rows], values[rows])
        far += table.frame.index[rows[is_far]].tolist()
        good[rows[is_far]] = False
    good &= _are_common(table, times, good)
    for rows in groups.values():
        parts = _parts(times, rows[good[rows]])
        pieces.append([part for part in parts if len(part) >= LEAST_ROWS])
    gone = [str(name) for name, parts in zip(groups, pieces, strict=True) if not parts]
    if not any(pieces):
        raise DataError(
            "there are no places, and no track has four velocities", file=table.file,
            column=next(iter(found.values())),
        )  # fmt: skip
    frames = [
        _track(table, times[part], values[part], part, found, scale)
        .assign(**_named(table, part, k, len(parts)))
        for parts in pieces for k, part in enumerate(parts, 1)
    ]  # fmt: skip
    frame = pd.concat(frames)
    used = len(np.concatenate([part for parts in pieces for part in parts])) + len(far)
    notes = [_told(told, used < len(times), max(map(len, pieces)) > 1)]
    if gone:
        notes.append(f"tracks with fewer than {LEAST_ROWS} velocities are left out: "
                     + ", ".join(gone[:LISTED]))  # fmt: skip
    if far:
        listed = ", ".join(map(str, far[:LISTED])) + (" ..." if len(far) > LISTED else "")
        notes.append(
            f"velocities far off their neighbours are left out: {len(far)}, in line {listed}"
        )
    theirs = {**table.theirs, **{axis: told[k] for k, axis in enumerate(found)}}
    unused = {k: v for k, v in table.unused.items() if k not in found.values()}
    if "t" not in table.frame and declaration.fps:
        units = units | {"t": "s"}
    table = replace(
        table, frame=frame, units={**table.units, **units}, theirs=theirs, unused=unused,
        untimed="", notes=(*table.notes, *notes),
    )  # fmt: skip
    said = {name: unit for name, unit in declaration.units.items() if name not in found.values()}
    noise = _noise(declaration, times, scale)
    return table, replace(declaration, velocity=ONLY, noise=noise, units=said)


def _told(headings, is_short, is_split):
    listed = ", ".join(repr(text) for text in headings)
    return (
        f"places are sums of velocities ({listed}): errors add up from row to row, and where a "
        "track lies is not known; its middle counts as 0"
        + ("; rows without a velocity, or of pieces that are too short, are left out"
           if is_short else "")
        + ("; behind a gap a track begins anew, as a scene of its own" if is_split else "")
    )  # fmt: skip


def _scales(table, declaration, found):
    """Place per velocity and time in numbers, units of the places, and headings."""
    said, theirs = declaration.units, [
        table.theirs.get(n, table.unused.get(n, n)) for n in found.values()
    ]  # fmt: skip
    plain = said.get("velocity", "")
    texts = {said.get(n, plain or table.units.get(n, "")) for n in found.values()} - {""}
    if not texts:
        return 1.0, {}, theirs
    if len(texts) > 1:
        raise DataError(
            f"velocities have different units: {', '.join(sorted(texts))}", file=table.file,
            column=next(iter(found.values())), remedy="give all of them in one",
        )  # fmt: skip
    (text,) = texts
    if not (_is(text, _SPEED) or _is(text, _RATE)):
        return 1.0, {}, theirs
    is_turn, is_in_pixels = unit_of(text) == _RATE, "px" in text.lower()
    speed = parse_unit(re.sub("(?i)px", "m", text))[0]
    time = said.get("t", said.get("time", table.units.get("t", "s")))
    scale = speed * (parse_unit(time)[0] if "t" in table.frame else 1.0)
    if is_in_pixels:
        return scale, dict.fromkeys(found, "px"), theirs
    length = said.get("length")
    if length and not is_turn:
        return scale / parse_unit(length)[0], {}, theirs
    return scale, dict.fromkeys(found, "rad" if is_turn else "m"), theirs


def _of_frames(table, declaration):
    """Times of a file that counts frames, s."""
    frames = numbers_of(table, "frame")
    return frames / declaration.fps if declaration.fps else frames * (declaration.dt or np.nan)


def _are_common(table, times, good):
    """Rows at times at which all bodies of their scene have a velocity: they share the times."""
    if "entity" not in table.frame:
        return np.ones(len(times), dtype=bool)
    scene = table.frame["scene"] if "scene" in table.frame else pd.Series("", table.frame.index)
    known = pd.DataFrame({
        "scene": scene.to_numpy(), "t": times, "entity": table.frame["entity"].to_numpy(),
    })  # fmt: skip
    wanted = known.groupby("scene", dropna=False)["entity"].transform("nunique").to_numpy()
    there = known.assign(good=good).groupby(["scene", "t"], dropna=False)["good"].transform("sum")
    return there.to_numpy() == wanted


def _are_far(times, values):
    """Rows (n,) whose velocities (n, d) are far off their neighbours: places would jump there."""
    return gross_errors(times, values, _roughness(values)) > 1


def _roughness(values):
    """Standard deviation of the noise of values (n, ...) by their fourth differences."""
    rough = np.diff(values, 4, axis=0)
    if not len(rough):
        return np.zeros(values.shape[1:])
    return 1.4826 * np.median(np.abs(rough), axis=0) / np.sqrt(70)


def _parts(times, rows):
    """Rows of a track up to its gaps: steps that grow as a wheel slows down are none."""
    steps = np.diff(times[rows])
    if not len(steps) or not np.median(steps) > 0:  # told where times are checked
        return [rows]
    usual = np.maximum(ndimage.median_filter(steps, NEIGHBOURS, mode="nearest"), np.median(steps))
    return np.split(rows, np.flatnonzero(steps > GAP * usual) + 1)


def _track(table, times, values, rows, found, scale):
    """Rows between those of velocities, with the places there."""
    steps = np.diff(times)
    ends = np.concatenate([
        [times[0] - steps[0] / 2], (times[1:] + times[:-1]) / 2, [times[-1] + steps[-1] / 2]
    ])  # fmt: skip
    places = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(
        [_gone(times, own, ends) for own in values.T], axis=1
    ).T])  # fmt: skip
    places -= places.mean(axis=0)  # what swings does so about its middle
    after = np.append(rows, rows[-1])
    frame = table.frame.iloc[after].drop(columns=[*found.values(), "frame"], errors="ignore")
    out = {"t": ends} | {a: scale * places[:, k] for k, a in enumerate(found)}
    for axis in found:
        if f"sv{axis}" in frame:
            error, width = numbers_of(table, f"sv{axis}")[rows], np.diff(ends)
            # As of a typical step: whatever adds them up reckons with the time of each.
            error = scale * error * np.sqrt(width * np.median(width))
            out[f"s{axis}"] = np.append(error[:1], error)
            frame = frame.drop(columns=f"sv{axis}")
    for name in frame.columns.difference([*out, "scene", "entity"]):
        if pd.api.types.is_numeric_dtype(frame[name]):
            out[name] = np.interp(ends, times, frame[name].to_numpy(dtype=float)[:-1])
    return frame.assign(**out)


def _gone(times, velocity, ends):
    """What is gone in the time of every row."""
    steps, plain = np.diff(times), velocity * np.diff(ends)
    is_even = np.ptp(steps) <= 0.02 * np.median(steps)
    bend, noise = np.diff(velocity, 2), float(_roughness(velocity))
    beyond = np.square(bend).mean() - 6 * noise**2
    if is_even and np.sqrt(max(beyond, 0.0)) / 24 <= CURVED * noise:
        return plain
    whole = CubicSpline(times, velocity).antiderivative()
    return np.diff(whole(ends))


def _named(table, rows, number, count):
    """Of a track that was split, a scene of its own for every piece."""
    if count == 1:
        return {}
    scene = table.frame["scene"].iloc[rows[0]] if "scene" in table.frame else "part"
    return {"scene": f"{scene} {number}"}


def _noise(declaration, times, scale):
    """Declared errors of velocities as those of what is added in a step."""
    noise, steps = declaration.noise, np.diff(times)
    step = scale * (float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0)
    if isinstance(noise, Mapping):
        return {body: tuple(step * x for x in np.atleast_1d(own)) for body, own in noise.items()}
    return noise and tuple(step * level for level in np.atleast_1d(noise))
