"""Samplers against known answers; tolerances are four standard errors."""

import numpy as np
import pytest

from bsp_gp.errors import FitError, SettingsError
from bsp_gp.inference.e_step import EStep, infer, refine
from bsp_gp.inference.emcee_step import sample_ensemble
from bsp_gp.inference.enumeration import enumerate_posterior
from bsp_gp.inference.importance import sample_importance
from bsp_gp.inference.latents import Latents, latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.priors import Prior
from bsp_gp.inference.profile import fit_profile
from tests.latent_worlds import PULL, law_of, masses_of, scenes

COVARIANCE = np.array([[1.0, 0.95], [0.95, 1.0]]) * np.outer([1.0, 0.01], [1.0, 0.01])
MEAN = np.array([1.0, -2.0])


def correlated(x):
    gap = x - MEAN
    return -0.5 * np.einsum("wi,ij,wj->w", gap, np.linalg.inv(COVARIANCE), gap)


def test_the_ensemble_knows_a_correlated_gaussian():
    rng = np.random.default_rng(3)
    start = MEAN + 0.001 * rng.standard_normal((16, 2))
    posterior = sample_ensemble(correlated, ("a", "b"), start, rng=rng, n_eff=2000)
    assert posterior.converged and posterior.n_eff.min() >= 2000
    error = posterior.sd / np.sqrt(2000)
    assert np.all(np.abs(posterior.mean - MEAN) < 4 * error)
    assert posterior.sd == pytest.approx(np.sqrt(np.diag(COVARIANCE)), rel=4 / np.sqrt(4000))
    assert posterior.correlation()[0, 1] == pytest.approx(0.95, abs=0.01)
    assert np.all(np.abs(posterior.r_hat - 1) < 0.03)


def test_the_same_generator_gives_the_same_draws_whatever_the_global_state():
    start = MEAN + 0.01 * np.random.default_rng(0).standard_normal((16, 2))
    runs = []
    for disturb in (1, 2):
        np.random.RandomState(disturb).uniform()
        runs.append(
            sample_ensemble(correlated, ("a", "b"), start, rng=np.random.default_rng(5), n_eff=200)
        )
    assert np.array_equal(runs[0].draws, runs[1].draws)


def test_a_chain_that_does_not_converge_is_usable_and_says_so():
    rng = np.random.default_rng(0)

    def two_far_modes(x):
        return np.logaddexp(-0.5 * (x[:, 0] - 50) ** 2, -0.5 * (x[:, 0] + 50) ** 2 - 0.7)

    start = np.concatenate([np.full((16, 1), 50.0), np.full((16, 1), -50.0)])
    start = start + rng.standard_normal((32, 1))
    posterior = sample_ensemble(
        two_far_modes, ("x",), start, rng=rng, n_eff=10**6, max_steps=400
    )
    assert not posterior.converged
    assert "did not converge" in posterior.notes[0]
    assert len(posterior.draws) > 100


def test_a_walker_that_never_moves_is_no_convergence():
    def with_a_spike(x):
        return np.where(np.abs(x[:, 0] - 90) < 1e-9, 1e4, -0.5 * x[:, 0] ** 2)

    rng = np.random.default_rng(0)
    start = np.append(rng.standard_normal(31), 90.0)[:, None]
    posterior = sample_ensemble(with_a_spike, ("x",), start, rng=rng, n_eff=500, max_steps=400)
    assert not posterior.converged
    assert "did not converge" in posterior.notes[0]


def test_nowhere_to_start_is_an_error_with_the_estimate():
    with pytest.raises(FitError, match="no start place") as caught:
        sample_ensemble(
            lambda x: np.full(len(x), -np.inf), ("a",), np.ones((4, 1)),
            rng=np.random.default_rng(0),
        )  # fmt: skip
    assert caught.value.estimate == pytest.approx([1.0])


def line(prior=None, k=2):
    """Latents without scenes, for densities written down."""
    from bsp_gp.inference.latents import Latent

    prior = prior or Prior("uniform", -10.0, 10.0)
    return Latents(tuple(Latent(f"x{i}", "x", prior, (("s", f"e{i}"),)) for i in range(k)))


