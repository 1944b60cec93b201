"""The objective of all searches against least squares, brute force and the exhaustive search."""

import tomllib

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset
from bsp_gp.errors import EvaluationError, SettingsError
from bsp_gp.language.expression import derive, to_formula
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.search import columns, recognition
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.objective import Objective
from tests.unit.test_banks_exhaustive import (
    MIXED,
    SPLIT,
    brute_force,
    derivations,
    grammar_of,
    regression_of,
)

SOFT = """
[grammar]
name = "soft"
start = "Force"
kind = "pair"
[types]
Const = "scalar *"
Force = "vector *"
Coeff = "scalar *"
Direction = "vector 1"
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
Const = "c1 | c2"
Force = "mul(c1, mul(Coeff, Direction)) | mul(Const, mul(Coeff, Direction)) | mul(Coeff, Direction)"
Coeff = "m_i | mul(m_i, m_j) | div(mul(m_i, m_j), add(square(norm(sub(p_i, p_j))), square(c2)))"
Direction = "normalize(sub(p_i, p_j)) | normalize(v_i)"
"""


def newtonian_of(regression):
    types = dataset_types(Dataset("made-up", tuple(regression.scenes)))
    return load_grammar("newtonian").masked(set(types), 2)[0]


def nuisance_of(regression):
    """Columns of two free terms, as a law that is there already would have."""
    law = ForceLaw(
        [Term(parse_formula(text, dataset_types(Dataset("made-up", regression.scenes))))
         for text in ("m_i * v_i", "m_i * m_j * (p_i - p_j)")]
    )  # fmt: skip
    return np.column_stack([regression.column(term)[0][:, 0] for term in law.terms])


def loss_by_lstsq(regression, formula, kind, nuisance, target):
    """None if the law has no finite value, no effect, or is one of the free terms."""
    try:
        column = regression.column(Term(split_linear(formula)[1], kind))[0]
    except EvaluationError:
        return None
    base = np.zeros((len(target), 0)) if nuisance is None else nuisance
    left = column - base @ np.linalg.lstsq(base, column, rcond=None)[0] if base.size else column
    if np.linalg.norm(left) <= 1e-5 * np.linalg.norm(column):
        return None
    design = np.column_stack([base, column])
    design = design / np.linalg.norm(design, axis=0)
    best = np.linalg.lstsq(design, target, rcond=None)[0]
    return 0.5 * float(np.square(target - design @ best).sum())


@pytest.mark.parametrize("method", ["one_step", "gls"])
@pytest.mark.parametrize("with_nuisance", [False, True], ids=["alone", "nuisance"])
def test_losses_are_those_of_least_squares(method, with_nuisance):
    regression = regression_of(method=method)
    grammar = newtonian_of(regression)
    nuisance = nuisance_of(regression) if with_nuisance else None
    rng = np.random.default_rng(5)
    target = regression.target() + rng.standard_normal(len(regression.target()))
    objective = Objective(regression, grammar, "pair", target=target, nuisance=nuisance)
    trees = Pcfg.uniform(grammar).sample_many(rng, objective.start, 9, 300)
    checked = conditions = 0
    for tree, score in zip(trees, objective.score(trees), strict=True):
        formula = to_formula(tree, grammar)
        direct = loss_by_lstsq(regression, formula, "pair", nuisance, target)
        if direct is None:
            assert score.law == -1
            assert score.loss == score.cost == np.inf
            continue
        assert score.loss == pytest.approx(direct, abs=1e-9 * objective.total)
        assert score.complexity == pytest.approx(-Pcfg.uniform(grammar).log_prob(tree))
        candidate = objective.candidate(tree)
        assert candidate.loss == pytest.approx(direct, rel=1e-9)
        assert candidate.total == pytest.approx(objective.total)
        checked += 1
        conditions += "s_j" in formula.inputs
    assert checked > 100
    assert conditions > 30


