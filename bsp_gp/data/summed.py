"""Places that are sums of measured velocities, or sums of sums of measured accelerations.

Every row stands for the time up to the middles between it and its neighbours. What is gone in that
time is added to the place, what is gained in it to the velocity, and errors add up so. Where a
track lies is not known, and its middle counts as 0; of accelerations how fast it begins is not
known either.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy import ndimage, sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import spsolve

from bsp_gp.data.gravity import GRAVITY, OFF, is_without, pull_in, told_off, told_turned
from bsp_gp.data.point_errors import FAR, gross_errors
from bsp_gp.data.scene import SUMS
from bsp_gp.data.table import less
from bsp_gp.data.twice import MOST_SLIPS
from bsp_gp.data.untimed import without_timeless_ends

VELOCITIES, ACCELERATIONS = SUMS
"""``[columns] velocity``: places are sums of velocities that alone were measured; these are sums
themselves, of measured accelerations."""
WHAT = {VELOCITIES: ("velocity", "velocities"), ACCELERATIONS: ("acceleration", "accelerations")}
MOST_USUAL = 1e6
"""Median of accelerations, m/s^2, above which no sensor has shown them."""
GAP = 3.5
"""Typical steps of a gap behind which a track begins anew: what is gone in it is not known."""
NEIGHBOURS = 15
"""Steps among which the usual one is told."""
CURVED = 0.1
"""Part of the error of a row up to which its value is taken as the mean over its time."""
LEAST_ROWS, LISTED = 4, 5
COARSEST, COARSE = 5.0, 0.25
"""Quoted errors that half of the values may be off the line between their neighbours, if all are
off by more than such a part of how much they vary."""
SWINGS = 3
"""Periods of the strongest wave of accelerations in a track that is bound to its middle."""
NARROW, PURE = 3, 0.25
"""Lines of a spectrum beside its highest that are of one wave, and the part of all power that they
have in what swings: a cart that rattles as it rolls has a tenth there."""
SLOWER = 10.0
"""Times as slow as that wave, what is taken as drift there: its accelerations are off by a part of
1e-4, places by what errors add up to within so many periods."""
QUIET, LEAST_STILL = 4.0, 10
"""Standard deviations of the noise up to which values are those at rest, and rows of a rest."""
CALM, PAUSE = 0.1, 0.25
"""Part of the largest acceleration below which a body rests between two pushes, or goes on as it
does, and the part of a period from which that is a pause: what swings shows less for a thirtieth of
one."""
ZERO = 0.3
"""What the zero of an accelerometer may be off by, m/s^2."""


@dataclass(frozen=True)
class Rates:
    """What of a table is added up to places.

    Attributes
    ----------
    columns : mapping of str to str
        Axis -> column.
    velocity : str
        `VELOCITIES` or `ACCELERATIONS`.
    scale : float
        Place per value and time (or squared time) in numbers.
    units : mapping of str to str
        Units of the places, by axis; empty = not known.
    headings : tuple of str
        Of the columns in the file.
    sensed : mapping of str to str
        Column -> heading of all axes of a sensor, of which some may show no motion.
    metric : float
        What a value is in m/s^2; 0 where that is not known.
    """

    columns: Mapping[str, str]
    velocity: str
    scale: float
    units: Mapping[str, str]
    headings: tuple[str, ...]
    sensed: Mapping[str, str] = field(default_factory=dict)
    metric: float = 0.0

    @property
    def order(self):
        """How often values are added up."""
        return SUMS[self.velocity]


def summed(table, declaration, rates):
    """The table with places, row by row of its tracks, and its declaration.

    Raises
    ------
    DataError
        Times are lost or do not increase; no track has four values, or these are beyond sensors.
    """
    found, (_, many) = rates.columns, WHAT[rates.velocity]
    table, told = without_timeless_ends(table)
    table = table.noted(*told)
    if "t" in table:
        times = table.numbers("t")
    else:
        dt = declaration.dt or np.nan
        frames = table.numbers("frame")
        times = frames / declaration.fps if declaration.fps else frames * dt
    lost = np.isnan(times)
    if lost.any():
        table.fail("empty cell or NaN where a time is needed", "t", row=int(lost.argmax()))
    values = np.stack([table.numbers(name) for name in found.values()], axis=1)
    if rates.order == 2:
        _require_possible(table, rates.metric * values, rates)
    pieces, far, twice = _pieces(table, times, values, rates)
    if not any(pieces.values()):
        table.fail(f"there are no places, and no track has four {many}", [*found.values()][0])
    plain, weight = rates, ()
    if rates.order == 2 and rates.metric:
        values, weight = _without_gravity(table, times, values, pieces, rates)
        plain = replace(rates, scale=rates.scale / rates.metric)
    frame = pd.concat([
        _track(table, times[part], values[part], part, plain)
        .assign(**_named(table, part, k, len(parts)))
        for parts in pieces.values() for k, part in enumerate(parts, 1)
    ])  # fmt: skip
    taken = found.values()
    units = less(table.units, taken) | rates.units
    if "t" not in table and declaration.fps:
        units["t"] = "s"
    table = replace(
        table, frame=frame, units=units, untimed="", unused=less(table.unused, taken),
        theirs={**table.theirs, **dict(zip(found, rates.headings, strict=True))},
    ).noted(*_notes(rates, pieces, (far, twice), len(times)), *weight)  # fmt: skip
    noise = _noise(declaration, times, rates)
    said = less(declaration.units, taken)
    return table, replace(declaration, velocity=rates.velocity, noise=noise, units=said)


def _require_possible(table, values, rates):
    """DataError where accelerations (n, d), in m/s^2, are mostly such as no sensor shows."""
    usual = [np.median(own[np.isfinite(own)]) if np.isfinite(own).any() else 0.0
             for own in np.abs(values).T]  # fmt: skip
    k = int(np.argmax(usual))
    if usual[k] > MOST_USUAL:
        table.fail(
            f"half of the accelerations are above {usual[k]:.3g} m/s^2, which no sensor shows",
            rates.headings[k], "look into the file: spreadsheets that know another decimal sign "
            "make 3.5E+07 of 3.5E-02; export it anew, or give the unit: --units acceleration=g",
        )  # fmt: skip


def _without_gravity(table, times, values, pieces, rates):
    """Values (n, d) in m/s^2 less the gravity that is in them, by track, and notes of that."""
    values, notes = rates.metric * values, []
    shown = rates.metric * np.stack([table.numbers(name) for name in rates.sensed], axis=1)
    own = [list(rates.sensed).index(name) for name in rates.columns.values()]
    headings = list(rates.sensed.values())
    for name, parts in pieces.items():
        if not parts:
            continue
        rows, who = np.concatenate(parts), "" if len(pieces) == 1 else str(name)
        pull = pull_in(shown[rows], headings)
        if pull is not None and pull.is_turned:
            notes.append(told_turned(who))
            continue
        rest = _weight_at_rest(times, shown[:, own], parts) if pull is None else None
        if pull is not None:
            values[rows] -= pull.usual[own]
            notes.append(told_off(pull.usual, headings, who))
        elif rest is not None and not any(map(is_without, headings)):
            values[rows] -= rest
            notes.append(told_off(rest, rates.headings, who))
    return values, tuple(notes)


def _weight_at_rest(times, shown, parts):
    """What is shown (n, d) at quiet ends, or by what swings, where that is gravity; else None."""
    whole = shown[np.concatenate(parts)]
    is_swung = all(_swing(times[part], shown[part]) for part in parts)
    level = np.median(whole, axis=0) if is_swung else _at_rest(shown[parts[0]])[1]
    off = abs(np.linalg.norm(level) - GRAVITY)
    return level if off <= (OFF * GRAVITY if is_swung else ZERO) else None


def _pieces(table, times, values, rates):
    """Rows of the pieces of every track, by the track's name; lines far off, and at one time."""
    one, _ = WHAT[rates.velocity]
    groups = table.tracks
    far, twice, good = [], [], np.isfinite(values).all(axis=1)
    for rows in groups.values():
        rows = rows[good[rows]]
        is_copy = (np.diff(np.column_stack([times, values])[rows], axis=0) == 0).all(axis=1)
        is_late = times[rows[1:]] <= np.fmax.accumulate(times[rows])[:-1]
        is_few = (is_late & ~is_copy).sum() <= max(MOST_SLIPS * len(rows), 1)
        again = rows[1:][is_late & is_few | is_copy]
        good[again], twice = False, [*twice, *table.frame.index[again].tolist()]
        rows = rows[good[rows]]
        back = np.flatnonzero(np.diff(times[rows]) <= 0)
        if len(back):
            problem = f"times must increase from {one} to {one} of a body"
            table.fail(problem, "t", "sort the rows; keep one per time", row=int(rows[back[0] + 1]))
        if rates.order == 1:  # what hits a body is seen in accelerations, and is no error
            is_far = _are_far(times[rows], values[rows])
            far += table.frame.index[rows[is_far]].tolist()
            good[rows[is_far]] = False
    good &= _are_common(table, times, good)
    _require_dense(table, times, values, [r[good[r]] for r in groups.values()], rates)
    parts = {name: _parts(times, rows[good[rows]]) for name, rows in groups.items()}
    long = {name: [p for p in own if len(p) >= LEAST_ROWS] for name, own in parts.items()}
    return long, far, twice


