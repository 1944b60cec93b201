"""Columns beside the tracks that nobody named: which of them may drive the motion.

A logger writes more than the motion: a current, a temperature, the speed of a fan; and numbers that
follow from what is there already: counts of rows, speeds, places in pixels, how sure a tracker is.
Whatever follows from the times and the places of a track says nothing of what moves it.
"""

import dataclasses
import re
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bsp_gp.data.conversion import unit_of
from bsp_gp.data.headings import (
    bodies_beside,
    is_acceleration,
    is_angle,
    is_angle_name,
    is_count,
    is_doubt,
    is_own_speed,
    property_of_words,
)
from bsp_gp.errors import UnitError
from bsp_gp.units import ACCELERATION, DIMENSIONLESS, Unit, parse_unit

SPEED = Unit.of(m=1, s=-1)
MOST = 6
"""Columns that are asked."""
AS_TIME, AS_PLACE, AS_MOTION, AS_OTHER = 1e-4, 1e-3, 5e-3, 1e-4
"""Part of its variance that a column must have beside the time, the places, the places and
velocities, and the columns before it."""
AS_VELOCITY = 0.1
"""Part of its variance that a column must have beside a velocity of the body, if it is in a unit of
one."""
AS_DIFFERENCES = 0.1
"""Part of the variance of its second differences that must not follow from those of the track:
what was computed of measured places shares their noise."""
TAPS = 3
LEAST_ROWS, LEAST_SCENES = 12, 4
"""Rows of a track in which differences are looked at; scenes of which each has one value."""
_TAKEN = frozenset("origin centre middle edge own both free plain mine up down".split())
_SUFFIX = "_logged"


def logged_columns(table, taken):
    """Numbers beside the tracks that may be measured inputs, by their names in laws.

    `taken` are columns that mean something.

    Returns
    -------
    dict of str to (str, ndarray, Unit)
        Heading, values (n,) in SI, and unit; a pure number where the unit is not known.
    """
    beside = bodies_beside(table.unused, table.units) if "entity" not in table.frame else {}
    of_bodies = {column for axes in beside.values() for column in axes.values()}
    out = {}
    for column, theirs in table.unused.items():
        if column not in table.frame or column in taken or theirs in of_bodies:
            continue
        cells, unit = table.frame[column], table.units.get(column, "")
        if not table.is_numeric(column) or _is_named_else(theirs, column, unit):
            continue
        try:
            scale, dimension = parse_unit(unit) if unit else (1.0, DIMENSIONLESS)
        except UnitError:
            scale, dimension = 1.0, DIMENSIONLESS
        values = cells.to_numpy(dtype=float, na_value=np.nan)
        name = _name(column, {*out, *taken})
        if name and np.isfinite(values).sum() > 1:
            out[name] = column, scale * np.where(np.isfinite(values), values, np.nan), dimension
    return out


def _is_named_else(theirs, column, unit):
    """Whether a heading says that a column is no cause: a count, a doubt, a motion, an angle."""
    is_kind = any(
        f(text) for f in (is_count, is_doubt, is_own_speed, is_acceleration, is_angle_name)
        for text in (theirs, column)
    )  # fmt: skip
    # A program writes the accelerations of its own track beside it: no cause of the motion.
    is_kind = is_kind or (not unit and theirs.strip() in ("a", "a_t"))
    return (
        is_kind or bool(property_of_words(column, unit)) or is_angle(unit)
        or bool(unit and unit_of(unit) == ACCELERATION)
    )  # fmt: skip


def _name(column, taken):
    """A name that laws can use, and none that they use for anything else; "" for none."""
    name = re.sub(r"\W+", "_", column, flags=re.ASCII).strip("_")
    if not re.match(r"[A-Za-z]", name):
        return ""
    is_short = re.fullmatch(r"[A-Za-z]{1,2}\d*|[A-Za-z]+_?\d+", name) is not None
    if is_short or name in _TAKEN or name[-2:] in ("_i", "_j", "_x", "_y"):
        name += _SUFFIX
    while name in taken:
        name += _SUFFIX
    return name


