import copy
import math

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, LatentDeclaration, Scene
from bsp_gp.errors import DataError
from bsp_gp.units import Unit

A, B = Entity("a"), Entity("b")
T = [0.0, 1.0, 2.0]
P = np.array([[[0, 0], [5, 5]], [[1, 0], [5, 5]], [[2, 0], [5, 5]]], dtype=float)


def test_arrays_are_copied_and_read_only():
    positions = P.copy()
    scene = Scene("s", T, positions, (A, B))
    positions[:] = 9
    assert scene.positions[0, 1, 0] == 5.0
    with pytest.raises(ValueError, match="read-only"):
        scene.positions[0] = 0
    with pytest.raises(TypeError):
        A.properties["mass"] = 1.0


def test_facts():
    scene = Scene("s", T, P, (A, Entity("b", is_static=True)))
    assert (scene.n_dims, scene.names, scene.dynamic.tolist()) == (2, ("a", "b"), [0])
    with pytest.raises(DataError, match="2 frame"):
        scene.rows(1, None)
    cut = Scene("s", [0, 1, 2, 3], np.arange(8.0).reshape(4, 1, 2), (A,)).rows(1, 4)
    assert cut.times.tolist() == [1, 2, 3]
    assert math.isnan(A.mass)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"positions": P[:, :1]}, "positions must have the shape"),
        ({"positions": P[..., :1]}, "2 or 3 axes"),
        ({"times": T[:2], "positions": P[:2]}, "at least 3"),
        ({"times": [0, 2, 1]}, "unsorted"),
        ({"times": [0, 1, 1]}, "duplicate"),
        ({"times": [0, 1, np.nan]}, "finite"),
        ({"positions": np.where(P == 2, np.inf, P)}, "infinite"),
        ({"entities": (A, A)}, "unique"),
        ({"velocities": P[:2]}, "velocities must have the shape"),
        ({"sigma": -P}, "must not be negative"),
        ({"positions": np.where(P == 5, [1.0, 0.0], P)}, "'a' and 'b' are at one point at t = 1"),
    ],
)
def test_bad_scenes(changes, expected):
    good = {"name": "s", "times": T, "positions": P, "entities": (A, B)}
    with pytest.raises(DataError, match=expected):
        Scene(**good | changes)


def test_one_point_is_found_among_many():
    rng = np.random.default_rng(31)
    positions = rng.normal(size=(50, 40, 3))
    positions[..., 0] = 0.0
    positions[:, 3] = np.nan
    entities = tuple(Entity(f"e{k}") for k in range(40))
    Scene("s", np.arange(50), positions, entities)
    positions[17, 31] = positions[17, 8]
    with pytest.raises(DataError, match=r"'e8' and 'e31' are at one point at t = 17"):
        Scene("s", np.arange(50), positions, entities)


def test_a_mat_may_lie_under_a_disc():
    mat = Entity("b", "rect_mat", width=1, height=1, is_static=True)
    Scene("s", T, np.where(P == 5, [1.0, 0.0], P), (A, mat))


def test_bad_entities():
    with pytest.raises(DataError, match="must be one of point, disc"):
        Entity("a", "cube")
    with pytest.raises(DataError, match="must be positive, got 0"):
        Entity("a", properties={"mass": 0.0})
    Entity("a", is_static=True, properties={"mass": 0.0})


def test_entities_and_scenes_travel_to_workers():
    scene = Scene("s", T, P, (A, Entity("b", properties={"mass": 2.0})))
    again = copy.deepcopy(scene)  # pickled, as on the way to a worker
    assert again.entities == scene.entities
    np.testing.assert_array_equal(again.positions, scene.positions)


def test_dataset():
    one, two = Scene("1", T, P, (A, B)), Scene("2", T, P, (A, Entity("b", properties={"q": 1.0})))
    dataset = Dataset("d", (one, two), train=("2",), test=("1",), property_units={"q": Unit()})
    assert dataset.scene("1") is one
    assert dataset.select(("2", "1")) == (two, one)
    assert (dataset.n_dims, dataset.property_names) == (2, ("q",))
    assert dataset.property_units["mass"] == Unit.of(kg=1)
    with pytest.raises(DataError, match="unknown scene '3'"):
        dataset.scene("3")
    with pytest.raises(DataError, match="unknown scene '3'"):
        dataset.select(("1", "3"))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"scenes": ()}, "no scenes"),
        ({"scenes": (Scene("1", T, P, (A, B)),) * 2}, "unique"),
        ({"train": ("7",)}, "unknown scenes"),
        ({"train": ("1",), "test": ("1",)}, "both in train and in test"),
        (
            {"scenes": (Scene("1", T, P, (A, B)), Scene("2", T, np.zeros((3, 1, 3)), (A,)))},
            "mixes 2-D and 3-D",
        ),
    ],
)
def test_bad_datasets(changes, expected):
    with pytest.raises(DataError, match=expected):
        Dataset(**{"name": "d", "scenes": (Scene("1", T, P, (A, B)),)} | changes)


def test_latent_defaults():
    assert LatentDeclaration("mass").share == "entity"
