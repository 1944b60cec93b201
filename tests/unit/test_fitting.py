import json
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.errors import BspError, LawError, SettingsError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.fitting.simulation import simulate_law
from tests.throws import C1, DRAG, GRAVITY, throws


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def noisy():
    return throws(n_scenes=6, n_times=30, sigma=0.01)


@pytest.fixture(scope="module")
def fit(noisy):
    return fit_law(noisy, [GRAVITY, DRAG], rng=rng(), noise=0.01)


def test_a_constant_is_recovered_within_its_interval(fit):
    (c1,) = fit.constants
    assert c1.low < C1 < c1.high
    assert c1.high - c1.low < 0.02 * C1
    assert (c1.name, c1.unit, c1.entity) == ("c1", "kg/s", "")
    assert fit.converged
    # 6 scenes, a quarter held out; 4 numbers of initial state for each, and the constant.
    assert (fit.n_rows, fit.n_free) == (4 * 30 * 2, 4 * 4 + 1)
    assert fit.reduced_chisqr == pytest.approx(1, abs=4 * np.sqrt(2 / fit.n_rows))
    assert fit.noise == {"sigma": [0.01, 0.01], "unit": "m", "source": "declared",
                         "method": "x: as declared; y: as declared", "correlation_time": None,
                         "correlated": 0.0, "tails": None}
    assert fit.status == "converged"
    assert 1 <= fit.n_agree <= fit.n_starts
    assert fit.gradient < 1e-3
    # From 10 noisy rows each prediction is off by a few noise widths only.
    assert fit.errors.rollout_rmse < 0.1


def test_text_has_the_parts_of_a_fit_report(fit):
    text = fit.text()
    for part in ("[[Model]]\n    F_i = 9.81 [m/s^2] * m_i * down - c1 * v_i", "[[Fit Statistics]]",
                 "# data points      = 240", "reduced chi-square = ",
                 "status             = converged: a minimum",
                 "[[Held-out Errors]]", "rollout rms", " m\n", "    c1: 0.", " ± ", " kg/s ("):
        assert part in text
    assert "[[Correlations]]" not in text


def test_dict_is_json(fit):
    data = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert data["schema"] == "bsp_gp/fit/2"
    assert {"status", "n_starts", "n_agree", "gradient", "chi2_red", "log_evidence"} <= set(data)
    assert data["constants"][0]["state"] == ""
    assert data["law"]["text"].endswith("- c1 * v_i")
    assert data["constants"][0]["value"] == fit.constants[0].value
    assert data["correlation"] == [[1.0]]


def test_constants_that_enter_nonlinearly_and_their_correlations(noisy):
    fit = fit_law(noisy, ["g * m_i * down", "-c1 * norm(v_i)^n * normalize(v_i)"], rng=rng())
    g, c1, n = fit.constants
    assert g.low - 0.05 < 9.81 < g.high + 0.05
    assert n.low - 0.05 < 1 < n.high + 0.05
    assert (g.unit, c1.unit) == ("m/s^2", "")
    a, b, value = fit.correlations()[0]
    assert (a, b) == ("c1", "n")
    assert value < -0.9  # a larger power is made up for by a smaller constant
    assert "C(c1, n) = -0.9" in fit.text()


def test_a_law_without_constants_is_scored(noisy):
    fit = fit_law(noisy, [GRAVITY], rng=rng())
    assert fit.constants == ()
    assert "none: every number" in fit.text()
    assert fit.reduced_chisqr > 10  # the drag is missing
    assert fit.notes[-1].startswith("check: ")


def test_fit_of_the_same_law_twice_is_the_same(noisy, fit):
    # The ones at which a declared law stands are no start values.
    again = fit_law(noisy, declared_law(noisy, [GRAVITY, DRAG]), rng=0, noise=0.01)
    assert again.to_dict() == fit.to_dict()


@pytest.mark.parametrize(
    ("laws", "noise", "error", "message"),
    [
        (["c1 * m_i"], None, LawError, "must be a vector"),
        ([GRAVITY], (1, 2, 3), SettingsError, "one per axis"),
        ([GRAVITY], -1, SettingsError, "not negative"),
        ([GRAVITY], np.nan, SettingsError, "finite"),
        (["c1 * v_i * norm(v_j)"], None, LawError, "second body"),
    ],
)
def test_bad_arguments_of_fit(noisy, laws, noise, error, message):
    with pytest.raises(error, match=message):
        fit_law(noisy, laws, rng=rng(), noise=noise)


