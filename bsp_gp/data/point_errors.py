"""Gross outliers among measured positions, found before any law is fitted.

No law can profit from what is left out.
"""

from functools import lru_cache

import numpy as np

REACH = 5
"""Points before and after by which a point is predicted."""
FAR = 5.0
"""Deviations, in standard deviations of what is predicted from neighbours, of a gross error."""
FAR_ALONE = 7.0
"""The same of one within reach of an end, or in a short track."""
FAR_STEP = 3.0
"""Steps as a body usually takes them, of one to an end that it did not take."""
MOST_GROSS = 0.2
"""Part of a track; where more points are off, the motion itself is rough."""
LEAST = 2 * REACH + 3
"""Points of a track that is judged."""
LONG = 30
"""Points of a track in which one that is far off does not change what is usual."""
TRIED = 3
"""Points of a shorter one that are looked at."""
APART, MANY = 4 * REACH, 1000
"""Points of which the furthest off is taken out in one turn, where a track has that many: one that
is off is in the prediction of those beside it, and no further."""
ALONE = 2
"""Points on either side that must not be far off as well."""
BOTH = (-2, -1, 1, 2), 3
BEFORE = tuple(range(-REACH, 0)), 2
AFTER = tuple(range(1, REACH + 1)), 2
"""Neighbours of a point, and the degree of the polynomial through them that predicts it."""
KEPT = 50_000
"""Points of a track whose weights are kept: it is looked at again under every estimate of its
noise."""
EVEN = 0.01
"""Of the noise, up to which it does not matter where a body is between two times."""
ENDS = {
    0: ((1,), 0), 1: ((-1,), 0), 2: ((-2, -1), 1), 3: ((-3, -2, -1), 2), 4: ((-4, -3, -2, -1), 2),
}  # fmt: skip
"""Those on the short side of the first points of a track."""


def gross_errors(times, positions, sigma, *, is_exact=False):
    """Deviation of gross errors from their neighbours, in sigma; 1 elsewhere.

    A point counts as a gross error if the two points before and the two after it, the five
    before it and the five after it all predict another place. Where a body is hit, one of the
    two sides still predicts it, and so a collision is no error. Within five points of an end there
    are fewer on that side, and none beyond the last one: it must lie further from the next than
    the body usually goes in a step. What is far off there, or in a short track, must be so alone:
    with it left out, the points beside it must be where they are expected.

    Parameters
    ----------
    times : ndarray, shape (T,)
    positions : ndarray, shape (T, d)
        nan where not seen.
    sigma : ndarray, shape (d,)
    is_exact : bool
        Whether the positions have no noise that could hide a bend of the motion: then points must
        be off alone everywhere.

    Returns
    -------
    ndarray, shape (T,)
    """
    off = np.ones(len(times))
    axes = np.isfinite(sigma) & (sigma > 0)
    rows = np.flatnonzero(np.isfinite(positions[:, axes]).all(axis=1))
    if not axes.any() or len(rows) < LEAST:
        return off
    most, seen = max(int(MOST_GROSS * len(rows)), 1), rows
    for _ in range(most + 1):
        size, worst = _worst(times[rows], positions[np.ix_(rows, axes)], sigma[axes], is_exact)
        if not len(worst):
            return _without_passages(off, seen)
        off[rows[worst]] = np.maximum(size, 1.0)
        rows = np.delete(rows, worst)
        if len(rows) < LEAST:
            return _without_passages(off, seen)
        if np.count_nonzero(off > 1) > most:
            break
    return np.ones(len(times))  # so many are off that the motion itself is rough


def _without_passages(off, rows):
    """The same without what is off in more rows on end than predict one: a passage, no errors.

    Of an orbit in coarse steps the rows about the nearest place are off their neighbours one by
    one, as these are left out.
    """
    is_off = np.concatenate([[0], off[rows] > 1, [0]])
    edges = np.flatnonzero(np.diff(is_off))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - first > REACH:
            off[rows[first:stop]] = 1.0
    return off


def are_smooth(times, positions, sigma):
    """Which of many tracks surely have no gross error, at the cost of a few tracks.

    Parameters
    ----------
    times : ndarray, shape (S, T)
    positions : ndarray, shape (S, T, d)
    sigma : ndarray, shape (d,)

    Returns
    -------
    ndarray of bool, shape (S,)
        False also where that is not told: rows are not seen, or at uneven times.
    """
    axes = np.isfinite(sigma) & (sigma > 0)
    out = np.isfinite(positions[..., axes]).all(axis=(1, 2))
    if not axes.any() or times.shape[1] < LEAST:
        return out
    out[out] = [
        _is_even(t, x, sigma[axes])
        for t, x in zip(times[out], positions[out][..., axes], strict=True)
    ]
    _, far, beyond = _deviations(None, positions[out][..., axes], sigma[axes])
    is_long = times.shape[1] >= LONG
    out[out] = (far if is_long else beyond).max(axis=-1) <= FAR
    return out


def _worst(times, x, sigma, is_exact):
    """Sizes in sigma of points that are furthest off, and which they are, of each stretch one."""
    n = len(times)
    size, far, beyond = _deviations(times, x, sigma)
    if n >= MANY:
        order = np.flatnonzero(_is_peak(far) & (far > FAR))
        is_inner = (order >= REACH) & (order < n - REACH) & (not is_exact)
        kept = [
            inner or _is_alone(times[part], x[part], sigma, row - part.start)
            for row, inner in zip(order, is_inner, strict=True)
            for part in [slice(max(row - MANY, 0), row + MANY)]
        ]
        worst = order[np.array(kept, dtype=bool)]
        return size[worst], worst
    order = np.argsort(-far, kind="stable")
    if n >= LONG:
        order = order[: np.count_nonzero(far > FAR)]
    else:  # one that is off makes everything look usual
        order = [row for row in order[:TRIED] if beyond[row] > FAR]
    for row in order:
        is_inner = REACH <= row < n - REACH
        if (n >= LONG and is_inner and not is_exact) or _is_alone(times, x, sigma, row):
            return size[[row]], np.array([row])
    return np.ones(0), np.zeros(0, dtype=int)


