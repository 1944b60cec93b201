"""Tables as strangers keep them: own clocks, places on the globe, headers of some columns."""

import shutil

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.errors import DataError


def table(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_bodies_may_have_clocks_of_their_own(tmp_path):
    header = "#Time A\tPos A\tTime B\tPos B\n#[s]\t[cm]\t[s]\t[cm]\n"
    rows = "".join(f"{k}\t{k * k}\t{k + 0.5}\t{-k}\n" for k in range(8))
    data = bsp_gp.load_dataset(table(tmp_path, header + rows, "data.txt"))
    (scene,) = data.scenes
    assert scene.names == ("A", "B") and len(scene.times) == 16
    np.testing.assert_allclose(scene.positions[::2, 0, 0], 0.01 * np.arange(8.0) ** 2)
    assert np.isnan(scene.positions[1::2, 0, 0]).all()


def test_a_header_of_some_columns_is_not_put_over_the_first_ones(tmp_path):
    rows = "".join(f"0 {0.1 * k:.1f} {k * k} {2 * k}\n" for k in range(8))
    path = table(tmp_path, "% x v\n" + rows, "data.txt")
    with pytest.raises(DataError, match=r'2 name\(s\).* rows have 4.*"t": "2", "x": "3"'):
        bsp_gp.load_dataset(path)
    data = bsp_gp.load_dataset(path, columns={"t": "2", "x": "3"})
    assert data.scenes[0].positions[3, 0, 0] == 9


def test_one_column_is_asked_how_many_rows_a_second_has(tmp_path):
    path = table(tmp_path, "".join(f"{9 - 0.5 * k}\n" for k in range(8)))
    with pytest.raises(DataError, match=r"fps=25"):
        bsp_gp.load_dataset(path)
    data = bsp_gp.load_dataset(path, columns={"vx": "1"}, fps=2, units={"length": "m", "time": "s"})
    assert data.velocity == "only"


GLOBE = "time,lat,lon,hMSL,velN\n,(deg),(deg),(m),(m/s)\n"


def test_places_on_the_globe_are_places_in_a_plane(tmp_path):
    rows = "".join(f"{k},{45 + 1e-3 * k},{7 + 1e-3 * k},{100 - k},0.1\n" for k in range(8))
    data = bsp_gp.load_dataset(table(tmp_path, GLOBE + rows), units={"time": "s"})
    east, north, up = data.scenes[0].positions[-1, 0]
    # A degree of latitude at 45 degrees is 111,132 m long, one of longitude 78,847 m.
    assert north == pytest.approx(7e-3 * 111_132, rel=1e-3)
    assert east == pytest.approx(7e-3 * 78_847, rel=1e-3)
    assert up == 93 and data.up == "z"
    assert any("WGS 84" in note for note in data.notes)


def test_a_latitude_beyond_the_pole_is_refused(tmp_path):
    with pytest.raises(DataError, match="latitude is between -90 and 90, got 95"):
        bsp_gp.load_dataset(table(tmp_path, "t,lat,lon\n0,45,7\n1,95,7\n2,45,7\n"))


def test_a_workbook_is_read_by_its_content(tmp_path):
    made = tmp_path / "run.xlsx"
    pd.DataFrame({"t": np.arange(6.0), "x": np.arange(6.0), "y": np.ones(6)}).to_excel(
        made, index=False
    )
    named = shutil.copy(made, tmp_path / "run.xls")
    assert len(bsp_gp.load_dataset(named).scenes[0].times) == 6


def test_numbered_torques_may_drive_the_motion(tmp_path):
    rows = "".join(f"{k},{k * k},{k},{np.sin(k):.3f},{np.cos(k):.3f}\n" for k in range(8))
    data = bsp_gp.load_dataset(table(tmp_path, f"t,x,y,tau1,tau2\n{rows}"))
    assert any("tau1 may drive the motion" in note for note in data.notes)


@pytest.mark.parametrize("name", ["torque", "h_delta", "motor duty"])
def test_what_drives_or_doubts_is_no_coordinate(tmp_path, name):
    rows = "".join(f"{k},{k * k},{np.sin(k):.3f}\n" for k in range(8))
    data = bsp_gp.load_dataset(table(tmp_path, f"t,x,{name}\n{rows}"))
    assert f"not used: {name}" in data.notes
    assert any("may drive the motion" in note for note in data.notes) == (name == "torque")


def test_the_rate_of_an_angle_needs_no_unit(tmp_path):
    t = 0.01 * np.arange(200)
    rows = "".join(f"{a:.2f},{np.cos(9 * a):.6f}\n" for a in t)
    data = bsp_gp.load_dataset(table(tmp_path, f"time,angular_velocity\n{rows}"))
    assert data.velocity == "only"
    assert np.ptp(data.scenes[0].positions[:, 0, 0]) == pytest.approx(2 / 9, rel=0.01)


def test_velocities_with_few_rows_a_turn_are_not_added_up(tmp_path):
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 60, 60))
    speed = 50 * np.cos(2 * np.pi * t / 4.2) + rng.normal(0, 2, 60)
    rows = "".join(f"{a:.4f},{v:.3f},2\n" for a, v in zip(t, speed, strict=True))
    with pytest.raises(DataError, match="too far apart to be added up"):
        bsp_gp.load_dataset(table(tmp_path, f"t (day),speed (m/s),e_speed\n{rows}"))
    often = 0.05 * np.arange(400)
    rows = "".join(f"{a:.4f},{50 * np.cos(1.5 * a):.6f},1e-3\n" for a in often)
    assert bsp_gp.load_dataset(table(tmp_path, f"t (day),speed (m/s),e_speed\n{rows}")).scenes


@pytest.mark.parametrize(
    ("first", "unit", "is_sky"), [(2002.25, None, True), (2.4e6, None, True), (0.0, None, False),
                                  (2002.25, {"length": "m", "time": "s"}, False)],
)  # fmt: skip
def test_dates_tell_the_sky_where_no_unit_does(first, unit, is_sky):
    frame = pd.DataFrame({"t": first + np.arange(12.0), "x": np.arange(12.0), "y": 1.0})
    assert is_of_the_sky(bsp_gp.Dataset.from_frames(frame, units=unit)) == is_sky


@pytest.mark.slow
def test_bodies_with_clocks_of_their_own_are_asked_like_others(tmp_path):
    rng = np.random.default_rng(0)
    early, late = 0.05 * np.arange(160), 0.05 * np.arange(160) + 0.025
    a = 3.0 * np.cos(4.4 * early) * np.exp(-0.05 * early) + 0.01 * rng.standard_normal(160)
    b = 2.0 * np.sin(4.4 * late) * np.exp(-0.05 * late) + 0.01 * rng.standard_normal(160)
    rows = "".join(f"{t:.4f},{x:.4f},{s:.4f},{y:.4f}\n"
                   for t, x, s, y in zip(early, a, late, b, strict=True))  # fmt: skip
    path = table(tmp_path, f"Time A (s),Pos A (cm),Time B (s),Pos B (cm)\n{rows}")
    report = bsp_gp.close_loop(bsp_gp.load_dataset(path), [], rng=0, n_bootstrap=0)
    values = [c.value for done in report.rounds if done.adopted for c in done.effect.constants]
    assert any(abs(abs(value) - 4.4**2) < 0.2 for value in values)
