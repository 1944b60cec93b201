"""Noise with the tails of Student's t, and the plain likelihood of a residual under any noise."""

import math

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

_DEGREES = (1.0, 200.0)
_N_PASSES = 10
_LEAST = 1e-300


def log_likelihood(model, channels, residual):
    """Plain log-likelihood of a residual (T, C), metres, by which different laws are compared."""
    if math.isinf(model.degrees):
        whitener = model.whitener(channels)
        square = float(np.square(whitener.whiten(residual)).sum())
        n_rows = np.count_nonzero(whitener.seen)
        return -0.5 * (square + whitener.log_det + n_rows * math.log(2.0 * math.pi))
    _, scaled, spread, seen = _weighed(model, channels, residual)
    normal = -0.5 * (np.square(scaled) + math.log(2.0 * math.pi))
    tailed = np.where(model.is_free[channels.axis], _log_student(scaled, model.degrees), normal)
    return float(np.where(seen, tailed - np.log(spread), 0.0).sum())


def weights_of(model, channels, residual):
    """Weights that the tails of a noise give rows of a residual (T, C), m; 1 where it has none."""
    if math.isinf(model.degrees):
        return np.ones(channels.seen.shape)
    return _weighed(model, channels, residual)[0]


def expected_weights(model, channels):
    """Weights under which least squares has the expected information of Student's t.

    About a place that information is (n + 1) / (n + 3) of the normal's of the same scale, for n
    degrees of freedom: how far the rows' weights narrow a place follows from it, not from the
    weights themselves.
    """
    weights = np.ones(channels.seen.shape)
    weights[:, model.is_free[channels.axis]] = information(model.degrees)
    return weights


def information(degrees):
    """Expected information of Student's t about a place, in that of the normal of its scale."""
    return 1.0 if math.isinf(degrees) else (degrees + 1.0) / (degrees + 3.0)


def _weighed(model, channels, residual):
    """Weights of rows, innovations in their spread without tails, that spread, what is seen."""
    weights = None
    for _ in range(_N_PASSES if model.correlated else 1):
        whitener = model.whitener(channels, weights)
        innovations = whitener.innovations(residual)
        scaled, spread = scaled_without_tails(model, channels, whitener, weights, innovations)
        weights = model.tail_weights(scaled, channels)
    return weights, scaled, spread, whitener.seen


def scaled_without_tails(model, channels, whitener, weights, innovations):
    """Innovations (T, C) in the spread they had without weights of rows, and that spread."""
    spread = whitener.spread
    if weights is not None:
        white, _ = model.parts(channels)
        rest = np.where(whitener.seen, white - white / weights, 0.0)
        spread = np.sqrt(np.square(spread) + rest)
    # Exact rows have no spread; what is off there is off by any number of it.
    return innovations / np.maximum(spread, _LEAST), spread


def fit_student(z):
    """Scale and degrees of freedom of a sample, and the gain of log-likelihood over the normal."""
    normal = -0.5 * len(z) * (math.log(2.0 * math.pi * float(np.mean(np.square(z)))) + 1.0)

    def loss(values):
        scale, degrees = np.exp(values)
        return float(np.log(scale) * len(z) - _log_student(z / scale, degrees).sum())

    bounds = [(-12.0, 5.0), tuple(np.log(_DEGREES))]
    start = [math.log(1.4826 * float(np.median(np.abs(z))) + 1e-5), math.log(5.0)]
    found = minimize(loss, start, method="L-BFGS-B", bounds=bounds)
    scale, degrees = (float(v) for v in np.exp(found.x))
    return scale, degrees, -float(found.fun) - normal


def fit_degrees(z, start):
    """Degrees of freedom of a sample of unit scale."""

    def loss(values):
        return -float(_log_student(z, math.exp(values[0])).sum())

    bounds = [tuple(np.log(_DEGREES))]
    found = minimize(loss, [math.log(start)], method="L-BFGS-B", bounds=bounds)
    return math.exp(float(found.x[0]))


def _log_student(z, degrees):
    half = 0.5 * (degrees + 1.0)
    norm = gammaln(half) - gammaln(0.5 * degrees) - 0.5 * math.log(degrees * math.pi)
    return norm - half * np.log1p(np.square(z) / degrees)
