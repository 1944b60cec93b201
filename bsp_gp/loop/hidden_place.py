"""Global search for an unseen source, and whether noise alone would have shown one as strong.

Candidate places lie on a grid over the data and, more and more sparsely, far beyond them;
candidate orbits are circles about the body that rules the others. The strength is in closed form,
so that a candidate costs one matrix product. The best, as far as they differ, are refined by least
squares. The same grid searched in simulated noise gives the p-value: choosing the place is part
of the test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.loop.hidden_motion import ORBIT, REST

__all__ = ["Found", "Grid", "Stage", "refine", "search", "survey"]

N_NULL = 199
"""Simulated residuals behind the p-value."""
FARTHEST = 30.0
"""Places are sought up to so many times the size of the data from their middle."""
N_STARTS = 5
ALIKE = 0.9
"""Correlation of responses above which two candidates are one."""
EXACT_ORBIT, NOISY_ORBIT = 1e-6, 1e-3
"""Error of an integrated orbit, as a part of the size of the data."""
RULES = 5.0
"""A body this many times as strong as every other is the centre of orbits."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Where things happen: scales of the search.

    Attributes
    ----------
    middle : ndarray, shape (d,), metres
    size : float
        Greatest distance of a visible body from there, metres.
    speed : float
        Typical speed, m/s.
    centre : int or None
        Number of the body that rules the others.
    normal : ndarray, shape (3,), or None
        Of the plane in which most of the motion about it happens.
    """

    middle: np.ndarray
    size: float
    speed: float
    centre: int | None = None
    normal: np.ndarray | None = None

    @classmethod
    def of(cls, observation, pull, view):
        """Read the scales off the training data."""
        scenes = observation.train
        p = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in scenes])
        p = p[np.isfinite(p).all(axis=1)]
        middle = (p.min(axis=0) + p.max(axis=0)) / 2
        size = float(np.linalg.norm(p - middle, axis=1).max()) or 1.0
        v = np.concatenate([part.velocities.reshape(-1, p.shape[1]) for part in view.parts])
        speed = float(np.sqrt(np.mean(np.square(v).sum(axis=1)))) or 1.0
        values = np.abs([e.properties.get(pull.column, 0.0) for e in scenes[0].entities])
        order = np.argsort(np.nan_to_num(values))
        rules = len(order) > 1 and values[order[-1]] > RULES * values[order[-2]]
        if not rules:
            return cls(middle, size, speed)
        centre = int(order[-1])
        normal = np.zeros(3)
        if p.shape[1] == 3:
            for part in view.parts:
                at = np.nanmean(scenes[0].positions[:, centre], axis=0)
                normal += np.cross(part.positions - at, part.velocities).sum(axis=(0, 1))
            normal /= np.linalg.norm(normal) or 1.0
        return cls(middle, size, speed, centre, normal if normal.any() else None)

    def candidates(self, motion):
        """Parameters to try, (C, k); none for a motion that starts from another's best."""
        if motion.kind == REST:
            return self._places()
        if motion.kind == ORBIT and self.centre is not None:
            return self._orbits(motion)
        return np.zeros((0, motion.n_parameters))

    def _places(self):
        n_dims = len(self.middle)
        if n_dims == 2:
            axis = np.linspace(-1.5, 1.5, 41)
            near = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
            directions = _circle(48)
        else:
            axis = np.linspace(-1.5, 1.5, 13)
            near = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
            directions = _sphere(120)
        radii = np.geomspace(1.5, FARTHEST, 10)
        far = (radii[:, None, None] * directions).reshape(-1, n_dims)
        return self.middle + self.size * np.concatenate([near, far])

    def _orbits(self, motion):
        radii = self.size * np.geomspace(0.05, 5.0, 36)
        circle = _circle(36)
        if len(self.middle) == 2:
            planes = [circle]
        else:
            one = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
            one /= np.linalg.norm(one)
            planes = [circle @ np.stack([one, np.cross(self.normal, one)])]
        offsets = (radii[:, None, None] * planes[0]).reshape(-1, len(self.middle))
        places, velocities = motion.field.circular(self.centre, offsets, self.normal, motion.epoch)
        found = np.concatenate([places, velocities], axis=1)
        if len(self.middle) == 2:  # either sense
            back = np.concatenate([places, 2 * velocities.mean(axis=0) - velocities], axis=1)
            found = np.concatenate([found, back])
        return found


def _circle(n):
    angles = 2 * np.pi * np.arange(n) / n
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _sphere(n):
    """Fibonacci's points on the unit sphere."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


@dataclass(frozen=True, eq=False)
class Found:
    """An unseen source that explains as much as any.

    Attributes
    ----------
    motion : Motion
    parameters : ndarray, shape (k,)
    strength : float
    gain : float
        Fall of the whitened sum of squares.
    """

    motion: object
    parameters: np.ndarray
    strength: float
    gain: float

    @property
    def n_free(self):
        return len(self.parameters) + 1

    def cost(self, view):
        """BIC on the view, less what is the same for all."""
        left = max(view.total - self.gain, 1e-300)
        per_row = left / view.dof
        if view.is_exact:
            per_row = max(per_row, 1.0)
        return view.dof * np.log(per_row) + self.n_free * np.log(view.dof)


@dataclass(frozen=True, eq=False)
class Grid:
    """What the candidates on the grid explain, and what they would explain of noise.

    Attributes
    ----------
    starts : list of (Motion, ndarray)
        Motions with the best candidates (n, k) of each, as far as they differ.
    share : float
        Of the sum of squares, explained by the best candidate.
    null : ndarray, shape (B,)
        The same for simulated noise.
    """

    starts: list
    share: float
    null: np.ndarray

    def p_value(self, share=0.0):
        """Chance that noise alone has a place that explains this share, or the grid's."""
        share = np.maximum(share, self.share)
        # So put that what is not a number is never significant.
        return float((1 + np.sum(~(self.null < share))) / (1 + len(self.null)))


