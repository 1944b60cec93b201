"""Held-out tracks drawn over each other: what was observed and what the models say."""

import math

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bsp_gp.report.drawing import (
    AFTER,
    BEFORE,
    axis_label,
    legend_above,
    log_ticks,
    panels_of,
    plain,
    scaled,
    tidy,
    time_scaled,
)
from bsp_gp.units import is_speed

MAX_PANELS = 9
_MODELS = (
    ("declared model", BEFORE, (0, (4, 2)), "before"), ("adopted law", AFTER, "-", "after"),
)  # fmt: skip
"""Label, colour and style of the line of each model, and the name by which a page hides it."""
_FLAT = 0.05  # an axis with less of the motion than this is not drawn
_ALIKE = 0.03  # models closer than this part of the picture look the same
_MAX_DOTS = 150
_BOX = 0.85  # height of a path's panel over its width
_LOG_FACTOR = 30.0


def pick_overlays(overlays, max_panels=MAX_PANELS):
    """Choose the tracks to show without looking at how well they went: scene after scene.

    Those of which nothing was observed are left out.
    """
    scenes = {}
    for overlay in overlays:
        if _observed(overlay).any():
            scenes.setdefault(overlay.scene, []).append(overlay)
    picked = []
    for turn in range(max((len(s) for s in scenes.values()), default=0)):
        picked += [s[turn] for s in scenes.values() if turn < len(s)]
    chosen = {id(o) for o in picked[:max_panels]}
    return [o for o in overlays if id(o) in chosen]


def pick_headline(overlays):
    """The track on which the declared model errs most; None without one."""
    known = [o for o in overlays if _observed(o).any() and math.isfinite(_median(_errors(o)[0]))]
    return max(known, key=lambda o: _median(_errors(o)[0]), default=None)


def _observed(overlay):
    return np.isfinite(np.asarray(overlay.observed, float)).all(axis=-1)


def _arrays(overlay):
    return [np.asarray(a, float) for a in (overlay.observed, overlay.declared, overlay.adopted)]


def _extents(overlay):
    observed = np.asarray(overlay.observed, float)[_observed(overlay)]
    return np.ptp(observed, axis=0)


def drawn_axes(overlay):
    """The one or two axes along which the motion is."""
    extents = _extents(overlay)
    main = int(np.argmax(extents))
    others = [k for k in range(len(extents)) if k != main]
    if not others:
        return (main,)
    second = max(others, key=lambda k: (extents[k], -k))
    if extents[second] <= _FLAT * extents[main]:
        return (main,)
    return tuple(sorted((main, second)))


def _errors(overlay):
    """Distance of the declared and the adopted rollout from what was observed."""
    observed, declared, adopted = _arrays(overlay)
    return [np.linalg.norm(model - observed, axis=-1) for model in (declared, adopted)]


def _median(values):
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def wants_errors(overlays):
    """Whether the tracks alone do not show the models apart: 3-D, or too close to each other."""
    alike = []
    for overlay in overlays:
        observed, *_ = _arrays(overlay)
        if observed.shape[-1] == 3:
            return True
        errors = _errors(overlay)[0] if len(drawn_axes(overlay)) == 1 else _off_path(overlay)
        largest = np.max(errors, initial=0.0, where=np.isfinite(errors))
        alike.append(largest < _ALIKE * max(_extents(overlay)))
    return 2 * sum(alike) > len(alike)


