"""One loop for every search: budget, seeds, Pareto front, callbacks, checkpoint and resume.

A strategy is any object with a name, ``init(objective, rng) -> state`` and
``step(state, objective, rng) -> state``; a state is a dict that JSON can hold, but for a list of
expressions under "population". The loop spawns one random stream per step, so that a resumed run
draws what the uninterrupted one would have.
"""

import gc
import hashlib
import json
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bsp_gp.errors import BspError, OutputError, SettingsError
from bsp_gp.language.expression import from_lists, to_lists
from bsp_gp.output.place import whole_file
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

    def is_spent(self, objective, started, steps, idle=0):
        """Whether a run is to end."""
        spent = objective.n_scored + (GRID - 1) * objective.n_grids
        return (
            idle >= self.n_idle
            or (self.n_scored is not None and spent >= self.n_scored)
            or (self.seconds is not None and time.perf_counter() - started >= self.seconds)
            or (self.n_steps is not None and steps >= self.n_steps)
        )


def run_search(
    strategy,
    objective,
    budget,
    *,
    rng,
    callback=None,
    checkpoint=None,
    keep=40,
    is_part=False,
):
    """Run a strategy until its budget is spent, a callback asks to stop, or Ctrl-C.

    Parameters
    ----------
    budget : Budget
    rng : numpy.random.Generator
        Only its seed sequence matters; step k uses the k-th stream spawned from it.
    callback : callable, optional
        ``callback(step, objective) -> bool``: True stops.
    checkpoint : path, optional
        State is written there (whole or not at all) often enough to lose little, and at the end;
        if the file exists the run goes on from it. The answer is that of an uninterrupted run.
    keep : int
        Candidates in the result.
    is_part : bool
        Of a larger work, which Ctrl-C is to end; by default it ends the search, and what was
        found until then is the result.

    Raises
    ------
    OutputError
        If the checkpoint cannot be written, is damaged, or is that of another search (strategy
        and its settings, grammar, data, seed). The file is left as it is.
    """
    started = time.perf_counter()
    entropy = int(rng.integers(2**63))
    with one_thread():  # the last bits of a sum may not depend on how many there are
        with _patient_collector():
            _steps(strategy, objective, budget, entropy, callback, checkpoint, is_part)
        return _result(objective, keep, time.perf_counter() - started)


def _steps(strategy, objective, budget, entropy, callback, path, is_part):
    started = time.perf_counter()
    identity = [strategy.name, repr(strategy), objective.fingerprint, entropy]
    checkpoint = _Checkpoint(path, identity)
    state, steps = checkpoint.load(objective)
    streams = _Streams(entropy, 0 if state is None else steps + 1)
    try:
        if state is None:
            state = strategy.init(objective, streams.next())
            checkpoint.save(state, 0, objective)
        while not budget.is_spent(objective, started, steps, checkpoint.idle):
            known = objective.n_scored
            state = strategy.step(state, objective, streams.next())
            steps += 1
            checkpoint.idle = checkpoint.idle + 1 if objective.n_scored == known else 0
            checkpoint.save(state, steps, objective)
            if callback is not None and callback(steps, objective):
                break
    except KeyboardInterrupt:
        if is_part or not objective.best:
            raise  # nothing to keep yet, or nobody to keep it for
    else:
        checkpoint.save(state, steps, objective, at_once=True)


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


def _digest(text):
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


class _Checkpoint:
    """The file that a run can be taken up from."""

    def __init__(self, path, identity):
        self.path = None if path is None else Path(path)
        self.identity = identity
        self.due = 0.0
        self.steps = None
        self.idle = 0

    def save(self, state, steps, objective, at_once=False):
        """Write the state; seldom enough to cost a twentieth of the time, unless `at_once`."""
        now = time.perf_counter()
        if self.path is None or steps == self.steps or (now < self.due and not at_once):
            return
        content = {
            "search": self.identity,
            "steps": steps,
            "state": state,
            "seen": objective.history,
            "counts": [objective.n_trees, objective.n_repeats, self.idle],
        }
        text = json.dumps(content, default=to_lists)
        with whole_file(self.path) as part:
            part.write_text(f'{text[:-1]}, "digest": "{_digest(text)}"}}', encoding="utf-8")
        self.steps = steps
        self.due = time.perf_counter() + 20 * (time.perf_counter() - now)

    def load(self, objective):
        """State and number of steps done, or (None, 0); the objective knows what it knew."""
        path = self.path
        if path is None or not path.exists():
            return None, 0
        damaged = f"{path} is no checkpoint of a search; move it away"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            is_as_written = content.pop("digest") == _digest(json.dumps(content))
            matches = content["search"] == self.identity
            steps, state, seen = int(content["steps"]), dict(content["state"]), content["seen"]
            n_trees, n_repeats, idle = map(int, content["counts"])
        except OSError as error:
            raise OutputError(f"checkpoint {path} cannot be read: {error.strerror}") from None
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise OutputError(damaged) from None
        if not matches:
            raise OutputError(
                f"{path} is the checkpoint of another search (strategy, grammar, data or seed); "
                "move it away"
            )
        if not is_as_written:
            raise OutputError(f"{damaged}; it was altered since it was written")
        try:
            grammar = objective.grammar
            seen = [[from_lists(lists, grammar) for lists in part] for part in seen]
            if "population" in state:
                state["population"] = [from_lists(lists, grammar) for lists in state["population"]]
        except (BspError, IndexError, KeyError, TypeError):
            raise OutputError(damaged) from None
        # Scoring the laws seen so far again, in the same batches, restores counts, numbers and
        # the front bit for bit.
        for part in seen:
            objective.score(part)
        objective.n_trees, objective.n_repeats = n_trees, n_repeats
        self.steps, self.idle = steps, idle
        return state, steps
