"""From rows of a table to scenes: validation, gaps, and the merging of times."""

import re
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from bsp_gp.data.conversion import KINDS, unit_of
from bsp_gp.data.headings import (
    NUMBER_COLUMNS,
    TEXT_COLUMNS,
    is_acceleration,
    is_angle,
    is_angle_name,
    is_count,
    is_error,
    is_no_place,
    is_rate,
    numbered_places,
)
from bsp_gp.data.logged import logged_columns
from bsp_gp.data.notes import quoted
from bsp_gp.data.property_columns import WITHIN
from bsp_gp.data.roster import ABSURD, vector_stems
from bsp_gp.data.scene import CHECK, PROPERTY_UNITS, SIGHT, SUMS, Entity, FirstState, Scene
from bsp_gp.data.steps import LEAST_ROUNDED, LEAST_TIES
from bsp_gp.data.table import GAP
from bsp_gp.data.twice import MOST_SLIPS
from bsp_gp.data.untimed import without_timeless_ends
from bsp_gp.errors import DataError
from bsp_gp.units import ACCELERATION, Unit

TURN = 2.04 * np.pi
"""Over what angles reach at the most that may jump by whole turns, rad: one, and some noise."""
LEAST_MARKED = 3
"""Rows at -1 on every axis from which these are a mark."""
MAX_CELLS = 100_000_000


@dataclass(frozen=True)
class Rows:
    """Rows of a trajectory table as arrays in file order, SI.

    Attributes
    ----------
    scene, entity : ndarray of int, shape (n,)
        Codes into `scene_names` and `entity_names`.
    times : ndarray, shape (n,), seconds
    positions : ndarray, shape (n, d), metres
    velocities, sigma : ndarray, shape (n, d), or None
    lines : ndarray of int, shape (n,)
        Line numbers in `file`.
    notes : tuple of str
        What was taken for granted.
    inputs : dict of str to (ndarray, Unit)
        Measured inputs, (n,) or (n, d), SI.
    first : tuple of ndarray, or None
        Velocities and their errors (n, d), m/s, that count in the first row of a scene; nan =
        unknown.
    is_placed : bool
        Whether the places of first rows are exact.
    may_meet : bool
        Whether two bodies may have one place: angles, and places along one axis.
    logged : dict of str to (str, ndarray, Unit)
        Further columns, see `bsp_gp.data.logged.logged_columns`.
    second : float
        Of the unit of the file's times, how many seconds it is.
    """

    scene: np.ndarray
    scene_names: tuple[str, ...]
    entity: np.ndarray
    entity_names: tuple[str, ...]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None
    sigma: np.ndarray | None
    lines: np.ndarray
    file: str | None
    notes: tuple[str, ...] = ()
    inputs: dict = field(default_factory=dict)
    first: tuple | None = None
    is_placed: bool = False
    may_meet: bool = False
    logged: dict = field(default_factory=dict)
    second: float = 1.0

    def fail(self, problem, row, column=None, remedy=None):
        """Raise a DataError about one row."""
        line = int(self.lines[row])
        raise DataError(problem, file=self.file, row=line, column=column, remedy=remedy)

    @property
    def tracks(self):
        """Of every row a number for its entity in its scene, shape (n,)."""
        return self.scene * len(self.entity_names) + self.entity

    @property
    def steps(self):
        """Rows of one track next to each other, two arrays of them, and the time between them."""
        order = np.argsort(self.tracks, kind="stable")
        same = np.diff(self.tracks[order]) == 0
        return order[:-1][same], order[1:][same], np.diff(self.times[order])[same]

    def noted(self, *notes):
        """The same with more notes; empty ones are none."""
        return replace(self, notes=(*self.notes, *filter(None, notes)))

    def taken(self, chosen):
        """Some of the rows, by their numbers."""
        names = ("scene", "entity", "times", "lines", "positions", "velocities", "sigma")
        own = {name: getattr(self, name) for name in names}
        return replace(
            self, **{name: values[chosen] for name, values in own.items() if values is not None},
            inputs={name: (values[chosen], unit) for name, (values, unit) in self.inputs.items()},
            first=self.first and tuple(values[chosen] for values in self.first),
            logged={name: (text, values[chosen], unit)
                    for name, (text, values, unit) in self.logged.items()},
        )  # fmt: skip

    def label(self, row):
        """Words for the scene and entity of one row."""
        scene, entity = self.scene_names[self.scene[row]], self.entity_names[self.entity[row]]
        return f"entity {entity!r} of scene {scene!r}"


