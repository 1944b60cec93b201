"""Tracker's .trk files: made here, after the published layout; hostile and broken ones refused."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.data.trk import read_trk
from bsp_gp.errors import DataError

STEP = """<property name="[{k}]" type="object"><object class="org.opensourcephysics.cabrillo.\
tracker.PointMass$FrameData"><property name="x" type="double">{x}</property>
<property name="y" type="double">{y}</property></object></property>"""
FILE = """<?xml version="1.0" encoding="UTF-8"?>
<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">
<property name="videoclip" type="object"><object class="VideoClip">
<property name="startframe" type="int">{start}</property>
<property name="stepsize" type="int">{size}</property></object></property>
<property name="clipcontrol" type="object"><object class="ClipControl">
<property name="delta_t" type="double">{delta}</property></object></property>
<property name="coords" type="object"><object class="ImageCoordSystem">
<property name="fixedorigin" type="boolean">true</property>
<property name="fixedangle" type="boolean">true</property>
<property name="fixedscale" type="boolean">true</property>
<property name="framedata" type="array" class="[L"><property name="[0]" type="object">
<object class="ImageCoordSystem$FrameData"><property name="xorigin" type="double">100</property>
<property name="yorigin" type="double">200</property>
<property name="angle" type="double">{angle}</property>
<property name="xscale" type="double">{scale}</property>
<property name="yscale" type="double">{scale}</property></object></property></property>
</object></property>
<property name="length_unit" type="string">m</property>
<property name="tracks" type="collection" class="java.util.ArrayList">
<property name="item" type="object"><object class="cabrillo.tracker.PointMass">
<property name="name" type="string">ball</property>
<property name="mass" type="double">0.25</property>
<property name="framedata" type="array" class="[L">{steps}</property></object></property>
<property name="item" type="object"><object class="cabrillo.tracker.TapeMeasure"/>
</property></property></object>"""


def write(path, steps=((2, 150, 200), (4, 150, 150), (6, 150, 100)), **changes):
    values = {"start": 2, "size": 2, "delta": 20.0, "angle": 0.0, "scale": 50.0} | changes
    text = "".join(STEP.format(k=k, x=x, y=y) for k, x, y in steps)
    path.write_text(FILE.format(steps=text, **values), "utf-8")
    return path


def test_positions_times_and_mass(tmp_path):
    frame, about = read_trk(write(tmp_path / "a.trk"))
    np.testing.assert_allclose(frame["t"], [0.0, 0.04, 0.08])
    np.testing.assert_allclose(frame[["x", "y"]], [[1, 0], [1, 1], [1, 2]])
    assert about["masses"] == {"ball": 0.25}
    assert about["unit"] == "m"
    assert about["fps"] == 50.0


def test_axes_are_turned_counter_clockwise(tmp_path):
    frame, _ = read_trk(write(tmp_path / "a.trk", angle=90.0))
    np.testing.assert_allclose(frame[["x", "y"]], [[0, -1], [1, -1], [2, -1]], atol=1e-12)


def test_frames_off_the_clip_are_no_steps(tmp_path):
    steps = ((0, 1, 1), (2, 150, 200), (3, 9, 9), (4, 150, 150), (6, 150, 100))
    frame, _ = read_trk(write(tmp_path / "a.trk", steps))
    assert len(frame) == 3


def test_a_data_set_of_it(tmp_path):
    dataset = load_dataset(write(tmp_path / "a.trk"))
    assert dataset.up == "y"
    assert dataset.scenes[0].entities[0].mass == 0.25
    np.testing.assert_allclose(dataset.scenes[0].positions[:, 0, 1], [0, 1, 2])


def changed(path, old, new, count=1):
    """The file with a piece of it replaced; the piece must be there."""
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, count), "utf-8")
    return path


def test_point_masses_that_are_never_seen_together_are_scenes(tmp_path):
    path = write(tmp_path / "hall.trk")
    steps = "".join(STEP.format(k=k, x=x, y=200) for k, x in ((8, 150), (10, 200), (12, 250)))
    item = f"""<property name="item" type="object"><object class="cabrillo.tracker.PointMass">
<property name="name" type="string">second</property>
<property name="framedata" type="array" class="[L">{steps}</property></object></property>"""
    tracks = '<property name="tracks" type="collection" class="java.util.ArrayList">'
    path.write_text(path.read_text("utf-8").replace(tracks, tracks + item), "utf-8")
    dataset = load_dataset(path)
    assert [(s.name, s.names, len(s.times)) for s in dataset.scenes] == [
        ("ball", ("ball",), 3), ("second", ("second",), 3),
    ]  # fmt: skip
    assert "2 bodies that are never seen at the same time: 2 scenes (ball, second)" in dataset.notes


def test_steps_after_the_end_of_the_clip_are_left_out(tmp_path):
    start = '<property name="startframe"'
    ends = '<property name="stepcount" type="int">2</property>' + start
    frame, _ = read_trk(changed(write(tmp_path / "a.trk"), start, ends))
    np.testing.assert_allclose(frame["t"], [0.0, 0.04])


def test_a_picture_sequence_brings_its_own_time_per_frame(tmp_path):
    path = changed(write(tmp_path / "a.trk"), '<property name="delta_t" type="double">20.0', "<x>")
    path = changed(path, "<x></property></object>", "</object>")
    video = """<object class="VideoClip"><property name="video" type="object">\
