"""Forces that act late: a controller, an eye or a nerve that answers to what was a while ago.

Where a body was is told from where it is, how fast it is, and what the law makes of that, to the
second order of the delay; what the others did, by their velocities, to the first.
"""

import numpy as np

from bsp_gp.language.formula import Call, Constant, Input, Number, substitute
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name

BELIEVED = 0.25
"""Delays that are believed, in the length of the shortest recording."""


class Delayed:
    """Terms of the law that answer to an earlier state, each alone, all, or to others alone."""

    name = "delayed"

    def propose(self, view):
        """The family of all terms that depend on places or velocities."""
        name, proposals = fresh_name(view.fit.law, "delay"), []
        null = np.zeros(view.moment_draws.shape[1])
        span = min(float(np.ptp(scene.times)) for scene in view.dataset.scenes)
        for late in _ways(view, name):
            column = _slope(view, late, name)
            score = view.score_forces(column)
            if not score.rank:
                continue
            null = np.maximum(null, view.null_forces(column))
            if score.amplitudes[0] > 0:  # nothing answers to what is yet to come
                proposals.append(_proposal(view, late, name, score, BELIEVED * span))
        proposals.sort(key=lambda p: -p.promise)
        best = proposals[0].gain if proposals else 0.0
        rank = 1 if proposals else 0
        return Family(self.name, tuple(proposals), best, rank, null, n_tried=len(proposals))


def _ways(view, name):
    """What may be late: lists of the place of a term and the formula that it has then."""
    own, others = (_changed(view, past) for past in (_earlier(view, name), _by_others(name)))
    return [[each] for each in (*own, *others)] + [own] * (len(own) > 1)


def _changed(view, replaced):
    """Places of the terms that other inputs change, and the formulas then."""
    late = ((k, t, substitute(t.formula, replaced)) for k, t in view.single_terms)
    return [(k, formula) for k, term, formula in late if formula != term.formula]


def _earlier(view, name):
    """What stands for the state of all bodies a while ago, by the input."""
    delay, place, velocity = Constant(name), _input("p_i"), _input("v_i")
    past = {_input("p_i"): Call("sub", place, Call("mul", delay, velocity)), **_by_others(name)}
    terms = view.fit.law.terms
    if not terms or any(term.kind == "pair" for term in terms):
        return past  # their sum over all others is no part of a formula
    force = None
    for term in terms:
        force = term.formula if force is None else Call("add", force, term.formula)
    push = Call("div", force, Input("m_i", dataset_types(view.dataset)["m_i"]))
    bend = Call("mul", Call("mul", Number(0.5), Call("square", delay)), push)
    past[_input("p_i")] = Call("add", past[_input("p_i")], bend)
    past[velocity] = Call("sub", velocity, Call("mul", delay, push))
    return past


def _by_others(name):
    """The same for those that a body answers to."""
    return {_input("p_j"): Call("sub", _input("p_j"), Call("mul", Constant(name), _input("v_j")))}


def _input(name):
    return Input(name, STATE_INPUTS[name])


def _slope(view, late, name):
    """Moments of what a small delay changes, a unit of it, (n, 1)."""
    law = view.fit.law
    terms = tuple(Term(formula, law.terms[k].kind) for k, formula in late)
    names = {n for term in terms for n in term.formula.constants}
    known = {n: law.constants.get(n, 0.0) for n in names}
    whole = ForceLaw(terms, known)
    column = np.zeros(len(view.left))
    for term in terms:  # a step of a size, as of a threshold, has no slope
        column = column + view.response.regression.gradient(whole, term).get(name, 0.0)
    return column[:, None]


def _proposal(view, late, name, score, longest):
    hypothesis, law = view.hypothesis, view.fit.law
    for k, formula in late:
        hypothesis = with_term_at(hypothesis, k, formula, {name: 0.0})
    text = " and ".join(to_text(law.terms[k].formula) for k, _ in late)
    start = min(float(score.amplitudes[0]), longest / 2)
    return Proposal(
        "delayed", f"{text}, of what was {name} ago", hypothesis,
        -len(late) * view.criteria.cause_nats, score.statistic,
        starts={name: start}, bounds={name: (0.0, longest)},
    )  # fmt: skip
