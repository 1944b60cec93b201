"""Where fits begin: nodes read off the data, and constants of the size that the data suggest."""

import math
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from bsp_gp.fitting.coordinates import powers_of
from bsp_gp.language.formula import Call, Constant, Input, walk

SIGNAL = 4.0
"""Mean square of curvatures, in that of the noise, from which they show an acceleration."""
HURRIED = 0.3
"""Part of the median time from row to row from which rows tell a velocity."""
EXPONENTS = (-2.0, 1.0, -1.0, 2.0, -3.0, 0.5, 3.0, 0.0, -4.0, 4.0)
DECADES = (1.0, 0.1, 10.0, 0.01, 100.0)


# --- nodes ------------------------------------------------------------------------------------


def first_nodes(chains, is_coarse=False):
    """A state for every row, (2, R, d, T, S): where it was seen, and the slope of a curve there.

    Parameters
    ----------
    is_coarse : bool
        Whether neighbouring rows show the acceleration above the noise: then the curve is a spline,
        else differences over two rows.
    """
    n_rows, n_chains, n_own, n_dims = chains.observed.shape
    nodes = np.zeros((2, n_own, n_dims, n_rows, n_chains))
    for s in range(n_chains):
        n = int(chains.lengths[s])
        times = chains.times[:n, s]
        for r in range(n_own):
            for k in range(n_dims):
                x = chains.observed[:n, s, r, k]
                seen = np.flatnonzero(np.isfinite(x))
                if not len(seen):
                    continue
                nodes[:, r, k, :n, s] = _states(times, x, seen, is_coarse)
    if chains.velocities is not None:
        measured = np.moveaxis(chains.velocities, (0, 1), (-2, -1))
        nodes[1] = np.where(np.isfinite(measured), measured, nodes[1])
    return nodes


def _states(times, x, seen, is_coarse):
    """Places and velocities at all rows of a coordinate that some show, (2, T)."""
    place, speed = x[seen], _slope(times[seen], x[seen], is_coarse)
    if len(seen) == len(x):
        return place, speed
    states = np.stack([np.interp(times, times[seen], v) for v in (place, speed)])
    between = (times >= times[seen[0]]) & (times <= times[seen[-1]])
    if len(seen) > 1:
        curve = CubicHermiteSpline(times[seen], place, speed)
        states[:, between] = curve(times[between]), curve(times[between], 1)
    states[1, ~between] = 0.0
    return states


def stepped_nodes(chains, nodes):
    """States with the velocities of the paper's steps: of the step that led to a row."""
    nodes = nodes.copy()
    with np.errstate(invalid="ignore"):
        velocity = np.diff(nodes[0], axis=-2) / np.diff(chains.times, axis=0)
    velocity = np.where(np.isfinite(velocity), velocity, nodes[1, ..., 1:, :])
    nodes[1, ..., 1:, :] = velocity
    nodes[1, ..., 0, :] = velocity[..., 0, :]
    return nodes


def _slope(times, x, is_coarse):
    """Slope of a curve through places; through means of rows that are hurried together.

    Two rows in one night tell nothing of a year's motion: what noise they differ by, over so short
    a time, would be a wild velocity.
    """
    if len(x) < 2:
        return np.zeros(len(x))
    rows = _together(times)
    if len(rows) < len(x):
        count = np.diff(np.append(rows, len(x)))
        when, where = (np.add.reduceat(v, rows) / count for v in (times, x))
        return np.interp(times, when, _slope_of(when, where, is_coarse))
    return _slope_of(times, x, is_coarse)


def _together(times):
    """First rows of groups of rows that are much closer to each other than rows usually are."""
    steps = np.diff(times)
    if np.all(steps >= HURRIED * np.median(steps)):
        return np.arange(len(times))
    least, first = HURRIED * np.median(steps), [0]
    for k in range(1, len(times)):
        if times[k] - times[first[-1]] >= least:
            first.append(k)
    return np.array(first)


def _slope_of(times, x, is_coarse):
    if len(x) < 2:
        return np.zeros(len(x))
    if is_coarse and len(x) > 3:
        return CubicSpline(times, x).derivative()(times)
    return np.gradient(x, times, edge_order=2 if len(x) > 2 else 1)


