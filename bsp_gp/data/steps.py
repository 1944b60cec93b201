"""Columns of times that are steps, or that were rounded: until rows share one, or coarsely."""

import re
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pandas as pd

from bsp_gp.data.headings import WORD
from bsp_gp.errors import in_python

_STEP = re.compile(
    r"d_?t|(?:delta|δ|∆)[\s_-]*t(?:ime)?|(?:time|zeit)[\s_-]?(?:step|schritt|delta)", re.IGNORECASE
)
ALIKE = 2.0
"""Upper quartile of steps, in their lower one, at the most."""
LEAST_ROWS, LEAST_ROUNDED = 10, 30
"""Rows of steps, and of times that are made even."""
LEAST_TIES, MOST_TIES = 3, 0.35
"""Of the latter, rows that share the time of the row before, at the least, and the part of them at
the most where they do so from the begin on: fewer may be slips, and more of two bodies."""
MOST_APART = 4.0
"""Steps up to which columns of times side by side are one clock, each rounded."""
MANY = 10
"""Rows from one to another between which steps are told."""
WORST = 2.0
"""Steps by which rows that share no time may be off an even clock: a last digit is at most a step
there, or half of them would be ties."""
COARSE = 0.02
"""Step between rows, of which a last digit is such a part: less does no harm."""

UNEVEN = 0.1
"""Part of the rows without times of their own from which a clock may be uneven by as much of a
step."""


def with_sums_of_steps(frame, found):
    """The table with times in the place of steps of time, where it has no other clock.

    With its headings, and notes, a tuple of str; columns are called by their positions.
    """
    names = [h.name for h in found]
    able = [
        k for k, h in enumerate(found)
        if not h.ignored and h.owner == ("", "") and _STEP.fullmatch(h.stem or h.theirs)
        and _are_steps(frame[k])
    ]  # fmt: skip
    clocks = [k for k, name in enumerate(names) if name in ("t", "frame")]
    if len(able) != 1 or clocks not in ([], able) or {"entity", "scene"} & set(names):
        return frame, found, ()
    (k,) = able
    steps = frame[k].to_numpy(dtype=float)
    is_next = np.isnan(steps[-1])
    times = np.append(0.0, np.cumsum(steps[:-1] if is_next else steps[1:]))
    theirs, whose = found[k].theirs, "to the next row" if is_next else "since the row before"
    new = found[k] if names[k] == "t" else replace(found[k], name="t", sure=WORD)
    note = in_python(
        f"{theirs!r} holds steps of time, each {whose}: times are their sums, from 0; if it is "
        f'something else: --columns "{theirs}"=ignore --fps 25'
    )
    return _with(frame, k, times), [*found[:k], new, *found[k + 1 :]], (note,)


def _with(frame, column, values):
    out = frame.copy()
    out[column] = values
    return out


def _are_steps(cells):
    """Whether a column may be steps: above 0 but at one end, mostly alike, not ever greater."""
    if cells.dtype.kind not in "fiu" or len(cells) < LEAST_ROWS:
        return False
    values = cells.to_numpy(dtype=float)
    inner, ends = values[1:-1], values[[0, -1]]
    is_whole = (inner > 0).all() and not (ends < 0).any() and not np.isnan(ends).all()
    low, high = np.quantile(inner, [0.25, 0.75])
    return bool(is_whole and high < ALIKE * low and not (np.diff(inner) > 0).all())


def with_even_clocks(frame, columns):
    """The table with even times where they were rounded coarsely, and a note of it.

    Recordings below each other are told apart by a column ``scene``. Rows of bodies below each
    other share their times, as those do that were written twice: they are left alone.
    """
    clocks = [c for c in columns if frame[c].dtype.kind == "f"]
    if not clocks or ("entity" in frame.columns and frame["entity"].nunique() > 1):
        return frame, ()
    keys = frame["scene"] if "scene" in frame.columns else pd.Series(0, frame.index)
    has_ties = any((frame[c].diff() == 0).any() for c in clocks)
    is_copy = (frame == frame.shift()).all(axis=1) if has_ties else pd.Series(False, frame.index)
    notes, made = (), []
    for column in clocks:
        out = frame[column].copy()
        for _, part in frame[column].groupby(keys, sort=False):
            n_ties = (part.diff() == 0).sum()
            even = _alike(part, made)
            if even is None and 2 * is_copy[part.index].sum() < max(n_ties, 1):
                even = _evened(part)
            if even is not None:
                out[part.index] = even
                made.append((part, even))
                step = np.nanmedian(np.diff(even))
                how = "until rows share one" if n_ties else "coarsely"
                notes = (
                    f"times were rounded {how}: they are taken as even, every {step:.6g}, which "
                    "fits all of them within their digits",
                )
        frame = _with(frame, column, out) if notes else frame
    return frame, notes


