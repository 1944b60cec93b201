"""One loop for every search: budget, seeds, Pareto front, callbacks, checkpoint and resume.

A strategy is any object with ``init(objective, rng) -> state`` and
``step(state, objective, rng) -> state``; a state is a dict that JSON can hold. The loop spawns
one random stream per step, so that a resumed run draws what the uninterrupted one would have.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from bsp_gp.errors import BspError, OutputError, SettingsError
from bsp_gp.language.expression import from_lists, to_lists
from bsp_gp.search.candidate import SearchResult

__all__ = ["Budget", "Search", "run_search"]


class Search(Protocol):
    """A search strategy."""

    name: str

    def init(self, objective, rng):
        """First state: a dict that JSON can hold, with the key "population" or like it."""

    def step(self, state, objective, rng):
        """Next state."""


@dataclass(frozen=True)
class Budget:
    """When to stop: whichever comes first.

    Attributes
    ----------
    n_scored : int or None
        Laws that differ on the data. Reproducible.
    seconds : float or None
        Not reproducible by itself: the result records its counts so that it can be replayed.
    n_steps : int or None
    """

    n_scored: int | None = None
    seconds: float | None = None
    n_steps: int | None = None

    def __post_init__(self):
        if self.n_scored is None and self.seconds is None and self.n_steps is None:
            raise SettingsError("a budget needs n_scored, seconds or n_steps")

    def is_spent(self, objective, started, steps):
        return (
            (self.n_scored is not None and objective.n_scored >= self.n_scored)
            or (self.seconds is not None and time.perf_counter() - started >= self.seconds)
            or (self.n_steps is not None and steps >= self.n_steps)
        )


def run_search(strategy, objective, budget, *, rng, callback=None, checkpoint=None, keep=40):
    """Run a strategy until its budget is spent, a callback asks to stop, or Ctrl-C.

    Parameters
    ----------
    strategy : Search
    objective : Objective
    budget : Budget
    rng : numpy.random.Generator
        Only its seed sequence matters; step k uses the k-th stream spawned from it.
    callback : callable, optional
        ``callback(step, objective) -> bool``: True stops.
    checkpoint : path, optional
        State is written there after every step (whole or not at all); if the file exists the run
        goes on from it. The answer is that of an uninterrupted run.
    keep : int
        Candidates in the result.

    Returns
    -------
    SearchResult

    Raises
    ------
    OutputError
        If the checkpoint cannot be written, is damaged, or is that of another search (strategy
        and its settings, grammar, data, seed). The file is left as it is.
    """
    # One thread: the last bits of a sum may not depend on how many there are.
    with threadpool_limits(limits=1, user_api="blas"):
        return _run(strategy, objective, budget, rng, callback, checkpoint, keep)


def _run(strategy, objective, budget, rng, callback, checkpoint, keep):
    started = time.perf_counter()
    entropy = int(rng.integers(2**63))
    identity = [strategy.name, repr(strategy), objective.fingerprint, entropy]
    state, steps = _load(checkpoint, identity, objective)
    streams = _Streams(entropy, 0 if state is None else steps + 1)
    try:
        if state is None:
            state = strategy.init(objective, streams.next())
            _save(checkpoint, identity, state, 0, objective)
        while not budget.is_spent(objective, started, steps):
            state = strategy.step(state, objective, streams.next())
            steps += 1
            _save(checkpoint, identity, state, steps, objective)
            if callback is not None and callback(steps, objective):
                break
    except KeyboardInterrupt:
        if not objective.best:
            raise  # nothing to keep yet
    return _result(objective, keep, time.perf_counter() - started)


class _Streams:
    """The k-th stream of a run, whatever was done before it in this process."""

    def __init__(self, entropy, index):
        self.entropy = entropy
        self.index = index

    def next(self):
        child = np.random.SeedSequence(self.entropy, spawn_key=(self.index,))
        self.index += 1
        return np.random.default_rng(child)


def _result(objective, keep, seconds):
    ranked = sorted(objective.best.values(), key=lambda e: (e[1].cost, e[1].complexity))[:keep]
    candidates = [objective.candidate(expression) for expression, _ in ranked]
    front = [objective.candidate(expression) for expression, _ in objective.front()]
    best = candidates[0] if candidates else None
    return SearchResult(
        best, tuple(candidates), tuple(front), objective.n_scored, objective.n_failed, seconds
    )


def _save(path, identity, state, steps, objective):
    if path is None:
        return
    path = Path(path)
    content = {
        "search": identity,
        "steps": steps,
        "state": state,
        "seen": [[to_lists(expression) for expression in part] for part in objective.history],
        "counts": [objective.n_trees, objective.n_repeats],
    }
    temporary = path.with_name(path.name + ".part")
    try:
        temporary.write_text(json.dumps(content), encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"checkpoint {path} cannot be written: {error.strerror}") from None


def _load(path, identity, objective):
    if path is None or not Path(path).exists():
        return None, 0
    damaged = f"{path} is no checkpoint of a search; move it away"
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        matches = content["search"] == identity
        steps, state, seen = int(content["steps"]), dict(content["state"]), content["seen"]
        n_trees, n_repeats = map(int, content["counts"])
    except OSError as error:
        raise OutputError(f"checkpoint {path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(damaged) from None
    if not matches:
        raise OutputError(
            f"{path} is the checkpoint of another search (strategy, grammar, data or seed); "
            "move it away"
        )
    try:
        seen = [[from_lists(lists, objective.grammar) for lists in part] for part in seen]
    except (BspError, IndexError, KeyError, TypeError):
        raise OutputError(damaged) from None
    # Scoring the laws seen so far again, in the same batches, restores counts, numbers and the
    # front bit for bit.
    for part in seen:
        objective.score(part)
    objective.n_trees, objective.n_repeats = n_trees, n_repeats
    return state, steps
