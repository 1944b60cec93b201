"""The E-step: posterior of the latents given a law, block by block.

Scenes that share no latent are independent given the law, so each block is sampled by itself:
continuous latents by emcee or importance sampling, discrete ones by enumeration, both together
by an ensemble over the continuous ones with the discrete ones summed out exactly.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bsp_gp.errors import FitError, SettingsError
from bsp_gp.inference.emcee_step import sample_ensemble
from bsp_gp.inference.enumeration import (
    MOST_COMBINATIONS,
    combinations,
    enumerate_posterior,
    n_combinations,
)
from bsp_gp.inference.findings import findings
from bsp_gp.inference.importance import sample_importance
from bsp_gp.inference.laplace import point_posterior, softened_note, start_places
from bsp_gp.inference.posterior import Posterior, joined
from bsp_gp.inference.profile import FixedConstants, fit_profile
from bsp_gp.inference.tracks import Softened, is_point, reweighted
from bsp_gp.randomness import generator

PRIOR_DRAWS = 1000
METHODS = ("auto", "emcee", "importance", "laplace", "tempered", "enumeration")


@dataclass(frozen=True)
class EStep:
    """Settings of an E-step.

    Attributes
    ----------
    method : str
        "auto" (emcee for continuous latents, enumeration for discrete ones, both mixed),
        "emcee", "importance" (from the prior, as in the paper), "laplace" or "tempered"
        (importance with these proposals; emcee where their weights collapse), "enumeration".
    n_eff : float
        Effective sample size to stop at (emcee).
    max_steps : int
        Bound of a chain.
    n_draws : int
        Draws of importance sampling.
    n_starts : int
        Prior draws from which the joint optimum is sought.
    keep_chain : bool
    """

    method: str = "auto"
    n_eff: float = 1000.0
    max_steps: int = 20_000
    n_draws: int = 2000
    n_starts: int = 8
    keep_chain: bool = False

    def __post_init__(self):
        if self.method not in METHODS:
            raise SettingsError(f"E-step must be one of {', '.join(METHODS)}, got {self.method!r}")


def infer(law, scenes, latents, likelihood, *, rng=None, settings=None, previous=None):
    """Posterior of the latents of some scenes under a law with its constants.

    Parameters
    ----------
    law : ForceLaw
    scenes : sequence of Scene
    latents : Latents
    likelihood : Likelihood
    rng : numpy.random.Generator, int or None
    settings : EStep, optional
    previous : Posterior, optional
        Of the last E-step: its walkers are the start.

    Returns
    -------
    Posterior
        Over all latents, in their order. What went wrong, and what the data do not say, is in
        `notes`.
    """
    settings = settings or EStep()
    latents, _ = latents.of_scenes([scene.name for scene in scenes])
    if not len(latents):
        raise SettingsError("no latent concerns these scenes")
    blocks = latents.blocks([scene.name for scene in scenes])
    by_name = {scene.name: scene for scene in scenes}
    streams = generator(rng).spawn(len(blocks) + 1)
    parts = []
    for (names, index), stream in zip(blocks, streams[1:], strict=True):
        if not len(index):
            continue
        mine, _ = latents.of_scenes(names)
        warm = previous.walkers.get(mine.names) if previous is not None else None
        block_scenes = tuple(by_name[name] for name in names)
        parts.append(_block(law, block_scenes, mine, likelihood, stream, settings, warm))
    if len(parts) == 1:
        return replace(parts[0], walkers={parts[0].names: parts[0].walkers})
    return joined(parts, latents.names, rng=streams[0])


def prior_posterior(latents, *, rng):
    """The posterior before any law: draws from the prior (a law of zero force says nothing)."""
    values = latents.sample(PRIOR_DRAWS, rng=rng)
    k = len(latents)
    return Posterior(
        latents.names, values, np.full(PRIOR_DRAWS, 1 / PRIOR_DRAWS), latents.log_prior(values),
        "prior", np.full(k, float(PRIOR_DRAWS)), np.full(k, np.nan),
        priors=tuple(item.prior for item in latents.items), truth=latents.truth, walkers={},
    )  # fmt: skip


def _block(law, scenes, latents, likelihood, rng, settings, warm):
    if not law.terms:
        return prior_posterior(latents, rng=rng)
    misfit = likelihood.misfit(law, latents, scenes, holds_constants=True)
    sample_rng, start_rng, check_rng = rng.spawn(3)
    if likelihood.exact and misfit.reference is not None and not latents.is_discrete.all():
        posterior, profile = _exact(misfit, latents, likelihood, settings, sample_rng, start_rng)
    else:
        posterior, profile = _sample(misfit, latents, settings, warm, sample_rng, start_rng)
        posterior = reweighted(posterior, misfit, latents, rng=start_rng)
    return _with_findings(posterior, misfit, latents, profile, check_rng)


def _exact(misfit, latents, likelihood, settings, rng, start_rng):
    """The posterior of exact tracks: a point where they determine everything."""
    if not latents.is_discrete.any() and is_point(misfit.reference.profile, latents):
        return point_posterior(latents, misfit.reference.profile, (), rng), misfit.reference.profile
    level = float(np.nanmax(likelihood.sigma))
    soft = Softened(misfit, level)
    posterior, profile = _sample(soft, latents, settings, None, rng, start_rng)
    return replace(posterior, notes=(*posterior.notes, softened_note(level))), profile


def _sample(misfit, latents, settings, warm, rng, start_rng):
    method = settings.method
    discrete = latents.is_discrete
    if method == "enumeration" and not discrete.all():
        raise SettingsError("enumeration needs discrete latents; use auto for mixed ones")
    small = n_combinations(latents) <= MOST_COMBINATIONS
    if discrete.all() and method in ("auto", "enumeration", "emcee"):
        if small:
            return enumerate_posterior(misfit.log_likelihood, latents), None
        if method == "enumeration":
            raise SettingsError(
                f"{n_combinations(latents):,} combinations are too many to enumerate; use "
                "importance"
            )
        method = "importance"
    if discrete.any() and method != "importance":
        if not small:
            method = "importance"
        elif method in ("auto", "emcee"):
            return _mixed(misfit, latents, settings, warm, rng), None
    if method == "importance":
        return (
            sample_importance(misfit.log_likelihood, latents, rng=rng, n_draws=settings.n_draws),
            None,
        )
    if misfit.reference is not None:
        profile = misfit.reference.profile
    else:
        profile = fit_fixed_constants(misfit, latents.sample(settings.n_starts, rng=start_rng))
    places, mean, covariance = start_places(latents, profile, 64, start_rng)
    if method in ("laplace", "tempered"):
        posterior = sample_importance(
            misfit.log_likelihood, latents, rng=rng, n_draws=settings.n_draws, proposal=method,
            mode=mean, covariance=covariance,
        )  # fmt: skip
        if posterior.converged:
            return posterior, profile
        # Collapsed weights are no posterior: the ensemble needs no good proposal.
    start = places if warm is None or warm.shape[1] != len(latents) else warm
    return _ensemble(misfit, latents, start, settings, rng), profile


def fit_fixed_constants(misfit, starts):
    """Joint optimum of the latents alone, the law's constants as they are."""
    return fit_profile(FixedConstants(misfit), starts)


