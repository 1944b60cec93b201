"""Layouts of files that strangers have published: excerpts of what they have in common, once more.

The first two are in ``test_tables_of_strangers.py`` and ``test_tables_once_more.py``.
"""

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.data.noise import estimate_noise
from bsp_gp.errors import DataError
from tests.text_tables import rows, written

NIGHTS = np.round(2450000 + np.cumsum(1 + 9 * np.random.default_rng(1).random(12)), 3)
SPEEDS = np.round(30 * np.cos(NIGHTS / 9), 2)


def test_plain_names_below_comments_are_the_header_though_rows_hold_words(tmp_path):
    comments = ["# Retrieved from https://made.up/data", "# L = Lick", "# JD-0 RV sigma Telescope"]
    own = rows(NIGHTS, SPEEDS, [1.5] * 12, ["L", "K"] * 6, mark=" ")
    data = load_dataset(written(tmp_path, [*comments, "JD   RV   e_RV Observatory", *own]))
    assert data.is_of_sight
    assert [scene.name for scene in data.scenes] == ["L", "K"]  # each has a zero of its own
    assert not any("decimal years" in note for note in data.notes)


def test_julian_dates_with_numbers_of_years_are_told(tmp_path):
    years = np.round(1998.9 + (NIGHTS - NIGHTS[0]) / 9, 5)
    path = written(tmp_path, ["JD,RV,e_RV", *rows(years, SPEEDS, [1.5] * 12)])
    (told,) = [note for note in load_dataset(path).notes if "decimal years" in note]
    assert told.startswith("check:") and 'units={"t": "yr"}' in told
    assert not any("decimal years" in n for n in load_dataset(path, units={"t": "yr"}).notes)


def test_markers_that_qualisys_lost_are_gaps_and_not_at_the_origin(tmp_path):
    head = ["NO_OF_FRAMES\t9", "NO_OF_MARKERS\t2", "FREQUENCY\t10", "MARKER_NAMES\tone\ttwo"]
    body = [f"{190 + k}.5\t457.9\t0.000\t" + ("0.000\t0.000\t0.000" if k < 3 else f"{k}.1\t5\t4")
            for k in range(9)]  # fmt: skip
    data = load_dataset(written(tmp_path, [*head, *body], "q.tsv"))
    places = data.scenes[0].positions
    assert np.isnan(places[:3, 1]).all() and not np.isnan(places[3:, 1]).any()
    assert not np.isnan(places[:, 0]).any()
    assert any("gaps: two (3)" in note for note in data.notes)


def machine_readable(body):
    return [
        "Title: A Made-up Survey and", "       its Velocities", "Authors: Nobody N.", "=" * 80,
        "Byte-by-byte Description of file: made_up.txt", "-" * 80,
        "   Bytes Format Units   Label  Explanations", "-" * 80,
        "   1-  5 A5     ---     Name   Name of the star",
        "   7- 18 F12.4  d       BJD    Barycentric Julian Date",
        "  20- 26 F7.2   km/s    RVel   ?=-999.99 Radial velocity",
        "  28- 31 F4.2   km/s  e_RVel   Uncertainty in RVel",
        "      33 A1     ---     Source Telescope (1)",
        "  35- 38 F4.1   ---     SVal   ? Emission", "-" * 80, "Note (1):", "    a = one;",
        "    b = two.", "-" * 80, *body,
    ]  # fmt: skip


def test_bytes_of_machine_readable_tables_tell_columns_and_units(tmp_path):
    body = [f"   17 {t:12.4f} {v:7.2f} 0.03 {'ab'[k // 6]} {'' if k % 2 else '0.2'}"
            for k, (t, v) in enumerate(zip(NIGHTS, SPEEDS, strict=True))]  # fmt: skip
    body[3] = body[3].replace(f"{SPEEDS[3]:7.2f}", "-999.99")
    body[0] = body[0].lstrip()  # as an editor leaves it
    data = load_dataset(written(tmp_path, machine_readable(body), "t_mrt.txt"))
    assert data.is_of_sight and [s.name for s in data.scenes] == ["a", "b"]
    assert data.scenes[0].times / 86400 == pytest.approx(NIGHTS[[0, 1, 2, 4, 5]], rel=1e-12)
    assert "km/s" in data.units.declared.values()
    assert data.scenes[0].positions[:, 0, 0] == pytest.approx(SPEEDS[[0, 1, 2, 4, 5]])
    assert data.scenes[1].sigma[0, 0, 0] == pytest.approx(0.03)
    assert any("lost blanks at their beginning: 20" in note for note in data.notes)
    body[5] = body[5].replace(" 0.03", "0.03")
    with pytest.raises(DataError, match="words of line 25 cross the columns"):
        load_dataset(written(tmp_path, machine_readable(body), "t_mrt.txt"))


