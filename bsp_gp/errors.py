"""The exceptions of bsp_gp: one small tree, so that callers can catch what they mean.

Every message says what was found, where, what is allowed and, where one is known, the remedy.
Options are written as on the command line; whoever works in Python is told of arguments.
"""

import contextlib
import re
from contextvars import ContextVar

_IS_SHELL = ContextVar("on the command line", default=False)
_OPTION = re.compile(
    r"""(?<![\w-])--([a-z][a-z-]*)"""
    r"""((?:[ ](?:[\w.]+|"[^"]*")=(?:"[^"]*"|'[^']*'|[^\s;,)"']+))+|[ ][\w-]+(?=$|[;,. )]))?"""
)
_PAIR = re.compile(r"""([\w.]+|"[^"]*")=("[^"]*"|'[^']*'|[^\s;,)"']+)""")
_ARGUMENTS = {"start": "starts", "set": "constants", "overwrite": "overwrite=True",
              "out": "folder", "law": "law", "property": "properties"}  # fmt: skip
_WITH_WORD = ("up", "kind", "latent", "max-levels")
_WITH_NUMBER = ("fps", "dt")


@contextlib.contextmanager
def on_command_line():
    """Meanwhile messages name options of the command line."""
    token = _IS_SHELL.set(True)
    try:
        yield
    finally:
        _IS_SHELL.reset(token)


def in_python(text):
    """A message as whoever reads it can follow: in Python options are arguments.

    Examples
    --------
    >>> in_python("say which it is: --columns scene=Versuch x='Weg'; or --time-limit")
    'say which it is: columns={"scene": "Versuch", "x": "Weg"}; or time_limit'
    """
    return text if _IS_SHELL.get() else _OPTION.sub(_argument, text)


def _argument(match):
    name = _ARGUMENTS.get(match[1], match[1].replace("-", "_"))
    rest = match[2] or ""
    pairs = _PAIR.findall(rest)
    if pairs:
        pairs = [(key.strip('"'), value.strip("\"'")) for key, value in pairs]
        told = ", ".join(f'"{key}": "{value}"' for key, value in pairs)
        return f"{name}={{{told}}}"
    is_number = rest.strip().isdecimal()
    word = rest.strip() if is_number else f'"{rest.strip()}"'
    is_value = match[1] in _WITH_WORD or is_number and match[1] in _WITH_NUMBER
    return f"{name}={word}" if rest and is_value else name + rest


class BspError(Exception):
    """Base of every error that a user of bsp_gp can cause and mend."""

    def __init__(self, *args):
        super().__init__(*(in_python(a) if isinstance(a, str) else a for a in args))


class DataError(BspError):
    """Measured data are unusable; names the file, row and column where they are known.

    Parameters
    ----------
    problem : str
        What was found and what is allowed.
    file, row, column : optional
        Where; `row` counts lines of the file from 1, the header included.
    remedy : str, optional
        What the user can do about it.
    """

    def __init__(self, problem, *, file=None, row=None, column=None, remedy=None):
        self.problem = problem
        self.file = file
        self.row = row
        self.column = column
        self.remedy = remedy
        where = ", ".join(
            f"{label} {value}" if label else str(value)
            for label, value in (("", file), ("line", row), ("column", column))
            if value is not None
        )
        text = f"{where}: {problem}" if where else problem
        super().__init__(f"{text}; {remedy}" if remedy else text)


class UnitError(BspError):
    """A unit is unknown, missing, or does not fit."""


class GrammarError(BspError):
    """A grammar file contradicts itself; names the rule."""


class LawError(BspError):
    """A law that a user typed cannot be read; says where in the text."""


class SettingsError(BspError):
    """A setting or argument is outside of what is allowed."""


class OutputError(BspError):
    """A result cannot be written, or would overwrite an older one."""


class ResourceError(BspError):
    """There is not enough memory for what was asked, or a process was ended for want of it."""


class MissingDependencyError(BspError):
    """An optional package is not installed; the message gives the install command."""


class EvaluationError(BspError):
    """A law has no finite value on these data; searches count it, nothing else catches it."""


class FitError(BspError):
    """A fit did not converge; carries the best estimate so far as `.estimate`."""

    def __init__(self, message, estimate=None, remedy=None):
        super().__init__(f"{message}; {remedy}" if remedy else message)
        self.estimate = estimate