def build_rows(table, declaration, conversion, *, scene_name):
    """Check the columns of a trajectory table and convert them.

    Without a column of scenes all rows are of one, `scene_name`.
    """
    axes, line_notes = axes_of(table, declaration)
    table, foot_notes = without_timeless_ends(table)
    table, gap_notes = _without_gaps(table)
    _require_right_clock(table, axes)
    known, velocities = table.axes, None
    positions = _stacked(table, axes, "", conversion.length)
    if declaration.velocity == "measured":
        table.require([f"v{axis}" for axis in known])
        velocities = _stacked(table, axes, "v", lambda a: conversion.velocity(f"v{a}"), True)
    scene, scene_names = _codes(table, "scene", scene_name)
    entity, entity_names = _codes(table, "entity", table.title or "object")
    times = _times(table, declaration, conversion)
    return Rows(
        scene, scene_names, entity, entity_names, times, positions, velocities,
        _sigma(table, axes, conversion), table.frame.index.to_numpy(), table.file,
        (*line_notes, *foot_notes, *gap_notes), _inputs(table, declaration, conversion),
        _first(table, declaration, conversion, axes), declaration.first_position == "exact",
        # Sensors along one axis have each a zero of its own.
        may_meet=conversion.system.is_angle or len(known) == 1,
        logged=logged_columns(table, inputs_of(table, declaration)),
        second=conversion.time() if "t" in table else 1.0,
    )  # fmt: skip


def _stacked(table, axes, prefix, scale, can_be_blank=False):
    """One column for each axis, (n, d) in SI by ``scale(axis)``; 0 along axes without places."""
    out = np.zeros((len(table.frame), len(axes)))
    for k, axis in enumerate(axes):
        if axis in table:
            out[:, k] = _numbers(table, f"{prefix}{axis}", can_be_blank) * scale(axis)
    return out


def _first(table, declaration, conversion, axes):
    """Velocities and their errors as ``[initial]`` has them, (n, d) each; None if unknown."""
    said, shape = declaration.first_velocity, (len(table.frame), len(axes))
    if said == "unknown":
        blank = np.full(shape, np.nan)
        return (blank, blank) if declaration.first_position == "exact" else None
    if said == "rest":
        return np.zeros(shape), np.zeros(shape)
    known = table.axes
    prefixes = ("v", "sv") if said == "measured" else ("v",)
    for prefix in prefixes:
        if not all(f"{prefix}{axis}" in table for axis in known):
            names = ", ".join(f"{prefix}{axis}" for axis in known)
            table.fail(
                f'[initial] velocity = "{said}" needs the column(s) {names}',
                remedy="fill them in the first row of every scene"
                + (' (standard errors of the velocities), or write "exact"' if prefix == "sv"
                   else ', or write velocity = "rest" for bodies that are let go'),
            )  # fmt: skip
    parts = [_stacked(table, axes, prefix, lambda a: conversion.velocity(f"v{a}"), True)
             for prefix in prefixes]  # fmt: skip
    if said == "exact":
        parts.append(np.where(np.isfinite(parts[0]), 0.0, np.nan))
    elif (parts[1] <= 0).any():
        at = int((parts[1] <= 0).any(axis=1).argmax())
        problem = "a standard error of a velocity must be positive"
        table.fail(problem, "svx", 'exact: velocity = "exact"', row=at)
    return tuple(parts)


def inputs_of(table, declaration):
    """Further columns of a trajectory table whose unit is declared: inputs that were measured."""
    taken = {*NUMBER_COLUMNS, *TEXT_COLUMNS, *KINDS, *PROPERTY_UNITS}
    return [c for c in table.frame.columns if c in declaration.units and c not in taken]


