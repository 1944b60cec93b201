"""Recordings in which a body was hit, or let go: followed in parts, where a law lacks more.

A kick alone is found like any other cause. Beside a law that lacks a force as well it explains
little, and any smooth force much: each then hides the other. Where a track shows that its velocity
jumps, whatever the law, its parts are followed each from a state of its own.
"""

from dataclasses import replace
from itertools import chain

import numpy as np

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK
from bsp_gp.data.stretches import cut_at, may_be_cut
from bsp_gp.fitting.fit import MISFIT
from bsp_gp.fitting.jumps import SIDE_ROWS
from bsp_gp.fitting.kinks import kinks
from bsp_gp.loop.proposers.walls import OFF, is_foreseen, jumps_in, levels_of, walls_at
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.units import Unit

VELOCITY = Unit.of(m=1, s=-1)
LEAST_MORE, ODD = 3, 4.0
"""Bounces more than there are axes, and errors by which velocities behind them must be off what any
linear law makes of those before them, for bounces to be odd."""
LEAST_FLIGHT = 8
"""Rows of a flight from wall to wall; shorter ones tell little, and are left out."""
PASSED = 0.25
"""Part of the usual distance of two bodies within which one passes the other."""
MOST = 4
"""Kinks of a recording, at the most: what is kicked all the time is pushed."""


def in_parts(dataset, found):
    """The data set with recordings cut where a velocity jumps, and a check that says where.

    Parameters
    ----------
    dataset : Dataset
    found : Fit
        Of the declared law, which lacks something.

    Returns
    -------
    Dataset or None
        None where nothing is cut: where the law foresees the jumps, where bodies meet, or jump
        all the time.
    """
    law = found.law
    if not may_be_cut(dataset) or constraints_of(law) or walls_of(law):
        return None
    edges, told = {}, []
    for scene in dataset.scenes:
        own = {k: _unforeseen(scene, k, found) for k in scene.dynamic}
        own = {k: some for k, some in own.items() if some}
        if not own:
            continue
        if len(own) > 1 or max(map(len, own.values())) > MOST:
            return None
        ((k, some),) = own.items()
        if any(_is_passed(scene, k, kink.time) for kink in some):
            return None
        edges[scene.name] = np.searchsorted(scene.times, [kink.time for kink in some]).tolist()
        where = f" in {scene.name!r}" if len(dataset.scenes) > 1 else ""
        told += [_told(scene, k, kink, dataset.units) + where for kink in some]
    if not told:
        return None
    note = (
        f"{CHECK}whatever moves it, a velocity jumps: {listed(told)}; something hits the body "
        f"there, or lets it go, and each side is followed from a state of its own"
    )
    return cut_at(dataset, edges, note)


def bounce(dataset):
    """Whether bodies turn back at walls: what they do there is no kick, and no hand's."""
    return bool(_bounces(dataset))


def _bounces(dataset):
    """Jumps of the velocity at walls, by axis and side."""
    return walls_at(list(chain(*jumps_in(dataset.scenes))), dataset)


def bounce_oddly(dataset):
    """Whether bodies leave walls with velocities that those they came with surely do not tell."""
    step = min(float(np.median(np.diff(scene.times))) for scene in dataset.scenes)
    for own in _bounces(dataset).values():
        came, left = np.stack([j.before for j in own]), np.stack([j.after for j in own])
        n_more = len(own) - came.shape[1]
        if n_more < LEAST_MORE:
            continue
        off = left - came @ np.linalg.lstsq(came, left, rcond=None)[0]
        error = own[0].error * np.sqrt(12 / SIDE_ROWS[0] ** 3) / step  # of the slope of few rows
        if np.square(off).sum() > n_more * came.shape[1] * (ODD * error) ** 2:
            return True
    return False


def in_flights(dataset):
    """The data set with recordings cut where bodies turn back at walls; None where that is no use.

    A ball that spins, or is not round, turns back in another way each time: no wall foretells its
    path. What acts on it in between shows all the same.
    """
    if not may_be_cut(dataset):
        return None
    walls = _bounces(dataset)
    if not walls:
        return None
    found = iter(jumps_in(dataset.scenes, tuple(sorted(levels_of(walls).items()))))
    edges = {}
    for scene in dataset.scenes:
        times = {jump.time for _ in scene.dynamic for jump in next(found)}
        edges[scene.name] = np.unique(np.searchsorted(scene.times, sorted(times))).tolist()
    count = sum(map(len, edges.values()))
    note = (
        f"{CHECK}bodies turn back at a wall, or are hit, {count} time(s), as no wall foretells: "
        "each flight is followed from a state of its own, and the wall is no part of the law"
    )
    cut = cut_at(dataset, {name: own for name, own in edges.items() if own}, note)
    long = tuple(
        scene for scene in cut.scenes
        if len(scene.times) >= LEAST_FLIGHT
        and np.ptp(scene.positions[:, scene.dynamic], axis=0).any()
    )  # fmt: skip
    names = {scene.name for scene in long}
    sides = {side: tuple(n for n in getattr(cut, side) if n in names) for side in ("train", "test")}
    return replace(cut, scenes=long, **sides) if len(long) > 1 else None


def lacks(found, levels):
    """Whether a law leaves more of places than the noise of rows, a memory of which may hide it."""
    if found.is_failed:
        return True
    left = found.residual / np.asarray(levels)[found.channels.axis]
    seen = np.isfinite(left)
    return float(np.square(left[seen]).sum()) > MISFIT * max(seen.sum() - found.n_free, 1)


def is_astray(found, levels):
    """Whether half of all rows are off what a law foresees by much more than their noise."""
    if found.is_failed:
        return True
    left = np.abs(found.residual / np.asarray(levels)[found.channels.axis])
    left = left[:, np.isfinite(left).any(axis=0)]
    return bool(np.nanmedian(left, axis=0).max(initial=0.0) > OFF)


def _unforeseen(scene, k, found):
    """Kinks of a body's track that a fit does not have."""
    return [
        kink for kink in kinks(scene.times, scene.positions[:, k])
        if found.is_failed or not is_foreseen(kink.time, scene, k, found)
    ]  # fmt: skip


def _is_passed(scene, k, time):
    """Whether another body passes close by at a time: what it does may pass for a kick."""
    others = np.arange(scene.positions.shape[1]) != k
    apart = np.linalg.norm(scene.positions[:, others] - scene.positions[:, [k]], axis=-1)
    row = int(np.searchsorted(scene.times, time))
    near = apart[max(row - SIDE_ROWS[0], 0) : row + SIDE_ROWS[0]]
    seen = np.isfinite(near).any(axis=0)
    least, usual = np.nanmin(near[:, seen], axis=0), np.nanmedian(apart[:, seen], axis=0)
    return bool((least < PASSED * usual).any())


def _told(scene, k, kink, units):
    speed = f"{np.linalg.norm(kink.turn):.3g} {units.text(VELOCITY)}"
    return f"that of {scene.names[k]} by {speed} at {units.instant(kink.time)}"
