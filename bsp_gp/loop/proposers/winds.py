"""A medium that moves: a declared drag acts against a wind or a current, not against what rests.

So does friction of constant size on a belt or a table that moves under the bodies.

Where all forces depend on velocities alone a camera that drifts looks the same, and is told too.
"""

import itertools
from typing import NamedTuple

import numpy as np

from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, Input, Number, factors, substitute
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.loop.view import orthonormal
from bsp_gp.physics.force import ForceLaw, Term, fresh_name, split_linear

_VELOCITY = Input("v_i", STATE_INPUTS["v_i"])
_AXES = "xyz"
_TOLD = {"wind": ("medium", "drag"), "belt": ("ground", "friction")}
COUNTS = {1: 41, 2: 21, 3: 9}
"""Velocities of a ground that are tried along each axis, by the number of these."""
BEYOND, SLOWLY = 0.1, 0.15
"""How far beyond the velocities of the bodies, in parts of their range; the part of all that in
which a second look is closer."""
SOFT = 0.1
"""Part of the root mean square of the speed below which friction that is tried fades."""
SAME = 1e-6
"""By how much directions of moments that are one may differ."""
REFINED, MOST_REFINED = 4, 6
"""How often the step from one velocity to the next is halved, and about how many of the best."""


class Winds:
    """The velocity of the medium, and of the ground, as constants in all declared brakes."""

    name = "winds"

    def propose(self, view):
        """One cause where drag was declared, and one where friction of constant size was."""
        terms = [(k, t) for k, t in view.single_terms if t.is_declared]
        drags = [(k, t) for k, t in terms if _is_drag(t.formula)]
        rubs = [(k, t) for k, t in terms if _is_friction(t.formula)]
        found = [f(view, own) for f, own in ((self._wind, drags), (self._belt, rubs)) if own]
        found = [(proposal, gain, null) for proposal, gain, null in found if proposal]
        if not found:
            return Family(self.name, n_tried=len(drags) + len(rubs))
        proposals, gains, nulls = zip(*found, strict=True)
        ranked = tuple(sorted(proposals, key=lambda p: -p.promise))
        return Family(
            self.name, ranked, max(gains), 2, np.max(nulls, axis=0), is_continuum=bool(rubs),
            n_tried=len(found),
        )  # fmt: skip

    def _wind(self, view, drags):
        """The cause of a weak wind, its gain, and those on noise; None where it shows nothing."""
        names, blown = _against(view, drags, "wind")
        columns = self._columns(view, [term for _, term in blown], names)
        score = view.score_forces(columns)
        if not score.rank:
            return None, 0.0, None
        starts = dict(zip(names, map(float, score.amplitudes), strict=True))
        proposal = _proposal(view, "wind", blown, names, starts, score.statistic, score.rank)
        gain = float(as_pair(score.statistic, score.rank))
        return proposal, gain, as_pair(view.null_forces(columns), score.rank)

    def _belt(self, view, rubs):
        """The cause of a ground that moves, at the velocity of all tried that suits best.

        Friction turns round where a body is as fast as the ground: of a weak velocity it shows
        little, so that velocities are tried through the range of those of the bodies.
        """
        names, blown = _against(view, rubs, "ground")
        scan = _Scan(view, rubs, blown, names)
        null, tried = np.zeros(view.moment_draws.shape[1]), []
        for at, step in _velocities(view):
            gain, size, column = scan.at(at)
            if np.isfinite(gain):
                null = np.maximum(null, as_pair(view.null_forces(column[:, None]), 1))
                tried.append(_Tried(gain, size, at, step))
        if not tried:
            return None, 0.0, None
        tried.sort(key=lambda each: -each.gain)
        near = [_refined(scan, each) for each in tried[:MOST_REFINED]]
        best = max(near, key=lambda each: each.gain)
        starts = dict(zip(names, map(float, best.at), strict=True))
        starts |= dict.fromkeys(scan.known, best.size)
        gain = max(best.gain, 0.0)
        proposal = _proposal(view, "belt", blown, names, starts, gain, len(names))
        return proposal, float(as_pair(gain, len(names))), null

    @staticmethod
    def _columns(view, terms, names):
        """Moments of what the terms change by each component of a weak wind, (n, d)."""
        columns = 0.0
        for term in terms:
            known = {n: view.fit.law.constants.get(n, 0.0) for n in term.formula.constants}
            slopes = view.response.regression.gradient(ForceLaw((term,), known), term)
            columns = columns + np.stack([slopes[name] for name in names], axis=1)
        return columns


def _against(view, terms, stem):
    """Names of the components of a velocity, and the terms with their motion past it.

    Along axes on which something moves: nothing is told of others.
    """
    names, past = past_medium(view, _moving(view), stem)
    past = {_VELOCITY: past}
    return names, [(k, Term(substitute(t.formula, past), t.kind)) for k, t in terms]


def past_medium(view, axes, stem):
    """Names of the components of a velocity along some axes, and the velocity of a body past it."""
    names, medium = [], None
    for axis in axes:
        names.append(fresh_name(view.fit.law, f"{stem}_{axis}"))
        part = Call("mul", Constant(names[-1]), Input(f"e_{axis}", STATE_INPUTS[f"e_{axis}"]))
        medium = part if medium is None else Call("add", medium, part)
    return names, Call("sub", _VELOCITY, medium)


def _moving(view):
    """Names of the axes along which something is seen to move."""
    return [_AXES[k] for k in np.flatnonzero(np.isfinite(view.fit.noise.levels))]


