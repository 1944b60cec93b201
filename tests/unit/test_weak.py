from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.regression import stack_draws
from bsp_gp.physics.weak_tracks import RANK_CUT, Run, Track, _whitener, combs
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.cross_entropy import CrossEntropy
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search
from tests.unit.test_banks_exhaustive import SPLIT, grammar_of

TYPES = input_types(PROPERTY_UNITS, up="y")
BALL = (Entity("ball", properties={"mass": 1.0}),)
ANCHORED = (*BALL, Entity("anchor", is_static=True, properties={"mass": 1.0}))
G, K = 9.8, 0.3


def law_of(*texts, kind="field", **constants):
    return ForceLaw([Term(parse_formula(text, TYPES), kind) for text in texts], constants)


BOUNCE = (
    "c1 * m_i * m_j / (m_i + m_j) * (abs(dot(v_i - v_j, e_x) * dot(normalize(p_i - p_c), e_x)) "
    "+ abs(dot(v_i - v_j, e_y) * dot(normalize(p_i - p_c), e_y))) "
    "* normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)"
)
PUSH = law_of("c1 * m_i * e_y", "c2 * m_i * e_x", c1=1.0, c2=1.0)
DRAG = law_of("c1 * m_i * e_y", "c2 * v_i", c1=1.0, c2=1.0)
SPRING = law_of("c1 * (p_j - p_i)", kind="pair", c1=1.0)


def uneven(n, span=6.0, seed=0):
    """Times with steps that differ by a factor of up to two."""
    steps = np.random.default_rng(seed).uniform(0.7, 1.4, n - 1)
    return np.concatenate([[0.0], np.cumsum(steps)]) * span / steps.sum()


def falling(t):
    """Gravity and linear drag, in closed form."""
    limit = np.array([0.0, -G / K])
    return (np.array([3.0, 4.0]) - limit) * (1 - np.exp(-K * t)[:, None]) / K + limit * t[:, None]


def noisy(t, p, sigma, rng, crew=BALL, quoted=None):
    """A scene with white noise on the first body."""
    positions = p[:, None] + sigma * rng.standard_normal((len(t), 1, 2))
    if len(crew) > 1:
        positions = np.concatenate([positions, np.zeros_like(positions)], axis=1)
    return Scene("s", t, positions, crew, sigma=quoted)


def weak(scene, sigma=1e-6, **settings):
    return build_regression([scene], method="weak", sigma=sigma, **settings)


def lost(scene, rows):
    positions = np.array(scene.positions)
    positions[rows] = np.nan
    return Scene(scene.name, scene.times, positions, scene.entities, sigma=scene.sigma)


