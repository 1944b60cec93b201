"""Exhaustive search of sums: the best set, what its certificate says, and what it refuses."""

import tomllib

import numpy as np
import pytest

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.errors import GrammarError
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.objective import Objective
from bsp_gp.search.sums import search_sums, terms_of
from tests.unit.test_banks_exhaustive import MIXED, grammar_of, regression_of
from tests.unit.test_recognition import SUM_TOML, everything, sum_world

MASSES = (("a", 0.5), ("b", 1.0), ("c", 1.7))


def description(objective, tree, y):
    """Profiled fit, half a log n per constant, and the prior of the terms."""
    score = objective.known([tree])[0]
    n = objective.regression.n_rows
    k = len(objective.recogniser.law(tree).terms)
    terms = [objective.complexity(child) for child in tree.children]
    return 0.5 * n * np.log(2 * score.loss / n) + 0.5 * k * np.log(n) + sum(terms)


@pytest.mark.parametrize("sigma", [0.02, 0.3, 3.0])
def test_no_sum_has_a_shorter_description(sigma):
    grammar, regression = sum_world(sigma)
    objective = Objective(regression, grammar, "pair")
    trees = everything(grammar)
    scores = objective.score(trees)
    costs = [
        description(objective, tree, regression.target()) if score.law >= 0 else np.inf
        for tree, score in zip(trees, scores, strict=True)
    ]
    result = search_sums(regression, grammar, kind="pair")
    best = trees[int(np.argmin(costs))]
    expected = objective.candidate(best)
    assert result.best.loss == pytest.approx(expected.loss, rel=1e-9)
    assert len(result.best.constants) == len(expected.constants)
    assert "differs in two terms or more is not ruled out" in result.certificate.text()
    assert [c.loss for c in result.candidates] == sorted(c.loss for c in result.candidates)


def test_exact_data_are_explained_and_nothing_more():
    grammar, regression = sum_world(0.0)
    result = search_sums(regression, grammar, kind="pair")
    text = to_text(result.best.formula)
    assert "m_i * m_j * normalize(p_i - p_j)" in text
    assert "m_i * normalize(v_i)" in text
    assert sorted(result.best.constants.values()) == pytest.approx([-2.0, 3.0], rel=1e-9)
    assert result.best.loss < 1e-20 * result.best.total


def test_a_law_that_is_there_already_is_refitted_jointly():
    grammar, regression = sum_world(0.1)
    column = regression.column(
        Term(everything_formula(grammar, regression, "m_i * normalize(v_i)"), "pair")
    )[0]
    result = search_sums(regression, grammar, kind="pair", nuisance=column)
    assert list(result.best.constants.values()) == pytest.approx([3.0], abs=0.2)
    with_both = np.column_stack(
        [column[:, 0], regression.column(Term(result.best.formula.args[1], "pair"))[0][:, 0]]
    )
    y = regression.target()
    left = y - with_both @ np.linalg.lstsq(with_both, y, rcond=None)[0]
    assert result.best.loss == pytest.approx(0.5 * left @ left, rel=1e-9)


def everything_formula(grammar, regression, text):
    """The constant-free formula of a term of the little grammar."""
    objective = Objective(regression, grammar, "pair")
    for tree in everything(grammar):
        formula = objective.recogniser.formula(tree)
        if to_text(formula) == f"c1 * ({text})":
            return formula.args[1]
    raise AssertionError(text)


def test_grammars_without_sums_are_searched_as_ever():
    grammar, regression = grammar_of(MIXED), regression_of()
    assert terms_of(grammar, "pair") == ("Force",)
    ours = search_sums(regression, grammar, kind="pair", max_levels=5)
    theirs = search_exhaustive(regression, grammar, kind="pair", max_levels=5)
    assert ours.candidates == theirs.candidates
    assert ours.certificate == theirs.certificate


def test_the_grammar_of_sums_has_three_terms():
    grammar = load_grammar("newtonian_sum")
    assert terms_of(grammar, "pair") == ("FirstForce", "SecondForce", "ThirdForce")
    single = load_grammar("newtonian")
    least = grammar.min_levels["Force"]
    # One term: as many laws as newtonian has, less the free choice among three constants.
    for levels in range(least, least + 3):
        term = grammar.count("FirstForce", levels)
        assert 3 * term == single.count("BasicForce", levels)
        assert grammar.count("Force", levels + 1) == term + term**2 + term**3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('Two = "mul(Second, mul(Coeff, Direction))"', 'Two = "mul(Second, Direction)"',
         "differ in their constants only"),
        ('Force = "One | add(One, Two)"', 'Force = "mul(First, Direction) | add(One, Two)"',
         "needs rules"),
    ],
)  # fmt: skip
def test_unlike_terms_are_refused(old, new, message):
    assert old in SUM_TOML
    grammar = read_grammar(tomllib.loads(SUM_TOML.replace(old, new)))
    with pytest.raises(GrammarError, match=message):
        terms_of(grammar, "pair")


def test_first_terms_are_also_looked_for_where_nothing_touches():
    """Two blows of one row each and a pull: by squares alone the pull comes late."""
    from bsp_gp.search.sums import _Sums

    grammar = load_grammar("newtonian_sum")
    rng = np.random.default_rng(0)
    discs = [Entity(name, "disc", radius=0.1, properties={"mass": m}) for name, m in MASSES]
    places = rng.uniform(-1, 1, (40, 3, 2))
    scene = Scene("s", 0.1 * np.arange(40), places, tuple(discs))
    regression = build_regression([scene], method="one_step", sigma=[1.0, 1.0])
    sums = _Sums(regression, grammar, "pair", None, None, {"max_levels": 5})
    rows = sums.touched("does_collide")
    pull = parse_formula("m_i * normalize(v_i)", grammar.inputs)
    sums.target = regression.column(Term(pull, "pair"))[0][:, 0]
    sums.target[rows] += 1e4 * rng.standard_normal(len(rows))
    assert 0 < len(rows) < 0.2 * len(sums.target)
    (first, *_) = sums.untouched()
    assert to_text(first.terms[0]) == "m_i * normalize(v_i)"
    best = sums.extended(type(first)((), (), np.inf))[0]
    assert best.terms != first.terms
