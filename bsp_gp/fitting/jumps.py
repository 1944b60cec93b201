"""Velocities that jump: where bodies were hit, and what tracks tell between such instants.

Wherever the velocity jumps between two rows, and the rows on both sides lie on parabolas of one
acceleration, a body was hit. Curves through rows on both sides would tell velocities that no body
had: states are read off the rows of one side.
"""

import math
from dataclasses import dataclass

import numpy as np

SIDE_ROWS = (4, 7, 12, 20)
"""Rows on each side of a jump that are looked at."""
LONGEST, CURVED = 20, 6
"""Those that are looked at only where fewer rows show nothing for their errors, and the degree of
the smooth motion that a jump must explain so many better than."""
CLEAR, CLEAR_THERE = 50.0, 12.0
"""Chi-squared by which a jump must explain them better than a motion that is smooth, anywhere and
where a wall is known to stand."""
NEAR = 5.0
"""Errors within which a jump is at a wall."""
QUICK, ACROSS = 6, 4.0
"""Rows from one turn to the next below which a swing is too fast for jumps to be told, and errors
that it goes between two of them."""
EXACT = 1e-6
"""Part of the extent below which errors are none."""
EVEN = 1e-9
"""Part of a window by which its times may differ from those of all others."""
WINDOW, LEAST_ROWS = 9, 5
"""Rows of the parabolas that states between jumps are read off; fewer tell no acceleration."""


@dataclass(frozen=True)
class Jump:
    """A velocity that jumps.

    Attributes
    ----------
    time : float, s
    place : ndarray, shape (d,), m
    before, after : ndarray, shape (d,), m/s
    pull : ndarray, shape (d,), m/s^2
        Acceleration on both sides.
    error : float, m
        Of a coordinate of a row.
    gain : float
        Chi-squared that it explains beside a smooth motion.
    """

    time: float
    place: np.ndarray
    before: np.ndarray
    after: np.ndarray
    pull: np.ndarray
    error: float
    gain: float


def jumps(times, places, levels=None):
    """Jumps of the velocity of a track in the order of time, the rows on both sides being smooth.

    Parameters
    ----------
    times : ndarray, shape (T,)
    places : ndarray, shape (T, d)
        nan where not seen.
    levels : mapping of (int, int) to float, optional
        Where walls are known to stand, by axis and side: jumps there need not be as clear.
    """
    seen = np.isfinite(places).all(axis=1)
    times, places = times[seen], places[seen]
    if len(times) < 2 * SIDE_ROWS[0] or not np.ptp(places, axis=0).any():
        return []
    error, every = scatter(places), []
    if any(n_turns(x, ACROSS * error) > len(x) / QUICK for x in places.T):
        return []  # bodies that swing so fast turn within what a jump is told by
    for rows in SIDE_ROWS:
        if len(times) >= 2 * rows:
            own = _jumps(times, places, rows, error, levels or {})
            every += [(rows == LONGEST, -jump.gain, at, jump) for at, jump in own]
    every.sort(key=lambda found: found[:3])
    out = {}
    for *_, at, jump in every:
        if all(abs(at - other) >= SIDE_ROWS[0] for other in out):
            out[at] = jump
    return [out[at] for at in sorted(out)]


def n_turns(x, least):
    """How often a coordinate turns back by more than so much."""
    low = high = x[0]
    count, way = 0, 0
    for value in x[1:].tolist():
        low, high = min(low, value), max(high, value)
        if way >= 0 and value < high - least:
            count, way, low = count + (way > 0), -1, value
        elif way <= 0 and value > low + least:
            count, way, high = count + (way < 0), 1, value
    return count


def scatter(places):
    """Error of a coordinate (T, d) as neighbouring rows tell it, few jumps aside, m.

    Zero where nothing moves, or is seen at fewer than four rows.
    """
    places = places[np.isfinite(places).all(axis=1)]
    moving = np.ptp(places, axis=0) > 0 if len(places) > 3 else np.zeros(places.shape[1], bool)
    if not moving.any():
        return 0.0
    spread = 1.4826 * np.median(np.abs(np.diff(places[:, moving], 3, axis=0)), axis=0)
    extent = float(np.ptp(places, axis=0).max())
    return max(float(np.sqrt(np.mean(np.square(spread)) / 20)), EXACT * extent)


def _jumps(times, places, rows, error, levels):
    """Jumps as (row behind it, Jump), told by so many rows on each side."""
    least = CLEAR_THERE if levels else CLEAR
    t, x, middle = windows(times, places, rows)
    numbers, left, rest, smooth = solved_alike(t, x, _explained)
    gains = surely = (rest - left) / error**2
    if SIDE_ROWS[0] < rows < LONGEST:  # where a wide swing turns it is no cubic, and no jump either
        surely = np.minimum(gains, (smooth - left) / error**2)
    out = []
    for k in np.flatnonzero(surely > least).tolist():
        if gains[k] < gains[max(k - SIDE_ROWS[0], 0) : k + SIDE_ROWS[0] + 1].max():
            continue
        first, second, before, after, pull = numbers[k]
        turn = after - before
        if turn.any():  # where the rows of both sides meet
            since = float(turn @ (first - second) / (turn @ turn))
            since = float(np.clip(since, t[k, rows - 1], t[k, rows]))
            place = first + before * since + pull * since**2 / 2
            own = before + pull * since, after + pull * since, pull
            jump = Jump(float(middle[k]) + since, place, *own, error, float(gains[k]))
            if surely[k] > CLEAR or _is_at(jump, levels):
                out.append((k + rows, jump))
    return out