@pytest.mark.slow
def test_a_law_without_finite_value_is_a_failed_fit(noisy):
    fit = fit_law(noisy, ["c1 / 0 * v_i"])
    assert (fit.status, fit.converged) == ("nonfinite", False)
    assert np.isnan([fit.constants[0].low, fit.constants[0].high]).all()
    assert "status             = nonfinite: failed" in fit.text()
    assert "±" not in fit.text().split("[[Variables]]")[1].split("\n", 1)[1]


def test_known_errors_that_refute_a_law_widen_its_intervals(noisy):
    law = ["g * m_i * down"]
    declared, estimated = (fit_law(noisy, law, noise=sigma) for sigma in (0.01, None))
    assert declared.status == "refuted"
    assert "the law lacks something" in declared.text()
    (g,) = declared.constants
    # Five standard errors would be 0.05: without drag the fall looks slower by 0.2 m/s^2 and more.
    assert g.high - g.low > 10 * 0.01 * 1.645 / np.sqrt(declared.n_rows)
    assert any("intervals were widened" in note for note in declared.notes)
    (other,) = estimated.constants
    assert other.value == pytest.approx(g.value, abs=g.high - g.low)


def test_a_start_and_bounds_are_kept(noisy):
    law = [GRAVITY, "-c1 * norm(v_i)^n * normalize(v_i)"]
    fit = fit_law(noisy, law, starts={"n": 2.0, "c1": 0.1}, bounds={"n": (1.5, 4.0)}, noise=0.01)
    n = next(c for c in fit.constants if c.name == "n")
    assert (n.value, n.state, fit.status) == (1.5, "at_bound", "at_bound")
    assert n.low == 1.5
    assert "n:  at its bound, 1.5" in fit.text()
    assert "widen bounds" in fit.message


def test_a_time_limit_ends_a_fit_and_is_told(noisy):
    fit = fit_law(noisy, [GRAVITY, DRAG], time_limit=1e-9)
    assert (fit.status, fit.converged) == ("unconverged", False)
    assert "the time limit of 1e-09 s came first" in fit.message
    assert [c.state for c in fit.constants] == ["unfinished"] * len(fit.constants)
    assert "where the fit stood when it was ended" in fit.text()
    assert "undetermined" not in fit.text() and "say nothing of the law" not in fit.text()


def test_what_is_told_can_be_typed_back():
    fit = fit_law(throws(n_scenes=6, n_times=30, sigma=0.01), [GRAVITY, DRAG])
    (c1,) = fit.constants
    again = fit_law(
        throws(n_scenes=6, n_times=30, sigma=0.01), [GRAVITY, DRAG], starts={"c1": c1.value},
        bounds={"c1": (c1.low, c1.high)},
    )  # fmt: skip
    assert again.constants[0].value == pytest.approx(c1.value, rel=1e-4)
    assert again.constants[0].state == ""


def test_constants_that_only_occur_together_are_undetermined(noisy):
    fit = fit_law(noisy, [GRAVITY, "-a * b * v_i"], noise=0.01)
    assert [c.state for c in fit.constants] == ["undetermined", "undetermined"]
    assert "a: undetermined by these data (left at" in fit.text()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"starts": {"z": 1.0}}, "the law has no such constant; it has c1"),
        ({"starts": {"c1": np.nan}}, "the start of c1 must be a finite number"),
        ({"starts": {"c1": "3"}}, "the start of c1 must be a finite number"),
        ({"starts": [1.0]}, "starts must be a mapping"),
        ({"bounds": {"c1": (2.0, 1.0)}}, "LOW..HIGH"),
        ({"bounds": {"c1": 1.0}}, "two numbers"),
        ({"bounds": {"c1": (0.0, 1.0)}, "starts": {"c1": 2.0}}, "must lie within its bounds"),
        ({"time_limit": 0}, "positive number of seconds"),
    ],
)
def test_bad_settings_of_fit(noisy, settings, message):
    with pytest.raises(SettingsError, match=message):
        fit_law(noisy, [GRAVITY, DRAG], **settings)


def test_simulation_reproduces_the_motion_it_started_from():
    exact = throws(n_times=30)
    made = simulate_law(exact, [GRAVITY, DRAG], constants={"c1": C1})
    for before, after in zip(exact.scenes, made.scenes, strict=True):
        # The first rows fix the initial state to rounding; 30 steps of fourth order follow.
        np.testing.assert_allclose(after.positions, before.positions, atol=1e-8)
        assert after.velocities is None
    assert made.noise == (0.0,)
    assert made.provenance["simulated law"].endswith("- 0.2 * v_i")


