"""Layouts of files that strangers have published: lines made up after them, a fourth time."""

import numpy as np
import pytest

from bsp_gp import load_dataset, save_dataset
from bsp_gp.errors import DataError
from tests.text_tables import rows, written


def observation(day, seconds, arcsec, *, end="F51", kind="C", name="06489J91J00X"):
    """A line of 80 columns near 13 h 52 min, -7 degrees."""
    ra, dec = f"13 52 {seconds:06.3f}", f"-07 06 {arcsec:05.2f}"
    return f"{name}  {kind}1991 05 {day:09.6f}{ra:12}{dec:12}{'16.1 GV#00Bq':>21}{end}"


def test_observations_of_the_minor_planet_center_are_places_on_the_sky(tmp_path):
    lines = [observation(12 + k / 64, 10 + k, 49 - k, end=("F51", "C51")[k % 2]) for k in range(9)]
    lines[1:1] = [observation(12.01, 0, 0, kind="X"),
                  f"{lines[0][:14]}s1991 05 12.000000 1 - 1797.7 + 6042.7 - 2854.2{'250':>15}"]
    comet = [observation(12 + k / 64, 10 - k / 4, 9, name="    CJ95O010") for k in range(9)]
    data = load_dataset(written(tmp_path, ["COD F51", *lines, *comet], "made_up.txt"))
    (scene,) = data.scenes
    assert scene.names == ("6489", "CJ95O010")
    assert scene.times[0] / 86400 == pytest.approx(2448388.5, abs=1e-9)  # 1991 May 12.0
    assert np.diff(scene.times) == pytest.approx(86400 / 64, rel=1e-4)
    moved = np.diff(scene.positions[:, 0], axis=0)
    assert moved == pytest.approx(np.full((8, 2), [15 * np.cos(np.radians(7.1)), 1]), rel=1e-3)
    assert data.steps == pytest.approx((0.015 * np.cos(np.radians(7.1)), 0.01), rel=1e-3)
    assert any("observatories (F51 (14), C51 (4))" in note for note in data.notes)
    assert any("2 line(s)" in note for note in data.notes)
    lines.append(observation(12 + 8 / 64, 18.02, 41.1, end="250"))  # from elsewhere, at once
    both = load_dataset(written(tmp_path, lines, "both.txt"))
    assert both.scenes[0].times == pytest.approx(scene.times)
    far = [observation(12 + k, 10, 9).replace("13 52", f"{8 + k:02d} 52") for k in range(4)]
    with pytest.raises(DataError, match="keep the rows of fewer nights"):
        load_dataset(written(tmp_path, far, "far.txt"))


@pytest.mark.parametrize("form", ["bytes", "astropy", "VizieR"])
def test_angles_in_several_columns_are_one(tmp_path, form):
    head = [
        "Title: Places of a Made-up Body", "=" * 80, "Byte-by-byte Description of file: t.txt",
        "-" * 80, "   Bytes Format Units   Label  Explanations", "-" * 80,
        "   1- 12 F12.4  d       JD     Date", "  14- 15 I2     h       RAh    Hour",
        "  17- 18 I2     min     RAm    Minute", "  20- 24 F5.2   s       RAs    Second",
        "      26 A1     ---     DE-    Sign", "  27- 28 I2     deg     DEd    Degree",
        "  30- 31 I2     arcmin  DEm    Minute", "  33- 36 F4.1   arcsec  DEs    Second", "-" * 80,
    ]  # fmt: skip
    body = [f"{2450000 + k:12.4f} 20 57 {10 + k:05.2f} -00 41 {9 + 2 * k:04.1f}" for k in range(9)]
    if form != "bytes":
        mark = "," if form == "astropy" else "\t"
        names = [line.split()[-2] for line in head[6:14]]
        units = [line.split()[-3].replace("---", "") for line in head[6:14]]
        below = [mark.join(units), mark.join(["----"] * 8)] if form == "VizieR" else []
        body = [mark.join(line.replace("-00", "- 0").split()) for line in body]
        head = ["#made up"] * (form == "VizieR") + [mark.join(names), *below]
    data = load_dataset(written(tmp_path, [*head, *body], "t_mrt.txt"))
    moved = np.diff(data.scenes[0].positions[:, 0], axis=0)
    assert moved == pytest.approx(np.full((8, 2), [15, -2]), rel=1e-3)
    assert data.steps == pytest.approx((0.15, 0.1), rel=1e-3)


TURN = np.arange(13) * np.pi / 12
CIRCLE = 7000 * np.cos(TURN), 7000 * np.sin(TURN), 0 * TURN


def message(frame, centre="EARTH", form="2024-12-31T23:{:02d}:00.000"):
    own = [f"{form.format(4 * k)} {x:.6f} {y:.6f} {z:.6f} 1.0 2.0 3.0"
           for k, (x, y, z) in enumerate(zip(*CIRCLE, strict=True))]  # fmt: skip
    return ["CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2025-01-01T00:00:00", "META_START",
            "OBJECT_NAME          = MADE UP", f"CENTER_NAME          = {centre}",
            f"REF_FRAME            = {frame}", "META_STOP", "COMMENT  a mass of 1 kg", *own,
            "COVARIANCE_START", "EPOCH = 2024-12-31T23:00:00", "1.0", "1.0 2.0", "1.0 2.0 3.0",
            "COVARIANCE_STOP"]  # fmt: skip