# --- exact recovery ------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(8, 40),
    push=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    width=st.sampled_from([None, 0.0, 1.0, 3.0]),
)
@settings(max_examples=60, deadline=None)
def test_parabolas_are_exact_on_uneven_times_with_gaps(seed, n, push, width):
    """Whatever the times: nothing of a constant force is left to quadrature."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.05, 0.3, n))
    p = np.array([1.0, -2.0]) + np.array([0.5, 3.0]) * t[:, None]
    p = p + np.array([push[1], push[0]]) / 2 * t[:, None] ** 2
    scene = Scene("s", t, p[:, None], BALL)
    if n > 14:
        scene = lost(scene, rng.choice(np.arange(6, n - 1), 3, replace=False))
    regression = weak(scene, sigma=1e-3, width=width)
    found = fit_constants(regression, PUSH)
    scale = 1 + max(abs(x) for x in push)
    np.testing.assert_allclose(found.values, push, atol=1e-7 * scale)


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(3, 40),
    spacing=st.floats(0.05, 5.0),
    is_measured=st.booleans(),
)
@example(seed=36, n=17, spacing=0.296875, is_measured=False)  # a condition of 1.5e10
@example(seed=3618, n=3, spacing=0.0546875, is_measured=False)  # nothing but straight motion
@settings(max_examples=100, deadline=None)
def test_combs_are_blind_to_straight_motion_whatever_the_times(seed, n, spacing, is_measured):
    """Of measured velocities, to constant ones; few or many rows between knots."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.exponential(0.2, n) + 0.01)
    comb = combs(t, spacing, rng.uniform(0.1, 10.0, n), is_measured)
    size = np.linalg.norm(comb, axis=1, keepdims=True)
    assert np.all(size > 0)
    straight = np.ones((n, 1)) if is_measured else np.stack([np.ones(n), t / t[-1]], axis=1)
    np.testing.assert_allclose(comb / size @ straight, 0.0, atol=1e-13 * n)
    # Of more combs than there are rows to tell them apart by, the rest are left out.
    run = Run(np.arange(n), np.arange(n) if is_measured else np.arange(1, n - 1))
    track = Track.of(t, [run], spacing, np.ones(n), is_measured=is_measured)
    assert len(track.observe) <= len(straight) - straight.shape[1]
    # Whitened by solving with a triangle, which loses as many digits as its condition has; that
    # is bounded by the cut below which test functions count as dependent.
    unit = combs(t, spacing, np.ones(n), is_measured)
    whitener, _ = _whitener(unit / np.linalg.norm(unit, axis=1, keepdims=True))
    condition = np.linalg.cond(whitener) if len(whitener) else 1.0
    assert condition < n / RANK_CUT
    np.testing.assert_allclose(
        track.observe @ track.observe.T, np.eye(len(track.observe)),
        atol=n**1.5 * np.finfo(float).eps * condition,
    )  # fmt: skip


