"""Which laws are equal on the data: expressions as sums of coefficient x direction.

A term of a law is ``constant * coefficient * direction``. Coefficients that are proportional on
the data are one class, directions (with their condition and 1 / m_i) likewise, and a law is the
set of its terms' classes: laws that differ in writing only are recognised without being scored.
Formulas, values and classes are kept per subtree, so that a new tree pays only for what is new
in it.
"""

from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from bsp_gp.errors import UnitError
from bsp_gp.language.formula import (
    Call,
    Constant,
    evaluate,
    factors,
    product,
    rename_constants,
    summands,
)
from bsp_gp.language.grammar import Slot, fill, joined_slots
from bsp_gp.search.banks import fingerprints

_SOUGHT = frozenset(("centre", "middle"))
CACHE_BYTES = 1 << 28
"""Bound on the values kept, and on those of subtrees."""


class Law(NamedTuple):
    """What an expression is on the data.

    Attributes
    ----------
    terms : tuple of (int, int)
        Classes of coefficient and direction of each term, ascending, each once.
    constants : tuple of str
        Names of the terms' constants, in the order of the expression.
    whole : Formula or None
        Instead of terms: a law whose constants do not all multiply a term each.
    """

    terms: tuple
    constants: tuple
    whole: object = None


class _Pattern(NamedTuple):
    """How a rule's body combines the laws, factors and constants of its children."""

    kind: str  # "pass", "sum", "product", "formula"
    constant: int = -1
    scalars: tuple = ()
    vectors: tuple = ()


class Recogniser:
    """Classes and values of coefficients and directions on the rows of a regression.

    Parameters
    ----------
    grammar : Grammar
        Masked to the data.
    """

    def __init__(self, grammar, rows):
        self.grammar = grammar
        self.rows = rows
        self._ranged = frozenset(grammar.inside.get("ranges", ()))
        self._patterns = [_pattern(rule, grammar) for rule in grammar.rules]
        self._laws = {}
        self._singles = {}
        self._formulas = {}
        self._factors = {"coefficient": {}, "direction": {}}
        self._of_formula = {}
        self._classes = {"coefficient": {}, "direction": {}}
        self._members = {"coefficient": [], "direction": []}
        self._values = OrderedDict()
        self._bytes = 0
        self._inputs = _FlatInputs(rows, grammar)
        self._subtrees = BoundedCache(CACHE_BYTES)
        self._weights = np.random.default_rng(20211).standard_normal((rows.n_rows, rows.n_dims, 3))
        self._per_mass = (1.0 / rows.input("m_i", False))[:, None]

    def law(self, expression):
        """The law that an expression is; None if it has no finite value on the data."""
        kind, constant, scalars, vectors = self._patterns[expression.rule]
        while kind == "pass":
            expression = expression.children[0]
            kind, constant, scalars, vectors = self._patterns[expression.rule]
        known = self._laws
        if expression in known:
            return known[expression]
        children = expression.children
        try:
            if kind == "sum":
                law = self._sum(expression)
            elif kind == "product":
                a = self._factor("coefficient", tuple([children[k] for k in scalars]))
                b = self._factor("direction", tuple([children[k] for k in vectors]))
                law = self._single(a, b, children[constant].rule, expression)
            else:
                law = self._from_formula(self.formula(expression))
        except UnitError:
            law = None
        known[expression] = law
        return law

    def formula(self, expression):
        """What an expression means; kept, since trees share their subtrees."""
        formula = self._formulas.get(expression)
        if formula is None:
            children = [self.formula(child) for child in expression.children]
            formula = fill(self.grammar.rules[expression.rule].body, children)
            self._formulas[expression] = formula
        return formula

    def values(self, role, number):
        """Values of a class on the rows, (P,) or (P, d), of greatest size one.

        Parameters
        ----------
        role : str
            "coefficient" or "direction"; directions are divided by m_i.
        """
        return self._value(role, self._members[role][number])

    # --- recognition -----------------------------------------------------------------------------

    def _single(self, a, b, constant, expression):
        """The law of one term; equal ones are one object."""
        if a is None or b is None:
            return None
        if "whole" in (a, b):
            return self._from_formula(self.formula(expression))
        law = self._singles.get((a, b, constant))
        if law is None:
            name = self.grammar.rules[constant].body.name
            law = self._singles[a, b, constant] = Law(((a, b),), (name,))
        return law

    def _sum(self, expression):
        laws = [self.law(child) for child in expression.children]
        if None in laws:
            return None
        names = [name for law in laws for name in law.constants]
        if any(law.whole is not None for law in laws) or len(set(names)) < len(names):
            return Law((), (), _canonical(self.formula(expression), self._ranged))
        terms = sorted({term for law in laws for term in law.terms})
        return Law(tuple(terms), tuple(names))

    def _factor(self, role, children):
        known = self._factors[role]
        if children not in known:
            formulas = [self.formula(child) for child in children]
            is_free = all(map(_is_settled, formulas))
            known[children] = self._class(role, product(formulas)) if is_free else "whole"
        return known[children]

    def _from_formula(self, formula):
        """Recognise a formula of any grammar by taking it apart."""
        terms, names = [], []
        for part in summands(formula):
            parts = _parts(part)
            if parts is None:
                return Law((), (), _canonical(formula, self._ranged))
            name, coefficient, direction = parts
            a = self._class("coefficient", coefficient)
            b = self._class("direction", direction)
            if a is None or b is None:
                return None
            terms.append((a, b))
            names.append(name)
        if len(set(names)) < len(names):
            return Law((), (), _canonical(formula, self._ranged))
        return Law(tuple(sorted(set(terms))), tuple(names))

    def _class(self, role, formula):
        """Number of the class of factors that are proportional on the data; None if not finite."""
        known = self._of_formula
        key = (role, formula)
        if key not in known:
            value = self._value(role, formula)
            if value is None:
                known[key] = None
            else:
                print_ = fingerprints([value], self._weights, merge_scale=True)[0]
                classes = self._classes[role]
                if print_ not in classes:
                    classes[print_] = len(self._members[role])
                    self._members[role].append(formula)
                known[key] = classes[print_]
        return known[key]

    def _value(self, role, formula):
        """Values of a factor on the rows, scaled to a greatest size of one (kept, bounded)."""
        key = (role, formula)
        if key in self._values:
            self._values.move_to_end(key)
            return self._values[key]
        value = evaluate(formula, self._inputs, cache=self._subtrees)
        if role == "direction":
            value = np.broadcast_to(value, (self.rows.n_rows, self.rows.n_dims)) * self._per_mass
        else:
            value = np.broadcast_to(value, (self.rows.n_rows,))
        top = max(value.max(initial=0.0), -value.min(initial=0.0))
        if not np.isfinite(top) or top == 0:
            return None
        value = np.ascontiguousarray(value / top)
        self._values[key] = value
        self._bytes += value.nbytes
        while self._bytes > CACHE_BYTES and len(self._values) > 2:
            _, old = self._values.popitem(last=False)
            self._bytes -= old.nbytes
        return value