DAYS = 2462240.5 + np.arange(40) / 24


def test_vectors_that_astroquery_sends_are_in_au_and_days(tmp_path):
    """A swing past the Earth on a circle of half a turn a day."""
    turn = np.pi * (DAYS - DAYS[0])
    x, y = 1e-3 * np.cos(turn), 1e-3 * np.sin(turn)
    names = ",targetname,datetime_jd,datetime_str,H,G,x,y,z,vx,vy,vz,lighttime,range,range_rate"
    texts = ["9 Made Up"] * 40, map(repr, DAYS.tolist()), ["A.D. 2029-Apr-14"] * 40
    moved = x, y, 0 * x, -np.pi * y, np.pi * x, 0 * x
    body = rows(range(40), *texts, [19.7] * 40, [0.25] * 40, *moved, x, x, x)
    data = load_dataset(written(tmp_path, [names, *body]))
    assert data.scenes[0].names == ("9 Made Up",)
    assert (data.units.declared["x"], data.units.declared["t"]) == ("au", "day")
    assert any("headings are those of astroquery" in note for note in data.notes)
    assert any("does not say from which body" in note for note in data.notes)


@pytest.mark.parametrize("has_distance", [True, False])
def test_ephemerides_that_astroquery_sends_are_places_on_the_sky(tmp_path, has_distance):
    names = "targetname,datetime_str,datetime_jd,H,RA,DEC,sat_X,sat_Y,Longitude,Latitude"
    ra, dec = 181 - np.arange(40) / 99, -10.9 + np.arange(40) ** 2 / 9999
    body = [["9 Made Up"] * 40, ["2029-Apr-14 00:00"] * 40, np.round(DAYS, 3), [19.7] * 40, ra, dec,
            1e5 + 9 * np.arange(40), 1e4 - 7 * np.arange(40), 11 + ra, dec]  # fmt: skip
    more = [0.001 + np.arange(40) / 1e6] if has_distance else []
    header = names + ",delta" * has_distance
    data = load_dataset(written(tmp_path, [header, *rows(*body, *more)]))
    assert data.scenes[0].names == ("9 Made Up",)
    assert data.units.declared["length"] == ("au" if has_distance else "arcsec")
    assert np.diff(data.scenes[0].times) == pytest.approx(3600, rel=1e-3)


def test_numbered_names_that_excel_puts_above_what_it_loads_name_nothing(tmp_path):
    names = "JDTDB, Calendar Date (TDB), X, Y, Z, VX, VY, VZ,"
    body = [f"{2460000 + k}.0, A.D. 2023-Feb-24 12:00, {1 - k / 99}, {k / 9}, 0.1, 0, 0, 0,"
            for k in range(9)]  # fmt: skip
    whole = ["*" * 70, "Target body name: Made Up (9)   {source: JPL#80}", "*" * 70, names,
             "*" * 70, "$$SOE", *body, "$$EOE"]  # fmt: skip
    first = ",".join(f"Column{k}" for k in range(1, 9))
    plain = ["t,x,y,A,B,C,D,E", *rows(*[range(9)] * 8)]
    for lines, name in ((whole, "Made Up"), (plain, "object")):
        path = written(tmp_path, [first, *lines])
        data = load_dataset(path)
        assert data.scenes[0].names == (name,)
        assert any("of a spreadsheet" in note for note in data.notes)
    numbers = written(tmp_path, [first, *plain[1:]])
    assert len(load_dataset(numbers, columns={"t": "Column1", "x": "Column2"}).scenes[0].times) == 9


