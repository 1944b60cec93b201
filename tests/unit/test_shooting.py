import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.shooting import cut_segments, fit_rollout, guess_state, parameter_list, predict

TYPES = input_types(PROPERTY_UNITS, up="y")


def law_of(*texts, **constants):
    return ForceLaw([Term(parse_formula(text, TYPES)) for text in texts], constants)


def ball(name, mass=1.0, is_static=False):
    return Entity(name, is_static=is_static, properties={"mass": mass})


def simulate(law, name, times, crew, p, v, noise=0.0, rng=None):
    """A scene made by the law itself, with white noise on the places of moving bodies."""
    times = np.asarray(times, dtype=float)
    positions = np.zeros((len(times), len(crew), 2))
    moving = [k for k, e in enumerate(crew) if not e.is_static]
    (batch,) = stack([Scene(name, times, positions + np.arange(len(crew))[:, None], crew)], up="y")
    batch.positions[:, :, [k for k, e in enumerate(crew) if e.is_static]] = 0.0
    p, v = np.array(p, float).reshape(1, -1, 2), np.array(v, float).reshape(1, -1, 2)
    positions[:, moving] = rollout(law, batch, p, v)[:, 0]
    if noise:
        positions[:, moving] += noise * rng.standard_normal(positions[:, moving].shape)
    return Scene(name, times, positions, crew)


TIMES = np.linspace(0, 2, 21)
DRAG = "c1 * norm(v_i) * v_i"
WEIGHT = "c2 * m_i * down"
TRUE = {"c1": -0.3, "c2": 9.81}
STARTS = [((0, 0), (1, 3)), ((1, 2), (-2, 4)), ((0, 5), (0.5, -1))]


def thrown(noise=0.0, seed=0, times=TIMES):
    rng = np.random.default_rng(seed)
    law = law_of(DRAG, WEIGHT, **TRUE)
    return [
        simulate(law, f"throw{k}", times, (ball("b", 0.8),), p, v, noise, rng)
        for k, (p, v) in enumerate(STARTS)
    ]


def test_planted_constants_and_initial_states_are_recovered():
    fit = fit_rollout(thrown(), law_of(DRAG, WEIGHT, c1=-0.01, c2=5.0), [1e-3, 1e-3], up="y")
    assert fit.converged
    assert fit.parameters == (("c1", ""), ("c2", ""))
    np.testing.assert_allclose(fit.values, [-0.3, 9.81], rtol=1e-7)
    assert dict(fit.law.constants) == pytest.approx(TRUE, rel=1e-7)
    np.testing.assert_allclose(fit.positions[0][:, 0], [p for p, _ in STARTS], atol=1e-7)
    np.testing.assert_allclose(fit.velocities[0][:, 0], [v for _, v in STARTS], atol=1e-6)
    assert fit.chisqr < 1e-6
    assert (fit.n_rows, fit.n_free) == (3 * 21 * 2, 2 + 3 * 4)
    assert fit.bic == pytest.approx(fit.chisqr + 2 * np.log(126))


def test_chi_squared_is_the_number_of_degrees_of_freedom():
    """Mean f, variance 2f: five standard deviations."""
    fit = fit_rollout(thrown(0.01, seed=1), law_of(DRAG, WEIGHT, **TRUE), [0.01, 0.01], up="y")
    freedom = fit.n_rows - fit.n_free
    assert abs(fit.chisqr - freedom) < 5 * np.sqrt(2 * freedom)
    seen = np.stack([s.positions for s in fit.batches[0].scenes], axis=1)[:, :, 0]
    residual = (seen - fit.predicted[0][:, :, 0]) / 0.01
    assert np.square(residual).sum() == pytest.approx(fit.chisqr, rel=1e-9)


def test_errors_are_calibrated_and_entities_have_their_own_constants():
    """200 draws of one thrown body with drag, 25 per fit, each with a constant of its own.

    Pulls (fitted - true) / sigma must have mean 0 and standard deviation 1, within four
    standard errors: 4 / sqrt(200) = 0.28 and 4 / sqrt(400) = 0.2.
    """
    rng = np.random.default_rng(2)
    times = np.linspace(0, 1.5, 13)
    pulls = []
    for _ in range(8):
        names = [f"b{k}" for k in range(25)]
        true = dict(zip(names, rng.uniform(-0.6, -0.2, 25), strict=True))
        scenes = [
            simulate(law_of(DRAG, c1=true[n]), n, times, (ball(n),), (0, 0), (2, 1), 0.01, rng)
            for n in names
        ]
        law = law_of(DRAG).with_constants({"c1": dict.fromkeys(names, -0.4)})
        fit = fit_rollout(scenes, law, [0.01, 0.01])
        assert fit.converged
        assert fit.parameters == tuple(("c1", n) for n in names)
        sigma = np.sqrt(np.diag(fit.covariance))
        # Nothing is shared: errors of different bodies are independent.
        off = fit.covariance / np.outer(sigma, sigma) - np.eye(25)
        assert np.abs(off).max() < 1e-6
        pulls.append((fit.values - np.array([true[n] for n in names])) / sigma)
        assert dict(fit.law.constants["c1"]) == dict(zip(names, fit.values, strict=True))
    pulls = np.concatenate(pulls)
    assert abs(pulls.mean()) < 4 / np.sqrt(200)
    assert abs(pulls.std() - 1) < 4 / np.sqrt(400)


