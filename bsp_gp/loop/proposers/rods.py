"""Constraints that tracks betray: a distance, a line, curve or plane that stays what it is."""

import math
from dataclasses import dataclass, replace
from string import ascii_lowercase

import numpy as np
from scipy.optimize import least_squares

from bsp_gp.errors import LawError
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.parts.constraints import read_constraint
from bsp_gp.fitting.periodogram import swing_of
from bsp_gp.fitting.probes import probe_terms
from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.loop.proposers.swings import LEAST_DRAG, decay_of, usual_mass
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.force import ForceLaw, Term, fresh_name

CONSTANT = 3.0
"""Deviations of a constant quantity, in those that its changes from row to row tell of noise."""
NEARLY = 0.01
"""Part of the way of a body that swings up to which its distance from a point is about constant:
bobs leave their plane, and cameras look aslant."""
STEEP = 20.0
"""Slope of a curve from which it is one of the other coordinate."""
ARC = 30.0
"""Deviations from a line from which an arc that does not come back is one about a point."""
BENT = 3.0
"""Deviations from a line, in the same, from which a track is one about a point."""
CLOSER = 0.9
"""Part of what a circle leaves below which another curve follows a track better: a piece of a
circle is nearly a parabola, and strings are commoner than rails of that form."""
MOVED = 10.0
"""The same of the way between two bodies that have moved about each other."""
UNEVEN = 0.2
"""Standard deviation of a speed, in its mean, that no round orbit has."""
MISFIT = 9.0
"""Mean square of what the law leaves, in the same, from which bodies may be held."""
MOST = 0.7
"""Part of all misfit that must be of bodies on rods, if nothing else is to be looked at first."""
CURVED, WRITTEN = tuple(range(2, 13)), 4
"""Degrees of curves along which bodies may go, and the highest that is written in powers of a
place; beyond, in powers of the way from the middle of the track in its half width."""
COMES_BACK = 0.5
"""Part of the way along a curve that a body must come back."""
NARROW, DIPS = 0.05, 0.5
"""Part of the extent of a track within which it keeps to a curve; part of its rows where this bends
upwards, if it is in a dip."""
LEANING = 0.1
"""Part of the greatest component of a weight from which another one is asked for."""
LEAST_ROWS = 12
EXACT = 1e-7
"""Part of the extent below which deviations are rounding."""
MOST_BODIES = 12
"""That may be tied to one another; of more some two always are about as far apart."""


@dataclass(frozen=True)
class _Kept:
    """A quantity that stays constant, as the constraint `text` with places for names says.

    `level` is that of the noise, told by changes from row to row, and `spread` that of places about
    a curve, metres. `is_sole`: nothing else would keep the quantity; an orbit may be round, at an
    even speed. `normal` is across a line or plane; `way` is whither a weight pulls that keeps the
    body swinging.
    """

    code: str
    text: str
    pair: tuple
    stems: tuple
    values: tuple
    level: float
    is_sole: bool = False
    normal: tuple | None = None
    spread: float = 0.0
    way: tuple = ()


class Rods:
    """Constraints as a proposer."""

    name = "constraints"
    is_structural = True

    def propose(self, view):
        """The family of all distances and lines of bodies that are not held already."""
        if view.is_sky:  # no rod is as long: an orbit of small eccentricity is a circle
            return Family(self.name)
        pairs = [pair for part in constraints_of(view.fit.law) for pair in part.pairs]
        held = {name for pair in pairs for name in pair}
        tracks = _tracks(view.dataset)
        names = dict.fromkeys(s.names[k] for s in view.dataset.scenes for k in s.dynamic)
        free = [name for name in names if name in tracks and name not in held]
        found = [_alone(name, tracks[name], view.dataset.up or "") for name in free]
        others = free if len(free) <= MOST_BODIES else []
        still = [name for name in tracks if name not in names]
        found += [
            _together(one, other, tracks)
            for k, one in enumerate(free) for other in (*others[k + 1 :], *still)
        ]  # fmt: skip
        found = [kept for kept in found if kept is not None]
        every = {name for kept in found if kept.normal is None for name in kept.pair}
        proposals = [p for kept in found for p in (_proposal(view, kept, every, len(found)),) if p]
        proposals.sort(key=lambda p: -p.promise)
        best = max(proposals, key=lambda p: p.gain, default=None)
        return Family(
            self.name, tuple(proposals), best.gain if best else 0.0, best.rank if best else 0,
            np.zeros(1), n_tried=len(found),
        )  # fmt: skip


