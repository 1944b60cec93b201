"""Steps through an instant at which a condition changes: found, and the derivatives jump.

Until the instant the law acts with the old mode, after it with the new one. An unknown that moves
the instant by dt shifts the state behind it by (f_before - f_after) dt: without that the derivative
by a threshold, or by anything that a contact depends on, is wrong (LOOP §2, "saltation").
"""

import numpy as np

from bsp_gp.physics.engine.motion import CREEP, Points
from bsp_gp.physics.engine.roots import CLOSE, FEW, roots

MAX_EVENTS = 16
"""Changes within one step beyond which the rest is taken with the modes as they are."""
WITHIN = tuple((k + 0.5) / 8 for k in range(8))
"""Parts of a step at which conditions are looked at when its length is chosen."""
STOP, CUT = -1, -2
"""In the place of a program: a body stops; a step is taken in parts."""
NEARER = 0.75
"""Part of the way to where a body has turned round after which its step is begun anew."""
JUST_BEFORE, CARRIED_BEFORE = 1 - 1e-9, 1 - 1e-5
"""Parts of the way to a stop that are gone: of bodies that come to rest on what moves itself the
last differences of velocities are lost in their digits."""
ALONG = 1e-6
"""Part of the speed of what they rest on by which bodies differ from it that come to rest."""
SLOW = 1e-3
"""Part of its speed at the start of a step below which a body that turned round had stopped."""
HALTED = 1e-4
"""Part of its speed that is left of a body that friction has as good as stopped within a step."""
NEAR = 1e-10
"""To which part of itself the instant of a stop is found: what is left of the speed there is as
small."""


def through_events(flow, scheme, stages, end, h, modes, index, slopes=False):
    """Mend the steps within which conditions change.

    Parameters
    ----------
    end : ndarray, shape (2, R, d, M)
        Ends with the modes of the start; a mended copy is returned.
    h : ndarray, shape (M,)
    modes : list of ndarray
        Modes of all intervals; those at `index` are changed in place.
    index : ndarray of int, shape (M,)
        Place of each step's interval in `modes`.

    Returns
    -------
    end : ndarray, shape (2, R, d, M)
    moved : dict of int to ndarray, shape (n, n + k)
        Derivatives of the mended steps by their starts and the constants.
    """
    points = stages.first
    changed = _changed(flow, points, end, h) | _turned(flow, stages, end).any(axis=(0, 1))
    changed |= passed_over(flow, points, end, h)
    if slopes:
        changed |= _halted(flow, points, end).any(axis=(0, 1))
    changed &= np.isfinite(points.state).all(axis=(0, 1, 2))  # a track that is lost stays so
    if not changed.any():
        return end, {}
    end, which = end.copy(), np.flatnonzero(changed)
    end[..., which], own, new = _through(flow, scheme, points.pick(which), h[which], slopes)
    for mode, held in zip(modes, new, strict=True):
        mode[..., index[which]] = held
    return end, dict(zip(which.tolist(), own, strict=True)) if slopes else {}


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
    points, turned = stages.first, _turned(flow, stages, end).any(axis=(0, 1))
    changed = (_changed(flow, points, end, h) & good) | turned
    if not changed.any():
        return end, h, good
    end, h, good = end.copy(), h.copy(), good.copy()
    which = np.flatnonzero(changed)
    start = points.pick(which)
    part, changes = _next_changes(flow, scheme, start, h[which])
    state = flow.step(scheme, start, part)[0]
    there, _ = _stopped(flow, start, state, part, changes)
    for m, change in enumerate(changes):
        if change is None or change[0] == CUT:
            continue
        h[which[m]], end[..., which[m]] = part[m], there.state[..., m]
        if change[0] == STOP:
            good[which[m]] = True
        else:
            program, mode, i, j = change
            held = modes[program][mode, i, j]
            held[index[which[m]]] = ~held[index[which[m]]]
    return end, h, good


def _turned(flow, stages, end):
    """Bodies that friction may stop and whose velocity turns by over 90 degrees, (G, R, M).

    The groups of axes are those of `Motion.stops`.
    """
    return _headings(flow, stages, end) < 0


