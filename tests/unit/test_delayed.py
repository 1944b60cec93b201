"""Forces that act late: a controller that answers to where its cart was a while ago."""

import cmath

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.loop.proposers.delayed import Delayed
from tests.loop_views import view_of
from tests.throws import SI

STIFFNESS, SIGMA = 4.0, 0.002
SPRING, PUSH = f"-{STIFFNESS} [1/s^2] * m_i * x_i * e_x", "-0.5 [m/s^2] * m_i * e_y"


def controlled(delay):
    """Carts about the origin with x'' = -k x(t - delay): exp(s t) where s^2 = -k exp(-s delay)."""
    root = complex(0.0, np.sqrt(STIFFNESS))
    for _ in range(50):
        root = cmath.sqrt(-STIFFNESS * cmath.exp(-root * delay))
    rng, t, scenes = np.random.default_rng(3), 0.025 * np.arange(80), []
    for number in range(3):
        x = np.real((1.0 + 0.2 * number) * np.exp(root * t))
        places = np.stack([x, 1.0 * t - 0.25 * t**2], axis=1)[:, None]
        places = places + SIGMA * rng.standard_normal(places.shape)
        scenes.append(Scene(str(number), t, places, (Entity("1", properties={"mass": 0.3}),)))
    return Dataset("carts", tuple(scenes), noise=(SIGMA,), units=SI)


def test_a_spring_that_acts_late_is_found_with_its_delay():
    data = controlled(0.1)
    best = Delayed().propose(view_of(data, SPRING, PUSH)).proposals[0]
    assert best.code == "delayed" and best.text.endswith("of what was delay1 ago")
    found = fit(best.hypothesis, data, starts=best.starts, bounds=best.bounds)
    assert found.law.constants["delay1"] == pytest.approx(0.1, abs=0.005)
    assert found.chi2_red < 1.3


def test_a_spring_that_acts_at_once_shows_none():
    family = Delayed().propose(view_of(controlled(0.0), SPRING, PUSH))
    assert family.gain < 15


def test_what_depends_on_no_place_cannot_act_late():
    assert Delayed().propose(view_of(controlled(0.0), PUSH)).proposals == ()
