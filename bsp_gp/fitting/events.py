"""Steps through an instant at which a condition changes: found, and the derivatives jump.

Until the instant the law acts with the old mode, after it with the new one. An unknown that moves
the instant by dt shifts the state behind it by (f_before - f_after) dt: without that the derivative
by a threshold, or by anything that a contact depends on, is wrong (LOOP §2, "saltation").
"""

from __future__ import annotations

import numpy as np

from bsp_gp.fitting.motion import CREEP, Points

__all__ = ["chained", "passed_over", "through_events", "up_to_events"]

MAX_EVENTS = 16
"""Changes within one step beyond which the rest is taken with the modes as they are."""
WITHIN = tuple((k + 0.5) / 8 for k in range(8))
"""Parts of a step at which conditions are looked at when its length is chosen."""
STOP = "stop"
JUST_BEFORE = 1 - 1e-9
SLOW = 1e-3
"""Part of its speed at the start of a step below which a body that turned round had stopped."""
BISECTIONS = 60
CLOSE = 1e-14
"""Part of a step to which an instant is found."""


def through_events(flow, scheme, stages, end, h, modes, index, slopes=False):
    """Mend the steps within which conditions change.

    Parameters
    ----------
    flow : Flow
    scheme : Scheme
    stages : list of Points
        Of the steps, their starts first.
    end : ndarray, shape (2, R, d, M)
        Ends with the modes of the start; a mended copy is returned.
    h : ndarray, shape (M,)
    modes : list of ndarray
        Modes of all intervals; those at `index` are changed in place.
    index : ndarray of int, shape (M,)
        Place of each step's interval in `modes`.
    slopes : bool

    Returns
    -------
    end : ndarray, shape (2, R, d, M)
    moved : dict of int to ndarray, shape (n, n + k)
        Derivatives of the mended steps by their starts and the constants.
    """
    points = stages[0]
    changed = _changed(flow, points, end, h) | _turned(flow, stages, end).any(axis=0)
    changed |= passed_over(flow, points, end, h)
    moved = {}
    if not changed.any():
        return end, moved
    end = end.copy()
    for m in np.flatnonzero(changed):
        state, own, new = _through(flow, scheme, points.pick([m]), h[m], slopes)
        end[..., m] = state[..., 0]
        if slopes:
            moved[m] = own
        for mode, held in zip(modes, new, strict=True):
            mode[..., index[m]] = held[..., 0]
    return end, moved


def passed_over(flow, points, end, h):
    """Whether a condition changes within steps and is back at their ends, (M,).

    Places between the ends are those of a cubic through both states.
    """
    passed = np.zeros(len(h), dtype=bool)
    after = flow.points(end, points.times + h, points.chain)
    (p0, v0), (p1, v1) = points.state, end
    for u in WITHIN:
        place = (
            (1 + 2 * u) * (1 - u) ** 2 * p0 + u * u * (3 - 2 * u) * p1
            + h * (u * (1 - u) ** 2 * v0 - u * u * (1 - u) * v1)
        )  # fmt: skip
        state = np.stack([place, (1 - u) * v0 + u * v1])
        inside = flow.points(state, points.times + u * h, points.chain)
        for before, now, then in zip(points.modes, inside.modes, after.modes, strict=True):
            passed |= ((now != before) & (then == before)).any(axis=(0, 1, 2))
    return passed


def up_to_events(flow, scheme, stages, end, h, modes, index, good):
    """Cut the steps that count where the first condition changes, and change its mode.

    A step at whose end a body has turned round does not count by its own error, but may by that
    of the part until the body stops: that part does.

    Parameters
    ----------
    flow, scheme, stages, end, h, modes, index, good
        As of `through_events`.

    Returns
    -------
    end : ndarray, shape (2, R, d, M)
    h : ndarray, shape (M,)
    good : ndarray of bool, shape (M,)
    """
    points, turned = stages[0], _turned(flow, stages, end).any(axis=0)
    changed = (_changed(flow, points, end, h) & good) | turned
    if not changed.any():
        return end, h, good
    end, h, good = end.copy(), h.copy(), good.copy()
    for m in np.flatnonzero(changed):
        start = points.pick([m])
        part, change = _next_change(flow, scheme, start, h[m])
        if change is None:
            continue
        state, _ = _part(flow, scheme, start, part, False)
        h[m] = part
        if change[0] == STOP:
            there, _ = _stopped(flow, start, state, part, change[1])
            state, good[m] = there.state, True
        else:
            program, mode, i, j = change
            modes[program][mode, i, j, index[m]] = ~modes[program][mode, i, j, index[m]]
        end[..., m] = state[..., 0]
    return end, h, good