def _require_dense(table, times, values, groups, rates):
    """DataError where values change so much from row to row that what lies between is anything."""
    for k, axis in enumerate(rates.columns):
        if rates.order != 1 or f"sv{axis}" not in table.frame:
            continue
        error = table.numbers(f"sv{axis}")
        parts = [_off_neighbours(times[r], values[r, k], error[r]) for r in groups]
        off, quoted = np.concatenate(parts, axis=1)
        size = float(np.nanmedian(np.abs(off) / quoted)) if len(off) else 0.0
        if size > COARSEST and off.std() > COARSE * values[np.concatenate(groups), k].std():
            table.fail(
                f"there are no places, and velocities are {size:.0f} of their errors off what "
                "their neighbours foresee: rows are too far apart to be added up to places",
                rates.headings[k], "a track needs places, or velocities with many rows a turn",
            )  # fmt: skip


def _off_neighbours(times, values, error):
    """Values beside the straight line between their neighbours, with no gap there; their errors."""
    steps = np.diff(times)
    share = steps[:-1] / (steps[:-1] + steps[1:])
    off = values[1:-1] - (1 - share) * values[:-2] - share * values[2:]
    is_near = np.maximum(steps[:-1], steps[1:]) <= GAP * np.median(steps)
    return np.stack([off, error[1:-1]])[:, is_near]


