"""What forces would do to fitted tracks: the gain that is promised is the gain that a fit finds."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.tangent import Tangent, p_of_gain
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposers.libraries import Rows
from bsp_gp.loop.view import View, selected
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import kind_of
from tests.fitted_tracks import body, dataset_of, scene_of

NOISE = 0.02
GRAVITY = "-9.81 [m/s^2] * m_i * e_y"


def thrown(drag=0.0, n_scenes=4, n_rows=30, seed=0, noise=NOISE, masses=(1.0,)):
    """Throws under gravity and linear drag, in closed form; bodies do not feel each other."""
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 2.0, n_rows)
    scenes = []
    for _ in range(n_scenes):
        places = np.empty((n_rows, len(masses), 2))
        for k, mass in enumerate(masses):
            v, g, t = rng.uniform(2.0, 6.0, 2), np.array([0.0, -9.81]), times[:, None]
            if not drag:
                places[:, k] = v * t + g * t**2 / 2
                continue
            eased = -np.expm1(-drag / mass * t) * mass / drag
            places[:, k] = v * eased + g * (t - eased) * mass / drag
        bodies = tuple(body(f"b{k}", m) for k, m in enumerate(masses))
        places += noise * rng.standard_normal(places.shape)
        scenes.append(scene_of(times, bodies, places, name=f"s{len(scenes)}"))
    return dataset_of(scenes, noise=(noise, noise))


def view_of(dataset, *laws, seed=0):
    hypothesis = Hypothesis.from_laws(dataset, list(laws))
    return View(fit(hypothesis, dataset), hypothesis, dataset, np.random.default_rng(seed))


def score(view, text):
    formula = parse_formula(text, dataset_types(view.dataset))
    return view.score_forces(view.force_columns([formula], kind_of(formula)))


@pytest.mark.parametrize(
    ("drag", "masses", "text"),
    [(0.02, (1.0,), "v_i"), (0.3, (1.0, 2.0), "v_i"), (0.05, (1.0,), "norm(v_i) * v_i"),
     (0.1, (1.0,), "m_i * e_x")],
)  # fmt: skip
def test_the_promise_of_a_force_is_what_a_fit_gains(drag, masses, text):
    dataset = thrown(drag, masses=masses)
    view = view_of(dataset, GRAVITY)
    found = score(view, text)
    fitted = fit(Hypothesis.from_laws(dataset, [GRAVITY, f"c * {text}"]), dataset)
    gain = view.fit.chisqr - fitted.chisqr
    assert found.rank == 1
    assert found.statistic == pytest.approx(gain, rel=0.02, abs=0.1)
    assert found.amplitudes[0] == pytest.approx(fitted.values[0], abs=0.3 * fitted.errors[0])
    assert found.errors[0] == pytest.approx(fitted.errors[0], rel=0.1)


def test_it_holds_beside_free_constants():
    dataset = thrown(0.1)
    view = view_of(dataset, "-g * m_i * e_y")
    fitted = fit(Hypothesis.from_laws(dataset, ["-g * m_i * e_y", "c * v_i"]), dataset)
    assert score(view, "v_i").statistic == pytest.approx(
        view.fit.chisqr - fitted.chisqr, rel=0.03, abs=0.1
    )
    assert score(view, "m_i * e_y").rank == 0  # the law has it


def test_moments_about_many_places_are_those_about_each():
    dataset = thrown(0.1, masses=(1.0, 2.0))
    view = view_of(dataset, "-g * m_i * e_y")
    types = dataset_types(dataset)
    texts = (
        "m_i * (y_i - h) * e_y", "norm(v_i) * v_i", "m_i / (y_i - h) * e_x", "m_i * e_y",
        "m_i * exp((x_i - h) / D) * e_x",
    )  # fmt: skip
    rows = [(parse_formula(text, types), k) for k, text in enumerate(texts)]
    places = [[1.0, 2.0], [-3.0, 1e-5], [0.5, 4.0]]
    found = Rows(view, rows, ("h", "D")).moments(np.array(places))
    assert found.shape == (3, len(view.left), len(texts))
    for (h, d), columns in zip(places, found, strict=True):
        for text, column in zip(texts, columns.T, strict=True):
            own = text.replace("h)", f"{h!r} [m])").replace("D)", f"{d!r} [m])")
            try:
                single = view.beside(view.force_columns([parse_formula(own, types)]))[:, 0]
            except EvaluationError:
                single = np.zeros(len(column))
            if text == "m_i * e_y":  # the law has it
                single = np.zeros(len(column))
            np.testing.assert_allclose(column, single, atol=1e-9 * np.abs(single).max(initial=1))
    grown = found[1, :, 4]
    assert not grown.any() and found[0, :, 4].any()  # beyond all numbers at one place alone


def test_forces_between_bodies_move_both_tracks():
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 3.0, 31)
    scenes = []
    for k in range(3):  # springs in closed form, a little stiffer than declared
        start, speed = rng.uniform(0.8, 1.6), rng.uniform(-0.4, 0.4)
        rate = np.sqrt(2 * 1.05)
        half = (start * np.cos(rate * times) + speed / rate * np.sin(rate * times)) / 2
        places = np.zeros((31, 2, 2))
        places[:, 0, 0], places[:, 1, 0] = half, -half
        places += 0.01 * rng.standard_normal(places.shape)
        scenes.append(scene_of(times, (body("a"), body("b")), places, name=f"s{k}"))
    dataset = dataset_of(scenes, noise=(0.01, 0.01))
    declared = "-1 [kg/s^2] * (p_i - p_j)"
    view = view_of(dataset, declared)
    fitted = fit(Hypothesis.from_laws(dataset, [declared, "-k * (p_i - p_j)"]), dataset)
    found = score(view, "p_i - p_j")
    assert found.statistic == pytest.approx(view.fit.chisqr - fitted.chisqr, rel=0.05)
    assert found.amplitudes[0] == pytest.approx(-fitted.values[0], rel=0.05)


def test_moments_of_noise_are_independent_and_of_size_one():
    sizes = []
    for seed in range(12):
        response = view_of(thrown(seed=seed), GRAVITY).response
        left = response.regression.target()
        kept = np.concatenate([b.kept.ravel() for b in response.regression.batches])
        sizes.append((float(left @ left), int(kept.sum())))
        assert not left[~kept].any()
    total, count = np.sum(sizes, axis=0)
    assert abs(total - count) < 4 * np.sqrt(2 * count)


def test_few_moments_stand_for_many_rows():
    response = view_of(thrown(n_rows=120), GRAVITY).response
    assert response.regression.n_rows < 0.3 * 4 * 120 * 2


def test_gaps_are_no_rows():
    dataset = thrown(0.1)
    scenes = []
    for scene in dataset.scenes:
        places = scene.positions.copy()
        places[5:9] = np.nan
        scenes.append(replace(scene, positions=places))
    dataset = replace(dataset, scenes=tuple(scenes))
    view = view_of(dataset, GRAVITY)
    fitted = fit(Hypothesis.from_laws(dataset, [GRAVITY, "c * v_i"]), dataset)
    assert score(view, "v_i").statistic == pytest.approx(
        view.fit.chisqr - fitted.chisqr, rel=0.03, abs=0.1
    )


# --- rows ---------------------------------------------------------------------------------------


def test_the_tangent_projects_out_what_is_free():
    view = view_of(thrown(0.05), "-g * m_i * e_y")
    tangent = Tangent(view.fit)
    own = tangent.projected(view.fit.local_columns)
    shared = tangent.projected(view.fit.shared_columns)
    size = np.linalg.norm(tangent.residual)
    assert np.abs(own).max() < 1e-8 and np.abs(shared).max() < 1e-6 * size + 1e-8
    # At a minimum the residual lies beside them already.
    assert size**2 == pytest.approx(view.fit.chisqr, rel=1e-6)


def test_a_column_of_the_rows_and_of_the_moments_score_alike():
    view = view_of(thrown(0.05), GRAVITY)
    times = view.fit.channels.times - np.nanmin(view.fit.channels.times)
    push = np.where(view.fit.channels.axis == 0, 0.5 * times**2, 0.0)  # of an acceleration e_x
    on_rows, on_moments = view.tangent.score(push[None]), score(view, "m_i * e_x")
    assert on_rows.statistic == pytest.approx(on_moments.statistic, rel=1e-3, abs=1e-3)
    assert on_rows.amplitudes == pytest.approx(on_moments.amplitudes, rel=1e-3, abs=1e-5)


def test_selection_counts_what_was_tried():
    rng = np.random.default_rng(0)
    for trials in (1, 30, 1000):
        null = np.square(rng.standard_normal((199, trials))).max(axis=1)
        observed = np.square(rng.standard_normal((400, trials))).max(axis=1)
        chances = np.array([selected(x, 1, null) for x in observed])
        assert np.mean(chances <= 0.1) == pytest.approx(0.1, abs=0.06)
        expected = -np.expm1(trials * np.log1p(-p_of_gain(60.0, 1)))
        assert selected(60.0, 1, null) == pytest.approx(expected, rel=0.5)


def test_nothing_selected_is_not_significant():
    assert selected(np.nan, 1, np.ones(9)) == 1.0
    assert selected(5.0, 0, np.ones(9)) == 1.0


def test_noise_whose_chance_is_below_all_numbers_is_counted_without_a_warning():
    null = np.full(20, 5000.0)  # of one column, exp(-2500)
    assert selected(4000.0, 1, null) == pytest.approx(1.0)
    assert selected(9000.0, 1, null) == pytest.approx(1 / 21)


def test_rows_far_off_their_neighbours_do_not_pull_where_causes_are_looked_for():
    dataset = thrown(drag=0.3, noise=0.005)
    plain = replace(dataset, noise=None)
    positions = plain.scenes[0].positions.copy()
    positions[12, 0, 0] += 0.4
    far = replace(plain, scenes=(replace(plain.scenes[0], positions=positions), *plain.scenes[1:]))
    (clean, seen), noise = (score(view_of(each, GRAVITY), "v_i") for each in (plain, far)), 0.4
    assert seen.amplitudes[0] == pytest.approx(clean.amplitudes[0], rel=0.03)
    assert seen.statistic > noise * clean.statistic
