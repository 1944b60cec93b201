"""Laws recognised on the data, populations made of pools, sums of terms in the objective."""

import pickle
import tomllib

import numpy as np
import pytest
from scipy import stats

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.language.expression import Expression, derive
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.objective import Objective
from tests.unit.test_banks_exhaustive import regression_of
from tests.unit.test_objective import newtonian_of

NEWTONIAN = load_grammar("newtonian")
UNIFORM = Pcfg.uniform(NEWTONIAN)

SUM_TOML = """
[grammar]
name = "sums"
start = "Force"
kind = "pair"
[types]
First = "scalar *"
Second = "scalar *"
Coeff = "scalar *"
Direction = "vector 1"
One = "vector *"
Two = "vector *"
Force = "vector *"
[inputs]
m_i = "scalar kg"
m_j = "scalar kg"
p_i = "point m"
p_j = "point m"
v_i = "vector m/s"
[constants]
c1 = "scalar *"
c2 = "scalar *"
[rules]
First = "c1"
Second = "c2"
Coeff = "m_i | mul(m_i, m_j) | norm(sub(p_i, p_j)) | add(m_i, m_j)"
Direction = "normalize(sub(p_i, p_j)) | normalize(v_i)"
One = "mul(First, mul(Coeff, Direction))"
Two = "mul(Second, mul(Coeff, Direction))"
Force = "One | add(One, Two)"
"""


def sum_world(sigma=0.3):
    grammar = read_grammar(tomllib.loads(SUM_TOML))
    regression = regression_of(n_times=20)
    law = ForceLaw(
        [Term(parse_formula(text, grammar.inputs), "pair")
         for text in ("c1 * (m_i * m_j * normalize(p_i - p_j))", "c2 * (m_i * normalize(v_i))")],
        {"c1": 3.0, "c2": -2.0},
    )  # fmt: skip
    rng = np.random.default_rng(1)
    for batch in regression.batches:
        batch.target[:] = regression.predict(batch, law)
        batch.target[:] += sigma * rng.standard_normal(batch.target.shape)
    return grammar, regression


def everything(grammar):
    """Every expression of the little grammar of sums."""

    def all_of(nonterminal):
        for rule in grammar.rules_of[nonterminal]:
            children = [list(all_of(child)) for child in rule.children]
            grid = [[]]
            for options in children:
                grid = [[*head, option] for head in grid for option in options]
            yield from (Expression(rule.index, head) for head in grid)

    return list(all_of("Force"))


# --- trees -----------------------------------------------------------------------------------


def test_equal_trees_are_one_object():
    one, other = (Expression(3, [Expression(1), Expression(2)]) for _ in range(2))
    assert one is other
    assert pickle.loads(pickle.dumps(one)) is one
    assert Expression(3, [Expression(2), Expression(1)]) is not one
    assert (one.levels, one.size) == (2, 3)


@pytest.mark.slow
@pytest.mark.parametrize("pool", [(64, 4), (5, 5), (1, 1)])
def test_pools_have_the_distribution_of_single_draws(pool):
    """Rules of the scalars, one tree per pool, so that the draws counted are independent."""
    crossed = np.zeros(len(NEWTONIAN.rules))
    for seed in range(300):
        trees = UNIFORM.sample_crossed(np.random.default_rng(seed), "Force", 10, 60, pool)
        assert len(trees) == 60
        assert max(tree.levels for tree in trees) <= 10
        crossed += UNIFORM.counts([trees[seed % 60]])
    plain = UNIFORM.counts(UNIFORM.sample_many(np.random.default_rng(0), "Force", 10, 3000))
    for name in ("BasicForce", "Coeff", "Condition", "Const", "UnitlessVec", "TransInvVec"):
        index = [rule.index for rule in NEWTONIAN.rules_of[name]]
        table = np.array([crossed[index], plain[index]])
        assert stats.chi2_contingency(table).pvalue > 1e-4, name


def test_pools_are_pools():
    trees = UNIFORM.sample_crossed(np.random.default_rng(0), "Force", 10, 512, (64, 4))
    basic = [tree.children[0] for tree in trees]
    scalars = {tree.children[:2] for tree in basic}  # constant and coefficient
    vectors = {tree.children[2:] for tree in basic}
    # At most two pools for each of the two rules of BasicForce; single draws differ nearly all.
    assert len(scalars) <= 4 * 66
    assert len(vectors) <= 4 * 6
    masked = newtonian_of(regression_of())
    for tree in Pcfg.uniform(masked).sample_crossed(np.random.default_rng(1), "Force", 8, 200):
        assert all(masked.enabled[rule] for rule in tree.rules())


