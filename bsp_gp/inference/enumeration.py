"""Discrete latents exactly: every combination of their values, weighed."""

import itertools

import numpy as np

from bsp_gp.inference.posterior import Posterior, effective_size, weights_of

MOST_COMBINATIONS = 200_000
"""Products of discrete supports up to this size are enumerated."""
NEGLIGIBLE = 1e-12
"""Combinations below this probability are not kept."""


def n_combinations(latents):
    """Size of the product of the discrete supports."""
    out = 1
    for item in latents.items:
        if item.prior.is_discrete:
            out *= len(item.prior.values)
    return out


def combinations(latents):
    """Every combination of the discrete latents, (n, k_discrete), in the order of the latents."""
    sets = [item.prior.values for item in latents.items if item.prior.is_discrete]
    return np.array(list(itertools.product(*sets)), dtype=float)


def enumerate_posterior(log_likelihood, latents):
    """The exact posterior of discrete latents.

    Parameters
    ----------
    log_likelihood : callable
        ``log_likelihood(values) -> (W,)``.
    latents : Latents
        All discrete.

    Returns
    -------
    Posterior
        Every combination that matters, weighed with its probability.
    """
    values = combinations(latents)
    log_joint = log_likelihood(values) + latents.log_prior(values)
    weights, notes = weights_of(log_joint), ()
    if weights is None:
        weights = np.full(len(values), 1 / len(values))
        notes = ("no combination has a finite probability: the prior is given",)
    kept = weights > NEGLIGIBLE * weights.max()
    weights = weights[kept] / weights[kept].sum()
    k = len(latents)
    return Posterior(
        latents.names, values[kept], weights, log_joint[kept], "enumeration",
        np.full(k, effective_size(weights)), np.full(k, np.nan),
        priors=tuple(item.prior for item in latents.items), truth=latents.truth, notes=notes,
    )  # fmt: skip
