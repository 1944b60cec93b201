"""What may leave the same residual as a missing force, and is none between visible bodies.

A hidden body changes who is there; a wrong length scale, a tilted camera or a slow clock changes
what was measured. Each is a rival of the found law: it is fitted to the same tracks by the same
likelihood, has a BIC of its own, and stands in the same table.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import log

__all__ = ["HIDDEN_BODY", "MEASUREMENT", "Explanation", "not_fitted"]

HIDDEN_BODY = "hidden_body"
MEASUREMENT = "measurement"


@dataclass(frozen=True, eq=False)
class Explanation:
    """A law fitted under another account of who is there, or of how it was measured.

    Attributes
    ----------
    kind : str
        `HIDDEN_BODY` or `MEASUREMENT`.
    name : str
        In a few words, e.g. "an unseen body", "a length scale that is off".
    text, latex : str
        What is assumed, with its fitted numbers.
    observation : Observation
        Under which `fit` was made: bodies added, or positions and times corrected. Going on with
        it is what adopting the explanation means.
    fit : Fit
        Its `chisqr` compares with that of the model on the positions as measured.
    n_free : int
        Free numbers of the explanation, beside those of the law.
    constants : tuple of ConstantEstimate
        Those numbers, with 90 % intervals and units.
    reason : str
        Why it cannot be adopted; "" if it can.
    is_open : bool
        Whether that is because the data leave its numbers open: it may hold all the same.
    equivalents : tuple of str
        Other explanations that these data cannot tell from it.
    separated_by : str
        Which further measurement would.
    details : dict
        For the report, JSON-able: posterior draws of a place and a mass, and the like. A
        `p_value` with the selection among rivals counted is weighed with that of the round.
    view : callable or None
        ``view(scene, track) -> Scene``: any measured scene as the explanation has it, from
        which is told what a further recording would show. `track` are the true positions of the
        receivers, shape (T, R, d).
    """

    kind: str
    name: str
    text: str
    latex: str
    observation: object
    fit: object
    n_free: int
    constants: tuple = ()
    reason: str = ""
    equivalents: tuple = ()
    separated_by: str = ""
    details: dict = field(default_factory=dict)
    view: object = None
    is_open: bool = False

    def bic(self, n_effective):
        """BIC with the explanation's own numbers counted, comparable to `Fit.bic`."""
        return self.fit.bic(n_effective) + self.n_free * log(max(n_effective, 2.0))


def not_fitted(observation, model, kind, name, reason, n_free=1):
    """An explanation that came to grief, listed with the reason."""
    latex = rf"\text{{{name}}}"
    return Explanation(kind, name, name, latex, observation, model.fit, n_free, reason=reason)
