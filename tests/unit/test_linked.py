"""Arms that hang on one another: their motion, its derivatives, and fits to angles."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.errors import LawError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.motion import Motion, Points

G, FIRST, SECOND, M1, M2 = 9.81, 0.3, 0.2, 0.2, 0.1
KAPPA = {"coupling_phi1": M2 * SECOND / ((M1 + M2) * FIRST), "coupling_phi2": FIRST / SECOND}
LAWS = ["-k[body] * m_i * sin(theta_i)", "linked(phi1, phi2)"]


def swing(drag=0.0, n=150, dt=0.01, sigma=1e-4, seed=0, start=(1.0, -0.6, 0.0, 1.0)):
    """Angles of two point masses on rods, by scipy from Lagrange's equations."""

    def rate(_, z):
        q, w = z[:2], z[2:]
        gap = q[0] - q[1]
        c, both = M2 * FIRST * SECOND, M1 + M2
        mass = np.array([
            [both * FIRST**2, c * np.cos(gap)], [c * np.cos(gap), M2 * SECOND**2],
        ])  # fmt: skip
        push = -np.array([both * FIRST, M2 * SECOND]) * G * np.sin(q)
        push += c * np.sin(gap) * np.array([-(w[1] ** 2), w[0] ** 2]) - drag * w
        return [*w, *np.linalg.solve(mass, push)]

    t = np.arange(n) * dt
    q = solve_ivp(rate, (0, t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-11, method="DOP853").y[:2]
    q = q + sigma * np.random.default_rng(seed).standard_normal(q.shape)
    return pd.DataFrame({"t": t, "phi1": q[0], "phi2": q[1]})


def arms(**kwargs):
    units = {"phi1": "rad", "phi2": "rad", "t": "s"}
    return bsp_gp.Dataset.from_frames(swing(**kwargs), units=units)


def test_derivatives_of_linked_arms_are_those_of_differences():
    data = arms()
    law = read_law(data, [*LAWS, "-c * (omega_i - omega_j)"])
    law = law.with_constants({
        "k[body]": {"phi1": 30.0, "phi2": 50.0}, "c": 0.3,
        "coupling_phi1": 0.25, "coupling_phi2": 1.4,
    })  # fmt: skip
    chains = build_chains(law, data.scenes, data.up)[0]
    names = (("c", ""), ("coupling_phi1", ""), ("coupling_phi2", ""))
    motion = Motion(law, chains, names)
    values = np.array([0.3, 0.25, 1.4])
    motion.set_constants(values)
    rng = np.random.default_rng(1)
    state = rng.standard_normal((2, 2, 2, 5))
    state[:, :, 1] = 0.0
    points = Points(state, np.zeros(5), np.zeros(5, dtype=int), None, [
        np.zeros((0, 1, 1, 5), dtype=bool) for _ in motion.programs
    ])  # fmt: skip
    by_state, by_constant = motion.slopes(points)
    step = 1e-6
    for part, body in np.ndindex(2, 2):
        ends = []
        for sign in (1, -1):
            moved = state.copy()
            moved[part, body, 0] += sign * step
            ends.append(motion.acceleration(points.at(moved)))
        expected = (ends[0] - ends[1]).reshape(4, 5).T / (2 * step)
        np.testing.assert_allclose(by_state[:, :, 4 * part + 2 * body], expected, atol=1e-6)
    for k in range(3):
        ends = []
        for sign in (1, -1):
            motion.set_constants(values + sign * step * (np.arange(3) == k))
            ends.append(motion.acceleration(points))
        expected = (ends[0] - ends[1]).reshape(4, 5).T / (2 * step)
        np.testing.assert_allclose(by_constant[:, :, k], expected, atol=1e-6)


def test_a_double_pendulum_is_fitted_in_angles():
    found = bsp_gp.fit_law(arms(), LAWS)
    assert found.status == "converged"
    told = {(c.name, c.entity): c for c in found.constants}
    for name, value in KAPPA.items():
        c = told[name, ""]
        assert abs(c.value - value) < 2 * (c.high - c.low)
    for body, length in (("phi1", FIRST), ("phi2", SECOND)):
        c = told["k[body]", body]
        assert abs(c.value - G / length) < 2 * (c.high - c.low)
        assert c.high - c.low < 0.02 * c.value


def test_what_is_no_pair_of_arms_is_refused():
    with pytest.raises(LawError, match="must name two arms"):
        read_law(arms(), ["linked(phi1, phi3)"])


def test_two_arms_are_solved_as_many_are():
    from bsp_gp.physics.engine.linked import Linkages

    rng, arms_ = np.random.default_rng(0), Linkages.__new__(Linkages)
    matrix = np.eye(2) + rng.normal(0, 0.6, (50, 2, 2))
    matrix[0, 0, 0] = np.nan
    right, arms_.n = rng.normal(size=(2, 3, 50)), 2
    found = arms_.solved(matrix, right)
    good = np.r_[False, np.linalg.det(matrix[1:]) > 0]
    assert 1 < (~good).sum() < 25 and np.isnan(found[..., ~good]).all()
    expected = np.linalg.solve(matrix[good], np.moveaxis(right[..., good], -1, 0))
    np.testing.assert_allclose(found[..., good], np.moveaxis(expected, 0, -1), rtol=1e-9)
