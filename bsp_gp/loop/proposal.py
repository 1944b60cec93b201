"""What proposers answer: causes that may be missing, and how much chance alone would show."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bsp_gp.errors import EvaluationError, FitError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.formula import Call, rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.physics.force import ForceLaw, split_linear

FAULTS = (EvaluationError, FitError, np.linalg.LinAlgError, FloatingPointError)
"""By which one cause cannot be fitted, and others may."""
NEW = 2
"""How much a term of a series adds that some textbook has: a power of a coordinate, or what acts
on one side of a place; that of one which none has is greater."""
UNIFORM = frozenset(("e_x", "e_y", "e_z", "up", "down", "m_i"))
"""What a uniform push is made of."""
PATIENT = 5
"""Times the usual effort that a fit may take which is not given up so soon."""


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
    formulas : tuple of Formula
        Of a law: the terms that are added.
    ties : tuple of Formula or str
        What would be the same on these data.
    n_dims : int
        Of the space of `formulas`.
    kind : str
        One of `KINDS`.
    volume : float, nats
        Logarithm of the part of its inner constants' range that the data leave.
    is_wide : bool
        Whether other forms are special cases of it: it is wider than they, and no other form.
    judged : Hypothesis or None
        By which it is judged, if not by itself alone: beside forces that know no physics, where
        more may be missing than one cause explains.
    error : float, m
        That of rows as their neighbours tell it, by which a misfit is judged; 0: as it is fitted.
    patience : int
        Times the usual effort for which its fit may go on, if that does not do.
    is_sole : bool
        Whether nothing else is asked for where it leaves no misfit, as it is judged.
    is_afresh : bool
        Whether it leads tracks so far from those of the fit that it extends that its fit begins
        at the data.
    path : object or None
        Where its bodies go by `starts`, as `fit` takes it.
    has_other_starts : bool
        Whether others of its family are the same from another start, and are all tried.
    is_first : bool
        Whether it is fitted before all others, and nothing else is asked for in its round where it
        takes off most of what is left: how motion is seen comes before what moves it.
    is_last : bool
        Whether it says all of the tracks: nothing is asked for beside it.
    is_alike : bool
        Whether no track like these tells it from a cause of another kind that leaves as little,
        whatever fewer numbers make likelier: who goes round evenly is held by a rod, or drawn.
    is_usual : bool
        Whether it is of laws of textbooks, though not of those that a grammar names as such: of a
        spring about a rest point that is fitted.
    news : dict of Formula to int
        Of terms of a series, how much each adds to what is known of textbooks.
    after : Proposal or None
        From whose fit its own begins, in the place of the fit that both extend: that of a larger
        sum, or of a part of this one.
    instead : Proposal or None
        What is fitted in its place where its own fit does not end.
    """

    code: str
    text: str
    hypothesis: Hypothesis
    log_prior: float
    gain: float
    rank: int = 1
    starts: dict = field(default_factory=dict)
    bounds: dict = field(default_factory=dict)
    formulas: tuple = ()
    ties: tuple = ()
    n_dims: int = 2
    kind: str = "force"
    volume: float = 0.0
    is_wide: bool = False
    judged: object = None
    is_sole: bool = False
    error: float = 0.0
    patience: int = 1
    is_afresh: bool = False
    path: object = None
    has_other_starts: bool = False
    is_first: bool = False
    is_last: bool = False
    is_alike: bool = False
    is_usual: bool = False
    news: dict = field(default_factory=dict)
    after: object = None
    instead: object = None

    @property
    def is_series(self):
        """Whether it is a series that may stand for a force of any form."""
        news = [self.news.get(formula, 0) for formula in self.formulas]
        return max(news, default=0) > NEW or sum(news) > 2 * NEW

    @property
    def n_laws(self):
        """Laws that it adds; components of one spin are one."""
        own = [split_linear(formula)[1] for formula in self.formulas]
        turning = sum(map(is_turning, own))
        return len(own) - max(turning - 1, 0)

    @cached_property
    def key(self):
        """Its identity: laws that are equal up to algebra have one."""
        if not self.formulas:
            return self.code, self.text
        return self.code, *sorted(canonical_key(f, self.n_dims) for f in self.formulas)

    @property
    def lead(self):
        """The first of its formulas as text, its numbers unnamed; what it is, where it has none."""
        if not self.formulas:
            return self.key
        first = self.formulas[0]
        return to_text(rename_constants(first, dict.fromkeys(first.constants, "c")))

    @property
    def texts_of_ties(self):
        """The ties as texts, without those that are this law or each other written anew."""
        known = {} if len(self.formulas) != 1 else {self.key[1]: None}
        for tie in self.ties:
            key = tie if isinstance(tie, str) else canonical_key(tie, self.n_dims)
            known.setdefault(key, tie if isinstance(tie, str) else to_text(tie))
        return tuple(text for text in known.values() if text is not None)

    @property
    def promise(self):
        """Log posterior beside the law as it is, nats, up to what all proposals share."""
        return 0.5 * self.gain + self.log_prior + self.volume

    def fitted(self, base, dataset, *, criteria, bounds=None, deadline=None):
        """Its fit, from the tracks of the fit that it extends.

        Parameters
        ----------
        base : Fit
        bounds : dict, optional
            Of the constants of what is declared.
        deadline : float, optional
        """
        if self.after is not None:
            own = {"criteria": criteria, "bounds": bounds, "deadline": deadline}
            base = self.after.fitted(base, dataset, **own)
            return replace(self, after=None).fitted(base, dataset, **own)
        known = {
            "starts": self.starts, "bounds": {**self.hypothesis.own(bounds), **self.bounds},
            "deadline": deadline,
        }  # fmt: skip
        near = None if self.is_afresh else base
        found = fit(
            self.hypothesis, dataset, near=near, path=self.path, effort=criteria.effort, **known
        )
        patience = max(self.patience, PATIENT if walls_of(self.hypothesis.law) else 1)
        if patience > 1 and found.status == "unconverged":  # on from where it was left
            effort = patience * criteria.effort
            if np.isfinite(found.values).all():
                known["starts"] = found.starts
            found = fit(self.hypothesis, dataset, near=found, effort=effort, **known)
        return found