# --- scales -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scales:
    """Typical sizes of what was seen.

    Attributes
    ----------
    acceleration : float, m/s^2
    rows : int
        Rows that a piece of a track needs to show it above the noise.
    span, step : float, s
        Longest track and shortest interval.
    extent : float, m
    turn : float
        Typical change of the velocity from row to row, in velocities: small where rows are dense,
        around one where a body turns from row to row.
    """

    acceleration: float
    rows: int
    span: float
    step: float
    extent: float
    turn: float


def scales_of(groups, noises):
    """Sizes of the motion, from curvatures of parabolas through pieces of the tracks."""
    span, step, extent, sparse = 0.0, np.inf, 0.0, 1.0
    for chains in groups:
        for s in range(chains.n_chains):
            times = chains.times[: chains.lengths[s], s]
            span = max(span, float(times[-1] - times[0]))
            step = min(step, float(np.diff(times).min()))
        # A body may be seen in no row at all, and then has no extent.
        spread = np.fmax.reduce(chains.observed) - np.fmin.reduce(chains.observed)
        extent = float(np.fmax(extent, np.fmax.reduce(spread, axis=None)))
        count = np.isfinite(chains.observed).sum(axis=0)
        per_row = chains.lengths[:, None, None] / np.maximum(count, 1)
        sparse = max(sparse, float(np.median(per_row[count > 0]))) if count.any() else sparse
    best, rows = 0.0, 0
    longest = max(int(chains.lengths.max()) for chains in groups)
    seen = [_seen(chains, noise) for chains, noise in zip(groups, noises, strict=True)]
    size = 3
    while size <= longest:
        signal, noise = _curvatures(seen, size)
        if signal > SIGNAL * noise:
            rows = rows or math.ceil(sparse * size)  # each body may be seen in few of all rows
            best = max(best, signal - noise)
        size = size + 1 if size < 6 else int(size * 1.5)
    if not best:
        best = (extent / span**2) ** 2
    return Scales(
        float(np.sqrt(best)), rows or longest, span, step, extent or 1.0, _turn(seen)
    )


def _seen(chains, noise):
    """Times, places and variances of rows in which a coordinate is seen, first; (T, S, R, d) each.

    Behind them nan. Bodies may each be seen at times of its own; where none is, times are one for
    all coordinates, (T, S, 1, 1).
    """
    x, times = chains.observed, chains.times[:, :, None, None]
    is_seen = np.isfinite(x)
    if not (np.diff(is_seen.astype(np.int8), axis=0) > 0).any():
        return times, x, noise.variance
    order = np.argsort(~is_seen, axis=0, kind="stable")
    all_rows = (np.broadcast_to(v, x.shape) for v in (is_seen, times, x, noise.variance))
    is_seen, *first = (np.take_along_axis(v, order, axis=0) for v in all_rows)
    return tuple(np.where(is_seen, v, np.nan) for v in first)


def _turn(seen):
    """Typical change of the velocity from row to row, in velocities, without what noise makes.

    Medians of squares: a few rows that are far off would make any motion a wild one.
    """
    changes, sizes = [], []
    for times, x, variance in seen:
        with np.errstate(invalid="ignore"):
            steps = np.diff(times, axis=0)
            v = np.diff(x, axis=0) / steps
            error = (variance[1:] + variance[:-1]) / steps**2
            # The row between two velocities makes both wrong, one way and the other.
            common = variance[1:-1] / (steps[1:] * steps[:-1])
            turned = np.square(np.diff(v, axis=0)) - error[1:] - error[:-1] - 2 * common
        changes.append(turned.sum(axis=-1).ravel())
        sizes.append((np.square(v) - error).sum(axis=-1).ravel())
    change, size = (np.concatenate(parts) for parts in (changes, sizes))
    change, size = (v[np.isfinite(v)] for v in (change, size))
    if not len(change) or not np.median(size) > 0:
        return 0.0
    return float(np.sqrt(max(np.median(change), 0.0) / np.median(size)))


