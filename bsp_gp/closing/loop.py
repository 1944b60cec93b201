"""Closing the loop: propose, fit, compare, decide, until nothing is missing or can be named."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.closing.criteria import Criteria
from bsp_gp.closing.decide import decide
from bsp_gp.closing.evidence import log_evidence
from bsp_gp.closing.proposal import continued
from bsp_gp.closing.table import HeldOut, HypothesisTable, Row, held_out_gain
from bsp_gp.closing.view import View, selected
from bsp_gp.fitting.fit import fit
from bsp_gp.language.render import to_text

__all__ = ["Round", "run_rounds"]


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    number : int
    entering : Fit
    table : HypothesisTable
    decision : Decision
    fits : dict of int to Fit
        By the id of the row.
    hypotheses : dict of int to Hypothesis
    families : tuple of Family
    """

    number: int
    entering: object
    table: HypothesisTable
    decision: object
    fits: dict
    hypotheses: dict
    families: tuple
    seconds: float = 0.0

    @property
    def after(self):
        """The fit to go on with."""
        if self.decision.is_adopted:
            return self.fits[self.decision.best.id]
        return self.entering


def run_rounds(hypothesis, dataset, proposers, *, rng, criteria=None, max_rounds=5, progress=None):
    """Rounds up to the first that adopts nothing.

    Parameters
    ----------
    hypothesis : Hypothesis
        What is declared.
    dataset : Dataset
        Training scenes.
    proposers : sequence
        With ``propose(view) -> Family``.
    rng : numpy.random.Generator
    criteria : Criteria, optional
    max_rounds : int
    progress : callable, optional

    Returns
    -------
    list of Round
    """
    criteria = criteria or Criteria()
    says = progress or (lambda text: None)
    says("fitting the declared model")
    found = fit(hypothesis, dataset)
    rounds = []
    for number, stream in enumerate(rng.spawn(max_rounds), 1):
        done = _round(number, hypothesis, found, dataset, proposers, stream, criteria, says)
        rounds.append(done)
        if not done.decision.is_adopted:
            break
        found = done.after
        hypothesis = done.hypotheses[done.decision.best.id]
    return rounds


def _round(number, hypothesis, found, dataset, proposers, rng, criteria, says):
    started = time.monotonic()
    base = Row(0, "base", "", "", found.status, log_evidence(found, hypothesis), 0.0, found.chisqr, found.n_free)
    fits, hypotheses, families, rows = {0: found}, {0: hypothesis}, [], [base]
    p_value = np.nan
    if base.is_fit:
        view = View(found, continued(hypothesis, found), dataset, rng)
        for proposer in proposers:
            says(f"round {number}: {proposer.name}")
            families.append(proposer.propose(view))
        p_value = _p_of_all(families, view)
        if p_value <= criteria.alpha:
            _fit_best(families, rows, fits, hypotheses, found, dataset, criteria, says)
    table = HypothesisTable(tuple(rows), p_value).without_repeats().with_probabilities()
    return Round(
        number, found, table, decide(table, criteria), fits, hypotheses, tuple(families),
        time.monotonic() - started,
    )  # fmt: skip


def _p_of_all(families, view):
    """Chance that noise alone shows as much in any family."""
    chances = [
        selected(f.gain, f.rank, f.null, view.noise_dof) for f in families if f.n_tried or f.rank
    ]
    if not chances:
        return 1.0
    return float(-np.expm1(len(chances) * np.log1p(-min(min(chances), 1 - 1e-16))))


def _fit_best(families, rows, fits, hypotheses, base, dataset, criteria, says):
    """Fit the likeliest proposals of all families, and put them and what lies near into rows."""
    every = sorted(
        ((f.name, p) for f in families for p in f.proposals), key=lambda pair: -pair[1].promise
    )
    offset = -math.inf
    for name, proposal in _chosen(every, criteria):
        says(f"fitting {proposal.text}")
        new = fit(proposal.hypothesis, dataset, starts=proposal.starts, bounds=proposal.bounds)
        number = len(rows)
        fits[number], hypotheses[number] = new, proposal.hypothesis
        evidence = log_evidence(new, proposal.hypothesis)
        rows.append(
            _row(
                number, name, proposal, new.status, evidence, new.chisqr, new.n_free,
                held_out_gain(base, new),
            )
        )  # fmt: skip
        offset = max(offset, evidence + proposal.log_prior - proposal.promise)
    if not math.isfinite(offset):
        return
    # What was scored only is told in the terms of what was fitted.
    least = max(row.log_posterior for row in rows[1:]) - offset - criteria.class_nats
    known = {row.key for row in rows}
    for name, proposal in every:
        if proposal.promise < least:
            break
        if proposal.key not in known:
            known.add(proposal.key)
            rows.append(
                _row(
                    len(rows), name, proposal, "scored", offset + 0.5 * proposal.gain,
                    base.chisqr - proposal.gain, base.n_free + proposal.rank, HeldOut(),
                )
            )  # fmt: skip


def _chosen(every, criteria):
    """The proposals that are fitted: those near the best, and the first of every family."""
    top = every[0][1].promise if every else 0.0
    chosen, families, keys = [], set(), set()
    for name, proposal in every:
        if len(chosen) == criteria.most_fits:
            break
        is_near = proposal.promise > top - criteria.fitted_nats
        is_first = name not in families and proposal.promise > 0
        if (is_near or is_first) and (proposal.key not in keys or proposal.starts):
            chosen.append((name, proposal))
            families.add(name)
            keys.add(proposal.key)
    return chosen


def _row(number, source, proposal, status, evidence, chisqr, n_free, held_out):
    return Row(
        number, proposal.code, proposal.text, source, status, evidence, proposal.log_prior, chisqr,
        n_free, held_out, key=proposal.key, ties=tuple(map(to_text, proposal.ties)),
    )  # fmt: skip