def windows(times, places, rows):
    """Windows of so many rows on each side: times since their middles, places, and the middles.

    Of shapes (K, n), (K, n, d) and (K,).
    """
    window = np.lib.stride_tricks.sliding_window_view
    t, x = window(times, 2 * rows), np.swapaxes(window(places, 2 * rows, axis=0), 1, 2)
    middle = t[:, rows - 1 : rows + 1].mean(axis=1)
    return t - middle[:, None], x, middle


def _explained(t, x):
    """Numbers of motions whose velocity jumps, and what they, cubics and smooth ones leave of x."""
    broken, smooth = _bases(t)
    numbers, left = solved(broken, x)
    _, rest = solved(smooth, x)
    is_longest = t.shape[1] == 2 * LONGEST
    return numbers, left, rest if is_longest else solved(smooth[..., :4], x)[1], rest


def _bases(t):
    """Motions (K, 2 rows, c) whose velocity jumps in the middle of windows, and smooth ones."""
    n = t.shape[1]
    late = np.broadcast_to((np.arange(n) >= n // 2).astype(float), t.shape)
    broken = np.stack([1 - late, late, (1 - late) * t, late * t, t * t / 2], axis=-1)
    degree = CURVED if n == 2 * LONGEST else 4
    return broken, np.stack([(t / t[:, -1:]) ** k for k in range(degree + 1)], axis=-1)


def _is_at(jump, levels):
    """Whether a body is turned back at one of the walls."""
    return any(
        side * jump.before[axis] < 0 < side * jump.after[axis]
        and abs(jump.place[axis] - level) <= NEAR * jump.error
        for (axis, side), level in levels.items()
    )


def solved(basis, x):
    """Least squares in stacks: numbers (K, c, d), and what is left of the squares (K,).

    Parameters
    ----------
    basis : ndarray, shape (K, n, c)
        Of full rank; one, (1, n, c), stands for all.
    x : ndarray, shape (K, n, d)
    """
    q, r = np.linalg.qr(basis)
    along = np.swapaxes(q, 1, 2) @ x
    return np.linalg.solve(r, along), np.square(x - q @ along).sum(axis=(1, 2))


def solved_alike(t, x, solve):
    """What is solved of windows in stacks, where those of the same times share one basis.

    Parameters
    ----------
    t : ndarray, shape (K, n)
        Times of the windows.
    x : ndarray, shape (K, n, d)
    solve : callable
        Of times, shape (1, n) where one stands for all, and of places; returns arrays (K, ...).
    """
    usual = np.median(t, axis=0)
    is_usual = np.abs(t - usual).max(axis=1) < EVEN * np.ptp(usual)
    if is_usual.all():
        return solve(t[:1], x)
    if not is_usual.any():
        return solve(t, x)
    others = solve(t[~is_usual], x[~is_usual])
    out = [np.empty((len(t), *each.shape[1:])) for each in others]
    for each, own, other in zip(out, solve(usual[None], x[is_usual]), others, strict=True):
        each[is_usual], each[~is_usual] = own, other
    return out


def between(times, places, found):
    """Places, velocities and accelerations of a track, from parabolas that pass over no jump.

    Each is (T, d), nan where too few rows were seen between two jumps.
    """
    out = np.full((3, *places.shape), np.nan)
    ends = [jump.time for jump in found]
    seen = np.isfinite(places).all(axis=1)
    for first, last in zip([-math.inf, *ends], [*ends, math.inf], strict=True):
        rows = np.flatnonzero(seen & (times > first) & (times < last))
        if len(rows) < 2:
            continue
        width = min(WINDOW, len(rows))
        begin = np.clip(np.arange(len(rows)) - width // 2, 0, len(rows) - width)
        near = rows[begin[:, None] + np.arange(width)]  # (n, width)
        t = times[near] - times[rows][:, None]
        basis = np.stack([np.ones_like(t), t, t * t / 2][: min(width, 3)], axis=-1)
        numbers = np.swapaxes(solved(basis, places[near])[0], 0, 1)
        told = len(numbers) if width >= LEAST_ROWS else 2
        out[:told, rows] = numbers[:told]
    return tuple(out)


def nodes_between(chains, nodes, levels):
    """Nodes (2, R, d, T, S) with states that pass over no jump, where rows tell them.

    Walls are known to stand at `levels`, as `jumps` takes them.
    """
    nodes = nodes.copy()
    for s in range(chains.n_chains):
        n = int(chains.lengths[s])
        for r in range(chains.n_moving):
            track = chains.times[:n, s], chains.observed[:n, s, r]
            told = np.stack(between(*track, jumps(*track, levels))[:2])
            own = nodes[:, r, :, :n, s]
            told = told.swapaxes(1, 2)
            nodes[:, r, :, :n, s] = np.where(np.isfinite(told), told, own)
    return nodes
