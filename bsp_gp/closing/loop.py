"""Closing the loop: propose, fit, compare, decide, until nothing is missing or can be named."""

from __future__ import annotations

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
    base = Row(
        0, "base", "", "", found.status, log_evidence(found, hypothesis), 0.0, found.chisqr,
        found.n_free,
    )  # fmt: skip
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
    table = HypothesisTable(tuple(rows), p_value).with_probabilities()
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
    every = [(f.name, p) for f in families for p in f.proposals]
    every.sort(key=lambda pair: -pair[1].promise)
    top = every[0][1].promise if every else 0.0
    chosen, per_family = [], {}
    for name, proposal in every:
        is_near = proposal.promise > top - criteria.fitted_nats
        is_first = name not in per_family and proposal.promise > 0
        if (is_near or is_first) and len(chosen) < criteria.most_fits:
            chosen.append((name, proposal))
            per_family[name] = True
    offset = None
    for name, proposal in chosen:
        says(f"fitting {proposal.text}")
        new = fit(proposal.hypothesis, dataset, starts=proposal.starts, bounds=proposal.bounds)
        number = len(rows)
        fits[number], hypotheses[number] = new, proposal.hypothesis
        rows.append(
            Row(
                number, proposal.code, proposal.text, name, new.status,
                log_evidence(new, proposal.hypothesis),
                proposal.log_prior, new.chisqr, new.n_free, held_out_gain(base, new),
                ties=proposal.ties,
            )
        )  # fmt: skip
        if not new.is_failed:
            gap = rows[-1].log_evidence + proposal.log_prior - proposal.promise
            offset = gap if offset is None else max(offset, gap)
    fitted = {row.text for row in rows}
    if offset is not None:
        _add_near(families, rows, fitted, base, offset)


def _add_near(families, rows, fitted, base, offset):
    """Rows of what was scored and not fitted, told in the terms of those that were."""
    for family in families:
        for near in family.near:
            if near.text not in fitted:
                rows.append(
                    Row(
                        len(rows), near.code, near.text, family.name, "scored",
                        offset + 0.5 * near.gain, near.log_prior, base.chisqr - near.gain,
                        base.n_free + 1, HeldOut(),
                    )
                )  # fmt: skip
