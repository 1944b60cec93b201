"""Drag in air that moves, where no drag is known: beside a weight it hides in pushes and springs.

A weak wind adds a push and a drag that are not along each other, which sums of forces in still air
describe nearly, with a spring to a point far away for the rest.
"""

from dataclasses import replace
from functools import reduce

import numpy as np
from scipy.optimize import minimize

from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import NEW, Family
from bsp_gp.loop.proposers.libraries import Placed, asks_series, family_of, moving_axes
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name

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
        upright = max(axes, key=lambda axis: np.std(_speeds(view, axis)))  # where a weight pulls
        ways = [axes, [axis for axis in axes if axis != upright]]
        libraries = [_library(view, axes, blowing) for blowing in ways]
        return family_of(self.name, view, [each for each in libraries if each], has_waves=False)


def _library(view, axes, blowing):
    """The terms where a wind along some axes explains most; None where none does."""
    types, velocity = dataset_types(view.dataset), Input("v_i", STATE_INPUTS["v_i"])
    names = tuple(fresh_name(view.fit.law, f"u_{'xyz'[axis]}") for axis in blowing)
    parts = [Call("mul", Constant(name), coordinate_of(types, axis)[1])
             for name, axis in zip(names, blowing, strict=True)]  # fmt: skip
    past = Call("sub", velocity, reduce(lambda a, b: Call("add", a, b), parts))
    drag = Call("mul", Call("norm", past), past)
    rows = [(drag, NEW)] + [(coordinate_of(types, axis)[1], 0) for axis in axes]
    fastest = [float(np.abs(_speeds(view, axis)).max()) or 1.0 for axis in blowing]
    extents = tuple((-most, most) for most in fastest)
    placed = Placed(view, rows, names, extents, STATE_INPUTS["v_i"].unit)
    first = np.concatenate([np.zeros((1, len(fastest))), 0.3 * np.diag(fastest)])
    found = minimize(
        placed.unexplained, first[0], method="Nelder-Mead",
        options={"maxfev": MOST_LOOKS, "initial_simplex": first, "xatol": 1e-4 * max(fastest)},
    )  # fmt: skip
    library = placed.library(found.x)
    return library and replace(library, largest=1 + MOST_PUSHES)


def _speeds(view, axis):
    """Velocities along an axis at the instants at which forces are asked, (n,), m/s."""
    batches = view.response.regression.batches
    own = (b.velocities[:, :, b.bodies.receivers][b.valid.any(axis=-1)] for b in batches)
    return np.concatenate(list(own))[:, axis]
