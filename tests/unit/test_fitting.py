import json
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.errors import BspError, EvaluationError, LawError, SettingsError
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.fitting import fit_law, simulate_law
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
                         "method": "x: as declared; y: as declared"}
    # From 10 noisy rows each prediction is off by a few noise widths only.
    assert fit.errors.rollout_rmse < 0.1


def test_text_has_the_parts_of_a_fit_report(fit):
    text = fit.text()
    for part in ("[[Model]]\n    F_i = 9.81 [m/s^2] * m_i * down - c1 * v_i", "[[Fit Statistics]]",
                 "# data points      = 240", "reduced chi-square = ", "converged          = yes",
                 "[[Held-out Errors]]", "rollout rms", " m\n", "    c1: 0.", " ± ", " kg/s ("):
        assert part in text
    assert "[[Correlations]]" not in text


def test_dict_is_json(fit):
    data = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert data["schema"] == "bsp_gp/fit/1"
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


def test_fit_of_the_same_law_twice_is_the_same(noisy, fit):
    again = fit_law(noisy, declared_law(noisy, [GRAVITY, DRAG]), rng=rng(), noise=0.01)
    assert again.to_dict() == fit.to_dict()


@pytest.mark.parametrize(
    ("laws", "noise", "error", "message"),
    [
        (["c1 * m_i"], None, LawError, "must be a vector"),
        ([GRAVITY], (1, 2, 3), SettingsError, "one per axis"),
        ([GRAVITY], -1, SettingsError, "not negative"),
        ([GRAVITY], np.nan, SettingsError, "finite"),
        (["c1 / 0 * v_i"], None, EvaluationError, "no finite value"),
        (["c1 * v_i * norm(v_j)"], None, LawError, "second body"),
    ],
)
def test_bad_arguments_of_fit(noisy, laws, noise, error, message):
    with pytest.raises(error, match=message):
        fit_law(noisy, laws, rng=rng(), noise=noise)


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
        ([GRAVITY], {"noise": 0.1}, "rng"),
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
