"""Bodies that never move while others do are held fast, and that is told."""

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.data.still import held_still

T = np.arange(20) / 30.0


def frame(scene, name, x, y, sigma=0.001):
    rng = np.random.default_rng(list(name.encode()))
    places = np.stack([x + 0 * T, y + 0 * T], axis=1) + sigma * rng.standard_normal((len(T), 2))
    rows = {"scene": scene, "t": T, "entity": name, "x": places[:, 0], "y": places[:, 1]}
    return pd.DataFrame(rows)


def loaded(*frames, **settings):
    return bsp_gp.Dataset.from_frames(
        pd.concat(frames), units={"length": "m", "time": "s"}, **settings
    )


def is_static(data, name):
    return [e.is_static for s in data.scenes for e in s.entities if e.name == name]


def test_a_mark_on_a_tripod_is_held_at_its_mean_place():
    ball = frame("a", "ball", 2 * T, 3 * T - 4.9 * T**2)
    mark = frame("a", "tripod", 1.0, 0.2)
    data = loaded(ball, mark)
    assert (is_static(data, "tripod"), is_static(data, "ball")) == ([True], [False])
    (scene,) = data.scenes
    places = scene.positions[:, list(scene.names).index("tripod")]
    np.testing.assert_allclose(places, np.tile(mark[["x", "y"]].mean(), (len(T), 1)), atol=1e-12)
    assert any("tripod never moves" in note for note in data.notes)


@pytest.mark.parametrize("y", [0.2 + 0.004 * T, 0.2 + 0.003 * np.sin(6 * T)])
def test_what_drifts_or_swings_beyond_its_jitter_is_left_to_forces(y):
    data = loaded(frame("a", "ball", 2 * T, 0.0), frame("a", "slow", 1.0, y, sigma=0.0003))
    assert is_static(data, "slow") == [False] and not any("moves" in n for n in data.notes)


def test_a_body_that_moves_in_one_recording_is_held_in_none():
    frames = [frame("a", "one", 2 * T, 0.0), frame("a", "two", 1.0, 1.0),
              frame("b", "one", 2 * T, 0.0), frame("b", "two", 1.0 + T, 1.0)]  # fmt: skip
    assert is_static(loaded(*frames), "two") == [False, False]


def test_what_is_said_is_believed_and_something_must_move():
    ball, mark = frame("a", "ball", 2 * T, 0.0), frame("a", "mark", 1.0, 1.0)
    crew = pd.DataFrame({"entity": ["ball", "mark"], "dynamic": [1, 1]})
    assert is_static(loaded(ball, mark, entities=crew), "mark") == [False]
    alone = loaded(frame("a", "one", 1.0, 0.0), frame("a", "other", 2.0, 0.0))
    assert held_still(alone.scenes) == (alone.scenes, ())


@pytest.mark.parametrize("length, sigma, is_held", [
    ("m", 0.001, True), ("km", 0.001, True), ("Gm", 0.001, False), ("Gm", 0.0, True),
])  # fmt: skip
def test_nothing_of_the_sky_is_held_but_where_places_count_from(length, sigma, is_held):
    """A heavy planet hardly moves; that it does shows in how fast its moons go round."""
    frames = pd.concat([
        frame("a", "moon", 2 * T, 3 * T - 4.9 * T**2), frame("a", "planet", 0.0, 0.0, sigma),
    ])  # fmt: skip
    units = {"length": length, "time": "s", "mass": "kg"}
    masses = {"mass": {"planet": 9e25, "moon": 3e20}}
    weighed = bsp_gp.Dataset.from_frames(frames, units=units, properties=masses)
    assert is_static(weighed, "planet") == [is_held]
    unweighed = bsp_gp.Dataset.from_frames(frames, units=units)
    assert is_static(unweighed, "planet") == [True]
