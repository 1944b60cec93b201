"""Formulas: operators applied to inputs, constants and numbers, typed as they are built.

A `Formula` is what a law *means*; it is evaluated, differentiated, rendered and unit-checked.
How a grammar derives it is an `Expression` (expression.py). Nodes are immutable, compare by
structure, and know their `Type`, so that an ill-typed formula cannot exist.
"""

from collections.abc import Mapping

import numpy as np

from bsp_gp.errors import UnitError
from bsp_gp.language.operators import OPERATORS, Type
from bsp_gp.units import DIMENSIONLESS


class Formula:
    """Base of the four kinds of node; `type` is the node's `Type`."""

    __slots__ = ("_constants", "_hash", "_inputs", "_key", "_told", "is_constant_free", "type")
    args = ()

    def __eq__(self, other):
        return self is other or (
            type(self) is type(other) and self._hash == other._hash and self._key == other._key
        )

    def __hash__(self):
        return self._hash

    def _settle(self, type_, key, is_constant_free=True):
        self.type = type_
        self.is_constant_free = is_constant_free
        self._key = key
        self._hash = hash((type(self).__name__, key))
        self._inputs = self._constants = None
        self._told = {}

    def __repr__(self):
        from bsp_gp.language.render import to_text

        return f"<{to_text(self)}>"

    def once(self, tell):
        """What ``tell(formula)`` tells of this very node, told once.

        Equal nodes may be written otherwise: what is told of one is not told of the other.
        """
        if tell not in self._told:
            self._told[tell] = tell(self)
        return self._told[tell]

    @property
    def inputs(self):
        """Names of all inputs that occur, a frozenset."""
        if self._inputs is None:
            self._inputs = frozenset().union(*(arg.inputs for arg in self.args))
        return self._inputs

    @property
    def constants(self):
        """Names of all free constants that occur, in order of appearance."""
        if self._constants is None:
            names = (name for arg in self.args for name in arg.constants)
            self._constants = tuple(dict.fromkeys(names))
        return self._constants


class Input(Formula):
    """A quantity that the data supply: ``m_i``, ``p_j``, ``e_y``, ``t``."""

    __slots__ = ("name",)

    def __init__(self, name, type_):
        self.name = name
        self._settle(type_, (name, type_))
        self._inputs = frozenset((name,))

    def __reduce__(self):
        return (Input, (self.name, self.type))


class Constant(Formula):
    """A free real number, fitted by the inner level; its unit is open."""

    __slots__ = ("name",)

    def __init__(self, name):
        self.name = name
        self._settle(Type("scalar", None), name, is_constant_free=False)
        self._constants = (name,)

    def __reduce__(self):
        return (Constant, (self.name,))


class Number(Formula):
    """A fixed number in SI; `text` is how the user wrote it, unit included."""

    __slots__ = ("text", "value")

    def __init__(self, value, unit=DIMENSIONLESS, text=None):
        self.value = float(value)
        self.text = text if text is not None else f"{self.value:.17g}"
        self._settle(Type("scalar", unit), (self.value, unit))

    def __reduce__(self):
        return (Number, (self.value, self.type.unit, self.text))


class Call(Formula):
    """An operator applied to arguments; building it checks shapes and units.

    Raises
    ------
    UnitError
        If the operator does not accept the types of the arguments.
    """

    __slots__ = ("args", "operator")

    def __init__(self, operator, *args):
        op = OPERATORS[operator]
        if len(args) != op.arity:
            raise UnitError(f"{operator} takes {op.arity} argument(s), got {len(args)}")
        self.operator = operator
        self.args = args
        type_ = op.infer(*(arg.type for arg in args))
        if operator == "pow" and isinstance(args[1], Number) and args[0].type.unit is not None:
            type_ = Type(type_.shape, args[0].type.unit ** args[1].value)
        self._settle(type_, (operator, args), all(arg.is_constant_free for arg in args))

    def __reduce__(self):
        return (Call, (self.operator, *self.args))


def walk(formula):
    """Yield every node of `formula`, parents before children."""
    stack = [formula]
    while stack:
        node = stack.pop()
        yield node
        if isinstance(node, Call):
            stack.extend(reversed(node.args))


def input_types_of(formula):
    """Types of all inputs that occur, by name."""
    return {node.name: node.type for node in walk(formula) if isinstance(node, Input)}


def substitute(formula, replaced):
    """The formula with some of its nodes replaced.

    Raises
    ------
    UnitError
        If an operator does not accept what stands in the place of an argument.
    """
    if formula in replaced:
        return replaced[formula]
    if isinstance(formula, Call):
        return Call(formula.operator, *(substitute(arg, replaced) for arg in formula.args))
    return formula


