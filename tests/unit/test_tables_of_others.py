"""Tables as other programs and people write them: words, comments, clocks, and what is no place."""

import json

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


def test_a_place_along_a_line_in_one_word(tmp_path):
    data = load_dataset(written(tmp_path / "a.csv", "t,xpos,vx", T, FALL, 3 - 9.8 * T))
    assert data.velocity == "ignore"
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], FALL, atol=1e-6)


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
    assert load_dataset(path).scenes[0].names == ("1", "2")


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


def test_arrays_of_times_bodies_and_axes(tmp_path):
    tracks = np.stack([np.stack([T + k, FALL, 0.1 * T], axis=1) for k in range(2)], axis=1)
    names, mass = np.array(["Star", "Moon"]), np.array([1.0, 0.1])
    np.savez(tmp_path / "a.npz", times=T, positions=tracks, names=names, masses=mass,
             velocities=np.gradient(tracks, axis=0))  # fmt: skip
    (scene,) = load_dataset(tmp_path / "a.npz").scenes
    assert scene.names == ("Star", "Moon") and scene.positions.shape == (40, 2, 3)
    np.testing.assert_array_equal(scene.positions, tracks)
    np.savez(tmp_path / "b.npz", t=T, r=tracks.swapaxes(0, 1)[..., :2])
    (scene,) = load_dataset(tmp_path / "b.npz").scenes
    assert scene.names == ("body1", "body2") and scene.n_dims == 2
    bodies = {name: tracks[:, k].tolist() for k, name in enumerate("AQ")}
    content = {"times": T.tolist(), "bodies": bodies}
    (tmp_path / "c.json").write_text(json.dumps(content), encoding="utf-8")
    (scene,) = load_dataset(tmp_path / "c.json").scenes
    assert scene.names == ("body A", "Q")
    np.testing.assert_array_equal(scene.positions, tracks)


def test_a_file_that_is_called_like_a_sensor_has_no_places(tmp_path):
    shown = (0.1 * np.sin(9 * T), np.cos(9 * T), 0.1 * np.cos(9 * T))
    path = written(tmp_path / "TotalAcceleration.csv", "seconds_elapsed,z,y,x", T, *shown)
    data = load_dataset(path)
    assert data.velocity == "unseen" and "in m/s^2" in told(data)
    assert load_dataset(path, columns={"x": "x", "y": "y", "z": "z"}).velocity == "ignore"
    path = written(tmp_path / "Magnetometer.csv", "seconds_elapsed,z,y,x", T, *shown)
    with pytest.raises(DataError, match="are no places"):
        load_dataset(path)


def test_a_lone_row_at_the_time_of_the_one_before_is_left_out(tmp_path):
    t, x = np.insert(0.05 * np.arange(200), 1, 0.0), np.sin(np.arange(201) / 9)
    data = load_dataset(written(tmp_path / "a.csv", "t,x", t, x))
    assert len(data.scenes[0].times) == 200 and "1 row(s) have a time" in told(data)


def test_the_last_comment_names_the_columns_and_what_has_a_colon_is_none(tmp_path):
    more = "# Telescopes: one, two, three\n# [2] Butler et al 2017\n#\n"
    nights = 2451121.5 + np.arange(40) * 1.37
    heading = f"{more}# Epoch[JD]  RV[m/s] RV_err[m/s] InstrumentID"
    path = written(tmp_path / "a.txt", heading, nights, np.sin(T), 0 * T + 0.1, np.arange(40) % 2,
                   mark=" ")  # fmt: skip
    data = load_dataset(path)
    assert data.velocity == "sight" and len(data.scenes) == 2
    path = written(tmp_path / "b.txt", "# TF Frame ID: /openni", T, FALL, np.sin(T), *[T % 3] * 2,
                   mark=" ")  # fmt: skip
    with pytest.raises(DataError, match='columns={"t": "1", "x": "2"}'):
        load_dataset(path)