@dataclass(frozen=True, eq=False)
class Family:
    """What one proposer found.

    Attributes
    ----------
    proposals : tuple of Proposal
        The likeliest first.
    gain, rank : float, int
        The greatest gain of all that was tried, and its free numbers.
    null : ndarray, shape (B,)
        The greatest gains on simulated noise.
    is_continuum : bool
        Whether what was tried runs through a continuum.
    is_control : bool
        Whether all of it is fitted whatever it promises: what others must be better than.
    n_controls : int
        How many of its first proposals are fitted so, where not all are.
    is_partial : bool
        Whether the time was up before all was tried.
    is_led : bool
        Whether it says nothing of whether anything is missing, since it can stand for any force, a
        slow error among them; what it has is fitted where others say so.
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
    is_partial: bool = False
    is_led: bool = False
    n_controls: int = 0

    @property
    def controls(self):
        """What is fitted whatever it promises, tuple of Proposal."""
        return self.proposals[: None if self.is_control else self.n_controls]


def both_of(first, second):
    """Two causes as one; the second was proposed beside the first."""
    return replace(
        second, text=f"{first.text} + {second.text}", log_prior=first.log_prior + second.log_prior,
        gain=first.gain + second.gain, rank=first.rank + second.rank, ties=(),
        formulas=(*first.formulas, *second.formulas), volume=first.volume + second.volume,
        bounds={**first.bounds, **second.bounds}, is_wide=first.is_wide or second.is_wide,
        patience=max(first.patience, second.patience),
    )  # fmt: skip


def continued(hypothesis, found):
    """The hypothesis with its constants where a fit found them."""
    parts = []
    for part in hypothesis.parts:
        if isinstance(part, Forces):
            known = {**part.law.constants, **found.law.constants}
            known = {name: known[name] for name in part.law.names}
            law = replace(part.law, constants=known)
            part = replace(part, law=law, paper_steps=found.paper_steps)
        elif part.kind != "noise" and part.parameters:
            part = part.at(found.law.constants)
            part = part.off_bounds() if part.kind == "world" else part
        parts.append(part)
    return Hypothesis(tuple(parts))


def is_turning(formula):
    """Whether a term acts across the velocity about an axis, and nothing else is in it."""
    return isinstance(formula, Call) and formula.operator == "cross"


def with_term(hypothesis, term, constants):
    """The hypothesis with a force more."""
    return hypothesis + Forces(ForceLaw((term,), constants), None)


def with_term_at(hypothesis, index, formula, constants):
    """The hypothesis with one of its terms, counted over all parts, in another form."""
    parts, seen = [], 0
    for part in hypothesis.parts:
        if isinstance(part, Forces):
            terms, known = list(part.law.terms), part.law.constants
            if seen <= index < seen + len(terms):
                terms[index - seen] = replace(terms[index - seen], formula=formula)
                law = replace(part.law, terms=tuple(terms), constants={**known, **constants})
                known = {name: value for name, value in law.constants.items() if name in law.names}
                part = replace(part, law=replace(law, constants=known))
            seen += len(terms)
        parts.append(part)
    return Hypothesis(tuple(parts))


def without_term(hypothesis, formula):
    """The hypothesis without a term, or without the cause of which it is one.

    None where it has none such, or no other force.
    """
    for k, part in enumerate(hypothesis.parts):
        terms = part.law.terms if isinstance(part, Forces) else ()
        at = [i for i, term in enumerate(terms) if term.formula == formula]
        if at:
            is_more = len(terms) > 1 and not part.is_one_cause
            less = [replace(part, law=part.law.without(at[0]))] if is_more else []
            parts = (*hypothesis.parts[:k], *less, *hypothesis.parts[k + 1 :])
            has_forces = any(isinstance(part, Forces) for part in parts)
            return Hypothesis(parts) if has_forces else None
    return None
