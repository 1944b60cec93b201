"""Laws lowered to scalar nodes: vectors become their components, conditions become modes.

What an operator computes is said once, in `bsp_gp.language.operators`; here it is said again for
components, so that exact derivatives by places, velocities and constants follow. A property test
holds the two together.

A condition (bodies touch, a centre is on a mat, the sign of a number) is constant between two
instants at which its margin is zero. It is lowered to an input, its *mode*, and its margin is kept
beside it: the integrator changes the mode where the margin changes its sign.
"""

from dataclasses import dataclass

from bsp_gp.errors import LawError
from bsp_gp.language.formula import Call, Constant, Input, Number, factors
from bsp_gp.language.inputs import property_of
from bsp_gp.language.operators import OPERATORS
from bsp_gp.physics.engine.graph import LEAVES

MOVING = ("p_i", "p_j", "v_i", "v_j", "t", "mode")
"""Inputs that differ from instant to instant; all others belong to the bodies of a scene."""
ORIGIN = "origin"
"""The point zero, which laws of users cannot name."""
_CONDITIONS = ("does_collide", "is_on")
_BY_COMPONENT = ("add", "sub", "mul", "div")
_OF_NUMBERS = (
    "square", "sqrt", "abs", "exp", "log", "sin", "cos", "tanh", "bessel_k0", "bessel_k1"
)  # fmt: skip
"""Operators that nodes have under the same name."""


@dataclass(frozen=True)
class Mode:
    """A condition of a law.

    Attributes
    ----------
    margin : int
        Node that is positive where the condition holds.
    on, off : float
        Values of the mode where it holds and where it does not.
    """

    margin: int
    on: float = 1.0
    off: float = 0.0


