"""Proposers: each turns a fit into causes that may be missing, one short file each."""

from bsp_gp.closing.proposers.exponents import Declared
from bsp_gp.closing.proposers.hidden import Hidden
from bsp_gp.closing.proposers.laws import Laws
from bsp_gp.closing.proposers.measurement import Measurement

__all__ = ["proposers_for"]


def proposers_for(dataset, grammar, *, max_levels=8, exclude=("t",)):
    """All proposers for a data set.

    Parameters
    ----------
    dataset : Dataset
        Training scenes.
    grammar : Grammar
        What forces may be.
    max_levels : int
    exclude : sequence of str
        Inputs that laws may not use.
    """
    return (Laws(grammar, dataset, max_levels, exclude), Declared(), Hidden(), Measurement())
