"""Terms split into properties and motion: ``force = constant * properties * motion``.

Nearly every law is such a product. Then the motion is evaluated once, and a new draw of the
properties costs a few numbers instead of all instants.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.language.formula import Call, Number, evaluate
from bsp_gp.language.inputs import property_of
from bsp_gp.physics.force import split_linear

ONE = Number(1.0)
SHAPES = frozenset(("s_i", "s_j"))


@dataclass(frozen=True)
class Separated:
    """A term as a product.

    Attributes
    ----------
    constant : str or None
        Name of the linear constant; None where the term has none.
    properties : Formula
        A scalar of properties alone.
    motion : Formula
        A vector without the unknown properties.
    needs_mass : bool
        Whether the product is a force, to be divided by the receiver's mass.
    """

    constant: str | None
    properties: object
    motion: object
    needs_mass: bool


def separate(term, columns):
    """Split a term by the columns of the latents; None if it is no product.

    Parameters
    ----------
    columns : collection of str
        Properties that are unknown.
    """
    formula = term.acceleration_formula
    name, rest = split_linear(formula)
    if rest.constants:
        return None
    parts = split_formula(rest, frozenset(columns))
    if parts is None or parts[1].type.shape != "vector":
        return None
    return Separated(name, *parts, term.needs_mass)


def depends_on(formula, columns):
    """Whether a formula names one of these properties; shapes have radii."""
    if "radius" in columns and not SHAPES.isdisjoint(formula.inputs):
        return True
    return any(p is not None and p[0] in columns for p in map(property_of, formula.inputs))


def split_formula(formula, columns):
    """(properties, motion) with formula = properties * motion, or None."""
    if not depends_on(formula, columns):
        return ONE, formula
    if all(property_of(name) is not None for name in formula.inputs):
        if formula.type.shape != "scalar":
            return None
        return formula, ONE
    if not isinstance(formula, Call):
        return None
    parts = [split_formula(arg, columns) for arg in formula.args if arg is not None]
    if any(part is None for part in parts):
        return None
    rule = _RULES.get(formula.operator)
    return rule and rule(formula, parts)


def _times(a, b):
    return b if a is ONE else a if b is ONE else Call("mul", a, b)


def _mul(formula, parts):
    (pa, ma), (pb, mb) = parts
    return _times(pa, pb), _times(ma, mb)


def _div(formula, parts):
    (pa, ma), (pb, mb) = parts
    over = formula.operator
    if over != "div" and pb is not ONE and mb is not ONE:
        return None  # the guard acts on the whole divisor
    return (
        pa if pb is ONE else Call(over, pa, pb),
        ma if mb is ONE else Call(over, ma, mb),
    )


def _neg(formula, parts):
    ((p, m),) = parts
    return p, Call("neg", m)


def _square(formula, parts):
    ((p, m),) = parts
    return _squared(p), _squared(m)


def _squared(part):
    return part if part is ONE else Call("square", part)


_RULES = {"mul": _mul, "div": _div, "div_guarded": _div, "neg": _neg, "square": _square}


def coefficient(separated, lookup):
    """Value of the property factor, per unit of the constant, as an acceleration's factor.

    Parameters
    ----------
    lookup : callable
        As `PropertyTable.inputs` gives it.

    Returns
    -------
    ndarray, shape (W or 1, S, R, J or 1); 0 where a property of the receiver is unknown.
    """
    names = separated.properties.inputs
    value = np.asarray(evaluate(separated.properties, {name: lookup(name) for name in names}))
    if value.ndim == 0:
        value = value.reshape(1, 1, 1, 1)
    if separated.needs_mass:
        mass = lookup("m_i")
        with np.errstate(divide="ignore", invalid="ignore"):
            value = value / np.where(np.isnan(mass), np.inf, mass)
    for name in names:
        if name.endswith("_i"):
            own = lookup(name)
            if np.isnan(own).any():
                value = np.where(np.isnan(own), 0.0, value)
    return value
