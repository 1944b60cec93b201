"""Forces between bodies that alternate about nothing: neither a law without time shows, nor a push.

A strength that has a mean is found by that first, and its wave beside it (`pulsing`).
"""

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.language.formula import Call, Constant
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.libraries import asks_series
from bsp_gp.loop.proposers.periods import FAR, Scan, cosine_and_sine, rates_of
from bsp_gp.loop.view import MOST_PAIRS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.search.inner import expanded, sayable

MOST = 3
"""Forms that are proposed."""
SAME = 1e-6
"""Part of a gain within which two forms are one on these data."""


class Alternating:
    """Pair forces of a grammar times a cosine and a sine of one rate, as a proposer.

    Parameters
    ----------
    laws : Laws
        Whose grammar and properties they are of.
    dataset : Dataset
        Training scenes.
    """

    name = "alternating"

    def __init__(self, laws, dataset):
        table, types = laws.grammar.inside, dataset_types(dataset)
        texts = [e for text in table.get("alternating", ())
                 for e in expanded(text, {**table, "0": laws.properties})]  # fmt: skip
        forms = (form for _, form in sayable(texts, types, dataset.units, laws.available))
        self.forms = {form: float(np.log(len(texts))) for form in forms}

    def propose(self, view):
        """The family of all forms, where bodies move beside others and no law explains them."""
        nothing = Family(self.name, null=np.zeros(view.moment_draws.shape[1]))
        if view.fit.law.terms or not 0 < view.n_pairs <= MOST_PAIRS or not asks_series(view):
            return nothing
        rates = rates_of(view)
        if not len(rates) or view.is_sky:
            return nothing
        scan, found = Scan(view, rates, np.column_stack([view.left, view.draws_left])), []
        for form, nats in self.forms.items():
            try:
                kernel = scan.kernel_of(ForceLaw((Term(form, "pair"),), {}))
            except EvaluationError:
                continue
            rate, gain, even = scan.best(kernel)
            found.append((rate, gain, form, nats, even))
        if not found:
            return nothing
        null = np.max([even[:, 1:].max(axis=0) for *_, even in found], axis=0)
        best = max(float(even[:, 0].max()) for *_, even in found)
        distinct = []
        for rate, gain, form, nats, _ in sorted(found, key=lambda one: -(0.5 * one[1] - one[3])):
            if all(abs(gain - other) > SAME * gain for _, other, *_ in distinct):
                distinct.append((rate, gain, form, nats))
        return Family(
            self.name, tuple(_proposal(view, rates, *each) for each in distinct[:MOST]), best, 2,
            null, n_tried=len(rates) * len(found), is_continuum=True,
        )  # fmt: skip


def _proposal(view, rates, rate, gain, form, nats):
    """The form times a wave about nothing."""
    a, b, w = (fresh_name(view.fit.law, stem) for stem in ("a", "b", "w"))
    angle = Call("mul", Constant(w), view.since(FAR))
    formula = Call("mul", Call("add", *cosine_and_sine((a, b), angle)), form)
    law = ForceLaw((Term(formula, "pair"),), {a: np.nan, b: np.nan, w: rate})
    return Proposal(
        "law", to_text(formula), view.hypothesis + Forces(law),
        -2 * view.criteria.cause_nats - nats, float(gain), 3, {w: rate},
        {w: (float(rates[0]), float(rates[-1]))}, formulas=(formula,), n_dims=view.dataset.n_dims,
        is_wide=True,
    )  # fmt: skip
