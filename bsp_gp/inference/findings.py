"""What a reader of a posterior must be told: nothing learnt, at the edge, contradicted."""

import numpy as np

SILENT = 0.01
"""Latents over whose whole prior the log-likelihood moves by less (nats) have not been seen."""
EDGE = 0.02
"""Part of the prior at an end in which more than half of a posterior counts as piled up."""
CONTRADICTED = 1e-6
"""Probability of a larger chi-squared below which law, priors and data contradict each other."""
QUANTILES = (0.01, 0.12, 0.25, 0.38, 0.5, 0.62, 0.75, 0.88, 0.99)


def findings(misfit, latents, posterior, profile, *, rng):
    """Notes on a posterior.

    Parameters
    ----------
    posterior : Posterior
        Latents first, constants after them.
    profile : Profile or None
        The joint optimum, for the test of the fit.
    """
    notes = []
    silent = silent_latents(misfit, latents, posterior, rng=rng)
    if silent:
        notes.append(
            f"the data say nothing about {', '.join(silent)}: the posterior is the prior (a body "
            "that never interacts, or a property that the law does not name)"
        )
    for side, names in _piled(latents, posterior).items():
        names = [name for name in names if name not in silent]
        if names:
            notes.append(
                f"the posterior of {', '.join(names)} piles up at the {side} end of its prior: "
                "widen the prior, or doubt the law"
            )
    if profile is not None:
        notes.extend(_contradiction(misfit, latents, profile))
    return notes


def silent_latents(misfit, latents, posterior, *, rng):
    """Names of latents that the likelihood does not depend on."""
    draws = posterior.draw(4, rng=rng)
    k = len(latents)
    values, constants = draws[:, :k], draws[:, k:] if draws.shape[1] > k else None
    silent = []
    for index, item in enumerate(latents.items):
        support = (
            np.array(item.prior.values)
            if item.prior.is_discrete
            else item.prior.ppf(np.array(QUANTILES))
        )
        trial = np.repeat(values, len(support), axis=0)
        trial[:, index] = np.tile(support, len(values))
        given = None if constants is None else np.repeat(constants, len(support), axis=0)
        with np.errstate(all="ignore"):
            log_like = misfit.log_likelihood(trial, given).reshape(len(values), -1)
            moves = np.ptp(log_like, axis=1)
        if np.all(moves < SILENT):
            silent.append(item.name)
    return silent


def _piled(latents, posterior):
    sides = {"lower": [], "upper": []}
    for index, item in enumerate(latents.items):
        if item.prior.is_discrete:
            continue
        u = item.prior.cdf(posterior.draws[:, index])
        for side, near in (("lower", u < EDGE), ("upper", u > 1 - EDGE)):
            if posterior.weights[near].sum() > 0.5:
                sides[side].append(item.name)
    return sides


def _contradiction(misfit, latents, profile):
    from scipy.stats import chi2

    free = max(misfit.n_rows - len(latents) - len(profile.constants), 1)
    if chi2.logsf(profile.chisq, free) < np.log(CONTRADICTED):
        yield (
            f"no values in the support of the priors explain the data under this law: chi-squared "
            f"{profile.chisq:.4g} for {misfit.n_rows} numbers; the intervals are those of a wrong "
            "law or a wrong noise level, and too narrow"
        )
