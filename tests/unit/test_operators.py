import numpy as np
import pytest

from bsp_gp.errors import UnitError
from bsp_gp.language.formula import Call, Constant, Input, Number, evaluate, evaluate_with_gradient
from bsp_gp.language.operators import GUARD, OPERATORS, Type
from bsp_gp.physics.geometry import Shapes
from bsp_gp.units import Unit

SCALAR, VECTOR, POINT, BOOL = (Type(s) for s in ("scalar", "vector", "point", "bool"))
METRE, KILOGRAM = Unit.of(m=1), Unit.of(kg=1)
INF, NAN = np.inf, np.nan


def value(name, *args, types=None):
    args = [a if isinstance(a, Shapes) else np.asarray(a, dtype=float) for a in args]
    if types is None:
        types = [VECTOR if a.ndim else SCALAR for a in args]
    with np.errstate(all="ignore"):
        return OPERATORS[name].evaluate(tuple(types), *args)


@pytest.mark.parametrize(
    ("name", "args", "expected"),
    [
        ("add", (-2, 5), 3),
        ("sub", (-2, 5), -7),
        ("mul", (-2, 5), -10),
        ("mul", (-2, [1, 0]), [-2, 0]),
        ("mul", ([1, -3], 0), [0, 0]),
        ("div", (-2, 4), -0.5),
        ("div", (1, 0), INF),
        ("div", ([4, -2], -2), [-2, 1]),
        ("div_guarded", (-2, 4), -0.5),
        ("div_guarded", ([4, -2], 2), [2, -1]),
        ("neg", (-2,), 2),
        ("neg", ([1, -2],), [-1, 2]),
        ("square", (-3,), 9),
        ("sqrt", (9,), 3),
        ("sqrt", (-1,), NAN),
        ("sqrt", (0,), 0),
        ("abs", (-3,), 3),
        ("abs", (0,), 0),
        ("inverse", (-4,), -0.25),
        ("inverse", (0,), INF),
        ("pow", (2, -3), 0.125),
        ("pow", (-2, 3), -8),
        ("pow", (0, 3), 0),
        ("pow", (0, -1), INF),
        ("pow", (-1, 0.5), NAN),
        ("exp", (-1,), np.exp(-1)),
        ("log", (np.e,), 1),
        ("log", (0,), -INF),
        ("log", (-1,), NAN),
        ("sin", (-np.pi / 2,), -1),
        ("cos", (0,), 1),
        ("tanh", (-1,), np.tanh(-1)),
        ("bessel_k0", (2,), 0.11389387274953344),
        ("bessel_k1", (2,), 0.13986588181652243),
        ("bessel_k1", (0,), INF),
        ("sign", (-3,), -1),
        ("sign", (0,), 0),
        ("norm", ([3, -4],), 5),
        ("norm", ([0, 0],), 0),
        ("normalize", ([3, -4],), [0.6, -0.8]),
        ("normalize", ([0, 0],), [0, 0]),
        ("normalize", ([1e-200, 0],), [0, 0]),  # its square underflows: as good as no vector
        ("dot", ([1, 2], [3, -4]), -5),
        ("dot", ([1, 2, 3], [1, 0, -1]), -2),
        ("along", ([3, 4], [0, -2]), -4),
        ("along", ([3, 4], [0, 0]), 0),
        ("project_abs", ([1, -2], [-3, 4]), 11),
        ("project_abs", ([1, 1], [1, -1]), 2),  # a dot product would be 0
        ("project_abs", ([0, 0], [1, -1]), 0),
        ("perp", ([1, 0],), [0, 1]),
        ("perp", ([0, 1],), [-1, 0]),
        ("cross", ([1, 0, 0], [0, 1, 0]), [0, 0, 1]),
        ("cross", ([0, -2, 0], [0, 0, 3]), [-6, 0, 0]),
    ],
)
def test_values(name, args, expected):
    np.testing.assert_allclose(value(name, *args), expected, rtol=1e-15, atol=1e-15)


def test_every_operator_is_tested_here():
    listed = {case[0] for mark in test_values.pytestmark for case in mark.args[1]}
    assert listed | {"does_collide", "is_on"} == set(OPERATORS)


@pytest.mark.parametrize(
    "divisor", [GUARD, np.nextafter(GUARD, 0), 1e-12, 0.0, -0.0, -1e-12, -1, -1e300]
)
@pytest.mark.parametrize("numerator", [3.0, -3.0, [1.0, -2.0]])
def test_guarded_division_is_zero_at_and_below_the_guard(divisor, numerator):
    assert not np.any(value("div_guarded", numerator, divisor))


def test_guarded_division_divides_above_the_guard():
    assert value("div_guarded", 3.0, np.nextafter(GUARD, 1)) == 3.0 * (1 / np.nextafter(GUARD, 1))


