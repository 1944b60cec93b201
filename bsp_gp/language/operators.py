"""The operators that a law may use: what they compute, how they type-check, how they differentiate.

Values are float64 arrays of any leading shape ``S``: a scalar has the shape ``S``, a vector (or
point) the shape ``S + (d,)``; leading shapes broadcast. A `Type` is a shape word with a unit;
the unit None is the wildcard of fitted constants, which absorb whatever dimension is missing.

Two operators exist in the paper's version and in a mended one (DESIGN §3): `div_guarded` is 0
for every divisor <= 1e-9 and `project_abs` sums absolute products; grammars choose by name.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points

import numpy as np

from bsp_gp.errors import UnitError
from bsp_gp.units import DIMENSIONLESS, Unit

SHAPES = ("scalar", "vector", "point", "bool", "shape")
GUARD = 1e-9
"""Divisors at or below this give 0 in the paper's guarded division."""


@dataclass(frozen=True)
class Type:
    """Shape word and unit of a value; unit None = open (depends on a fitted constant)."""

    shape: str
    unit: Unit | None = DIMENSIONLESS

    def __str__(self):
        return f"{self.shape} {'*' if self.unit is None else self.unit.text()}"


@dataclass(frozen=True)
class Operator:
    """One operator.

    Attributes
    ----------
    infer : callable
        ``infer(*types) -> Type``; raises UnitError with a fact ("adds kg to m").
    evaluate : callable
        ``evaluate(types, *values) -> array``.
    derivative : callable or None
        ``derivative(types, values, tangents) -> array``: directional derivative, where a tangent
        of None is zero. None for operators without one (conditions).
    latex : str
        A template with ``{0}``, ``{1}``; infix operators are handled by the renderer.
    function, partials : callable and tuple of callable
        Of an operator of a user's own (`bsp_gp.language.own_operators`): values and derivatives by
        each argument, numbers being all it takes.
    """

    name: str
    arity: int
    infer: Callable
    evaluate: Callable
    derivative: Callable | None
    latex: str = ""
    function: Callable | None = None
    partials: tuple = ()


def bessel_k0(x):
    """Modified Bessel function of the second kind: the potential of a screened line."""
    from scipy.special import k0

    return k0(x)


def bessel_k1(x):
    """That of order one: the force of a screened line, as between what floats."""
    from scipy.special import k1

    return k1(x)


class _Operators(dict):
    """Operators by name; those of installed packages are loaded when they are first asked for."""

    def __contains__(self, name):
        return super().__contains__(name) or self._is_loaded(name)

    def _is_loaded(self, name):
        point = _offered().pop(name, None) if isinstance(name, str) else None
        if point is not None:
            point.load()()  # it registers the operator
        return super().__contains__(name)


@cache
def _offered():
    """Operators of installed packages that are not loaded yet, by name."""
    return {point.name: point for point in entry_points(group="bsp_gp.operators")}


# --- shapes and units -------------------------------------------------------------------------


def _number(type_):
    return type_.shape in ("scalar", "bool")


def _scalar(name, *types):
    for type_ in types:
        if not _number(type_):
            raise UnitError(f"{name} takes scalars, got a {type_.shape}")


def _vector(name, *types):
    for type_ in types:
        if type_.shape != "vector":
            raise UnitError(
                f"{name} takes vectors, got a {type_.shape}"
                + (" (use a difference of points)" if type_.shape == "point" else "")
            )


def _times(a, b):
    return None if a is None or b is None else a * b


def _over(a, b):
    return None if a is None or b is None else a / b


def _same_unit(verb, a, b):
    if a is None:
        return b
    if b is None or a == b:
        return a
    raise UnitError(f"{verb} {b} and {a}, which are different units")


def _infer_add(a, b):
    unit = _same_unit("adds", a.unit, b.unit)
    if _number(a) and _number(b):
        return Type("scalar", unit)
    shapes = {a.shape, b.shape}
    if shapes == {"vector"}:
        return Type("vector", unit)
    if shapes == {"point", "vector"}:
        return Type("point", unit)
    raise UnitError(f"cannot add a {a.shape} and a {b.shape}")