def test_covariance_is_that_of_linear_least_squares():
    """A body under constant force is linear in everything: x0 + v0 t + c t^2 / 2."""
    law = law_of("c1 * m_i * e_x", c1=2.0)
    scene = simulate(law, "s", TIMES, (ball("b"),), (0, 0), (1, 0), 0.05, np.random.default_rng(3))
    fit = fit_rollout([scene], law.with_constants({"c1": 0.1}), [0.05, 0.05])
    design = np.stack([np.ones(21), TIMES, TIMES**2 / 2], axis=1) / 0.05
    covariance = np.linalg.inv(design.T @ design)
    best = covariance @ design.T @ scene.positions[:, 0, 0] / 0.05
    assert fit.values[0] == pytest.approx(best[2], rel=1e-7)
    assert fit.covariance[0, 0] == pytest.approx(covariance[2, 2], rel=1e-6)
    assert fit.positions[0][0, 0, 0] == pytest.approx(best[0], abs=1e-8)


@pytest.mark.parametrize(
    ("bounds", "expected"), [((-0.2, 0.0), -0.2), ((0.0, np.inf), 0.0), ((-np.inf, -0.5), -0.5)]
)
def test_bounds_hold_and_the_rest_adapts(bounds, expected):
    start = law_of(DRAG, WEIGHT, c1=-0.1, c2=5.0)
    fit = fit_rollout(thrown(), start, [0.01, 0.01], up="y", bounds={"c1": bounds})
    assert fit.values[0] == expected
    held = start.with_constants({"c1": expected})
    rest = fit_rollout(thrown(), held, [0.01, 0.01], up="y", free=("c2",))
    assert fit.values[1] == pytest.approx(rest.values[0], rel=1e-6)
    assert fit.chisqr == pytest.approx(rest.chisqr, rel=1e-6)


def test_bounds_that_do_not_bind_change_nothing():
    start = law_of(DRAG, WEIGHT, c1=-0.1, c2=5.0)
    fit = fit_rollout(thrown(), start, [0.01, 0.01], up="y", bounds={"c1": (-1, 0)})
    np.testing.assert_allclose(fit.values, [-0.3, 9.81], rtol=1e-7)


def test_an_unseen_axis_does_not_count():
    """The x-axis is not measured (sigma nan): garbage there changes nothing."""
    scenes = [simulate(law_of(WEIGHT, **{"c2": 9.81}), "s", TIMES, (ball("b"),), (0, 0), (0, 3))]
    garbage = scenes[0].positions.copy()
    garbage[:, 0, 0] = 0.25
    spoilt = [Scene("s", TIMES, garbage, scenes[0].entities)]
    fits = [fit_rollout(s, law_of(WEIGHT, c2=1.0), [np.nan, 0.1], up="y") for s in (scenes, spoilt)]
    assert fits[0].n_rows == 21
    for fit in fits:
        np.testing.assert_allclose(fit.values, 9.81, rtol=1e-8)


def test_gaps_and_lost_first_rows_do_not_bias():
    whole = thrown()
    holed = []
    for scene in whole:
        positions = scene.positions.copy()
        positions[[0, 1, 7, 8, 20]] = np.nan
        holed.append(Scene(scene.name, scene.times, positions, scene.entities))
    fit = fit_rollout(holed, law_of(DRAG, WEIGHT, c1=-0.01, c2=5.0), [0.01, 0.01], up="y")
    assert fit.n_rows == 3 * 16 * 2
    np.testing.assert_allclose(fit.values, [-0.3, 9.81], rtol=1e-6)


def test_slopes_beyond_all_numbers_stop_a_fit_without_a_warning():
    """A body at rest under a force that drives it off: finite track, slopes whose squares are not.

    A warning is an error here.
    """
    times = np.linspace(0, 6, 61)
    scene = Scene("run", times, np.zeros((61, 1, 2)), (ball("b"),))
    fit = fit_rollout([scene], law_of("c1 * v_i", c1=400.0), [1e-3, 1e-3], up="y", free=())
    assert fit.chisqr == 0.0


