"""Recordings that begin in a hand, or end in one."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.hands import without_hands
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.units import UnitSystem

WEIGHT = "9.81 [m/s^2] * m_i * down"
SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
STEP, THROW = 1 / 60, 0.3
BEGIN, SPEED = np.array([0.0, 1.2]), np.array([2.5, 5.0])


def recorded(places, seed=0, sigma=0.003):
    places = places + sigma * np.random.default_rng(seed).standard_normal(places.shape)
    times = np.arange(len(places)) * STEP
    body = Entity("ball", properties={"mass": 1.0})
    scene = Scene("throw", times, places[:, None], (body,))
    return Dataset("throw", (scene,), units=SI, up="y")


def flight(n_rows, drag=0.0, more=None, begin=BEGIN, speed=SPEED):
    """Places (T, 2) under weight, quadratic drag and what else acts."""

    def rate(t, state):
        x, v = state[:2], state[2:]
        pull = np.array([0.0, -9.81]) - drag * np.linalg.norm(v) * v
        return [*v, *(pull if more is None else pull + more(t, x, v))]

    times = np.arange(n_rows) * STEP
    path = solve_ivp(rate, (0, times[-1]), [*begin, *speed], t_eval=times, max_step=0.005)
    return path.y[:2].T


def thrown(held, drag, caught=0):
    """A ball held for some rows, thrown within 0.3 s, in flight for a second, and caught."""
    s = np.arange(round(THROW / STEP)) * STEP
    hand = BEGIN + SPEED * (s**3 / THROW**2 - s**4 / (2 * THROW**3))[:, None]
    flown = flight(60, drag, begin=BEGIN + SPEED * THROW / 2)
    last = (flown[-1] - flown[-2]) / STEP
    w = np.arange(1, caught + 1) * STEP
    stopped = flown[-1] + last * 0.08 * (1 - np.exp(-w / 0.08))[:, None]
    return np.concatenate([np.tile(BEGIN, (held, 1)), hand, flown, stopped])


def left_out(data):
    """Rows that are left out before and after, (0, 0) where none are."""
    found = without_hands(data, read_law(data, WEIGHT))
    if found is None:
        return 0, 0
    ends = (re.search(rf"(\d+) {side}", found.notes[-1]) for side in ("before", "after"))
    return tuple(int(end[1]) if end else 0 for end in ends)


@pytest.mark.parametrize("drag", [0.0, 0.12])
@pytest.mark.parametrize("held, caught", [(0, 0), (12, 0), (8, 18)])
def test_hands_are_left_out_up_to_a_few_rows(held, caught, drag):
    before, after = left_out(recorded(thrown(held, drag, caught)))
    assert abs(before - held - 18) <= 4
    assert abs(after - caught) <= 5


@pytest.mark.parametrize("seed", range(3))
def test_flights_that_are_trimmed_stay_whole_whatever_their_law_lacks(seed):
    assert left_out(recorded(flight(70, drag=0.15), seed)) == (0, 0)


def test_a_constant_thrust_is_no_hand():
    thrust = flight(90, more=lambda t, x, v: np.array([4.0, 22.0]) * (t < 0.5), speed=0.2 * SPEED)
    assert left_out(recorded(thrust)) == (0, 0)


def test_a_force_that_fades_with_the_distance_is_no_hand():
    def pushed(_, x, v):
        away = x - np.array([-0.3, 1.1])
        return 1.2 * away / np.linalg.norm(away) ** 3

    assert left_out(recorded(flight(90, more=pushed, speed=0.6 * SPEED))) == (0, 0)


@pytest.mark.slow
def test_the_drag_of_a_ball_is_found_between_hands():
    report = close_loop(recorded(thrown(10, 0.12, 15)), WEIGHT, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.name == "c1 * (norm(v_i)^2 * normalize(v_i))"
    (drag,) = report.constants
    assert drag.value == pytest.approx(-0.12, abs=2 * (drag.high - drag.low))
    assert any("a hand that throws or catches it" in note for note in report.dataset["notes"])
