"""Ctrl-C or SIGTERM during the work: status 130, one line, nothing written, no process left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.throws import GRAVITY, throws_folder

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize("how", ["ctrl-c", "kill", "kill all"])
def test_interrupt_leaves_nothing(how, workers, tmp_path):
    data = throws_folder(tmp_path / "throws", n_scenes=10, n_times=150, sigma=0.01)
    # A session of its own: Ctrl-C goes to all of its processes, as from a terminal.
    process = subprocess.Popen(
        [sys.executable, "-m", "bsp_gp", "close", str(data), "--declare", GRAVITY,
         "--workers", workers, "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        cwd=ROOT,
    )  # fmt: skip
    try:
        seen = []
        while not seen or "round 1: laws" not in seen[-1]:
            line = process.stderr.readline()
            assert line, f"it ended before it could be interrupted: {seen}"
            seen.append(line)
        if how == "kill":
            process.terminate()
        else:
            os.killpg(process.pid, signal.SIGINT if how == "ctrl-c" else signal.SIGTERM)
        out, err = process.communicate(timeout=30)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "bsp-gp: interrupted; nothing was written"
    assert "Traceback" not in err
    assert out == ""
    assert [p.name for p in tmp_path.iterdir()] == ["throws"]
    with pytest.raises(ProcessLookupError):  # nobody of the session is left
        for _ in range(50):
            os.killpg(process.pid, 0)
            time.sleep(0.1)
