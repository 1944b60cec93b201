"""Tables as people write them in other languages, encodings, and formats of other programs."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from bsp_gp.data.tables import load_dataset
from bsp_gp.data.words import folded, n_known_words, words_for
from bsp_gp.errors import DataError

TIMES = np.arange(12) * 0.1
FALL = 1.0 + 2 * TIMES - 4.9 * TIMES**2


def read(tmp_path, text, name="run.csv", encoding="utf-8", **options):
    """The data set of a file with this text."""
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return load_dataset(path, **options)


def rows(*columns, sep=","):
    """Lines of columns of numbers."""
    return "".join(sep.join(f"{v:.4f}" for v in row) + "\n" for row in zip(*columns, strict=True))


def along(dataset, axis, scene=0, body=0):
    """A coordinate of a body."""
    return dataset.scenes[scene].positions[:, body, axis]


HEADERS = [
    ("Tid (s);Posisjon (m)", 0), ("Tid (s);Høyde (m)", 1), ("tid;sträcka", 0),
    ("Tijd (s);Hoogte (m)", 1), ("Czas (s);Wysokość (m)", 1), ("Čas (s);Výchylka (m)", 0),
    ("Idő (s);Magasság (m)", 1), ("Zaman (s);Konum (m)", 0), ("Время (с);Координата (м)", 0),
    ("Время, с;Высота, м", 1), ("Χρόνος (s);Θέση (m)", 0), ("Waktu (s);Ketinggian (m)", 1),
    ("时间（秒）;高度（米）", 1), ("時間[s];位置[m]", 0), ("시간(s);높이(m)", 1),
    ("Zeit (Sekunden);Weg (Meter)", 0), ("Zeit (in s);x (in m)", 0), ("t;alt", 1),
    ("Time (s);Altitude (m-AGL)", 1), ("data.time;data.altitude", 1),
]  # fmt: skip


@pytest.mark.parametrize(("header", "axis"), HEADERS)
def test_headings_of_many_languages_are_times_and_places(tmp_path, header, axis):
    dataset = read(tmp_path, f"{header}\n{rows(TIMES, FALL, sep=';')}")
    assert np.allclose(along(dataset, axis), FALL, atol=1e-4)
    assert not np.ptp(along(dataset, 1 - axis))


def test_chinese_axes_need_no_blank(tmp_path):
    header = "时间（秒）,位置x（米）,位置y（米）"
    dataset = read(tmp_path, f"{header}\n{rows(TIMES, 0 * TIMES + 1, FALL)}")
    assert np.allclose(along(dataset, 1), FALL, atol=1e-4)
    assert dataset.units.declared["length"] == "m"


@pytest.mark.parametrize(
    ("header", "encoding"),
    [("时间(s),高度(m)", "gb18030"), ("時間[s],高さ[m]", "shift_jis"),
     ("Время (с);Высота (м)", "cp1251"), ("Czas (s);Wysokość (m)", "cp1250"),
     ("Zeit (s);Höhe (m)", "cp1252"), ("Zeit (s);Höhe (m)", "mac_roman")],
)  # fmt: skip
def test_encodings_are_told_by_the_words_that_they_make(tmp_path, header, encoding):
    text = f"{header}\n{rows(TIMES, FALL, sep=';' if ';' in header else ',')}"
    dataset = read(tmp_path, text, encoding=encoding)
    assert np.allclose(along(dataset, 1), FALL, atol=1e-4)
    name = "Windows-1252" if encoding == "cp1252" else encoding
    assert any(f"not UTF-8: read as {name}" in note for note in dataset.notes)


def test_words_are_folded():
    assert folded("Höhe Größe ÉLAN Čas") == "hohe große elan cas"
    assert len(folded("e\u0301te")) == 3
    assert "hohe" in words_for("height") and n_known_words("Höhe, Zeit, 高度") == 2


@pytest.mark.parametrize("header", [
    "Time (s),Angle Run #1 (rad),Angle Run #2 (rad)",
    "Time (s),Angle (rad) Run #1,Angle (rad) Run #2",
])  # fmt: skip
def test_runs_share_a_clock(tmp_path, header):
    dataset = read(tmp_path, f"{header}\n{rows(TIMES, np.sin(TIMES), np.cos(TIMES))}")
    assert [scene.name for scene in dataset.scenes] == ["Run #1", "Run #2"]
    assert dataset.units.is_angle and np.allclose(along(dataset, 0, 1), np.cos(TIMES), atol=1e-4)


def test_angles_with_clocks_of_their_own_are_recordings_where_these_differ(tmp_path):
    lines = [f"{t:.1f};{np.sin(t):.4f};0;{t:.1f};{np.cos(t):.4f};0" for t in TIMES]
    lines += [f"{t:.1f};{np.sin(t):.4f};0;;;" for t in 1.2 + TIMES]
    header = "t1;theta1;omega1;t2;theta2;omega2"
    dataset = read(tmp_path, "\n".join([header, *lines]), units={"theta": "rad", "t": "s"})
    assert [len(scene.times) for scene in dataset.scenes] == [24, 12]
    same = "\n".join([header, *lines[:12]])
    together = read(tmp_path, same, "same.csv", units={"theta": "rad", "t": "s"})
    assert len(together.scenes) == 1 and len(together.scenes[0].names) == 2


def test_a_body_its_axis_and_what_of_it(tmp_path):
    header = "Zeit (in s); Objekt 1 x-Koordinate; Objekt 1 y-Koordinate; Objekt 1 y-Geschwindigkeit"
    dataset = read(tmp_path, f"{header}\n{rows(TIMES, TIMES, FALL, FALL, sep=';')}")
    assert dataset.scenes[0].names == ("Objekt 1",)
    assert np.allclose(along(dataset, 1), FALL, atol=1e-4)


def test_a_body_behind_its_axis_is_told_as_one_that_is_left_out(tmp_path):
    header = "t,X,Y,Xearth,Yearth"
    dataset = read(tmp_path, f"{header}\n{rows(TIMES, TIMES, FALL, FALL, TIMES)}")
    assert "Xearth" in next(note for note in dataset.notes if note.startswith("check"))


def test_one_height_in_two_units_is_one(tmp_path):
    text = f"Time(s),Altitude(m),Altitude(ft),Speed(mph)\n{rows(TIMES, FALL, FALL / 0.3048, FALL)}"
    dataset = read(tmp_path, text)
    assert np.allclose(along(dataset, 1), FALL, atol=1e-4) and dataset.velocity == "ignore"


def test_an_accelerometer_beside_a_height_is_no_place(tmp_path):
    text = f"Time (s),X [g],Y [g],Z [g],Altitude [m]\n{rows(TIMES, TIMES, TIMES, TIMES, FALL)}"
    dataset = read(tmp_path, text)
    assert np.allclose(along(dataset, 1), FALL, atol=1e-4) and not np.ptp(along(dataset, 0))


def test_matlab_files_are_tables_of_their_vectors(tmp_path):
    savemat(tmp_path / "run.mat", {"t": TIMES, "x": TIMES, "y": FALL[:, None], "rate": 3.0})
    dataset = load_dataset(tmp_path / "run.mat")
    assert np.array_equal(along(dataset, 1), FALL)
    logged = {"time": TIMES, "signals": {"values": FALL, "label": ""}}
    savemat(tmp_path / "sim.mat", {"height": logged, "more": np.arange(3.0)})
    dataset = load_dataset(tmp_path / "sim.mat")
    assert np.array_equal(along(dataset, 1), FALL) and "not more (3)" in " ".join(dataset.notes)
    np.savez(tmp_path / "run.npz", t=TIMES, pos=np.stack([TIMES, FALL], axis=1))
    assert np.array_equal(along(load_dataset(tmp_path / "run.npz"), 1), FALL)


def test_what_is_no_array_is_refused(tmp_path):
    savemat(tmp_path / "one.mat", {"t": TIMES, "x": 1.0})
    with pytest.raises(DataError, match=r"no two vectors have one length; there are t \(12\)"):
        load_dataset(tmp_path / "one.mat")
    (tmp_path / "bad.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(DataError, match="cannot be read"):
        load_dataset(tmp_path / "bad.mat")
    np.savez(tmp_path / "object.npz", t=np.array([{}], dtype=object))
    with pytest.raises(DataError, match="cannot be read"):
        load_dataset(tmp_path / "object.npz")


GPX = """<?xml version="1.0"?>
<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{}</trkseg></trk></gpx>"""


def test_tracks_of_satellites_are_places_in_a_plane(tmp_path):
    points = "".join(
        f'<trkpt lat="{47 + 1e-5 * k:.6f}" lon="8.0"><ele>{400 + k}</ele>'
        f"<time>2024-05-01T10:00:{k:02d}Z</time></trkpt>" for k in range(12)
    )  # fmt: skip
    dataset = read(tmp_path, GPX.format(points), "walk.gpx")
    assert np.allclose(np.diff(along(dataset, 1)), 1.1117, rtol=1e-3)  # m a step to the north
    assert np.allclose(np.diff(along(dataset, 2)), 1.0) and dataset.scenes[0].times[-1] == 11.0
    with pytest.raises(DataError, match="DOCTYPE"):
        read(tmp_path, '<!DOCTYPE x [<!ENTITY a "b">]>' + GPX, "bomb.gpx")
    with pytest.raises(DataError, match="no point of a track has a time"):
        read(tmp_path, GPX.format('<trkpt lat="47" lon="8"/>'), "still.gpx")


def test_sentences_of_receivers_go_on_over_midnight(tmp_path):
    lines = [
        f"$GPGGA,{'2359' if k < 6 else '0000'}{54 + k if k < 6 else k - 6:02d}.00,"
        f"4700.{600 + k},N,00800.000,E,1,8,1.0,{400 + k}.0,M,0,M,,*00" for k in range(12)
    ]  # fmt: skip
    dataset = read(tmp_path, "\n".join(["$PVER,1", "$GPGSV,1,1*00", *lines]), "log.txt")
    assert np.allclose(np.diff(dataset.scenes[0].times), 1.0)
    assert np.allclose(np.diff(along(dataset, 1)), 1.853, rtol=1e-3)


def test_records_of_horizons_without_labels(tmp_path):
    text = "\n".join([
        "*" * 40, "Target body name: Comet {source: X}", "Output units    : KM-S", "*" * 40,
        "JDCT ", "   X     Y     Z", "   VX    VY    VZ", "*" * 40, "$$SOE",
        *(f"{2448810.5 + k:.9f} = A.D. 1992-Jul-07 00:00:00.0000 (TDB)\n"
          f"  {k}.0E+05 {k * k}.0E+05 1.0E+05\n  1.0E+00 2.0E+00 3.0E+00" for k in range(6)),
        "$$EOE",
    ])  # fmt: skip
    dataset = read(tmp_path, text, "horizons.txt")
    assert dataset.scenes[0].names == ("Comet",)
    assert np.allclose(along(dataset, 1), 1e8 * np.arange(6) ** 2)
    about = "Center body name: Jupiter (599)    {source: JUP310}\nCenter-site name: BODY CENTER"
    dataset = read(tmp_path, text.replace("Output", f"{about}\nOutput", 1), "centre.txt")
    assert dataset.scenes[0].names == ("Comet", "Jupiter")
    assert dataset.scenes[0].entities[1].is_static
    assert "places count from Jupiter, which is at rest at the origin" in dataset.notes


def test_a_tab_behind_the_headings_of_qualisys_moves_no_column(tmp_path):
    head = ["NO_OF_FRAMES\t12", "NO_OF_MARKERS\t1", "FREQUENCY\t10", "MARKER_NAMES\tcork",
            "Frame\tTime\tcork X\tcork Y\tcork Z\t"]  # fmt: skip
    lines = [f"{k + 1}\t{t:.1f}\t{1000 * t:.1f}\t{1000 * z:.1f}\t5.0"
             for k, (t, z) in enumerate(zip(TIMES, FALL, strict=True))]  # fmt: skip
    dataset = read(tmp_path, "\n".join(head + lines), "take.tsv")
    assert np.allclose(along(dataset, 0), TIMES) and np.allclose(along(dataset, 1), FALL, atol=1e-4)


def workbook(path, sheets):
    """A workbook of rows of texts and numbers."""
    with pd.ExcelWriter(path) as book:
        for name, frame in sheets.items():
            frame.to_excel(book, sheet_name=name, index=False)


def test_sheets_with_one_header_are_recordings(tmp_path):
    pytest.importorskip("openpyxl")
    one = pd.DataFrame({"t": TIMES, "x": TIMES, "y": FALL})
    workbook(tmp_path / "runs.xlsx", {"slow": one, "fast": one.assign(x=2 * TIMES), "notes":
                                      pd.DataFrame({"who": ["me"]})})  # fmt: skip
    dataset = load_dataset(tmp_path / "runs.xlsx")
    assert [scene.name for scene in dataset.scenes] == ["slow", "fast"]
    assert "2 sheets of runs.xlsx with one header are recordings, not 'notes'" in dataset.notes
    with pd.ExcelWriter(tmp_path / "bare.xlsx") as book:
        for name in ("Run 1", "Run 2"):
            one.to_excel(book, sheet_name=name, index=False, header=False)
    bare = load_dataset(tmp_path / "bare.xlsx")
    assert [scene.name for scene in bare.scenes] == ["Run 1", "Run 2"]
    assert np.allclose(along(bare, 1, 1), FALL)


def test_a_legend_beside_numbers_is_no_column(tmp_path):
    """Ten runs in ten sheets had the first one's legend for a header, and no places."""
    pytest.importorskip("openpyxl")
    one = pd.DataFrame({"t": TIMES, "x": TIMES, "y": FALL})
    legend = pd.DataFrame([["", "t", "x", "y"]])
    with pd.ExcelWriter(tmp_path / "runs.xlsx") as book:
        for name, table in (("Run 1", pd.concat([one, legend], axis=1)), ("Run 2", one)):
            table.to_excel(book, sheet_name=name, index=False, header=False)
    dataset = load_dataset(tmp_path / "runs.xlsx")
    assert [scene.name for scene in dataset.scenes] == ["Run 1", "Run 2"]
    assert np.allclose(dataset.scenes[0].positions[:, 0, 1], FALL)