def _ensemble(misfit, latents, start, settings, rng):
    posterior = sample_ensemble(
        _density(latents, lambda values, _: misfit.log_likelihood(values)), latents.names, start,
        rng=rng, n_eff=settings.n_eff, max_steps=settings.max_steps,
        keep_chain=settings.keep_chain, **_bounds(latents),
    )  # fmt: skip
    return _in_values(posterior, latents)


def _density(latents, log_likelihood):
    """Log posterior of coordinates of latents, and of constants behind them with a flat prior."""
    k = len(latents)

    def log_prob(places):
        values = latents.from_coordinate(places[:, :k])
        out = latents.log_prior(values) + latents.log_jacobian(places[:, :k])
        inside = np.isfinite(out)
        if inside.any():
            out[inside] += log_likelihood(values[inside], places[inside, k:])
        return out

    return log_prob


def _bounds(latents, constants=0):
    low, high = latents.of_priors("bounds").T
    open_end = np.full(constants, np.inf)
    return {"low": np.concatenate([low, -open_end]), "high": np.concatenate([high, open_end])}


def _in_values(posterior, latents, constants=0):
    """Draws from coordinates to values; log_prob per value, not per coordinate."""
    k = len(latents)
    places = posterior.draws

    def converted(array):
        head = latents.from_coordinate(array[..., :k])
        return np.concatenate([head, array[..., k:]], axis=-1) if constants else head

    return replace(
        posterior,
        draws=converted(places),
        log_prob=posterior.log_prob - latents.log_jacobian(places[:, :k]),
        chain=None if posterior.chain is None else converted(posterior.chain),
    )


