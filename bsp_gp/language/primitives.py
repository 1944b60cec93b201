"""The grammar as a strongly-typed DEAP primitive set: one type per nonterminal, units included.

Rule k is the primitive ``r<k>``; its argument types are its nonterminals, left to right, and a
rule without nonterminals is a terminal. DEAP trees and expressions are in bijection.
"""

import zlib

from deap import gp

from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import Expression


class _StableHash(type):
    """Hash type classes by name: DEAP keeps them in sets, whose order must not vary by process."""

    def __hash__(cls):
        return zlib.crc32(cls.__name__.encode())


def _type_class(nonterminal, type_):
    return _StableHash(nonterminal, (), {"type": type_, "__doc__": str(type_)})


def primitive_set(grammar, kind=None):
    """Build the DEAP primitive set of a grammar.

    Parameters
    ----------
    grammar : Grammar
        Masked rules are left out.
    kind : str, optional
        Which start symbol; by default the grammar's first.

    Returns
    -------
    deap.gp.PrimitiveSetTyped
        Without arguments: a tree is closed, its leaves are rules. Never compile it; its names
        are rule indices (`from_tree` gives the expression).
    """
    kinds = list(grammar.start)
    start = grammar.start[kind or kinds[0]]
    classes = {name: _type_class(name, type_) for name, type_ in grammar.types.items()}
    pset = gp.PrimitiveSetTyped(f"{grammar.name}:{start}", [], classes[start])
    for rules in grammar.rules_of.values():
        for rule in rules:
            name = f"r{rule.index}"
            if rule.children:
                pset.addPrimitive(
                    rule.index.__add__,  # never called; DEAP wants a callable
                    [classes[child] for child in rule.children],
                    classes[rule.nonterminal],
                    name=name,
                )
            else:
                pset.addTerminal(rule.index, classes[rule.nonterminal], name=name)
    return pset


def to_tree(expression, pset):
    """DEAP tree (prefix list) of an expression."""
    return gp.PrimitiveTree([pset.mapping[f"r{rule}"] for rule in expression.rules()])


def from_tree(tree, grammar):
    """Expression of a DEAP tree; GrammarError if it is not a whole, well-typed derivation."""
    nodes = iter(tree)

    def build(expected):
        node = next(nodes, None)
        if node is None:
            raise GrammarError("the tree ends too early")
        rule = grammar.rules[int(node.name[1:])]
        if expected is not None and rule.nonterminal != expected:
            raise GrammarError(f"rule {rule.index} derives {rule.nonterminal}, wanted {expected}")
        return Expression(rule.index, [build(child) for child in rule.children])

    expression = build(None)
    if next(nodes, None) is not None:
        raise GrammarError("the tree has nodes left over")
    return expression
