"""Defects of single tracks and frames: swapped labels, a track that was lost, a frame that is off.

Swapped and lost tracks are looked for in the positions alone, so that no law has a say in what
is a defect; whether undoing it explains what a law leaves is then a matter of a fit. Outliers of
single bodies have been seen to before (`data.point_errors`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bsp_gp.data.point_errors import REACH
from bsp_gp.errors import DataError, EvaluationError
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.explanation import MEASUREMENT, Explanation, not_fitted
from bsp_gp.loop.seeing import with_scenes

__all__ = ["bad_frame", "defect_rivals", "frozen_tails", "swaps_of", "without_swaps"]

WINDOW = 4
"""Rows before and after a frame through which a cubic is put to judge whether labels swap."""
MOST_SWAPS = 3
"""In one scene."""
SHORTEST_TAIL = 5
"""Rows for which a body must stand still to count as lost."""
CLEAR = 12.0
"""Fall of chi-squared, beyond what choosing among all frames gives, of a defect."""
ALONE = 4.0
"""How much more a bad frame leaves than the frames beside it."""


@dataclass(frozen=True)
class Swap:
    """Labels of two bodies are exchanged from a row on."""

    scene: str
    row: int
    first: int
    second: int
    gain: float


def defect_rivals(observation, model):
    """Defects of tracks and frames that may leave what a law leaves.

    Parameters
    ----------
    observation : Observation
    model : Model

    Returns
    -------
    list of Explanation
    """
    if model.fit.whole is None or not model.fit.whole.batches:
        return []
    out = []
    for name, finder in (
        ("tracks with swapped labels", _swapped), ("a track that was lost", _lost),
        ("a frame that is off", _bad),
    ):  # fmt: skip
        found, reason = or_fault(finder, observation, model)
        if reason:
            found = not_fitted(observation, model, MEASUREMENT, name, reason)
        out += [] if found is None else [found]
    return out


# --- swapped tracks -------------------------------------------------------------------------------


def swaps_of(scene, sigma):
    """Frames from which two tracks go on more smoothly with their labels exchanged.

    Parameters
    ----------
    scene : Scene
    sigma : ndarray, shape (d,)

    Returns
    -------
    list of Swap
        In the order in which they are undone.
    """
    out = []
    pairs = list(combinations(scene.dynamic.tolist(), 2))
    bar = CLEAR + 2 * np.log(max(len(pairs) * len(scene.times), 2))
    while pairs and len(out) < MOST_SWAPS:
        gain, row, first, second = max((*_best_swap(scene, sigma, a, b), a, b) for a, b in pairs)
        if gain < bar:
            break
        out.append(Swap(scene.name, row, first, second, gain))
        scene = _relabelled(scene, out[-1])
    return out


def _best_swap(scene, sigma, a, b):
    """Greatest fall of the roughness at a row if labels swap there, and the row."""
    axes = np.isfinite(sigma) & (sigma > 0)
    p = scene.positions[:, [a, b]][..., axes] / sigma[axes]
    best = (0.0, 0)
    for row in range(WINDOW, len(scene.times) - WINDOW + 1):
        rows = slice(row - WINDOW, row + WINDOW)
        here, times = p[rows], scene.times[rows]
        if not np.isfinite(here).all():
            continue
        rough = _rough(times)
        other = here.copy()
        other[WINDOW:] = here[WINDOW:, ::-1]
        kept, swapped = (
            np.square(np.einsum("ij,jbd->ibd", rough, path)).sum() for path in (here, other)
        )
        best = max(best, (float(kept - swapped), row))
    return best


def _rough(times):
    """What a cubic through all rows of a window leaves."""
    s = (times - times.mean()) / np.ptp(times)
    basis, _ = np.linalg.qr(s[:, None] ** np.arange(4))
    return np.eye(len(times)) - basis @ basis.T


def _relabelled(scene, swap):
    def exchanged(array):
        if array is None:
            return None
        array = np.array(array)
        array[swap.row :, [swap.first, swap.second]] = array[swap.row :, [swap.second, swap.first]]
        return array

    return replace(
        scene, positions=exchanged(scene.positions), velocities=exchanged(scene.velocities),
        sigma=exchanged(scene.sigma),
    )  # fmt: skip


def without_swaps(scene, sigma):
    """The scene with swapped labels put right, and the swaps."""
    swaps = swaps_of(scene, sigma)
    for swap in swaps:
        scene = _relabelled(scene, swap)
    return scene, swaps


def _swapped(observation, model):
    mended, swaps = _mended(observation, lambda s: without_swaps(s, observation.sigma))
    if not swaps:
        return None
    names = {s.name: s.names for s in observation.train}
    times = {s.name: s.times for s in observation.train}
    text = "; ".join(
        f"{names[w.scene][w.first]} and {names[w.scene][w.second]} exchange their labels at "
        f"t = {times[w.scene][w.row]:.4g} in scene {w.scene}"
        for w in swaps
    )
    n_choices = sum(
        len(s.times) * len(s.dynamic) * (len(s.dynamic) - 1) // 2 for s in observation.train
    )
    return _explained(
        observation, model, mended, "swapped tracks", text, r"x_a \leftrightarrow x_b",
        2 * len(swaps), n_choices,
    )  # fmt: skip


# --- a lost track ---------------------------------------------------------------------------------


def frozen_tails(scene, sigma):
    """Moving bodies that stand still from a row to the end.

    Parameters
    ----------
    scene : Scene
    sigma : ndarray, shape (d,)

    Returns
    -------
    list of (int, int, float)
        Entity, row, and chi-squared of the rest of its track about one place.
    """
    axes = np.isfinite(sigma) & (sigma > 0)
    out = []
    for k in scene.dynamic.tolist():
        p = scene.positions[:, k][:, axes] / sigma[axes]
        seen = np.flatnonzero(np.isfinite(p).all(axis=1))
        found = None
        for start in range(len(seen) - SHORTEST_TAIL, WINDOW, -1):
            tail = p[seen[start:]]
            chisqr = float(np.square(tail - tail.mean(axis=0)).sum())
            dof = (len(tail) - 1) * p.shape[1]
            if chisqr > dof + 4 * np.sqrt(2 * dof):
                break
            found = (k, int(seen[start]), chisqr)
        if found is None:
            continue
        before = p[seen[seen < found[1]][-WINDOW:]]
        speed = np.linalg.norm(before[-1] - before[0]) / (len(before) - 1)
        # Standing still all the time, or coming to rest, is no loss.
        if speed * SHORTEST_TAIL > 10 * np.sqrt(p.shape[1]) and speed > 3:
            out.append(found)
    return out


def _lost(observation, model):
    left = []

    def mend(scene):
        tails = frozen_tails(scene, observation.sigma)
        positions = np.array(scene.positions)
        for k, row, _ in tails:
            positions[row:, k] = np.nan
        left.append(tails)
        return (replace(scene, positions=positions) if tails else scene), [
            (scene.name, scene.names[k], float(scene.times[row]), chisqr)
            for k, row, chisqr in tails
        ]

    mended, tails = _mended(observation, mend)
    if not tails:
        return None
    text = "; ".join(
        f"{body} stands still from t = {t:.4g} in scene {scene}" for scene, body, t, _ in tails
    )
    n_axes = int(np.isfinite(observation.sigma).sum())
    n_choices = sum(len(s.times) * len(s.dynamic) for s in observation.train)
    return _explained(
        observation, model, mended, "a lost track", text, r"\hat{x} = \mathrm{const}",
        (n_axes + 1) * len(tails), n_choices, extra=sum(chisqr for *_, chisqr in tails),
    )  # fmt: skip


# --- a bad frame ----------------------------------------------------------------------------------


def bad_frame(observation, fit):
    """The frame in which all bodies together are most off, if it stands out.

    Where a scene has one body only the frames that `data.point_errors` does not judge: the first
    and the last few.

    Parameters
    ----------
    observation : Observation
    fit : Fit

    Returns
    -------
    (scene name, row, gain, left) or None
        By what a common shift of the frame lowers chi-squared, and what it leaves there.
    """
    best = None
    for batch, errors in zip(fit.whole.batches, fit.whole.whitened, strict=True):
        count = np.maximum((errors != 0).sum(axis=2), 1)
        gains = (np.square(errors.sum(axis=2)) / count).sum(axis=-1)  # (T, S)
        sizes = np.square(errors).sum(axis=(2, 3))
        for s, scene in enumerate(batch.scenes):
            n = len(scene.times)
            rows = np.arange(n)
            if len(scene.dynamic) == 1 and n >= 2 * REACH + 3:
                rows = np.concatenate([rows[:REACH], rows[-REACH:]])
            gain = gains[:n, s]
            beside = np.maximum(np.append(gain[1:], 0.0), np.append(0.0, gain[:-1]))
            beside[[0, -1]] *= 4  # an end has one neighbour, and a track that bends away
            for row in rows[gain[rows] > ALONE * beside[rows]]:
                if best is None or gain[row] > best[2]:
                    left = float(sizes[row, s] - gain[row])
                    best = (scene.name, int(row), float(gain[row]), left)
    return best


def _bad(observation, model):
    if observation.memory:
        return None
    found = bad_frame(observation, model.fit)
    n_choices = sum(len(s.times) for s in observation.train)
    if found is None or found[2] < CLEAR + 2 * np.log(n_choices):
        return None
    segment = next(s for s in observation.segments if s.name == found[0])
    time = float(segment.times[found[1]])
    name = found[0] if any(s.name == found[0] for s in observation.train) else (
        found[0].partition("[")[0]
    )  # fmt: skip

    def mend(scene):
        if scene.name != name or time not in scene.times:
            return scene, []
        positions = np.array(scene.positions)
        positions[np.searchsorted(scene.times, time), scene.dynamic] = np.nan
        return replace(scene, positions=positions), [name]

    mended, _ = _mended(observation, mend, only_train=True)
    n_axes = int(np.isfinite(observation.sigma).sum())
    return _explained(
        observation, model, mended, "one bad frame",
        f"the frame at t = {time:.4g} of scene {name} is shifted as a whole",
        r"\hat{x}(t_k) = x(t_k) + a", n_axes + 1, n_choices, extra=found[3],
    )  # fmt: skip


# --- what is common -------------------------------------------------------------------------------


def _mended(observation, mend, only_train=False):
    """The observation with mended scenes, and what was mended in training scenes."""
    train, found = [], []
    for scene in observation.train:
        scene, more = mend(scene)
        train.append(scene)
        found += more
    if not found:
        return None, []
    test = observation.test if only_train else tuple(mend(s)[0] for s in observation.test)
    return (tuple(train), tuple(test)), found


def _explained(observation, model, scenes, name, text, latex, n_free, n_choices, extra=0.0):
    """The explanation by a defect; `extra` is the chi-squared of rows that were left out."""
    from scipy import stats

    try:
        seen = with_scenes(observation, *scenes)
        fit = seen.fit(model.fit.law, sign_bounds(observation, model.fit.law))
    except (DataError, EvaluationError):
        return None
    fit = replace(fit, chisqr=fit.chisqr + extra, n_rows=model.fit.n_rows)
    gain = model.fit.chisqr - fit.chisqr
    dof = max(fit.n_rows - model.fit.whole.n_free, 1)
    misfit = max(fit.chisqr / dof, 1.0)
    return Explanation(
        MEASUREMENT, name, text, latex, seen, fit, n_free,
        reason="" if gain > 0 else "it explains nothing of what is left",
        details={
            "p_value": float(min(1.0, n_choices * stats.chi2.sf(max(gain, 0) / misfit, n_free))),
            "is_defect": True,
        },
    )  # fmt: skip
