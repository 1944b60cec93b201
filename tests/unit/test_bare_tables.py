"""Tables without a column of times, and files without a header."""

import re

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.data.untimed import COUNTED
from bsp_gp.errors import DataError
from tests.text_tables import rows

N = 8
XY = [(0.5 * k, k * k) for k in range(N)]
SURE = (0.97, 0.93, 0.99, 1.0, 0.94, 0.98, 0.95, 0.96)


def table(tmp_path, *lines, name="film.csv"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def wide(tmp_path, lost=()):
    """A table of idTracker: two bodies side by side, and how sure each is."""
    x, y = map(list, zip(*XY, strict=True))
    for k in lost:
        x[k] = y[k] = "NaN"
    lines = rows(x, y, SURE, [9 - k for k in range(N)], range(N), SURE[::-1], mark="\t")
    return table(tmp_path, "X1\tY1\tProbId1\tX2\tY2\tProbId2", *lines, name="trajectories.txt")


@pytest.mark.parametrize("rate", [{"fps": 25}, {"dt": 0.04}])
def test_rows_of_bodies_side_by_side_are_frames_at_a_rate(tmp_path, rate):
    data = bsp_gp.load_dataset(wide(tmp_path), **rate)
    (scene,) = data.scenes
    assert scene.names == ("1", "2") and COUNTED in data.notes
    np.testing.assert_allclose(scene.times, np.arange(N) / 25)
    np.testing.assert_allclose(scene.positions[:, 0], XY)


def test_a_body_that_is_lost_or_all_of_them_leave_the_frames_as_they_are(tmp_path):
    (scene,) = bsp_gp.load_dataset(wide(tmp_path, lost=(2, 3)), fps=25).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 25)
    assert np.isnan(scene.positions[2:4, 0]).all()
    lines = rows(*zip(*XY, strict=True))
    lines[3] = ","
    (scene,) = bsp_gp.load_dataset(table(tmp_path, "x,y", *lines), fps=10).scenes
    np.testing.assert_allclose(scene.times, [0, 0.1, 0.2, 0.4, 0.5, 0.6, 0.7])


@pytest.mark.parametrize("units", [{}, {"length": "px"}, {"length": "m", "time": "s"}])
def test_without_a_rate_the_remedy_is_named(tmp_path, units):
    with pytest.raises(DataError, match="no column 't'; present are X1, .*columns=.*fps=25"):
        bsp_gp.load_dataset(wide(tmp_path), units=units)


@pytest.mark.parametrize("further", [(), SURE, range(3, 3 + N), [7] * N])
def test_rows_of_one_body_are_frames(tmp_path, further):
    x, y = zip(*XY, strict=True)
    columns, header = ((x, y, further), "x,y,q") if further else ((x, y), "x,y")
    path = table(tmp_path, header, *rows(*columns))
    (scene,) = bsp_gp.load_dataset(path, fps=10).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 10)
    with pytest.raises(DataError, match="no column 't'.*fps=25"):
        bsp_gp.load_dataset(path)


@pytest.mark.parametrize("heading", ["Strom (A)", "U (V)"])
def test_what_has_a_unit_is_no_clock_and_no_name(tmp_path, heading):
    path = table(tmp_path, f"{heading},x,y", *rows(range(5, 5 + 2 * N, 2), *zip(*XY, strict=True)))
    with pytest.raises(DataError, match="no column 't'"):
        bsp_gp.load_dataset(path)
    (scene,) = bsp_gp.load_dataset(path, fps=10).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 10)


def test_frames_of_which_every_fifth_was_looked_at_stay_what_they_are(tmp_path):
    lines = [row for each in rows(*zip(*XY, strict=True)) for row in (each, *[","] * 4)]
    (scene,) = bsp_gp.load_dataset(table(tmp_path, "x,y", *lines), fps=10).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 2)


