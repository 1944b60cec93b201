import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.split import choose_split
from bsp_gp.errors import DataError


def scenes(n_scenes, n_times=100, seed=31):
    rng = np.random.default_rng(seed)
    t = np.arange(n_times) * 0.1
    walks = rng.normal(size=(n_scenes, n_times, 1, 2)).cumsum(axis=1)
    return tuple(Scene(str(k), t, walks[k], (Entity("a"),)) for k in range(n_scenes))


def names(part):
    return [scene.name for scene in part]


def test_declared_split_wins():
    split = choose_split(Dataset("d", scenes(5), train=("1", "0"), test=("4",)), None)
    assert (names(split.train), names(split.test)) == (["1", "0"], ["4"])
    assert "declared" in split.note


def test_half_a_split_is_completed():
    split = choose_split(Dataset("d", scenes(3), test=("1",)), None)
    assert names(split.train) == ["0", "2"]
    with pytest.raises(DataError, match="nothing is left to train on"):
        choose_split(Dataset("d", scenes(2), test=("0", "1")), None)


@pytest.mark.parametrize(("n_scenes", "n_test"), [(4, 1), (6, 2), (20, 5)])
def test_random_quarter(n_scenes, n_test):
    dataset = Dataset("d", scenes(n_scenes))
    split = choose_split(dataset, np.random.default_rng(1))
    again = choose_split(dataset, np.random.default_rng(1))
    assert names(split.test) == names(again.test)
    assert len(split.test) == n_test
    assert sorted(names(split.train + split.test)) == sorted(names(dataset.scenes))
    others = {tuple(names(choose_split(dataset, np.random.default_rng(k)).test)) for k in range(9)}
    assert len(others) > 1


def test_what_is_held_out_at_random_is_named():
    split = choose_split(Dataset("d", scenes(5)), np.random.default_rng(1))
    assert f"({', '.join(names(split.test))}) and not fitted" in split.told
    many = choose_split(Dataset("d", scenes(40)), np.random.default_rng(1))
    assert many.told.partition("(")[2].partition(")")[0].endswith(", …")


def test_few_scenes_are_cut_in_time():
    dataset = Dataset("d", scenes(2))
    split = choose_split(dataset, np.random.default_rng(1))
    assert names(split.train) == ["0", "1"]
    assert split.learned == dataset.scenes
    assert names(split.test) == ["0 (held out)", "1 (held out)"]
    for scene, train, test in zip(dataset.scenes, split.train, split.test, strict=True):
        assert test.times[0] == pytest.approx(0.7 * scene.times[-1], abs=0.1)
        assert test.times[-1] == scene.times[-1]
        gap = len(scene.times) - len(train.times) - len(test.times)
        assert 1 <= gap <= 10
        assert train.times[-1] < test.times[0]


def test_of_a_star_nights_are_held_out_all_along():
    """A companion that takes as long as its star was watched was refused for what it did last."""
    dataset = Dataset("star", scenes(1, n_times=41), velocity="sight")
    split = choose_split(dataset, np.random.default_rng(1))
    (scene,), (train,), (test,) = dataset.scenes, split.train, split.test
    assert split.learned == dataset.scenes
    assert test.times == pytest.approx(scene.times[2::4])
    assert sorted([*train.times, *test.times]) == pytest.approx(scene.times)
    few = Dataset("star", scenes(1, n_times=8), velocity="sight")
    assert not choose_split(few, np.random.default_rng(1)).test


def test_the_gap_follows_the_correlation():
    t = np.arange(400) * 0.01
    smooth = Scene("s", t, np.stack([np.sin(3 * t), np.cos(5 * t)], 1)[:, None], (Entity("a"),))
    split = choose_split(Dataset("d", (smooth,)), None)
    assert len(t) - len(split.train[0].times) - len(split.test[0].times) > 15


@pytest.mark.parametrize("n_times", [3, 5])
def test_too_short_to_cut(n_times):
    split = choose_split(Dataset("d", scenes(1, n_times)), None)
    assert names(split.train) == ["0"]
    assert split.test == ()
    assert "too short" in split.note
