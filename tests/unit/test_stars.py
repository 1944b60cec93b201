"""Measures of double stars: separation and position angle, dates, errors, the primary."""

import numpy as np
import pytest

from bsp_gp.cli import main
from bsp_gp.data.polar_words import date_unit, error_of, is_far, is_position_angle
from bsp_gp.data.tables import dataset_from_frames, load_dataset, save_dataset
from bsp_gp.errors import DataError, on_command_line

YEAR = 365.25 * 86400
T = 1950.25 + 1.5 * np.arange(12)
RHO = 1.2 + 0.3 * np.cos(0.4 * np.arange(12))
PA = (300 + 11 * np.arange(12.0)) % 360
EAST, NORTH = RHO * np.sin(np.radians(PA)), RHO * np.cos(np.radians(PA))
ACROSS = RHO * np.radians(0.5)


def _table(header, row, sep=","):
    """Text of a table whose rows are made of (date, separation, position angle)."""
    lines = [row(*values) for values in zip(T, RHO, PA, strict=True)]
    return "\n".join([header, *lines]).replace("|", sep) + "\n"


def _iso(year):
    days = round((year - 1950) * 365.25)
    return str(np.datetime64("1950-01-01") + np.timedelta64(days, "D"))


WRITTEN = {
    "an observer": _table(
        "date,separation (arcsec),PA (deg)", lambda t, r, a: f"{t:.2f},{r:.9f},{a:.9f}"
    ),
    "catalogue of measures": _table(
        "    Epoch     PA      SEP", lambda t, r, a: f"  {t:.2f}  {a:.9f}  {r:.9f}"
    ),
    "ephemerides of the catalogue of orbits": _table(
        "#  date   theta  rho", lambda t, r, a: f"{t:.3f} {a:.9f} {r:.9f}"
    ),
    "speckle, anonymous errors": _table(
        "Date,P.A.,Error,Sep.,Error", lambda t, r, a: f"{t:.4f},{a:.9f},0.5,{r:.9f},0.01"
    ),
    "a machine-readable table": _table(
        "Ep|PA|e_PA|rho|e_rho\nyr|deg|deg|arcsec|arcsec\n----|---|----|---|-----",
        lambda t, r, a: f"{t:.2f}|{a:.9f}|0.5|{r:.9f}|0.010", "\t",
    ),
    "orbits by MCMC": _table(
        "epoch,object,sep (mas),sep_err (mas),pa (deg),pa_err (deg)",
        lambda t, r, a: f"{51544.5 + 365.25 * (t - 2000):.6f},b,{1e3 * r:.7f},10,{a:.9f},0.5",
    ),
    "orbits by MCMC, in arcseconds": _table(
        "# Date Sep Err_sep PA Err_PA", lambda t, r, a: f"{t:.2f} {r:.9f} 0.01 {a:.9f} 0.5"
    ),
    "Greek letters": _table(
        '"Obs. date","ρ ("")","σρ (mas)","θ (°)","σθ (°)"',
        lambda t, r, a: f"{t:.2f},{r:.9f},10,{a:.9f},0.5",
    ),
    "German": _table(
        'Jahr;Positionswinkel (°);Abstand (″);Beobachter',
        lambda t, r, a: f"{t:.2f};{a:.9f};{r:.9f};Str".replace(".", ","),
    ),
}  # fmt: skip
QUOTED = {"speckle, anonymous errors", "a machine-readable table", "orbits by MCMC",
          "orbits by MCMC, in arcseconds", "Greek letters"}  # fmt: skip


def _loaded(tmp_path, text, **options):
    path = tmp_path / "star.csv"
    path.write_text(text, encoding="utf-8")
    with on_command_line():
        return load_dataset(path, **options)


@pytest.mark.parametrize("name", WRITTEN)
def test_measures_are_read_as_they_are_written(tmp_path, name):
    data = _loaded(tmp_path, WRITTEN[name])
    (scene,) = data.scenes
    assert scene.names == ("b" if "object" in WRITTEN[name] else "companion", "primary")
    assert [e.is_static for e in scene.entities] == [False, True]
    assert data.units.symbols["m"] == "arcsec"
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([EAST, NORTH], 1), atol=1e-8)
    np.testing.assert_array_equal(scene.positions[:, 1], 0)
    since = T - 2000 + 51544.5 / 365.25 if "object" in WRITTEN[name] else T
    np.testing.assert_allclose(scene.times, since * YEAR, rtol=1e-9)
    if name in QUOTED:
        sine, cosine = np.sin(np.radians(PA)), np.cos(np.radians(PA))
        np.testing.assert_allclose(scene.sigma[:, 0, 0], np.hypot(0.01 * sine, ACROSS * cosine))
        np.testing.assert_allclose(scene.sigma[:, 0, 1], np.hypot(0.01 * cosine, ACROSS * sine))
    else:
        assert scene.sigma is None
    told = " ".join(data.notes)
    assert "north through east" in told and "added as 'primary'" in told
    if name != "a machine-readable table":
        assert "has no unit: its numbers were read as" in told


