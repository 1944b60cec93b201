"""Every class of bad input through the whole command: one line, status 2, nothing left behind."""

import errno
import json

import pytest

from bsp_gp.cli import main
from bsp_gp.data import sources

T, E, D, M = "trajectories.csv", "entities.csv", "dataset.toml", "model.toml"
ROWS = [f"{s},{k / 10:g},ball,{k * v:g},{5 - k * k * 0.0490500:.6f}"
        for s, v in (("a", 0.1), ("b", 0.2), ("c", 0.3), ("d", 0.4)) for k in range(6)]
GOOD = "\n".join(["scene,t,entity,x,y", *ROWS, ""])
FALLING_DOWN = "\n".join(
    ["scene,t,entity,x,y", *(f"a,0.{k},ball,{k},{0.049 * k * k:.4f}" for k in range(9)), ""]
)
BODIES = "entity,mass,radius\nball,0.5,0.05\n"
TOML = '[units]\nlength = "m"\ntime = "s"\nmass = "kg"\n[axes]\nup = "y"\n'
FILES = {T: GOOD, E: BODIES, D: TOML}
LAW = "9.81 [m/s^2] * m_i * down"


def edit(old, new, text=GOOD):
    assert old in text
    return text.replace(old, new, 1)


def lines(*numbers):
    """The header and these lines (from 2) of the table."""
    all_lines = GOOD.splitlines()
    return "\n".join([all_lines[0], *(all_lines[n - 1] for n in numbers), ""])


# id: (what the files are instead, what the message must say)
DATA = {
    "missing column": ({T: edit(",y", ",gap")}, ["no column 'y'", "gap"]),
    "text in a number": ({T: edit("ball,0.1,", "ball,ten,")}, ["line 3", "column x", "'ten'"]),
    "text in a time": ({T: edit("a,0.1", "a,soon")}, ["line 3", "column t", "'soon'"]),
    "empty cell": ({T: edit("ball,0.1,", "ball,,")}, ["line 3", "column x"]),
    "NaN": ({T: edit("ball,0.1,", "ball,nan,")}, ["line 3", "column x"]),
    "infinite": ({T: edit("ball,0.1,", "ball,-inf,")}, ["line 3", "column x", "finite"]),
    "absurd number": ({T: edit("ball,0.1,", "ball,1e200,")}, ["line 3", "column x"]),
    "unsorted time": ({T: edit("a,0.2", "a,0.05")}, ["line 4", "column t", "increase"]),
    "duplicate time": ({T: edit("a,0.2", "a,0.1")}, ["line 4", "duplicate"]),
    "unknown entity": ({E: edit("ball", "bal", BODIES)}, ["'ball'", "bal"]),
    "one frame": ({T: lines(2)}, ["1 frame", "at least 3"]),
    "two frames": ({T: lines(2, 3)}, ["2 frame", "at least 3"]),
    "zero mass": ({E: edit("0.5", "0", BODIES)}, [E, "line 2", "column mass", "positive"]),
    "negative mass": ({E: edit("0.5", "-1", BODIES)}, [E, "line 2", "positive"]),
    "text in a mass": ({E: edit("0.5", "heavy", BODIES)}, [E, "line 2", "column mass"]),
    "unknown unit": ({D: edit('"m"', '"ells"', TOML)}, [D, "'ells'"]),
    "unit of another kind": ({D: edit('"m"', '"K"', TOML)}, [D, "'K'"]),
    "unit of time missing": ({D: edit('time = "s"\n', "", TOML)}, ["[m/s^2]", "--units length=m"]),
    "no units at all": ({D: '[axes]\nup = "y"\n'}, ["[m/s^2]", "--units length=m time=s"]),
    "pixels": ({D: edit('"m"', '"px"', TOML)}, ["[m/s^2]", "[units]"]),
    "no vertical": (
        {D: edit('up = "y"', "", TOML), T: FALLING_DOWN}, ["'down'", "--up y", "--up=-x"],
    ),
    "unknown shape": ({E: "entity,shape,mass\nball,egg,1\n"}, [E, "line 2", "'egg'"]),
    "two entities at one point": (
        {T: GOOD + "a,0,b,0,5\na,0.1,b,1,1\n", E: BODIES + "b,1,1\n"}, ["'b'", "one point"],
    ),
    "empty table": ({T: ""}, [T, "empty"]),
    "header only": ({T: lines()}, [T, "no rows"]),
    "no header": ({T: GOOD.partition("\n")[2]}, [T, "line 1"]),
    "ragged": ({T: edit("ball,0.1,", "ball,")}, [T, "line 3", "cells"]),
    "open quote": ({T: edit("a,0.1,ball", 'a,0.1,"ball')}, [T, "line 3"]),
    "two encodings": (
        {T: edit("ball", "Bälle").encode("cp1252") + "a,9,Bälle,0,0\n".encode()},
        [T, "line 2", "UTF-8"],
    ),
    "UTF-16 that does not say so": ({T: GOOD.encode("utf-16-le")}, [T, "UTF-16"]),
    "a picture": ({T: b"\x89PNG\r\n\x1a\n\x00\x00\x01"}, [T, "UTF-8"]),
    "unreadable TOML": ({D: "[units\n"}, [D, "line 1", "TOML"]),
    "TOML in another encoding": ({D: 'name = "Bälle"'.encode("cp1252")}, [D, "UTF-8"]),
    "unknown key": ({D: "fsp = 30\n"}, [D, "'fsp'", "fps"]),
    "overlapping split": (
        {D: TOML + '[split]\ntrain = ["a", "b"]\ntest = ["b", "c"]\n'}, [D, "b", "both"],
    ),
    "split of nothing": ({D: TOML + '[split]\ntest = "z*"\n'}, [D, "'z*'"]),
    "all in train": ({D: TOML + '[split]\ntrain = "*"\n'}, ["nothing is held out"]),
    "all in test": ({D: TOML + '[split]\ntest = "*"\n'}, ["nothing is left to train on"]),
    "negative noise": ({D: "noise = -1\n" + TOML}, [D, "noise"]),
    "no table": ({T: None, "tracks.csv": GOOD}, [f"no {T}", "tracks.csv"]),
    "nothing moves": (
        {T: "\n".join(["t,entity,x,y", *(f"{k},ball,1,1" for k in range(6)), ""])},
        ["nothing moves"],
    ),
    "nothing is dynamic": ({E: "entity,mass,dynamic\nball,1,0\n"}, ["dynamic"]),
}  # fmt: skip

