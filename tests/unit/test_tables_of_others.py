"""Tables as other programs and people write them: words, comments, clocks, and what is no place."""

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.errors import DataError

T = np.arange(40) * 0.05
FALL = 2.0 + 3.0 * T - 4.9 * T**2


def written(path, heading, *columns, mark=","):
    """A table of columns of numbers."""
    rows = [mark.join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([heading, *rows] if heading else rows) + "\n", encoding="utf-8")
    return path


def told(data):
    return "\n".join(data.notes)


@pytest.mark.parametrize("name", ["time", "run", "trial", "body", "track"])
def test_a_column_is_left_out_by_a_name_that_stands_for_another_too(tmp_path, name):
    path = written(tmp_path / "a.csv", f"{name},x,y", T // 0.4, T, FALL)
    data = load_dataset(path, columns={name: "ignore"}, fps=20)
    np.testing.assert_allclose(data.scenes[0].times, T)
    assert data.scenes[0].names == ("object",)


@pytest.mark.parametrize("form", ["p{}", "t{}", "{}pos", "pos{}"])
def test_places_in_one_word_are_no_reason_to_add_up_velocities(tmp_path, form):
    names = ["t", *(form.format(axis) for axis in "xy"), "vx", "vy"]
    path = written(tmp_path / "a.csv", ",".join(names), T, T**2, FALL, 2 * T, 3 - 9.8 * T)
    data = load_dataset(path)
    assert data.velocity == "ignore" and data.up is None
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], FALL, atol=1e-6)


def test_velocities_are_not_added_up_beside_the_places_under_another_name(tmp_path):
    path = written(tmp_path / "a.csv", "t,way1,vx", T, np.sin(T), np.cos(T))
    with pytest.raises(DataError, match="'way1' changes as they say.*columns={\"x\": \"way1\"}"):
        load_dataset(path)


def test_rates_speeds_and_commands_are_no_bodies(tmp_path):
    kinds = ["drone_pos", "drone_vel", "drone_rate", "drone_cmd"]
    names = ["t", *(f"{kind}_{axis}" for kind in kinds for axis in "xy")]
    path = written(tmp_path / "a.csv", ",".join(names), T, *[T**2, FALL, 2 * T, 3 - 9.8 * T] * 2)
    (scene,) = load_dataset(path).scenes
    assert scene.names == ("drone_pos",)


def test_bodies_with_their_axis_in_brackets_or_their_place_in_one_word(tmp_path):
    path = written(tmp_path / "a.csv", "t,ball (x),ball (y),C7 (x),C7 (y)", T, T, FALL, T + 1, FALL)
    assert load_dataset(path).scenes[0].names == ("ball", "C7")
    path = written(tmp_path / "b.csv", "t,cartPos,cartVel,bobPos", T, T**2, 2 * T, FALL)
    data = load_dataset(path)
    assert data.scenes[0].names == ("cart", "bob")
    np.testing.assert_allclose(data.scenes[0].positions[:, 1, 0], FALL, atol=1e-6)
    path = written(tmp_path / "c.csv", "t,pos1,pos2,vel1", T, T**2, FALL, 2 * T)
    with pytest.raises(DataError, match="BODY_x=pos1 OTHER_x=pos2"):
        load_dataset(path)


def test_names_as_tex_writes_them(tmp_path):
    path = written(tmp_path / "a.txt", "#t\tu\tv\t$\\theta$", T, T, T, np.sin(T), mark="\t")
    data = load_dataset(path, units={"theta": "rad", "t": "s"})
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], np.sin(T), atol=1e-6)
    assert load_dataset(path, columns={"theta": "$\\theta$"}, units={"theta": "rad", "t": "s"})


def test_track_and_pitch_of_a_vehicle_are_no_body_and_no_throw(tmp_path):
    names, deg = "time,lat,lon,alt,track,pitch", 1e-4
    more = (500 + FALL, 90 + T, np.arange(40) % 3)
    path = written(tmp_path / "a.csv", names, T, 46 + deg * T, 7 + deg * T, *more)
    data = load_dataset(path)
    assert len(data.scenes) == 1 and data.scenes[0].positions.shape == (40, 1, 3)


def test_what_is_left_out_is_no_other_body(tmp_path):
    names = "t,x,y,other_x,other_y,next_x,next_y"
    path = written(tmp_path / "a.csv", names, T, T, FALL, T + 1, FALL, T + 0.05, FALL)
    assert "'other_x', 'other_y';" in told(load_dataset(path))
    out = {"other_x": "ignore", "other_y": "ignore"}
    assert "another body" not in told(load_dataset(path, columns=out))


def test_a_velocity_beside_its_error_at_dates_is_one_along_the_line_of_sight(tmp_path):
    rng = np.random.default_rng(3)
    nights = 2364.8 + np.cumsum(rng.choice([0.006, 1.0, 2.1, 9.0], 40))
    speed, error = 10 * np.sin(nights / 3), np.full(40, 1.5)
    path = written(tmp_path / "a.csv", "errvel,t,vel", error, nights, speed)
    data = load_dataset(path)
    assert data.velocity == "sight" and "'errvel' is taken as its error" in told(data)
    path = written(tmp_path / "b.csv", "t,vel,errvel", T, 2 * T, 0.01 + 0 * T)
    assert load_dataset(path).velocity == "only"
