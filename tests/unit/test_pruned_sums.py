"""Sums of laws that are larger than they need be: terms are left out while that is likelier."""

import numpy as np
import pytest

from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposal import Family, Proposal, with_term, without_term
from tests.throws import GRAVITY, throws

WRONG = "9.0 [m/s^2] * m_i * down"
DRAGS = ("-c1 * normalize(v_i)", "-c2 * v_i", "-c3 * norm(v_i) * v_i")


class Sum:
    """Proposes all of several laws, and nothing smaller."""

    name = "laws"

    def __init__(self, texts):
        self.texts = texts

    def propose(self, view):
        hypothesis, formulas = view.hypothesis, []
        for text in self.texts:
            (term,) = read_law(view.dataset, [text]).terms
            (name,) = term.formula.constants
            hypothesis = with_term(hypothesis, term, {name: 0.0})
            formulas.append(term.formula)
        null = np.zeros(view.moment_draws.shape[1])
        best = Proposal(
            "law", " + ".join(self.texts), hypothesis, -3.0 * len(formulas), 500.0, len(formulas),
            formulas=tuple(formulas),
        )  # fmt: skip
        return Family(self.name, (best,), 500.0, len(formulas), null, n_tried=1)


@pytest.mark.parametrize(
    ("weight", "texts", "left"),
    [(GRAVITY, DRAGS, {"c2"}),
     (WRONG, (DRAGS[1], "c4 * m_i * down"), {"c2", "c4"})],
)  # fmt: skip
def test_terms_that_are_one_too_many_are_left_out_and_others_are_not(weight, texts, left):
    data = throws(n_scenes=6, n_times=30, sigma=0.01, noise=(0.01,))
    (done,) = run_rounds(
        Hypothesis.from_laws(data, [weight]), data, [Sum(texts)],
        rng=np.random.default_rng(0), max_rounds=1,
    )  # fmt: skip
    chosen = done.hypotheses[done.decision.best.id]
    assert set(chosen.law.names) == left
    assert done.decision.is_adopted


def test_a_term_is_taken_out_of_its_part_alone():
    data = throws()
    law = Hypothesis.from_laws(data, [GRAVITY])
    (term,) = read_law(data, [DRAGS[1]]).terms
    more = with_term(law, term, {"c2": 0.1})
    assert without_term(more, term.formula).law == law.law
    both = Hypothesis.from_laws(data, [GRAVITY, DRAGS[1]])
    assert without_term(both, both.law.terms[1].formula).law.terms == law.law.terms