# --- laws ------------------------------------------------------------------------------------


def test_forces_that_cancel_are_no_law():
    """Two like sources on opposite sides: what is left of their pull is rounding."""
    crew = tuple(Entity(n, properties={"mass": m}) for n, m in zip("abc", (1, 2, 2), strict=True))
    rng = np.random.default_rng(0)
    half = rng.uniform(1, 2, (12, 2)) * np.array([1 / 3, 1 / 7])
    centre = 0.01 * rng.standard_normal((12, 2))
    positions = np.stack([centre, centre + half, centre - half], axis=1)
    crew = (crew[0], *(Entity(e.name, properties=e.properties, is_static=True) for e in crew[1:]))
    regression = build_regression([Scene("s", 0.1 * np.arange(12), positions, crew)])
    grammar = newtonian_of(regression)
    objective = Objective(regression, grammar, "pair")
    text = "c1 * (m_i * m_j / norm(p_i - p_j)^2 * normalize(p_i - p_j))"
    tree = derive(parse_formula(text, grammar.inputs), grammar, "Force")
    tree = tree or derive(
        parse_formula("c1 * (m_i * normalize(p_i - p_j))", grammar.inputs), grammar, "Force"
    )
    assert objective.score([tree])[0].law == -1


def test_sums_have_the_losses_of_least_squares():
    grammar, regression = sum_world()
    objective = Objective(regression, grammar, "pair")
    trees = everything(grammar)
    y = regression.target()
    checked = failed = 0
    for tree, score in zip(trees, objective.score(trees), strict=True):
        formula = objective.recogniser.formula(tree)
        parts = [formula] if formula.operator == "mul" else list(formula.args)
        columns = np.column_stack(
            [regression.column(Term(part.args[1], "pair"))[0][:, 0] for part in parts]
        )
        columns /= np.linalg.norm(columns, axis=0)
        if np.linalg.matrix_rank(columns, tol=1e-8) < min(2, len({repr(p.args[1]) for p in parts})):
            assert score.law == -1
            failed += 1
            continue
        best = np.linalg.lstsq(columns, y, rcond=None)[0]
        direct = 0.5 * float(np.square(y - columns @ best).sum())
        assert score.loss == pytest.approx(direct, rel=1e-9)
        candidate = objective.candidate(tree)
        assert candidate.loss == pytest.approx(direct, rel=1e-9)
        assert set(candidate.constants) == set(formula.constants)
        checked += 1
    assert checked > 60
    assert objective.n_failed == failed
    best, score = min(objective.best.values(), key=lambda e: e[1].cost)
    found = sorted(objective.candidate(best).constants.values())
    assert found == pytest.approx([-2.0, 3.0], abs=0.5)


def test_a_sum_in_any_order_is_one_law_and_twice_a_term_is_the_term():
    grammar, regression = sum_world()
    objective = Objective(regression, grammar, "pair")
    trees = everything(grammar)
    by_terms = {}
    for tree, score in zip(trees, objective.score(trees), strict=True):
        by_terms.setdefault(objective.recogniser.law(tree).terms, set()).add(score.law)
    assert all(len(laws) == 1 for laws in by_terms.values())
    assert len(by_terms) == 8 + 8 * 7 // 2  # eight terms, all pairs
    assert objective.n_scored <= len(by_terms) < len(trees)


def test_a_constant_in_two_terms_is_one_constant():
    grammar, regression = sum_world()
    shared = read_grammar(tomllib.loads(SUM_TOML.replace('Second = "c2"', 'Second = "c1"')))
    objective = Objective(regression, shared, "pair")
    for tree, score in zip(everything(shared), objective.score(everything(shared)), strict=True):
        law = objective.recogniser.law(tree)
        if law.whole is not None:
            assert law.whole.constants == ("c1",)
            term = Term(objective.recogniser.formula(tree), "pair")
            column = 0.0
            for part in term.formula.args:
                column = column + regression.column(Term(part.args[1], "pair"))[0][:, 0]
            y = regression.target()
            direct = 0.5 * float(y @ y - (column @ y) ** 2 / (column @ column))
            assert score.loss == pytest.approx(direct, rel=1e-9)
    assert any(objective.recogniser.law(tree).whole for tree in everything(shared))


def test_objectives_travel_to_other_processes():
    grammar, regression = sum_world()
    objective = Objective(regression, grammar, "pair", criterion="mdl")
    trees = everything(grammar)
    scores = objective.score(trees)
    copy = pickle.loads(pickle.dumps(objective))
    assert copy.n_scored == 0
    assert copy.score(trees) == scores
