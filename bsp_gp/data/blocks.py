"""Long tracks of dense rows, averaged over blocks so short that the motion is a parabola in them.

The means of a block's rows, less what the bend of the track adds to them, tell as much of a smooth
motion as the rows do: nothing is thinned out. What they cannot tell, events and noise within a
block, is looked for first, and where there is any the rows are left as they are. Places that are
sums of velocities are taken at the ends of blocks: what is gone in between is that of all rows.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.point_errors import gross_errors
from bsp_gp.data.scene import Evaluation

MOST_ROWS = 1200
"""Rows of a scene that are handled as they are; blocks make so many of more."""
BENT, APART = 0.02, 4
"""What is left of the bend of a track may move the mean of a block by so many of its standard
errors; the bend is told by blocks so many blocks apart, where noise hides it less."""
OFF_CURVE = APART**2 / 288
"""Of the fourth derivative of a track, what its bend as it is told so is off by in a mean: in the
fourth power of the length of a block."""
KINKED = 6.0
"""Standard deviations by which a mean may be off its neighbours' curve: more is a kick."""
LEAST_LENGTH = 4
"""Rows of a block from which it is told by itself whether there is more than noise in it."""
LEAST_BENT = 6
"""Rows of a block from which it is told whether they lie on a parabola, and not on a line."""
NO_MORE = 5e-3
"""Part of how much measured velocities vary up to which it does not matter what is lost of them."""
SCATTER = 1.1
"""Variance within blocks, in that of the noise from row to row, up to which there is no more."""
UNEVEN = 3.0
"""Median intervals up to which one between two rows is no gap."""
COARSE = 1.5
"""Standard deviations of the noise up to which rounded positions may be averaged."""
DENSE = 20
"""Times as many rows as are handled, from which on those are averaged that lie on a grid which
noise does not fill: nearly all hold the place of the row before."""


def in_blocks(dataset, most_rows=MOST_ROWS):
    """The data set with its long, dense tracks averaged, and a note of it; itself without such.

    Nothing is done where rows are counted (`Evaluation`), noise is exact or has a declared memory,
    accelerations were measured, bodies may touch, or rows come at uneven times. Gross errors are in
    no mean, which is told. About `most_rows` are left of a longer scene.
    """
    is_plain = dataset.evaluation == Evaluation() and not dataset.noise_memory
    if dataset.n_sums == 1 and is_plain:
        return _in_steps(dataset, most_rows)
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
                "s, within which the tracks are parabolas up to noise; errors are those of the "
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
    is_told = scene.sigma is not None or declared is not None
    is_coarse = _is_coarse(scene, moving, axes, sigma)
    if is_coarse and (is_told or n <= DENSE * most_rows):
        return scene, 0
    positions = scene.positions.copy()
    for k in moving:
        positions[gross_errors(scene.times, scene.positions[:, k], sigma) > 1, k] = np.nan
    n_far = int(np.isnan(positions).sum() - np.isnan(scene.positions).sum()) // scene.n_dims
    tracks, longest = positions[:, moving][..., axes], -(-n // most_rows)
    length = _length_of(tracks, sigma[axes], longest, is_coarse)
    if length < 2:
        return scene, 0
    made = _means(scene, positions, n // length, declared)
    bend = np.zeros_like(made.positions)
    for k in moving:
        bend[:, k] = _bend(made.positions[:, k])
    return replace(made, positions=made.positions - bend / 24), n_far


def _is_coarse(scene, moving, axes, sigma):
    """Whether places lie on grids that noise does not fill."""
    for k, axis in ((k, axis) for k in moving for axis in axes):
        gaps = np.diff(np.unique(scene.positions[:MOST_ROWS, k, axis]))
        if gaps.size and np.nanmin(gaps) > COARSE * sigma[axis]:
            return True
    return False


def _length_of(tracks, sigma, longest, is_coarse):
    """Rows of blocks, a half, quarter ... of the longest, within which tracks are smooth."""
    length = longest
    while length > 1 and not _is_smooth(tracks, sigma, length, is_coarse):
        length //= 2
    return length


def _is_smooth(tracks, sigma, length, is_coarse=False):
    """Whether tracks (n, R, a) are parabolas within blocks, but for noise of a size (a,).

    That of rows on a coarse grid has a memory: a mean may be as far off as a row is.
    """
    count = len(tracks) // length
    blocks = tracks[: count * length].reshape(count, length, *tracks.shape[1:])
    means, error = blocks.mean(axis=1), sigma / np.sqrt(1 if is_coarse else length)
    known = np.isfinite(means)
    if 2 * known.all(axis=(1, 2)).sum() < count or count <= 4 * APART:
        return False
    means = np.where(known, means, np.nan)
    off = _differences(means, 4) / APART**4
    beyond = np.nanmean(np.square(off), axis=0) - 70 * np.square(error) / APART**8
    if np.any(OFF_CURVE * np.sqrt(np.maximum(beyond, 0.0)) > BENT * error):
        return False
    at_once = np.diff(means, 2, axis=0)[APART - 1 : 1 - APART] - _differences(means, 2) / APART**2
    if np.nanmax(np.abs(at_once) / error) > KINKED * np.sqrt(6.0):
        return False
    if is_coarse:
        return True
    blocks = _of_rows_enough(blocks)
    blocks = blocks[np.isfinite(blocks).all(axis=(1, 2, 3))]
    return len(blocks) > 0 and bool(np.all(_scatter(blocks) < SCATTER * np.square(sigma)))


def _of_rows_enough(blocks):
    """Blocks (n, length, ...), two for one where they are so short that noise fills them."""
    count, length = blocks.shape[:2]
    if length >= LEAST_LENGTH:
        return blocks
    return blocks[: count // 2 * 2].reshape(count // 2, 2 * length, *blocks.shape[2:])


def _differences(means, order):
    """Differences of an order of means (n, ...) so many blocks apart."""
    for _ in range(order):
        means = means[APART:] - means[:-APART]
    return means


def _bend(means):
    """Second derivatives of tracks (n, a) in blocks squared; beyond both ends on a line."""
    inner = _differences(means, 2) / APART**2
    seen = np.arange(APART, len(means) - APART)
    out = np.empty_like(means)
    for axis in range(means.shape[1]):
        known = np.isfinite(inner[:, axis])
        if not known.any():
            out[:, axis] = 0.0
            continue
        at, bend = seen[known], inner[known, axis]
        out[:, axis] = np.interp(np.arange(len(means)), at, bend)
        if len(at) > APART:
            for end, near in ((slice(0, at[0]), 0), (slice(at[-1] + 1, None), -1)):
                far = APART if near == 0 else -1 - APART
                slope = (bend[far] - bend[near]) / (at[far] - at[near])
                out[end, axis] += slope * (np.arange(len(means))[end] - at[near])
    return out


def _scatter(blocks):
    """Variances (a,) of blocks (n, length, R, a) beside a parabola each, or a line where short."""
    length = blocks.shape[1]
    order = 2 if length >= LEAST_BENT else 1
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, length), order + 1))
    left = blocks - np.einsum("lo,mo,nm...->nl...", basis, basis, blocks)
    n_tracks = blocks.shape[2]
    dof = len(blocks) * n_tracks * (length - order - 1)
    return np.square(left).sum(axis=(0, 1, 2)) / dof


