"""Constraints that tracks betray: bodies on rods, wires and rails, with what moves them."""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.errors import LawError
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.parts.constraints import read_constraint
from bsp_gp.fitting.parts.latents import Properties
from bsp_gp.fitting.periodogram import swing_of
from bsp_gp.fitting.probes import probe_terms
from bsp_gp.inference.latents import latents_of_bodies
from bsp_gp.inference.priors import Prior
from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.loop.proposers.steady import alone, together, tracks_of
from bsp_gp.loop.proposers.swings import LEAST_DRAG, decay_of, usual_mass
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.force import ForceLaw, Term, fresh_name, fresh_names, numbered
from bsp_gp.physics.masses import are_assumed

MISFIT = 9.0
"""Mean square of what the law leaves, in the same, from which bodies may be held."""
MOST = 0.7
"""Part of all misfit that must be of bodies on rods, if nothing else is to be looked at first."""
LEANING = 0.1
"""Part of the greatest component of a weight from which another one is asked for."""
MOST_BODIES = 12
"""That may be tied to one another; of more some two always are about as far apart."""
HEAVIER = 30.0
"""Times that a body on a rod may be heavier, or lighter, than the one that it hangs from."""


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
        tracks = tracks_of(view.dataset)
        names = dict.fromkeys(s.names[k] for s in view.dataset.scenes for k in s.dynamic)
        free = [name for name in names if name in tracks and name not in held]
        found = [alone(name, tracks[name], view.dataset.up or "") for name in free]
        others = free if len(free) <= MOST_BODIES else []
        still = [name for name in tracks if name not in names]
        found += [
            together(one, other, tracks, other in still)
            for k, one in enumerate(free) for other in (*others[k + 1 :], *still)
        ]  # fmt: skip
        found = [kept for kept in found if kept is not None]
        every = {name for kept in found if kept.normal is None for name in kept.pair}
        proposals = [p for kept in found for p in (_proposal(view, kept, every, len(found)),) if p]
        proposals += filter(None, (_hung(view, own, len(found)) for own in _chains(found, names)))
        proposals.sort(key=lambda p: -p.promise)
        best = max(proposals, key=lambda p: p.gain, default=None)
        return Family(
            self.name, tuple(proposals), best.gain if best else 0.0, best.rank if best else 0,
            np.zeros(1), n_tried=len(found),
        )  # fmt: skip


def _proposal(view, kept, every, n_tried):
    """The constraint beside the law; None where the law leaves nothing that it could explain."""
    fit = view.fit
    # Where nothing moves along some axis, that needs no wire.
    if not np.isfinite(np.array(fit.noise.levels)).all():
        return None
    level = _level(view, kept)
    misfits = _misfits(fit, kept, level)
    if not _is_misfit(misfits):
        return None
    # A rod between two explains of either no more than it can of the other.
    gain = min(gain for gain, _ in misfits)
    names = [fresh_name(fit.law, stem) for stem in kept.stems]
    try:
        part = _part(view.dataset, kept, names)
    except LawError:  # masses that a rod would need are not known
        return None
    pushes, drag, starts = _pushes(view, kept)
    log_prior = -view.criteria.cause_nats * (1 + len(pushes)) - math.log(n_tried)
    text = _text(kept)
    is_sole = kept.is_sole and _share(fit, every) > MOST
    hypothesis = _under(view.hypothesis + part, pushes, starts)
    proposal = Proposal(
        kept.code, text, hypothesis, log_prior, gain, len(names) + len(pushes), kind="constraint",
        judged=beside_probes(fit, hypothesis), error=level, is_sole=is_sole, patience=PATIENT,
        is_afresh=True, is_alike=bool(kept.way) and not (kept.is_sole or fit.law.terms),
    )  # fmt: skip
    return replace(proposal, instead=_slowed(view, proposal, drag, starts)) if drag else proposal