class _FlatInputs(dict):
    """Inputs of a grammar on the rows, looked up when first asked for."""

    def __init__(self, rows, grammar):
        super().__init__()
        self.rows = rows
        self.types = grammar.inputs

    def __missing__(self, name):
        self.update(self.rows.inputs_for([name], self.types))
        return self[name]


class BoundedCache(dict):
    """Values of sub-formulas; emptied when it has grown beyond its bound."""

    def __init__(self, most_bytes):
        super().__init__()
        self.most_bytes = most_bytes
        self.bytes = 0

    def __setitem__(self, key, value):
        self.bytes += np.asarray(value).nbytes
        if self.bytes > self.most_bytes:
            self.clear()
            self.bytes = np.asarray(value).nbytes
        super().__setitem__(key, value)


def _pattern(rule, grammar):
    """How a rule combines its children; "formula" where it takes reading the formula."""
    if isinstance(rule.body, Slot):
        is_force = grammar.types[rule.nonterminal].shape == "vector"
        return _Pattern("pass" if is_force else "formula")
    slots = joined_slots(rule.body, "add")
    if slots is not None and all(grammar.types[s.nonterminal].shape == "vector" for s in slots):
        return _Pattern("sum")
    slots = joined_slots(rule.body, "mul")
    if slots is None:
        return _Pattern("formula")
    by_shape = {"scalar": [], "vector": [], "bool": []}
    constants = []
    for slot in slots:
        if grammar.is_constant(slot.nonterminal):
            constants.append(slot.position)
        else:
            by_shape.setdefault(grammar.types[slot.nonterminal].shape, []).append(slot.position)
    if len(constants) != 1 or len(by_shape["vector"]) != 1:
        return _Pattern("formula")
    return _Pattern(
        "product",
        constants[0],
        tuple(by_shape["scalar"]),
        (*by_shape["vector"], *by_shape["bool"]),
    )


def _parts(formula):
    """Split constant * scalars * vector [* condition] into (name, coefficient, direction).

    None if the formula is not of that form, or has further constants.
    """
    above, below = factors(formula)
    constants = [f for f in above if isinstance(f, Constant)]
    vectors = [f for f in above if f.type.shape == "vector"]
    if len(constants) != 1 or len(vectors) != 1:
        return None
    if not all(map(_is_settled, below)):
        return None
    conditions = [f for f in above if f.type.shape == "bool"]
    scalars = [f for f in above if f.type.shape == "scalar" and not isinstance(f, Constant)]
    if not all(map(_is_settled, (*scalars, *vectors))):
        return None
    coefficient = product(scalars)
    if below:
        coefficient = Call("div", coefficient, product(below))
    return constants[0].name, coefficient, product([*vectors, *conditions])


def _is_settled(formula):
    """Whether a formula has values without any constant, or place that is sought."""
    return formula.is_constant_free and _SOUGHT.isdisjoint(formula.inputs)


def _canonical(formula, kept):
    """The formula with its constants named c1, c2, ... in order of appearance, but for some."""
    free = (name for name in formula.constants if name not in kept)
    return rename_constants(formula, {name: f"c{k}" for k, name in enumerate(free, 1)})
