import sys

import numpy as np
import pytest

from bsp_gp.data.ephemeris import GRAVITATIONAL_CONSTANT, load_ephemeris
from bsp_gp.errors import DataError, MissingDependencyError

J2000 = 2451545.0


@pytest.fixture(scope="module")
def year():
    reason = "jplephem and de421 are not installed (pip install 'bsp_gp[astro]')"
    pytest.importorskip("jplephem", reason=reason)
    pytest.importorskip("de421", reason=reason)
    return load_ephemeris(start_jd=J2000, n_days=365, step_days=0.5)


def test_scene(year):
    assert year.positions.shape == year.velocities.shape == (731, 11, 3)
    assert year.times[:2].tolist() == [0.0, 43200.0]
    assert [year.names[k] for k in year.dynamic] == ["mercury"]


def test_masses(year):
    gm = {e.name: e.mass * GRAVITATIONAL_CONSTANT for e in year.entities}
    assert gm["sun"] == pytest.approx(1.32712440040945e20, rel=1e-12)
    assert gm["earth"] == pytest.approx(3.98600436233e14, rel=1e-10)
    assert gm["moon"] == pytest.approx(4.902800076e12, rel=1e-9)
    assert gm["mercury"] == pytest.approx(2.203209e13, rel=1e-9)


def test_earth_and_moon(year):
    earth, moon = (year.names.index(name) for name in ("earth", "moon"))
    distance = np.linalg.norm(year.positions[:, earth] - year.positions[:, moon], axis=1)
    assert 3.56e8 < distance.min() < distance.max() < 4.07e8


def test_velocities_are_those_of_the_positions(year):
    h = year.times[1]
    difference = central_difference(year.positions, h) - year.velocities[4:-4]
    moon = year.names.index("moon")
    others = [k for k in range(11) if k != moon]
    assert np.abs(difference[:, others]).max() < 1e-4


def central_difference(values, step):
    weights = (1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280)
    n = len(values) - 8
    return sum(w * values[k : k + n] for k, w in enumerate(weights)) / step


def test_newton_leaves_what_relativity_explains(year):
    mercury = year.names.index("mercury")
    observed = central_difference(year.velocities[:, mercury], year.times[1])
    newton = np.zeros_like(observed)
    for k, body in enumerate(year.entities):
        if k != mercury:
            r = year.positions[4:-4, k] - year.positions[4:-4, mercury]
            cube = np.linalg.norm(r, axis=1, keepdims=True) ** 3
            newton += GRAVITATIONAL_CONSTANT * body.mass * r / cube

    def rms(a):
        return np.sqrt((a**2).sum(axis=1).mean())

    assert rms(observed - newton) == pytest.approx(3.57e-9, rel=0.02)
    assert rms(observed - newton) / rms(newton) == pytest.approx(8.5e-8, rel=0.02)


def test_bad_arguments(year):
    settings = {"start_jd": J2000, "n_days": 10, "step_days": 1}
    with pytest.raises(DataError, match="bodies must be a sequence among sun"):
        load_ephemeris(("sun", "vulcan"), **settings)
    with pytest.raises(DataError, match="receivers must be a sequence among sun"):
        load_ephemeris(("sun",), receivers=("mars",), **settings)
    with pytest.raises(DataError, match="covers Julian dates"):
        load_ephemeris(**settings | {"start_jd": 1.0})
    with pytest.raises(DataError, match="must be positive"):
        load_ephemeris(**settings | {"step_days": 0})


def test_without_the_packages(monkeypatch):
    monkeypatch.setitem(sys.modules, "jplephem", None)
    with pytest.raises(MissingDependencyError, match="astro"):
        load_ephemeris(start_jd=J2000, n_days=10, step_days=1)
