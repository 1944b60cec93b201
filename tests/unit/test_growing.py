"""Strengths that grow or fade: found with their rate where they do, and else left alone."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.loop.proposers.growing import Growing
from bsp_gp.loop.view import selected
from tests.loop_views import throws, view_of

WIND = "c * e_x"


def blown(rate, begin=0.0):
    """Throws in a wind whose force on a mass of one grows from the first row on."""
    def move(t, mass):
        push = 2.0 * (t**2 / 2 + rate * t**3 / 6) / mass
        return push[:, None] * [1, 0]

    data = throws(np.random.default_rng(3), move=move, sigma=0.002)
    if begin:
        scenes = tuple(replace(s, times=s.times + begin) for s in data.scenes)
        data = replace(data, scenes=scenes)
    return data


def proposed(rate, begin=0.0):
    data = blown(rate, begin)
    view = view_of(data, "-9.81 [m/s^2] * m_i * e_y", WIND)
    family = Growing().propose(view)
    return data, family, selected(family.gain, family.rank, family.null, view.noise_dof)


@pytest.mark.slow
@pytest.mark.parametrize("begin", [0.0, 1000.0])
def test_a_wind_that_grows_is_found_with_its_rate(begin):
    data, family, chance = proposed(0.4, begin)
    assert chance < 1e-6
    best = max(
        (fit(p.hypothesis, data, starts=p.starts, bounds=p.bounds) for p in family.proposals),
        key=lambda found: found.log_likelihood,
    )
    assert best.law.constants["r1"] == pytest.approx(0.4, abs=0.03)
    assert best.law.constants["c"] == pytest.approx(2.0, rel=0.01)
    assert best.chi2_red < 1.2


def test_a_steady_wind_is_left_alone():
    assert proposed(0.0)[2] > 0.01
