"""Ends at which tracks depart from the motion between: told by the track, and as a hypothesis."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.fitting.departures import departures, going_on
from tests.fitted_tracks import body, dataset_of, scene_of

GRAVITY = "9.81 [m/s^2] * m_i * down"
SIGMA = 0.002


def path(rate, begin, span, fps):
    times = np.arange(0.0, span, 1 / fps)
    found = solve_ivp(rate, (0, times[-1]), begin, t_eval=times, rtol=1e-9, max_step=0.01)
    return found.y[:2].T


def flight(drag, begin=(0.3, 1.5, 2.5, 4.0), span=0.9, fps=30):
    def rate(_, y):
        return [*y[2:], *(-drag * np.hypot(*y[2:]) * y[2:] + [0.0, -9.81])]

    return path(rate, begin, span, fps)


def pushed(places, speed, lasts=0.25, fps=30):
    """The rows in which a hand brings a body from rest to its first place and speed."""
    count = int(lasts * fps)
    u = 1.0 - np.arange(count, 0, -1) / (lasts * fps)
    way = lasts * (u**3 - 0.5 * u**4 - 0.5)
    return np.concatenate([places[0] + way[:, None] * np.asarray(speed), places]), count


def seen(places, seed=0, fps=30):
    places = places + SIGMA * np.random.default_rng(seed).standard_normal(places.shape)
    return np.arange(len(places)) / fps, places


def dataset(*tracks, fps=30):
    scenes = []
    for k, places in enumerate(tracks):
        times, noisy = seen(places, k, fps)
        scenes.append(scene_of(times, (body("ball"),), noisy[:, None], name=f"s{k}"))
    return dataset_of(scenes)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("drag", [0.0, 0.3])
def test_a_throw_departs_where_the_hand_lets_go(drag, seed):
    places, count = pushed(flight(drag), (2.5, 4.0))
    head, tail = departures(*seen(places, seed), np.full(2, SIGMA))
    assert count - 4 <= head <= count + 1 and tail == 0
    times, backwards = seen(places[::-1], seed)
    head, tail = departures(times, backwards, np.full(2, SIGMA))
    assert head == 0 and count - 4 <= tail <= count + 1


@pytest.mark.parametrize("seed", range(10))
def test_smooth_motions_depart_nowhere(seed):
    def swinging(_, y):
        return [*y[2:], *(-25.0 * y[:2] - 0.3 * y[2:])]

    for places in (flight(0.0), flight(0.25), path(swinging, (0.2, 0.0, 0.0, 0.5), 3.0, 30)):
        assert departures(*seen(places, seed), np.full(2, SIGMA)) == [0, 0]


def test_few_rows_are_not_asked():
    assert departures(np.arange(9.0), np.zeros((9, 2)), np.ones(2)) == [0, 0]


def test_rows_that_go_on_straight_fail_to_by_nothing():
    times = np.array([0.0, 1.0, 3.0, 4.0, 6.0])
    np.testing.assert_allclose(going_on(times, np.outer(times, [2.0, -1.0])), 0.0, atol=1e-12)
    bent = going_on(np.arange(5.0), np.arange(5.0)[:, None] ** 2)
    np.testing.assert_allclose(bent, 2.0)


def test_a_cart_that_a_hand_has_pushed_rolls_with_drag():
    def rate(_, y):
        return [*y[2:], -0.38 * y[2], 0.0]

    places, count = pushed(path(rate, (0.15, 0.0, 0.9, 0.0), 2.5, 30), (0.9, 0.0))
    data = dataset(places * [1.0, 0.0])
    report = close_loop(data, rng=0, n_bootstrap=0)
    assert report.verdict in ("effect adopted", "effective law")
    # A hand that pushes evenly is a push up to an instant as well.
    name, found = report.rounds[0].effect.name, {c.name: c for c in report.constants}
    assert "left out[s0, 0:" in name or "c1 * v_i + c2 * (0.5 * (1 - sign(t - t1)) * e_x)" in name
    assert found["c1"].value == pytest.approx(-0.38, abs=0.04)


@pytest.mark.slow
def test_a_thrust_that_few_rows_show_hides_no_drag():
    def rate(t, y):
        thrust = 30.0 * (t < 0.3)
        return [*y[2:], *(-0.02 * np.hypot(*y[2:]) * y[2:] + [0.0, thrust - 9.81])]

    report = close_loop(
        dataset(path(rate, (0.0, 0.0, 0.1, 0.0), 2.5, 30)), GRAVITY, rng=0, n_bootstrap=0
    )
    # The thrust is left out, or told as a push that ends.
    name, found = report.rounds[0].effect.name, {c.name: c for c in report.constants}
    forms = r"norm\(v_i\)\^2 \* normalize\(v_i\)|norm\(v_i\) \* v_i"
    drag = re.search(rf"(c\d) \* \((?:{forms})\)", name)
    assert found[drag[1]].value == pytest.approx(-0.02, abs=0.002)


@pytest.mark.slow
def test_a_force_that_acts_at_one_end_is_no_hand_and_its_place_is_found():
    def rate(_, y):
        return [*y[2:], *(0.0335 * y[:2] / np.hypot(*y[:2]) ** 3)]

    low, high = (0.13, 0.08, 0.2, 0.05), (0.17, 0.12, 0.4, 0.15)
    begins = np.random.default_rng(1).uniform(low, high, (4, 4))
    tracks = [path(rate, begin, 2.5, 30) for begin in begins]
    report = close_loop(dataset(*tracks), rng=0, n_bootstrap=0)
    assert report.rounds[0].effect.code == "hidden_body"
    place = {c.name: c for c in report.constants}
    for axis in "xy":
        assert place[f"h_{axis}1"].low < 0.0 < place[f"h_{axis}1"].high