def _infer_sub(a, b):
    unit = _same_unit("subtracts", a.unit, b.unit)
    if _number(a) and _number(b):
        return Type("scalar", unit)
    if a.shape == b.shape and a.shape in ("vector", "point"):
        return Type("vector", unit)
    if (a.shape, b.shape) == ("point", "vector"):
        return Type("point", unit)
    raise UnitError(f"cannot subtract a {b.shape} from a {a.shape}")


_PLACE = (
    ", which is a place; a difference of points is a vector: write k * ((X, Y) - p_i), a pull to "
    "(X, Y), k * (origin - p_i), one to the origin, or -k * x_i * e_x along one axis"
)
"""What to write in place of -k * p_i."""


def _infer_mul(a, b):
    unit = _times(a.unit, b.unit)
    if _number(a) and _number(b):
        return Type("scalar", unit)
    if {a.shape, b.shape} in ({"scalar", "vector"}, {"bool", "vector"}):
        return Type("vector", unit)
    raise UnitError(
        f"cannot multiply a {a.shape} by a {b.shape}"
        + ("; write dot(a, b) or a norm" if a.shape == b.shape == "vector" else "")
        + (_PLACE if "point" in (a.shape, b.shape) else "")
    )


def _infer_div(a, b):
    if not _number(b) or a.shape not in ("scalar", "bool", "vector"):
        raise UnitError(f"cannot divide a {a.shape} by a {b.shape}")
    return Type("vector" if a.shape == "vector" else "scalar", _over(a.unit, b.unit))


def _infer_unary(name, unit_of):
    def infer(a):
        _scalar(name, a)
        return Type("scalar", unit_of(a.unit))

    return infer


def _dimensionless(name):
    def unit_of(unit):
        if unit is not None and not unit.is_dimensionless:
            raise UnitError(f"{name} takes a dimensionless number, got {unit}")
        return DIMENSIONLESS

    return unit_of


def _infer_pow(a, b):
    _scalar("a power", a, b)
    if b.unit is not None and not b.unit.is_dimensionless:
        raise UnitError(f"an exponent must be dimensionless, got {b.unit}")
    # The unit of x**n for a number n is set by the formula, which knows n.
    return Type("scalar", DIMENSIONLESS if a.unit is not None and a.unit.is_dimensionless else None)


def _infer_neg(a):
    if a.shape == "point":
        raise UnitError(f"cannot negate a point{_PLACE}")
    return Type("scalar" if _number(a) else a.shape, a.unit)


def _infer_of_vectors(name, shape, unit_of):
    def infer(*types):
        _vector(name, *types)
        return Type(shape, unit_of(*(type_.unit for type_ in types)))

    return infer


def _infer_contact(name):
    def infer(shape_i, point_i, shape_j, point_j):
        # Grammars without translation invariance have positions that are vectors.
        places = all(place.shape in ("point", "vector") for place in (point_i, point_j))
        if not places or (shape_i.shape, shape_j.shape) != ("shape", "shape"):
            raise UnitError(f"{name} takes (s_i, p_i, s_j, p_j)")
        return Type("bool", DIMENSIONLESS)

    return infer


# --- values -----------------------------------------------------------------------------------


def _lift(value, is_vector, other_is_vector):
    """Give a scalar a trailing axis where its partner is a vector."""
    return value[..., None] if other_is_vector and not is_vector else value


def _mul(types, a, b):
    va, vb = types[0].shape == "vector", types[1].shape == "vector"
    return _lift(np.asarray(a), va, vb) * _lift(np.asarray(b), vb, va)


def _div(types, a, b):
    return np.asarray(a) / _lift(np.asarray(b), False, types[0].shape == "vector")


def _inverse_guarded(b):
    b = np.asarray(b, dtype=float)
    return np.where(b > GUARD, 1.0 / np.where(b > GUARD, b, 1.0), 0.0)


def _div_guarded(types, a, b):
    return np.asarray(a) * _lift(_inverse_guarded(b), False, types[0].shape == "vector")


def _norm(types, a):
    return np.sqrt(_dot(types, a, a))


def _normalize(types, a):
    size = _norm(types, a)[..., None]
    good = size > 0
    if good.all():
        return a / size
    return np.where(good, a / np.where(good, size, 1.0), 0.0)


