"""Genetic programming: typed variation within the bound, fast selection, nothing global."""

import itertools
import random

import numpy as np
import pytest
from deap import tools
from hypothesis import given, settings
from hypothesis import strategies as st

from bsp_gp.language.expression import to_formula
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.search.genetic import Genetic, _Variation
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search
from tests.unit.test_banks_exhaustive import MIXED, grammar_of, regression_of
from tests.unit.test_objective import newtonian_of

NEWTONIAN = load_grammar("newtonian")
MASKED = newtonian_of(regression_of())
SMALL = Genetic(population=25, offspring=60)


def objective_of():
    return Objective(regression_of(), MASKED, "pair")


def parents_of(seed, max_levels, grammar=MASKED):
    pcfg = Pcfg.uniform(grammar)
    rng = np.random.default_rng(seed)
    variation = _Variation(grammar, pcfg, max_levels, rng)
    return variation, pcfg.sample_many(rng, "Force", max_levels, 2)


def check_types(tree, grammar):
    found = tuple(grammar.rules[child.rule].nonterminal for child in tree.children)
    assert found == grammar.rules[tree.rule].children
    for child in tree.children:
        check_types(child, grammar)


def check(tree, grammar, max_levels):
    assert tree.levels <= max_levels
    assert all(grammar.enabled[rule] for rule in tree.rules())
    assert grammar.rules[tree.rule].nonterminal == "Force"
    check_types(tree, grammar)
    formula = to_formula(tree, grammar)
    assert formula.type.shape == "vector"


@given(seed=st.integers(0, 2**32), max_levels=st.integers(5, 12))
@settings(max_examples=150, deadline=None)
def test_offspring_are_well_typed_and_within_the_bound(seed, max_levels):
    variation, (one, other) = parents_of(seed, max_levels)
    for _ in range(5):
        children = [*variation.crossover(one, other), variation.mutate(one)]
        for child in children:
            check(child, MASKED, max_levels)
        one, other = children[-1], children[0]


