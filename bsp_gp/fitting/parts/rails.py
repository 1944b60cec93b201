"""Bodies that do not move along an axis whatever pulls: carts on a track, pucks on a table."""

from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.hypothesis import Numbered


@dataclass(frozen=True)
class Rail(Numbered):
    """Places along some axes stay what they are."""

    axes: tuple
    numbers: tuple = ()
    kind = "rail"

    def describe(self):
        return f"held along {' and '.join('xyz'[axis] for axis in self.axes)}"


def rail_of(dataset, still):
    """The rail of a data set; None where no force across it would act on what is seen.

    That is where bodies, or what pulls them, stand side by side along an axis on which none moves:
    forces between them point aside, and nothing is moved. And where all motion is along a line: a
    force along the velocity that does not vanish with it has no direction where a body turns round,
    but on a line.

    Parameters
    ----------
    still : collection of str
        Axes along which no body moves, see `NoiseEstimate.inactive_axes`.
    """
    axes = tuple("xyz".index(name) for name in still)
    if len(axes) < dataset.n_dims - 1:
        axes = tuple(k for k in axes if any(_are_aside(scene, k) for scene in dataset.scenes))
    return Rail(axes) if axes else None


def _are_aside(scene, axis):
    places = scene.positions[:, :, axis]
    places = places[np.isfinite(places)]
    return bool(len(places) and np.ptp(places) > 0)
