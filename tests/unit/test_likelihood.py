import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.errors import DataError, EvaluationError, SettingsError
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.differences import difference_weights
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import METHODS, build_regression
from bsp_gp.physics.metrics import one_step_errors, one_step_nrmse, residual_acceleration
from bsp_gp.physics.regression import stack_draws

TYPES = input_types(PROPERTY_UNITS, up="y")
LAW_TEXTS = ("m_i * m_j * (p_j - p_i) / norm(p_j - p_i)^3", "c1 * norm(v_i) * v_i", "m_i * t * e_x")


def law_of(*texts, **constants):
    return ForceLaw([Term(parse_formula(text, TYPES)) for text in texts], constants)


LAW = law_of(*LAW_TEXTS, c1=-0.3)


def ball(name, mass, is_static=False):
    return Entity(name, is_static=is_static, properties={"mass": mass})


def scene_of(seed, n_times=12, irregular=True, name=None, static_moves=False):
    """Random tracks: nothing that a law would explain is needed here."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.05, 0.2, n_times) if irregular else np.full(n_times, 0.125)
    crew = (ball("a", 1.5), ball("b", 0.7), ball("wall", 2.0, is_static=True))
    positions = rng.normal(size=(n_times, 3, 2)) + np.array([[0, 0], [6, 0], [0, 6]])
    drift = np.arange(n_times)[:, None] if static_moves else 0.0  # jitter alone would be none
    positions[:, 2] = positions[0, 2] + drift
    return Scene(name or f"s{seed}", np.cumsum(steps), positions, crew)


def by_hand(scene, law_terms=True, c1=-0.3):
    """The paper's one-step prediction, one body and instant at a time."""
    t, p, crew = scene.times, scene.positions, scene.entities
    errors = np.zeros((len(t) - 2, 2, 2))
    for k in range(1, len(t) - 1):
        for i in range(2):
            v = (p[k, i] - p[k - 1, i]) / (t[k] - t[k - 1])
            force = np.zeros(2)
            if law_terms:
                for j in range(3):
                    if j != i:
                        r = p[k, j] - p[k, i]
                        force += crew[i].mass * crew[j].mass * r / np.linalg.norm(r) ** 3
                force += c1 * np.linalg.norm(v) * v + crew[i].mass * t[k] * np.array([1, 0])
            h = t[k + 1] - t[k]
            # On an even grid the step is v' = v + a h; on an uneven one the backward difference
            # is the velocity half a step earlier, and a acts over the mean of the two steps.
            v = v + force / crew[i].mass * (h + t[k] - t[k - 1]) / 2
            errors[k - 1, i] = p[k + 1, i] - (p[k, i] + v * h)
    return errors


@pytest.mark.parametrize("irregular", [False, True])
def test_one_step_is_the_papers_definition(irregular):
    scenes = [scene_of(seed, irregular=irregular) for seed in (1, 2)]
    sigma = np.array([0.5, 2.0])
    regression = build_regression(scenes, sigma=sigma)
    residual = regression.residual(LAW).reshape(10, 2, 2, 2)  # instant, scene, body, axis
    for s, scene in enumerate(scenes):
        np.testing.assert_allclose(residual[:, s], by_hand(scene) / sigma, rtol=1e-10, atol=1e-11)


def test_nrmse_is_the_mean_euclidean_error_over_entities_static_ones_included():
    scenes = [scene_of(1), scene_of(2, n_times=9)]
    expected = [np.linalg.norm(by_hand(scene), axis=-1) for scene in scenes]
    found = one_step_errors(scenes, LAW)
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_allclose(one[:, :2], two, rtol=1e-10)
        assert not one[:, 2].any()
    mean = np.mean([e.sum(axis=1).mean() / 3 for e in expected])
    assert one_step_nrmse(scenes, LAW) == pytest.approx(mean, rel=1e-12)
    still = [np.linalg.norm(by_hand(scene, law_terms=False), axis=-1) for scene in scenes]
    mean = np.mean([e.sum(axis=1).mean() / 3 for e in still])
    assert one_step_nrmse(scenes, ForceLaw()) == pytest.approx(mean, rel=1e-12)