@given(seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_crossover_swaps_and_makes_nothing_up(seed):
    variation, (one, other) = parents_of(seed, 9)
    children = variation.crossover(one, other)
    if len(children) == 2:
        before = sorted([*one.rules(), *other.rules()])
        assert sorted(rule for child in children for rule in child.rules()) == before
        assert set(children) != {one, other} or one.rule == other.rule


def test_crossover_without_partners_mutates():
    """Two equal trees hold no other subtree of a type that occurs once in them."""
    grammar = grammar_of(MIXED)
    variation, (one, _) = parents_of(3, 4, grammar)
    seen = set()
    for _ in range(100):
        children = variation.crossover(one, one)
        for child in children:
            check(child, grammar, 4)
        seen.add(len(children))
    assert 1 in seen


def test_mutation_reaches_every_law():
    grammar = grammar_of(MIXED)
    variation, (tree, _) = parents_of(0, 4, grammar)
    seen = {tree}
    for _ in range(6000):
        tree = variation.mutate(tree)
        seen.add(tree)
    assert len(seen) == grammar.count("Force", 4)


def states(strategy, objective, n, seed=0):
    rng = np.random.default_rng(seed)
    state = strategy.init(objective, rng)
    yield state
    for _ in range(n):
        state = strategy.step(state, objective, rng)
        yield state


def test_a_population_holds_distinct_laws_within_the_bound():
    objective = objective_of()
    strategy = Genetic(population=25, offspring=60, max_levels=7)
    best = []
    for state in states(strategy, objective, 5):
        population = state["population"]
        assert 15 <= len(population) <= 25
        for tree in population:
            check(tree, MASKED, 7)
        scores = objective.known(population)
        assert len({score.law for score in scores}) == len(population)
        assert state["best"] == min(
            score.cost for score in objective._scores.values() if score.law >= 0
        )
        best.append(state["best"])
    assert len(population) == 25
    assert best == sorted(best, reverse=True)
    assert best[-1] < best[0]


def test_parents_are_not_counted_again():
    objective = objective_of()
    for n, _ in enumerate(states(SMALL, objective, 3), 1):
        assert objective.n_trees == 60 * n
    assert objective.n_repeats == objective.n_trees - len(objective._scores)


def test_the_front_survives_selection():
    """NSGA-II: laws that no other of the pool dominates are kept where there is room."""
    objective = objective_of()
    state = SMALL.init(objective, np.random.default_rng(0))
    scores = objective.known(state["population"])
    kept = {(score.loss, score.complexity) for score in scores}
    pool = [(s.loss, s.complexity) for s in objective._scores.values() if s.law >= 0]
    for loss, complexity in pool:
        if not any(
            (a <= loss and b <= complexity) and (a, b) != (loss, complexity) for a, b in pool
        ):
            assert (loss, complexity) in kept


def test_selection_sorts_in_n_log_n(monkeypatch):
    """The default sorting of selNSGA2 takes seconds for populations of a thousand."""
    sorting, select = [], tools.selNSGA2

    def spy(pool, k, nd="standard"):
        sorting.append(nd)
        return select(pool, k, nd=nd)

    monkeypatch.setattr(tools, "selNSGA2", spy)
    list(states(SMALL, objective_of(), 2))
    assert sorting == ["log", "log", "log"]


def test_the_global_generators_are_left_alone():
    random.seed(7)
    python, numpy = random.getstate(), np.random.get_state(legacy=False)  # noqa: NPY002
    run_search(SMALL, objective_of(), Budget(n_steps=3), rng=np.random.default_rng(0))
    assert random.getstate() == python
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert after["state"]["pos"] == numpy["state"]["pos"]
    assert np.array_equal(after["state"]["key"], numpy["state"]["key"])


def test_the_global_generators_have_no_say():
    outcomes = []
    for seed in (1, 2):
        random.seed(seed)
        outcomes.append(list(states(SMALL, objective_of(), 3)))
    assert outcomes[0] == outcomes[1]


def test_stagnation_keeps_the_best_alone():
    objective = objective_of()
    strategy = Genetic(population=25, offspring=60, patience=2)
    rng = np.random.default_rng(0)
    state = strategy.init(objective, rng) | {"best": -1.0}  # which no law beats
    stuck = []
    for _ in range(3):
        before, seen = state["population"], set(objective._scores)
        state = strategy.step(state, objective, rng)
        stuck.append(state["stuck"])
    assert stuck == [1, 2, 1]
    # The new pool is the best of the old one and sixty fresh trees.
    best = min(before, key=lambda tree: objective.known([tree])[0].cost)
    fresh = {score.law for tree, score in objective._scores.items() if tree not in seen}
    after = state["population"]
    laws = {score.law for score in objective.known(after)}
    assert objective.known([best])[0].law in laws
    old = {score.law for score in objective.known(before)}
    assert len((laws - fresh) & old) < len(old) / 2


def test_immigrants_come_from_the_whole_grammar(monkeypatch):
    objective = objective_of()
    drawn, sample_many = [], Pcfg.sample_many

    def spy(self, rng, nonterminal, max_levels, n):
        drawn.append((np.array_equal(self.probabilities, Pcfg.uniform(MASKED).probabilities), n))
        return sample_many(self, rng, nonterminal, max_levels, n)

    monkeypatch.setattr(Pcfg, "sample_many", spy)
    list(states(Genetic(population=25, offspring=60, immigrants=0.25), objective, 2))
    assert drawn == [(True, 60), (True, 15), (True, 15)]


def test_it_goes_on_when_no_law_has_a_value():
    objective = Objective(regression_of(), grammar_of(MIXED), "pair")
    recogniser = objective.recogniser
    known, recogniser.law = recogniser.law, lambda expression: None
    strategy = Genetic(population=10, offspring=20, patience=None)
    rng = np.random.default_rng(0)
    state = strategy.init(objective, rng)
    assert state["population"] == []
    state = strategy.step(state, objective, rng)
    assert state["population"] == []
    recogniser.law = known
    state = strategy.step(state, objective, rng)
    assert len(state["population"]) > 1


def test_tournaments_prefer_the_first():
    picked = [SMALL._picked(np.random.default_rng(seed), 20) for seed in range(300)]
    numbers = list(itertools.chain.from_iterable(picked))
    assert min(numbers) == 0
    # The mean of the lower of two out of 0..19 is (19 * 18 + ...) = 6.175, its sd 4.6.
    assert np.mean(numbers) == pytest.approx(6.175, abs=4 * 4.7 / np.sqrt(len(numbers)))
