"""Worker processes end with their parent, and a pool that breaks says so in one sentence."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bsp_gp.errors import ResourceError
from bsp_gp.workers import worker_pool

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = sorted(p for p in (ROOT / "experiments").rglob("*.py"))
PARENT = """
import os, threading, time
from bsp_gp.workers import worker_pool
if __name__ == "__main__":
    with worker_pool(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        futures = [pool.submit({work}, {amount}) for _ in range(2)]
        print(*pool._processes, flush=True)
        time.sleep(120)
"""


def is_alive(pid):
    """Whether a process runs; one that only waits to be reaped does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


def test_one_worker_is_this_process():
    with worker_pool(1) as pool:
        assert pool is None
    with worker_pool(1, own_process=True) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="reads /proc")
@pytest.mark.parametrize(
    "work, amount, by_system",
    [
        ("time.sleep", 120, True),
        ("time.sleep", 120, False),
        # One call of compiled code, in which no other thread has its turn: the system's signal.
        pytest.param("sum", "range(10**10)", True,
                     marks=pytest.mark.skipif(sys.platform != "linux", reason="prctl is Linux's")),
    ],
)  # fmt: skip
def test_workers_end_with_a_parent_that_is_killed(work, amount, by_system, tmp_path):
    script = tmp_path / "parent.py"
    text = PARENT.format(work=work, amount=amount)
    if not by_system:  # as from a thread, or on another system
        text = text.replace("    with", "    threading.main_thread = object\n    with", 1)
    script.write_text(text, encoding="utf-8")
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True,
                              cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})  # fmt: skip
    with parent:
        parent.stdout.readline()
        pids = [int(word) for word in parent.stdout.readline().split()]
        parent.kill()
    assert len(pids) == 2
    deadline = time.monotonic() + 2
    while any(map(is_alive, pids)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(map(is_alive, pids))


def test_a_worker_that_is_killed_is_an_error_of_ours():
    with pytest.raises(ResourceError, match="2 worker processes"), worker_pool(2) as pool:
        pool.submit(os.kill, os.getpid(), 0).result()
        pool.submit(signal.raise_signal, signal.SIGKILL).result()


def out_of_memory():
    import numpy as np

    return np.empty(1 << 50)


def test_memory_that_runs_out_in_a_worker_is_a_memory_error():
    from tests.unit.test_workers import out_of_memory as work

    with pytest.raises(MemoryError), worker_pool(2) as pool:
        pool.submit(work).result()


@pytest.mark.parametrize("path", [*EXPERIMENTS, ROOT / "bsp_gp" / "cli.py"],
                         ids=lambda p: p.stem)  # fmt: skip
def test_pools_are_made_in_one_place(path):
    text = path.read_text(encoding="utf-8")
    assert "ProcessPoolExecutor(" not in text and ".Pool(" not in text
