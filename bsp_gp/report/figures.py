"""The figures of a report: tracks, residuals, constants, errors round by round."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.loop.told import Told
from bsp_gp.report.bars import constants_figure, rounds_figure
from bsp_gp.report.drawing import (
    AFTER,
    BEFORE,
    WIDTH,
    axis_label,
    legend_above,
    log_ticks,
    new_figure,
    png_bytes,
    scaled,
    spans_decades,
    svg_text,
    tidy,
    time_scaled,
)
from bsp_gp.report.hidden_map import draw_hidden_map
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import adopted_rounds
from bsp_gp.report.traces import trace_figure
from bsp_gp.report.tracks import (
    draw_errors,
    draw_tracks,
    pick_headline,
    pick_overlays,
    wants_errors,
)

MAX_POINTS = 4000
_NARROW = 4.8
"""Inches: letters stay readable on a telephone."""
_MIN_HELD_OUT = 200
_N_BINS = 24
_MIN_PER_BIN = 8


@dataclass(frozen=True)
class ReportFigure:
    """A figure with its words; its name is that of a file without the ending."""

    name: str
    caption: str
    figure: object

    @functools.cached_property
    def svg(self):
        return svg_text(self.figure)

    @functools.cached_property
    def png(self):
        """The figure as the bytes of a PNG file."""
        return png_bytes(self.figure)


def build_figures(report):
    """Draw every figure that the report has data for.

    Returns
    -------
    dict of str to ReportFigure
        Names among headline, tracks, track_errors, constants, rounds, residuals and trace_1,
        trace_2, … for the rounds whose residual was traced, hidden_1, … for those that tell of an
        unseen body, in this order.
    """
    report = page_of(report)
    makers = {
        "headline": _headline, "tracks": _tracks, "track_errors": _track_errors,
        "constants": constants_figure, "rounds": rounds_figure, "residuals": _residuals,
    }  # fmt: skip
    made = {name: make(report) for name, make in makers.items()}
    made |= {f"trace_{r.number}": trace_figure(r) for r in report.rounds}
    made |= {f"hidden_{r.number}": _hidden(r) for r in report.rounds}
    return {name: ReportFigure(name, *parts) for name, parts in made.items() if parts is not None}


def _hidden(done):
    """Where the unseen body of a round must be."""
    if done.effect is None or not done.effect.details.get("draws"):
        return None
    caption = (
        "Where the unseen body must be: regions that hold half and nine tenths of the posterior "
        "draws, among the tracks of the bodies that are seen; beside it, how strong it is."
    )
    return caption, draw_hidden_map(done.effect.details)


def units_of(report):
    """Units of lengths, accelerations and times."""
    before = report.total.get("before")
    length = before.unit if before is not None else ""
    acceleration = before.acceleration_unit if before is not None else ""
    told = Told(report.dataset.get("units") or {}, report.dataset.get("symbols") or {})
    time = told.own["s"][1] if "s" in told.own else "s"
    return length or "", acceleration or "", time


def _tracks_caption(report, picked):
    n_all = len(report.overlays)
    if n_all > len(picked):
        return f"{len(picked)} of {n_all} held-out tracks, one scene after the other"
    return "Held-out tracks"


def _drawn(draw, report, overlays, height, width=WIDTH):
    """Tracks, or their errors, in the units of a report."""
    length, _, time = units_of(report)
    has_adopted = bool(adopted_rounds(report))
    return new_figure(lambda f: draw(f, overlays, length, time, has_adopted), height, width)


def _headline(report):
    overlay = pick_headline(report.overlays)
    if overlay is None:
        return None
    draw = draw_errors if wants_errors([overlay]) else draw_tracks
    figure = _drawn(draw, report, [overlay], 2.7, _NARROW)
    return "Held-out track, largest error before.", figure


def _tracks(report):
    picked = pick_overlays(report.overlays)
    if not picked:
        return None
    models = "the declared model (dashed)"
    models += " and the adopted one (solid)" if adopted_rounds(report) else ""
    caption = (
        f"{_tracks_caption(report, picked)}: observed positions (dots) and rollouts of {models}, "
        "started from the first rows only (filled dots)."
    )
    return caption, _drawn(draw_tracks, report, picked, 0.45 + 2.25 * math.ceil(len(picked) / 3))


def _track_errors(report):
    picked = pick_overlays(report.overlays)
    if not picked or not wants_errors(picked):
        return None
    caption = (
        f"{_tracks_caption(report, picked)}: distance between the observed position and each "
        "rollout against time. The shaded rows fixed the initial state and do not count."
    )
    return caption, _drawn(draw_errors, report, picked, 0.45 + 2.0 * math.ceil(len(picked) / 3))


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
    length, acceleration, time = units_of(report)
    against = []
    for name, values, unit in (
        ("time", table.t, time),
        ("speed", table.speed, f"{length}/{time}" if length else ""),
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
    figure = new_figure(lambda f: _draw_residuals(f, against, series, acceleration), 2.9)
    rows = "held-out rows" if use_held_out else "all rows"
    caption = (
        f"Size of the residual acceleration, {rows}"
        + (", before and after" if has_adopted else "")
        + ": running medians, with bands from 10\u00a0% to 90\u00a0%. Where a panel slopes or "
        "steps, the residual depends on that quantity."
    )
    return caption, figure


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
            panel.plot(
                x[thinned], y[thinned], ".", ms=1.6, mew=0, color=color, alpha=0.25,
                rasterized=True, zorder=1,
            )  # fmt: skip
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
