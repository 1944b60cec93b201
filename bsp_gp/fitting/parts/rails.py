"""Bodies that do not move along an axis whatever pulls: carts on a track, pucks on a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.hypothesis import Numbered

__all__ = ["Rail", "rail_of"]


@dataclass(frozen=True)
class Rail(Numbered):
    """Places along some axes stay what they are.

    Attributes
    ----------
    axes : tuple of int
    """

    axes: tuple
    numbers: tuple = ()
    kind = "rail"

    def describe(self):
        return f"held along {' and '.join('xyz'[axis] for axis in self.axes)}"


def rail_of(dataset):
    """The rail of a data set; None where no force along an axis would act on what is seen.

    That is where no body moves along an axis and bodies, or what pulls them, stand side by side
    there: forces between them point aside, and nothing is moved.
    """
    axes = tuple(k for k in range(dataset.n_dims) if _holds(dataset, k))
    return Rail(axes) if axes else None


def _holds(dataset, axis):
    is_aside = False
    for scene in dataset.scenes:
        places = scene.positions[:, :, axis]
        first = np.array([x[np.isfinite(x)][:1] for x in places.T if np.isfinite(x).any()])
        moving = [x[np.isfinite(x)] for x in places[:, scene.dynamic].T]
        if any(np.ptp(x) > 0 for x in moving if len(x)):
            return False
        is_aside |= len(first) > 1 and np.ptp(first) > 0
    return bool(is_aside)