def _in_steps(dataset, most_rows):
    """Sums of velocities at the ends of longer steps, in which these are parabolas up to noise.

    One length for all scenes, since errors of a step are declared for all.
    """
    longest = max(len(scene.times) for scene in dataset.scenes)
    length = -(-longest // most_rows)
    while length > 1 and not all(_has_smooth_velocities(s, length) for s in dataset.scenes):
        length //= 2
    if length < 2:
        return dataset
    scenes = tuple(_at_ends(scene, length) for scene in dataset.scenes)
    noise = dataset.noise and tuple(length**0.5 * level for level in dataset.noise)
    told = f"places are taken at every {length} rows' end: what is gone between them is of all rows"
    return replace(dataset, scenes=scenes, noise=noise, notes=(*dataset.notes, told))


def _has_smooth_velocities(scene, length):
    """Whether velocities are parabolas within blocks, but for noise or what does not matter."""
    steps = np.diff(scene.times)
    tracks = scene.positions[:, list(scene.dynamic)]
    if not np.isfinite(tracks).all() or steps.max() > UNEVEN * np.median(steps):
        return False
    velocities = np.diff(tracks, axis=0) / steps[:, None, None]
    count = len(velocities) // length
    if count <= 4 * APART:
        return False
    blocks = velocities[: count * length].reshape(count, length, *velocities.shape[1:])
    rough = np.diff(velocities, 4, axis=0).reshape(-1, velocities.shape[-1])
    noise = (1.4826 * np.median(np.abs(rough), axis=0)) ** 2 / 70
    lost = np.square(NO_MORE) * velocities.var(axis=(0, 1))
    return bool(np.all(_scatter(_of_rows_enough(blocks)) <= SCATTER * noise + lost))


def _at_ends(scene, length):
    """Every so many of the rows of a scene, with the errors of as many steps together."""
    def thinned(values, power=0.0):
        return None if values is None else values[::length] * length**power

    return replace(
        scene, times=scene.times[::length], positions=scene.positions[::length],
        sigma=thinned(scene.sigma, 0.5), velocities=thinned(scene.velocities),
        inputs={name: thinned(values) for name, values in scene.inputs.items()},
    )  # fmt: skip


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
