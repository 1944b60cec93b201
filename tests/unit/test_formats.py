import numpy as np
import pytest

from bsp_gp.data.formats import read_table
from bsp_gp.data.sniffing import normalise_columns
from bsp_gp.data.tables import load_dataset

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
        (["t", "x error", "fit x", "x"], ("t", "x error", "fit x", "x")),
        (["t", "x", "v_x / (m/s)", "y velocity (m/s²)"], ("t", "x", "vx", "vy")),
        (["t", "x", "position x"], ("t", "x", "position x")),
    ],
)
def test_names_in_headers(header, names):
    assert normalise_columns(header)[0] == names


def test_a_renamed_column_keeps_the_unit_of_its_header():
    names, units, renamed = normalise_columns(["t", "Ort / cm"], {"x": "Ort"})
    assert names == ("t", "x") and units == {"x": "cm"} and renamed == {"x"}


def test_declared_units_win_over_the_header(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t (s),x (cm),y (cm)\n0,0,1\n0.5,1.5,2\n1,4.25,3\n", encoding="utf-8")
    dataset = load_dataset(path, units={"x": "mm", "y": "mm"})
    assert dataset.scenes[0].positions[1, 0, 0] == pytest.approx(1.5e-3)


@pytest.mark.parametrize(("length", "scale"), [("m", 1.0), ("0.17 um", 0.17e-6), ("cm", 0.01)])
@pytest.mark.parametrize("header", ["t (s),x (cm),y (cm)", "t,x (px),y (px)"])
def test_a_declared_kind_wins_over_the_header_and_is_told(tmp_path, header, length, scale):
    path = tmp_path / "run.csv"
    path.write_text(f"{header}\n0,0,1\n0.5,1.5,2\n1,4.25,3\n", encoding="utf-8")
    dataset = load_dataset(path, units={"length": length, "time": "s"})
    assert dataset.scenes[0].positions[1, 0] == pytest.approx([1.5 * scale, 2 * scale])
    told = [note for note in dataset.notes if "as declared" in note]
    assert len(told) == (0 if f"({length})" in header else 2)


def test_tracker_single_mass(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("mass A\nt\tx\ty\n0,0\t0,0\t1\n0,5\t1,5\t2\n1\t4,25\t3\n", encoding="utf-8")
    scene = load_dataset(path).scenes[0]
    assert scene.names == ("mass A",)
    assert scene.positions[:, 0, 0].tolist() == X


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
    assert any("'mass' is not used" in note for note in dataset.notes)


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
