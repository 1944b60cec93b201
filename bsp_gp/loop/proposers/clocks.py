"""Gaps in the times of a recording that its tracks do not know: the clock was put forward.

Over rows that are lost bodies go on by what they are fast. Where they go on over a gap by no more
than from row to row, the times behind it are late. That shows without a law, and counts as far as
the fit leaves the recording unexplained.
"""

import numpy as np

from bsp_gp.fitting.channels import unexplained
from bsp_gp.fitting.parts.defects import Shifted
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.loop.proposers.swaps import smooth_levels

LONG = 1.5
"""Steps, of the usual ones, from which a step is a gap."""
BESIDE = 4
"""Steps on each side of a gap whose medians tell how fast a body is: single rows may be off."""
MUCH = 0.25
"""Part of what a step over a gap is off, squared, that a usual step must not leave of it."""
MOST_GAPS = 4
"""Of a recording that are closed."""


def put_forward(view):
    """Gaps that are none: parts, their gain, and the greatest one as of two numbers."""
    share, levels = smooth_levels(view)
    axes, parts, excess, best = np.isfinite(levels), [], 0.0, 0.0
    for scene in view.dataset.scenes:
        gaps = _gaps(scene.times)
        needed = 2 * (float(np.log(max(len(gaps), 1))) + view.criteria.cause_nats)
        places = scene.positions[:, scene.dynamic][..., axes] / levels[axes]
        found = [(_gain(scene.times, places, *gap), *gap) for gap in gaps]
        found = sorted((f for f in found if f[0] > needed), reverse=True)[:MOST_GAPS]
        left, dof = unexplained(view.fit, scene.name) if found else (0.0, 1)
        left /= share**2
        if left > dof:
            best = max(best, min(found[0][0], float(as_pair(left, dof))))
            parts += [Shifted(scene.name, row, seconds) for _, row, seconds in found]
            excess += left - dof  # all that is behind is seen too late
    return parts, excess, best


def _gaps(times):
    """Rows behind a gap, and the seconds that close it to a usual step."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 1.0
    return [(int(k) + 1, usual - float(steps[k])) for k in np.flatnonzero(steps > LONG * usual)]


def _gain(times, places, row, seconds):
    """By how much less places (T, n, d) go on over a gap as its time says than over a closed one.

    0 where a closed one does no better.
    """
    steps = np.diff(times)[:, None, None]
    with np.errstate(invalid="ignore"):
        speeds = np.diff(places, axis=0) / steps
    sides = speeds[max(row - 1 - BESIDE, 0) : row - 1], speeds[row : row + BESIDE]
    if not all(len(side) for side in sides):
        return 0.0
    speed = np.mean([np.median(side, axis=0) for side in sides], axis=0)
    gap, way = float(steps[row - 1, 0, 0]), places[row] - places[row - 1]
    long, closed = (
        np.nansum(np.square(way - speed * time)) for time in (gap, gap + seconds)
    )  # fmt: skip
    return float(long - closed) if closed < MUCH * long else 0.0