def _notes(rates, pieces, left, count):
    """What is told of how places were made, of so many rows; `left` has the lines left out."""
    (_, many), (far, twice) = WHAT[rates.velocity], left
    used = sum(len(part) for parts in pieces.values() for part in parts) + len(far) + len(twice)
    yield _told(rates, used < count, max(map(len, pieces.values())) > 1)
    gone = [str(name) for name, parts in pieces.items() if not parts]
    if gone:
        listed = ", ".join(gone[:LISTED])
        yield f"tracks with fewer than {LEAST_ROWS} {many} are left out: {listed}"
    for lines, how in ((far, "far off their neighbours"), (twice, "at a time that was")):
        listed = ", ".join(map(str, lines[:LISTED])) + (" ..." if len(lines) > LISTED else "")
        if lines:
            yield f"{many} {how} are left out: {len(lines)}, in line {listed}"


def _told(rates, is_short, is_split):
    listed = ", ".join(repr(text) for text in rates.headings)
    one, many = WHAT[rates.velocity]
    start = "" if rates.order == 1 else (
        "; how fast a body begins is not known either, and of what swings all that is "
        f"{SLOWER:g} times as slow is taken as drift of the sensor"
    )  # fmt: skip
    return (
        f"places are sums of {many} ({listed}): errors add up from row to row, and where a "
        f"track lies is not known; its middle counts as 0{start}"
        + (f"; rows without any {one}, or of pieces that are too short, are left out"
           if is_short else "")
        + ("; behind a gap a track begins anew, as a scene of its own" if is_split else "")
    )  # fmt: skip