def _curvatures(seen, size):
    """Mean square of second derivatives over pieces of so many rows, and what noise makes of it."""
    total = expected = count = 0.0
    for when, where, variances in seen:
        starts = range(0, when.shape[0] - size + 1, max(size // 2, 1))
        if not len(starts):
            continue
        rows = np.array(starts)[:, None] + np.arange(size)
        times = when[rows]  # (P, size, S, R, d)
        centre = times.mean(axis=1, keepdims=True)
        width = np.ptp(times, axis=1, keepdims=True)
        u = np.moveaxis((times - centre) / width, 1, -1)
        whole = np.isfinite(u).all(axis=-1)  # (P, S, R, d)
        u = np.where(whole[..., None], u, np.linspace(-0.5, 0.5, size))
        basis, triangle = np.linalg.qr(np.stack([np.ones_like(u), u, u * u], axis=-1))
        weight = basis[..., 2] / triangle[..., 2, 2, None]  # of the coefficient of u^2
        width = np.where(whole, width[:, 0], 1.0)
        x, variance = (np.moveaxis(v[rows], 1, -1) for v in (where, variances))
        value = 2.0 * (weight * x).sum(axis=-1) / width**2
        error = 4.0 * (weight * weight * variance).sum(axis=-1) / width**4
        good = np.isfinite(value) & np.isfinite(error) & whole
        total += float(np.square(value[good]).sum())
        expected += float(error[good].sum())
        count += int(good.sum())
    return (total / count, expected / count) if count else (0.0, 1.0)


# --- constants --------------------------------------------------------------------------------


def roles_of(law):
    """What each constant does: "exponent", "rate", "phase", "inner", "linear" or "kept".

    What is kept belongs to a constraint or a wall, and begins where the rows have it.
    """
    roles = {}
    for term in law.terms:
        for _, name, _ in powers_of(term.formula):
            roles[name] = "exponent"
        for node in walk(term.formula):
            if not isinstance(node, Call):
                continue
            if node.operator == "pow":
                for name in node.args[1].constants:
                    roles.setdefault(name, "exponent")
            if node.operator in ("sin", "cos"):
                _angle_roles(node.args[0], roles)
    for part in law.frame:
        if part.kind in ("constraint", "wall"):
            roles |= dict.fromkeys(part.names, "kept")
    for name in law.names:
        if name not in roles:
            is_linear = all(_is_linear(term.formula, name) for term in law.terms)
            roles[name] = "linear" if is_linear else "inner"
    return roles


def _angle_roles(angle, roles):
    """Constants beside the time in an angle are rates, those added to it phases."""
    for node in walk(angle):
        if isinstance(node, Call) and node.operator in ("mul", "div"):
            names = node.constants
            has_time = any(isinstance(n, Input) and n.name == "t" for n in walk(node))
            for name in names:
                roles.setdefault(name, "rate" if has_time else "inner")
    if isinstance(angle, Call) and angle.operator in ("add", "sub"):
        for arg in angle.args:
            if isinstance(arg, Constant):
                roles[arg.name] = "phase"


def _is_linear(node, name):
    """Whether a formula is linear, or constant, in a constant."""
    if name not in node.constants:
        return True
    if isinstance(node, Constant):
        return True
    if node.operator in ("add", "sub", "neg"):
        return all(_is_linear(arg, name) for arg in node.args)
    if node.operator == "mul":
        both = [name in arg.constants for arg in node.args]
        return sum(both) == 1 and all(_is_linear(arg, name) for arg in node.args)
    if node.operator == "div":
        return name not in node.args[1].constants and _is_linear(node.args[0], name)
    return False


def candidates(law, parameters, scales, rates, most):
    """Values of the constants to begin with, the likeliest first.

    Of those that do not enter linearly; the others are found from these.

    Parameters
    ----------
    rates : sequence of float
        Angular frequencies at which the tracks show something, rad/s.
    """
    roles = roles_of(law)
    names = dict.fromkeys(name for name, _ in parameters)
    names = [n for n in names if roles[n] not in ("linear", "kept")]
    grids = {
        "exponent": EXPONENTS,
        "rate": tuple(rates) or tuple(2 * np.pi / scales.span * np.array([1.0, 3.0, 10.0])),
        "phase": (0.0, np.pi / 2),
        "inner": tuple(scales.extent * np.array(DECADES)),
    }
    sizes = [len(grids[roles[name]]) for name in names]
    sums = range(sum(sizes) - len(sizes) + 1)
    choices = (choice for total in sums for choice in _adding_up(total, sizes))
    return [
        {name: float(grids[roles[name]][k]) for name, k in zip(names, choice, strict=True)}
        for choice in islice(choices, most)
    ]


def _adding_up(total, sizes):
    """Places (k, ...), each below its size, that add up to a total, in their order."""
    if not sizes:
        yield from [()] if total == 0 else []
        return
    rest = sum(sizes[1:]) - len(sizes[1:])
    for k in range(max(total - rest, 0), min(total, sizes[0] - 1) + 1):
        for others in _adding_up(total - k, sizes[1:]):
            yield (k, *others)
