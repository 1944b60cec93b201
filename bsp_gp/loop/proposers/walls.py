"""Floors, walls and cushions that tracks betray: velocities that turn back at one place.

Wherever the velocity jumps between two rows, and the rows on both sides lie on parabolas of one
acceleration, a body was hit. Jumps that turn it back across one axis at one place are a wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.parts.constraints import extent_of
from bsp_gp.fitting.parts.walls import wall_of
from bsp_gp.fitting.probes import probe_terms
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.physics.force import ForceLaw, Term, fresh_name

__all__ = ["Jump", "Walls", "jumps"]

SIDE_ROWS = 4
"""Rows on each side of a jump that are looked at."""
CLEAR = 50.0
"""Chi-squared by which a jump must explain them better than a motion that is smooth."""
LEAST_JUMPS = 2
ALIKE = 0.02
"""Part of the extent of tracks within which jumps of one wall lie, beside their errors."""
ERRORS = 5.0
KEPT = (0.05, 1.2)
"""Parts of their speed that bodies may keep."""
EXACT = 1e-6
"""Part of the extent below which errors are none."""


@dataclass(frozen=True)
class Jump:
    """A velocity that jumps.

    Attributes
    ----------
    place : ndarray, shape (d,), m
    before, after : ndarray, shape (d,), m/s
    pull : ndarray, shape (d,), m/s^2
        Acceleration on both sides.
    error : float, m
        Of a coordinate of a row.
    gain : float
        Chi-squared that it explains beside a smooth motion.
    """

    place: np.ndarray
    before: np.ndarray
    after: np.ndarray
    pull: np.ndarray
    error: float
    gain: float


class Walls:
    """Walls as a proposer."""

    name = "walls"

    def propose(self, view):
        """The family of all walls that tracks turn back at.

        Parameters
        ----------
        view : View
        """
        if view.is_astronomical or view.fit.paper_steps:
            return Family(self.name)
        found = [
            jump for scene in view.dataset.scenes for k in scene.dynamic
            for jump in jumps(scene.times, scene.positions[:, k])
        ]  # fmt: skip
        extent = extent_of(view.dataset)[1]
        known = {(part.axis, part.side) for part in walls_of(view.fit.law)}
        groups = {key: own for key, own in _walls(found, extent).items() if key not in known}
        if not groups:
            return Family(self.name)
        proposals = _proposals(view, groups, extent)
        best = proposals[0]
        return Family(
            self.name, proposals, best.gain, best.rank, np.zeros(1),
            n_tried=2 * view.dataset.n_dims,
        )  # fmt: skip


def jumps(times, places):
    """Instants at which the velocity of a track jumps, the rows on both sides being smooth.

    Parameters
    ----------
    times : ndarray, shape (T,)
    places : ndarray, shape (T, d)
        nan where not seen.

    Returns
    -------
    list of Jump
    """
    seen = np.isfinite(places).all(axis=1)
    times, places = times[seen], places[seen]
    if len(times) < 2 * SIDE_ROWS:
        return []
    third = np.diff(places, 3, axis=0)
    extent = float(np.ptp(places, axis=0).max())
    spread = 1.4826 * np.median(np.abs(third), axis=0) / math.sqrt(20)
    error = max(float(np.sqrt(np.mean(np.square(spread)))), EXACT * extent)
    found = [_jump(times, places, k, error) for k in range(SIDE_ROWS, len(times) - SIDE_ROWS + 1)]
    gains = np.array([0.0 if jump is None else jump.gain for jump in found])
    out = []
    for k in np.flatnonzero(gains > CLEAR):
        near = gains[max(k - SIDE_ROWS, 0) : k + SIDE_ROWS + 1]
        if gains[k] == near.max():
            out.append(found[k])
    return out


def _jump(times, places, k, error):
    """A jump between the rows before k and those from k on; None where it explains nothing."""
    rows = slice(k - SIDE_ROWS, k + SIDE_ROWS)
    middle = (times[k - 1] + times[k]) / 2
    t, x = times[rows] - middle, places[rows]
    late = (np.arange(2 * SIDE_ROWS) >= SIDE_ROWS).astype(float)
    broken = np.column_stack([1 - late, late, (1 - late) * t, late * t, t * t / 2])
    smooth = np.column_stack([np.ones_like(t), t, t * t, t**3])
    (numbers, left), (_, rest) = (_solved(basis, x) for basis in (broken, smooth))
    gain = (rest - left) / error**2
    before, after = numbers[2], numbers[3]
    turn = after - before
    if gain <= CLEAR or not turn.any():
        return None
    way = turn / np.linalg.norm(turn)
    closing = way @ turn
    since = float(np.clip(way @ (numbers[0] - numbers[1]) / closing, -1, 1))  # where they meet
    since = float(np.clip(since, times[k - 1] - middle, times[k] - middle))
    place = numbers[0] + before * since + numbers[4] * since**2 / 2
    return Jump(place, before + numbers[4] * since, after + numbers[4] * since, numbers[4],
                error, float(gain))  # fmt: skip


def _solved(basis, x):
    numbers = np.linalg.lstsq(basis, x, rcond=None)[0]
    return numbers, float(np.square(x - basis @ numbers).sum())


def _walls(found, extent):
    """Jumps of every wall, by axis and side."""
    groups = {}
    for jump in found:
        turn = jump.after - jump.before
        axis = int(np.argmax(np.abs(turn)))
        side = 1 if turn[axis] > 0 else -1
        kept = -jump.after[axis] / jump.before[axis] if jump.before[axis] else math.inf
        if KEPT[0] <= kept <= KEPT[1]:
            groups.setdefault((axis, side), []).append(jump)
    out = {}
    for (axis, side), own in groups.items():
        levels = np.array([jump.place[axis] for jump in own])
        speed = np.array([abs(jump.before[axis]) for jump in own])
        level = float(np.median(levels))
        # The instant is told to a part of a row; half of all jumps lie near the middle one.
        width = ALIKE * extent + ERRORS * np.array([jump.error for jump in own])
        alike = np.abs(levels - level) <= width
        if alike.sum() >= max(LEAST_JUMPS, len(own) / 2) and speed[alike].any():
            out[axis, side] = [jump for jump, is_in in zip(own, alike, strict=True) if is_in]
    return out


def _proposals(view, groups, extent):
    """All walls together: beside the law as it is, and beside a push across them as well."""
    law, n_dims, walls, names = view.fit.law, view.dataset.n_dims, [], []
    for (axis, side), own in groups.items():
        taken = law.with_constants(dict.fromkeys((*law.names, *names), math.nan))
        mine = [fresh_name(taken, stem) for stem in ("h", "e", "k", "tilt")]
        names += mine
        walls.append(wall_of(mine, axis, side, n_dims, _values(own, axis, side), extent))
    every = [jump for own in groups.values() for jump in own]
    part = view.hypothesis
    for wall in walls:
        part = part + wall
    # All that is left: bodies that bounce are far from where the law would take them.
    gain = max(float(view.left @ view.left) - view.n_left, 0.0)
    gain = max(gain, sum(jump.gain for jump in every))
    text = ", ".join(wall.describe() for wall in walls)
    price = -view.criteria.cause_nats * len(walls)
    rank = sum(len(wall.names) for wall in walls)
    axis = next(iter(groups))[0]
    push = float(np.median([jump.pull[axis] for jump in every]))
    name = fresh_name(law, "c")
    formula = parse_formula(f"{name} * e_{'xyz'[axis]}", dataset_types(view.dataset))
    pushed = part + Forces(ForceLaw((Term(formula),), {name: push}))
    is_moving = np.isfinite(np.array(view.fit.noise.levels))

    def proposal(text, hypothesis, price, rank):
        terms = tuple(probe_terms(view.fit.groups, is_moving))
        strengths = {name: math.nan for term in terms for name in term.formula.constants}
        judged = hypothesis + Forces(ForceLaw(terms, strengths)) if terms else None
        return Proposal(
            "bounce", text, hypothesis, price, gain, rank, kind="wall", judged=judged,
            is_sole=True, patience=PATIENT, is_afresh=True,
        )  # fmt: skip

    out = [proposal(text, part, price, rank)]
    if not any(term.is_declared for term in law.terms):
        more = f"{text} + {to_text(formula)}"
        out.append(proposal(more, pushed, price - view.criteria.cause_nats, rank + 1))
    return tuple(out[::-1])


def _values(own, axis, side):
    """Where the numbers of a wall begin: its place, and what bodies keep across and along it."""
    level = side * float(np.median([jump.place[axis] for jump in own]))
    kept = float(np.median([-jump.after[axis] / jump.before[axis] for jump in own]))
    along = 1.0
    if len(own[0].place) > 1:
        rest = [np.delete(np.stack([j.before, j.after]), axis, axis=1) for j in own]
        size = sum(float(np.square(before).sum()) for before, _ in rest)
        along = sum(float(before @ after) for before, after in rest) / size if size else 1.0
    return level, kept, float(np.clip(along, 0.0, 1.2))
