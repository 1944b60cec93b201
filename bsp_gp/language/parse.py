"""Laws as people type them -> formulas. Nothing is ever evaluated as code.

``c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)``; a number may carry its unit in
brackets, ``9.81 [m/s^2]``; a name that is no input is a constant to fit, ``c[body]`` and
``c[scene]`` constants of which every receiver or scene has its own. ``x_i`` and ``vx_i`` are
components of place and velocity; ``pi`` is the number. Where places are angles, ``sin(x_i)`` is
that of one.
"""

import ast
import contextlib
import math
import re
from collections.abc import Mapping

from bsp_gp.errors import LawError, UnitError
from bsp_gp.language.formula import Call, Constant, Input, Number
from bsp_gp.language.impulse import impulse
from bsp_gp.language.inputs import ALIASES, STATE_INPUTS, property_of
from bsp_gp.language.operators import OPERATORS
from bsp_gp.language.radian import OF_ANGLES, in_radians
from bsp_gp.units import DIMENSIONLESS, parse_unit

MAX_LENGTH = 2000
MAX_NESTING = 60
MAX_DEPTH = 200
"""Operators below one another, chains such as a + b + c + ... included."""
MAX_EXPONENT = 99
_TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?:\s*\[(?P<unit>[^\[\]]*)\])?
    | (?P<name>[A-Za-z][A-Za-z0-9_]*)(?:\s*\[(?P<index>body|scene)\])?
    | (?P<op>\*\*|[-+*/^(),])
    )""",
    re.VERBOSE,
)
_COMPONENT = re.compile(r"(v?)([xyz])_([ij])")
_BINARY = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.Pow: "pow"}
_CONVENIENCE = {"unit": "normalize", "magnitude": "norm"}
_IMPULSE = "impulse(t - 0.5 [s], 0.001 [s])"


def parse_formula(text, types: Mapping, *, operators: Mapping | None = None, units=None):
    """Read a typed law as a Formula.

    Parameters
    ----------
    types : mapping of str to Type
        The inputs that exist (`bsp_gp.language.inputs.input_types`).
    operators : mapping of str to str, optional
        What `div` and `project` mean in the grammar at hand; by default plain division, and no
        `project`.
    units : UnitSystem, optional
        Of the data: a number with a unit that the data are not calibrated in is an error.

    Raises
    ------
    LawError
        With the place in the text, for anything that is not a law.
    """
    if not isinstance(text, str) or not text.strip():
        raise LawError("a law must be a text such as 'c1 * m_i * down', got nothing")
    if len(text) > MAX_LENGTH:
        raise LawError(f"a law must be at most {MAX_LENGTH} characters long, got {len(text)}")
    source, numbers = _tokenise(text, units)
    try:
        tree = ast.parse(source, mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        place = getattr(error, "offset", None)
        where = f" near position {place}" if place else ""
        raise LawError(f"law {_short(text)} cannot be read{where}: {_reason(error)}") from None
    is_angle = units is not None and units.is_angle
    return _Builder(text, types, dict(operators or {}), numbers, is_angle).build(tree)


def _short(text):
    return repr(text if len(text) <= 80 else text[:77] + "...")


def _reason(error):
    if not isinstance(error, SyntaxError):
        return "too deeply nested"
    return error.msg or "bad syntax"


def _tokenise(text, units):
    """Rewrite to Python's syntax: units taken out, ``^`` is a power; returns (source, numbers)."""
    pieces, numbers, position, depth = [], {}, 0, 0
    stripped = text.rstrip()
    while position < len(stripped):
        match = _TOKEN.match(stripped, position)
        if not match:
            rest = stripped[position:].lstrip()
            raise LawError(
                f"law {_short(text)}: unexpected {rest[:1]!r} at position "
                f"{len(stripped) - len(rest) + 1}; allowed are names, numbers with a [unit], "
                "calls, + - * / ^ ( ), and a constant's [body] or [scene]"
            )
        position = match.end()
        if match["number"]:
            placeholder = f"number__{len(numbers)}"
            numbers[placeholder] = _number(match["number"], match["unit"], text, units)
            pieces.append(placeholder)
        elif match["name"]:
            if "__" in match["name"]:
                raise LawError(f"law {_short(text)}: a name must not contain '__'")
            pieces.append("__".join(filter(None, (match["name"], match["index"]))))
        else:
            operator = match["op"]
            depth += (operator == "(") - (operator == ")")
            if depth > MAX_NESTING:
                raise LawError(f"law {_short(text)} is nested more than {MAX_NESTING} deep")
            pieces.append("**" if operator == "^" else operator)
    return " ".join(pieces), numbers