def _slowed(view, proposal, drag, starts=None):
    """The proposal beside a drag: what is slowed down is not followed over the top without it."""
    return replace(
        proposal, hypothesis=_under(proposal.hypothesis, (drag,), starts or {}),
        rank=proposal.rank + 1, log_prior=proposal.log_prior - view.criteria.cause_nats,
    )  # fmt: skip


def _level(view, kept):
    """That of the noise of a quantity, as far as its rows and the fit tell it.

    No more than the quantity itself is off: a memory of the noise may have taken up what a motion
    is, and tells nothing then of how much of the errors rows do not show.
    """
    noise = view.fit.noise
    level = min(kept.level * _unseen(noise, view.step), max(kept.spread, kept.level))
    return max(level, float(np.max(noise.lowest)))


def _part(dataset, kept, names):
    """The constraint with its constants, by their names."""
    numbers = dict(zip(names, kept.values, strict=True))
    return read_constraint(dataset, kept.text.format(*names), (kept.pair,), numbers)


def _text(kept):
    """The constraint as it was seen, with the names of its bodies."""
    text = kept.text.format(*(f"{value:.4g}" for value in kept.values))
    for letter, name in zip("ij", kept.pair, strict=True):
        text = text.replace(f"_{letter}", f"_{name}") if name else text
    return text


# --- bodies that hang from one another ------------------------------------------------------------


def _chains(found, moving):
    """Rods that lead from a point to one body and on to others, a list for every such chain."""
    rods = [kept for kept in found if kept.code == "rod"]
    for first in rods:
        own = [first]
        if first.pair[1] in moving:
            continue
        while True:
            bodies = {name for kept in own for name in kept.pair}
            more = [
                kept for kept in rods
                if kept not in own and set(kept.pair) <= set(moving) and bodies & set(kept.pair)
            ]  # fmt: skip
            if not more:
                break
            own += more
        if len(own) > 1:
            yield own


def _hung(view, chain, n_tried):
    """All rods of a chain with a weight at once: one without the others explains nothing.

    Rods between bodies pass forces on by their masses; where none is known, those of all but the
    first are fitted, in its mass.
    """
    fit, law = view.fit, view.fit.law
    if law.terms or not np.isfinite(np.array(fit.noise.levels)).all():
        return None
    level = min(_level(view, kept) for kept in chain)  # of a place, not of how two are apart
    bodies = dict.fromkeys(name for kept in chain for name in kept.pair)
    misfits = _misfits_of(fit, bodies, level)
    if not _is_misfit(misfits):
        return None
    hypothesis, dataset = view.hypothesis, view.dataset
    if are_assumed(dataset):
        first = chain[0].pair[0]
        masses = _masses(dataset, dict.fromkeys(n for k in chain[1:] for n in k.pair if n != first))
        hypothesis, dataset = hypothesis + masses, masses.seen(dataset)
    taken = set(law.names)
    try:
        for kept in chain:
            names = [numbered(stem, taken) for stem in kept.stems]
            taken |= set(names)
            hypothesis += _part(dataset, kept, names)
    except LawError:
        return None
    types = dataset_types(dataset)
    mass = Input("m_i", types["m_i"])
    pulls = _pulls(law, types, chain[0].way)
    weight = tuple(_force(name, Call("mul", mass, along)) for name, along, _ in pulls)
    taken |= {name for term in weight for name in term.formula.constants}
    drag = _force(numbered("c", taken), Call("mul", mass, Input("v_i", STATE_INPUTS["v_i"])))
    hypothesis = _under(hypothesis, weight, {})
    n_free = len(hypothesis.parameters) - len(view.hypothesis.parameters)
    proposal = Proposal(
        "rods", "; ".join(map(_text, chain)), hypothesis,
        -view.criteria.cause_nats * (len(chain) + 1) - math.log(n_tried),
        sum(gain for gain, _ in misfits), n_free, kind="constraint",
        judged=beside_probes(fit, hypothesis), error=level, is_sole=True, patience=PATIENT,
        is_afresh=True,
    )  # fmt: skip
    return replace(proposal, instead=_slowed(view, proposal, drag))


