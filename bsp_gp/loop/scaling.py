"""Power laws of the size of a residual in one channel, fitted in the smooth view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.loop.quantities import FLOOR, Quantity
from bsp_gp.loop.shares import explain

__all__ = ["MOST", "AboutPoint", "Scaling", "shifts_of"]

MOST = 8.0
"""Exponents beyond are not looked for."""
STARTS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
_TIGHT = {"xtol": 1e-6, "ftol": 1e-8, "gtol": 1e-8}


@dataclass(frozen=True, eq=False)
class Scaling:
    """The power laws of one channel.

    Attributes
    ----------
    view : SmoothView
    legs : list of ndarray, shape (n, S, R, L, d)
        Unit vectors over the mass of the receiver.
    quantities : tuple of Quantity
        Whose exponents are free.
    is_pooled : bool
        One amplitude for all tracks, or one for each.
    """

    view: object
    legs: list
    quantities: tuple
    is_pooled: bool

    def pushes(self, exponents):
        """The push at amplitude one, coordinates (S, R, D) per group."""
        return self.weighted(exponents, [1.0] * len(self.view.groups))

    def weighted(self, exponents, weights):
        """The same times weights (n, S, R, L) per group."""
        out = []
        for g, (group, weight) in enumerate(zip(self.view.groups, weights, strict=True)):
            legs, logs = self.geometry(g, exponents)
            log = sum(p * one for p, one in zip(exponents, logs, strict=True))
            size = weight * np.exp(np.clip(log, -50.0, 50.0))
            for quantity in self.quantities:
                if quantity.signs is not None:
                    size = size * quantity.signs[g]
            summed = (legs * np.asarray(size)[..., None]).sum(axis=3)
            out.append(group.project(summed[:, :, :, None])[..., 0])
        return out

    def geometry(self, g, exponents):
        """Unit vectors, and logarithms of the quantities, of group number g."""
        return self.legs[g], [quantity.logs[g] for quantity in self.quantities]

    def left(self, exponents):
        """Residual after the best amplitudes, constants of the law refitted, (n,)."""
        target = self.view.flat(self.view.target)
        pushes = self.pushes(exponents)
        if not self.is_pooled:
            return target - explain(self.view, [push[..., None] for push in pushes]).fitted
        column = self.view.flat(pushes)
        column = column - self.view.constants @ (self.view.constants.T @ column)
        size = float(column @ column)
        return target - (column @ target / size if size > 0 else 0.0) * column

    def misfit(self, exponents):
        """Sum of squares after the best amplitudes."""
        left = self.left(exponents)
        return float(left @ left)

    def amplitudes(self, exponents):
        """Amplitude of every track, (S, R) per group: accelerations at the typical quantities."""
        pushes, target = self.pushes(exponents), self.view.target
        if self.is_pooled:
            column = self.view.flat(pushes)
            bent = column - self.view.constants @ (self.view.constants.T @ column)
            size = float(bent @ bent)
            one = float(bent @ self.view.flat(target)) / size if size > 0 else 0.0
            return [np.full(push.shape[:2], one) for push in pushes]
        sizes = [np.square(push).sum(axis=2) for push in pushes]
        return [
            (push * t).sum(axis=2) / np.where(size > 0, size, np.inf)
            for push, t, size in zip(pushes, target, sizes, strict=True)
        ]

    def curvature_error(self, exponents, index, step=1e-4):
        """Standard error of an exponent at unit noise, all others free; inf if undetermined."""
        middle = self.left(exponents)
        slopes = []
        for k in range(len(self.quantities)):
            moved = np.array(exponents, dtype=float)
            moved[k] += step
            slopes.append((self.left(moved) - middle) / step)
        slopes = np.stack(slopes, axis=1)
        others = np.delete(slopes, index, axis=1)
        own = slopes[:, index]
        if others.shape[1]:
            own = own - others @ np.linalg.lstsq(others, own, rcond=1e-10)[0]
        size = float(np.linalg.norm(own))
        return 1 / size if size > 0 else np.inf

    @property
    def n_amplitudes(self):
        return 1 if self.is_pooled else sum(legs.shape[1] * legs.shape[2] for legs in self.legs)

    def fit(self, fixed=None, start=None):
        """Best exponents and their sum of squares, those of `fixed` (index -> value) held."""
        from scipy.optimize import least_squares

        fixed = fixed or {}
        free = [k for k in range(len(self.quantities)) if k not in fixed]
        base = np.zeros(len(self.quantities))
        base[list(fixed)] = list(fixed.values())

        def filled(values):
            out = base.copy()
            out[free] = values
            return out

        if not free:
            return base, self.misfit(base)
        best = None
        for first in [np.asarray(start)[free]] if start is not None else self._starts(filled, free):
            result = least_squares(
                lambda values: self.left(filled(values)), np.clip(first, -MOST, MOST),
                bounds=(-MOST - 1e-6, MOST + 1e-6), max_nfev=30, x_scale=1.0, **_TIGHT,
            )  # fmt: skip
            if best is None or 2 * result.cost < best[1]:
                best = filled(result.x), float(2 * result.cost)
        return best

    def _starts(self, filled, free):
        """The two best of a coarse grid: one exponent runs, those of properties are 0 or 1."""
        trials = []
        for value in STARTS:
            for other in (0.0, 1.0) if len(free) > 1 else (0.0,):
                trials.append(np.array([value] + [other] * (len(free) - 1)))
        trials.sort(key=lambda trial: self.misfit(filled(trial)))
        return trials[:2]


@dataclass(frozen=True, eq=False)
class AboutPoint(Scaling):
    """Power laws about an unseen point whose place is free as well.

    The last quantities are shifts of the place; the distance is worked out anew from it.
    """

    place: np.ndarray = None
    step: float = 1.0

    def geometry(self, g, exponents):
        n_dims = len(self.place)
        group = self.view.groups[g]
        place = self.place + self.step * np.asarray(exponents)[-n_dims:]
        gap = group.batch.positions[:, :, group.batch.bodies.receivers] - place
        length = np.linalg.norm(gap, axis=-1, keepdims=True)
        heavy = np.linalg.norm(self.legs[g], axis=-1, keepdims=True)  # one over the mass
        legs = (gap / np.where(length > 0, length, 1.0))[:, :, :, None] * heavy
        logs = [quantity.logs[g] for quantity in self.quantities]
        for k, quantity in enumerate(self.quantities):
            if quantity.name == "distance":
                size = np.nan_to_num(length, nan=quantity.typical)
                logs[k] = np.log(np.maximum(size / quantity.typical, FLOOR))
        return legs, logs


def shifts_of(view, n_dims):
    """Quantities that stand for shifts of a place; they scale nothing."""
    zeros = [np.zeros((1, 1, 1, 1)) for _ in view.groups]
    return tuple(
        Quantity(f"place {k}", zeros, None, 1.0, None, False, True, 1.0) for k in range(n_dims)
    )
