"""The one evidence by which hypotheses are compared, in nats, free of units.

Laplace's approximation over everything that was fitted. A strength is as likely in every factor of
ten of what the data could show (log-uniform); an exponent is normal about what was declared. No
prior names metres or seconds.
"""

import math

import numpy as np

from bsp_gp.fitting.starts import roles_of
from bsp_gp.loop.criteria import Criteria

WEAK = 3.0
"""Standard errors of its strength below which a term of a sum may be one too many."""
LEAST = 2.0
"""Strengths are no likelier below so many standard errors."""
TURN = 2.0 * math.pi


def log_evidence(fit, hypothesis, criteria=None):
    """Log-evidence of a fit, nats; -inf of a failed one.

    Parameters
    ----------
    hypothesis : Hypothesis
        That was fitted; its parameters may have priors of their own.
    criteria : Criteria, optional
        With the widths of the other priors.
    """
    criteria = criteria or Criteria()
    if fit.is_failed:
        return -math.inf
    total = fit.log_likelihood + fit.state_volume + hypothesis.log_density
    # Numbers of the noise beyond its levels, each known to about the root of the rows.
    n_more = sum(p.is_free and not p.name.startswith("sigma_") for p in fit.noise.parameters)
    total -= 0.5 * n_more * math.log(max(fit.n_rows, 2))
    if not len(fit.values):
        return total
    covariance = fit.covariance
    known = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0)
    if np.isinf(np.diag(covariance)).any():
        return float(total + _log_share(fit, hypothesis, criteria))
    inner = covariance[np.ix_(known, known)]
    size = np.sqrt(np.diag(inner))
    _, volume = np.linalg.slogdet(inner / np.outer(size, size))
    total += 0.5 * (volume + len(size) * math.log(TURN))
    roles, tables = roles_of(fit.law), {}
    values = fit.values[known]
    numbers = [p for p, is_known in zip(hypothesis.parameters, known, strict=True) if is_known]
    for number, value, error in zip(numbers, values.tolist(), size.tolist(), strict=True):
        total += math.log(error)
        if hasattr(number.prior, "log_prob"):
            total += float(number.prior.log_prob(value))
        elif number.prior is not None:
            centre, scale = number.prior
            total -= math.log(math.pi * scale * (1 + ((value - centre) / scale) ** 2))
        elif number.name.endswith("]"):
            tables.setdefault(number.name, []).append((value, error))
        else:
            total += _log_prior(roles[number.name], abs(value), error, criteria)
    more = (_log_prior_of_table(np.array(t).T, criteria) for t in tables.values())
    return float(total + sum(more))


def _log_share(fit, hypothesis, criteria):
    """Logarithm of the part of the prior that the data leave where they do not tell all numbers.

    Directions that they do not tell keep their prior, and cost nothing; those that they tell cost
    what they would in any other numbers.
    """
    roles, widths, total = roles_of(fit.law), [], 0.0
    errors = 1.0 / np.sqrt(np.maximum(np.square(fit.jacobian).sum(axis=0), 1e-300))
    for number, value, error in zip(hypothesis.parameters, fit.values, errors, strict=True):
        if hasattr(number.prior, "log_prob"):
            widths.append(math.exp(-float(number.prior.log_prob(value))) / math.sqrt(TURN))
        elif number.prior is not None:
            centre, scale = number.prior
            total -= math.log1p(((value - centre) / scale) ** 2)
            widths.append(math.pi * scale / math.sqrt(TURN))
        else:
            role = "linear" if number.name.endswith("]") else roles[number.name]
            least = min(error, abs(value) or error)  # of a constant that stayed at 0 its error
            widths.append(math.exp(-_log_prior(role, abs(value), least, criteria)))
            widths[-1] /= math.sqrt(TURN)
    scaled = fit.jacobian * np.minimum(widths, 1e100)
    size = np.linalg.svd(scaled, compute_uv=False)
    return total - 0.5 * float(np.log1p(np.square(np.minimum(size, 1e150))).sum())


def _log_prior_of_table(table, criteria):
    """Logarithm of the prior density of numbers of one kind, one for each body or scene.

    They lie about a mean with a spread that the data choose; both are strengths.
    """
    values, errors = table
    n = len(values)
    mean = float(values.mean())
    widest = float(np.abs(values - mean).max())
    spreads = np.concatenate([[0.0], widest * np.logspace(-2, 0.5, 26)])
    variance = np.square(spreads)[:, None] + np.square(errors)
    heights = -0.5 * (np.square(values - mean) / variance + np.log(TURN * variance)).sum(axis=1)
    best = int(np.argmax(heights))
    error = float(np.sqrt(variance[best].mean() / n))
    total = float(heights[best]) + _log_prior("linear", abs(mean), error, criteria)
    total += 0.5 * math.log(TURN) + math.log(error)
    if best:  # a spread is known to about its part of one in the root of twice the numbers
        total += 0.5 * math.log(TURN / (2 * n)) - math.log(criteria.decades * math.log(10.0))
    return total


def _log_prior(role, value, error, criteria):
    """Logarithm of the prior density of a number, in the units of its own."""
    if role == "exponent":
        width = criteria.exponent_width
        return -0.5 * (value / width) ** 2 - math.log(width * math.sqrt(TURN))
    if role == "phase":
        return -math.log(max(TURN, error))
    # Log-uniform, both signs.
    return -math.log(2.0 * criteria.decades * math.log(10.0) * max(value, LEAST * error))


def significance(fit, name):
    """Values of a constant in their standard errors, one or those of every entity, (k,).

    Parameters
    ----------
    name : str or None
        Empty where the fit has none of that name.
    """
    own = [k for k, (each, _) in enumerate(fit.parameters) if each == name]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(np.asarray(fit.values)[own]) / np.asarray(fit.errors)[own]
