"""Measures by several instruments: in the order of their dates, one row each time of a body.

What is done to rows is among their notes.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from bsp_gp.data.extent import JULIAN, YEARS, are_within
from bsp_gp.data.noise import coarsest_step
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK

AGREE = 5.0
"""Standard errors of their difference by which measures at one time may differ."""
LISTED = 8
LEAP, LEAST_LEAPS = 10.0, 10
"""Steps of the grid of its places, if they are on one, that a body leaps before a reading that is
held, and behind it; and how many of these there are at least."""
LOWEST, NEARLY, MOSTLY = 0.01, 0.15, 0.9
"""The quantile of steps that is about the smallest, and how many of all are by how little off whole
numbers of it, where they are steps of a sensor: of any size three in ten are."""
TURNS = 0.5
"""Part of the usual share of readings between two steps of one sense, below which those that are
held at turning points are none."""
MOST_SLIPS = 0.01
"""Part of the rows of a body whose time may not be after those before."""
FEW, NEAR = 0.2, 0.25
"""Part of the rows without errors that may share a date with another, and of the whole way by which
they may differ."""


def by_date(rows):
    """Rows in the order of their times, where these are dates of several instruments.

    Those are far from zero, and errors are quoted; what begins anew at zero is another recording.
    """
    span = np.ptp(rows.times) if len(rows.times) else 0.0
    if rows.sigma is None or not 0 < span < np.abs(rows.times).min():
        return rows
    _, later, steps = rows.steps
    back = later[steps < 0]
    if not len(back):
        return rows
    line = int(rows.lines[back.min()])
    note = f"dates go back, first in line {line}: rows were put into the order of their dates"
    return rows.taken(np.lexsort((rows.times, rows.entity, rows.scene))).noted(note)


def without_copies(rows):
    """Rows without those that say again what the row before says."""
    same = [np.diff(v) == 0 for v in (rows.scene, rows.entity, rows.times)]
    same += [(np.diff(rows.positions, axis=0) == 0).all(axis=1)]
    if rows.sigma is not None:
        same += [(np.isnan(s[1:]) & np.isnan(s[:-1])) | (s[1:] == s[:-1]) for s in rows.sigma.T]
    is_copy = np.append(False, np.all(same, axis=0))
    is_copy &= rows.velocities is None
    return _left_out(rows, is_copy, "say time and place of the row before again")


def without_slips(rows):
    """Rows without the few whose time is not after all before of their body.

    Clocks of loggers step back at times, or show one twice; what begins anew is another recording,
    and where more rows share a time they were rounded, or are of two bodies.
    """
    key = rows.tracks
    times = pd.Series(rows.times)
    before = times.groupby(key).cummax().groupby(key).shift()
    is_late = times <= before
    is_few = is_late.groupby(key).transform("mean") <= MOST_SLIPS
    is_slip = (is_late & is_few).to_numpy()
    return _left_out(rows, is_slip, "have a time that is not after those before")


def without_held(rows):
    """Rows without those of readings that were held until the next one.

    A logger that is faster than its sensor, and a tracker that has lost a body, say the last place
    again. What lies still does so, too, but does not leap there, nor away from there; and rows on
    both sides of a turning point may have one place on a grid.
    """
    if rows.velocities is not None or len(rows.times) < 2:
        return rows
    is_held = np.zeros(len(rows.times), dtype=bool)
    key = rows.tracks
    for own in pd.Series(key).groupby(key).indices.values():
        is_held[own] = _are_held(rows.times[own], rows.positions[own])
    return _left_out(rows, is_held, "hold the place of the row before, and leap to the next")


def _are_held(times, places):
    """Rows (n,) of one body, at places (n, d), that repeat a reading."""
    nothing, places = np.zeros(len(places), dtype=bool), places[:, np.isfinite(places).any(axis=0)]
    signed = np.diff(places, axis=0)
    steps = np.abs(signed)
    moving = np.flatnonzero(steps.any(axis=1))  # the last row of each reading, but of the last one
    # The grid of a long track takes a while, and hardly any track holds readings.
    if np.count_nonzero(np.diff(moving) > 1) < LEAST_LEAPS or not np.isfinite(places).all():
        return nothing
    grid = np.array([coarsest_step([(times, own)]) for own in places.T])
    grid = np.maximum(grid, [_quantum(own[own > 0]) for own in steps.T])
    is_leap = ((steps[moving] > 0) & (steps[moving] >= LEAP * grid)).any(axis=1)
    firsts, lasts = np.append(0, moving + 1), np.append(moving, len(places) - 1)
    chosen = np.append(True, is_leap) & np.append(is_leap, True) & (lasts > firsts)
    within = chosen[1:-1]
    goes_on = (signed[moving[:-1]] * signed[moving[1:]]).sum(axis=1) > 0
    n_on = np.count_nonzero(within & goes_on)
    if n_on < LEAST_LEAPS:
        return nothing
    if n_on < TURNS * goes_on.mean() * np.count_nonzero(within):
        chosen[1:-1] &= goes_on
    # At the ends it may lie still for as long as it likes.
    chosen &= lasts - firsts <= (lasts - firsts)[1:-1][within].max()
    for first, last in zip(firsts[chosen], lasts[chosen], strict=True):
        nothing[first + 1 : last + 1] = True
    return nothing


def _quantum(steps):
    """Size that steps are whole numbers of, but for rounding; 0.0 where they are of any size.

    Degrees of a sensor that are printed as radians lie on no grid but that of the last digit.
    """
    if not len(steps):
        return 0.0
    least = np.quantile(steps, LOWEST)
    size = float(np.median(steps[steps < 1.5 * least])) if least > 0 else 0.0
    is_whole = np.abs(steps / size - np.round(steps / size)) < NEARLY if size else np.zeros(1)
    return size if np.mean(is_whole) > MOSTLY else 0.0


def _left_out(rows, is_out, what):
    """Rows without some, and a check that says so; the same ones without any."""
    if not is_out.any():
        return rows
    lines = rows.lines[is_out]
    named = listed(list(dict.fromkeys(lines.tolist())), LISTED)  # of bodies side by side, once
    note = f"{len(lines)} row(s) {what}: left out (line {named})"
    return rows.taken(np.flatnonzero(~is_out)).noted(CHECK + note)


def measures_at_once(rows):
    """Rows in which neighbours of one body, scene and time are their mean, weighted by errors.

    They must quote errors and agree within these: what does not may be of two bodies, and stays as
    it is. Of decimal years and Julian dates, which nobody films by, they need no errors where few
    share a time and lie within a part of the way.
    """
    if rows.velocities is not None or len(rows.times) < 2:
        return rows
    if rows.sigma is None:
        return _observed_at_once(rows)
    again = np.all([np.diff(v) == 0 for v in (rows.scene, rows.entity, rows.times)], axis=0)
    is_new = np.append(True, ~again)
    starts, axes = np.flatnonzero(is_new), np.isfinite(rows.sigma).any(axis=0)
    x, sigma = rows.positions[:, axes], rows.sigma[:, axes]
    first = starts[np.cumsum(is_new) - 1]
    with np.errstate(all="ignore"):
        far = np.abs(x - x[first]) / np.hypot(sigma, sigma[first])
        agree = ((sigma > 0) & (sigma[first] > 0) & (far <= AGREE)).all(axis=1)
        total = np.add.reduceat(sigma**-2.0, starts)
        means = np.add.reduceat(sigma**-2.0 * x, starts) / total
    is_copy = (x == x[first]).all(axis=1) & (sigma == sigma[first]).all(axis=1)
    if again.all() or not again.any() or not agree[~is_new].all() or is_copy[~is_new].any():
        return rows
    places, errors = rows.positions[starts].copy(), rows.sigma[starts].copy()
    several = np.isin(starts, first[~is_new])[:, None]
    places[:, axes] = np.where(several, means, places[:, axes])
    errors[:, axes] = np.where(several, total**-0.5, errors[:, axes])
    lines = rows.lines[~is_new]
    told = listed(lines.tolist(), LISTED)
    note = (
        f"{len(lines)} row(s) are at the time of the row before (line {told}) and agree with it: "
        "they are one measure, the mean weighted by their errors"
    )
    return replace(rows.taken(starts), positions=places, sigma=errors).noted(note)


def _observed_at_once(rows):
    """Of what is dated, rows in which a few neighbours without errors are their median."""
    dates = rows.times / rows.second
    is_dated = are_within(dates.min(), dates.max(), (YEARS, JULIAN))
    again = np.all([np.diff(v) == 0 for v in (rows.scene, rows.entity, rows.times)], axis=0)
    if not is_dated or not again.any() or again.sum() > FEW * len(again):
        return rows
    starts = np.flatnonzero(np.append(True, ~again))
    counts = np.diff(np.append(starts, len(rows.times)))
    way = np.fmax.reduce(rows.positions) - np.fmin.reduce(rows.positions)
    middles = np.array([np.median(own, axis=0) for own in np.split(rows.positions, starts[1:])])
    off = np.abs(rows.positions - np.repeat(middles, counts, axis=0))
    is_far = (off > NEAR / 2 * way).any(axis=1)
    if (2 * np.add.reduceat(is_far, starts) >= counts).any():
        return rows
    lines = rows.lines[1:][again]
    note = (
        f"{len(lines)} row(s) have the date of the row before (line {listed(lines, LISTED)}): "
        "they are one observation, the median"
    )
    return replace(rows.taken(starts), positions=middles).noted(note)
