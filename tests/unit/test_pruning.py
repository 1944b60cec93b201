"""Backward steps of the loop: what later rounds made needless, what the data never asked for."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.outcome import ConstantEstimate, Effect
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.pruning import prune
from bsp_gp.physics.force import Term
from bsp_gp.report.sentences import adopted_rounds, outcome_sentence
from tests.worlds import WEIGHT, flights, wind


@pytest.fixture(scope="module")
def windy():
    """A report on data with a wind, closed in two rounds."""
    return close_loop(flights(1, wind), [WEIGHT], rng=np.random.default_rng(0))


def adopting(done, name, constants):
    """A round that adopts an effect with these constants."""
    estimates = tuple(ConstantEstimate(c, 1.0, 0.9, 1.1, "N") for c in constants)
    effect = Effect(name, "field", "", "", (), estimates, 0.0)
    return replace(done, effect=effect, adopted=True)


def test_what_a_later_term_made_needless_is_taken_back(windy):
    data = flights(1, wind)
    law = declared_law(data, [WEIGHT])
    observation = observe(data, law, np.random.default_rng(0), sources=False)
    for text in ("c1 * (norm(v_i) * normalize(v_i))", "c2 * e_x"):
        (term,) = declared_law(data, [text]).terms
        law = law.plus(Term(term.formula, term.kind), dict.fromkeys(term.formula.constants, 0.0))
    model = evaluate(observation, law)
    rounds = [adopting(windy.rounds[0], "drag", ["c1"]),
              adopting(windy.rounds[0], "wind", ["c1", "c2"])]  # fmt: skip
    pruned, told = prune(observation, model, rounds, 0.01)
    assert list(pruned.law.names) == ["c2"]
    assert "not needed: BIC falls by" in told[0].removed and not told[1].removed
    assert outcome_sentence(told[0]).startswith("Adopted, and taken back: drag")
    assert adopted_rounds(replace(windy, rounds=tuple(told))) == [told[1]]


def test_what_is_needed_stays(windy):
    assert [done.removed for done in windy.rounds] == ["", ""]
    assert windy.rounds[0].adopted


def nothing(t, p, v, m, q):
    return np.zeros_like(p)


def test_a_declared_term_without_support_is_said():
    report = close_loop(flights(3, nothing), [WEIGHT, "k * v_i"], rng=np.random.default_rng(0))
    (note,) = [n for n in report.notes if "no support" in n]
    assert note.startswith("the declared term k * v_i has no support")
    assert note.endswith("kg/s")
    rng = np.random.default_rng(0)
    needed = close_loop(flights(3, lambda t, p, v, m, q: -0.2 * v), [WEIGHT, "k * v_i"], rng=rng)
    assert not any("support" in n for n in needed.notes)


def test_a_declared_term_of_the_wrong_sign_is_said():
    """Upward gravity, a slip of many users: once, the fit of a clock ran backwards over it."""
    data = flights(3, nothing)
    report = close_loop(data, ["9.81 [m/s^2] * m_i * e_y"], rng=np.random.default_rng(0))
    effect = report.rounds[0].effect
    assert effect.name == "declared number 9.81 [m/s^2]: its sign is wrong"
    assert effect.constants[0].low < -9.81 < effect.constants[0].high
    assert not effect.equivalents and "other sign" in report.rounds[0].reason