# id: (words after `close DATA`, what the message must say)
ARGUMENTS = {
    "no law": ([], ["--declare"]),
    "empty law": (["--declare", ""], ["law"]),
    "code": (["--declare", "__import__('os').system('touch pwned')"], ["position 1"]),
    "code in a call": (["--declare", "open(m_i) * down"], ["unknown function 'open'"]),
    "attribute": (["--declare", "m_i.real * down"], ["unexpected '.'"]),
    "walrus": (["--declare", "(m_i := 3) * down"], ["unexpected ':'"]),
    "lambda": (["--declare", "lambda x: x"], ["unexpected ':'"]),
    "line break": (["--declare", "m_i\n* 9.81 [m/s^2] * (down"], ["law"]),
    "NUL": (["--declare", "m_i\0 * down"], ["NUL"]),
    "other script": (["--declare", "m_i * dоwn"], ["unexpected 'о'"]),
    "half a character": (["--declare", "m_i * \udcff"], ["unexpected"]),
    "endless law": (["--declare", "m_i * " * 5000 + "down"], ["2000 characters"]),
    "deep law": (["--declare", "(" * 900 + "m_i" + ")" * 900 + "* down"], ["nested"]),
    "huge number": (["--declare", "1e999 * m_i * down"], ["too large"]),
    "unbalanced": (["--declare", "(m_i * down"], ["cannot be read"]),
    "not a force": (["--declare", "m_i"], ["a force has kg m/s^2"]),
    "no direction": (["--declare", "c1 * m_i"], ["a force must be a vector"]),
    "wrong unit of a law": (["--declare", "9.81 [m/s] * m_i * down"], ["unit"]),
    "unit left out": (["--declare", "9.81 * 2.5 * m_i * down"], ["9.81 [m/s^2]"]),
    "unknown unit in a law": (["--declare", "9.81 [ells] * m_i * down"], ["'ells'"]),
    "unknown property": (["--declare", "q_i * v_i"], ["charge", "q_i"]),
    "second body of one": (["--declare", "c1 * (p_j - p_i)"], ["second body"]),
    "unknown grammar": (["--declare", LAW, "--grammar", "latin"], ["'latin'", "newtonian"]),
    "broken grammar": (["--declare", LAW, "--grammar", M], [M]),
    "unknown search": (["--declare", LAW, "--search", "luck"], ["--search", "exhaustive"]),
    "alpha": (["--declare", LAW, "--alpha", "1"], ["--alpha", "'1'"]),
    "alpha is no number": (["--declare", LAW, "--alpha", "nan"], ["--alpha", "'nan'"]),
    "seed": (["--declare", LAW, "--seed", "-3"], ["--seed", "'-3'"]),
    "rounds": (["--declare", LAW, "--max-rounds", "0"], ["--max-rounds", "'0'"]),
    "absurd size": (["--declare", LAW, "--max-levels", "99999999"], ["--max-levels"]),
    "absurd number of digits": (["--declare", LAW, "--seed", "9" * 5000], ["--seed"]),
    "workers": (["--declare", LAW, "--workers", "many"], ["--workers", "'many'"]),
    "excluded input": (["--declare", LAW, "--exclude", "zz"], ["zz", "v_i"]),
    "unknown option": (["--declare", LAW, "--fast"], ["--fast"]),
    "abbreviated option": (["--declare", LAW, "--over"], ["--over"]),
    "units without value": (["--declare", LAW, "--units", "length"], ["NAME=VALUE"]),
    "units twice": (["--declare", LAW, "--units", "length=m", "length=cm"], ["twice"]),
    "units after a comma": (["--declare", LAW, "--units", "length=m,time"], ["'time'", "KIND"]),
    "unit of nothing": (["--declare", LAW, "--units", "depth=m"], ["'depth'"]),
    "unknown unit": (["--declare", LAW, "--units", "length=ells"], ["'ells'"]),
    "up": (["--declare", LAW, "--up", "north"], ["--up", "'north'"]),
    "up in 2-D": (["--declare", LAW, "--up", "z"], ["x, y"]),
    "both clocks": (["--declare", LAW, "--fps", "10", "--dt", "0.1"], ["--dt", "--fps"]),
    "zero rate": (["--declare", LAW, "--fps", "0"], ["--fps", "positive"]),
    "noise": (["--declare", LAW, "--noise", "-1"], ["--noise", "not negative"]),
    "noise of too many axes": (["--declare", LAW, "--noise", "1", "1", "1"], ["--noise"]),
    "overlap": (["--declare", LAW, "--train", "a", "b", "--test", "b"], ["both"]),
    "scene unknown": (["--declare", LAW, "--train", "z"], ["'z'"]),
    "column unknown": (["--declare", LAW, "--columns", "x=X"], ["'X'"]),
    "no model file": (["--model", "nowhere.toml"], ["nowhere.toml", "No such file"]),
    "model is a folder": (["--model", "."], ["directory"]),
    "broken model": (["--model", M], [M, "TOML"]),
    "two models": (["--model", M, "--declare", LAW], ["--declare", "--model"]),
    "out is a file": (["--declare", LAW, "--out", M], ["is a file"]),
    "out is here": (["--declare", LAW, "--out", "."], ["folder of its own"]),
}

