"""Tables without times: their rows as frames, where nothing speaks against it; ends without one."""

from dataclasses import replace

import numpy as np
import pandas as pd

from bsp_gp.data.conversion import TIME, unit_of
from bsp_gp.data.headings import GUESS, UNKNOWN, is_body, is_rate_of
from bsp_gp.data.notes import quoted
from bsp_gp.data.scene import CHECK

COUNTED = "there is no column of times: every row is taken as a frame"
IN_TURN = "there is no column of times: bodies stand below each other in turn, a frame each round"
RISES = 0.8
"""Part of the steps of a clock that go up; it may begin anew where another recording begins."""
_RATE = "--fps 25 says how many are in a second, or --dt the time of one"
_NAME_IT = 'add it, or say which it is: --columns t="..."'


def rows_as_frames(frame, found):
    """Count the rows of a table that has places and no times.

    Rows are frames one after another unless a column says otherwise, or may: that of bodies, that
    of recordings whose rows are mixed, or one that means nothing to us and may be a clock or tell
    rows apart. Columns are called by their positions; the index counts lines.

    Returns
    -------
    frames : Series or None
        The frame of every row, from 0 in every recording; None where rows are not counted.
    remedy : str
        What to do where nothing says how long a frame is, or rows are not counted.
    """
    names = [h.name for h in found]
    doubtful = [
        k for k, h in enumerate(found)
        if h.sure == UNKNOWN and not (h.ignored or _is_measured(h) or is_rate_of(h.name))
        and _may_order(frame[k])
    ]  # fmt: skip
    if doubtful:
        able = [found[k].theirs for k in doubtful if _may_be_clock(frame[k])]
        return None, _remedy_of_doubt(doubtful, [found[k].theirs for k in doubtful], able)
    if "entity" in names and "scene" not in names and _in_turn(frame[names.index("entity")]):
        n_bodies = frame[names.index("entity")].nunique()
        counted = pd.Series(np.arange(len(frame)) // n_bodies, frame.index)
        return counted, f"{_NAME_IT}; if every round is a frame, {_RATE}"
    scenes = frame[names.index("scene")] if "scene" in names else pd.Series(0, frame.index)
    are_mixed = (scenes != scenes.shift()).sum() > scenes.nunique()
    if "entity" in names or are_mixed:
        return None, (
            f'{_NAME_IT}; or number the frames, --columns frame="..." and --fps 25: rows of '
            "several bodies or recordings are no frames one after another"
        )
    lines = pd.Series(frame.index, frame.index)
    counted = lines - lines.groupby(scenes).transform("min")  # rows where all are lost count
    return counted, f"{_NAME_IT}; if every row is a frame, {_RATE}"


def with_bodies_in_turn(frame, found):
    """Headings with the one of names that come again and again in one order as that of bodies."""
    if {"t", "frame", "entity", "scene"} & {h.name for h in found}:
        return found
    named = [
        h for k, h in enumerate(found)
        if h.sure == UNKNOWN and not h.ignored and is_body(h.name)
        and frame[k].dtype.kind not in "fiub" and _in_turn(frame[k])
    ]  # fmt: skip
    return [replace(h, name="entity", sure=GUESS) if [h] == named else h for h in found]


def _in_turn(names):
    """Whether names of bodies come in rounds, all in one order."""
    codes, labels = pd.factorize(names)
    count = len(labels)
    is_whole = 1 < count <= len(codes) // 2 and len(codes) % count == 0
    return bool(is_whole and (codes.reshape(-1, count) == np.arange(count)).all())


def _is_measured(heading):
    """Whether a column has a unit, and that is none of time."""
    return bool(heading.unit) and unit_of(heading.unit) != TIME


def _may_order(cells):
    """Whether a column may be a clock, or names of bodies or recordings."""
    cells = cells.dropna()
    n_values = cells.nunique()
    if n_values < 2:
        return False
    if cells.dtype.kind not in "iuf":
        return True
    steps = np.diff(cells.to_numpy(dtype=float))
    if (steps == 1).all():  # it counts rows
        return False
    is_clock = (steps > 0).sum() >= RISES * (steps != 0).sum()
    return bool(is_clock or (n_values <= len(cells) / 2 and (cells % 1 == 0).all()))


def _may_be_clock(cells):
    """Whether cells are numbers, or texts of which no two are the same, as dates are."""
    return cells.dtype.kind in "iuf" or cells.is_unique


def _remedy_of_doubt(places, names, clocks):
    if "" in names:
        place = places[names.index("")] + 1
        return f"column {place} has no name and may be it: give it one, such as t or frame"
    names = list(map(quoted, names))
    is_it = f"{' or '.join(names[:3])} " + "is it, or " * bool(clocks)
    options = f"t={quoted(clocks[0])} (or frame=, entity=, scene=)" if clocks else (
        f"scene={names[0]} (of bodies entity=)")  # fmt: skip
    ignored = " ".join(f"{name}=ignore" for name in names)
    return (
        f"if {is_it}tells bodies or recordings apart, say so: --columns {options}; if none does, "
        "and every row is a "
        f"frame: --columns {ignored} and --fps 25"
    )


def without_timeless_ends(table):
    """The table without rows at its ends that have no time, as sums and means below it; a note."""
    if "t" not in table.frame.columns:
        return table, ()
    lines = table.frame.index.to_numpy()  # of runs side by side the same ones
    timed = lines[table.frame["t"].notna().to_numpy()]
    if not len(timed):
        return table, ()
    is_within = (timed.min() <= lines) & (lines <= timed.max())
    if is_within.all():
        return table, ()
    count = len(is_within) - is_within.sum()
    note = f"{CHECK}{count} row(s) without a time at the ends of the table are left out"
    return table.of_rows(is_within), (note,)
