"""Places that count from a body which the others pull: all that is seen is accelerated with it."""

from dataclasses import dataclass

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.parts.hidden import about_origin
from bsp_gp.language.formula import Call, Input, Number
from bsp_gp.physics.force import Term


@dataclass(frozen=True)
class Reference(Forces):
    """What a body at the origin is pulled by, turned about, on all others: one cause.

    Its numbers are those of the declared pulls.
    """

    parameters = ()
    is_one_cause = True


def pulls_on_origin(term):
    """What a pair term does to a body at the origin, as those who count from it see it.

    The indirect term of celestial mechanics: a body there is accelerated by ``F / m``, and all that
    is seen from it by as much the other way. One term is by all others, one by the receiver
    itself; there is none where the given one is not of that kind.

    Parameters
    ----------
    term : Term
        A pair term that is as heavy as its receiver (gravity): of no other is it known how the
        body at the origin is accelerated.
    """
    if term.kind != "pair" or not _is_as_heavy(term.formula):
        return ()
    by_others, by_itself = about_origin(term.formula)
    # Of the body at the origin itself the first is 0/0: it does not pull itself.
    by_others = Call("neg", _guarded(by_others))
    return Term(by_others, "pair"), Term(Call("neg", by_itself), "field")


def _is_as_heavy(formula):
    """Whether a formula is the mass of the receiver times what else it has."""
    if isinstance(formula, Call) and formula.operator in ("mul", "neg"):
        return any(map(_is_as_heavy, formula.args))
    if isinstance(formula, Call) and formula.operator == "div":
        return _is_as_heavy(formula.args[0])
    return isinstance(formula, Input) and formula.name == "m_i"


def _guarded(formula):
    """The same with quotients that are 0 where they divide by 0."""
    if not isinstance(formula, Call):
        return formula
    args = tuple(map(_guarded, formula.args))
    if formula.operator == "div":
        return Call("div_guarded", *args)
    if formula.operator == "inverse":
        return Call("div_guarded", Number(1.0), *args)
    power = args[1].value if formula.operator == "pow" and isinstance(args[1], Number) else 0.0
    if power < 0:
        whole = Call("pow", args[0], Number(-power))
        return Call("div_guarded", Number(1.0), whole)
    return Call(formula.operator, *args)
