"""Whether the times of a table can be right: against a declared rate, and against the motion."""

import numpy as np

from bsp_gp.data.scene import CHECK

SAME_RATE = 0.01
"""Part by which a declared step and the steps of the times may differ."""
MOST_FRAMES = 25
"""Frames between two rows, at most: any step is nearly a whole number of much finer ones."""
SIDE = 5
"""Rows before and after a step of time from which it is judged."""
ODD = 0.5
"""Part of the usual step by which a step is odd."""
MOST_JUMPS = 5
"""Odd steps of a track; where there are more, its rows are no regular series."""
NEAR = 2.0
"""Shift and misfit of a motion that goes on, in what nine in ten other places have."""
FAR = 12.0
"""Way at the speed of the body, in the same, that it would have gone."""
SURE = 4.0
"""Standard errors by which a speed is taken smaller than it looks."""
SAME_CLOCK = 0.1
"""Part of the usual step by which what goes up with a clock may be off it."""
_S = np.arange(2 * SIDE) - SIDE + 0.5
_DESIGN = np.stack([_S**0, _S, _S**2, (_S > 0) - 0.5, _S**3], axis=1)
_FIT = np.linalg.pinv(_DESIGN)
_SLOPE = np.linalg.pinv(_DESIGN[:SIDE, :2])[1]


def slope_on_clock(times, values):
    """What a column goes up in a unit of a clock, where it does so from row to row; else 0.0."""
    steps, rises = np.diff(times), np.diff(values)
    is_known = len(steps) >= SIDE and np.isfinite(steps).all() and np.isfinite(rises).all()
    if not is_known or (steps <= 0).any() or (rises <= 0).any():
        return 0.0
    slope = float((values[-1] - values[0]) / (times[-1] - times[0]))
    off = np.abs(values - values[0] - slope * (times - times[0]))
    return slope if off.max() < SAME_CLOCK * np.median(rises) else 0.0


def check_declared_rate(rows, declaration, second):
    """Compare the column t with a declared ``dt`` or ``fps``; notes, a tuple of str.

    The column counts in any case. Rows that are whole numbers of steps apart are gaps, or every
    k-th frame of a recording; where they are so throughout it is noted. Times increase for every
    entity of a scene; `second` is the unit of the column t, s.

    Raises
    ------
    DataError
        Where the times of a scene contradict the declaration.
    """
    if declaration.fps is None and declaration.dt is None:
        return ()
    step = 1 / declaration.fps if declaration.dt is None else declaration.dt * second
    name = "dt" if declaration.fps is None else "fps"
    value = f"{name} = {getattr(declaration, name):g}"
    usual = {}
    _, later, steps = rows.steps
    for scene in np.unique(rows.scene[later]).tolist():
        gaps = steps[rows.scene[later] == scene]
        counts = np.maximum(np.round(gaps / step), 1)
        # Digits that were rounded leave the mean right, some rows at odd times the median.
        means = gaps.sum() / counts.sum(), np.median(gaps / counts)
        is_same = min(abs(mean / step - 1) for mean in means) <= SAME_RATE
        usual[scene] = int(np.median(counts))
        if not is_same or usual[scene] > MOST_FRAMES:
            where = int(np.flatnonzero(rows.scene == scene)[0])
            rows.fail(
                f"the times of scene {rows.scene_names[scene]!r} are {np.median(gaps) / second:.4g}"
                f" apart, which contradicts {value} ({step / second:.4g} a frame)", where, "t",
                f"leave out {name} if column t is right; if it is not, give a column frame in its "
                "place; or mend the unit of time",
            )  # fmt: skip
    most = max(usual.values(), default=1)
    if most < 2:
        return ()
    return (
        f"{CHECK}rows are up to {most} frames of {value} apart: the times are those of column t; "
        f"if the recording has every frame, {name} contradicts them",
    )