def _tracks(dataset):
    """Seen places of every body, one array (T, d) per scene, nan where it is not seen."""
    out = {}
    for scene in dataset.scenes:
        for k, name in enumerate(scene.names):
            out.setdefault(name, {})[scene.name] = scene.positions[:, k]
    return out


def _alone(name, tracks, up=""):
    """The line or curve along which, or the point about which a body moves; or None.

    Parameters
    ----------
    tracks : dict of str to ndarray, shape (T, d)
        By scene.
    up : str
        The declared vertical, ``"y"`` or ``"-y"``; none = not declared.
    """
    places = np.concatenate(list(tracks.values()))
    seen = np.isfinite(places).all(axis=1)
    if seen.sum() < LEAST_ROWS:
        return None
    middle = places[seen].mean(axis=0)
    axes = np.linalg.svd(places[seen] - middle, full_matrices=False)[2]
    line = {key: (p - middle) @ axes[-1] for key, p in tracks.items()}
    bend, level = deviation(line)
    if _is_constant(bend, level, places[seen]):
        names = "xyz"[: len(middle)]
        text = " + ".join(f"{axes[-1][k]:.6g} * {x}_i" for k, x in enumerate(names)) + " = {0}"
        values = (float(middle @ axes[-1]),)
        return _Kept("wire", text, (name, ""), ("b",), values, level, normal=tuple(axes[-1]))
    curve = _along_a_curve(name, tracks, up) if len(middle) == 2 else None
    centre, radius = _sphere(places[seen])
    spread, level = deviation({k: np.linalg.norm(p - centre, axis=1) for k, p in tracks.items()})
    if not _swings(tracks, axes[0]) and bend < ARC * level:
        return None  # of a track that is thrown, noise makes an arc
    is_about = spread <= NEARLY * np.ptp(places[seen], axis=0).max() and _swings(tracks, axes[0])
    is_about &= spread < CLOSER * bend  # a circle that follows a track as a line does is none
    if bend < BENT * level or not (is_about or _is_constant(spread, level, places[seen])):
        return curve if bend > BENT * level else None
    stems = tuple(f"pivot_{axis}" for axis in "xyz"[: len(centre)])
    point = ", ".join(f"{{{k}}}" for k in range(len(centre)))
    text = f"norm(p_i - ({point})) = {{{len(centre)}}}"
    values = (*centre.tolist(), radius)
    rod = _Kept("rod", text, (name, ""), (*stems, "L"), values, level, _is_uneven(tracks),
                way=tuple((middle - centre).tolist()))  # fmt: skip
    is_better = curve is not None and curve.spread < CLOSER * spread
    return curve if is_better else rod


def _swings(tracks, axis):
    """Whether a body comes back along a direction, as what is thrown does not."""
    rows = [p[np.isfinite(p).all(axis=1)] @ axis for p in tracks.values()]
    return any(len(own) > 1 and _gone_back(own) > COMES_BACK * np.ptp(own) for own in rows)