def _turned(flow, stages, end):
    """Bodies that friction may stop and whose velocity turns by over 90 degrees, (R, M)."""
    if not flow.motion.has_stops:
        return np.zeros((1, end.shape[-1]), dtype=bool)
    return _headings(stages, end) < 0


def _headings(stages, end):
    """Least product of the velocity at the start of a step with those within it, (R, M)."""
    first = stages[0].state[1]
    later = [*(stage.state[1] for stage in stages[1:]), end[1]]
    return np.min([(first * v).sum(axis=1) for v in later], axis=0)


def _stopped(flow, start, state, part, body):
    """The point behind a stop: the body is held at rest, or sets out the other way.

    Returns
    -------
    there : Points
    is_held : bool
    """
    state = state.copy()
    state[1, body] = 0.0
    there = flow.points(state, start.times + part, start.chain, start.modes)
    is_held = bool(flow.motion.is_held(there)[body, 0])
    if not is_held:
        pull = flow.motion.acceleration(there)[body]
        size = np.sqrt(np.square(pull).sum())
        state[1, body] = CREEP * pull / (size if size > 0 else 1.0)
        there = flow.points(state, start.times + part, start.chain, start.modes)
    return there, is_held


def _changed(flow, points, end, h):
    """Steps at whose ends a condition is not what it was, (M,)."""
    after = flow.points(end, points.times + h, points.chain)
    changed = np.zeros(len(h), dtype=bool)
    for before, now in zip(points.modes, after.modes, strict=True):
        changed |= (before != now).any(axis=(0, 1, 2))
    return changed


def _through(flow, scheme, points, h, slopes):
    """One step of one interval, taken in parts between the instants of change."""
    total = None
    left = h
    for _ in range(MAX_EVENTS):
        part, change = _next_change(flow, scheme, points, left)
        end, moved = _part(flow, scheme, points, part, slopes)
        total = chained(total, moved, flow.n_state)
        time = points.times + part
        left -= part
        if change is None:
            return end, total, points.modes
        if change[0] == STOP:
            there, is_held = _stopped(flow, points, end, part, change[1])
            if slopes:
                total = _stop_jump(flow, points, end, part, there, change[1], is_held) @ total
            points = there
            if left <= CLOSE * h:
                return there.state, total, points.modes
            continue
        held = [mode.copy() for mode in points.modes]
        program, mode, i, j = change
        held[program][mode, i, j] = ~held[program][mode, i, j]
        here = flow.points(end, time, points.chain, points.modes)
        there = flow.points(end, time, points.chain, held)
        if slopes:
            by_state, by_constant = _jump(flow, here, there, change)
            total = by_state @ total
            total[:, flow.n_state :] += by_constant
        points = there
        if left <= CLOSE * h:
            return end, total, points.modes
    end, moved = _part(flow, scheme, points, left, slopes)
    return end, chained(total, moved, flow.n_state), points.modes


def _part(flow, scheme, points, length, slopes):
    length = np.array([length])
    end, stages, _ = flow.step(scheme, points, length)
    if not slopes:
        return end, None
    moved = flow.step_slopes(scheme, stages, length)
    return end, moved[..., 0] if flow.is_sparse else moved[0]


def chained(total, moved, n):
    """Derivatives of steps one after the other, as square matrices over states and constants."""
    if moved is None:
        return None
    if total is None:
        return moved
    after = moved[:, :n] @ total
    after[:, n:] += moved[:, n:]
    return after


