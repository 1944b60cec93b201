"""Posteriors of data drawn from the prior predictive: ranks are uniform, intervals cover."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from bsp_gp.inference.e_step import EStep, infer
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.physics.bodies import stack
from experiments.ranks import coverage, rank_of, simultaneous_band
from tests.latent_worlds import PULL, law_of, masses_of, scenes

SIGMA = 0.02
N_SETS = 150


def predicted(scene, latents, law, draw, rng):
    """A scene of the one-step generative model: noise enters every step."""
    (filled,) = latents.filled((scene,), draw)
    (batch,) = stack([filled])
    p = np.array(batch.positions)
    steps = np.diff(batch.times[:, 0])
    for t in range(1, len(p) - 1):
        v = (p[t] - p[t - 1]) / steps[t - 1]
        a = law.acceleration(batch.bodies, p[t], v, batch.times[t])
        p[t + 1] = p[t] + steps[t] * (v + steps[t] * a) + SIGMA * rng.standard_normal(p[t].shape)
    return dataclasses.replace(scene, positions=p[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "laplace"])
def test_ranks_are_uniform_and_intervals_cover(method):
    law, likelihood = law_of(PULL, c1=20.0), Likelihood(sigma=SIGMA)
    ranks, inside, groups = [], [], []
    for index in range(N_SETS):
        rng = np.random.default_rng([5, index])
        (scene,) = scenes(1, n_times=20)
        latents = masses_of((scene,))
        (truth,) = latents.sample(1, rng=rng)
        made = predicted(scene, latents, law, truth, rng)
        posterior = infer(
            law, [made], latents, likelihood, rng=rng, settings=EStep(method, n_eff=200)
        )
        low, high = posterior.interval(0.9).T
        for k in range(len(latents)):
            ranks.append(rank_of(truth[k], posterior.draws[:, k], posterior.weights, rng=rng))
            inside.append(low[k] <= truth[k] <= high[k])
            groups.append(index)
    assert stats.kstest(ranks, "uniform").statistic < simultaneous_band(len(ranks), 0.999)
    share, error = coverage(inside, groups)
    assert abs(share - 0.9) < 4 * error
