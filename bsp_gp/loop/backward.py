"""Backward removal: what was adopted early and what came later has made superfluous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.language.render import to_text
from bsp_gp.loop.clock import Clock, TimeIsUp
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.evidence import log_evidence, significance
from bsp_gp.loop.proposal import FAULTS, continued, without_term
from bsp_gp.physics.force import split_linear

__all__ = ["Pruned", "prune"]

NEEDED = 50.0
"""Standard errors from zero of a strength that cannot be spared: a thousand nats."""


@dataclass(frozen=True, eq=False)
class Pruned:
    """What is left of what the rounds adopted.

    Attributes
    ----------
    fit : Fit
    hypothesis : Hypothesis
    removed : frozenset of int
        Numbers of the rounds whose cause was taken back.
    displaced : tuple of str
        Declared terms in whose place an adopted one stands: the declared model asked for them, the
        final one does not.
    n_fits : int
    is_complete : bool
        False where the time was up before everything was looked at.
    """

    fit: object
    hypothesis: object
    removed: frozenset = frozenset()
    displaced: tuple = ()
    n_fits: int = 0
    is_complete: bool = True


def prune(rounds, dataset, *, criteria=None, bounds=None, clock=None, progress=None):
    """Refit without each cause that was adopted before the last one.

    What the evidence does not ask for is dropped, the least of all first, until nothing is.

    Parameters
    ----------
    rounds : sequence of Round
    dataset : Dataset
        Training scenes.
    criteria : Criteria, optional
    bounds : dict, optional
        Of the constants of what is declared.
    clock : Clock, optional
    progress : callable, optional

    Returns
    -------
    Pruned
    """
    run = _Pruning(rounds, dataset, criteria or Criteria(), bounds, clock or Clock(), progress)
    try:
        run.take_back()
        run.displace()
    except TimeIsUp:
        run.is_complete = False
    return Pruned(
        run.found, run.hypothesis, frozenset(run.removed), tuple(run.displaced), run.n_fits,
        run.is_complete,
    )  # fmt: skip


class _Pruning:
    """The hypothesis, and what was removed from it, while it shrinks."""

    def __init__(self, rounds, dataset, criteria, bounds, clock, progress):
        self.dataset, self.criteria, self.bounds, self.clock = dataset, criteria, bounds, clock
        self.says = progress or (lambda text: None)
        self.first = rounds[0].entering
        self.adopted = [done for done in rounds if done.decision.is_adopted]
        self.found, self.hypothesis = rounds[-1].after, rounds[-1].continuing
        self.removed, self.displaced, self.n_fits, self.is_complete = set(), [], 0, True

    def take_back(self):
        """Remove causes of earlier rounds while the evidence does not ask for them."""
        while True:
            weakest, least = None, 0.0
            for done in self.adopted[:-1]:
                known = done.number in self.removed
                smaller = None if known else _without(self.hypothesis, done)
                best = done.decision.best
                fitted = smaller and self.fitted(smaller, f"without {best.text}")
                if fitted and fitted[2] + best.log_prior <= least:
                    weakest, least = (done.number, *fitted[:2]), fitted[2] + best.log_prior
            if weakest is None:
                return
            number, self.found, self.hypothesis = weakest
            self.removed.add(number)

    def displace(self):
        """Remove declared terms in whose place adopted ones stand."""
        kept = [done for done in self.adopted if done.number not in self.removed]
        for formula in [t.formula for t in self.first.law.terms] if kept else ():
            is_asked = self._asked_for(formula) and not self._is_needed(formula)
            smaller = is_asked and without_term(self.hypothesis, formula)
            fitted = smaller and self.fitted(smaller, f"without {to_text(formula)}")
            if fitted and fitted[2] <= 0.0:
                self.found, self.hypothesis, _ = fitted
                self.displaced.append(to_text(formula))

    def _asked_for(self, formula):
        """Whether the declared model has numbers of its own in a term, one of them not zero."""
        least = stats.norm.isf(self.criteria.alpha / 2)
        others = {c for t in self.first.law.terms if t.formula != formula
                  for c in t.formula.constants}  # fmt: skip
        numbers = zip(self.first.parameters, self.first.values, self.first.errors, strict=True)
        return any(
            abs(value) > least * error
            for (name, _), value, error in numbers
            if name in formula.constants and name not in others
        )

    def _is_needed(self, formula):
        """Whether the last fit has the strength of a term so surely that nothing stands for it.

        What could take its place would leave it open; a fit without it would only lose its way.
        """
        name, _ = split_linear(formula)
        own = significance(self.found, name)
        return len(own) > 0 and bool(np.all(own > NEEDED))

    def fitted(self, smaller, text):
        """A smaller hypothesis fitted: (fit, hypothesis, evidence that is lost), or None."""
        if self.clock.is_over:
            raise TimeIsUp
        self.says(text)
        smaller = continued(smaller, self.found)
        self.n_fits += 1
        try:
            other = fit(
                smaller, self.dataset, bounds=smaller.own(self.bounds), deadline=self.clock.left,
                near=self.found, effort=self.criteria.effort,
            )  # fmt: skip
        except FAULTS:  # it cannot be done without
            return None
        if self.clock.is_over:  # it may have been cut short
            raise TimeIsUp
        whole, theirs = (
            log_evidence(f, h, self.criteria)
            for f, h in ((self.found, self.hypothesis), (other, smaller))
        )
        return other, smaller, whole - theirs


def _without(hypothesis, done):
    """A later hypothesis with what a round changed put back; None where that is there no more."""
    before = done.hypotheses[0].parts
    known = [_identity(part) for part in before]
    after = [_identity(part) for part in done.continuing.parts]
    added = [key for key in after if key not in known]
    parts = [part for part in hypothesis.parts if _identity(part) not in added]
    if not added or len(parts) != len(hypothesis.parts) - len(added):
        return None
    lost = [part for part, key in zip(before, known, strict=True) if key not in after]
    return Hypothesis((*lost, *parts))


def _identity(part):
    """What a part is, whatever values its numbers have."""
    if isinstance(part, Forces):
        return type(part), tuple(term.formula for term in part.law.terms)
    return type(part), tuple(p.name for p in part.parameters)