def _headings(flow, stages, end):
    """Least product of the velocity at the start of a step with those within it, (G, R, M).

    Velocities are those past that on which bodies come to rest.
    """
    points, motion = stages.first, flow.motion
    later = [*stages.states[1:, 1], end[1]]
    out = np.zeros((len(motion.stops), len(end[1]), end.shape[-1]))
    for group in range(len(motion.stops)):
        first = motion.past(group, points, points.state[1])
        sums = [(first * motion.past(group, points, v)).sum(axis=1) for v in later]
        out[group] = np.min(sums, axis=0)
    return out


def _halted(flow, start, end):
    """Bodies that may go aside and are as good as stopped at the end of a step, (G, R, M)."""
    motion = flow.motion
    out = np.zeros((len(motion.stops), len(end[1]), end.shape[-1]), dtype=bool)
    for group, axes in enumerate(motion.stops):
        if len(axes) > 1:
            sizes = [np.square(motion.past(group, start, v)).sum(axis=1)
                     for v in (start.state[1], end[1])]  # fmt: skip
            out[group] = sizes[1] < HALTED**2 * sizes[0]
    return out


def _stopped(flow, start, state, part, changes):
    """The points behind stops: bodies are held at rest, `is_held`, or set out the other way."""
    state, times = state.copy(), start.times + part
    is_held = np.zeros(len(part), dtype=bool)
    stops = [(m, change) for m, change in enumerate(changes) if change and change[0] == STOP]
    media = {group: flow.motion.medium(group, start) for group in {c[1] for _, c in stops}}
    for m, (_, group, body, _) in stops:
        state[1, body, list(flow.motion.stops[group]), m] = _of_body(media[group], body, m)
    there = flow.points(state, times, start.chain, start.modes)
    if not stops:
        return there, is_held
    held, pull = flow.motion.is_held(there), flow.motion.acceleration(there)
    for m, (_, group, body, _) in stops:
        axes = list(flow.motion.stops[group])
        is_held[m] = held[body, axes[0], m]
        if not is_held[m]:
            size = np.sqrt(np.square(pull[body, axes, m]).sum())
            creep = CREEP * pull[body, axes, m] / (size if size > 0 else 1.0)
            state[1, body, axes, m] = _of_body(media[group], body, m) + creep
    return flow.points(state, times, start.chain, start.modes), is_held


def _of_body(medium, body, m):
    """The velocity of a medium for one body at one point."""
    return medium[body, :, m] if np.ndim(medium) else medium


def _changed(flow, points, end, h):
    """Steps at whose ends a condition is not what it was, (M,)."""
    after = flow.points(end, points.times + h, points.chain)
    changed = np.zeros(len(h), dtype=bool)
    for before, now in zip(points.modes, after.modes, strict=True):
        changed |= (before != now).any(axis=(0, 1, 2))
    return changed


def _through(flow, scheme, points, h, slopes):
    """Steps of some intervals, each in parts between the instants of change; modes at the ends."""
    ends = points.state.copy()
    modes = [mode.copy() for mode in points.modes]
    times, left = points.times.copy(), h.copy()
    n = flow.n_state
    total = np.tile(np.eye(n, n + flow.n_constants), (len(h), 1, 1)) if slopes else None
    open_ = np.arange(len(h))
    for number in range(MAX_EVENTS + 1):
        chain = points.chain[open_]
        here = [mode[..., open_] for mode in modes]
        start = flow.points(ends[..., open_], times[open_], chain, here)
        part, changes = _next_changes(flow, scheme, start, left[open_])
        is_lost = np.zeros(len(open_), dtype=bool)
        if number == MAX_EVENTS:
            # Part by part too long: such a step has no end that means anything.
            is_lost = np.array([change is not None and change[0] == CUT for change in changes])
            part, changes = left[open_], [None] * len(open_)
        state, moved = _part(flow, scheme, start, part, slopes)
        there, is_held = _stopped(flow, start, state, part, changes)
        new = _switched(modes, open_, changes)
        behind = flow.points(there.state, there.times, chain, new)
        if slopes:
            _straightened(flow, start, state, part, moved)
            total[open_] = chained(total[open_], moved, n)
            before = flow.points(state, there.times, chain, start.modes)
            _jumped(flow, total, open_, changes, is_held, (start, before, behind))
            if flow.motion.constraints:  # a body that creeps feels the least way off them
                kept = flow.motion.constraints.tangent(behind)
                total[open_] = chained(total[open_], kept, n)
        ends[..., open_], times[open_] = there.state, there.times
        ends[..., open_[is_lost]] = np.nan
        for mode, held in zip(modes, new, strict=True):
            mode[..., open_] = held
        left[open_] -= part
        has_more = np.array([change is not None for change in changes])
        has_more &= np.abs(left[open_]) > CLOSE * np.abs(h[open_])
        open_ = open_[has_more]
        if not len(open_):
            break
    return ends, total, modes


