"""The figures of a report: tracks, residuals, constants, errors round by round."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.report.drawing import (
    AFTER,
    BEFORE,
    FLOOR,
    INK,
    axis_label,
    legend_above,
    log_ticks,
    new_figure,
    plain,
    png_bytes,
    scaled,
    spans_decades,
    svg_text,
    tidy,
    time_scaled,
)
from bsp_gp.report.numbers import format_number, format_value, is_number, with_unit
from bsp_gp.report.sentences import adopted_rounds, constant_groups
from bsp_gp.report.tracks import draw_errors, draw_tracks, pick_overlays, wants_errors

__all__ = ["ReportFigure", "build_figures"]

MAX_POINTS = 4000
_MIN_HELD_OUT = 200
_MAX_LABELS = 60
_N_BINS = 24
_MIN_PER_BIN = 8


@dataclass(frozen=True)
class ReportFigure:
    """A figure with its words.

    Attributes
    ----------
    name : str
        File name without its ending.
    caption : str
    figure : matplotlib.figure.Figure
    """

    name: str
    caption: str
    figure: object

    def svg(self):
        """The figure as SVG text."""
        return svg_text(self.figure)

    def png(self):
        """The figure as the bytes of a PNG file."""
        return png_bytes(self.figure)


def build_figures(report):
    """Draw every figure that the report has data for.

    Parameters
    ----------
    report : LoopReport

    Returns
    -------
    dict of str to ReportFigure
        Names among tracks, track_errors, constants, rounds, residuals, in this order.
    """
    made = (_tracks(report), _track_errors(report), _constants(report), _rounds(report),
            _residuals(report))
    return {figure.name: figure for figure in made if figure is not None}


def _units(report):
    """Units of lengths, accelerations and times."""
    before = report.total.get("before")
    length = before.unit if before is not None else ""
    acceleration = before.acceleration_unit if before is not None else ""
    units = report.dataset.get("units")
    time = (units.get("time") if hasattr(units, "get") else None) or "s"
    return length or "", acceleration or "", str(time)


def _tracks_caption(report, picked):
    n_all = len(report.overlays)
    which = f"{len(picked)} of {n_all} held-out tracks" if n_all > len(picked) else "Held-out tracks"
    return f"{which}, one scene after the other" if n_all > len(picked) else which


def _tracks(report):
    picked = pick_overlays(report.overlays)
    if not picked:
        return None
    length, _, time = _units(report)
    has_adopted = bool(adopted_rounds(report))
    n_rows = math.ceil(len(picked) / 3)
    figure = new_figure(
        lambda f: draw_tracks(f, picked, length, time, has_adopted), 0.45 + 2.25 * n_rows
    )
    models = "the declared model (dashed)"
    models += " and the adopted one (solid)" if has_adopted else ""
    caption = (
        f"{_tracks_caption(report, picked)}: observed positions (dots) and rollouts of {models}, "
        "started from the first rows only (filled dots)."
    )
    return ReportFigure("tracks", caption, figure)


def _track_errors(report):
    picked = pick_overlays(report.overlays)
    has_adopted = bool(adopted_rounds(report))
    if not picked or not wants_errors(picked):
        return None
    length, _, time = _units(report)
    n_rows = math.ceil(len(picked) / 3)
    figure = new_figure(
        lambda f: draw_errors(f, picked, length, time, has_adopted), 0.45 + 2.0 * n_rows
    )
    caption = (
        f"{_tracks_caption(report, picked)}: distance between the observed position and each "
        "rollout against time. The shaded rows fixed the initial state and do not count."
    )
    return ReportFigure("track_errors", caption, figure)


def _residuals(report):
    table = report.residuals
    if table is None:
        return None
    before, after = np.asarray(table.before, float), np.asarray(table.after, float)
    held_out = np.array([s == "test" for s in table.split], dtype=bool)
    seen = np.isfinite(before) if before.size else np.zeros(0, bool)
    use_held_out = bool((seen & held_out).sum() >= _MIN_HELD_OUT)
    seen &= held_out if use_held_out else True
    if not seen.any():
        return None
    length, acceleration, time = _units(report)
    against = []
    for name, values, unit in (
        ("time", table.t, time), ("speed", table.speed, f"{length}/{time}" if length else ""),
        ("distance to the nearest body", table.distance, length),
    ):
        values = np.asarray(values, float)
        if np.unique(values[seen & np.isfinite(values)]).size > 1:
            against.append((name, values[seen], unit))
    if not against:
        return None
    has_adopted = bool(adopted_rounds(report))
    series = [("declared model", BEFORE, before[seen])]
    if has_adopted:
        series.append(("adopted law", AFTER, after[seen]))
    figure = new_figure(
        lambda f: _draw_residuals(f, against, series, acceleration), 2.9
    )
    rows = "held-out rows" if use_held_out else "all rows"
    caption = (
        f"Size of the residual acceleration, {rows}"
        + (", before and after" if has_adopted else "")
        + ": running medians, with bands from 10\u00a0% to 90\u00a0%. Where a panel slopes or steps, the "
        "residual depends on that quantity."
    )
    return ReportFigure("residuals", caption, figure)


def _draw_residuals(figure, against, series, unit):
    panels = np.atleast_1d(figure.subplots(1, len(against), sharey=True))
    everything = np.concatenate([values for _, _, values in series])
    factor, shown_unit = scaled(unit, everything)
    is_log = spans_decades(everything)
    handles = []
    for k, (panel, (name, x, x_unit)) in enumerate(zip(panels, against, strict=True)):
        rescale = time_scaled if name == "time" else scaled
        x_factor, x_unit = rescale(x_unit, x)
        x = x * x_factor
        order = np.argsort(x, kind="stable")
        order = order[np.isfinite(x[order])]
        if is_log:
            panel.set_yscale("log")
        if name != "time" and spans_decades(x) and np.nanmin(x) > 0:
            panel.set_xscale("log")
        thinned = order[:: max(1, -(-len(order) // MAX_POINTS))]
        for _, color, y in series:
            y = y * factor
            y = np.where(y > 0, y, np.nan) if is_log else y
            panel.plot(x[thinned], y[thinned], ".", ms=1.6, mew=0, color=color, alpha=0.25,
                       rasterized=True, zorder=1)
            center, low, middle, high = _running_quantiles(x[order], y[order])
            panel.fill_between(center, low, high, color=color, alpha=0.16, lw=0, zorder=2)
            (line,) = panel.plot(center, middle, color=color, lw=1.6, zorder=3)
            if k == 0:
                handles.append(line)
        panel.set_xlabel(axis_label(name, x_unit))
        tidy(panel)
        if is_log:
            log_ticks(panel.yaxis)
    shown = everything[np.isfinite(everything) & ((everything > 0) | (not is_log))] * factor
    if shown.size and shown.max() > 0:
        low, high = np.quantile(shown, [0.01, 0.998])
        panels[0].set_ylim(low / 1.5 if is_log else 0, 1.5 * high if is_log else 1.15 * high)
    panels[0].set_ylabel(axis_label("residual acceleration", shown_unit))
    legend_above(figure, handles, [label for label, _, _ in series])


def _running_quantiles(x, y):
    """Median and 10–90 % of y in bins of equal numbers of x."""
    keep = np.isfinite(y)
    x, y = x[keep], y[keep]
    n_bins = int(np.clip(len(x) // _MIN_PER_BIN, 1, _N_BINS))
    parts = [p for p in np.array_split(np.arange(len(x)), n_bins) if len(p)]
    centers = np.array([np.median(x[p]) for p in parts])
    quantiles = np.array([np.quantile(y[p], [0.1, 0.5, 0.9]) for p in parts]).reshape(-1, 3)
    return centers, *quantiles.T


def _constants(report):
    shared, own = constant_groups([c for c in report.constants if is_number(c.value)])
    shared = [c for c in shared if c.value and is_number(c.low) and is_number(c.high)]
    if not shared and not own:
        return None
    heights = [0.5 + 0.24 * len(shared)] if shared else []
    heights += [0.5 + 0.17 * min(len(group), _MAX_LABELS) for _, _, group in own]
    figure = new_figure(lambda f: _draw_constants(f, shared, own, heights), 0.15 + sum(heights))
    parts = ["the interval relative to the value (at −100\u00a0% it would reach zero)"] if shared else []
    parts += ["one value per entity, sorted by value"] if own else []
    caption = f"Constants with their 90\u00a0% intervals: {'; '.join(parts)}."
    return ReportFigure("constants", caption, figure)


def _draw_constants(figure, shared, own, heights):
    panels = list(figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    if shared:
        panel = panels.pop(0)
        low, high = np.array([sorted((c.low / c.value - 1, c.high / c.value - 1)) for c in shared]).T
        labels = [
            f"{plain(c.name)} = {plain(format_value(c.value, c.low, c.high, c.unit), 60)}"
            for c in shared
        ]
        _draw_intervals(panel, np.zeros(len(shared)), 100 * low, 100 * high, labels)
        panel.set_ylim(len(shared) - 0.4, -0.6)
        panel.axvline(0, lw=0.6, color="#AAAAAA", zorder=0)
        if low.min() < -0.8:
            panel.axvline(-100, lw=0.8, ls=":", color=INK, zorder=0)
        panel.set_xlabel("difference from the value (%)", labelpad=1)
    for panel, (name, unit, group) in zip(panels, own, strict=True):
        values = np.array([c.value for c in group], float)
        low = np.array([c.low if is_number(c.low) else c.value for c in group], float)
        high = np.array([c.high if is_number(c.high) else c.value for c in group], float)
        factor, shown_unit = scaled(unit, values)
        if (low > 0).all() and spans_decades(values, 1.7):
            panel.set_xscale("log")
            factor, shown_unit = 1.0, unit
        labels = [plain(c.entity) for c in group] if len(group) <= _MAX_LABELS else []
        _draw_intervals(panel, values * factor, low * factor, high * factor, labels)
        panel.set_xlabel(axis_label(name, shown_unit), labelpad=1)
        if not labels:
            panel.set_ylabel(f"{len(group)} entities")


def _draw_intervals(panel, values, low, high, labels):
    rows = np.arange(len(values))
    panel.hlines(rows, low, high, color=AFTER, lw=1.6)
    panel.plot(values, rows, "o", ms=3.6, color=AFTER)
    panel.set_ylim(-0.8, len(values) - 0.2)
    panel.margins(x=0.08)
    tidy(panel)
    panel.spines["left"].set_visible(False)
    panel.tick_params(axis="y", length=0)
    panel.set_yticks(rows if labels else [], labels)
    panel.grid(axis="y", lw=0.3, color="#DDDDDD")


def _rounds(report):
    panels = []
    for metric, title in (("rollout_rmse", "Position error of rollouts"),
                          ("residual_acceleration", "Residual acceleration")):
        rows = []
        for r in report.rounds:
            for label, errors, color in (("before", r.before, BEFORE), ("after", r.after, AFTER),
                                         ("noise floor", r.floor, FLOOR)):
                value = getattr(errors, metric) if errors is not None else math.nan
                if is_number(value):
                    unit = errors.unit if metric == "rollout_rmse" else errors.acceleration_unit
                    rows.append((r.number, label, float(value), color, unit))
        if rows:
            panels.append((title, rows))
    if all(len(rows) < 2 for _, rows in panels):
        return None
    height = 0.55 + 0.24 * max(len(rows) + len({r[0] for r in rows}) for _, rows in panels)
    figure = new_figure(lambda f: _draw_rounds(f, panels), max(height, 1.4))
    caption = "Error on held-out data before and after every round, and the floor set by the noise"
    caption += "; logarithmic where dots stand for bars." if any(map(_is_log, panels)) else "."
    return ReportFigure("rounds", caption, figure)


def _is_log(panel):
    values = [row[2] for row in panel[1]]
    return min(values) > 0 and max(values) > 50 * min(values)


def _draw_rounds(figure, panels):
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for panel, (title, rows) in zip(axes, panels, strict=True):
        values = np.array([row[2] for row in rows])
        is_log = _is_log((title, rows))
        start = values.min() / 3 if is_log else 0.0
        if is_log:
            panel.set_xscale("log")
        places, place, number = [], 0.0, rows[0][0]
        for row in rows:
            place += 0.6 if row[0] != number else 0.0
            number = row[0]
            places.append(place)
            place += 1.0
        for where, (_, _, value, color, unit) in zip(places, rows, strict=True):
            if is_log:  # a bar has no natural length here
                panel.hlines(where, start, value, color=color, lw=1.0)
                panel.plot(value, where, "o", ms=5, color=color)
            else:
                panel.barh(where, value, height=0.72, color=color)
            panel.annotate(with_unit(format_number(value), unit), (value, where), (5, 0),
                           textcoords="offset points", va="center", color=INK)
        many = len({row[0] for row in rows}) > 1
        names = [f"round {row[0]}, {row[1]}" if many else row[1] for row in rows]
        tidy(panel)
        panel.set_yticks(places, names)
        panel.set_ylim(max(places[-1], 2) + 0.7, -0.7)
        top = values.max() * ((values.max() / start) ** 0.45 if is_log else 1.45)
        panel.set_xlim(start, top if top > start else 1.0)
        panel.set_title(title, loc="left")
        panel.spines[["left", "bottom"]].set_visible(False)
        panel.tick_params(axis="y", length=0)
        panel.tick_params(axis="x", which="both", length=0, labelbottom=False)