@pytest.mark.parametrize("unit", ["0.5 cm", "0.5cm"])
def test_a_number_before_a_unit_needs_no_blank(tmp_path, unit):
    path = tmp_path / "run.csv"
    path.write_text(f"t,x,y\n{rows(TIMES, TIMES, FALL)}", encoding="utf-8")
    dataset = load_dataset(path, units={"length": unit, "time": "s"})
    assert np.allclose(dataset.scenes[0].positions[:, 0, 1], 0.005 * FALL)


def test_names_of_films_are_recordings(tmp_path):
    told = rows(TIMES, TIMES, FALL).splitlines()
    lines = [f"v{k},{row}" for k in (1, 2) for row in told]
    dataset = read(tmp_path, "video,t (s),x (m),y (m)\n" + "\n".join(lines))
    assert [scene.name for scene in dataset.scenes] == ["v1", "v2"]


def test_a_mark_for_nothing_seen_is_a_gap(tmp_path):
    x = np.where(np.arange(12) % 4 == 1, -1.0, 10 + TIMES)
    y = np.where(np.arange(12) % 4 == 1, -1.0, 20 + FALL)
    dataset = read(tmp_path, f"t,x,y\n{rows(TIMES, x, y)}")
    assert len(dataset.scenes[0].times) == 9 and "at -1, -1" in " ".join(dataset.notes)
    kept = read(tmp_path, f"t,x,y\n{rows(TIMES, x, FALL - 5)}", "below.csv")
    assert len(kept.scenes[0].times) == 12


