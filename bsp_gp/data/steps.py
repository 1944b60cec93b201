"""Columns of times that are steps, or that were rounded until rows share one."""

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
the most: fewer may be slips, and more of two bodies."""


def with_sums_of_steps(frame, found):
    """The table with times in the place of steps of time, where it has no other clock.

    Parameters
    ----------
    frame : DataFrame
        Its columns are called by their positions.

    Returns
    -------
    frame : DataFrame
    found : sequence of Heading
    notes : tuple of str
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
    """The table with even times where rounding made neighbours share one, and a note of it.

    Recordings below each other are told apart by a column ``scene``. Rows of bodies below each
    other share their times, as those do that were written twice: they are left alone.
    """
    clocks = [c for c in columns if frame[c].dtype.kind == "f" and (frame[c].diff() == 0).any()]
    if "entity" in frame.columns or not clocks:
        return frame, ()
    keys = frame["scene"] if "scene" in frame.columns else pd.Series(0, frame.index)
    is_copy, notes = (frame == frame.shift()).all(axis=1), ()
    for column in clocks:
        out = frame[column].copy()
        for _, part in frame[column].groupby(keys, sort=False):
            n_ties = (part.diff() == 0).sum()
            even = _evened(part) if 2 * is_copy[part.index].sum() < n_ties else None
            if even is not None:
                out[part.index] = even
                step = np.nanmax(np.diff(even))
                notes = (
                    "times were rounded until rows share one: they are taken as even, every "
                    f"{step:.6g}, which fits all of them within their digits",
                )
        frame = _with(frame, column, out) if notes else frame
    return frame, notes


def _evened(times):
    """Times (n,) of rows as they were before they were rounded; None where that does not show.

    An even clock must fit all of them within half of their last digit.
    """
    known = times.notna().to_numpy()
    v, k = times.to_numpy(dtype=float)[known], np.flatnonzero(known)
    steps = np.diff(v)
    ties = np.count_nonzero(steps == 0)
    if len(v) < LEAST_ROUNDED or (steps < 0).any() or not LEAST_TIES <= ties <= MOST_TIES * len(v):
        return None
    design = np.stack([np.ones(len(k)), k], axis=1)
    for digit in _last_digits(v):
        line = np.linalg.lstsq(design / digit[:, None], v / digit, rcond=None)[0]
        even = np.where(known, line[0] + line[1] * np.arange(len(times)), np.nan)
        if (np.abs(even[known] - v) <= (0.5 + 1 / np.sqrt(len(v))) * digit).all():
            return even - even[known][0] + v[0]  # when it began does not matter
    return None


def _last_digits(values):
    """Sizes (n,) of the last digits, if all numbers have as many decimals, and as many digits."""
    parts = [Decimal(repr(value)).normalize() for value in values.tolist()]
    yield np.full(len(values), 10.0 ** min(part.as_tuple().exponent for part in parts))
    most = max(len(part.as_tuple().digits) for part in parts)
    sizes = np.array([part.adjusted() if part else np.nan for part in parts], dtype=float)
    yield 10.0 ** (np.where(np.isnan(sizes), np.nanmin(sizes), sizes) - most + 1)