class Lowering:
    """Lowers formulas of one kind into a graph.

    Parameters
    ----------
    direction : callable
        ``direction(name)`` gives the components of a lab axis.
    vectors : collection of str
        Names of property inputs that are vectors.
    unknown : collection of str
        Columns of properties that are fitted: these are constants.
    moving : collection of str
        Inputs that differ from instant to instant.
    rails : collection of int
        Axes along which nothing moves.

    Attributes
    ----------
    stops : list of (tuple of int, tuple of int)
        Axes along which a force acts against a body's own velocity and may bring it to rest, and
        the nodes of the velocity of that on which it then rests.
    """

    def __init__(
        self, graph, n_dims, direction, vectors=(), unknown=(), moving=MOVING, rails=()
    ):  # fmt: skip
        self.graph = graph
        self.n_dims, self.moving = n_dims, moving
        self.direction = direction
        self.vectors, self.unknown = frozenset(vectors), frozenset(unknown)
        self.modes, self.stops, self.rails = [], [], rails
        self._known = {}
        self._mode_of = {}

    def lower(self, formula):
        """A node for a scalar, a tuple of nodes for a vector or point."""
        if formula not in self._known:
            self._known[formula] = self._lower(formula)
        return self._known[formula]

    def _lower(self, node):
        g = self.graph
        if isinstance(node, Number):
            return g.number(node.value)
        if isinstance(node, Constant):
            return g.constant(node.name)
        if isinstance(node, Input):
            return self._input(node)
        if node.operator in _CONDITIONS:
            return self._condition(node)
        args = [self.lower(arg) for arg in node.args]
        if node.operator in _OF_NUMBERS or OPERATORS[node.operator].partials:
            return g.call(node.operator, *args)
        if node.operator in _BY_COMPONENT:
            return self._both(getattr(g, node.operator), *args)
        handler = getattr(self, f"_{node.operator}", None)
        if handler is None:
            raise LawError(f"the operator {node.operator!r} has no derivative for fits to tracks")
        return handler(*args)

    def _input(self, node):
        g, name = self.graph, node.name
        axes = range(self.n_dims)
        if name in ("e_x", "e_y", "e_z", "up", "down"):
            return tuple(g.number(x) for x in self.direction(name))
        if name == "p_c":
            return self._contact_point()
        known = property_of(name)
        if known and known[0] in self.unknown:
            return g.constant("_".join(known))
        if name == ORIGIN:
            return (g.zero,) * self.n_dims
        if name in ("v_i", "v_j"):
            return tuple(g.zero if k in self.rails else g.input(name, k) for k in axes)
        if node.type.shape in ("vector", "point") or name in self.vectors:
            return tuple(g.input(name, k) for k in axes)
        return g.input(name)

    def _contact_point(self):
        """Centre of the other, or on a wall the foot point: free along the wall's longer side."""
        g = self.graph
        point = [g.input("p_j", k) for k in range(self.n_dims)]
        for axis, side in enumerate(("wide_wall", "tall_wall")):
            shift = g.sub(g.input("p_i", axis), point[axis])
            point[axis] = g.add(point[axis], g.mul(g.input(side), shift))
        return tuple(point)

    def _condition(self, node):
        """The mode of a contact of these two places."""
        p_i, p_j = self.lower(node.args[1]), self.lower(node.args[3])
        gap = [self.graph.sub(a, b) for a, b in zip(p_i, p_j, strict=True)]
        margin = self._reach(gap) if node.operator == "does_collide" else self._mat(gap)
        return self._mode(Mode(margin))

    def _mode(self, mode):
        if mode not in self._mode_of:
            self._mode_of[mode] = self.graph.input("mode", len(self.modes))
            self.modes.append(mode)
        return self._mode_of[mode]

    def _reach(self, gap):
        """How far discs, or a disc and a wall, are inside each other; -1 m if neither."""
        g = self.graph
        discs, walls = g.input("is_disc_pair"), g.input("is_disc_wall")
        between = g.sub(g.input("disc_reach"), g.call("sqrt", g.dot(gap, gap)))
        inside = self._box(gap, "wall_half_width", "wall_half_height")
        neither = g.sub(g.add(discs, walls), g.one)
        return g.add(g.add(g.mul(discs, between), g.mul(walls, inside)), neither)

    def _mat(self, gap):
        """How far a centre is within a mat; -1 m if the other is none."""
        g = self.graph
        mats = g.input("is_mat")
        inside = self._box(gap, "mat_half_width", "mat_half_height")
        return g.add(g.mul(mats, inside), g.sub(mats, g.one))

    def _box(self, gap, *sizes):
        g = self.graph
        sides = [g.sub(g.input(s), g.call("abs", x)) for s, x in zip(sizes, gap[:2], strict=True)]
        return g.call("minimum", *sides)

    # --- operators ------------------------------------------------------------------------------

    def _both(self, function, a, b):
        """An operation between components, a scalar being repeated."""
        if isinstance(a, tuple) or isinstance(b, tuple):
            n = len(a if isinstance(a, tuple) else b)
            a = a if isinstance(a, tuple) else (a,) * n
            b = b if isinstance(b, tuple) else (b,) * n
            return tuple(function(x, y) for x, y in zip(a, b, strict=True))
        return function(a, b)

    def _div_guarded(self, a, b):
        return self._both(self.graph.mul, a, self.graph.call("inverse_guarded", b))

    def _pow(self, a, b):
        return self.graph.pow(a, b)

    def _neg(self, a):
        return tuple(map(self.graph.neg, a)) if isinstance(a, tuple) else self.graph.neg(a)

    def _norm(self, a):
        return self.graph.call("sqrt", self.graph.dot(a, a))

    def _normalize(self, a):
        free = tuple(k for k in range(self.n_dims) if k not in self.rails)
        medium = tuple(self._medium(a[k], self.graph.input("v_i", k)) for k in free)
        is_flat = all(a[k] == self.graph.zero for k in self.rails)
        if free and is_flat and None not in medium:
            self._stop(free, medium)
        return self._both(self.graph.mul, a, self.graph.call("inverse_positive", self._norm(a)))

    def _dot(self, a, b):
        return self.graph.dot(a, b)

    def _along(self, a, b):
        return self.graph.dot(a, self._normalize(b))

    def _project_abs(self, a, b):
        g = self.graph
        return g.sum(g.call("abs", g.mul(x, y)) for x, y in zip(a, b, strict=True))

    def _perp(self, a):
        if len(a) != 2:
            raise LawError("perp is a rotation in the plane; in 3-D use cross(a, b)")
        return (self.graph.neg(a[1]), a[0])

    def _cross(self, a, b):
        if len(a) != 3:
            raise LawError("cross needs three dimensions; in 2-D use perp(a)")
        g = self.graph
        turns = ((1, 2), (2, 0), (0, 1))
        return tuple(g.sub(g.mul(a[j], b[k]), g.mul(a[k], b[j])) for j, k in turns)

    def _sign(self, a):
        axis = self._own_axis(a)
        if axis is None:
            return self._mode(Mode(a, 1.0, -1.0))
        self._stop((axis,), (self.graph.zero,))
        return self.graph.call("sign", a)

    def _own_axis(self, node):
        """The axis whose velocity of its own body a node is, but for fixed factors, or None."""
        op, *args = self.graph.nodes[node]
        if op == "input":
            name, axis = args[0]
            return axis if name == "v_i" else None
        if op == "neg":
            return self._own_axis(args[0])
        if op not in ("mul", "div"):
            return None
        factor, rest = sorted(args, key=self._moves) if op == "mul" else args[::-1]
        return None if self._moves(factor) else self._own_axis(rest)

    def _moves(self, node):
        """Whether a node differs from instant to instant."""
        op, *args = self.graph.nodes[node]
        if op in LEAVES:
            return op == "input" and args[0][0] in self.moving
        return any(map(self._moves, args))

    def _stop(self, axes, medium):
        if (axes, medium) not in self.stops:
            self.stops.append((axes, medium))

    def _medium(self, node, own):
        """The node of what stays the same by which a node is less than a velocity, or None."""
        g, is_turned = self.graph, False
        if node == own:
            return g.zero
        op, *args = g.nodes[node]
        if op == "neg":
            (op, *args), is_turned = g.nodes[args[0]], True
        if op == "add" and own in args and not is_turned:
            rest = args[1 - args.index(own)]
            return None if self._moves(rest) else g.neg(rest)
        if op != "sub" or args[is_turned] != own or self._moves(args[not is_turned]):
            return None
        return args[not is_turned]

    def _inverse(self, a):
        return self.graph.div(self.graph.one, a)


