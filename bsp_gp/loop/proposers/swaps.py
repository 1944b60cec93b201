"""Two tracks that bear each other's names from some row on.

A swap shows in the places whatever the law: tracks go on more smoothly with names exchanged. It
counts as far as the fit leaves the two tracks unexplained, since what collides may look the same.
"""

from itertools import combinations

import numpy as np

from bsp_gp.fitting.channels import unexplained
from bsp_gp.fitting.parts.defects import Swapped
from bsp_gp.fitting.tangent import as_pair

WINDOW = 4
"""Rows before and after a swap through which a cubic is put."""
MOST_BODIES = 12
"""Of a scene that are compared with each other: those of the roughest tracks."""
MOST_SWAPS = 4
"""In one scene."""


def swaps(view):
    """Every swap that pays: parts, their gain, the greatest one as of two numbers, choices."""
    scenes = view.dataset.scenes
    share, levels = smooth_levels(view)
    n_tried = sum(len(s.times) * len(s.dynamic) * (len(s.dynamic) - 1) // 2 for s in scenes)
    choice, parts, excess, best = float(np.log(max(n_tried, 1))), [], 0.0, 0.0
    for scene in scenes:
        found = list(_swaps(scene, levels, choice))
        left, dof = unexplained(view.fit, scene.name) if found else (0.0, 1)
        left /= share**2
        if left > dof:
            gain = min(max(g for g, _ in found), float(as_pair(left, dof)))
            best = max(best, gain - 2 * choice)  # chance of a wrong name: exp(-gain / 2) each
            parts += [part for _, part in found]
            excess += left - dof
    return parts, excess, best, n_tried


def smooth_levels(view):
    """What tracks are rough by in levels of the fit, at most 1, and levels so small, (d,).

    What is estimated beside tracks that their names mislead is no level of the noise.
    """
    levels = np.array(view.fit.noise.levels)
    if not view.fit.noise.is_free.any() or view.fit.noise.adding:
        return 1.0, levels
    rough = []
    for scene in view.dataset.scenes:
        places = (scene.positions / levels)[:, scene.dynamic][..., np.isfinite(levels)]
        for k in range(places.shape[1]):
            numbers = (2 * WINDOW - 4) * places.shape[2]
            rough.append(_roughness(scene.times, places[:, [k]]) / numbers)
    rough = np.concatenate(rough) if rough else np.ones(1)
    share = float(np.sqrt(np.median(rough))) if len(rough) and np.median(rough) > 0 else 1.0
    return min(share, 1.0), min(share, 1.0) * levels


def _swaps(scene, levels, choice):
    """Swaps of a scene that pay, in the order in which they are undone: (gain, Swapped)."""
    axes = np.isfinite(levels)
    for _ in range(MOST_SWAPS):
        places = scene.positions[..., axes] / levels[axes]
        bodies = scene.dynamic
        if len(bodies) > MOST_BODIES:
            rough = [-_roughness(scene.times, places[:, [k]]).max(initial=0.0) for k in bodies]
            bodies = np.sort(bodies[np.argsort(rough)[:MOST_BODIES]])
        pairs = map(list, combinations(bodies.tolist(), 2))
        tried = [(*_best_row(scene.times, places[:, pair]), pair) for pair in pairs]
        gain, row, pair = max(tried, default=(0.0, 0, []))
        if gain <= 2 * choice:
            return
        part = Swapped(scene.name, row, *(scene.names[k] for k in pair))
        yield gain, part
        scene = part.edited(scene)


def _best_row(times, pair):
    """Greatest fall of roughness if tracks (T, 2, d) are exchanged from a row on, and the row."""
    seen = np.flatnonzero(np.isfinite(pair).all(axis=(1, 2)))
    if len(seen) < 2 * WINDOW:
        return 0.0, 0
    times, pair = times[seen], pair[seen]
    kept = _roughness(times, pair)
    typical = max(float(np.median(kept)) / ((2 * WINDOW - 4) * pair[0].size), 1.0)
    gain = (kept - _roughness(times, pair, True)) / typical
    k = int(np.argmax(gain))
    return float(gain[k]), int(seen[k + 1])


def _roughness(times, tracks, is_exchanged=False):
    """What cubics leave of tracks (T, n, d) around every row but the first, (T - 1,)."""
    good = np.isfinite(tracks).all(axis=(1, 2))
    times, tracks = times[good], tracks[good]
    n = len(times)
    if n < 2 * WINDOW:
        return np.zeros(max(n - 1, 0))
    at = np.arange(1, n)
    rows = np.clip(at - WINDOW, 0, n - 2 * WINDOW)[:, None] + np.arange(2 * WINDOW)
    u = times[rows] - times[rows].mean(axis=1, keepdims=True)
    u = u / np.abs(u).max(axis=1, keepdims=True)
    basis, _ = np.linalg.qr(u[..., None] ** np.arange(4))  # (T - 1, 2 W, 4)
    x = tracks[rows]
    if is_exchanged:
        x = np.where((rows >= at[:, None])[..., None, None], x[:, :, ::-1], x)
    x = x.reshape(*rows.shape, -1)
    inside = np.swapaxes(basis, 1, 2) @ x
    return np.square(x - basis @ inside).sum(axis=(1, 2))