def test_iso_dates_and_besselian_years(tmp_path):
    text = _table("Date,rho (mas),theta (deg)", lambda t, r, a: f"{_iso(t)},{1e3 * r:.6f},{a:.6f}")
    (scene,) = _loaded(tmp_path, text).scenes
    np.testing.assert_allclose(scene.times, (T - T[0]) * YEAR, atol=86400)
    text = _table('Besselian year,rho ("),theta (deg)', lambda t, r, a: f"{t:.2f},{r:.6f},{a:.6f}")
    data = _loaded(tmp_path, text)
    # B1950.0 is JD 2433282.42346.
    julian = 2000 + (2433282.42346 + 365.242198781 * (T - 1950) - 2451545) / 365.25
    np.testing.assert_allclose(data.scenes[0].times, julian * YEAR, rtol=1e-11)
    assert any("Besselian" in note and "Julian" in note for note in data.notes)


def test_an_option_says_that_it_is_none_or_that_it_is(tmp_path):
    text = WRITTEN["an observer"]
    columns = {"distance": "separation (arcsec)", "angle": "PA (deg)"}
    (scene,) = _loaded(tmp_path, text, columns=columns).scenes
    assert scene.names == ("object",)
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([NORTH, EAST], 1), atol=1e-8)
    text = text.replace("separation (arcsec),PA (deg)", "r (m),phi (deg)")
    (scene,) = _loaded(tmp_path, text, units={"time": "s"}).scenes
    assert scene.names == ("object",)
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([NORTH, EAST], 1), atol=1e-8)
    columns = {"separation": "r (m)", "position_angle": "phi (deg)"}
    (scene,) = _loaded(tmp_path, text, columns=columns, units={"time": "s"}).scenes
    assert scene.names == ("companion", "primary")
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([EAST, NORTH], 1), atol=1e-8)


def test_units_may_be_declared_under_any_of_the_names(tmp_path):
    text = WRITTEN["ephemerides of the catalogue of orbits"]
    for units in ({"rho": "mas", "theta": "deg"}, {"separation": "mas", "position_angle": "deg"}):
        data = _loaded(tmp_path, text, units={**units, "time": "yr"})
        np.testing.assert_allclose(data.scenes[0].positions[:, 0, 0], 1e-3 * EAST, atol=1e-8)
        assert not any("no unit is given" in note for note in data.notes)
    assert any("arcsec" in note and "deg" in note for note in _loaded(tmp_path, text).notes)


def test_what_was_not_measured_is_told(tmp_path):
    lines = WRITTEN["a machine-readable table"].replace("\t", " , ").splitlines()
    lines = [line for line in lines if "---" not in line]
    lines[3] = "1951.75 , 311.0 , . , . , ."
    lines[4] = "1953.25 , 322.0 , . , 1.2 , 0.01"
    data = _loaded(tmp_path, "\n".join(lines) + "\n")
    (scene,) = data.scenes
    assert len(scene.times) == 11
    note = "1 row(s) with a separation or a position angle alone are left out (line 4)"
    assert note in data.notes
    assert np.isnan(scene.sigma[1, 0]).all() and np.isfinite(scene.sigma[2, 0]).all()
    text = _table("date,rho (mas),e_rho,PA (deg)", lambda t, r, a: f"{t},{r:.6f},0.1,{a:.6f}")
    data = _loaded(tmp_path, text)
    assert data.scenes[0].sigma is None
    assert any("'e_rho': errors are used where" in note for note in data.notes)
    with pytest.raises(DataError, match="errors of the distance are in 'deg'"):
        _loaded(tmp_path, text.replace("e_rho", "e_rho (deg)").replace("PA (deg)", "e_PA,PA (deg)")
                .replace(",0.1,", ",0.1,0.5,"))  # fmt: skip