CASES = [(MIXED, "pair", "one_step", 5), (SPLIT, "pair", "gls", 5), (SPLIT, "field", "gls", 4)]


@pytest.mark.parametrize(
    ("text", "kind", "method", "levels"), CASES, ids=["mixed", "split", "field"]
)
@pytest.mark.parametrize("with_nuisance", [False, True], ids=["alone", "nuisance"])
def test_it_agrees_with_the_exhaustive_search(text, kind, method, levels, with_nuisance):
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    nuisance = nuisance_of(regression) if with_nuisance else None
    result = search_exhaustive(
        regression, grammar, kind=kind, nuisance=nuisance, max_levels=levels, top_k=10_000
    )
    objective = Objective(regression, grammar, kind, nuisance=nuisance)
    trees = list(derivations(grammar, grammar.start[kind], levels))
    scores = objective.score(trees)
    assert objective.n_scored == len(objective.best)
    assert min(s.loss for s in scores) == pytest.approx(result.best.loss, rel=1e-10)
    ours = np.array([score.loss for _, score in objective.best.values()])
    theirs = np.array([c.loss for c in result.candidates])
    same = np.abs(ours[:, None] - theirs) < 1e-9 * theirs
    assert same.any(axis=0).all()
    assert same.any(axis=1).all()
    # Exhaustive search also merges laws that differ by a free term: (m_i + m_j) v_i, m_j v_i.
    assert 0 <= len(ours) - len(theirs) <= (1 if with_nuisance else 0)


def test_laws_equal_on_the_data_share_a_number_and_are_scored_once():
    grammar, regression = grammar_of(MIXED), regression_of()
    truth = brute_force(regression, grammar, "pair", 5)
    objective = Objective(regression, grammar, "pair")
    trees = list(truth)
    scores = objective.score(trees)
    columns = np.stack([column / np.linalg.norm(column) for _, column in truth.values()])
    same = np.abs(columns @ columns.T) > 1 - 1e-12
    laws = np.array([score.law for score in scores])
    np.testing.assert_array_equal(same, laws[:, None] == laws)
    assert sorted(set(laws)) == list(range(objective.n_scored))
    assert objective.n_scored < len(trees)
    # Equal laws have one loss, to the bit; the least complex tree stands for them.
    for law in set(laws):
        members = [score for score in scores if score.law == law]
        assert len({score.loss for score in members}) == 1
        assert objective.best[law][1].complexity == min(s.complexity for s in members)


def test_a_law_in_the_target_already_is_not_found_again():
    """What is left of it beside the free terms is rounding, and no law."""
    grammar, regression = grammar_of(MIXED), regression_of()
    trees = list(derivations(grammar, "Force", 4))
    formula = to_formula(trees[7], grammar)
    column = regression.column(Term(split_linear(formula)[1], "pair"))[0]
    objective = Objective(regression, grammar, "pair", nuisance=column)
    assert objective.score([trees[7]])[0].law == -1
    assert objective.n_failed == 1


def test_trees_repeats_laws_and_failures_are_counted():
    regression = regression_of()
    grammar = newtonian_of(regression)
    objective = Objective(regression, grammar, "pair")
    rng = np.random.default_rng(0)
    pcfg = Pcfg.uniform(grammar)
    seen, failed = set(), 0
    for step in range(3):
        trees = pcfg.sample_many(rng, objective.start, 8, 200)
        for tree, score in zip(trees, objective.score(trees), strict=True):
            failed += tree not in seen and score.law < 0
            seen.add(tree)
        assert set(objective._scores) == seen
        assert objective.n_trees == 200 * (step + 1) == objective.n_repeats + len(seen)
        assert objective.n_failed == failed
        assert objective.n_scored == len(objective.best) <= len(seen) - failed
    assert failed > 0
    before = (objective.n_trees, objective.n_scored, objective.n_repeats)
    assert objective.known(trees) == [objective.known([tree])[0] for tree in trees]
    objective.candidate(objective.front()[0][0])
    assert before == (objective.n_trees, objective.n_scored, objective.n_repeats)


