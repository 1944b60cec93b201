import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Evaluation, Scene
from bsp_gp.errors import DataError, LawError
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import _check_masses, close_loop, declared_law
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.observation import N_FLOOR
from bsp_gp.loop.preparing import MAX_SUBSTEPS, RESOLUTION, observe
from bsp_gp.loop.tracks import fit_tracks
from bsp_gp.search.constants import fit_constants
from bsp_gp.simulate import effects
from bsp_gp.simulate.synth import make, preset
from bsp_gp.units import UnitSystem
from tests.planted import GRAVITY as PULL
from tests.planted import SI, orbit_dataset
from tests.throws import C1, DRAG, GRAVITY, throws
from tests.worlds import WEIGHT, flights, linear_drag, tied


def rng(seed=0):
    return np.random.default_rng(seed)


def observed(dataset, *texts, seed=0, **settings):
    law = declared_law(dataset, texts)
    return observe(dataset, law, rng(seed), **settings), law


def stepped(n=40, dt=0.02):
    """Throws made by the paper's symplectic Euler step with the backward velocity."""
    ball = Entity("ball", properties={"mass": 1.0})
    scenes = []
    for k in range(4):
        p = [np.array([0.0, 10.0]), np.array([0.1, 10.1 - 0.03 * k])]
        for _ in range(n - 2):
            v = (p[-1] - p[-2]) / dt
            p.append(p[-1] + dt * (v + dt * (np.array([0.0, -9.81]) - 0.4 * v)))
        scenes.append(Scene(f"s{k}", dt * np.arange(n), np.array(p)[:, None], [ball]))
    return Dataset("steps", scenes, units=SI, up="y")


# --- what is chosen -------------------------------------------------------------------------------


def test_exact_positions_made_in_steps_are_taken_step_by_step():
    observation, law = observed(stepped(), "-0.4 [1/s] * m_i * v_i", "c1 * m_i * e_y")
    assert (observation.method, observation.integrator, observation.is_exact) == (
        "one_step",
        "euler",
        True,
    )
    assert observation.segments == observation.train
    fit = observation.fit(law)
    assert fit.whole is None
    assert fit.values[0] == pytest.approx(-9.81, rel=1e-9)


def test_exact_positions_of_a_smooth_motion_are_fitted_to_a_resolution():
    observation, _ = observed(throws(noise=(0.0,), n_times=30), GRAVITY, DRAG)
    assert (observation.method, observation.integrator, observation.is_exact) == (
        "gls",
        "rk4",
        False,
    )
    spans = [np.ptp(s.positions) for s in observation.dataset.scenes]
    np.testing.assert_allclose(observation.sigma, RESOLUTION * max(spans))
    assert "looks continuous" in observation.split_note


def test_noisy_positions():
    observation, _ = observed(throws(sigma=0.01, n_times=30, noise=(0.01,)), GRAVITY)
    assert (observation.method, observation.integrator) == ("gls", "rk4")
    np.testing.assert_array_equal(observation.sigma, [0.01, 0.01])
    np.testing.assert_array_equal(observation.regression_sigma, observation.sigma)


def measured_throws(sigma_v=0.01):
    """Throws with measured velocities; position columns are exact."""
    data = throws(n_times=60, dt=0.02)
    scenes = []
    for k, scene in enumerate(data.scenes):
        rate, fall = C1 / 0.5, np.array([0.0, -9.81 * 0.5 / C1])
        v = fall + (np.array([3.0 + k, 4.0 - k]) - fall) * np.exp(-rate * scene.times)[:, None]
        v = v + sigma_v * rng(k).standard_normal(v.shape)
        scenes.append(replace(scene, velocities=v[:, None]))
    return replace(data, scenes=tuple(scenes), velocity="measured")


def test_measured_velocities_are_differentiated():
    observation, law = observed(measured_throws(), GRAVITY, DRAG)
    assert (observation.method, observation.integrator) == ("derivative", "rk4")
    assert observation.is_exact
    assert observation.velocity == "measured"
    assert all(observation.n_initial(scene) == 1 for scene in observation.test)
    # The weights of the 11-point derivative have the norm 1.33 / dt (Fornberg).
    np.testing.assert_allclose(observation.regression_sigma, 0.01 * 1.33 / 0.02, rtol=0.25)
    fit = observation.fit(law)
    assert abs(fit.values[0] - C1) < 3 * fit.intervals[0]
    assert observation.floor(law, rng())[1] == ()


