"""Scalar expressions with exact derivatives, and tapes that compute many of them at once.

A law is lowered (`bsp_gp.physics.engine.lowering`) to scalar nodes; equal nodes are one node, so
that values and derivatives share what they have in common. A `Tape` is the straight line of the
operations that some outputs need; what depends on properties and constants alone is computed once
by `Tape.prepare`. `kernel` runs it compiled, `Tape.run` with NumPy.
"""

import numpy as np

from bsp_gp.language.operators import GUARD, OPERATORS, bessel_k0, bessel_k1


def _inverse_positive(x):
    """1 / x where x > 0, else 0: the direction of a zero vector is zero."""
    is_positive = x > 0
    if is_positive.all():
        return np.reciprocal(x)
    return np.divide(1.0, x, out=np.zeros_like(x), where=is_positive)


def _inverse_guarded(x):
    """The paper's inverse: 0 for every x at or below its guard."""
    return np.divide(1.0, x, out=np.zeros_like(x), where=x > GUARD)


def _log_positive(x):
    """Logarithm where x > 0, else 0: 0 ** n does not feel its exponent."""
    return np.log(x, out=np.zeros_like(x), where=x > 0)


def _array(function):
    return lambda x: function(np.asarray(x, dtype=float))


UFUNCS = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power,
    "neg": np.negative, "sqrt": np.sqrt, "abs": np.abs, "square": np.square, "exp": np.exp,
    "log": np.log, "sin": np.sin, "cos": np.cos, "tanh": np.tanh, "sign": np.sign,
    "bessel_k0": bessel_k0, "bessel_k1": bessel_k1,
    "minimum": np.minimum, "less": np.less, "inverse_positive": _array(_inverse_positive),
    "inverse_guarded": _array(_inverse_guarded), "log_positive": _array(_log_positive),
}  # fmt: skip
LEAVES = ("number", "input", "constant")
BY = "'"
"""Between the name of a user's operator and the argument by which it is derived."""
STEP = 1e-5
"""Part of an argument by which the derivative of a derivative of a user's operator is taken."""


def _function(op):
    """What a node computes: of `UFUNCS`, or a user's operator, or a derivative of it."""
    if op in UFUNCS:
        return UFUNCS[op]
    name, *by = op.split(BY)
    if len(by) < 2:
        return OPERATORS[name].partials[int(by[0])] if by else OPERATORS[name].function
    *rest, last = by
    below = _function(BY.join([name, *rest]))

    def slope(*args):
        step = STEP * np.maximum(np.abs(args[int(last)]), STEP)
        low, high = ([*args] for _ in range(2))
        low[int(last)], high[int(last)] = args[int(last)] - step, args[int(last)] + step
        return (below(*high) - below(*low)) / (2 * step)

    return slope


