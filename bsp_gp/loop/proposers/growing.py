"""Strengths that grow or fade steadily: a mass that is lost, a battery that runs down."""

import math

import numpy as np

from bsp_gp.language.formula import Call, Constant, Number
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.physics.force import ForceLaw, Term, fresh_name

NEAR = 0.01
"""Part of the span of the times within which their zero is the first row."""
MOST = 5.0
"""Times its strength by which a term may have grown at the end."""
LEFT = 0.02
"""Of what it is divided by, or of its strength, that is left at the end at the least."""


class Growing:
    """A term times ``1 + r t`` or ``exp(r t)``; or by the first, as where mass is lost."""

    name = "growing"

    def propose(self, view):
        """The family of all terms of the law."""
        law, proposals, null = view.fit.law, [], np.zeros(view.moment_draws.shape[1])
        begin = min(float(scene.times[0]) for scene in view.dataset.scenes)
        span = max(float(scene.times[-1]) for scene in view.dataset.scenes) - begin
        since = view.since(NEAR)
        best = 0.0
        for index, term in view.single_terms:
            if "t" in term.formula.inputs:
                continue
            known = {name: law.constants[name] for name in term.formula.constants}
            changed = Term(Call("mul", since, term.formula), term.kind)
            column = view.response.moments_of(ForceLaw((changed,), known))[:, None]
            score = view.score_forces(column)
            if not score.rank:
                continue
            null = np.maximum(null, view.null_forces(column))
            best = max(best, score.statistic)
            proposals += _proposals(view, index, since, span, score)
        proposals.sort(key=lambda p: -p.promise)
        rank = 1 if proposals else 0
        return Family(self.name, tuple(proposals), best, rank, null, n_tried=len(proposals))


def _proposals(view, index, since, span, score):
    """The term grows evenly or by itself, or is divided by what does: to first order all one."""
    law, rate = view.fit.law, float(score.amplitudes[0])
    name = fresh_name(law, "r")
    change = Call("mul", Constant(name), since)
    growth = Call("add", Number(1.0), change)
    term = law.terms[index].formula
    even, whole = ((LEFT - 1) / span, MOST / span), (math.log(LEFT) / span, math.log(MOST) / span)
    for formula, start, (low, high) in (
        (Call("mul", growth, term), rate, even), (Call("div", term, growth), -rate, even),
        (Call("mul", Call("exp", change), term), rate, whole),
    ):  # fmt: skip
        yield Proposal(
            "growing", to_text(formula), with_term_at(view.hypothesis, index, formula, {name: 0.0}),
            -view.criteria.cause_nats, score.statistic,
            starts={name: float(np.clip(start, low / 2, high / 2))}, bounds={name: (low, high)},
        )  # fmt: skip