def test_a_clock_that_steps_back_loses_a_row(tmp_path):
    t = np.arange(150) * 0.1
    t[70] = 6.5
    dataset = read(tmp_path, f"t,x,y\n{rows(t, t, np.sin(t))}")
    assert len(dataset.scenes[0].times) == 149
    assert "1 row(s) have a time that is not after those before" in " ".join(dataset.notes)


def test_files_of_one_mass_each_are_bodies(tmp_path):
    for name, shift in (("mass_A", 0.0), ("mass_B", 3.0)):
        text = f"t,x,y,r\n{rows(TIMES, TIMES + shift, FALL, np.cos(9 * TIMES))}"
        (tmp_path / f"{name}.csv").write_text(text)
    dataset = load_dataset([tmp_path / "mass_A.csv", tmp_path / "mass_B.csv"])
    assert dataset.scenes[0].names == ("mass_A", "mass_B") and len(dataset.scenes) == 1
    text = f"t,x,y,r\n{rows(TIMES + 1, TIMES, FALL, FALL)}"
    (tmp_path / "mass_B.csv").write_text(text)
    assert len(load_dataset([tmp_path / "mass_A.csv", tmp_path / "mass_B.csv"]).scenes) == 2


def test_observations_of_one_date_are_one(tmp_path):
    years = np.sort(np.append(1900 + 2.0 * np.arange(20), 1910.0))
    x, y = np.cos(years / 9), np.sin(years / 9)
    x[5] += 0.02
    dataset = read(tmp_path, f"t,x,y\n{rows(years, x, y)}")
    assert len(dataset.scenes[0].times) == 20 and "one observation" in " ".join(dataset.notes)
    with pytest.raises(DataError, match="duplicate"):
        read(tmp_path, f"t,x,y\n{rows(years - 1900, x, y)}", "film.csv")


