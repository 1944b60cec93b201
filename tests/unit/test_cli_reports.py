"""Older reports: shown, run again, and read from Python."""

import json
import re
import shlex
import shutil
import subprocess

import numpy as np
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.cli_reports import first_difference
from bsp_gp.errors import DataError
from bsp_gp.report.page import page_of
from bsp_gp.report.summary import summary_text
from tests.throws import throws_folder

WEIGHT = "9.81 [m/s^2] * m_i * down"
FAST = ["--max-levels", "2", "--max-rounds", "1", "--bootstrap", "2", "--quiet"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A report beside its data, made from there."""
    place = tmp_path_factory.mktemp("place")
    throws_folder(place / "throws", noise=(0.0,))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main(["close", "throws", "--declare", WEIGHT, "--out", "found", *FAST]) == 0
    return place / "found"


@pytest.mark.slow
def test_a_report_is_read_back(folder):
    report = bsp_gp.load_report(folder)
    told = json.loads((folder / "report.json").read_text("utf-8"))
    assert json.loads(json.dumps(report.to_dict())) == told
    assert report.verdict == told["verdict"] and bsp_gp.load_report(folder / "report.json")
    assert report.law.text().startswith("9.81")
    assert len(report.residuals) == len((folder / "residuals.csv").read_text().splitlines()) - 1
    again = bsp_gp.simulate_law(bsp_gp.load_dataset(folder.parent / "throws"), report.law)
    assert np.isfinite(again.scenes[0].positions).all()
    assert page_of(report).rounds[0].effect is None or page_of(report).rounds[0].effect.name


def test_where_a_trace_tells_nothing_its_error_is_infinite(folder, tmp_path):
    told = json.loads((folder / "report.json").read_text("utf-8"))
    trace = next(r["trace"] for r in told["rounds"] if r["trace"] and r["trace"]["errors"])
    trace["errors"][0] = None  # as JSON writes it
    (tmp_path / "report.json").write_text(json.dumps(told), "utf-8")
    report = bsp_gp.load_report(tmp_path / "report.json")
    assert np.isinf(next(r.trace for r in report.rounds if r.trace and r.trace.errors).errors[0])
    assert page_of(report).rounds


def test_numbers_that_are_not_known_come_back_as_such(folder, tmp_path):
    """They came back as nothing, and `show` ended with a traceback where units are not SI."""
    told = json.loads((folder / "report.json").read_text("utf-8"))
    told["dataset"]["units"]["length"] = "cm"
    told["total"]["after"]["residual_acceleration"] = None
    told["rounds"][0]["before"]["residual_acceleration"] = None
    for constant in told["law"]["constants"]:
        constant["low"] = None
    (tmp_path / "report.json").write_text(json.dumps(told), "utf-8")
    report = bsp_gp.load_report(tmp_path)
    assert np.isnan(report.total["after"].residual_acceleration)
    assert np.isnan(report.rounds[0].before.residual_acceleration)
    assert summary_text(report)


@pytest.mark.parametrize("content", ["{}", "[]", "{", '{"schema": "other"}', None])
def test_what_is_no_report_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "report.json").write_text(content)
    with pytest.raises(DataError, match="report"):
        bsp_gp.load_report(tmp_path)


def test_show_prints_the_summary_and_where_the_page_is(folder, capsys):
    assert main(["show", str(folder), "--no-open"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(summary_text(bsp_gp.load_report(folder)))
    assert out.splitlines()[-1] == f"Report: {folder / 'report.html'}"
    assert main(["show", str(folder.parent), "--no-open"]) == 2
    assert "no report" in capsys.readouterr().err


@pytest.mark.slow
def test_rerun_says_whether_the_answer_is_the_same(folder, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # from anywhere
    before = (folder / "report.json").read_bytes()
    assert main(["rerun", str(folder), "--quiet"]) == 0
    assert capsys.readouterr().out == "The same, bit for bit.\n"
    assert (folder / "report.json").read_bytes() == before
    table = folder.parent / "throws" / "trajectories.csv"
    text = table.read_text()
    try:
        table.write_text(re.sub(r"\.(\d)(\d*)\n$", r".\g<1>9\n", text))
        assert text != table.read_text()
        assert main(["rerun", str(folder), "--quiet"]) == 1
    finally:
        table.write_text(text)
    assert "Not the same: report.dataset." in capsys.readouterr().out


def test_what_was_made_from_python_cannot_be_run_again(folder, tmp_path, capsys):
    for name in ("report.json", "run.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "run.json").write_text("{}")
    assert main(["rerun", str(tmp_path)]) == 2
    assert "from Python" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
@pytest.mark.parametrize(
    ("typed", "found"),
    [(["bsp-gp", "clo"], ["close"]), (["bsp-gp", "close", "x", "--declar"], ["--declare"]),
     (["bsp-gp", "show", "--no"], ["--no-open"]), (["bsp-gp", "close", "x", "--per-e"], []),
     (["bsp-gp", "make", "pe"], ["pendulum"]), (["bsp-gp", "make", "x", "pe"], []),
     (["bsp-gp", "grammar", "ch"], ["check"]), (["bsp-gp", "completion", "z"], ["zsh"]),
     (["bsp-gp", "grammar", "check", "--da"], ["--data"]),
     (["bsp-gp", "close", "x", "--search", "ge"], ["genetic"])],
)  # fmt: skip
def test_a_shell_completes_commands_and_options(typed, found, capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    words = " ".join(map(shlex.quote, typed))
    ask = f'COMP_WORDS=({words}); COMP_CWORD={len(typed) - 1}; _bsp_gp; echo "${{COMPREPLY[@]}}"'
    run = subprocess.run(["bash", "-c", script + ask], capture_output=True, text=True, check=True)
    assert run.stdout.split() == found and not run.stderr


def test_first_difference_names_the_place():
    one = {"a": [1, {"b": 2.0}], "wall_s": 3}
    assert first_difference(one, {"a": [1, {"b": 2.0}], "wall_s": 4}) == ""
    assert first_difference(one, {"a": [1, {"b": 2.5}]}) == "report.a[1].b: 2.0 and 2.5"
    assert first_difference(one, {"a": [1]}).startswith("report.a: ")