def _switched(modes, index, changes):
    """Modes of some intervals behind their changes."""
    new = [mode[..., index] for mode in modes]  # copies: the index is an array
    for m, change in enumerate(changes):
        if change is not None and change[0] >= 0:
            program, mode, i, j = change
            new[program][mode, i, j, m] = ~new[program][mode, i, j, m]
    return new


def _straightened(flow, start, end, length, moved):
    """Let derivatives of parts at whose ends bodies have stopped be what they are across the way.

    The direction of friction turns as fast as a body is slow: what the stages of a step make of
    that, just before a stop, are no digits. With the velocity goes all that it was across the way;
    on the way there the body went aside by it as long as friction, f, had not taken it: h / (1 + p)
    for p = f / (what slows it down). `moved` is changed in place.
    """
    is_halted = _halted(flow, start, end)
    half, motion = flow.n_state // 2, flow.motion
    for group in np.flatnonzero(is_halted.any(axis=(1, 2))).tolist():
        body, m = np.nonzero(is_halted[group])
        points, at, h = start.pick(m), np.arange(len(m)), length[m, None, None]
        way = motion.past(group, points, points.state[1])[body, :, at]
        way = way / np.sqrt(np.square(way).sum(axis=1, keepdims=True))
        along = way[:, :, None] * way[:, None]
        across = np.eye(way.shape[1]) - along
        of_speed = _rows_of(flow, group, body)
        place = of_speed - half
        own, row = m[:, None, None], place[:, :, None]
        slowing = motion.slopes(points)[0][at[:, None, None], row, of_speed[:, None]]
        friction = np.trace(-h * across @ slowing, axis1=1, axis2=2) / (way.shape[1] - 1)
        aside = h / (1 + np.maximum(friction, 0.0)[:, None, None])
        for rows in (of_speed, place):
            moved[m[:, None], rows] = along @ moved[m[:, None], rows]
        moved[own, row, place[:, None]] += across
        moved[own, row, of_speed[:, None]] += aside * across
        if motion.is_carried(group):
            carried = np.moveaxis(motion.medium_slope(group, points), 3, 0)[at, body]
            moved[m[:, None], place, flow.n_state :] += (h - aside) * (across @ carried)


def _jumped(flow, total, index, changes, is_held, points):
    """Let the derivatives of some intervals jump where a condition changes or a body stops."""
    _, before, behind = points
    stops = {}
    for m, change in enumerate(changes):
        if change is None or change[0] == CUT:
            continue
        if change[0] == STOP:
            stops.setdefault(change[1], []).append((m, change[2]))
            continue
        own, one = index[m], np.array([m])
        by_state, by_constant = _jump(flow, before.pick(one), behind.pick(one), change)
        total[own] = by_state @ total[own]
        total[own][:, flow.n_state :] += by_constant
    for group, found in stops.items():
        which, body = np.array(found).T
        parts = [part.pick(which) for part in points]
        _halt(flow, total, index[which], group, body, is_held[which], parts)