def test_equal_neighbours_at_turning_points_are_no_held_readings(tmp_path):
    t = np.arange(1500) / 5
    x = np.round(100 * np.exp(-t / 300) * np.cos(2 * np.pi * t / 1.633)).astype(int)
    data = load_dataset(written(tmp_path, ["t (s),x (px)", *rows(t, x)]))
    assert len(data.scenes[0].times) == 1500
    x[1::2] = x[::2]  # a logger that is faster than its sensor
    data = load_dataset(written(tmp_path, ["t (s),x (px)", *rows(t, x)]))
    assert len(data.scenes[0].times) < 900


@pytest.mark.parametrize("form", ["sexagesimal", "degrees", "in space"])
def test_places_on_the_sky_are_as_sure_as_their_last_digits(tmp_path, form):
    k = np.arange(120)
    ra = 57 * 60 + 39.98 - 0.0163 * k + 2e-6 * k**2  # seconds of time beyond 20 h
    dec = 41 * 60 + 49.3 - 0.093 * k  # arcseconds
    if form == "sexagesimal":
        own = [[f"20 {s // 60:02.0f} {s % 60:05.2f}" for s in ra],
               [f"-00 {s // 60:02.0f} {s % 60:04.1f}" for s in dec]]  # fmt: skip
        least = np.array([0.15, 0.1]) / np.sqrt(12)
    else:
        own = [np.round(15 * (20 + ra / 3600), 5), np.round(-dec / 3600, 5)]
        least = np.array([0.036, 0.036]) / np.sqrt(12)
    header = "t (day),ra,dec" + ",distance (au)" * (form == "in space")
    body = rows(NIGHTS[0] + k / 1440, *own, *[1 + np.sqrt(k) / 7] * (form == "in space"))
    data = load_dataset(written(tmp_path, [header, *body]))
    sigma = np.array(estimate_noise(data).sigma)
    if form == "in space":
        far = 149597870700 * np.sqrt(np.mean((1 + np.sqrt(k) / 7) ** 2))
        assert 0.99 < sigma[2] / (np.radians(1e-5) / np.sqrt(12) * far) < 2
        return
    assert ((0.99 * least < sigma) & (sigma < 2 * least)).all()
    far = load_dataset(written(tmp_path, [header, *body]), sky={"distance": "2 pc"})
    assert np.array(estimate_noise(far).sigma) == pytest.approx(2 * sigma * 149597870700)
    both = load_dataset([written(tmp_path, [header, *body], f"{n}.csv") for n in "ab"])
    assert both.steps == data.steps != (0, 0)


@pytest.mark.parametrize(
    "count, told",
    [
        (3, "t=1 rv=2 srv=3 of velocities along the line of sight, or --columns t=1 x=2 sx=3"),
        (5, "t=1 x=2 sx=3 y=4 sy=5, or --columns t=1 rv=2 srv=3 of"),
    ],
)
def test_years_beside_errors_without_names_are_told_as_such(tmp_path, count, told):
    years = np.round(1995.439 + (NIGHTS - NIGHTS[0]) / 6, 3)
    columns = [years, SPEEDS, [1.5] * 12, SPEEDS, [1.5] * 12][:count]
    path = written(tmp_path, rows(*columns, ["Keck"] * 12, mark=" "), "s2.dat")
    with pytest.raises(DataError) as caught:
        load_dataset(path)
    assert told in caught.value.remedy and "--units t=yr" in caught.value.remedy
    lines = rows(NIGHTS - 2400000.5, *columns[1:], ["Keck"] * 12, mark=" ")
    days = written(tmp_path, lines, "mjd.dat")
    with pytest.raises(DataError) as caught:
        load_dataset(days)
    assert told in caught.value.remedy and "--units" not in caught.value.remedy
    named = {"t": "1", "rv": "2", "srv": "3"}
    data = load_dataset(path, columns=named, units={"t": "yr"})
    assert data.is_of_sight and len(data.scenes[0].times) == 12


def test_four_columns_beside_a_clock_may_be_two_bodies(tmp_path):
    wave = np.round(np.sin(np.arange(12)), 3)
    path = written(tmp_path, rows(np.arange(12) / 100, wave, -wave, 3 * wave, 2 * wave))
    with pytest.raises(DataError) as caught:
        load_dataset(path)
    assert "side by side a_x=2 a_y=3 b_x=4 b_y=5" in caught.value.remedy


