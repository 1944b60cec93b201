"""Regressions with certified answers: NIST's Statistical Reference Datasets, read from its files.

The models are read as formulas of our language, derivatives included; the one with an arctangent,
which the language does not have, is written here.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.problem import Linearised
from bsp_gp.language.formula import evaluate_with_gradient
from bsp_gp.language.operators import Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.units import DIMENSIONLESS

MOST_DIGITS = 11
"""Of the certificates."""
_DATA = 60
"""Lines above the data in every file."""


@dataclass(frozen=True)
class Dense:
    """A plain problem: ``residual(x) -> (n,)`` and ``jacobian(x) -> (n, k)``, points are arrays."""

    residual: Callable
    jacobian: Callable

    def values(self, point):
        return np.asarray(point, dtype=float)

    def linearise(self, point):
        point = self.values(point)
        residual = np.asarray(self.residual(point), dtype=float)
        if not np.isfinite(residual).all():
            return None
        jacobian = np.asarray(self.jacobian(point), dtype=float)
        return Linearised(residual, jacobian) if np.isfinite(jacobian).all() else None

    def move(self, point, linearised, values, share, reins):
        return values


@dataclass(frozen=True, eq=False)
class Regression:
    """A problem with its certificate.

    Attributes
    ----------
    name, level : str
    starts : ndarray, shape (2, k)
    certified, errors : ndarray, shape (k,)
        Parameters and their standard errors.
    chisqr : float
        Certified residual sum of squares.
    model : callable
        ``model(values) -> (residual, jacobian)``.
    """

    name: str
    level: str
    starts: np.ndarray
    certified: np.ndarray
    errors: np.ndarray
    chisqr: float
    model: Callable

    def residual(self, values):
        return self.model(values)[0]

    def jacobian(self, values):
        return self.model(values)[1]

    def digits(self, values):
        """Correct digits of the worst parameter, 0 to 11."""
        error = np.max(np.abs(values - self.certified) / np.abs(self.certified))
        return float(np.clip(-np.log10(max(error, 10.0**-MOST_DIGITS)), 0, MOST_DIGITS))


def read_problem(path):
    """A problem from its file."""
    text = path.read_text("ascii")
    body = "".join(text.splitlines(keepends=True)[_DATA:])
    data = np.array(body.split(), dtype=float)
    header = re.search(r"^Data:[ ]+(y.*)$", text.split("Residual Sum")[1], re.MULTILINE)
    columns = header.group(1).split()
    data = dict(zip(columns, data.reshape(-1, len(columns)).T, strict=True))
    rows = re.findall(r"^ *b\d+ =(.*)$", text, re.MULTILINE)
    table = np.array([row.split() for row in rows], dtype=float)
    return Regression(
        name=path.stem, level=re.search(r"(\w+) Level of Difficulty", text).group(1),
        starts=table[:, :2].T, certified=table[:, 2], errors=table[:, 3],
        chisqr=float(re.search(r"Residual Sum of Squares: +(\S+)", text).group(1)),
        model=_model(text, data),
    )  # fmt: skip


def _model(text, data):
    left, right = re.search(r"\n +(\S*y\S*) +=(.*?)\+ +e\s", text, re.DOTALL).groups()
    observed = np.log(data["y"]) if left.startswith("log") else data["y"]
    if "arctan" in right:
        return _arctangent(data["x"], observed)
    law = right.replace("[", "(").replace("]", ")").replace("pi", repr(np.pi))
    inputs = {name: column for name, column in data.items() if name != "y"}
    types = dict.fromkeys(inputs, Type("scalar", DIMENSIONLESS))
    formula = parse_formula(" ".join(law.split()), types)
    names = sorted(formula.constants)

    def model(values):
        constants = dict(zip(names, values, strict=True))
        value, slopes = evaluate_with_gradient(formula, inputs, constants, names)
        columns = [np.broadcast_to(slopes[name], observed.shape) for name in names]
        return observed - value, -np.stack(columns, axis=1)

    return model


def _arctangent(x, y):
    """Of Roszman1: our language has no arctangent."""

    def model(values):
        b1, b2, b3, b4 = values
        away = x - b4
        whole = np.pi * (away**2 + b3**2)
        slopes = np.stack([np.ones_like(x), -x, -away / whole, -b3 / whole], axis=1)
        return y - (b1 - b2 * x - np.arctan(b3 / away) / np.pi), -slopes

    return model