def _dot(types, a, b):
    # Component by component: several times as fast as a sum along so short an axis.
    a, b = np.asarray(a), np.asarray(b)
    total = a[..., 0] * b[..., 0]
    for k in range(1, a.shape[-1]):
        total = total + a[..., k] * b[..., k]
    return total


def _along(types, a, b):
    return _dot(types, a, _normalize(types, b))


def _project_abs(types, a, b):
    return np.abs(np.asarray(a) * b).sum(axis=-1)


def _perp(types, a):
    a = np.asarray(a)
    if a.shape[-1] != 2:
        raise UnitError("perp is a rotation by 90 degrees in the plane; in 3-D use cross(a, b)")
    return np.stack([-a[..., 1], a[..., 0]], axis=-1)


def _cross(types, a, b):
    a, b = np.broadcast_arrays(a, b)
    if a.shape[-1] != 3:
        raise UnitError("cross needs three dimensions; in 2-D use perp(a)")
    return np.cross(a, b)


# --- directional derivatives (tangent None = zero) ----------------------------------------------


def _linear(evaluate):
    """Derivative of an operator that is linear in its only argument."""

    def derivative(types, values, tangents):
        return evaluate(types, tangents[0])

    return derivative


def _d_add(types, values, tangents):
    a, b = tangents
    return b if a is None else a if b is None else a + b


def _d_sub(types, values, tangents):
    a, b = tangents
    return -b if a is None else a if b is None else a - b


def _d_of_two(first, second):
    """Derivative of an operator of two arguments, of what a change of either does to it."""

    def derivative(types, values, tangents):
        pairs = zip((first, second), tangents, strict=True)
        parts = [by(types, *values, change) for by, change in pairs if change is not None]
        return sum(parts[1:], parts[0])

    return derivative


def _d_bilinear(evaluate):
    return _d_of_two(
        lambda types, a, b, change: evaluate(types, change, b),
        lambda types, a, b, change: evaluate(types, a, change),
    )


def _d_quotient(evaluate):
    return _d_of_two(
        lambda types, a, b, change: evaluate(types, change, b),
        lambda types, a, b, change: -evaluate(
            types, _mul(types, evaluate(types, a, b), change), b
        ),
    )


def _d_scalar(slope):
    def derivative(types, values, tangents):
        return slope(values[0]) * tangents[0]

    return derivative


def _d_base(types, base, power, change):
    power = np.asarray(power, dtype=float)
    return power * np.asarray(base, dtype=float) ** (power - 1) * change


def _d_power(types, base, power, change):
    base = np.asarray(base, dtype=float)
    return base**power * np.log(np.where(base > 0, base, 1.0)) * change


def _d_norm(types, values, tangents):
    return _dot(types, _normalize(types, values[0]), tangents[0])


def _d_normalize(types, values, tangents):
    size = _norm(types, values[0])[..., None]
    unit = _normalize(types, values[0])
    change = tangents[0] - unit * _dot(types, unit, tangents[0])[..., None]
    return np.where(size > 0, change / np.where(size > 0, size, 1.0), 0.0)


def _d_direction(types, a, b, change):
    return _dot(types, a, _d_normalize(types, [b], [change]))


def _d_project_abs(types, a, b, change):
    """By the first argument; the other one is alike."""
    return (np.sign(np.asarray(a) * b) * change * b).sum(axis=-1)


def _same(unit, *others):
    return unit


def _power_of(n):
    return lambda unit: None if unit is None else unit**n


