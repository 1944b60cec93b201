"""Terms whose strength has a period: a pivot that shakes, a field that alternates."""

import numpy as np

from bsp_gp.language.formula import Call, Constant, Number
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.loop.proposers.periods import FAR, Scan, cosine_and_sine, rates_of
from bsp_gp.physics.force import ForceLaw, fresh_name


class Pulsing:
    """Strengths with a period as a proposer: a term times ``1 + a cos(w t) + b sin(w t)``."""

    name = "pulsing"

    def propose(self, view):
        """The family of all terms of the law, each with all rates."""
        rates, law = rates_of(view), view.fit.law
        null, proposals, best = np.zeros(view.moment_draws.shape[1]), [], 0.0
        if not len(rates):
            return Family(self.name, null=null)
        scan = Scan(view, rates, np.column_stack([view.left, view.draws_left]))
        for index, term in view.single_terms:
            if "t" in term.formula.inputs:
                continue
            known = {name: law.constants[name] for name in term.formula.constants}
            kernel = scan.kernel_of(ForceLaw((term,), known))
            rate, gain, even = scan.best(kernel)
            null, best = np.maximum(null, even[:, 1:].max(axis=0)), max(best, even[:, 0].max())
            proposals.append(_proposal(view, index, rates, rate, gain))
        proposals.sort(key=lambda p: -p.promise)
        return Family(
            self.name, tuple(proposals), float(best), 2 if proposals else 0, null,
            n_tried=len(rates) * len(proposals), is_continuum=True,
        )  # fmt: skip


def _proposal(view, index, rates, rate, gain):
    law = view.fit.law
    term = law.terms[index]
    a, b, w = (fresh_name(law, stem) for stem in ("a", "b", "w"))
    angle = Call("mul", Constant(w), view.since(FAR))
    waves = cosine_and_sine((a, b), angle)
    strength = Call("add", Call("add", Number(1.0), waves[0]), waves[1])
    formula = Call("mul", strength, term.formula)
    bounds = {w: (float(rates[0]), float(rates[-1]))}
    if "v_i" in term.formula.inputs:  # a brake may be weaker or stronger; it never drives
        bounds |= dict.fromkeys((a, b), (-1.0, 1.0))
    return Proposal(
        "pulsing", to_text(formula),
        with_term_at(view.hypothesis, index, formula, {a: 0.0, b: 0.0, w: rate}),
        -2 * view.criteria.cause_nats, gain, 3, {w: rate}, bounds,
    )  # fmt: skip
