"""What proposers answer: causes that may be missing, and how much chance alone would show."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import ForceLaw

__all__ = ["Family", "Proposal", "continued", "with_term"]


@dataclass(frozen=True, eq=False)
class Proposal:
    """One cause that may be missing.

    Attributes
    ----------
    code : str
        One of `CAUSES`.
    text : str
        What it adds, as text; the identity of the cause in a report.
    hypothesis : Hypothesis
        With the cause in it.
    log_prior : float, nats
    gain : float
        Chi-squared that it promises to take away.
    rank : int
        Free numbers that it adds.
    starts, bounds : dict
        For the fit.
    formula : Formula or None
        Of a law: the term that is added.
    ties : tuple of Formula or str
        What would be the same on these data.
    n_dims : int
        Of the space of `formula`.
    """

    code: str
    text: str
    hypothesis: Hypothesis
    log_prior: float
    gain: float
    rank: int = 1
    starts: dict = field(default_factory=dict)
    bounds: dict = field(default_factory=dict)
    formula: object = None
    ties: tuple = ()
    n_dims: int = 2

    @cached_property
    def key(self):
        """Its identity: laws that are equal up to algebra have one."""
        if self.formula is None:
            return self.code, self.text
        return self.code, canonical_key(self.formula, self.n_dims)

    @property
    def texts_of_ties(self):
        """The ties as texts."""
        return tuple(tie if isinstance(tie, str) else to_text(tie) for tie in self.ties)

    @property
    def promise(self):
        """Log posterior beside the law as it is, nats, up to what all proposals share."""
        return 0.5 * self.gain + self.log_prior


@dataclass(frozen=True, eq=False)
class Family:
    """What one proposer found.

    Attributes
    ----------
    name : str
    proposals : tuple of Proposal
        The likeliest first.
    gain, rank : float, int
        The greatest gain of all that was tried, and its free numbers.
    null : ndarray, shape (B,)
        The greatest gains on simulated noise.
    certificate : str
    is_continuum : bool
        Whether what was tried runs through a continuum.
    is_control : bool
        Whether its best is fitted whatever it promises: what others must be better than.
    n_tried : int
    """

    name: str
    proposals: tuple = ()
    gain: float = 0.0
    rank: int = 0
    null: np.ndarray = field(default_factory=lambda: np.zeros(0))
    certificate: str = ""
    is_control: bool = False
    is_continuum: bool = False
    n_tried: int = 0


def continued(hypothesis, fit):
    """The hypothesis with its constants where a fit found them."""
    parts = []
    for part in hypothesis.parts:
        if isinstance(part, Forces):
            known = {name: fit.law.constants[name] for name in part.law.names}
            law = replace(part.law, constants=known)
            part = replace(part, law=law, paper_steps=fit.paper_steps)
        elif part.kind == "instrument" and part.parameters:
            part = part.at(fit.law.constants)
        parts.append(part)
    return Hypothesis(tuple(parts))


def with_term(hypothesis, term, constants):
    """The hypothesis with a force more."""
    return hypothesis + Forces(ForceLaw((term,), constants), None)