def test_simulated_noise_has_the_size_asked_for_and_the_seed_decides():
    exact = throws(n_scenes=6, n_times=30)
    law = declared_law(exact, [GRAVITY, DRAG]).with_constants({"c1": C1})
    first, again, other = (simulate_law(exact, law, rng=rng(s), noise=0.1) for s in (0, 0, 1))
    parts = [[s.positions for s in d.scenes] for d in (exact, first, again, other)]
    zero, a, b, c = (np.concatenate(p) for p in parts)
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    # 360 draws: the standard deviation is known to 1 part in sqrt(720), five times that allowed.
    assert np.std(a - zero) == pytest.approx(0.1, rel=5 / np.sqrt(720))
    assert first.noise == (0.1,)


@pytest.mark.parametrize("integrator", ["euler", "leapfrog", "rk4"])
def test_integrators_agree_to_their_order(integrator):
    exact = throws(n_times=30)
    made = simulate_law(exact, [GRAVITY, f"-{C1} [kg/s] * v_i"], integrator=integrator, substeps=8)
    worst = max(np.abs(a.positions - b.positions).max()
                for a, b in zip(exact.scenes, made.scenes, strict=True))
    assert worst < {"euler": 0.1, "leapfrog": 1e-3, "rk4": 1e-8}[integrator]


def test_gaps_and_static_bodies_are_kept():
    from dataclasses import replace

    from bsp_gp.data.scene import Entity

    scene = throws(n_scenes=1).scenes[0]
    positions = np.concatenate([scene.positions, np.full((12, 1, 2), 5.0)], axis=1)
    positions[5, 0] = np.nan
    wall = Entity("post", is_static=True)
    scene = replace(scene, positions=positions, entities=(*scene.entities, wall))
    made = simulate_law(replace(throws(n_scenes=1), scenes=(scene,)), [GRAVITY]).scenes[0]
    assert np.array_equal(made.positions[:, 1], scene.positions[:, 1])
    assert np.array_equal(np.isnan(made.positions), np.isnan(scene.positions))


@pytest.mark.parametrize(
    ("laws", "settings", "message"),
    [
        ([DRAG], {}, "'c1' has no value"),
        ([DRAG], {"constants": {"c1": 1, "c2": 2}}, "no constant 'c2'"),
        ([GRAVITY], {"noise": (1, 1, 1)}, "one per axis"),
        ([GRAVITY], {"substeps": 0}, "substeps"),
        ([GRAVITY], {"integrator": "simpson"}, "integrator must be one of"),
        (["1e300 [kg/s] * v_i"], {}, "scene 's0' leaves the range of numbers"),
    ],
)
def test_bad_arguments_of_simulate(laws, settings, message):
    with pytest.raises(BspError, match=message):
        simulate_law(throws(), laws, **settings)


def test_an_axis_without_motion_is_reported():
    falls = throws(n_scenes=6, n_times=30, sigma=0.01)
    scenes = [replace(s, positions=s.positions * [0.0, 1.0]) for s in falls.scenes]
    fit = fit_law(replace(falls, scenes=tuple(scenes)), [GRAVITY, DRAG], rng=rng())
    assert "nothing moves along x: that axis is left out" in fit.notes
    assert "noise              = -, 0.0" in fit.text()


