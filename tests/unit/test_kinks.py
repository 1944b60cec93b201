"""Kinks of tracks, and recordings that are followed in parts from one to the next."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.kinks import kinks

TIMES = np.linspace(0.0, 6.0, 220)


def slid(friction, kick=0.0, at=3.1, sigma=1e-3, seed=0, pull=0.2):
    """Places (T, 2) of a block on a slope, whose velocity jumps once."""

    def rate(_, state):
        return [state[1], pull + friction(state[1])]

    first = TIMES < at
    begin = solve_ivp(rate, (0, at), [0.0, -0.6], t_eval=[*TIMES[first], at], max_step=0.02)
    end = begin.y[:, -1] + [0.0, kick]
    last = solve_ivp(rate, (at, 6), end, t_eval=TIMES[~first], max_step=0.02)
    x = np.concatenate([begin.y[0, :-1], last.y[0]])
    x = x + sigma * np.random.default_rng(seed).standard_normal(len(x))
    return np.column_stack([x, np.zeros_like(x)])


def recorded(places):
    body = Entity("block", properties={"mass": 1.0})
    return Dataset("slope", (Scene("slope", TIMES, places[:, None], (body,)),))


def test_a_velocity_that_jumps_is_seen_with_its_size_whatever_moves_the_body():
    (found,) = kinks(TIMES, slid(lambda v: -0.15 * v, kick=0.4))
    assert found.time == pytest.approx(3.1, abs=0.02)
    assert found.turn == pytest.approx([0.4, 0.0], abs=0.06)
    assert found.error == pytest.approx(1e-3, rel=0.3)


@pytest.mark.parametrize("memory", [0.0, 0.8])
@pytest.mark.parametrize("seed", range(6))
def test_smooth_motions_have_none(seed, memory):
    """Nor has one whose acceleration jumps, where friction turns round; nor noise with a memory."""
    rng = np.random.default_rng([seed, 1])
    rate, damping, sigma = rng.uniform(0.5, 6), rng.uniform(0, 0.5), 10 ** rng.uniform(-4, -2)
    swing = np.exp(-damping * TIMES) * np.cos(rate * TIMES)
    rubbed = slid(lambda v: -0.1 * np.sign(v), sigma=0.0)[:, 0]
    noise = rng.standard_normal(len(TIMES))
    for k in range(1, len(noise)):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    for smooth in (swing, rubbed):
        assert not kinks(TIMES, (smooth + sigma * noise)[:, None])


def test_a_track_that_jumps_has_no_kink():
    places = slid(lambda v: -0.15 * v)
    places[100:, 0] += 0.05
    assert not kinks(TIMES, places)


def test_gaps_uneven_times_and_few_rows_are_borne():
    places = slid(lambda v: -0.15 * v, kick=0.4)
    kept = np.random.default_rng(2).random(len(TIMES)) < 0.9
    places[50:53] = np.nan
    (found,) = kinks(TIMES[kept], places[kept])
    assert found.time == pytest.approx(3.1, abs=0.03)
    assert not kinks(TIMES[:8], places[:8])


@pytest.mark.slow
@pytest.mark.parametrize("friction, text", [
    (lambda v: -0.15 * v, "c1 * (norm(v_i) * normalize(v_i))"),
    (lambda v: -0.06 * np.sign(v), "c1 * (m_i * normalize(v_i))"),
])  # fmt: skip
def test_a_force_beside_a_kick_is_found(friction, text):
    report = close_loop(recorded(slid(friction, kick=0.35)), "g * m_i * e_x", n_bootstrap=0)
    assert report.verdict == "effect adopted" and report.rounds[0].effect.name == text
    (note,) = [n for n in report.dataset["notes"] if "velocity jumps" in n]
    assert "by 0.3" in note and (" at 3.09" in note or " at 3.1" in note)


@pytest.mark.slow
def test_where_a_kick_is_all_that_is_missing_it_is_the_cause():
    places = slid(lambda v: 0.0 * v, kick=0.35)
    report = close_loop(recorded(places), "g * m_i * e_x", n_bootstrap=0)
    assert report.verdict == "effect adopted" and report.rounds[0].effect.code == "contact"
    assert not any("velocity jumps" in note for note in report.dataset["notes"])


def test_a_marker_that_flickers_for_some_rows_is_hit_by_nothing():
    """Two gliders on a track of air were "hit" at instants at which a camera lost sight."""
    rng, found = np.random.default_rng(2), 0
    for _ in range(20):
        times = 0.002 * np.arange(400)
        places = np.stack([0.3 * times, 0.1 * times**2], axis=1)
        places = places + 2e-5 * rng.standard_normal(places.shape)
        first = int(rng.integers(50, 350))
        places[first : first + 3] += 1.5e-4 * np.outer([0.4, 1.0, 0.5], rng.standard_normal(2))
        found += len(kinks(times, places))
    assert found == 0


def test_kinks_are_those_of_any_times_where_most_rows_are_even():
    """Windows of the same times share one basis; few rows left out had cost all others theirs."""
    places = slid(lambda v: -0.15 * v, kick=0.4)
    kept = np.ones(len(TIMES), dtype=bool)
    kept[[20, 150]] = False
    (whole,), (some,) = kinks(TIMES, places), kinks(TIMES[kept], places[kept])
    assert some.time == pytest.approx(whole.time, abs=1e-3)
    assert some.gain == pytest.approx(whole.gain, rel=0.05)
    jittered = TIMES + 1e-5 * np.random.default_rng(0).standard_normal(len(TIMES))
    (other,) = kinks(jittered, places)
    assert other.gain == pytest.approx(whole.gain, rel=0.05)
