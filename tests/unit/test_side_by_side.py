"""Bodies side by side under odd headings: read, or named as left out, never dropped silently."""

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import DataError

MASSES = {"mass": {"red": "69.3[g]", "blue": "127.9[g]"}}
CM = {"length": "cm"}
NAMED = {"red_x": "P1", "red_y": "P2", "blue_x": "Q1", "blue_y": "Q2"}


def pucks(*names, takes=2):
    t = np.arange(5.0)
    rows = np.column_stack([t, t, t**2, 9 - t, 5 + t])
    frame = pd.DataFrame(rows, columns=["t [s]", *names])
    pieces = [frame.assign(**{"take #": f"take_{k}"}) for k in range(takes)]
    return pd.concat(pieces, ignore_index=True)


@pytest.mark.parametrize(
    ("names", "bodies"),
    [
        (("red_x (cm)", "red_y (cm)", "blue_x (cm)", "blue_y (cm)"), ("red", "blue")),
        (("Puck rot: X/cm", "Puck rot: Y/cm", "blue puck X (cm)", "blue puck Y (cm)"),
         ("Puck rot", "blue puck")),
        (("red puck X (cm)", "red puck Y (cm)", "Blau: x (cm)", "Blau: y (cm)"),
         ("red puck", "Blau")),
    ],
)  # fmt: skip
def test_bodies_are_read_under_any_of_these_headings(names, bodies):
    dataset = bsp_gp.Dataset.from_frames(pucks(*names))
    assert [scene.names for scene in dataset.scenes] == [bodies] * 2
    assert [scene.name for scene in dataset.scenes] == ["take_0", "take_1"]
    np.testing.assert_allclose(dataset.scenes[0].positions[1], [[0.01, 0.01], [0.08, 0.06]])


@pytest.mark.parametrize("letters", ["AB", "ab", "CD", "BA"])
def test_bodies_whose_letters_name_units_are_bodies(letters):
    """``y_A`` was no column and ``x_a`` refused: an ampere, a year."""
    names = [f"{axis}_{letter}" for letter in letters for axis in "xy"]
    dataset = bsp_gp.Dataset.from_frames(pucks(*names), units={"length": "m"})
    (first, _) = dataset.scenes
    assert sorted(first.names) == sorted(letters)
    places = first.positions[:, first.names.index(letters[0])]
    np.testing.assert_allclose(places[2], [2.0, 4.0])


def test_letters_of_lengths_are_units_and_no_bodies():
    dataset = bsp_gp.Dataset.from_frames(pucks("x_m", "y_m", "x_s", "y_s", takes=1))
    assert dataset.scenes[0].names == ("object",)


def test_odd_names_are_named():
    dataset = bsp_gp.Dataset.from_frames(pucks("P1", "P2", "Q1", "Q2"), columns=NAMED,
                                         units=CM, properties=MASSES)  # fmt: skip
    assert [e.mass for e in dataset.scenes[0].entities] == pytest.approx([0.0693, 0.1279])


def test_a_body_that_was_left_out_is_told_and_how_to_name_it(tmp_path, capsys):
    frame = pucks("x", "y", "blue_x", "blue_y", takes=1)
    dataset = bsp_gp.Dataset.from_frames(frame, units=CM)
    (note,) = [note for note in dataset.notes if note.startswith(CHECK)]
    assert "'blue_x', 'blue_y'" in note and '"OTHER_x": "blue_x"' in note
    with pytest.raises(DataError, match=r"'red'.*'blue_x', 'blue_y'.*columns=\{\"ONE_x\": \"x\""):
        bsp_gp.Dataset.from_frames(frame, units=CM, properties=MASSES)
    path = tmp_path / "pucks.csv"
    frame.to_csv(path, index=False)
    assert main(["check", str(path), "--units", "length=cm", "--property", "mass=red:3[g]"]) != 0
    assert "--columns ONE_x=x ONE_y=y OTHER_x=blue_x" in capsys.readouterr().err


@pytest.mark.parametrize("body", ["raw", "x_filtered", "pixel", "fit"])
def test_one_body_a_second_time_is_no_other(body):
    frame = pucks("x", "y", f"{body}_x", f"{body}_y")
    dataset = bsp_gp.Dataset.from_frames(frame, units=CM)
    assert not any(note.startswith(CHECK) for note in dataset.notes)


def test_runs_of_one_body_stay_runs():
    frame = pucks("Run 1: X", "Run 1: Y", "Run 2: X", "Run 2: Y", takes=1).drop(columns="take #")
    dataset = bsp_gp.Dataset.from_frames(frame, units={"length": "m"})
    assert [scene.name for scene in dataset.scenes] == ["Run 1", "Run 2"]
