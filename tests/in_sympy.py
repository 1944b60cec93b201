"""Formulas of the plane as SymPy has them: what computes them a second time."""

import sympy as sp

from bsp_gp.language.formula import Constant, Input, Number

AXES = "xy"


def norm(vector):
    return sp.sqrt(sum(x**2 for x in vector))


CALLS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "div_guarded": lambda a, b: a / b,
    "neg": lambda a: -a,
    "pow": lambda a, b: a**b,
    "square": lambda a: a**2,
    "inverse": lambda a: 1 / a,
    "sqrt": sp.sqrt,
    "abs": sp.Abs,
    "exp": sp.exp,
    "log": sp.log,
    "sin": sp.sin,
    "cos": sp.cos,
    "tanh": sp.tanh,
    "bessel_k0": lambda a: sp.besselk(0, a),
    "bessel_k1": lambda a: sp.besselk(1, a),
    "sign": sp.sign,
    "norm": norm,
    "normalize": lambda a: a / norm(a),
    "dot": lambda a, b: a.dot(b),
    "along": lambda a, b: a.dot(b) / norm(b),
    "project_abs": lambda a, b: sum(sp.Abs(x * y) for x, y in zip(a, b, strict=True)),
    "perp": lambda a: sp.Matrix([-a[1], a[0]]),
}


def to_sympy(node):
    """A formula without contacts; vectors are matrices of components that are called p_i_x."""
    if isinstance(node, Number):
        if node.text == "pi":
            return sp.pi
        whole = node.value == int(node.value)
        return sp.Integer(int(node.value)) if whole else sp.Float(node.value)
    if isinstance(node, Constant):
        return sp.Symbol(node.name, real=True)
    if not isinstance(node, Input):
        return CALLS[node.operator](*map(to_sympy, node.args))
    if node.type.shape in ("vector", "point"):
        if node.name.startswith("e_"):
            return sp.Matrix([int(axis == node.name[2]) for axis in AXES])
        return sp.Matrix([sp.Symbol(f"{node.name}_{axis}", real=True) for axis in AXES])
    positive = node.name.startswith(("m_", "R_", "mass_", "radius_"))
    return sp.Symbol(node.name, real=True, positive=positive or None)