def _number(digits, unit_text, text, units):
    value = float(digits)
    if unit_text is None:
        return Number(_finite(value, digits, text), text=digits)
    try:
        scale, unit = parse_unit(unit_text)
    except UnitError as error:
        raise LawError(f"law {_short(text)}: {error}") from None
    if units is not None and not units.is_calibrated(unit):
        if set(units.symbols.values()) == {"mass"}:
            seen = units.remedies.get("kg")
            raise LawError(
                f"law {_short(text)}: [{unit_text.strip()}] needs masses, and the data do not say "
                f"what they are; {f'{seen}; or ' if seen else ''}give them with --property "
                "mass=0.3[kg], or where they have masses the unit of those with --units mass=kg"
            )
        raise LawError(
            f"law {_short(text)}: [{unit_text.strip()}] cannot be compared with the data, which do "
            f"not say what their {' and '.join(sorted(set(units.symbols.values())))} are in SI; "
            "declare them under [units] in dataset.toml, or with --units length=m time=s (or au, "
            'yr; of pixels the length of one, "length=2.43 mm"); a mass is given with --property '
            "mass=0.3[kg] (or Msun)"
        )
    return Number(_finite(value * scale, digits, text), unit, f"{digits} [{unit_text.strip()}]")


def _finite(value, digits, text):
    if value == float("inf"):
        raise LawError(f"law {_short(text)}: the number {_short(digits)} is too large")
    return value


