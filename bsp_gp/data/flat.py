"""Axes along which no body moves beyond its noise, as of carts on a straight track.

There a track tells nothing but noise, and places that are off by as much would have forces between
bodies push aside what a track or a table holds.
"""

from dataclasses import replace

import numpy as np
from scipy import fft, stats

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.data.scene import Evaluation

LEAST_ROWS, SLOW = 8, 3
"""Rows that tell whether a body moves, and waves over a track by which slow motion is told."""
SWEPT = 30.0
"""Times that motion along another axis must be larger than the noise."""
DIFFERENCES, TIED = 20, 2.3
"""Variance of third differences of white noise, in its own, and how many of them are as one."""
CHANCE = 0.01
"""By which noise alone may look as much like motion, at the least."""


def held_flat(dataset, spoken=()):
    """The data set with bodies at rest along axes on which they show nothing but noise.

    Every body of every scene must be so; a note tells it. Nothing is done where rows are counted
    (`Evaluation`), velocities are data, or the data are of the sky. Along the axes in `spoken`, of
    which a declared law speaks, bodies are free.
    """
    is_plain = dataset.evaluation == Evaluation() and dataset.velocity != "measured"
    is_plain = is_plain and all(scene.first is None for scene in dataset.scenes)
    if not is_plain or is_of_the_sky(dataset):
        return dataset
    dataset = _in_plane(dataset, spoken)
    tracks = [_tracks(dataset, axis) for axis in range(dataset.n_dims)]
    spans = [max((float(np.ptp(x)) for x in own if len(x)), default=0.0) for own in tracks]
    moving = [k for k, span in enumerate(spans) if span > 0]
    flat = [k for k in moving if "xyz"[k] not in spoken and _is_flat(tracks[k])]
    swept = max((spans[k] for k in moving if k not in flat), default=0.0)
    if not flat or swept < SWEPT * max(_level(tracks[k]) for k in flat):
        return dataset
    scenes = tuple(_at_rest(scene, flat) for scene in dataset.scenes)
    names = " and ".join("xyz"[k] for k in flat)
    note = (
        f"along {names} no body moves beyond its noise: {'it is' if len(flat) == 1 else 'they are'}"
        " taken as at rest there, as on a track or a table"
    )
    held = replace(dataset, scenes=scenes, notes=(*dataset.notes, note))
    return _in_plane(held, spoken)


def _in_plane(dataset, spoken):
    """Data whose height z does not change, as data of a plane, with a note.

    Of walkers whose heads are tracked above a floor, say, or of a tracker that writes a column of
    zeros. What pulls to a place does so in the plane, and may pull across. Nothing is done where
    something is at another height, or a law speaks of the axis.
    """
    scenes = dataset.scenes
    if dataset.n_dims < 3 or "z" in spoken or (dataset.up or "").strip("-") == "z":
        return dataset
    if any(np.nanmin(z) != np.nanmax(z) for z in (s.positions[..., 2] for s in scenes)):
        return dataset
    flat = tuple(
        replace(s, positions=s.positions[..., :2], sigma=s.sigma if s.sigma is None else
                s.sigma[..., :2])
        for s in scenes
    )  # fmt: skip
    note = "z does not change: the motion is taken as one in a plane"
    noise = dataset.noise and dataset.noise[:2]
    return replace(dataset, scenes=flat, noise=noise, notes=(*dataset.notes, note))


def _tracks(dataset, axis):
    """Seen coordinates of every body of every scene."""
    tracks = [s.positions[:, k, axis] for s in dataset.scenes for k in s.dynamic]
    return [values[np.isfinite(values)] for values in tracks]


def _level(tracks):
    """Noise from row to row, told by third differences."""
    steps = np.concatenate([np.diff(x, 3) for x in tracks])
    return float(np.sqrt(np.mean(np.square(steps)) / DIFFERENCES))


def _is_flat(tracks):
    """Whether no track shows a slope, a bend or a wave, beside the noise from row to row."""
    if not tracks or min(map(len, tracks)) < LEAST_ROWS:
        return False
    variance = _level(tracks) ** 2
    if not variance > 0:
        return False
    # Cosines are independent under white noise; the first few are what a slow motion shows.
    waves = [np.square(fft.dct(x - x.mean(), norm="ortho")[1:]) / variance for x in tracks]
    n_steps = sum(len(x) - 3 for x in tracks)
    doubt = 1 + np.sqrt(2 * TIED / n_steps)  # of the variance itself
    slow = sum(float(w[:SLOW].sum()) for w in waves)
    total = sum(float(w.sum()) for w in waves)
    largest = max(float(w.max()) for w in waves)
    count = sum(map(len, waves))
    chances = (
        stats.chi2.sf(slow / doubt, SLOW * len(waves)),
        stats.chi2.sf(total / doubt**2, count),
        -np.expm1(count * np.log1p(-stats.chi2.sf(largest / doubt, 1))),
    )
    return min(chances) > CHANCE / len(chances)


def _at_rest(scene, axes):
    """A scene whose bodies stay where they are on the average along some axes."""
    positions = scene.positions.copy()
    for k in scene.dynamic:
        for axis in axes:
            values = positions[:, k, axis]
            positions[:, k, axis] = np.where(np.isfinite(values), np.nanmean(values), np.nan)
    return replace(scene, positions=positions)
