"""Drag in air that moves, where no drag is known: beside a weight it hides in pushes and springs.

A weak wind adds a push and a drag that are not along each other, which sums of forces in still air
describe nearly, with a spring to a point far away for the rest.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from bsp_gp.language.formula import Call
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import NEW, Family
from bsp_gp.loop.proposers.libraries import Placed, asks_series, family_of, moving_axes
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.loop.proposers.winds import past_medium, velocities_seen
from bsp_gp.physics.bodies import dataset_types

MOST_LOOKS = 200
"""Winds that are tried."""
MOST_PUSHES = 3
"""Beside the drag, along the axes."""


class Blown:
    """Quadratic drag against a wind of any direction beside uniform pushes, as a proposer."""

    name = "blown"
    is_alone = False

    def propose(self, view):
        """The family of the likeliest sums, where no law of the grammar explains all."""
        axes = moving_axes(view)
        if len(axes) < 2 or view.is_astronomical or not asks_series(view):
            return Family(self.name)
        upright = axes[np.argmax(velocities_seen(view)[:, axes].std(axis=0))]  # of a weight
        ways = [axes, [axis for axis in axes if axis != upright]]
        libraries = [_library(view, axes, blowing) for blowing in ways]
        return family_of(self.name, view, [each for each in libraries if each], has_waves=False)


def _library(view, axes, blowing):
    """The terms where a wind along some axes explains most; None where none does."""
    names, past = past_medium(view, ["xyz"[axis] for axis in blowing], "u")
    drag = Call("mul", Call("norm", past), past)
    types = dataset_types(view.dataset)
    rows = [(drag, NEW)] + [(coordinate_of(types, axis)[1], 0) for axis in axes]
    fastest = np.abs(velocities_seen(view)[:, blowing]).max(axis=0)
    fastest = np.where(fastest > 0, fastest, 1.0).tolist()
    extents = tuple((-most, most) for most in fastest)
    placed = Placed(view, rows, tuple(names), extents, STATE_INPUTS["v_i"].unit)
    first = np.concatenate([np.zeros((1, len(fastest))), 0.3 * np.diag(fastest)])
    found = minimize(
        placed.unexplained, first[0], method="Nelder-Mead",
        options={"maxfev": MOST_LOOKS, "initial_simplex": first, "xatol": 1e-4 * max(fastest)},
    )  # fmt: skip
    library = placed.library(found.x)
    return library and replace(library, largest=1 + MOST_PUSHES)