@pytest.mark.parametrize(
    "further",
    [
        [k / 30 for k in range(N)],
        [0.1, 0.2, 0.3, 0.4, 0.1, 0.2, 0.3, 0.4],
        [0, 1, 2, 5, 6, 7, 9, 10],
        [1, 1, 1, 1, 2, 2, 2, 2],
        [1, 2] * 4,
        ["anna", "bea"] * 4,
        [f"10h{k}" for k in range(N)],
    ],
)
def test_what_may_be_a_clock_or_tell_rows_apart_is_asked_for(tmp_path, further):
    path = table(tmp_path, "q,x,y", *rows(further, *zip(*XY, strict=True)))
    for rate in ({}, {"fps": 10}):
        with pytest.raises(DataError, match=r'"(t|scene)": "q".*columns=.*"q": "ignore".* fps=25'):
            bsp_gp.load_dataset(path, **rate)
    (scene,) = bsp_gp.load_dataset(path, fps=10, columns={"q": "ignore"}).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 10)


def test_a_clock_without_a_name_needs_one(tmp_path):
    path = table(tmp_path, ",x,y", *rows([k / 30 for k in range(N)], *zip(*XY, strict=True)))
    with pytest.raises(DataError, match="column 1 has no name"):
        bsp_gp.load_dataset(path, fps=10)


@pytest.mark.parametrize("names", [["a"] * 4 + ["b"] * 4, ["a", "b", "b", "a"] * 2])
def test_rows_of_bodies_below_each_other_are_no_frames(tmp_path, names):
    path = table(tmp_path, "entity,x,y", *rows(names, *zip(*XY, strict=True)))
    with pytest.raises(DataError, match="no column 't'.*frame.*no frames one after another"):
        bsp_gp.load_dataset(path, fps=10)


def test_rows_of_recordings_are_frames_of_each_where_they_are_not_mixed(tmp_path):
    x, y = zip(*XY, strict=True)
    path = table(tmp_path, "scene,x,y", *rows(["a"] * 4 + ["b"] * 4, x, y))
    scenes = bsp_gp.load_dataset(path, fps=10).scenes
    assert [scene.name for scene in scenes] == ["a", "b"]
    for scene in scenes:
        np.testing.assert_allclose(scene.times, [0, 0.1, 0.2, 0.3])
    path = table(tmp_path, "scene,x,y", *rows(["a", "b"] * 4, x, y))
    with pytest.raises(DataError, match="no frames one after another"):
        bsp_gp.load_dataset(path, fps=10)


@pytest.mark.parametrize("clock", ["frame", "t"])
def test_a_column_of_times_or_frames_counts_as_before(tmp_path, clock):
    path = table(tmp_path, f"{clock},x,y", *rows(range(0, 2 * N, 2), *zip(*XY, strict=True)))
    data = bsp_gp.load_dataset(path, **({"fps": 10} if clock == "frame" else {}))
    step = 0.2 if clock == "frame" else 2
    np.testing.assert_allclose(data.scenes[0].times, step * np.arange(N))
    assert COUNTED not in data.notes


def test_frames_of_pandas_without_times_are_read_alike():
    frame = pd.DataFrame(XY, columns=["x", "y"]).assign(q=SURE)
    (scene,) = bsp_gp.Dataset.from_frames(frame, fps=10).scenes
    np.testing.assert_allclose(scene.times, np.arange(N) / 10)


T = [0.004 * k for k in range(N)]


@pytest.mark.parametrize("n_columns", [2, 3, 4])
@pytest.mark.parametrize("sep", [",", ";", "\t", " ", "   "])
def test_numbers_without_a_header_are_times_and_places(tmp_path, sep, n_columns):
    columns = [T, [k * k for k in range(N)], [5 - k for k in range(N)], SURE][:n_columns]
    data = bsp_gp.load_dataset(table(tmp_path, *rows(*columns, mark=sep)))
    (scene,) = data.scenes
    np.testing.assert_allclose(scene.times, T)
    found = scene.positions[:, 0, : n_columns - 1].T
    np.testing.assert_allclose(found, columns[1:])
    names = ", ".join("txyz"[:n_columns])
    assert any(f"no header: columns read as {names};" in note for note in data.notes)