def test_of_dates_only_what_leaves_no_doubt_is_guessed(tmp_path):
    header = WRITTEN["an observer"].splitlines()[0]
    late = "\n".join([header, *(f"{k},1.{k},{10 * k}" for k in range(3, 9))]) + "\n"
    with pytest.raises(DataError, match="no unit of time"):
        _loaded(tmp_path, late)
    assert _loaded(tmp_path, late, units={"time": "day"}).scenes[0].times[0] == 3 * 86400


def test_the_primary_in_the_table_of_entities_is_known_and_all_is_written_again(tmp_path):
    folder = tmp_path / "star"
    folder.mkdir()
    text = WRITTEN["orbits by MCMC"].replace("object", "entity")
    (folder / "trajectories.csv").write_text(text)
    (folder / "entities.csv").write_text("entity,mass\nb,0.5\nprimary,1.5\n")
    (folder / "dataset.toml").write_text('[units]\nmass = "Msun"\n')
    data = load_dataset(folder)
    b, primary = data.scenes[0].entities
    assert primary.is_static and primary.mass == pytest.approx(3 * b.mass)
    assert not any("no trajectory" in note for note in data.notes)
    again = load_dataset(save_dataset(data, tmp_path / "again"))
    assert again.scenes[0].names == ("b", "primary") and again.scenes[0].entities[1].is_static
    np.testing.assert_array_equal(again.scenes[0].positions, data.scenes[0].positions)


def test_places_on_the_sky_have_dates_too(tmp_path):
    rows = "\n".join(f"{2000 + k / 4},266.4168{k},-29.0078" for k in range(5))
    data = _loaded(tmp_path, f"year,ra,dec\n{rows}\n")
    assert data.scenes[0].times[1] == pytest.approx(2000.25 * YEAR)
    assert data.scenes[0].names == ("object",)


def test_frames_of_pandas_are_read_alike():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"epoch": T, "rho (arcsec)": RHO, "theta (deg)": PA})
    (scene,) = dataset_from_frames(frame).scenes
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([EAST, NORTH], 1))


@pytest.mark.parametrize(
    ("text", "of"),
    [("e_rho", "distance"), ("sep_err", "distance"), ("σρ", "distance"), ("PAerr", "angle"),
     ("sigma theta", "angle"), ("± PA", "angle"), ("err. P.A.", "angle"), ("rho", None),
     ("error", None), ("mag_err", None), ("O-C theta", None), ("rho_calc", None)],
)  # fmt: skip
def test_errors_by_their_words(text, of):
    assert error_of(text) == of


def test_words():
    assert is_far("Sep.") and is_far("angular separation") and not is_far("observed")
    assert not is_far("rho_calc")
    assert is_position_angle("P.A. (deg)") and not is_position_angle("theta")
    assert date_unit("MJD") == "day" and date_unit("obs.") is None and date_unit("Nights") is None


def test_check_tells_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "star.csv").write_text(WRITTEN["an observer"])
    assert main(["check", "star.csv"]) == 0
    out = capsys.readouterr().out
    for text in (
        "1 scene, 2 bodies, 12 rows", "separation = 'separation (arcsec)'",
        "position_angle = 'PA (deg)'", "Bodies: companion, primary", "were read as decimal years",
        '--columns distance="separation (arcsec)" angle="PA (deg)"',
    ):  # fmt: skip
        assert text in out
    told = ["--columns", "distance=separation (arcsec)", "angle=PA (deg)"]
    assert main(["check", "star.csv", *told]) == 0
    assert "Bodies: object" in capsys.readouterr().out


def _orbit(t, *, half_axis=1.2, period=40.0, eccentricity=0.4, periastron=1947.0):
    """Separation and position angle (degrees) on an orbit in the plane of the sky."""
    mean = 2 * np.pi * (t - periastron) / period
    anomaly = mean.copy()
    for _ in range(60):
        off = anomaly - eccentricity * np.sin(anomaly) - mean
        anomaly -= off / (1 - eccentricity * np.cos(anomaly))
    ratio = np.sqrt((1 + eccentricity) / (1 - eccentricity))
    true = 2 * np.arctan(ratio * np.tan(anomaly / 2))
    return half_axis * (1 - eccentricity * np.cos(anomaly)), np.degrees(true + 1.5) % 360


