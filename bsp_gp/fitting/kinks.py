"""Kinks of tracks: instants at which a velocity jumps, whatever moves the body before and after.

Along a few rows on both sides any smooth motion is a polynomial. Where one whose slope may jump in
the middle follows them within their noise, and smooth ones of as many numbers do not, nor one whose
acceleration jumps, the body was hit, or let go.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from bsp_gp.fitting.jumps import scatter, solved, solved_alike, windows

SIDE_ROWS = (6, 10, 16, 24)
"""Rows on each side of a kink that are looked at."""
DEGREE = 5
"""Of the smooth part of a motion along so many rows; fewer numbers than half of the rows."""
CLEAR = 25.0
"""Chi-squared by which a kink must explain rows better than motions without one, in a track of
`USUAL` rows, and twice the logarithm of how many times as many: in 240 simulated smooth motions
under white noise and noise with a memory none did."""
USUAL = 100
WITHIN = 2.0
"""Chi-squared of the rows, for each degree of freedom, that a kink may leave at the most."""
SMOOTH = 4.0
"""The same that the middle one of all windows may leave beside the noise from row to row: along
more rows such motions are no polynomials."""
MEETING = 4.0
"""Errors within which both sides meet between the two rows: else the track jumps, not the speed."""
OFF = 3
"""Rows that may flicker together: where a smooth motion follows all others, there is no kink."""
_CHUNK = 4096


@dataclass(frozen=True)
class Kink:
    """A velocity that jumps.

    Attributes
    ----------
    time : float, s
    turn : ndarray, shape (d,), m/s
        Gain of velocity.
    error : float, m
        Of a coordinate of a row, as neighbouring rows tell it.
    gain : float
        Chi-squared that it explains beside smooth motions of as many numbers.
    """

    time: float
    turn: np.ndarray
    error: float
    gain: float


def kinks(times, places):
    """Kinks of a track (T, d), nan where it was not seen, in the order of time."""
    seen = np.isfinite(places).all(axis=1)
    times, places = times[seen], places[seen]
    if len(times) < 2 * SIDE_ROWS[0] or not np.ptp(places, axis=0).any():
        return []
    error, found = scatter(places), []
    moving = np.ptp(places, axis=0) > 0
    clear = CLEAR + 2 * np.log(max(len(times) / USUAL, 1.0))
    for rows in SIDE_ROWS:
        for first in range(0, len(times) - 2 * rows + 1, _CHUNK):
            part = slice(first, first + _CHUNK + 2 * rows - 1)
            own = _kinks(times[part], places[part][:, moving], rows, error, clear)
            found += [(first + at, kink) for at, kink in own]
    out = {}
    for at, kink in sorted(found, key=lambda each: -each[1].gain):
        if all(abs(at - other) >= SIDE_ROWS[0] for other in out):
            turn = np.zeros(len(moving))
            turn[moving] = kink.turn
            out[at] = Kink(kink.time, turn, error, kink.gain)
    return [out[at] for at in sorted(out)]


def _kinks(times, places, rows, error, clear):
    """Kinks as (row behind it, Kink), told by so many rows on each side."""
    if len(times) < 2 * rows:
        return []
    t, x, middle = windows(times, places, rows)
    span = np.ptp(np.lib.stride_tricks.sliding_window_view(times, 2 * rows), axis=1) / 2
    u = t / span[:, None]
    degree = min(DEGREE, rows - 3)
    numbers, left, smooth, bent = solved_alike(u, x, partial(_explained, degree=degree))
    dof = (2 * rows - degree - 3) * x.shape[2]
    # Noise with a memory is larger along many rows than from row to row.
    variance = max(error**2, float(np.median(left)) / dof)
    if variance > SMOOTH * error**2:
        return []
    gain = (np.minimum(smooth, bent) - left) / variance
    is_clear = (gain > clear) & (left < WITHIN * dof * variance)
    out = []
    for k in np.flatnonzero(is_clear).tolist():
        if gain[k] < gain[max(k - rows, 0) : k + rows + 1].max():
            continue
        step, slope = numbers[k, 0], numbers[k, 1]
        since = float(np.clip(-(slope @ step) / (slope @ slope), u[k, rows - 1], u[k, rows]))
        if np.abs(step + slope * since).max() > MEETING * error:
            continue
        off = _without_rows([u[k] ** power for power in range(degree + 1)], x[k])
        if off - left[k] < clear * variance:
            continue
        turn = slope / span[k]
        out.append((k + rows, Kink(float(middle[k] + since * span[k]), turn, error, gain[k])))
    return out


def _explained(u, x, degree):
    """Numbers of motions whose velocity jumps, and what they, smooth and bent ones leave of x."""
    late = (np.arange(u.shape[1]) * 2 >= u.shape[1]).astype(float)
    powers = [u**k for k in range(degree + 3)]
    jumps = [late * u**k for k in range(4)]  # of the place, the velocity and the acceleration
    (numbers, left), (_, smooth), (_, bent) = (
        solved(np.stack(columns, axis=-1), x) for columns in (
            [*jumps[:2], *powers[:-2]], powers, [*jumps[2:], *powers[:-2]]
        )
    )  # fmt: skip
    return numbers, left, smooth, bent


def _without_rows(columns, places):
    """What smooth motions leave of rows at the least, where some that follow each other are off."""
    first = np.arange(len(places) - OFF + 1)[:, None]
    row = np.arange(len(places))
    kept = ((row < first) | (row >= first + OFF)).astype(float)
    columns = kept[..., None] * np.stack(columns, axis=-1)
    return float(solved(columns, kept[..., None] * places)[1].min())