def _halt(flow, total, own, group, body, is_held, points):
    """Let derivatives jump where bodies stop, and stay with what they rest on or set out again.

    Points are those before the part of the step that ends there, at its end, and behind the stop.
    """
    rows = _rows_of(flow, group, body)
    moved = total[own[:, None], rows]  # (S, a, n + k)
    at = np.arange(len(own))
    slope = 0.0
    if flow.motion.is_carried(group):
        slope = np.moveaxis(flow.motion.medium_slope(group, points[0]), 3, 0)[at, body]
        moved[..., flow.n_state :] -= slope
    moved[is_held] = 0.0  # it moves on as what it rests on
    free = np.flatnonzero(~is_held)
    if len(free):
        parts = [part.pick(free) for part in points]
        way, by_speed = _set_out(flow, group, body[free], parts)
        along = (way[..., None] * moved[free]).sum(axis=1)
        moved[free] += by_speed[..., None] * along[:, None]
    moved[..., flow.n_state :] += slope
    total[own[:, None], rows] = moved


def _part(flow, scheme, points, length, slopes):
    end, stages, _ = flow.step(scheme, points, length)
    if not slopes:
        return end, None
    moved = flow.step_slopes(scheme, stages, length)
    return end, np.moveaxis(moved, -1, 0) if flow.is_sparse else moved


def chained(total, moved, n):
    """Derivatives of steps one after the other, by the first start and the constants."""
    after = moved[..., :n] @ total
    after[..., n:] += moved[..., n:]
    return after


def _next_changes(flow, scheme, points, h):
    """Lengths until first conditions change, and which do; whole steps and None where none does.

    Changes are (program, mode, receiver, source), (STOP, group of axes, body, 0), or (CUT, 0, 0, 0)
    where the step is too long to tell whether a body stops: the rest is looked at from there.
    """
    part, changes = h.copy(), [None] * len(h)
    open_ = np.arange(len(h))
    if not flow.motion.has_modes:  # no body stops within a step at whose end none has turned
        open_ = np.unique(_flipped(flow, scheme, points, h)[1])
    highs = np.array([*WITHIN, 1.0])
    lows = np.append(0.0, WITHIN)
    at_once = len(highs) if len(open_) <= FEW else 1  # few steps cost as much as one
    for first in range(0, len(highs), at_once):
        if not len(open_):
            break
        looks = slice(first, first + at_once)
        here = points.pick(np.repeat(open_, at_once))
        keys, at = _flipped(flow, scheme, here, np.outer(h[open_], highs[looks]).ravel())
        if keys:
            keys, at, look = _earliest(keys, at, at_once)
            at, look = open_[at], look + first
            instants, is_turn = _instants(
                flow, scheme, points, keys, at, lows[look] * h[at], highs[look] * h[at]
            )
            instants = np.where(is_turn, NEARER * instants, instants)
            seen = set()
            for k in np.argsort(np.abs(instants), kind="stable"):
                if int(at[k]) not in seen:
                    seen.add(int(at[k]))
                    part[at[k]] = instants[k]
                    changes[at[k]] = (CUT, 0, 0, 0) if is_turn[k] else keys[k]
            open_ = np.array([m for m in open_ if changes[m] is None], dtype=int)
    return part, changes


def _earliest(keys, at, n_looks):
    """Of what flips in several looks at each step, that in the first: keys, step, look."""
    step, look = np.divmod(at, n_looks)
    first = np.full(step.max() + 1, n_looks)
    np.minimum.at(first, step, look)
    kept = np.flatnonzero(look == first[step])
    return [keys[k] for k in kept], step[kept], look[kept]


def _flipped(flow, scheme, points, length):
    """Conditions that differ after so much of a step, bodies that turned round: keys, points."""
    end, stages, _ = flow.step(scheme, points, length)
    there = flow.points(end, points.times + length, points.chain, points.modes)
    keys, places = [], []
    margins = flow.motion.margins(there) if flow.motion.has_modes else ()
    for program, margin in enumerate(margins):
        for mode, i, j, m in np.argwhere((margin > 0) != points.modes[program]).tolist():
            keys.append((program, mode, i, j))
            places.append(m)
    for group, body, m in np.argwhere(_turned(flow, stages, end)).tolist():
        keys.append((STOP, group, body, 0))
        places.append(m)
    return keys, np.array(places, dtype=int)