def second_difference_covariance(times):
    """Of second divided differences (acceleration) of white positions, element by element."""
    n = len(times) - 2
    rows = np.zeros((n, n + 2))
    for k in range(n):
        a, b = times[k + 1] - times[k], times[k + 2] - times[k + 1]
        rows[k, k : k + 3] = 2 / (a * (a + b)), -2 / (a * b), 2 / (b * (a + b))
    return rows @ rows.T


@pytest.mark.parametrize("irregular", [False, True])
def test_gls_whitens_the_covariance_of_second_differences(irregular):
    scene = scene_of(3, n_times=25, irregular=irregular)
    (batch,) = build_regression([scene], method="gls").batches
    covariance = second_difference_covariance(scene.times)
    if not irregular:  # the banded matrix (6, -4, 1) / h^4
        np.testing.assert_allclose(covariance[5, 3:8] * 0.125**4, [1, -4, 6, -4, 1], rtol=1e-12)
    white = batch.whitener @ covariance @ batch.whitener.T
    # The covariance has the condition number n^4, about 4e5.
    np.testing.assert_allclose(white, np.eye(23), atol=1e-9)


def positions_with_free_states(scene, accelerations, body):
    """Sum of squares of positions about the best x0 + v0 t + double sum of accelerations."""
    t = scene.times
    bend = np.zeros_like(scene.positions[:, body])
    for k in range(1, len(t) - 1):
        a, b = t[k] - t[k - 1], t[k + 1] - t[k]
        slope = (bend[k] - bend[k - 1]) / a + accelerations[k - 1] * (a + b) / 2
        bend[k + 1] = bend[k] + b * slope
    design = np.stack([np.ones_like(t), t - t.mean()], axis=1)
    target = scene.positions[:, body] - bend
    best = np.linalg.lstsq(design, target, rcond=None)[0]
    return np.square(target - design @ best)


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("law", [ForceLaw(), LAW], ids=["no force", "law"])
def test_gls_is_least_squares_of_positions_under_free_initial_states(irregular, law):
    scene = scene_of(4, n_times=20, irregular=irregular)
    sigma = np.array([0.5, 2.0])
    regression = build_regression([scene], method="gls", sigma=sigma)
    (batch,) = regression.batches
    accelerations = regression.predict(batch, law)[:, 0]
    expected = sum(
        (positions_with_free_states(scene, accelerations[:, i], i) / sigma**2).sum() for i in (0, 1)
    )
    residual = regression.residual(law)
    assert residual @ residual == pytest.approx(expected, rel=1e-9)