def _off_path(overlay):
    """How far the declared rollout lies beside the path that was observed, whenever it is there."""
    axes = list(drawn_axes(overlay))
    observed = np.asarray(overlay.observed, float)[_observed(overlay)][:, axes]
    declared = np.asarray(overlay.declared, float)[:, axes]
    declared = declared[np.isfinite(declared).all(axis=1)]  # one that ran away lies nowhere
    path = observed[:: -(-len(observed) // (10 * _MAX_DOTS))]
    path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    points = declared[:: max(-(-len(declared) // _MAX_DOTS), 1), None]
    start, step = path[:-1], np.diff(path, axis=0)
    length = np.maximum(np.square(step).sum(axis=-1), np.finfo(float).tiny)
    along = np.clip(((points - start) * step).sum(axis=-1) / length, 0, 1)
    return np.linalg.norm(points - start - along[..., None] * step, axis=-1).min(axis=1)


def _title(overlay):
    scene, entity = plain(overlay.scene, 20), plain(overlay.entity, 20)
    return f"{scene}: {entity}" if scene and scene != entity else entity


def draw_tracks(figure, overlays, length_unit, time_unit, has_adopted):
    """Draw paths, or one coordinate against time where the motion is along one axis."""
    panels = panels_of(figure, len(overlays))
    models = _MODELS[: 1 + has_adopted]
    for panel, overlay in zip(panels, overlays, strict=True):
        axes = drawn_axes(overlay)
        observed, declared, adopted = _arrays(overlay)
        shown = observed[:, axes]
        factor, unit = scaled(length_unit, shown)
        times = np.asarray(overlay.times, float)
        t_factor, t_unit = time_scaled(time_unit, times)

        def coordinates(values, axes=axes, times=times, factor=factor, t_factor=t_factor):
            if len(axes) == 1:
                return times * t_factor, values[:, axes[0]] * factor
            return values[:, axes[0]] * factor, values[:, axes[1]] * factor

        start = np.arange(len(times)) < overlay.n_initial
        step = max(1, -(-len(times) // _MAX_DOTS))
        x, y = coordinates(observed)
        panel.plot(x[::step], y[::step], "o", ms=2.8, mew=0.6, mec="#555555", mfc="white", zorder=1)
        panel.plot(x[start], y[start], "o", ms=3.0, mew=0, color="#222222", zorder=2)
        curves = []
        for (_, color, style, gid), values in zip(models, (declared, adopted), strict=False):
            curves.append(coordinates(values))
            panel.plot(*curves[-1], color=color, ls=style, lw=1.3, zorder=3, gid=gid)
        _set_limits(panel, (x, y), curves, len(axes) == 2)
        names = ["velocity"] if is_speed(length_unit) else ["xyz"[k] for k in axes]
        panel.set_title(_title(overlay), loc="left")
        across = (names[0], unit) if len(axes) == 2 else ("time", t_unit)
        panel.set_xlabel(axis_label(*across))
        panel.set_ylabel(axis_label(names[-1], unit))
        tidy(panel, 4)
    handles = [Line2D([], [], ls="", marker="o", ms=4, mew=0.8, mec="#555555", mfc="white")]
    lines, labels = _legend_of(models)
    legend_above(figure, handles + lines, ["observed", *labels])


def _legend_of(models):
    """Lines and labels of models."""
    lines = [Line2D([], [], color=color, ls=style, lw=1.4) for _, color, style, _ in models]
    return lines, [label for label, *_ in models]


def _set_limits(panel, observed, curves, is_path):
    """Frame what was observed; a rollout that runs away may leave the frame."""
    frame = []
    spans = [np.ptp(a[np.isfinite(a)]) for a in observed]
    widest = max(spans) if is_path else 0.0
    for k, values in enumerate(observed):
        finite = values[np.isfinite(values)]
        low, high = float(finite.min()), float(finite.max())
        span = max(spans[k], 0.2 * widest) or abs(high) * 1e-3 or 1.0
        room = (low - 0.6 * span, high + 0.6 * span)
        for curve in curves:
            inside = curve[k][np.isfinite(curve[k])]
            if inside.size:
                low = max(min(low, inside.min()), room[0])
                high = min(max(high, inside.max()), room[1])
        frame.append((low - 0.06 * span, high + 0.06 * span))
    if is_path:  # the same scale along both axes
        side = max(frame[0][1] - frame[0][0], (frame[1][1] - frame[1][0]) / _BOX)
        halves = (side / 2, side * _BOX / 2)
        middles = [(low + high) / 2 for low, high in frame]
        frame = [(m - half, m + half) for m, half in zip(middles, halves, strict=True)]
        panel.set_box_aspect(_BOX)
    panel.set_xlim(*frame[0])
    panel.set_ylim(*frame[1])


def draw_errors(figure, overlays, length_unit, time_unit, has_adopted):
    """Draw the distance between observation and rollouts against time."""
    panels, models = panels_of(figure, len(overlays)), _MODELS[: 1 + has_adopted]
    for panel, overlay in zip(panels, overlays, strict=True):
        times = np.asarray(overlay.times, float)
        errors = _errors(overlay)[: len(models)]
        factor, unit = scaled(length_unit, *errors)
        t_factor, t_unit = time_scaled(time_unit, times)
        medians = [_median(e) for e in errors]
        is_log = has_adopted and max(medians) > _LOG_FACTOR * min(medians) > 0
        if is_log:
            panel.set_yscale("log")
        for error, (_, color, style, gid) in zip(errors, models, strict=True):
            shown = np.where(error > 0, error, np.nan) if is_log else error
            panel.plot(times * t_factor, shown * factor, color=color, ls=style, lw=1.2, gid=gid)
        if 0 < overlay.n_initial <= len(times):
            panel.axvspan(
                times[0] * t_factor,
                times[overlay.n_initial - 1] * t_factor,
                color="#E8E8E8",
                lw=0,
                zorder=0,
            )
        panel.set_title(_title(overlay), loc="left")
        panel.set_xlabel(axis_label("time", t_unit))
        panel.set_ylabel(axis_label("position error", unit))
        panel.margins(x=0.02)
        tidy(panel, 4)
        if is_log:
            log_ticks(panel.yaxis)
        else:
            panel.set_ylim(bottom=0)
    lines, labels = _legend_of(models)
    start = Patch(color="#E8E8E8")
    legend_above(figure, [*lines, start], [*labels, "rows that fixed the start"])
