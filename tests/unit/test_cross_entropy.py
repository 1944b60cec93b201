"""Drawing many trees from a grammar, and the cross-entropy search on top of it."""

import collections
import dataclasses
import json

import numpy as np
import pytest
from scipy.stats import chi2

from bsp_gp.errors import GrammarError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
from bsp_gp.search.objective import Objective
from tests.unit.test_banks_exhaustive import MIXED, derivations, grammar_of, regression_of
from tests.unit.test_objective import newtonian_of

NEWTONIAN = load_grammar("newtonian")


def skewed(grammar, seed=0):
    """A PCFG whose rules are far from equally likely."""
    counts = np.random.default_rng(seed).exponential(size=len(grammar.rules)) ** 2
    return Pcfg.from_counts(grammar, counts)


# --- Pcfg.sample_many -------------------------------------------------------------------------


def choices(grammar, trees, max_levels):
    """How often each rule was drawn at a nonterminal with so many levels left."""
    counts = collections.Counter()
    stack = [(tree, max_levels) for tree in trees]
    while stack:
        node, levels = stack.pop()
        counts[grammar.rules[node.rule].nonterminal, levels, node.rule] += 1
        stack.extend((child, levels - 1) for child in node.children)
    return counts


def surprise(pcfg, counts):
    """Chi-squared and degrees of freedom of drawn rules against the probabilities due to them.

    Draws at one nonterminal and bound are independent, whatever was drawn above.
    """
    grammar, total, freedom = pcfg.grammar, 0.0, 0
    for name, levels in {(name, levels) for name, levels, _ in counts}:
        fitting = [
            rule.index
            for rule in grammar.rules_of[name]
            if all(grammar.min_levels[child] < levels for child in rule.children)
        ]
        seen = np.array([counts[name, levels, index] for index in fitting])
        due = pcfg.probabilities[fitting] / pcfg.probabilities[fitting].sum() * seen.sum()
        assert seen.sum() == sum(n for key, n in counts.items() if key[:2] == (name, levels))
        common = due >= 5
        if common.sum() >= 2:
            pooled = np.append(seen[common], seen[~common].sum())
            expected = np.append(due[common], due[~common].sum())
            pooled, expected = pooled[expected > 0], expected[expected > 0]
            total += float((np.square(pooled - expected) / expected).sum())
            freedom += len(pooled) - 1
    return total, freedom


@pytest.mark.slow
@pytest.mark.parametrize("max_levels", [6, 10])
@pytest.mark.parametrize("make", [Pcfg.uniform, skewed], ids=["uniform", "skewed"])
def test_many_draws_have_the_distribution_of_single_ones(make, max_levels):
    pcfg = make(NEWTONIAN)
    rng = np.random.default_rng(20)
    many = pcfg.sample_many(rng, "Force", max_levels, 6000)
    single = [pcfg.sample(rng, "Force", max_levels) for _ in range(1500)]
    for trees in (many, single):
        total, freedom = surprise(pcfg, choices(NEWTONIAN, trees, max_levels))
        assert freedom > 30
        assert 1e-4 < chi2.sf(total, freedom) < 1 - 1e-4
    # The other distribution would be noticed.
    other = skewed(NEWTONIAN, seed=1)
    total, freedom = surprise(other, choices(NEWTONIAN, many, max_levels))
    assert total > 10 * freedom


@pytest.mark.parametrize("max_levels", [5, 7, 12])
def test_many_draws_keep_the_bound(max_levels):
    assert NEWTONIAN.min_levels["Force"] == 5
    trees = skewed(NEWTONIAN).sample_many(np.random.default_rng(0), "Force", max_levels, 2000)
    assert len(trees) == 2000
    assert max(tree.levels for tree in trees) <= max_levels


def test_a_bound_that_is_too_low_is_refused():
    with pytest.raises(GrammarError, match="Force needs at least 5 levels, got a bound of 4"):
        Pcfg.uniform(NEWTONIAN).sample_many(np.random.default_rng(0), "Force", 4, 10)


def test_equal_subtrees_are_one_object():
    trees = Pcfg.uniform(NEWTONIAN).sample_many(np.random.default_rng(0), "Force", 9, 500)
    objects, stack, n_nodes = {}, list(trees), 0
    while stack:
        node = stack.pop()
        n_nodes += 1
        assert objects.setdefault(node, node) is node
        stack.extend(node.children)
    assert len(objects) < 0.5 * n_nodes


def test_masked_rules_are_never_drawn():
    grammar = newtonian_of(regression_of())
    enabled = np.array(grammar.enabled)
    assert not enabled.all()
    pcfg = Pcfg.uniform(grammar)
    counts = pcfg.counts(pcfg.sample_many(np.random.default_rng(0), "Force", 10, 2000))
    assert not counts[~enabled].any()


def test_one_seed_draws_the_same_trees():
    pcfg = Pcfg.uniform(NEWTONIAN)
    one, other = (pcfg.sample_many(np.random.default_rng(4), "Force", 9, 50) for _ in range(2))
    assert one == other
    assert one != pcfg.sample_many(np.random.default_rng(5), "Force", 9, 50)
    assert pcfg.sample_many(np.random.default_rng(4), "Force", 9, 0) == []


# --- the search -------------------------------------------------------------------------------


@pytest.fixture
def objective():
    regression = regression_of()
    return Objective(regression, newtonian_of(regression), "pair")


def reward(objective, rule):
    """Make costs depend on nothing but whether a tree has a rule."""
    score, made = objective.score, {}

    def changed(trees):
        out = []
        for tree, old in zip(trees, score(trees), strict=True):
            cost = float(rule not in set(tree.rules())) if old.law >= 0 else np.inf
            out.append(made.setdefault(tree, old._replace(cost=cost)))
        return out

    objective.score = changed


