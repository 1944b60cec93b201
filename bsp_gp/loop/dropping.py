"""A rival that cannot be fitted is dropped and listed; it never ends a run."""

import numpy as np

from bsp_gp.errors import BspError, ResourceError

__all__ = ["FAULTS", "NOT_FITTED", "dropped_rivals", "or_fault"]

FAULTS = (BspError, np.linalg.LinAlgError, FloatingPointError)
"""What a rival may come to grief by; anything else is a bug and shows."""
NOT_FITTED = "it could not be fitted: "
"""How the reason of a dropped rival begins."""


def or_fault(work, *args):
    """Do some work for one rival.

    Returns
    -------
    result
        None if it failed.
    reason : str
        Why; "" if it did not.

    Raises
    ------
    ResourceError
        Memory that is short is short for all.
    """
    try:
        return work(*args), ""
    except ResourceError:
        raise
    except FAULTS as error:
        return None, f"{NOT_FITTED}{str(error) or type(error).__name__}"


def dropped_rivals(rounds):
    """Notes of a report on the rivals that were dropped, each once."""
    said = {
        (rival.name, rival.reason): f"left out of round {done.number}: {rival.name}; {rival.reason}"
        for done in reversed(rounds)
        for rival in done.rivals
        if rival.reason.startswith(NOT_FITTED)
    }
    return tuple(reversed(said.values()))