def _are_common(table, times, good):
    """Rows at times at which all bodies of their scene have a value: they share the times."""
    if "entity" not in table.frame:
        return np.ones(len(times), dtype=bool)
    scene = table.frame["scene"] if "scene" in table.frame else pd.Series("", table.frame.index)
    known = pd.DataFrame({
        "scene": scene.to_numpy(), "t": times, "entity": table.frame["entity"].to_numpy(),
    })  # fmt: skip
    wanted = known.groupby("scene", dropna=False)["entity"].transform("nunique").to_numpy()
    there = known.assign(good=good).groupby(["scene", "t"], dropna=False)["good"].transform("sum")
    return there.to_numpy() == wanted


def _are_far(times, values):
    """Rows (n,) whose values (n, d) are far off their neighbours: places would jump there.

    What is shaken for a while is as rough about them: that is its motion, and no error.
    """
    noise = _roughness(values)
    off = gross_errors(times, values, noise)
    if not (off > 1).any():
        return off > 1
    bends = np.abs(np.pad(np.diff(values, 4, axis=0), ((2, 2), (0, 0)), mode="edge"))
    about = ndimage.median_filter(bends, (2 * NEIGHBOURS + 1, 1), mode="nearest")
    rougher = (1.4826 * about / np.sqrt(70) / np.maximum(noise, np.finfo(float).tiny)).max(axis=1)
    return (off > 1) & (off > FAR * rougher)


def _roughness(values):
    """Standard deviation of the noise of values (n, ...) by their fourth differences."""
    rough = np.diff(values, 4, axis=0)
    if not len(rough):
        return np.zeros(values.shape[1:])
    return 1.4826 * np.median(np.abs(rough), axis=0) / np.sqrt(70)


def _parts(times, rows):
    """Rows of a track up to its gaps: steps that grow as a wheel slows down are none.

    Nor are those of a clock that waits once in a few rows, as one does that writes them out.
    """
    steps = np.diff(times[rows])
    if not len(steps) or not np.median(steps) > 0:  # told where times are checked
        return [rows]
    usual = np.maximum(ndimage.median_filter(steps, NEIGHBOURS, mode="nearest"), np.median(steps))
    is_gap = steps > GAP * usual
    if NEIGHBOURS * np.count_nonzero(is_gap) > len(steps):
        is_gap = steps > GAP * np.maximum(usual, np.median(steps[is_gap]))
    return np.split(rows, np.flatnonzero(is_gap) + 1)


def _track(table, times, values, rows, rates):
    """Rows that those of values lie between, or beside, with the places there."""
    sums = _sums_of_velocities if rates.order == 1 else _sums_of_accelerations
    ends, places = sums(times, values)
    places = places - places.mean(axis=0)  # what swings does so about its middle
    after = np.concatenate([rows, np.repeat(rows[-1:], rates.order)])
    columns = rates.columns
    frame = table.frame.iloc[after].drop(columns=[*columns.values(), "frame"], errors="ignore")
    out = {"t": ends} | {a: rates.scale * places[:, k] for k, a in enumerate(columns)}
    for axis in columns:
        if rates.order == 1 and f"sv{axis}" in frame:
            error, width = table.numbers(f"sv{axis}")[rows], np.diff(ends)
            # As of a typical step: whatever adds them up reckons with the time of each.
            error = rates.scale * error * np.sqrt(width * np.median(width))
            out[f"s{axis}"] = np.append(error[:1], error)
            frame = frame.drop(columns=f"sv{axis}")
    for name in frame.columns.difference([*out, "scene", "entity"]):
        if table.is_numeric(name):
            inner = frame[name].to_numpy(dtype=float)[: len(times)]
            out[name] = np.interp(ends, times, inner)
    return frame.assign(**out)


