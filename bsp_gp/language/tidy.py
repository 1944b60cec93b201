"""Formulas written shorter: powers of one base together, numbers that are added as one."""

from bsp_gp.language.formula import Call, Number, factors, product
from bsp_gp.language.render import to_text

POWERS = {
    -2.0: ("square", "inverse"), -1.0: ("inverse",), -0.5: ("sqrt", "inverse"), 0.5: ("sqrt",),
    1.0: (), 2.0: ("square",),
}  # fmt: skip
"""Operators, the first one first, that are these powers."""


def tidied(formula):
    """A formula without powers of one, roots as such, and numbers that are added taken together."""
    if not isinstance(formula, Call):
        return formula
    operator, args = formula.operator, tuple(map(tidied, formula.args))
    if operator == "pow" and isinstance(args[1], Number):
        return _raised(args[0], args[1].value) if args[1].value else Number(1.0)
    if operator in ("add", "sub"):
        return _added(operator, *args)
    return _multiplied(args) if operator == "mul" else Call(operator, *args)


def _multiplied(args):
    """A product in which every base stands once, a number before all others."""
    powers, number = {}, 1.0
    for part in (each for arg in args for each in factors(arg)[0]):
        base, power = power_of(part)
        if isinstance(base, Number) and (base.value > 0 or power == 1.0):
            number *= base.value**power
        else:
            powers[base] = powers.get(base, 0.0) + power
    parts = [_raised(base, power) for base, power in powers.items() if power]
    parts.sort(key=to_text)
    return product(parts if number == 1.0 and parts else [Number(number), *parts])


def power_of(formula):
    """Base and power of a part of a product."""
    power = 1.0
    while isinstance(formula, Call):
        if formula.operator in ("inverse", "square", "sqrt"):
            power *= {"inverse": -1.0, "square": 2.0, "sqrt": 0.5}[formula.operator]
        elif formula.operator == "pow" and isinstance(formula.args[1], Number):
            power *= formula.args[1].value
        else:
            break
        formula = formula.args[0]
    return formula, power


def _raised(base, power):
    """A base to a power that is a number."""
    if power not in POWERS:
        return Call("pow", base, Number(power))
    for operator in POWERS[power]:
        base = Call(operator, base)
    return base


def _added(operator, one, other):
    """A sum or difference, of a number and a formula as short as can be."""
    sign = 1.0 if operator == "add" else -1.0
    number, rest, way = 0.0, None, 1.0
    for part, own in ((one, 1.0), (other, sign)):
        inner = part
        if isinstance(part, Call) and part.operator in ("add", "sub"):
            left, right = part.args
            own_sign = 1.0 if part.operator == "add" else -1.0
            if isinstance(right, Number):
                number, inner = number + own * own_sign * right.value, left
            elif isinstance(left, Number):
                number, inner, own = number + own * left.value, right, own * own_sign
        if isinstance(inner, Number):
            number += own * inner.value
        elif rest is None:
            rest, way = inner, own
        else:
            return Call(operator, one, other)
    if rest is None:
        return Number(number)
    if number == 0.0:
        return rest if way > 0 else Call("neg", rest)
    if way < 0:
        return Call("sub", Number(number), rest)
    if number < 0:
        return Call("sub", rest, Number(-number))
    return Call("add", Number(number), rest)