def _mixed(misfit, latents, settings, warm, rng):
    """Continuous latents by an ensemble, the discrete ones summed out, then drawn given them."""
    discrete = latents.is_discrete
    grid = combinations(latents)
    smooth = type(latents)(tuple(i for i in latents.items if not i.prior.is_discrete))
    log_discrete = -float(np.log(len(grid)))

    def full(values):
        out = np.empty((len(values), len(grid), len(latents)))
        out[:, :, ~discrete] = values[:, None]
        out[:, :, discrete] = grid
        return out

    def log_table(values):
        every = full(values).reshape(-1, len(latents))
        return misfit.log_likelihood(every).reshape(len(values), len(grid)) + log_discrete

    log_prob = _density(smooth, lambda values, _: logsumexp(log_table(values), axis=1))
    draw_rng, sample_rng = rng.spawn(2)
    start = smooth.to_coordinate(smooth.sample(256, rng=draw_rng)) if warm is None else warm
    if warm is None:
        value = log_prob(start)
        start = start[np.argsort(-value, kind="stable")[:64]]
    posterior = sample_ensemble(
        log_prob, smooth.names, start, rng=sample_rng, n_eff=settings.n_eff,
        max_steps=settings.max_steps, **_bounds(smooth),
    )  # fmt: skip
    values = smooth.from_coordinate(posterior.draws)
    table = log_table(values)
    gumbel = draw_rng.gumbel(size=table.shape)
    chosen = np.argmax(table + gumbel, axis=1)
    rows = np.arange(len(values))
    k = len(latents)
    n_eff, r_hat = np.full(k, float(np.min(posterior.n_eff))), np.full(k, np.nan)
    n_eff[~discrete], r_hat[~discrete] = posterior.n_eff, posterior.r_hat
    return Posterior(
        latents.names, full(values)[rows, chosen], posterior.weights,
        table[rows, chosen] + smooth.log_prior(values), "emcee x enumeration", n_eff, r_hat,
        posterior.acceptance, posterior.autocorr_time, posterior.converged,
        notes=posterior.notes, walkers=posterior.walkers,
    )  # fmt: skip


def refine(profile, scenes, latents, likelihood, *, rng, settings=None, misfit=None):
    """Constants and latents of a found law sampled together (constants with a flat prior).

    Parameters
    ----------
    profile : Profile
        The joint optimum; its law is sampled around it.
    misfit : misfit of its law, optional
        Where it has been made already.

    Returns
    -------
    Posterior
        Over the latents, then the constants.

    Raises
    ------
    SettingsError
        If a latent is discrete.
    """
    settings = settings or EStep()
    latents, _ = latents.of_scenes([scene.name for scene in scenes])
    if latents.is_discrete.any():
        raise SettingsError("constants and discrete latents are not sampled together")
    misfit = misfit or likelihood.misfit(profile.law, latents, scenes)
    if misfit.reference is not None:
        profile = misfit.reference.profile
    elif likelihood.is_gls and likelihood.kind != "gls":
        profile = fit_profile(misfit, profile.values[None])  # sharper than it was found with
    used, own = misfit, []
    if likelihood.exact and misfit.reference is not None:
        if is_point(profile, latents):
            posterior = point_posterior(latents, profile, misfit.constants, rng)
            return _with_findings(posterior, misfit, latents, profile, rng)
        own = [softened_note(float(np.nanmax(likelihood.sigma)))]
        used = Softened(misfit, float(np.nanmax(likelihood.sigma)))
        profile = used.reference.profile
    n_c = len(misfit.constants)
    start_rng, sample_rng, check_rng = rng.spawn(3)
    n_walkers = max(32, 4 * (len(latents) + n_c))
    start, _, _ = start_places(latents, profile, n_walkers, start_rng, constants=n_c)
    try:
        posterior = sample_ensemble(
            _density(latents, used.log_likelihood), (*latents.names, *misfit.constants), start,
            rng=sample_rng, n_eff=settings.n_eff, max_steps=settings.max_steps,
            keep_chain=settings.keep_chain, **_bounds(latents, n_c),
        )  # fmt: skip
    except FitError as error:
        raise FitError(f"joint refinement: {error}", estimate=profile) from None
    posterior = _in_values(posterior, latents, n_c)
    posterior = replace(posterior, notes=(*posterior.notes, *own))
    if used is misfit:
        posterior = reweighted(posterior, misfit, latents, rng=check_rng)
    return _with_findings(posterior, misfit, latents, profile, check_rng)


def _with_findings(posterior, misfit, latents, profile, rng):
    """A posterior of latents, and maybe constants, with what its reader must be told."""
    n_c = len(posterior.names) - len(latents)
    posterior = replace(
        posterior,
        priors=(*(item.prior for item in latents.items), *(None,) * n_c),
        truth=np.concatenate([latents.truth, np.full(n_c, np.nan)]),
    )
    found = findings(misfit, latents, posterior, profile, rng=rng)
    return replace(posterior, notes=(*posterior.notes, *misfit.notes, *found))
