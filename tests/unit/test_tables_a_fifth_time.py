"""Layouts of files that strangers have published: lines made up after them, a fifth time."""

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.cli import main
from bsp_gp.data.logged import asked_of
from bsp_gp.errors import DataError, on_command_line
from bsp_gp.fitting.restricted import Restricted
from tests.text_tables import rows, written

TURN = 2 * np.pi * np.arange(1, 513) / 256
NIGHTS = 8600 + np.cumsum(np.tile([1, 0.04, 5.3], 12))
SPEEDS = np.round(3 * np.sin(NIGHTS), 3)


def refused(tmp_path, lines, **said):
    """What is said of a table that is not read, as on the command line."""
    with on_command_line(), pytest.raises(DataError) as caught:
        load_dataset(written(tmp_path, lines), **said)
    return str(caught.value)


def test_what_is_said_of_a_column_holds_for_all_of_its_rows(tmp_path):
    circle = rows(np.round(np.cos(TURN), 6), np.round(np.sin(TURN), 6))
    told = refused(tmp_path, circle)
    assert "--columns x=1 y=2 --fps 25" in told and "increases" not in told
    n = np.arange(200)
    far = rows(np.round(-0.4 - n / 190, 6), np.round(-2 + n / 700 + n**2 / 1e6, 6),
               np.round(0.2 - n / 13000, 6))  # fmt: skip
    assert "--columns x=1 y=2 z=3 --fps 25" in refused(tmp_path, far)
    assert load_dataset(written(tmp_path, far), columns=dict(zip("xyz", "123", strict=True)),
                        dt=3600).scenes[0].n_dims == 3  # fmt: skip
    uneven = 0.025 * n + 0.003 * np.sin(7 * n)  # a clock, beside what swings
    swing = rows(np.round(np.cos(n / 9), 4), np.round(uneven, 4), np.round(np.sin(n / 9), 4))
    assert "t=2 x=1 (column 2 increases from row to row;" in refused(tmp_path, swing)
    anew = rows(np.round(np.cos(n / 9), 4), np.round((n % 100) * 0.1, 1), np.round(np.sin(n), 4))
    assert "from row to row, but for 1 where it falls back" in refused(tmp_path, anew)


def test_parts_of_dates_and_angles_in_columns_of_their_own_are_no_clocks(tmp_path):
    minutes = (25 + 2.3 * np.arange(40)) % 60
    told = refused(tmp_path, [f"Mar,{13 + k // 24},{k % 24:02d}:00:00.0,5,{m:.0f},{k}.5,+,23,4"
                              for k, m in enumerate(minutes)])  # fmt: skip
    assert "write what stands in several columns into one" in told and "t=" not in told
    lines = [f"12:00:{k:02d},{k % 4},{k % 7}" for k in range(20)]
    assert "column 1 has times of a day: a header" in refused(tmp_path, lines)
    (scene,) = load_dataset(written(tmp_path, ["t,x,y", *lines])).scenes
    assert np.diff(scene.times) == pytest.approx(np.ones(19))


@pytest.mark.parametrize("end", ["", ","])
def test_rows_of_horizons_without_their_names_are_known(tmp_path, end):
    when = 2458940.5 + 30 * np.arange(24)
    at = [0.0172 * (t - when[0]) for t in when]
    lines = [
        f"{t:.9f}, A.D. 20{20 + k // 12}-{'Apr' if k % 2 else 'May'}-01 00:00:00.0000, "
        f"{69.18567 - k / 1e5:.6f}, {np.cos(p):.9E}, {np.sin(p):.9E}, {p / 100:.9E}, 1.0E-02{end}"
        for k, (t, p) in enumerate(zip(when, at, strict=True))
    ]
    told = refused(tmp_path, lines)
    assert "--columns t=1 x=4 y=5 z=6" in told and "rv=" not in told
    names = {"t": "1", "x": "4", "y": "5", "z": "6"}
    read = load_dataset(written(tmp_path, lines), columns=names)
    assert read.scenes[0].positions[0, 0] == pytest.approx([1, 0, 0])


def test_elements_of_horizons_are_said_by_name(tmp_path):
    lines = ["*" * 30, "Target body name: Pallas   {source: x}", "JDTDB", " EC    QR   IN",
             "*" * 30, "$$SOE", "2458515.500000000 = A.D. 2019-Feb-01 00:00:00.0000 TDB",
             " EC= 2.2798E-01 QR= 2.1370E+00 IN= 3.4844E+01", "$$EOE"]  # fmt: skip
    assert "osculating elements" in refused(tmp_path, lines)