class Graph:
    """Interned scalar nodes; a node is its number.

    Leaves are numbers, inputs (a name and, for components of vectors, an axis) and constants.
    """

    def __init__(self):
        self.nodes = []
        self._numbers = {}
        self._slopes = {}
        self.zero, self.one = self.number(0.0), self.number(1.0)

    def _intern(self, *node):
        if node not in self._numbers:
            self._numbers[node] = len(self.nodes)
            self.nodes.append(node)
        return self._numbers[node]

    def number(self, value):
        return self._intern("number", float(value))

    def input(self, name, axis=None):
        """A quantity that is given for every point, or one component of it."""
        return self._intern("input", (name, axis))

    def constant(self, name):
        return self._intern("constant", name)

    def has_constant(self, name):
        return ("constant", name) in self._numbers

    def value_of(self, node):
        """The number that a node is, or None."""
        op, *args = self.nodes[node]
        return args[0] if op == "number" else None

    # --- arithmetic, with the simplifications that derivatives need ---------------------------

    # Signs and fixed factors are moved outwards, so that what differs by them alone is one node.

    def _is_negative(self, a):
        return self.nodes[a][0] == "neg"

    def _positive(self, a):
        """What a negative node is the negative of."""
        return self.nodes[a][1]

    def _factor(self, a):
        """A node as a fixed factor and the rest."""
        op, *args = self.nodes[a]
        if op == "number":
            return a, self.one
        is_scaled = op == "mul" and self.value_of(args[0]) is not None
        return args if is_scaled else (self.one, a)

    def add(self, a, b):
        if a == self.zero:
            return b
        if b == self.zero:
            return a
        if self._is_negative(b):
            return self.sub(a, self._positive(b))
        if self._is_negative(a):
            return self.sub(b, self._positive(a))
        if a == b:
            return self.mul(self.number(2.0), a)
        return self._fold("add", *sorted((a, b)))

    def sub(self, a, b):
        if b == self.zero:
            return a
        if a == b:
            return self.zero
        if a == self.zero:
            return self.neg(b)
        if self._is_negative(b):
            return self.add(a, self._positive(b))
        if self._is_negative(a):
            return self.neg(self.add(self._positive(a), b))
        return self.neg(self._fold("sub", b, a)) if a > b else self._fold("sub", a, b)

    def mul(self, a, b):
        if self.zero in (a, b):
            return self.zero
        for x, y in ((a, b), (b, a)):
            if self._is_negative(x):
                return self.neg(self.mul(self._positive(x), y))
        (c, x), (d, y) = self._factor(a), self._factor(b)
        factor = self._fold("mul", c, d)
        rest = y if x == self.one else x if y == self.one else self._fold("mul", *sorted((x, y)))
        if rest == self.one:
            return factor
        if self.value_of(factor) == -1.0:
            return self.neg(rest)
        return rest if factor == self.one else self._fold("mul", factor, rest)

    def div(self, a, b):
        if a == self.zero or b == self.one:
            return a
        if self._is_negative(a):
            return self.neg(self.div(self._positive(a), b))
        if self._is_negative(b):
            return self.neg(self.div(a, self._positive(b)))
        return self._fold("div", a, b)

    def neg(self, a):
        if a == self.zero:
            return a
        return self._positive(a) if self._is_negative(a) else self._fold("neg", a)

    def pow(self, a, b):
        n = self.value_of(b)
        simple = {0.0: lambda: self.one, 1.0: lambda: a, 2.0: lambda: self.call("square", a)}
        return simple[n]() if n in simple else self._fold("pow", a, b)

    def call(self, op, *args):
        """A function of `UFUNCS`, or a user's operator, of other nodes."""
        if op in ("square", "abs") and self._is_negative(args[0]):
            args = (self._positive(args[0]),)
        return self._fold(op, *args)

    def sum(self, nodes):
        total = self.zero
        for node in nodes:
            total = self.add(total, node)
        return total

    def dot(self, a, b):
        return self.sum(
            self.call("square", x) if x == y else self.mul(x, y) for x, y in zip(a, b, strict=True)
        )

    def _fold(self, op, *args):
        values = [self.value_of(arg) for arg in args]
        if all(value is not None for value in values):
            with np.errstate(all="ignore"):
                return self.number(_function(op)(*map(np.float64, values)))
        return self._intern(op, *args)

    # --- derivatives --------------------------------------------------------------------------

    def slope(self, node, leaf):
        """Exact derivative of a node by a leaf, a node."""
        if node == leaf:
            return self.one
        key = (node, leaf)
        if key not in self._slopes:
            op, *args = self.nodes[node]
            self._slopes[key] = (
                self.zero if op in LEAVES else self._slope(node, op, args, leaf)
            )
        return self._slopes[key]

    def _slope(self, node, op, args, leaf):
        parts = [self.slope(arg, leaf) for arg in args]
        if all(part == self.zero for part in parts):
            return self.zero
        if op in _BINARY:
            return _BINARY[op](self, node, args, parts)
        if op in _UNARY:
            return self.mul(_UNARY[op](self, node, args[0]), parts[0])
        return self.sum(
            self.mul(self.call(f"{op}{BY}{k}", *args), part) for k, part in enumerate(parts)
        )


def _slope_div(g, node, args, parts):
    return g.div(g.sub(parts[0], g.mul(node, parts[1])), args[1])


def _slope_pow(g, node, args, parts):
    base, power = args
    by_base = g.mul(g.mul(power, g.pow(base, g.sub(power, g.one))), parts[0])
    return g.add(by_base, g.mul(g.mul(node, g.call("log_positive", base)), parts[1]))


def _slope_minimum(g, node, args, parts):
    first = g.call("less", *args)
    return g.add(g.mul(first, parts[0]), g.mul(g.sub(g.one, first), parts[1]))