@pytest.mark.parametrize("width", [0.0, 0.8])
def test_harmonic_motion_is_recovered_to_the_order_of_the_quadrature(width):
    """Law of position on uneven times with gaps: halved steps leave a 16th of the error or less."""
    errors = []
    for n in (40, 80, 160):
        t = uneven(n)
        p = np.stack([np.cos(2 * t + 0.3), np.sin(2 * t)], axis=1)
        scene = noisy(t, p, 0.0, np.random.default_rng(0), ANCHORED)
        scene = lost(scene, [n // 3, n // 2, n // 2 + 1])
        found = fit_constants(weak(scene, width=width), SPRING)
        errors.append(abs(found.values[0] - 4.0))
    # Fourth order; times are drawn anew for every n, so that a factor of two is left to chance.
    assert errors[2] < 2 * errors[0] / 16**2 * 2
    assert errors[2] < 1e-4


def test_smooth_motion_with_drag_is_recovered_by_wide_test_functions():
    errors = []
    for n in (40, 80, 160):
        t = uneven(n)
        found = fit_constants(weak(Scene("s", t, falling(t)[:, None], BALL), width=6.0), DRAG)
        errors.append(np.abs(found.values - [-G, -K]))
    assert np.all(errors[-1] < [1e-4, 1e-5])


def test_impulses_between_rows_need_no_quadrature_of_the_track():
    """A kink is seen as the impulse times the test function, linear between rows, where it is."""
    t = uneven(41)
    kick, push = 3.217, 2.0
    p = np.stack([np.maximum(t - kick, 0.0) * push, np.zeros_like(t)], axis=1)
    scene = Scene("s", t, p[:, None], BALL)
    (batch,) = build_regression(
        [scene], method="one_step_weak", sigma=1.0, width=2.0, sources=False
    ).batches
    # By steps, a force acts at rows: column k of the whitener is (test function) x (mean step).
    values = batch.whitener / ((t[2:] - t[:-2]) / 2)
    padded = np.pad(values, ((0, 0), (1, 1)))
    at = [np.interp(kick, t, function) for function in padded]
    seen = batch.observed[: len(values), 0, 0, 0]
    np.testing.assert_allclose(seen, push * np.array(at), atol=1e-9 * np.abs(seen).max())


def test_contacts_inside_a_support_are_fine_where_the_law_has_them(shared_data):
    """BOUNCE, made by steps: test functions of eleven rows, most with collisions inside."""
    dataset = load_dataset(shared_data / "synth" / "bounce")
    law = ForceLaw([Term(parse_formula(BOUNCE, dataset_types(dataset)), "pair")], {"c1": 1.0})
    scenes = dataset.scenes[:3]
    step = float(np.diff(scenes[0].times)[0])
    regression = build_regression(scenes, method="one_step_weak", sigma=1.0, width=11 * step)
    assert regression.widths.rows == pytest.approx(11)
    assert regression.n_rows < 0.8 * build_regression(scenes, method="gls").n_rows
    fit = fit_constants(regression, law)
    # The data are written with about ten digits after a second difference.
    assert np.sqrt(2 * fit.loss) < 1e-7 * np.linalg.norm(regression.target())
    without = np.linalg.norm(regression.target()) / np.sqrt(regression.n_rows)
    assert without > 0.01


# --- symmetries ----------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 10_000),
    shift=st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
    angle=st.floats(-3, 3),
    width=st.sampled_from([0.0, 1.5]),
)
@settings(max_examples=10, deadline=None)
def test_shifts_change_nothing_and_turns_turn_the_residual(seed, shift, angle, width):
    rng = np.random.default_rng(seed)
    t = uneven(30, seed=seed)
    scene = noisy(t, falling(t), 0.05, rng, ANCHORED)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    positions = scene.positions @ turn.T + np.array(shift)
    moved = Scene("s", t, positions, ANCHORED)
    law = SPRING.with_constants({"c1": 2.5}).plus(law_of("c2 * v_i").terms[0], {"c2": -0.3})
    residuals = [
        weak(one, sigma=0.05, width=width).residual(law).reshape(-1, 2) for one in (scene, moved)
    ]
    size = np.abs(residuals[0]).max()
    np.testing.assert_allclose(residuals[1], residuals[0] @ turn.T, atol=1e-6 * size)


def test_without_a_noise_level_the_width_is_that_of_the_estimated_one():
    t = uneven(80)
    scene = noisy(t, falling(t), 0.05, np.random.default_rng(2))
    level = estimate_noise([scene]).sigma
    unsaid, said = weak(scene, sigma=None), weak(scene, sigma=level)
    assert unsaid.widths.spacing == said.widths.spacing
    np.testing.assert_array_equal(unsaid.sigma, 1.0)


def test_the_chosen_width_does_not_depend_on_units_or_place():
    rng = np.random.default_rng(1)
    t = uneven(60)
    scene = noisy(t, falling(t), 0.02, rng)
    base = weak(scene, sigma=0.02).widths
    other = Scene("s", 60 * t, 100 * scene.positions + 7, BALL)
    scaled = weak(other, sigma=2.0).widths
    assert scaled.rows == pytest.approx(base.rows, rel=1e-6)
    assert scaled.seconds == pytest.approx(60 * base.seconds, rel=1e-6)
    assert scaled.n_functions == base.n_functions


# --- noise ---------------------------------------------------------------------------------------


def whitened(sigma, n_draws, quoted=None, gap=False, width=None, seed=0):
    """Whitened residuals under the true law (constant force), one row per draw."""
    t = uneven(40)
    p = np.array([1.0, -G]) / 2 * t[:, None] ** 2
    scenes = []
    for rng in np.random.default_rng(seed).spawn(n_draws):
        scene = noisy(t, p, sigma if quoted is None else quoted, rng, quoted=quoted)
        scene = lost(scene, [11, 20, 21, 22]) if gap else scene
        scenes.append(replace(scene, name=f"{len(scenes)}"))
    regression = build_regression(scenes, method="weak", sigma=sigma, width=width)
    residual = regression.residual(law_of("-9.8 * m_i * e_y", "1 * m_i * e_x"))
    (batch,) = regression.batches
    residual = np.moveaxis(residual.reshape(batch.target.shape), 1, 0).reshape(n_draws, -1)
    kept = np.moveaxis(batch.kept, 1, 0).reshape(n_draws, -1)
    assert regression.n_rows == kept.sum()
    return residual[:, kept[0]]


@pytest.mark.parametrize(
    ("width", "gap"), [(0.0, False), (0.0, True), (1.5, False), (1.5, True), (6.0, False)]
)
def test_whitened_residuals_are_white(width, gap):
    """Unit variance and no correlation, to five standard errors of 400 draws."""
    z = whitened(0.05, 400, gap=gap, width=width)
    covariance = z.T @ z / len(z)
    tolerance = 5 * np.sqrt(2 / len(z))
    np.testing.assert_allclose(np.diag(covariance), 1.0, atol=tolerance)
    np.testing.assert_allclose(covariance - np.diag(np.diag(covariance)), 0.0, atol=tolerance)


def test_quoted_errors_whiten_row_by_row_and_axis_by_axis():
    rng = np.random.default_rng(5)
    quoted = rng.uniform(0.01, 0.3, size=(40, 1, 2)) * np.array([1.0, 4.0])
    z = whitened(1.0, 400, quoted=quoted, width=2.0)
    covariance = z.T @ z / len(z)
    np.testing.assert_allclose(covariance, np.eye(z.shape[1]), atol=5 * np.sqrt(2 / len(z)))


def test_rows_quoted_as_bad_weigh_little():
    """A row that is far off and says so changes nothing; unsaid it spoils the fit."""
    t = uneven(40)
    p = np.array([1.0, -G])[:, None].T / 2 * t[:, None] ** 2
    p[17] += 3.0
    quoted = np.full((40, 1, 2), 0.01)
    plain = fit_constants(weak(Scene("s", t, p[:, None], BALL), sigma=0.01, width=3.0), PUSH)
    quoted[17] = 1e4
    said = Scene("s", t, p[:, None], BALL, sigma=quoted)
    told = fit_constants(weak(said, sigma=0.01, width=3.0), PUSH)
    np.testing.assert_allclose(told.values, [-G, 1.0], atol=1e-5)
    assert np.abs(plain.values - [-G, 1.0]).max() > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [1e-3, 0.03, 0.3])