@pytest.mark.parametrize("form", ["2024-12-31T23:{:02d}:00.000", "2024-366T23:{:02d}:00Z"])
def test_orbit_ephemeris_messages_have_their_centre_at_the_origin(tmp_path, form):
    data = load_dataset(written(tmp_path, message("EME2000", form=form), "a.oem"))
    (scene,) = data.scenes
    assert scene.names == ("Earth", "MADE UP")
    assert np.diff(scene.times) == pytest.approx(240)
    assert scene.positions[:, 1] == pytest.approx(1000 * np.transpose(CIRCLE), abs=1e-3)
    assert not scene.positions[:, 0].any()
    sun = load_dataset(written(tmp_path, message("ICRF", "SOLAR SYSTEM BARYCENTER"), "b.txt"))
    assert sun.scenes[0].names == ("MADE UP",)


@pytest.mark.parametrize("frame, is_turning", [("J2000", False), ("Fixed", True)])
def test_ephemerides_of_stk_are_on_axes_that_keep_their_directions(tmp_path, frame, is_turning):
    body = [f" {240 * k:.8e}  {x:.8e}  {y:.8e} {z:.8e} 1.0 2.0 3.0"
            for k, (x, y, z) in enumerate(zip(*CIRCLE, strict=True))]  # fmt: skip
    lines = ["stk.v.11.0", "", "# WrittenBy    STK_v11.3.0", "BEGIN Ephemeris",
             "  NumberOfEphemerisPoints  13", "  CentralBody  Earth", "  DistanceUnit Kilometers",
             f"  CoordinateSystem  {frame}", "  EphemerisTimePosVel", "", *body, "",
             "END Ephemeris"]  # fmt: skip
    data = load_dataset(written(tmp_path, lines, "made_up.e"))
    (scene,) = data.scenes
    assert scene.names == ("Earth", "made_up")
    x, y, _ = scene.positions[-1, 1]
    turned = 7.2921151467e-5 * 240 * 12 * is_turning
    assert np.arctan2(-y, -x) == pytest.approx(turned, abs=1e-6)
    assert any("turn with the Earth" in note for note in data.notes) == is_turning


def test_elements_of_an_orbit_are_no_motion(tmp_path):
    one = "1 43466U 98067NP  19148.08702609  .00015247  00000-0  15470-3 0  9997"
    two = "2 43466  51.6373  84.0291 0002049  67.4964 292.6248 15.65439709 59539"
    for lines in ([one, two], ["MADE UP", one, two]):
        with pytest.raises(DataError, match=r"two-line elements.*t,x,y,z"):
            load_dataset(written(tmp_path, lines, "a.txt"))


def test_input_of_orbit_has_measures_of_a_double_star_and_velocities(tmp_path):
    years = 1990 + 3 * np.arange(9)
    head = ["Object:  made up", "RA:  10.29", "Parallax: 12.7   # in mas", "P  15.2", "*K1  00",
            "C   CHISQ  Sig_V1", "C  1991.25  44.0  0.104  0.001  I1"]  # fmt: skip
    places = rows(years, 40 * np.arange(9), ["0.1"] * 9, ["0.002"] * 9, ["I1"] * 9, mark="  ")
    speeds = [f"{48000 + 90 * k}.5  {5 * np.cos(k):.2f}  0.4  V{'ab'[k % 2]} COR"
              for k in range(30)]  # fmt: skip
    path = written(tmp_path, [*head, *places, "C RV", *speeds], "m.inp")
    data = load_dataset(path)
    assert data.scenes[0].names == ("companion", "primary")
    seen = np.isfinite(data.scenes[0].positions[:, 0, 0])
    assert data.scenes[0].sigma[seen, 0] == pytest.approx(0.002, rel=1e-3)
    assert any("(Vb) are not read: 15" in note for note in data.notes)
    sight = load_dataset(path, columns={"rv": "RV (km/s)", "srv": "RV_err"})
    assert sight.is_of_sight and len(sight.scenes[0].times) == 15
    assert np.diff(sight.scenes[0].times) == pytest.approx(180 * 86400)


WAVE = np.round(np.sin(np.arange(60) / 5), 4)
SECONDS = np.round(0.05 + np.arange(60) / 100 + 1e-4 * WAVE, 6)


@pytest.mark.parametrize(
    "names, told",
    [
        ("AccelerationZ,AccelerationY,AccelerationX", "accelerations ('AccelerationZ')"),
        ("gyroX,gyroY,gyroZ", "velocities ('gyroX')"),
        ("velX,velY,velZ", "velocities ('velX', 'velY', 'velZ')"),
    ],
)
def test_axes_that_are_joined_to_their_words_are_known(tmp_path, names, told):
    body = rows(1729260574556450300 + np.arange(60), SECONDS, WAVE, [0.001] * 60, [0.002] * 60)
    data = load_dataset(written(tmp_path, [f"Timestamp,seconds_elapsed,{names}", *body]))
    assert any(f"places are sums of {told}" in note for note in data.notes)
    assert np.diff(data.scenes[0].times)[5] == pytest.approx(0.01, rel=0.01)


