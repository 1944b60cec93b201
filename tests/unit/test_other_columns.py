"""Columns that nobody asked for, and columns of bodies without their name."""

import pandas as pd
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.errors import DataError


def table(tmp_path, text, name="data.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_text(text, encoding=encoding)
    return path


def rows(*cells, n=6):
    """Rows of a clock, a fall and some more columns, functions of the row."""
    return "".join(
        ",".join([f"{0.1 * k:.1f}", f"{k * k}", *(str(cell(k)) for cell in cells)]) + "\n"
        for k in range(n)
    )


@pytest.mark.parametrize(
    ("header", "cell"),
    [
        ("Zeit (s),Weg (cm),Temperatur (°C)", lambda k: 19.2 + 0.1 * k),
        ("Zeit (s),Weg (cm),Messwert", lambda k: 0.1 * k),
        ("t,x,voltage", lambda k: 5 + 0.1 * k),
        ("t,x,Spannung U", lambda k: 5 + 0.1 * k),
        ("t,x,level", lambda k: 3),
        ("t,x,remark_of_mine", lambda k: f"fine {k}"),
        ("t (s),x (m),U (V)", lambda k: 5 + k),
    ],
)
def test_what_is_no_place_is_left_out_and_told(tmp_path, header, cell):
    data = bsp_gp.load_dataset(table(tmp_path, f"{header}\n{rows(cell)}"))
    assert f"not used: {header.split(',')[-1]}" in data.notes
    assert not data.scenes[0].inputs


@pytest.mark.parametrize("header", ["t,x,gap", "t (s),x (m),depth (m)", "t,x,q"])
def test_what_may_be_the_other_axis_is_asked_for(tmp_path, header):
    path, name = table(tmp_path, f"{header}\n{rows(lambda k: 2 * k + k * k)}"), "columns"
    with pytest.raises(DataError, match=r'columns=\{"y": .*columns=\{".*": "ignore"\}'):
        bsp_gp.load_dataset(path)
    theirs = header.split(",")[-1].split(" (")[0]
    data = bsp_gp.load_dataset(path, **{name: {theirs: "ignore"}})
    assert f"not used: {header.split(',')[-1]}" in data.notes
    seen = bsp_gp.load_dataset(path, columns={"y": header.split(",")[-1]})
    assert seen.scenes[0].positions[1, 0, 1] == 3


def test_any_column_may_be_left_out(tmp_path):
    path = table(tmp_path, f"t,x,y\n{rows(lambda k: -k)}")
    data = bsp_gp.load_dataset(path, columns={"y": "ignore"})
    assert not data.scenes[0].positions[..., 1].any() and "not used: y" in data.notes
    with pytest.raises(DataError, match=r'no column .w.; present are t, x, y.*"ignore"'):
        bsp_gp.load_dataset(path, columns={"w": "ignore"})


def test_check_says_what_it_understood_before_it_refuses(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = table(tmp_path, f"Zeit,Weg,gap\n{rows(lambda k: 2 * k)}")
    assert main(["check", str(path)]) == 2
    told = capsys.readouterr()
    assert "t = 'Zeit', x = 'Weg'" in told.out and "Not known: 'gap'" in told.out
    assert "--columns gap=ignore" in told.err
    assert main(["check", str(path), "--columns", "gap=ignore"]) == 0
    assert "Note: not used: gap" in capsys.readouterr().out


def two_bodies(column, names=("A", "B"), is_stacked=False):
    frame = pd.DataFrame({
        "t": [0.0, 0.0, 0.1, 0.1, 0.2, 0.2], column: list(names) * 3,
        "x": [1.0, -1.0, 0.9, -0.9, 0.7, -0.7], "y": [0.0, 0.1] * 3,
    })  # fmt: skip
    return frame.sort_values([column, "t"], ignore_index=True) if is_stacked else frame


@pytest.mark.parametrize(
    ("column", "names", "is_stacked"),
    [
        ("puck", ("A", "B"), False),
        ("puck", (1, 2), True),
        ("Kugel Nr.", (1, 2), False),
        ("Körper", ("rot", "blau"), True),
        ("who", ("anna", "bea"), False),
        ("id", (1, 2), True), ("ID", ("ant3", "ant7"), True),
    ],
)
def test_what_tells_rows_at_one_time_apart_names_bodies(column, names, is_stacked):
    data = bsp_gp.Dataset.from_frames(two_bodies(column, names, is_stacked))
    assert set(data.scenes[0].names) == {str(name) for name in names}
    assert any(f"{column!r} as entity" in note for note in data.notes)
    assert not any("not used" in note for note in data.notes)


@pytest.mark.parametrize(
    ("column", "names", "is_stacked"),
    [("condition", ("slow", "fast"), True), ("level", (1, 2), False)],
)
def test_where_it_is_not_clear_the_options_can_be_copied(column, names, is_stacked):
    with pytest.raises(DataError, match=r'columns=\{"entity": "COLUMN"\}'):
        bsp_gp.Dataset.from_frames(two_bodies(column, names, is_stacked))
    data = bsp_gp.Dataset.from_frames(
        two_bodies(column, names, is_stacked), columns={"scene": column}
    )
    assert len(data.scenes) == 2


@pytest.mark.parametrize("heading", ["Lichtzeiger x / mm", "light spot x (mm)", "Spot_x [mm]"])
def test_one_thing_with_one_place_is_no_body_beside_others(tmp_path, heading):
    path = tmp_path / "log.csv"
    path.write_text(f"t / s;{heading}\n" + "".join(f"{k};{k * k}\n" for k in range(8)), "utf-8")
    (scene,) = bsp_gp.load_dataset(path).scenes
    assert scene.names == ("object",) and scene.positions[2, 0, 0] == pytest.approx(0.004)