def _sums_of_velocities(times, values):
    """Times between those of values (n, d) and beyond, (n + 1,), and places there, (n + 1, d)."""
    steps = np.diff(times)
    ends = np.concatenate([
        [times[0] - steps[0] / 2], (times[1:] + times[:-1]) / 2, [times[-1] + steps[-1] / 2]
    ])  # fmt: skip
    gone = np.diff(_whole(times, values)(ends), axis=0) if _is_bent(times, values) else (
        values * np.diff(ends)[:, None]
    )  # fmt: skip
    return ends, np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(gone, axis=0)])


def _sums_of_accelerations(times, values):
    """Times of values (n, d) and one beyond either end, (n + 2,), and places there, (n + 2, d).

    What swings stays about its middle: the places are those next to it of all whose second
    differences are as measured, in the least squares of what is left of both (Tikhonov), which
    keeps out what drifts. What does not is at rest before it is moved, or comes to rest.
    """
    steps = np.diff(times)
    ends = np.concatenate([[times[0] - steps[0]], times, [times[-1] + steps[-1]]])
    gaps, rate = np.diff(ends), _swing(times, values)
    widths = (gaps[1:] + gaps[:-1]) / 2
    zero = _between_pauses(times, values, rate) if rate else None
    if zero is not None:
        (first, last), level, rate = (0, 0), zero, 0.0
    else:
        (first, last), level = ((0, 0), 0.0) if rate else _at_rest(values)
    values = values - level
    gained = values * widths[:, None]
    if _is_bent(times, values):  # the mean over the times between, weighed as what they add is
        gained = np.diff(np.diff(_whole(times, values, 2)(ends), axis=0) / gaps[:, None], axis=0)
    if rate:
        return ends, _bound(gaps, gained, widths, rate / SLOWER)
    speed = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(gained, axis=0)])
    if zero is not None:  # at rest at both ends
        speed -= speed[-1] * ((ends[:-1] - ends[0]) / (ends[-2] - ends[0]))[:, None]
    elif last > first:
        speed -= speed[-1]
    places = np.cumsum(speed * gaps[:, None], axis=0)
    return ends, np.concatenate([np.zeros((1, values.shape[1])), places])


def _at_rest(values):
    """How many of the first and last values (n, d) are at rest; what a sensor shows there, (d,).

    A sensor shows gravity, or what its zero is off by; all else at an end is a push.
    """
    noise = _roughness(values)
    spans = []
    for own in (values, values[::-1]):
        level = np.median(own[:LEAST_STILL], axis=0)
        off = np.abs(np.linalg.norm(level) - np.array([0.0, GRAVITY]))
        is_same = (np.abs(own - level) <= QUIET * noise).all(axis=1)
        count = len(own) if is_same.all() else int(is_same.argmin())
        is_rest = LEAST_STILL <= count < len(own) and off.min() <= ZERO
        spans.append(count if is_rest else 0)
    first, last = spans
    still = np.concatenate([values[:first], values[len(values) - last :]])
    return spans, still.mean(axis=0) if len(still) else np.zeros(values.shape[1])


