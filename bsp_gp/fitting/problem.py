"""What the least-squares driver is asked and what it answers: problems, settings, minima."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np


@dataclass(frozen=True, eq=False)
class Linearised:
    """A problem linearised at a point; a problem may add fields that its `move` needs.

    Attributes
    ----------
    residual : ndarray, shape (n,)
        Whitened, what the local unknowns can explain projected out.
    jacobian : ndarray, shape (n, k)
        Of the residual with respect to the shared unknowns, projected in the same way.
    rests : ndarray, shape (B,)
        Sums of squares of what was projected out, block by block of local unknowns: chi-squared at
        the point is ``residual @ residual + rest``, and whole local steps gain `rest`, their sum.
    block : ndarray of int, shape (m,)
        Of which block the first rows of the residual are; those beyond are of none.
    rounding : float
        Fall of chi-squared that rounding of the local unknowns alone foresees.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    rests: np.ndarray = field(default_factory=lambda: np.zeros(0))
    block: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    rounding: float = 0.0

    @property
    def rest(self):
        return float(self.rests.sum())

    @property
    def chisqr(self):
        return float(self.residual @ self.residual) + self.rest

    def own(self, reins):
        """What shortened steps of blocks do: a part s takes off 2 s a - s^2 b; a and b, (B,)."""
        return reins * self.rests, np.square(reins) * self.rests

    @property
    def is_finite(self):
        return all(np.isfinite(a).all() for a in (self.residual, self.jacobian, self.rests))

    def by_block(self, residual):
        """Sum of squares of the rows of every block, (B,)."""
        squares = np.square(residual[: len(self.block)])
        return np.bincount(self.block, squares, minlength=len(self.rests))


class Problem(Protocol):
    """What `minimise` needs to know; points are opaque to it."""

    def values(self, point) -> np.ndarray:
        """Shared unknowns of a point, shape (k,)."""

    def linearise(self, point) -> Linearised | None:
        """The linearisation there; None if the model is not finite.

        It may tell instead that some blocks are not: with a rest that is nan.
        """

    def move(self, point, linearised, values, share, reins) -> Any:
        """The point with these values of the shared unknowns.

        Local unknowns follow them by the linearisation, and make `share` (0 to 1) of the step that
        they would make if the shared unknowns stayed: the Gauss-Newton step, or of blocks with
        `reins` (B,) below 1 one that is so much shorter; with 0 they stay as they are.
        """


@dataclass(frozen=True)
class Settings:
    """When to stop.

    Attributes
    ----------
    absolute : float
        Fall of chi-squared that is nothing, in variances of the noise; 0 if the noise is unknown.
    relative : float
        The same as a part of chi-squared.
    rank : float
        Singular values below this part of the largest (columns of unit length) determine nothing.
    last_steps : int
        At most so many steps that gain nothing visible are made at the end, until the fall is 1e-4
        of that again: digits that no longer depend on the start.
    hopeless : float
        Chi-squared above which a descent is given up that has been linearised a dozen times.
    """

    absolute: float = 1e-4
    relative: float = 1e-12
    max_linearised: int = 1000
    rank: float = 1e-10
    last_steps: int = 30
    hopeless: float = np.inf


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where `minimise` ended.

    Attributes
    ----------
    values : ndarray, shape (k,)
    linearised : Linearised or None
        None where the start is not finite.
    status : str
        "converged", "at_bound" (converged, with an unknown at a bound), "unconverged", "nonfinite".
    code : str
        Why it ended: "fall" (nothing to be gained), "flat" (nothing to be gained, since an unknown
        has no influence at all there, or unknowns can no longer be told apart that could before:
        a plateau), "stalled", "limit", "stopped", "start".
    gradient : float
        Largest cosine between the residual and the column of an unknown that is free to move.
    fall : float
        Of chi-squared, as a whole Gauss-Newton step foresees it.
    undetermined : ndarray of bool, shape (k,)
        Unknowns that the data do not determine, alone or in combination with others.
    held : ndarray of bool, shape (B,)
        Blocks that were left as they are, since no step of theirs, however short, does what the
        linearisation foresees.
    """

    point: Any
    values: np.ndarray
    linearised: Linearised | None
    status: str
    code: str
    gradient: float
    fall: float
    undetermined: np.ndarray
    n_linearised: int
    n_starts: int = 1
    n_agree: int = 1
    held: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def chisqr(self):
        return np.inf if self.linearised is None else self.linearised.chisqr

    @property
    def kept_chisqr(self):
        """Chi-squared without that of the blocks that are held."""
        if self.linearised is None or not self.held.any():
            return self.chisqr
        by_block = self.linearised.by_block(self.residual) + self.linearised.rests
        beyond = self.residual[len(self.linearised.block) :]
        return float(by_block[~self.held].sum() + beyond @ beyond)

    @property
    def residual(self):
        return self.linearised.residual

    @property
    def jacobian(self):
        return self.linearised.jacobian