def test_the_grammar_learns_the_elite(objective):
    grammar = objective.grammar
    strategy = CrossEntropy(population=150, elite=15)
    rare = min(
        range(len(grammar.rules)),
        key=lambda k: Pcfg.uniform(grammar).probabilities[k] or np.inf,
    )
    reward(objective, rare)
    name = grammar.rules[rare].nonterminal
    siblings = [rule.index for rule in grammar.rules_of[name]]
    rng, shares = np.random.default_rng(0), []
    state = strategy.init(objective, rng)
    for _ in range(5):
        state = strategy.step(state, objective, rng)
        shares.append(np.array(state["counts"])[rare] / np.array(state["counts"])[siblings].sum())
    assert len(siblings) >= 4
    assert shares[-1] > 2 / len(siblings)


def elite_counts(objective, distinct):
    strategy = CrossEntropy(population=150, elite=10, distinct=distinct, pool=None)
    pcfg = Pcfg.uniform(objective.grammar)
    trees = pcfg.sample_many(np.random.default_rng(3), objective.start, strategy.max_levels, 150)
    # Five of the best law, as if it had been drawn again and again.
    best = min(trees, key=lambda tree: objective.score([tree])[0].cost)
    trees = [best] * 5 + trees
    scores = objective.score(trees)
    chosen, laws = [], []
    for k in sorted(range(len(trees)), key=lambda k: scores[k].cost):
        if len(chosen) < 10 and not (distinct and scores[k].law in laws):
            chosen.append(trees[k])
            laws.append(scores[k].law)

    class Fixed(Pcfg):
        def sample_many(self, *_):
            return trees

    fixed = Fixed(objective.grammar, pcfg.probabilities)
    state = strategy._drawn(fixed, objective, None, None, 0)
    np.testing.assert_array_equal(state["counts"], pcfg.counts(chosen))
    return laws


@pytest.mark.parametrize("distinct", [True, False])
def test_the_elite(objective, distinct):
    laws = elite_counts(objective, distinct)
    assert len(laws) == 10
    assert (len(set(laws)) == 10) == distinct
    assert distinct or laws[:6] == laws[:1] * 6


def test_no_rule_dies_out(objective, monkeypatch):
    drawn = []
    sample_crossed = Pcfg.sample_crossed

    def spy(self, *args):
        drawn.append(self.probabilities)
        return sample_crossed(self, *args)

    monkeypatch.setattr(Pcfg, "sample_crossed", spy)
    strategy = CrossEntropy(population=60, elite=3, smoothing=0.0, uniform_share=0.2)
    rng = np.random.default_rng(0)
    state = strategy.init(objective, rng)
    for _ in range(4):
        state = strategy.step(state, objective, rng)
    uniform = Pcfg.uniform(objective.grammar).probabilities
    np.testing.assert_array_equal(drawn[0], uniform)
    assert len(drawn) == 5
    for probabilities in drawn[1:]:
        assert np.all(probabilities >= 0.2 * uniform * (1 - 1e-12))
        assert np.all((probabilities > 0) == (uniform > 0))
        assert np.abs(probabilities - uniform).max() > 0.1


def test_it_begins_anew_when_stuck(objective, monkeypatch):
    drawn = []
    sample_crossed = Pcfg.sample_crossed

    def spy(self, *args):
        drawn.append(self.probabilities)
        return sample_crossed(self, *args)

    monkeypatch.setattr(Pcfg, "sample_crossed", spy)
    strategy = CrossEntropy(population=30, elite=5, patience=3)
    rng = np.random.default_rng(0)
    state = strategy.init(objective, rng) | {"best": -1.0}  # which no law beats
    stuck = []
    for _ in range(4):
        state = strategy.step(state, objective, rng)
        stuck.append(state["stuck"])
    assert stuck == [1, 2, 3, 0]
    uniform = Pcfg.uniform(objective.grammar).probabilities
    assert [np.array_equal(p, uniform) for p in drawn] == [True, False, False, False, True]
    assert state["best"] > 0
    # Without patience it never does.
    state = dataclasses.replace(strategy, patience=None).step(
        state | {"best": -1.0, "stuck": 99}, objective, rng
    )
    assert state["stuck"] == 100


def test_states_survive_json(objective):
    rng = np.random.default_rng(0)
    for strategy in (CrossEntropy(population=40), RandomSearch(population=40)):
        state = strategy.init(objective, rng)
        for _ in range(2):
            assert json.loads(json.dumps(state)) == state
            state = strategy.step(state, objective, rng)


def test_no_law_with_a_value_is_no_elite():
    """Where nothing can be scored the grammar stays uniform and the search goes on."""
    regression = regression_of()
    objective = Objective(regression, grammar_of(MIXED), "pair")
    objective.recogniser.law = lambda expression: None
    strategy = CrossEntropy(population=20)
    rng = np.random.default_rng(0)
    state = strategy.init(objective, rng)
    for _ in range(2):
        state = strategy.step(json.loads(json.dumps(state)), objective, rng)
        assert not np.any(state["counts"])
    assert objective.n_scored == 0
    assert objective.n_failed == len(objective._scores)


def test_random_search_covers_a_small_grammar():
    regression = regression_of()
    objective = Objective(regression, grammar_of(MIXED), "pair")
    strategy = RandomSearch(population=2000, max_levels=4)
    state = strategy.init(objective, None)
    rng = np.random.default_rng(0)
    for _ in range(3):
        state = strategy.step(state, objective, rng)
    everything = Objective(regression, grammar_of(MIXED), "pair")
    everything.score(list(derivations(everything.grammar, "Force", 4)))
    assert objective.n_scored == everything.n_scored
    assert objective.n_trees == 6000
