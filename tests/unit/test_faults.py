"""Kill -9 at every write, and a disk that is full from any write on: the old result or the new."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SLOW = ("fit", "close", "compare", "infer", "learn", "make", "demo", "track")
KILLED = ("close", "compare", "learn", "make", "study")


def faults(command, mode, *words):
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.faults", command, mode, *words],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def lasting(names):
    return [pytest.param(name, marks=pytest.mark.faults) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["simulate", *lasting((*SLOW, "study"))])
def test_a_kill_at_any_write_leaves_the_old_result_or_the_new(command):
    result = faults(command, "kill")
    assert result["bad"] == []
    assert result["old"] > 5 and result["new"] > 0


@pytest.mark.parametrize("command", lasting(("simulate", "make")))
def test_so_it_is_after_the_next_run_where_names_cannot_be_exchanged(command):
    result = faults(command, "plain")
    assert result["bad"] == []
    assert result["old"] > 5 and result["new"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("command", ["simulate", *lasting((*SLOW, "study"))])
def test_a_full_disk_at_any_write_is_one_line_and_leaves_the_old_result(command):
    result = faults(command, "full")
    assert result["bad"] == []
    # The last thing that a study writes is its figure, which is as it was.
    assert result["old"] > 5 and (result["new"] == 0 or command == "study")


@pytest.mark.faults
@pytest.mark.parametrize("command", KILLED)
def test_a_kill_at_any_time_leaves_the_old_result_or_the_new(command):
    result = faults(command, "random", "100")
    assert result["bad"] == []
    assert result["points"] == 100 and result["old"] > 0
