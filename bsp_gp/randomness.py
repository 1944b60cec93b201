"""Random numbers as public functions take them: an int, a Generator, or None."""

from numbers import Integral

import numpy as np

from bsp_gp.errors import SettingsError

Random = np.random.Generator | int | None
"""What may be given; see `generator`."""


def generator(rng: Random = None) -> np.random.Generator:
    """A Generator: the one given, or one of a seed; None is the seed 0, as on the command line.

    Parameters
    ----------
    rng : numpy.random.Generator, int or None
    """
    if isinstance(rng, np.random.Generator):
        return rng
    if rng is None or (isinstance(rng, Integral) and not isinstance(rng, bool) and rng >= 0):
        return np.random.default_rng(0 if rng is None else int(rng))
    raise SettingsError(
        f"rng must be a numpy.random.Generator, a seed or None, got {type(rng).__name__}"
    )
