"""Layouts that people's own files have: dates, lost cells, odd headings, tables of Horizons."""

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.errors import DataError
from tests.text_tables import rows, written

T = np.arange(30) / 10
X = np.cos(T)


def test_unix_times_are_seconds_whatever_they_count(tmp_path):
    for ticks in (1, 1_000, 1_000_000, 1_000_000_000):
        times = [int(1.7e9 * ticks) + int(round(t * ticks)) for t in T * 10]
        data = load_dataset(written(tmp_path, ["timestamp,x (m),y (m)", *rows(times, X, X**2)]))
        np.testing.assert_allclose(data.scenes[0].times, T * 10, atol=1e-5)
        assert any("since 1970" in note for note in data.notes)


def test_units_of_one_kind_in_headings_leave_the_other_open(tmp_path):
    data = load_dataset(written(tmp_path, ["t (s),x,y", *rows(T, X, X**2)]))
    assert data.units.symbols["m"] == "length" and "s" not in data.units.symbols
    assert any("no unit of length" in note for note in data.notes)
    data = load_dataset(written(tmp_path, ["t,x (cm),y (cm)", *rows(T, X, X**2)]))
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], X / 100)
    assert data.units.symbols["s"] == "time"


def test_rows_that_lack_cells_of_columns_that_are_not_used_are_read(tmp_path):
    whole = rows(T, X, X**2, T, T)
    lines = [
        "t,x,y,voltage,temperature",
        *whole[:-4],
        *(row.rsplit(",", 1)[0] for row in whole[-4:]),
    ]
    data = load_dataset(written(tmp_path, lines))
    assert len(data.scenes[0].times) == 30
    assert any("lack cells at their ends" in note and ": 4," in note for note in data.notes)
    cut = [*lines[:-1], ",".join(lines[-1].split(",")[:3])]  # y may be a part of a number
    with pytest.raises(DataError, match="3 cells"):
        load_dataset(written(tmp_path, cut))


def test_rows_that_have_all_that_is_used_may_lack_the_rest(tmp_path):
    """Several that end so were written so; one alone may have been cut within its last number."""
    header = "t,x,y,remark"
    lines = [header, f"{T[0]},{X[0]},0.5,7", *rows(T[1:], X[1:], X[1:])]
    data = load_dataset(written(tmp_path, lines))
    assert len(data.scenes[0].times) == 30
    assert any("lack cells at their ends" in note and ": 29," in note for note in data.notes)
    whole = rows(T, X, X, T)
    alone = [header, *whole[:-1], whole[-1].rsplit(",", 1)[0]]
    with pytest.raises(DataError, match="it lacks remark; .*leaves it out"):
        load_dataset(written(tmp_path, alone))
    data = load_dataset(written(tmp_path, alone), columns={"remark": "ignore"})
    assert len(data.scenes[0].times) == 30
    with pytest.raises(DataError, match="line 3: this row has 2 cells.*it lacks y, remark"):
        load_dataset(written(tmp_path, [header, *whole[:1], "0.1,0.5", *whole[2:]]))


def test_a_lone_z_is_a_height(tmp_path):
    data = load_dataset(written(tmp_path, ["time (s),z (m),v (m/s)", *rows(T, X, T)]))
    assert data.up == "y"
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], X)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("tdays,Angledeg", "deg"), ("Zeit t / s,Weg &b_A1 / rad", "rad"),
        ("# t in s, Winkel in rad", "rad"),
    ],
)  # fmt: skip
def test_angles_are_known_by_what_stands_behind_them(tmp_path, header, unit):
    mark = ";" if header.startswith("#") else ","
    data = load_dataset(written(tmp_path, [header, *rows(T, X, mark=mark)]))
    scale = np.pi / 180 if unit == "deg" else 1.0
    assert data.units.is_angle
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], scale * X)


@pytest.mark.parametrize("name", ["times", "Tmin", "tmax", "ts"])
def test_names_that_only_look_glued_have_no_unit(tmp_path, name):
    lines = [f"t,x,y,{name}", *rows(T, X, X**2, T)]
    data = load_dataset(written(tmp_path, lines))
    np.testing.assert_allclose(data.scenes[0].times, T)
    assert not data.units.declared


def test_offsets_on_the_sky_are_places(tmp_path):
    header = "Date\tDeltaR.A.\tDeltaDecl.\tDeltaR.A.Error\tDeltaDecl.Error"
    data = load_dataset(
        written(tmp_path, [header, *rows(2000 + T, X, X**2, T + 1, T + 2, mark="\t")])
    )
    np.testing.assert_allclose(data.scenes[0].positions[:, 0], np.stack([X, X**2], axis=1))
    np.testing.assert_allclose(data.scenes[0].sigma[:, 0, 1], T + 2)


