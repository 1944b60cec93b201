"""Bodies of one table that are never seen at the same time: recordings of their own.

So is what stands below a clock that begins anew. One file may hold throw after throw of one ball,
each under a name of its own. As one scene every throw would exist from the first row on, long
before it is seen, and a law that brings tracks together in the past (drag, run backwards) could not
be fitted at all.

Bodies that are seen together may seem to be at one point at times, since their places were rounded
to whole pixels.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import in_python

LEAST_PART, NEAR_START = 8, 2.0
"""Rows of what is a recording of its own below a clock that begins anew, and usual steps by which
its first time may differ from that of the file."""
NEAR_HOME, LEAP, LEAST_BACK = 0.1, 0.5, 2
"""Parts of all that a body moves: within which it is back at its beginning, and over which it
leaps; how often it is back so where recordings may stand below each other."""
MAX_NAMES = 3
"""Bodies that the name of a scene tells, and scenes that a note lists times four."""
MOST, LEAST_ROWS = 0.25, 12
"""Part of the rows of a body in which it may be where another is, of so many at least."""
WHOLE = 1e-3
"""Part of a step that places may be off whole ones."""
LEAST_STEP = 1e-6
"""Part of the whole way that a step has at least; finer ones make no two places the same."""


def below_each_other(table):
    """A table whose clock falls back to its own beginning as recordings, each a scene; and a note.

    Every part of it must increase from row to row. Where a column tells recordings or bodies apart,
    or times are dates, it is left as it is.
    """
    if "t" not in table or table.owners or table.is_dated:
        return table
    if table.frame["t"].dtype.kind not in "fiu":
        return table
    times = table.numbers("t")
    starts = np.flatnonzero(np.diff(times) < 0) + 1
    parts = np.split(times, starts)
    if len(parts) < 2 or not all(_begins_as(part, times[0]) for part in parts):
        return table
    names = [f"part {k}" for k, part in enumerate(parts, 1) for _ in part]
    lines = listed(table.frame.index[starts].tolist(), 4 * MAX_NAMES)
    note = (
        f"{CHECK}the clock begins anew in line {lines}: read as recordings below each other, "
        f"scenes part 1 to part {len(parts)}; if they are bodies of one recording, add a column "
        "entity that names them"
    )
    return table.assigned(scene=names).noted(note)


def _begins_as(times, first):
    """Whether times are those of a recording that begins at about a first time."""
    if len(times) < LEAST_PART or not np.isfinite(times).all():
        return False
    steps = np.diff(times)
    return bool((steps > 0).all() and abs(times[0] - first) <= NEAR_START * np.median(steps))


def may_be_below(rows):
    """Rows with a check where a lone body is at its beginning again and again, after gaps."""
    if len(rows.entity_names) > 1 or len(rows.scene_names) > 1:
        return rows
    order = np.argsort(rows.times, kind="stable")
    places, gaps = rows.positions[order], np.diff(rows.times[order])
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    if len(gaps) < LEAST_PART or not size > 0:
        return rows
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    home = np.linalg.norm(places[1:] - places[0], axis=1) < NEAR_HOME * size
    is_back = home & (steps > LEAP * size) & (gaps > NEAR_START * np.median(gaps))
    if is_back.sum() < LEAST_BACK or np.quantile(steps, 0.9) > LEAP * size:
        return rows
    lines = listed(rows.lines[order][1:][is_back].tolist(), 4 * MAX_NAMES)
    return rows.noted(in_python(
        f"{CHECK}after gaps the body is back where it began, in line {lines}: these may be "
        "recordings below each other; a column that tells them apart makes them scenes, "
        "--columns scene=COLUMN"
    ))  # fmt: skip


def recordings_apart(rows, roster, has_scenes):
    """Rows of one scene as scenes of bodies whose times overlap, directly or through others.

    Nothing is taken apart where the roster (or None) holds bodies that do not move, or speaks of
    scenes: a wall is there though it is seen once; nor where the table says itself which rows are
    one scene (`has_scenes`).
    """
    if has_scenes or len(rows.entity_names) < 2 or _has_own_scenes(roster):
        return rows
    group_of = _groups(rows)
    n_groups = int(group_of.max()) + 1
    if n_groups < 2:
        return rows
    members = [np.flatnonzero(group_of == k) for k in range(n_groups)]
    names = tuple(_name([rows.entity_names[body] for body in group]) for group in members)
    what = "bodies" if n_groups == len(rows.entity_names) else "groups of bodies"
    told = ", ".join(names[: 4 * MAX_NAMES]) + ", …" * (n_groups > 4 * MAX_NAMES)
    note = f"{n_groups} {what} that are never seen at the same time: {n_groups} scenes ({told})"
    return replace(rows, scene=group_of[rows.entity], scene_names=names).noted(note)


def _has_own_scenes(roster):
    if roster is None:
        return False
    is_still = any(entity.is_static for entity in roster.entities)
    return is_still or any(scene is not None for scene, _ in roster.rows)


def _groups(rows):
    """Group of every entity, shape (n_entities,), in order of their first rows."""
    n_bodies = len(rows.entity_names)
    begin, end = np.full(n_bodies, np.inf), np.full(n_bodies, -np.inf)
    np.minimum.at(begin, rows.entity, rows.times)
    np.maximum.at(end, rows.entity, rows.times)
    order = np.argsort(begin, kind="stable")
    seen_until = np.maximum.accumulate(end[order])
    begins_anew = np.append(0, begin[order][1:] > seen_until[:-1])
    groups = np.empty(n_bodies, dtype=np.int64)
    groups[order] = np.cumsum(begins_anew)
    return groups


def _name(bodies):
    if len(bodies) > MAX_NAMES:
        return f"{bodies[0]} and {len(bodies) - 1} more"
    return " and ".join(bodies)


def without_meetings(rows):
    """Rows without those in which a body is where one before it is.

    No force between the two has a direction there, which rounding alone has made; where places
    were not rounded, or bodies meet often, nothing is left out.
    """
    if rows.may_meet or len(rows.entity_names) < 2:
        return rows
    order = np.argsort(rows.entity, kind="stable")
    where = pd.DataFrame(rows.positions).assign(scene=rows.scene, time=rows.times)
    is_met = np.zeros(len(rows.times), dtype=bool)
    is_met[order] = where.iloc[order].duplicated().to_numpy()
    if not is_met.any() or not all(map(_is_rounded, rows.positions.T)):
        return rows
    counts = np.bincount(rows.entity, minlength=len(rows.entity_names))
    met = np.bincount(rows.entity[is_met], minlength=len(counts))
    if (counts[met > 0] < LEAST_ROWS).any() or (met > MOST * counts).any():
        return rows
    each = [f"{rows.entity_names[k]!r} in {met[k]} of {counts[k]}" for k in np.flatnonzero(met)]
    note = (
        f"{CHECK}within the digits of the places another body is at the same point as "
        f"{listed(each)} row(s): there, these rows are gaps in its track (line "
        f"{listed(rows.lines[is_met], 8)}); if they are one body that was measured twice, "
        "leave one of them out"
    )
    return rows.taken(np.flatnonzero(~is_met)).noted(note)


def _is_rounded(places):
    """Whether all places along an axis are whole steps apart."""
    known = np.unique(places[np.isfinite(places)])
    if len(known) < 2:
        return True
    step = np.diff(known).min()
    if step < LEAST_STEP * np.ptp(known):
        return False
    steps = (known - known[0]) / step
    return bool(np.abs(steps - np.round(steps)).max() < WHOLE)
