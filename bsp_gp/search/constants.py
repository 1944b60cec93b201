"""The inner level: the best constants of a law on a regression.

Constants that enter linearly are solved in closed form; the others by scipy's L-BFGS-B with
exact gradients (paper, section 3.3.1), from several starts where asked, each start with the
linear ones solved first.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.physics.force import Term, split_linear

START_SCALES = (1.0, 0.1, 10.0, 0.01, 100.0, -1.0, 1e-3, 1e3, 2.0, 0.5)


@dataclass(frozen=True, eq=False)
class ConstantFit:
    """Best constants on a regression.

    Attributes
    ----------
    law : ForceLaw
    parameters : tuple of (name, entity)
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        For the sigma of the regression, not rescaled by the misfit.
    residual : ndarray, shape (n,)
        Whitened.
    jacobian : ndarray, shape (n, k)
        Whitened derivatives of the prediction: the columns to project out of later terms.
    loss : float
        Half the whitened residual sum of squares, nats.
    """

    law: object
    parameters: tuple
    values: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    loss: float


def linear_columns(regression, law):
    """Columns of a law that is linear in all its constants; None if it is not.

    Returns
    -------
    fixed : ndarray, shape (n,)
        Whitened acceleration of the terms without constants.
    columns : ndarray, shape (n, k)
    parameters : tuple of (name, entity)
    """
    fixed = np.zeros(regression.target().shape)
    columns = {}
    for term in law.terms:
        if not term.formula.constants:
            fixed = fixed + regression.column(term)[0][:, 0]
            continue
        name, rest = split_linear(term.formula)
        if name is None or rest.constants:
            return None
        own = isinstance(law.constants.get(name), Mapping)
        values, names = regression.column(Term(rest, term.kind), per_entity=own)
        for k, entity in enumerate(names):
            if own and entity not in law.constants[name]:
                continue
            key = (name, entity if own else "")
            columns[key] = columns.get(key, 0.0) + values[:, k]
    parameters = tuple(columns)
    matrix = (
        np.stack([columns[key] for key in parameters], axis=1)
        if columns
        else np.zeros((len(fixed), 0))
    )
    return fixed, matrix, parameters


def fit_constants(regression, law, *, starts=1):
    """Fit all constants of a law to a regression.

    Parameters
    ----------
    law : ForceLaw
        Values of its constants are start values; per-entity constants must enter linearly.
    starts : int
        Start points for constants that do not enter linearly; the first is the given one.

    Raises
    ------
    EvaluationError
        If the law has no finite value on the data from any start, or its forces are so small
        that its constant is beyond the range of numbers.
    """
    law = law.with_constants({n: law.constants.get(n, 1.0) for n in law.names})
    linear = linear_columns(regression, law)
    target = regression.target()
    if linear is not None:
        fixed, matrix, parameters = linear
        with np.errstate(over="ignore", invalid="ignore"):
            is_sayable = np.isfinite(matrix).all() and np.isfinite(fixed @ fixed)
        if not is_sayable:
            raise EvaluationError(
                "accelerations under the law, or their squares, are beyond the range of numbers"
            )
        values, covariance, residual = _least_squares(matrix, target - fixed)
        if not np.isfinite(values).all():
            raise EvaluationError(
                "the law is next to nothing on the data: no number is its constant"
            )
        return _fit(law, parameters, values, covariance, residual, matrix)
    return _fit_nonlinear(regression, law, starts)


def _least_squares(matrix, y):
    if not matrix.shape[1]:
        return np.zeros(0), np.zeros((0, 0)), y
    top = np.max(np.abs(matrix), axis=0)
    top = np.where(top > 0, top, 1.0)
    size = np.linalg.norm(matrix / top, axis=0) * top  # columns beyond 1e154 do not overflow
    scaled = matrix / np.where(size > 0, size, 1.0)
    values, *_ = np.linalg.lstsq(scaled, y, rcond=1e-13)
    covariance = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    residual = y - scaled @ values
    # Columns near the least number there is have constants beyond the greatest: not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        unscale = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
        return values * unscale, covariance * np.outer(unscale, unscale), residual


def _fit(law, parameters, values, covariance, residual, jacobian):
    return ConstantFit(
        law.with_values(parameters, values), tuple(parameters), np.asarray(values), covariance,
        residual, jacobian, 0.5 * float(residual @ residual),
    )  # fmt: skip


def _fit_nonlinear(regression, law, starts):
    names = law.names
    first = np.array([law.constants[n] for n in names], dtype=float)
    nonlinear = _nonlinear_names(law)
    best = None
    failed = 0
    for scale in START_SCALES[:starts]:
        x0 = np.array(
            [v * scale if n in nonlinear else v for n, v in zip(names, first, strict=True)]
        )
        try:
            value, x = _descend(regression, law, names, x0, nonlinear)
        except EvaluationError:
            failed += 1
            continue
        if best is None or value < best[0]:
            best = (value, x)
    if best is None:
        raise EvaluationError(f"the law has no finite value from any of {failed} starts")
    x = best[1]
    law = law.with_constants(dict(zip(names, x, strict=True)))
    jacobian = _jacobian(regression, law, names)
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    return _fit(
        law, tuple((n, "") for n in names), x, covariance, regression.residual(law), jacobian
    )


def _descend(regression, law, names, x0, nonlinear):
    """L-BFGS-B from one start over the constants that do not enter linearly.

    The linear ones are solved in closed form at every step (variable projection, Golub and
    Pereyra 1973); at their optimum the gradient by the others is that of the full problem.
    """
    from scipy.optimize import minimize

    moving = [k for k, n in enumerate(names) if n in nonlinear]
    x = _solve_linear(regression, law, names, x0, nonlinear)
    top = max(_value_and_gradient(regression, law, names, x)[0], 1e-300)
    unit = np.where(x != 0, np.abs(x), 1.0)[moving]
    best = {"value": np.inf, "x": x}

    def scaled(z):
        try:
            trial = np.array(best["x"])
            trial[moving] = z * unit
            trial = _solve_linear(regression, law, names, trial, nonlinear)
            value, gradient = _value_and_gradient(regression, law, names, trial)
        except EvaluationError:
            return 1e300, np.zeros(len(z))  # a wall for the line search, not a fit
        if value < best["value"]:
            best.update(value=value, x=trial)
        return value / top, gradient[moving] * unit / top

    options = {"maxiter": 500, "ftol": 1e-15, "gtol": 1e-12}
    minimize(scaled, x[moving] / unit, jac=True, method="L-BFGS-B", options=options)
    if not np.isfinite(best["value"]):
        raise EvaluationError("the law has no finite value from this start")
    return best["value"], best["x"]


def _nonlinear_names(law):
    linear = set()
    for term in law.terms:
        name, _ = split_linear(term.formula)
        if name is not None and sum(name in t.formula.constants for t in law.terms) == 1:
            linear.add(name)
    return set(law.names) - linear


def _jacobian(regression, law, names):
    columns = {n: 0.0 for n in names}
    for term in law.terms:
        for name, column in regression.gradient(law, term).items():
            columns[name] = columns[name] + column
    n = len(regression.target())
    return np.stack([np.broadcast_to(columns[name], (n,)) for name in names], axis=1)


def _value_and_gradient(regression, law, names, x):
    law = law.with_constants(dict(zip(names, x, strict=True)))
    residual = regression.residual(law)
    with np.errstate(over="ignore", invalid="ignore"):
        value = 0.5 * float(residual @ residual)
        gradient = -_jacobian(regression, law, names).T @ residual
    if not (np.isfinite(value) and np.isfinite(gradient).all()):
        raise EvaluationError("the residual or its derivative is too large to be squared")
    return value, gradient


def _solve_linear(regression, law, names, x, nonlinear):
    """Closed form for the linear constants at the given values of the others."""
    free = [k for k, n in enumerate(names) if n not in nonlinear]
    if not free:
        return x
    law = law.with_constants(dict(zip(names, x, strict=True)))
    jacobian = _jacobian(regression, law, names)[:, free]
    x = np.array(x, dtype=float)
    current = x[free]
    with np.errstate(over="ignore", invalid="ignore"):
        residual = regression.residual(law) + jacobian @ current
    if not (np.isfinite(jacobian).all() and np.isfinite(residual).all()):
        raise EvaluationError("accelerations under the law are beyond the range of numbers")
    x[free], _, _ = _least_squares(jacobian, residual)
    return x
