"""FALL in pixels and frames: the pull of each clip, what limits it, and whether the four agree.

Three things move the answer by more than 3 %: the fingers, which belong to the outline until they
are clear of the block; the few frames between there and the table; and perspective, since a
camera that looks down on a table sees a falling block recede. The last is modelled: a block that
falls straight moves along the picture of a vertical line, y = y0 + s L / (L + s), where s is the
fall (px at row y0) and L the distance from y0 to the vanishing point of verticals.
"""

import numpy as np
from phys101_clips import FPS
from scipy import stats
from scipy.optimize import least_squares

G = 9.81
FREE = {
    "w_block_05-table-01": (10, 12),
    "w_block_05-table-02": (9, 11),
    "w_block_05-table-03": (9, 11),
    "w_block_05-table-04": (7, 10),
}
"""Frames of the full video without a finger in the outline and without a touch of the table (the
block is seen to bounce between the last of them and the next)."""
RELEASE = {
    "w_block_05-table-01": (9, 12),
    "w_block_05-table-02": (8, 11),
    "w_block_05-table-03": (8, 11),
    "w_block_05-table-04": (6, 10),
}
"""One frame more: fingers are at the block or let go of it."""
FOCAL = 960 / np.tan(np.radians(84.1 / 2))
"""px: half the width of the picture over the tangent of half the Kinect's angle of view."""
MIDDLE, ROW = 540.0, 450.0  # px: the optical axis, and the row in whose scale g is given
TARGET = 0.03


def picture_row(s, pitch):
    """Row of a point that has fallen by `s` (px at `ROW`) from there, camera down by `pitch`."""
    if pitch == 0:
        return ROW + s
    length = MIDDLE + FOCAL / np.tan(pitch) - ROW
    return ROW + s * length / (length + s)


def flights(clips, windows):
    """Times (frames, about their mean) and rows of every clip in its window."""
    out = []
    for clip in clips:
        first, last = windows[clip.name]
        rows = (clip.frames >= first) & (clip.frames <= last) & np.isfinite(clip.px[:, 1])
        out.append((clip.frames[rows] - clip.frames[rows].mean(), clip.px[rows, 1]))
    return out


def fit_falls(data, pitch=0.0, *, shared=False, free_pitch=False):
    """Least squares of ``s = a + b t + g t² / 2`` in every clip, errors of the rows all alike.

    Parameters
    ----------
    data : list of (t, y)
    pitch : float
        Radians below the horizontal; the start value with `free_pitch`.
    shared : bool
        One g for all clips.

    Returns
    -------
    g, se : ndarray
        px/frame² at `ROW`, and the standard errors for errors of 1 px in each row.
    pitch, pitch_se : float
        Radians; the error is nan for a given pitch.
    left : float
        Sum of squares, px².
    dof : int
    """
    n = len(data)
    n_g = 1 if shared else n

    def residuals(p):
        g = np.broadcast_to(p[2 * n : 2 * n + n_g], n)
        angle = p[-1] if free_pitch else pitch
        return np.concatenate([
            picture_row(p[2 * k] + p[2 * k + 1] * t + 0.5 * g[k] * t**2, angle) - y
            for k, (t, y) in enumerate(data)
        ])  # fmt: skip

    start = [x for _, y in data for x in (y.mean() - ROW, y[-1] - y[-2])] + [15.0] * n_g
    start += [pitch] if free_pitch else []
    fit = least_squares(residuals, start, x_scale="jac")
    se = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)))
    there = slice(2 * n, 2 * n + n_g)
    angle, angle_se = (fit.x[-1], se[-1]) if free_pitch else (pitch, np.nan)
    dof = len(fit.fun) - len(fit.x)
    return fit.x[there], se[there], float(angle), float(angle_se), float(2 * fit.cost), dof


def unit_error(n):
    """Standard error of the second derivative from `n` rows one frame apart with errors of 1 px.

    The Cramér-Rao bound for Gaussian errors: sqrt(720 / (n (n² - 1) (n² - 4))).
    """
    return float(np.sqrt(720.0 / (n * (n**2 - 1) * (n**2 - 4))))


def agreement(g, se):
    """Weighted mean, chi-squared about it, and its p-value."""
    weights = np.asarray(se) ** -2.0
    mean = float(np.sum(weights * g) / weights.sum())
    chi2 = float(np.sum(weights * (g - mean) ** 2))
    return mean, chi2, float(stats.chi2.sf(chi2, len(g) - 1))