def test_caches_are_bounded_and_change_nothing(monkeypatch):
    regression = regression_of()
    grammar = newtonian_of(regression)
    trees = Pcfg.uniform(grammar).sample_many(np.random.default_rng(3), "Force", 9, 400)
    roomy = Objective(regression, grammar, "pair")
    expected = roomy.score(trees)
    monkeypatch.setattr(recognition, "CACHE_BYTES", 3000)
    tight = Objective(regression, grammar, "pair")
    assert tight.score(trees) == expected
    assert len(roomy.recogniser._values) > 50
    assert len(tight.recogniser._values) <= 3
    held = sum(np.asarray(value).nbytes for value in tight.recogniser._subtrees.values())
    assert held == tight.recogniser._subtrees.bytes <= 3000 + 8 * regression.n_rows * 2
    monkeypatch.setattr(columns, "BATCH_BYTES", 1)  # one law at a time
    for score, old in zip(
        Objective(regression, grammar, "pair").score(trees), expected, strict=True
    ):
        assert (score.law, score.complexity) == (old.law, old.complexity)
        assert score.loss == pytest.approx(old.loss, abs=1e-12 * roomy.total)


@pytest.mark.parametrize("criterion", ["prior", "mdl"])
def test_costs(criterion):
    grammar, regression = grammar_of(MIXED), regression_of()
    objective = Objective(regression, grammar, "pair", criterion=criterion, beta=0.3)
    n = regression.n_rows
    for score in objective.score(list(derivations(grammar, "Force", 4))):
        bic = n / 2 * np.log(2 * score.loss / n) + np.log(n) / 2
        expected = {
            "prior": score.loss + 0.3 * score.complexity,
            "mdl": bic + score.complexity,
        }
        assert score.cost == pytest.approx(expected[criterion], rel=1e-12)


def test_settings_are_checked():
    grammar, regression = grammar_of(MIXED), regression_of()
    with pytest.raises(SettingsError, match="criterion must be one of .* got 'aic'"):
        Objective(regression, grammar, "pair", criterion="aic")
    with pytest.raises(SettingsError, match="mixed has no field laws"):
        Objective(regression, grammar, "field")


def test_the_front_improves_with_complexity():
    regression = regression_of()
    grammar = newtonian_of(regression)
    objective = Objective(regression, grammar, "pair")
    objective.score(Pcfg.uniform(grammar).sample_many(np.random.default_rng(2), "Force", 9, 400))
    front = [score for _, score in objective.front()]
    assert len(front) >= 3
    for one, other in zip(front, front[1:], strict=False):
        assert one.complexity < other.complexity
        assert one.loss > other.loss
    for _, score in objective.best.values():
        assert any(f.loss <= score.loss and f.complexity <= score.complexity for f in front)


# --- laws with several constants, or none -----------------------------------------------------


def soft_world(text, constants, nuisance=()):
    """The grammar of softened laws, and data that obey one of them."""
    grammar = read_grammar(tomllib.loads(SOFT))
    regression = regression_of()
    texts = (text, *nuisance)
    law = ForceLaw([Term(parse_formula(t, grammar.inputs), "pair") for t in texts], constants)
    for batch in regression.batches:
        batch.target[:] = regression.predict(batch, law)
    return grammar, regression


SOFTENED = "c1 * (m_i * m_j / (norm(p_i - p_j)^2 + c2^2) * normalize(p_i - p_j))"