def test_wide_separations_without_a_unit_are_milliarcseconds(tmp_path):
    for far, size in ((3.0, 1.0), (300.0, 1e-3)):
        lines = ["epoch,sep,sep_err,pa,pa_err",
                 *rows(55000 + 100 * T, far + X, 0 * T + 0.01, 10 * T, 0 * T + 0.1)]  # fmt: skip
        data = load_dataset(written(tmp_path, lines))
        place = data.scenes[0].positions[:, 0]
        np.testing.assert_allclose(
            np.linalg.norm(place, axis=1), np.abs(size * (far + X)), rtol=1e-6
        )


def test_places_on_the_globe_come_before_the_way_that_was_gone(tmp_path):
    header = '"Time (s)","Latitude (°)","Longitude (°)","Altitude (m)","Distance (km)"'
    lines = [header, *rows(T, 48 + 1e-5 * T, 9 + 1e-5 * X, 100 + T, T)]
    data = load_dataset(written(tmp_path, lines))
    assert data.scenes[0].n_dims == 3 and data.up == "z"
    assert np.ptp(data.scenes[0].positions[:, 0, 1]) == pytest.approx(
        1e-5 * 2.9 * 111_200, rel=1e-2
    )


def test_rows_of_data_with_words_are_no_header(tmp_path):
    lines = rows(2000 + T, X, T, ["Keck"] * 30, mark="  ")
    with pytest.raises(DataError, match="first line holds 3 number.*by its number"):
        load_dataset(written(tmp_path, lines))
    data = load_dataset(written(tmp_path, lines), columns={"t": "1", "x": "2"})
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], X)


ABOVE = ["*" * 70, " Target body name: 1543 Bourgeois (1941 S)   {source: JPL}", "*" * 70]


def horizons(tmp_path, names, body, mark=""):
    lines = [*ABOVE, names, "*" * 70, "$$SOE", *body, "$$EOE", "*" * 70, "notes"]
    return load_dataset(written(tmp_path, [mark + line for line in lines], "horizons_results.txt"))


def test_observer_tables_of_horizons_are_angles_on_the_sky(tmp_path):
    names = " Date__(UT)__HR:MN     R.A._____(ICRF)_____DEC"
    body = [f" 2022-Sep-01 21:{k:02d} *m  20 57 {39.98 + k:.2f} -00 41 49.3" for k in range(14, 30)]
    data = horizons(tmp_path, names, body)
    scene = data.scenes[0]
    assert scene.names == ("1543 Bourgeois",)
    np.testing.assert_allclose(np.diff(scene.times) / 86400 * 1440, 1.0, rtol=1e-3)
    across = np.diff(scene.positions[:, 0, 0])
    np.testing.assert_allclose(across, 15 * np.cos(np.radians(0.697)), rtol=1e-3)


def test_heliocentric_angles_of_horizons_are_places_in_space(tmp_path):
    names = " Date__(UT)__HR:MN     hEcl-Lon hEcl-Lat                r        rdot"
    body = [f" 1700-Jan-{k:02d} 00:00     134.{k:02d}00   7.1101   36.85155255243  -1.2277052"
            for k in range(7, 30)]  # fmt: skip
    scene = horizons(tmp_path, names, body, mark="@ ").scenes[0]
    assert scene.n_dims == 3
    far = np.linalg.norm(scene.positions[:, 0], axis=1)
    np.testing.assert_allclose(far, 36.85155255243 * 149_597_870_700.0, rtol=1e-9)


def test_vector_tables_of_horizons_in_lines_of_their_own(tmp_path):
    body = []
    for k in range(12):
        body += [f"{2459824.5 + k:.9f} = A.D. 2022-Sep-{2 + k:02d} 00:00:00.0000 TDB ",
                 f" X = {1.5 + k / 100:.6E} Y =-2.100000E-01 Z = 3.000000E-02",
                 " VX= 1.000000E-02 VY= 1.000000E-04 VZ= 0.000000E+00",
                 " LT= 1.000000E-02 RG= 1.500000E+00 RR= 1.000000E-02"]  # fmt: skip
    lines = [*ABOVE, " Output units    : AU-D", "*" * 70, "JDTDB", "   X     Y     Z", "*" * 70,
             "$$SOE", *body, "$$EOE"]  # fmt: skip
    data = load_dataset(written(tmp_path, lines, "horizons_results.txt"))
    au = 149_597_870_700.0
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], (1.5 + np.arange(12) / 100) * au)
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], -0.21 * au)


def test_an_observer_table_without_places_is_refused_with_what_to_ask_for(tmp_path):
    names = "Date_________JDUT       APmag   S-brt             delta      deldot"
    body = [f"{2457877.5 + k:.9f}      27.071    n.a.  3.15433612900422 -34.7661095"
            for k in range(9)]  # fmt: skip
    with pytest.raises(DataError, match="says no place.*vector table"):
        horizons(tmp_path, names, body)


