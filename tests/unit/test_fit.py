"""A hypothesis fitted to whole tracks: values, errors, and what is said of them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import DataError, LawError, SettingsError
from bsp_gp.fitting.fit import FAILED, STATUSES, fit
from bsp_gp.fitting.hypothesis import Hypothesis, Part, read_law
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from bsp_gp.units import UnitSystem
from tests.fitted_tracks import body, dataset_of, scene_of

TIMES = np.linspace(0.0, 4.0, 41)
POST = body("post", is_static=True)
SPRING, DAMPING = "-k * (p_i - p_j)", "-c * v_i"
PUSH = "a * sin(w * t) * e_x"
TRUE = {"k": 4.0, "c": 0.3}


def swing(seed=0, sigma=0.02, noise=None, k=4.0, c=0.3, times=TIMES, m=1.0):
    """A damped spring about a post, in closed form, as a scene and with white noise."""
    rng = np.random.default_rng(seed)
    rate, half = np.sqrt(k / m - (c / m) ** 2 / 4), c / m / 2
    start = np.array([[1.0, 0.2], [0.0, 1.5]])  # place, velocity
    cosine, sine = np.cos(rate * times)[:, None], np.sin(rate * times)[:, None]
    track = np.exp(-half * times)[:, None] * (
        start[0] * cosine + (start[1] + half * start[0]) / rate * sine
    )
    places = np.zeros((len(times), 2, 2))
    places[:, 0] = track + sigma * rng.standard_normal(track.shape)
    scene = scene_of(times, (body("a", m), POST), places)
    return dataset_of([scene], noise=None if noise is None else (noise, noise))


def fitted(dataset, *laws, **options):
    return fit(Hypothesis.from_laws(dataset, list(laws)), dataset, **options)


@lru_cache
def ordinary():
    return fitted(swing(noise=0.02), SPRING, DAMPING)


def values(found):
    return dict(zip([name for name, _ in found.parameters], found.values, strict=True))


# --- fields -----------------------------------------------------------------------------------


def test_fields_of_a_fit():
    found = ordinary()
    assert found.status == "converged" and not found.is_failed
    assert found.parameters == (("k", ""), ("c", ""))
    assert (found.n_rows, found.n_free) == (82, 2 + 4)
    assert found.law.constants == values(found)
    assert found.covariance.shape == (2, 2)
    np.testing.assert_array_equal(found.errors, np.sqrt(np.diag(found.covariance)))
    np.testing.assert_array_less(np.abs(found.values - [4.0, 0.3]), 4 * found.errors)
    assert np.all(found.errors < [0.1, 0.1])
    assert found.residual.shape == found.whitened.shape == (41, 2)
    np.testing.assert_allclose(found.whitened, found.residual / 0.02, rtol=1e-12)
    assert found.chisqr == pytest.approx(np.sum(found.whitened**2), rel=1e-6)
    assert found.chi2_red == pytest.approx(found.chisqr / (82 - 6))
    normal = -0.5 * np.sum(found.whitened**2) - 82 * np.log(0.02 * np.sqrt(2 * np.pi))
    assert found.log_likelihood == pytest.approx(normal, rel=1e-9)
    assert found.log_evidence < found.log_likelihood
    information = found.jacobian.T @ found.jacobian
    np.testing.assert_allclose(np.linalg.inv(information), found.covariance, rtol=1e-6)
    assert found.local_columns.shape == (4, 41, 2) and found.shared_columns.shape == (2, 41, 2)
    assert found.gradient < 1e-3
    assert found.n_starts >= found.n_agree >= 1
    assert found.noise.levels == (0.02, 0.02)
    assert not found.paper_steps


def test_predictions_and_states_are_the_law_s_own_track():
    found = ordinary()
    dataset = swing(noise=0.02)
    (nodes,) = found.nodes
    k, c = found.values

    def slope(t, y):
        return [*y[2:], *(-k * y[:2] - c * y[2:])]

    track = solve_ivp(
        slope, (0, 4), nodes[:, 0, :, 0, 0].ravel(), t_eval=TIMES, rtol=1e-11, atol=1e-11
    ).y
    np.testing.assert_allclose(nodes[:, 0, :, :, 0].reshape(4, -1), track, atol=1e-4)
    places = dataset.scenes[0].positions[:, 0]
    np.testing.assert_allclose(found.residual, places - track[:2].T, atol=1e-4)


def test_the_same_bits_twice():
    again = fitted(swing(noise=0.02), SPRING, DAMPING)
    for name in ("values", "covariance", "residual", "jacobian"):
        assert getattr(again, name).tobytes() == getattr(ordinary(), name).tobytes()
    assert again.log_evidence == ordinary().log_evidence


def reference(dataset, acceleration, start, sigma):
    """Values, errors and chi-squared by solve_ivp and least_squares over constants and states."""
    scene = dataset.scenes[0]
    seen = scene.positions[:, 0]

    def residual(u):
        def slope(t, y):
            return [*y[2:], *acceleration(t, y[:2], y[2:], u[:-4])]

        track = solve_ivp(
            slope, scene.times[[0, -1]], u[-4:], t_eval=scene.times, method="DOP853", rtol=1e-10,
            atol=1e-10,
        )  # fmt: skip
        return ((seen - track.y[:2].T) / sigma).ravel()

    found = least_squares(residual, start, x_scale="jac", jac="3-point", xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    n = len(start) - 4
    return found.x[:n], np.sqrt(np.diag(covariance))[:n], 2 * found.cost


BY_SCIPY = {
    "spring": ((SPRING, DAMPING), lambda t, p, v, u: -u[0] * p - u[1] * v, [4.0, 0.3]),
    "power": (
        ("-k * norm(p_i - p_j)^n * normalize(p_i - p_j)",),
        lambda t, p, v, u: -u[0] * np.linalg.norm(p) ** (u[1] - 1) * p, [4.0, 1.0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ["spring", "power"])
def test_values_and_errors_are_scipys(name):
    laws, acceleration, guess = BY_SCIPY[name]
    dataset = swing(noise=0.02, c=0.3 if name == "spring" else 0.0)
    found = fitted(dataset, *laws)
    x, errors, chisqr = reference(dataset, acceleration, [*guess, 1.0, 0.2, 0.0, 1.5], 0.02)
    assert found.status == "converged"
    np.testing.assert_array_less(np.abs(found.values - x) / errors, 1e-3)
    np.testing.assert_allclose(found.errors, errors, rtol=0.01)
    assert found.chisqr == pytest.approx(chisqr, rel=1e-5)


# --- statuses ---------------------------------------------------------------------------------


def test_statuses_are_those_of_the_design():
    assert STATUSES == (
        "nonfinite", "unconverged", "aliased", "at_bound", "refuted", "converged",
    )  # fmt: skip
    assert FAILED == ("nonfinite", "unconverged", "aliased")


def test_a_constant_at_its_bound_is_said_to_be_there():
    found = fitted(swing(noise=0.02), SPRING, DAMPING, bounds={"c": (0.5, 2.0)})
    assert found.status == "at_bound" and not found.is_failed
    assert values(found)["c"] == 0.5
    inside = fitted(swing(noise=0.02), SPRING, DAMPING, bounds={"c": (0.1, 2.0)})
    assert inside.status == "converged"
    np.testing.assert_allclose(inside.values, ordinary().values, rtol=1e-4)


def test_declared_errors_that_are_far_too_small_refute_the_law():
    found = fitted(swing(noise=0.002), SPRING, DAMPING)
    assert found.status == "refuted" and not found.is_failed
    assert found.chi2_red == pytest.approx(100, rel=0.5)
    assert fitted(swing(noise=0.02), SPRING).status == "refuted"  # and so does a lack


def test_a_rate_beyond_what_rows_show_is_an_alias():
    """Pushed at 7 rad/s, seen every 0.1 s: 2 pi / 0.1 - 7 moves it just so."""
    times = 0.1 * np.arange(60)
    push = np.zeros((60, 1, 2))
    push[:, 0, 0] = -0.5 / 49 * np.sin(7 * times)
    push[:, 0, 0] += 0.5 * times + 2e-4 * np.random.default_rng(1).standard_normal(60)
    dataset = dataset_of([scene_of(times, (body("a"),), push)], noise=(2e-4, 2e-4))
    right = fitted(dataset, PUSH)
    assert right.status == "converged"
    assert abs(values(right)["w"] - 7.0) < 4 * right.errors[1]
    wrong = fitted(dataset, PUSH, starts={"w": 2 * np.pi / 0.1 - 7.0})
    assert wrong.status == "aliased" and wrong.is_failed
    assert values(wrong)["w"] > np.pi / 0.1


def test_a_fit_that_runs_out_of_time_is_not_converged():
    found = fitted(swing(noise=0.02), SPRING, DAMPING, deadline=0.0, starts={"k": 40.0, "c": 3.0})
    assert found.status == "unconverged" and found.is_failed


@pytest.mark.slow
@pytest.mark.parametrize("start", [{"n": 5000.0, "k": 1e300}, {"n": 700.0, "k": 1.0}])
def test_a_law_that_has_no_finite_track_is_said_so(start):
    law = "-k * norm(p_i - p_j)^n * normalize(p_i - p_j)"
    found = fitted(swing(noise=0.02), law, starts=start)
    assert found.status == "nonfinite" and found.is_failed


def test_a_constant_that_data_do_not_determine_has_no_finite_error():
    found = fitted(swing(noise=0.02), SPRING, "-c1 * v_i", "-c2 * v_i")
    assert np.isinf(found.errors[1:]).all() and np.isfinite(found.errors[0])
    assert values(found)["c1"] + values(found)["c2"] == pytest.approx(
        values(ordinary())["c"], abs=0.01 * ordinary().errors[1]
    )


# --- what is handed in -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"starts": {"q": 1.0}}, "start of q: the law has no such constant; it has c, k"),
        ({"bounds": {"q": (0.0, 1.0)}}, "bound of q: the law has no such constant; it has c, k"),
        ({"bounds": {"k": (2.0, 1.0)}}, "bounds of k must be LOW..HIGH, got 2..1"),
        ({"starts": {"k": 9.0}, "bounds": {"k": (0.0, 5.0)}}, "must lie within its bounds 0..5"),
    ],
)
def test_starts_and_bounds_that_cannot_be(options, words):
    with pytest.raises(SettingsError, match=words.replace("(", r"\(")):
        fitted(swing(noise=0.02), SPRING, DAMPING, **options)


def test_what_does_not_move_cannot_be_fitted():
    scene = scene_of(TIMES, (body("a"), POST), [[1.0, 1.0], [0.0, 0.0]])
    with pytest.raises(DataError, match="nothing moves"):
        fitted(dataset_of([scene]), SPRING)


def test_a_text_that_is_no_force_is_named():
    with pytest.raises(LawError, match=r"9.81 \* 2 \* m_i \* down"):
        Hypothesis.from_laws(swing(), ["9.81 * 2 * m_i * down"])


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("9.81 * m_i * e_y", "9.81 [m/s^2] * m_i * e_y"),
        ("m_i * 9.81 * e_y - c * v_i", "m_i * 9.81 [m/s^2] * e_y - c * v_i"),
        ("-9.81 [m/s^2] * e_y", "m_i * (-9.81 [m/s^2] * e_y)"),
        ("-0.3 * v_i", "-0.3 [kg/s] * v_i"),
    ],
)
def test_where_one_unit_makes_a_force_of_a_law_in_si_it_may_be_left_out(typed, read):
    dataset = swing()
    assert read_law(dataset, typed).text(digits=False) == read
    coarse = replace(dataset, units=UnitSystem.from_declared({**dataset.units.declared,
                                                              "length": "cm"}))  # fmt: skip
    if typed != "-9.81 [m/s^2] * e_y":
        with pytest.raises(LawError, match="give its number a unit, as in"):
            read_law(coarse, typed)


def test_hypotheses_add_up():
    dataset = swing(noise=0.02)
    one, two = (Hypothesis.from_laws(dataset, [law]) for law in (SPRING, DAMPING))
    both = one + two
    assert both.law.names == ("k", "c") and len([p for p in both.parts if p.kind == "noise"]) == 1
    assert [p.name for p in both.parameters] == ["k", "c"]
    found = fit(both, dataset)
    np.testing.assert_allclose(found.values, ordinary().values, rtol=1e-6)
    assert "F_i = " in both.describe()
    assert Part().parameters == ()


def test_a_start_is_where_it_begins():
    found = fitted(swing(noise=0.02), SPRING, DAMPING, starts={"k": 3.0, "c": 0.0})
    np.testing.assert_allclose(found.values, ordinary().values, rtol=1e-4)
    dataset = swing(noise=0.02)
    law = ordinary().law.with_constants({"k": 3.0})
    assert fit(Hypothesis.from_laws(dataset, law), dataset).status == "converged"


# --- rows and scenes ----------------------------------------------------------------------------


def test_rows_that_were_not_seen_count_for_nothing():
    """Blank rows, and the same rows left out."""
    dataset = swing(noise=0.02)
    scene = dataset.scenes[0]
    lost = np.array([3, 4, 17, 30])
    blank = scene.positions.copy()
    blank[lost, 0] = np.nan
    kept = np.setdiff1d(np.arange(41), lost)
    both = [
        fitted(dataset_of([s], noise=(0.02, 0.02)), SPRING, DAMPING)
        for s in (
            Scene("s", scene.times, blank, scene.entities),
            Scene("s", scene.times[kept], scene.positions[kept], scene.entities),
        )
    ]
    assert [found.n_rows for found in both] == [74, 74]
    np.testing.assert_allclose(both[0].values, both[1].values, atol=1e-3 * both[0].errors.min())
    np.testing.assert_allclose(both[0].errors, both[1].errors, rtol=1e-4)


def test_scenes_share_constants_and_have_states_of_their_own():
    scenes = []
    for seed, n in ((1, 41), (2, 25)):
        own = swing(seed, times=TIMES[:n]).scenes[0]
        scenes.append(Scene(f"s{seed}", own.times, own.positions, own.entities))
    found = fitted(dataset_of(scenes, noise=(0.02, 0.02)), SPRING, DAMPING)
    assert (found.n_rows, found.n_free) == (2 * (41 + 25), 2 + 8)
    alone = [fitted(dataset_of([s], noise=(0.02, 0.02)), SPRING, DAMPING) for s in scenes]
    inverse = [np.linalg.inv(f.covariance) for f in alone]
    np.testing.assert_allclose(np.linalg.inv(found.covariance), sum(inverse), rtol=0.1)
    weighted = sum(i @ f.values for i, f in zip(inverse, alone, strict=True))
    mean = np.linalg.solve(sum(inverse), weighted)
    np.testing.assert_array_less(np.abs(found.values - mean), 0.2 * found.errors)


# --- evidence ---------------------------------------------------------------------------------


def in_units(dataset, length, time, noise):
    """The same recording with other numbers: lengths and times multiplied."""
    scenes = [
        Scene(s.name, time * s.times, length * s.positions, s.entities) for s in dataset.scenes
    ]
    return dataset_of(scenes, noise=None if noise is None else (length * noise,) * 2)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.02, None], ids=["declared", "estimated"])
def test_evidence_does_not_know_units(noise):
    """Metres as feet, seconds as milliseconds: the difference between two hypotheses stays."""
    dataset = swing(3, noise=noise)
    gains = []
    for length, time in ((1.0, 1.0), (1 / 0.3048, 1e3)):
        other = in_units(dataset, length, time, noise)
        pair = [fitted(other, *laws) for laws in ((SPRING,), (SPRING, DAMPING))]
        assert pair[1].status == "converged"
        gains.append(pair[1].log_evidence - pair[0].log_evidence)
    assert gains[0] > 10
    assert gains[1] == pytest.approx(gains[0], rel=1e-6)


@pytest.mark.slow
def test_evidence_finds_what_is_there_and_nothing_else():
    """A weak damping of five standard errors and none, eight recordings each.

    Twice the gain of likelihood of a term of s standard errors is (s + z)^2 with z normal; what is
    not there loses Occam's factor, some nats, unless |z| > 3: once in 370.
    """
    gains = {0.0: [], 0.05: []}
    for c, found in gains.items():
        for seed in range(8):
            dataset = swing(seed, c=c, sigma=0.02, noise=0.02)
            one, two = fitted(dataset, SPRING), fitted(dataset, SPRING, DAMPING)
            found.append(two.log_evidence - one.log_evidence)
            assert two.log_likelihood >= one.log_likelihood - 1e-3
    assert np.sum(np.array(gains[0.0]) < 0) >= 7
    assert np.sum(np.array(gains[0.05]) > 0) >= 7


# --- noise ------------------------------------------------------------------------------------


def pendulum(seed, n=600, sigma=0.008):
    """The angle of a damped pendulum in radians, as if along x: 24 swings."""
    times = 0.05 * np.arange(n)
    track = solve_ivp(
        lambda t, y: [y[1], -25.0 * np.sin(y[0]) - 0.06 * y[1]], (0, times[-1]), [0.6, 0.0],
        t_eval=times, method="DOP853", rtol=1e-10, atol=1e-10,
    ).y  # fmt: skip
    places = np.zeros((n, 2, 2))
    places[:, 0, 0] = track[0] + sigma * np.random.default_rng(seed).standard_normal(n)
    places[:, 1, 1] = -1.0
    return dataset_of([scene_of(times, (body("bob"), POST), places)])


def test_noise_is_found_with_and_without_a_damping_that_is_missing():
    """Its level within five sampling errors, 1 / sqrt(2 n) each, and damping wins."""
    dataset = pendulum(0)
    swinging = "-g * m_i * sin(dot(p_i - p_j, e_x) / 1 [m]) * e_x"
    with_damping, without = fitted(dataset, swinging, DAMPING), fitted(dataset, swinging)
    assert with_damping.status == "converged"
    level = with_damping.noise.levels[0]
    assert level == pytest.approx(0.008, rel=5 / np.sqrt(2 * 600))
    assert without.noise.levels[0] == pytest.approx(0.008, rel=0.15)
    assert with_damping.log_evidence > without.log_evidence + 20
    off = np.abs(with_damping.values - [25.0, 0.06])
    np.testing.assert_array_less(off, 4 * with_damping.errors)


def test_exact_data_are_fitted_to_rounding():
    dataset = swing(sigma=0.0, noise=0.0)
    hypothesis = Hypothesis.from_laws(dataset, [SPRING, DAMPING], paper_steps=False)
    found = fit(hypothesis, dataset)
    assert found.status == "converged"
    np.testing.assert_allclose(found.values, [4.0, 0.3], rtol=1e-8)


def test_exact_data_that_two_kinds_of_steps_explain_are_continuous_motion():
    found = fitted(swing(sigma=0.0, noise=0.0), SPRING, DAMPING)
    np.testing.assert_allclose(found.values, [4.0, 0.3], rtol=1e-8)


# --- tails ------------------------------------------------------------------------------------


def with_gross_errors(dataset, seed, share=0.03, size=30.0):
    """The same with errors of so many times the noise in a share of the rows, all to one side."""
    (scene,) = dataset.scenes
    rng = np.random.default_rng([seed, 9])
    positions = scene.positions.copy()
    rows = np.flatnonzero(rng.random(len(positions)) < share)
    positions[rows, 0] += size * 0.02 * (1 + rng.random((len(rows), 2)))
    return dataset_of([replace(scene, positions=positions)]), rows


def test_gross_errors_do_not_pull_on_a_fit_whose_noise_has_tails():
    clean = swing(times=np.linspace(0.0, 8.0, 161))
    dirty, rows = with_gross_errors(clean, 0)
    assert len(rows) >= 3
    without, found = fitted(clean, SPRING, DAMPING), fitted(dirty, SPRING, DAMPING)
    assert found.status == "converged"
    assert "tails" in found.noise.describe()
    assert found.n_rows == without.n_rows  # none is left out
    assert np.abs((found.values - without.values) / without.errors).max() < 2.0
    assert (found.errors < 1.5 * without.errors).all()
    assert (np.abs(found.whitened[rows]) < 3.0).all()  # of 30 and more
    assert np.abs(found.residual[rows]).min() > 0.5


@pytest.mark.slow
def test_errors_under_tails_are_those_of_students_information():
    """z of both constants over a few draws is about one: the weights alone would say 1.5."""
    times, z = np.linspace(0.0, 8.0, 161), []
    for seed in range(12):
        noise = 0.02 * np.random.default_rng([seed, 3]).standard_t(3.0, (len(times), 2))
        (scene,) = swing(sigma=0.0, times=times).scenes
        positions = scene.positions.copy()
        positions[:, 0] += noise
        found = fitted(dataset_of([replace(scene, positions=positions)]), SPRING, DAMPING)
        assert np.isfinite(found.noise.degrees)
        z.append((found.values - list(TRUE.values())) / found.errors)
    spread = np.sqrt(np.mean(np.square(z)))
    assert 0.7 < spread < 1.35


@pytest.mark.slow
def test_known_noise_has_no_tails():
    dirty, _ = with_gross_errors(swing(times=np.linspace(0.0, 8.0, 161)), 0)
    found = fitted(replace(dirty, noise=(0.02, 0.02)), SPRING, DAMPING)
    assert found.status == "refuted"
    assert np.isinf(found.noise.degrees)


def test_the_time_is_looked_at_within_an_integration(monkeypatch):
    """The limit comes while steps are chosen: no further step is taken."""
    dataset = swing(noise=0.02)
    clock = iter([0.0] * 3 + [1e9] * 10**6)
    monkeypatch.setattr("bsp_gp.fitting.fit.time.monotonic", lambda: next(clock))
    found = fitted(dataset, SPRING, DAMPING, deadline=1.0)
    assert found.status == "unconverged" and found.message == "stopped"


def test_a_flow_that_is_over_has_no_ends():
    shown = ordinary()
    (chains,), (nodes,) = shown.groups, shown.nodes
    motion = Motion(shown.law, chains, shown.parameters)
    motion.set_constants(shown.values)
    flow = Flow(motion, np.full(chains.n_chains, 1e-9))
    mesh = flow.mesh(nodes)
    assert mesh.is_complete and np.isfinite(flow.run(nodes, mesh)[0]).all()
    late = Flow(motion, flow.tolerance, is_over=lambda share: True)
    assert not late.mesh(nodes).is_complete
    ends, transitions = late.run(nodes, mesh)
    assert np.isnan(ends).all() and np.isnan(transitions).all()


def test_rounding_does_not_choose_between_the_papers_steps_and_continuous_motion():
    """Without a force both lead straight on; what extends the fit was bound to the wrong ones."""
    times, bodies = 0.02 * np.arange(40), [Entity("ball", "disc", radius=0.1)]
    scenes = []
    for k in range(4):
        places = np.stack([0.3 * times * (1 + k), 0.2 * times + 0.05 * (k + 1) * times**2], axis=-1)
        scenes.append(Scene(f"s{k}", times, places[:, None], bodies))
    units = UnitSystem.from_declared({"length": "m", "time": "s"})
    found = fit(Hypothesis.from_laws(Dataset("d", scenes, units=units), "nothing"),
                Dataset("d", scenes, units=units))  # fmt: skip
    assert found.status == "refuted" and found.paper_steps