def test_laws_with_two_constants_go_through_the_inner_level():
    grammar, regression = soft_world(SOFTENED, {"c1": 2.0, "c2": 0.7})
    objective = Objective(regression, grammar, "pair", beta=0.0)
    tree = derive(parse_formula(SOFTENED, grammar.inputs), grammar, "Force")
    trees = list(derivations(grammar, "Force", 5))
    assert tree in trees
    scores = dict(zip(trees, objective.score(trees), strict=True))
    assert scores[tree].loss < 1e-12 * objective.total
    candidate = objective.candidate(tree)
    assert candidate.constants["c1"] == pytest.approx(2.0, rel=1e-5)
    assert abs(candidate.constants["c2"]) == pytest.approx(0.7, rel=1e-5)
    assert candidate.loss < 1e-12 * objective.total
    # It is the only law that explains the data; every law's loss is its fit's.
    good = {score.law for score in scores.values() if score.loss < 1e-9 * objective.total}
    assert good == {scores[tree].law}
    for expression, score in scores.items():
        formula = to_formula(expression, grammar)
        law = ForceLaw([Term(formula, "pair")], dict.fromkeys(formula.constants, 1.0))
        fit = fit_constants(regression, law, starts=3)
        assert score.loss == pytest.approx(fit.loss, rel=1e-6, abs=1e-9 * objective.total)
        again = objective.candidate(expression)
        assert again.loss == pytest.approx(score.loss, rel=1e-9, abs=1e-12 * objective.total)
        assert set(again.constants) == set(formula.constants)


def test_laws_with_two_constants_are_fitted_once():
    """c1 * ... c2 ... is the same law whichever way the tree was derived."""
    grammar, regression = soft_world(SOFTENED, {"c1": 2.0, "c2": 0.7})
    objective = Objective(regression, grammar, "pair")
    by_formula = {}
    trees = list(derivations(grammar, "Force", 5))
    for tree, score in zip(trees, objective.score(trees), strict=True):
        by_formula.setdefault(to_formula(tree, grammar), set()).add(score.law)
    assert len(by_formula) < len(trees)
    assert all(len(laws) == 1 for laws in by_formula.values())


def test_the_constants_of_every_law_are_paid_for():
    grammar, regression = soft_world("c1 * (m_i * normalize(v_i))", {"c1": 1.0})
    rng = np.random.default_rng(0)
    target = rng.standard_normal(len(regression.target()))
    objective = Objective(regression, grammar, "pair", target=target, criterion="mdl")
    tree = derive(parse_formula(SOFTENED, grammar.inputs), grammar, "Force")
    (score,) = objective.score([tree])
    n = regression.n_rows
    profiled = n / 2 * np.log(2 * score.loss / n) + 2 * np.log(n) / 2
    assert score.cost == pytest.approx(profiled + score.complexity)


def test_two_constants_beside_a_law_that_is_there_already():
    """Target and free terms of that law count in the full inner level as well."""
    drag = "c3 * (m_i * v_i)"
    grammar, regression = soft_world(SOFTENED, {"c1": 2.0, "c2": 0.7, "c3": -0.4}, (drag,))
    column = regression.column(Term(parse_formula("m_i * v_i", grammar.inputs), "pair"))[0]
    target = regression.target() + 5.0 * column[:, 0]  # a residual after some other drag
    tree = derive(parse_formula(SOFTENED, grammar.inputs), grammar, "Force")
    objective = Objective(regression, grammar, "pair", target=target, nuisance=column)
    assert objective.score([tree])[0].loss < 1e-12 * objective.total
    assert objective.candidate(tree).constants["c1"] == pytest.approx(2.0, rel=1e-4)


def test_laws_without_constants_are_scored_as_they_are():
    text = "m_i * m_j * normalize(v_i)"
    grammar, regression = soft_world(text, {})
    tree = derive(parse_formula(text, grammar.inputs), grammar, "Force")
    objective = Objective(regression, grammar, "pair")
    (score,) = objective.score([tree])
    assert score.loss < 1e-20 * objective.total
    assert objective.candidate(tree).constants == {}
    wrong = derive(parse_formula("m_i * normalize(v_i)", grammar.inputs), grammar, "Force")
    law = ForceLaw([Term(to_formula(wrong, grammar), "pair")])
    direct = 0.5 * np.square(regression.residual(law)).sum()
    assert objective.score([wrong])[0].loss == pytest.approx(direct, rel=1e-12)