def asked_of(dataset, taken=(), exclude=()):
    """The data set with those columns as measured inputs that do not follow from what is there.

    `Dataset.logged` has what is asked, and a note tells it. Names in `taken` mean something else in
    laws; columns in `exclude` are not asked.
    """
    names = [
        n for n in dataset.logged
        if n not in exclude and all(_is_logged(scene, n) for scene in dataset.scenes)
    ]  # fmt: skip
    tracks = [_Track(scene, k) for scene in dataset.scenes for k in scene.dynamic]
    tracks = [track for track in tracks if len(track.times) > 1]
    kept, columns = {}, []
    for name in names if tracks else ():
        values = _within([track.values(name) for track in tracks])
        if len(kept) < MOST and values is not None:
            if not _follows(tracks, name, values, columns, dataset.logged[name][1]):
                kept[name if name not in taken else name + _SUFFIX] = name
                columns.append(values)
    found = _with_inputs(dataset, kept)
    logged = {new: dataset.logged[old] for new, old in kept.items()}
    scenes = tuple(dataclasses.replace(scene, logs={}) for scene in found.scenes)
    return dataclasses.replace(
        found, scenes=scenes, logged=logged, notes=_told(dataset.notes, logged)
    )


def named_of(dataset, uses):
    """The data set with those columns as measured inputs that laws name as a loop does.

    A name of `uses` that is the heading itself is a constant, unless a unit is declared.
    """
    return _with_inputs(dataset, {
        name: name for name, (heading, _) in dataset.logged.items()
        if name in uses and name != heading and all(_is_logged(s, name) for s in dataset.scenes)
    })  # fmt: skip


def _with_inputs(dataset, names):
    """The data set with columns as measured inputs, by the names that these get."""
    scenes = tuple(
        dataclasses.replace(s, inputs=s.inputs | {new: s.logs[old] for new, old in names.items()})
        for s in dataset.scenes
    )
    units = {new: dataset.logged[old][1] for new, old in names.items()}
    return dataclasses.replace(
        dataset, scenes=scenes, property_units={**dataset.property_units, **units}
    )


def _told(notes, logged):
    """The notes with what is asked, which is not called unused any more."""
    if not logged:
        return notes
    theirs = {heading for heading, _ in logged.values()}
    out = []
    for note in notes:
        before, mark, names = note.partition("not used: ")
        left = [n for n in names.split(", ") if re.sub(r"\s*[(\[].*", "", n).strip() not in theirs]
        if not mark or left:
            out.append(before + mark + ", ".join(left) if mark else note)
    each = [f"{heading!r}" + f" as {name}" * (heading != name)
            for name, (heading, _) in logged.items()]  # fmt: skip
    return (*out, f"asked whether forces vary with further columns: {', '.join(each)}")


def _is_logged(scene, name):
    """Whether every body that moves has values of a column."""
    values = scene.logs.get(name)
    if values is None or name in scene.inputs:
        return False
    return bool(np.isfinite(values[:, scene.dynamic]).any(axis=0).all())


class _Track:
    """One body of one scene where it is seen: times (T,), places (T, d)."""

    def __init__(self, scene, k):
        self.scene, self.k = scene, k
        seen = np.isfinite(scene.positions[:, k]).all(axis=1)
        self.times = scene.times[seen]
        self.places = scene.positions[seen, k]

    def values(self, name):
        """Of a column, at the rows where the body is seen; between rows along straight lines."""
        values = self.scene.logs[name][:, self.k]
        known = np.isfinite(values)
        return np.interp(self.times, self.scene.times[known], values[known])

    def velocities(self):
        """Slopes of lines through `TAPS` rows on either side of each, (T, d)."""
        width = 2 * TAPS + 1
        if len(self.times) < width:
            return np.gradient(self.places, self.times, axis=0)
        t = sliding_window_view(self.times, width)
        t = t - t.mean(axis=1, keepdims=True)
        p = sliding_window_view(self.places, width, axis=0)
        slopes = np.einsum("tw,tdw->td", t, p) / np.square(t).sum(axis=1)[:, None]
        return np.pad(slopes, ((TAPS, TAPS), (0, 0)), mode="edge")

    @cached_property
    def motion(self):
        """Places, velocities, and squares and sizes of both, (T, f)."""
        p, v = self.places, self.velocities()
        far, speed = (np.linalg.norm(each, axis=1, keepdims=True) for each in (p, v))
        return np.concatenate([p, v, p * p, far, speed, speed**2], axis=1)

    @cached_property
    def ways(self):
        """Length of the way so far, and distance from the first place; at a row, or at the next.

        Programs that measure films write them beside the places, (T, 4).
        """
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        gone = np.concatenate([[0.0], np.cumsum(steps)])
        far = np.linalg.norm(self.places - self.places[0], axis=1)
        return np.stack([gone, [*gone[1:], gone[-1]], far, [*far[1:], far[-1]]], axis=1)

    @cached_property
    def differences(self):
        """Second differences of places shifted by rows, and of speeds made of them, (T - 8, f)."""
        n = len(self.times) - 2 * TAPS
        shifted = [self.places[k : k + n] for k in range(2 * TAPS + 1)]
        steps = np.diff(self.places, axis=0) / np.diff(self.times)[:, None]
        middle = 0.5 * (steps[1:] + steps[:-1])
        sizes = [steps[TAPS - 1 :][:n], steps[TAPS:][:n], middle[TAPS - 1 :][:n]]
        sizes = [np.linalg.norm(s, axis=1, keepdims=True) for s in sizes]
        far = np.linalg.norm(shifted[TAPS], axis=1, keepdims=True)
        made = [*shifted, *sizes, *(s * s for s in sizes), far]
        return np.diff(np.concatenate(made, axis=1), 2, axis=0)