def test_measured_velocities_that_are_not_declared_are_ignored():
    observation, _ = observed(replace(measured_throws(), velocity="ignore"), GRAVITY)
    assert observation.method == "gls"


def test_a_law_with_contacts_is_stepped_as_the_paper_does():
    data = throws(sigma=0.01, n_times=30)
    law = "c1 * m_i * m_j * normalize(p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)"
    scenes = []
    for scene in data.scenes:
        p = np.concatenate([scene.positions, np.tile([[[30.0, 0.0]]], (30, 1, 1))], axis=1)
        wall = Entity(
            "wall", "rect_wall", width=1.0, height=60.0, is_static=True, properties={"mass": 1.0}
        )
        scenes.append(replace(scene, positions=p, entities=(*scene.entities, wall)))
    observation, _ = observed(replace(data, scenes=tuple(scenes)), law)
    assert observation.integrator == "euler"


def test_steps_are_halved_until_the_noise_is_not_reached():
    coarse = orbit_dataset(0, n_train=2, n_test=1, dt=0.6, n_times=20, sigma=0.0001)
    fine = orbit_dataset(0, n_train=2, n_test=1, dt=0.05, n_times=20, sigma=0.01)
    steps = [observed(d, PULL)[0].substeps for d in (coarse, fine)]
    assert steps[1] == 1
    assert 1 < steps[0] <= MAX_SUBSTEPS


def test_the_split_is_as_declared_else_a_seeded_quarter():
    data = throws(n_scenes=8, sigma=0.01, n_times=20)
    named = replace(data, test=("s1", "s6"))
    observation, _ = observed(named, GRAVITY)
    assert [s.name for s in observation.test] == ["s1", "s6"]
    first, again, other = (observed(data, GRAVITY, seed=s)[0].test for s in (0, 0, 3))
    assert [s.name for s in first] == [s.name for s in again] != [s.name for s in other]
    assert len(first) == 2


def test_nothing_that_moves_is_an_error():
    still = Scene("a", np.arange(5.0), np.ones((5, 1, 2)), [Entity("stone")])
    with pytest.raises(DataError, match="nothing moves"):
        observed(Dataset("still", [still], units=SI))
    wall = Scene("a", np.arange(5.0), np.ones((5, 1, 2)), [Entity("wall", is_static=True)])
    with pytest.raises(DataError, match="dynamic"):
        observed(Dataset("walls", [wall], units=SI))


# --- held-out scenes are predicted from their first rows ------------------------------------------


@pytest.fixture(scope="module")
def noisy():
    return replace(
        throws(n_scenes=8, n_times=30, sigma=0.01, noise=(0.01,)),
        test=("s1", "s3", "s4", "s6", "s7"),
    )


def with_later_rows_changed(dataset, observation):
    """Every held-out scene, bent after the rows that its initial state may use."""
    scenes = []
    for scene in dataset.scenes:
        if scene.name in dataset.test:
            p = np.array(scene.positions)
            p[observation.n_initial(scene) :] += np.linspace(1, 9, len(p))[
                observation.n_initial(scene) :, None, None
            ]
            scene = replace(scene, positions=p)
        scenes.append(scene)
    return replace(dataset, scenes=tuple(scenes))


def test_no_leak_from_later_rows(noisy):
    observation, law = observed(noisy, GRAVITY, DRAG)
    bent, _ = observed(with_later_rows_changed(noisy, observation), GRAVITY, DRAG)
    assert bent.substeps == observation.substeps
    a, b = observation.fit(law), bent.fit(law)
    np.testing.assert_array_equal(a.values, b.values)
    before, after = observation.predictions(a.law), bent.predictions(b.law)
    for p, q in zip(before, after, strict=True):
        np.testing.assert_array_equal(p, q)
    assert bent.errors(b.law)[0].rollout_rmse > 100 * observation.errors(a.law)[0].rollout_rmse