def test_coefficients_are_unbiased_and_their_errors_calibrated(sigma):
    """Gravity and drag on uneven times: 80 draws at each noise level."""
    t = uneven(50)
    scores = []
    for rng in np.random.default_rng(11).spawn(80):
        fit = fit_constants(weak(noisy(t, falling(t), sigma, rng), sigma=sigma), DRAG)
        scores.append((fit.values - [-G, -K]) / np.sqrt(np.diag(fit.covariance)))
    scores = np.array(scores)
    # Five standard errors of the mean and of the standard deviation of 80 draws.
    np.testing.assert_allclose(scores.mean(axis=0), 0.0, atol=5 / np.sqrt(80))
    np.testing.assert_allclose(scores.std(axis=0), 1.0, atol=5 / np.sqrt(160))


def test_narrow_test_functions_are_generalised_least_squares():
    """On even times but for the quadrature; of a constant force exactly, errors included."""
    rng = np.random.default_rng(3)
    t = np.linspace(0, 6, 60)
    scene = noisy(t, falling(t), 0.02, rng)
    fits = [
        fit_constants(build_regression([scene], method=method, sigma=0.02, **more), PUSH)
        for method, more in (("gls", {}), ("weak", {"width": 0.0}))
    ]
    np.testing.assert_allclose(fits[1].values, fits[0].values, rtol=1e-9)
    np.testing.assert_allclose(fits[1].covariance, fits[0].covariance, rtol=1e-9)
    assert fits[1].loss == pytest.approx(fits[0].loss, rel=1e-9)


