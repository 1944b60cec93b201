"""How a grammar's start symbol factors: constant * scalars * direction [* condition]."""

from dataclasses import dataclass

from bsp_gp.errors import GrammarError
from bsp_gp.language.grammar import Slot, joined_slots


@dataclass(frozen=True)
class Plan:
    """One way in which a start symbol factors.

    Attributes
    ----------
    constant : str
        Name of the constant.
    left, right : (nonterminal, budget) or None
        Scalar factors; None is the number 1.
    operator : str
        "mul", or the grammar's division.
    direction, condition : (nonterminal, budget), condition may be None
    rules : tuple of int
        Rules used on the way, for the complexity.
    """

    constant: str
    left: tuple | None
    right: tuple | None
    operator: str
    direction: tuple
    condition: tuple | None
    rules: tuple[int, ...]


def plan_of(grammar, kind, max_levels):
    """Factor the start symbol of a grammar.

    Raises
    ------
    GrammarError
        If a rule of the start symbol is not a product of a constant, scalars, one direction and
        at most one condition.
    """
    plans = []
    _expand(grammar, grammar.start[kind], max_levels, (), plans)
    return plans


def _expand(grammar, nonterminal, budget, rules, plans):
    for rule in grammar.rules_of[nonterminal]:
        used = (*rules, rule.index)
        if isinstance(rule.body, Slot):
            _expand(grammar, rule.body.nonterminal, budget - 1, used, plans)
            continue
        plans.extend(_plans_of_rule(grammar, rule, budget - 1, used))


def _plans_of_rule(grammar, rule, budget, used):
    constant, scalars, directions, conditions = None, [], [], []
    slots = joined_slots(rule.body, "mul")
    if slots is None:
        raise GrammarError(
            f"exhaustive search needs products; rule {rule.nonterminal} -> {rule.text} is none"
        )
    for nonterminal in (slot.nonterminal for slot in slots):
        shape = grammar.types[nonterminal].shape
        if grammar.is_constant(nonterminal):
            first = grammar.rules_of[nonterminal][0]
            constant = first.body.name
            used = (*used, first.index)
        else:
            {"scalar": scalars, "vector": directions, "bool": conditions}[shape].append(nonterminal)
    if constant is None or len(directions) != 1 or len(conditions) > 1 or len(scalars) > 2:
        raise GrammarError(
            f"exhaustive search needs rules of the form constant * scalars * direction "
            f"[* condition]; rule {rule.nonterminal} -> {rule.text} is not"
        )
    direction = (directions[0], budget)
    condition = (conditions[0], budget) if conditions else None
    for left, operator, right, extra in _coefficients(grammar, scalars, budget):
        yield Plan(constant, left, right, operator, direction, condition, (*used, *extra))


def _coefficients(grammar, scalars, budget):
    if not scalars:
        yield None, "mul", None, ()
    elif len(scalars) == 2:
        yield (scalars[0], budget), "mul", (scalars[1], budget), ()
    else:
        yield from _split_coefficient(grammar, scalars[0], budget)


def _split_coefficient(grammar, nonterminal, budget):
    """A coefficient whose rules are products of two nonterminals factors; others stay whole."""
    rules = grammar.rules_of[nonterminal]
    binary = [r for r in rules if _binary(r)]
    if not any(isinstance(r.body, Slot) for r in rules) or not binary:
        yield (nonterminal, budget), "mul", None, ()
        return
    for rule in rules:
        if isinstance(rule.body, Slot):
            yield (rule.body.nonterminal, budget - 1), "mul", None, (rule.index,)
        elif _binary(rule):
            left, right = rule.children
            yield (left, budget - 1), rule.body[0], (right, budget - 1), (rule.index,)
        else:
            raise GrammarError(
                f"exhaustive search cannot factor rule {rule.nonterminal} -> {rule.text}: give "
                'what is multiplied a symbol of its own, as in Pace = "Speed | square(Speed)" and '
                'Coeff = "Pace | mul(Size, Pace)"'
            )


def _binary(rule):
    return (
        isinstance(rule.body, tuple)
        and rule.body[0] in ("mul", "div", "div_guarded")
        and all(isinstance(part, Slot) for part in rule.body[1:])
    )
