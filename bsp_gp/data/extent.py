"""How large the recordings of a data set are, and whether they are of the sky."""

import numpy as np

from bsp_gp.units import OF_THE_SKY, Unit, parse_unit

ASTRONOMICAL = 1e6
"""Size of the data from which an attraction is gravity, and nothing is held, m."""

YEARS, JULIAN, MODIFIED = (1500.0, 2200.0), (2.2e6, 2.6e6), (15_000.0, 100_000.0)
"""Numbers that are decimal years, and Julian dates and modified ones in days."""
DATED = ((YEARS, 0.5), (JULIAN, 1.0))
"""What times without a unit may be, and how long a recording of the sky is in it."""


def is_astronomical(dataset):
    """Whether tracks are so large, in metres, that only gravity acts as far."""
    return spans_the_sky(dataset.scenes, dataset.units)


def spans_the_sky(scenes, units):
    """Whether scenes are: what these units make metres and seconds of is known, and large."""
    if not units.is_calibrated(Unit.of(m=1, s=1)):
        return False
    places = [s.positions.reshape(-1, s.n_dims) for s in scenes]
    sizes = [np.fmax.reduce(p, axis=0) - np.fmin.reduce(p, axis=0) for p in places]
    return bool(np.nanmax(sizes, initial=0.0) > ASTRONOMICAL)


def is_of_the_sky(dataset):
    """Whether places are of astronomical size, angles without a distance, or velocities of stars.

    Where no unit is given, dates tell it: no film begins in the year 2002.25.
    """
    if dataset.is_of_sight:
        return True
    if is_astronomical(dataset) or dataset.units.symbols.get("m") in OF_THE_SKY:
        return True
    declared = dataset.units.declared
    told = declared.get("time", declared.get("t"))
    unit = parse_unit(told)[0] if told else 1.0
    is_far = not {"length", *"xyz"} & set(declared)
    ends = [scene.times[[0, -1]] / unit for scene in dataset.scenes]
    return is_far and all(
        any(are_within(first, last, (span,)) and last - first > least for span, least in DATED)
        for first, last in ends
    )


def are_within(first, last, ranges):
    """Whether times from a first to a last one lie in one of some ranges."""
    return any(low <= first and last <= high for low, high in ranges)