def _within(values):
    """Values less their mean in each track; None where that says nothing.

    Of what is constant in each scene the means are compared.
    """
    whole = np.concatenate(values)
    size = np.abs(whole).max()
    out = np.concatenate([v - v.mean() for v in values])
    if np.abs(out).max() > 1e-9 * size:
        return out
    known = np.unique([v[0] for v in values])
    is_varied = len(known) >= LEAST_SCENES and not np.allclose(np.diff(known), known[1] - known[0])
    return whole - whole.mean() if is_varied else None


def _follows(tracks, name, values, columns, unit):
    """Whether a column follows from the times and places, or from columns before it."""
    own = [track.values(name) for track in tracks]
    if all(_is_count(v) for v in own) or _is_velocity(tracks, values, unit):
        return True

    def beside(parts):
        return _left(values, np.concatenate([p - p.mean(axis=0) for p in parts]))

    if (
        beside([track.times[:, None] for track in tracks]) < AS_TIME
        or beside([track.places for track in tracks]) < AS_PLACE
        or beside([track.motion for track in tracks]) < AS_MOTION or _are_ways(tracks, own)
    ):  # fmt: skip
        return True
    long = [k for k, track in enumerate(tracks) if len(track.times) >= LEAST_ROWS]
    if long:
        quick = np.concatenate([np.diff(own[k][TAPS:-TAPS], 2) for k in long])
        made = np.concatenate([tracks[k].differences for k in long])
        if _left(quick, made) < AS_DIFFERENCES:
            return True
    return bool(columns) and _left(values, np.stack(columns, axis=1)) < AS_OTHER


def _is_velocity(tracks, values, unit):
    """Whether a column is the velocity of the body itself, in whatever language it is called so.

    It goes as one of its parts, or as its size, but for noise; without a unit it is as large too.
    """
    if unit not in (SPEED, DIMENSIONLESS):
        return False
    parts = [track.velocities() for track in tracks]
    parts = [np.column_stack([v, np.linalg.norm(v, axis=1)]) for v in parts]
    parts = np.concatenate([p - p.mean(axis=0) for p in parts])
    sizes, total = np.square(parts).sum(axis=0), float(values @ values)
    parts, sizes = parts[:, sizes > 0], sizes[sizes > 0]
    slopes = values @ parts / sizes
    is_near = slopes**2 * sizes >= (1 - AS_VELOCITY) * total
    is_large = np.abs(np.abs(slopes) - 1) < AS_VELOCITY
    return bool((is_near & (is_large | (unit == SPEED))).any())


def _are_ways(tracks, own):
    """Whether values are ways or distances, but at ends, where programs write what they like."""
    inner = [(track.ways[1:-1], v[1:-1]) for track, v in zip(tracks, own, strict=True)]
    inner = [(ways - ways.mean(axis=0), v - v.mean()) for ways, v in inner if len(v) > TAPS]
    if not inner:
        return False
    ways, values = (np.concatenate(each) for each in zip(*inner, strict=True))
    return min(_left(values, ways[:, [k]]) for k in range(ways.shape[1])) < AS_PLACE


def _left(values, columns):
    """Part of the variance of values (n,) beside columns (n, f), these being counted."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    total, n = float(values @ values), len(values)
    if total == 0 or n <= columns.shape[1] + 2:
        return 1.0
    rest = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(rest @ rest) / total * n / (n - columns.shape[1])


def _is_count(values):
    """Whether whole numbers go up by the same at nearly all rows."""
    steps = np.diff(values)
    if not len(steps) or (values != np.round(values)).any() or (steps <= 0).any():
        return False
    return bool((steps == np.median(steps)).mean() > 0.9)