def _along_a_curve(name, tracks, up):
    """The curve in a plane, one coordinate as a polynomial of the other, that a body goes along.

    None where there is none, and where nothing comes back along it: what is thrown flies along a
    parabola as well. It does not fly through a dip.
    """
    for of, along in ((1, 0), (0, 1)):
        rows = [p[np.isfinite(p).all(axis=1)] for p in tracks.values()]
        places = np.concatenate(rows)
        swept = float(np.ptp(places[:, along]))
        back = max(_gone_back(own[:, along]) for own in rows if len(own) > 1)
        comes_back, may_dip = back > COMES_BACK * swept, up[-1:] == "xy"[of]
        extent = float(np.ptp(places, axis=0).max())
        found = []  # (spread beside the numbers of the curve, spread, level, curve)
        for degree in CURVED if comes_back or may_dip else ():
            if 2 * (degree + 1) > len(places):
                break
            curve = np.polynomial.Polynomial.fit(places[:, along], places[:, of], degree)
            slope = curve.deriv()
            if np.abs(slope(places[:, along])).max() > STEEP:
                break
            left = {
                key: (p[:, of] - curve(p[:, along])) / np.hypot(1.0, slope(p[:, along]))
                for key, p in tracks.items()
            }
            spread, level = deviation(left)
            lift = slope.deriv()(places[:, along]) * (-1 if up.startswith("-") else 1)
            is_held = comes_back or np.mean(lift > 0) > DIPS
            is_narrow = spread < NARROW * extent
            if is_held and is_narrow and _is_constant(spread, level, places):
                beside = spread / math.sqrt(1 - (degree + 1) / len(places))
                found.append((beside, spread, level, curve))
        if found:  # the simplest of those that follow the track about as well as any
            most = max(min(one[0] for one in found) / CLOSER, EXACT * extent)
            return _kept_curve(name, of, *next(one for one in found if one[0] <= most)[1:])
    return None


def _kept_curve(name, of, spread, level, curve):
    """A body that is kept to a curve of one coordinate, a polynomial of the other."""
    place, plain, degree = f"{'yx'[of]}_i", curve.convert(), curve.degree()
    if degree > WRITTEN:
        low, high = curve.domain.tolist()
        middle, half = (float(f"{n:.4g}") for n in ((low + high) / 2, (high - low) / 2))
        place = f"(({place} - {middle!r} [m]) / ({half!r} [m]))"
        plain = curve.convert(domain=(middle - half, middle + half))
    terms = ["{0}", f"{{1}} * {place}", *(f"{{{k}}} * {place}^{k}" for k in range(2, degree + 1))]
    stems = tuple(f"rail_{k}" for k in ascii_lowercase[: degree + 1])
    return _Kept(
        "wire", f"{'xy'[of]}_i = " + " + ".join(terms), (name, ""), stems,
        tuple(plain.coef.tolist()), level, True, spread=spread,
        way=tuple(float(k == of) for k in (0, 1)),
    )  # fmt: skip


def _gone_back(places):
    """How far a coordinate comes back from the farthest that it had reached, on either side."""
    ways = (places, -places)
    return min(float((np.maximum.accumulate(way) - way).max()) for way in ways)


def _together(one, other, tracks):
    """The distance of two bodies, if it stays constant."""
    shared = [key for key in tracks[one] if key in tracks[other]]
    if not shared:
        return None
    gaps = {key: np.linalg.norm(tracks[one][key] - tracks[other][key], axis=1) for key in shared}
    moves = np.concatenate([tracks[one][key] - tracks[other][key] for key in shared])
    moves = moves[np.isfinite(moves).all(axis=1)]
    if len(moves) < LEAST_ROWS:
        return None
    spread, level = deviation(gaps)
    if np.ptp(moves, axis=0).max() < MOVED * level or not _is_constant(spread, level, moves):
        return None
    ways = {key: tracks[one][key] - tracks[other][key] for key in shared}
    values = (float(np.linalg.norm(moves, axis=1).mean()),)
    return _Kept(
        "rod", "norm(p_i - p_j) = {0}", (one, other), ("L",), values, level, _is_uneven(ways)
    )


