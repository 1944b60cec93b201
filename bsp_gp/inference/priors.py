"""Priors of unknown properties: made of `[latent.*]` declarations, or written in code.

Every prior has a *coordinate* in which it is sampled and fitted: the property itself, or its
logarithm for a log-uniform prior (in which that prior is flat). scipy.stats does the mathematics.
"""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import SettingsError

KINDS = ("uniform", "log_uniform", "truncated_normal", "discrete")
_ALIASES = {"loguniform": "log_uniform", "log-uniform": "log_uniform", "set": "discrete",
            "truncnorm": "truncated_normal", "truncated normal": "truncated_normal",
            "truncated-normal": "truncated_normal", "normal": "truncated_normal",
            "choice": "discrete"}  # fmt: skip


@dataclass(frozen=True)
class Prior:
    """Prior distribution of one unknown number, SI.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    low, high : float
        Support; may be infinite for a truncated normal.
    mean, sd : float
        Of the normal before truncation.
    values : tuple of float
        The equally likely values of a discrete prior.

    Examples
    --------
    >>> Prior("uniform", 0.02, 9.0).log_prob([1.0, 10.0]).round(3).tolist()
    [-2.195, -inf]
    """

    kind: str = "uniform"
    low: float = math.nan
    high: float = math.nan
    mean: float = math.nan
    sd: float = math.nan
    values: tuple[float, ...] = ()

    def __post_init__(self):
        kind = _ALIASES.get(self.kind, self.kind)
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        if kind not in KINDS:
            raise SettingsError(f"prior must be one of {', '.join(KINDS)}, got {self.kind!r}")
        if kind != "truncated_normal":  # one nan for all, so that equal priors compare equal
            object.__setattr__(self, "mean", math.nan)
            object.__setattr__(self, "sd", math.nan)
        if kind == "discrete":
            if not self.values or not np.isfinite(self.values).all():
                raise SettingsError("a discrete prior needs a list of finite values")
            if len(set(self.values)) < len(self.values):
                raise SettingsError(f"values of a discrete prior must differ, got {self.values}")
            object.__setattr__(self, "low", min(self.values))
            object.__setattr__(self, "high", max(self.values))
            return
        if kind == "truncated_normal":
            self._check_normal()
        elif not (math.isfinite(self.low) and math.isfinite(self.high)):
            raise SettingsError(f"a {kind} prior needs low and high, got {self.low}, {self.high}")
        if not self.low < self.high:
            raise SettingsError(f"low must be below high in a prior, got {self.low}, {self.high}")
        if kind == "log_uniform" and self.low <= 0:
            raise SettingsError(f"a log-uniform prior needs low above 0, got {self.low:g}")

    def _check_normal(self):
        if not (math.isfinite(self.mean) and self.sd > 0 and math.isfinite(self.sd)):
            raise SettingsError(
                f"a truncated normal needs mean and a positive sd, got {self.mean}, {self.sd}"
            )
        for name, end in (("low", -math.inf), ("high", math.inf)):
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, end)

    @property
    def is_discrete(self):
        return self.kind == "discrete"

    def distribution(self):
        """The frozen scipy.stats distribution (continuous priors)."""
        from scipy import stats  # a slow import

        if self.kind == "uniform":
            return stats.uniform(self.low, self.high - self.low)
        if self.kind == "log_uniform":
            return stats.loguniform(self.low, self.high)
        if self.kind == "truncated_normal":
            a, b = (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd
            return stats.truncnorm(a, b, loc=self.mean, scale=self.sd)
        raise SettingsError("a discrete prior has no density")

    def sample(self, size, *, rng):
        """Independent draws, an array of the given size."""
        if self.is_discrete:
            return rng.choice(np.array(self.values), size=size)
        return np.asarray(self.distribution().ppf(rng.random(size)))

    def log_prob(self, x):
        """Log density (log probability of a discrete value); -inf outside."""
        x = np.asarray(x, dtype=float)
        if self.is_discrete:
            inside = np.isin(x, self.values)
            return np.where(inside, -math.log(len(self.values)), -np.inf)
        if self.kind == "uniform":  # the hot path of samplers
            inside = (x >= self.low) & (x <= self.high)
            return np.where(inside, -math.log(self.high - self.low), -np.inf)
        return np.asarray(self.distribution().logpdf(x))

    def cdf(self, x):
        """Cumulative probability."""
        if self.is_discrete:
            x = np.asarray(x, dtype=float)
            return np.mean(x[..., None] >= np.array(self.values), axis=-1)
        return np.asarray(self.distribution().cdf(x))

    def ppf(self, u):
        """Quantiles, the inverse of `cdf`."""
        if self.is_discrete:
            ordered = np.sort(self.values)
            index = np.ceil(np.asarray(u) * len(ordered)).astype(int) - 1
            return ordered[np.clip(index, 0, len(ordered) - 1)]
        return np.asarray(self.distribution().ppf(u))

    # --- the coordinate in which it is sampled and fitted ----------------------------------------

    @property
    def is_logarithmic(self):
        return self.kind == "log_uniform"

    def to_coordinate(self, x):
        """Property -> coordinate."""
        return np.log(x) if self.is_logarithmic else np.asarray(x, dtype=float)

    def from_coordinate(self, y):
        """Coordinate -> property."""
        return np.exp(y) if self.is_logarithmic else np.asarray(y, dtype=float)

    @property
    def bounds(self):
        """Support in the coordinate, (low, high)."""
        return float(self.to_coordinate(self.low)), float(self.to_coordinate(self.high))

    @property
    def pull(self):
        """(mean, sd) of the Gaussian in the coordinate that the prior is inside its bounds.

        sd is inf where the prior is flat in its coordinate.
        """
        return (self.mean, self.sd) if self.kind == "truncated_normal" else (0.0, math.inf)

    @property
    def spread(self):
        """Standard deviation of the prior in its coordinate: the scale of a natural step."""
        if self.is_discrete:
            return float(np.std(self.values)) or 1.0
        if self.kind == "truncated_normal":
            return float(self.distribution().std())
        low, high = self.bounds
        return (high - low) / math.sqrt(12)

    def text(self):
        """One short text, as in a table of priors."""
        if self.is_discrete:
            return "one of {" + ", ".join(f"{v:g}" for v in self.values) + "}"
        if self.kind == "truncated_normal":
            return f"N({self.mean:g}, {self.sd:g}) on [{self.low:g}, {self.high:g}]"
        name = "U" if self.kind == "uniform" else "log-U"
        return f"{name}({self.low:g}, {self.high:g})"


def prior_of(declaration):
    """The prior of a latent declaration.

    Parameters
    ----------
    declaration : LatentDeclaration
        Plain record of ``[latent.NAME]``, SI.

    Raises
    ------
    SettingsError
        If the declaration is no prior; the message names the latent.
    """
    kind = "discrete" if declaration.values else declaration.prior
    try:
        return Prior(
            kind, declaration.low, declaration.high, declaration.mean, declaration.sd,
            declaration.values,
        )  # fmt: skip
    except SettingsError as error:
        raise SettingsError(f"[latent.{declaration.name}]: {error}") from None
