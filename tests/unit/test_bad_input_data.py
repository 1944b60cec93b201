"""Every defect of a data set is one DataError that says what, where and what to do."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data import assembly, sources
from bsp_gp.data.scene import Dataset
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError

GOOD = "scene,t,entity,x,y\na,0,ball,0,0\na,1,ball,1,0\na,2,ball,2,1\n"
SPLIT = GOOD + GOOD.split("\n", 1)[1].replace("a,", "b,")
T, E, D = "trajectories.csv", "entities.csv", "dataset.toml"


def edit(old, new, text=GOOD):
    assert old in text
    return text.replace(old, new)


# id: (files, what the message must contain)
DEFECTS = {
    "missing column": ({T: edit(",y", ",q")}, [T, "no column 'y'", "present are", "[columns]"]),
    "missing time column": ({T: edit(",t,", ",q,")}, [T, "no column 't'"]),
    "frame without rate": ({T: edit(",t,", ",frame,")}, [T, "column frame", "fps"]),
    "text in a number": ({T: edit("1,0\n", "1.0 m,0\n")}, [T, "line 3", "column x", "'1.0 m'"]),
    "text in time": ({T: edit("a,1", "a,noon")}, [T, "line 3", "column t", "'noon'"]),
    "empty cell": ({T: edit("ball,1,", "ball,,")}, [T, "line 3", "column x", "gap"]),
    "nan": ({T: edit("ball,1,", "ball,NaN,")}, [T, "line 3", "column x", "gap"]),
    "infinite": ({T: edit("ball,1,", "ball,inf,")}, [T, "line 3", "column x", "finite"]),
    "overflow": ({T: edit("ball,1,", "ball,1e400,")}, [T, "line 3", "column x"]),
    "absurd": ({T: edit("ball,1,", "ball,1e151,")}, [T, "line 3", "column x", "1e+150"]),
    "infinite time": ({T: edit("a,2", "a,inf")}, [T, "line 4", "column t"]),
    "decimal comma": ({T: edit("ball,1,0", "ball,1,5,0")}, [T, "line 3", "6 cells"]),
    "unsorted": ({T: edit("a,2", "a,0.5")}, [T, "line 4", "column t", "must increase", "sort"]),
    "duplicate": ({T: edit("a,2", "a,1")}, [T, "line 4", "duplicate", "'ball'", "one row"]),
    "blank entity": ({T: edit("a,1,ball", "a,1,")}, [T, "line 3", "column entity"]),
    "blank scene": ({T: edit("a,1,", ",1,")}, [T, "line 3", "column scene"]),
    "one frame": ({T: GOOD[: GOOD.index("a,1")]}, [T, "scene 'a'", "1 frame", "at least 3"]),
    "two at one point": (
        {T: GOOD + "a,0,b,5,5\na,1,b,1,0\n"}, [T, "'ball'", "'b'", "one point", "t = 1"],
    ),
    "empty file": ({T: ""}, [T, "empty", "header"]),
    "blank file": ({T: "\n \n"}, [T, "empty"]),
    "header only": ({T: "t,x,y\n"}, [T, "no rows"]),
    "no header": ({T: "0,0,0\n1,1,1\n1,2,2\n"}, [T, "line 1", "names of the columns", "t,x,y"]),
    "duplicated header": ({T: edit("entity,x", "x,x")}, [T, "line 1", "'x' twice"]),
    "short row": ({T: edit("ball,1,0", "ball,1")}, [T, "line 3", "4 cells", "header has 5"]),
    "long row": ({T: edit("ball,0,0", "ball,0,0,0")}, [T, "line 2", "6 cells", "header has 5"]),
    "open quote": ({T: edit("a,1,ball", 'a,1,"ball')}, [T, "line 3"]),
    "two encodings": (
        {T: GOOD.encode() + "a,3,Kügel,".encode() + "Kügel\n".encode("cp1252")},
        [T, "line 5", "iconv"],
    ),
    "cut in a letter": ({T: GOOD.encode() + b"a,3,b\xc3"}, [T, "line 5", "UTF-8"]),
    "utf-16": ({T: GOOD.encode("utf-16-le")}, [T, "UTF-16", "UTF-8"]),
    "utf-32": ({T: GOOD.encode("utf-32")}, [T, "UTF-32", "UTF-8"]),
    "binary": ({T: b"\x89PNG\r\n\x1a\n\x00\x00"}, [T, "UTF-8"]),
    "negative sigma": (
        {T: "t,x,y,sx\n0,0,0,1\n1,1,1,-1\n2,2,2,1\n"}, [T, "line 3", "column sx", "negative"],
    ),
    "no measured velocity": (
        {T: GOOD, D: '[columns]\nvelocity = "measured"\n'}, [T, "no column 'vx'"],
    ),
    "unknown entity": (
        {T: GOOD, E: "entity,mass\nbal,1\n"}, [T, "line 2", "'ball'", E, "present are bal"],
    ),
    "no entity column": ({T: GOOD, E: "name,mass\nball,1\n"}, [E, "no column 'entity'"]),
    "empty entities": ({T: GOOD, E: ""}, [E, "empty"]),
    "listed twice": ({T: GOOD, E: "entity\nball\nball\n"}, [E, "line 3", "twice"]),
    "zero mass": ({T: GOOD, E: "entity,mass\nball,0\n"}, [E, "line 2", "column mass", "positive"]),
    "negative mass": ({T: GOOD, E: "entity,mass\nball,-1\n"}, [E, "line 2", "empty"]),
    "mass is text": ({T: GOOD, E: "entity,mass\nball,heavy\n"}, [E, "line 2", "column mass"]),
    "mixed property": ({T: GOOD, E: "entity,c\nball,1\nb,x\n"}, [E, "line 3", "column c", "'x'"]),
    "infinite property": ({T: GOOD, E: "entity,c\nball,inf\n"}, [E, "line 2", "column c"]),
    "negative radius": ({T: GOOD, E: "entity,radius\nball,-1\n"}, [E, "line 2", "column radius"]),
    "unknown shape": ({T: GOOD, E: "entity,shape\nball,cube\n"}, [E, "line 2", "disc", "'cube'"]),
    "wall without size": ({T: GOOD, E: "entity,shape\nball,rect_wall\n"}, [E, "line 2", "width"]),
    "dynamic": ({T: GOOD, E: "entity,dynamic\nball,yes\n"}, [E, "line 2", "1 or 0", "'yes'"]),
    "dynamic 2": ({T: GOOD, E: "entity,dynamic\nball,2\n"}, [E, "line 2", "1 or 0"]),
    "unreadable toml": ({T: GOOD, D: "dt = \n"}, [D, "line 1", "TOML"]),
    "toml encoding": ({T: GOOD, D: 'name = "Kügel"'.encode("cp1252")}, [D, "UTF-8"]),
    "unknown key": ({T: GOOD, D: "fsp = 30\n"}, [D, "'fsp'", "allowed are", "fps"]),
    "unknown axis key": ({T: GOOD, D: '[axes]\nip = "y"\n'}, [D, "'ip'", "[axes]", "up"]),
    "unknown latent key": (
        {T: GOOD, D: "[latent.mass]\nlo = 1\n"}, [D, "'lo'", "[latent.mass]", "low"],
    ),
    "latent bounds": ({T: GOOD, D: "[latent.mass]\nlow = 2\nhigh = 1\n"}, [D, "below high"]),
    "latent share": ({T: GOOD, D: '[latent.mass]\nshare = "c"\n'}, [D, "share", "entity", "'c'"]),
    "latent entity": ({T: GOOD, D: '[latent.mass]\nentities = ["z"]\n'}, [D, "'z'", "ball"]),
    "table as value": ({T: GOOD, D: 'units = "m"\n'}, [D, "'units'", "table"]),
    "number for text": ({T: GOOD, D: "[units]\nlength = 1\ntime = 's'\n"}, [D, "'length'", "text"]),
    "up": ({T: GOOD, D: '[axes]\nup = "north"\n'}, [D, "up must be one of", "-y"]),
    "up in 2-D": ({T: GOOD, D: '[axes]\nup = "z"\n'}, [D, "'z'", "x, y"]),
    "negative fps": ({T: GOOD, D: "fps = -1\n"}, [D, "fps must be positive"]),
    "both clocks": ({T: GOOD, D: "fps = 1\ndt = 1\n"}, [D, "dt and fps"]),
    "negative noise": ({T: GOOD, D: "noise = -1\n"}, [D, "noise", "negative"]),
    "noise axes": ({T: GOOD, D: "noise = [1, 2, 3]\n"}, [D, "noise", "one per axis (2)"]),
    "noise of nobody": ({T: GOOD, D: "[noise]\nbal = 1\n"}, [D, "[noise]", "'bal'", "ball"]),
    "noise of a body": ({T: GOOD, D: "[noise]\nball = 0\n"}, [D, "noise of ball", "positive"]),
    "noise of three axes": ({T: GOOD, D: "[noise]\nball = [1, 2, 3]\n"}, [D, "of ball", "(2)"]),
    "a body without noise": (
        {T: GOOD + GOOD.split("\n", 1)[1].replace("a,", "b,").replace("ball", "cork"),
         D: "[noise]\nball = 1\n"}, [D, "'cork'", '"*"'],
    ),
    "velocity": ({T: GOOD, D: '[columns]\nvelocity = "yes"\n'}, [D, "only, unseen, sight, ignore"]),
    "column key": ({T: GOOD, D: '[columns]\nvelocty = "measured"\n'}, [D, "velocty", "velocity"]),
    "unknown unit": (
        {T: GOOD, D: '[units]\nlength = "smoot2"\ntime = "s"\n'}, [D, "smoot2", "column x"],
    ),
    "broken unit": ({T: GOOD, D: '[units]\nlength = "m/"\ntime = "s"\n'}, [D, "'m/'", "column x"]),
    "open bracket": ({T: GOOD, D: '[units]\nlength = "m("\ntime = "s"\n'}, [D, "'m('", "column x"]),
    "wrong dimension": (
        {T: GOOD, D: '[units]\nlength = "kg"\ntime = "s"\n'}, [D, "must be one of m", "'kg'"],
    ),
    "unit of nothing": (
        {T: GOOD, D: '[units]\nlength = "m"\ntime = "s"\nmas = "g"\n'},
        [D, "'mas'", "length, time, mass", "entity"],
    ),
    "stiffness in grams": (
        {
            T: GOOD,
            E: "entity,stiffness\nball,1\n",
            D: '[units]\nlength = "m"\ntime = "s"\nmass = "g"\n',
        },
        [D, "stiffness", 'add stiffness = "kg/s^2"'],
    ),
    "overlapping split": (
        {T: SPLIT, D: '[split]\ntrain = "*"\ntest = "b"\n'}, [D, "b", "both in train and in test"],
    ),
    "split of nothing": ({T: SPLIT, D: '[split]\ntrain = "drop_*"\n'}, [D, "'drop_*'", "a, b"]),
    "split range": ({T: SPLIT, D: '[split]\ntest = "7..9"\n'}, [D, "'7..9'", "matches nothing"]),
    "split type": ({T: SPLIT, D: "[split]\ntest = [1.5]\n"}, [D, "1.5", "a..b"]),
    "evaluation": ({T: GOOD, D: "[evaluation]\nendpoint_row = 0\n"}, [D, "endpoint_row", "from 1"]),
    "no trajectories": ({"tracks.csv": GOOD, "film.mp4": ""}, [f"no {T}", "tracks.csv"]),
}  # fmt: skip


@pytest.mark.parametrize("defect", DEFECTS)
def test_defect_is_reported(tmp_path, defect):
    files, expected = DEFECTS[defect]
    for name, content in files.items():
        data = content if isinstance(content, bytes) else content.encode("utf-8")
        (tmp_path / name).write_bytes(data)
    with pytest.raises(DataError) as caught:
        load_dataset(tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    for part in [str(tmp_path), *expected]:
        assert part in message, message


def test_good_data_are_good(tmp_path):
    (tmp_path / T).write_text(GOOD, encoding="utf-8")
    assert load_dataset(tmp_path).scenes[0].positions.shape == (3, 1, 2)


def test_missing_path(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        load_dataset(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("limit", "value", "expected"), [("MAX_ROWS", 2, "rows"), ("MAX_BYTES", 20, "GB")]
)
def test_absurd_size(tmp_path, monkeypatch, limit, value, expected):
    (tmp_path / T).write_text(GOOD, encoding="utf-8")
    monkeypatch.setattr(sources, limit, value)
    with pytest.raises(DataError, match=expected):
        load_dataset(tmp_path)


def test_too_many_short_tracks(tmp_path, monkeypatch):
    (tmp_path / T).write_text(GOOD, encoding="utf-8")
    monkeypatch.setattr(assembly, "MAX_CELLS", 5)
    with pytest.raises(DataError, match="filter_stubs"):
        load_dataset(tmp_path)


@pytest.mark.parametrize("unit", [{"length": "m"}, {"time": "s"}])
def test_half_of_the_units_is_told_as_such(tmp_path, unit):
    (tmp_path / T).write_text(GOOD, encoding="utf-8")
    (other,) = {"length", "time"} - set(unit)
    notes = " ".join(load_dataset(tmp_path, units=unit).notes)
    assert f"check: no unit of {other} is given: {other}s stay numbers of the file" in notes


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"fps": 0}, "fps must be positive"),
        ({"fps": "fast"}, "fps must be a finite number"),
        ({"fps": 1, "dt": 1}, "dt and fps"),
        ({"train": "zzz"}, "'zzz'"),
        ({"columns": {"x": "Q"}}, "'Q'"),
    ],
)
def test_bad_arguments(tmp_path, arguments, expected):
    (tmp_path / T).write_text(GOOD, encoding="utf-8")
    with pytest.raises(DataError, match=expected):
        load_dataset(tmp_path, **arguments)


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ({}, "empty mapping"),
        ([1, 2], "must be a DataFrame"),
        (pd.DataFrame({"t": [], "x": [], "y": []}), "no rows"),
        (pd.DataFrame({"t": [0, 1, 2], "x": [0, 1, 2], "w": [0, 1, 3]}), "no column 'y'"),
        (pd.DataFrame({"t": [0, 1, 2], "w": [0, 1, 2]}), "no column 'x'"),
        (pd.DataFrame({"t": [0, 1, 2], "x": [0, np.nan, 2], "y": 0.0}), "empty cell or NaN"),
        (pd.DataFrame({"t": [0, 1, 2], "x": ["0", "a", "2"], "y": 0.0}), "expected numbers"),
    ],
)
def test_bad_frames(frames, expected):
    with pytest.raises(DataError, match=expected):
        Dataset.from_frames(frames)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("Time (s),X,Y (m/s^2)", "accelerations (Y (m/s^2)"),
        ("Time (s),X,Y (rad/s)", "angular velocities (Y (rad/s)"),
    ],
)
def test_what_a_telephone_feels_is_no_place(tmp_path, header, expected):
    path = tmp_path / "Raw Data.csv"
    path.write_text(header + "\n" + "".join(f"{k / 50},0.{k},9.8\n" for k in range(9)))
    with pytest.raises(DataError) as error:
        load_dataset(path)
    for text in (expected, "no positions", 'x": "Y (', "film", "LiDAR, sonar", "GPS"):
        assert text in str(error.value)