def test_chosen_widths_lose_nothing_against_generalised_least_squares():
    """A constant force: the same estimate within a small part of its error, with fewer rows."""
    t = uneven(60)
    apart = []
    for rng in np.random.default_rng(4).spawn(20):
        p = np.array([1.0, -G]) / 2 * t[:, None] ** 2
        scene = noisy(t, p, 0.1, rng)
        fine = fit_constants(build_regression([scene], method="gls", sigma=0.1), PUSH)
        regression = weak(scene, sigma=0.1)
        wide = fit_constants(regression, PUSH)
        errors = np.sqrt(np.diag(fine.covariance))
        np.testing.assert_allclose(np.sqrt(np.diag(wide.covariance)), errors, rtol=0.02)
        apart.append((wide.values - fine.values) / errors)
        assert regression.n_rows < 0.5 * 2 * 58
    assert np.sqrt(np.mean(np.square(apart))) < 0.2


def test_the_loss_has_as_many_degrees_of_freedom_as_rows():
    """BIC and evidence count n_rows: the loss of the true law is half a chi-squared of them."""
    z = whitened(0.05, 300, width=1.5)
    sums = np.square(z).sum(axis=1)
    assert stats.kstest(sums, stats.chi2(z.shape[1]).cdf).pvalue > 1e-3
    t = uneven(40)
    regression = weak(Scene("s", t, falling(t)[:, None], BALL), width=1.5)
    assert regression.n_rows == z.shape[1] == regression.widths.n_functions


def test_widths_follow_the_corner_between_signal_and_noise():
    t = np.linspace(0, 6, 200)
    fast = np.stack([np.sin(12 * t), np.cos(12 * t)], axis=1)
    slow = np.stack([np.sin(2 * t), np.cos(2 * t)], axis=1)
    rng = np.random.default_rng(6)
    rows = {}
    for name, track in (("fast", fast), ("slow", slow)):
        for sigma in (1e-4, 1e-1):
            rows[name, sigma] = weak(noisy(t, track, sigma, rng), sigma=sigma).widths.rows
    assert rows["fast", 1e-4] < rows["fast", 1e-1] < rows["slow", 1e-1]
    assert rows["slow", 1e-4] < rows["slow", 1e-1]


# --- measured velocities -------------------------------------------------------------------------


@pytest.mark.slow
def test_measured_velocities_are_integrated_by_parts_once():
    t = uneven(60)
    p = falling(t)
    limit = np.array([0.0, -G / K])
    v = (np.array([3.0, 4.0]) - limit) * np.exp(-K * t)[:, None] + limit
    scores = []
    for rng in np.random.default_rng(8).spawn(60):
        seen = v + 0.05 * rng.standard_normal(v.shape)
        scene = Scene("s", t, p[:, None], BALL, velocities=seen[:, None])
        regression = weak(scene, sigma=0.05, velocity="measured")
        fit = fit_constants(regression, PUSH.without(1).plus(DRAG.terms[1], {"c2": 1.0}))
        scores.append((fit.values - [-G, -K]) / np.sqrt(np.diag(fit.covariance)))
    # Laws are evaluated at the measured velocities, whose noise is not in the covariance.
    assert np.all(np.abs(np.mean(scores, axis=0)) < 1.0)
    exact = Scene("s", t, p[:, None], BALL, velocities=v[:, None])
    fit = fit_constants(weak(exact, sigma=1e-6, velocity="measured", width=0.0), DRAG)
    np.testing.assert_allclose(fit.values, [-G, -K], rtol=1e-6)


# --- the interface -------------------------------------------------------------------------------