def test_gls_velocities_are_of_second_order_at_uneven_times():
    """Central differences that are exact for parabolas; and accelerations too."""
    t = np.cumsum([0.1, 0.2, 0.05, 0.4, 0.1, 0.3])
    p = np.stack([1 + 2 * t - 3 * t**2, 0.5 * t**2], axis=-1)[:, None]
    scene = Scene("s", t, p, (ball("a", 1.0),))
    (batch,) = build_regression([scene], method="gls").batches
    inner = t[1:-1]
    speed = np.stack([2 - 6 * inner, inner], axis=-1)
    np.testing.assert_allclose(batch.velocities[:, 0, 0], speed, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(batch.target[:, 0, 0], np.tile([-6, 1], (4, 1)), rtol=1e-11)


def with_gap(scene, row, body, value=np.nan):
    positions = scene.positions.copy()
    positions[row, body] = value
    return Scene(scene.name, scene.times, positions, scene.entities)


@pytest.mark.parametrize("method", ["one_step", "gls"])
def test_gaps_take_out_the_rows_that_need_them(method):
    """A lost row takes out three instants of its body; of other bodies only where they see it."""
    scene = with_gap(scene_of(5), 5, 0)
    (alone,) = build_regression([scene], method=method, sources=False).batches
    lost = {0: [3, 4, 5], 1: []}
    for body, rows in lost.items():
        expected = np.ones(10, dtype=bool)
        expected[rows] = False
        np.testing.assert_array_equal(alone.valid[:, 0, body].all(axis=-1), expected)
    (seen,) = build_regression([scene], method=method).batches
    # Without its place or its velocity a body is no source: with a backward difference at the
    # lost row and after it, with a central one before it as well.
    unseen = np.ones(10, dtype=bool)
    unseen[{"one_step": [4, 5], "gls": [3, 4, 5]}[method]] = False
    np.testing.assert_array_equal(seen.valid[:, 0, 1].all(axis=-1), unseen)


def test_gls_whitens_what_a_gap_leaves():
    scene = with_gap(scene_of(6, n_times=20), 7, 0)
    regression = build_regression([scene], method="gls", sources=False)
    (batch,) = regression.batches
    covariance = second_difference_covariance(scene.times)
    for body in (0, 1):
        keep = batch.valid[:, 0, body].any(axis=-1)
        assert keep.sum() == (15 if body == 0 else 18)
        block = batch.whitener[0, body]
        assert not block[~keep].any() and not block[:, ~keep].any()
        white = block @ covariance @ block.T
        np.testing.assert_allclose(white, np.diag(keep.astype(float)), atol=1e-9)
    # The rows before and after the gap share no position: two fits with states of their own.
    force = law_of("c1 * norm(v_i) * v_i", c1=-0.3)
    accelerations = regression.predict(batch, force)[:, 0, 0]
    expected = 0.0
    for part in (slice(0, 7), slice(8, 20)):
        piece = Scene("p", scene.times[part], scene.positions[part], scene.entities)
        inner = accelerations[part.start : part.stop - 2]
        expected += positions_with_free_states(piece, inner, 0).sum()
    mine = regression.residual(force).reshape(18, 2, 2)[:, 0]
    assert np.square(mine).sum() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("method", ["one_step", "gls"])
def test_padded_scenes_count_as_if_alone(method):
    scenes = [scene_of(7, n_times=12), scene_of(8, n_times=7)]
    together = build_regression(scenes, method=method)
    alone = [build_regression([scene], method=method) for scene in scenes]
    assert together.n_rows == sum(part.n_rows for part in alone) == (10 + 5) * 2 * 2
    squares = [np.square(r.residual(LAW)).sum() for r in (together, *alone)]
    assert squares[0] == pytest.approx(squares[1] + squares[2], rel=1e-12)


def test_an_axis_without_noise_estimate_is_left_out():
    scene = scene_of(9)
    regression = build_regression([scene], sigma=[np.nan, 0.1])
    assert regression.n_rows == 10 * 2
    residual = regression.residual(LAW).reshape(10, 2, 2)
    assert not residual[..., 0].any()
    expected = by_hand(scene)[..., 1] / 0.1
    np.testing.assert_allclose(residual[..., 1], expected, rtol=1e-9, atol=1e-10)


def test_velocities_of_entities_that_stand_still_are_exactly_zero_and_of_moving_ones_are_not():
    for moves in (False, True):
        (batch,) = build_regression([scene_of(10, static_moves=moves)]).batches
        assert bool(batch.velocities[:, 0, 2].any()) is moves
        assert batch.target.shape[2] == 2


def test_columns_gradients_and_residuals_agree():
    """residual(c) = target - sum of c * column, exactly linear in c1."""
    scenes = [scene_of(11), scene_of(12, n_times=8)]
    regression = build_regression(scenes, method="gls", sigma=0.3)
    term = Term(parse_formula("norm(v_i) * v_i", TYPES))
    column, names = regression.column(term)
    assert names == ("",)
    law = law_of("c1 * norm(v_i) * v_i", c1=-0.3)
    np.testing.assert_allclose(
        regression.residual(law), regression.target() + 0.3 * column[:, 0], rtol=1e-12, atol=1e-9
    )
    gradient = regression.gradient(law, law.terms[0])
    np.testing.assert_allclose(gradient["c1"], column[:, 0], rtol=1e-12)
    own, names = regression.column(term, per_entity=True)
    assert names == ("a", "b")
    np.testing.assert_allclose(own.sum(axis=1), column[:, 0], rtol=1e-12)
    assert not np.any(own[:, 0] * own[:, 1])


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_difference_weights_are_exact_for_polynomials(order):
    """Up to the degree that the number of points determines, on uneven grids."""
    rng = np.random.default_rng(13)
    for n in (order + 1, order + 2, 7, 11):
        x = np.sort(rng.uniform(-1, 1, n)) * 1e-2 + 3e-3
        weights = difference_weights(x, order)
        for degree in range(n):
            exact = np.prod(np.arange(1, order + 1)) if degree == order else 0.0
            terms = weights * (x / 1e-2) ** degree * 1e-2**order
            # Rounding of a sum of terms of both signs.
            assert abs(terms.sum() - exact) < 1e-13 * np.abs(terms).sum() * n + 1e-13


def test_difference_weights_of_the_textbook():
    np.testing.assert_allclose(difference_weights(np.array([-1.0, 0, 1]), 1), [-0.5, 0, 0.5])
    np.testing.assert_allclose(
        difference_weights(np.arange(-2.0, 3), 2), np.array([-1, 16, -30, 16, -1]) / 12, atol=1e-15
    )


def orbit(n_times=60, velocities=True):
    """Two bodies on circles about their centre of mass, masses 3 and 1, distance 2."""
    separation, masses = 2.0, np.array([3.0, 1.0])
    omega = np.sqrt(masses.sum() / separation**3)
    t = np.linspace(0, 4, n_times)
    u = np.stack([np.cos(omega * t), np.sin(omega * t)], axis=-1)
    w = omega * np.stack([-u[:, 1], u[:, 0]], axis=-1)
    radii = separation * np.array([-masses[1], masses[0]]) / masses.sum()
    crew = (ball("sun", masses[0]), ball("planet", masses[1]))
    return Scene(
        "orbit", t, radii[:, None] * u[:, None], crew,
        radii[:, None] * w[:, None] if velocities else None,
    )  # fmt: skip


GRAVITY = law_of("m_i * m_j / norm(p_j - p_i)^2 * normalize(p_j - p_i)")


def test_derivative_of_measured_velocities():
    """Tenth order: (omega h)^10 / 2772 of an acceleration of 0.75, far below rounding (1e-13)."""
    regression = build_regression([orbit()], method="derivative", velocity="measured")
    assert regression.n_rows == (60 - 10) * 2 * 2
    assert residual_acceleration(regression, GRAVITY) < 1e-12
    rms = np.sqrt((0.25**2 + 0.75**2) / 2)
    assert residual_acceleration(regression, ForceLaw()) == pytest.approx(rms, rel=1e-12)


def test_other_likelihoods_are_of_second_order_on_the_orbit():
    """Second differences err by h^2 omega^2 / 12 of the acceleration."""
    for method in ("one_step", "gls"):
        errors = []
        for n in (41, 81):
            regression = build_regression([orbit(n)], method=method)
            errors.append(residual_acceleration(regression, GRAVITY))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.01)


