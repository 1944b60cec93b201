"""Folders of studies: held by one process, resumed, and nothing in them that is not theirs lost."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
STUDY = (
    "import sys\n"
    "from common import options, run_jobs, write_text\n"
    "def work(k):\n"
    "    return [{'k': k, 'square': k * k}]\n"
    "if __name__ == '__main__':\n"
    "    args = options('a study')\n"
    "    run_jobs([(k,) for k in range(3)], work, args.out, args.workers)\n"
    "    write_text('done', args.out / 'summary.md')\n"
)
MANY = (
    "import sys\n"
    "from pathlib import Path\n"
    "from common import write_text\n"
    "for k in range(10):\n"
    "    write_text('x', Path(sys.argv[1]) / f'{sys.argv[2]}-{k}.txt')\n"
)


def run(text, *words, **env):
    places = os.pathsep.join([str(ROOT / "experiments"), str(ROOT)])
    env = {**os.environ, "PYTHONPATH": places, **env}
    return subprocess.run(
        [sys.executable, "-c", text, *map(str, words)],
        capture_output=True, text=True, env=env, check=False,
    )  # fmt: skip


def names(folder):
    return sorted(p.name for p in folder.iterdir())


@pytest.mark.slow
def test_a_study_is_resumed_and_leaves_other_files_alone(tmp_path):
    out = tmp_path / "far" / "out"
    assert run(STUDY, "--out", out).returncode == 0
    assert names(out) == [".bsp_gp", "results.csv", "summary.md"]
    assert names(out.parent) == ["out"]
    (out / "notes.md").write_text("mine")
    assert run(STUDY, "--out", out).returncode == 0
    assert (out / "notes.md").read_text() == "mine"
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "summary.md").write_text("mine")
    end = run(STUDY, "--out", mine)
    assert end.returncode == 2 and end.stderr.count("\n") == 1 and "never overwritten" in end.stderr
    assert names(mine) == ["summary.md"]


def test_a_file_that_no_study_wrote_is_not_overwritten(tmp_path):
    assert run(STUDY, "--out", tmp_path / "out").returncode == 0
    mark = tmp_path / "out" / ".bsp_gp"
    content = json.loads(mark.read_text())
    del content["files"]["summary.md"]
    mark.write_text(json.dumps(content))
    end = run(STUDY, "--out", tmp_path / "out")
    assert end.returncode and "summary.md: is not of this study" in end.stderr
    assert "Traceback" not in end.stderr


@pytest.mark.parametrize("where", [".", "data/runs", "link"])
def test_a_study_does_not_write_into_the_reference_data(tmp_path, where):
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "data")
    end = run(STUDY, "--out", tmp_path / where, BSP_GP_DATA=str(tmp_path / "data"))
    assert end.returncode == 2 and "the input" in end.stderr and end.stderr.count("\n") == 1
    assert names(tmp_path) == ["data", "link"] and not names(tmp_path / "data")


def test_processes_of_a_study_list_their_files_by_turns(tmp_path):
    assert run(MANY, tmp_path / "out", "0").returncode == 0
    with ThreadPoolExecutor(2) as pool:
        ends = list(pool.map(lambda who: run(MANY, tmp_path / "out", who), "ab"))
    assert [end.stderr for end in ends] == ["", ""]
    listed = json.loads((tmp_path / "out" / ".bsp_gp").read_text())["files"]
    assert len(listed) == 30 and set(names(tmp_path / "out")) == {".bsp_gp", *listed}