def _inputs(table, declaration, conversion):
    """Measured inputs with their units; ``wind_x`` and ``wind_y`` are one vector."""
    columns = inputs_of(table, declaration)
    stems = vector_stems(columns)
    stems = {s: c for s, c in stems.items() if len(c) == len(axes_of(table, declaration)[0])}
    parts = {column for each in stems.values() for column in each}
    out = {}
    for name in [c for c in columns if c not in parts] + list(stems):
        if not re.fullmatch(r"[A-Za-z]\w*", name) or name[-2:] in ("_i", "_j"):
            table.fail(
                f"the measured input {name!r} must be a name that laws can use", name,
                "letters, digits and underscores, and no _i or _j at its end",
            )  # fmt: skip
        columns = stems.get(name, (name,))
        values = [_numbers(table, column, can_be_blank=True) for column in columns]
        scale, unit, _ = conversion.property(name, columns if name in stems else ())
        out[name] = scale * (np.stack(values, axis=1) if name in stems else values[0]), unit
    return out


def along_named_axis(table, declaration):
    """The table with its only place along the axis that laws name, if they name another one only.

    A height that a file calls one is read as y; who writes laws in x means it all the same. A lone
    z is a height. ``declaration.uses`` has the names in laws.
    """
    own = table.axes
    named = [axis for axis in "xyz" if {f"{axis}_i", f"e_{axis}"} & set(declaration.uses)]
    if own == ["z"] and "z" not in named:
        table = replace(table, up="z")
        named = named or ["y"]
    if len(own) != 1 or len(named) != 1 or own == named or named == ["z"]:
        return table
    (old,), (new,) = own, named
    is_vertical = {"up", "down"} & set(declaration.uses)
    said = {*declaration.units} if old == "z" else {*declaration.columns, *declaration.units}
    is_said = {old, f"s{old}"} & said
    if is_said or f"v{old}" in table.frame or is_vertical:
        return table
    told = f"laws name {new} alone, and " if declaration.uses else ""
    note = f"{told}{table.heading(old)!r} is the only place: it is taken as {new}"
    is_height = old == "z" and table.up == "z"
    up = new if is_height else None if table.up == old else table.up
    return replace(table.called({old: new, f"s{old}": f"s{new}"}), up=up).noted(note)


def axes_of(table, declaration):
    """Axes of the positions, and a note where one of x and y is not in the table.

    A table of x alone, or of y alone, is motion along a line; but a column that is not used and
    may be the other axis under another name is no reason to leave that axis out.
    """
    columns, axes = table.columns, table.axes
    _refuse_rates(table, declaration, axes)
    _require_clock(table, declaration)
    if axes not in (["x"], ["y"]):
        needed = ["x", "y"] if {"t", "frame"} & set(columns) else ["t", "x"]
        table.require(needed, numbered_places(table.present or columns))
        return axes, ()
    other = "y" if axes == ["x"] else "x"
    angle = declaration.units.get("length", table.units.get(axes[0], ""))
    known = {*NUMBER_COLUMNS, *TEXT_COLUMNS, *WITHIN, *inputs_of(table, declaration)}
    # Who says which column is one of them would say which is the other.
    is_summed = declaration.velocity in (*SUMS, SIGHT)  # all that there is of them
    is_turn = is_angle(angle) or is_angle_name(table.theirs.get(axes[0], ""))
    is_whole = is_turn or axes[0] in declaration.columns or is_summed
    rest = [] if is_whole else [column for column in columns if column not in known]
    doubtful = [column for column in rest if _may_be_place(table, column, axes[0])]
    if doubtful:
        theirs = [table.unused.get(column, column) for column in doubtful]
        names = list(map(quoted, theirs))
        ignored = " ".join(f"{name}=ignore" for name in names)
        present = ", ".join(dict.fromkeys(table.present or columns))
        own = table.heading(axes[0])
        along = axes[0] if own == axes[0] else repr(own)
        table.fail(
            f"the header has no column {other!r}; present are {present}", other,
            f"if {theirs[0]!r} is that, --columns {other}={names[0]} (in dataset.toml under "
            f"[columns]); if it drives the motion (a support, a thrust), its unit, --units "
            f"{names[0]}=UNIT, makes it an input of laws; if all motion is along {along}, "
            f"--columns {ignored}",
        )  # fmt: skip
    note = f"there is no column {other!r}: it is taken as 0, motion along {axes[0]}"
    return ["x", "y"], () if is_angle(angle) else (note,)