def _sphere(places):
    """Centre and radius of the circle or sphere that places lie on best."""
    matrix = np.column_stack([2 * places, np.ones(len(places))])
    start = np.linalg.lstsq(matrix, np.square(places).sum(axis=1), rcond=None)[0][:-1]

    def left(centre):
        distance = np.linalg.norm(places - centre, axis=1)
        return distance - distance.mean()

    centre = least_squares(left, start).x
    return centre, float(np.linalg.norm(places - centre, axis=1).mean())


def deviation(series):
    """Root mean square of deviations from the mean, and what noise makes of it."""
    rows = [values[np.isfinite(values)] for values in series.values()]
    mean = np.concatenate(rows).mean()
    spread = np.sqrt(np.mean(np.square(np.concatenate(rows) - mean)))
    steps = np.concatenate([np.diff(values, 3) for values in rows])
    level = np.sqrt(np.mean(np.square(steps)) / 20) if len(steps) else spread
    return float(spread), float(level)


def _is_constant(spread, level, places):
    return spread <= max(CONSTANT * level, EXACT * float(np.ptp(places, axis=0).max()))


def _proposal(view, kept, every, n_tried):
    """The constraint beside the law; None where the law leaves nothing that it could explain."""
    fit = view.fit
    names = [fresh_name(fit.law, stem) for stem in kept.stems]
    # Where nothing moves along some axis, that needs no wire.
    if not np.isfinite(np.array(fit.noise.levels)).all():
        return None
    level = max(kept.level * _unseen(fit.noise, view.step), float(np.max(fit.noise.lowest)))
    gain, n_rows = _misfit(fit, kept, level)
    if gain < (MISFIT - 1) * n_rows:
        return None
    try:
        numbers = dict(zip(names, kept.values, strict=True))
        part = read_constraint(view.dataset, kept.text.format(*names), (kept.pair,), numbers)
    except LawError:  # masses that a rod would need are not known
        return None
    pushes, braked, starts = _pushes(view, kept)
    log_prior = -view.criteria.cause_nats * (1 + len(pushes)) - math.log(n_tried)
    text = kept.text.format(*(f"{value:.4g}" for value in kept.values))
    for letter, name in zip("ij", kept.pair, strict=True):
        text = text.replace(f"_{letter}", f"_{name}") if name else text
    is_sole = kept.is_sole and _share(fit, every) > MOST
    hypothesis = _under(view.hypothesis + part, pushes, starts)
    proposal = Proposal(
        kept.code, text, hypothesis, log_prior, gain, len(names) + len(pushes), kind="constraint",
        judged=beside_probes(fit, hypothesis), error=level, is_sole=is_sole, patience=PATIENT,
        is_afresh=True, is_alike=bool(kept.way) and not (kept.is_sole or fit.law.terms),
    )  # fmt: skip
    if not braked:
        return proposal
    # What is slowed down on its way over the top is not followed without that.
    other = replace(
        proposal, hypothesis=_under(hypothesis, braked, starts), rank=proposal.rank + len(braked),
        log_prior=log_prior - view.criteria.cause_nats,
    )  # fmt: skip
    return replace(proposal, instead=other)


def _under(hypothesis, terms, starts):
    """A hypothesis with forces, of unknown strengths where no start is known."""
    if not terms:
        return hypothesis
    names = [name for term in terms for name in term.formula.constants]
    strengths = {name: starts.get(name, math.nan) for name in names}
    return hypothesis + Forces(ForceLaw(terms, strengths))


