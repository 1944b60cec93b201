"""Formulas for people and programs: text that parses back, and LaTeX."""

from bsp_gp.language.formula import Call, Constant, Input, Number, factors
from bsp_gp.language.impulse import impulse_of
from bsp_gp.language.inputs import property_of
from bsp_gp.language.operators import OPERATORS

_INFIX = {
    "add": ("+", 1), "sub": ("-", 1), "mul": ("*", 2), "div": ("/", 2), "div_guarded": ("/", 2),
}  # fmt: skip
_ATOM, _POWER, _NEGATIVE = 9, 4, 3
_OPPOSITE = {"+": "-", "-": "+"}
_GREEK = {"mu": r"\mu", "friction": r"\mu"}
_LATEX_INPUTS = {
    "p_i": r"\mathbf{p}_i",
    "p_j": r"\mathbf{p}_j",
    "p_c": r"\mathbf{c}",
    "v_i": r"\mathbf{v}_i",
    "v_j": r"\mathbf{v}_j",
    "s_i": "i",
    "s_j": "j",
    "t": "t",
    "e_x": r"\hat{\mathbf{x}}",
    "e_y": r"\hat{\mathbf{y}}",
    "e_z": r"\hat{\mathbf{z}}",
    "up": r"\hat{\mathbf{u}}",
    "down": r"\left(-\hat{\mathbf{u}}\right)",
}
_NAMED_VECTORS = {
    ("p_i", "p_j"): r"\mathbf{r}_{ji}",
    ("p_j", "p_i"): r"\mathbf{r}_{ij}",
    ("v_i", "v_j"): r"\mathbf{v}_{ij}",
    ("v_j", "v_i"): r"\mathbf{v}_{ji}",
}


def to_text(formula, values=None, units=None):
    """Write a formula so that `parse_formula` reads the same one back.

    Parameters
    ----------
    values : mapping of str to float, optional
        Constants to write as numbers.
    units : mapping of str to str, optional
        Their units.
    """
    return _text(formula, values or {}, units or {})[0]


def _text(node, values, units):
    """Text of a node and how strongly it binds; kept where no constant has a value."""
    return _written(node, values, units) if values else node.once(_plain)


def _plain(node):
    return _written(node, {}, {})


def _written(node, values, units):
    node = _as_one_number(node, values)
    if isinstance(node, Number):
        text = node.text
        return text, _NEGATIVE if text.startswith("-") else _ATOM
    if isinstance(node, Input):
        return node.name, _ATOM
    if isinstance(node, Constant):
        if node.name not in values:
            return node.name, _ATOM
        text = f"{values[node.name]:.6g}"
        if units.get(node.name) not in (None, "", "1"):
            text += f" [{units[node.name]}]"
        return text, _NEGATIVE if text.startswith("-") else _ATOM
    if component := _component(node):
        return "{}{}_{}".format(*component), _ATOM
    if brief := impulse_of(node):
        return f"impulse({_text(brief[0], values, units)[0]}, {brief[1]!r} [s])", _ATOM
    parts = [_text(arg, values, units) for arg in node.args]
    if node.operator in _INFIX:
        sign, level = _INFIX[node.operator]
        if sign in _OPPOSITE and isinstance(node.args[1], Constant) and parts[1][0][0] == "-":
            sign, parts[1] = _OPPOSITE[sign], (parts[1][0][1:], _ATOM)  # x - -2 is x + 2
        left = _wrap(parts[0], level)
        # The right side of an infix operator keeps its brackets, so that the tree survives.
        right = _wrap(parts[1], level + 1)
        return f"{left} {sign} {right}", level
    if node.operator == "neg":
        return f"-{_wrap(parts[0], 3)}", _NEGATIVE
    if node.operator == "square":
        return f"{_wrap(parts[0], _ATOM)}^2", _POWER
    if node.operator == "pow":
        return f"{_wrap(parts[0], _ATOM)}^{_wrap(parts[1], _NEGATIVE)}", _POWER
    name = "project" if node.operator == "project_abs" else node.operator
    return f"{name}({', '.join(text for text, _ in parts)})", _ATOM


def _as_one_number(node, values):
    """A term times one and a change with a value: its number is written as what it has become."""
    if not isinstance(node, Call) or node.operator != "mul":
        return node
    change, term = node.args
    if not isinstance(change, Call) or change.operator != "add":
        return node
    one, by = change.args
    if not (isinstance(one, Number) and one.value == 1.0 and isinstance(by, Constant)):
        return node
    return (by.name in values and _times(term, 1.0 + values[by.name])) or node


def _times(node, factor):
    """A product with its leading number times a factor; None where none leads it."""
    if isinstance(node, Number):
        digits, *unit = node.text.split(" ", 1)
        if digits.lstrip("-") == "pi":
            return None
        text = " ".join([f"{float(digits) * factor:.6g}", *unit])
        return Number(node.value * factor, node.type.unit, text)
    if isinstance(node, Call) and node.operator in ("mul", "div", "neg"):
        first = _times(node.args[0], factor)
        return first and Call(node.operator, first, *node.args[1:])
    return None


def _wrap(part, level):
    text, own = part
    return text if own >= level else f"({text})"


def to_latex(formula, values=None, units=None):
    """Typeset a formula: vectors bold, fractions and powers drawn, constants with their values."""
    return _latex(formula, values or {}, units or {}, 0)