def _require_clock(table, declaration):
    """DataError where a table has no column of times and its rows are no frames of a known rate."""
    has_rate = declaration.fps is not None or declaration.dt is not None
    if table.untimed and not (has_rate and "frame" in table.frame.columns):
        table.fail(f"there is no column 't'; present are {', '.join(table.present)}", "t",
                   table.untimed)  # fmt: skip


EVEN = 0.1
"""Part of the usual step by which those of a clock differ."""


def _require_right_clock(table, axes):
    """DataError where times go back again and again, and what is read as a place is a clock.

    Of columns without names, which are read in their order, one that increases over the whole file
    is one as well, however unevenly, where that of the times falls back anywhere.
    """
    if "t" not in table or table.owners:
        return
    times, is_bare = np.diff(table.numbers("t")), table.theirs.get("t", "").isdecimal()
    if not len(times) or (times <= 0).mean() <= (0 if is_bare else MOST_SLIPS):
        return
    places = [axis for axis in axes if axis in table]
    even = [axis for axis in places if _is_clock(table, axis)]
    rising = [axis for axis in places if is_bare and (np.diff(table.numbers(axis)) > 0).all()]
    if not even + rising:
        return
    clock = (even + rising)[0]
    order = [name for name in table.frame.columns if name in ("t", *axes) and name != clock]
    named = zip(("t", *"xyz"), (clock, *order), strict=False)
    options = " ".join(f"{ours}={quoted(table.heading(own))}" for ours, own in named)
    table.fail(
        f"times ({table.heading('t')!r}) go back, and {table.heading(clock)!r} increases"
        f"{' evenly' * bool(even)} from row to row", "t",
        f"if that is the time, say so: --columns {options}",
    )  # fmt: skip


def _is_clock(table, column):
    """Whether a column increases by nearly the same from row to row."""
    steps = np.diff(table.numbers(column))
    return len(steps) >= LEAST_MARKED and bool((np.abs(steps - np.median(steps))
                                                < EVEN * np.median(steps)).all())  # fmt: skip


_SYMBOLS = frozenset("aAvVfF")
"""Of a speed, an acceleration, a force: no places."""
_SENSED = re.compile(r"[gmw][xyz]")
"""Of a gyroscope, or a compass."""


def _may_be_place(table, column, axis):
    """Whether a column that means nothing to us may be a coordinate: nothing else speaks of it."""
    cells, unit = table.frame[column], table.units.get(column, "")
    is_number = table.is_numeric(column)
    is_sensed = is_acceleration(column) or _SENSED.fullmatch(column.lower())
    if not is_number or cells.nunique() < 2 or is_error(column) or is_count(column) or is_sensed:
        return False
    if unit or column in _SYMBOLS:
        return bool(unit) and unit_of(unit) == Unit.of(m=1)
    # Who writes the unit of one coordinate writes that of the other.
    return not (table.units.get(axis) or is_no_place(column))


