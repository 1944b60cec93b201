"""Logs that are late: a delay of any size is found, and a log that is in time is left alone."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.late import Late
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.late import LateLogs
from bsp_gp.loop.view import View, selected
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.motion import Motion, Points

MASS, SIGMA = 0.5, 2e-3
UNITS = {"length": "m", "time": "s", "thrust": "N", "mass": "kg"}
LAWS = ["9.81 [m/s^2] * m_i * down", "k * thrust * up"]


def thrust(t, phase, end=2.38):
    """As it was logged; before and after that it stays as it is."""
    t = np.clip(t, 0.0, end)
    return MASS * 9.81 + 1.5 * np.sin(4.1 * t + phase) + 0.8 * np.sin(9.7 * t + 3 * phase)


def flown(delay, phases=(0.0, 0.7, 1.9), n=120, dt=0.02):
    """Flights under a thrust that acts later than its log says."""
    frames, rng = {}, np.random.default_rng(4)
    t = np.arange(n) * dt
    for k, phase in enumerate(phases):
        track = solve_ivp(
            lambda t, y, phase=phase: [*y[2:], 0.0, thrust(t - delay, phase) / MASS - 9.81],
            (0, t[-1]), [0, 1, 0.5, 0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.02,
        ).y[:2] + SIGMA * rng.standard_normal((2, n))  # fmt: skip
        frames[f"s{k}"] = pd.DataFrame(
            {"t": t, "x": track[0], "y": track[1], "thrust": thrust(t, phase)}
        )
    bodies = pd.DataFrame({"entity": ["object"], "mass": [MASS]})
    return bsp_gp.Dataset.from_frames(frames, bodies, units=UNITS, up="y")


def proposed(delay):
    data = flown(delay)
    hypothesis = Hypothesis.from_laws(data, LAWS)
    found = fit(hypothesis, data)
    view = View(found, continued(hypothesis, found), data, np.random.default_rng(0))
    family = LateLogs().propose(view)
    return data, family, selected(family.gain, family.rank, family.null, view.noise_dof, True)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.013, 0.11, 0.4, -0.17])
def test_a_delay_of_any_size_is_found(delay):
    data, family, chance = proposed(delay)
    assert chance < 1e-6
    best = family.proposals[0]
    found = fit(best.hypothesis, data, starts=best.starts)
    assert found.chi2_red < 1.2
    error = found.errors[found.parameters.index(("delay_thrust", ""))]
    assert abs(found.law.constants["delay_thrust"] - delay) < 5 * error < 0.005
    assert abs(found.law.constants["k"] - 1) < 0.02


def test_a_log_that_is_in_time_is_left_alone():
    assert proposed(0.0)[2] > 0.01


def test_slopes_by_a_delay_are_those_of_the_acceleration():
    data = flown(0.0)
    law = (Hypothesis.from_laws(data, LAWS) + Late(("thrust",), 0.5)).law
    (chains,) = build_chains(law, data.scenes, data.up)
    parameters = (("k", ""), ("delay_thrust", ""))
    motion = Motion(law, chains, parameters)
    state = np.random.default_rng(0).standard_normal((2, 1, 2, 3))
    points = Points(state, np.array([0.31, 0.77, 1.23]), np.arange(3), None, [])

    def push(delay):
        motion.set_constants(np.array([1.2, delay]))
        return motion.acceleration(points)

    motion.set_constants(np.array([1.2, 0.053]))
    slope = motion.slopes(points)[1][:, :, 1]
    step = 1e-5
    expected = (push(0.053 + step) - push(0.053 - step)) / (2 * step)
    np.testing.assert_allclose(slope, np.moveaxis(expected[0], -1, 0), rtol=1e-6, atol=1e-9)
    # What simulates and what fits asks the log at one instant.
    law = law.with_constants({"k": 1.2, "delay_thrust": 0.053})
    told = bsp_gp.physics.evaluation.PreparedLaw(law, bodies_of(data))
    places, speeds = np.moveaxis(state, -1, 1)[:, :, None]
    got = told.acceleration(np.swapaxes(places, 0, 1)[0][None], speeds[None, :, 0], points.times)
    np.testing.assert_allclose(got.reshape(3, 2), np.moveaxis(push(0.053)[0], -1, 0))


def bodies_of(data):
    from bsp_gp.physics.bodies import stack

    return stack(data.scenes, data.up)[0].bodies


@pytest.mark.slow
def test_the_loop_adopts_a_delay():
    data = flown(0.11)
    report = bsp_gp.close_loop(data, LAWS[:1] + ["thrust * up"], rng=0, n_bootstrap=0)
    effect = next(done.effect for done in report.rounds if done.adopted)
    assert effect.code == "late_log"
    (delay,) = [c for c in report.constants if c.name == "delay_thrust"]
    assert delay.low < 0.11 < delay.high and delay.unit == "s"
