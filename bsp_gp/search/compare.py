"""Searches side by side: same grammar, same objective, same budget, many seeds.

Exhaustive search gives the certified optimum within its bound on levels, against which the
others report their regret; a learner may look at deeper trees, so that its regret may be
negative.
"""

import time
from dataclasses import dataclass

from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.run import run_search
from bsp_gp.search.sums import search_sums

STRATEGIES = {
    "cross_entropy": CrossEntropy(),
    "genetic": Genetic(),
    "random": RandomSearch(),
}
"""Strategies with their default settings, by name."""


@dataclass(frozen=True)
class Outcome:
    """What one search found.

    Attributes
    ----------
    best : Candidate or None
        Of lowest cost.
    cost : float
        Loss plus what the objective's criterion asks for complexity.
    n_evaluated, n_trees : int
        Scored laws; trees, repeats included.
    seconds : float
        Processor time of the search.
    n_to_best : int
        Scored laws when the best one was met.
    certificate : Certificate or None
    """

    search: str
    seed: int
    best: object
    cost: float
    n_evaluated: int
    n_trees: int
    seconds: float
    n_to_best: int
    seconds_to_best: float
    certificate: object = None


def certified(objective, *, missing_inputs=()):
    """The exhaustive search's optimum of an objective's cost.

    Parameters
    ----------
    objective : Objective
        Its target, free terms and criterion are used; nothing is scored in it.
    """
    started = time.process_time()
    result = search_sums(
        objective.regression, objective.grammar, kind=objective.kind, target=objective.y,
        nuisance=objective.q if objective.q.shape[1] else None, missing_inputs=missing_inputs,
    )  # fmt: skip
    seconds = time.process_time() - started
    best = min(result.candidates, key=lambda c: cost_of(objective, c), default=None)
    cost = cost_of(objective, best) if best else float("inf")
    n = result.n_evaluated
    return Outcome("exhaustive", 0, best, cost, n, n, seconds, n, seconds, result.certificate)


def cost_of(objective, candidate):
    """What an objective's criterion makes of a candidate."""
    return objective.cost(candidate.loss, candidate.complexity, len(candidate.constants))


def run_one(objective, name, strategy, seed, budget, *, rng, is_done=None):
    """Run one strategy once.

    Parameters
    ----------
    seed : int
        For the record.
    is_done : callable, optional
        ``is_done(expression, score) -> bool``, asked whenever there is a new best law; True ends
        the search.
    """
    objective = objective.fresh()
    started = time.process_time()
    watch = _Watch(started, is_done)
    result = run_search(
        strategy, objective, budget, rng=rng, callback=watch, keep=1, is_part=True
    )
    watch(None, objective)
    return Outcome(
        name, seed, result.best, watch.cost, objective.n_scored, objective.n_trees,
        time.process_time() - started, watch.n_scored, watch.seconds,
    )  # fmt: skip


class _Watch:
    """Notes when the best law was met."""

    def __init__(self, started, is_done):
        self.started = started
        self.is_done = is_done
        self.cost = float("inf")
        self.n_scored = 0
        self.seconds = 0.0

    def __call__(self, step, objective):
        best = min(objective.best.values(), key=lambda entry: entry[1].cost, default=None)
        if best is None or best[1].cost >= self.cost:
            return False
        self.cost = best[1].cost
        self.n_scored = objective.n_scored
        self.seconds = time.process_time() - self.started
        return self.is_done is not None and self.is_done(*best)


def compare(objective, budget, *, seeds, rng, strategies=None, executor=None, missing_inputs=()):
    """Run every strategy from every seed, and the exhaustive search once.

    Parameters
    ----------
    budget : Budget
        Of every run.
    seeds : int
        Runs of each strategy, from streams spawned from `rng`.
    strategies : dict of str to Search, optional
        `STRATEGIES` by default.
    executor : concurrent.futures.Executor, optional
        Where the runs go; the answer is the same without, but for the seconds.

    Returns
    -------
    list of Outcome
        The exhaustive search first.
    """
    strategies = STRATEGIES if strategies is None else strategies
    jobs = [
        (objective, name, strategies[name], seed, budget, child)
        for name in strategies
        for seed, child in enumerate(rng.spawn(seeds))
    ]
    found = map(_job, jobs) if executor is None else executor.map(_job, jobs)
    return [certified(objective, missing_inputs=missing_inputs), *found]


def _job(job):
    *settings, rng = job
    return run_one(*settings, rng=rng)