def _refuse_rates(table, declaration, axes):
    """DataError where what stands in the place of positions is what a telephone's sensors give."""
    theirs = {name: table.theirs.get(name, name) for name in table.columns}
    said = set(declaration.units)
    units = {} if "length" in said else {n: table.units.get(n, "") for n in set(theirs) - said}
    turns = re.compile(r"(?:rad|deg|°).*")  # a rate without an angle may be anything
    for what, letter, is_kind, is_named in (
        ("accelerations", "a", lambda text: unit_of(text) == ACCELERATION, is_acceleration),
        ("angular velocities", "v",
         lambda text: unit_of(text) == Unit.of(s=-1) and turns.match(text), is_rate),
    ):  # fmt: skip
        of_unit = {name for name, text in units.items() if is_kind(text)}
        found = [column for column in table.present if is_named(column)]
        found = found or [theirs[name] for name in theirs if name in of_unit]
        if found and (not axes or of_unit & set(axes)):
            table.fail(
                f"the table has {what} ({', '.join(found[:3])}) and no positions",
                remedy=f'name one that is to be added up, --columns {letter}x="{found[0]}" (errors '
                "add up as well: where you can, record the motion from outside, by a film, a "
                "motion sensor, or of a telephone its distance (LiDAR, sonar) or location (GPS)); "
                "or, if one of the columns is a position, name it: --columns x=ITS_NAME",
            )  # fmt: skip


def _without_gaps(table):
    """The table without rows that have a time but no coordinate at all, and a note of them."""
    axes = table.axes
    empty = table.frame[axes].isna().all(axis=1).to_numpy()
    unseen = _are_marked_unseen(table, axes)
    if not (empty | unseen).any():
        return table, ()
    if empty.all():
        table.fail("no row has any coordinates")
    notes = [f"{int(empty.sum())} row(s) without coordinates are gaps in the track"]
    notes = notes if empty.any() else []
    if unseen.any():
        notes.append(f"{CHECK}{int(unseen.sum())} row(s) at {', '.join(['-1'] * len(axes))} where "
                     "nothing else is below 0 are gaps in the track")  # fmt: skip
    return table.of_rows(~(empty | unseen)), tuple(notes)


def _are_marked_unseen(table, axes):
    """Rows at -1 on every axis, as trackers mark a frame in which they see nothing.

    Pixels count from 0: all else is not below it.
    """
    cells = table.frame[axes]
    none = np.zeros(len(cells), dtype=bool)
    if len(axes) < 2 or not all(map(table.is_numeric, axes)):
        return none
    unseen = (cells == -1).all(axis=1).to_numpy()
    rest = cells[~unseen]
    is_marked = unseen.sum() >= LEAST_MARKED and rest.notna().any(axis=None)
    return unseen if is_marked and not (rest < 0).any(axis=None) else none


def _numbers(table, column, can_be_blank=False):
    values = table.numbers(column)
    bad = np.isinf(values) | (np.abs(values) > ABSURD)
    if not can_be_blank:
        bad |= np.isnan(values)
    if not bad.any():
        return values
    k = int(bad.argmax())
    problem = f"{values[k]:g} is not a usable number (finite, at most {ABSURD:g} in size)"
    if np.isnan(values[k]):
        problem = "empty cell or NaN where a number is needed"
    table.fail(problem, column, GAP, row=k)


def _times(table, declaration, conversion):
    if "t" in table.frame.columns:
        return _numbers(table, "t") * conversion.time()
    if "frame" not in table.frame.columns:
        table.require(["t"])
    frames = _numbers(table, "frame")
    if declaration.fps is not None:
        return frames / declaration.fps
    if declaration.dt is not None:
        return frames * (declaration.dt * conversion.time())
    table.fail("the file counts frames, but nothing says how long a frame is", "frame",
               "give fps = 30 (or dt = 0.02) in dataset.toml or as an argument")  # fmt: skip


def _sigma(table, axes, conversion):
    if not any(f"s{axis}" in table for axis in axes):
        return None
    out = np.full((len(table.frame), len(axes)), np.nan)
    for k, column in enumerate(f"s{axis}" for axis in axes):
        if column in table:
            out[:, k] = _numbers(table, column, can_be_blank=True) * conversion.length(column)
            if (out[:, k] < 0).any():
                row = int((out[:, k] < 0).argmax())
                problem = f"a standard error must not be negative, got {out[row, k]:g}"
                table.fail(problem, column, row=row)
    return out


