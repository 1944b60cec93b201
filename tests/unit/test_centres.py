"""What goes round a body that is seen at rest is asked for gravity before all else."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp import close_loop
from bsp_gp.data.scene import Entity
from bsp_gp.loop.proposers.centres import strength_of
from bsp_gp.report.page import page_of

AU, YEAR = 1.495978707e11, 3.15576e7
SUN = 4 * np.pi**2  # au^3/yr^2


def orbit(eccentricity=0.19, n_rows=110, step=10 / 365.25, planet=9.5e-4 * SUN):
    """Places of an asteroid that Jupiter pulls as well, au."""
    times = step * np.arange(n_rows)
    first = np.array([1 - eccentricity, 0, 0, 0, 0, 0.1])
    first[4] = np.sqrt(SUN * (1 + eccentricity) / (1 - eccentricity))

    def rate(t, y):
        angle = 2 * np.pi * t / 11.86
        jupiter = 5.2 * np.array([np.cos(angle), np.sin(angle), 0.0]) - y[:3]
        pull = -SUN * y[:3] / np.linalg.norm(y[:3]) ** 3
        return np.r_[y[3:], pull + planet * jupiter / np.linalg.norm(jupiter) ** 3]

    found = solve_ivp(rate, (0, times[-1]), first, "DOP853", times, rtol=1e-11, atol=1e-12)
    return times, found.y[:3].T


def data_of(times, places):
    frame = pd.DataFrame({"t": times, "entity": "rock", **dict(zip("xyz", places.T, strict=True))})
    centre = frame.assign(entity="Sun", x=0.0, y=0.0, z=0.0)
    return bsp_gp.Dataset.from_frames(
        pd.concat([frame, centre], ignore_index=True),
        [Entity("rock"), Entity("Sun", is_static=True)], units={"length": "au", "time": "yr"},
    )  # fmt: skip


def test_the_strength_is_told_by_most_rows():
    times, places = orbit()
    places[40] += 0.05  # a row that is wrong, or a body that is passed closely
    assert strength_of(data_of(times, places)) == pytest.approx(SUN * AU**3 / YEAR**2, rel=0.01)


@pytest.mark.slow
def test_an_asteroid_goes_round_the_sun_whatever_else_pulls_it():
    """Of the ephemeris of Apophis pushes with a period had been told, and of a comet a frame."""
    report = close_loop(data_of(*orbit()), "nothing", rng=1, n_bootstrap=0)
    first = report.rounds[0]
    assert first.verdict == "effect adopted" and "inverse(norm(p_i - p_j)^2)" in first.effect.name
    strength = next(c for c in report.constants if c.name == "c1")
    assert -strength.value == pytest.approx(SUN * AU**3 / YEAR**2, rel=2e-3)
    assert report.total["ratio"].value < 1e-2


def double_star(seed=5, n=30, part=0.6, noise=0.01, slope=1.2):
    """Offsets of a companion from its primary in an orbit seen aslant, arcsec; its strength."""
    rng = np.random.default_rng(seed)
    period, axis, flat, node, periastron = 120.0, 1.2, 0.4, 0.9, 2.0
    times = np.sort(rng.uniform(0, part * period, n))
    mean = 2 * np.pi * times / period + 1.0
    anomaly = mean.copy()
    for _ in range(60):
        anomaly = mean + flat * np.sin(anomaly)
    along, across = np.cos(anomaly) - flat, np.sqrt(1 - flat**2) * np.sin(anomaly)
    turned = np.exp(1j * periastron) * (along + 1j * across)
    seen = np.exp(1j * node) * (turned.real + 1j * np.cos(slope) * turned.imag)
    places = axis * (np.stack([seen.real, seen.imag], axis=1) + noise * rng.normal(size=(n, 2)))
    frame = pd.DataFrame({"t": times, "entity": "companion", "x": places[:, 0], "y": places[:, 1]})
    data = bsp_gp.Dataset.from_frames(
        pd.concat([frame, frame.assign(entity="primary", x=0.0, y=0.0)], ignore_index=True),
        [Entity("companion"), Entity("primary", is_static=True)],
        units={"length": "arcsec", "time": "yr"},
    )  # fmt: skip
    return data, 4 * np.pi**2 * axis**3 / period**2, slope


def test_a_double_star_is_gravity_in_a_plane_that_is_inclined():
    """An unseen body, four forces along the line, or nothing had been told of three in nine."""
    data, strength, slope = double_star()
    report = close_loop(data, "nothing", rng=1, n_bootstrap=0)
    known = {c.name: c for c in report.constants}
    assert report.rounds[0].adopted
    assert "inverse(norm(p_i - p_j)^2)" in report.rounds[0].effect.name
    assert known["inclination"].value == pytest.approx(slope, abs=0.03)
    told = known["c1"]
    half = (told.high - told.low) / 2  # of the 90 % interval
    assert -told.value * YEAR**2 == pytest.approx(strength, abs=2.0 * half * YEAR**2)
    assert half < 0.25 * -told.value
    assert "inclined to the sky" in page_of(report).rounds[0].effect.name