def _alike(times, made):
    """Even times of another column with the same times but for a row's step; None without one."""
    for others, even in made:
        if len(others) == len(times) and np.array_equal(others.isna(), times.isna()):
            off, step = np.abs(times.to_numpy() - others.to_numpy()), np.nanmedian(np.diff(even))
            if np.nanmedian(off) == 0 and np.nanmax(off) <= MOST_APART * step:
                return even
    return None


def _evened(times):
    """Times (n,) of rows as they were before they were rounded; None where that does not show.

    An even clock, of which rows may be missing, must fit all of them within their last digit, and
    differ from them.
    """
    known = times.notna().to_numpy()
    v, k = times.to_numpy(dtype=float)[known], np.flatnonzero(known)
    steps = np.diff(v)
    ties = np.flatnonzero(steps == 0)
    if len(v) < LEAST_ROUNDED or (steps < 0).any() or 0 < len(ties) < LEAST_TIES:
        return None
    if len(ties) > MOST_TIES * len(v) and ties[0] < LEAST_ROUNDED:
        return None
    if not len(ties):  # digits take long to be read: most clocks need none
        off = np.abs(v - np.polynomial.Polynomial.fit(k, v, 1)(k)).max()
        step = (v[-1] - v[0]) / (k[-1] - k[0])
        if not COARSE / 4 * step < off < WORST * step:
            return None
    for digit in _last_digits(v):
        frames = _frames(k, v, digit) if len(ties) else k
        design = np.stack([np.ones(len(k)), frames], axis=1)
        begin, step = np.linalg.lstsq(design / digit[:, None], v / digit, rcond=None)[0]
        off = np.abs(begin + step * frames - v)
        most = (0.5 + 1 / np.sqrt(len(v))) * digit
        if len(ties) and np.ptp(digit):  # lost digits tell more surely than ties what happened
            most = digit + (UNEVEN if len(ties) > UNEVEN * len(v) else COARSE) * step
        if (off <= most).all():
            if off.max() <= COARSE / 4 * step:
                return None  # as good as they stand
            even = np.interp(np.arange(len(times)), k, step * (frames - frames[0]) + v[0])
            return np.where(known, even, np.nan)  # when it began is no matter
    return None


def _frames(k, v, digit):
    """Numbers (n,) of the frames of rows k at times v, which are off by a digit at the most."""
    step, frames = np.median((v[MANY:] - v[:-MANY]) / (k[MANY:] - k[:-MANY])), k.astype(float)
    if not step > 0:  # most rows share their times with many: no clock of frames
        return frames
    for _ in range(2):
        behind = (v - v[0]) / step - (frames - frames[0])
        lost = np.diff(np.maximum.accumulate(np.maximum(behind - digit / step, 0.0)), prepend=0.0)
        frames = frames + np.cumsum(np.round(lost))
        step = np.polyfit(frames, v, 1)[0]
    return frames


def _last_digits(values):
    """Sizes (n,) of the last digits, if all numbers have as many decimals; if all of a size do."""
    parts = [Decimal(repr(value)).normalize() for value in values.tolist()]
    ends = np.array([part.as_tuple().exponent for part in parts])
    yield np.full(len(values), 10.0 ** ends.min())
    sizes = np.array([part.adjusted() if part else -99 for part in parts])
    sizes = np.maximum(sizes, sizes[sizes > -99].min(initial=0))
    least = {size: ends[sizes == size].min() for size in set(sizes.tolist())}
    yield 10.0 ** np.array([least[size] for size in sizes.tolist()], dtype=float)