def test_first_rows_do_matter_and_do_not_count(noisy):
    observation, law = observed(noisy, GRAVITY, f"-{C1} [kg/s] * v_i")
    scene = observation.test[0]
    n = observation.n_initial(scene)
    assert n == 10  # a third of 30 rows
    p = np.array(scene.positions)
    p[2] += 0.3
    moved = [replace(scene, positions=p)]
    assert not np.allclose(observation.predictions(law, moved)[0], observation.predictions(law)[0])
    row = observation.errors(law)[1][0]
    error = (scene.positions - observation.predictions(law)[0])[n:]
    assert row["n"] == 30 - n
    assert row["sum_squares"] == pytest.approx(np.square(error).sum())
    assert row["endpoints"] == [pytest.approx(np.linalg.norm(error[-1]))]


def test_evaluation_settings_are_kept(noisy):
    data = replace(noisy, evaluation=Evaluation(initial_rows=4, endpoint_row=20))
    observation, law = observed(data, GRAVITY, f"-{C1} [kg/s] * v_i")
    assert [observation.n_initial(s) for s in observation.test] == [4] * 5
    errors, rows = observation.errors(law)
    track = observation.predictions(law)[0]
    assert rows[0]["endpoints"][0] == pytest.approx(
        np.linalg.norm(observation.test[0].positions[19] - track[19])
    )
    ends = [end for row in rows for end in row["endpoints"]]
    assert (errors.endpoint, errors.endpoint_mean) == (
        pytest.approx(np.median(ends)),
        pytest.approx(np.mean(ends)),
    )
    late = replace(noisy, evaluation=Evaluation(endpoint_row=31))
    errors, rows = observed(late, GRAVITY)[0].errors(law)
    assert np.isnan(errors.endpoint) and rows[0]["endpoints"] == []


def test_units_of_errors(noisy):
    observation, law = observed(noisy, GRAVITY)
    errors, _ = observation.errors(law)
    assert (errors.unit, errors.acceleration_unit) == ("m", "m/s^2")
    assert errors.rollout_rmse == pytest.approx(observation.headline_error(law))


# --- floor and ratio ------------------------------------------------------------------------------


def test_the_floor_is_what_the_true_law_reaches(noisy):
    observation, law = observed(noisy, GRAVITY, f"-{C1} [kg/s] * v_i")
    floor, copies = observation.floor(law, rng(1))
    measured, _ = observation.errors(law)
    assert len(copies) == N_FLOOR
    assert all(len(copy) == len(observation.test) for copy in copies)
    # 5 scenes against 8 copies of them. The error grows with time from one fitted state, so a
    # scene counts for about two independent numbers: 10 of them, relative error of an rms 0.22.
    assert measured.rollout_rmse == pytest.approx(floor.rollout_rmse, rel=3 * 0.24)
    again, _ = observation.floor(law, rng(2))
    assert again is floor  # kept for this law
    wrong = declared_law(noisy, [GRAVITY])
    assert observation.errors(wrong)[0].rollout_rmse > 5 * floor.rollout_rmse


def test_the_floor_of_exact_data_is_numerical():
    observation, law = observed(stepped(), "-0.4 [1/s] * m_i * v_i", "c1 * m_i * e_y")
    floor, copies = observation.floor(law, rng())
    assert copies == ()
    assert floor.rollout_rmse < 1e-9
    assert floor.residual_acceleration > 0


# --- tracks that depend strongly on their start ---------------------------------------------------


def test_tracks_are_cut_where_a_small_change_has_grown():
    """A ball driven away from a post by a force that grows with the distance: cosh(2 t)."""
    t = 0.05 * np.arange(90)[:, None]
    scenes = []
    for k, child in enumerate(rng(5).spawn(3)):
        p = np.array([0.1, 0.02 * k]) * np.cosh(2 * t) + [0.0, 0.05] * np.sinh(2 * t)
        p = np.stack([p + 0.01 * child.standard_normal(p.shape), np.zeros_like(p)], axis=1)
        crew = [Entity("ball", properties={"mass": 1.0}), Entity("post", is_static=True)]
        scenes.append(Scene(f"s{k}", t[:, 0], p, crew))
    data = Dataset("unstable", scenes, train=("s0", "s1"), test=("s2",), units=SI, noise=(0.01,))
    away = "c1 * (p_i - p_j)"
    observation, law = observed(data, "4 [kg/s^2] * (p_i - p_j)")
    segments = observation.segments
    assert len(segments) == 2 * 2  # cosh(2 t) = 30 at 2.05 s of 4.45
    assert sum(len(s.times) for s in segments) == 2 * 90
    assert {s.name.partition("[")[0] for s in segments} == {"s0", "s1"}
    assert observed(data, "-4 [kg/s^2] * (p_i - p_j)")[0].segments == observation.train
    fit = observation.fit(declared_law(data, [away]))
    assert fit.whole.n_free == 1 + 4 * len(segments)
    # 5 standard errors of a reduced chi-squared.
    dof = fit.whole.n_rows - fit.whole.n_free
    assert fit.chisqr / dof == pytest.approx(1, abs=5 * np.sqrt(2 / dof))
    assert abs(fit.values[0] - 4.0) < 2 * fit.intervals[0]
    # What is predicted is not cut.
    assert [len(p) for p in observation.predictions(fit.law)] == [90]