def _proposal(view, code, blown, names, starts, gain, rank):
    """The hypothesis with the motion of some terms past what moves."""
    hypothesis = view.hypothesis
    for k, term in blown:
        hypothesis = with_term_at(hypothesis, k, term.formula, dict.fromkeys(names, 0.0))
    medium = " + ".join(f"{n} * e_{a}" for n, a in zip(names, _moving(view), strict=True))
    what, where = _TOLD[code]
    return Proposal(
        code, f"the {what} moves: v_i - ({medium}) for v_i in {where}",
        hypothesis, -view.criteria.cause_nats, gain, rank, starts=starts,
    )  # fmt: skip


class _Tried(NamedTuple):
    """A velocity of the ground: what it gains, the constant in front, itself, and the step."""

    gain: float
    size: float
    at: np.ndarray
    step: np.ndarray


class _Scan:
    """What is explained by friction on a ground of some velocity, in the place of that declared.

    Where there is one friction its constant in front, `known`, is found anew at every velocity.
    """

    def __init__(self, view, rubs, blown, names):
        own = split_linear(rubs[0][1].formula)[0] if len(rubs) == 1 else None
        self.view, self.names, self.known = view, names, {own: 1.0} if own else {}
        self.terms = tuple(_softened(view, term) for _, term in blown)
        declared = self._moments(self.terms, dict.fromkeys(names, 0.0))
        target, columns = view.response.left()
        own = self._moments(tuple(term for _, term in rubs), self.known)
        size = np.linalg.norm(columns, axis=0) * np.linalg.norm(own)
        beside = np.abs(own @ columns) < (1 - SAME) * size
        self.taken = orthonormal(columns[:, beside] if self.known else columns, len(target))
        self.target = self._beside(target + declared)
        self.least = float(view.left @ view.left)

    def _moments(self, terms, values):
        """Moments of terms under some values, and constants of the law where these lack, (n,)."""
        law = ForceLaw(terms, {})
        known = {n: values.get(n, self.view.fit.law.constants.get(n)) for n in law.names}
        return self.view.response.moments_of(ForceLaw(terms, known))

    def _beside(self, moments):
        return moments - self.taken @ (self.taken.T @ moments)

    def at(self, velocity):
        """Chi-squared gained, the constant in front, and moments for a unit of that, (n,)."""
        values = dict(zip(self.names, map(float, velocity), strict=True))
        column = self._moments(self.terms, self.known | values)
        own = self._beside(column)
        length = float(own @ own)
        if not length > 0:
            return np.nan, 1.0, column
        size = float(own @ self.target) / length if self.known else 1.0
        return self.least - float(np.square(self.target - size * own).sum()), size, column


def _softened(view, term):
    """Friction that fades where a body is nearly as fast as the ground.

    Which way it acts there is told by the noise alone.
    """
    (way,) = [part for part in factors(term.formula)[0] if "v_i" in part.inputs]
    unit = STATE_INPUTS["v_i"].unit
    speed = np.sqrt(np.square(velocities_seen(view)).sum(axis=1).mean())
    least = Number(float(SOFT * speed), unit)
    size = Call("add", Call("square", Call("norm", way.args[0])), Call("square", least))
    soft = Call("div", way.args[0], Call("sqrt", size))
    return Term(substitute(term.formula, {way: soft}), term.kind)


def velocities_seen(view):
    """Velocities of the bodies at the instants at which forces are asked, (n, d)."""
    batches = view.response.regression.batches
    own = (b.velocities[:, :, b.bodies.receivers][b.valid.any(axis=-1)] for b in batches)
    return np.concatenate(list(own))


def _velocities(view):
    """Velocities that a ground may have, and the steps (d,) from one to the next.

    They go through the range of those of the bodies and somewhat beyond, and closer about rest.
    """
    seen = velocities_seen(view)[:, np.isfinite(view.fit.noise.levels)]
    low, high = seen.min(axis=0), seen.max(axis=0)
    count, more = COUNTS[seen.shape[1]], BEYOND * (high - low)
    for part in (1.0, SLOWLY):
        ends = part * (low - more), part * (high + more)
        axes = [np.linspace(a, b, count if b > a else 1) for a, b in zip(*ends, strict=True)]
        step = (ends[1] - ends[0]) / (count - 1)
        for at in itertools.product(*axes):
            yield np.array(at), step


def _refined(scan, best):
    """The best velocity to a part of the way from one that was tried to the next."""
    step = best.step
    for _ in range(REFINED):
        step, middle = 0.5 * step, best.at
        for shift in itertools.product(*((-1, 0, 1) if each else (0,) for each in step)):
            there = middle + step * shift
            gain, size, _ = scan.at(there)
            if gain > best.gain:
                best = _Tried(gain, size, there, step)
    return best


def _is_friction(formula):
    """Whether a term is a friction of constant size against the velocity."""
    above, below = factors(formula)
    moving = [part for part in (*above, *below) if "v_i" in part.inputs]
    return moving == [Call("normalize", _VELOCITY)] and "v_j" not in formula.inputs


def _is_drag(formula):
    """Whether a term brakes the more the faster a body is; friction of constant size does not."""
    above, below = factors(formula)
    if below or "v_j" in formula.inputs:
        return False
    sizes = [part for part in above if "v_i" in part.inputs]
    return _VELOCITY in sizes or any(part.type.shape == "scalar" for part in sizes)
