import json

import numpy as np
import pytest
from scipy import stats

from bsp_gp.errors import SettingsError
from bsp_gp.inference.e_step import EStep, infer, prior_posterior
from bsp_gp.inference.identifiability import identifiability
from bsp_gp.inference.latents import Latents, latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.posterior import (
    Posterior,
    effective_size,
    joined,
    split_r_hat,
    weighted_quantile,
)
from bsp_gp.inference.prediction import posterior_nrmse, predictive_bands
from bsp_gp.inference.priors import Prior
from bsp_gp.inference.profile import fit_profile
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.report.posterior import corner_figure, rollout_figure, trace_figure
from experiments.ranks import coverage, rank_of, simultaneous_band
from tests.latent_worlds import PULL, law_of, masses_of, scenes


def weighted(n=4000, seed=0):
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((n, 2)) * [1.0, 2.0] + [0.0, 5.0]
    weights = rng.uniform(0, 1, n)
    k = np.full(2, effective_size(weights))
    return Posterior(
        ("a", "b"), draws, weights / weights.sum(), np.zeros(n), "importance", k, np.full(2, np.nan)
    )


def test_moments_and_intervals_of_weighted_draws():
    posterior = weighted()
    error = 4 / np.sqrt(posterior.n_eff[0])
    assert posterior.mean == pytest.approx([0, 5], abs=2 * error)
    assert posterior.sd == pytest.approx([1, 2], abs=2 * error)
    assert posterior.interval(0.9)[0] == pytest.approx([-1.645, 1.645], abs=0.15)
    table = posterior.summary()
    assert list(table.index) == ["a", "b"]
    assert {"mean", "sd", "ess", "r_hat"} < set(table.columns)
    json.dumps(posterior.to_dict(), allow_nan=False)


def test_effective_size_and_quantiles_of_simple_weights():
    assert effective_size([1, 1, 1, 1]) == pytest.approx(4)
    assert effective_size([1, 0, 0, 0]) == pytest.approx(1)
    assert weighted_quantile([3.0, 1.0, 2.0], [1, 1, 1], 0.5) == pytest.approx(2.0)


def test_r_hat_sees_chains_that_disagree():
    rng = np.random.default_rng(0)
    good = rng.standard_normal((400, 8, 1))
    assert split_r_hat(good)[0] == pytest.approx(1, abs=0.01)
    bad = good.copy()
    bad[:, :2] += 3
    assert split_r_hat(bad)[0] > 1.2
    assert np.isnan(split_r_hat(good[:3])).all()


def test_independent_blocks_are_joined_in_order():
    a, b = weighted(seed=1), weighted(seed=2)
    b = Posterior(("c", "d"), b.draws, b.weights, b.log_prob, b.method, b.n_eff, b.r_hat)
    both = joined([a, b], ("c", "a", "d", "b"), rng=np.random.default_rng(0))
    assert both.mean == pytest.approx([0, 0, 5, 5], abs=0.3)
    assert np.abs(both.correlation()[0, 1]) < 4 / np.sqrt(4000)


def test_draws_must_fit_names():
    with pytest.raises(SettingsError, match="needs draws"):
        Posterior(("a",), np.zeros((3, 2)), np.ones(3), np.zeros(3), "x", np.ones(1), np.ones(1))


def test_export_to_arviz():
    pytest.importorskip("arviz_base")
    some = scenes(1)
    posterior = infer(
        law_of(PULL, c1=20.0), some, masses_of(some), Likelihood(sigma=0.1),
        rng=np.random.default_rng(0), settings=EStep(n_eff=100, keep_chain=True),
    )  # fmt: skip
    tree = posterior.to_arviz()
    chain = tree["posterior"]["mass[s0:b1]"]
    assert chain.shape == posterior.chain.shape[1::-1]
    assert weighted().to_arviz()["sample_stats"]["weight"].sum() == pytest.approx(1)


# --- identifiability ------------------------------------------------------------------------------


def found(law, latents, some, likelihood):
    misfit = likelihood.misfit(law, latents, some)
    profile = fit_profile(misfit, latents.sample(6, rng=np.random.default_rng(0)))
    return identifiability(profile, latents)


