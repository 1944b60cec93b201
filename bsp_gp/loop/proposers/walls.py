"""Floors, walls and cushions that tracks betray: velocities that turn back at one place.

Jumps of the velocity that turn bodies back across an axis, at the places farthest along it, are a
wall. What acts between jumps is proposed with it, since no track is followed across many bounces
under a law that is far off.
"""

import math
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np

from bsp_gp.fitting.fit import REFUTED
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.jumps import ACROSS, SIDE_ROWS, WINDOW, between, jumps, n_turns, scatter
from bsp_gp.fitting.parts.constraints import extent_of
from bsp_gp.fitting.parts.defects import Resting
from bsp_gp.fitting.parts.walls import count_of, places_of, wall_of
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.physics.force import ForceLaw, Term, numbered

STEMS = ("h", "e", "k", "tilt")
PLAIN = 2
"""Of these, those of a wall that is smooth and stands along an axis."""
SLOWING = ("norm(v_i) * normalize(v_i)", "norm(v_i)^2 * normalize(v_i)", "normalize(v_i)")
"""What slows bodies between walls: linear and quadratic drag, friction."""
SELDOM = 0.1
"""Part of the times that bodies turn back at a side at which their velocities jump at a wall."""
LEAST_SWEPT = 0.05
"""Part of the longest way, along whichever axis, that bodies go along an axis with walls."""
ALIKE, OUTSIDE = 0.02, 0.2
"""Part of the extent of tracks within which jumps of one wall lie, beside their errors, and the
most of the way that bodies go along its axis."""
ERRORS = 5.0
FORESEEN = 0.5
"""Part of a turn that the law as it is makes, from which it is no wall's."""
FAR = 20.0
"""Chi-squared of forces between jumps, beyond that of the best, from which sums are not fitted; and
the part of it that errors of the forces may make, as one over so much."""
SLANTING = 0.05
"""Speed along a wall, in that across it, below which what is kept of it is not asked of jumps."""
OFF = 3.0
"""Errors by which half of all rows must be off for one jump alone to be at a wall, and for flights
from wall to wall to be followed each by itself where no wall could be fitted."""
SLOWEST, FAST = 0.3, 0.9
"""Part of their speeds along an axis, of the one that nine tenths of rows have at the most, at
which bodies meet a wall."""
KEPT = (0.05, 1.2)
"""Parts of their speed that bodies may keep."""
LYING, LEAST_LYING = 4.0, 12
"""Errors above a wall within which a body lies on it, and rows at which it is seen there."""


class Walls:
    """Walls as a proposer."""

    name = "walls"

    def propose(self, view):
        """The family of all walls that tracks turn back at."""
        # A body on a rod or a wire turns back where that leads it.
        if view.is_sky or view.fit.paper_steps or constraints_of(view.fit.law):
            return Family(self.name)
        found = _jumps_of(view)
        known = {(part.axis, part.side) for part in walls_of(view.fit.law)}
        groups = walls_at([jump for own in found.values() for jump in own], view.dataset)
        if groups:  # where a wall stands other bounces show that are not as clear
            found = _jumps_of(view, levels_of(groups))
            groups = walls_at([jump for own in found.values() for jump in own], view.dataset)
        groups = {key: own for key, own in groups.items() if key not in known}
        most = _unexplained(view, groups) if groups else 0.0
        if most <= 0:
            return Family(self.name)
        proposals = _proposals(view, groups, found, most)
        best = proposals[0]
        return Family(
            self.name, proposals, best.gain, best.rank, np.zeros(1),
            n_tried=2 * view.dataset.n_dims,
        )  # fmt: skip


def _jumps_of(view, levels=None):
    """Jumps of every track that the law does not foresee, by scene and number of the body."""
    scenes = view.dataset.scenes
    found = jumps_in(scenes, tuple(sorted((levels or {}).items())))
    tracks = [(scene, k) for scene in scenes for k in scene.dynamic]
    return {
        (scene.name, k): [jump for jump in own if not is_foreseen(jump.time, scene, k, view.fit)]
        for (scene, k), own in zip(tracks, found, strict=True)
    }