def _next_change(flow, scheme, points, h):
    """Length until the first condition changes, and which; the whole step and None if none."""

    def ends(length):
        return flow.step(scheme, points, np.array([length]))[0]

    def headings(length):
        end, stages, _ = flow.step(scheme, points, np.array([length]))
        return _headings(stages, end)[:, 0]

    def margins(length):
        end = ends(length)
        there = flow.points(end, points.times + length, points.chain, points.modes)
        return flow.motion.margins(there)

    low = 0.0
    for part in (*WITHIN, 1.0):
        first, which = part * h, None
        found = margins(first)
        for program, (held, margin) in enumerate(zip(points.modes, found, strict=True)):
            for mode, i, j in np.argwhere((margin[..., 0] > 0) != held[..., 0]).tolist():
                key = (program, mode, i, j)
                instant = _instant(
                    lambda x, key=key: margins(x)[key[0]][key[1], key[2], key[3], 0],
                    low, part * h, held[mode, i, j, 0],
                )  # fmt: skip
                if which is None or abs(instant) < abs(first):
                    first, which = instant, key
        for body in np.flatnonzero(headings(part * h) < 0) if flow.motion.has_stops else ():
            # Just before it: behind it the last stages of a step would be pushed on by friction.
            instant = JUST_BEFORE * _instant(
                lambda x, body=body: headings(x)[body], low, part * h, True
            )
            speed = np.abs(ends(instant)[1, body]).max()
            if speed <= SLOW * np.abs(points.state[1, body]).max() and abs(instant) < abs(first):
                first, which = instant, (STOP, int(body))
            elif which is None and speed <= SLOW * np.abs(points.state[1, body]).max():
                first, which = instant, (STOP, int(body))
        if which is not None:
            return first, which
        low = first
    return h, None


def _stop_jump(flow, start, end, part, there, body, is_held):
    """How derivatives by the state jump where a body stops, (n, n)."""
    n, n_dims = flow.n_state, flow.chains.n_dims
    rows = n // 2 + body * n_dims + np.arange(n_dims)
    jump = np.eye(n)
    if is_held:
        jump[rows] = 0.0
        return jump
    here = flow.points(end, start.times + part, start.chain, start.modes)
    # Just before the stop the body creeps as it came.
    creep = end.copy()
    way = start.state[1, body, :, 0] / np.sqrt(np.square(start.state[1, body, :, 0]).sum())
    creep[1, body, :, 0] = CREEP * way
    here = flow.points(creep, here.times, here.chain, here.modes)
    before = flow.motion.acceleration(here)[body, :, 0]
    after = flow.motion.acceleration(there)[body, :, 0]
    slowing = way @ before
    if slowing != 0:
        jump[np.ix_(rows, rows)] += np.outer(after - before, way) / slowing
    return jump


def _instant(margin, low, high, held):
    """Where a margin leaves the sign of its mode, by bisection with secants (Illinois)."""
    sign = 1.0 if held else -1.0
    at_low, at_high = sign * margin(low), sign * margin(high)
    if at_low <= 0:  # on the edge already
        return low
    width = abs(high - low)
    side = 0
    for _ in range(BISECTIONS):
        middle = low + (high - low) * at_low / (at_low - at_high)
        value = sign * margin(middle)
        if value > 0:
            low, at_low = middle, value
            at_high, side = (at_high / 2 if side == 1 else at_high), 1
        else:
            high, at_high = middle, value
            at_low, side = (at_low / 2 if side == -1 else at_low), -1
        if abs(high - low) <= CLOSE * width or value == 0:
            break
    return high


def _jump(flow, here, there, change):
    """How derivatives jump where a condition changes: by the state (n, n), by constants (n, k)."""
    n = flow.n_state
    motion = flow.motion
    before, after = motion.acceleration(here), motion.acceleration(there)
    by_state, by_time, by_constant = motion.margin_slope(here, *change)
    rate = np.concatenate([here.state[1].reshape(-1), before.reshape(-1)])
    speed = by_state[0] @ rate + by_time[0] + _driven_rate(flow, here, change)
    kick = np.zeros(n)
    if speed != 0 and np.isfinite(speed):
        kick[n // 2 :] = (after - before).reshape(-1) / speed
    return np.eye(n) + np.outer(kick, by_state[0]), np.outer(kick, by_constant[0])


def _driven_rate(flow, here, change):
    """How fast a margin changes because the other, driven, body moves."""
    program, mode, i, j = change
    other = flow.motion.others[i, j] if flow.motion.programs[program].kind == "pair" else -1
    n_own = flow.chains.n_moving
    if other < n_own or here.driven is None or not here.driven[1].any():
        return 0.0
    step = 1e-7 * (flow.length.min() or 1.0)

    def margin(dt):
        driven = here.driven.copy()
        driven[0] += dt * driven[1]
        moved = Points(here.state, here.times, here.chain, driven, here.modes)
        return flow.motion.margins(moved)[program][mode, i, j, 0]

    return (margin(step) - margin(-step)) / (2 * step)
