"""SPRING in closed form: period, damping and stiffness of each clip, and what they do not tell."""

import numpy as np
import pandas as pd
from phys101_clips import FPS
from scipy.optimize import least_squares

SEEN = {0.1103: 14.1, 0.2308: 19.3}
"""Periods counted in the videos by eye, frames, by the mass of the block (kg)."""


def oscillation(t, y, damped):
    """y = c + A exp(-b t) cos(w t + phase): least squares.

    Returns
    -------
    parameters : ndarray
        c, the two amplitudes, w, b.
    se : ndarray
        Standard errors of the first four; neighbouring errors taken as independent.
    """
    power = np.abs(np.fft.rfft(y - y.mean(), 4096))
    w0 = 2 * np.pi * (np.argmax(power[4:]) + 4) / 4096 / (t[1] - t[0])
    start = [y.mean(), np.ptp(y) / 2, 0.0, w0, 0.0]

    def residuals(p):
        return oscillation_values(t, p, damped) - y

    fits = [
        least_squares(residuals, [start[0], a, b, *start[3:]])
        for a, b in ((start[1], 0), (0, start[1]), (-start[1], 0), (0, -start[1]))
    ]
    best = min(fits, key=lambda f: f.cost)
    covariance = np.linalg.pinv(best.jac.T @ best.jac)[:4, :4] * 2 * best.cost / (len(y) - 5)
    return best.x, np.sqrt(np.maximum(np.diag(covariance), 0))


def oscillation_values(t, p, damped):
    decay = np.exp(-p[4] * t) if damped else 1.0
    return p[0] + decay * (p[1] * np.cos(p[3] * t) + p[2] * np.sin(p[3] * t))


def spring_track(clip):
    """Seconds since the release, and rows of the block (px), where it is known."""
    rows = (clip.frames >= clip.window[0]) & np.isfinite(clip.px[:, 1])
    return (clip.frames[rows] - clip.window[0]) / FPS, clip.px[rows, 1]


def clock_jitter(t, y, p):
    """Error of the clock that the scatter about the fit allows, frames (nan if none shows).

    A frame taken late moves a fast block more than a slow one: the squared error of a row is
    fitted as (error of the tracker)² + (error of the clock times speed)².
    """
    fitted = oscillation_values(t, p, True)
    speed = np.gradient(fitted)
    design = np.stack([np.ones(len(t)), speed**2], axis=1)
    (_, square), *_ = np.linalg.lstsq(design, (y - fitted) ** 2, rcond=None)
    return float(np.sqrt(square)) if square > 0 else float("nan")


def spring_facts(clip, n_fit=70):
    """Period, stiffness (SI) and damping before/after on later frames, by closed-form motion."""
    t, y = spring_track(clip)
    fit, late = slice(0, n_fit), slice(n_fit, None)
    out = {}
    for damped in (False, True):
        p, se = oscillation(t[fit], y[fit], damped)
        left = y - oscillation_values(t, p, damped)
        out[damped] = (p, se, np.sqrt(np.mean(left[fit] ** 2)), np.sqrt(np.mean(left[late] ** 2)))
    p, se, *_ = out[True]
    w = abs(p[3])
    whole = abs(oscillation(t, y, True)[0][3])
    period = 2 * np.pi / w * FPS
    seen = next(v for mass, v in SEEN.items() if abs(mass - clip.mass) < 1e-4)
    return {
        "clip": clip.name, "mass_kg": clip.mass, "period_frames": period,
        "period_se": 2 * np.pi / w**2 * FPS * se[3], "period_seen": seen,
        "period_off": period / seen - 1, "period_whole_clip": 2 * np.pi / whole * FPS,
        "decay_per_s": p[4], "k_N_per_m": clip.mass * w**2,
        "amplitude_px": float(np.hypot(p[1], p[2])), "rest_row_px": p[0],
        "clock_jitter_frames": clock_jitter(t[fit], y[fit], p),
        "before_px": out[False][3], "after_px": out[True][3],
        "fit_before_px": out[False][2], "fit_after_px": out[True][2],
    }  # fmt: skip


def stiffness(springs):
    """k from mass and period, with one added mass (hook, bag, part of the spring) for all clips.

    ``(m + d) w² = k`` for the two masses gives d and k; their errors from the scatter between the
    two clips of a mass.

    Returns
    -------
    dict
        added_kg, added_se, k, k_se, per_clip (k of each clip with the added mass), alone (largest
        over smallest k of the block's mass alone, minus one), pairs (the same within a mass).
    """
    frame = pd.DataFrame(springs)
    w2 = ((2 * np.pi * FPS / frame.period_frames) ** 2).to_numpy()
    mass = frame.mass_kg.to_numpy()
    light = mass < 0.2
    m1, m2 = mass[light].mean(), mass[~light].mean()

    def solve(a, b):
        added = (m2 * b - m1 * a) / (a - b)
        return np.array([added, (m1 + added) * a])

    a, b = w2[light].mean(), w2[~light].mean()
    centre = solve(a, b)
    spread = [np.ptp(w2[s]) / 2 for s in (light, ~light)]  # standard error of a mean of two
    errors = np.hypot(solve(a + spread[0], b) - centre, solve(a, b + spread[1]) - centre)
    alone = mass * w2
    return {
        "added_kg": float(centre[0]), "added_se": float(errors[0]), "k": float(centre[1]),
        "k_se": float(errors[1]), "per_clip": (mass + centre[0]) * w2,
        "alone": float(alone.max() / alone.min() - 1),
        "pairs": max(float(alone[s].max() / alone[s].min() - 1) for s in (light, ~light)),
    }  # fmt: skip


def spring_lines(springs):
    """What the summary says."""
    found = stiffness(springs)
    lines = []
    for r, k in zip(springs, found["per_clip"], strict=True):
        lines.append(
            f"- {r['clip']}: period {r['period_frames']:.2f} +- {r['period_se']:.2f} frames "
            f"({100 * r['period_off']:+.1f} % of the {r['period_seen']} seen by eye; over the "
            f"whole clip {r['period_whole_clip']:.2f}), k = {r['k_N_per_m']:.1f} N/m with the "
            f"block's mass alone, {k:.1f} with {1000 * found['added_kg']:.0f} g more; decay "
            f"{r['decay_per_s']:.3f} /s; later frames {r['before_px']:.1f} -> {r['after_px']:.1f} "
            f"px, fitted frames {r['fit_before_px']:.2f} -> {r['fit_after_px']:.2f} px"
        )
    jitter = np.array([r["clock_jitter_frames"] for r in springs])
    lines += [
        f"- stiffness: with the blocks' masses alone the clips differ by {100 * found['alone']:.0f}"
        f" %, within one mass by {100 * found['pairs']:.1f} % at most. With "
        f"{1000 * found['added_kg']:.0f} +- {1000 * found['added_se']:.1f} g that move along "
        f"(hook, bag, a third of the spring) k is {found['k']:.1f} +- {found['k_se']:.1f} N/m for "
        "both masses. That is one number more for one difference: two masses cannot tell it from a "
        "spring that is stiffer when it is stretched further, nor a hook from the spring's own "
        "mass; a third mass, or the hook on the scales, would",
        f"- clock: scatter that grows with speed allows {np.nanmax(jitter):.2f} frames at most "
        f"(none shows in {np.isnan(jitter).sum()} of {len(jitter)} clips): no frame is dropped",
    ]  # fmt: skip
    return lines
