"""Bodies of one table that are never seen at the same time are recordings of their own."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.tables import dataset_from_frames

UNITS = {"length": "m", "time": "s", "mass": "kg"}


def table(**spans):
    pieces = [
        pd.DataFrame({"t": t, "entity": name, "x": 1.0 * t, "y": float(k)})
        for k, (name, span) in enumerate(spans.items())
        for t in [np.arange(*span)]
    ]
    return pd.concat(pieces, ignore_index=True)


def names_of(dataset):
    return {scene.name: scene.names for scene in dataset.scenes}


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ({"a": (0, 5), "b": (10, 15)}, {"a": ("a",), "b": ("b",)}),
        ({"late": (10, 15), "early": (0, 5)}, {"early": ("early",), "late": ("late",)}),
        ({"a": (0, 5), "b": (3, 8), "c": (7, 9), "d": (20, 25)},
         {"a and b and c": ("a", "b", "c"), "d": ("d",)}),
        ({"a": (0, 5), "b": (4, 9)}, {"hall": ("a", "b")}),
    ],
)  # fmt: skip
def test_bodies_whose_times_overlap_are_one_scene(spans, expected):
    dataset = dataset_from_frames(table(**spans), name="hall", units=UNITS)
    assert names_of(dataset) == expected
    said = [note for note in dataset.notes if "never seen at the same time" in note]
    assert len(said) == (len(expected) > 1)
    assert all(f"{len(expected)} scenes ({', '.join(expected)})" in note for note in said)


def test_each_keeps_its_times_and_its_mass():
    bodies = pd.DataFrame({"entity": ["a", "b"], "mass": [0.1, 0.2]})
    dataset = dataset_from_frames(table(a=(0, 5), b=(10, 15)), bodies, units=UNITS)
    assert [scene.entities[0].properties["mass"] for scene in dataset.scenes] == [0.1, 0.2]
    np.testing.assert_allclose(dataset.scenes[1].times, np.arange(10, 15))


def test_a_table_with_scenes_and_one_with_a_wall_are_believed():
    rows = table(a=(0, 5), b=(10, 15))
    one = dataset_from_frames(rows.assign(scene="both"), units=UNITS)
    assert names_of(one) == {"both": ("a", "b")}
    bodies = pd.DataFrame({"entity": ["a", "b"], "dynamic": ["0", "1"]})
    assert len(dataset_from_frames(rows, bodies, units=UNITS).scenes) == 1


def test_many_recordings_are_told_shortly():
    spans = {f"n{k}": (10 * k, 10 * k + 5) for k in range(20)}
    (note,) = dataset_from_frames(table(**spans), units=UNITS).notes
    assert note.startswith("20 bodies") and note.endswith("n11, …)")