# id: (all words, what the message must say)
COMMANDS = {
    "nothing": ([], ["COMMAND"]),
    "unknown command": (["open", "data"], ["'open'", "close"]),
    "no such data": (["close", "nowhere", "--declare", LAW], ["nowhere", "no such"]),
    "name too long": (["close", "n" * 5000, "--declare", LAW], ["too long"]),
    "NUL in a name": (["close", "a\0b", "--declare", LAW], ["NUL"]),
    "empty name": (["fit", "", "--law", LAW], [""]),
    "fit: not a force": (["fit", "data", "--law", "c1 * m_i"], ["vector"]),
    "fit: out below a file": (["fit", "data", "--law", LAW, "--out", f"{M}/z"], ["is a file"]),
    "fit: parents of out": (["fit", "data", "--law", "c1 * m_i", "--out", "x/y/z"], ["vector"]),
    "simulate: no out": (["simulate", "data", "--law", LAW], ["--out"]),
    "simulate: no value": (
        ["simulate", "data", "--law", "c1 * v_i", "--out", "out"], ["'c1'", "--set c1="],
    ),
    "simulate: no number": (
        ["simulate", "data", "--law", "c1 * v_i", "--set", "c1=x", "--out", "out"], ["c1=x"],
    ),
    "simulate: unknown unit": (
        ["simulate", "data", "--law", "c1 * v_i", "--set", "c1=1 [ells]", "--out", "out"],
        ["'ells'"],
    ),
    "simulate: infinite": (
        ["simulate", "data", "--law", "c1 * v_i", "--set", "c1=inf", "--out", "out"], ["finite"],
    ),
    "simulate: unknown constant": (
        ["simulate", "data", "--law", LAW, "--set", "c1=1", "--out", "out"], ["'c1'", "none"],
    ),
    "simulate: it explodes": (
        ["simulate", "data", "--law", "1e300 [kg/s] * v_i", "--out", "out"], ["range of numbers"],
    ),
    "simulate: substeps": (
        ["simulate", "data", "--law", LAW, "--substeps", "1e9", "--out", "out"], ["--substeps"],
    ),
    "grammar: no action": (["grammar"], ["ACTION"]),
    "grammar: unknown": (["grammar", "show", "latin"], ["'latin'", "newtonian, newtonian_free"]),
    "grammar: broken": (["grammar", "count", M], [M, "TOML"]),
    "grammar: absurd": (["grammar", "count", "newtonian", "--levels", "1000000"], ["--levels"]),
    "grammar: no data": (["grammar", "show", "physics", "--data", "nowhere"], ["nowhere"]),
    "demo: seed": (["demo", "--seed", "x"], ["--seed", "'x'"]),
}  # fmt: skip


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Current folder with good data and a broken TOML file."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path, FILES)
    (tmp_path / M).write_text("declare = [\n", encoding="utf-8")
    return tmp_path


