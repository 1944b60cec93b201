"""Drag in air that moves, or thins, where no drag is known: beside a weight it hides in others.

A weak wind adds a push and a drag that are not along each other, which sums of forces in still air
describe nearly, with a spring to a point far away for the rest. Air that thins with the height
brakes less above, which pushes that change with the height describe.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from bsp_gp.language.formula import Call
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposal import NEW, Family
from bsp_gp.loop.proposers.libraries import (
    Placed,
    asks_series,
    extent_of,
    family_of,
    left_by,
    moving_axes,
)
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.loop.proposers.winds import past_medium, velocities_seen
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name

MOST_LOOKS = 200
"""Winds that are tried."""
MOST_PUSHES = 3
"""Beside the drag, along the axes."""
THINNEST, THICKEST = 0.25, 16.0
"""Extents of a track in which the air thins by a factor of e."""


class Blown:
    """Quadratic drag in a wind of any direction, or in air that thins, beside uniform pushes."""

    name = "blown"
    is_alone = False

    def propose(self, view):
        """The family of the likeliest sums, where no law of the grammar explains all."""
        axes = moving_axes(view)
        if view.is_sky or not asks_series(view):
            return Family(self.name)
        upright = axes[np.argmax(velocities_seen(view)[:, axes].std(axis=0))]  # of a weight
        libraries = [_thinning(view, axes, upright)]
        if len(axes) > 1:
            ways = [axes, [axis for axis in axes if axis != upright]]
            libraries += [_library(view, axes, blowing) for blowing in ways]
        return family_of(self.name, view, [each for each in libraries if each], has_waves=False)


def _library(view, axes, blowing):
    """The terms where a wind along some axes explains most; None where none does."""
    names, past = past_medium(view, ["xyz"[axis] for axis in blowing], "u")
    drag = Call("mul", Call("norm", past), past)
    types = dataset_types(view.dataset)
    rows = [(drag, NEW), *_pushes(types, axes)]
    fastest = np.abs(velocities_seen(view)[:, blowing]).max(axis=0)
    fastest = np.where(fastest > 0, fastest, 1.0).tolist()
    extents = tuple((-most, most) for most in fastest)
    placed = Placed(view, rows, tuple(names), extents)
    first = np.concatenate([np.zeros((1, len(fastest))), 0.3 * np.diag(fastest)])
    found = minimize(
        placed.unexplained, first[0], method="Nelder-Mead",
        options={"maxfev": MOST_LOOKS, "initial_simplex": first, "xatol": 1e-4 * max(fastest)},
    )  # fmt: skip
    library = placed.library(found.x)
    return library and replace(library, largest=1 + MOST_PUSHES)


def _thinning(view, axes, upright):
    """The terms with a drag that fades along an axis; None where it explains nothing."""
    types, name = dataset_types(view.dataset), fresh_name(view.fit.law, "D")
    low, high = extent_of(view, upright)
    middle, way = float(f"{(low + high) / 2:.2g}"), f"e_{'xyz'[upright]}"
    height, found = f"dot(p_i - (origin + {middle!r} [m] * {way}), {way})", []
    extents = ((THINNEST * (high - low), THICKEST * (high - low)),)
    for sign in ("-", ""):  # the axis may point down
        drag = parse_formula(f"exp({sign}{height} / {name}) * norm(v_i) * v_i", types)
        placed = Placed(view, [(drag, NEW), *_pushes(types, axes)], (name,), extents)
        library = placed.best_on_line()
        found += [library] if library else []
    best = min(found, key=lambda each: left_by(view, each.columns), default=None)
    return best and replace(best, largest=1 + MOST_PUSHES)


def _pushes(types, axes):
    """Steady pushes along axes, which are nothing new."""
    return [(coordinate_of(types, axis)[1], 0) for axis in axes]
