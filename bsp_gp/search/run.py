"""One loop for every search: budget, seeds, Pareto front, callbacks.

A strategy is any object with a name, ``init(objective, rng) -> state`` and
``step(state, objective, rng) -> state``. The loop spawns one random stream per step.
"""

import gc
import time
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.search.candidate import SearchResult
from bsp_gp.threads import one_thread

GRID = 5
"""Laws for which one counts whose inner constants are scored on a grid: it takes as long."""


@dataclass(frozen=True)
class Budget:
    """When to stop: whichever comes first.

    Attributes
    ----------
    n_scored : int or None
        Laws that differ on the data; one with constants on a grid counts `GRID` times.
        Reproducible.
    seconds : float or None
        Not reproducible by itself: the result records its counts so that it can be replayed.
    n_idle : int
        Steps in a row without a law not seen before, after which the grammar counts as
        exhausted.
    """

    n_scored: int | None = None
    seconds: float | None = None
    n_steps: int | None = None
    n_idle: int = 100

    def __post_init__(self):
        if self.n_scored is None and self.seconds is None and self.n_steps is None:
            raise SettingsError("a budget needs n_scored, seconds or n_steps")

    def is_spent(self, objective, started, steps, idle):
        """Whether a run is to end."""
        spent = objective.n_scored + (GRID - 1) * objective.n_grids
        return (
            idle >= self.n_idle
            or (self.n_scored is not None and spent >= self.n_scored)
            or (self.seconds is not None and time.perf_counter() - started >= self.seconds)
            or (self.n_steps is not None and steps >= self.n_steps)
        )


def run_search(strategy, objective, budget, *, rng, callback=None, keep=40, is_part=False):
    """Run a strategy until its budget is spent, a callback asks to stop, or Ctrl-C.

    Parameters
    ----------
    budget : Budget
    rng : numpy.random.Generator
        Only its seed sequence matters; step k uses the k-th stream spawned from it.
    callback : callable, optional
        ``callback(step, objective) -> bool``: True stops.
    keep : int
        Candidates in the result.
    is_part : bool
        Of a larger work, which Ctrl-C is to end; by default it ends the search, and what was
        found until then is the result.
    """
    started = time.perf_counter()
    streams = np.random.SeedSequence(int(rng.integers(2**63)))
    with one_thread():  # the last bits of a sum may not depend on how many there are
        with _patient_collector():
            try:
                _steps(strategy, objective, budget, streams, callback)
            except KeyboardInterrupt:
                if is_part or not objective.best:
                    raise  # nothing to keep yet, or nobody to keep it for
        return _result(objective, keep, time.perf_counter() - started)


def _steps(strategy, objective, budget, streams, callback):
    started, steps, idle = time.perf_counter(), 0, 0
    state = strategy.init(objective, _next_stream(streams))
    while not budget.is_spent(objective, started, steps, idle):
        known = objective.n_scored
        state = strategy.step(state, objective, _next_stream(streams))
        steps += 1
        idle = idle + 1 if objective.n_scored == known else 0
        if callback is not None and callback(steps, objective):
            break


def _next_stream(streams):
    return np.random.default_rng(*streams.spawn(1))


@contextmanager
def _patient_collector():
    """Let the cyclic garbage collector run seldom.

    A search keeps hundreds of thousands of small tuples and makes no cycles; at the usual
    thresholds going through them takes a third of its time.
    """
    thresholds = gc.get_threshold()
    gc.set_threshold(200_000, 50, 1000)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)


def _result(objective, keep, seconds):
    ranked = sorted(objective.best.values(), key=lambda e: (e[1].cost, e[1].complexity))[:keep]
    candidates = [objective.candidate(expression) for expression, _ in ranked]
    front = [objective.candidate(expression) for expression, _ in objective.front()]
    best = candidates[0] if candidates else None
    return SearchResult(
        best, tuple(candidates), tuple(front), objective.n_scored, objective.n_failed, seconds
    )
