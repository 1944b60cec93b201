"""Readings that are held until the next one are left out; what lies still is not."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp import Dataset

T = np.arange(240) * 0.02
MOVING = np.stack([1.5 * T, 1.0 + 3.0 * T - 4.905 * T**2], axis=1)
MOVING += np.random.default_rng(3).normal(0.0, 0.001, MOVING.shape)


def loaded(places):
    frame = pd.DataFrame({"t": T, "x": places[:, 0], "y": places[:, 1]})
    return Dataset.from_frames(frame, units={"length": "m", "time": "s"})


def test_a_logger_faster_than_its_sensor_holds_every_reading():
    held = MOVING[np.arange(len(T)) // 4 * 4]
    data = loaded(held)
    (scene,) = data.scenes
    np.testing.assert_allclose(scene.times, T[::4])
    np.testing.assert_allclose(scene.positions[:, 0], MOVING[::4])
    (note,) = (n for n in data.notes if "hold the place of the row before" in n)
    assert note.startswith("check: 180 row(s)")


@pytest.mark.parametrize(
    "places",
    [
        MOVING,
        np.where(T[:, None] < 2.0, MOVING[:1], MOVING),  # at rest until it is struck
        np.round(0.02 * np.sin(2 * T)[:, None] * [1, 2], 2),  # slow, on a grid
    ],
    ids=["moving", "struck", "grid"],
)
def test_what_is_seen_at_every_row_stays(places):
    data = loaded(places)
    assert len(data.scenes[0].times) == len(T)
    assert not any("hold the place" in note for note in data.notes)
