"""Bodies that are held before they are let go, or lie on something at the end of a recording.

They stand still there although the declared law would move them: these rows are no part of the
motion that it is to explain. Standing still shows in the places whatever the law; what sets off
slowly from rest, or turns, goes on smoothly and is the motion.
"""

from dataclasses import replace

import numpy as np
from scipy import stats

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK, Evaluation
from bsp_gp.fitting.channels import unexplained
from bsp_gp.fitting.snippets import snippets_under

LEAST_ROWS, LEAST_MOVING, MOST_STILL, SURELY = 5, 10, 0.75, 100
"""Rows that stand still at an end, rows that are left, part of a track that may stand still, and
rows that are surely a motion, however long the rest is."""
STILL = 3.0
"""Standard deviations by which the scatter of rows that stand still may pass what is expected."""
NEAR = 0.01
"""Part of the extent of a track within which a body stands still, whatever noise its rows have."""
SLOW, CREPT = 0.05, 0.03
"""Part of its longest step up to which a body creeps, and of the extent how far that may take it:
what is held in a hand, or by friction, does not stand quite still."""
STEADY = 10.0
"""Times its scatter about an even motion that a way is which is no creeping."""
BESIDE = 2
"""Rows about the last that stands still, in which a body may already move."""
SETTLED = 0.1
"""Rows of a body that has settled which are kept where it rests long, in those of its motion."""
SMOOTH = 0.5
"""Of the squares of steps from row to row, in those of places about their mean, below which rows
are a motion: of noise without a memory they are twice as large."""
LAG, WANDERING = 4, 0.5
"""Rows in which a random walk goes twice as far as in one step; and part of the steps of others,
and of the square of that way, from which on rows wander."""
SAME = 1e-3
"""Standard deviations of the noise within which places are the same."""
HELD, CHANCE = 4.0, 1e-6
"""Reduced chi-squared from which on a law does not follow rows, and the chance of what curves and
laws leave."""
ABRUPT = 0.5
"""Mean step before a body lies still, in that of its motion, from which something stops it: what
settles where forces balance slows down, and is motion."""


def without_rests(dataset, law):
    """The data set without rows at which bodies stand still in spite of a law, with a note.

    Scenes of one moving body alone; nothing is done where rows are counted (`Evaluation`), where
    velocities are data, or in the sky. It is the same one where there is no such row.
    """
    if not may_lose_ends(dataset):
        return dataset
    levels = np.array(estimate_noise(dataset).sigma)
    ends = {scene.name: _still_ends(scene, levels) for scene in dataset.scenes}
    if not any(map(sum, ends.values())):
        return dataset
    held = _held(dataset, law, ends)
    ends = {
        name: [n * ((name, k) in held) for k, n in enumerate(own)] for name, own in ends.items()
    }
    note = (
        f"{CHECK}the body stands still where the law would move it, before the motion or after: it "
        "is held or lies on something, and these rows are left out ({})"
    )
    return _without(dataset, ends, note)


def without_still_ends(dataset):
    """The data set without rows at which bodies stand still before they move, or after.

    Whatever law is declared, and with a note: of bodies that bounce, or that nothing is known of,
    which begin in somebody's hand and end on the floor. It is the same one where there is no such
    row.
    """
    if not may_lose_ends(dataset):
        return dataset
    levels = np.array(estimate_noise(dataset).sigma)
    ends = {scene.name: _still_ends(scene, levels, SETTLED) for scene in dataset.scenes}
    note = (
        f"{CHECK}the body stands still before it moves, or after: it is held or lies on something, "
        "and these rows are left out ({})"
    )
    return _without(dataset, ends, note)


def _without(dataset, ends, note):
    """The data set without so many rows at both ends of scenes, and with a note that lists them."""
    scenes, told = [], []
    for scene in dataset.scenes:
        head, tail = ends[scene.name]
        if head or tail:
            told.append(f"{head} before and {tail} after in {scene.name!r}")
            scene = scene.rows(head, len(scene.times) - tail)
        scenes.append(scene)
    if not told:
        return dataset
    notes = (*dataset.notes, note.format(listed(told)))
    return replace(dataset, scenes=tuple(scenes), notes=notes)


def may_lose_ends(dataset):
    """Whether rows at the ends may be left out that are no part of the motion.

    Not where rows are counted (`Evaluation`), where velocities are data, or in the sky.
    """
    is_plain = dataset.evaluation == Evaluation() and dataset.velocity != "measured"
    return is_plain and not dataset.is_summed and not is_of_the_sky(dataset)


def _held(dataset, law, ends):
    """The ends, (scene, 0 or 1), whose rows a law does not follow as the others let it be."""
    moving = [scene.rows(a, len(scene.times) - b) for scene in dataset.scenes
              for a, b in [ends[scene.name]]]  # fmt: skip
    cut = replace(dataset, scenes=tuple(moving), train=(), test=())
    still = {}
    for scene in dataset.scenes:
        head, tail = (n - 2 * BESIDE for n in ends[scene.name])  # what surely stands still
        if head > 0:
            still[f"{scene.name} 0"] = (scene.name, 0, scene.rows(0, head))
        if tail > 0:
            still[f"{scene.name} 1"] = (scene.name, 1, scene.rows(-tail, None))
    scenes = [replace(rows, name=name) for name, (_, _, rows) in still.items()]
    found, out = snippets_under(law, cut, scenes), set()
    if found is None:
        return out
    for name, (scene, k, _) in still.items():
        left, dof = unexplained(found, name)
        if left > HELD * dof and stats.chi2.sf(left, dof) < CHANCE:
            out.add((scene, k))
    return out