@pytest.mark.parametrize(
    "name",
    ["div_guarded", "norm", "normalize", "dot", "along", "project_abs", "perp", "abs", "square"],
)
def test_finite_on_zeros_and_negatives(name):
    """What the paper's grammar uses must never lose a row to a zero or a sign."""
    operator = OPERATORS[name]
    takes_vectors = name in ("norm", "normalize", "dot", "along", "project_abs", "perp")
    grid = [np.array(v, dtype=float) for v in ([0, 0], [-1, 0], [0, -2], [3, -4])]
    grid = grid if takes_vectors else [np.float64(x) for x in (0.0, -0.0, -2.0, 1e-300, 5.0)]
    for a in grid:
        for b in grid:
            assert np.all(np.isfinite(value(name, *(a, b)[: operator.arity])))


def test_perp_turns_by_plus_90_degrees_and_needs_the_plane():
    rng = np.random.default_rng(1)
    a = rng.normal(size=(5, 2))
    turned = value("perp", a)
    np.testing.assert_array_equal(value("perp", turned), -a)
    np.testing.assert_array_equal(np.sum(a * turned, axis=-1), 0)
    assert np.all(a[:, 0] * turned[:, 1] - a[:, 1] * turned[:, 0] > 0)
    with pytest.raises(UnitError, match="in 3-D use cross"):
        value("perp", [1, 2, 3])


def test_cross_needs_three_dimensions():
    with pytest.raises(UnitError, match="in 2-D use perp"):
        value("cross", [1, 2], [3, 4])


SIGNATURES = {
    "add": ["ss", "vv"], "sub": ["ss", "vv"], "mul": ["ss", "sv", "vs"],
    "div": ["ss", "vs"], "div_guarded": ["ss", "vs"], "pow": ["ss"], "neg": ["s", "v"],
    "norm": ["v"], "normalize": ["v"], "dot": ["vv"], "along": ["vv"], "project_abs": ["vv"],
    "perp": ["v"], "cross": ["vv"], "sqrt": ["s"], "abs": ["s"], "square": ["s"],
    "inverse": ["s"], "exp": ["s"], "log": ["s"], "sin": ["s"], "cos": ["s"], "tanh": ["s"],
    "sign": ["s"], "bessel_k0": ["s"], "bessel_k1": ["s"],
}  # fmt: skip
CASES = [(name, signature) for name, all_ in SIGNATURES.items() for signature in all_]


def draw(rng, name, kind, lead):
    """Random values away from kinks; positive where a logarithm or root is taken."""
    n_dims = 3 if name == "cross" else 2
    size = rng.uniform(0.5, 2.0, (*lead, n_dims) if kind == "v" else lead)
    above_zero = ("sqrt", "log", "pow", "div_guarded", "bessel_k0", "bessel_k1")
    positive = name in above_zero and kind == "s"
    return size if positive else size * rng.choice([-1, 1], size.shape)