def _masses(dataset, names):
    """Unknown masses of bodies, in that of another one."""
    prior = Prior("log_uniform", 1 / HEAVIER, HEAVIER)
    unit = dataset.property_units.get("mass")
    return Properties(latents_of_bodies(names, "mass", prior), (("mass", unit),))


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
        return (), None, {}
    mass, rate = usual_mass(view.dataset.scenes, kept.pair[0]), 0.0
    if kept.code == "rod" and any(kept.way):
        rate = swing_of(view.fit, body=kept.pair[0])
    pull = mass * rate**2 * kept.values[-1] / (math.hypot(*kept.way) or 1.0)
    pulls = _pulls(view.fit.law, dataset_types(view.dataset), kept.way)
    terms = [_force(name, along) for name, along, _ in pulls]
    starts = {name: pull * part for name, _, part in pulls} if rate else {}
    name = numbered("c", {*view.fit.law.names, *(one for one, _, _ in pulls)})
    drag = _force(name, Input("v_i", STATE_INPUTS["v_i"]))
    starts |= {name: -mass * max(decay_of(view.fit), LEAST_DRAG * rate)} if rate else {}
    return tuple(terms), drag, starts


def _force(name, along):
    """A force of the strength `name`, that acts on a body by itself."""
    return Term(Call("mul", Constant(name), along), "field")


def _pulls(law, types, way):
    """Of a weight: a constant, a direction and the part of a way along it, for each of its axes."""
    most = max(map(abs, way))
    axes = [axis for axis, along in enumerate(way) if abs(along) > LEANING * most]
    names = fresh_names(law, axes, "c")
    return [(names[axis], coordinate_of(types, axis)[1], way[axis]) for axis in axes]


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


def _is_misfit(misfits):
    """Whether the law leaves much of some bodies: chi-squared and rows of each."""
    return sum(gain for gain, _ in misfits) >= (MISFIT - 1) * sum(n for _, n in misfits)


def _misfits_of(fit, bodies, level):
    """Chi-squared that the law leaves of each of some bodies, in errors of a level, and its rows.

    A memory of the noise may have taken up what a motion is: what is left is told without.
    """
    channels, found = fit.channels, []
    for k, name in enumerate(channels.body_names):
        seen = channels.seen & (channels.body == k)
        if name in bodies and seen.any():
            left, n_rows = fit.residual[seen] / level, np.count_nonzero(seen)
            found.append((float(np.square(left).sum()) - n_rows, n_rows))
    return found


def _misfits(fit, kept, level):
    """The same that a constraint may take away, of the bodies that it holds alone.

    One that moves along a line is no body on a wire, unless the law would have it leave it.
    """
    if kept.normal is None:
        return _misfits_of(fit, kept.pair, level)
    channels = fit.channels
    mine = channels.body_names.index(kept.pair[0])
    across = []
    for chain in np.unique(channels.chain):
        own = (channels.chain == chain) & (channels.body == mine)
        at = [np.flatnonzero(own & (channels.axis == k)) for k in range(len(kept.normal))]
        if all(len(k) for k in at):
            rows = [fit.residual[:, k[0]] for k in at]
            across.append(np.array(kept.normal) @ rows)
    left = np.concatenate(across) / level
    left = left[np.isfinite(left)]
    return [(float(np.square(left).sum()) - len(left), len(left))]


def _share(fit, bodies):
    """Part of all misfit that is of some bodies."""
    own = [k for k, name in enumerate(fit.channels.body_names) if name in bodies]
    square = np.square(fit.whitened).sum(axis=0)
    return float(square[np.isin(fit.channels.body, own)].sum()) / (float(square.sum()) or 1.0)