@pytest.mark.slow
@pytest.mark.parametrize("quoted", ["", ",0.01,0.5"])
def test_the_law_of_an_orbit_is_the_inverse_square_of_the_distance_to_the_primary(
    tmp_path, monkeypatch, capsys, quoted
):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(5)
    t = np.arange(1940, 2000.1, 1.5)
    rho, angle = _orbit(t)
    rho += 0.01 * rng.standard_normal(len(t))
    angle = (angle + 0.5 * rng.standard_normal(len(t))) % 360
    rows = [f"{a:.1f},{b:.4f},{c:.2f}{quoted}" for a, b, c in zip(t, rho, angle, strict=True)]
    header = "date,separation (arcsec),PA (deg)" + (",sep_err,PA_err" if quoted else "")
    (tmp_path / "star.csv").write_text("\n".join([header, *rows]))
    assert main(["fit", "star.csv", "--quiet"]) == 0
    out = capsys.readouterr().out
    assert "pull to primary, as distance⁻²" in out
    strength = float(out.split("Law: F = -")[1].split()[0])
    assert strength == pytest.approx(4 * np.pi**2 * 1.2**3 / 40**2, rel=0.02)


def _mailed(*pairs):
    """Measures as the Washington catalogue mails them: fixed columns, dots for no value, limits."""
    lines = ["USNO Double Star data for WDS 00000+0000", "", "Note: made up.", "-" * 40, "",
             "MEASURES:", ""]  # fmt: skip
    for pair in pairs:
        lines.append(f"{pair}     1950 1966   12 300 060   1.4   1.6 12.06   .   M3       NC")
        for t, r, a in zip(T, RHO, PA, strict=True):
            lines.append(f"       {t:<11}{a:6.2f}   0.5    {r:7.4f}   0.010    7.28  0.07   A")
        lines.append("       2008.9754      .      .    <  0.020   >0.040      .     .    > 2.43")
        lines.append("       2009.5         .      .       1.5       .         .     .       .  ")
    return "\n".join([*lines, "", "-" * 40, "", "NOTES:", "ABC  1   1999. 2. 3. 4."]) + "\n"


def test_measures_are_read_as_the_catalogue_mails_them(tmp_path):
    data = _loaded(tmp_path, _mailed("ABC   1"))
    (scene,) = data.scenes
    assert scene.names == ("companion", "primary") and data.units.symbols["m"] == "arcsec"
    np.testing.assert_allclose(scene.positions[:, 0], np.stack([EAST, NORTH], 1), atol=1e-4)
    assert scene.sigma[0, 0] == pytest.approx(
        np.hypot(0.01 * np.array([EAST, NORTH])[:, 0] / RHO[0],
                 np.radians(0.5) * np.array([NORTH, EAST])[:, 0]), rel=1e-3)  # fmt: skip
    told = " ".join(data.notes)
    assert "limits" in told and "line 21" in told and "alone are left out (line 22)" in told
    assert "Besselian years were put into Julian ones" in told
    scenes = _loaded(tmp_path, _mailed("ABC   1AB", "ABC   1AC")).scenes
    assert [scene.name for scene in scenes] == ["ABC 1AB", "ABC 1AC"]


def _at_once(second, header="t,x,y,sx,sy", rows=(0, 1, 2, 3)):
    lines = [f"{2000 + k},{k},{k},0.1,0.1" for k in rows]
    return "\n".join([header, *lines[:2], second, *lines[2:]]) + "\n"


def test_measures_at_one_time_that_agree_are_their_mean(tmp_path):
    data = _loaded(tmp_path, _at_once("2001,1.2,1.1,0.1,0.2"))
    (scene,) = data.scenes
    assert scene.times.tolist() == [2000, 2001, 2002, 2003]
    assert scene.positions[1, 0] == pytest.approx([1.1, 1.02])
    assert scene.sigma[1, 0] == pytest.approx([0.1 / np.sqrt(2), 0.1 / np.sqrt(1.25)])
    assert any("row(s) are at the time of the row before (line 4)" in n for n in data.notes)


@pytest.mark.parametrize("second", ["2001,2,1.1,0.1,0.2", "2001,1,1,,", "2001,1,1,0.1,0"])
def test_measures_at_one_time_that_disagree_are_refused_with_the_time_of_the_file(tmp_path, second):
    with pytest.raises(DataError, match=r"line 4.*two rows at t = 2001 \(duplicate\)"):
        _loaded(tmp_path, _at_once(second), units={"time": "yr", "length": "arcsec"})


def test_mailed_measures_in_other_columns_are_refused(tmp_path):
    with pytest.raises(DataError, match="line 9 has other columns"):
        _loaded(tmp_path, _mailed("ABC   1").replace("       1950.25    ", " " * 15 + "1950.25"))