class _Builder:
    """Turns the whitelisted part of Python's syntax tree into a Formula."""

    def __init__(self, text, types, operators, numbers, is_angle=False):
        self.text, self.is_angle = text, is_angle
        self.types = types
        self.operators = operators
        self.numbers = numbers
        self.depth = 0

    def fail(self, problem):
        raise LawError(f"law {_short(self.text)}: {problem}")

    def call(self, operator, *args):
        try:
            return Call(operator, *args)
        except UnitError as error:
            if self.is_angle and operator in OF_ANGLES:
                with contextlib.suppress(UnitError):
                    return Call(operator, *map(in_radians, args))
            away = self.from_origin(args)
            if away is not None and operator != "add":
                with contextlib.suppress(UnitError):
                    return Call(operator, *away)
            self.fail(str(error))

    def from_origin(self, args):
        """The same with places as ways from the origin, as people write them: -k * p_i."""
        if "origin" not in self.types or all(arg.type.shape != "point" for arg in args):
            return None
        origin = Input("origin", self.types["origin"])
        return [Call("sub", a, origin) if a.type.shape == "point" else a for a in args]

    def build(self, node):
        self.depth += 1
        if self.depth > MAX_DEPTH:
            self.fail(f"more than {MAX_DEPTH} operators below one another; shorten the law")
        formula = self.node(node)
        self.depth -= 1
        return formula

    def node(self, node):
        if isinstance(node, ast.Name):
            return self.name(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            argument = self.build(node.operand)
            if isinstance(argument, Number):
                return Number(-argument.value, argument.type.unit, f"-{argument.text}")
            return self.call("neg", argument)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd):
            return self.build(node.operand)
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            return self.binary(_BINARY[type(node.op)], node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self.function(node.func.id, [self.build(arg) for arg in node.args])
        if isinstance(node, ast.Tuple) and self.depth > 1:
            return self.place([self.build(part) for part in node.elts])
        self.fail("only names, numbers, calls, places such as (a, b) and arithmetic are allowed")

    def binary(self, operator, node):
        left, right = self.build(node.left), self.build(node.right)
        if operator == "pow":
            self.require_bare_exponent(right)
            if isinstance(right, Number) and right.value == 2:
                return self.call("square", left)
            if isinstance(right, Number) and abs(right.value) > MAX_EXPONENT:
                self.fail(f"an exponent must be at most {MAX_EXPONENT}, got {right.value:g}")
            return self.call("pow", left, right)
        return self.call(self.operators.get(operator, operator), left, right)

    def require_bare_exponent(self, exponent):
        if isinstance(exponent, Number) and exponent.type.unit != DIMENSIONLESS:
            number, _, unit = exponent.text.partition(" ")
            self.fail(
                f"the exponent {exponent.text} has a unit; write the unit after another number of "
                f"the product, as in 4 {unit} * pi^{number}"
            )

    def function(self, name, args):
        if name == "impulse":
            return self.impulse(args)
        operator = self.operators.get(name, _CONVENIENCE.get(name, name))
        if operator not in OPERATORS:
            near = _nearest(name, (*OPERATORS, *_CONVENIENCE))
            self.fail(
                f"unknown function {name!r}; "
                + (f"did you mean {near}? " if near else "")
                + f"known are {', '.join(sorted(OPERATORS))}"
            )
        if len(args) != OPERATORS[operator].arity:
            self.fail(f"{name} takes {OPERATORS[operator].arity} argument(s), got {len(args)}")
        return self.call(operator, *args)

    def impulse(self, args):
        if len(args) != 2:
            self.fail(f"impulse takes when and how long, as in {_IMPULSE}, got {len(args)}")
        try:
            return impulse(*args)
        except UnitError as error:
            self.fail(f"{error}, as in {_IMPULSE}")

    def name(self, name):
        if name in self.numbers:
            return self.numbers[name]
        name, _, index = name.partition("__")
        if index:
            if not isinstance(self.name(name), Constant):
                self.fail(f"only constants have an index, and {name!r} is none")
            return Constant(f"{name}[{index}]")
        if name in self.types:
            return Input(name, self.types[name])
        if name == "pi":
            return Number(math.pi, text="pi")
        component = _COMPONENT.fullmatch(name)
        if component and {f"p_{component[3]}", f"e_{component[2]}"} <= self.types.keys():
            return self.component(*component.groups())
        if name in ("up", "down"):
            self.fail(
                f'{name!r} needs a declared vertical: [axes] up = "y" in dataset.toml, or --up y; '
                "--up x where the height is called x (motion along one axis), "
                "--up=-x where it counts down"
            )
        if name == "e_z":
            self.fail("e_z does not exist in two dimensions")
        if name == "p_c":
            self.fail("p_c needs entities with an extent (disc, rect_wall, rect_mat)")
        if name in STATE_INPUTS:
            self.fail(f"{name!r} needs a second body, and every scene of the data has one only")
        if name in OPERATORS:
            self.fail(f"{name!r} is a function and needs arguments")
        self._reject_near_property(name)
        self._reject_misspelling(name)
        return Constant(name)

    def place(self, parts):
        """``(a, b)``, the point with these coordinates, as in a constraint."""
        axes = [f"e_{axis}" for axis in "xyz" if f"e_{axis}" in self.types]
        if len(parts) == 2:  # in the plane z = 0, in which everything may lie
            axes = axes[:2]
        if len(parts) != len(axes):
            self.fail(f"a place has {len(axes)} coordinates here, got {len(parts)}")
        place = self.name("origin")
        for part, axis in zip(parts, axes, strict=True):
            place = self.call("add", place, self.call("mul", part, self.name(axis)))
        return place

    def component(self, speed, axis, role):
        """``x_i``, a coordinate of a place, or ``vx_i``, a component of a velocity."""
        vector = self.name(f"v_{role}" if speed else f"p_{role}")
        vector = vector if speed else self.call("sub", vector, self.name("origin"))
        return self.call("dot", vector, self.name(f"e_{axis}"))

    def _reject_near_property(self, name):
        """A misspelt property must not silently become a constant to fit."""
        known = property_of(name)
        present = sorted(n for n in self.types if property_of(n))
        if known is not None:
            self.fail(
                f"the data have no property {known[0]!r} (wanted by {name!r}); "
                f"present are {', '.join(present) or 'none'}; give it with --property "
                f'{known[0]}=1.2, body by body with --property {known[0]}="star1:1.2,star2:0.8", '
                "or in entities.csv; a constant to fit must not end in _i or _j"
            )
        columns = {property_of(n)[0] for n in present}
        if name in columns or ALIASES.get(name) in columns:
            self.fail(
                f"{name!r} is a property; write {name}_i for the receiver or {name}_j for the "
                "source, or give the constant another name"
            )
        if name in ("p", "v", "r", "x", "y", "z"):
            self.fail(f"{name!r} is not defined; write p_i, p_j, v_i, v_j or norm(p_i - p_j)")

    def _reject_misspelling(self, name):
        """Nor must an input with one letter wrong."""
        near = _nearest(name, {n for n in (*self.types, *STATE_INPUTS) if len(n) > 2})
        if near:
            self.fail(
                f"{name!r} is no input, and differs from {near!r} by one letter; write {near}, or "
                "give the constant to fit a name that differs more"
            )


def _nearest(name, allowed):
    """The first of the allowed names that is one slip away, None if none is.

    A slip is one letter too many, missing or wrong, or two neighbours swapped (the distance 1 of
    Damerau, Commun. ACM 7, 171, 1964). A digit (c1, v_0) and another letter in a name of three
    (v_t, m_x) are none: so people tell constants from inputs.
    """
    if len(name) < 2:
        return None
    return next((other for other in sorted(allowed) if _is_slip(name, other)), None)


def _is_slip(name, other):
    short, long = sorted((name, other), key=len)
    if len(long) - len(short) > 1 or name == other:
        return False
    start = next((k for k, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), None)
    start = len(short) if start is None else start
    if len(short) < len(long):
        is_one, changed = short[start:] == long[start + 1 :], long[start]
    else:
        is_one, changed = short[start + 1 :] == long[start + 1 :], name[start]
        swapped = long[:start] + long[start : start + 2][::-1] + long[start + 2 :]
        is_one = (is_one and len(name) > 3) or short == swapped
    return is_one and not changed.isdigit()