def test_spots_of_no_track_are_no_body(tmp_path):
    lines = [f"{k % 3 if k % 4 else 'None'},{k // 3},{k},{k * k}" for k in range(36)]
    text = "\n".join(["TRACK_ID,POSITION_T,POSITION_X,POSITION_Y", *lines])
    dataset = read(tmp_path, text)
    names = {name for scene in dataset.scenes for name in scene.names}
    assert "None" not in names and "of no track: left out" in " ".join(dataset.notes)


def test_a_counter_that_would_be_in_the_future_is_no_date(tmp_path):
    t = 9_000_000_000 + np.arange(12)
    assert load_and_first(tmp_path, t, "far.csv") == 9_000_000_000
    assert load_and_first(tmp_path, 1_600_000_000 + np.arange(12), "unix.csv") == 0


def load_and_first(tmp_path, t, name):
    lines = [f"{a},{b:.3f},{b * b:.3f}" for a, b in zip(t, TIMES, strict=True)]
    return read(tmp_path, "\n".join(["t,x,y", *lines]), name).scenes[0].times[0]


def test_milliseconds_since_1970_that_are_declared_count_from_the_first(tmp_path):
    lines = [f"{1_600_000_000_000 + 100 * k},{t:.3f},{t * t:.3f}" for k, t in enumerate(TIMES)]
    text = "\n".join(["t,x,y", *lines])
    dataset = read(tmp_path, text, units={"time": "ms", "length": "m"})
    assert np.allclose(dataset.scenes[0].times, TIMES)


