import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.errors import EvaluationError
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.constants import _descend, fit_constants, linear_columns

TYPES = input_types(PROPERTY_UNITS, up="y")


def law_of(*texts, **constants):
    return ForceLaw([Term(parse_formula(text, TYPES)) for text in texts], constants)


def planted(law, seed=0, noise=0.0, method="one_step", n_times=20):
    """Regressions whose observed accelerations are those of the law, plus noise."""
    rng = np.random.default_rng(seed)
    scenes = []
    for k in range(2):
        crew = tuple(
            Entity(n, properties={"mass": m, "charge": q})
            for n, m, q in zip("abc", rng.uniform(0.5, 2, 3), rng.uniform(1, 3, 3), strict=True)
        )
        positions = rng.uniform(-1, 1, (n_times, 3, 2)) * 0.4 + np.array([[0, 0], [2, 0], [0, 2.5]])
        scenes.append(Scene(f"s{k}", 0.1 * np.arange(n_times), positions, crew))
    regression = build_regression(scenes, method=method, up="y")
    for batch in regression.batches:
        batch.target[:] = regression.predict(batch, law)
        batch.target[:] += noise * rng.standard_normal(batch.target.shape)
    return regression


GRAVITY = "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
WEIGHT = "c2 * m_i * down"
DRAG = "c3 * v_i"