@pytest.mark.parametrize("proposal", ["prior", "laplace", "tempered"])
def test_importance_sampling_knows_a_gaussian(proposal):
    sd = np.array([0.8, 1.5])

    def log_like(x):
        return -0.5 * np.square((x - [1.0, -2.0]) / sd).sum(axis=1)

    posterior = sample_importance(
        log_like, line(), rng=np.random.default_rng(4), n_draws=8000, proposal=proposal,
        mode=np.array([1.0, -2.0]), covariance=np.diag(sd**2),
    )  # fmt: skip
    n_eff = posterior.n_eff[0]
    assert posterior.converged and n_eff > (150 if proposal == "prior" else 3000)
    assert np.all(np.abs(posterior.mean - [1.0, -2.0]) < 4 * sd / np.sqrt(n_eff))
    assert posterior.sd == pytest.approx(sd, rel=4 / np.sqrt(n_eff))


def test_collapsed_weights_are_reported_and_tempering_mends_them(caplog):
    def narrow(x):
        return -0.5 * np.square((x - 3.0) / 0.002).sum(axis=1)

    plain = sample_importance(narrow, line(), rng=np.random.default_rng(0), n_draws=2000)
    assert not plain.converged and "collapsed" in plain.notes[0]
    assert any("collapsed" in record.message for record in caplog.records)
    mended = sample_importance(
        narrow, line(), rng=np.random.default_rng(0), n_draws=2000, proposal="tempered"
    )
    assert mended.converged
    assert np.all(np.abs(mended.mean - 3.0) < 4 * 0.002 / np.sqrt(mended.n_eff[0]))


def test_weights_are_applied_once():
    """Redrawn draws are equally weighted: their mean is the weighted mean, not its square's."""
    posterior = sample_importance(
        lambda x: -0.5 * np.square(x[:, 0]), line(k=1), rng=np.random.default_rng(1), n_draws=20000
    )
    draws, weights = posterior.thinned(4000, rng=np.random.default_rng(2))
    assert np.all(weights == weights[0])
    assert draws.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * 1500))


def test_enumeration_is_exact():
    latents = line(Prior("discrete", values=(0.0, 1.0, 3.0)))
    posterior = enumerate_posterior(lambda v: -np.square(v[:, 0] - v[:, 1] - 1), latents)
    table = {tuple(d): w for d, w in zip(posterior.draws, posterior.weights, strict=True)}
    every = {(a, b): np.exp(-((a - b - 1) ** 2)) for a in (0, 1, 3) for b in (0, 1, 3)}
    total = sum(every.values())
    for key, value in every.items():
        assert table[key] == pytest.approx(value / total)


def test_discrete_and_continuous_together_agree_with_a_grid():
    some = scenes(1, noise=0.02)
    heavy = latents_of(some, "mass", Prior("discrete", values=(0.7, 2.0, 6.0)), entities=["b1"])
    other = latents_of(some, "mass", Prior("uniform", 0.2, 9.0), entities=["b2"])
    latents = Latents((*heavy.items, *other.items))
    law, likelihood = law_of(PULL, c1=20.0), Likelihood(sigma=0.05)
    posterior = infer(
        law, some, latents, likelihood, rng=np.random.default_rng(0), settings=EStep(n_eff=1500)
    )
    assert posterior.method == "emcee x enumeration"
    grid = np.linspace(0.2, 9.0, 801)
    misfit = likelihood.misfit(law, latents, some)
    table = np.array([
        misfit.log_likelihood(np.column_stack([np.full(801, v), grid])) for v in (0.7, 2.0, 6.0)
    ])
    weight = np.exp(table - table.max())
    weight /= weight.sum()
    for value, expected in zip((0.7, 2.0, 6.0), weight.sum(axis=1), strict=True):
        found = posterior.weights[posterior.draws[:, 0] == value].sum()
        assert found == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 1500))
    mean = float((weight.sum(axis=0) * grid).sum())
    sd = float(np.sqrt((weight.sum(axis=0) * (grid - mean) ** 2).sum()))
    assert posterior.mean[1] == pytest.approx(mean, abs=4 * sd / np.sqrt(1500))


