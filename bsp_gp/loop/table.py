"""The table of everything that was fitted: one row per hypothesis."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

SAME_MINIMUM = 1e-3
"""Nats within which two descents have come to one minimum."""


@dataclass(frozen=True)
class HeldOut:
    """What scenes that were left out say of a hypothesis beside the one that it extends.

    Attributes
    ----------
    gain, se : float, nats
        Of the predictive log-scores, summed over the scenes, and its standard error.
    promised : float, nats
        The gain that the hypothesis itself foresees.
    """

    gain: float = math.nan
    se: float = math.nan
    promised: float = math.nan


@dataclass(frozen=True)
class Row:
    """A hypothesis that was fitted, or one that was scored only.

    Attributes
    ----------
    code : str
        What it adds, of `CAUSES`; "base" for the model that enters the round.
    text : str
        What it adds.
    source : str
        Proposer.
    status : str
        Of its fit; "idle" where a part that it adds does nothing in it, "less" where it explains
        less than what it extends, or is a series that leaves more than noise; "scored", or
        "linearised" of what nobody lists, beside a row that was fitted.
    log_evidence, log_prior : float, nats
    log_likelihood : float, nats
        Of the tracks, at the best constants and noise.
    kind : str
        What kind of thing it adds, of `KINDS`.
    p_value : float
        Selection counted.
    key : tuple
        Identity of what it adds.
    ties : tuple of str
    is_wide : bool
        Whether other forms are special cases of it.
    n_pushes, n_terms : int
        Uniform pushes, as weight is one, among the forces that it adds, and these.
    n_kicks : int
        That it adds.
    is_of_pairs : bool
        Whether it adds a force between bodies.
    is_alike : bool
        Whether other kinds of causes that leave as little are as good, see `Proposal`.
    is_echo : bool
        Whether it is a sum with a push in it whose period is that of the swing itself.
    left : float, m
        Root mean square of what its fit leaves; nan where that is not known.
    """

    id: int
    code: str
    text: str
    source: str
    status: str
    log_evidence: float
    log_prior: float
    log_likelihood: float
    n_free: int
    kind: str = "force"
    held_out: HeldOut = field(default_factory=HeldOut)
    p_value: float = math.nan
    probability: float = math.nan
    key: tuple = ()
    ties: tuple = ()
    is_wide: bool = False
    n_pushes: int = 0
    n_terms: int = 0
    n_kicks: int = 0
    is_of_pairs: bool = False
    is_alike: bool = False
    is_echo: bool = False
    left: float = math.nan

    @property
    def log_posterior(self):
        """Up to what all rows share, nats."""
        return self.log_evidence + self.log_prior

    @property
    def is_fit(self):
        return self.status in ("converged", "at_bound", "refuted")


@dataclass(frozen=True)
class HypothesisTable:
    """All rows of a round, the base first.

    Attributes
    ----------
    p_value : float
        Chance that noise alone shows as much in the best of everything that was tried.
    noise_p : float
        Chance that noise as it was assumed leaves as odd an error, see `View.noise_chance`.
    forced : float
        Nats by which a force that knows no physics is likelier than the memory of the noise.
    swamped : float
        Size of noise with a memory, in that of the motion itself.
    """

    rows: tuple[Row, ...]
    p_value: float
    noise_p: float = 1.0
    forced: float = -math.inf
    swamped: float = 0.0

    @property
    def base(self):
        return self.rows[0]

    @property
    def candidates(self):
        """Rows that add something and can be compared, the likeliest first, of equals the simplest.

        Two ways to say one motion differ by rounding alone, which must not choose between them.
        """
        able = [r for r in self.rows[1:] if r.is_fit and np.isfinite(r.log_posterior)]
        return sorted(able, key=lambda r: (-round(r.log_posterior, 6), r.n_free, len(r.text)))

    def without_repeats(self):
        """The same without rows that are another descent of one hypothesis."""
        best = {}
        for row in self.rows:
            if row.key not in best or _height(row) > _height(best[row.key]):
                best[row.key] = row
        return replace(self, rows=tuple(r for r in self.rows if best[r.key] is r))

    def beside(self, best, unknown, criteria):
        """The same with what nobody lists beside one of its rows, and probabilities."""
        first, codes = max(row.id for row in self.rows) + 1, [one.code for one in unknown]
        rows = tuple(
            replace(
                best, id=first + k, code=one.code, text=one.text, source="unknown",
                status="linearised", log_evidence=best.log_evidence + one.log_odds,
                log_prior=best.log_prior - criteria.unknown_nats - math.log(codes.count(one.code)),
                held_out=HeldOut(), key=(one.code, one.text), ties=(), is_wide=True,
            )
            for k, one in enumerate(unknown)
        )  # fmt: skip
        return replace(self, rows=(*self.rows, *rows)).with_probabilities()

    def with_probabilities(self):
        """The same with probabilities over all rows that can be compared."""
        able = ("scored", "linearised")
        heights = np.array([r.log_posterior if r.is_fit or r.status in able else -np.inf
                            for r in self.rows])  # fmt: skip
        heights = np.where(np.isfinite(heights), heights, -np.inf)
        if not np.isfinite(heights).any():
            return self
        weights = np.exp(heights - heights.max())
        weights = weights / weights.sum()
        rows = tuple(
            replace(row, probability=float(w)) for row, w in zip(self.rows, weights, strict=True)
        )
        return replace(self, rows=rows)


def _height(row):
    return (row.is_fit, row.log_posterior)


def part_of(best, rows, criteria):
    """A sum of laws, or the least part of it among some rows that is about as likely.

    A term that makes a sum hardly likelier is not worth saying: rounds after it ask for it again.
    """
    parts = [
        row for row in rows
        if row.code == best.code and 0 < row.n_terms < best.n_terms and set(row.key) < set(best.key)
        and best.log_posterior - row.log_posterior < criteria.tie_nats
    ]  # fmt: skip
    return min(parts, key=lambda row: (row.n_terms, -row.log_posterior), default=best)


def held_out_gain(base, other):
    """Predictive log-scores of two fits, scene by scene left out.

    The scores follow in closed form from what each scene says of the constants (its compressed
    residual and derivatives): those of the others, and the residual of the scene under them, with
    its own initial states free.

    Returns
    -------
    HeldOut
        nan where there are fewer than two scenes, where numbers that no other scene tells differ,
        or rows are left out, of which nothing is foreseen.
    """
    names = np.unique(base.row_scenes)
    if len(names) < 2 or base.is_failed or other.is_failed:
        return HeldOut()
    if _count_alone(base, names) != _count_alone(other, names) or other.n_rows < base.n_rows:
        return HeldOut()
    if bool(base.noise.correlated) == bool(other.noise.correlated):
        # What the base leaves of tracks that the other made, under the noise of the other.
        scale = _level(other) / _level(base)
        gains = _scores(other, names, 1.0) - _scores(base, names, scale)
        promised = 0.5 * max(float(base.chisqr) / scale**2 - float(other.chisqr), 0.0)
    else:  # one has the memory of the noise in place of a cause: each under its own
        one, two = (_scores(f, names, 1.0) + _heights(f, names) for f in (base, other))
        gains = two - one
        promised = max(other.log_likelihood - base.log_likelihood, 0.0)
    if not np.isfinite(gains).all():
        return HeldOut()
    se = float(np.sqrt(len(gains)) * gains.std(ddof=1))
    return HeldOut(float(gains.sum()), se, promised)


def _heights(fit, names):
    """What the noise itself adds to the log-scores of scenes."""
    log_dets = fit.noise.whitener(fit.channels).log_dets
    of_scene = np.array(fit.channels.scene_names)[fit.channels.scene]
    return np.array([-0.5 * log_dets[of_scene == name].sum() for name in names])


def _level(fit):
    levels = np.array(fit.noise.levels)
    return float(np.sqrt(np.nanmean(np.square(levels))))


def _scores(fit, names, scale):
    """Log-scores of every scene from the others, noise levels divided by `scale`."""
    jacobian, rows = fit.jacobian / scale, fit.rows / scale
    information = jacobian.T @ jacobian
    out = []
    for name in names:
        mine = fit.row_scenes == name
        alone = _is_alone(fit, mine)
        j, r = jacobian[mine], rows[mine]
        shared = information[np.ix_(~alone, ~alone)] - j[:, ~alone].T @ j[:, ~alone]
        q, _ = np.linalg.qr(j[:, alone])  # what nothing foresees is fitted to the scene itself
        j = j[:, ~alone]
        j, r = j - q @ (q.T @ j), r - q @ (q.T @ r)
        others = np.linalg.pinv(shared, hermitian=True)
        left = r + j @ (others @ (j.T @ r))
        covariance = np.eye(len(r)) + j @ others @ j.T
        _, size = np.linalg.slogdet(covariance)
        out.append(-0.5 * left @ np.linalg.solve(covariance, left) - 0.5 * size)
    return np.array(out)


def _is_alone(fit, mine):
    """Numbers that some rows tell and no others, shape (k,)."""
    return fit.jacobian[mine].any(axis=0) & ~fit.jacobian[~mine].any(axis=0)


def _count_alone(fit, names):
    """How many numbers only one scene tells."""
    return sum(int(_is_alone(fit, fit.row_scenes == name).sum()) for name in names)
