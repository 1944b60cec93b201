"""Importance sampling, the paper's E-step for any prior; weights are applied once.

Proposals: the prior; a Laplace proposal (multivariate t about the joint optimum, with a tenth of
prior draws, so that weights stay bounded); a tempered one, where draws of a flattened posterior
shape the next proposal (population Monte Carlo; Cappe et al. 2004, JCGS 13, 907).
"""

import logging
import math

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.inference.posterior import Posterior, effective_size, weights_of

logger = logging.getLogger(__name__)
PROPOSALS = ("prior", "laplace", "tempered")
COLLAPSED = 0.02
"""Effective share of the draws below which the weights have collapsed."""
FREEDOM = 5.0
"""Degrees of freedom of the t proposal."""
DEFENSIVE = 0.1
"""Share of prior draws mixed into a fitted proposal."""
KEPT_SHARE = 0.3
"""Effective share that every stage of tempering keeps."""
MAX_STAGES = 40
WIDENED = 1.5
"""Factor on the covariance of weighted draws, so that the next proposal covers its target."""


def sample_importance(
    log_likelihood, latents, *, rng, n_draws=2000, proposal="prior", mode=None, covariance=None
):
    """Draw from a proposal and weigh.

    Parameters
    ----------
    log_likelihood : callable
        ``log_likelihood(values) -> (W,)`` for values (W, k), nats.
    proposal : str
        One of `PROPOSALS`.
    mode, covariance : ndarray, (k,) and (k, k), optional
        In coordinates of the priors; needed for "laplace".

    Returns
    -------
    Posterior
        Weighted draws; a note and a warning in the log if the weights have collapsed.
    """
    if proposal not in PROPOSALS:
        raise SettingsError(f"proposal must be one of {', '.join(PROPOSALS)}, got {proposal!r}")
    if proposal == "prior":
        values = latents.sample(n_draws, rng=rng)
        log_joint = log_likelihood(values)
        log_weight = log_joint
        log_joint = log_joint + latents.log_prior(values)
    else:
        if latents.is_discrete.any():
            raise SettingsError(
                "a fitted proposal needs continuous latents; discrete ones are enumerated, or "
                "sampled from the prior"
            )
        if proposal == "tempered":
            mode, covariance = _temper(log_likelihood, latents, n_draws, rng)
        values, log_weight, log_like = _fitted(
            log_likelihood, latents, n_draws, mode, covariance, rng
        )
        log_joint = log_like + latents.log_prior(values)
    return _weighted(latents, values, log_weight, log_joint, proposal)


def _weighted(latents, values, log_weight, log_joint, proposal):
    weights, notes, n_eff = weights_of(log_weight), [], 0.0
    if weights is None:
        notes.append("no draw has a finite probability: equal weights of the prior are given")
        weights = np.full(len(values), 1 / len(values))
    else:
        n_eff = effective_size(weights)
    if n_eff < COLLAPSED * len(values):
        remedy = "; use the proposal 'laplace' or 'tempered', or emcee"
        notes.append(
            f"the weights have collapsed: {len(values)} draws from the {proposal} proposal are "
            f"worth {n_eff:.1f}" + (remedy if proposal == "prior" else "")
        )
        level = logging.WARNING if proposal == "prior" else logging.INFO
        logger.log(level, "%s", notes[-1])
    return Posterior(
        latents.names, values, weights, log_joint, f"importance ({proposal})",
        np.full(len(latents), n_eff), np.full(len(latents), np.nan),
        converged=n_eff >= COLLAPSED * len(values),
        priors=tuple(item.prior for item in latents.items), truth=latents.truth,
        notes=tuple(notes),
    )  # fmt: skip


def _fitted(log_likelihood, latents, n_draws, mode, covariance, rng):
    """Draws of a t distribution mixed with the prior, in coordinates; weights of the mixture."""
    k = len(latents)
    factor = np.linalg.cholesky(covariance + 1e-14 * np.trace(covariance) * np.eye(k) / k)
    n_prior = int(round(DEFENSIVE * n_draws))
    n_t = n_draws - n_prior
    normal = rng.standard_normal((n_t, k))
    radius = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, n_t))
    places = mode + (normal @ factor.T) * radius[:, None]
    prior = latents.to_coordinate(latents.sample(n_prior, rng=rng))
    places = np.concatenate([places, prior])
    with np.errstate(all="ignore"):
        values = latents.from_coordinate(places)
    log_prior = latents.log_prior(values) + latents.log_jacobian(places)
    log_t = _log_t(places - mode, factor)
    log_q = np.logaddexp(math.log(1 - DEFENSIVE) + log_t, math.log(DEFENSIVE) + log_prior)
    inside = np.isfinite(log_prior)
    log_like = np.full(len(values), -np.inf)
    if inside.any():
        log_like[inside] = log_likelihood(values[inside])
    return values, np.where(inside, log_like + log_prior - log_q, -np.inf), log_like


def _log_t(gaps, factor):
    from scipy.linalg import solve_triangular
    from scipy.special import gammaln

    k = gaps.shape[1]
    z = solve_triangular(factor, gaps.T, lower=True)
    constant = (
        gammaln((FREEDOM + k) / 2)
        - gammaln(FREEDOM / 2)
        - 0.5 * k * math.log(FREEDOM * math.pi)
        - np.log(np.diag(factor)).sum()
    )
    return constant - 0.5 * (FREEDOM + k) * np.log1p(np.square(z).sum(axis=0) / FREEDOM)


def _temper(log_likelihood, latents, n_draws, rng):
    """Mean and covariance of the posterior, approached through flattened ones."""
    values = latents.sample(n_draws, rng=rng)
    places = latents.to_coordinate(values)
    log_like = log_likelihood(values)
    base = np.zeros(n_draws)  # log (prior / proposal)
    for _ in range(MAX_STAGES):
        power, weights = _next_power(log_like, base)
        mean = weights @ places
        gap = places - mean
        covariance = (gap * weights[:, None]).T @ gap
        covariance += 1e-12 * np.diag([item.prior.spread**2 for item in latents.items])
        if power >= 1:
            break
        values, log_weight, log_like = _fitted(
            log_likelihood, latents, n_draws, mean, WIDENED * covariance, rng
        )
        places = latents.to_coordinate(values)
        seen = np.isfinite(log_weight)
        base = np.where(seen, log_weight - np.where(seen, log_like, 0.0), -np.inf)
    return mean, WIDENED * covariance


def _next_power(log_like, base):
    """Largest exponent of the likelihood that keeps `KEPT_SHARE` of the draws effective."""
    known = np.where(np.isfinite(log_like), log_like, 0.0)
    base = np.where(np.isfinite(log_like), base, -np.inf)

    def weights_at(p):
        w = base + p * known
        w = np.exp(w - w.max())
        return w / w.sum()

    if effective_size(weights_at(1.0)) >= KEPT_SHARE * len(base):
        return 1.0, weights_at(1.0)
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2 if low else high / 16
        if effective_size(weights_at(middle)) >= KEPT_SHARE * len(base):
            low = middle
        else:
            high = middle
        if low and high / low < 1.02:
            break
    return low, weights_at(low)
