"""Ends of a track that begin with a leap no body makes: what is seen there is another thing.

A motion sensor whose object has left its beam, a tracker that lost its mark: the place leaps by
many times the longest step before, and does not go on from there as a body that was hit would.
"""

import heapq
from dataclasses import replace

import numpy as np

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK, Evaluation
from bsp_gp.units import Unit

LEAP = 8.0
"""Steps, in the longest of the track before but for a few, from which one is a leap."""
FEW = 2
"""Steps that a single bad row makes."""
LEAST_KEPT, LEAST_ROWS = 0.6, 3
"""Part of the rows that must be left, and rows behind a leap: fewer are rows that are off."""
SMOOTH, LEAST_LEAP = 5.0, 0.25
"""Longest steps that the way of a motion is at least, and part of that way that a leap is."""
ONWARD = 0.5
"""Part of a leap that a body which was hit would go on by from row to row."""


def without_torn_ends(dataset):
    """The data set without ends of tracks behind a leap, with a note.

    Scenes of one moving body alone: where several move, another of them may have been taken for
    it. Nor where something is logged beside the track, first states are declared, rows are counted
    (`Evaluation`), or in the sky.
    """
    if dataset.evaluation != Evaluation() or is_of_the_sky(dataset):
        return dataset
    scenes, told = [], []
    unit = dataset.units.text(Unit.of(s=1))
    for scene in dataset.scenes:
        first, stop = _whole(scene)
        if (first, stop) != (0, len(scene.times)):
            at = [scene.times[first]] if first else []
            at += [scene.times[stop - 1]] if stop < len(scene.times) else []
            when = " and ".join(f"{time:.6g}" for time in at)
            sides = "before" if stop == len(scene.times) else "after"
            sides = "outside" if len(at) > 1 else sides
            told.append(
                f"{len(scene.times) - stop + first} of {scene.name!r} {sides} t = {when} {unit}"
            )
            scene = scene.rows(first, stop)
        scenes.append(scene)
    if not told:
        return dataset
    note = (
        f"{CHECK}a track leaps by far more than any step of the motion, and does not go on from "
        f"there: the rows beyond are left out ({listed(told)}); if they are the "
        "motion, give them as a recording of their own"
    )
    return replace(dataset, scenes=tuple(scenes), notes=(*dataset.notes, note))


def _whole(scene):
    """First row and row behind the last of the part of a scene that is not torn."""
    whole = 0, len(scene.times)
    if len(scene.dynamic) != 1 or scene.first is not None or scene.inputs or scene.logs:
        return whole
    places = scene.positions[:, scene.dynamic[0]]
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    places, times = places[seen], scene.times[seen]
    tail = _leap(times, places)
    head = _leap(-times[::-1], places[::-1])
    if head is not None and tail is not None:  # what is left must still be most of it
        is_most = tail + head + 2 - len(seen) >= LEAST_KEPT * len(seen)
        head, tail = (head, tail) if is_most else (None, None)
    return (
        0 if head is None else int(seen[len(seen) - 1 - head]),
        whole[1] if tail is None else int(seen[tail]) + 1,
    )


def _leap(times, places):
    """The last row before the first leap towards the end of a track; None if there is none."""
    if len(times) < 4 * LEAST_ROWS:
        return None
    step = np.diff(times)
    usual = np.median(step)
    way = np.diff(places, axis=0)
    # Rows that are hurried together differ by their noise, in however short a time.
    size = np.linalg.norm(way, axis=1) * usual / np.maximum(step, usual)
    first = int(LEAST_KEPT * len(places))
    top, span = float(size[:first].max()), np.ptp(places[:first], axis=0)
    # What rests, jitters, or answers a push within a few rows may leap: it does not move elsewise.
    if not np.linalg.norm(span) > SMOOTH * top > 0:
        return None
    longest = sorted(np.partition(size[:first], -FEW - 1)[-FEW - 1 :].tolist())
    if not size[first:].max() > LEAP * longest[0] > 0:  # the longest before only grow
        return None
    for k in range(first, len(size) - LEAST_ROWS + 1):
        is_leap = size[k] > LEAP * longest[0]
        heapq.heappushpop(longest, float(size[k]))  # sorted, it is a heap: the least in front
        if not is_leap:
            continue
        before, behind = way[k - 1], way[k + 1]
        goes_on = np.linalg.norm(behind - before) < ONWARD * np.linalg.norm(before)
        if goes_on or np.linalg.norm(way[k]) < LEAST_LEAP * np.linalg.norm(span):
            continue  # out of one side of a box and in at the other; or a gap
        onward = (places[[k + 2, k + 3]] - places[k + 1]) @ way[k] / (way[k] @ way[k])
        before = np.median(places[k - FEW : k + 1], axis=0)  # the last row may be off itself
        away = np.linalg.norm(np.median(places[k + 1 :], axis=0) - before)
        back = np.linalg.norm(places[k + 2 : k + 2 + FEW] - before, axis=1).min()
        is_row = back < ONWARD * np.linalg.norm(way[k])  # a row is off, and the next are not
        if np.all(onward < ONWARD) and away > 0.5 * np.linalg.norm(way[k]) and not is_row:
            return k
    return None
