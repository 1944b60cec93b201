"""What is known of laws before any data, beside what each of them costs in a grammar."""

import numpy as np

from bsp_gp.language.formula import Call, Input, factors, walk
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import split_linear

AXES = ("e_x", "e_y", "e_z")
EDGE = 0.02
"""Part of all rows on the lesser side of a place below which they show no edge there."""
ON = 0.95
"""Part of the extent of a track that lies between its ends where a body did not turn."""


def cost_of(candidates):
    """Nats that laws cost together: components of one vector along axes are one cause."""
    costs: dict = {}
    for candidate in candidates:
        vector = vector_of(candidate)
        costs[vector] = max(costs.get(vector, 0.0), candidate.complexity)
    return sum(costs.values())


def vector_of(candidate):
    """Factors of a law, those that are axes of the laboratory as one."""
    above, below = factors(split_linear(candidate.formula)[1])
    words = ["" if isinstance(f, Input) and f.name in AXES else to_text(f) for f in above]
    return tuple(sorted(words)), tuple(sorted(map(to_text, below)))


def drives(formula, strength):
    """Whether a law of so much strength pushes a body on along its own velocity.

    What brakes is everywhere; what drives needs a motor, a wind or a hand.
    """
    above, _ = factors(split_linear(formula)[1])
    ways = (f.args[0] if isinstance(f, Call) and f.operator == "normalize" else f for f in above)
    return strength > 0 and any(isinstance(way, Input) and way.name == "v_i" for way in ways)


def is_passed_once(formula, axes, dataset):
    """Whether a law is a force about a place on a line along which all bodies go one way only.

    There whatever depends on speed, such as what slows down a fall through the air, depends on the
    place as well; and springs are pulled forth and back.

    Parameters
    ----------
    formula : Formula
    axes : set of str
        Along which it has a place, ``{"x"}``.
    """
    words = {getattr(node, "operator", getattr(node, "name", "")) for node in walk(formula)}
    is_smooth = not words & {"v_i", "v_j", "p_j", "t", "sign"}
    return is_smooth and len(axes) == 1 and all(
        _goes_on(track) for scene in dataset.scenes
        for track in scene.positions[:, scene.dynamic, "xyz".index(*axes)].T
    )  # fmt: skip


def edges_cost(formula, places, dataset):
    """What it costs that a law acts on one side of a place alone, in causes.

    Where nearly all rows are on one side of it they tell of no edge, and the law without it says as
    much.

    Parameters
    ----------
    formula : Formula
    places : sequence of (str, float)
        Axes and places on them, m: ``[("x", 0.4)]``.
    dataset : Dataset
    """
    words = {getattr(node, "operator", "") for node in walk(formula)}
    cost = 0
    for axis, at in places if "sign" in words else ():
        tracks = [s.positions[:, s.dynamic, "xyz".index(axis)].ravel() for s in dataset.scenes]
        seen = np.concatenate(tracks)
        beyond = np.mean(seen[np.isfinite(seen)] > at)
        cost = max(cost, 1 if min(beyond, 1 - beyond) > EDGE else 3)
    return cost


def _goes_on(track):
    """Whether places (T,) lie one behind the other, up to their noise."""
    seen = track[np.isfinite(track)]
    return len(seen) > 1 and abs(seen[-1] - seen[0]) > ON * np.ptp(seen)
