"""A sweep has a row for every data set, the same whoever makes it and however often it stops."""

import csv
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bsp_gp import sweep as room
from bsp_gp.cli import main
from bsp_gp.errors import DataError, OutputError, SettingsError
from bsp_gp.sweep import find_datasets, sweep

TABLE = "t,entity,x,y\n" + "\n".join(f"{k / 10},ball,{k},{3 * k - k * k / 20}" for k in range(9))
DROP = "9.81 [m/s^2] * m_i * down"


class Report:
    """As much of a report as a row tells."""

    def __init__(self, name):
        self.name = name

    def to_dict(self):
        rms = {"rollout_rmse": 0.25, "unit": "m"}
        return {
            "rounds": [{"effect": {"name": f"-c * v_{self.name}", "code": "law"},
                        "missing": {"p_value": 0.0}}],
            "total": {"before": rms, "after": rms, "floor": {**rms, "rollout_rmse": None},
                      "ratio": {"value": 1.0, "low": 0.9, "high": 1.1}},
            "law": {"text": "=1", "constants": [
                {"name": "c", "entity": "", "value": 1 / 3, "low": 0.3, "high": 0.4, "unit": "kg"}
            ]},
            "verdict": "effect adopted", "probability": 0.9, "equivalents": [], "complete": True,
        }  # fmt: skip


class Names(list):
    stop_at = ""


@pytest.fixture
def closed(monkeypatch):
    """Names of the data sets that were closed."""
    names = Names()

    def close_loop(dataset, declared, *, rng, **settings):
        names.append(dataset.name)
        if names.stop_at == dataset.name:
            raise KeyboardInterrupt
        if dataset.name == "broken":
            raise RuntimeError("<b>a defect</b>")
        return Report(dataset.name)

    monkeypatch.setattr(room, "close_loop", close_loop)
    return names


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "many"
    for name in ("a", "b", "deep/c"):
        (place / name).mkdir(parents=True)
        (place / name / "trajectories.csv").write_text(TABLE)
    (place / "d.csv").write_text(TABLE)
    (place / "a" / "notes.txt").write_text("of a")
    return place


def test_data_sets_are_found_in_folders_globs_and_tables_of_paths(folder, tmp_path):
    assert list(find_datasets([folder])) == ["a", "b", "d.csv", "deep/c"]
    assert list(find_datasets([folder / "a"])) == ["a"]
    assert list(find_datasets([f"{folder}/?"])) == ["a", "b"]
    (tmp_path / "list.csv").write_text("path,who\nmany/b,x\nmany/d.csv,y\n")
    assert list(find_datasets([tmp_path / "list.csv"])) == ["b", "d.csv"]
    (tmp_path / "list.csv").write_text("path\nmany/none\n")
    with pytest.raises(DataError, match="not there"):
        find_datasets([tmp_path / "list.csv"])
    with pytest.raises(DataError, match="no data set"):
        find_datasets([tmp_path / "nowhere"])


def test_a_stopped_sweep_goes_on_and_has_the_same_files(folder, tmp_path, closed):
    found = find_datasets([folder])
    whole = sweep(found, [DROP], tmp_path / "once")
    assert closed == ["a", "b", "d", "c"]
    out, closed.stop_at = tmp_path / "twice", "d"
    with pytest.raises(KeyboardInterrupt):
        sweep(found, [DROP], out)
    assert not (out / "summary.csv").exists()
    with (out / "rows.jsonl").open("ab") as file:  # killed while it wrote
        file.write(b'{"sweep": "00')
    with pytest.raises(SettingsError, match="other laws"):
        sweep(found, [DROP, DROP], out, resume=True)
    with pytest.raises(OutputError, match="exists already"):
        sweep(found, [DROP], out)
    closed.clear()
    with pytest.raises(KeyboardInterrupt):
        sweep(found, [DROP], out, resume=True)
    assert closed == ["d"]
    closed.stop_at = ""
    assert sweep(found, [DROP], out, resume=True) == whole
    assert closed == ["d", "d", "c"]
    for name in ("rows.jsonl", "summary.csv", "index.html"):
        assert (out / name).read_bytes() == (tmp_path / "once" / name).read_bytes()


def test_only_what_has_changed_is_closed_again(folder, tmp_path, closed):
    found = find_datasets([folder])
    sweep(found, [DROP], tmp_path / "out")
    closed.clear()
    (folder / "b" / "trajectories.csv").write_text(TABLE.replace("0.1,", "0.11,"))
    with ThreadPoolExecutor(2) as threads:
        sweep(found, [DROP], tmp_path / "out", resume=True, workers=threads)
    assert closed == ["b"]


def test_what_cannot_be_closed_has_a_row_that_says_why(folder, tmp_path, closed):
    (folder / "empty.csv").write_text("t,x,y\n")
    (folder / "broken.csv").write_text(TABLE)
    rows = {r["dataset"]: r for r in sweep(find_datasets([folder]), [DROP], tmp_path / "out")}
    assert "no rows" in rows["empty.csv"]["error"] and not rows["empty.csv"]["verdict"]
    assert "RuntimeError" in rows["broken.csv"]["error"]
    assert rows["a"]["verdict"] == "effect adopted"
    page = (tmp_path / "out" / "index.html").read_text()
    assert "<b>a defect" not in page and "a defect&lt;/b&gt;" in page
    with (tmp_path / "out" / "summary.csv").open(newline="") as file:
        (table,) = [r for r in csv.DictReader(file) if r["dataset"] == "a"]
    assert table["law"] == "'=1"  # no formula to a spreadsheet
    assert table["constants"] == "c = 0.333333 (0.3 to 0.4) kg"


def test_a_slip_in_the_law_shows_before_the_work(folder, tmp_path, capsys):
    assert main(["sweep", str(folder), "--declare", "9.81 * nonsense(", "--out",
                 str(tmp_path / "o"), "--quiet"]) == 2  # fmt: skip
    assert "law" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_a_sweep_of_processes_killed_twice_makes_the_same_table(tmp_path):
    made = ["make", "fall", "--scenes", "3", "--frames", "25", "--effect", "drag=0.3",
            "--undeclared", "--quiet"]  # fmt: skip
    for seed in range(4):
        out = tmp_path / "many" / f"d{seed}"
        assert main([*made, "--seed", str(seed), "--out", str(out)]) == 0
    words = [sys.executable, "-m", "bsp_gp", "sweep", str(tmp_path / "many" / "d?"), "--declare",
             DROP, "--bootstrap", "0", "--quiet"]  # fmt: skip
    subprocess.run([*words, "--out", str(tmp_path / "once")], check=True)
    rows = tmp_path / "twice" / "rows.jsonl"
    for count in (1, 2):
        process = subprocess.Popen(
            [*words, "--workers", "2", "--resume", "--out", str(tmp_path / "twice")]
        )
        while process.poll() is None and not _has_lines(rows, count):
            time.sleep(0.05)
        process.kill()
        process.wait()
    subprocess.run(
        [*words, "--workers", "2", "--resume", "--out", str(tmp_path / "twice")], check=True
    )
    for name in ("summary.csv", "index.html"):
        once, twice = (Path(tmp_path / run / name).read_bytes() for run in ("once", "twice"))
        assert once == twice


def _has_lines(path, count):
    return path.exists() and path.read_bytes().count(b"\n") >= count