def _instants(flow, scheme, points, keys, at, low, high):
    """Where conditions leave their modes, and bodies their way, between two lengths of steps.

    And whether a body turned round without having stopped.
    """
    picked = points.pick(at)
    stops = np.array([key[0] == STOP for key in keys])
    sign = np.array([
        1.0 if key[0] == STOP or points.modes[key[0]][(*key[1:], m)] else -1.0
        for key, m in zip(keys, at, strict=True)
    ])  # fmt: skip

    programs, places = np.array([key[0] for key in keys]), np.array([key[1:] for key in keys])

    def margin(length, which):
        here = picked.pick(which)
        flow.count(len(which))  # of bodies that stop again and again these are most of all work
        end, stages, _ = flow.step(scheme, here, length)
        out = np.empty(len(which))
        for program in np.unique(programs[which]).tolist():
            mine = np.flatnonzero(programs[which] == program)
            first, *others = places[which[mine]].T
            if program == STOP:
                out[mine] = _headings(flow, stages, end)[first, others[0], mine]
            else:
                there = flow.points(end, here.times + length, here.chain, here.modes)
                out[mine] = flow.motion.margins(there)[program][first, *others, mine]
        return sign[which] * out

    before, instants = roots(margin, low, high, np.where(stops, NEAR, 0.0))
    is_nothing = np.zeros(len(keys), dtype=bool)
    if stops.any():
        which = np.flatnonzero(stops)
        # Before it: behind it the last stages of a step would be pushed on by friction.
        carried = np.array([flow.motion.is_carried(keys[k][1]) for k in which])
        instants[which] = np.where(carried, CARRIED_BEFORE, JUST_BEFORE) * before[which]
        is_nothing[which] = _speeds(flow, scheme, picked, keys, which, instants) > SLOW
    return instants, is_nothing


def _speeds(flow, scheme, points, keys, which, instants):
    """Speeds of bodies that turn round, where they do, in those at the start of their steps.

    0 of those that are nearly as fast as what they rest on, and come to rest on it.
    """
    here = points.pick(which)
    end = flow.step(scheme, here, instants[which])[0]
    groups = {keys[k][1] for k in which}
    sizes = {
        g: [np.abs(flow.motion.past(g, here, v)).max(axis=1) for v in (here.state[1], end[1])]
        for g in groups
    }  # fmt: skip
    media = {g: flow.motion.medium(g, here) for g in groups}
    out = np.empty(len(which))
    for n, k in enumerate(which):
        _, group, body, _ = keys[k]
        at_first, left = (size[body, n] for size in sizes[group])
        is_near = at_first <= ALONG * np.abs(_of_body(media[group], body, n)).max()
        out[n] = 0.0 if is_near else left / at_first
    return out


def _rows_of(flow, group, body):
    """Rows of the derivatives that belong to velocities which stops take, (S, a)."""
    axes = np.array(flow.motion.stops[group])
    return flow.n_state // 2 + body[:, None] * flow.chains.n_dims + axes


def _set_out(flow, group, body, points):
    """Which way bodies came that stop, what one more in their speed changes behind it, (S, a)."""
    start, before, behind = points
    motion, axes = flow.motion, list(flow.motion.stops[group])
    here = body[:, None], axes, np.arange(len(body))[:, None]
    # Just before the stop the body creeps as it came.
    creep = before.state.copy()
    medium = np.broadcast_to(motion.medium(group, start), start.state[1][:, axes].shape)
    medium = medium[body, :, np.arange(len(body))]
    came = start.state[1][here] - medium
    if motion.constraints:
        creep[1] = start.state[1]
        creep = motion.constraints.along(before.at(creep))
        came = creep[1][here] - medium
    way = came / np.sqrt(np.square(came).sum(axis=1, keepdims=True))
    creep[1][here] = medium + CREEP * way
    slowed = motion.acceleration(before.at(creep))[here]
    after = motion.acceleration(behind)[here]
    slowing = (way * slowed).sum(axis=1, keepdims=True)
    is_slowed = slowing != 0
    by_speed = np.where(is_slowed, after - slowed, 0.0) / np.where(is_slowed, slowing, 1.0)
    return way, by_speed


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