def _still_ends(scene, levels, settled=0.0):
    """How many rows stand still at the beginning and at the end of a scene of one moving body.

    Of a body that has settled where forces balance only those count that are more than `settled`, a
    part of the rows of its motion; 0: none of them do.
    """
    if len(scene.dynamic) != 1 or scene.first is not None:
        return 0, 0
    places, seen = in_levels(scene, scene.dynamic[0], levels)
    head = _n_still(scene.times[seen], places[seen])
    tail = _n_still(-scene.times[seen][::-1], places[seen][::-1], is_end=True)
    moving = np.linalg.norm(np.diff(places[seen][head : len(seen) - tail], axis=0), axis=1)
    if tail and len(moving) and moving[-BESIDE - 1 :].mean() < ABRUPT * moving.mean():
        is_motion = not settled or _swings(places[seen][len(seen) - tail // 2 :])
        tail = 0 if is_motion else max(tail - int(settled * len(moving)), 0)
    n_moving = len(seen) - head - tail
    if n_moving < (SURELY if head + tail > MOST_STILL * len(seen) else LEAST_MOVING):
        return 0, 0
    return (
        int(seen[head]) if head else 0,
        len(scene.times) - 1 - int(seen[-1 - tail]) if tail else 0,
    )


def _swings(places):
    """Whether what has nearly settled still goes to and fro, from row to row less than in all."""
    if np.ptp(places, axis=0).max() < SAME:  # but for rounding
        return False
    scatter = np.square(places - places.mean(axis=0)).sum()
    return bool(np.square(np.diff(places, axis=0)).sum() < SMOOTH * scatter)


def _n_still(times, places, is_end=False):
    """Rows from the first on that stand still and do not go over smoothly into the others.

    What stands still may be told worse than what moves, and the very first row may be off: whoever
    tracks by hand begins somewhere.
    """
    if len(places) <= LEAST_ROWS:
        return 0
    off = int(np.argmax([_n_near(places, is_end), 1 + _n_near(places[1:], is_end)]))
    times, places = times[off:], places[off:]
    n = max(still_rows(places), _n_near(places, is_end))
    if not LEAST_ROWS <= n < len(places) or _wanders(places, n):
        return 0
    near = slice(0, min(2 * n, len(places)))
    t = (times[near] - times[0]) / np.ptp(times[near])
    left = (places[near] - _smooth(t, places[near])) / np.maximum(places[:n].std(axis=0), 1.0)
    dof = max(left.size - 3 * left.shape[1], 1)
    is_broken = stats.chi2.sf(np.square(left).sum(), dof) < CHANCE
    return off + min(n + BESIDE, len(places)) if is_broken else 0


def _wanders(places, n):
    """Whether the first n rows go on as the others do, by steps at random: nobody holds a bead."""
    if n < LAG**2 or len(places) - n < 2:
        return False
    own, other, far = (
        np.sqrt(np.mean(np.square(p[lag:] - p[:-lag])))
        for p, lag in ((places[:n], 1), (places[n:], 1), (places[:n], LAG))
    )
    return bool(own > WANDERING * other and far > WANDERING**0.5 * np.sqrt(LAG) * own)


def _n_near(places, is_end):
    """Rows from the first on that are near it beside the way of all, or creep about there.

    What goes on evenly to the end of a track moves, as under a parachute; a hand may do so before
    it lets go.
    """
    away = np.linalg.norm(places - places[0], axis=1)
    extent = np.linalg.norm(np.ptp(places, axis=0))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    slow = _until(steps > SLOW * steps.max(initial=0.0)) + 1
    crept = min(slow, _until(away > CREPT * extent))
    return max(_until(away > NEAR * extent), 0 if is_end and _is_steady(places[:crept]) else crept)


def _is_steady(places):
    """Whether rows go on evenly; what creeps stops and goes."""
    if len(places) < 2 * LEAST_ROWS:
        return False
    t = np.linspace(-1.0, 1.0, len(places))
    centred = places - places.mean(axis=0)
    slope = t @ centred / (t @ t)
    left = centred - t[:, None] * slope
    return bool(np.square(2 * slope).sum() > STEADY**2 * np.square(left).sum(axis=1).mean())


def _until(is_over):
    """How many come before the first that is True."""
    at = np.flatnonzero(is_over)
    return int(at[0]) if len(at) else len(is_over)


def _smooth(t, places):
    """Parabolas nearest to places."""
    columns = np.stack([np.ones_like(t), t, t * t], axis=1)
    return columns @ np.linalg.lstsq(columns, places, rcond=None)[0]


def in_levels(scene, k, levels):
    """Places of a body in levels of the noise (T, a), along axes that have one, and rows seen."""
    axes = np.isfinite(levels)
    places = scene.positions[:, k][:, axes] / np.maximum(levels[axes], np.finfo(float).tiny)
    return places, np.flatnonzero(np.isfinite(places).all(axis=1))


def still_rows(places):
    """How many rows of (T, d) from the first on scatter about one place as noise does."""
    places = places - places[:1]  # far from zero little would be left of their scatter
    count = np.arange(1, len(places) + 1)
    mean = np.cumsum(places, axis=0) / count[:, None]
    scatter = (np.cumsum(np.square(places), axis=0) - count[:, None] * mean**2).sum(axis=1)
    dof = (count - 1) * places.shape[1]
    return int(count[scatter <= dof + STILL * np.sqrt(2 * np.maximum(dof, 1))].max(initial=0))
