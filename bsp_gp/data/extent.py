"""How large the recordings of a data set are, and whether they are of the sky."""

import numpy as np

from bsp_gp.units import OF_THE_SKY, Unit

ASTRONOMICAL = 1e6
"""Size of the data from which an attraction is gravity, and nothing is held, m."""


def is_astronomical(dataset):
    """Whether tracks are so large, in metres, that only gravity acts as far."""
    sizes = [
        np.nanmax(s.positions, axis=(0, 1)) - np.nanmin(s.positions, axis=(0, 1))
        for s in dataset.scenes
    ]
    is_known = dataset.units.is_calibrated(Unit.of(m=1, s=1))
    return bool(is_known and np.max(sizes) > ASTRONOMICAL)


def is_of_the_sky(dataset):
    """Whether places are of astronomical size, or angles without a distance."""
    return is_astronomical(dataset) or dataset.units.symbols.get("m") in OF_THE_SKY