def test_a_minus_of_typesetters_is_one(tmp_path):
    text = f"t;x;y\n{rows(TIMES, TIMES - 5, FALL, sep=';')}".replace("-", "\u2212")
    assert np.allclose(along(read(tmp_path, text), 0), TIMES - 5)


def test_columns_that_are_named_by_hand(tmp_path):
    text = f"a;b;c;d\n{rows(TIMES, 47 + 1e-3 * TIMES, 8 + 0 * TIMES, FALL, sep=';')}"
    columns = {"t": "a", "lat": "b", "lon": "c", "alt": "d"}
    assert np.allclose(along(read(tmp_path, text, columns=columns), 2), FALL, atol=1e-4)
    columns = {"z": "W (m)", "b": "ignore"}
    lone = read(tmp_path, f"t,W (m),b\n{rows(TIMES, FALL, FALL)}", columns=columns)
    assert np.allclose(along(lone, 1), FALL, atol=1e-4) and lone.up == "y"
    bare = f"{rows(TIMES, TIMES, FALL, TIMES, FALL, TIMES, sep=' ')}"
    columns = {"a_t": "1", "a_x": "2", "a_y": "3", "b_t": "4", "b_x": "5", "b_y": "6"}
    assert read(tmp_path, bare, "bare.txt", columns=columns).scenes[0].names == ("a", "b")
    clock = f"Time(s),Altitude (m)\n{rows(np.floor(TIMES), FALL)}"
    dataset = read(tmp_path, clock, "whole.csv", columns={"Time(s)": "ignore"}, fps=10)
    assert np.allclose(dataset.scenes[0].times, TIMES)
