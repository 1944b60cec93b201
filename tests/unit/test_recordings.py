"""Recordings of one body under several forces, nothing or weight declared: named at once."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.loop.close import close_loop
from bsp_gp.report.naming import describe
from bsp_gp.units import UnitSystem
from tests.fitted_tracks import body, dataset_of, scene_of


def recorded(force, starts, times, sigma, seed=0):
    """Scenes of a body of one kilogram with accelerations ``force(t, place, velocity)``."""
    rng, scenes = np.random.default_rng(seed), []
    for k, start in enumerate(starts):
        start = np.ravel(start).astype(float)
        half = len(start) // 2
        y = solve_ivp(
            lambda t, y, half=half: [*y[half:], *np.atleast_1d(force(t, y[:half], y[half:]))],
            (times[0], times[-1]), start, t_eval=times, rtol=1e-9, atol=1e-11, max_step=0.01,
        ).y[:half]  # fmt: skip
        seen = y.T + sigma * rng.standard_normal((len(times), half))
        if half == 1:
            seen = np.column_stack([seen, np.zeros(len(times))])
        scenes.append(scene_of(times, (body("body"),), seen[:, None], name=f"s{k}"))
    return dataset_of(scenes)


def told(data, declared=()):
    """The report, and values with intervals of what was found, by stem of the name."""
    report = close_loop(data, declared, rng=0, n_bootstrap=0)
    return report, {c.name.rstrip("0123456789"): c for c in report.constants}


def holds(constant, truth, factor=2.0):
    """Whether a truth lies within so many times the 90 % interval."""
    middle, half = (constant.low + constant.high) / 2, (constant.high - constant.low) / 2
    return abs(truth - middle) <= factor * half


def forces(report):
    """Names of the terms of the final law that were found."""
    return {describe(term.formula) for term in report.law.terms if not term.is_declared}


@pytest.mark.slow
def test_a_spring_with_two_drags():
    times = np.linspace(0.0, 8.0, 241)
    data = recorded(lambda t, x, v: -25 * x - 0.4 * v - 3 * abs(v) * v, [(0.3, 0.0)], times, 1e-3)
    report, found = told(data)
    assert report.verdict == "effect adopted" and len(report.rounds) == 2
    assert forces(report) == {
        "spring to a rest point", "drag, linear in speed", "drag, quadratic in speed",
    }  # fmt: skip
    assert holds(found["centre_x"], 0.0)


@pytest.mark.slow
def test_drag_in_a_wind():
    def force(t, place, v):
        return -0.06 * np.hypot(v[0] + 3.0, v[1]) * (v + [3.0, 0.0]) + [0.0, -9.81]

    starts = [(0.0, 1.5, 6.0 + k, 8.0 - 0.5 * k) for k in range(4)]
    data = recorded(force, starts, np.arange(0.0, 1.6, 0.04), 3e-3)
    report, found = told(data, "9.81 [m/s^2] * m_i * down")
    assert report.verdict == "effect adopted"
    assert forces(report) == {"drag in a wind, quadratic in speed"}
    assert holds(found["u_x"], -3.0) and holds(found["c"], -0.06)


@pytest.mark.slow
def test_a_driven_and_damped_spring():
    def force(t, x, v):
        return -16 * x - 0.4 * v + 0.8 * np.cos(2.7 * t)

    report, found = told(recorded(force, [(0.05, 0.0)], np.arange(0.0, 20.0, 0.05), 1e-3))
    assert forces(report) == {
        "spring to a rest point", "drag, linear in speed", "push with a period along x",
    }  # fmt: skip
    assert holds(found["w"], 2.7) and holds(found["a"], 0.8)


@pytest.mark.slow
def test_a_swing_of_a_large_angle():
    def force(t, angle, rate):
        return -9.81 / 0.62 * np.sin(angle) - 0.08 * rate

    data = recorded(force, [(1.2, 0.0)], np.arange(0.0, 12.0, 0.05), 3.5e-3)
    units = UnitSystem.from_declared({"length": "rad", "time": "s"})
    report, _ = told(replace(data, units=units))
    assert forces(report) == {
        "what drives an angle back as its sine (a weight on an arm, a pendulum)",
        "drag, linear in speed",
    }  # fmt: skip
    linear = (c for c in report.constants if c.name[0] == "c")
    drag, strength = sorted(linear, key=lambda c: -c.value)
    assert holds(strength, -9.81 / 0.62) and holds(drag, -0.08)


@pytest.mark.slow
def test_a_repulsion_by_a_magnet_with_friction():
    def force(t, x, v):
        return 1e-3 / x**4 - 0.05 * np.tanh(v / 0.002)

    starts = [(0.4, -0.5), (0.35, -0.7), (0.45, -0.9), (0.3, -0.4)]
    report, found = told(recorded(force, starts, np.arange(0.0, 1.5, 0.02), 5e-4))
    assert forces(report) == {
        "force to a point, to a fitted power of distance", "friction of constant size",
    }  # fmt: skip
    assert holds(found["n"], -4.0)