def test_names_beside_velocities_are_instruments_with_a_zero_each(tmp_path):
    names = np.where(np.arange(len(NIGHTS)) % 3 == 0, "HIRES", "HARPS")
    zeros = np.where(names == "HIRES", 0.0, 20.7)
    lines = rows(NIGHTS.round(3), (SPEEDS + zeros).round(3), [0.002] * len(NIGHTS), names, mark=" ")
    assert "instrument=4 where column 4 (HIRES, HARPS) names" in refused(tmp_path, lines)
    named = {"t": "1", "rv": "2", "srv": "3"}
    with on_command_line():
        plain = load_dataset(written(tmp_path, lines), columns=named)
    assert any("check: column '4' has HIRES, HARPS" in note for note in plain.notes)
    for word in ("instrument", "tel"):
        data = load_dataset(written(tmp_path, lines), columns={**named, word: "4"})
        assert sorted(scene.name for scene in data.scenes) == ["HARPS", "HIRES"]
        assert any("each has a zero of its own" in note for note in data.notes)
    others = ["t,x,q", *rows(range(12), range(12), ["a", "b"] * 6)]  # of places as well
    data = load_dataset(written(tmp_path, others), columns={"instrument": "q"})
    assert [scene.name for scene in data.scenes] == ["a", "b"]
    even = rows(8000 + 31 * np.arange(30), SPEEDS[:30], [0.002] * 30, ["S"] * 30, mark=" ")
    assert "t=1 rv=2 srv=3 of velocities along the line of sight" in refused(tmp_path, even)


def test_one_number_above_zero_in_a_third_column_is_the_error_of_the_second(tmp_path):
    t = np.cumsum(np.tile([1.15, 2.3], 10)).round(3)
    v = (3 * np.sin(3 * t)).round(3)
    data = load_dataset(written(tmp_path, rows(t, v, [0.5] * 20)))
    assert data.scenes[0].sigma[:, 0, 0] == pytest.approx(np.full(20, 0.5))
    assert any("column 3 is 0.5 in every row" in note for note in data.notes)
    smooth = (t / 10).round(4)  # beside a steady motion it would be no error but a place
    plain = load_dataset(written(tmp_path, rows(t, smooth, [0.5] * 20)))
    assert plain.scenes[0].sigma is None
    assert plain.scenes[0].positions[:, 0, 1] == pytest.approx(np.full(20, 0.5))


def test_a_delimiter_at_the_end_of_rows_is_no_cell(tmp_path):
    t = np.arange(20) / 25
    head = "t,x,y"
    data = load_dataset(written(tmp_path, [head, *(line + "," for line in rows(t, t, t * t))]))
    assert data.scenes[0].positions[:, 0] == pytest.approx(np.stack([t, t * t], axis=1))
    assert any("nothing behind it: 20" in note for note in data.notes)
    some = [line + "," * (k % 3 == 0) for k, line in enumerate(rows(t, t, t * t))]
    assert len(load_dataset(written(tmp_path, [head, *some])).scenes[0].times) == 20
    with pytest.raises(DataError, match="this row has 5 cells"):
        load_dataset(written(tmp_path, [head, *(line + ",7" for line in some)]))


def test_rows_may_lack_a_cell_that_the_header_and_others_have(tmp_path):
    t = np.arange(20) / 25
    lines = [f"{s}\t{s / 2}\t{s * s}\t1\t" + "2\t3" * (k > 9) for k, s in enumerate(t)]
    lines = [line.rstrip("\t") for line in lines]
    data = load_dataset(written(tmp_path, ["\tmass A\t\t\t", "t\tx\ty\tr\tv\t", *lines], "a.txt"))
    assert data.scenes[0].positions[:, 0, 0] == pytest.approx(t / 2)
    assert any("lack cells at their ends, which are not used: 10" in n for n in data.notes)


def test_bodies_by_letters_need_a_rate_and_are_read_with_it(tmp_path):
    n = np.arange(30)
    lines = ["xA;yA;zA;xB;yB;zB", *rows(n, n**2, 0 * n, -n, n, n / 2, mark=";")]
    assert "--fps 25 says how many are in a second, or --dt" in refused(tmp_path, lines)
    (scene,) = load_dataset(written(tmp_path, lines), dt=0.002).scenes
    assert scene.names == ("A", "B") and scene.times[1] == pytest.approx(0.002)
    assert scene.positions[3, 1] == pytest.approx([-3, 3, 1.5])