@pytest.mark.parametrize("method", ["one_step", "gls", "weak"])
def test_linear_constants_are_the_least_squares_solution(method):
    true = law_of(GRAVITY, WEIGHT, DRAG, c1=2.0, c2=9.81, c3=-0.4)
    regression = planted(true, noise=0.5, method=method)
    fit = fit_constants(regression, true.with_constants({"c1": 1, "c2": 1, "c3": 1}))
    columns = np.stack(
        [regression.column(Term(parse_formula(text.split(" * ", 1)[1], TYPES)))[0][:, 0]
         for text in (GRAVITY, WEIGHT, DRAG)], axis=1,
    )  # fmt: skip
    best, *_ = np.linalg.lstsq(columns, regression.target(), rcond=None)
    np.testing.assert_allclose(fit.values, best, rtol=1e-9)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(columns.T @ columns), rtol=1e-8)
    residual = regression.target() - columns @ best
    np.testing.assert_allclose(fit.residual, residual, atol=1e-9 * np.abs(residual).max())
    assert fit.loss == pytest.approx(0.5 * residual @ residual, rel=1e-12)
    np.testing.assert_allclose(fit.jacobian, columns, rtol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_closed_form_and_descent_agree(noise):
    true = law_of(GRAVITY, WEIGHT, DRAG, c1=2.0, c2=9.81, c3=-0.4)
    regression = planted(true, noise=noise)
    start = true.with_constants({"c1": 1, "c2": 1, "c3": 1})
    closed = fit_constants(regression, start)
    # All constants left to L-BFGS-B, none solved in closed form.
    loss, values = _descend(regression, start, start.names, np.ones(3), set(start.names))
    np.testing.assert_allclose(values, closed.values, rtol=1e-8)
    assert loss == pytest.approx(closed.loss, rel=1e-10, abs=1e-12)


def test_declared_numbers_stay_and_are_subtracted_first():
    true = law_of("9.81 [m/s^2] * m_i * down", DRAG, c3=-0.4)
    regression = planted(true)
    fit = fit_constants(regression, true.with_constants({"c3": 1.0}))
    np.testing.assert_allclose(fit.values, [-0.4], rtol=1e-10)
    fixed, columns, names = linear_columns(regression, true)
    assert names == (("c3", ""),)
    np.testing.assert_allclose(fixed - 0.4 * columns[:, 0], regression.target(), atol=1e-9)


def test_a_law_without_constants_has_a_loss_all_the_same():
    law = law_of("9.81 [m/s^2] * m_i * down")
    regression = planted(law)
    assert fit_constants(regression, law).loss < 1e-20
    target = regression.target()
    assert fit_constants(regression, ForceLaw()).loss == pytest.approx(0.5 * target @ target)


def test_one_constant_may_multiply_two_terms():
    both = law_of("c1 * m_i * down", "c1 * v_i", c1=1.5)
    fit = fit_constants(planted(both), both.with_constants({"c1": 0.1}))
    np.testing.assert_allclose(fit.values, [1.5], rtol=1e-10)


def test_entities_may_have_constants_of_their_own():
    own = {"a": 1.0, "b": -2.0, "c": 0.25}
    law = law_of(DRAG, WEIGHT, c2=3.0).with_constants({"c3": own})
    regression = planted(law)
    start = law.with_constants({"c3": dict.fromkeys("abc", 1.0), "c2": 1.0})
    fit = fit_constants(regression, start)
    assert fit.parameters == (("c3", "a"), ("c3", "b"), ("c3", "c"), ("c2", ""))
    np.testing.assert_allclose(fit.values, [1, -2, 0.25, 3], rtol=1e-9)
    assert dict(fit.law.constants["c3"]) == pytest.approx(own)


def test_a_term_that_does_nothing_gets_no_constant():
    """A column of zeros: 0 with no error, not a division by zero."""
    law = law_of(GRAVITY, "c2 * m_i * (v_i - v_i)", c1=2.0, c2=1.0)
    fit = fit_constants(planted(law), law)
    np.testing.assert_allclose(fit.values, [2, 0], rtol=1e-10)


def test_proportional_terms_share_what_there_is():
    law = law_of("c1 * v_i", "c2 * v_i / 2", c1=1.0, c2=1.0)
    fit = fit_constants(planted(law), law)
    assert fit.values[0] + fit.values[1] / 2 == pytest.approx(1.5, rel=1e-10)
    assert fit.loss < 1e-18


NONLINEAR = {
    "softened": ("c1 * m_i * m_j / (norm(p_i - p_j)^2 + c2^2) * normalize(p_j - p_i)", 2.0, 0.8),
    "power": ("c1 * m_i * m_j * norm(p_i - p_j)^c2 * normalize(p_j - p_i)", 2.0, -1.7),
    "screened": ("c1 * q_i * q_j * exp(-norm(p_i - p_j) / c2) * normalize(p_i - p_j)", 3.0, 1.4),
    "wave": ("c1 * m_i * sin(c2 * t) * e_x", 1.5, 2.2),
}


@pytest.mark.parametrize("start", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("name", NONLINEAR)
def test_nonlinear_constants_are_recovered_from_several_starts(name, start):
    """The sign of a softening length is free: it occurs squared."""
    text, c1, c2 = NONLINEAR[name]
    true = law_of(text, c1=c1, c2=c2)
    regression = planted(true)
    fit = fit_constants(regression, true.with_constants({"c1": 1.0, "c2": start}), starts=6)
    found = np.abs(fit.values) if name == "softened" else fit.values
    np.testing.assert_allclose(found, [c1, c2], rtol=1e-5)
    assert fit.loss < 1e-9 * np.square(regression.target()).sum()


THREE = {
    "screened power": (
        "c1 * m_i * m_j * exp(-norm(p_i - p_j) / c2) * norm(p_i - p_j)^c3 * normalize(p_i - p_j)",
        [-2.0, 0.9, -1.3],
    ),
    "softened power": (
        "c1 * m_i * m_j / (norm(p_i - p_j)^2 + c2^2)^c3 * normalize(p_i - p_j)",
        [3.0, 0.7, 1.5],
    ),
}


@pytest.mark.parametrize("name", THREE)
def test_three_constants_are_recovered_from_ten_starts(name):
    """As many as a law of the paper may have; two of them not linear."""
    text, values = THREE[name]
    true = law_of(text, **dict(zip(("c1", "c2", "c3"), values, strict=True)))
    start = true.with_constants({"c1": 1.0, "c2": 1.0, "c3": 1.0})
    fit = fit_constants(planted(true), start, starts=10)
    found = np.array([fit.law.constants[n] for n in ("c1", "c2", "c3")])
    found[1] = np.abs(found[1])  # occurs squared
    np.testing.assert_allclose(found, values, rtol=1e-4)


def test_forces_that_overflow_from_both_sides_are_no_warning():
    """inf - inf over two sources is a law without a value, not a crash."""
    law = law_of("c1 * exp(norm(p_i - p_j) * c2) * normalize(p_i - p_j)", c1=1.0, c2=1e4)
    with pytest.raises(EvaluationError):
        planted(law_of("c1 * v_i", c1=1.0)).residual(law)


def test_forces_next_to_nothing_have_no_constant_and_no_warning():
    """A screening length so short that the columns are near the least number there is."""
    law = law_of("c1 * m_i * exp(-(norm(p_i - p_j) / c2)) * e_x", c1=1.0, c2=3.0)
    regression = planted(law)
    distance = min(np.linalg.norm(s.positions[:, 0] - s.positions[:, 1], axis=1).min()
                   for s in regression.scenes)  # fmt: skip
    near = law.with_constants({"c2": distance / 739.0})  # exp(-739) is a subnormal number
    fit = fit_constants(regression, near, starts=10)
    assert np.isfinite([fit.loss, *fit.values]).all()
    with pytest.raises(EvaluationError, match="finite value"):
        fit_constants(regression, near, starts=1)


def test_a_law_next_to_nothing_has_no_linear_constant_either():
    regression = planted(law_of(DRAG, c3=1.0))
    least = min(np.linalg.norm(s.positions[:, 0] - s.positions[:, 1], axis=1).min()
                for s in regression.scenes)  # fmt: skip
    text = f"c1 * m_i * exp(-(norm(p_i - p_j) * {739 / least:.12g} [1/m])) * e_x"
    with pytest.raises(EvaluationError, match="next to nothing"):
        fit_constants(regression, law_of(text, c1=1.0))


def test_starts_far_off_overflow_silently():
    text, c1, c2 = NONLINEAR["power"]
    true = law_of(text, c1=c1, c2=c2)
    fit = fit_constants(planted(true), true.with_constants({"c1": 1.0, "c2": 3.0}), starts=6)
    np.testing.assert_allclose(fit.values, [c1, c2], rtol=1e-5)


@pytest.mark.parametrize("name", NONLINEAR)
def test_jacobian_and_covariance_of_nonlinear_constants(name):
    """The Jacobian against central differences of the residual (error h^2, h = 1e-6)."""
    text, c1, c2 = NONLINEAR[name]
    true = law_of(text, c1=c1, c2=c2)
    regression = planted(true, noise=0.05)
    fit = fit_constants(regression, true)
    for k, constant in enumerate(("c1", "c2")):
        at = fit.law.constants[constant]
        up, down = (
            regression.residual(fit.law.with_constants({constant: at + h})) for h in (1e-6, -1e-6)
        )
        np.testing.assert_allclose(fit.jacobian[:, k], (down - up) / 2e-6, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(
        fit.covariance @ fit.jacobian.T @ fit.jacobian, np.eye(2), atol=1e-8
    )
    # A minimum: the gradient is nothing beside the lengths of its factors.
    size = np.linalg.norm(fit.jacobian, axis=0) * np.linalg.norm(fit.residual)
    assert np.all(np.abs(fit.jacobian.T @ fit.residual) < 1e-5 * size)


def test_more_starts_are_never_worse():
    text, c1, c2 = NONLINEAR["wave"]
    true = law_of(text, c1=c1, c2=c2)
    regression = planted(true)
    start = true.with_constants({"c1": 1.0, "c2": 14.0})
    losses = [fit_constants(regression, start, starts=n).loss for n in (1, 2, 4, 8)]
    assert losses == sorted(losses, reverse=True)


def test_starts_without_a_value_are_skipped_and_none_left_is_an_error():
    law = law_of("c1 * m_i * sqrt(c2) * e_x + c1 * m_i * log(c2) * e_y", c1=1.0, c2=2.0)
    regression = planted(law)
    # From -2 only the start scaled by -1 (the sixth) has a value.
    fit = fit_constants(regression, law.with_constants({"c2": -2.0}), starts=6)
    np.testing.assert_allclose(fit.values, [1, 2], rtol=1e-5)
    with pytest.raises(EvaluationError, match="from any of 5 starts"):
        fit_constants(regression, law.with_constants({"c2": -2.0}), starts=5)
