"""Backward removal: what was adopted early and what came later has made superfluous."""

from __future__ import annotations

from dataclasses import dataclass

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposal import FAULTS, continued

__all__ = ["Pruned", "prune"]


@dataclass(frozen=True, eq=False)
class Pruned:
    """What is left of what the rounds adopted.

    Attributes
    ----------
    fit : Fit
    hypothesis : Hypothesis
    removed : frozenset of int
        Numbers of the rounds whose cause was taken back.
    n_fits : int
    is_complete : bool
        False where the time was up before everything was looked at.
    """

    fit: object
    hypothesis: object
    removed: frozenset = frozenset()
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
    clock, criteria = clock or Clock(), criteria or Criteria()
    found, hypothesis = rounds[-1].after, rounds[-1].continuing
    adopted = [done for done in rounds if done.decision.is_adopted]
    removed, n_fits = set(), 0
    while True:
        weakest, least = None, 0.0
        whole = log_evidence(found, hypothesis, criteria)
        for done in adopted[:-1]:
            smaller = None if done.number in removed else _without(hypothesis, done)
            if smaller is None:
                continue
            if clock.is_over:
                return Pruned(found, hypothesis, frozenset(removed), n_fits, False)
            if progress is not None:
                progress(f"without {done.decision.best.text}")
            smaller = continued(smaller, found)
            n_fits += 1
            try:
                other = fit(
                    smaller, dataset, bounds=smaller.own(bounds), deadline=clock.left, near=found,
                    effort=criteria.effort,
                )
            except FAULTS:  # it cannot be done without
                continue
            if clock.is_over:  # it may have been cut short
                return Pruned(found, hypothesis, frozenset(removed), n_fits, False)
            loss = whole - log_evidence(other, smaller, criteria) + done.decision.best.log_prior
            if loss <= least:
                weakest, least = (done.number, other, smaller), loss
        if weakest is None:
            return Pruned(found, hypothesis, frozenset(removed), n_fits)
        removed.add(weakest[0])
        found, hypothesis = weakest[1:]


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