def test_derivative_needs_velocities_and_rows():
    with pytest.raises(DataError, match="needs measured velocities"):
        build_regression([orbit(velocities=False)], method="derivative")
    with pytest.raises(DataError, match="more than 10 rows, got 9"):
        build_regression([orbit(9)], method="derivative")


def test_settings_are_checked():
    classic = ("one_step", "one_step_gls", "central", "gls", "derivative")
    assert METHODS == (*classic, "weak", "one_step_weak")
    with pytest.raises(SettingsError, match="one_step, one_step_gls, .*, got 'weakest'"):
        build_regression([scene_of(1)], method="weakest")
    gone = np.full((4, 2), np.nan)
    scene = Scene("s", np.arange(4.0), gone[:, None], (ball("a", 1.0),))
    with pytest.raises(DataError, match="three successive frames"):
        build_regression([scene])


def test_a_law_without_a_value_is_an_evaluation_error():
    regression = build_regression([scene_of(14)])
    with pytest.raises(EvaluationError, match="at 40 instants"):
        regression.residual(law_of("sqrt(-norm(v_i)) * v_i"))
    # nan where there is no row does no harm.
    scene = with_gap(scene_of(14), 5, 0)
    assert np.all(np.isfinite(build_regression([scene]).residual(LAW)))