def _between_pauses(times, values, rate):
    """What a sensor shows at rest, (n, d), of a body that is pushed and stopped now and then; None.

    A lift that goes twice shows nothing between its rides, or at constant speed, for longer than
    what swings does at its turns. It must be at rest at both ends. `rate` is that of the strongest
    wave, 1/s.
    """
    near = ndimage.uniform_filter1d(values - np.median(values, axis=0), NEIGHBOURS, axis=0)
    size = np.linalg.norm(near, axis=1)
    moving = np.flatnonzero(size > CALM * size.max())
    pause = PAUSE * 2 * np.pi / rate
    is_cut = np.diff(times[moving]) > pause
    starts, stops = moving[np.append(True, is_cut)], moving[np.append(is_cut, True)]
    bursts = times[stops] - times[starts]
    is_still = min(times[starts[0]] - times[0], times[-1] - times[stops[-1]]) > pause
    if len(bursts) < 2 or bursts.max() > pause / PAUSE or not is_still:
        return None
    rests = [slice(0, starts[0]), slice(stops[-1] + 1, None)]
    at = [times[own].mean() for own in rests]
    shown = np.stack([values[own].mean(axis=0) for own in rests])
    off = np.abs(np.linalg.norm(shown, axis=1)[:, None] - [0.0, GRAVITY]).min(axis=1)
    if off.max() > ZERO:
        return None
    return np.stack([np.interp(times, at, own) for own in shown.T], axis=1)


def has_swing(values):
    """Whether values (n, d) of rows that are about even in time are those of what swings."""
    return _swing(np.arange(float(len(values))), values) > 0


def _swing(times, values):
    """Angular rate of the strongest wave of values (n, d), 1/s; 0.0 where it is no swing's."""
    even = np.linspace(times[0], times[-1], len(times))
    axis = int(np.argmax(values.var(axis=0)))
    wave = np.interp(even, times, values[:, axis])
    power = np.square(np.abs(np.fft.rfft((wave - wave.mean()) * np.hanning(len(wave)))))
    peak = int(np.argmax(power))
    is_wave = power[max(peak - NARROW, 0) : peak + NARROW + 1].sum() > PURE * power.sum()
    return 2 * np.pi * peak / (times[-1] - times[0]) if peak >= SWINGS and is_wave else 0.0


def _bound(gaps, gained, widths, rate):
    """Places (n + 2, d) that gain velocities (n, d) at their rows and keep to their middle.

    What a sensor shows at rest is unknown too, and left out.
    """
    n = len(gained)
    slope = sparse.diags([-1 / gaps, 1 / gaps], [0, 1], shape=(n + 1, n + 2))
    bend = sparse.diags([-1.0, 1.0], [0, 1], shape=(n, n + 1)) @ slope
    bend = sparse.hstack([bend, widths[:, None]])
    weigh = sparse.diags(1 / widths)
    ties = sparse.diags(rate**4 * np.concatenate([[gaps[0]], widths, [gaps[-1], 0.0]]))
    normal = (bend.T @ weigh @ bend + ties).tocsc()
    return spsolve(normal, bend.T @ weigh @ gained).reshape(n + 3, -1)[:-1]


def _whole(times, values, order=1):
    """The integral of values over time, `order` times over."""
    return CubicSpline(times, values).antiderivative(order)


def _is_bent(times, values):
    """Whether values mostly bend between their rows by what counts beside their noise."""
    steps = np.diff(times)
    if np.ptp(steps) > 0.02 * np.median(steps):
        return True
    bend, noise = np.diff(values, 2, axis=0), _roughness(values)
    beyond = np.square(1.4826 * np.median(np.abs(bend), axis=0)) - 6 * noise**2  # not of a hit
    return bool(np.any(np.sqrt(np.maximum(beyond, 0.0)) / 24 > CURVED * noise))


def _named(table, rows, number, count):
    """Of a track that was split, a scene of its own for every piece."""
    if count == 1:
        return {}
    scene = table.frame["scene"].iloc[rows[0]] if "scene" in table.frame else "part"
    return {"scene": f"{scene} {number}"}


def _noise(declaration, times, rates):
    """Declared errors of values as those of what is added in a step."""
    noise, steps = declaration.noise, np.diff(times)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    step = rates.scale * step**rates.order
    if isinstance(noise, Mapping):
        return {body: tuple(step * x for x in np.atleast_1d(own)) for body, own in noise.items()}
    return noise and tuple(step * level for level in np.atleast_1d(noise))