def test_decimal_commas_without_a_header(tmp_path):
    lines = [line.replace(".", ",") for line in rows(T, SURE, mark="\t")]
    (scene,) = bsp_gp.load_dataset(table(tmp_path, *lines)).scenes
    np.testing.assert_allclose(scene.times, T)
    np.testing.assert_allclose(scene.positions[:, 0, 0], SURE)


def test_columns_without_names_are_called_by_their_numbers(tmp_path):
    path = table(tmp_path, *rows(T, SURE, range(1, N + 1)))
    data = bsp_gp.load_dataset(path, columns={"t": "1", "x": "3"})
    np.testing.assert_allclose(data.scenes[0].times, T)
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], range(1, N + 1))
    assert "not used: 2" in data.notes and not any("no header" in note for note in data.notes)
    data = bsp_gp.load_dataset(path, columns={"2": "ignore"})
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], range(1, N + 1))
    path = table(tmp_path, *rows(SURE, [k * k for k in range(N)], T, range(N), SURE[::-1]))
    names = {"t": "3", "red_x": "1", "red_y": "2", "blue_x": "4", "blue_y": "5"}
    assert bsp_gp.load_dataset(path, columns=names).scenes[0].names == ("red", "blue")
    data = bsp_gp.load_dataset(path, columns={"x": "1", "y": "2", "3": "ignore", "4": "ignore"},
                               fps=10)  # fmt: skip
    np.testing.assert_allclose(data.scenes[0].times, np.arange(N) / 10)


def test_columns_called_by_their_numbers_may_stand_beside_texts(tmp_path):
    lines = [f"{k},ID{7 * k},{'ab'[k % 2]},0.5,{k},{k // 2},0.5" for k in range(1, 9)]
    path = table(tmp_path, *lines)
    columns = {"frame": "6", "entity": "3", "x": "5", "y": "4"}
    data = bsp_gp.load_dataset(path, columns=columns, fps=10)
    assert set(data.scenes[0].names) == {"a", "b"} and "not used: 1, 2, 7" in data.notes
    path = table(tmp_path, "t,1,2", *rows(T, SURE, range(N)))
    (scene,) = bsp_gp.load_dataset(path, columns={"x": "1", "y": "2"}).scenes
    np.testing.assert_allclose(scene.positions[:, 0, 0], SURE)


@pytest.mark.parametrize("first", ["1,2,3", "0,0,0", "2,1,3"])
def test_the_first_row_is_not_lost_though_it_looks_like_numbers_of_columns(tmp_path, first):
    path = table(tmp_path, first, *rows(range(3, 3 + N), range(N), SURE))
    for columns in ({}, {"t": "1", "x": "2", "y": "3"}):
        scene = bsp_gp.load_dataset(path, columns=columns).scenes[0]
        cells = [scene.times[0], *scene.positions[0, 0]]
        assert len(scene.times) == N + 1 and cells == [float(cell) for cell in first.split(",")]


def test_a_header_of_numbers_as_pandas_writes_it_is_no_row(tmp_path):
    path = table(tmp_path, "0,1,2", *rows([0.5 + k for k in range(N)], range(N), SURE))
    with pytest.raises(DataError, match="if that line is a row.*\"t\": \"0\""):
        bsp_gp.load_dataset(path)
    scene = bsp_gp.load_dataset(path, columns={"t": "0", "x": "1", "y": "2"}).scenes[0]
    assert scene.times[0] == 0.5 and len(scene.times) == N


@pytest.mark.parametrize(
    "lines",
    [
        rows(T, *[SURE] * 4),
        rows([0, 1, 1, *range(2, N - 1)], SURE),
        [*rows(T, SURE), "0.9,lost"],
        [*rows(T, SURE), "0.9,1,2"],
        ["nan,0.9", *rows(T, SURE)],
        [",0.9", *rows(T, SURE)],
    ],
)
def test_numbers_of_which_the_first_is_no_clock_need_names(tmp_path, lines):
    remedy = re.escape('add a header such as t,x,y, or say which column is which by its number: '
                       'columns={"t": "1", "x": "2"}')  # fmt: skip
    with pytest.raises(DataError, match=f"number.s. where the names of the columns.*{remedy}"):
        bsp_gp.load_dataset(table(tmp_path, *lines))