def test_without_a_header_the_column_that_increases_is_asked_for_as_the_time(tmp_path):
    for name, columns, said in (
        ("a", (np.sin(T), FALL, T), '"t": "3", "x": "1"'),
        ("b", (T + T**2, T), '"t": "2", "x": "1"'),  # both increase, and one evenly
        ("c", (T, 0 * T, 0 * T, np.sin(T), FALL), '"t": "1", "x": "4"'),
        ("n", (np.arange(40), T, FALL, FALL, FALL), '"t": "2", "x": "3"'),
        ("d", (2453602.6 + T, FALL, 0.1 + T / 9), '"rv": "2", "srv": "3".*"x": "2", "sx": "3"'),
    ):
        path = written(tmp_path / f"{name}.csv", "", *columns)
        with pytest.raises(DataError, match=said):
            load_dataset(path)
    data = load_dataset(written(tmp_path / "e.csv", "", T**2), columns={"ax": "1"}, fps=20)
    assert data.velocity == "unseen"


def test_headings_over_the_wrong_columns_are_told_by_the_one_that_is_a_clock(tmp_path):
    path = written(tmp_path / "a.csv", "X,Y,t", T, np.cos(3 * T), FALL)
    with pytest.raises(DataError, match='"t": "X", "x": "Y", "y": "t"'):
        load_dataset(path)
    data = load_dataset(path, columns={"t": "X", "x": "Y", "y": "t"})
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], FALL, atol=1e-6)


def test_no_rate_is_told_where_no_even_clock_fits(tmp_path):
    times = np.append(np.arange(200) * 0.0101, 2.02 + np.arange(200) * 0.0025).round(2)
    path = written(tmp_path / "a.csv", "t,x", times, np.sin(np.arange(400) / 9))
    with pytest.raises(DataError, match=r"no even clock fits them.*from row 20\d on") as error:
        load_dataset(path)
    assert "fps=" not in str(error.value)


def test_places_that_never_change_are_told(tmp_path):
    data = load_dataset(written(tmp_path / "a.csv", "t,x,y", T, 0 * T, 0 * T))
    assert "check: nothing moves" in told(data)


def test_minutes_and_seconds_go_on_over_the_hour(tmp_path):
    seconds = (3590 + 0.5 * np.arange(40)) % 3600
    clock = [f"{at // 60:02.0f}:{at % 60:04.1f}" for at in seconds]
    rows = [f"{at},{x}" for at, x in zip(clock, FALL, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["datetime,x", *rows]) + "\n", encoding="utf-8")
    data = load_dataset(tmp_path / "a.csv")
    np.testing.assert_allclose(data.scenes[0].times, 3590 + 0.5 * np.arange(40))
    assert "seconds since the full hour" in told(data)


def test_bodies_in_turn_without_a_clock_are_frames_round_by_round(tmp_path):
    rows = [f"{who};{k + FALL[k]};{j}" for k in range(40) for j, who in enumerate(["sun", "moon"])]
    text = "\n".join(["name; position x; position y", *rows]) + "\n"
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    data = load_dataset(tmp_path / "a.csv", fps=10)
    assert data.scenes[0].names == ("sun", "moon") and len(data.scenes[0].times) == 40
    assert "a frame each round" in told(data)
    (tmp_path / "a.csv").write_text(text + "moon;1;1\nsun;2;0\n", encoding="utf-8")
    with pytest.raises(DataError, match="column 't'"):
        load_dataset(tmp_path / "a.csv", columns={"entity": "name"}, fps=10)


