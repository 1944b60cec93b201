"""The loop of all searches: budgets, seeds, checkpoints, resuming, Ctrl-C."""

import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.errors import OutputError, SettingsError
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


@pytest.mark.parametrize("cut", [None, 4])
def test_an_exhausted_grammar_ends_the_search(cut, tmp_path):
    """More laws than a grammar has can be asked for; the count of idle steps is resumed."""
    grammar = grammar_of(MIXED)
    path = None if cut is None else tmp_path / "run.json"
    steps = []
    first = [Budget(n_steps=cut, n_idle=7)] if cut else []
    for budget in (*first, Budget(n_scored=10**6, n_idle=7)):
        objective = Objective(world()[0], grammar, "pair")
        result = run_search(
            RandomSearch(population=3000, max_levels=4), objective, budget, checkpoint=path,
            rng=np.random.default_rng(0), callback=lambda k, objective: steps.append(k),
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


# --- checkpoints ------------------------------------------------------------------------------


@all_strategies
def test_a_checkpoint_changes_nothing(name, tmp_path):
    assert outcome(name, checkpoint=tmp_path / "run.json") == uninterrupted(name)
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


@pytest.mark.slow
@all_strategies
def test_runs_resume_from_every_step(name, tmp_path):
    for steps in range(6):
        path = tmp_path / f"{steps}.json"
        run(name, steps, checkpoint=path)
        assert json.loads(path.read_text())["steps"] == steps
        assert outcome(name, checkpoint=path) == uninterrupted(name), steps
    # A finished run is only read back.
    assert outcome(name, checkpoint=path) == uninterrupted(name)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@all_strategies
def test_kill_9_and_resume(name, tmp_path):
    path = tmp_path / "run.json"
    code = (
        "import time\n"
        "from tests.unit.test_run_search import run\n"
        f"run({name!r}, 6, checkpoint={str(path)!r}, callback=lambda *_: time.sleep(0.3))"
    )
    process = in_another_process(code)
    try:
        until = time.monotonic() + 60
        while not path.exists() or json.loads(path.read_text())["steps"] < 2:
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.02)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert 2 <= json.loads(path.read_text())["steps"] < 6
    assert outcome(name, checkpoint=path) == uninterrupted(name)


def refused(path, match, name="cross_entropy", **settings):
    before = path.read_bytes()
    with pytest.raises(OutputError, match=match):
        run(name, 3, checkpoint=path, **settings)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_foreign_checkpoints_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "run.json"
    run("cross_entropy", 1, checkpoint=path)
    match = "is the checkpoint of another search .*; move it away"
    refused(path, match, name="genetic")
    refused(path, match, seed=2)
    refused(path, match, objective=objective_of(seed=5))
    refused(path, match, objective=objective_of(beta=0.5))
    refused(path, match, objective=objective_of(criterion="bic"))
    regression, grammar = world()
    fewer = grammar.masked(set(grammar.inputs) - {"v_j"}, 2)[0]
    assert fewer.fingerprint == grammar.fingerprint
    refused(path, match, objective=Objective(regression, fewer, "pair"))
    nuisance = np.ones((len(regression.target()), 1))
    refused(path, match, objective=objective_of(nuisance=nuisance))
    monkeypatch.setitem(STRATEGIES, "cross_entropy", CrossEntropy(population=81, elite=15))
    refused(path, match)


def damaged():
    yield "nothing", lambda text: ""
    yield "cut", lambda text: text[: len(text) // 2]
    yield "other-json", lambda text: "[1, 2]"
    yield "other-text", lambda text: "scene,entity,t\n1,a,0.0\n"
    yield "deep", lambda text: "[" * 100_000
    for key in ("search", "steps", "state", "seen", "counts"):
        yield f"no-{key}", functools.partial(_changed, key, None)
    yield "steps", functools.partial(_changed, "steps", "many")
    yield "state", functools.partial(_changed, "state", 3)
    yield "counts", functools.partial(_changed, "counts", [1])
    for seen in (7, [7], [[[]]], [[[10**6]]], [[["a"]]], [[[0, [0]]]]):
        yield f"seen-{seen}", functools.partial(_changed, "seen", seen)


def _changed(key, value, text):
    """As somebody writes it who knows of the digest, so that what is behind it is tested too."""
    content = json.loads(text)
    del content["digest"]
    if value is None:
        del content[key]
    else:
        content[key] = value
    text = json.dumps(content)
    return json.dumps({**content, "digest": hashlib.sha256(text.encode()).hexdigest()})


@pytest.mark.parametrize("damage", [pytest.param(d, id=name) for name, d in damaged()])
def test_damaged_checkpoints_are_refused(damage, tmp_path):
    path = tmp_path / "run.json"
    run("random", 0, checkpoint=path)
    path.write_text(damage(path.read_text()))
    refused(path, "run.json is no checkpoint of a search; move it away", name="random")


def says_the_same(text, other):
    try:
        return json.loads(text) == json.loads(other)
    except json.JSONDecodeError:
        return False


def test_an_altered_checkpoint_is_found_wherever_it_was_altered(tmp_path):
    path = tmp_path / "run.json"
    run("cross_entropy", 1, checkpoint=path)
    whole = path.read_text()
    rng = np.random.default_rng(0)
    digits = [k for k, c in enumerate(whole) if c.isdigit()]
    for k in rng.choice(digits, 60, replace=False):
        other = str((int(whole[k]) + 1 + rng.integers(9)) % 10)
        altered = whole[:k] + other + whole[k + 1 :]
        path.write_text(altered)
        if not says_the_same(altered, whole):  # the 17th digit of a number may say nothing
            refused(path, "altered since|another search|no checkpoint")
    path.write_text(json.dumps(json.loads(whole), indent=1))  # the same, only set otherwise
    assert run("cross_entropy", 1, checkpoint=path)


def test_checkpoints_that_are_no_text_or_no_file(tmp_path):
    path = tmp_path / "run.json"
    path.write_bytes(b"\xff\xfe\x00\x80")
    refused(path, "is no checkpoint of a search")
    with pytest.raises(OutputError, match="cannot be read"):
        run("random", 1, checkpoint=tmp_path)
    with pytest.raises(OutputError, match="cannot be written"):
        run("random", 1, checkpoint=tmp_path / "missing" / "run.json")


# --- Ctrl-C -----------------------------------------------------------------------------------


@all_strategies
def test_interrupt_keeps_the_best_so_far(name, tmp_path):
    def interrupt(step, objective):
        if step == 2:
            signal.raise_signal(signal.SIGINT)

    path = tmp_path / "run.json"
    found, _ = run(name, 6, callback=interrupt, checkpoint=path)
    expected, _ = run(name, 2)
    assert found.best == expected.best
    assert found.candidates == expected.candidates
    assert found.front == expected.front
    # And the run goes on where it was.
    assert outcome(name, checkpoint=path) == uninterrupted(name)


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


def laws(result):
    return [(to_text(c.formula), c.constants, c.loss.hex()) for c in result.candidates]


def test_checkpoints_cost_little(tmp_path, monkeypatch):
    """The file grows with the run: it is written a twentieth of the time, and at the end."""
    writes, write = [], Path.write_text

    def spy(self, *args, **kwargs):
        writes.append(self.name)
        time.sleep(0.05)
        return write(self, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", spy)
    outcome_ = run("cross_entropy", 8, checkpoint=tmp_path / "run.json")[0]
    assert 1 <= len(writes) <= 3
    monkeypatch.undo()
    resumed = run("cross_entropy", 8, checkpoint=tmp_path / "run.json")[0]
    assert laws(resumed) == laws(outcome_)
