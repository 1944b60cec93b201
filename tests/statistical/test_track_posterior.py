"""Posteriors read from whole tracks: intervals hold what they say."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from bsp_gp.inference.e_step import EStep, refine
from bsp_gp.inference.likelihood import Likelihood
from tests import double_star

N_SEEDS = 20
SETTINGS = {
    "dense": {"epochs": 40, "revolutions": 3},
    "coarse": {"epochs": 10, "revolutions": 6},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
def test_truths_are_draws_from_their_posteriors(name):
    squares, ranks = [], []
    for seed in range(N_SEEDS):
        data = double_star.dataset(100 + seed, **SETTINGS[name])
        latents = double_star.masses_of(data)
        likelihood = Likelihood("track", sigma=np.full(2, 1e-3), velocities="central")
        misfit = likelihood.misfit(double_star.law_of(data, c=1.0), latents, data.scenes)
        assert misfit.reference is not None
        posterior = refine(
            misfit.reference.profile, data.scenes, latents, likelihood, misfit=misfit,
            rng=np.random.default_rng(seed), settings=EStep(n_eff=300),
        )  # fmt: skip
        truth = np.array([*latents.truth, double_star.C])
        assert posterior.mean == pytest.approx(truth, rel=0.01)
        gap = posterior.mean - truth
        size = posterior.sd
        squares.append(gap / size @ np.linalg.solve(posterior.correlation(), gap / size))
        ranks.append(posterior.weights @ (posterior.draws < truth))
    total = np.sum(squares)
    assert chi2.ppf(0.0005, 3 * N_SEEDS) < total < chi2.ppf(0.9995, 3 * N_SEEDS)
    for column in np.transpose(ranks):
        assert kstest(column, "uniform").pvalue > 1e-3