@pytest.mark.parametrize(("second", "length"), [(86400.0, "km"), (1.0, "au")])
def test_headings_of_horizons_alone_tell_the_units(tmp_path, second, length):
    days = np.arange(40.0)
    turn, size = days / 58, 1.5e8 if length == "km" else 1.0
    x, y = size * np.cos(turn), size * np.sin(turn)
    path = written(tmp_path / "a.csv", "JDTDB,Calendar Date (TDB),X,Y,Z,VX,VY,VZ", 2457944.5 + days,
                   days, x, y, 0 * x, -y / 58 / second, x / 58 / second, 0 * x)  # fmt: skip
    data = load_dataset(path)
    assert data.units.declared["length"] == length and data.units.declared["time"] == "day"
    assert "from which body places count" in told(data)
    assert np.ptp(data.scenes[0].times) == pytest.approx(39 * 86400)


def test_flights_of_gliders(tmp_path):
    clock = ["235957", "235958", "235959", "000000", "000001", "000002"]
    fixes = [f"B{at}4530{100 * k:03d}S00712000W{mark}02000{1000 + k:05d}"
             for k, (at, mark) in enumerate(zip(clock, "AAVAAA", strict=True))]  # fmt: skip
    path = tmp_path / "a.igc"
    path.write_text("\n".join(["AXXX", "HFDTE010203", *fixes, "GAB"]) + "\n", encoding="utf-8")
    data = load_dataset(path)
    (scene,) = data.scenes
    np.testing.assert_allclose(np.diff(scene.times), [1, 2, 1, 1])
    np.testing.assert_allclose(scene.positions[:, 0, 2], [1000, 1001, 1003, 1004, 1005])
    north = scene.positions[-1, 0, 1]  # half a minute of latitude to the south
    assert north == pytest.approx(-0.5 * 1852, rel=2e-3) and "without a height" in told(data)


def test_frames_of_particles(tmp_path):
    def write(comment, wrap=9.0):
        frames = [f"3\n{comment(k)}\nAr {(0.4 * k) % wrap} 0 1\nAr 1 {k * k} 2\nNe 2 1 0 extra\n"
                  for k in range(20)]  # fmt: skip
        path = tmp_path / "a.xyz"
        path.write_text("".join(frames), encoding="utf-8")
        return path

    (scene,) = load_dataset(write(lambda k: f"Time= {0.5 * k} ps, E=1")).scenes
    assert scene.names == ("Ar1", "Ar2", "Ne")
    np.testing.assert_allclose(scene.times, 0.5e-12 * np.arange(20))
    np.testing.assert_allclose(scene.positions[:, 1, 1], np.arange(20.0) ** 2)
    data = load_dataset(write(lambda k: f"timestep = {10 * k}", wrap=2.0), dt=0.01)
    np.testing.assert_allclose(data.scenes[0].times, 0.1 * np.arange(20))
    with pytest.raises(DataError, match="how long a frame is"):
        load_dataset(write(lambda k: ""))
    path = tmp_path / "b.xyz"
    path.write_text("2\n\nAr 0 0 0\nAr 1 1 1\n2\n\nAr 0 0 0\n", encoding="utf-8")
    with pytest.raises(DataError, match="line 5: this is no frame"):
        load_dataset(path, fps=1)


def test_formats_of_other_programs_are_named(tmp_path):
    (tmp_path / "a.labx").write_text("<x/>", encoding="utf-8")
    with pytest.raises(DataError, match="not read; .*CASSY Lab 2"):
        load_dataset(tmp_path / "a.labx")


def test_a_body_that_is_named_is_the_only_one(tmp_path):
    path = written(tmp_path / "a.csv", "t,P (x),P (y),Q7 (x),Q7 (y)", T, T, FALL, T + 1, FALL)
    data = load_dataset(path, columns={"head_x": "Q7 (x)", "head_y": "Q7 (y)"})
    assert data.scenes[0].names == ("head",)


def test_speeds_are_no_clock_and_frames_may_have_the_unit_of_times(tmp_path):
    path = written(tmp_path / "a.csv", "x,y,next_vy,bobVel", T, FALL, T, 2 * T)
    data = load_dataset(path, fps=20, units={"x": "cm", "t": "s"})
    np.testing.assert_allclose(data.scenes[0].times, T)
    assert data.units.declared["time"] == "s"
