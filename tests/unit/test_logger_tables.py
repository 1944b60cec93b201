"""Tables of loggers and programs: read right, or refused with the option that helps."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.cli import main
from bsp_gp.data.dates import seconds_of
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError, on_command_line
from tests.capture_tables import CAPTURES
from tests.logger_tables import LATER, LOOKED_AT, MORE, SET_ASIDE

SAMPLES = LOOKED_AT | SET_ASIDE | LATER | MORE | CAPTURES


def test_there_are_thirty_of_them_half_set_aside_and_thirty_of_other_days():
    fifteen = (LOOKED_AT, SET_ASIDE, LATER, CAPTURES)
    assert {len(tables) for tables in fifteen} == {15} and len(SAMPLES) == 60 + len(MORE)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_table_is_read_right_or_refused_with_what_helps(tmp_path, name):
    sample = SAMPLES[name]
    if not sample.content:
        pytest.skip("what writes such a file is not installed: pip install 'bsp_gp[test,parquet]'")
    path = tmp_path / sample.name
    path.write_bytes(sample.content)
    if sample.refused:
        with on_command_line(), pytest.raises(DataError) as error:
            load_dataset(path, **sample.options)
        for word in sample.refused:
            assert word.lower() in str(error.value).lower()
        return
    dataset = load_dataset(path, **sample.options)
    assert {(s.name, n) for s in dataset.scenes for n in s.names} == {
        (scene or path.stem, entity) for scene, entity in sample.tracks
    }
    assert dataset.up == sample.up
    for (name, entity), (t, x, y) in sample.tracks.items():
        scene = dataset.scene(name or path.stem)
        k = scene.names.index(entity)
        seen = np.isfinite(scene.positions[:, k]).all(axis=1)
        assert scene.times[seen] == pytest.approx(t, abs=1e-9)
        for axis, values in ((0, x), (1, y)):
            expected = 0 * t if values is None else values
            assert scene.positions[seen, k, axis] == pytest.approx(expected, abs=5e-6)
    text = " ".join(dataset.notes)
    for word in sample.told:
        assert word in text, f"{word} is not told in {text}"


@pytest.mark.parametrize(
    ("name", "cut", "said"),
    [
        ("trc", lambda text: text.replace("ball\t", "\t"), "must name markers"),
        ("vicon", lambda text: text[:20], "preamble cannot be read"),
        ("campbell", lambda text: "\n".join(text.splitlines()[:2]), "preamble cannot be read"),
        ("cassy", lambda text: text.replace("DEF", "Def"), "preamble cannot be read"),
        ("labview", lambda text: text[:60], "preamble cannot be read"),
    ],
)
def test_a_preamble_that_is_not_as_the_program_writes_it_is_told(tmp_path, name, cut, said):
    path = tmp_path / SAMPLES[name].name
    path.write_text(cut(SAMPLES[name].content.decode("cp1252")), "utf-8")
    with pytest.raises(DataError, match=said):
        load_dataset(path)


@pytest.mark.parametrize("style", ["{}_{} / cm", "{1}_{0} in cm", "{} {} / cm"])
def test_bodies_side_by_side_have_units_behind_any_mark(tmp_path, style):
    header = ["time / s", *(style.format(body, axis) for body in "AB" for axis in "xy")]
    rows = [f"{0.1 * k:.1f},{k},2,3,{k * k}" for k in range(4)]
    path = tmp_path / "run1.csv"
    path.write_text("\n".join([",".join(header), *rows]) + "\n", "utf-8")
    (scene,) = load_dataset(path).scenes
    assert sorted(scene.names) == ["A", "B"] and scene.times == pytest.approx([0, 0.1, 0.2, 0.3])
    assert scene.positions[:, scene.names.index("B"), 1] == pytest.approx([0, 0.01, 0.04, 0.09])


@pytest.mark.parametrize("has_header", [True, False])
@pytest.mark.parametrize("is_later", [True, False])
def test_an_export_of_qualisys_is_in_millimetres(tmp_path, has_header, is_later):
    head = ["NO_OF_FRAMES\t3", "NO_OF_MARKERS\t2", "FREQUENCY\t100", "DATA_INCLUDED\t3D"]
    lines = ["FILE_VERSION\t2.0.0"] * is_later + [*head, "MARKER_NAMES\tred\tblue"]
    lines += ["TRAJECTORY_TYPES\tMeasured\tMixed"] * is_later
    places = ["1.5\t-2\t1000\t4\t5\t6", "\t\t\t7\t8\t9", "1e1\t11\t12\t13\t14\t15"]
    if has_header:
        lines.append("Frame\tTime\tred X\tred Y\tred Z\tblue X\tblue Y\tblue Z")
        places = [f"{k + 1}\t{0.01 * k:.5f}\t{text}" for k, text in enumerate(places)]
    path = tmp_path / "throw.tsv"
    path.write_text("\n".join([*lines, *places]) + "\n", "utf-8")
    (scene,) = load_dataset(path).scenes
    red, blue = scene.names.index("red"), scene.names.index("blue")
    assert scene.times == pytest.approx([0.0, 0.01, 0.02])
    assert scene.positions[0, red] == pytest.approx([0.0015, -0.002, 1.0])
    assert scene.positions[:, blue, 2] == pytest.approx([0.006, 0.009, 0.015])
    assert np.isnan(scene.positions[1, red]).all()


@pytest.mark.parametrize(
    ("dates", "seconds"),
    [
        (["1/2/2025 10:00:00", "1/2/2025 10:00:01", "1/2/2025 10:00:03"], [0, 1, 3]),
        (["31/1/2025 23:59:59", "1/2/2025 00:00:00", "1/2/2025 0:00:01"], [0, 1, 2]),
        (["1/31/2025 23:59:59", "2/1/2025 00:00:00", "2/1/2025 0:00:01"], [0, 1, 2]),
        (["1/2/2025 23:59:59", "2/2/2025 00:00:00", "2/2/2025 0:00:01"], None),
    ],
)
def test_dates_in_which_day_and_month_may_be_mistaken_are_read_where_that_does_not_matter(
    dates, seconds
):
    read = seconds_of(pd.Series(dates))
    assert read is None if seconds is None else read[0] == pytest.approx(seconds)


def test_check_says_what_was_understood_and_draws_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sample = SAMPLES["excel, german"]
    (tmp_path / sample.name).write_bytes(sample.content)
    assert main(["check", sample.name]) == 0
    out = capsys.readouterr().out
    for text in (
        "1 scene, 1 body, 8 rows", "t = 'Zeit (s)', y = 'Höhe (m)'", "length in m",
        "every 0.05000 s",
        "Bodies: object", "Up: y", "Axis x: nothing moves", "Axis y: from 1.399 to 2.000 m, noise",
        "--columns y=NAME",
    ):  # fmt: skip
        assert text in out
    picture = tmp_path / "Fall-check" / "picture.png"
    assert picture.read_bytes()[:4] == b"\x89PNG" and f"Picture: {picture.resolve()}" in out
    assert main(["check", sample.name, "--columns", "scene=Versuch"]) == 2
    assert "--columns scene=ONE_OF_THESE" in capsys.readouterr().err
    assert main(["check", sample.name]) == 0, "an older check is replaced"


def test_frames_that_are_called_the_time_are_counted_at_the_rate(tmp_path):
    path = tmp_path / "eggs.csv"
    path.write_text("frame,x,y\n0,1,2\n300,2,3\n600,4,4\n900,7,5\n", "utf-8")
    (scene,) = load_dataset(path, columns={"t": "frame"}, fps=25).scenes
    assert scene.times == pytest.approx([0.0, 12.0, 24.0, 36.0])
