"""Places on the sky: right ascension and declination, angles for lengths, distances."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import DataError
from bsp_gp.units import parse_unit

EAST, NORTH = np.array([0.3, -0.2, 0.5, 0.1]), np.array([-0.1, 0.4, 0.2, -0.3])  # arcsec
AU = parse_unit("au")[0]
RA, DEC = 266.41684, -29.00781


def _folder(path, header, rows, toml):
    path.mkdir()
    table = "\n".join(",".join(map(str, row)) for row in rows)
    (path / "trajectories.csv").write_text(f"{header}\n{table}\n")
    (path / "dataset.toml").write_text(toml)
    return path


def _equatorial():
    dec = DEC + NORTH / 3600
    return RA + EAST / 3600 / np.cos(np.radians(dec)), dec


def _sexagesimal(value):
    size = abs(value)
    minutes = 60 * (size % 1)
    return f"{'-' if value < 0 else ''}{int(size)}:{int(minutes):02d}:{60 * (minutes % 1):09.6f}"


def _rows(ra, dec):
    return [(2000 + k / 4, a, d, 2.0, 3.0) for k, (a, d) in enumerate(zip(ra, dec, strict=True))]


@pytest.mark.parametrize("is_sexagesimal", [False, True])
def test_right_ascension_and_declination_are_offsets_on_the_sky(tmp_path, is_sexagesimal):
    ra, dec = _equatorial()
    if is_sexagesimal:
        ra, dec = [_sexagesimal(a / 15) for a in ra], [_sexagesimal(d) for d in dec]
    header = "epoch,RA,Dec,sRA,sDec"
    data = load_dataset(_folder(tmp_path / "a", header, _rows(ra, dec), '[units]\ntime = "yr"\n'))
    (scene,) = data.scenes
    moved = scene.positions[:, 0] - scene.positions[0, 0]
    assert moved[:, 0] == pytest.approx(EAST - EAST[0], abs=2e-5)
    assert moved[:, 1] == pytest.approx(NORTH - NORTH[0], abs=2e-5)
    assert scene.sigma[0, 0] == pytest.approx([0.002, 0.003])
    assert data.units.symbols["m"] == "arcsec"
    assert any("east and north" in note for note in data.notes)
    assert not any("not used" in note for note in data.notes)
    again = load_dataset(save_dataset(data, tmp_path / "b"))
    assert np.array_equal(again.scenes[0].positions, scene.positions)
    assert again.units.symbols["m"] == "arcsec"


@pytest.mark.parametrize("far", ['distance = "8 kpc"', 'parallax = "0.125 mas"'])
def test_angles_at_a_distance_are_lengths(tmp_path, far):
    ra, dec = _equatorial()
    toml = f'[units]\ntime = "yr"\n[sky]\n{far}\n'
    data = load_dataset(_folder(tmp_path / "a", "t,ra,dec,sra,sdec", _rows(ra, dec), toml))
    (scene,) = data.scenes
    moved = (scene.positions[:, 0] - scene.positions[0, 0]) / AU
    assert moved[:, 0] == pytest.approx(8000 * (EAST - EAST[0]), abs=0.2)
    assert scene.sigma[0, 0] / AU == pytest.approx([16.0, 24.0])
    assert data.units.declared["length"] == "au" and "m" not in data.units.symbols


def test_position_angles_run_from_north_through_east(tmp_path):
    rho, theta = np.hypot(EAST, NORTH), np.degrees(np.arctan2(EAST, NORTH)) % 360
    rows = [(k, r, a, 0.01, 0.5) for k, (r, a) in enumerate(zip(rho, theta, strict=True))]
    toml = '[units]\ntime = "yr"\nlength = "mas"\nangle = "degrees"\n[sky]\ndistance = "10 pc"\n'
    header = "t,separation,position_angle,sseparation,sposition_angle"
    (scene,) = load_dataset(_folder(tmp_path / "a", header, rows, toml)).scenes
    assert scene.positions[:, 0, 0] / AU == pytest.approx(0.01 * EAST)
    assert scene.positions[:, 0, 1] / AU == pytest.approx(0.01 * NORTH)


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ('[sky]\ndistance = "8"', "positive length"),
        ('[sky]\nparallax = "1 kpc"', "positive angle"),
        ('[sky]\ndistance = "8 kpc"\nparallax = "1 mas"', "keep one"),
        ('[sky]\nredshift = "1"', "unknown key 'redshift'"),
    ],
)  # fmt: skip
def test_what_is_no_distance_is_refused(tmp_path, toml, words):
    path = _folder(tmp_path / "a", "t,ra,dec,sra,sdec", _rows(*_equatorial()),
                   f'[units]\ntime = "yr"\n{toml}\n')  # fmt: skip
    with pytest.raises(DataError, match=words):
        load_dataset(path)


def test_a_cell_that_is_no_angle_is_named(tmp_path):
    rows = [(0, "17:45:40", "-29:00:28"), (1, "17:45", "-29:00:28"), (2, "17:45:41", "-29:00:28")]
    path = _folder(tmp_path / "a", "t,ra,dec", rows, '[units]\ntime = "yr"\n')
    with pytest.raises(DataError, match="'17:45' is no angle"):
        load_dataset(path)


def test_how_far_it_is_may_be_said_beside_a_file(tmp_path):
    table = tmp_path / "pair.csv"
    table.write_text("epoch,PA (deg),sep (arcsec)\n2000.5,10,1\n2001.5,20,1\n2002.5,30,1.1\n")
    for sky in ({"distance": "10pc"}, {"parallax": "100 mas"}):
        (scene,) = load_dataset(table, sky=sky).scenes
        assert np.linalg.norm(scene.positions[0, 0]) / AU == pytest.approx(10.0)
    with pytest.raises(DataError, match="distance or parallax, not 'far'"):
        load_dataset(table, sky={"far": "10 pc"})
    with pytest.raises(DataError, match="a number and its unit"):
        load_dataset(table, sky={"distance": "pc"})


def _rising(path, heading, scale, unit=""):
    """A table of a planet in places like those of an almanac, its right ascension so many of h."""
    hours = np.linspace(17.6, 18.0, 30)
    rows = [(k, scale * h, -23.1 - k / 400) for k, h in enumerate(hours)]
    table = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(f"t,{heading},dec\n{table}\n")
    data = load_dataset(path, units={"time": "d", **({"ra": unit} if unit else {})})
    way = np.ptp(data.scenes[0].positions[:, 0, 0]) / 3600
    return way, any("between 0 and 24" in note for note in data.notes)


def test_right_ascensions_within_a_day_may_be_hours_and_that_is_told(tmp_path):
    degrees = 0.4 * np.cos(np.radians(23.1))
    way, is_told = _rising(tmp_path / "a.csv", "ra", 1)
    assert is_told and way == pytest.approx(degrees, rel=0.01)
    for heading in ("ra (h)", "RA_hours", "Right Ascension (hr)", "RA [hours]"):
        way, is_told = _rising(tmp_path / "b.csv", heading, 1)
        assert not is_told and way == pytest.approx(15 * degrees, rel=0.02)
    for heading in ("RA (degrees)", "ra_deg"):
        assert not _rising(tmp_path / "c.csv", heading, 1)[1]
    assert not _rising(tmp_path / "d.csv", "ra", 15)[1]
    for unit, times in (("h", 15), ("deg", 1)):
        way, is_told = _rising(tmp_path / "e.csv", "ra", 1, unit)
        assert not is_told and way == pytest.approx(times * degrees, rel=0.02)