@pytest.mark.parametrize(("name", "signature"), CASES)
def test_leading_shapes_broadcast(name, signature):
    rng = np.random.default_rng(2)
    leads = [(4, 1, 3), (5, 1)][: len(signature)]
    args = [draw(rng, name, kind, lead) for kind, lead in zip(signature, leads, strict=True)]
    types = [VECTOR if kind == "v" else SCALAR for kind in signature]
    together = value(name, *args, types=types)
    lead = np.broadcast_shapes(*leads)
    for index in np.ndindex(*lead):
        picked = []
        for kind, arg in zip(signature, args, strict=True):
            tail = arg.shape[-1:] if kind == "v" else ()
            picked.append(np.broadcast_to(arg, (*lead, *tail))[index])
        alone = value(name, *picked, types=types)
        np.testing.assert_allclose(together[index], alone, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(("name", "signature"), CASES)
def test_derivatives_are_exact(name, signature):
    """Against central differences with step h.

    Their error is h^2 f'''/6 + eps |f| / h, below 1e-9 for values of order one and h = 1e-5
    (third derivatives of pow, log and sqrt at 0.5 stay below 30).
    """
    rng = np.random.default_rng(3)
    operator = OPERATORS[name]
    types = tuple(VECTOR if kind == "v" else SCALAR for kind in signature)
    args = [draw(rng, name, kind, (20,)) for kind in signature]
    directions = [rng.uniform(-1, 1, arg.shape) for arg in args]
    h = 1e-5
    patterns = [(True,)] if len(signature) == 1 else [(True, True), (True, False), (False, True)]
    for active in patterns:
        tangents = [d if on else None for d, on in zip(directions, active, strict=True)]
        moved = [d if on else 0 * d for d, on in zip(directions, active, strict=True)]
        up = operator.evaluate(types, *(a + h * d for a, d in zip(args, moved, strict=True)))
        down = operator.evaluate(types, *(a - h * d for a, d in zip(args, moved, strict=True)))
        exact = operator.derivative(types, args, tangents)
        np.testing.assert_allclose(exact, (up - down) / (2 * h), rtol=1e-8, atol=2e-8)


def test_every_operator_but_conditions_has_a_derivative():
    assert {n for n, o in OPERATORS.items() if o.derivative is None} == {"does_collide", "is_on"}
    assert {n for n, _ in CASES} == {n for n, o in OPERATORS.items() if o.derivative is not None}


def test_guarded_division_has_no_slope_where_the_guard_acts():
    formula = Call("div_guarded", Number(1.0), Constant("a"))
    for a, slope in ((2.0, -0.25), (0.0, 0.0), (-2.0, 0.0)):
        _, gradient = evaluate_with_gradient(formula, {}, {"a": a}, ["a"])
        assert gradient["a"] == slope


def test_gradient_of_a_whole_formula():
    """Chain, product and quotient rules together, for constants that share nodes."""
    a, b, r = Constant("a"), Constant("b"), Input("r", Type("vector", METRE))
    u = Call("normalize", Call("add", r, Call("mul", a, r)))
    scalar = Call("exp", Call("neg", Call("div", Call("norm", r), b)))
    formula = Call("mul", Call("mul", Call("pow", Call("norm", r), a), scalar), u)
    inputs = {"r": np.random.default_rng(4).uniform(0.5, 2.0, (7, 2))}
    at = {"a": 0.7, "b": 1.3}
    _, gradient = evaluate_with_gradient(formula, inputs, at, ["a", "b", "absent"])
    assert gradient["absent"] is None
    h = 1e-5
    for name in at:
        up = evaluate(formula, inputs, at | {name: at[name] + h})
        down = evaluate(formula, inputs, at | {name: at[name] - h})
        np.testing.assert_allclose(gradient[name], (up - down) / (2 * h), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "types", "expected"),
    [
        ("add", (Type("scalar", METRE), Type("scalar", METRE)), Type("scalar", METRE)),
        ("add", (Type("scalar", METRE), Type("scalar", None)), Type("scalar", METRE)),
        ("add", (POINT, VECTOR), POINT),
        ("sub", (POINT, POINT), VECTOR),
        ("mul", (Type("scalar", METRE), Type("vector", KILOGRAM)),
         Type("vector", METRE * KILOGRAM)),
        ("mul", (VECTOR, BOOL), VECTOR),
        ("mul", (Type("scalar", None), Type("scalar", METRE)), Type("scalar", None)),
        ("div", (Type("vector", METRE), Type("scalar", KILOGRAM)),
         Type("vector", METRE / KILOGRAM)),
        ("norm", (Type("vector", METRE),), Type("scalar", METRE)),
        ("normalize", (Type("vector", METRE),), VECTOR),
        ("square", (Type("scalar", METRE),), Type("scalar", METRE**2)),
        ("sqrt", (Type("scalar", METRE),), Type("scalar", METRE**0.5)),
        ("along", (Type("vector", METRE), Type("vector", KILOGRAM)), Type("scalar", METRE)),
        ("dot", (Type("vector", METRE),) * 2, Type("scalar", METRE**2)),
        ("does_collide", (Type("shape"), POINT, Type("shape"), POINT), BOOL),
    ],
)  # fmt: skip
def test_types(name, types, expected):
    assert OPERATORS[name].infer(*types) == expected


@pytest.mark.parametrize(
    ("name", "types", "message"),
    [
        ("add", (Type("scalar", METRE), Type("scalar", KILOGRAM)), "adds kg and m"),
        ("sub", (Type("scalar", METRE), Type("scalar", KILOGRAM)), "subtracts kg and m"),
        ("add", (POINT, POINT), "cannot add a point and a point"),
        ("add", (SCALAR, VECTOR), "cannot add a scalar and a vector"),
        ("sub", (VECTOR, POINT), "cannot subtract a point from a vector"),
        ("mul", (VECTOR, VECTOR), "write dot"),
        ("mul", (SCALAR, POINT), "cannot multiply a scalar by a point"),
        ("div", (SCALAR, VECTOR), "cannot divide a scalar by a vector"),
        ("neg", (POINT,), "difference of points"),
        ("norm", (POINT,), "use a difference of points"),
        ("norm", (SCALAR,), "norm takes vectors, got a scalar"),
        ("sqrt", (VECTOR,), "sqrt takes scalars, got a vector"),
        ("exp", (Type("scalar", METRE),), "dimensionless number, got m"),
        ("pow", (SCALAR, Type("scalar", METRE)), "exponent must be dimensionless, got m"),
        ("is_on", (POINT, POINT, Type("shape"), POINT), "is_on takes"),
    ],
)
def test_types_that_do_not_fit(name, types, message):
    with pytest.raises(UnitError, match=message):
        OPERATORS[name].infer(*types)


def test_powers_by_a_number_keep_units_exact():
    length = Input("l_j", Type("scalar", METRE))
    assert Call("pow", length, Number(-3.0)).type.unit == METRE**-3
    assert Call("pow", length, Number(0.5)).type.unit == METRE**0.5
    assert Call("pow", length, Constant("c")).type.unit is None