def test_stacked_draws_give_the_weighted_mean_of_losses():
    """Expectation over draws of an unknown mass, one constant for all draws."""
    times = np.arange(12) * 0.1
    track = np.stack([times, times - 0.5 * times**2], axis=1)[:, None]
    draws, weights = (0.5, 1.0, 3.0), np.array([1.0, 2.0, 1.0])
    regressions = [
        build_regression([Scene("s", times, track, (Entity("b", properties={"mass": m}),))])
        for m in draws
    ]
    law = ForceLaw([Term(parse_formula("c1 * e_y", input_types({})))], {"c1": -1.2})
    stacked = stack_draws(regressions, weights)
    single = [np.square(r.residual(law)).sum() for r in regressions]
    assert np.square(stacked.residual(law)).sum() == pytest.approx(weights @ single / 4, rel=1e-12)
    with pytest.raises(SettingsError, match="weights must be 3 numbers"):
        stack_draws(regressions, [1.0, 2.0])


@pytest.mark.parametrize("method", ["one_step", "one_step_gls", "gls"])
def test_rows_with_an_unsure_contact_are_left_out(method):
    """A disc crosses a mat: near the edges nobody knows under noise whether it is on."""
    disc = Entity("disc", "disc", radius=0.5, properties={"mass": 1.0})
    mat = Entity("mat", "rect_mat", width=4.0, height=4.0, is_static=True)
    times = 0.1 * np.arange(61)
    positions = np.zeros((61, 2, 2))
    positions[:, 0, 0] = -3.03 + times  # over the edges at x = -2 and x = 2
    scene = Scene("s", times, positions, (disc, mat))
    regression = build_regression([scene], method=method, sigma=0.03, unsure=0.12)
    x = positions[1:-1, 0, 0]
    left_out = np.abs(np.abs(x) - 2.0) < 0.12
    assert left_out.sum() == 4
    (batch,) = regression.batches
    np.testing.assert_array_equal(batch.valid[:, 0, 0, 0], ~left_out)
    assert np.all(batch.whiten(batch.target)[left_out] == 0)
    everything = build_regression([scene], method=method, sigma=0.03)
    assert everything.n_rows == regression.n_rows + 2 * left_out.sum()


def test_one_step_gls_is_one_step_with_the_covariance_of_second_differences():
    """Same targets and states; the whitened target has the quadratic form of the covariance."""
    rng = np.random.default_rng(0)
    scene = Scene("s", 0.1 * np.arange(9), rng.standard_normal((9, 2, 2)), pair_of_bodies())
    plain, exact, central = (
        build_regression([scene], method=method, sigma=0.2)
        for method in ("one_step", "one_step_gls", "gls")
    )
    (one,), (other,), (third,) = plain.batches, exact.batches, central.batches
    np.testing.assert_array_equal(one.velocities, other.velocities)
    np.testing.assert_array_equal(one.target, other.target)
    np.testing.assert_array_equal(third.whitener, other.whitener)
    assert not np.array_equal(third.velocities, other.velocities)
    second = np.array([1.0, -2.0, 1.0]) / 0.1**2
    matrix = sum(np.eye(7, 9, k) * weight for k, weight in enumerate(second))
    precision = np.linalg.inv(0.2**2 * matrix @ matrix.T)
    y = other.target[:, 0, 0, 0]
    white = other.whiten(other.target)[:, 0, 0, 0]
    assert white @ white == pytest.approx(y @ precision @ y, rel=1e-8)


def pair_of_bodies():
    return (Entity("a", properties={"mass": 1.0}), Entity("b", properties={"mass": 2.0}))


def test_a_law_without_a_value_has_no_finite_error():
    """Its errors may not be taken for gaps of the track, which do not count."""
    positions = np.cumsum(np.ones((6, 2, 2)), axis=0)
    positions[:, 1] += 5.0  # side by side with one velocity: 1 / 0
    scene = Scene("s", 0.1 * np.arange(6), positions, pair_of_bodies())
    law = law_of("c1 * m_i / norm(v_i - v_j) * e_x", c1=1.0)
    assert one_step_nrmse([scene], law) == np.inf
    assert one_step_nrmse([scene], ForceLaw(())) == pytest.approx(0.0, abs=1e-12)
