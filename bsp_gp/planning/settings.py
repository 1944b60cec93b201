"""Settings of an apparatus, and numbers of bodies that follow from them: ``speed * cos(angle)``."""

import ast
import math
import operator

from bsp_gp.errors import SettingsError

_FUNCTIONS = {"sin": math.sin, "cos": math.cos, "tan": math.tan, "sqrt": math.sqrt}
_NUMBERS = {"pi": math.pi}
_BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: math.pow,
}  # fmt: skip
_UNARY = {ast.UAdd: operator.pos, ast.USub: operator.neg}
MOST_LETTERS = 200
"""Of a formula."""
RESERVED = frozenset((*_FUNCTIONS, *_NUMBERS))
"""Names that no setting may have."""


class Following:
    """A number that follows from the settings of an apparatus.

    Parameters
    ----------
    text : str
        Numbers, names of settings, ``pi``, ``+ - * / **``, brackets, sin, cos, tan (of radians)
        and sqrt. It is read as a tree, and never run as code.
    names : collection of str
        Of the settings.

    Raises
    ------
    SettingsError
        If it is anything else.
    """

    def __init__(self, text, names):
        self.text, self.names = text, frozenset(names)
        if len(text) > MOST_LETTERS:
            raise SettingsError(f"{text[:40]!r}... is longer than {MOST_LETTERS} letters")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise SettingsError(f"{text!r} is no formula") from error
        self._value(self._tree, dict.fromkeys(names, 1.0), is_checked=True)

    def __repr__(self):
        return f"Following({self.text!r})"

    def __eq__(self, other):
        return isinstance(other, Following) and self.text == other.text

    def __hash__(self):
        return hash(self.text)

    def __call__(self, settings):
        """Its number where the settings are these, name -> float."""
        value = self._value(self._tree, settings)
        if not math.isfinite(value):
            raise SettingsError(f"{self.text!r} is no finite number where {_told(settings)}")
        return value

    def _value(self, node, settings, is_checked=False):
        """The number of a node; nan for what cannot be computed where only its form is checked."""
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return float(node.value)
        if isinstance(node, ast.Name) and node.id in settings:
            return float(settings[node.id])
        if isinstance(node, ast.Name) and node.id in _NUMBERS:
            return _NUMBERS[node.id]
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            form, parts = _BINARY[type(node.op)], (node.left, node.right)
        elif isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
            form, parts = _UNARY[type(node.op)], (node.operand,)
        elif _is_call(node):
            form, parts = _FUNCTIONS[node.func.id], node.args
        else:
            raise SettingsError(
                f"{ast.unparse(node)!r} in {self.text!r} is neither a number nor a setting "
                f"({', '.join(sorted(self.names)) or 'there are none'}); there are also pi, "
                f"+ - * / ** and {', '.join(_FUNCTIONS)}"
            )
        try:
            return form(*(self._value(part, settings, is_checked) for part in parts))
        except (ArithmeticError, ValueError):
            if is_checked:
                return math.nan
            raise SettingsError(f"{self.text!r} is no number where {_told(settings)}") from None


def _is_call(node):
    """Whether a node is a known function of one number."""
    is_named = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    return is_named and node.func.id in _FUNCTIONS and len(node.args) == 1 and not node.keywords


def _told(settings):
    return ", ".join(f"{name} = {value:g}" for name, value in settings.items()) or "nothing is set"
