"""The E-step by an affine-invariant ensemble (emcee), vectorised over walkers.

Foreman-Mackey et al. 2013 (PASP 125, 306); moves mixed of stretches and differential evolution.
Runs until the effective sample size asked for is reached, judged by the autocorrelation time.
"""

import logging

import numpy as np

from bsp_gp.errors import FitError
from bsp_gp.inference.posterior import Posterior, split_r_hat

logger = logging.getLogger(__name__)
FIRST_STEPS = 200
TRUSTED = 40
"""Chains shorter than so many autocorrelation times do not know that time."""
BURN_IN = 5
"""Autocorrelation times left out at the start."""
DEAD_MOVES = 0.02


def sample_ensemble(
    log_prob, names, start, *, rng, n_eff=1000, max_steps=20_000, keep_chain=False, low=None,
    high=None,
):  # fmt: skip
    """Sample a density with an ensemble of walkers.

    Parameters
    ----------
    log_prob : callable
        ``log_prob(x) -> (W,)`` for x of shape (W, k); -inf outside of the support.
    names : tuple of str, length k
    start : ndarray, shape (n, k)
        Places to start from (last walkers, Laplace or prior draws); more are made if needed.
    n_eff : float
        Effective sample size of the worst parameter to stop at.
    max_steps : int
        Bound; a chain that has not got there is returned, with the reason.
    low, high : ndarray, shape (k,), optional
        Bounds of the support, to keep start places inside.

    Returns
    -------
    Posterior
        Equally weighted draws, with `converged` and the reason in `notes` if not.

    Raises
    ------
    FitError
        If no start place has a finite probability.
    """
    import emcee  # a slow import

    k = len(names)
    n_walkers = max(32, 4 * k)
    places = _start_places(log_prob, np.atleast_2d(start), n_walkers, low, high, rng)
    moves = [(emcee.moves.StretchMove(), 0.4), (emcee.moves.DEMove(), 0.5),
             (emcee.moves.DESnookerMove(), 0.1)]  # fmt: skip
    sampler = emcee.EnsembleSampler(n_walkers, k, log_prob, vectorize=True, moves=moves)
    # The sampler's own seed argument is ignored silently: the state carries the generator.
    seed = np.random.RandomState(int(rng.integers(2**32))).get_state()
    state = emcee.State(places, random_state=seed)
    steps, enough = FIRST_STEPS, False
    done = 0
    while True:
        # Weird start places are no reason to refuse: DE moves leave any affine subspace.
        state = sampler.run_mcmc(state, steps - done, skip_initial_state_check=True)
        done = steps
        tau = _autocorr_time(sampler, emcee)
        worst = float(np.max(tau)) if np.isfinite(tau).all() else np.inf
        got = n_walkers * (done - BURN_IN * worst) / worst if np.isfinite(worst) else 0.0
        enough = got >= n_eff and done >= TRUSTED * worst
        if enough or done >= max_steps:
            break
        needed = worst * max(n_eff / n_walkers + BURN_IN, TRUSTED) if np.isfinite(worst) else 0
        steps = int(min(max_steps, max(done * 1.3, min(needed * 1.1, done * 3))))
    return _posterior(sampler, names, tau, enough, n_eff, keep_chain, state)


def _start_places(log_prob, start, n_walkers, low, high, rng):
    """Walkers at places of finite probability, no two alike."""
    value = log_prob(start)
    good = start[np.isfinite(value)]
    if not len(good):
        raise FitError(
            "no start place of the sampler has a finite probability: the law has no finite value "
            "anywhere in the priors' support",
            estimate=start.mean(axis=0),
        )
    index = np.arange(n_walkers) % len(good)
    places = good[rng.permutation(len(good))[index]].astype(float)
    spread = good.std(axis=0)
    spread = np.where(spread > 0, spread, 1e-4 * np.maximum(np.abs(good.mean(axis=0)), 1e-3))
    repeated = np.arange(n_walkers) >= len(good)
    for _ in range(50):
        trial = places + 0.1 * spread * rng.standard_normal(places.shape)
        if low is not None:
            trial = np.clip(trial, low, high)
        fine = repeated & np.isfinite(log_prob(trial))
        places[fine] = trial[fine]
        repeated &= ~fine
        if not repeated.any():
            break
        spread = spread / 2
    return places


def _autocorr_time(sampler, emcee):
    """Integrated autocorrelation time of every parameter, in steps.

    inf where it has no value: where a walker has not moved yet, the chain has not converged.
    """
    chain = sampler.get_chain(discard=sampler.iteration // 5)
    with np.errstate(all="ignore"):
        tau = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


def _posterior(sampler, names, tau, enough, n_eff, keep_chain, state):
    done = sampler.iteration
    worst = float(np.max(tau)) if np.isfinite(tau).all() else done / 10
    burn = int(min(BURN_IN * worst, done // 2))
    thin = max(1, int(worst / 2))
    chain = sampler.get_chain(discard=burn)
    draws = sampler.get_chain(discard=burn, thin=thin, flat=True)
    log_prob = sampler.get_log_prob(discard=burn, thin=thin, flat=True)
    sizes = np.minimum(chain.shape[0] * chain.shape[1] / tau, chain.shape[0] * chain.shape[1])
    acceptance = float(np.mean(sampler.acceptance_fraction))
    notes = []
    if not enough:
        notes.append(
            f"the chain did not converge in {done} steps: autocorrelation time {np.max(tau):.0f} "
            f"(a chain of {TRUSTED} of them is wanted), effective sample size {sizes.min():.0f} of "
            f"{n_eff:g} asked for; the draws are usable as a rough guide only"
        )
        logger.warning("%s: %s", ", ".join(names), notes[0])
    if acceptance < DEAD_MOVES:
        notes.append(f"only {100 * acceptance:.1f} % of the moves were accepted")
    return Posterior(
        tuple(names), draws, np.full(len(draws), 1 / len(draws)), log_prob, "emcee", sizes,
        split_r_hat(chain), acceptance, float(np.max(tau)), enough, notes=tuple(notes),
        walkers=np.array(state.coords), chain=chain if keep_chain else None,
    )  # fmt: skip
