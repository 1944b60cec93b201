"""The loop of all searches: budgets, seeds, Ctrl-C."""

import functools
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.errors import SettingsError
from bsp_gp.language.render import to_text
from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search
from tests.unit.test_banks_exhaustive import MIXED, derivations, grammar_of, regression_of
from tests.unit.test_objective import newtonian_of

ROOT = Path(__file__).resolve().parents[2]
STRATEGIES = {
    "cross_entropy": CrossEntropy(population=80, elite=15, patience=2),
    "genetic": Genetic(population=30, offspring=80, patience=2),
    "random": RandomSearch(population=80),
}
all_strategies = pytest.mark.parametrize("name", STRATEGIES)


@functools.lru_cache(maxsize=2)
def world(seed=0):
    regression = regression_of(seed)
    return regression, newtonian_of(regression)


def objective_of(seed=0, **settings):
    return Objective(*world(seed), "pair", **settings)


def run(name, steps, *, seed=1, objective=None, **settings):
    objective = objective_of() if objective is None else objective
    rng = np.random.default_rng(seed)
    result = run_search(STRATEGIES[name], objective, Budget(n_steps=steps), rng=rng, **settings)
    return result, objective


def outcome(name, steps=6, **settings):
    """Everything that a run gives, to the last bit, as text."""
    result, objective = run(name, steps, **settings)
    return json.dumps(
        {
            "laws": [
                [to_text(c.formula), c.constants, c.loss.hex(), c.complexity.hex()]
                for c in (result.best, *result.candidates, *result.front)
            ],
            "result": [result.n_evaluated, result.n_failed],
            "counts": [objective.n_trees, objective.n_scored, objective.n_repeats,
                       objective.n_failed],
            "numbers": [[law, score.loss.hex()] for law, (_, score) in objective.best.items()],
        }
    )  # fmt: skip


@functools.cache
def uninterrupted(name):
    return outcome(name)


def in_another_process(code, **environment):
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


# --- budgets ----------------------------------------------------------------------------------


@all_strategies
def test_the_budget_of_steps(name):
    steps = []
    result, objective = run(name, 3, callback=lambda step, _: steps.append(step))
    assert steps == [1, 2, 3]
    assert objective.n_trees == (3 if name == "random" else 4) * 80
    assert result.n_evaluated == objective.n_scored
    assert result.n_failed == objective.n_failed
    assert result.certificate is None


@all_strategies
def test_the_budget_of_laws(name):
    objective, seen = objective_of(), []
    run_search(
        STRATEGIES[name], objective, Budget(n_scored=150), rng=np.random.default_rng(0),
        callback=lambda _, o: seen.append(o.n_scored),
    )  # fmt: skip
    assert objective.n_scored >= 150
    assert all(n < 150 for n in seen[:-1])


def test_the_budget_of_seconds():
    objective = objective_of()
    strategy = STRATEGIES["random"]
    result = run_search(strategy, objective, Budget(seconds=0.3), rng=np.random.default_rng(0))
    assert result.seconds >= 0.3
    assert objective.n_trees > 0
    nothing = run_search(
        strategy, objective_of(), Budget(seconds=0.0), rng=np.random.default_rng(0)
    )
    assert nothing.best is None
    assert nothing.candidates == nothing.front == ()


def test_a_budget_needs_a_bound():
    with pytest.raises(SettingsError, match="a budget needs n_scored, seconds or n_steps"):
        Budget()


def test_an_exhausted_grammar_ends_the_search():
    """More laws than a grammar has can be asked for."""
    grammar, steps = grammar_of(MIXED), []
    result = run_search(
        RandomSearch(population=3000, max_levels=4), Objective(world()[0], grammar, "pair"),
        Budget(n_scored=10**6, n_idle=7), rng=np.random.default_rng(0),
        callback=lambda k, objective: steps.append(k),
    )  # fmt: skip
    everything = Objective(world()[0], grammar, "pair")
    everything.score(list(derivations(grammar, "Force", 4)))
    assert result.n_evaluated == everything.n_scored
    assert len(steps) in range(7, 20)
    assert steps == list(range(1, len(steps) + 1))


def test_a_callback_stops():
    steps = []

    def stop(step, objective):
        steps.append((step, objective.n_scored))
        return step == 2

    run("random", 50, callback=stop)
    assert [step for step, _ in steps] == [1, 2]


# --- results ----------------------------------------------------------------------------------


@all_strategies
def test_results_are_in_order(name):
    result, objective = run(name, 3, keep=7)
    assert len(result.candidates) == 7
    assert result.best is result.candidates[0]
    costs = [c.loss + objective.beta * c.complexity for c in result.candidates]
    assert costs == pytest.approx(sorted(costs), rel=1e-9)
    assert min(costs) == pytest.approx(min(s.cost for _, s in objective.best.values()), rel=1e-9)
    for one, other in zip(result.front, result.front[1:], strict=False):
        assert one.complexity < other.complexity
        assert one.loss > other.loss


@all_strategies
def test_one_seed_gives_the_same_bits(name):
    assert outcome(name) == uninterrupted(name)
    assert outcome(name, seed=2) != uninterrupted(name)


def test_another_process_with_other_hashes_gives_the_same_bits():
    code = (
        "from tests.unit.test_run_search import STRATEGIES, outcome\n"
        "for name in STRATEGIES: print(outcome(name))"
    )
    process = in_another_process(code, PYTHONHASHSEED="4711")
    out, _ = process.communicate(timeout=60)
    assert out.splitlines() == [uninterrupted(name) for name in STRATEGIES]


# --- Ctrl-C -----------------------------------------------------------------------------------


@all_strategies
def test_interrupt_keeps_the_best_so_far(name):
    def interrupt(step, objective):
        if step == 2:
            signal.raise_signal(signal.SIGINT)

    found, _ = run(name, 6, callback=interrupt)
    expected, _ = run(name, 2)
    assert found.best == expected.best
    assert found.candidates == expected.candidates
    assert found.front == expected.front


def test_interrupt_in_the_middle_of_scoring(monkeypatch):
    objective = objective_of()
    settle, calls = objective._settle, []

    def interrupting(*args):
        calls.append(1)
        if len(calls) == 90:
            raise KeyboardInterrupt
        return settle(*args)

    monkeypatch.setattr(objective, "_settle", interrupting)
    result, _ = run("random", 6, objective=objective)
    assert result.best is not None
    assert len(calls) == 90


def test_interrupt_before_there_is_anything(monkeypatch):
    def interrupt(trees):
        raise KeyboardInterrupt

    objective = objective_of()
    monkeypatch.setattr(objective, "score", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run("cross_entropy", 3, objective=objective)
