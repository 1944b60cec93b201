"""Posteriors: named draws with weights, how far they can be trusted, and their tables."""

from dataclasses import dataclass, field
from html import escape

import numpy as np

from bsp_gp.errors import MissingDependencyError, SettingsError

INTERVAL = 0.9
"""Probability of the intervals in tables."""


MAX_ROWS = 7
"""Names whose values are told unasked."""


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """Draws of the latents (and constants, where they were sampled too) given the data.

    Attributes
    ----------
    names : tuple of str
    draws : ndarray, shape (S, k)
    weights : ndarray, shape (S,)
        Sum to one; they are applied once, and never by redrawing as well.
    log_prob : ndarray, shape (S,)
        Log likelihood + log prior of every draw, nats up to a constant.
    method : str
        "emcee", "enumeration", "importance", "emcee x enumeration", "prior" ...
    n_eff : ndarray, shape (k,)
        Effective sample size of every name.
    r_hat : ndarray, shape (k,)
        Split R-hat; nan where there is no chain.
    acceptance, autocorr_time : float
        Of the sampler; nan where there is none.
    converged : bool
    priors : tuple
        Prior of every name, None for constants.
    truth : ndarray, shape (k,)
        Recorded values, for scoring only.
    notes : tuple of str
        What a reader must know: no convergence, nothing learnt, weights collapsed.
    walkers : ndarray or None
        Last places of the sampler, to start the next one from.
    chain : ndarray or None, shape (steps, walkers, k)
        Kept where asked for.
    """

    names: tuple[str, ...]
    draws: np.ndarray
    weights: np.ndarray
    log_prob: np.ndarray
    method: str
    n_eff: np.ndarray
    r_hat: np.ndarray
    acceptance: float = np.nan
    autocorr_time: float = np.nan
    converged: bool = True
    priors: tuple = ()
    truth: np.ndarray = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    walkers: object = field(default=None, repr=False)
    chain: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        draws = np.array(self.draws, dtype=float)
        weights = np.array(self.weights, dtype=float)
        if draws.ndim != 2 or draws.shape != (len(weights), len(self.names)):
            raise SettingsError(
                f"a posterior of {len(self.names)} names needs draws (S, {len(self.names)}) and "
                f"weights (S,), got {draws.shape} and {weights.shape}"
            )
        draws.setflags(write=False)
        weights.setflags(write=False)
        object.__setattr__(self, "draws", draws)
        object.__setattr__(self, "weights", weights)
        if not len(self.truth):
            object.__setattr__(self, "truth", np.full(len(self.names), np.nan))
        if not self.priors:
            object.__setattr__(self, "priors", (None,) * len(self.names))

    def __repr__(self):
        rows = [f"  {name} = {mean:.4g} +- {sd:.2g}" for name, mean, sd in
                zip(self.names, self.mean, self.sd, strict=True)]  # fmt: skip
        if len(rows) > MAX_ROWS:
            rows = [*rows[:MAX_ROWS], f"  and {len(rows) - MAX_ROWS} more"]
        how = "converged" if self.converged else "not converged"
        head = f"Posterior by {self.method}: {len(self.draws)} draws, {how}"
        return "\n".join([head, *rows, f"  notes: {len(self.notes)}"])

    def _repr_html_(self):
        return f"<pre>{escape(repr(self))}</pre>"

    @property
    def mean(self):
        """Means, (k,)."""
        return self.weights @ self.draws

    @property
    def sd(self):
        """Standard deviations, (k,)."""
        return np.sqrt(self.weights @ np.square(self.draws - self.mean))

    def quantile(self, q):
        """Quantiles of every name, (k,)."""
        return np.array([weighted_quantile(c, self.weights, q) for c in self.draws.T])

    def interval(self, probability=INTERVAL):
        """Equal-tailed intervals, (k, 2)."""
        tail = (1 - probability) / 2
        return np.stack([self.quantile(tail), self.quantile(1 - tail)], axis=1)

    def correlation(self):
        """Correlation matrix, (k, k)."""
        gap = self.draws - self.mean
        covariance = (gap * self.weights[:, None]).T @ gap
        size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        size = np.where(size > 0, size, np.inf)
        out = covariance / np.outer(size, size)
        np.fill_diagonal(out, 1.0)
        return out

    def draw(self, n_draws, *, rng):
        """Equally weighted draws, (n_draws, k)."""
        index = rng.choice(len(self.weights), size=n_draws, p=self.weights)
        return self.draws[index]

    def thinned(self, n_draws, *, rng):
        """A few draws with weights for an expectation, without applying weights twice.

        Draws of equal weight are taken without, others with replacement in proportion to their
        weights; either way the result is equally weighted.

        Returns
        -------
        draws : ndarray, shape (n_draws, k)
        weights : ndarray, shape (n_draws,)
        """
        even = np.ptp(self.weights) <= 1e-12 and len(self.weights) >= n_draws
        index = rng.choice(
            len(self.weights), size=n_draws, replace=not even, p=None if even else self.weights
        )
        return self.draws[index], np.full(n_draws, 1 / n_draws)

    def summary(self):
        """Table of every name: mean, sd, 90 % interval, effective sample size, R-hat.

        Returns
        -------
        pandas.DataFrame
        """
        import pandas as pd

        low, high = self.interval().T
        return pd.DataFrame(
            {
                "mean": self.mean, "sd": self.sd, "low_5%": low, "high_95%": high,
                "ess": self.n_eff, "r_hat": self.r_hat,
                "prior": [p.text() if p is not None else "flat" for p in self.priors],
                "truth": self.truth,
            },
            index=pd.Index(self.names, name="name"),
        )  # fmt: skip

    def to_arviz(self):
        """An ArviZ DataTree with the group ``posterior`` (and ``sample_stats``).

        Weighted draws are passed on with their weights in ``sample_stats``.

        Raises
        ------
        MissingDependencyError
            If arviz-base is not installed.
        """
        try:
            from arviz_base import from_dict
        except ImportError as error:
            raise MissingDependencyError(
                "ArviZ export needs arviz-base: pip install 'bsp_gp[bayes]'"
            ) from error
        names = [name.replace("/", "|") for name in self.names]  # "/" is a path to xarray
        if self.chain is not None:
            posterior = {n: self.chain[:, :, k].T for k, n in enumerate(names)}
            return from_dict({"posterior": posterior})
        posterior = {n: self.draws[None, :, k] for k, n in enumerate(names)}
        stats = {"lp": self.log_prob[None], "weight": self.weights[None]}
        return from_dict({"posterior": posterior, "sample_stats": stats})

    def to_dict(self):
        """Plain numbers and texts, for JSON."""
        low, high = self.interval().T
        entries = [
            {
                "name": name, "mean": float(self.mean[k]), "sd": float(self.sd[k]),
                "low": float(low[k]), "high": float(high[k]), "n_eff": _plain(self.n_eff[k]),
                "r_hat": _plain(self.r_hat[k]), "truth": _plain(self.truth[k]),
                "prior": None if self.priors[k] is None else self.priors[k].text(),
            }
            for k, name in enumerate(self.names)
        ]  # fmt: skip
        return {
            "method": self.method,
            "n_draws": len(self.weights),
            "converged": bool(self.converged),
            "acceptance": _plain(self.acceptance),
            "autocorr_time": _plain(self.autocorr_time),
            "latents": entries,
            "notes": list(self.notes),
        }


