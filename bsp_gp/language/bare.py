"""Numbers that were typed without a unit, where only one unit makes the law a force."""

from bsp_gp.language.formula import Call, Number, summands
from bsp_gp.units import DIMENSIONLESS

_FACTORS = ("mul", "neg", "div")


def bare_number(formula, unit):
    """The lone number without a unit that multiplies terms of another unit than this, or None.

    None also where there are several: who knows of which the unit was left out.
    """
    found = [n for term in summands(formula) if term.type.unit == unit for n in _numbers(term)]
    return found[0] if len(found) == 1 else None


def with_bare_unit(formula, number, unit):
    """The law with a unit for a number that had none: that very one, and no exponent like it."""
    if formula is number:
        return Number(number.value, unit, f"{number.text} [{unit}]")
    if not isinstance(formula, Call) or formula.operator not in ("add", "sub", *_FACTORS):
        return formula
    return Call(formula.operator, *(with_bare_unit(arg, number, unit) for arg in formula.args))


def _numbers(term):
    """Numbers without a unit among the factors of a term, signs apart."""
    if isinstance(term, Number):
        is_bare = term.type.unit == DIMENSIONLESS and "[" not in term.text
        return [term] if is_bare and abs(term.value) != 1 else []
    if isinstance(term, Call) and term.operator in _FACTORS:
        above = term.args[:1] if term.operator == "div" else term.args
        return [n for arg in above for n in _numbers(arg)]
    return []
