"""Linear constants from accelerations of neighbouring rows: where a fit to tracks begins.

Second divided differences of three rows are accelerations as far as the rows are close; pieces
that noise or their length makes wrong are recognised by their misfit and count little (a Cauchy
weight). Good enough to begin with, and for nothing else.
"""

import numpy as np

PASSES = 30


def regressed(flows, nodes, noises, constants, free):
    """Values (k,) of the constants `free`, which enter linearly, the others as they are."""
    constants = np.array(constants, dtype=float)
    constants[free] = 0.0
    targets, columns, errors = [], [], []
    for flow, own, noise in zip(flows, nodes, noises, strict=True):
        target, column, error = _rows(flow, own, noise, constants, free)
        targets.append(target)
        columns.append(column)
        errors.append(error)
    y, a, s = np.concatenate(targets), np.concatenate(columns), np.concatenate(errors)
    good = np.isfinite(y) & np.isfinite(a).all(axis=1) & np.isfinite(s) & (s > 0)
    if good.sum() < len(free):
        return constants
    y, a, s = y[good], a[good], s[good]
    size = np.sqrt(np.square(a).mean(axis=0))
    size = np.where(size > 0, size, 1.0)
    weight, solved = 1.0 / s, np.zeros(len(free))
    for _ in range(PASSES):
        before = solved
        solved = np.linalg.lstsq(a / size * weight[:, None], y * weight, rcond=1e-10)[0]
        left = (y - a / size @ solved) / s
        spread = max(1.4826 * float(np.median(np.abs(left))), 1.0)
        weight = 1.0 / (s * np.sqrt(1.0 + np.square(left / spread)))
        if np.all(np.abs(solved - before) <= 1e-6 * np.abs(solved)):
            break
    constants[free] = solved / size
    return constants


def _rows(flow, nodes, noise, constants, free):
    """Accelerations less those without the free constants, their columns, and their errors."""
    chains = flow.chains
    t = chains.times
    with np.errstate(invalid="ignore"):
        before, after = t[1:-1] - t[:-2], t[2:] - t[1:-1]
    row, chain = np.nonzero(np.isfinite(before) & np.isfinite(after))
    h0, h1 = before[row, chain], after[row, chain]
    weights = np.stack([2 / (h0 * (h0 + h1)), -2 / (h0 * h1), 2 / (h1 * (h0 + h1))])
    places = np.stack([chains.observed[row + k, chain] for k in range(3)])  # (3, M, R, d)
    variance = np.stack([noise.variance[row + k, chain] for k in range(3)])
    target = np.einsum("km,kmrd->mrd", weights, places)
    error = np.sqrt(np.einsum("km,kmrd->mrd", np.square(weights), variance))
    # What lies between the rows of a piece counts as an error that grows with its span.
    span = h0 + h1
    error = np.hypot(error, np.abs(target) * (span / np.median(span))[:, None, None] ** 2 * 0.05)
    flow.motion.set_constants(constants)
    points = flow.at(nodes, row + 1, chain)
    fixed = np.moveaxis(flow.motion.acceleration(points), -1, 0)
    ones = constants.copy()
    ones[free] = 1.0  # linear: the columns are those of any value
    flow.motion.set_constants(ones)
    _, by_constant = flow.motion.slopes(points)
    return (
        (target - fixed).reshape(-1),
        by_constant[..., free].reshape(-1, len(free)),
        error.reshape(-1),
    )