def test_a_heading_that_is_a_unit_of_angles_is_the_angle_with_the_error_of_y(tmp_path):
    t = np.arange(40) / 15
    swing = np.round(0.2 * np.cos(5 * t), 4)
    lines = ["t\trad\txerr\tyerr", *rows(t.round(3), swing, [0.005] * 40, [0.009] * 40, mark="\t")]
    data = load_dataset(written(tmp_path, lines))
    assert data.units.is_angle
    assert data.scenes[0].positions[:, 0, 0] == pytest.approx(swing)
    assert data.scenes[0].sigma[:, 0, 0] == pytest.approx(np.full(40, 0.009))


def test_a_column_of_texts_is_proposed_as_no_clock(tmp_path):
    lines = ["x,y,metric", *rows(range(20), range(20), ["Speed", "Way"] * 10)]
    told = refused(tmp_path, lines)
    assert "--columns scene=metric" in told and "t=metric" not in told


def test_measures_of_several_pairs_are_asked_for(tmp_path):
    lines = ["Identifier,Tobs,PAObs,SepObs,PAErr,SepErr"]
    lines += [f"{star},{2008 + k},{50 + 2 * k},{sep},1.1,0.1," for star, sep in
              (("STF 1", 4.7), ("STF 2", 3.1)) for k in range(5)]  # fmt: skip
    one = load_dataset(written(tmp_path, [line.removeprefix("STF 1,") for line in
                                          ["Tobs,PAObs,SepObs,PAErr,SepErr", *lines[1:6]]]))
    assert one.scenes[0].names == ("companion", "primary")
    data = load_dataset(written(tmp_path, lines), columns={"scene": "Identifier"})
    assert [scene.names for scene in data.scenes] == [("companion", "primary")] * 2
    twice = [lines[0], *(line for pair in zip(lines[1:6], lines[6:], strict=True) for line in pair)]
    assert "scene=COLUMN" in refused(tmp_path, twice)


def test_a_clock_whose_digits_are_missing_is_told(tmp_path):
    n = np.arange(200)
    t = n // 9 + (n > 150)  # no even clock fits
    told = refused(tmp_path, ["t (s),x (m)", *rows(t, np.round(np.sin(n / 20), 3))])
    assert "digits are missing from the clock" in told


def test_places_of_miriade_count_from_the_sun(tmp_path):
    lines = [
        "# Miriade.ephemcc.results", "# Request:", "# targetType: Planet, targetName: Mars, "
        "Coordinates: Ecliptic rectangular, frameCentre: Heliocenter", "# Nb rows: 9",
        "Target, Date, X (au), Y (au), Z (au), Xp (au/day), Observer distance (au)",
    ]  # fmt: skip
    rows_of = [f"Mars, 2018-01-{1 + k:02d}T00:00:00.00, {k / 9}, {k * k / 90}, 0.1, 0.2, 1"
               for k in range(9)]  # fmt: skip
    data = load_dataset(written(tmp_path, [*lines, *rows_of]))
    assert data.scenes[0].names == ("Mars", "Sun")
    assert not data.scenes[0].positions[:, 1].any()
    lines[2] = lines[2].replace("Heliocenter", "Geocenter")
    assert len(load_dataset(written(tmp_path, [*lines, *rows_of])).scenes[0].names) == 1


@pytest.mark.parametrize("heading", ["Pikavauhti (m/s)", "pikavauhti"])
def test_the_velocity_of_the_body_itself_is_no_input_in_any_language(tmp_path, heading):
    rng, t = np.random.default_rng(3), np.arange(60) / 50
    fall, speed = 4.9 * t**2 + rng.normal(0, 2e-4, 60), 9.8 * t + rng.normal(0, 0.1, 60)
    wind = 2 + np.sin(7 * t)
    head = f"t (s),x (m),{heading},tuuli (m/s)"
    lines = [head, *rows(t, fall.round(5), speed.round(3), wind.round(3))]
    data = load_dataset(written(tmp_path, lines), columns={"x": "x (m)"})
    names = {heading for heading, _ in asked_of(data).logged.values()}
    assert names == {"tuuli"}


def test_a_fit_without_noise_says_of_which_file_and_what_to_do(tmp_path, monkeypatch, capsys):
    t = np.arange(40) / 25
    path = written(tmp_path, ["t (s),x (m),y (m)", *rows(t, t.round(3), (t * t).round(3))])
    monkeypatch.setattr(Restricted, "_eliminate", lambda self, whitener: None)
    monkeypatch.chdir(tmp_path)
    assert main(["close", str(path), "--declare", "nothing", "--quiet", "--bootstrap", "0"]) == 2
    error = capsys.readouterr().err
    assert str(path) in error and "cannot be separated" in error and "bsp-gp check" in error