# --- unknown masses -------------------------------------------------------------------------------


def without_mass(dataset, *names):
    """The same with the masses of some bodies (all of them by default) unknown."""
    scenes = []
    for scene in dataset.scenes:
        entities = [
            replace(e, properties={k: v for k, v in e.properties.items() if k != "mass"})
            if (e.name in names or not names)
            else e
            for e in scene.entities
        ]
        scenes.append(replace(scene, entities=tuple(entities)))
    return replace(dataset, scenes=tuple(scenes))


def test_without_any_mass_constants_are_per_unit_mass(noisy):
    observation, law = observed(without_mass(noisy), GRAVITY, DRAG)
    assert all(e.mass == 1.0 for s in observation.train for e in s.entities)
    assert any("per unit mass" in note for note in observation.dataset.notes)
    fit = observation.fit(law)
    assert abs(fit.values[0] - C1 / 0.5) < 2 * fit.intervals[0]


def test_a_body_of_unknown_mass_is_left_out_of_pooled_laws():
    data = without_mass(orbit_dataset(0, n_train=2, n_test=1), "body2")
    observation, law = observed(data)
    search = EffectSearch(observation, load_grammar("physics"))
    assert [s.names for s in search.pooled_scenes] == [("body0", "body1", "body2")] * 2
    for scene in search.pooled_scenes:
        assert [scene.names[k] for k in scene.dynamic] == ["body0", "body1"]
    _check_masses(observation, law)  # no declared law: nothing is needed


def test_a_declared_law_that_needs_an_unknown_mass_is_an_error():
    data = without_mass(orbit_dataset(0, n_train=2, n_test=1), "body2")
    with pytest.raises(LawError, match="'body2' that is unknown"):
        close_loop(data, ["-c1 * v_i"], rng=rng())


def test_a_weight_does_not_need_the_mass(noisy):
    """All forces on the body are proportional to its mass, so that it drops out."""
    scenes = tuple(
        replace(s, entities=(replace(s.entities[0], name=f"ball{k}"),))
        for k, s in enumerate(noisy.scenes)
    )
    data = without_mass(replace(noisy, scenes=scenes), "ball0")
    observation, law = observed(data, GRAVITY, "-c1 * m_i * v_i")
    _check_masses(observation, law)
    fit = observation.fit(law)
    assert abs(fit.values[0] - C1 / 0.5) < 2 * fit.intervals[0]


# --- workers --------------------------------------------------------------------------------------