@pytest.mark.slow
def test_rolled_tracks_are_those_of_a_step_by_step_integration():
    from scipy.integrate import solve_ivp

    from bsp_gp.data.scene import Dataset, Entity, Scene
    from bsp_gp.fitting.hypothesis import read_law
    from bsp_gp.fitting.rolling import roll
    from bsp_gp.physics.engine.chains import build_chains

    times = np.linspace(0.0, 12.0, 241)
    start = np.array([1.0, 0.0, 0.0, 0.6])  # an ellipse about a mass at rest

    def rate(t, y):
        return [y[2], y[3], *(-y[:2] / np.hypot(*y[:2]) ** 3)]

    true = solve_ivp(rate, (0, 12), start, t_eval=times, method="DOP853", rtol=1e-12, atol=1e-13)
    places = np.stack([true.y[:2].T, np.zeros((241, 2))], axis=1)
    measured = places + 0.02 * rng().standard_normal(places.shape) * [[[1.0], [0.0]]]
    bodies = (
        Entity("moon", properties={"mass": 1.0}),
        Entity("sun", is_static=True, properties={"mass": 1.0}),
    )
    dataset = Dataset("orbit", (Scene("s", times, measured, bodies),))
    law = read_law(dataset, ["k * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"])
    for factor in (1.0, 0.7):  # under another law the track leaves the measured one far behind
        law = law.with_constants({"k": factor})
        (chains,) = build_chains(law, dataset.scenes)
        nodes = roll(law, chains, start.reshape(2, 1, 2, 1), np.array([1e-7]))
        rated = solve_ivp(
            lambda t, y, k=factor: [y[2], y[3], *(-k * y[:2] / np.hypot(*y[:2]) ** 3)],
            (0, 12), start, t_eval=times, method="DOP853", rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        np.testing.assert_allclose(nodes[0, 0, :, :, 0], rated.y[:2], atol=1e-6)


@pytest.mark.slow
def test_a_motion_that_runs_away_is_infinitely_wrong():
    from bsp_gp.fitting.hypothesis import read_law
    from bsp_gp.fitting.rolling import roll
    from bsp_gp.physics.engine.chains import build_chains

    dataset = throws(n_scenes=2, n_times=30)
    law = read_law(dataset, ["k * norm(v_i)^4 * v_i"]).with_constants({"k": 1.0})
    (chains,) = build_chains(law, dataset.scenes)
    first = np.zeros((2, 1, 2, 2))
    first[1, 0, 0] = [3.0, 1e-3]  # only the fast one explodes
    tracks = roll(law, chains, first, np.full(2, 1e-6))[0, 0, 0]
    assert np.isinf(tracks[-1, 0])
    assert tracks[-1, 1] == pytest.approx(1e-3 * dataset.scenes[0].times[-1], rel=1e-6)


def test_a_row_far_off_its_neighbours_is_left_out_and_told(noisy, fit):
    scenes = list(noisy.scenes)
    for k in range(len(scenes)):
        positions = scenes[k].positions.copy()
        positions[14, 0, 1] += 0.7
        scenes[k] = replace(scenes[k], positions=positions)
    found = fit_law(replace(noisy, scenes=tuple(scenes)), [GRAVITY, DRAG], noise=0.01)
    assert any("far off their neighbours, and left out of" in n for n in found.notes)
    assert found.status == "converged"
    assert found.n_rows == fit.n_rows - 2 * 4
    (c1,), (before,) = found.constants, fit.constants
    assert c1.value == pytest.approx(before.value, abs=before.high - before.low)


def test_a_row_far_off_its_neighbours_is_weighed_by_tails_where_noise_is_estimated(noisy):
    scenes = list(noisy.scenes)
    for k in range(len(scenes)):
        positions = scenes[k].positions.copy()
        positions[14, 0, 1] += 0.7
        scenes[k] = replace(scenes[k], positions=positions)
    dirty = replace(noisy, scenes=tuple(scenes), noise=None)
    before = fit_law(replace(noisy, noise=None), [GRAVITY, DRAG])
    found = fit_law(dirty, [GRAVITY, DRAG])
    assert any("given little weight by the tails of the noise" in n for n in found.notes)
    assert found.noise["tails"] is not None and before.noise["tails"] is None
    assert found.n_rows == before.n_rows
    assert found.constants[0].value == pytest.approx(
        before.constants[0].value, abs=before.constants[0].high - before.constants[0].low
    )


def test_a_law_without_a_track_on_what_is_held_out_is_told():
    """A drag that falls with the speed has no bound at rest, which the held-out throw passes."""
    from scipy.integrate import solve_ivp

    falls = throws(n_scenes=3, n_times=30, sigma=0.01)
    scenes = []
    for k, scene in enumerate(falls.scenes):
        speed = 3.0 + 3.0 * k  # m/s; a drag of 6 N / v^1.5 on 0.5 kg
        found = solve_ivp(
            lambda t, y: [y[1], 9.81 - 12.0 * y[1] ** -1.5], (0, 1.5), [0.0, speed],
            t_eval=scene.times, rtol=1e-9,
        )  # fmt: skip
        height = found.y[0] if k else 0.5 * 9.81 * scene.times**2 - 12.0 * scene.times
        noise = 0.01 * rng(k).standard_normal(len(height))
        positions = np.stack([0 * height, -height + noise], axis=-1)[:, None]
        scenes.append(replace(scene, positions=positions))
    dataset = replace(falls, scenes=tuple(scenes), train=("s1", "s2"), test=("s0",))
    found = fit_law(dataset, [GRAVITY, "-k * norm(v_i)^n * v_i"])
    assert found.converged
    assert {c.name: c.value for c in found.constants}["n"] == pytest.approx(-2.5, abs=0.5)
    assert np.isinf(found.errors.rollout_rmse)
    (note,) = [n for n in found.notes if "runs away on held-out" in n]
    assert "with n = -2" in note and "--bounds n=0..4" in note
