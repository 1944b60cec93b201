"""Rows of several instruments below each other are put into the order of their dates."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError

DATES = np.array([2001.1, 2003.5, 2008.2, 1999.3, 2002.2, 2003.5, 2006.1])
UNITS = {"length": "mas", "time": "yr"}


def read(folder, times, errors=True):
    x = 3.0 * (times - times.min())
    table = pd.DataFrame({"t": times, "x": x, "y": -x})
    if errors:
        table = table.assign(sx=0.5, sy=0.5)
    table.loc[5, ["x", "y"]] += 0.1
    table.to_csv(folder / "star.csv", index=False)
    return load_dataset(folder / "star.csv", units=UNITS, sky={"distance": "8 kpc"})


def test_dates_of_two_instruments_are_put_in_order_and_that_is_told(tmp_path):
    (scene,) = read(tmp_path, DATES).scenes
    assert len(scene.times) == 6  # of the night that both have there is one measure
    assert (np.diff(scene.times) > 0).all()
    assert (np.diff(scene.positions[:, 0, 0]) > 0).all()
    notes = read(tmp_path, DATES).notes
    assert any("dates go back, first in line" in note for note in notes)


@pytest.mark.parametrize(("times", "errors"), [(DATES, False), (DATES - 1999.0, True)])
def test_recordings_below_each_other_are_no_dates(times, errors, tmp_path):
    with pytest.raises(DataError, match="must increase"):
        read(tmp_path, times, errors)
