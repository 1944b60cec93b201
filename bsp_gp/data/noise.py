"""How accurate the positions are: quoted, declared, or estimated from the data themselves."""

import math
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.scene import Dataset
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.units import Unit, parse_unit

ORDERS = range(2, 9)
FLOOR = 1e-12
"""Part of the range of the positions below which no noise is taken to lie."""
_MAD_TO_SIGMA = 1.482602218505602
_CLIP = 3.0
_CLIPPED_RMS = 0.98658  # rms of a standard normal within ±3
_N_PASSES = 6
_MIN_WINDOWS = 8
_TOLERANCE = 1.0
_MIN_GRID_VALUES = 6
_COMES_BACK = 10
"""Changes of value for every one of fewer values from which these are a grid all the same."""
_STAYS = 50
"""Rows for every one of fewer values, on which nothing that moves can be seen to go on."""
_MOST_NEW, _HELD = 0.5, 1e-9
"""Part of the rows of a track that have a place of their own, below which places are held between
fixes; and part of its range within which a place is held."""
_MIN_GRID_STEP = 1e4
"""Smallest step that counts as a grid, in roundings of the largest value."""
_LARGE = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Parts of the values that are smaller than those whose own grid is asked for: numbers that were
printed to as many digits each (``%g``) are the coarser the larger they are."""
_MIN_ROUGH = 0.25
"""Part of the moving windows of a rounded track whose third difference is not zero, at least."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Standard deviation of the measured positions.

    Attributes
    ----------
    sigma : tuple of float, length d, metres
        Per axis; nan on an inactive axis, never below 1e-12 of the range of the positions.
    source : str
        "quoted" (columns sx, sy, sz, or ``noise`` body by body), "declared" (``noise``) or
        "estimated".
    n_effective : tuple of float, length d
        Independent differences behind each estimate; inf where sigma was not estimated.
    inactive_axes : tuple of str
        Axes along which no dynamic entity ever moves: they carry no information and are left out.
    method : str
        One line for the report.
    notes : tuple of str
        That positions were rounded, where they were, and which axes are left out.
    """

    sigma: tuple[float, ...]
    source: str
    n_effective: tuple[float, ...]
    inactive_axes: tuple[str, ...] = ()
    method: str = ""
    notes: tuple[str, ...] = ()


def checked_noise(noise, n_dims):
    """One standard deviation, or one per axis, as a tuple; SettingsError if it is none."""
    values = tuple(float(v) for v in np.atleast_1d(noise))
    if len(values) not in (1, n_dims):
        problem = f"noise must be one number or one per axis ({n_dims})"
        raise SettingsError(f"{problem}, got {len(values)}")
    if not all(math.isfinite(v) and v >= 0 for v in values):
        raise SettingsError(f"noise must be finite and not negative, got {noise}")
    return values


def declare_noise(dataset, sigma):
    """The data set with another declared noise, m: one for all axes (a tuple), or one per axis.

    Raises
    ------
    SettingsError
        If points quote errors of their own, since these would count and not `sigma`.
    """
    if any(_quoted(dataset.scenes, axis) is not None for axis in range(dataset.n_dims)):
        raise SettingsError(
            "noise is given as an option, but the points quote errors of their own (columns sx, "
            "sy, sz, or noise body by body), which come before it; leave the option out, or the "
            "quoted errors out of the data"
        )
    return replace(dataset, noise=tuple(sigma))


def is_declared_noisy(dataset):
    """Whether an error above zero is declared or quoted: such a noise is never replaced."""
    if any(_quoted(dataset.scenes, axis) for axis in range(dataset.n_dims)):
        return True
    return any(sigma > 0 for sigma in dataset.noise or ())


def estimate_noise(data):
    """Find the standard deviation of the position noise, per axis.

    Quoted errors come before a declared value, and that before an estimate. The estimate is for
    white noise on a smooth motion: a k-th difference annihilates what is locally a polynomial of
    degree k - 1 and leaves noise of variance sigma^2 * C(2k, k) on uniform times (on other times
    the weights of the divided difference are used). The scale is robust, so contacts do not matter;
    k runs from 2 to 8 and the first order after which the estimate no longer falls significantly is
    taken. Rounding is not white where a track moves slowly, so positions on a grid (whole pixels,
    few decimals) are never more accurate than its step / sqrt(12), that of the larger ones where
    all have as many digits. Of a Dataset, or of scenes, dynamic entities alone count; all are
    pooled.
    """
    is_dataset = isinstance(data, Dataset)
    scenes = data.scenes if is_dataset else tuple(data)
    declared = data.noise if is_dataset else None
    if not any(len(scene.dynamic) for scene in scenes):
        raise DataError("no entity is dynamic, so there is no motion to explain")
    n_dims = scenes[0].n_dims
    tracks = [_tracks(scenes, axis, _summing(data)) for axis in range(n_dims)]
    is_active = [any(np.ptp(x) > 0 for _, x in tracks[axis]) for axis in range(n_dims)]
    span = [_span(tracks[axis]) for axis in range(n_dims)]
    quoted = [_quoted(scenes, axis) for axis in range(n_dims)]
    steps = _steps(data, tracks)
    sigma, degrees = [math.nan] * n_dims, [math.nan] * n_dims
    sources, methods, notes = [], [], []
    length, unit = _length_told(data) if is_dataset else (1.0, "")
    for axis in np.flatnonzero(is_active).tolist():
        label, n_effective = "xyz"[axis], math.inf
        if quoted[axis] is not None:
            value, source, how = quoted[axis], "quoted", "rms of the errors of its points"
        elif declared is not None:
            value, source, how = declared[axis % len(declared)], "declared", "as declared"
        else:
            own = _of_fixes(tracks[axis], steps[axis], data)
            value, order, n_effective = _from_differences(own)
            source, how = "estimated", f"differences of order {order}"
            step = f"{steps[axis] / length:.4g}{unit}"
            if steps[axis] > value:
                notes.append(f"{label} is rounded to steps of {step}: its noise is taken as at "
                             "least the step / sqrt(12)")  # fmt: skip
            if value < steps[axis] / math.sqrt(12):
                value, n_effective = steps[axis] / math.sqrt(12), math.inf
                how = f"step of {step} / sqrt(12)"
        sigma[axis], degrees[axis] = max(float(value), FLOOR * span[axis]), n_effective
        sources.append(source)
        methods.append(f"{label}: {how}")
    inactive = tuple("xyz"[axis] for axis in range(n_dims) if not is_active[axis])
    notes += [f"nothing moves along {axis}: that axis is left out" for axis in inactive]
    best = next((s for s in ("quoted", "declared") if s in sources), "estimated")
    return NoiseEstimate(
        tuple(sigma), best, tuple(degrees), inactive, "; ".join(methods), tuple(notes)
    )


def finest_noise(data):
    """Per axis, the step of the grid that positions lie on (0.0: none) and the least sigma, metres.

    Returns
    -------
    steps, floors : tuple of float, length d
        The floor of an estimate is the step / sqrt(12) and 1e-12 of the range of the positions;
        that of a declared value is the latter alone.
    """
    scenes = data.scenes if isinstance(data, Dataset) else tuple(data)
    tracks = [_tracks(scenes, axis, _summing(data)) for axis in range(scenes[0].n_dims)]
    return tuple(_steps(data, tracks)), tuple(FLOOR * _span(axis) for axis in tracks)


def _summing(data):
    """Interval between rows of places that are sums, and how often they were added up; or zeros."""
    is_summed = isinstance(data, Dataset) and data.is_summed
    return (data.typical_step, data.n_sums) if is_summed else (0.0, 0)


def _tracks(scenes, axis, summed=(0.0, 0)):
    """Times and positions of every dynamic entity, gaps left out; at least two points each.

    Of sums, what is added to the places from row to row, or to the velocities times a step.
    """
    found, (step, order) = [], summed
    for scene in scenes:
        for entity in scene.dynamic:
            x = scene.positions[:, entity, axis]
            known = np.isfinite(x)
            if np.count_nonzero(known) < 2 + order:
                continue
            times, x = scene.times[known], x[known]
            gaps = np.diff(times)
            if order == 1:
                times, x = (times[1:] + times[:-1]) / 2, np.diff(x) * np.sqrt(step / gaps)
            elif order == 2:
                gained = np.diff(np.diff(x) / gaps)
                times, x = times[1:-1], gained * step**2 / ((gaps[1:] + gaps[:-1]) / 2)
            found.append((times, x))
    return found


def _span(tracks):
    if not tracks:
        return 0.0
    return max(float(x.max()) for _, x in tracks) - min(float(x.min()) for _, x in tracks)


def _quoted(scenes, axis):
    """Root mean square of the quoted errors of the dynamic entities, None without any."""
    values = [s.sigma[:, s.dynamic, axis].ravel() for s in scenes if s.sigma is not None]
    values = np.concatenate(values) if values else np.empty(0)
    values = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(values**2))) if len(values) else None


def _length_told(data):
    """The unit in which lengths of a data set are told, behind a blank, and its size in SI."""
    text, metre = data.units.declared.get("length", "").strip(), Unit.of(m=1)
    if text and not text[0].isdigit() and data.units.is_calibrated(metre):
        return parse_unit(text)[0], f" {text}"
    return 1.0, f" {data.units.text(metre)}"


def _of_fixes(tracks, step, data):
    """Tracks of fixes alone, unless places lie on a grid, where what hardly moves is held as well.

    What is added to sums from row to row stays as it is.
    """
    return tracks if step or _summing(data)[1] else [_fixes(*track) for track in tracks]


def _fixes(times, x):
    """The first row of every place, where most rows hold the place of the row before.

    What is held has no noise of its own, and its differences say next to nothing of that of fixes.
    """
    is_new = np.append(True, np.abs(np.diff(x)) > _HELD * np.ptp(x))
    is_held = is_new.mean() < _MOST_NEW and is_new.sum() > _MIN_WINDOWS + max(ORDERS)
    return (times[is_new], x[is_new]) if is_held else (times, x)


def _from_differences(tracks):
    """Sigma, the order of differences behind it, and the effective number of differences."""
    together = {}
    for times, x in tracks:
        together.setdefault(times.tobytes(), (times, []))[1].append(x)
    stacks = [(times, np.array(xs)) for times, xs in together.values()]
    candidates = []
    for order in ORDERS:
        z = [_differences(t, x, order).ravel() for t, x in stacks if len(t) > order]
        z = np.concatenate(z) if z else np.empty(0)
        if len(z) < _MIN_WINDOWS and candidates:
            break
        if len(z):
            correlation = math.comb(4 * order, 2 * order) / math.comb(2 * order, order) ** 2
            candidates.append((order, _robust_scale(z), len(z) / correlation))
    if not candidates:
        raise DataError("the noise cannot be estimated: no track has three positions",
                        remedy="declare noise in dataset.toml")  # fmt: skip
    least, chosen = math.inf, None
    for order, scale, n_effective in reversed(candidates):  # the lowest that no later one undercuts
        least = min(least, scale)
        if scale <= least * (1 + _TOLERANCE / math.sqrt(2 * n_effective)):
            chosen = scale, order, n_effective
    return chosen


def _steps(data, tracks):
    """Step of the grid of each axis, or of what its places were made of; 0.0 without one."""
    of_cells = getattr(data, "steps", ()) or [0.0] * len(tracks)
    return list(map(max, grid_steps(tracks), of_cells))


def grid_steps(tracks):
    """Step of the grid that the values of each axis lie on, 0.0 where there is none.

    Exact motion under a constant force is on a grid too, one of its own making; what tells rounding
    from it is that third differences of rounded tracks do not vanish. An axis along which they
    happen to vanish is rounded if it lies on the grid of one that shows it, the coarsest of these.
    """
    own = [grid_step(axis) for axis in tracks]
    is_seen = [bool(s) and _is_rough(axis, s) for s, axis in zip(own, tracks, strict=True)]
    seen = [s for s, is_own in zip(own, is_seen, strict=True) if is_own]
    whole = [
        step if is_own else max((s for s in seen if step and _is_multiple(step, s)), default=0.0)
        for step, is_own in zip(own, is_seen, strict=True)
    ]
    large = [_step_of_large(axis, step) for axis, step in zip(tracks, own, strict=True)]
    return list(map(max, whole, large))


def _step_of_large(tracks, step, *, by_digits=True):
    """Step of the grid that the larger values lie on, where it is coarser by digits; else 0.0.

    A value is never more accurate than its last digit, and one sigma counts for all. `step` is that
    of all values, 0.0 where it is finer than can be told. Of measured places the larger ones are
    coarser by whole digits (`by_digits`).
    """
    values, best = np.abs(np.concatenate([np.empty(0), *(x for _, x in tracks)])), 0.0
    for part in _LARGE if len(values) else ():
        least = np.quantile(values, part)
        if not grid_step([(t[0:0], x[np.abs(x) >= least]) for t, x in tracks]):
            continue  # as of nearly all that is not rounded: stretches need not be cut out
        pieces = _of_size(tracks, least)
        own = grid_step(pieces)
        digits = math.log10(own / step) if own and step else 1.0
        is_coarser = own > 0 and digits > 0.5
        is_coarser = is_coarser and (not by_digits or abs(digits - round(digits)) < 1e-3)
        if is_coarser and _is_rough(pieces, own):
            best = max(best, own)
    return best


def _of_size(tracks, least):
    """Stretches of tracks in which all values are of a size or more."""
    pieces = []
    for times, x in tracks:
        ends = np.flatnonzero(np.diff(np.abs(x) >= least)) + 1
        cut = zip(np.split(times, ends), np.split(x, ends), strict=True)
        pieces += [(t, own) for t, own in cut if abs(own[0]) >= least]
    return pieces


def _is_multiple(step, of):
    return step > 0.999 * of and abs(step / of - round(step / of)) < 1e-3


def grid_step(tracks):
    """Greatest common divisor of the gaps between all values (Euclid), 0.0 if it is rounding."""
    values = np.unique(np.concatenate([np.empty(0), *(x for _, x in tracks)]))
    rounding = 16 * np.finfo(float).eps * float(np.abs(values).max(initial=0.0))
    gaps = np.diff(values)
    gaps = np.sort(gaps[gaps > rounding])
    if not len(gaps):
        return 0.0
    if len(gaps) < _MIN_GRID_VALUES - 1:
        n_values, n_rows = len(gaps) + 1, sum(len(x) for _, x in tracks)
        n_changes = sum(np.count_nonzero(np.abs(np.diff(x)) > rounding) for _, x in tracks)
        if n_changes < _COMES_BACK * n_values and n_rows < _STAYS * n_values:
            return 0.0
    step = float(gaps[0])
    while step > _MIN_GRID_STEP * rounding:
        step = _refined(step, gaps)
        multiples = np.round(gaps / step)
        rest = np.abs(gaps - multiples * step)
        rest = rest[rest > np.minimum(rounding * (1 + multiples), 1e-3 * step)]
        if not len(rest):
            return step
        step = float(rest[0])  # that of the smallest gap is the most accurate
    return 0.0


def coarsest_step(tracks):
    """Step of the grid of all values, or of the larger ones where that is coarser; else 0.0."""
    own = grid_step(tracks)
    return max(own, _step_of_large(tracks, own, by_digits=False))


def _refined(step, gaps):
    """The step by least squares on ever larger gaps that are multiples of it."""
    for most in (10, 1e3, 1e5):
        multiples = np.round(gaps / step)
        kept = (multiples > 0) & (multiples <= most)
        kept &= np.abs(gaps - multiples * step) < 1e-3 * step
        if kept.any():
            step = float(gaps[kept] @ multiples[kept] / (multiples[kept] @ multiples[kept]))
    return step


def _is_rough(tracks, step):
    """Whether tracks in steps of a grid are no polynomials of low degree, piece by piece."""
    n_moving = n_rough = 0
    for _, x in tracks:
        counts = np.round((x - x[0]) / step)
        if len(counts) < 4:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(counts, 4)
        n_moving += np.count_nonzero(np.ptp(windows, axis=1))
        n_rough += np.count_nonzero(np.diff(counts, 3))
    return n_rough > _MIN_ROUGH * n_moving


def _differences(times, x, order):
    """Differences of `order` of tracks (k, n), scaled so that white noise keeps its variance."""
    steps = np.diff(times)
    x = x - x.mean(axis=1, keepdims=True)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        return np.diff(x, order) / math.sqrt(math.comb(2 * order, order))
    windows = np.lib.stride_tricks.sliding_window_view(times, order + 1)
    spans = windows[:, -1:] - windows[:, :1]
    scaled = (windows - windows[:, :1]) / spans
    gaps = scaled[:, :, None] - scaled[:, None, :]
    gaps[:, np.arange(order + 1), np.arange(order + 1)] = 1.0
    weights = 1.0 / gaps.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    seen = np.lib.stride_tricks.sliding_window_view(x, order + 1, axis=1)
    return np.einsum("knw,nw->kn", seen, weights)


def _robust_scale(z):
    """Scale of a centred normal sample with outliers: from the MAD to the clipped rms."""
    z = np.abs(z)
    scale = _MAD_TO_SIGMA * float(np.median(z))
    if scale == 0:  # mostly at rest: what is left is in the moving part
        moving = z[z > 0]
        if len(moving) == 0:
            return 0.0
        scale = _MAD_TO_SIGMA * float(np.median(moving))
    for _ in range(_N_PASSES):
        kept = z[z <= _CLIP * scale]
        if not kept.any():  # all that moves is clipped where most rows repeat
            break
        scale = math.sqrt(float(np.mean(kept**2))) / _CLIPPED_RMS
    return scale