def _pushes(view, kept):
    """The weight that keeps a held body swinging, where no force at all is known, and a drag.

    And what they begin with, by the rate of the swing and how it fades: whole tracks that begin out
    of step do not find it.
    """
    if view.fit.law.terms or not (kept.is_sole and kept.way):
        return (), (), {}
    law, terms, most = view.fit.law, [], max(map(abs, kept.way))
    mass, rate = usual_mass(view.dataset.scenes, kept.pair[0]), 0.0
    if kept.code == "rod" and most > 0:
        rate = swing_of(view.fit, body=kept.pair[0])
    pull, starts = mass * rate**2 * kept.values[-1] / (math.hypot(*kept.way) or 1.0), {}
    types = dataset_types(view.dataset)
    for axis, along in enumerate(kept.way):
        if abs(along) > LEANING * most:
            name = fresh_name(law, "c")
            push = Call("mul", Constant(name), coordinate_of(types, axis)[1])
            terms.append(Term(push, "field"))
            starts |= {name: pull * along} if rate else {}
            law = law.plus(terms[-1], {name: math.nan})
    name = fresh_name(law, "c")
    drag = Call("mul", Constant(name), Input("v_i", STATE_INPUTS["v_i"]))
    starts |= {name: -mass * max(decay_of(view.fit), LEAST_DRAG * rate)} if rate else {}
    return tuple(terms), (Term(drag, "field"),), starts


def beside_probes(fit, hypothesis):
    """A hypothesis that holds bodies beside forces that know no physics; None without such."""
    is_moving = np.isfinite(np.array(fit.noise.levels))
    terms = tuple(probe_terms(fit.groups, is_moving, is_held=True))
    strengths = {name: math.nan for term in terms for name in term.formula.constants}
    return hypothesis + Forces(ForceLaw(terms, strengths)) if terms else None


def _unseen(noise, step):
    """How much larger errors are than their changes from row to row tell, if they have a memory."""
    if not noise.correlated:
        return 1.0
    lags = noise.correlated * np.exp(-np.arange(1, 4) * step / noise.correlation_time)
    return math.sqrt(20 / (20 + lags @ [-30, 12, -2]))  # third differences


def _misfit(fit, kept, level):
    """Chi-squared that the constraint may take away, in errors of its own, and of how many rows.

    Of the bodies that it holds alone. One that moves along a line is no body on a wire, unless the
    law would have it leave it.
    """
    channels, names = fit.channels, fit.channels.body_names
    if kept.normal is None:
        own = np.isin(channels.body, [k for k, name in enumerate(names) if name in kept.pair])
        seen = channels.seen & own
        # A memory of the noise may have taken up what a motion is: what is left is told without.
        left = float(np.square(fit.residual[seen] / level).sum())
        return left - np.count_nonzero(seen), np.count_nonzero(seen)
    mine = names.index(kept.pair[0])
    across = []
    for chain in np.unique(channels.chain):
        own = (channels.chain == chain) & (channels.body == mine)
        at = [np.flatnonzero(own & (channels.axis == k)) for k in range(len(kept.normal))]
        if all(len(k) for k in at):
            rows = [fit.residual[:, k[0]] for k in at]
            across.append(np.array(kept.normal) @ rows)
    left = np.concatenate(across) / level
    left = left[np.isfinite(left)]
    return float(np.square(left).sum()) - len(left), len(left)


def _share(fit, bodies):
    """Part of all misfit that is of some bodies."""
    own = [k for k, name in enumerate(fit.channels.body_names) if name in bodies]
    square = np.square(fit.whitened).sum(axis=0)
    return float(square[np.isin(fit.channels.body, own)].sum()) / (float(square.sum()) or 1.0)


def _is_uneven(series):
    """Whether a body goes about a point at anything but a constant speed, as an orbit might."""
    seen = (p[np.isfinite(p).all(axis=1)] for p in series.values())
    steps = [np.diff(p, axis=0) for p in seen]
    speed = np.linalg.norm(np.concatenate(steps), axis=1)
    level = np.concatenate([np.diff(own, 2, axis=0) for own in steps])
    noise = 2 * np.square(level).mean() / 20 if len(level) else 0.0  # of a step, along its way
    return bool(max(speed.var() - noise, 0.0) > (UNEVEN * speed.mean()) ** 2)