@pytest.mark.parametrize("method", ["auto", "laplace", "importance"])
def test_e_steps_agree_with_a_grid(method):
    some = scenes(1, noise=0.02)
    latents = latents_of(some, "mass", Prior("uniform", 0.2, 9.0), entities=["b1"])
    law, likelihood = law_of(PULL, c1=20.0), Likelihood(sigma=0.05)
    posterior = infer(
        law, some, latents, likelihood, rng=np.random.default_rng(0), settings=EStep(method)
    )
    grid = np.linspace(0.2, 9.0, 2001)
    weight = np.exp(likelihood.misfit(law, latents, some).log_likelihood(grid[:, None]))
    weight /= weight.sum()
    mean = float(weight @ grid)
    sd = float(np.sqrt(weight @ (grid - mean) ** 2))
    error = sd / np.sqrt(posterior.n_eff[0])
    assert posterior.mean[0] == pytest.approx(mean, abs=4 * error)
    assert posterior.sd[0] == pytest.approx(sd, abs=4 * error)


def test_a_body_that_never_interacts_keeps_its_prior_and_the_report_says_so():
    some = scenes(1, far=True)
    latents = masses_of(some)
    posterior = infer(
        law_of(PULL, c1=20.0), some, latents, Likelihood(sigma=0.05),
        rng=np.random.default_rng(0), settings=EStep(n_eff=500),
    )  # fmt: skip
    note = next(n for n in posterior.notes if "say nothing about" in n)
    assert "mass[s0:b2]" in note and "mass[s0:b1]" not in note
    prior = latents.items[1].prior
    assert posterior.mean[1] == pytest.approx(4.6, abs=4 * prior.spread / np.sqrt(500))


def test_contradictory_data_are_told_and_the_draws_stay_usable():
    """One mass for two bodies whose masses differ, on exact data."""
    some = scenes(1)
    latents = latents_of(some, "mass", Prior("uniform", 0.2, 9.0), entities=["b1", "b2"],
                         share="all")  # fmt: skip
    posterior = infer(
        law_of(PULL, c1=20.0), some, latents, Likelihood(sigma=1e-5),
        rng=np.random.default_rng(0), settings=EStep(n_eff=300),
    )  # fmt: skip
    assert any("no values in the support" in note for note in posterior.notes)
    assert np.isfinite(posterior.mean).all() and posterior.sd[0] > 0


def test_constants_are_sampled_together_with_the_latents():
    some = scenes(2, noise=0.005)
    latents, law = masses_of(some), law_of(PULL)
    likelihood = Likelihood("gls", sigma=0.005)
    misfit = likelihood.misfit(law, latents, some)
    profile = fit_profile(misfit, latents.sample(6, rng=np.random.default_rng(0)))
    joint = refine(
        profile, some, latents, likelihood, rng=np.random.default_rng(1),
        settings=EStep(n_eff=400, keep_chain=True),
    )  # fmt: skip
    assert joint.names == (*latents.names, "c1")
    assert abs(joint.mean[-1] - 20) < 5 * joint.sd[-1]
    assert joint.sd[-1] < 0.2


def test_settings_that_do_not_fit_are_refused():
    some = scenes(1)
    with pytest.raises(SettingsError, match="E-step must be one of"):
        EStep("gibbs")
    with pytest.raises(SettingsError, match="needs discrete"):
        infer(
            law_of(PULL), some, masses_of(some), Likelihood(sigma=0.1),
            rng=np.random.default_rng(0), settings=EStep("enumeration"),
        )  # fmt: skip
    with pytest.raises(SettingsError, match="no latent"):
        infer(law_of(PULL), some, Latents(), Likelihood(sigma=0.1), rng=np.random.default_rng(0))
