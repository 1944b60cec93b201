"""A declared term with a power of distance or speed that is not quite right.

Each scalar factor of a declared term that changes with the motion is given a further power: the
term is multiplied by (x / x0)^n, x0 being a typical value in these data, and n is fitted. At n = 0
it is the declared term. A strength that is a declared number is held as it is at x0; freed beside n
it makes another rival, which can be reported and, like every change of a declared number, not be
adopted. An exponent is a rival of every new term: 2.0000001574 in the law of gravity once explained
what is left of Mercury's motion (Hall 1894).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.language.formula import Call, Constant, Number, factors
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.naming import fresh_name
from bsp_gp.physics.force import ForceLaw, Term

__all__ = ["changed_exponents", "exponent_attempts"]

PRIOR_NATS = 3.0
"""Complexity of a changed exponent: as likely beforehand as the simplest laws of a grammar."""
WITH_NUMBER = "it also changes the number of a declared term, which is declared as fixed"
MIN_SPREAD = 1e-3
"""Relative spread of a quantity below which its power cannot be seen."""


def exponent_attempts(observation, model, p_values=None):
    """The model with one exponent of a declared term free, for each of them.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    p_values : dict of str to float, optional
        By the text of what is raised to the power, where that was tested by itself.

    Returns
    -------
    list of Attempt
        Of the kind "declared_term_change".
    """
    out = []
    for index, term in enumerate(model.law.terms):
        if term.is_declared:
            for base, power in _powers(term.formula):
                for with_number in (False,) if term.formula.constants else (False, True):
                    attempt = _attempt(observation, model, index, base, power, with_number)
                    if attempt is not None:
                        p = (p_values or {}).get(to_text(base), float("nan"))
                        out.append(replace(attempt, p_value=p))
    return out


def changed_exponents(observation, law):
    """What a small change of each exponent adds to the declared terms: (text of base, Term).

    The derivative of a term by its exponent, at a typical value: the term times log(x / x0).
    """
    for term in law.terms:
        if term.is_declared:
            for base, _ in _powers(term.formula):
                typical = _typical(observation, law, term, base)
                if typical is not None:
                    ratio = Call("div", base, Number(typical, base.type.unit))
                    yield to_text(base), Term(
                        Call("mul", Call("log", ratio), term.formula), term.kind
                    )


def _powers(formula):
    """Factors of a formula that change with the motion, and their powers."""
    found = {}
    for sign, parts in zip((1, -1), factors(formula), strict=True):
        for part in parts:
            base, power = _base(part, sign)
            is_scalar = part.type.shape == "scalar" and not part.constants
            if is_scalar and any(not property_of(name) for name in base.inputs):
                found[base] = found.get(base, 0) + power
    return [(base, power) for base, power in found.items() if _is_positive(base)]


def _base(part, power):
    while isinstance(part, Call):
        if part.operator == "square":
            power, part = 2 * power, part.args[0]
        elif part.operator == "inverse":
            power, part = -power, part.args[0]
        elif part.operator == "pow" and isinstance(part.args[1], Number):
            power, part = power * part.args[1].value, part.args[0]
        else:
            break
    return part, power


def _is_positive(base):
    return isinstance(base, Call) and base.operator in ("norm", "abs")


def _attempt(observation, model, index, base, power, with_number):
    law, term = model.law, model.law.terms[index]
    typical = _typical(observation, law, term, base)
    if typical is None:
        return None
    name, scale = fresh_name(law, "n"), fresh_name(law, "s")
    typical = Number(typical, base.type.unit, f"{typical:.3g} [{base.type.unit}]")
    factor = Call("pow", Call("div", base, typical), Constant(name))
    start = {name: 0.0}
    if with_number:
        factor, start[scale] = Call("mul", Constant(scale), factor), 1.0
    freed = replace(term, formula=Call("mul", factor, term.formula))
    terms = (*law.terms[:index], freed, *law.terms[index + 1 :])
    new = ForceLaw(terms, {**law.constants, **start})
    try:
        fit = observation.fit_beyond(new, model.fit, sign_bounds(observation, new))
    except EvaluationError:
        return None
    if not np.isfinite(fit.chisqr):
        return None
    k = [n for n, _ in fit.parameters].index(name)
    return Attempt(
        fit.law, fit, PRIOR_NATS,
        f"exponent of {to_text(base)} in a declared term: {power:g} {fit.values[k]:+.3g} ± "
        f"{fit.intervals[k]:.1g}" + (", and its number" if with_number else ""),
        to_text(freed.formula), to_latex(freed.formula), "declared_term_change",
        share=float(1 - fit.chisqr / model.fit.chisqr) if model.fit.chisqr > 0 else 0.0,
        replaces=(f"the declared {to_text(term.formula)}",), freed=tuple(start),
        redoes_declared=with_number, reason=WITH_NUMBER if with_number else "",
    )  # fmt: skip


def _typical(observation, law, term, base):
    """Typical value of a factor where the term acts, to three digits; None if it hardly varies."""
    regression = observation.train_regression
    ratios = []
    with_base = Term(Call("mul", base, term.formula), term.kind, True)
    for batch in regression.batches:
        plain, more = (
            np.linalg.norm(regression.predict(batch, ForceLaw((t,), law.constants)), axis=-1)
            for t in (term, with_base)
        )
        acts = (plain > 0) & batch.valid.any(axis=-1)
        ratios.append(more[acts] / plain[acts])
    ratios = np.concatenate(ratios)
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    if not len(ratios) or np.ptp(np.log(ratios)) < MIN_SPREAD:
        return None
    return float(f"{np.median(ratios):.3g}")