def _codes(table, column, default):
    """Integer codes in order of first appearance, and the names."""
    if column not in table.frame.columns:
        return np.zeros(len(table.frame), dtype=np.int64), (default,)
    codes, labels = pd.factorize(table.frame[column])
    names = ["" if pd.isna(label) else str(label).strip() for label in labels]
    blank = codes < 0
    if "" in names:
        blank |= codes == names.index("")
    if blank.any():
        table.fail("empty cell where a name is needed", column, row=int(blank.argmax()))
    unique = tuple(dict.fromkeys(names))
    if len(unique) < len(names):
        place = {name: k for k, name in enumerate(unique)}
        codes = np.array([place[name] for name in names])[codes]
    return codes.astype(np.int64), unique


_BELOW = (
    "where recordings or bodies stand below each other, say which column tells them apart: "
    "--columns scene=COLUMN of recordings, --columns entity=COLUMN of bodies"
)


def _check_order(rows):
    """Times of one entity must increase; returns the smallest step of every scene."""
    earlier, later, steps = rows.steps
    bad = steps <= 0
    if bad.any():
        first = later[bad].argmin()
        k = later[bad][first]
        before, now = (rows.times[each] / rows.second for each in (earlier[bad][first], k))
        if now == before:
            own = rows.times[rows.tracks == rows.tracks[k]]
            rows.fail(
                f"{rows.label(k)} has two rows at t = {before:.9g} (duplicate)", k, "t",
                f"keep one row per scene, time and entity; {_BELOW}{_of_rounded(own)}",
            )  # fmt: skip
        rows.fail(
            f"times of {rows.label(k)} must increase, got {before:.9g} then {now:.9g}",
            k, "t", "sort the rows by time, or mend the clock if they are in their order as they "
            f"stand; {_BELOW}",
        )  # fmt: skip
    smallest = np.full(len(rows.scene_names), np.inf)
    np.minimum.at(smallest, rows.scene[later], steps)
    return smallest


SLOWEST = 0.1
"""Frames a second of what may be a film."""


def _of_rounded(times):
    """What to do where times in order may be those of frames, rounded; empty of others.

    Where many share a time, an even clock was tried and does not fit: a mean rate would be wrong.
    """
    steps = np.diff(times)
    if (steps < 0).mean() > MOST_SLIPS:
        return ""
    if (steps == 0).mean() > 0.5:
        rises = steps[steps > 0]
        if not len(rises) or np.isclose(rises, np.median(rises), rtol=EVEN).mean() < 0.5:
            return ""
        count = len(times) / (len(rises) + 1)
        return (
            f"; if these are rows of one body one after another, digits are missing from the "
            f"clock, which has {count:.3g} rows at each of its times: record it with more digits, "
            "or if rows are even and their rate is known, leave it out: --columns ITS_NAME=ignore "
            "--fps RATE"
        )
    if (steps < 0).any():
        return ""
    ties = np.flatnonzero(steps == 0)
    if len(ties) >= LEAST_TIES and len(times) >= LEAST_ROUNDED:
        return (
            "; if times were rounded: no even clock fits them, so the rate changes or frames are "
            f"lost, and no --fps tells it; cut the table (rows share times from row {ties[0] + 2} "
            "on), or record times with more digits"
        )
    rate = len(steps) / (times[-1] - times[0])
    remedy = (
        "; if times were rounded and every row is a frame, leave their column out, --columns "
        f"ITS_NAME=ignore --fps {rate:.4g}"
    )
    return remedy if rate >= SLOWEST else ""


def _time_index(rows, smallest):
    """Rows sorted by scene and time, the flag of each new time, and the first row of a scene."""
    order = np.lexsort((rows.times, rows.scene))
    scene, times = rows.scene[order], rows.times[order]
    step = smallest[scene]
    rounding = 2 * np.finfo(float).eps * np.abs(times)
    tolerance = np.minimum(np.maximum(1e-9 * step, rounding), 1e-3 * step)
    tolerance[np.isinf(step)] = 0.0
    is_first = np.append(True, np.diff(scene) != 0)
    is_new = is_first | np.append(True, np.diff(times) > tolerance[1:])
    return order, is_new, np.flatnonzero(is_first)


