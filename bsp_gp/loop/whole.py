"""Promises of laws, read off whole tracks where moments of pieces lose what is slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.tangent import law_columns
from bsp_gp.language.formula import rename_constants
from bsp_gp.loop.proposal import FAULTS
from bsp_gp.physics.force import Term, split_linear

__all__ = ["on_whole_tracks"]

MOST = 24
"""Forces that are looked at."""


def on_whole_tracks(view, families):
    """Families in which the likeliest laws promise what whole tracks show of them.

    Moments of pieces do not know where one piece leads the next: what a force does slowly, over
    whole orbits, is free for each of them. A column of the whole track is dearer, and knows. Noise
    has as many chances there as among the moments, by whose gains on noise a family is judged.

    Parameters
    ----------
    view : View
    families : sequence of Family

    Returns
    -------
    list of Family
    """
    if not view.response.is_cut or view.fit.is_failed:
        return list(families)
    every = sorted((p for f in families for p in f.proposals), key=lambda p: -p.promise)
    try:
        gains = {**_of_added(view, every), **_of_changed(view, every)}
    except FAULTS:
        return list(families)
    out = []
    for family in families:
        own = [replace(p, gain=max(gains.get(id(p), 0.0), p.gain)) for p in family.proposals]
        of_rank = [gains.get(id(p), 0.0) for p in family.proposals if p.rank == family.rank]
        out.append(
            replace(
                family, proposals=tuple(sorted(own, key=lambda p: -p.promise)),
                gain=max(family.gain, *of_rank) if of_rank else family.gain,
            )
        )  # fmt: skip
    return out


def _of_added(view, proposals):
    """Gains of chi-squared on whole tracks by the likeliest proposals that add forces."""
    numbers, chosen, law = {}, [], view.fit.law
    for proposal in proposals:
        forces = proposal.formulas if all(map(_is_linear, proposal.formulas)) else ()
        if forces and len({*numbers, *forces}) <= MOST:
            chosen.append(proposal)
            numbers |= {force: numbers.get(force, len(numbers)) for force in forces}
    names = []
    for force, number in numbers.items():
        (old,) = force.constants
        names.append(f"{old}_{number}")
        law = law.plus(Term(rename_constants(force, {old: names[-1]})), {names[-1]: 0.0})
    columns = law_columns(view.fit, law, names) if names else ()
    return {
        id(p): _gain(view, columns[[numbers[force] for force in p.formulas]]) for p in chosen
    }


def _of_changed(view, proposals):
    """The same by proposals that change a declared term."""
    out = {}
    for proposal in [p for p in proposals if p.at_zero][:MOST]:
        zero = dict.fromkeys(proposal.at_zero, 0.0)
        law = proposal.hypothesis.law.with_constants({**view.fit.law.constants, **zero})
        out[id(proposal)] = _gain(view, law_columns(view.fit, law, proposal.at_zero))
    return out


def _is_linear(formula):
    """Whether a law is proportional to its only constant."""
    name, rest = split_linear(formula)
    return name is not None and not rest.constants


def _gain(view, columns):
    """Gain of chi-squared of columns of whole tracks; 0 where they cannot be told."""
    return view.tangent.score(columns).statistic if np.isfinite(columns).all() else 0.0
