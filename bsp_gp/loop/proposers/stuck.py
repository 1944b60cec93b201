"""Tracks that stand still to their beginning or end: what was followed there was not the body.

Standing still shows in the places whatever the law. It counts where it begins or ends at once: what
starts slowly is the body. And it counts as far as the fit leaves the track unexplained, since what
comes to rest looks the same.
"""

import numpy as np
from scipy import stats

from bsp_gp.fitting.channels import unexplained
from bsp_gp.fitting.jumps import scatter, solved
from bsp_gp.fitting.parts.defects import LeftOut
from bsp_gp.fitting.rests import in_levels, still_rows
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.loop.proposers.swaps import smooth_levels

LEAST_ROWS = 4
"""That stand still."""
LEAST_KEPT = 0.25
"""Part of a track that is its body's if the rest is not."""
BESIDE, UNLIKELY = 4, 1e-3
"""Rows on each side of an instant that tell whether a track breaks there, and the chance by which
one that goes on smoothly may look broken."""


def stuck(view):
    """Tracks that stand still from or up to some row: parts, gain less price, gain as pair."""
    share, levels = smooth_levels(view)
    axes, parts, excess, best = np.isfinite(levels), [], 0.0, 0.0
    for scene in view.dataset.scenes:
        found = [part for k in scene.dynamic for part in _ends(scene, k, levels, axes)]
        left, dof = unexplained(view.fit, scene.name) if found else (0.0, 1)
        left /= share**2
        if left <= dof:
            continue
        best = max(best, min(max(g for _, g, _ in found), float(as_pair(left, dof))))
        parts += [part for part, *_ in found]
        excess += left - dof - sum(price for *_, price in found)
    return parts, excess, best


def _ends(scene, k, levels, axes):
    """The head and the tail of a track that stand still beside the rest: (LeftOut, gain, price).

    The gain is what as many steps as elsewhere would have been; leaving them out costs less.
    """
    places, seen = in_levels(scene, k, levels)
    low, high = np.nanmin(scene.positions, axis=(0, 1)), np.nanmax(scene.positions, axis=(0, 1))
    for is_tail in (True, False):
        rows = seen[::-1] if is_tail else seen
        n = still_rows(places[rows])
        if n < LEAST_ROWS or n > (1 - LEAST_KEPT) * len(rows):
            continue
        steps = np.square(np.diff(places[rows[n - 1 :]], axis=0)).sum(axis=1)
        bounds = (int(rows[n - 1]), len(scene.times)) if is_tail else (0, int(rows[n - 1]) + 1)
        if not is_broken(scene, scene.names[k], bounds[0] or bounds[1]):
            continue
        count = n * int(axes.sum())
        part = LeftOut(
            scene.name, *bounds, scene.names[k],
            n_left_out=count, extent=float((high - low).max()),
        )  # fmt: skip
        level = np.sqrt(2 * np.pi) * levels[axes].mean()
        price = 2 * count * max(float(np.log(part.extent / level)), 0.0)
        gain = n * float(np.median(steps) - 2 * axes.sum())
        if gain > price:
            yield part, gain, price


def is_broken(scene, name, at):
    """Whether a body jumps or turns off at a row where its track is said to be lost, or found."""
    return bool(are_broken(scene, name, np.array([at]))[0])


def are_broken(scene, name, at):
    """The same of many rows.

    Parameters
    ----------
    at : ndarray of int, shape (R,)

    Returns
    -------
    ndarray of bool, shape (R,)
    """
    places = scene.positions[:, scene.names.index(name)]
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    place = np.searchsorted(seen, at)
    near = (place >= BESIDE) & (place + BESIDE <= len(seen))
    broken = ~near  # too near an end for rows to tell
    if not near.any():
        return broken
    rows = seen[place[near][:, None] + np.arange(-BESIDE, BESIDE)]
    t = scene.times[rows]
    t = t - t.mean(axis=1, keepdims=True)
    t /= np.abs(t).max(axis=1, keepdims=True)
    is_behind = np.broadcast_to(np.arange(-BESIDE, BESIDE) >= 0, t.shape)
    basis = np.stack([np.ones_like(t), t, t * t, is_behind, is_behind * t], axis=-1)

    least = stats.chi2.isf(UNLIKELY, 2 * places.shape[1]) * scatter(places) ** 2
    smooth, behind = (solved(columns, places[rows])[1] for columns in (basis[..., :3], basis))
    broken[near] = smooth - behind > least
    return broken