def build_scenes(rows, roster, *, without_track=()):
    """Scenes in order of first appearance, and notes.

    Without a roster (None) every entity is a point of unknown mass; names in `without_track` need
    no rows.
    """
    smallest = _check_order(rows)
    order, is_new, starts = _time_index(rows, smallest)
    stops = [*starts[1:], len(order)]
    time_index = np.cumsum(is_new) - 1
    points = {} if roster is None else None
    scenes, used, n_cells = [], set(), 0
    for start, stop in zip(starts, stops, strict=True):
        part = order[start:stop]
        entities, local = _entities(rows, part, roster, points, used)
        row = time_index[start:stop] - time_index[start]
        shape = (int(row[-1]) + 1, len(entities), rows.positions.shape[1])
        n_cells += shape[0] * shape[1] * shape[2]
        if n_cells > MAX_CELLS:
            raise DataError(
                f"{shape[1]} entities at {shape[0]} times make more than {MAX_CELLS:,} numbers",
                file=rows.file,
                remedy="drop short tracks (trackpy.filter_stubs) or split the data set",
            )
        scenes.append(_scene(rows, part, entities, row, local, is_new[start:stop], shape))
    return tuple(scenes), _unused(roster, used, without_track)


def _entities(rows, part, roster, points, used):
    """Entities of one scene in roster order, and the column of every row."""
    codes, local = np.unique(rows.entity[part], return_inverse=True)
    names = [rows.entity_names[code] for code in codes]
    if roster is None:
        for name in names:
            if name not in points:
                points[name] = Entity(name)
        return tuple(points[name] for name in names), local
    scene = rows.scene_names[rows.scene[part[0]]]
    places = [roster.row(scene, name) for name in names]
    if None in places:
        k = part[local == places.index(None)].min()
        known = list(dict.fromkeys(entity.name for entity in roster.entities))
        rows.fail(
            f"{rows.label(k)} is not in {roster.file}; present are {', '.join(known[:20])}", k,
            "entity", "add a row for it (scene blank = every scene) or correct the name",
        )  # fmt: skip
    used.update(places)
    ranks = np.argsort(places)
    return tuple(roster.entities[places[k]] for k in ranks), np.argsort(ranks)[local]


def _scene(rows, part, entities, row, local, is_new, shape):
    def spread(values):
        if values is None or (values is not rows.positions and np.isnan(values[part]).all()):
            return None
        full = np.full((*shape[:2], *values.shape[1:]), np.nan)
        full[row, local] = values[part]
        return full

    def first_state():
        if rows.first is None:
            return None
        blank = np.full(shape, np.nan)
        known = [blank if v is None else v for v in map(spread, rows.first)]
        return FirstState(known[0][0], known[1][0], rows.is_placed)

    name = rows.scene_names[rows.scene[part[0]]]
    try:
        return Scene(
            name, rows.times[part][is_new], spread(rows.positions), entities,
            spread(rows.velocities), spread(rows.sigma),
            {n: spread(v) for n, (v, _) in rows.inputs.items() if np.isfinite(v[part]).any()},
            first_state(), rows.may_meet,
            {n: spread(v) for n, (_, v, _) in rows.logged.items() if np.isfinite(v[part]).any()},
        )  # fmt: skip
    except DataError as error:
        raise DataError(error.problem, file=rows.file, remedy=error.remedy) from error


def unwrapped(scene):
    """A scene of angles without jumps by a whole turn, rad.

    Angles that reach over more than a turn do not jump: whoever wrote them counted the turns, of
    which there may be more than a half from row to row.
    """
    places = np.array(scene.positions)
    for track in np.moveaxis(places, 0, -1).reshape(-1, len(places)):
        seen = np.isfinite(track)
        if seen.any() and np.ptp(track[seen]) <= TURN:
            track[seen] = np.unwrap(track[seen])
    return replace(scene, positions=places)


def _unused(roster, used, without_track):
    if roster is None:
        return ()
    idle = {e.name for k, e in enumerate(roster.entities) if k not in used}
    idle = sorted(idle - set(without_track))
    if not idle:
        return ()
    return (f"{len(idle)} row(s) of {roster.file} have no trajectory: {', '.join(idle[:10])}",)
