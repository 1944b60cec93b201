"""Proposers: each turns a fit into causes that may be missing, one short file each."""

from __future__ import annotations

from bsp_gp.closing.proposers.companions import Companions
from bsp_gp.closing.proposers.contacts import Contacts
from bsp_gp.closing.proposers.defects import Defects
from bsp_gp.closing.proposers.exponents import Declared
from bsp_gp.closing.proposers.hidden import Hidden
from bsp_gp.closing.proposers.laws import Laws
from bsp_gp.closing.proposers.measurement import Measurement
from bsp_gp.closing.proposers.noise import Noise
from bsp_gp.closing.proposers.periods import Periods
from bsp_gp.closing.proposers.varying import Varying

__all__ = ["standard"]


def standard(grammar, dataset, *, max_levels=8, exclude=("t",)):
    """All proposers; this list is the only place that knows them by name.

    Parameters
    ----------
    grammar : Grammar
    dataset : Dataset
        Training scenes.
    max_levels, exclude
        As in `Laws`.
    """
    return [
        Laws(grammar, dataset, max_levels, exclude), Declared(), Varying(), Periods(), Hidden(),
        Companions(), Contacts(), Measurement(), Defects(), Noise(),
    ]  # fmt: skip