def test_of_dates_and_other_clocks_that_which_rises_in_every_row_is_the_time(tmp_path):
    whole = [f"2024-10-17 16:06:{k // 10:02d}" for k in range(60)]
    java = [f"Thu Oct 17 16:06:{k:02d} GMT+08:00 2024" for k in range(60)]
    late = ["-"] * 9 + java[9:]
    parts = [f"17-Oct-2024 16:06:{k:02d}" + ".5" * (k > 0) for k in range(60)]
    for first, second, is_second, step in (
        ("Date", "Timestamp", True, 0.1), ("GPS Time", "Device Time", True, 1),
        ("Time", "State", False, 1),
    ):  # fmt: skip
        cells = {"Date": whole, "Timestamp": np.round(1.7e9 + np.arange(60) / 10, 1),
                 "GPS Time": late, "Device Time": parts, "Time": java, "State": ["on"] * 60}
        lines = [f"{first},{second},x,y", *rows(cells[first], cells[second], WAVE, WAVE)]
        data = load_dataset(written(tmp_path, lines))
        assert np.diff(data.scenes[0].times)[1:] == pytest.approx(step, abs=1e-5)
        assert any(f"{second!r} as t" in note for note in data.notes) == is_second


def test_places_in_logs_of_drones_are_those_that_change(tmp_path):
    names = "APP.latitude,APP.longitude,OSD.latitude,OSD.longitude,OSD.height [m],CUSTOM.updateTime"
    clock = [f"2018/07/04 09:19:{k:02d}.701" for k in range(30)]
    k = np.arange(30)
    body = rows([55.5] * 30, [10.7] * 30, 55.5 + k / 1e5, 10.7 - k**2 / 1e6, k / 10, clock)
    data = load_dataset(written(tmp_path, [names, *body]))
    assert all(text in data.provenance["columns"]
               for text in ("t = 'CUSTOM.updateTime'", "x = 'OSD.longitude'"))  # fmt: skip
    assert np.diff(data.scenes[0].positions[:, 0, 1]) == pytest.approx(1.113, abs=0.01)


def test_ways_to_the_east_and_the_north_have_heights_above_them(tmp_path):
    for names in ("Position East of launch (m),Position North of launch (m),Altitude (m)",
                  "Easting (m),Northing (m),Height (m)", "East (m),North (m),Up (m)"):
        body = rows(SECONDS, WAVE, 2 * WAVE, np.arange(60))
        body.insert(3, "# Event LIFTOFF occurred at t=0.05 seconds")
        data = load_dataset(written(tmp_path, [f"Time (s),{names}", *body]))
        assert data.scenes[0].positions[:, 0] == pytest.approx(
            np.stack([WAVE, 2 * WAVE, np.arange(60)], axis=1)
        )


def test_a_title_above_a_row_of_units_is_no_body(tmp_path):
    body = rows(SECONDS, WAVE, WAVE, mark="\t")
    head = ["Made-up pointings", "t\tx\ty", "(s)\t(m)\t(m)"]
    assert load_dataset(written(tmp_path, [*head, *body])).scenes[0].names == ("object",)
    tracker = load_dataset(written(tmp_path, ["puck", "t\tx\ty", *body]))
    assert tracker.scenes[0].names == ("puck",)


def test_the_only_column_of_lengths_is_proposed_as_the_place(tmp_path):
    path = written(tmp_path, ["t (s),hauteur de chute (m)", *rows(SECONDS, WAVE)])
    with pytest.raises(DataError) as caught:
        load_dataset(path)
    assert '--columns x="hauteur de chute (m)"' in caught.value.remedy
    assert load_dataset(path, columns={"x": "hauteur de chute (m)"}).up is None


def test_velocities_by_their_numbers_have_a_unit_that_is_told(tmp_path):
    path = written(tmp_path, rows(2450000.5 + 7 * np.arange(60) ** 1.1, WAVE, [0.3] * 60, mark=" "))
    notes = load_dataset(path, columns={"t": "1", "rv": "2", "srv": "3"}).notes
    assert any(note.startswith("check: '2' has no unit: m/s is taken") for note in notes)
    assert "'3' is taken as its error" in notes


def test_a_saved_table_of_the_sky_keeps_the_steps_of_its_digits(tmp_path):
    ra = [f"20 57 {10 + k / 50:05.2f}" for k in range(60)]
    lines = ["t (day),ra,dec", *rows(np.arange(60), ra, [f"-00 41 {k:04.1f}" for k in range(60)])]
    data = load_dataset(written(tmp_path, lines))
    again = load_dataset(save_dataset(data, tmp_path / "saved"))
    assert again.steps == data.steps != ()