@lru_cache(maxsize=4)
def jumps_in(scenes, levels=()):
    """Jumps of every track of scenes; every round asks for them anew.

    Parameters
    ----------
    scenes : tuple of Scene
    levels : tuple, optional
        Items of the levels that `jumps` takes.
    """
    return [
        jumps(scene.times, scene.positions[:, k], dict(levels))
        for scene in scenes for k in scene.dynamic
    ]  # fmt: skip


def is_foreseen(time, scene, k, fit):
    """Whether a body turns back there under the law as well, without a wall: at a spring's end.

    Parameters
    ----------
    time : float, s
    scene : Scene
    k : int
        Number of the body in it.
    fit : Fit
    """
    channels = fit.channels
    if scene.name not in channels.scene_names or scene.names[k] not in channels.body_names:
        return False
    mine = channels.scene == channels.scene_names.index(scene.name)
    mine &= channels.body == channels.body_names.index(scene.names[k])
    left, places = fit.residual[: len(scene.times), mine], scene.positions[:, k]
    left = np.where(np.isnan(left).all(axis=0), 0.0, left)  # axes along which nothing moves
    seen = np.isfinite(places).all(axis=1) & np.isfinite(left).all(axis=1)
    times, places, left = scene.times[seen], places[seen], left[seen]
    at, rows = int(np.searchsorted(times, time)), SIDE_ROWS[0]
    if at < rows or at > len(times) - rows:
        return False
    before, after = slice(at - rows, at), slice(at, at + rows)

    def turn(track):
        late, early = (np.polyfit(times[rows], track[rows], 1)[0] for rows in (after, before))
        return late - early

    found, foreseen = turn(places), turn(places - left)
    return bool(found @ foreseen > FORESEEN * (found @ found))


def walls_at(found, dataset):
    """Jumps at every wall, by axis and side: bodies turn back where they come farthest."""
    extent, places, groups = extent_of(dataset)[1], places_of(dataset), {}
    swept = np.nanmax(places, axis=0) - np.nanmin(places, axis=0)
    for jump in found:
        turn = jump.after - jump.before
        axis = int(np.argmax(np.abs(turn)))
        if swept[axis] < LEAST_SWEPT * swept.max():
            continue  # what shakes a body across its way is no wall
        side = 1 if turn[axis] > 0 else -1
        kept = -jump.after[axis] / jump.before[axis] if jump.before[axis] else math.inf
        farthest = side * float(np.nanmin(side * places[:, axis]))
        within = min(ALIKE * extent, OUTSIDE * swept[axis]) + ERRORS * jump.error
        is_there = abs(jump.place[axis] - farthest) <= within
        if is_there and KEPT[0] <= kept <= KEPT[1]:
            groups.setdefault((axis, side), []).append(jump)
    # Where a spring turns bodies back, or they shake, they are slow; and a row that is off is no
    # wall at which they turn back smoothly otherwise.
    return {
        (axis, side): own for (axis, side), own in groups.items()
        if max(abs(jump.before[axis]) for jump in own) > SLOWEST * _fast(dataset, axis)
        and len(own) >= SELDOM * _n_turns(dataset, axis) / 2
    }


def _n_turns(dataset, axis):
    """How often bodies turn back along an axis, on both sides."""
    tracks = [s.positions[:, k] for s in dataset.scenes for k in s.dynamic]
    tracks = [x[np.isfinite(x).all(axis=1)] for x in tracks]
    return sum(n_turns(x[:, axis], ACROSS * scatter(x)) for x in tracks if len(x))


def _fast(dataset, axis):
    """How fast bodies are along an axis where they are fast, m/s."""
    found = [np.zeros(1)]
    for scene in dataset.scenes:
        for k in scene.dynamic:
            x = scene.positions[:, k, axis]
            times, x = scene.times[np.isfinite(x)], x[np.isfinite(x)]
            rows = min(SIDE_ROWS[0], max(len(x) - 1, 1))
            found.append(np.abs((x[rows:] - x[:-rows]) / (times[rows:] - times[:-rows])))
    return float(np.quantile(np.concatenate(found), FAST))


