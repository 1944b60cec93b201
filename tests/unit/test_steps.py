"""Columns of times that are steps, or that were rounded until rows share one."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.tables import dataset_from_frames, load_dataset
from bsp_gp.errors import DataError

N = 60
X = np.cumsum(np.cos(np.arange(N) / 7))
STEPS = 0.01 + 1e-4 * np.sin(3.0 * np.arange(N)) + 0.01 * (np.arange(N) % 9 == 4)


def frame(**columns):
    return pd.DataFrame({"x": X, "y": X**2, **columns})


@pytest.mark.parametrize("name", ["dt", "delta t", "Δt", "Delta_t (s)", "time step"])
@pytest.mark.parametrize("first", [np.nan, 0.0, 0.01])
def test_steps_of_time_are_summed_and_told(tmp_path, name, first):
    steps = np.append(first, STEPS[1:])
    path = tmp_path / "puck.csv"
    frame(**{name: steps}).to_csv(path, index=False)
    data = load_dataset(path, units={"length": "m", "time": "s"})
    (scene,) = data.scenes
    assert scene.times == pytest.approx(np.append(0, np.cumsum(STEPS[1:])))
    assert len(scene.times) == N and any("are their sums" in note for note in data.notes)
    if name == "dt":
        named = load_dataset(path, units={"length": "m", "time": "s"}, columns={"t": "dt"})
        assert (named.scenes[0].times == scene.times).all()
        counted = load_dataset(path, columns={"dt": "ignore"}, fps=10)
        assert counted.scenes[0].times == pytest.approx(np.arange(N) / 10)


def test_a_title_above_steps_of_which_the_first_is_blank_is_no_header(tmp_path):
    path = tmp_path / "puck.csv"
    rows = [f"{x},{x**2},{step}" for x, step in zip(X[1:], STEPS[1:], strict=True)]
    path.write_text("\n".join(["Table 3", "", "x,y,dt", "0,0,", *rows]) + "\n", encoding="utf-8")
    assert load_dataset(path).scenes[0].times[1] == pytest.approx(STEPS[1])


def test_steps_to_the_next_row_end_before_the_last_one():
    data = dataset_from_frames(frame(dt=np.append(STEPS[:-1], np.nan)))
    assert data.scenes[0].times == pytest.approx(np.append(0, np.cumsum(STEPS[:-1])))


@pytest.mark.parametrize("values", [np.arange(N) / 10, np.sin(np.arange(N)), 0 * STEPS])
def test_what_is_called_steps_and_is_none_is_asked_for(values):
    with pytest.raises(DataError, match="no column 't'"):
        dataset_from_frames(frame(dt=values))


def test_beside_a_clock_steps_are_left_alone():
    data = dataset_from_frames(frame(t=np.arange(N) / 10, dt=STEPS))
    assert data.scenes[0].times == pytest.approx(np.arange(N) / 10) and "not used: dt" in data.notes


def rounded(rate, form):
    return np.array([float(form % (k / rate)) for k in range(300)])


@pytest.mark.parametrize("form", ["%.2f", "%.2e"])
@pytest.mark.parametrize("way", ["lone", "two bodies", "recordings"])
def test_times_that_were_rounded_are_even(form, way):
    x = np.sin(np.arange(300) / 40)
    columns = {"t": rounded(119.9, form), "x": x, "y": x**2}
    if way == "two bodies":
        columns = {"t": columns["t"], "red_x": x, "red_y": x + 5, "blue_x": x, "blue_y": x**2}
        columns["blue_x"] = np.where(np.arange(300) % 11 == 3, np.nan, x)
        columns["blue_y"] = np.where(np.arange(300) % 11 == 3, np.nan, x**2)
    table = pd.DataFrame(columns)
    if way == "recordings":
        table = pd.concat([table.assign(scene=name) for name in "ab"], ignore_index=True)
    data = dataset_from_frames(table)
    for scene in data.scenes:
        np.testing.assert_allclose(scene.times, np.arange(300) / 119.9, atol=0.006)
        assert scene.times[0] == 0
        assert np.ptp(np.diff(scene.times)) < 1e-9
    assert len(data.scenes) == 1 + (way == "recordings")
    assert any("rounded until rows share one" in note for note in data.notes)


def test_frames_that_are_lost_among_rounded_times_leave_a_gap():
    kept = np.delete(np.arange(300), range(70, 78))
    times = rounded(119.9, "%.2f")[kept]
    data = dataset_from_frames(pd.DataFrame({"t": times, "x": np.sin(kept / 40), "y": 0.0}))
    np.testing.assert_allclose(data.scenes[0].times, kept / 119.9, atol=0.011)
    assert (np.diff(data.scenes[0].times) > 0).all()


def test_digits_that_grow_with_the_time_until_rows_share_one():
    """Three digits, as spreadsheets write them: from 10 s on three rows have one time."""
    times = np.array([float(f"{k / 30:.2e}") for k in range(600)])
    x = np.cos(np.arange(600) / 30)
    data = dataset_from_frames(pd.DataFrame({"t": times, "x": x, "y": 0.0}))
    np.testing.assert_allclose(data.scenes[0].times, np.arange(600) / 30, atol=0.05)
    assert np.ptp(np.diff(data.scenes[0].times)) < 1e-9


def test_times_with_coarse_digits_are_taken_as_even_and_fine_ones_are_left():
    frames = np.arange(100)
    for digits, note in ((2, True), (6, False)):
        times = np.round(frames / 30, digits)
        data = dataset_from_frames(pd.DataFrame({"t": times, "x": np.cos(times), "y": 0.0}))
        assert any("rounded coarsely" in told for told in data.notes) == note
        np.testing.assert_allclose(data.scenes[0].times, frames / 30, atol=1e-3 if note else 1e-6)
    uneven = np.cumsum(1 / 30 + 0.008 * np.sin(frames))
    data = dataset_from_frames(pd.DataFrame({"t": uneven.round(2), "x": np.cos(uneven), "y": 0.0}))
    np.testing.assert_allclose(data.scenes[0].times, uneven.round(2))


def doubled(t, k):
    return np.insert(t, k, t[k])


def test_other_rows_at_one_time_are_refused_with_what_may_be_the_remedy():
    times = doubled(np.arange(100.0), [3, 9, 44, 60])
    table = pd.DataFrame({"t": times, "x": np.sin(np.arange(len(times)) / 9), "y": 0.0})
    with pytest.raises(DataError, match="duplicate.*no even clock fits them"):
        dataset_from_frames(table)


@pytest.mark.parametrize("rows", [range(5, 200, 10), range(200), [*range(99), *range(120, 200)]])
def test_rows_that_were_written_twice_are_left_out_and_two_bodies_refused(rows):
    t = doubled(np.arange(200.0), rows)
    data = dataset_from_frames(pd.DataFrame({"t": t, "x": np.sin(t), "y": 0.0}))
    np.testing.assert_array_equal(data.scenes[0].times, np.arange(200.0))
    assert any(f"{len(rows)} row(s) say time and place" in note for note in data.notes)
    if len(rows) > 20:  # every tenth row twice is what rounding does too
        with pytest.raises(DataError, match="duplicate"):
            dataset_from_frames(pd.DataFrame({"t": t, "x": np.sin(t), "y": np.arange(len(t)) % 7}))