def fades_at_rest(formula):
    """Whether a force goes to zero with the speed of its receiver, and cannot hold it at rest.

    Told from its factors: drag ``norm(v_i)^2 * normalize(v_i)`` does, friction and what has a
    power that is fitted do not. Where it acts against a medium, the speed in that is meant.
    """
    above, below = factors(formula)
    powers = {}
    for sign, parts in ((1.0, above), (-1.0, below)):
        for part in parts:
            base, power = _power_of_speed(part)
            if base is not None:
                powers[base] = powers.get(base, 0.0) + sign * power
    return bool(powers) and min(powers.values()) > 0


def _power_of_speed(part):
    """The velocity that a factor is a power of, or has the direction of, and that power."""
    power = 1.0
    while isinstance(part, Call) and part.operator in (
        "square", "inverse", "pow", "norm", "normalize"
    ):  # fmt: skip
        if part.operator == "pow":
            power *= part.args[1].value if isinstance(part.args[1], Number) else 0.0
        power *= {"square": 2.0, "inverse": -1.0, "normalize": 0.0}.get(part.operator, 1.0)
        part = part.args[0]
    is_past = isinstance(part, Call) and part.operator == "sub"
    own = part.args[0] if is_past else part
    is_own = isinstance(own, Input) and own.name == "v_i"
    is_own &= not (is_past and {"v_i", "v_j", "p_i", "p_j", "t"} & set(part.args[1].inputs))
    return (part, power) if is_own else (None, 0.0)
