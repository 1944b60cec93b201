"""Long tracks of dense rows, averaged over blocks so short that the motion bends little in them.

The means of a block's rows tell as much of a smooth motion as the rows do: nothing is thinned out.
What they cannot tell, events and noise within a block, is looked for first, and where there is any
the rows are left as they are.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.point_errors import gross_errors
from bsp_gp.data.scene import Evaluation

MOST_ROWS = 5000
"""Rows of a scene that are handled as they are; blocks make so many of more."""
BENT, COARSER = 0.02, 4
"""What the bend of a track moves the mean of a block by, in its standard error, at the most; the
bend is told by blocks so many times as long, where noise hides it less."""
SCATTER = 1.1
"""Variance within blocks, in that of the noise from row to row, up to which there is no more."""
UNEVEN = 3.0
"""Median intervals up to which one between two rows is no gap."""
COARSE = 1.5
"""Standard deviations of the noise up to which rounded positions may be averaged."""


def in_blocks(dataset, most_rows=MOST_ROWS):
    """The data set with its long, dense tracks averaged, and a note of it; itself without such.

    Nothing is done where rows are counted (`Evaluation`), noise is exact, adds up or has a declared
    memory, bodies may touch, or rows come at uneven times. Gross errors are in no mean, which is
    told. About `most_rows` are left of a longer scene.
    """
    is_plain = dataset.evaluation == Evaluation() and not dataset.noise_memory
    is_plain &= not dataset.is_summed
    if not is_plain or all(len(scene.times) <= most_rows for scene in dataset.scenes):
        return dataset
    sigma = np.array(estimate_noise(dataset).sigma)
    scenes, notes = [], list(dataset.notes)
    for scene in dataset.scenes:
        made, n_far = _averaged(scene, sigma, dataset.noise, most_rows)
        if made is not scene:
            n, left = len(scene.times), len(made.times)
            span = (scene.times[-1] - scene.times[0]) / left
            far = f"; points far off their neighbours are in none: {n_far}" if n_far else ""
            notes.append(
                f"{scene.name}: {n:,} dense rows were averaged over {left:,} blocks of {span:.3g} "
                "s, within which the tracks are straight up to noise; errors are those of the "
                f"means{far}"
            )
        scenes.append(made)
    if all(a is b for a, b in zip(scenes, dataset.scenes, strict=True)):
        return dataset
    return replace(dataset, scenes=tuple(scenes), notes=tuple(notes))


def _averaged(scene, sigma, declared, most_rows):
    """A scene of means, and points that are in none; itself where means tell less than rows."""
    n, steps = len(scene.times), np.diff(scene.times)
    moving, axes = list(scene.dynamic), np.flatnonzero(np.isfinite(sigma))
    can_touch = sum(e.shape != "point" for e in scene.entities) > 1
    is_known = scene.first is not None  # of the first row, and no mean
    if n <= most_rows or can_touch or is_known or steps.max() > UNEVEN * np.median(steps):
        return scene, 0
    for k, axis in ((k, axis) for k in moving for axis in axes):
        gaps = np.diff(np.unique(scene.positions[:MOST_ROWS, k, axis]))
        if gaps.size and np.nanmin(gaps) > COARSE * sigma[axis]:
            return scene, 0
    positions = scene.positions.copy()
    for k in moving:
        positions[gross_errors(scene.times, scene.positions[:, k], sigma) > 1, k] = np.nan
    n_far = int(np.isnan(positions).sum() - np.isnan(scene.positions).sum()) // scene.n_dims
    tracks, length = positions[:, moving][..., axes], -(-n // most_rows)
    while length > 1 and not _is_straight(tracks, sigma[axes], length):
        length //= 2
    if length < 2:
        return scene, 0
    return _means(scene, positions, n // length, declared), n_far


def _is_straight(tracks, sigma, length):
    """Whether tracks (n, R, a) are straight within blocks, but for noise of a size (a,)."""
    count = len(tracks) // length
    blocks = tracks[: count * length].reshape(count, length, *tracks.shape[1:])
    blocks = blocks[np.isfinite(blocks).all(axis=(1, 2, 3))]
    if 2 * len(blocks) < count:
        return False
    means = blocks.mean(axis=1)
    error = sigma / np.sqrt(length)
    joined = means[: len(means) // COARSER * COARSER]
    joined = joined.reshape(-1, COARSER, *means.shape[1:]).mean(axis=1)
    bend = np.square(np.diff(joined, 2, axis=0)).mean(axis=0) - 6 * np.square(error) / COARSER
    if np.any(np.sqrt(np.maximum(bend, 0.0)) / (24 * COARSER**2) > BENT * error):
        return False
    if length < 4:
        return True
    place = np.arange(length) - (length - 1) / 2
    slope = np.tensordot(place, blocks, (0, 1)) / (place @ place)
    left = blocks - means[:, None] - place[:, None, None] * slope[:, None]
    scatter = np.square(left).sum(axis=(0, 1)) / (len(blocks) * (length - 2))
    return bool(np.all(scatter < SCATTER * np.square(sigma)))


def _means(scene, positions, count, declared):
    """The scene with the means of so many blocks for rows."""
    edges = np.round(np.linspace(0, len(scene.times), count + 1)).astype(int)[:-1]

    def mean(values, power=1):
        if values is None:
            return None
        known = np.isfinite(values)
        counts = np.add.reduceat(known.astype(float), edges)
        sums = np.add.reduceat(np.where(known, values, 0.0), edges)
        with np.errstate(invalid="ignore"):
            return sums / counts**power

    sigma = scene.sigma
    if sigma is None and declared is not None:
        levels = np.resize(np.array(declared, dtype=float), positions.shape[-1])
        sigma = np.broadcast_to(levels, positions.shape)
    if sigma is not None:
        sigma = np.sqrt(mean(np.square(np.where(np.isfinite(positions), sigma, np.nan)), 2))
    return replace(
        scene, times=mean(scene.times), positions=mean(positions), sigma=sigma,
        velocities=mean(scene.velocities),
        inputs={name: mean(values) for name, values in scene.inputs.items()},
    )  # fmt: skip
