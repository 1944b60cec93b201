"""Other forms in the place of a proposal that was fitted: fewer terms, one strength, a limit."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.fitting.jackknife import jackknife_errors
from bsp_gp.fitting.law_fit import is_misfit
from bsp_gp.fitting.parts.contacts import Kick, kicks_text
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.loop.evidence import WEAK, significance
from bsp_gp.loop.proposal import without_term
from bsp_gp.physics.force import ForceLaw, Term, kind_of, split_linear


def without_weakest(proposal, found, criteria):
    """A sum of laws without its weakest term, from where its fit is; None if all are strong."""
    strengths = {}
    for formula in proposal.formulas:
        own = significance(found, split_linear(formula)[0])
        strengths[formula] = own[0] if len(own) == 1 and own[0] >= 0 else math.inf
    weakest = min(strengths, key=strengths.get)
    hypothesis = without_term(proposal.hypothesis, weakest)
    if hypothesis is None or not strengths[weakest] < WEAK:
        return None
    formulas = tuple(f for f in proposal.formulas if f != weakest)
    known = hypothesis.own(found.law.constants).items()
    return replace(
        proposal, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts={name: value for name, value in known if isinstance(value, float)},
        bounds=hypothesis.own(proposal.bounds), formulas=formulas, ties=(),
        rank=proposal.rank - 1, log_prior=min(proposal.log_prior + criteria.cause_nats, 0.0),
        patience=1, after=None,
    )  # fmt: skip


def led_by(form, proposal, found, criteria):
    """A sum of laws with another form in the place of its first, from where its own fit is."""
    first, *rest = proposal.formulas
    terms = tuple(Term(formula, kind_of(formula)) for formula in rest)
    known = {name: found.law.constants[name] for term in terms for name in term.formula.constants}
    hypothesis = form.hypothesis
    hypothesis = hypothesis + Forces(ForceLaw(terms, known)) if terms else hypothesis
    formulas = (*form.formulas, *rest)
    return replace(
        form, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts={**form.starts, **known}, bounds={**form.bounds, **hypothesis.own(proposal.bounds)},
        formulas=formulas, ties=(), gain=proposal.gain,
        rank=proposal.rank - len(first.constants) + len(form.formulas[0].constants),
        log_prior=form.log_prior - criteria.cause_nats * len(rest),
    )  # fmt: skip


def with_one_strength(proposal, base, found, criteria):
    """A law of a strength for each owner with one for all; None where it has none such."""
    names = {n: n.partition("[")[0] for f in proposal.formulas for n in f.constants}
    if all(old == new for old, new in names.items()):
        return None
    formulas = tuple(rename_constants(f, names) for f in proposal.formulas)
    values = {new: found.law.constants[old] for old, new in names.items()}
    values = {
        n: float(np.median(list(v.values()))) if isinstance(v, Mapping) else v
        for n, v in values.items()
    }  # fmt: skip
    law = ForceLaw(tuple(Term(formula, kind_of(formula)) for formula in formulas), values)
    return replace(
        proposal, code="law", text=" + ".join(map(to_text, formulas)),
        hypothesis=base + Forces(law, None), formulas=formulas, rank=len(values), ties=(),
        starts=values, log_prior=proposal.log_prior + criteria.cause_nats, is_wide=False,
    )  # fmt: skip


def in_place_of(source, proposal):
    """What is fitted in the place of a proposal whose fit does not end."""
    if proposal.instead is not None:
        return [proposal.instead]
    is_long = source == "inside" and len(proposal.formulas) > 2
    return [less for less in [_shorter(proposal)] if less is not None] if is_long else []


def _shorter(proposal):
    """A sum of laws without its last term, as it was proposed; None where that says all of it.

    A descent that came to no end says nothing of a sum that is part of it. Of laws without numbers
    inside sums of every size are fitted anyway.
    """
    hypothesis = without_term(proposal.hypothesis, proposal.formulas[-1])
    if hypothesis is None:
        return None
    formulas = proposal.formulas[:-1]
    return replace(
        proposal, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts=hypothesis.own(proposal.starts), bounds=hypothesis.own(proposal.bounds),
        formulas=formulas, ties=(), rank=proposal.rank - len(proposal.formulas[-1].constants),
    )  # fmt: skip


def without_open_kicks(proposal, found, base):
    """Several kicks without those that may be anywhere in their recording; None where none may.

    Of those that a hypothesis has beside its base. Where two others explain what it was proposed
    for, a kick has no size and no instant.
    """
    sizes = np.asarray(found.errors)
    if is_misfit(found):
        sizes = np.maximum(sizes, jackknife_errors(found)[0])
    errors = {name: error for (name, _), error in zip(found.parameters, sizes, strict=True)}
    before = {part.mark for part in base.parts if isinstance(part, Kick)}
    kicks = [part for part in proposal.hypothesis.parts
             if isinstance(part, Kick) and part.mark not in before]  # fmt: skip
    told = [kick for kick in kicks
            if errors.get(kick.instant, np.inf) < np.ptp(kick.span) / 2]  # fmt: skip
    if not told or len(told) == len(kicks):
        return None
    lost = {kick.mark for kick in kicks} - {kick.mark for kick in told}
    parts = tuple(p for p in proposal.hypothesis.parts
                  if not (isinstance(p, Kick) and p.mark in lost))  # fmt: skip
    text = kicks_text((k.entity, k.scene, found.law.constants[k.instant]) for k in told)
    share, hypothesis = len(told) / len(kicks), Hypothesis(parts)
    return replace(
        proposal, text=text, hypothesis=hypothesis, starts=hypothesis.own(found.starts),
        rank=round(share * proposal.rank), log_prior=share * proposal.log_prior,
    )  # fmt: skip
