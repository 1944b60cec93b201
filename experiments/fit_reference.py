"""The fit that scipy makes of a world from the truth, and the one that a user would write."""

from dataclasses import dataclass

import numpy as np
from fit_tracks import jacobian, positions_of
from scipy.optimize import least_squares

SMOOTHEST = 6
"""Gauss-Newton steps after scipy's, to the last digit."""
EDGE = 1e-6
"""What is so near a bound lies on it."""
UNDETERMINED = 1e-8


@dataclass(frozen=True, eq=False)
class Reference:
    """What scipy finds: values of the constants, and their covariance where it is finite."""

    values: np.ndarray
    covariance: np.ndarray


def reference(world, dataset):
    """Least squares of the world's own track, from the truth, to the last digit."""
    n_constants = len(world.truth)
    sizes = np.cumsum([n_constants, *(shot.states.size for shot in world.shots)])

    def parts(x):
        return [
            (shot, scene, x[a:b].reshape(shot.states.shape))
            for shot, scene, a, b in zip(world.shots, dataset.scenes, sizes[:-1], sizes[1:],
                                         strict=True)
        ]  # fmt: skip

    def left(x):
        found = []
        for shot, scene, states in parts(x):
            seen = scene.positions[:, : states.shape[1], : states.shape[2]]
            predicted = positions_of(world, shot, x[:n_constants], states)
            found.append(((predicted - seen) / shot.sigma).ravel())
        return np.concatenate(found)

    def slopes(x):
        rows = []
        for k, (shot, _, states) in enumerate(parts(x)):
            by_constants, by_states = jacobian(world, shot, x[:n_constants], states)
            row = np.zeros((len(by_constants), len(x)))
            row[:, :n_constants] = by_constants
            row[:, sizes[k] : sizes[k + 1]] = by_states
            rows.append(row)
        return np.concatenate(rows)

    low, high = np.full(sizes[-1], -np.inf), np.full(sizes[-1], np.inf)
    for name, ends in world.bounds.items():
        low[list(world.truth).index(name)], high[list(world.truth).index(name)] = ends
    start = np.concatenate([world.values, *(shot.states.ravel() for shot in world.shots)])
    # Without bounds by MINPACK, which copes with combinations that are not determined.
    box = {"method": "trf", "bounds": (low, high)} if world.bounds else {"method": "lm"}
    start = np.clip(start, low + EDGE, high - EDGE)
    x = least_squares(
        left, start, jac=slopes, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14, **box
    ).x
    free = (x - low > 2 * EDGE) & (high - x > 2 * EDGE)
    x = np.where(free, x, np.where(x - low <= 2 * EDGE, low, high))
    for _ in range(SMOOTHEST):
        x[free] -= _inverse(slopes(x)[:, free]) @ left(x)
    covariance = np.zeros((len(x), len(x)))
    inverse = _inverse(slopes(x)[:, free])
    covariance[np.ix_(free, free)] = inverse @ inverse.T
    return Reference(x[:n_constants], covariance[:n_constants, :n_constants])


def _inverse(slopes):
    """Pseudo-inverse for columns of any size; what they do not determine stays where it is."""
    size = np.linalg.norm(slopes, axis=0)
    return np.linalg.pinv(slopes / size, rcond=UNDETERMINED) / size[:, None]
