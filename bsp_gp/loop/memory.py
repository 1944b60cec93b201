"""Tracking noise with a memory: estimated beside the law, so that neither is taken for the other.

Errors of a tracker may be alike from frame to frame. Taken for white noise they look like a
small force; a force that the model lacks looks like such errors. The correlation time is
therefore estimated on what the best proposal of the search leaves, by maximum likelihood on the
second differences (from which initial states have dropped out), and the search is repeated with
it, until the two agree. How uncertain it is goes into the intervals of the constants (`widened`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.loop.effects import sign_bounds
from bsp_gp.search.columns import balanced

__all__ = [
    "NoiseFit", "estimate_memory", "p_value_of", "plausible_memories", "search_with_memory",
    "widened", "with_memory",
]  # fmt: skip

STEPS = (0.35, 0.5, 0.75, 1.0, 1.5, 2.5, 4.0, 7.0, 12.0, 25.0)
"""Correlation times that are tried, in median time steps; between them by a parabola."""
MIN_GAIN = 6.0
"""Fall of the BIC at which a memory is taken for real."""
MOST_TURNS = 2
MOST_TRIED = 1e6
"""Things tried at once, at most: beyond that a p-value is rounding."""
NEGLIGIBLE = 0.01
"""Probability of a memory below which it is left out of account."""
_NODES, _WEIGHTS = (-np.sqrt(3), np.sqrt(3)), (2 / 3, 1 / 6, 1 / 6)


@dataclass(frozen=True)
class NoiseFit:
    """Noise that explains a residual.

    Attributes
    ----------
    memory : float
        Correlation time, s; 0 = white.
    factor : float
        Its standard deviation over the one assumed.
    gain : float
        Fall of the BIC against white noise.
    spread : float
        Standard deviation of the logarithm of the memory; 0 where that is 0.
    """

    memory: float
    factor: float
    gain: float
    spread: float = 0.0


def estimate_memory(search, fit, proposal=None):
    """Correlation time of the noise, given the law and perhaps one more term.

    Parameters
    ----------
    search : EffectSearch
        Its observation's own memory does not matter.
    fit : Fit
        Of the law; its constants are refitted, and that of the proposal.
    proposal : Proposal, optional

    Returns
    -------
    NoiseFit
    """
    tried, logs, factors, n = _profiles(search, fit, proposal)
    best = int(np.argmax(logs))
    gain = 2 * (logs[best] - logs[0]) - np.log(n)
    if best == 0 or gain < MIN_GAIN:
        return NoiseFit(0.0, factors[0], 0.0)
    place, spread = _peak(np.log(tried[1:]), logs[1:], best - 1)
    memory = float(np.exp(place))
    _, factor, _ = _profile(search, memory, fit, proposal)
    return NoiseFit(memory, factor, float(gain), spread)


def plausible_memories(search, fit):
    """Memories that the noise may have, given a law, white noise among them.

    White noise is as likely beforehand as noise with a memory, all of those tried together. One
    that cannot be told from white noise in few rows still makes slow errors look like forces.

    Parameters
    ----------
    search : EffectSearch
    fit : Fit
        Of the law.

    Returns
    -------
    list of (float, float, float)
        Probability, memory in s, and factor on the assumed standard deviation (1 where that was
        not estimated, and for white noise where that is assumed), of those that matter. One alone
        where the memory was declared.
    """
    observation = search.observation
    if not observation.may_have_memory:
        return [(1.0, observation.memory, 1.0)]
    tried, logs, factors, _ = _profiles(search, fit, None)
    prior = np.array([1.0, *np.full(len(STEPS), 1 / len(STEPS))])
    weights = prior * np.exp(logs - logs.max())
    kept = weights > NEGLIGIBLE * weights.sum()
    weights, tried, factors = weights[kept] / weights[kept].sum(), tried[kept], factors[kept]
    if not observation.memory:
        factors = np.where(tried > 0, factors, 1.0)
    if observation.noise.source != "estimated":
        factors = np.ones(len(factors))
    return [tuple(map(float, row)) for row in zip(weights, tried, factors, strict=True)]


def p_value_of(search, before, after, p_value):
    """p-value of a term under all memories that the noise may have.

    Under each, the laws are fitted again. The p-value is that of the fall of chi-squared, times the
    number of things tried, which the given p-value says; their mean counts, by the probability of
    each memory given the law with the term.

    Parameters
    ----------
    search : EffectSearch
    before, after : Fit
        Of the law without and with the term.
    p_value : float
        Under the noise of the search's observation.

    Returns
    -------
    float
    """
    observation = search.observation
    free = max(len(after.parameters) - len(before.parameters), 1)
    own = _log_p(before.chisqr - after.chisqr, free)
    tried = np.clip(np.log(max(p_value, 1e-300)) - own, 0.0, np.log(MOST_TRIED))
    total = 0.0
    for weight, memory, factor in plausible_memories(search, after):
        if memory == observation.memory:
            total += weight * p_value
            continue
        other = with_memory(observation, memory, factor, is_whole=False)
        chisqr = [
            other.fit(fit.law, sign_bounds(other, fit.law), start=fit.law).chisqr
            for fit in (before, after)
        ]
        total += weight * np.exp(min(tried + _log_p(chisqr[0] - chisqr[1], free), 0.0))
    return float(total)


def _log_p(fall, free):
    """Logarithm of the p-value of a fall of chi-squared; far out that of its exponential alone."""
    from scipy.stats import chi2  # a slow import

    value = chi2.logsf(max(fall, 0.0), free)
    return value if np.isfinite(value) else -0.5 * fall


def _profiles(search, fit, proposal):
    """Memories tried, their log-likelihoods, factors on the noise level, and the rows."""
    step = _step(search.observation)
    tried = np.array([0.0, *(step * k for k in STEPS)])
    rows = [_profile(search, memory, fit, proposal) for memory in tried]
    logs, factors, n = zip(*rows, strict=True)
    return tried, np.array(logs), np.array(factors), n[0]


def _step(observation):
    """Median time step of the training scenes."""
    return float(np.median(np.concatenate([np.diff(s.times) for s in observation.train])))


def _peak(x, y, k):
    """Where the parabola through the best point and its neighbours is highest, and its width.

    The width is that of the normal law whose logarithm the parabola is; at an end of the grid the
    distance of the neighbour.
    """
    if 0 < k < len(x) - 1:
        a, b, _ = np.polyfit(x[k - 1 : k + 2] - x[k], y[k - 1 : k + 2], 2)
        if a < 0:
            shift = np.clip(-b / (2 * a), x[k - 1] - x[k], x[k + 1] - x[k])
            return float(x[k] + shift), float(1 / np.sqrt(-2 * a))
    return float(x[k]), float(np.abs(np.diff(x[max(k - 1, 0) : k + 2])).max())


def _profile(search, memory, fit, proposal):
    """Log-likelihood with constants and noise level profiled out, noise level, and rows."""
    # What it leaves is regressed anew: the observation's own regressions are not asked for.
    observation = replace(search.observation, memory=float(memory))
    regression, residual, columns = search.on(observation).left(fit, proposal)
    if columns.shape[1]:
        columns = balanced(columns)
        sizes = np.linalg.norm(columns, axis=0)
        columns = columns[:, sizes > 0] / sizes[sizes > 0]
        residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    n = regression.n_rows
    free = max(n - columns.shape[1], 1)
    size = float(residual @ residual)
    log = regression.log_scale() - 0.5 * free * np.log(max(size, 1e-300))
    return log, float(np.sqrt(size / free)), n


def with_memory(observation, memory, factor=1.0, is_whole=True):
    """The observation under noise with a memory.

    Parameters
    ----------
    observation : Observation
    memory : float
        Correlation time, s.
    factor : float
        On the standard deviation, where that was estimated: differences of positions see little
        of an error that hardly changes from one to the next.
    is_whole : bool
        Otherwise for fits alone: what is regressed on held-out tracks stays as it was.
    """
    factor = factor if observation.noise.source == "estimated" else 1.0
    changed = replace(
        observation,
        memory=float(memory),
        sigma=observation.sigma * factor,
        regression_sigma=observation.regression_sigma * factor,
        noise=replace(observation.noise, sigma=tuple(np.array(observation.noise.sigma) * factor)),
    )
    return replace(
        changed,
        train_regression=changed.regression(observation.train),
        test_regression=(
            changed.regression(observation.test) if is_whole else observation.test_regression
        ),
    )


def widened(search, fit):
    """The fit with the uncertainty of an estimated memory in the covariance of its constants.

    The law is fitted again under a longer and a shorter memory, the outer two nodes of a
    three-point Gauss-Hermite rule, each with the noise level that goes with it; the covariance is
    that of the mixture.

    Parameters
    ----------
    search : EffectSearch
        On the observation of the fit.
    fit : Fit
        Of a law to its training scenes.

    Returns
    -------
    Fit
        The same one where no memory was estimated.
    """
    observation = search.observation
    if not (observation.memory and observation.may_have_memory and fit.parameters):
        return fit
    spread = estimate_memory(search, fit).spread
    # No further than what was tried: beyond that the likelihood says nothing.
    ends = np.log(_step(observation)) + np.log((STEPS[0], STEPS[-1]))
    total = _WEIGHTS[0] * fit.covariance
    for weight, node in zip(_WEIGHTS[1:], _NODES, strict=True):
        memory = float(np.exp(np.clip(np.log(observation.memory) + node * spread, *ends)))
        _, factor, _ = _profile(search, memory, fit, None)
        other = with_memory(observation, memory, factor, is_whole=False)
        again = other.fit(fit.law, sign_bounds(other, fit.law), start=fit.law)
        moved = again.values - fit.values
        total = total + weight * (again.covariance + np.outer(moved, moved))
    return replace(fit, covariance=total)


def search_with_memory(search, fit, rng, **options):
    """Search for what a fitted law lacks, the noise estimated beside it.

    Parameters
    ----------
    search : EffectSearch
    fit : Fit
    rng : numpy.random.Generator
    **options
        For `EffectSearch.propose`.

    Returns
    -------
    search : EffectSearch
        On the observation with the noise that was found, or the one given.
    fit : Fit
        Of the law under that noise.
    proposals : Proposals
    """
    proposals = search.propose(fit, rng, **options)
    if not search.observation.may_have_memory:
        return search, fit, proposals
    for _ in range(MOST_TURNS):
        # A changed number explains a residual as well as a new term does.
        best = max(proposals.shortlist, key=lambda p: p.evidence, default=None)
        noise = estimate_memory(search, fit, best)
        before = search.observation.memory
        if abs(noise.memory - before) <= 0.1 * max(noise.memory, before):
            break
        observation = with_memory(search.observation, noise.memory, noise.factor)
        search = search.on(observation)
        fit = observation.fit(fit.law, sign_bounds(observation, fit.law))
        proposals = search.propose(fit, rng, **options)
    return search, fit, proposals
