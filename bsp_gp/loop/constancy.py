"""Are the constants of a law constant, and which powers of speed and distance do the data allow.

A law is a law only if its strength is the same everywhere that it was looked at (LOOP §5.3). Of
every term that was found, the term times smooth functions of one variable is a set of columns; the
term times the logarithm of speed or distance tells the power with its interval.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import (
    Call,
    Constant,
    Formula,
    Number,
    factors,
    rename_constants,
)
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposers.exponents import base_of, is_size, power_of, typical_value
from bsp_gp.loop.trace import moments_of, smooth_variables
from bsp_gp.loop.view import selected
from bsp_gp.physics.force import ForceLaw, Term

BASES = {"field": ("norm(v_i)",), "pair": ("norm(p_i - p_j)",)}
"""Whose power is told of every term of a kind, beside those that it names."""
Z_90 = 1.6448536269514722


@dataclass(frozen=True)
class Exponent:
    """The power of a quantity in a term.

    Attributes
    ----------
    stated, value, error : float
        As the law has it; as the data have it, to first order, with its standard error.
    low, high : float
        90 %.
    """

    term: Formula
    of: Formula
    stated: float
    value: float
    error: float

    @property
    def low(self):
        return self.value - Z_90 * self.error

    @property
    def high(self):
        return self.value + Z_90 * self.error

    def is_as_stated(self, criteria):
        """Whether the data have the power that is stated, and none next to it."""
        least = np.sqrt(criteria.separation)
        away = abs(self.value - self.stated)
        is_it = away <= max(least * self.error, criteria.constant_within)
        return bool(is_it and least * self.error <= criteria.power_step)


@dataclass(frozen=True)
class Varies:
    """A variable in which the strength of a term changes.

    Attributes
    ----------
    p_value : float
        All terms and variables counted.
    share : float
        Size of the change in that of the term, as the tracks show both.
    """

    term: Formula
    variable: str
    p_value: float
    share: float


@dataclass(frozen=True)
class Constancy:
    """Answers for all terms that were found.

    Attributes
    ----------
    varies : tuple of Varies
        The most striking first, whatever its p-value.
    unknown : tuple of Unknown
        What nobody lists, beside the law.
    bound : HiddenBound or None
        How much may still be hidden beside it.
    """

    exponents: tuple[Exponent, ...] = ()
    varies: tuple[Varies, ...] = ()
    unknown: tuple = ()
    bound: object = None

    def of(self, formulas):
        """The answers for some terms."""
        return Constancy(
            tuple(e for e in self.exponents if e.term in formulas),
            tuple(v for v in self.varies if v.term in formulas),
            tuple(u for u in self.unknown if u.term is None or u.term in formulas),
        )


def constancy(view):
    """The constancy of the terms of a View that nobody declared."""
    law = view.fit.law
    found = [term for term in law.terms if not term.is_declared]
    exponents, asked = [], []
    for term in found:
        for base in powers_in(term):
            columns = logarithms(view, term, base)
            if columns is None:
                continue
            score = view.score_forces(columns[:, :1])
            if score.rank and np.isfinite(score.errors[0]):
                stated = power_of(base, term.formula)
                value = stated + float(score.amplitudes[0])
                error = float(score.errors[0])
                exponents.append(Exponent(term.formula, base, stated, value, error))
            asked.append((term, to_text(base), columns))
        asked += [(term, name, c) for name, c in varied(view, term)]
    return Constancy(tuple(exponents), _judged(view, asked))


def _judged(view, asked):
    """Which variables matter, the greatest gain on noise taken over all of them."""
    null, found = np.zeros(view.moment_draws.shape[1]), []
    for term, variable, columns in asked:
        score = view.score_forces(columns)
        if score.rank:
            null = np.maximum(null, as_pair(view.null_forces(columns), score.rank))
            gain = float(as_pair(score.statistic, score.rank))
            whole = np.linalg.norm(_moments(view, term, term.formula))
            share = float(np.linalg.norm(columns @ score.amplitudes) / (whole or np.inf))
            found.append((gain, term.formula, variable, share))
    found.sort(key=lambda entry: -entry[0])
    return tuple(
        Varies(formula, variable, selected(gain, 2, null, view.noise_dof), share)
        for gain, formula, variable, share in found
    )


def _moments(view, term, formula):
    """Moments of a formula of the kind of a term, with its constants, (n,)."""
    known = {name: view.fit.law.constants[name] for name in term.formula.constants}
    return view.response.moments_of(ForceLaw((Term(formula, term.kind),), known))


def powers_in(term):
    """Quantities whose power in a term is asked for."""
    types = {name: STATE_INPUTS[name] for name in ("p_i", "p_j", "v_i", "v_j")}
    wanted = [parse_formula(text, types) for text in BASES[term.kind]]
    parts = [p for side in factors(term.formula) for p in side]
    named = [base_of(p) for p in parts if not p.constants or _is_of_centre(p)]
    return list(dict.fromkeys((*wanted, *filter(is_size, named))))


def _is_of_centre(part):
    """Whether a factor is a power, not a fitted one, of the distance to a place that is fitted."""
    base = base_of(part)
    is_norm = isinstance(base, Call) and base.operator == "norm"
    return is_norm and "p_i" in base.inputs and len(part.constants) == len(base.constants)


def powers_beside(base, term, own, rivals):
    """Powers of a quantity in forms that differ in nothing else from a sum, as floats.

    Parameters
    ----------
    term : Formula
        Of the sum `own`, tuple of Formula, whose power is meant.
    rivals : iterable of tuple of Formula
        Other sums. Masses and names of constants make no difference.
    """
    others = sorted(shape_of(f) for f in own if f != term)
    for formulas in rivals:
        for k, formula in enumerate(formulas):
            beside = sorted(shape_of(f) for f in (*formulas[:k], *formulas[k + 1 :]))
            if beside == others and shape_of(formula, base) == shape_of(term, base):
                yield power_of(base, formula)


def shape_of(formula, base=None):
    """Factors of a term as texts, without its mass, and without powers of a quantity, if any.

    A vector is its size times a direction; names of constants make no difference.
    """
    vector = base.args[0] if isinstance(base, Call) and base.operator == "norm" else None
    out = []
    for side in factors(formula):
        parts = []
        for part in side:
            found = base_of(part)
            if found == vector:
                found = part = Call("normalize", found)
            is_plain = isinstance(part, Constant) or found.inputs == frozenset({"m_i"})
            if not is_plain and (base is None or found != base):
                parts.append(to_text(rename_constants(part, dict.fromkeys(part.constants, "c"))))
        out.append(tuple(sorted(parts)))
    return tuple(out)


def logarithms(view, term, base):
    """Moments of a term times the logarithm of a quantity and its square, (n, 2)."""
    typical = typical_value(view, term, base)
    if typical is None:
        return None
    ratio = Call("log", Call("div", base, Number(typical, base.type.unit)))
    once = Call("mul", ratio, term.formula)
    both = (once, Call("mul", ratio, once))
    try:
        return np.stack([_moments(view, term, formula) for formula in both], axis=1)
    except EvaluationError:  # the quantity is exactly zero somewhere, as where friction holds
        return None


def varied(view, term, **settings):
    """Moments of a term times functions of `smooth_variables`, one by one: (name, (n, f))."""
    known = {name: view.fit.law.constants[name] for name in term.formula.constants}
    law = ForceLaw((term,), known)
    regression = view.response.regression
    values = [regression.predict(batch, law) for batch in regression.batches]
    for name, functions in smooth_variables(view, **settings):
        pushes = [
            np.nan_to_num(value)[..., None, :] * f[..., None]
            for value, f in zip(values, functions, strict=True)
        ]
        yield name, moments_of(view, pushes)
