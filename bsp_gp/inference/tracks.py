"""The whole-track likelihood: misfits about a joint optimum, and how far they can be trusted."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.inference.misfit import misfit_of
from bsp_gp.inference.posterior import effective_size, weights_of
from bsp_gp.inference.profile import FixedConstants, fit_profile
from bsp_gp.inference.track_reference import find_reference
from bsp_gp.inference.track_world import TrackWorld

N_STARTS = 8
"""Prior draws from which the joint optimum is sought."""
NUMERICAL = 1e3
"""Levels of numerical noise within which a law leaves nothing of exact tracks."""
ALIKE = 1.3
"""Level left by a law, in that estimated from the tracks alone, that leaves nothing to explain."""
BETTER = 3.0
"""Nats by which the paper's steps must explain noisy tracks better than continuous motion."""
LOST = 1e-13
"""Information, in parts of the largest, that is rounding."""
POINT = 1e-6
"""Width of a posterior, in that of its prior, below which it is numerically a point."""
N_CHECKED = 20
"""Draws at which a posterior is checked against tracks that are linearised there."""
APART = 0.1
"""Difference in log-probability, nats, that is no concern."""
N_WEIGHTED = 500
"""Draws that are weighted anew where it is larger."""
ENOUGH = 50
"""Effective draws after weighting, below which they are no posterior."""
BLIND, WIDER = 2.0, 5.0
"""Standard errors between one step and whole tracks, and ratio of their widths, worth a note."""


def track_misfit(likelihood, law, latents, scenes, holds_constants):
    """The misfit of a law on whole tracks.

    Where no joint optimum is found on whole tracks, that of the propagated one-step form, with a
    note.

    Returns
    -------
    ReducedMisfit or DirectMisfit
        With `reference` and `notes`.
    """
    first = _one_step(likelihood, law, latents, scenes, holds_constants)
    references = _references(likelihood, law, latents, scenes, holds_constants, first)
    if not references:
        other = replace(likelihood, kind="one_step" if likelihood.exact else "propagated")
        misfit = other.misfit(law, latents, scenes)
        misfit.notes = (
            "no joint optimum was found on whole tracks: the posterior is that of single steps "
            f"({other.kind.replace('_', ' ')})",
        )
        return misfit
    best = max(references, key=_log_likelihood)
    misfit = misfit_of(law, latents, best.bank)
    misfit.reference = best
    misfit.notes = _level_note(likelihood, best)
    if not likelihood.exact:
        constants = () if holds_constants else misfit.constants
        misfit.notes += tuple(_blindness(first, best, latents, constants))
    return misfit


def _one_step(likelihood, law, latents, scenes, holds_constants):
    """The joint optimum of single steps: where tracks are begun with."""
    rng = np.random.default_rng(0)  # start places only
    misfit = likelihood.for_search.misfit(law, latents, scenes)
    if holds_constants:
        misfit = FixedConstants(misfit)
    return fit_profile(misfit, latents.sample(N_STARTS, rng=rng))


def _references(likelihood, law, latents, scenes, holds_constants, first):
    """Settled references, by kind of steps."""
    rng = np.random.default_rng(1)  # start places only
    starts = np.concatenate([first.values[None], latents.sample(N_STARTS - 1, rng=rng)])
    constants = None if holds_constants or not len(first.constants) else first.constants
    # The paper's data, and those of collisions, were made in Euler steps.
    both = likelihood.exact > 0 or likelihood.velocities == "backward"
    out = []
    for paper_steps in (True, False) if both else (False,):
        world = TrackWorld(
            law, latents, tuple(scenes), _level(likelihood, scenes), paper_steps, likelihood.up,
            likelihood.is_estimated or likelihood.exact > 0, likelihood.exact, holds_constants,
            likelihood.is_quoted,
        )  # fmt: skip
        try:
            found = find_reference(world, starts, constants)
        except (EvaluationError, np.linalg.LinAlgError):
            continue
        explains = _explains(found, likelihood)
        if found.has_modes and not explains:
            continue  # other contacts than those of the data: a minimum of its own
        if found.is_settled or _is_numerical(found, likelihood):
            out.append(found)
            if explains:
                break  # nothing is left that other steps could explain
    return out


def _is_numerical(found, likelihood):
    return bool(np.nanmax(found.world.sigma) <= NUMERICAL * likelihood.exact)


def _explains(found, likelihood):
    """Whether tracks are explained up to their noise."""
    if likelihood.exact:
        return _is_numerical(found, likelihood)
    if likelihood.is_estimated:
        return bool(np.nanmax(found.world.sigma / _level(likelihood, found.world.scenes)) < ALIKE)
    dof = sum(path.n_seen for path in found.bank.paths)
    return bool(found.profile.chisq < dof + 3 * np.sqrt(2 * dof))


def _level(likelihood, scenes):
    sigma = np.asarray(likelihood.sigma, dtype=float)
    return np.array(np.broadcast_to(sigma, (scenes[0].n_dims,)))


def _log_likelihood(reference):
    """Nats, up to what all references of the same tracks share."""
    sigma = reference.world.sigma
    seen = sum(path.n_seen for path in reference.bank.paths) / len(sigma)
    total = -0.5 * reference.profile.chisq - seen * float(np.nansum(np.log(sigma)))
    return total - (BETTER if reference.world.paper_steps else 0.0)


