"""What the caller names wins over what words mean."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp import Dataset
from bsp_gp.errors import DataError
from bsp_gp.report.recording import data_text

T = np.arange(12) * 0.04
NAMES = ("X position [px]", "Y position [px]", "Distance [px]")
ONE, TWO = ([f"Object {k}: {name}" for name in NAMES] for k in (1, 2))


@pytest.fixture
def table():
    columns = {"Time [s]": T}
    for k, names in enumerate((ONE, TWO)):
        columns |= dict(zip(names, (100 * k + T, T * T, 5 + k + 0 * T), strict=True))
    return pd.DataFrame(columns)


def test_objects_side_by_side_are_bodies(table):
    data = Dataset.from_frames(table)
    assert data.scenes[0].names == ("Object 1", "Object 2")
    np.testing.assert_array_equal(data.scenes[0].positions[:, 1, 0], 100 + T)


@pytest.mark.parametrize("names, offset", [(ONE, 0), (TWO, 100)])
@pytest.mark.parametrize("how", ["x", "x and y", "body"])
def test_places_of_one_object_that_are_named_are_the_only_ones(table, names, offset, how):
    columns = {"x": names[0]} | ({"y": names[1]} if how == "x and y" else {})
    if how == "body":
        columns = {"ball_x": names[0], "ball_y": names[1]}
    data = Dataset.from_frames(table, columns=columns)
    assert data.scenes[0].names == (("ball",) if how == "body" else ("object",))
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0, 0], offset + T)
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0, 1], T * T)
    told = " ".join(data.notes)
    assert "by their words" not in told
    other = TWO if names is ONE else ONE
    assert all(name.removesuffix(" [px]") in told for name in (*other, names[2]))


def test_of_an_object_that_is_left_out_no_other_column_is_a_place(table):
    data = Dataset.from_frames(table, columns={TWO[0]: "ignore", TWO[1]: "ignore"})
    assert len(data.scenes[0].names) == 1
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0, 0], T)


@pytest.mark.parametrize("names", ["x1 x2", "x_1 x_2", "1_x 2_x"])
def test_numbered_places_that_are_named_are_bodies(names):
    """`x1=4` of a table without a header was told that there is no column 4 beside 1 to 5."""
    table = pd.DataFrame({"t": T, "4": T, "5": T * T})
    data = Dataset.from_frames(table, columns=dict(zip(names.split(), "45", strict=True)))
    assert sorted(data.scenes[0].names) == ["1", "2"]
    k = data.scenes[0].names.index("2")
    np.testing.assert_array_equal(data.scenes[0].positions[:, k, 0], T * T)


def test_a_plain_place_gives_way_to_one_that_is_named():
    table = pd.DataFrame({"t": T, "x": 0 * T, "y": 0 * T, "X2": T, "Y2": T * T})
    data = Dataset.from_frames(table, columns={"x": "X2", "y": "Y2"})
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0], np.stack([T, T * T], axis=1))


@pytest.fixture
def sensor():
    return pd.DataFrame({"Time (s)": T, "Voltage ( V )": T * T, "Speed [m/s]": 2 * T})


def test_volts_that_are_named_as_a_place_are_one_that_is_not_calibrated(sensor):
    data = Dataset.from_frames(sensor, columns={"x": "Voltage ( V )"})
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0, 0], T * T)
    (note,) = [note for note in data.notes if "not calibrated" in note]
    assert note.startswith("check: 'Voltage ( V )': V is no unit of length")
    assert "m" not in data.units.declared
    told = Dataset.from_frames(sensor, columns={"x": "Voltage ( V )"}, units={"x": "0.5 mm"})
    np.testing.assert_allclose(told.scenes[0].positions[:, 0, 0], 0.0005 * T * T)
    assert not any("calibrated" in note for note in told.notes)


def test_a_speed_that_is_named_as_a_place_is_refused_with_what_works(sensor):
    with pytest.raises(DataError, match=r'columns={"vx": "Speed \[m/s\]"}'):
        Dataset.from_frames(sensor, columns={"x": "Speed [m/s]"})
    assert Dataset.from_frames(sensor, columns={"vx": "Speed [m/s]"}).velocity == "only"


def test_a_complaint_names_the_headings_of_the_file():
    table = pd.DataFrame({"t": T, "S": T * T, "Vs": 2 * T, "As": 2 + 0 * T + T**3})
    with pytest.raises(DataError, match="present are t, S, Vs, As; .* all motion is along 'S'"):
        Dataset.from_frames(table)


def test_an_error_is_that_of_the_place_whose_heading_it_abbreviates():
    table = pd.DataFrame({"t (s)": T, "Distance (cm)": 100 * T * T, "Dist Error (cm)": 0.2})
    data = Dataset.from_frames(table)
    np.testing.assert_allclose(data.scenes[0].sigma[:, 0, 0], 0.002)
    table = table.rename(columns={"Dist Error (cm)": "Dial Error (cm)"})
    assert Dataset.from_frames(table).scenes[0].sigma is None


@pytest.mark.parametrize(
    "start, step, told",
    [(0.0, 1.0, "from 0 to 11.00"), (62397555.0, 1.0, "6.23975550 × 10⁷ to 6.23975660"),
     (2453736.5, 0.25, "2.4537365 × 10⁶ to 2.453739")],
)  # fmt: skip
def test_times_far_from_zero_are_printed_so_that_rows_are_told_apart(start, step, told):
    table = pd.DataFrame({"t": start + step * np.arange(12), "x": T, "y": T * T})
    assert told in data_text(Dataset.from_frames(table))


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_bodies_at_one_pixel_at_times_are_read_and_told(scale):
    k = np.arange(20)
    one, two = np.round(3.3 * k) * scale, np.round(3.3 * k + 2 * np.cos(k)) * scale
    count = int((one == two).sum())
    assert 0 < count <= 5
    table = pd.DataFrame({"t": k / 30, "p_x": one, "p_y": k, "q_x": two, "q_y": k})
    data = Dataset.from_frames(table)
    assert np.isnan(data.scenes[0].positions[:, 1, 0]).sum() == count
    (note,) = [note for note in data.notes if "same point" in note]
    assert note.startswith("check: ") and f"'q' in {count} of 20" in note


def test_bodies_that_meet_often_or_exactly_are_refused():
    k = np.arange(20)
    x = np.round(3.3 * k)
    for other in (np.where(k % 2, x, x + 1), np.where(k == 3, np.sqrt(k), np.sqrt(k + 1))):
        one = x if other[1] == x[1] else np.sqrt(k)
        table = pd.DataFrame({"t": k / 30, "p_x": one, "p_y": k, "q_x": other, "q_y": k})
        with pytest.raises(DataError, match="at one point"):
            Dataset.from_frames(table)
