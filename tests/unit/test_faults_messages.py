"""Input that is hostile or broken: status 2 and one line on stderr, or no error; no traceback."""

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.cli import main
from bsp_gp.data.tables import load_dataset
from bsp_gp.data.toml import TomlError, parse_toml
from bsp_gp.fitting.law_fit import fit_law
from tests.throws import DRAG, throws_folder

FAST = ["--max-rounds", "1", "--max-levels", "2", "--quiet"]
DIGITS = "9" * 10_000
NESTED = {
    "digits": f"noise = {DIGITS}",
    "hex digits": f"noise = 0x{'f' * 10_000}",
    "65 bits": f"noise = {2**64}",
    "range": f'[split]\ntrain = "1..{DIGITS}"',
    "inline tables": "noise = " + "{a = " * 3000 + "1" + "}" * 3000,
    "lists": "noise = " + "[" * 3000 + "]" * 3000,
    "dotted": "noise." + "a." * 3000 + "b = 1",
    "header": f"[{'a.' * 3000}b]",
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return throws_folder(tmp_path_factory.mktemp("data") / "throws", sigma=0.001)


def refused(words, capsys):
    assert main([str(word) for word in words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert captured.err.startswith("bsp-gp: error: ") and len(captured.err) < 1000
    return captured.err


@pytest.mark.parametrize("text", NESTED.values(), ids=NESTED)
def test_toml_beyond_all_bounds(text, data, tmp_path, capsys):
    folder = shutil.copytree(data, tmp_path / "data")
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    assert "dataset.toml" in refused(["fit", folder, "--law", DRAG], capsys)
    for kind in ("model", "grammar"):
        path = tmp_path / f"{kind}.toml"
        path.write_text(text, encoding="utf-8")
        words = ["--model", path] if kind == "model" else ["--declare", DRAG, "--grammar", path]
        assert path.name in refused(["close", data, *words, *FAST], capsys)


def test_toml_within_the_bounds_is_read():
    assert parse_toml(f"\ufeffa = {2**63 - 1}\nb = -{2**63}".encode()) == {
        "a": 2**63 - 1, "b": -(2**63),
    }  # fmt: skip
    assert parse_toml(b"a = " + b"[" * 30 + b"]" * 30)["a"]
    with pytest.raises(TomlError):
        parse_toml(b"a = [")


@pytest.mark.skipif(os.name != "posix", reason="links and special files of POSIX")
@pytest.mark.parametrize("kind", ["loop", "device", "folder", "missing", "long"])
@pytest.mark.parametrize("where", ["data", "model", "grammar", "trajectories", "toml"])
def test_unreadable_places(kind, where, data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bad = tmp_path / "bad.toml"
    if kind == "loop":
        bad.symlink_to(bad)
    elif kind == "device":
        bad.symlink_to("/proc/self/mem")
        if not os.path.exists("/proc/self/mem"):
            pytest.skip("no such file here")
    elif kind == "folder":
        bad.mkdir()
    elif kind == "long":
        bad = tmp_path / ("x" * 300 + ".toml")
    words = ["close", data, "--declare", DRAG]
    if where == "data":
        words[1] = bad
    elif where in ("model", "grammar"):
        words += [f"--{where}", bad]
        words = words if where == "grammar" else [*words[:2], *words[4:]]
    else:
        if kind in ("missing", "long"):
            pytest.skip("nothing to be read")
        folder = shutil.copytree(data, tmp_path / "data")
        path = folder / {"trajectories": "trajectories.csv", "toml": "dataset.toml"}[where]
        path.unlink()
        bad.rename(path)
        if kind == "loop":
            path.unlink()
            path.symlink_to(path)
        words[1] = folder
    refused([*words, *FAST], capsys)
    refused([*words, *FAST, "--out", "chosen"], capsys)


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["p", "v", "s", "p_x,p_y"])
def test_a_property_named_as_a_state_is_left_out_and_told(columns, data, tmp_path, capsys):
    folder = shutil.copytree(data, tmp_path / "data")
    n = columns.count(",") + 1
    (folder / "entities.csv").write_text(
        f"entity,mass,{columns}\nball,0.5,{','.join('7' * n)}\n", encoding="utf-8"
    )
    dataset = load_dataset(folder)
    assert dataset.scenes[0].entities[0].properties == {"mass": 0.5}
    assert any(columns.split(",")[0] in note for note in dataset.notes)
    if columns == "p":  # the loop follows everything that is left along every input
        words = ["close", str(folder), "--declare", DRAG, *FAST, "--out", str(tmp_path / "out")]
        assert main(words) == 0


def test_a_property_named_as_a_state_in_python_leaves_laws_their_state(data):
    dataset = load_dataset(data)
    scenes = tuple(
        replace(s, entities=tuple(replace(e, properties={**e.properties, "v": 7.0})
                                  for e in s.entities))
        for s in dataset.scenes
    )  # fmt: skip
    found = fit_law(replace(dataset, scenes=scenes), [DRAG], rng=np.random.default_rng(0))
    plain = fit_law(dataset, [DRAG], rng=np.random.default_rng(0))
    assert found.constants[0].value == plain.constants[0].value


def test_frames_beyond_all_bounds(capsys):
    refused(["track", "x.mp4", "--object", "a=disc:red", "--frames", f"1..{DIGITS}"], capsys)