def _latex(node, values, units, level):
    node = _as_one_number(node, values)
    if isinstance(node, Number):
        return _latex_number(node.text)
    if isinstance(node, Input):
        return _latex_input(node)
    if isinstance(node, Constant):
        if node.name not in values:
            return _latex_name(node.name)
        unit = units.get(node.name)
        tail = rf"\,[\mathrm{{{unit.replace(' ', '~')}}}]" if unit not in (None, "1") else ""
        return _latex_number(f"{values[node.name]:.4g}") + tail
    if component := _component(node):
        speed, axis, role = component
        return rf"v_{{{axis},{role}}}" if speed else rf"{axis}_{role}"
    if brief := impulse_of(node):
        return rf"\delta\left({_latex(brief[0], values, units, 0)}\right)"
    if node.operator in ("mul", "div", "div_guarded"):
        return _latex_product(node, values, units)
    if node.operator in ("add", "sub"):
        named = _named_difference(node)
        if named:
            return named
        left, right = (_latex(arg, values, units, 1) for arg in node.args)
        is_sum = isinstance(node.args[1], Call) and node.args[1].operator in ("add", "sub")
        if node.operator == "sub" and is_sum:
            right = rf"\left({right}\right)"
        text = f"{left} {'+' if node.operator == 'add' else '-'} {right}"
        return rf"\left({text}\right)" if level > 1 else text
    if node.operator == "neg":
        return f"-{_latex(node.args[0], values, units, 2)}"
    if node.operator in ("square", "pow"):
        # Every argument is typeset once: twice would double the work at every level.
        base = _latex(node.args[0], values, units, 2)
        power = "2" if node.operator == "square" else _latex(node.args[1], values, units, 1)
        closed = ("norm", "add", "sub", "abs")
        if isinstance(node.args[0], Call) and node.args[0].operator not in closed:
            base = rf"\left({base}\right)"
        return f"{base}^{{{power}}}"
    if node.operator == "normalize" and _named_difference(node.args[0]):
        return _hat(_named_difference(node.args[0]))
    if node.operator == "normalize" and isinstance(node.args[0], Input):
        return _hat(_latex_input(node.args[0]))
    if node.operator == "norm" and _named_difference(node.args[0]):
        return _named_difference(node.args[0]).replace(r"\mathbf", "")
    parts = [_latex(arg, values, units, 1) for arg in node.args]
    return OPERATORS[node.operator].latex.format(*parts)


def _hat(vector):
    """A hat on the letter, not on its index."""
    letter, mark, index = vector.partition("_")
    return rf"\hat{{{letter}}}{mark}{index}"


def _latex_product(node, values, units):
    if node.operator == "div_guarded":
        above, below = [node.args[0]], [node.args[1]]
    else:
        above, below = factors(node, impulse_of)
    sign = ""
    kept = []
    for factor in above:
        if isinstance(factor, Number) and factor.value == -1.0 and len(above) > 1:
            sign = "-" if not sign else ""
        elif isinstance(factor, Call) and factor.operator == "inverse":
            below = [*below, factor.args[0]]
        else:
            kept.append(factor)

    def joined(parts):
        return r"\,".join(_latex(part, values, units, 2) for part in parts) or "1"

    if not below:
        return sign + joined(kept)
    scalars = [f for f in kept if f.type.shape != "vector"]
    vectors = [f for f in kept if f.type.shape == "vector"]
    text = rf"\frac{{{joined(scalars)}}}{{{joined(below)}}}"
    return sign + (text + r"\," + joined(vectors) if vectors else text)


def _component(node):
    """Of ``dot(p_i - origin, e_x)``, or of a velocity: ("", "x", "i"), ("v", "x", "i"); or None."""
    if not (isinstance(node, Call) and node.operator == "dot"):
        return None
    vector, axis = node.args
    if not (isinstance(axis, Input) and axis.name in ("e_x", "e_y", "e_z")):
        return None
    if isinstance(vector, Call) and vector.operator == "sub":
        names = [arg.name if isinstance(arg, Input) else "" for arg in vector.args]
        is_place = names[0] in ("p_i", "p_j") and names[1] == "origin"
        return ("", axis.name[-1], names[0][-1]) if is_place else None
    is_speed = isinstance(vector, Input) and vector.name in ("v_i", "v_j")
    return ("v", axis.name[-1], vector.name[-1]) if is_speed else None


def _named_difference(node):
    if isinstance(node, Call) and node.operator == "sub":
        names = tuple(arg.name if isinstance(arg, Input) else None for arg in node.args)
        return _NAMED_VECTORS.get(names)
    return None


def _latex_input(node):
    if node.name in _LATEX_INPUTS:
        return _LATEX_INPUTS[node.name]
    stem, _, role = node.name.rpartition("_")
    column = property_of(node.name)
    if len(stem) > 1:
        words = stem.replace("_", "\\ ")
        stem = _GREEK.get(stem, rf"\mathrm{{{words}}}")
    return rf"{stem}_{role}" if column else _latex_name(node.name)


def _latex_name(name):
    name, _, index = name.rstrip("]").partition("[")
    head = name.rstrip("0123456789")
    digits = name[len(head) :]
    head = head.strip("_").replace("_", "\\ ")
    head = head if len(head) == 1 else rf"\mathrm{{{head}}}"
    below = ",".join(filter(None, (digits, index and rf"\mathrm{{{index}}}")))
    return f"{head}_{{{below}}}" if below else head


def _latex_number(text):
    if text.removeprefix("-") == "pi":
        return text.replace("pi", r"\pi")
    number, _, unit = text.partition(" [")
    mantissa, e, exponent = number.lower().partition("e")
    out = rf"{mantissa}\times 10^{{{int(exponent)}}}" if e else mantissa
    if unit:
        unit = unit.rstrip("]").replace(" ", "~")
        out += rf"\,[\mathrm{{{unit}}}]"
    return out