def test_a_product_of_constant_and_property_is_named():
    """-c2 mu v / m: only c2 mu enters."""
    some = scenes(1, c2=1.0)
    latents = latents_of(some, "friction", Prior("uniform", 0.1, 4.0))
    result = found(law_of(PULL, "-c2 * (mu_i * v_i)"), latents, some, Likelihood(sigma=1e-3))
    direction = result.directions[0]
    powers = dict(zip(direction.names, direction.powers, strict=True))
    assert set(powers) == {"c2", *latents.names}
    friction = [powers[name] for name in latents.names]
    assert friction == pytest.approx([-powers["c2"]] * 3, rel=0.02)
    assert "reference body" in direction.remedy and "common factor" in result.text()


def test_what_is_determined_is_said_to_be():
    some = scenes(2)
    result = found(law_of(PULL), masses_of(some), some, Likelihood(sigma=1e-4))
    assert result.directions == ()
    assert "every unknown is determined" in result.text()


def test_a_silent_body_is_a_direction_of_its_own():
    some = scenes(1, far=True)
    result = found(law_of(PULL), masses_of(some), some, Likelihood(sigma=1e-3))
    assert result.directions[0].names == ("mass[s0:b2]",)
    assert "record a motion" in result.directions[0].remedy


# --- prediction -----------------------------------------------------------------------------------


def test_nrmse_of_one_draw_is_the_papers():
    some = scenes(2, noise=0.01)
    latents, law = masses_of(some), law_of(PULL, c1=20.0)
    (draw,) = latents.sample(1, rng=np.random.default_rng(0))
    expected = one_step_nrmse(latents.filled(some, draw), law)
    assert posterior_nrmse(law, some, latents, draw[None]).mean() == pytest.approx(expected)
    clean = scenes(2)
    against = posterior_nrmse(law, some, latents, draw[None], reference=clean).mean()
    assert 0 < against != pytest.approx(expected)


def test_bands_hold_the_track_and_figures_are_drawn(tmp_path):
    (scene,) = scenes(1, n_times=20)
    latents, law = masses_of((scene,)), law_of(PULL, c1=20.0)
    posterior = infer(
        law, [scene], latents, Likelihood(sigma=1e-3), rng=np.random.default_rng(0),
        settings=EStep(n_eff=200, keep_chain=True),
    )  # fmt: skip
    bands = predictive_bands(law, scene, latents, posterior, rng=np.random.default_rng(1))
    noise = 3e-3
    inside = (bands.observed >= bands.low - noise) & (bands.observed <= bands.high + noise)
    assert inside[2:].mean() > 0.8
    trace_figure(posterior, tmp_path / "t.png")
    corner_figure(posterior, tmp_path / "c.png")
    rollout_figure(bands, tmp_path / "r.png")
    assert all((tmp_path / f"{n}.png").stat().st_size > 5000 for n in "tcr")


# --- calibration ----------------------------------------------------------------------------------


def test_ranks_of_calibrated_draws_are_uniform_and_others_leave_the_band():
    rng = np.random.default_rng(2)
    n, even = 400, np.full(99, 1 / 99)
    truth = rng.standard_normal(n)
    good = [rank_of(t, rng.standard_normal(99), even, rng=rng) for t in truth]
    band = simultaneous_band(n, 0.99)
    assert stats.kstest(good, "uniform").statistic < band
    narrow = [rank_of(t, 0.6 * rng.standard_normal(99), even, rng=rng) for t in truth]
    assert stats.kstest(narrow, "uniform").statistic > band
    assert band == pytest.approx(1.63 / np.sqrt(n), rel=0.03)


def test_standard_error_of_coverage_counts_groups():
    inside = np.tile([True, False, True, True], 50)
    share, error = coverage(inside, np.arange(200))
    assert (share, error) == (pytest.approx(0.75), pytest.approx(np.sqrt(0.1875 / 200), rel=0.01))
    together = np.repeat([True, False, True, True], 50)
    _, wide = coverage(together, np.repeat(np.arange(4), 50))
    assert wide > 5 * error


def test_the_prior_is_the_posterior_under_no_force():
    some = scenes(1)
    posterior = prior_posterior(masses_of(some), rng=np.random.default_rng(0))
    assert posterior.method == "prior"
    assert posterior.mean == pytest.approx([4.6, 4.6], abs=4 * 2.54 / np.sqrt(1000))
    assert Latents().names == ()
