"""Inference on whole tracks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from bsp_gp.cli import main
from bsp_gp.data.scene import LatentDeclaration
from bsp_gp.data.tables import save_dataset
from bsp_gp.errors import EvaluationError
from bsp_gp.inference import tracks
from bsp_gp.inference.e_step import EStep, infer, refine
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.misfit import ReducedMisfit
from bsp_gp.inference.posterior import Posterior
from bsp_gp.inference.track_path import ScenePath
from bsp_gp.inference.track_reference import find_reference
from bsp_gp.inference.track_world import TrackWorld
from tests import double_star, latent_worlds

UNKNOWN = LatentDeclaration("mass", low=0.2, high=9.0, entities=("A", "B"))


def track(sigma=1e-3, **settings):
    return Likelihood("track", sigma=np.full(2, sigma), velocities="central", **settings)


@pytest.fixture(scope="module")
def star():
    """Data, and the misfit of the right law on them."""
    data = double_star.dataset(1)
    latents = double_star.masses_of(data)
    return data, latents, track().misfit(double_star.law_of(data), latents, data.scenes)


def chisq_by_scipy(data, masses, c, near):
    """Of a whole track with its initial state fitted."""
    (scene,) = data.scenes

    def residual(state):
        places = double_star.motion(scene.times, state, masses, c)
        return ((places - scene.positions) / 1e-3).ravel()

    return 2 * least_squares(residual, near, x_scale="jac", method="lm").cost


@pytest.mark.slow
def test_log_likelihoods_are_those_of_tracks_with_fitted_initial_states(star):
    data, _, misfit = star
    profile = misfit.reference.profile
    rng = np.random.default_rng(0)
    factor = np.linalg.cholesky(np.linalg.inv(profile.information))
    draws = np.concatenate([profile.values, profile.constants])
    draws = draws + rng.standard_normal((3, 3)) @ factor.T
    found = -2 * misfit.log_likelihood(draws[:, :2], draws[:, 2:])
    near = double_star.start(0.3)
    expected = np.array([chisq_by_scipy(data, d[:2], d[2], near) for d in draws])
    assert found == pytest.approx(expected, abs=0.1)
    exact = misfit.reference.exact_chisq(draws[:, :2], draws[:, 2:])
    assert exact == pytest.approx(expected, abs=0.1)
    # The error of the integration is the same everywhere.
    assert exact - exact[0] == pytest.approx(expected - expected[0], abs=0.02)


def test_the_optimum_is_the_truth_where_single_steps_are_blind(star):
    data, latents, misfit = star
    profile = misfit.reference.profile
    sd = np.sqrt(np.diag(np.linalg.inv(profile.information)))
    gap = np.concatenate([profile.values - latents.truth, profile.constants - double_star.C])
    assert np.all(np.abs(gap) < 4 * sd)
    assert np.all(sd[:2] < 1e-3) and sd[2] < 1e-5
    assert any("less accurately than whole tracks" in note for note in misfit.notes)


def test_products_and_laws_evaluated_everywhere_agree(star):
    data, latents, misfit = star
    assert isinstance(misfit, ReducedMisfit)
    direct = misfit.reference.bank.direct(misfit.law, latents)
    rng = np.random.default_rng(0)
    values = latents.sample(5, rng=rng)
    constants = rng.uniform(-0.1, 0.1, (5, 1))
    assert direct.chisq(values, constants) == pytest.approx(
        misfit.chisq(values, constants), rel=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"epochs": 12, "revolutions": 8}, {"epochs": 40}])
def test_coarse_rows_are_no_hindrance(settings):
    data = double_star.dataset(3, **settings)
    latents = double_star.masses_of(data)
    law = double_star.law_of(data, c=1.0)
    profile = track().misfit(law, latents, data.scenes).reference.profile
    assert profile.values == pytest.approx(latents.truth, rel=0.005)
    assert profile.constants == pytest.approx([double_star.C], rel=0.01)


def test_a_level_estimated_from_the_tracks_alone_is_estimated_anew():
    data = double_star.dataset(4)
    latents = double_star.masses_of(data)
    likelihood = track(sigma=2e-2, is_estimated=True)
    misfit = likelihood.misfit(double_star.law_of(data), latents, data.scenes)
    assert misfit.reference.world.sigma == pytest.approx([1e-3, 1e-3], rel=0.15)
    assert any("estimated under the law" in note for note in misfit.notes)


def test_gaps_in_a_track_are_carried_over():
    data = double_star.dataset(5)
    positions = np.array(data.scenes[0].positions)
    positions[10:14, 0] = np.nan
    positions[60, 1] = np.nan
    scenes = (replace(data.scenes[0], positions=positions),)
    latents = double_star.masses_of(data)
    misfit = track().misfit(double_star.law_of(data), latents, scenes)
    assert misfit.reference is not None
    assert misfit.reference.profile.values == pytest.approx(latents.truth, rel=0.005)
    assert misfit.n_rows == 4 * 161 - 10 - 8


@pytest.mark.slow
def test_quoted_errors_weigh_their_points():
    data = double_star.dataset(5)
    sigma = np.full(data.scenes[0].positions.shape, 1e-3)
    sigma[::2] = 4e-3
    scenes = (replace(data.scenes[0], sigma=sigma),)
    latents = double_star.masses_of(data)
    law = double_star.law_of(data)
    quoted = track(is_quoted=True).misfit(law, latents, scenes).reference.profile.information
    plain = track().misfit(law, latents, scenes).reference.profile.information
    # Half of the points count a sixteenth.
    assert np.diag(quoted) / np.diag(plain) == pytest.approx(np.full(3, 17 / 32), rel=0.1)


def test_what_an_acceleration_does_to_a_free_body_is_its_double_integral():
    """x'' = a(t): impulses a at the starts of intervals, carried along without forces."""
    h, n = 0.5, 6
    drift = np.array([[1.0, h], [0.0, 1.0]])
    path = ScenePath(
        "s", h * np.arange(n - 1), np.zeros((2, 1, 1, n - 1)),
        np.tile([[[h**2]], [[h]]], (n - 1, 1, 1, 1)).reshape(n - 1, 2, 1), np.arange(n - 1),
        np.tile(drift, (n - 1, 1, 1)), np.zeros((n - 1, 2)), np.zeros((n, 1)), np.ones((n, 1)),
        np.full(2, 1e-6), [(0, n)],
    )  # fmt: skip
    a = np.random.default_rng(0).normal(size=(n - 1, 1, 1))
    found = path.apply(a)[:, 0]
    v = h * np.cumsum(a.ravel())
    x = np.concatenate([[0.0], h * np.cumsum(v)])
    line = np.stack([np.ones(n), np.arange(n)], axis=1)
    left = x - line @ np.linalg.lstsq(line, x, rcond=None)[0]
    assert found @ found == pytest.approx(left @ left, rel=1e-6)


def test_exact_tracks_are_a_point_of_numerical_width():
    some = latent_worlds.scenes(1)
    latents = latent_worlds.masses_of(some)
    law = latent_worlds.law_of(latent_worlds.PULL, c1=20.0)
    likelihood = Likelihood("track", sigma=1e-3, exact=1e-11)
    misfit = likelihood.misfit(law, latents, some)
    assert misfit.reference.world.paper_steps  # as the world was made
    posterior = refine(
        misfit.reference.profile, some, latents, likelihood, rng=np.random.default_rng(0),
        misfit=misfit,
    )  # fmt: skip
    assert posterior.method == "laplace"
    assert posterior.mean == pytest.approx([*latents.truth, 20.0], rel=1e-7)
    assert np.all(posterior.sd < 1e-6 * posterior.mean)
    assert any("numerically a point" in note for note in posterior.notes)


def test_what_exact_tracks_leave_free_is_sampled():
    """Only c1 m_j of a body is seen by the others: the constant and both masses scale."""
    some = latent_worlds.scenes(1)
    latents = latent_worlds.latents_of(some, "mass", latent_worlds.Prior("uniform", 0.2, 400.0))
    law = latent_worlds.law_of(latent_worlds.PULL, c1=20.0)
    likelihood = Likelihood("track", sigma=1e-3, exact=1e-11)
    misfit = likelihood.misfit(law, latents, some)
    posterior = refine(
        misfit.reference.profile, some, latents, likelihood, rng=np.random.default_rng(0),
        settings=EStep(n_eff=50, max_steps=600), misfit=misfit,
    )  # fmt: skip
    assert posterior.method == "emcee"
    assert np.ptp(posterior.draws[:, -1]) > 1.0
    assert any("leave something free" in note for note in posterior.notes)


@pytest.mark.slow
def test_draws_are_weighted_where_tracks_bend(star):
    data, latents, misfit = star
    profile = misfit.reference.profile
    rng = np.random.default_rng(0)
    wide = 6 * np.linalg.cholesky(np.linalg.inv(profile.information))
    draws = np.concatenate([profile.values, profile.constants])
    draws = draws + rng.standard_normal((800, 3)) @ wide.T
    n = len(draws)
    made = Posterior(
        (*latents.names, "c"), draws, np.full(n, 1 / n),
        misfit.log_likelihood(draws[:, :2], draws[:, 2:]), "test", np.full(3, n), np.full(3, 1.0),
    )  # fmt: skip
    found = tracks.reweighted(made, misfit, latents, rng=rng)
    assert "weighted" in found.method
    ratio = -0.5 * misfit.reference.exact_chisq(found.draws[:5, :2], found.draws[:5, 2:])
    ratio -= misfit.log_likelihood(found.draws[:5, :2], found.draws[:5, 2:])
    assert np.log(found.weights[:5] / found.weights[0]) == pytest.approx(ratio - ratio[0], abs=1e-6)
    narrow = replace(made, draws=profile_draws(profile, rng))
    assert tracks.reweighted(narrow, misfit, latents, rng=rng) is narrow


def profile_draws(profile, rng):
    factor = np.linalg.cholesky(np.linalg.inv(profile.information))
    centre = np.concatenate([profile.values, profile.constants])
    return centre + 0.3 * rng.standard_normal((800, 3)) @ factor.T


def test_without_an_optimum_single_steps_are_read_and_it_is_said(monkeypatch):
    monkeypatch.setattr(tracks, "_references", lambda *a: [])
    data = double_star.dataset(1)
    latents = double_star.masses_of(data)
    posterior = infer(
        double_star.law_of(data), data.scenes, latents, track(), rng=np.random.default_rng(0),
        settings=EStep(n_eff=50, max_steps=300),
    )  # fmt: skip
    assert any("no joint optimum was found on whole tracks" in note for note in posterior.notes)


def test_contacts_on_continuous_tracks_are_left_to_single_steps():
    """What a law with conditions does hangs on when they begin: no frozen track knows it."""
    some = latent_worlds.scenes(1, noise=0.01)
    latents = latent_worlds.masses_of(some)
    text = "c1 * m_j * does_collide(s_i, p_i, s_j, p_j) * normalize(p_i - p_j)"
    law = latent_worlds.law_of(text, c1=20.0)
    world = TrackWorld(law, latents, some, np.full(2, 0.01))
    with pytest.raises(EvaluationError, match="paper's steps only"):
        find_reference(world, latents.sample(2, rng=np.random.default_rng(0)))


@pytest.mark.slow
def test_infer_reads_whole_tracks_by_default(tmp_path, capsys):
    data = double_star.dataset(2, latents=(UNKNOWN,))
    folder = str(save_dataset(data, tmp_path / "star"))
    words = ["infer", folder, "--law", double_star.PULL, "--law", double_star.DRAG]
    assert main([*words, "--json", "--quiet", "--n-eff", "200"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["likelihood"] == "track"
    truth = {"mass[s:A]": 2.0, "mass[s:B]": 1.0, "c": double_star.C}
    for item in result["posterior"]["latents"]:
        assert item["mean"] == pytest.approx(truth[item["name"]], rel=0.01)
        assert item["low"] < item["high"] < 1.01 * item["low"]