def clock_jumps(rows, scenes, second):
    """Notes of times that jump while the bodies go on as if they had not.

    At a gap a body is somewhere else: it went on while nobody looked. Where its positions go on,
    within what is usual along its track, as if one step had passed, and at its speed it would have
    left by far, the clock jumped and not the body. Bodies at rest say nothing; one that was
    somewhere else after all is enough for a gap. `rows` are those that the scenes were made of;
    `second` is the unit of the column t, s.
    """
    notes = []
    for code, scene in enumerate(scenes):
        verdicts = {}
        for k in scene.dynamic:
            for ends, extra, verdict in _track_jumps(scene.times, scene.positions[:, k]):
                verdicts.setdefault(ends, [extra]).append(verdict)
        for (before, after), (extra, *found) in verdicts.items():
            if min(found) < 0 or max(found) < 1:
                continue
            line = int(rows.lines[(rows.scene == code) & (rows.times == after)][0])
            notes.append(
                f"{CHECK}the clock of scene {scene.name!r} seems to jump by {extra / second:.4g}: "
                f"from t = {before / second:.9g} to {after / second:.9g} (line {line}) the "
                "positions go on as if one step had passed; a law that is fitted across the jump "
                "is wrong, so mend the times or make two scenes of it"
            )
    return tuple(notes)


def _track_jumps(times, positions):
    """Odd steps of a track, as ((before, after), what is too much, verdict).

    The verdict is 1 where the positions go on as if there were none, -1 where they do not, 0 where
    that cannot be told.
    """
    seen = np.isfinite(positions).all(axis=1)
    t, x = times[seen], positions[seen]
    gaps = np.diff(t)
    if len(gaps) < 4 * SIDE - 2:
        return
    usual = np.median(gaps)
    odd = np.abs(gaps / usual - 1) > ODD
    if not 0 < odd.sum() <= MOST_JUMPS:
        return
    # Windows of SIDE rows on either side of a step, all other steps of which are the usual one.
    windows = np.lib.stride_tricks.sliding_window_view(odd, 2 * SIDE - 1)
    others = windows.sum(axis=1) - windows[:, SIDE - 1]
    shifts, misfits, speeds = _across(x)
    plain = (others == 0) & ~windows[:, SIDE - 1]
    if plain.sum() < SIDE:
        return
    floor = 1e-9 * np.abs(x).max()
    shift, misfit = (max(np.quantile(v[plain], 0.9), floor) for v in (shifts, misfits))
    for w in np.flatnonzero((others == 0) & windows[:, SIDE - 1]):
        k = w + SIDE - 1
        extra = gaps[k] - usual
        speed = max(speeds[w] - SURE * max(misfits[w], misfit) * np.linalg.norm(_SLOPE), 0.0)
        goes_on = shifts[w] <= NEAR * shift and misfits[w] <= NEAR * misfit
        is_far = shifts[w] > FAR * shift or misfits[w] > FAR * misfit
        verdict = -1 if is_far else int(goes_on and speed * abs(extra) > FAR * shift * usual)
        yield (float(t[k]), float(t[k + 1])), float(extra), verdict


def _across(x):
    """Of every window of 2 SIDE rows: shift at its middle, misfit, speed per step; lengths.

    A cubic and a shift of the second half are fitted to rows one step apart.
    """
    windows = np.lib.stride_tricks.sliding_window_view(x, 2 * SIDE, axis=0)
    fit = windows @ _FIT.T
    left = windows - fit @ _DESIGN.T
    n_left = _DESIGN.shape[0] - _DESIGN.shape[1]
    before, after = windows[..., :SIDE] @ _SLOPE, windows[..., SIDE:] @ _SLOPE
    speed = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    return (
        np.linalg.norm(fit[..., 3], axis=1),
        np.sqrt(np.square(left).sum(axis=(1, 2)) / n_left),
        np.where((before * after).sum(axis=1) > 0, speed, 0.0),
    )