def test_columns_gradients_and_residuals_agree():
    rng = np.random.default_rng(9)
    scenes = []
    for k, n in enumerate((30, 22)):
        t = uneven(n, seed=k)
        one = noisy(t, falling(t), 0.05, rng, ANCHORED)
        scenes.append(Scene(f"s{k}", t, one.positions, ANCHORED))
    regression = build_regression(scenes, method="weak", sigma=0.05)
    term = Term(parse_formula("norm(v_i) * v_i", TYPES), "field")
    column, _ = regression.column(term)
    law = law_of("c1 * norm(v_i) * v_i", c1=-0.3)
    np.testing.assert_allclose(
        regression.residual(law), regression.target() + 0.3 * column[:, 0], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(
        regression.gradient(law, law.terms[0])["c1"], column[:, 0], rtol=1e-12
    )
    doubled = stack_draws([regression, regression], [1.0, 3.0])
    residual = regression.residual(law)
    assert np.square(doubled.residual(law)).sum() == pytest.approx(residual @ residual)


def test_all_searches_run_on_it():
    """Each finds the planted law among the little grammar's, and all agree on its loss."""
    grammar = grammar_of(SPLIT)
    rng = np.random.default_rng(12)
    t = uneven(60)
    drop = np.stack([8 * (1 - np.exp(-K * t)), 5 * (1 - np.exp(-K * t))], axis=1) / K
    crew = (Entity("ball", properties={"mass": 2.0}), ANCHORED[1])
    scene = noisy(t, drop, 0.01, rng, crew)
    regression = weak(scene, sigma=0.01)
    best = search_exhaustive(regression, grammar, kind="field", max_levels=6).best
    assert to_text(best.formula) == "c1 * (norm(v_i) * normalize(v_i))"
    assert best.constants["c1"] == pytest.approx(-2.0 * K, rel=0.01)
    assert best.loss < 0.5 * stats.chi2(regression.n_rows).isf(1e-4)
    objective = Objective(regression, grammar, "field", beta=1.0)
    for strategy in (CrossEntropy(population=100, elite=10), Genetic(population=25, offspring=60)):
        result = run_search(strategy, objective.fresh(), Budget(n_steps=6), rng=rng)
        assert result.best.loss == pytest.approx(best.loss, rel=1e-9)


def test_lost_rows_and_rows_that_are_missing_are_the_same():
    t = uneven(40)
    rng = np.random.default_rng(10)
    scene = noisy(t, falling(t), 0.02, rng)
    keep = np.setdiff1d(np.arange(40), [12, 25, 26])
    short = Scene("s", t[keep], scene.positions[keep], BALL)
    fits = [
        fit_constants(weak(one, sigma=0.02, width=2.0), DRAG)
        for one in (lost(scene, [12, 25, 26]), short)
    ]
    np.testing.assert_allclose(fits[0].values, fits[1].values, rtol=1e-6)


@pytest.mark.parametrize("n", [3, 4])
def test_too_few_rows_are_refused_with_a_remedy(n):
    t = np.arange(n) * 0.1
    with pytest.raises(DataError, match="rows in succession") as caught:
        weak(Scene("s", t, falling(t)[:, None], BALL))
    assert caught.value.remedy


def test_one_frame_is_refused_with_a_remedy():
    with pytest.raises(DataError, match="at least 3") as caught:
        weak(Scene("s", np.zeros(1), np.zeros((1, 1, 2)), BALL))
    assert caught.value.remedy


def test_tracks_that_are_all_gaps_are_refused_with_a_remedy():
    t = np.arange(60) * 0.1
    scene = lost(Scene("s", t, falling(t)[:, None], BALL), slice(None))
    for sigma in (1e-6, None):
        with pytest.raises(DataError, match="rows in succession") as caught:
            weak(scene, sigma=sigma)
        assert caught.value.remedy
    with pytest.raises(DataError, match="velocit") as caught:
        weak(Scene("s", t, falling(t)[:, None], BALL), velocity="measured")
    assert caught.value.remedy


def test_noise_with_a_memory_is_refused():
    t = uneven(20)
    scene = noisy(t, falling(t), 0.0, np.random.default_rng(0))
    with pytest.raises(SettingsError, match=r"white, and a memory of 0\.5 s"):
        weak(scene, memory=0.5)
