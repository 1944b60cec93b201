"""What goes round a body that is seen at rest is asked for gravity before all else."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp import close_loop
from bsp_gp.data.scene import Entity
from bsp_gp.loop.proposers.centres import strength_of

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