# --- what a reader must be told -------------------------------------------------------------------


def _level_note(likelihood, reference):
    """What was taken for the noise, where it was not given."""
    level = float(np.nanmax(reference.world.sigma))
    if likelihood.exact:
        return (
            f"the positions are exact: intervals are those of the {level:.2g} m that the law "
            "leaves of them, numerical noise or what the law lacks",
        )
    if likelihood.is_estimated:
        return (f"noise {level:.3g} m, estimated under the law on whole tracks",)
    return ()


def _blindness(one, reference, latents, constants):
    """Where single steps would have misled."""
    track = reference.profile
    names = [*latents.names, *constants]
    apart, wider = [], []
    fits = (one, track)
    places = [[*latents.to_coordinate(p.values), *p.constants] for p in fits]
    widths = [_widths(p, latents) for p in fits]
    for name, a, b, sd_a, sd_b in zip(names, *places, *widths, strict=True):
        if abs(a - b) > BLIND * np.hypot(sd_a, sd_b) and np.isfinite(sd_b):
            apart.append(name)
        if sd_a > WIDER * sd_b:
            wider.append(name)
    if apart:
        yield (
            f"single steps from row to row put {', '.join(apart)} elsewhere, by more than "
            f"{BLIND:g} standard errors: the rows are too coarse or too noisy for them, whole "
            "tracks were used"
        )
    if wider:
        yield (
            f"single steps from row to row see {', '.join(wider)} more than {WIDER:g} times less "
            "accurately than whole tracks"
        )


def _widths(profile, latents):
    """Standard deviations by the information at an optimum, the width of the priors included."""
    information = np.array(profile.information)
    spread = latents.of_priors("spread")
    index = np.arange(len(spread))
    information[index, index] += 1 / np.square(spread)
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    # What rounding hides counts as free, not as known.
    values = np.maximum(values, LOST * values[-1])
    return np.sqrt(np.square(vectors) @ (1 / values)) / size


# --- exact positions -----------------------------------------------------------------------------


class Softened:
    """A misfit of exact tracks with an error at which an ensemble can move.

    Parameters
    ----------
    misfit : misfit with a reference
    level : float, m
    """

    def __init__(self, misfit, level):
        self.misfit = misfit
        share = float(np.nanmax(misfit.reference.world.sigma) / level)
        self.factor = share**2
        profile = misfit.reference.profile
        profile = replace(profile, jacobian=share * profile.jacobian)
        self.reference = replace(misfit.reference, profile=profile)

    def log_likelihood(self, values, constants=None):
        """Nats up to a constant, (W,)."""
        return self.factor * self.misfit.log_likelihood(values, constants)


def is_point(profile, latents):
    """Whether a joint optimum is so sharp that no sampler need move in it."""
    spread = latents.of_priors("spread")
    widths = _widths(profile, latents)
    sizes = np.concatenate([spread, np.abs(profile.constants)])
    return bool(np.all(widths <= POINT * sizes))


# --- whether the linearisation holds --------------------------------------------------------------


def reweighted(posterior, misfit, latents, *, rng):
    """A posterior checked against tracks whose nodes are settled anew at its draws.

    Where log-probabilities differ by more than `APART` the draws are weighted anew.

    Parameters
    ----------
    posterior : Posterior
        Latents first, constants after them.
    misfit : misfit of the law
        With the reference that the draws were made with.
    """
    reference = misfit.reference
    if reference is None:
        return posterior
    k = len(latents)

    def log_ratio(draws):
        constants = draws[:, k:] if draws.shape[1] > k else None
        with np.errstate(all="ignore"):  # tracks that run away
            exact = reference.exact_chisq(draws[:, :k], constants)
            return -0.5 * exact - misfit.log_likelihood(draws[:, :k], constants)

    some, _ = posterior.thinned(min(N_CHECKED, len(posterior.weights)), rng=rng)
    ratio = log_ratio(some)
    with np.errstate(invalid="ignore"):
        apart = float(np.ptp(ratio))
    if apart <= APART:  # never where one is not finite
        return posterior
    index = rng.choice(len(posterior.weights), size=N_WEIGHTED, p=posterior.weights)
    draws = posterior.draws[index]
    ratio = log_ratio(draws)
    weights = weights_of(ratio)
    if weights is None:
        note = f"tracks run away at all of {N_WEIGHTED} draws: the posterior could not be checked"
        return replace(posterior, converged=False, notes=(*posterior.notes, note))
    ratio = np.where(np.isfinite(ratio), ratio, -np.inf)
    size = effective_size(weights)
    note = (
        f"tracks bend within the posterior (log-probabilities by {apart:.2g} "
        f"nats): {N_WEIGHTED} draws were weighted by tracks integrated anew"
    )
    converged = posterior.converged and size >= ENOUGH
    if size < ENOUGH:
        note += f"; only {size:.0f} of them count, the intervals are a rough guide"
    return replace(
        posterior, draws=draws, weights=weights, log_prob=posterior.log_prob[index] + ratio,
        n_eff=np.minimum(posterior.n_eff, size), converged=converged,
        notes=(*posterior.notes, note), method=f"{posterior.method}, weighted",
    )  # fmt: skip
