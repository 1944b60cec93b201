"""Where an unseen source must be, and how strong: draws from the posterior.

The likelihood is the view about the best fit, in which the pull is exact in the place and the
response of the tracks linear. The strength is integrated out, so that only places (and velocities)
are searched; it is drawn afterwards, given each of them. Draws are weighed from a widened Laplace
proposal; where these weights collapse (a bent or a broken posterior), an ensemble of walkers takes
over. The prior is flat over the scene and falls off beyond it, as a Cauchy law of the size of the
scene; that of the strength is flat in its logarithm above a small part of the strongest visible
body's, so that far and strong sources are no likelier than near and weak ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.inference.emcee_step import sample_ensemble
from bsp_gp.inference.posterior import effective_size
from bsp_gp.loop.hidden_motion import ORBIT
from bsp_gp.loop.hidden_place import scales

__all__ = ["Draws", "draw_posterior"]

N_PROPOSED = 3000
N_DRAWS = 600
FREEDOM = 5.0
WIDENED = 1.2
LEAST_SHARE = 0.05
"""Effective share of the proposed draws below which an ensemble takes over."""
PRIOR_SIZE = 3.0
"""Width of the prior in units of the scene."""
MOST_STRENGTH = 1e3
"""Greatest strength, in units of the strongest visible body."""
LEAST_STRENGTH = 1e-6
"""Strength, in the same units, below which the prior is flat."""
N_STRENGTHS = 96
REACH = 6.0
"""Half of the range of strengths that is summed over, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Equally weighted draws of place, velocity and strength.

    Attributes
    ----------
    values : ndarray, shape (S, k)
        Strength last.
    method : str
    n_eff : float
    notes : tuple of str
    """

    values: np.ndarray
    method: str
    n_eff: float
    notes: tuple = ()

    @property
    def mean(self):
        return self.values.mean(axis=0)

    @property
    def sd(self):
        return self.values.std(axis=0)

    def quantile(self, q):
        return np.quantile(self.values, q, axis=0)


def draw_posterior(polished, pull, stage, rng, inflation, may_walk=True):
    """Draw from the posterior of a polished source.

    Parameters
    ----------
    polished : Polished
    pull : Pull
    stage : Stage
    rng : numpy.random.Generator
    inflation : float
        Variance of the whitened residual, at least 1 where it is noise.
    may_walk : bool
        Whether walkers may take over; else the draws are rough where weights collapse.

    Returns
    -------
    Draws
    """
    found, view = polished.found, polished.view
    motion = found.motion
    unit = scales(motion, stage)
    mode = found.parameters / unit
    middle = np.zeros(len(unit))
    middle[: motion.n_dims] = stage.middle / unit[: motion.n_dims]
    strengths = _Strengths(view, pull, inflation)

    def log_prob(x):
        value, *_ = strengths(view.response(motion, x * unit))
        value = value - _far(x[:, : motion.n_dims] - middle[: motion.n_dims])
        if motion.n_parameters > motion.n_dims:
            value = value - _far(x[:, motion.n_dims :])
        return np.where(np.isfinite(value), value, -np.inf)

    def complete(x, rng):
        return np.column_stack([x * unit, strengths.drawn(view.response(motion, x * unit), rng)])

    covariance = _laplace(view, motion, mode, unit, found.strength, inflation)
    proposal_rng, pick_rng, walk_rng, strength_rng = rng.spawn(4)
    x, log_weight = _proposed(log_prob, mode, covariance, proposal_rng)
    top = log_weight.max()
    if np.isfinite(top):
        weight = np.exp(log_weight - top)
        weight = weight / weight.sum()
        n_eff = effective_size(weight)
        pick = pick_rng.choice(len(weight), size=N_DRAWS, p=weight)
        if n_eff >= LEAST_SHARE * N_PROPOSED or not may_walk:
            return Draws(complete(x[pick], strength_rng), "importance", float(n_eff))
        start = np.unique(x[pick], axis=0)
    else:
        start = mode[None]
    axes = "xyz"[: motion.n_dims]
    moving = [f"v{axis}" for axis in axes] if len(unit) > motion.n_dims else []
    posterior = sample_ensemble(
        log_prob, (*axes, *moving), start, rng=walk_rng, n_eff=400,
        max_steps=400 if motion.kind == ORBIT else 3000,
    )  # fmt: skip
    values = complete(posterior.draw(N_DRAWS, rng=pick_rng), strength_rng)
    return Draws(values, "emcee", float(np.min(posterior.n_eff)), posterior.notes)


class _Strengths:
    """The strength given the response of unit sources: a normal law times the prior.

    In the coordinate u = log(1 + |s| / s0), with the sign of s, the prior is flat, and a uniform
    grid over the standard deviations around the best strength sums over everything that counts.
    """

    def __init__(self, view, pull, inflation):
        self.y, self.inflation = view.y, inflation
        self.least = LEAST_STRENGTH * pull.most
        high = MOST_STRENGTH * pull.most
        self.low, self.high = (0.0 if pull.is_positive else -high), high

    def __call__(self, response):
        """Log of the integral over the strength, the grid (C, n), and log-weights on it."""
        with np.errstate(all="ignore"):
            size = np.square(response).sum(axis=1) / self.inflation
            slope = (response @ self.y) / self.inflation
            sd = 1.0 / np.sqrt(np.maximum(size, 1e-300))
            best = slope / np.maximum(size, 1e-300)
            near = np.clip(best, self.low, self.high)
            bounds = [
                self._coordinate(np.clip(near + sign * REACH * sd, self.low, self.high))
                for sign in (-1, 1)
            ]
            step = (bounds[1] - bounds[0]) / N_STRENGTHS
            nodes = bounds[0][:, None] + step[:, None] * (np.arange(N_STRENGTHS) + 0.5)
            s = self._strength(nodes)
            weight = slope[:, None] * s - 0.5 * size[:, None] * np.square(s)
            top = weight.max(axis=1)
            total = top + np.log(np.exp(weight - top[:, None]).sum(axis=1) * step)
        return total, nodes, weight, step

    def drawn(self, response, rng):
        """One strength for each response, shape (C,)."""
        _, nodes, weight, step = self(response)
        # The greatest of weights with Gumbel noise is a draw in proportion to them.
        index = np.argmax(weight + rng.gumbel(size=weight.shape), axis=1)
        within = rng.uniform(-0.5, 0.5, len(index)) * step
        return self._strength(nodes[np.arange(len(index)), index] + within)

    def _coordinate(self, s):
        return np.sign(s) * np.log1p(np.abs(s) / self.least)

    def _strength(self, u):
        return np.sign(u) * self.least * np.expm1(np.abs(u))


def _far(x):
    """Minus the log-density of the prior, up to a constant."""
    k = x.shape[1]
    return 0.5 * (k + 1) * np.log1p(np.square(x / PRIOR_SIZE).sum(axis=1))


def _laplace(view, motion, mode, unit, strength, inflation):
    """Covariance of the place in units of the stage, the strength's error included.

    Where the data say nothing it is the prior's.
    """
    step = 1e-4
    k = len(mode)
    moved = np.concatenate([mode + step * np.eye(k), mode - step * np.eye(k)])
    out = strength * view.response(motion, moved * unit)
    slopes = np.nan_to_num((out[:k] - out[k:]) / (2 * step))
    own = view.response(motion, mode * unit)[0]
    size = own @ own
    if size > 0:  # what another strength takes up says nothing of the place
        slopes = slopes - np.outer(slopes @ own, own) / size
    information = slopes @ slopes.T / inflation + np.eye(k) / PRIOR_SIZE**2
    return np.linalg.inv(information)


def _proposed(log_prob, mode, covariance, rng):
    """Draws of a multivariate t and their log-weights."""
    k = len(mode)
    factor = np.linalg.cholesky(WIDENED**2 * covariance)
    z = rng.standard_normal((N_PROPOSED, k))
    scale = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, N_PROPOSED))[:, None]
    x = mode + (z * scale) @ factor.T
    squares = np.square(z * scale).sum(axis=1)
    log_density = -0.5 * (FREEDOM + k) * np.log1p(squares / FREEDOM)
    return x, log_prob(x) - log_density
