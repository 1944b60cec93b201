"""A force that knows no physics, as strong and as smooth as the data ask for.

It is a Gaussian process in time: white, or with a memory (Matern 5/2), by marginal likelihood. What
it makes of a track is the track without noise: places and velocities at which laws are evaluated,
and noise that is told from what laws lack.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bsp_gp.physics.engine.chains import spread

STRENGTHS = np.logspace(-4, 14, 73)
"""Variances, in units of what one moment would show."""
MEMORIES = 2.0 ** np.arange(1, 8)
"""Times over which it is smooth, in steps between rows."""
LOOKED_AT, FEWEST, MOMENTS = 48, 8, 3000
"""Pieces of tracks by which these are chosen: fewer of those that have many moments."""
NEAR = 3.0
"""Times by which memories differ that are tried where one was chosen for nearly the same."""
NOTHING = 1e-12
"""Part of what a force shows best, below which a moment is rounding."""
LIKELIER = 1.0
"""Nats by which it must be likelier than none, and one with a memory likelier than a white one."""


@dataclass(frozen=True, eq=False)
class FreeForce:
    """What a free force of one memory shows in moments of W pieces.

    Attributes
    ----------
    by_force : ndarray, shape (W, m, L R d)
        Moments of unit error by accelerations at L instants.
    times : ndarray, shape (L, W)
    memory : float, s
        0 = white.
    """

    by_force: np.ndarray
    times: np.ndarray
    memory: float = 0.0

    def on(self, by_force, times):
        """The same force on other moments."""
        return FreeForce(by_force, times, self.memory)

    @cached_property
    def spread(self):
        """Moments by force, times its covariance in time, (W, m, L R d)."""
        if not self.memory:
            return self.by_force
        n_instants, n_pieces = self.times.shape
        n_numbers = self.by_force.shape[2] // n_instants
        shaped = self.by_force.reshape(n_pieces, -1, n_instants, n_numbers)
        out = np.empty_like(shaped)
        for own, there, times in zip(out, shaped, self.times.T, strict=True):
            apart = np.nan_to_num(np.abs(times[:, None] - times), nan=np.inf)
            own[:] = np.einsum("lk,mkr->mlr", _matern(apart / self.memory), there, optimize=True)
        return out.reshape(self.by_force.shape)

    @cached_property
    def shown(self):
        """Covariance of moments by a force of one as eigenvalues (W, m) that rise, and vectors."""
        values, vectors = np.linalg.eigh(self.spread @ np.swapaxes(self.by_force, 1, 2))
        return np.maximum(values, 0.0), vectors

    def seen(self, left):
        """What a force of one shows in moments that tell it best, and those of `left`, (W, m)."""
        values, vectors = self.shown
        return values, (np.swapaxes(vectors, 1, 2) @ left[..., None])[..., 0]

    def telling(self, left):
        """The same force in as many turned moments as show any, and these of `left`.

        Of a body on a rod a half: forces along it show nothing, in whatever memory.
        """
        values, vectors = self.shown
        top = values.max(axis=1, keepdims=True, initial=0.0)
        count = max(int((values > NOTHING * top).sum(axis=1).max(initial=0)), 1)
        turned = np.swapaxes(vectors[:, :, -count:], 1, 2)  # eigenvalues rise
        found = replace(self, by_force=turned @ self.by_force)
        return found, (turned @ left[..., None])[..., 0]

    def chosen(self, left, near=None):
        """The same with the memory that is likeliest to have left moments (W, m).

        Parameters
        ----------
        near : FreeForce, optional
            That was chosen for nearly the same moments: memories far from its own are not tried.
        """
        count = min(max(MOMENTS // left.shape[1], FEWEST), LOOKED_AT)
        some = np.unique(np.linspace(0, len(left) - 1, count).astype(int))
        part, left = FreeForce(self.by_force[some], self.times[:, some]).telling(left[some])
        steps = np.diff(self.times, axis=0)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        memories = [m for m in step * MEMORIES if m < spread(self.times).max()]
        if near is not None and near.memory:
            memories = [m for m in memories if near.memory / NEAR < m < near.memory * NEAR]
        heights = {}
        for memory in (0.0, *memories):
            values, turned = replace(part, memory=memory).seen(left)
            heights[memory] = _as_likely(turned, values)[1] - (LIKELIER if memory else 0.0)
        return replace(self, memory=max(heights, key=heights.get))

    def strength(self, left):
        """The likeliest variance beside which moments (W, m) were left, (W, 1); None if none is."""
        values, turned = self.seen(left)
        strength, height, least = _as_likely(turned, values)
        return strength if strength.any() and height >= least + LIKELIER else None

    def expected(self, strength, vectors):
        """What a force of such variances (W, 1) shows along vectors (W, m, m), squared, (W, m)."""
        turned = np.swapaxes(vectors, 1, 2)
        return strength * ((turned @ self.spread) * (turned @ self.by_force)).sum(axis=2)

    def smoothest(self, left):
        """Accelerations (W, L R d) that are likeliest to have left moments (W, m); None if none."""
        (values, turned), (_, vectors) = self.seen(left), self.shown
        strength = self.strength(left)
        if strength is None:
            return None
        weight = strength / (1 + strength * values)
        inner = (vectors * weight[:, None]) @ turned[..., None]
        return (np.swapaxes(self.spread, 1, 2) @ inner)[..., 0]


def _as_likely(turned, values):
    """The likeliest strength (W, 1) of a free force, one for all pieces in what it shows best.

    With it log-evidences with and without, nats. A force of one shows `values`, squared, (W, m).
    """
    scaled, top = in_units(values)
    heights = [_height(np.square(turned), 1 + s * scaled) for s in (0.0, *STRENGTHS)]
    best = int(np.argmax(heights))
    strength = (0.0, *STRENGTHS)[best] / np.where(top > 0, top, 1.0)
    return np.broadcast_to(strength, top.shape), heights[best], heights[0]


def in_units(values):
    """Values in those that show best of each piece, and these, (W, 1)."""
    top = values.max(axis=1, keepdims=True, initial=0.0)
    return values / np.where(top > 0, top, 1.0), top


def _height(square, size):
    return -0.5 * float((square / size + np.log(size)).sum())


def _matern(apart):
    """Matern 5/2 of distances in memories."""
    apart = np.sqrt(5.0) * np.minimum(apart, 100.0)
    return (1 + apart + apart * apart / 3) * np.exp(-apart)