_BINARY = {
    "add": lambda g, n, a, p: g.add(*p),
    "sub": lambda g, n, a, p: g.sub(*p),
    "mul": lambda g, n, a, p: g.add(g.mul(p[0], a[1]), g.mul(a[0], p[1])),
    "div": _slope_div,
    "pow": _slope_pow,
    "minimum": _slope_minimum,
    "less": lambda g, n, a, p: g.zero,
}
_UNARY = {
    "neg": lambda g, n, a: g.number(-1.0),
    "sqrt": lambda g, n, a: g.mul(g.number(0.5), g.call("inverse_positive", n)),
    "abs": lambda g, n, a: g.call("sign", a),
    "square": lambda g, n, a: g.mul(g.number(2.0), a),
    "exp": lambda g, n, a: n,
    "log": lambda g, n, a: g.div(g.one, a),
    "sin": lambda g, n, a: g.call("cos", a),
    "cos": lambda g, n, a: g.neg(g.call("sin", a)),
    "tanh": lambda g, n, a: g.sub(g.one, g.call("square", n)),
    "bessel_k0": lambda g, n, a: g.neg(g.call("bessel_k1", a)),
    "bessel_k1": lambda g, n, a: g.neg(g.add(g.call("bessel_k0", a), g.div(n, a))),
    "sign": lambda g, n, a: g.zero,
    "inverse_positive": lambda g, n, a: g.neg(g.call("square", n)),
    "inverse_guarded": lambda g, n, a: g.neg(g.call("square", n)),
    "log_positive": lambda g, n, a: g.call("inverse_positive", a),
}


class Tape:
    """The nodes that some outputs need, in order.

    Parameters
    ----------
    outputs : sequence of int
        Nodes to compute.
    moving : collection of str
        Names of inputs that differ from instant to instant; what depends on none of them is
        computed once by `prepare`.

    Attributes
    ----------
    kept, loads : list of tuple
        What is put in places at first: a prepared node, an input (name, axis) at an instant.
    line : list of (str, int, int or None, int)
        Operations, in order: the places of their arguments and of the result.
    places : list of int
        Where the outputs are then.
    """

    def __init__(self, graph, outputs, moving):
        self.outputs = tuple(outputs)
        needed, stack = set(), list(outputs)
        while stack:
            node = stack.pop()
            if node not in needed:
                needed.add(node)
                op, *args = graph.nodes[node]
                stack.extend(() if op in LEAVES else args)
        inputs, self.settled, steps, self._leaves = [], [], [], []
        changing = set()
        for node in sorted(needed):  # arguments have lower numbers
            op, *args = graph.nodes[node]
            if op == "input" and args[0][0] in moving:
                changing.add(node)
                inputs.append((node, args[0]))
            elif op in LEAVES:
                self._leaves.append((node, op, args[0]))
            elif changing.isdisjoint(args):
                self.settled.append((_function(op), node, args))
            else:
                changing.add(node)
                steps.append((op, node, args))
        read = {arg for _, _, args in steps for arg in args} | set(outputs)
        kept = sorted(read - changing)
        order = [*kept, *(n for n, _ in inputs), *(n for _, n, _ in steps)]
        place = {node: k for k, node in enumerate(order)}
        self.kept = [(place[node], node) for node in kept]
        self.loads = [(place[node], key) for node, key in inputs]
        self.line = [
            (op, place[args[0]], place[args[1]] if len(args) == 2 else None, place[node])
            for op, node, args in steps
        ]
        self.places = [place[node] for node in self.outputs]
        self.n_places = len(order)
        self._functions = [_function(op) for op, _, _ in steps]

    def prepare(self, inputs, constants):
        """Compute what does not change along a track, to hand to `run`: arrays by node.

        Parameters
        ----------
        inputs : callable
            ``inputs(name, axis)`` gives an array.
        """
        values = {}
        for node, op, content in self._leaves:
            if op == "number":
                values[node] = np.float64(content)
            else:
                values[node] = constants[content] if op == "constant" else inputs(*content)
        with np.errstate(all="ignore"):
            for function, node, args in self.settled:
                values[node] = function(*[values[k] for k in args])
        return {node: values[node] for _, node in self.kept}

    def run(self, prepared, inputs):
        """Values of the outputs at some instants, from what `prepare` made and inputs as there."""
        values = [prepared[node] for _, node in self.kept]
        values += [inputs(name, axis) for _, (name, axis) in self.loads]
        for function, (_, first, second, _) in zip(self._functions, self.line, strict=True):
            if second is None:
                values.append(function(values[first]))
            else:
                values.append(function(values[first], values[second]))
        return [values[place] for place in self.places]