def evaluate(formula, inputs: Mapping, constants: Mapping | None = None, cache: dict | None = None):
    """Compute the value of a formula.

    Parameters
    ----------
    inputs : mapping of str to array
        Scalars of shape S, vectors and points of shape S + (d,); shapes broadcast.
    cache : dict, optional
        Values of constant-free sub-formulas; filled and reused between calls on the same inputs.

    Returns
    -------
    ndarray
        Shape S for scalars and conditions (0.0 or 1.0), S + (d,) for vectors. Not checked for
        finiteness: the caller knows what a division by zero means to it.
    """
    with np.errstate(all="ignore"):
        return _evaluate(formula, inputs, constants or {}, cache)


def _evaluate(node, inputs, constants, cache):
    if isinstance(node, Number):
        return np.float64(node.value)
    if isinstance(node, Input):
        return inputs[node.name]
    if isinstance(node, Constant):
        return constants[node.name]
    if cache is not None and node in cache:
        return cache[node]
    values = [_evaluate(arg, inputs, constants, cache) for arg in node.args]
    value = OPERATORS[node.operator].evaluate(tuple(arg.type for arg in node.args), *values)
    if cache is not None and node.is_constant_free:
        cache[node] = value
    return value


def evaluate_with_gradient(formula, inputs, constants, names):
    """Value of a formula and its exact derivatives with respect to named constants, by name.

    A derivative is None where the formula does not depend on that constant.
    """
    with np.errstate(all="ignore"):
        value, tangents = _forward(formula, inputs, constants, tuple(names))
    return value, dict(zip(names, tangents, strict=True))


def _forward(node, inputs, constants, names):
    none = [None] * len(names)
    if isinstance(node, Number):
        return np.float64(node.value), none
    if isinstance(node, Input):
        return inputs[node.name], none
    if isinstance(node, Constant):
        return np.float64(constants[node.name]), [1.0 if n == node.name else None for n in names]
    pairs = [_forward(arg, inputs, constants, names) for arg in node.args]
    values = [value for value, _ in pairs]
    types = tuple(arg.type for arg in node.args)
    operator = OPERATORS[node.operator]
    value = operator.evaluate(types, *values)
    tangents = []
    for k in range(len(names)):
        parts = [None if t[k] is None else np.asarray(t[k]) for _, t in pairs]
        active = any(part is not None for part in parts) and operator.derivative is not None
        tangents.append(operator.derivative(types, values, parts) if active else None)
    return value, tangents


def factors(formula, is_whole=lambda formula: False):
    """Flatten a product: ``(numerator, denominator)`` lists of formulas that are no products.

    ``a * (b / c) * d`` gives ``([a, b, d], [c])``. Guarded divisions are kept whole, since
    a / (b / c) is not a * c / b where the guard acts, and so is what the caller says.
    """
    if isinstance(formula, Call) and not is_whole(formula):
        if formula.operator in ("mul", "div"):
            above, below = factors(formula.args[0], is_whole)
            more_above, more_below = factors(formula.args[1], is_whole)
            if formula.operator == "div":
                more_above, more_below = more_below, more_above
            return above + more_above, below + more_below
        if formula.operator == "neg":
            above, below = factors(formula.args[0], is_whole)
            return [Number(-1.0), *above], below
    return [formula], []


def product(formulas):
    """Multiply formulas, left to right; an empty product is the number 1."""
    total = None
    for formula in formulas:
        total = formula if total is None else Call("mul", total, formula)
    return Number(1.0) if total is None else total


def quotient(above, below):
    """A product over a product, either of which may be empty."""
    return Call("div", product(above), product(below)) if below else product(above)


def summands(formula):
    """The terms of a sum, left to right; a difference is a sum with its second term negated."""
    if isinstance(formula, Call) and formula.operator == "add":
        return [term for arg in formula.args for term in summands(arg)]
    if isinstance(formula, Call) and formula.operator == "sub":
        first, second = formula.args
        if first.type.shape == "vector":  # not for points, whose difference is one vector
            return summands(first) + [Call("neg", term) for term in summands(second)]
    return [formula]


def rename_constants(formula, names):
    """The formula with constants renamed: ``names`` maps old names to new ones."""
    if all(names.get(name, name) == name for name in formula.constants):
        return formula
    if isinstance(formula, Constant):
        return Constant(names[formula.name])
    return Call(formula.operator, *(rename_constants(arg, names) for arg in formula.args))
