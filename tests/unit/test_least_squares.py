"""The least-squares driver: bounds, rank, plateaus, honest endings, states that move along."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from bsp_gp.errors import SettingsError
from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Linearised, Settings
from experiments.certified import Dense

X = np.linspace(0.0, 4.0, 30)
NOISE = np.random.default_rng(1).standard_normal(30)
UNKNOWN = Settings(absolute=0.0)


def linear(matrix, target):
    return Dense(lambda b: target - matrix @ b, lambda b: -matrix)


def decay(target, sigma=0.01):
    """a exp(-b x), whitened."""
    return Dense(
        lambda p: (target - p[0] * np.exp(-p[1] * X)) / sigma,
        lambda p: -np.stack([np.exp(-p[1] * X), -p[0] * X * np.exp(-p[1] * X)], axis=1) / sigma,
    )


DECAY = decay(2.0 * np.exp(-0.7 * X) + 0.01 * NOISE)


def test_a_minimum_is_where_scipy_finds_it():
    found = minimise(DECAY, [1.0, 1.0], settings=UNKNOWN)
    sharp = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-15)
    other = least_squares(DECAY.residual, [1.0, 1.0], DECAY.jacobian, **sharp)
    np.testing.assert_allclose(found.values, other.x, rtol=1e-9)
    assert (found.status, found.code) == ("converged", "fall")
    assert found.chisqr == pytest.approx(2 * other.cost, rel=1e-12)
    assert found.gradient < 1e-8 and found.fall < 1e-8
    assert not found.undetermined.any()


def test_steps_end_on_bounds_where_the_bounded_optimum_is():
    matrix = np.random.default_rng(2).standard_normal((30, 4))
    target = matrix @ [3.0, -2.0, 1.0, 0.5] + NOISE
    low, high = np.array([-1.0, -1.0, -1.0, -9.0]), np.array([1.0, 9.0, 9.0, 9.0])
    found = minimise(linear(matrix, target), np.zeros(4), low=low, high=high)
    expected = lsq_linear(matrix, target, (low, high), method="bvls").x
    np.testing.assert_allclose(found.values, expected, atol=1e-12)
    assert found.status == "at_bound" and found.gradient < 1e-9
    assert found.values[0] == 1.0 and found.values[1] == -1.0


def test_a_bound_that_the_start_lies_on_is_left_where_chisqr_falls_inward():
    found = minimise(DECAY, [5.0, 0.0], low=[0.0, 0.0], high=[5.0, 9.0])
    assert found.status == "converged"
    np.testing.assert_allclose(found.values, minimise(DECAY, [1.0, 1.0]).values, rtol=1e-6)


def test_bounds_of_a_curved_problem():
    bounds = ([0.0, 0.9], [9.0, 9.0])
    found = minimise(DECAY, [1.0, 3.0], low=bounds[0], high=bounds[1])
    other = least_squares(DECAY.residual, [1.0, 3.0], DECAY.jacobian, bounds, xtol=1e-15)
    assert found.status == "at_bound" and found.values[1] == 0.9
    assert found.chisqr <= 2 * other.cost * (1 + 1e-9)


def test_equal_bounds_hold_an_unknown_and_are_no_warning():
    found = minimise(DECAY, [1.0, 0.5], low=[-9.0, 0.5], high=[9.0, 0.5])
    shape = np.exp(-0.5 * X)
    assert found.status == "converged" and found.values[1] == 0.5
    residual = DECAY.residual([0.0, 0.5]) * 0.01
    assert found.values[0] == pytest.approx(shape @ residual / (shape @ shape), rel=1e-12)


def test_a_start_outside_of_its_bounds_is_refused():
    with pytest.raises(SettingsError, match=r"unknown 1 must lie within its bounds 0 to 1, got 2"):
        minimise(DECAY, [1.0, 2.0], low=[0.0, 0.0], high=[1.0, 1.0])


def test_unknowns_that_cannot_be_told_apart_are_named_and_stay_small():
    matrix = np.stack([X, X, np.ones_like(X)], axis=1)
    found = minimise(linear(matrix, 2.0 * X + 1.0 + 0.1 * NOISE), [0.0, 0.0, 0.0])
    assert found.status == "converged"
    assert found.undetermined.tolist() == [True, True, False]
    assert found.values[0] == pytest.approx(found.values[1]) == pytest.approx(1.0, abs=0.1)


def test_fewer_rows_than_unknowns():
    matrix = np.random.default_rng(3).standard_normal((2, 4))
    found = minimise(linear(matrix, np.ones(2)), np.zeros(4))
    assert found.undetermined.all() and found.chisqr < 1e-20
    np.testing.assert_allclose(found.values, np.linalg.pinv(matrix) @ np.ones(2), atol=1)


def test_an_unknown_without_influence_is_no_fit():
    matrix = np.stack([X, 0 * X], axis=1)
    found = minimise(linear(matrix, X + NOISE), [0.0, 1.0])
    assert (found.status, found.code) == ("unconverged", "flat")
    assert found.undetermined.tolist() == [False, True] and found.values[1] == 1.0


def test_a_plateau_is_not_called_a_minimum():
    start = [1.0, 300.0]  # exp(-300 x) is 1 at x = 0, and nothing after
    plateau = minimise(DECAY, start)
    assert plateau.chisqr > 100 * minimise(DECAY, [1.0, 1.0]).chisqr
    assert plateau.status == "unconverged"


SPIKE = np.where(X == 0.0, 1.0, -0.1 * np.abs(NOISE))


def test_unknowns_that_run_away_together_are_not_called_a_minimum():
    late = X + 0.5  # a exp(-b late) comes nearer to a spike the larger a and b, for ever
    problem = Dense(
        lambda p: (SPIKE - p[0] * np.exp(-p[1] * late)) / 0.01,
        lambda p: -np.exp(-p[1] * late)[:, None] * np.stack([late**0, -p[0] * late], axis=1) / 0.01,
    )
    assert minimise(problem, [1.0, 1.0]).status == "unconverged"


@pytest.mark.parametrize(
    ("misfit", "ending"), [(0.05, ("unconverged", "flat")), (0.0, ("converged", "fall"))]
)
def test_unknowns_told_apart_at_the_start_only_are_a_fit_if_the_data_are_met(misfit, ending):
    problem = Dense(  # the product a b, and a threshold that a falls below
        lambda p: np.array([p[0] * p[1] - 1.0, max(p[0] - 2.0, 0.0), misfit]) / 0.01,
        lambda p: np.array([[p[1], p[0]], [float(p[0] > 2.0), 0.0], [0.0, 0.0]]) / 0.01,
    )
    found = minimise(problem, [3.0, 0.4])
    assert (found.status, found.code) == ending
    assert found.undetermined.all() and found.fall < 1e-6


def test_a_start_that_is_not_finite():
    found = minimise(DECAY, [1.0, -1e6])
    assert (found.status, found.chisqr, found.n_linearised) == ("nonfinite", np.inf, 1)
    huge = minimise(Dense(lambda b: b * 1e200, lambda b: np.eye(1)), [1.0])
    assert huge.status == "nonfinite"


def test_trial_steps_that_overflow_or_leave_the_domain_are_shortened():
    target = np.log(3.0 + X) + 1e-3 * NOISE
    problem = Dense(
        lambda b: (target - np.log(b[0] + X)) / 1e-3,
        lambda b: -(1.0 / (b[0] + X) / 1e-3)[:, None],
    )
    found = minimise(problem, [1000.0])  # the first whole step leads to a negative argument
    assert found.status == "converged" and found.values[0] == pytest.approx(3.0, abs=0.01)
    growth = Dense(
        lambda b: np.exp(b[0] * X) - np.exp(2.0 * X),
        lambda b: (X * np.exp(b[0] * X))[:, None],
    )
    found = minimise(growth, [-3.0])  # overshoots into overflow
    assert found.status == "converged" and found.values[0] == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("factor", [-1.0, 30.0])
def test_wrong_derivatives_end_in_no_convergence(factor):
    wrong = Dense(
        DECAY.residual, lambda p: DECAY.jacobian(p) + factor * np.stack([X, X**2], axis=1)
    )
    found = minimise(wrong, [1.0, 1.0], settings=Settings(max_linearised=200))
    assert found.status == "unconverged"


def test_a_stall_is_unconverged():
    wall = Dense(  # steps towards the minimum at 0 lead out of the domain at 1
        lambda b: np.array([b[0] if b[0] >= 1.0 else np.nan]), lambda b: np.eye(1)
    )
    found = minimise(wall, [1.0])
    assert (found.status, found.code, found.values[0]) == ("unconverged", "stalled", 1.0)


def test_limits_are_kept_and_told():
    few = minimise(DECAY, [1.0, 3.0], settings=Settings(max_linearised=3))
    assert (few.status, few.code, few.n_linearised) == ("unconverged", "limit", 3)
    answers = iter([False, True])
    stopped = minimise(DECAY, [1.0, 3.0], is_over=lambda: next(answers))
    assert (stopped.status, stopped.code, stopped.n_linearised) == ("unconverged", "stopped", 2)
    assert stopped.chisqr <= minimise(DECAY, [1.0, 3.0], is_over=lambda: True).chisqr


def test_what_is_negligible_without_noise_is_a_part_of_chisqr():
    tiny = decay(2.0 * np.exp(-0.7 * X) + 0.01 * NOISE, sigma=1e6)
    known, unknown = minimise(tiny, [1.0, 1.0]), minimise(tiny, [1.0, 1.0], settings=UNKNOWN)
    assert known.n_linearised == 1, "all of chi-squared is less than a variance's 1e-4"
    np.testing.assert_allclose(unknown.values, minimise(DECAY, [1.0, 1.0]).values, rtol=1e-6)


def test_many_rows_are_the_same_problem():
    matrix = np.random.default_rng(4).standard_normal((1000, 5)) * 10.0 ** np.arange(-6, 9, 3)
    target = np.random.default_rng(5).standard_normal(1000)
    found = minimise(linear(matrix, target), np.zeros(5), settings=UNKNOWN)
    expected = np.linalg.lstsq(matrix / 10.0 ** np.arange(-6, 9, 3), target)[0]
    np.testing.assert_allclose(found.values * 10.0 ** np.arange(-6, 9, 3), expected, rtol=1e-10)


def test_exact_data_are_fitted_to_rounding():
    found = minimise(decay(2.0 * np.exp(-0.7 * X)), [1.0, 1.0], settings=UNKNOWN)
    assert found.status == "converged"
    np.testing.assert_allclose(found.values, [2.0, 0.7], rtol=1e-14)


def test_the_same_bits_twice():
    one, two = (minimise(DECAY, [1.0, 3.0]) for _ in range(2))
    assert one.values.tobytes() == two.values.tobytes()
    assert one.n_linearised == two.n_linearised


# -- points that carry states -----------------------------------------------------------------


@dataclass(frozen=True)
class Track:
    """A point: the shared frequency, and amplitude and phase of every track."""

    rate: float
    local: np.ndarray


class Tracks:
    """a sin(w t + f), a and f of every track its own: eliminated from the linearisation."""

    def __init__(self, targets, sigma=0.01, *, is_shared=True):
        self.targets, self.sigma, self.is_shared = targets, sigma, is_shared

    def values(self, point):
        return np.array([point.rate] if self.is_shared else [])

    def linearise(self, point):
        residuals, columns, steps, responses, rests = [], [], [], [], []
        for target, (a, f) in zip(self.targets, point.local, strict=True):
            sine, cosine = np.sin(point.rate * X + f), np.cos(point.rate * X + f)
            residual = (target - a * sine) / self.sigma
            local = -np.stack([sine, a * cosine], axis=1) / self.sigma
            shared = -(a * X * cosine / self.sigma)[:, None][:, : len(self.values(point))]
            basis, triangle = np.linalg.qr(local)
            along = basis.T @ residual
            rests.append(along @ along)
            steps.append(-np.linalg.solve(triangle, along))
            responses.append(-np.linalg.solve(triangle, basis.T @ shared))
            residuals.append(residual - basis @ along)
            columns.append(shared - basis @ (basis.T @ shared))
        block = np.repeat(np.arange(len(rests)), len(X))
        found = Linearised(
            np.concatenate(residuals), np.concatenate(columns), np.array(rests), block
        )
        object.__setattr__(found, "local", (np.array(steps), np.array(responses)))
        return found

    def move(self, point, linearised, values, share, reins):
        steps, responses = linearised.local
        follow = responses @ (values - self.values(point))
        local = point.local + share * reins[:, None] * steps + follow
        return Track(float(values[0]) if self.is_shared else point.rate, local)


LOCAL = np.array([[1.0, 0.3], [2.0, -0.8], [0.5, 2.0]])
TARGETS = [
    a * np.sin(1.7 * X + f) + 0.01 * np.roll(NOISE, k) for k, (a, f) in enumerate(LOCAL)
]  # fmt: skip


def whole(unknowns):
    local = unknowns[1:].reshape(-1, 2)
    predicted = [a * np.sin(unknowns[0] * X + f) for a, f in local]
    return np.concatenate([(t - p) / 0.01 for t, p in zip(TARGETS, predicted, strict=True)])


@pytest.mark.parametrize("rate", [1.7, 1.5, 1.9])
def test_states_move_along_to_the_joint_minimum(rate):
    start = Track(rate, LOCAL + [0.3, 0.4])
    found = minimise(Tracks(TARGETS), start)
    joint = least_squares(whole, np.append(1.7, LOCAL), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.status == "converged"
    assert found.values[0] == pytest.approx(joint.x[0], abs=1e-7)
    np.testing.assert_allclose(found.point.local, joint.x[1:].reshape(-1, 2), atol=1e-6)
    assert found.chisqr == pytest.approx(2 * joint.cost, rel=1e-9)
    assert found.linearised.rest < 1e-4, "the states are at their optimum, too"


def test_states_far_away_are_brought_in_by_shorter_steps():
    start = Track(1.9, LOCAL + [-0.2, 1.4])  # whole steps of the phases overshoot
    found = minimise(Tracks(TARGETS), start)
    assert found.chisqr <= Tracks(TARGETS).linearise(start).chisqr
    assert found.status == "converged" and found.linearised.rest < 1e-4


class Misled(Tracks):
    """The linearisation of the third track is wrong: its steps lead away from its data."""

    def move(self, point, linearised, values, share, reins):
        moved = super().move(point, linearised, values, share, reins)
        local = moved.local.copy()
        local[2] = point.local[2] - 3.0 * (local[2] - point.local[2])
        return replace(moved, local=local)


def test_a_track_whose_steps_fail_does_not_hold_back_the_others():
    local = np.concatenate([LOCAL, LOCAL[:2] + [0.3, 0.2]])
    targets = [a * np.sin(1.7 * X + f) + 0.01 * np.roll(NOISE, k) for k, (a, f) in enumerate(local)]
    found = minimise(Misled(targets), Track(1.75, local + [0.3, 0.4]))
    assert found.held.tolist() == [False, False, True, False, False]
    assert (found.status, found.code) == ("unconverged", "held")
    right = minimise(Tracks(targets[:2] + targets[3:]), Track(1.75, np.delete(local, 2, axis=0)))
    assert found.values[0] == pytest.approx(right.values[0], abs=1e-6)
    assert found.kept_chisqr == pytest.approx(right.chisqr, rel=1e-6)


def test_states_alone_without_shared_unknowns():
    found = minimise(Tracks(TARGETS, is_shared=False), Track(1.7, LOCAL + [0.3, 0.4]))
    assert found.status == "converged" and found.values.shape == (0,)
    np.testing.assert_allclose(found.point.local, LOCAL, atol=0.05)


@pytest.mark.parametrize("gains", [True, False])
def test_a_fall_within_rounding_is_tried(gains):
    """The bound of what the last digits do is far too wide for some states."""

    class Rounded:
        def values(self, point):
            return np.zeros(0)

        def linearise(self, point):
            rests = np.array([0.1**point if gains else 1.0 + point, 0.0])
            block = np.array([0, 0, 1])
            return Linearised(np.full(3, 1e3), np.zeros((3, 0)), rests, block, rounding=1e6)

        def move(self, point, linearised, values, share, reins):
            return point + 1

    found = minimise(Rounded(), 0)
    assert found.code == "fall"
    if gains:
        assert found.linearised.rest < 1e-3
    else:
        assert found.point == 0 and found.n_linearised <= 3


def test_a_descent_that_gains_nothing_however_short_its_steps_is_given_up():
    class Rising:
        """Its linearisation foresees a fall where chi-squared rises."""

        n_seen = 0

        def values(self, point):
            return point

        def linearise(self, point):
            self.n_seen += 1
            rise = 1.0 + np.abs(point).sum()
            return Linearised(np.full(3, 10.0 * rise), np.eye(3, len(point)) - 2.0)

        def move(self, point, linearised, values, share, reins):
            return values

    problem = Rising()
    found = minimise(problem, np.zeros(2), settings=Settings(max_linearised=60))
    assert (found.status, found.code) == ("unconverged", "stalled")
    assert problem.n_seen < 15


def test_a_kink_in_which_no_step_gains_what_is_foreseen_is_an_end():
    middle = float(np.mean(X + NOISE))

    def kinked(p):  # whichever way it goes, more is left than the slope says
        return np.append(X - p[0] + NOISE, 20.0 + 0.01 * np.abs(p[0] - middle))

    problem = Dense(kinked, lambda p: np.append(-np.ones_like(X), -0.01)[:, None])
    for slight, status in ((1e-6, "converged"), (0.0, "unconverged")):
        settings = Settings(absolute=slight, max_linearised=60)
        found = minimise(problem, [middle], settings=settings)
        assert found.status == status
        assert found.values[0] == pytest.approx(middle, abs=1e-2)


def test_a_descent_that_stays_hopelessly_far_up_is_given_up_after_a_dozen_steps():
    """Rosenbrock's valley: steps gain a little, again and again."""
    valley = Dense(
        lambda p: np.array([1000.0 * (p[1] - p[0] ** 2), 1.0 - p[0], 1e3]),
        lambda p: np.array([[-2000.0 * p[0], 1000.0], [-1.0, 0.0], [0.0, 0.0]]),
    )
    whole = minimise(valley, [-1.2, 1.0], settings=UNKNOWN)
    assert whole.status == "converged" and whole.n_linearised > 20
    found = minimise(valley, [-1.2, 1.0], settings=Settings(absolute=0.0, hopeless=1e5))
    assert (found.status, found.code) == ("unconverged", "limit")
    assert found.n_linearised <= 14
    near = minimise(valley, [-1.2, 1.0], settings=Settings(absolute=0.0, hopeless=1e7))
    assert near.values == pytest.approx(whole.values)
