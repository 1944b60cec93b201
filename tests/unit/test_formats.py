import numpy as np
import pytest

from bsp_gp.data.formats import read_table
from bsp_gp.data.headings import headings
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError

X = [0.0, 1.5, 4.25]
DIALECTS = {
    "comma": "t,x,y\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
    "crlf and BOM": "\ufefft,x,y\r\n0,0,1\r\n0.5,1.5,2\r\n1,4.25,3\r\n",
    "blanks after commas": "t, x, y\n0, 0, 1\n0.5, 1.5, 2\n\n1, 4.25, 3\n\n",
    "tab": "t\tx\ty\n0\t0\t1\n0.5\t1.5\t2\n1\t4.25\t3\n",
    "white space": "  t   x  y\n 0.0  0  1\n 0.5 1.5  2\n1 4.25   3\n",
    "decimal comma": "t;x;y\n0;0;1\n0,5;1,5;2\n1;4,25;3\n",
    "decimal comma, tab": "t\tx\ty\n0,0\t0,0\t1,0\n0,5\t1,5\t2\n1\t4,25\t3\n",
    "titles": "Logger 3\nrun of May\n\nTime,X,Y\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
    "trailing delimiters": "t,x,y,\n0,0,1,\n0.5,1.5,2,\n1,4.25,3,\n",
    "index column": ",t,x,y\n0,0,0,1\n1,0.5,1.5,2\n2,1,4.25,3\n",
    "quotes": '"t","x","y"\n"0","0","1"\n"0.5","1.5","2"\n"1","4.25","3"\n',
    "further columns": "step,t,x,y,label\n1,0,0,1,a\n2,0.5,1.5,2,b\n3,1,4.25,3,c\n",
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects(tmp_path, dialect):
    path = tmp_path / "run.csv"
    path.write_bytes(DIALECTS[dialect].encode("utf-8"))
    scene = load_dataset(path).scenes[0]
    assert scene.name == "run"
    assert scene.times.tolist() == [0.0, 0.5, 1.0]
    assert scene.positions[:, 0, 0].tolist() == X
    assert scene.positions[:, 0, 1].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "text",
    [
        "t (s),x (cm),y (cm)\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
        "t [s];x [cm];y [cm]\n0;0;1\n0,5;1,5;2\n1;4,25;3\n",
        "t,x,y\ns,cm,cm\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
        "Zeit t (s);x (cm);y (cm)\n0;0;1\n0,5;1,5;2\n1;4,25;3\n",
        "t in s;x in cm;y in cm\n0;0;1\n0,5;1,5;2\n1;4,25;3\n",
        "t / s,x / cm,y / cm\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
        "t/s\tx/cm\ty/cm\n0\t0\t1\n0,5\t1,5\t2\n1\t4,25\t3\n",
        "Elapsed Time (s),x-Position [cm],pos_y / (cm)\n0,0,1\n0.5,1.5,2\n1,4.25,3\n",
        "t\tx\ty\n(s)\t(cm)\t(cm)\n0\t0\t1\n0.5\t1.5\t2\n1\t4.25\t3\n",
    ],
)
def test_units_in_the_header(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    dataset = load_dataset(path)
    assert dataset.scenes[0].positions[:, 0, 0] == pytest.approx(np.array(X) / 100)
    assert dataset.units.declared["length"] == "cm"


@pytest.mark.parametrize(
    ("header", "names"),
    [
        (["t", "ratio / s", "x", "in s"], ("t", "ratio / s", "x", "in s")),
        (["t", "x / s", "y in kg", "x"], ("t", "x / s", "y in kg", "x")),
        (["t", "x error", "fit x", "x"], ("t", "sx", "fit x", "x")),
        (["t", "x", "v_x / (m/s)", "y velocity (m/s²)"], ("t", "x", "vx", "vy")),
        (["t", "x", "position x"], ("t", "x", "position x")),
    ],
)
def test_names_in_headers(header, names):
    assert tuple(h.name for h in headings(header)) == names


def test_a_renamed_column_keeps_the_unit_of_its_header():
    t, x = headings(["t", "Ort / cm"], {"x": "Ort"})
    assert (t.name, x.name, x.unit) == ("t", "x", "cm")
    assert x.is_renamed and not t.is_renamed


def test_declared_units_win_over_the_header(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t (s),x (cm),y (cm)\n0,0,1\n0.5,1.5,2\n1,4.25,3\n", encoding="utf-8")
    dataset = load_dataset(path, units={"x": "mm", "y": "mm"})
    assert dataset.scenes[0].positions[1, 0, 0] == pytest.approx(1.5e-3)


@pytest.mark.parametrize("word", ["year", "Jahr", "année", "decimal year"])
def test_a_column_of_years_is_the_time_where_there_is_no_other(tmp_path, word):
    path = tmp_path / "pair.csv"
    path.write_text(f"{word},A_x (au),A_y (au),B_x (au),B_y (au)\n2000,0,1,2,3\n2001,1,1,2,4\n"
                    "2002,3,1,2,5\n", encoding="utf-8")  # fmt: skip
    scene = load_dataset(path).scenes[0]
    assert scene.names == ("A", "B")
    assert np.diff(scene.times) == pytest.approx(365.25 * 86400)
    path.write_text(f"t (s),x (m),y (m),{word}\n0,1,2,2000\n1,3,4,2001\n2,3,5,2002\n",
                    encoding="utf-8")  # fmt: skip
    assert load_dataset(path).scenes[0].times.tolist() == [0, 1, 2]


@pytest.mark.parametrize(("length", "scale"), [("m", 1.0), ("0.17 um", 0.17e-6), ("cm", 0.01)])
@pytest.mark.parametrize("header", ["t (s),x (cm),y (cm)", "t,x (px),y (px)"])
def test_a_declared_kind_wins_over_the_header_and_is_told(tmp_path, header, length, scale):
    path = tmp_path / "run.csv"
    path.write_text(f"{header}\n0,0,1\n0.5,1.5,2\n1,4.25,3\n", encoding="utf-8")
    dataset = load_dataset(path, units={"length": length, "time": "s"})
    assert dataset.scenes[0].positions[1, 0] == pytest.approx([1.5 * scale, 2 * scale])
    told = [note for note in dataset.notes if "as declared" in note]
    assert len(told) == (0 if f"({length})" in header else 2)


def test_a_unit_in_words_is_the_declared_one(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t_segundos,X_metros,Y_metros\n0,0,1\n0.5,1.5,2\n1,4.25,3\n", encoding="utf-8")
    data = load_dataset(path, units={"length": "m", "time": "s"})
    assert data.notes == ()
    data = load_dataset(path, units={"length": "cm"})
    assert "x is in 'cm' as declared, not in 'metros'" in data.notes


def test_tracker_single_mass(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("mass A\nt\tx\ty\n0,0\t0,0\t1\n0,5\t1,5\t2\n1\t4,25\t3\n", encoding="utf-8")
    scene = load_dataset(path).scenes[0]
    assert scene.names == ("mass A",)
    assert scene.positions[:, 0, 0].tolist() == X


def test_a_header_may_end_with_a_delimiter_that_rows_have_not(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text(",mass A,,\nt,x,y,\n0.0E0,0,1\n5.0E-1,1.5,2\n1,4.25,3\n", encoding="utf-8")
    scene = load_dataset(path).scenes[0]
    assert scene.names == ("mass A",)
    assert scene.positions[:, 0, 0].tolist() == X


@pytest.mark.parametrize("header", ["t\tx\ty error", "# t\tx\ty error", "t\tx\ty\terror"])
def test_tabs_and_blanks_may_be_mixed(tmp_path, header):
    path = tmp_path / "copied.txt"
    rows = "0\t0\t 1\t9\n0.5\t1.5  2\t9\n1\t4.25\t3\t9\n"
    path.write_text(f"# as copied\n{header}\n{rows}", encoding="utf-8")
    scene = load_dataset(path, columns={"error": "ignore"}).scenes[0]
    assert scene.positions[:, 0].tolist() == [[0, 1], [1.5, 2], [4.25, 3]]


@pytest.mark.parametrize("cell", ["X", "-", "--", "...", "NA", "n/a", "?", "none", ""])
def test_what_stands_for_no_value_is_none(tmp_path, cell):
    path = tmp_path / "run.csv"
    path.write_text(f"t,x,y,sx,sy\n0,0,1,0.1,{cell}\n0.5,{cell},{cell},,\n1,4,3,0.1,0.1\n"
                    "2,4,5,1,1\n", encoding="utf-8")  # fmt: skip
    scene = load_dataset(path).scenes[0]
    assert scene.times.tolist() == [0, 1, 2] and np.isnan(scene.sigma[0, 0, 1])


@pytest.mark.parametrize(
    "text",
    [
        "mass A,,,mass B,,\nt,x,y,t,x,y\n0,0,1,0,5,6\n0.5,1.5,2,0.5,,\n1,4.25,3,1,7,8\n",
        "mass A,mass B\nt,x,y,t,x,y\n0,0,1,0,5,6\n0.5,1.5,2,,,\n1,4.25,3,1,7,8\n",
        ",mass A,,mass B,\nt,x,y,x,y\n0,0,1,5,6\n0.5,1.5,2,,\n1,4.25,3,7,8\n",
    ],
)
def test_tracker_masses_side_by_side(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    scene = load_dataset(path).scenes[0]
    assert scene.names == ("mass A", "mass B")
    assert scene.positions[:, 0, 0].tolist() == X
    assert np.isnan(scene.positions[1, 1]).all()
    assert scene.positions[2, 1].tolist() == [7.0, 8.0]


def test_trackpy_csv(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text(
        ",y,x,mass,frame,particle\n"
        + "".join(f"{k},{k}.25,{2 * k},310.5,{k},7\n" for k in range(4)),
        encoding="utf-8",
    )
    dataset = load_dataset(path, fps=25)
    scene = dataset.scenes[0]
    assert scene.names == ("7",)
    assert scene.times == pytest.approx([0, 0.04, 0.08, 0.12])
    assert scene.positions[1, 0].tolist() == [2.0, 1.25]
    assert any(note == "not used: mass" for note in dataset.notes)


def test_line_numbers_survive_titles_and_blank_lines(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("title\n\nt,x,y\n0,0,1\n\n1,1,1\n", encoding="utf-8")
    assert read_table(path).frame.index.tolist() == [4, 6]


def test_numbers_are_read_exactly(tmp_path):
    values = np.random.default_rng(31).integers(0, 2**64, 2000, dtype=np.uint64).view(float)
    values = values[np.abs(values) < 1e140]
    path = tmp_path / "run.csv"
    lines = [f"{k},{value!r},0" for k, value in enumerate(values.tolist())]
    path.write_text("t,x,y\n" + "\n".join(lines) + "\n", encoding="utf-8")
    np.testing.assert_array_equal(read_table(path).frame["x"].to_numpy(), values)


@pytest.mark.parametrize("cells", ["2024-03-01 12:00:0{}", "1.3.2024 12:00:0{}", "12:00:0{}"])
def test_times_as_dates_are_seconds(tmp_path, cells):
    path = tmp_path / "run.csv"
    rows = "".join(f"{cells.format(2 * k)},{x},0\n" for k, x in enumerate(X))
    path.write_text("Time,x,y\n" + rows, encoding="utf-8")
    dataset = load_dataset(path, units={"length": "cm"})
    steps = np.diff(dataset.scenes[0].times)
    assert steps == pytest.approx([2.0, 2.0])
    assert dataset.units.declared["time"] == "s"
    assert any("seconds since" in note for note in dataset.notes)


def test_dates_are_put_into_the_unit_that_is_declared(tmp_path):
    path = tmp_path / "run.csv"
    rows = "".join(f"2024-03-0{k + 1}T06:00:00Z,{x},0\n" for k, x in enumerate(X))
    path.write_text("epoch_utc,x,y\n" + rows, encoding="utf-8")
    dataset = load_dataset(path, columns={"t": "epoch_utc"}, units={"length": "km", "time": "d"})
    assert np.diff(dataset.scenes[0].times) == pytest.approx([86400.0, 86400.0])
    assert dataset.units.declared["time"] == "d"
    assert any("times are in d since 2024-03-01" in note for note in dataset.notes)
    assert not any("as declared" in note for note in dataset.notes)


@pytest.mark.parametrize("cell", ["3/4/2024", "noon", "2024-13-01"])
def test_dates_that_may_be_mistaken_are_refused(tmp_path, cell):
    path = tmp_path / "run.csv"
    path.write_text(f"t,x,y\n{cell},0,0\n1,1,1\n2,2,2\n", encoding="utf-8")
    with pytest.raises(DataError, match="2024-01-31T12:00:00"):
        load_dataset(path)


def test_two_positions_are_two_bodies_where_the_user_says_so(tmp_path):
    path = tmp_path / "carts.csv"
    path.write_text("Time (s),Pos 1 (m),Pos 2 (m)\n0,0,5\n1,1.5,6\n2,4.25,7\n", "utf-8")
    dataset = load_dataset(path, columns={"red_x": "Pos 1", "blue_x": "Pos 2 (m)"})
    scene = dataset.scenes[0]
    assert scene.names == ("red", "blue")
    assert scene.positions[:, :, 0].T.tolist() == [X, [5.0, 6.0, 7.0]]


def test_x1_and_x2_alone_are_two_bodies_on_a_line_and_it_is_told(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,x1,x2\n0,0,5\n1,1.5,6\n2,4.25,7\n", "utf-8")
    dataset = load_dataset(path)
    assert set(dataset.scenes[0].names) == {"1", "2"}
    assert any("'x1' as x of 1" in note for note in dataset.notes)
    assert load_dataset(path, columns={"x": "x1", "y": "x2"}).scenes[0].names == ("object",)
    path.write_text("t,xA,xB\n0,0,5\n1,1.5,6\n2,4.25,7\n", "utf-8")
    assert set(load_dataset(path).scenes[0].names) == {"A", "B"}


def test_x1_x2_and_x3_alone_may_be_two_things(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,x1,x2,x3\n0,0,5,1\n1,1.5,6,2\n2,4.25,7,4\n", "utf-8")
    with pytest.raises(DataError, match="x1, x2, x3.*columns={.x.: .*BODY_x"):
        load_dataset(path)


@pytest.mark.parametrize("ending", [".cmbl", ".cap", ".xls", ".ods"])
def test_formats_of_other_programs_say_how_to_get_a_table(tmp_path, ending):
    path = tmp_path / f"run{ending}"
    path.write_bytes(b"<Document>")
    with pytest.raises(DataError, match="CSV|Export"):
        load_dataset(path)


def test_a_wrong_name_of_a_column_names_those_there_are(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Zeit (s);Ort x (m);Ort y (m);Nr\n0;0;5;1\n", "utf-8")
    with pytest.raises(DataError, match="'Versuch'.*Ort x .m., .*Nr; write columns={.scene."):
        load_dataset(path, columns={"scene": "Versuch"})


def test_a_broken_workbook_is_refused(tmp_path):
    path = tmp_path / "run.xlsx"
    path.write_bytes(b"PK no workbook")
    with pytest.raises(DataError, match="no workbook"):
        load_dataset(path)


def test_gyroscopes_and_fields_are_no_bodies(tmp_path):
    path = tmp_path / "phone.csv"
    names = [f"Gyroscope {a} (rad/s)" for a in "xyz"] + [f"Magnetic field {a} (µT)" for a in "xyz"]
    path.write_text("Time (s)," + ",".join(names) + "\n" + "0,1,2,3,4,5,6\n" * 3, "utf-8")
    with pytest.raises(DataError, match="several columns may be the velocity: Gyroscope x"):
        load_dataset(path)


def test_names_and_units_in_comments_above_a_table_of_blanks(tmp_path):
    """As tables of astronomers have them: units stand below their names, not one for each."""
    path = tmp_path / "orbit.dat"
    path.write_text(
        "# places of B with respect to A, J2000\n"
        "# time      x      y    note\n"
        "# (yr)    (mm)   (mm)\n"
        "2001.25   1.5     2.0   a\n2001.50   2.5     3.0   a\n2001.75   3.5     4.5   b\n",
        encoding="utf-8",
    )
    scene = load_dataset(path).scenes[0]
    np.testing.assert_allclose(scene.positions[:, 0, 0], [1.5e-3, 2.5e-3, 3.5e-3])


@pytest.mark.parametrize(("name", "second"), [("ms", 1e-3), ("millis", 1e-3), ("sec", 1.0)])
def test_a_column_that_is_called_by_a_unit_of_time_is_the_time(tmp_path, name, second):
    path = tmp_path / "log.csv"
    path.write_text(f"{name},x (m),y (m)\n0,0,1\n500,1.5,2\n1000,4.25,3\n", encoding="utf-8")
    times = load_dataset(path).scenes[0].times
    np.testing.assert_allclose(times, np.array([0.0, 500.0, 1000.0]) * second)
    path.write_text(f"t,{name},x (m),y (m)\n0,9,0,1\n1,8,1.5,2\n2,7,4.25,3\n", encoding="utf-8")
    assert load_dataset(path, units={"time": "s"}).scenes[0].times.tolist() == [0.0, 1.0, 2.0]


def test_a_first_name_may_be_said_with_its_mark(tmp_path):
    path = tmp_path / "bag.csv"
    rows = "".join(f"{9 * k},{k},{x}\n" for k, x in enumerate(X))
    path.write_text("%time,stamp,pos\n" + rows, encoding="utf-8")
    columns = {"t": "stamp", "x": "pos", "%time": "ignore"}
    dataset = load_dataset(path, columns=columns, units={"length": "m", "time": "s"})
    assert dataset.scenes[0].times.tolist() == [0.0, 1.0, 2.0]
    columns = {"t": "%time", "x": "pos", "stamp": "ignore"}
    dataset = load_dataset(path, columns=columns, units={"length": "m", "time": "s"})
    assert dataset.scenes[0].times.tolist() == [0.0, 9.0, 18.0]


def _runs(tmp_path, *names, count=2):
    """A table of runs side by side, each with these columns."""
    path = tmp_path / "runs.csv"
    header = [f"{name} Run #{k}" for k in range(1, count + 1) for name in names]
    own = [10 * k + i for k in range(count) for i in range(len(names))]
    rows = [[str(value + j) for value in own] for j in range(5)]
    path.write_text("\n".join(map(",".join, [header, *rows])) + "\n", encoding="utf-8")
    return path


PENDULUM = ("Time (s)", "Angle (rad)", "Acceleration (m/s²)", "Position (m)")


@pytest.mark.parametrize("name", ["x", "theta"])
@pytest.mark.parametrize("theirs", ["Angle (rad) Run #1", "Angle (rad) Run #2", "Angle (rad)"])
def test_a_column_that_is_named_is_that_of_every_run(tmp_path, name, theirs):
    data = load_dataset(_runs(tmp_path, *PENDULUM), columns={name: theirs})
    assert [scene.name for scene in data.scenes] == ["Run #1", "Run #2"]
    assert [scene.positions[0, 0, 0] for scene in data.scenes] == [1.0, 11.0]
    assert data.units.declared["length"] == "rad"


def test_columns_of_two_runs_that_are_named_are_two_bodies(tmp_path):
    columns = {"red_x": "Position (m) Run #1", "blue_x": "Position (m) Run #2"}
    path = _runs(tmp_path, "Time (s)", "U (V)", "I (A)", "Position (m)")
    (scene,) = load_dataset(path, columns={"t": "Time (s) Run #1", **columns}).scenes
    assert scene.names == ("red", "blue") and scene.positions[0, :, 0].tolist() == [3.0, 13.0]


def test_of_runs_without_a_sure_place_it_is_asked_for(tmp_path):
    with pytest.raises(DataError, match="of Run #1 no column is a place.* Angle .*for all"):
        load_dataset(_runs(tmp_path, *PENDULUM))


def test_columns_of_one_name_that_nobody_uses_do_no_harm(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,x,note,y,note\n0,0,a,1,b\n1,1,a,2,b\n2,4,a,3,b\n", encoding="utf-8")
    data = load_dataset(path)
    assert data.scenes[0].positions[:, 0, 1].tolist() == [1, 2, 3]
    assert "not used: note" in data.notes


ERRORS = {
    "x_err": "t,x,x_err,y,y_err",
    "err_x": "t,x,err_x,y,err_y",
    "sigma": "t (s),x (m),σx,y (m),σ_y",
    "right of it": "t,x,Error,y,Error",
    "of what is called so": "t,Δ1,Δ1.Error,Δ2,Error Δ2",
    "of a body": "t,red_x,red_x_err,red_y,red_y_err",
}
NO_ERRORS = {
    "differences": "t,x,dx,y,dy",
    "vectors": "t,x,e_x,y,u_y",
    "of one axis": "t,x,x_err,y,q",
    "parts": "t,x,x_err (%),y,y_err (%)",
    "fits": "t,x,x_fit,y,y_residual",
}


@pytest.mark.parametrize("kind", ERRORS)
def test_errors_beside_places_count_row_by_row_and_are_told(tmp_path, kind):
    path = tmp_path / "run.csv"
    path.write_text(f"{ERRORS[kind]}\n0,0,0.1,1,0.2\n1,1.5,0.3,2,\n2,4,0.1,3,0.4\n", "utf-8")
    columns = {"x": "Δ1", "y": "Δ2"} if "Δ" in ERRORS[kind] else {}
    data = load_dataset(path, columns=columns)
    assert data.scenes[0].sigma[:, 0, 0].tolist() == [0.1, 0.3, 0.1]
    assert np.isnan(data.scenes[0].sigma[1, 0, 1]) and any("as sx" in note for note in data.notes)
    if kind == "x_err":
        ignored = load_dataset(path, columns={"x_err": "ignore", "y_err": "ignore"})
        assert ignored.scenes[0].sigma is None


@pytest.mark.parametrize("header", [*NO_ERRORS.values(), "t,x,x_err,y,y_err"])
def test_what_only_looks_like_errors_is_left_alone(tmp_path, header):
    path = tmp_path / "run.csv"
    path.write_text(f"{header}\n0,0,0.1,1,0.2\n1,1.5,0.3,2,-0.1\n2,4,0.1,3,0.4\n", "utf-8")
    data = load_dataset(path)
    assert data.scenes[0].sigma is None
    assert any(note.startswith(f"not used: {header.split(',')[2]}") for note in data.notes)