def fall_facts(clips):
    """Rows for ``falls.csv`` (clip, window, pitch, g) and what the summary says of all four.

    The error of a row is taken from the scatter about *one* g for all clips, and never less than
    the tracker states; whether the clips agree is tested with the tracker's own errors alone.
    """
    rows = []
    stated = np.sqrt(np.mean([
        np.nanmean(c.cov[np.isin(c.frames, range(a, b + 1)), 1, 1])
        for c in clips for a, b in (FREE[c.name],)
    ]))  # fmt: skip
    data = {"free": flights(clips, FREE), "release": flights(clips, RELEASE)}
    g1, g1_se, pitch, pitch_se, left, dof = fit_falls(
        data["release"], np.radians(15), shared=True, free_pitch=True
    )
    sigma = max(float(stated), np.sqrt(left / dof))
    tests = []
    for window, angle in (("free", 0.0), ("release", 0.0), ("free", pitch), ("release", pitch)):
        g, unit, *_ = fit_falls(data[window], angle)
        mean, chi2, p = agreement(g, stated * unit)
        tests.append({"window": window, "pitch_deg": np.degrees(angle), "mean": mean,
                      "se": sigma * np.sum(unit**-2.0) ** -0.5, "spread": np.ptp(g) / mean,
                      "chi2": chi2, "p": p})  # fmt: skip
        rows += [
            {"clip": c.name, "window": window, "frames": len(t), "pitch_deg": np.degrees(angle),
             "g_px_per_frame2": value, "se": sigma * u, "floor_se": 0.4 * u,
             "sigma_for_3_percent": TARGET * value / u}
            for c, (t, _), value, u in zip(clips, data[window], g, unit, strict=True)
        ]  # fmt: skip
    return {
        "rows": rows, "tests": tests, "stated": float(stated), "sigma": sigma, "dof": dof,
        "g": float(g1[0]), "g_se": float(sigma * g1_se[0]),
        "pitch_deg": np.degrees(pitch), "pitch_se_deg": np.degrees(pitch_se * sigma),
        "px_per_m": float(g1[0] * FPS**2 / G), "px_per_m_se": float(sigma * g1_se[0] * FPS**2 / G),
    }  # fmt: skip


def fall_lines(facts):
    """What the summary says."""
    lines = ["| clip | free frames | g, px/frame² | error needed for 3 %, px | with the frame of "
             "release | free, perspective | release, perspective |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    per_fit = [facts["rows"][k : k + 4] for k in range(0, 16, 4)]
    for free, release, free_tilted, release_tilted in zip(*per_fit, strict=True):
        lines.append(f"| {free['clip']} | {free['frames']} | " + " | ".join(
            [_pm(free), f"{free['sigma_for_3_percent']:.2f}",
             *map(_pm, (release, free_tilted, release_tilted))]) + " |")  # fmt: skip
    lines += ["", f"Errors are for {facts['sigma']:.1f} px a row: the scatter about one g and one "
              f"pitch of the camera for all clips ({facts['dof']} degrees of freedom); the tracker "
              f"states {facts['stated']:.1f} px.", ""]  # fmt: skip
    for test in facts["tests"]:
        lines.append(
            f"- {test['window']} frames, pitch {test['pitch_deg']:.0f}°: mean {test['mean']:.1f} "
            f"+- {test['se']:.1f} px/frame², largest difference {100 * test['spread']:.0f} %, "
            f"chi-squared with the tracker's stated errors {test['chi2']:.1f} on 3 "
            f"(p = {test['p']:.2g})"
        )
    bounds = ", ".join(f"{n}: {unit_error(n):.2f}" for n in (3, 4, 5, 6, 8))
    needed = next(n for n in range(3, 60) if facts["sigma"] * unit_error(n) < TARGET * facts["g"])
    lines += [
        f"- measurement floor (Cramér-Rao, px/frame² for errors of 1 px, by frames): {bounds}; "
        f"with 0.4 px, the tracker's target on blurred renders, 3 frames give "
        f"{100 * 0.4 * unit_error(3) / facts['g']:.0f} % and 4 give "
        f"{100 * 0.4 * unit_error(4) / facts['g']:.0f} %; 3 % with the errors found here takes "
        f"{needed} free frames a clip, and the clips have 3 or 4",
        f"- all four together (frames of release included): g {facts['g']:.1f} +- "
        f"{facts['g_se']:.1f} px/frame² at row {ROW:.0f}, camera pitched down by "
        f"{facts['pitch_deg']:.0f} +- {facts['pitch_se_deg']:.0f}°; with g = 9.81 m/s² the scale "
        f"is {facts['px_per_m']:.0f} +- {facts['px_per_m_se']:.0f} px/m",
    ]  # fmt: skip
    return lines


def _pm(row):
    return f"{row['g_px_per_frame2']:.1f} +- {row['se']:.1f}"
