"""The least-squares driver on problems drawn at random: units and scales do not matter."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Settings
from experiments.certified import Dense

PROFILE = settings(max_examples=60, deadline=None)
SEEDS = st.integers(0, 2**32)
X = np.linspace(0.0, 3.0, 25)
UNKNOWN = Settings(absolute=0.0)


@PROFILE
@given(SEEDS, st.integers(1, 6), st.floats(-9, 9))
def test_linear_problems_of_any_scale_are_solved_at_once(seed, n_unknowns, power):
    rng = np.random.default_rng(seed)
    matrix = np.linalg.qr(rng.standard_normal((20, n_unknowns)))[0]
    matrix = matrix + 0.2 * rng.standard_normal(matrix.shape) / np.sqrt(20)
    scales = 10.0 ** rng.uniform(-9, 9, n_unknowns)
    truth = rng.uniform(0.5, 2.0, n_unknowns)
    noise = 0.1 * rng.standard_normal(20)
    noise -= matrix @ np.linalg.lstsq(matrix, noise, rcond=None)[0]
    target, size = matrix @ truth + noise, 10.0**power
    problem = Dense(
        lambda b: size * (target - matrix @ (b * scales)), lambda b: -size * matrix * scales
    )
    found = minimise(problem, rng.standard_normal(n_unknowns) / scales, settings=UNKNOWN)
    assert found.status == "converged" and found.n_linearised <= 3
    np.testing.assert_allclose(found.values * scales, truth, rtol=1e-10)


@PROFILE
@given(SEEDS, st.lists(st.integers(-40, 40), min_size=3, max_size=3))
def test_a_change_of_units_changes_nothing(seed, powers):
    rng = np.random.default_rng(seed)
    units = 2.0 ** np.array(powers)
    start = np.array([1.0, 1.0, 0.5]) * 2.0 ** rng.uniform(-2, 2, 3)
    target = 2.0 * np.exp(-0.7 * X) + 0.3 + 0.01 * rng.standard_normal(len(X))

    def problem(units):
        def residual(p):
            a, b, c = p * units
            return (target - a * np.exp(-b * X) - c) / 0.01

        def jacobian(p):
            a, b, _ = p * units
            fall = np.exp(-b * X)
            return -np.stack([fall, -a * X * fall, np.ones_like(X)], axis=1) * units / 0.01

        return Dense(residual, jacobian)

    plain = minimise(problem(np.ones(3)), start)
    other = minimise(problem(units), start / units)
    assert (other.status, other.n_linearised) == (plain.status, plain.n_linearised)
    np.testing.assert_allclose(other.values * units, plain.values, rtol=1e-9)


@PROFILE
@given(SEEDS)
@example(1071)  # a lower and an upper bound that the solver of the subproblem missed by a rounding
@example(3111978)
def test_bounds_are_never_left_and_never_cost_the_optimum(seed):
    rng = np.random.default_rng(seed)
    matrix, target = rng.standard_normal((15, 4)), rng.standard_normal(15)
    low, high = -rng.exponential(0.3, 4), rng.exponential(0.3, 4)
    seen = []

    def residual(b):
        seen.append(b)
        return target - matrix @ b

    found = minimise(Dense(residual, lambda b: -matrix), np.zeros(4), low=low, high=high)
    assert np.all(np.array(seen) >= low) and np.all(np.array(seen) <= high)
    assert found.status in ("converged", "at_bound")
    slopes = -matrix.T @ (target - matrix @ found.values)
    assert np.all((slopes < 1e-6) | (found.values == low))
    assert np.all((slopes > -1e-6) | (found.values == high))