def _proposals(view, groups, jumps_of, most):
    """All walls together: beside the law as it is, and with forces of textbooks as well.

    None gains more than `most`.
    """
    law, dataset, part = view.fit.law, view.dataset, view.hypothesis
    names, walls, plain, extent = list(law.names), [], view.hypothesis, extent_of(dataset)[1]
    for (axis, side), own in groups.items():
        mine = [numbered(stem, names) for stem in STEMS[: count_of(dataset)]]
        names += mine
        values = _values(own, axis)
        walls.append(wall_of(mine, axis, side, dataset.n_dims, values, extent))
        part = part + walls[-1]
        plain = plain + wall_of(mine[:PLAIN], axis, side, dataset.n_dims, values[:PLAIN], extent)
    resting = _resting(dataset, groups)
    part, plain = sum(resting, part), sum(resting, plain)
    every = [jump for own in groups.values() for jump in own]
    # All that is left: bodies that bounce are far from where the law would take them. Turns that it
    # explains, of a mass on a spring, are none of these.
    gain = max(float(view.left @ view.left) - view.n_left, sum(jump.gain for jump in every))
    gain = min(gain, most)
    text = ", ".join(one.describe() for one in (*walls, *resting))
    rank = sum(len(wall.names) for wall in walls)
    told = _told(dataset, jumps_of, groups, is_bare=not any(t.is_declared for t in law.terms))
    types = dataset_types(dataset)
    least = min(left for _, left in told.values())
    error = max(jump.error for jump in every)
    out = []
    for forms, (values, left) in told.items():
        if left - least > max(FAR, least / FAR):
            continue
        strengths = []
        for _ in forms:
            strengths.append(numbered("c", [*names, *strengths]))
        formulas = tuple(
            parse_formula(f"{name} * ({form})", types)
            for form, name in zip(forms, strengths, strict=True)
        )
        starts = dict(zip(strengths, values, strict=True))
        more = [Forces(ForceLaw(tuple(map(Term, formulas)), starts))] if forms else []
        whole, smooth = sum(more, part), sum(more, plain)
        proposal = Proposal(
            "bounce", " + ".join([text, *map(to_text, formulas)]), whole,
            -(len(walls) + len(resting) + len(forms)) * view.criteria.cause_nats,
            gain - (left - least),
            rank + len(forms), kind="wall", is_sole=True, error=error, is_afresh=True,
            patience=PATIENT,  # contacts make many steps of a track
        )  # fmt: skip
        if rank > PLAIN * len(walls):  # many numbers of many walls lead one another astray
            less = replace(proposal, hypothesis=smooth, rank=PLAIN * len(walls) + len(forms))
            proposal = replace(proposal, instead=less)
        out.append(proposal)
    return tuple(sorted(out, key=lambda proposal: -proposal.promise))


def _resting(dataset, groups):
    """Rows at which bodies lie on walls up to their ends, as parts of a hypothesis."""
    levels, out = levels_of(groups), []
    for scene in dataset.scenes:
        for k in scene.dynamic:
            places = scene.positions[:, k]
            error, seen = scatter(places), np.isfinite(places).all(axis=1)
            lies = ~seen | _at_walls(places, levels, LYING * error)
            first = len(lies) - int(np.argmin(lies[::-1])) if not lies.all() else 0
            if first and np.count_nonzero(seen[first:]) >= LEAST_LYING:
                out.append(Resting(
                    scene.name, first, len(lies), scene.names[k], error=error,
                    n_left_out=np.count_nonzero(seen[first:]) * dataset.n_dims,
                ))  # fmt: skip
    return out


def levels_of(groups):
    """Where walls stand across their axes, by axis and side."""
    return {key: np.median([jump.place[key[0]] for jump in own]) for key, own in groups.items()}


def _at_walls(places, levels, near):
    """Whether places (T, d) are nearer than that to some wall, or behind it, (T,)."""
    held = [side * (places[:, axis] - at) < near for (axis, side), at in levels.items()]
    return np.any(held, axis=0)


