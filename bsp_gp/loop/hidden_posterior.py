"""Where an unseen source must be, and how strong: draws from the posterior.

The likelihood is the view about the best fit, in which the pull is exact in the place and the
response of the tracks linear. Draws are weighed from a widened Laplace proposal; where these
weights collapse (a bent or a broken posterior), an ensemble of walkers takes over. The prior is
flat over the scene and falls off beyond it, as a Cauchy law of the size of the scene.
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
    unit = np.append(scales(motion, stage), max(abs(found.strength), 1e-12 * pull.most))
    mode = np.append(found.parameters, found.strength) / unit
    middle = np.zeros(len(unit))
    middle[: motion.n_dims] = stage.middle / unit[: motion.n_dims]
    low = 0.0 if pull.is_positive else -MOST_STRENGTH * pull.most / unit[-1]
    high = MOST_STRENGTH * pull.most / unit[-1]

    def log_prob(x):
        response = view.response(motion, x[:, :-1] * unit[:-1])
        left = view.y - (x[:, -1:] * unit[-1]) * response
        with np.errstate(over="ignore", invalid="ignore"):
            value = -0.5 * np.square(left).sum(axis=1) / inflation
        value = value - _far(x[:, : motion.n_dims] - middle[: motion.n_dims])
        if motion.n_parameters > motion.n_dims:
            value = value - _far(x[:, motion.n_dims : -1])
        inside = (x[:, -1] > low) & (x[:, -1] < high)
        return np.where(inside & np.isfinite(value), value, -np.inf)

    covariance = _laplace(view, motion, mode, unit, inflation)
    proposal_rng, pick_rng, walk_rng = rng.spawn(3)
    x, log_weight = _proposed(log_prob, mode, covariance, proposal_rng)
    top = log_weight.max()
    if np.isfinite(top):
        weight = np.exp(log_weight - top)
        weight = weight / weight.sum()
        n_eff = effective_size(weight)
        pick = pick_rng.choice(len(weight), size=N_DRAWS, p=weight)
        if n_eff >= LEAST_SHARE * N_PROPOSED or not may_walk:
            return Draws(x[pick] * unit, "importance", float(n_eff))
        start = np.unique(x[pick], axis=0)
    else:
        start = mode[None]
    axes = "xyz"[: motion.n_dims]
    moving = [f"v{axis}" for axis in axes] if len(unit) > motion.n_dims + 1 else []
    names = (*axes, *moving, pull.column)
    posterior = sample_ensemble(
        log_prob, names, start, rng=walk_rng, n_eff=400,
        max_steps=400 if motion.kind == ORBIT else 3000,
    )  # fmt: skip
    values = posterior.draw(N_DRAWS, rng=pick_rng) * unit
    return Draws(values, "emcee", float(np.min(posterior.n_eff)), posterior.notes)


def _far(x):
    """Minus the log-density of the prior, up to a constant."""
    k = x.shape[1]
    return 0.5 * (k + 1) * np.log1p(np.square(x / PRIOR_SIZE).sum(axis=1))


def _laplace(view, motion, mode, unit, inflation):
    """Covariance in units of the stage; the prior's where the data say nothing."""
    step = 1e-4

    def predicted(x):
        return x[:, -1:] * unit[-1] * view.response(motion, x[:, :-1] * unit[:-1])

    k = len(mode)
    moved = np.concatenate([mode + step * np.eye(k), mode - step * np.eye(k)])
    out = predicted(moved)
    slopes = np.nan_to_num((out[:k] - out[k:]) / (2 * step))
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