def test_exponents_that_a_spreadsheet_has_made_are_told(tmp_path, capfd):
    """3.53E-2 became 3,53E+07, and times that are the same for many rows; some cells stayed."""
    t = np.repeat(np.arange(1, 41), 60) / 100
    texts = [f"{1e9 * v:.2E}".replace(".", ",") for v in t]
    shown = [f"{9.81e9 + 1e7 * (k % 7):.3E}".replace(".", ",") for k in range(len(t))]
    shown[60] = "0.000000000E0"
    header = "Time (s); Acceleration x (m/s^2)"
    path = written(tmp_path, [header, *rows(texts, shown, mark=";")])
    with pytest.raises(DataError, match="which no sensor shows") as caught:
        load_dataset(path)
    assert "3.5E-02" in caught.value.remedy and caught.value.column == "Acceleration x (m/s^2)"
    assert "DLASCL" not in "".join(capfd.readouterr())


def test_one_column_below_settings_is_proposed_as_such(tmp_path):
    numbers = [f"{90 * np.cos(k / 9):.2f}" for k in range(90)]
    path = written(tmp_path, ["start_deg, sample_rate, duration", "90, 100, 5", *numbers], "s.txt")
    with pytest.raises(DataError, match="row has 1 cells") as caught:
        load_dataset(path)
    assert "--columns x=1 --fps 25" in caught.value.remedy
    assert len(load_dataset(path, columns={"x": "1"}, fps=100).scenes[0].times) == 90


def test_a_clock_that_waits_every_tenth_row_has_no_gaps(tmp_path):
    waits = np.where(np.arange(400) % 10 == 7, 12, 2)
    waits[200] = 5000
    t = np.cumsum(waits) / 1000
    path = written(tmp_path, ["t (s),v (m/s)", *rows(np.round(t, 3), np.round(np.sin(t), 4))])
    data = load_dataset(path)
    assert [len(scene.times) for scene in data.scenes] == [201, 201]


def test_what_cannot_be_an_input_is_not_proposed_as_one(tmp_path):
    wave = np.round(np.sin(np.arange(30) / 3), 4)
    for names, is_told in (("t,x,y,tau1", True), ("t,pos1,pos2,tau1", False)):
        body = rows(np.arange(30) / 10, wave, -wave, 2 * wave)
        data = load_dataset(written(tmp_path, [names, *body]))
        assert any("may drive the motion" in note for note in data.notes) == is_told


@pytest.mark.parametrize(
    "names, bodies",
    [
        ("theta,theta_dot", ("theta",)),
        ("theta,thetadot", ("theta",)),
        ("theta_noisy,theta,theta_dot", ("theta",)),
        ("phi,phi_ddot", ("phi",)),
        ("x,x_dot", ("object",)),
        ("theta1,theta2,theta1_dot,theta2_dot", ("theta1", "theta2")),
    ],
)
def test_what_is_named_after_the_dots_of_newton_is_a_rate(tmp_path, names, bodies):
    wave = [np.round(np.sin(np.arange(40) / 5 + k), 4) for k in range(names.count(",") + 1)]
    path = written(tmp_path, [f"t,{names}", *rows(np.arange(40) / 10, *wave)])
    units = {name: "rad" for name in names.split(",") if name[0] != "x" and "_" not in name}
    assert len(load_dataset(path, units=units).scenes[0].names) == len(bodies)


def test_degrees_printed_as_radians_are_no_held_readings(tmp_path):
    times = np.arange(600) / 40
    angle = np.radians(np.round(25 * np.exp(-times / 20) * np.cos(3.1 * times + 0.3)))
    file = tmp_path / "swing.csv"
    rows = [f"{t:.3f},{a:.3f}" for t, a in zip(times, angle, strict=True)]
    file.write_text("\n".join(["t (s),theta (rad)", *rows]) + "\n", encoding="utf-8")
    data = load_dataset(file)
    assert sum(len(scene.times) for scene in data.scenes) == 600
    assert not any("hold the place" in note for note in data.notes)
