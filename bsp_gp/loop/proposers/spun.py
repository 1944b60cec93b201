"""A spin that nobody measured, about an axis that lies aslant: what turns the path of a ball aside.

In a plane such a force is one term of the grammar. In space it has three numbers, beside a weight
and a drag more than the sums that a search looks at.
"""

from dataclasses import replace

from bsp_gp.language.formula import Input
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import NEW, Family, is_turning
from bsp_gp.loop.proposers.libraries import (
    Rows,
    asks_series,
    drags,
    family_of,
    moving_axes,
)
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import split_linear


class Spun:
    """Sums of weight, drags and what acts across the velocity, for bodies in space, a proposer."""

    name = "spun"
    is_alone = False

    def propose(self, view):
        """The family of the likeliest sums in which two components of a spin or more are."""
        axes = moving_axes(view)
        if view.is_sky or len(axes) < 3 or not asks_series(view):
            return Family(self.name)
        types = dataset_types(view.dataset)
        pushes = [(coordinate_of(types, axis)[1], 0) for axis in axes]
        # A second component makes a sum that no other has.
        own = [(row, NEW // 2 * is_turning(row)) for row, _ in drags(view, axes)]
        library = Rows(view, pushes + own).library()
        libraries = [] if library is None else [library]
        family = family_of(self.name, view, libraries, has_waves=False)
        return replace(family, proposals=tuple(_costed(view, p) for p in family.proposals))


def _costed(view, proposal):
    """A sum that costs what its causes do: components of one vector are one."""
    causes = {_cause_of(split_linear(formula)[1]) for formula in proposal.formulas}
    log_prior = -view.criteria.cause_nats * len(causes)
    return replace(proposal, log_prior=log_prior, news={})


def _cause_of(row):
    if is_turning(row):
        return "spin"
    return "push" if isinstance(row, Input) else to_text(row)