@pytest.mark.parametrize(
    ("last", "told"),
    [("99,lost", "line 71, column x: expected a number, got 'lost'"), ("3,4", "line 71.*increase")],
)
def test_what_is_wrong_further_down_is_told_with_its_line(tmp_path, last, told):
    lines = [*rows(range(70), [k * k for k in range(70)]), last]
    with pytest.raises(DataError, match=told):
        bsp_gp.load_dataset(table(tmp_path, *lines))


def test_named_by_numbers_what_is_wrong_in_the_first_rows_is_told_with_its_line(tmp_path):
    named = {"t": "1", "x": "2"}
    with pytest.raises(DataError, match="line 9, column x: expected a number, got 'lost'"):
        bsp_gp.load_dataset(table(tmp_path, *rows(T, SURE), "0.9,lost"), columns=named)
    with pytest.raises(DataError, match="line 2: this row has 3 cells, the first row has 2"):
        bsp_gp.load_dataset(table(tmp_path, "0,1", "1,2,3", "2,5,6,7"), columns=named)
    data = bsp_gp.load_dataset(table(tmp_path, "# of May", *rows(T, SURE), "0.9,NA"), columns=named)
    assert "1 row(s) without coordinates are gaps in the track" in data.notes


def test_check_says_how_a_bare_file_was_read(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = table(tmp_path, *rows(T, SURE))
    assert main(["check", str(path), "--units", "length=um", "time=ms"]) == 0
    told = capsys.readouterr().out
    assert "no header: columns read as t, x; if they are not that" in told
    assert "--columns t=1 x=2" in told
    assert main(["check", str(wide(tmp_path))]) == 2
    told = capsys.readouterr()
    assert "x = 'X1'" in told.out and "if every row is a frame, --fps 25" in told.err


def test_a_clock_in_two_units_is_suggested_once_and_taken_for_no_axis(tmp_path):
    """Nanoseconds since 1970 beside seconds from the start, and what a sensor shows."""
    seconds = [round(0.03 + 0.01 * k, 5) for k in range(60)]
    since = [1_620_421_562_000_000_000 + round(1e9 * t) for t in seconds]
    axes = [np.cos(np.arange(60) / 5 + k).round(5).tolist() for k in range(3)]
    path = table(tmp_path, *rows(since, seconds, *axes))
    with pytest.raises(DataError) as error:
        bsp_gp.load_dataset(path)
    assert "column 1 is the same clock" in str(error.value)
    assert "t=2 ax=3 ay=4 az=5" in str(error.value)
    data = bsp_gp.load_dataset(path, columns={"t": "2", "ax": "3", "ay": "4", "az": "5"})
    assert not any("is a clock" in note for note in data.notes)
    data = bsp_gp.load_dataset(path, columns={"t": "1", "ax": "2", "ay": "3", "az": "4"})
    assert any("'2' increases with the time" in note for note in data.notes)
    short = table(tmp_path, *rows(since, seconds, *axes[:1]))
    with pytest.raises(DataError, match="same clock"):  # the second is no place
        bsp_gp.load_dataset(short)


def test_what_counts_rows_is_not_suggested_beside_a_clock_that_is_uneven(tmp_path):
    times = np.cumsum([2, 6, 3, 9, 4] * 8).tolist()
    axes = [np.cos(np.arange(40) / 5 + k).round(5).tolist() for k in range(3)]
    path = table(tmp_path, *rows(range(1, 41), times, *axes, ["ramp"] * 40))
    with pytest.raises(DataError, match="t=2 ax=3 ay=4 az=5"):
        bsp_gp.load_dataset(path)
