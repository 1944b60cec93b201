"""Memory of an exhaustive search: foreseen, refused with a bound that fits; at worst one line."""

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.cli import main
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import save_dataset
from bsp_gp.errors import ResourceError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search import room
from bsp_gp.search.exhaustive import Exhaustive, law_pool, search_exhaustive
from tests.throws import SI, throws_folder

ROOT = Path(__file__).resolve().parents[2]
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
from bsp_gp.cli import main
sys.exit(main(sys.argv[1:]))
"""


def three_bodies(n_scenes=2, n_times=12):
    rng = np.random.default_rng(0)
    t = 0.05 * np.arange(n_times)
    scenes = []
    for k in range(n_scenes):
        p, v, a = rng.normal(size=(3, 3, 2))
        path = p + v * t[:, None, None] + a * t[:, None, None] ** 2
        bodies = tuple(
            Entity(f"b{i}", "disc", radius=0.1, properties={"mass": m, "friction": m / 7})
            for i, m in enumerate(rng.uniform(0.5, 2, 3))
        )
        scenes.append(Scene(f"s{k}", t, path, bodies))
    return Dataset("three", tuple(scenes), units=SI, up="y")


@pytest.fixture(scope="module")
def problem():
    """A regression, and the paper's grammar as far as it applies."""
    data = three_bodies()
    grammar = load_grammar("newtonian")
    sayable = {"m_i", "m_j", "mu_i", "mu_j", "p_i", "p_j", "v_i", "v_j"}
    return build_regression(data.scenes), grammar.masked(sayable, 2)[0]


def needed(problem, levels, n_targets, monkeypatch):
    """The least memory that is not refused."""
    search = Exhaustive(*problem, "pair", levels)
    low, high = 0.0, 2.0**40
    while high > 1.01 * low:
        middle = (low + high) / 2
        monkeypatch.setattr(room, "available_bytes", lambda m=middle: m / room.SHARE)
        try:
            room.require_room(search, n_targets)
            high = middle
        except ResourceError:
            low = middle
    return high


@pytest.mark.slow
@pytest.mark.parametrize("n_null, levels", [(0, 9), (300, 8)])
def test_what_is_foreseen_is_near_what_is_taken(problem, n_null, levels, monkeypatch):
    with monkeypatch.context() as patch:
        foreseen = needed(problem, levels, 1 + n_null, patch)
    regression, grammar = problem
    null = np.random.default_rng(1).normal(size=(len(regression.target()), n_null))
    tracemalloc.start()
    try:
        search_exhaustive(regression, grammar, kind="pair", max_levels=levels, null_targets=null,
                          max_ties=0)  # fmt: skip
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.1 * foreseen < peak < foreseen + 4e6  # what does not grow with the search


@pytest.mark.parametrize("levels", [9, 20])
def test_a_bound_that_fits_is_proposed(problem, levels, monkeypatch):
    monkeypatch.setattr(room, "available_bytes", lambda: 5e6)
    with pytest.raises(ResourceError) as caught:
        search_exhaustive(*problem, kind="pair", max_levels=levels)
    words = str(caught.value).split()
    (word,) = (word for word in words if word.startswith("max_levels="))
    proposed = int("".join(filter(str.isdigit, word)))
    assert 5 <= proposed < levels
    assert search_exhaustive(*problem, kind="pair", max_levels=proposed).best is not None
    with pytest.raises(ResourceError):  # nor does a level more
        search_exhaustive(*problem, kind="pair", max_levels=proposed + 1)


def test_where_no_bound_fits_fewer_rows_are_proposed(problem, monkeypatch):
    monkeypatch.setattr(room, "available_bytes", lambda: 1e4)
    for search in (
        lambda: search_exhaustive(*problem, kind="pair", max_levels=8),
        lambda: law_pool(*problem, kind="pair", is_left=lambda _: True, max_levels=8),
    ):
        with pytest.raises(ResourceError) as caught:
            search()
        assert "--max-levels" not in str(caught.value)


def test_the_banks_are_the_same_with_and_without_foresight(problem, monkeypatch):
    found = search_exhaustive(*problem, kind="pair", max_levels=8)
    monkeypatch.setattr("bsp_gp.search.exhaustive.require_room", lambda *_: None)
    plain = search_exhaustive(*problem, kind="pair", max_levels=8)
    assert [str(c.formula) for c in found.candidates] == [str(c.formula) for c in plain.candidates]
    assert [c.loss for c in found.candidates] == [c.loss for c in plain.candidates]
    assert found.certificate == plain.certificate


def test_available_memory_heeds_the_least_limit(monkeypatch):
    files = {
        "/proc/meminfo": ["MemTotal: 9000 kB", "MemAvailable:    4000 kB"],
        "/proc/self/cgroup": ["0::/a/b"],
        "/sys/fs/cgroup/memory.max": ["max"],
        "/sys/fs/cgroup/a/memory.max": ["3000000"],
        "/sys/fs/cgroup/a/memory.current": ["1500000"],
        "/sys/fs/cgroup/a/memory.stat": ["anon 7", "inactive_file 500000"],
        "/sys/fs/cgroup/a/b/memory.max": ["max"],
        "/sys/fs/cgroup/a/b/memory.current": ["10"],
    }
    monkeypatch.setattr(room, "_lines", lambda path: files.get(path, []))
    monkeypatch.setattr(room, "_left_of_process", lambda: float("inf"))
    assert room.available_bytes() == 2e6
    files["/proc/self/cgroup"] = ["4:memory:/a", "1:cpu:/a"]
    files["/sys/fs/cgroup/memory/a/memory.limit_in_bytes"] = ["1000000"]
    files["/sys/fs/cgroup/memory/a/memory.usage_in_bytes"] = ["1500000"]
    assert room.available_bytes() == 0
    files["/proc/self/cgroup"] = []
    assert room.available_bytes() == 4000 * 1024
    monkeypatch.setattr(room, "_left_of_process", lambda: 5.0)
    assert room.available_bytes() == 5


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_too_many_levels_are_refused_with_one_line(tmp_path):
    data = save_dataset(three_bodies(n_scenes=4, n_times=70), tmp_path / "three")
    out = tmp_path / "out"
    run = subprocess.run(
        [sys.executable, "-c", LIMITED.format(limit=3 * 2**30), "close", str(data), "--declare",
         "-c * v_i", "--grammar", "newtonian", "--max-levels", "20", "--quiet", "--out", str(out)],
        cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert len(run.stderr.splitlines()) == 1 and "--max-levels" in run.stderr
    assert run.stdout == "" and not out.exists()


def test_memory_that_runs_out_is_one_line(tmp_path, monkeypatch, capsys):
    def hungry(*args, **kwargs):
        return np.empty(1 << 50)

    data = str(throws_folder(tmp_path / "throws"))
    monkeypatch.setattr("bsp_gp.fitting.law_fit.fit_law", hungry)
    assert main(["fit", data, "--law", "-c * v_i", "--quiet"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
