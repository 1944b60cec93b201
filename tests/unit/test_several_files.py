"""Several files as one data set."""

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.errors import DataError


def write(path, scale=1.0, header="Time (s),Distance (m)", n=30):
    t = 0.1 * np.arange(n)
    rows = "".join(f"{a:.2f},{scale * (0.3 + 0.9 * a - 0.2 * a * a):.5f}\n" for a in t)
    path.write_text(f"{header}\n{rows}", encoding="utf-8")
    return str(path)


@pytest.fixture
def ramps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return [write(tmp_path / f"ramp_{k}.csv", s) for k, s in (("a", 1.0), ("b", 1.1), ("c", 1.2))]


def test_every_file_is_a_scene(ramps):
    data = bsp_gp.load_dataset(ramps, test="ramp_c", properties={"mass": "0.3[kg]"})
    assert [scene.name for scene in data.scenes] == ["ramp_a", "ramp_b", "ramp_c"]
    assert data.name == "ramp" and data.test == ("ramp_c",) and data.train == ("ramp_a", "ramp_b")
    assert len([key for key in data.provenance if key.startswith("sha256")]) == 3
    assert len([note for note in data.notes if "no column 'y'" in note]) == 1
    assert data.scenes[2].entities[0].mass == 0.3
    assert data.scenes[1].positions[0, 0, 0] == pytest.approx(0.33)


def test_a_folder_of_nothing_but_tables_is_all_of_them(ramps, tmp_path):
    folder = tmp_path / "ramps"
    folder.mkdir()
    for k in (9, 10):
        write(folder / f"clip{k}.csv")
    data = bsp_gp.load_dataset(folder, properties={"mass": 0.3})
    assert [scene.name for scene in data.scenes] == ["clip9", "clip10"] and data.name == "ramps"
    assert main(["check", str(folder)]) == 0
    (folder / "film.mp4").touch()  # who knows what else is there
    with pytest.raises(DataError, match="no trajectories.csv"):
        bsp_gp.load_dataset(folder)


@pytest.mark.parametrize("words", [["check"], ["fit", "--law", "a * m_i * e_x"]])
def test_commands_take_several(ramps, words, capsys):
    assert main([words[0], *ramps, *words[1:]]) == 0
    out = capsys.readouterr().out
    assert "Scene ramp_b: 30 rows" in out or "data set           = ramp;" in out


@pytest.mark.slow
def test_the_report_is_called_by_what_they_have_in_common(ramps, tmp_path, capsys):
    words = ["close", *ramps, "--declare", "g * m_i * e_x", "--max-rounds", "1", "--max-levels",
             "2", "--bootstrap", "0", "--quiet"]  # fmt: skip
    assert main(words) == 0
    assert (tmp_path / "ramp-report" / "report.html").is_file()


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("Time (s),Distance (cm)", r"odd\.csv.*x is in cm, and in m in ramp_a\.csv"),
        ("Time (s),y (m)", r"odd\.csv"),
    ],
)
def test_columns_and_units_must_agree(ramps, tmp_path, header, message):
    odd = write(tmp_path / "odd.csv", header=header)
    with pytest.raises(DataError, match=message):
        bsp_gp.load_dataset([*ramps, odd])


def test_runs_of_a_file_keep_their_names(ramps, tmp_path):
    frame = pd.DataFrame({"run": np.repeat([1, 2], 5), "t": np.tile(np.arange(5.0), 2)})
    frame["x"] = frame["t"] ** 2
    for name in ("first", "second"):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    frame.assign(run=frame["run"] + 6).to_csv(tmp_path / "third.csv", index=False)
    names = ("first", "third")
    data = bsp_gp.load_dataset([tmp_path / f"{name}.csv" for name in names])
    assert [scene.name for scene in data.scenes] == ["1", "2", "7", "8"]
    names = ("first", "second")
    data = bsp_gp.load_dataset([tmp_path / f"{name}.csv" for name in names])
    assert [scene.name for scene in data.scenes] == ["first 1", "first 2", "second 1", "second 2"]


def test_a_file_that_is_given_twice_is_refused(ramps):
    with pytest.raises(DataError, match="give every file once"):
        bsp_gp.load_dataset([ramps[0], ramps[0]])
