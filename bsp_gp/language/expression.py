"""Expressions: derivation trees of a grammar, stored as rule indices, hashable.

An `Expression` says how a grammar derives a law; `to_formula` says what the law means, and
`derive` finds the expression of a formula again.
"""

import threading
import weakref

from bsp_gp.language.formula import Call
from bsp_gp.language.grammar import Slot, fill

_KNOWN: weakref.WeakValueDictionary = weakref.WeakValueDictionary()
LARGEST = 20
"""Rules of a derivation, up to which all are looked for."""
_LOCK = threading.RLock()  # a collected tree may be made again while one is made


class Expression:
    """A derivation tree: the index of the rule at its root and one subtree per nonterminal.

    Equal trees are one object (hash-consed), so that they are compared and looked up by identity
    however deep they are.

    Attributes
    ----------
    levels : int
        A rule without nonterminals is one level.
    size : int
        Number of rules used.
    """

    __slots__ = ("__weakref__", "children", "levels", "rule", "size")

    def __new__(cls, rule, children=()):
        key = (rule, tuple(children))
        reference = _KNOWN.data.get(key)  # half the time of `_KNOWN.get`, where searches spend it
        found = None if reference is None else reference()
        if found is None:
            with _LOCK:  # two threads may not make the same tree
                found = _KNOWN.get(key)
                if found is None:
                    found = _KNOWN[key] = cls._made(*key)
        return found

    @classmethod
    def _made(cls, rule, children):
        self = object.__new__(cls)
        self.rule = rule
        self.children = children
        levels, size = 0, 1
        for child in children:
            size += child.size
            if child.levels > levels:
                levels = child.levels
        self.levels = levels + 1
        self.size = size
        return self

    def __reduce__(self):
        return (Expression, (self.rule, self.children))

    def __repr__(self):
        return f"Expression({self.rule}, {list(self.children)})"

    def rules(self):
        """Yield the rule index of every node, parents before children, left to right."""
        stack = [self]
        while stack:
            node = stack.pop()
            yield node.rule
            stack.extend(reversed(node.children))


def to_formula(expression, grammar):
    """What the derivation means: its rule bodies filled in."""
    children = [to_formula(child, grammar) for child in expression.children]
    return fill(grammar.rules[expression.rule].body, children)


def derive(formula, grammar, nonterminal):
    """Find a derivation of `formula` from `nonterminal`; None if the grammar cannot say it.

    Where the grammar is ambiguous the derivation with the fewest levels is returned, and of
    those the one whose rules come first in the file.
    """
    return _Deriver(grammar).derive(formula, nonterminal)


def smallest(grammar, nonterminal, most):
    """All derivations up to the size of which there are no more than `most`, smallest first.

    Parameters
    ----------
    most : int

    Returns
    -------
    list of Expression
    """
    known: dict = {}

    def of_size(name, size):
        key = name, size
        if key not in known:
            known[key] = [
                Expression(rule.index, children) for rule in grammar.rules_of[name]
                for children in below(rule.children, size - 1)
            ]  # fmt: skip
        return known[key]

    def below(names, size):
        if not names:
            return [()] if size == 0 else []
        return [
            (one, *others) for k in range(1, size - len(names) + 2)
            for one in of_size(names[0], k) for others in below(names[1:], size - k)
        ]  # fmt: skip

    found: list = []
    for size in range(1, LARGEST + 1):
        some = of_size(nonterminal, size)
        if len(found) + len(some) > most:
            break
        found += some
    return found


class _Deriver:
    def __init__(self, grammar):
        self.grammar = grammar
        self.memo = {}

    def derive(self, formula, nonterminal):
        key = (formula, nonterminal)
        if key not in self.memo:
            self.memo[key] = None  # guards against unit rules that lead back here
            best = None
            for rule in self.grammar.rules_of[nonterminal]:
                slots = {}
                if self.match(rule.body, formula, slots):
                    children = [self.derive(slots[k], c) for k, c in enumerate(rule.children)]
                    if all(child is not None for child in children):
                        found = Expression(rule.index, children)
                        if best is None or found.levels < best.levels:
                            best = found
            self.memo[key] = best
        return self.memo[key]

    def match(self, body, formula, slots):
        if isinstance(body, Slot):
            slots[body.position] = formula
            return True
        if isinstance(body, tuple):
            return (
                isinstance(formula, Call)
                and formula.operator == body[0]
                and all(
                    self.match(part, arg, slots)
                    for part, arg in zip(body[1:], formula.args, strict=True)
                )
            )
        return body == formula
