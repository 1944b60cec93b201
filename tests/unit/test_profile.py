import numpy as np
import pytest

from bsp_gp.inference.latents import Latents, latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.priors import Prior
from bsp_gp.inference.profile import fit_profile
from tests.latent_worlds import DRAG, PULL, law_of, masses_of, scenes


def profile_of(some, law, latents, likelihood, n_starts=6, seed=0):
    misfit = likelihood.misfit(law, latents, some)
    starts = latents.sample(n_starts, rng=np.random.default_rng(seed))
    return misfit, fit_profile(misfit, starts)


def test_masses_and_constants_of_exact_data_are_found_from_any_start():
    some = scenes(3, c2=0.5)
    law, latents = law_of(PULL, DRAG), masses_of(some)
    _, profile = profile_of(some, law, latents, Likelihood(sigma=0.01))
    assert profile.loss < 1e-10
    assert profile.values == pytest.approx(latents.truth, rel=1e-5)
    assert profile.constants == pytest.approx([20.0, 0.5], rel=1e-6)
    assert np.sum(profile.losses < 1e-8) >= 4  # most of six starts get there


def test_the_optimum_is_that_of_scipy():
    from scipy.optimize import least_squares

    some = scenes(2, noise=0.01)
    law, latents = law_of(PULL), masses_of(some)
    misfit, profile = profile_of(some, law, latents, Likelihood("gls", sigma=0.01))
    low, high = MASS_BOUNDS = np.array([i.prior.bounds for i in latents.items]).T
    assert MASS_BOUNDS.shape == (2, 4)

    def residual(x):
        return misfit.residual(x[None, :-1], x[None, -1:])[0]

    start = np.append(np.clip(profile.values, low + 0.1, high - 0.1), 19.0)
    fit = least_squares(
        residual, start, bounds=(np.append(low, -np.inf), np.append(high, np.inf)),
        x_scale=np.append(np.ones(4), 20.0), xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    assert profile.loss <= fit.cost + 0.5 * misfit.rest.sum() + 1e-6
    assert profile.constants[0] == pytest.approx(fit.x[-1], rel=1e-5)
    # The jacobian is that of the residual.
    x = np.append(profile.values, profile.constants)
    step = 1e-6 * np.eye(5)
    slope = np.stack([(residual(x + h) - residual(x - h)) / 2e-6 for h in step], axis=1)
    assert profile.jacobian == pytest.approx(slope, rel=1e-3, abs=1e-4 * np.abs(slope).max())


def test_bounds_hold_and_are_told():
    some = scenes(2)
    low = Prior("uniform", 0.1, 0.4)  # all true masses are above
    latents = masses_of(some, low)
    _, profile = profile_of(some, law_of(PULL), latents, Likelihood(sigma=0.01))
    assert np.all((profile.values >= 0.1) & (profile.values <= 0.4))
    assert profile.at_bound.any()


def test_a_gaussian_prior_pulls():
    """Of a body that nothing says anything about, the prior's mean is the optimum."""
    some = scenes(1)
    prior = Prior("truncated_normal", 0.1, 9.0, mean=3.0, sd=0.7)
    latents = latents_of(some, "friction", prior, entities=["b1"])
    _, profile = profile_of(some, law_of(PULL), latents, Likelihood(sigma=0.01))
    assert profile.values == pytest.approx([3.0])
    assert profile.information[0, 0] == pytest.approx(1 / 0.7**2)


def test_a_logarithmic_prior_fits_the_logarithm():
    some = scenes(2)
    latents = masses_of(some, Prior("log_uniform", 0.1, 20.0))
    _, profile = profile_of(some, law_of(PULL), latents, Likelihood(sigma=0.01))
    assert profile.values == pytest.approx(latents.truth, rel=1e-5)


def test_without_latents_the_constants_alone_are_fitted():
    some = scenes(1)
    misfit = Likelihood(sigma=0.01).misfit(law_of(PULL), Latents(), some)
    profile = fit_profile(misfit, np.zeros((1, 0)))
    assert profile.constants == pytest.approx([20.0])


@pytest.mark.parametrize("n_scenes", [1, 3])
def test_discrete_latents_end_at_their_values_where_only_products_are_determined(n_scenes):
    """All masses unknown, so that c1 * mass alone moves anything: the values fix the scale."""
    some = scenes(n_scenes)
    true = masses_of(some).truth
    values = (200.0, *true, *(1.7 * true), *(0.4 * true))
    latents = latents_of(some, "mass", Prior("discrete", values=values))
    misfit = Likelihood(sigma=0.01).misfit(law_of(PULL, c1=1.0), latents, some)
    profile = fit_profile(misfit, latents.sample(6, rng=np.random.default_rng(1)))
    assert set(profile.values) <= set(values)
    assert profile.loss < 1e-9
    assert profile.values == pytest.approx(latents.truth)
    assert profile.constants == pytest.approx([20.0])
    assert not profile.at_bound.any()