def _is_peak(values):
    """Whether a value is the first greatest of those up to `APART` / 2 before and after it."""
    half = APART // 2
    padded = np.pad(values, half, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, APART + 1)
    return windows.argmax(axis=1) == half


def _is_alone(times, x, sigma, row):
    """Whether a point is far off by what is usual without it, and those beside it are not."""
    kept = np.delete(np.arange(len(times)), row)
    usual = {}
    others = _deviations(times[kept], x[kept], sigma, usual)[1]
    beside = others[max(row - ALONE, 0) : row + ALONE]
    return _deviations(times, x, sigma, usual)[1][row] > FAR_ALONE and beside.max() <= FAR


def _deviations(times, x, sigma, usual=None):
    """Size of what points (..., T, d) are off, in sigma; how far by what is usual, by sigma alone.

    Times of None are even; `usual`, the deviation by set of neighbours, is filled in where it
    lacks.
    """
    shape = x.shape[:-1]
    n = shape[-1]
    usual = {} if usual is None else usual
    size, far, beyond = np.ones(shape), np.full(shape, np.inf), np.full(shape, np.inf)
    is_even = times is None or _is_even(times, x, sigma)
    for (offsets, degree), judged in _neighbours(n):
        rows = np.arange(max(-offsets[0], 0), n - max(offsets[-1], 0))
        nodes = rows[:, None] + np.array(offsets)
        if is_even:
            weights = _evenly(offsets, degree)
        elif n <= MANY:
            weights = _unevenly(times.tobytes(), offsets, degree)
        elif n <= KEPT:
            weights = _unevenly_of_many(times.tobytes(), offsets, degree)
        else:
            weights = _along(times, offsets, degree)
        gap = np.abs(x[..., rows, :] - (weights[..., None] * x[..., nodes, :]).sum(axis=-2)) / sigma
        z = gap / np.sqrt(1 + np.square(weights).sum(axis=1))[:, None]
        if (offsets, degree) not in usual:
            # The motion itself is no polynomial: what is usual on this track is no error.
            middle = np.median(z, axis=-2, keepdims=True)
            usual[offsets, degree] = np.maximum(1.4826 * middle, 1.0)
        ratio = (z / usual[offsets, degree]).max(axis=-1)
        if degree == 0:
            ratio *= FAR_ALONE / FAR_STEP
        own = judged - rows[0]
        far[..., judged] = np.minimum(far[..., judged], ratio[..., own])
        beyond[..., judged] = np.minimum(beyond[..., judged], z.max(axis=-1)[..., own])
        if (offsets, degree) in (BEFORE, AFTER, BOTH):
            size[..., judged] = gap.max(axis=-1)[..., own]
    return size, far, beyond


def _is_even(times, x, sigma):
    """Whether times are even, up to what moves the body by far less than its noise."""
    steps = np.diff(times)
    fastest = np.abs(np.diff(x, axis=0) / steps[:, None]).max(axis=0)
    return bool(np.all(np.ptp(steps) * fastest < EVEN * sigma))


def _neighbours(n):
    """Sets of neighbours, each with the degree of its polynomial, and the rows that it judges."""
    yield BEFORE, np.arange(REACH, n)
    yield AFTER, np.arange(n - REACH)
    yield BOTH, np.arange(2, n - 2)
    for sign in (1, -1):
        for place, (offsets, degree) in ENDS.items():
            turned = offsets if sign > 0 else tuple(-k for k in reversed(offsets))
            yield (turned, degree), np.array([place if sign > 0 else n - 1 - place])


@lru_cache
def _evenly(offsets, degree):
    """The same at even times, (1, k)."""
    return _predicting(np.array([offsets], dtype=float), np.zeros(1), degree)


@lru_cache(maxsize=128)
def _unevenly(times, offsets, degree):
    """The same at times (T,) given as bytes, (n, k): copies of a track have those of the track."""
    return _along(np.frombuffer(times), offsets, degree)


@lru_cache(maxsize=32)
def _unevenly_of_many(times, offsets, degree):
    """The same of so many times that few tracks are remembered."""
    return _along(np.frombuffer(times), offsets, degree)


def _along(times, offsets, degree):
    rows = np.arange(max(-offsets[0], 0), len(times) - max(offsets[-1], 0))
    return _predicting(times[rows[:, None] + np.array(offsets)], times[rows], degree)


def _predicting(nodes, at, degree):
    """Weights of the least squares polynomial through nodes (n, k) at places (n,), (n, k)."""
    s = nodes - at[:, None]
    s = s / np.abs(s).max(axis=1, keepdims=True)
    if np.ptp(s, axis=0).max() < 1e-9:  # even times: all rows have the same weights
        s = s[:1]
    powers = s[..., None] ** np.arange(degree + 1)
    gram = np.swapaxes(powers, 1, 2) @ powers
    first = np.eye(degree + 1)[None, :, :1]
    try:
        found = np.linalg.solve(gram, first)
    except np.linalg.LinAlgError:  # most of the times are one, beside one that is far off
        found = np.linalg.pinv(gram, hermitian=True) @ first
    return (powers @ found)[..., 0]