def _unexplained(view, groups):
    """Chi-squared that the law leaves of places beyond that of noise, surely.

    A memory of the noise may have taken up what a motion is, and one jump may be a row that is far
    off: then half of all rows must be off by much more than the noise from row to row.
    """
    fit, every = view.fit, [jump for own in groups.values() for jump in own]
    usual = _beyond(fit.whitened if fit.noise.adding else
                    fit.residual / fit.noise.sizes(fit.channels))  # fmt: skip
    if fit.noise.adding or (len(every) > 1 and usual > 0):
        return usual
    left = fit.residual / max(jump.error for jump in every)
    half = np.ma.median(np.ma.masked_invalid(np.abs(left)), axis=0)  # of every coordinate
    return _beyond(left) if half.max() > OFF else 0.0


def _beyond(left):
    """Chi-squared of errors of size one beyond that of noise, surely."""
    count = np.count_nonzero(np.isfinite(left))
    return float(np.nansum(np.square(left))) - count - REFUTED * math.sqrt(2 * count)


def _told(dataset, jumps_of, groups, is_bare):
    """Strengths of every sum of forces that may act between walls, and chi-squared that it leaves.

    Where forces are declared, nothing is said of either: a push across a wall is none of these.
    Nor where no rows are between jumps.
    """
    pushes = [f"e_{'xyz'[axis]}" for axis in dict.fromkeys(axis for axis, _ in groups) if is_bare]
    sums = [tuple(form for form in both if form) for both in product(("", *pushes), ("", *SLOWING))]
    flights = _flights(dataset, jumps_of, groups) if is_bare else None
    if flights is None or not len(flights[0]):
        return {forms: ([math.nan] * len(forms), 0.0) for forms in sums}
    return {forms: _regressed(flights, forms) for forms in sums}


def _flights(dataset, jumps_of, groups):
    """Velocities, forces and errors of forces at rows between jumps, (n, d), (n, d) and (n, 1).

    Forces of neighbouring rows are told by the same rows: errors are such that each counts for its
    part. A body that lies at a wall of `groups` is held by it.
    """
    levels, out = levels_of(groups), []
    for scene in dataset.scenes:
        for k in scene.dynamic:
            _, v, a = between(scene.times, scene.positions[:, k], jumps_of[scene.name, k])
            mass, error = scene.entities[k].mass, scatter(scene.positions[:, k])
            if not error > 0:
                continue  # a run in which it only stood
            near = _at_walls(scene.positions[:, k], levels, ERRORS * error)
            told = np.isfinite(a).all(axis=1) & ~near
            mass = mass if math.isfinite(mass) else 1.0
            span = WINDOW * float(np.median(np.diff(scene.times)))
            error *= math.sqrt(720) / span**2  # of a parabola through so many rows
            out.append((v[told], mass * a[told], np.full((told.sum(), 1), mass * error)))
    return tuple(map(np.concatenate, zip(*out, strict=True))) if out else None


def _regressed(flights, forms):
    """Strengths of forces (with names as in `SLOWING`, or axes) between jumps, and chi-squared."""
    v, forces, errors = flights
    speed = np.linalg.norm(v, axis=1, keepdims=True)
    known = dict(zip(SLOWING, (v, speed * v, v / np.where(speed > 0, speed, 1.0)), strict=True))
    known |= {f"e_{'xyz'[k]}": np.broadcast_to(axis, v.shape)
              for k, axis in enumerate(np.eye(v.shape[1]))}  # fmt: skip
    columns = np.stack([np.zeros_like(v), *(known[form] for form in forms)], axis=-1)
    columns, target = (columns / errors[..., None]).reshape(v.size, -1), (forces / errors).ravel()
    values = np.linalg.lstsq(columns, target, rcond=None)[0]
    return values[1:].tolist(), float(np.square(target - columns @ values).sum())


def _values(own, axis):
    """Where the numbers of a wall begin: its place, and what bodies keep across and along it."""
    level = float(np.median([jump.place[axis] for jump in own]))
    kept = float(np.median([-jump.after[axis] / jump.before[axis] for jump in own]))
    along = 1.0
    if len(own[0].place) > 1:
        rest = [np.delete(np.stack([j.before, j.after]), axis, axis=1) for j in own]
        size = sum(float(np.square(before).sum()) for before, _ in rest)
        across = sum(float(j.before[axis] ** 2) for j in own)
        if size > SLANTING**2 * across:
            along = sum(float(before @ after) for before, after in rest) / size
    return level, kept, float(np.clip(along, 0.0, 1.2))