def test_what_is_kept_for_the_running_loop_does_not_travel(noisy):
    observation, law = observed(noisy, GRAVITY, DRAG)
    observation.predictions(law)
    observation.floor(law, rng())
    assert {"_predictions", "_floors"} <= set(vars(observation))
    copy = pickle.loads(pickle.dumps(observation))
    assert not [name for name in vars(copy) if name.startswith("_")]
    for a, b in zip(copy.predictions(law), observation.predictions(law), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(copy.fit(law).values, observation.fit(law).values)


def test_kept_predictions_are_those_of_their_law(noisy):
    observation, law = observed(noisy, GRAVITY, DRAG)
    first = observation.predictions(law)
    other = law.with_constants({"c1": 3.0})
    assert not np.allclose(observation.predictions(other)[0], first[0])
    np.testing.assert_array_equal(observation.predictions(law)[0], first[0])


# --- fits -----------------------------------------------------------------------------------------


def test_intervals_widen_with_the_misfit(noisy):
    """A law that does not fit has no right to a narrow interval."""
    observation, law = observed(noisy, GRAVITY, DRAG)
    good = observation.fit(law)
    quadratic = declared_law(noisy, [GRAVITY, "-c1 * norm(v_i) * v_i"])
    bad = observation.fit(quadratic)
    assert bad.chisqr > 3 * good.chisqr
    raw = 1.645 * np.sqrt(np.diag(bad.whole.covariance))
    assert bad.intervals[0] > 1.5 * raw[0]
    assert bad.n_effective < good.n_effective
    assert bad.bic() > good.bic()


def test_bounds_are_kept(noisy):
    observation, law = observed(noisy, GRAVITY, DRAG)
    fit = observation.fit(law, bounds={"c1": (-np.inf, 0.1)})
    assert fit.values[0] == pytest.approx(0.1)


def test_springs_of_a_body_at_a_post():
    observation, law = observed(
        tied(0, n_train=2, n_test=1), "-c1 * (norm(p_i - p_j) - l_i) * normalize(p_i - p_j)"
    )
    fit = observation.fit(law)
    assert abs(fit.values[0] - 8.0) < 2 * fit.intervals[0]


def turning(rate=6.0, sigma=0.05, n=200, dt=0.05):
    """Circles at one rate, so noisy that their second differences say little."""
    t = dt * np.arange(n)
    scenes = []
    for k, child in enumerate(rng(5).spawn(4)):
        p = (0.2 + 0.1 * k) * np.stack([np.cos(rate * t), np.sin(rate * t)], axis=1)
        p = p + sigma * child.standard_normal(p.shape)
        scenes.append(Scene(f"s{k}", t, p[:, None], [Entity("ball", properties={"mass": 1.0})]))
    return Dataset("turning", scenes, units=SI, noise=(sigma,), test=("s3",))


def test_a_fit_that_contains_another_is_never_worse():
    """A turn too many or too few is a minimum of its own, where the regression may lead.

    The fit of whole tracks comes back from there, too: over 15 s from a rate that is 7 % off.
    """
    observation, law = observed(turning(n=300), "c1 * m_i * perp(v_i)")
    inner = observation.fit(law, start=law.with_constants({"c1": 6.0}))
    more = inner.law.plus(declared_law(observation.dataset, ["c2 * m_i * v_i"]).terms[0], {"c2": 0})
    first = fit_constants(observation.train_regression, more).law
    assert abs(first.constants["c1"] - 6.0) > 0.3  # the premise
    assert fit_tracks(observation, first, is_sure=True).chisqr <= inner.chisqr
    fit = observation.fit_beyond(more, inner)
    assert fit.chisqr <= inner.chisqr * (1 + 1e-6)
    assert fit.values[0] == pytest.approx(6.0, rel=0.01)
    assert observation.fit_beyond(law, inner).chisqr == pytest.approx(inner.chisqr)


@pytest.mark.parametrize(("name", "integrator"), [("pucks", "rk4"), ("bounce", "euler")])
def test_contacts_are_smooth_or_impulses_of_a_step(name, integrator):
    """Soft discs overlap for several rows; in the paper's scenes a contact is one row."""
    missing = effects.effect("field", 1.0 if name == "pucks" else 50.0, is_declared=False)
    noise = 0.01 if name == "pucks" else 0.1
    settings = preset(name, [missing], noise=noise, n_scenes=4, n_frames=50)
    data, truth = make(settings, np.random.default_rng(3))
    declared = truth.declared or ["c1 * m_i * m_j / (m_i + m_j) * along(v_i - v_j, p_i - p_c)"
                                  " * normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)"]
    observation = observe(data, declared_law(data, declared), np.random.default_rng(0))
    assert observation.integrator == integrator
    assert (observation.substeps > 1) == (integrator == "rk4")


def test_a_term_with_a_tiny_constant_is_fitted_beside_a_law_that_nearly_holds():
    """Fast and dragged by 3e-10 kg/m: a step of 1e-5 in that constant would run away."""
    t, c, speed = 0.01 * np.arange(60), 3e-10, np.array([7000.0, 1000.0])
    size = np.linalg.norm(speed)
    path = speed / (c * size**2) * size * np.log1p(c * size * t)[:, None]
    noise = rng(1).standard_normal((4, *path.shape))
    ball = Entity("ball", properties={"mass": 1.0})
    sigma = 2.5e-4  # what is left has twice the size of the noise
    scenes = [Scene(f"s{k}", t, (path + sigma * e)[:, None], (ball,)) for k, e in enumerate(noise)]
    data = Dataset("fast", tuple(scenes), units=SI, noise=(sigma,))
    observation, _ = observed(data)
    inner = observation.fit(declared_law(data, []))
    law = declared_law(data, ["c1 * norm(v_i) * v_i"]).with_constants({"c1": 0.0})
    fit = observation.fit_beyond(law, inner)
    half = fit.intervals[0]
    assert inner.chisqr > fit.chisqr + 100
    assert fit.values[0] == pytest.approx(-c, abs=3 * half)
    assert half < 0.5 * c


def test_what_held_out_tracks_would_show_of_a_law_is_what_they_show_on_the_average():
    found, expected = 0.0, 0.0
    for seed in range(8):
        data = flights(seed, lambda t, p, v, m, q: -0.02 * v, sigma=0.02)
        observation, law = observed(data, WEIGHT)
        true = declared_law(data, [WEIGHT, "c * v_i"]).with_constants({"c": -0.02})
        found += observation.held_out_gain(law, true)
        expected += observation.held_out_sight(law, true) ** 2
    assert expected > 100
    # Its mean is the square of the ratio, its variance four times that; 4 standard errors.
    assert abs(found - expected) < 4 * 2 * np.sqrt(expected)


def test_held_out_rows_that_are_not_seen_do_not_count():
    data = flights(0, linear_drag)
    last = data.scenes[-1]
    positions = np.array(last.positions)
    positions[5:30] = np.nan
    gap = replace(data, scenes=[*data.scenes[:-1], replace(last, positions=positions)])
    sights = []
    for dataset in (data, gap):
        observation, law = observed(dataset, WEIGHT)
        true = declared_law(data, [WEIGHT, "c * v_i"]).with_constants({"c": -0.3})
        sights.append(observation.held_out_sight(law, true))
    assert 0 < sights[1] < sights[0]


GM, ORBIT = 3.986004418e14, 2.6e7  # m^3/s^2; of a navigation satellite, m


def satellite(noise=None, quoted=None, sigma=0.05, n=120):
    """One turn about the Earth, seen to 5 cm: two parts in a thousand million of the range."""
    rate = np.sqrt(GM / ORBIT**3)
    times = np.linspace(0, math.tau / rate, n)
    p = np.zeros((n, 2, 2))
    p[:, 0] = ORBIT * np.stack([np.cos(rate * times), np.sin(rate * times)], axis=1)
    p[:, 0] += sigma * np.random.default_rng(0).standard_normal((n, 2))
    bodies = Entity("satellite", properties={"mass": 1e3}), Entity("Earth", is_static=True)
    errors = None if quoted is None else np.full(p.shape, quoted)
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    return Dataset("orbit", (Scene("a", times, p, bodies, None, errors),), noise=noise, units=units)


@pytest.mark.parametrize("how", [{"noise": (0.05,)}, {"quoted": 0.05}])
def test_declared_noise_is_never_replaced(how):
    law = ["k * m_i / norm(p_i - p_j)^2 * normalize(p_j - p_i)"]
    fit = fit_law(satellite(**how), law, rng=np.random.default_rng(0))
    assert fit.noise["sigma"] == pytest.approx([0.05, 0.05])
    assert fit.reduced_chisqr == pytest.approx(1, abs=0.4)
    (k,) = fit.constants
    assert k.low < GM < k.high and k.high - k.low < 1e-8 * GM


def test_what_is_left_of_positions_declared_exact_is_their_noise():
    law = ["k * m_i / norm(p_i - p_j)^2 * normalize(p_j - p_i)"]
    fit = fit_law(satellite(noise=(0.0,)), law, rng=np.random.default_rng(0))
    assert fit.noise["sigma"] == pytest.approx([0.05, 0.05], rel=0.3)
    assert fit.constants[0].low < GM < fit.constants[0].high
