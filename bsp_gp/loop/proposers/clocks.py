"""Gaps in the times of a recording that its tracks do not know: the clock was put forward.

Rows that are lost leave a gap of whole steps, in times and places alike. Where a gap is no whole
number of steps, or places go on over it as from row to row, the times behind it are late. That
shows without a law, and counts as far as the fit leaves the recording unexplained.
"""

import numpy as np

from bsp_gp.fitting.parts.defects import Shifted
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.loop.proposers.swaps import roughness, smooth_levels, unexplained

LONG = 1.5
"""Steps, of the usual ones, from which a step is a gap."""
EVEN, OFF = 0.02, 0.1
"""Part of a step by which even steps differ, and by which a gap is no whole number of them."""
MOST_GAPS = 4
"""Of a recording that are closed."""


def put_forward(view):
    """Gaps that are none: parts, their gain, and the greatest one as of two numbers."""
    share, levels = smooth_levels(view)
    axes, parts, excess, best = np.isfinite(levels), [], 0.0, 0.0
    for scene in view.dataset.scenes:
        gaps = _gaps(scene.times)
        choice = float(np.log(max(len(gaps), 1)))
        left, dof = unexplained(view.fit, scene.name) if gaps else (0.0, 1)
        left /= share**2
        if left <= dof:
            continue
        odd = [(left - dof, row, seconds) for row, seconds, is_whole in gaps if not is_whole]
        whole = [(_gain(scene, row, seconds, levels, axes), row, seconds)
                 for row, seconds, is_whole in gaps if is_whole and not odd]  # fmt: skip
        found = [
            (gain, Shifted(scene.name, row, seconds))
            for gain, row, seconds in (odd[:MOST_GAPS] or sorted(whole, reverse=True)[:1])
            if gain > 2 * (choice + view.criteria.cause_nats)
        ]
        if found:
            best = max(best, min(found[0][0], float(as_pair(left, dof))))
            parts += [part for _, part in found]
            excess += min(left - dof, sum(g for g, _ in found))
    return parts, excess, best


def _gaps(times):
    """Rows behind a gap, seconds that close it to a usual step, and if it is of whole steps."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 1.0
    counts = steps / usual
    is_even = np.median(np.abs(counts - 1)) < EVEN
    return [
        (int(k) + 1, usual - float(steps[k]),
         not is_even or abs(counts[k] - round(counts[k])) < OFF)
        for k in np.flatnonzero(counts > LONG)
    ]  # fmt: skip


def _gain(scene, row, seconds, levels, axes):
    """How much smoother all tracks run over a gap that is closed."""
    places = scene.positions[:, scene.dynamic][..., axes] / levels[axes]
    closed = scene.times + np.where(np.arange(len(scene.times)) >= row, seconds, 0.0)
    total = 0.0
    for k in range(places.shape[1]):
        seen = np.isfinite(places[:, k]).all(axis=1)
        at = int(seen[:row].sum()) - 1
        both = [roughness(t[seen], places[seen][:, [k]]) for t in (scene.times, closed)]
        if 0 <= at < len(both[0]):
            total += float(both[0][at] - both[1][at])
    return total
