"""A row that is off is no end of a track."""

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.torn import without_torn_ends
from tests.throws import SI


def test_a_single_bad_row_leaves_the_track_whole():
    t = 0.05 * np.arange(200)
    height = np.where(t < 3.4, 60 * t**2, 690 + 100 * (t - 3.4))
    height[67] = 30.0
    places = np.stack([np.zeros(200), height], axis=1)[:, None]
    scene = Scene("rocket", t, places, (Entity("1", properties={"mass": 1.0}),))
    data = Dataset("rocket", (scene,), units=SI)
    assert without_torn_ends(data) is data