def survey(view, motions, stage, rng, n_null=N_NULL):
    """Try every candidate, on the residual and on noise.

    Parameters
    ----------
    view : View
    motions : list of Motion
    stage : Stage
    rng : numpy.random.Generator
    n_null : int

    Returns
    -------
    Grid
    """
    targets, totals = view.null(rng, n_null)
    share, null, starts = 0.0, np.zeros(n_null), []
    for motion in motions:
        candidates = stage.candidates(motion)
        chosen = np.zeros((0, motion.n_parameters))
        if len(candidates):
            response = view.response(motion, candidates)
            _, gain = view.strengths(response)
            _, by_chance = view.strengths(response, targets)
            share = max(share, float(gain.max()) / view.total)
            null = np.maximum(null, by_chance.max(axis=0) / totals)
            chosen = candidates[_distinct(response, gain)]
        starts.append((motion, chosen))
    return Grid(starts, share, null)


def search(view, grid, stage):
    """Refine the best candidates of a grid.

    Parameters
    ----------
    view : View
    grid : Grid
    stage : Stage

    Returns
    -------
    list of Found
        The best first; empty if no candidate explains anything.
    """
    found = []
    for motion, starts in grid.starts:
        resting = [f.parameters for f in found if f.motion.kind == REST]
        if not len(starts) and resting:
            still = np.zeros(motion.n_parameters - len(resting[0]))
            starts = np.array([np.concatenate([place, still]) for place in resting])
        if len(starts) and motion.kind == ORBIT:
            fine = EXACT_ORBIT if view.is_exact else NOISY_ORBIT
            motion = motion.settled(starts, fine * stage.size)
        refined = [refine(view, motion, start, stage) for start in starts]
        found += _best_of([f for f in refined if f.gain > 0], 3 if motion.kind == REST else 1)
    return sorted(found, key=lambda f: f.cost(view))


def _best_of(found, most):
    """The best few, each place once."""
    out = []
    for f in sorted(found, key=lambda f: -f.gain):
        if len(out) < most and all(
            np.linalg.norm(f.parameters - g.parameters) > 1e-3 * np.linalg.norm(g.parameters)
            for g in out
        ):
            out.append(f)
    return out


def _distinct(response, gain):
    """Best candidates that are unlike one another."""
    size = np.linalg.norm(response, axis=1)
    unit = response / np.where(size > 0, size, 1.0)[:, None]
    chosen = []
    for k in np.argsort(-gain)[:400]:
        if gain[k] > 0 and all(unit[k] @ unit[j] < ALIKE for j in chosen):
            chosen.append(int(k))
        if len(chosen) == N_STARTS:
            break
    return chosen


def scales(motion, stage):
    """Units of the parameters of a motion."""
    place = np.full(motion.n_dims, stage.size)
    if motion.kind == REST:
        return place
    return np.concatenate([place, np.full(motion.n_dims, stage.speed)])


def refine(view, motion, start, stage, max_nfev=40):
    """Least squares over place and velocity, the strength in closed form at every step.

    Returns
    -------
    Found
    """
    from scipy.optimize import least_squares

    unit = scales(motion, stage)
    middle = np.zeros(len(unit))
    middle[: motion.n_dims] = stage.middle / stage.size
    reach = np.full(len(unit), 2 * FARTHEST)

    def left(response):
        strength, _ = view.strengths(response)
        return view.y - strength[:, None] * response

    def residual(x):
        out = left(view.response(motion, x * unit))[0]
        return np.where(np.isfinite(out), out, 1e6)

    def jacobian(x):
        # The grid steps in units of the stage; near a body the pull changes over less.
        step = 1e-5
        moved = np.concatenate([x + step * np.eye(len(x)), x - step * np.eye(len(x))])
        out = left(view.response(motion, moved * unit))
        slopes = (out[: len(x)] - out[len(x) :]) / (2 * step)
        return np.nan_to_num(slopes.T, posinf=0.0, neginf=0.0)

    x0 = np.clip(start / unit, middle - 0.99 * reach, middle + 0.99 * reach)
    solved = least_squares(
        residual, x0, jacobian, bounds=(middle - reach, middle + reach), max_nfev=max_nfev,
        x_scale="jac", ftol=1e-9, xtol=1e-9, gtol=1e-12,
    )  # fmt: skip
    parameters = solved.x * unit
    strength, gain = view.strengths(view.response(motion, parameters))
    return Found(motion, parameters, float(strength[0]), float(gain[0]))