def write(place, files):
    folder = place / "data"
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        if content is None:
            (folder / name).unlink()
        else:
            data = content if isinstance(content, bytes) else content.encode("utf-8")
            (folder / name).write_bytes(data)


def tree(place):
    return sorted(p.relative_to(place).as_posix() for p in place.rglob("*"))


def complaint(words, place, capsys):
    """Run a command that must fail, and give its one line."""
    before = tree(place)
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("bsp-gp: error: "), captured.err
    assert captured.err.count("\n") == 1 and captured.err.endswith("\n"), captured.err
    assert "Traceback" not in captured.err
    assert tree(place) == before
    return captured.err


@pytest.mark.parametrize("defect", DATA)
def test_defect_of_the_data(defect, place, capsys):
    files, expected = DATA[defect]
    write(place, files)
    error = complaint(["close", "data", "--declare", LAW, "--out", "out"], place, capsys)
    for part in expected:
        assert part in error


@pytest.mark.parametrize("defect", ARGUMENTS)
def test_bad_argument(defect, place, capsys):
    words, expected = ARGUMENTS[defect]
    out = [] if "--out" in words else ["--out", "out"]
    error = complaint(["close", "data", *words, *out], place, capsys)
    for part in expected:
        assert part in error


@pytest.mark.parametrize("defect", COMMANDS)
def test_bad_command(defect, place, capsys):
    words, expected = COMMANDS[defect]
    error = complaint(words, place, capsys)
    for part in expected:
        assert part in error


@pytest.mark.slow
@pytest.mark.parametrize("law", ["c1 * 9^9^9^9^9 * m_i * down", "c1 / 0 * m_i * down"])
def test_a_law_without_a_finite_value_is_no_fit(law, place, capsys):
    assert main(["close", "data", "--declare", law, "--out", "out"]) == 0
    data = json.loads((place / "out" / "report.json").read_text("utf-8"))
    assert (data["verdict"], data["stop_reason"]) == ("cannot tell", "failed")
    assert data["rounds"][0]["reason"] == "declared_model_not_fitted"


def test_a_track_too_short_to_hold_anything_out_is_told(place, capsys):
    write(place, {T: lines(2, 3, 4, 5)})
    assert main(["close", "data", "--declare", LAW, "--out", "out"]) == 0
    data = json.loads((place / "out" / "report.json").read_text("utf-8"))
    assert "too short" in data["dataset"]["split"]
    assert data["dataset"]["test"] == []
    assert data["verdict"] in ("nothing missing", "cannot tell")


@pytest.mark.parametrize("command", [["close", "data", "--declare"], ["fit", "data", "--law"]])
def test_unknown_mass(command, place, capsys):
    moon = "".join(f"{s},{k / 10:g},moon,9,{k}\n" for s in "abcd" for k in range(6))
    write(place, {T: GOOD + moon, E: edit("0.5", "", BODIES) + "moon,1,1\n"})
    error = complaint([*command, "c1 * m_i * v_i * norm(v_i) / m_i", "--out", "out"], place, capsys)
    for part in ("'ball'", "entities.csv", "unknown"):
        assert part in error


@pytest.mark.parametrize(("limit", "value"), [("MAX_ROWS", 5), ("MAX_BYTES", 50)])
def test_too_much_data(limit, value, place, capsys, monkeypatch):
    monkeypatch.setattr(sources, limit, value)
    complaint(["close", "data", "--declare", LAW, "--out", "out"], place, capsys)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "report.html"), "No space left"),
        (MemoryError(), "not enough memory"),
    ],
)
def test_trouble_of_the_machine(error, expected, place, capsys, monkeypatch):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr("bsp_gp.loop.close.close_loop", fail)
    assert expected in complaint(
        ["close", "data", "--declare", LAW, "--out", "out"], place, capsys
    )


def test_a_full_disk_leaves_nothing(place, capsys, monkeypatch):
    def full(self, *args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    monkeypatch.setattr("pathlib.Path.write_text", full)
    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    for words in (["fit", "data", "--law", LAW], ["simulate", "data", "--law", LAW]):
        assert "No space left" in complaint([*words, "--out", "out"], place, capsys)


def test_good_input_is_good(place, capsys):
    assert main(["fit", "data", "--law", LAW, "--out", "out"]) == 0
    assert "out/fit.json" in tree(place)
