"""Layouts of files that strangers have published: excerpts of what they have in common."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp import load_dataset
from bsp_gp.data.noise import estimate_noise
from bsp_gp.errors import DataError
from tests.text_tables import rows, written

T = np.arange(30) / 10
X = np.cos(T)


def horizons(name, names, body):
    return [
        "*" * 70, f"Target body name: {name}                 {{source: JPL#80}}",
        "Output units    : AU-D", "*" * 70, names, "*" * 70, "$$SOE", *body, "$$EOE", "*" * 70,
    ]  # fmt: skip


def test_a_body_of_horizons_may_have_a_designation_in_brackets_alone(tmp_path):
    names = "JDTDB, Calendar Date (TDB), X, Y, Z, VX, VY, VZ,"
    body = [f"{2460000 + k}.0, A.D. 2023-Feb-24 12:00, {1 - k / 99}, {k / 9}, 0.1, 0, 0, 0,"
            for k in range(9)]  # fmt: skip
    for text, own in (("(2024 YR4)", "2024 YR4"), ("1543 Bourgeois (1941 S)", "1543 Bourgeois")):
        data = load_dataset(written(tmp_path, horizons(text, names, body), "h.txt"))
        assert data.scenes[0].names == (own,)


def test_what_a_telephone_has_logged_is_known_by_any_word_of_its_sensor(tmp_path):
    header = ",seconds_elapsed,z,y,x"
    lines = [header, *rows(range(200), np.arange(200) / 100, *([np.sin(np.arange(200) / 9)] * 3))]
    for name in ("Acceleration_Project.csv", "ride_to_school_accelerometer.csv"):
        data = load_dataset(written(tmp_path, lines, name))
        assert data.velocity == "unseen"
    with pytest.raises(DataError, match="a sensor of a telephone shows") as caught:
        load_dataset(written(tmp_path, lines, "project.csv"))
    assert "x=m/s^2" in caught.value.remedy
    named = load_dataset(tmp_path / "project.csv", units={a: "m/s^2" for a in "xyz"})
    assert named.velocity == "unseen"
    placed = load_dataset(tmp_path / "project.csv", columns={a: a for a in "xyz"})
    assert placed.scenes[0].positions.shape[2] == 3 and placed.velocity == "ignore"


def test_units_that_astropy_says_above_the_table_are_those_of_its_columns(tmp_path):
    above = [
        "# %ECSV 1.0", "# ---", "# datatype:", "# - {name: bjd, unit: d, datatype: float64}",
        "# - {name: rv, unit: km / s, datatype: float64, description: 'of the star, {all}'}",
        "# - {name: rv_err, unit: !astropy.units.Unit {unit: km / s}, datatype: float64}",
    ]  # fmt: skip
    body = rows(2458499.5 + 7 * T, 10 * X, 0 * T + 0.1, mark=" ")
    path = written(tmp_path, [*above, "# schema: astropy-2.0", "bjd rv rv_err", *body], "s.ecsv")
    data = load_dataset(path)
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], 10 * X)
    assert "km / s" in str(data.units.declared)
    assert not any("has no unit" in note for note in data.notes)
    places = ["# %ECSV 0.9", "# ---", "# delimiter: ','", "# datatype:",
              "# - {name: t, unit: ms, datatype: float64}",
              "# - {name: x, unit: cm, datatype: float64}", "t,x"]  # fmt: skip
    data = load_dataset(written(tmp_path, [*places, *rows(T, X)], "p.ecsv"))
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], X / 100)
    np.testing.assert_allclose(data.scenes[0].times, T / 1000)


def test_orbits_in_sp3_are_turned_back_about_the_earth(tmp_path):
    """A satellite that keeps its place over the ground goes round once in a day."""
    lines = ["", "#cP2017  2 14  0  0  0.00000000       2 ORBIT IGS14 HLM  IGS",
             "## 1936 172800.00000000   900.00000000 57798 0.0000000000000", "+    2   G01G02"]
    for k in range(24):
        lines += [f"*  2017  2 14 {k:2d}  0  0.00000000",
                  "PG01  42164.000000      0.000000      0.000000     49.177035  7  6  8 122",
                  "PG02      0.000000      0.000000      0.000000 999999.999999"]  # fmt: skip
    data = load_dataset(written(tmp_path, [*lines, "EOF"], "orbits.sp3"))
    (scene,) = data.scenes
    assert scene.names == ("Earth", "G01")
    places = scene.positions[:, 1]
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 4.2164e7)
    np.testing.assert_allclose(np.ptp(np.unwrap(np.arctan2(places[:, 1], places[:, 0]))),
                               7.292115e-5 * 23 * 3600, rtol=1e-6)  # fmt: skip
    assert any("turn with the Earth" in note for note in data.notes)
    comment = ["#cPlaces", "t,x", *rows(T, X)]
    assert len(load_dataset(written(tmp_path, comment)).scenes[0].times) == 30


def test_places_in_the_sky_with_a_distance_are_places_in_space(tmp_path):
    """The distance is no motion on a line; one that is the same in all rows says nothing."""
    turn, far = np.arange(30) / 20, 5 + X / 9
    lines = ["Date,JD,RA (deg),DEC (deg),Dist_AU",
             *rows([f"2023-Jan-{k + 1:02d} 00:00" for k in range(30)], 2459957.5 + np.arange(30),
                   np.degrees(turn), 0 * turn + 30, far)]  # fmt: skip
    data = load_dataset(written(tmp_path, lines))
    au = 149_597_870_700.0
    places = data.scenes[0].positions[:, 0] / au
    flat = far * np.cos(np.radians(30))
    expected = np.stack([flat * np.cos(turn), flat * np.sin(turn), far / 2], axis=1)
    np.testing.assert_allclose(places, expected)
    assert any("places x, y and z in space" in note for note in data.notes)
    near = ["t (day),ra (deg),dec (deg),distance (pc)",
            *rows(T, 10 + X / 100, T / 100, 0 * T + 7)]  # fmt: skip
    data = load_dataset(written(tmp_path, near))
    assert data.scenes[0].n_dims == 2 and any("not used: distance" in n for n in data.notes)


def test_observer_tables_of_horizons_with_a_distance_are_places_in_space(tmp_path):
    names = " Date__(UT)__HR:MN     R.A._____(ICRF)_____DEC             delta      deldot"
    body = [f" 2022-Sep-{k:02d} 00:00     {k:02d} 00 00.00 +00 00 00.0  2.00000000000000 -34.766"
            for k in range(1, 20)]  # fmt: skip
    body[3] = body[3].replace("2.000", "2.100")
    data = load_dataset(written(tmp_path, horizons("(2024 YR4)", names, body), "h.txt"))
    far = np.linalg.norm(data.scenes[0].positions[:, 0], axis=1) / 149_597_870_700.0
    np.testing.assert_allclose(far, [2.1 if k == 3 else 2 for k in range(19)])
    bare = [line.partition("  2.")[0] for line in body]
    alone = names.partition("   delta")[0].rstrip()
    with pytest.raises(DataError, match="degrees from the middle") as caught:
        load_dataset(written(tmp_path, horizons("(2024 YR4)", alone, bare), "h.txt"))
    assert "vector table" in caught.value.remedy


def test_a_velocity_in_two_units_is_one_and_so_is_a_height(tmp_path):
    speed = 10 - 9.81 * T
    height = 50 + 10 * T - 9.81 * T**2 / 2
    lines = ["t(s),alt(ft),vz(ft/s),alt(m),vz(m/s)",
             *rows(T, height / 0.3048, speed / 0.3048, height, speed)]  # fmt: skip
    data = load_dataset(written(tmp_path, lines))
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], height)
    assert "= 'alt(m)'" not in data.provenance["columns"]
    assert not any(" as ;" in note or "as ," in note for note in data.notes)
    lines[0] = "t(s),x(px),y,x(m),vz(m/s)"
    with pytest.raises(DataError, match="'x' twice .x.px., x.m.") as caught:
        load_dataset(written(tmp_path, lines))
    assert 'x(m)"=ignore' in caught.value.remedy


def test_bodies_behind_their_axes_and_precisions_in_brackets(tmp_path):
    header = "\t".join([
        "Time (seconds) (± 0.0083s)", "x-coordinate for mass 1 (meters)  (± 0.0025m)",
        "y-coordinate for mass 1 (meters) (± 0.0025m)", "x velocity of mass 1 (m/s)",
        "x-coordinate for mass 2 (meters)  (± 0.0025m)",
        "y-coordinate for mass 2 (meters) (± 0.0025m)",
    ])  # fmt: skip
    path = written(tmp_path, [header, *rows(T, X, X**2, T, X / 2, X**3, mark="\t")])
    data = load_dataset(path)
    assert data.scenes[0].names == ("mass 1", "mass 2")
    np.testing.assert_allclose(data.scenes[0].positions[:, 1, 0], X / 2)
    assert {data.units.declared["time"], data.units.declared["length"]} <= {"seconds", "s", "m"}
    for blanks in (" ", "  "):
        name = f"x-coordinate for mass 1 (meters){blanks}(± 0.0025m)"
        (scene,) = load_dataset(path, columns={"y": name}).scenes
        np.testing.assert_allclose(scene.positions[:, 0, 1], X)


def test_velocities_of_a_star_that_are_named_are_read_beside_places_of_its_companion(tmp_path):
    lines = ["epoch,object,sep,sep_err,pa,pa_err,rv,rv_err",
             *(f"{56900 + 90 * k},1,606.5,7.0,{180 + k},0.6,," for k in range(3)),
             *(f"{50000 + 37 * k},0,,,,,{0.3 * X[k]},0.002" for k in range(30))]  # fmt: skip
    path = written(tmp_path, lines)
    data = load_dataset(path)
    assert len(data.scenes[0].times) == 3
    told = [note for note in data.notes if "velocities along the line of sight" in note]
    assert "check" in told[0] and "30" in told[0]
    columns = {"rv": "rv", "srv": "rv_err", "t": "epoch"}
    data = load_dataset(path, columns=columns)
    assert data.velocity == "sight" and len(data.scenes[0].times) == 30
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], 0.3 * X)
    assert any("not used, since velocities are named: sep" in note for note in data.notes)
    with pytest.raises(DataError, match="not read at once"):
        load_dataset(path, columns={**columns, "separation": "sep", "position_angle": "pa"})


def test_several_recordings_in_each_sheet_are_told_apart_by_both(tmp_path):
    pytest.importorskip("openpyxl")
    drops = pd.DataFrame({"Drop #": np.repeat([1, 2], 30), "Time (s)": np.tile(T, 2),
                          "Height (m)": np.tile(X, 2)})  # fmt: skip
    for heading in ("Drop #", "Which"):
        path = tmp_path / f"{heading[0]}.xlsx"
        with pd.ExcelWriter(path) as book:
            for name in ("ball", "cup"):
                own = drops.rename(columns={"Drop #": heading})
                own.to_excel(book, sheet_name=name, index=False)
        data = load_dataset(path, columns={} if heading == "Drop #" else {"scene": heading})
        assert [s.name for s in data.scenes] == ["ball 1", "ball 2", "cup 1", "cup 2"]
        assert not any("not used" in note for note in data.notes)


def test_angles_in_counts_of_an_encoder(tmp_path):
    path = written(tmp_path, ["time_us,angle", *rows(range(0, 300_000, 10_000), range(30))])
    for unit in ("0.09 deg", "rev/4000", "2 turns / 8000"):
        data = load_dataset(path, units={"angle": unit, "time": "us"})
        assert data.units.is_angle
        np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], np.pi / 2000 * np.arange(30))
    with pytest.raises(DataError, match="unknown unit") as caught:
        load_dataset(path)
    assert "angle=rev/4000" in caught.value.remedy
    several = written(tmp_path, ["t (s),theta1,theta2", *rows(T, range(30), range(30))])
    data = load_dataset(several, units={"theta": "rev/4000"})
    assert data.units.is_angle and data.scenes[0].positions[-1, 1, 0] == pytest.approx(
        29 * np.pi / 2000
    )


def test_a_column_that_goes_up_over_the_whole_file_is_proposed_as_the_clock(tmp_path):
    """Places fall back behind the lines from which a table without names is known."""
    fall = np.cumsum(1 + np.arange(80) / 40)
    frames = np.concatenate([start + np.arange(80) for start in (652, 974, 1262)])
    frames[5:] += 4  # some are lost
    path = written(tmp_path, rows(np.round(np.concatenate([fall, fall + 9, fall]), 3), frames))
    with pytest.raises(DataError, match="'2' increases from row to row") as caught:
        load_dataset(path)
    assert "--columns t=2 x=1" in caught.value.remedy
    data = load_dataset(path, columns={"t": "2", "x": "1"})
    (told,) = [note for note in data.notes if "below each other" in note]
    assert "81, 161" in told


def test_few_whole_pixels_that_come_back_are_a_grid(tmp_path):
    rng = np.random.default_rng(1)
    y = 550 + 2 * (np.cumsum(rng.random(300) < 0.2) % 3)
    x = np.round(400 * np.cos(np.arange(300) / 20) + rng.normal(0, 0.4, 300))
    data = load_dataset(written(tmp_path, ["t,x,y", *rows(np.arange(300) / 25, x, y)]))
    assert estimate_noise(data).sigma[1] >= 2 / np.sqrt(12)


def test_places_that_are_held_between_fixes_have_the_noise_of_these(tmp_path):
    """The height is new in each row, so that no row as a whole is held."""
    rng = np.random.default_rng(1)
    t = np.arange(600) / 100
    fixes = 100 * np.sin(t[::10] / 3) + rng.normal(0, 0.2, 60)
    x = np.repeat(fixes, 10) * (1 + 1e-13 * rng.normal(size=600))
    lines = ["t (s),x (m),y (m)", *rows(t, map(repr, x.tolist()), 40 * t - 4.9 * t**2)]
    sigma = estimate_noise(load_dataset(written(tmp_path, lines))).sigma
    assert 0.1 < sigma[0] < 0.4


def test_counts_of_an_encoder_at_a_slow_place_are_no_held_readings(tmp_path):
    """Numbers with as many digits each lie on no grid; the larger of them do."""
    t = np.arange(2000) / 40
    counts = 1.2126e-4 * np.round(0.03 * np.cos(t / 2) / 1.2126e-4)
    texts = [f"{c:.4f}" if abs(c) >= 1e-3 else f"{c:.4E}" for c in counts]
    data = load_dataset(written(tmp_path, ["t (s),x (m)", *rows(t, texts)]))
    assert len(data.scenes[0].times) == 2000
    assert not any("hold the place" in note for note in data.notes)


def test_a_lift_that_goes_twice_does_not_swing(tmp_path):
    rng = np.random.default_rng(1)
    t = np.arange(0, 52, 0.01)
    pushed = 0 * t
    for start, sign in ((12, 1), (18, -1), (35, 1), (41, -1)):
        pushed += sign * 0.85 * ((t > start) & (t < start + 2.5))
    shown = pushed - 0.03 + rng.normal(0, 0.02, len(t))
    lines = ["t (s),Linear Acceleration z (m/s^2)", *rows(t, shown)]
    places = load_dataset(written(tmp_path, lines)).scenes[0].positions[:, 0, 0]
    assert np.ptp(places) == pytest.approx(2 * 0.85 * 2.5 * 6, rel=0.1)
    swung = np.cos(2 * np.pi * t / 4) * np.exp(-t / 40) + rng.normal(0, 0.02, len(t))
    lines = ["t (s),Linear Acceleration z (m/s^2)", *rows(t, swung)]
    places = load_dataset(written(tmp_path, lines)).scenes[0].positions[:, 0, 0]
    assert np.ptp(places) < 2.5 * (4 / 2 / np.pi) ** 2