def test_markers_that_tracking_tools_lost_and_found_are_bodies(tmp_path):
    lines = ['comment,"OptiTrack Export Data"', 'comment,"== "', "righthanded",
             "info,framecount,30", "frame,0,0.0,0,0"]  # fmt: skip
    for k in range(1, 30):
        lines.append(f"frame,{k},{k / 120:.8f},0,2,{X[k]},0.3,0.5,7,A,{-X[k]},0.1,0.2,8,B")
    scene = load_dataset(written(tmp_path, lines)).scenes[0]
    assert scene.names == ("A", "B") and scene.n_dims == 3
    np.testing.assert_allclose(scene.positions[:, 1, 0], -X[1:])


def test_dates_of_our_era_are_dates(tmp_path):
    days = [f"A.D. 2025-Jul-{day:02} 00:00:00.0000" for day in range(1, 31)]
    data = load_dataset(written(tmp_path, ["Date,X_AU,Y_AU", *rows(days, X, X**2)]))
    np.testing.assert_allclose(data.scenes[0].times, 86400 * np.arange(30))
    assert any("since 2025-07-01" in note for note in data.notes)


@pytest.mark.parametrize(
    "header",
    [
        "Tempo_ms,Angulo_Real_graus,Alvo_graus", "tiempo_ms,angulo_medido_grados,x_ref",
        "temps_ms,angle_degres,consigne", "zeit_ms,winkel_ist_grad,soll", "t_ms,theta_top_deg,ref",
    ],
)  # fmt: skip
def test_the_end_of_the_name_of_an_angle_is_its_unit(tmp_path, header):
    """Whatever words are between, in any language; and so it is of the clock."""
    path = written(tmp_path, [header, *rows(T * 1000, 40 * X, 0 * X)])
    angle = header.split(",")[1]
    for units in ({}, {angle: "deg"}, {angle: "deg", "t": "ms"}):
        data = load_dataset(path, units=units)
        assert data.units.is_angle
        np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], np.radians(40 * X))
        np.testing.assert_allclose(data.scenes[0].times, T)
    data = load_dataset(path, units={angle: "rad"})
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], 40 * X)


def test_what_is_asked_of_an_angle_says_no_unit_of_a_clock_that_has_one(tmp_path):
    path = written(tmp_path, ["Tempo_ms,Angulo_Real,Alvo", *rows(T * 1000, X, 0 * X)])
    with pytest.raises(DataError, match="unknown unit") as error:
        load_dataset(path)
    assert '"t"' not in str(error.value) and '{"Angulo_Real": "rad"}' in str(error.value)
    assert load_dataset(path, units={"Angulo_Real": "deg"}).units.is_angle
    path = written(tmp_path, ["Tempo,Angulo_Real", *rows(T, X)])
    with pytest.raises(DataError, match='"t": "s"'):
        load_dataset(path)


def test_recordings_below_a_clock_that_begins_anew_are_scenes(tmp_path):
    """Each begins where the first did, if not at the same instant, and has rows of its own."""
    runs = [(T, X), (0.1 + T[:12], X[5:17]), (T[:9], -X[:9])]
    lines = [line for t, x in runs for line in rows(t, x, x)]
    data = load_dataset(written(tmp_path, ["t (s),x (m),y (m)", *lines]))
    assert [scene.name for scene in data.scenes] == ["part 1", "part 2", "part 3"]
    for scene, (t, x) in zip(data.scenes, runs, strict=True):
        np.testing.assert_allclose(scene.times, t)
        np.testing.assert_allclose(scene.positions[:, 0, 0], x)
    assert any("begins anew in line 32, 44" in note for note in data.notes)
    speeds = [line for t, x in runs[:2] for line in rows(t, x)]
    data = load_dataset(written(tmp_path, ["t (s),vx (m/s)", *speeds]))
    assert len(data.scenes) == 2


@pytest.mark.parametrize(
    "second",
    [T[:6], T[:12] + 0.9, np.append(T[:12], T[3:12]), np.append(T[:12], T[11])],
    ids=["few rows", "begins elsewhere", "goes back", "stands still"],
)
def test_what_goes_back_otherwise_is_asked_for(tmp_path, second):
    lines = [*rows(T, X, X), *rows(second, *[X[: len(second)]] * 2)]
    with pytest.raises(DataError, match="must increase|two rows at t"):
        load_dataset(written(tmp_path, ["t,x,y", *lines]))


@pytest.mark.parametrize(
    "beside", ["Pres", "press", "P(hPa)", "P_hPa", "baro", "hum", "RH", "RH%", "temp1", "T (C)"]
)
def test_short_words_of_what_is_logged_beside_a_motion_are_no_places(tmp_path, beside):
    path = written(tmp_path, [f"Time,{beside},Alt", *rows(T, 900 + X, X)])
    data = load_dataset(path)
    np.testing.assert_allclose(data.scenes[0].times, T)
    np.testing.assert_allclose(data.scenes[0].positions[:, 0, 1], X)
    other = written(tmp_path, ["Time,depressed,Alt", *rows(T, 900 + X, X)])
    with pytest.raises(DataError, match="no column 'x'"):
        load_dataset(other)