def _plain(value):
    value = float(value)
    return value if np.isfinite(value) else None


def joined(parts, names, *, rng):
    """One posterior of independent ones, columns in the order of `names`.

    The longest posterior gives the number of draws; others are redrawn to it.

    Parameters
    ----------
    parts : sequence of Posterior
        Of independent blocks.
    """
    n_draws = max(len(part.weights) for part in parts)
    columns, log_prob = {}, np.zeros(n_draws)
    for part in parts:
        even = np.ptp(part.weights) <= 1e-12
        if even and len(part.weights) == n_draws:
            index = rng.permutation(n_draws)
        else:
            index = rng.choice(len(part.weights), size=n_draws, p=part.weights)
        log_prob = log_prob + part.log_prob[index]
        for k, name in enumerate(part.names):
            columns[name] = (part, k, part.draws[index, k])
    order = [columns[name] for name in names]
    methods = list(dict.fromkeys(part.method for part in parts))

    def each(attribute):
        return np.array([getattr(part, attribute)[k] for part, k, _ in order])

    with np.errstate(all="ignore"):
        acceptance = [p.acceptance for p in parts if np.isfinite(p.acceptance)]
        times = [p.autocorr_time for p in parts if np.isfinite(p.autocorr_time)]
    return Posterior(
        tuple(names), np.stack([draws for _, _, draws in order], axis=1),
        np.full(n_draws, 1 / n_draws), log_prob, ", ".join(methods), each("n_eff"), each("r_hat"),
        float(np.mean(acceptance)) if acceptance else np.nan,
        float(np.max(times)) if times else np.nan, all(part.converged for part in parts),
        tuple(part.priors[k] for part, k, _ in order), each("truth"),
        tuple(dict.fromkeys(note for part in parts for note in part.notes)),
        {part.names: part.walkers for part in parts},
    )  # fmt: skip


def effective_size(weights):
    """Kish's effective sample size of normalised weights: 1 / sum of squares."""
    weights = np.asarray(weights, dtype=float)
    return float(1 / np.square(weights / weights.sum()).sum())


def weights_of(log_weight):
    """Normalised weights of their logarithms; None where none is finite."""
    finite = np.isfinite(log_weight)
    if not finite.any():
        return None
    weights = np.where(finite, np.exp(log_weight - log_weight[finite].max()), 0.0)
    return weights / weights.sum()


def split_r_hat(chain):
    """Split R-hat of every parameter (Gelman et al. 2013, section 11.4).

    The walkers of an ensemble are pooled into groups, each of which counts as one chain, cut in
    halves: a single walker is too short to be one.

    Parameters
    ----------
    chain : ndarray, shape (steps, walkers, k)

    Returns
    -------
    ndarray, shape (k,)
        nan for fewer than four steps.
    """
    half = len(chain) // 2
    n_groups = min(4, chain.shape[1])
    if half < 2:
        return np.full(chain.shape[2], np.nan)
    each = chain.shape[1] // n_groups
    parts = [
        chain[start : start + half, g * each : (g + 1) * each].reshape(-1, chain.shape[2])
        for g in range(n_groups)
        for start in (0, half)
    ]
    n = half * each
    within = np.mean([part.var(axis=0, ddof=1) for part in parts], axis=0)
    between = np.var([part.mean(axis=0) for part in parts], axis=0, ddof=1)
    with np.errstate(all="ignore"):
        out = np.sqrt((n - 1) / n + between / within)
    return np.where(within > 0, out, 1.0)


def weighted_quantile(values, weights, q):
    """Quantile of weighted values, linear between the midpoints of their weights."""
    order = np.argsort(values, kind="stable")
    values, weights = np.asarray(values)[order], np.asarray(weights)[order]
    total = np.cumsum(weights)
    return float(np.interp(q * total[-1], total - 0.5 * weights, values))
