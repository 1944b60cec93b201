import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bsp_gp.data.scene import LatentDeclaration
from bsp_gp.errors import SettingsError
from bsp_gp.inference.priors import Prior, prior_of

PRIORS = [
    Prior("uniform", 0.02, 9.0),
    Prior("log-uniform", 0.1, 10.0),
    Prior("truncated_normal", 2.0, 8.0, mean=5.1, sd=2.0),
    Prior("normal", mean=-1.0, sd=0.5),
]


@pytest.mark.parametrize("prior", PRIORS, ids=lambda p: p.kind)
def test_draws_follow_the_prior(prior):
    draws = prior.sample(2000, rng=np.random.default_rng(0))
    # A Kolmogorov-Smirnov distance of 2000 draws exceeds 0.0435 once in a thousand.
    assert stats.kstest(draws, prior.cdf).statistic < 0.0435
    assert np.all((draws >= prior.low) & (draws <= prior.high))


@pytest.mark.parametrize("prior", PRIORS, ids=lambda p: p.kind)
def test_density_integrates_to_one_and_quantiles_invert(prior):
    low, high = (prior.ppf(q) for q in (1e-9, 1 - 1e-9))
    x = np.linspace(low, high, 20001)
    assert np.trapezoid(np.exp(prior.log_prob(x)), x) == pytest.approx(1, abs=2e-4)
    u = np.linspace(0.01, 0.99, 9)
    assert prior.cdf(prior.ppf(u)) == pytest.approx(u)


@given(st.integers(0, 3), st.floats(0.001, 0.999))
def test_coordinates_round_trip(index, u):
    prior = PRIORS[index]
    x = prior.ppf(u)
    assert prior.from_coordinate(prior.to_coordinate(x)) == pytest.approx(x)
    low, high = prior.bounds
    assert low <= prior.to_coordinate(x) <= high


def test_discrete_values_are_equally_likely():
    prior = Prior("discrete", values=(1.0, 3.0, 9.0))
    draws = prior.sample(3000, rng=np.random.default_rng(1))
    counts = [np.sum(draws == v) for v in prior.values]
    assert np.all(np.abs(np.array(counts) - 1000) < 4 * np.sqrt(3000 * 2 / 9))
    assert prior.log_prob([3.0, 2.0]).tolist() == [-np.log(3), -np.inf]
    assert prior.cdf(3.0) == pytest.approx(2 / 3)
    assert prior.ppf(np.array([0.1, 0.5, 0.9])).tolist() == [1.0, 3.0, 9.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "uniform", "low": 2.0, "high": 1.0}, "low must be below high"),
        ({"kind": "uniform", "low": 2.0}, "needs low and high"),
        ({"kind": "log_uniform", "low": 0.0, "high": 1.0}, "above 0"),
        ({"kind": "truncated_normal", "mean": 1.0}, "positive sd"),
        ({"kind": "discrete"}, "list of finite values"),
        ({"kind": "discrete", "values": (1.0, 1.0)}, "must differ"),
        ({"kind": "gamma", "low": 0.0, "high": 1.0}, "prior must be one of"),
    ],
)
def test_bad_priors_are_refused(arguments, message):
    with pytest.raises(SettingsError, match=message):
        Prior(**arguments)


def test_declarations_become_priors_and_errors_name_the_latent():
    assert prior_of(LatentDeclaration("mass", low=0.1, high=2.0)) == Prior("uniform", 0.1, 2.0)
    normal = prior_of(LatentDeclaration("l", prior="normal", low=0.0, high=9.0, mean=5.0, sd=2.0))
    assert (normal.kind, normal.mean) == ("truncated_normal", 5.0)
    assert prior_of(LatentDeclaration("q", values=(-1.0, 0.0, 1.0))).is_discrete
    with pytest.raises(SettingsError, match=r"\[latent.mass\]"):
        prior_of(LatentDeclaration("mass"))