<object class="ImageVideo"><property name="delta_t" type="double">10.0</property></object>\
</property>"""
    frame, about = read_trk(changed(path, '<object class="VideoClip">', video))
    np.testing.assert_allclose(frame["t"], [0.0, 0.02, 0.04])
    assert about["fps"] == 100.0
    assert about["notes"] == ()


def test_moving_axes_hold_from_key_frame_to_key_frame(tmp_path):
    path = changed(write(tmp_path / "a.trk"), '"fixedorigin" type="boolean">true',
                   '"fixedorigin" type="boolean">false')  # fmt: skip
    key = path.read_text("utf-8").split('class="[L">')[1].split("</object></property>")[0]
    key += "</object></property>"
    later = key.replace("[0]", "[4]").replace(">100<", ">150<")
    frame, _ = read_trk(changed(path, key, key + later))
    np.testing.assert_allclose(frame["x"], [1, 0, 0])


def test_masses_have_the_unit_of_the_file(tmp_path):
    unit = '<property name="length_unit" type="string">m</property>'
    path = changed(write(tmp_path / "a.trk"), unit, unit + unit.replace("length", "mass").replace(
        ">m<", ">g<"))  # fmt: skip
    dataset = load_dataset(path)
    assert dataset.units.declared["mass"] == "g"
    assert dataset.scenes[0].entities[0].mass == pytest.approx(0.25e-3)


def test_a_file_without_calibration_is_in_pixels(tmp_path):
    dataset = load_dataset(write(tmp_path / "a.trk", scale=1.0))
    assert dataset.units.declared["length"] == "px"
    assert any("never calibrated" in note for note in dataset.notes)
    np.testing.assert_allclose(dataset.scenes[0].positions[:, 0, 1], [0, 50, 100])


def test_the_mass_of_every_new_track_is_no_measurement(tmp_path):
    path = changed(write(tmp_path / "a.trk"), ">0.25<", ">1.0<")
    _, about = read_trk(path)
    assert any("ball" in note and "check it" in note for note in about["notes"])


def test_models_are_no_measurements(tmp_path):
    path = write(tmp_path / "a.trk")
    text = path.read_text("utf-8")
    item = text[text.index('<property name="item"') : text.index('<property name="item" type="ob'
                + 'ject"><object class="cabrillo.tracker.TapeMeasure"')]  # fmt: skip
    model = item.replace("PointMass", "DynamicParticle", 1).replace(">ball<", ">model A<")
    frame, _ = read_trk(changed(path, item, item + model))
    assert set(frame["entity"]) == {"ball"}


def test_a_zipped_project_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "a.trz"
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(DataError, match="unzip"):
        load_dataset(path)


@pytest.mark.parametrize("head", ["<!DOCTYPE x>", '<!DOCTYPE x [<!ENTITY a "b">]>', "<!doctype x>"])
def test_doctype_and_entities_are_refused(tmp_path, head):
    path = write(tmp_path / "a.trk")
    text = path.read_text("utf-8")
    path.write_text(text.replace("?>\n", f"?>\n{head}\n", 1), "utf-8")
    with pytest.raises(DataError, match="DOCTYPE"):
        read_trk(path)


def test_doctype_hidden_by_utf16_is_refused(tmp_path):
    path = write(tmp_path / "a.trk")
    text = path.read_text("utf-8").replace('encoding="UTF-8"', 'encoding="UTF-16"')
    path.write_bytes(text.replace("?>\n", "?>\n<!DOCTYPE x>\n", 1).encode("utf-16"))
    with pytest.raises(DataError, match="DOCTYPE"):
        read_trk(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("TrackerPanel", "DataTool", "not a Tracker file"),
        ("<object", "<objekt", "not XML"),
        (">150<", ">wide<", "must be a number"),
        (">50.0<", ">0<", "scale of zero"),
        ("PointMass", "RGBRegion", "no point mass"),
    ],
)
def test_broken_files_are_named(tmp_path, old, new, message):
    path = write(tmp_path / "a.trk")
    text = path.read_text("utf-8")
    path.write_text(
        text.replace(old, new, 1) if old == "<object" else text.replace(old, new), "utf-8"
    )
    with pytest.raises(DataError, match=message) as caught:
        read_trk(path)
    assert "a.trk" in str(caught.value)


def test_a_film_shows_no_sky(tmp_path):
    with pytest.raises(DataError, match="shows no sky"):
        load_dataset(write(tmp_path / "a.trk"), sky={"distance": "10 pc"})
