"""Loops in machine code, where NumPy has none."""

import numba


def compiled(function):
    """Compiled at its first call, and kept on disk where there is a place for it."""
    try:
        return numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # no folder can be written to
        return numba.njit(error_model="numpy")(function)