def test_segments_share_constants_and_have_states_of_their_own():
    """Multiple shooting: the same constants from a chaotic-length track cut in pieces."""
    scenes = thrown(times=np.linspace(0, 4, 41))
    pieces = cut_segments(scenes, 10)
    assert [len(s.times) for s in pieces] == [10, 10, 10, 11] * 3
    assert sum(len(s.times) for s in pieces) == 3 * 41
    assert len({s.name for s in pieces}) == 12
    assert cut_segments(scenes, None) == scenes
    fit = fit_rollout(pieces, law_of(DRAG, WEIGHT, c1=-0.01, c2=5.0), [1e-3, 1e-3], up="y")
    np.testing.assert_allclose(fit.values, [-0.3, 9.81], rtol=1e-6)
    assert fit.n_free == 2 + 12 * 4


def test_two_bodies_that_pull_each_other():
    law = law_of("c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)", c1=1.0)
    crew = (ball("a", 3.0), ball("b", 1.0), ball("fixed", 2.0, is_static=True))
    scene = simulate(law, "s", TIMES, crew, [(4, 0), (6, 0)], [(0, 0.9), (0, 2.2)])
    fit = fit_rollout([scene], law.with_constants({"c1": 0.7}), [1e-3, 1e-3])
    np.testing.assert_allclose(fit.values, 1.0, rtol=1e-6)
    assert fit.n_free == 1 + 8


def test_parameters_are_listed_in_order():
    law = law_of(DRAG, WEIGHT, c1=1.0, c2=2.0).with_constants({"c1": {"a": 1.0, "b": 2.0}})
    assert parameter_list(law) == (("c1", "a"), ("c1", "b"), ("c2", ""))
    assert parameter_list(law, ("c2",)) == (("c2", ""),)


def test_guesses_are_exact_for_parabolas_and_use_measured_velocities():
    t = TIMES
    p = np.stack([1 + 2 * t - 3 * t**2, 0.5 * t**2], axis=-1)[:, None]
    (batch,) = stack([Scene("s", t, p, (ball("b"),))])
    position, velocity = guess_state(batch)
    np.testing.assert_allclose(position[0, 0], [1, 0], atol=1e-12)
    np.testing.assert_allclose(velocity[0, 0], [2, 0], atol=1e-11)
    v = np.full_like(p, 7.0)
    (batch,) = stack([Scene("s", t, p, (ball("b"),), v)], velocity="measured")
    np.testing.assert_array_equal(guess_state(batch)[1][0, 0], [7, 7])


# --- prediction: what is scored must not have been seen ------------------------------------------


@pytest.mark.parametrize("n_initial", [1, 3, 8])
@pytest.mark.parametrize("measured", [False, True])
def test_predictions_use_the_first_rows_only(n_initial, measured):
    law = law_of(DRAG, WEIGHT, **TRUE)
    scenes = thrown(0.01, seed=4)
    used = 1 if measured else max(n_initial, 3)

    def with_velocities(scene, positions):
        v = np.gradient(scene.positions, scene.times, axis=0) if measured else None
        if v is not None:
            v[used:] = np.where(positions[used:] == scene.positions[used:], v[used:], 99.0)
        return Scene(scene.name, scene.times, positions, scene.entities, v)

    spoilt = []
    for scene in scenes:
        positions = scene.positions.copy()
        positions[used:] = np.random.default_rng(5).normal(size=positions[used:].shape) * 100
        spoilt.append(with_velocities(scene, positions))
    whole = [with_velocities(scene, scene.positions) for scene in scenes]
    settings = {"n_initial": lambda scene: n_initial, "up": "y",
                "velocity": "measured" if measured else "ignore"}  # fmt: skip
    one = predict(whole, law, [0.01, 0.01], **settings)
    two = predict(spoilt, law, [0.01, 0.01], **settings)
    for a, b in zip(one, two, strict=True):
        assert a.shape == (21, 1, 2)
        np.testing.assert_array_equal(a, b)
    # The first rows do matter.
    moved = [Scene(s.name, s.times, s.positions + 1.0, s.entities, s.velocities) for s in whole]
    three = predict(moved, law, [0.01, 0.01], **settings)
    np.testing.assert_allclose(three[0], one[0] + 1.0, atol=1e-6)


def test_predictions_of_exact_scenes_are_exact():
    law = law_of(DRAG, WEIGHT, **TRUE)
    scenes = [*thrown(), *thrown(times=np.linspace(0, 1, 11))[:1]]
    scenes[3] = Scene("short", scenes[3].times, scenes[3].positions, scenes[3].entities)
    found = predict(scenes, law, [1e-3, 1e-3], n_initial=lambda s: len(s.times) // 3, up="y")
    for scene, prediction in zip(scenes, found, strict=True):
        np.testing.assert_allclose(prediction, scene.positions, atol=1e-6)


def test_predicting_fits_no_constants():
    wrong = law_of(DRAG, WEIGHT, c1=-0.3, c2=5.0)
    scene = thrown()[0]
    (found,) = predict([scene], wrong, [1e-3, 1e-3], n_initial=lambda s: 3, up="y")
    fall = found[-1, 0, 1] - scene.positions[-1, 0, 1]
    assert fall > 1  # less weight, it stays higher