def _table():
    plain = {
        "sqrt": (np.sqrt, lambda a: 0.5 / np.sqrt(a), _power_of(0.5), r"\sqrt{{{0}}}"),
        "abs": (np.abs, np.sign, _same, r"\left|{0}\right|"),
        "sign": (
            np.sign,
            np.zeros_like,
            lambda unit: DIMENSIONLESS,
            r"\operatorname{{sign}}\left({0}\right)",
        ),
        "square": (np.square, lambda a: 2 * np.asarray(a), _power_of(2), ""),
        "inverse": (
            lambda a: 1.0 / np.asarray(a),
            lambda a: -1.0 / np.square(a),
            _power_of(-1),
            r"\frac{{1}}{{{0}}}",
        ),
    }
    transcendental = {
        "exp": (np.exp, np.exp),
        "log": (np.log, lambda a: 1.0 / np.asarray(a)),
        "sin": (np.sin, np.cos),
        "cos": (np.cos, lambda a: -np.sin(a)),
        "tanh": (np.tanh, lambda a: 1.0 / np.square(np.cosh(a))),
        "bessel_k0": (bessel_k0, lambda a: -bessel_k1(a)),
        "bessel_k1": (bessel_k1, lambda a: -bessel_k0(a) - bessel_k1(a) / a),
    }
    operators = [
        Operator("add", 2, _infer_add, lambda t, a, b: np.asarray(a) + b, _d_add),
        Operator("sub", 2, _infer_sub, lambda t, a, b: np.asarray(a) - b, _d_sub),
        Operator("mul", 2, _infer_mul, _mul, _d_bilinear(_mul)),
        Operator("div", 2, _infer_div, _div, _d_quotient(_div)),
        Operator("div_guarded", 2, _infer_div, _div_guarded, _d_quotient(_div_guarded)),
        Operator(
            "pow", 2, _infer_pow, lambda t, a, b: np.asarray(a, dtype=float) ** b,
            _d_of_two(_d_base, _d_power),
        ),
        Operator("neg", 1, _infer_neg, lambda t, a: -np.asarray(a), _linear(lambda t, a: -a)),
        Operator(
            "norm", 1, _infer_of_vectors("norm", "scalar", _same), _norm, _d_norm,
            r"\left\|{0}\right\|",
        ),
        Operator(
            "normalize", 1, _infer_of_vectors("normalize", "vector", lambda unit: DIMENSIONLESS),
            _normalize, _d_normalize, r"\widehat{{\left({0}\right)}}",
        ),
        Operator(
            "dot", 2, _infer_of_vectors("dot", "scalar", _times), _dot, _d_bilinear(_dot),
            r"\left({0}\right)\cdot\left({1}\right)",
        ),
        Operator(
            "along", 2, _infer_of_vectors("along", "scalar", _same), _along,
            _d_of_two(lambda t, a, b, change: _along(t, change, b), _d_direction),
            r"\left({0}\right)\cdot\widehat{{\left({1}\right)}}",
        ),
        Operator(
            "project_abs", 2, _infer_of_vectors("project_abs", "scalar", _times), _project_abs,
            _d_of_two(_d_project_abs, lambda t, a, b, change: _d_project_abs(t, b, a, change)),
            r"\operatorname{{project}}\left({0}, {1}\right)",
        ),
        Operator(
            "perp", 1, _infer_of_vectors("perp", "vector", _same), _perp, _linear(_perp),
            r"{{\left({0}\right)}}_{{\perp}}",
        ),
        Operator(
            "cross", 2, _infer_of_vectors("cross", "vector", _times), _cross, _d_bilinear(_cross),
            r"\left({0}\right)\times\left({1}\right)",
        ),
        Operator(
            "does_collide", 4, _infer_contact("does_collide"),
            lambda t, s_i, p_i, s_j, p_j: s_i.collides(p_i, s_j, p_j), None,
            r"\left[{0}\,{2}\ \mathrm{{touch}}\right]",
        ),
        Operator(
            "is_on", 4, _infer_contact("is_on"),
            lambda t, s_i, p_i, s_j, p_j: s_i.is_on(p_i, s_j, p_j), None,
            r"\left[{0}\ \mathrm{{on}}\ {2}\right]",
        ),
    ]  # fmt: skip
    for name, (function, slope) in transcendental.items():
        latex = rf"\operatorname{{{{{name}}}}}\left({{0}}\right)"
        plain[name] = function, slope, _dimensionless(name), latex
    operators += [
        Operator(
            name, 1, _infer_unary(name, unit_of), lambda t, a, f=function: f(a), _d_scalar(slope),
            latex,
        )
        for name, (function, slope, unit_of, latex) in plain.items()
    ]  # fmt: skip
    return _Operators({operator.name: operator for operator in operators})


OPERATORS = _table()


def is_across_in(text, n_dims):
    """Whether what a law's text has across a vector is defined: `perp` in a plane, `cross` not."""
    return f"{'cross' if n_dims == 2 else 'perp'}(" not in text
