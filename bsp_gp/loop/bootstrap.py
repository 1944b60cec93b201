"""Question 5 through the whole search: how often a complete model looks as incomplete.

The declared model is taken for the truth: its fitted tracks with noise as large and with as long a
memory as its residual may have, drawn anew for every data set. On every such data set the search is
done again from the start: the model is fitted, the tracks are denoised, the noise is estimated, all
laws are searched. The p-value counts how often the best law is as strong as the one that was found.
What is tested beside the search, common effects and rivals, has p-values of its own, and counts
double. Rounds need no further correction: a round is only reached if all before it adopted
something, so that at most one of them meets a complete model first (a gatekeeping procedure).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.loop.denoise import tracks_of
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.memory import plausible_memories, search_with_memory
from bsp_gp.physics.noise import draw_noise

__all__ = ["Significance", "bootstrap", "strength"]

ENOUGH = 8
"""As strong simulated findings after which a p-value is known well enough (Besag and Clifford
1991, Biometrika 78, 301)."""
LEAST = 19
"""Simulated data sets before a finding may count as beyond them all."""
BATCH = 8
TAIL = 1.5
"""Factor on the width of the tail, which is estimated from few simulated findings."""


@dataclass(frozen=True)
class Significance:
    """Outcome of a bootstrap.

    Attributes
    ----------
    p_value : float
    n_done : int
        Simulated data sets.
    n_as_strong : int
        Of these, with a finding as strong as the observed one.
    n_failed : int
        That could not be fitted; they count as if as strong.
    is_extrapolated : bool
        No finding came near, and the p-value is that of the fitted tail.
    strengths : tuple of float
        Of the simulated findings, nats.
    """

    p_value: float
    n_done: int
    n_as_strong: int
    n_failed: int
    is_extrapolated: bool
    strengths: tuple[float, ...]

    def text(self):
        """For the report: how the p-value came about."""
        if self.is_extrapolated:
            how = "none comes near, the p-value is that of their fitted tail"
        else:
            how = f"{self.n_as_strong} of them with as strong a finding"
        failed = f", {self.n_failed} of them without a fit" if self.n_failed else ""
        return f"the whole search on {self.n_done} simulated data sets{failed}: {how}"


def strength(proposals):
    """Evidence of the best proposal that is more than a change of a declared number, nats."""
    able = [p.evidence for p in proposals.shortlist if not p.redoes_declared]
    return max(able, default=-math.inf)


def bootstrap(search, fit, observed, rng, *, alpha=0.01, n_max=99, workers=None):
    """p-value of a finding of the search, which is done again on simulated data.

    Parameters
    ----------
    search : EffectSearch
        On the observation as it was before a memory of its noise was estimated.
    fit : Fit
        Of the model that may be complete.
    observed : float
        `strength` of what was found.
    rng : numpy.random.Generator
    alpha : float
        Level; far beyond it no further data are simulated.
    n_max : int
    workers : concurrent.futures.Executor, optional
        The answer does not depend on it.

    Returns
    -------
    Significance
    """
    source = _Source(search, fit)
    run = map if workers is None else workers.map
    strengths, n_failed = [], 0
    seeds = rng.spawn(n_max)
    for start in range(0, n_max, BATCH):
        for value in run(source, seeds[start : start + BATCH]):
            is_failed = value is None or math.isnan(value)
            n_failed += is_failed
            strengths.append(math.inf if is_failed else value)
            done = _decided(strengths, n_failed, observed, alpha, n_max)
            if done is not None:
                return done
    n_strong = sum(not s < observed for s in strengths)  # nor is what failed significant
    return Significance(
        (n_strong + 1) / (n_max + 1), n_max, n_strong, n_failed, False, tuple(strengths)
    )


def _decided(strengths, n_failed, observed, alpha, n_max):
    n, n_strong = len(strengths), sum(not s < observed for s in strengths)
    if n_strong >= ENOUGH:
        return Significance(n_strong / n, n, n_strong, n_failed, False, tuple(strengths))
    if n < LEAST or n == n_max or n_strong:
        return None
    p = _tail(np.array(strengths), observed)
    return None if p > alpha / 10 else Significance(p, n, 0, n_failed, True, tuple(strengths))


def _tail(strengths, observed):
    """Chance of the observed strength under the Gumbel law of the simulated maxima.

    The greatest of many chi-squared gains has a tail that falls by e for each nat, not faster.
    """
    width = max(TAIL * math.sqrt(6) / math.pi * float(np.std(strengths, ddof=1)), 1.0)
    middle = float(np.mean(strengths)) - 0.5772156649015329 * width / TAIL
    return -math.expm1(-math.exp(min(-(observed - middle) / width, 50.0)))


class _Source:
    """Makes a data set as the model would have it, and returns what the search finds in it."""

    def __init__(self, search, fit):
        observation = search.observation
        self.noises = plausible_memories(search, fit)
        self.search = search
        self.law = fit.law
        self.tracks = tracks_of(fit.whole, observation.train)

    def __call__(self, rng):
        data_rng, search_rng = rng.spawn(2)
        weights, memories, factors = zip(*self.noises, strict=True)
        k = data_rng.choice(len(weights), p=weights)
        noise = self.search.observation.sigma * factors[k], memories[k]
        train = [self._simulated(s, noise, data_rng) for s in self.search.observation.train]
        search = self.search.on(self.search.observation.with_train(train))
        return or_fault(self._strength, search, search_rng)[0]

    def _strength(self, search, rng):
        fit = search.observation.fit(self.law)
        _, _, proposals = search_with_memory(search, fit, rng, n_null=0, top_k=1, max_ties=0)
        return strength(proposals)

    def _simulated(self, scene, noise, rng):
        """The scene with simulated positions; one whose rollout ran away is kept as it is."""
        if scene.name not in self.tracks:
            return scene
        track, _ = self.tracks[scene.name]
        sigma, memory = noise
        drawn = track + draw_noise(scene, sigma, memory, rng)
        # An axis along which nothing moves has no noise and keeps its values.
        drawn = np.where(np.isfinite(sigma), drawn, scene.positions[:, scene.dynamic])
        return replace(scene.on_track(drawn), velocities=None)
