"""Constants with their error bars, and errors round by round."""

import math

import numpy as np

from bsp_gp.report.drawing import (
    AFTER,
    BEFORE,
    FLOOR,
    INK,
    axis_label,
    new_figure,
    plain,
    scaled,
    spans_decades,
    tidy,
)
from bsp_gp.report.numbers import format_number, format_value, is_number, with_unit
from bsp_gp.report.sentences import constant_groups

_MAX_LABELS = 60


def constants_figure(report):
    """Draw the constants with their intervals: (caption, Figure), or None."""
    shared, own = constant_groups([c for c in report.constants if is_number(c.value)])
    shared = [c for c in shared if c.value and is_number(c.low) and is_number(c.high)]
    if not shared and not own:
        return None
    heights = [0.5 + 0.24 * len(shared)] if shared else []
    heights += [0.5 + 0.17 * min(len(group), _MAX_LABELS) for _, _, group in own]
    figure = new_figure(lambda f: _draw_constants(f, shared, own, heights), 0.15 + sum(heights))
    parts = []
    if shared:
        parts.append("the interval relative to the value (at −100\u00a0% it would reach zero)")
    if own:
        parts.append("one value per entity, sorted by value")
    return f"Constants with their 90\u00a0% intervals: {'; '.join(parts)}.", figure


def _draw_constants(figure, shared, own, heights):
    panels = list(figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    if shared:
        panel = panels.pop(0)
        ends = [sorted((c.low / c.value - 1, c.high / c.value - 1)) for c in shared]
        low, high = np.array(ends).T
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


def rounds_figure(report):
    """Draw the errors before and after every round, and the floor: (caption, Figure), or None."""
    panels = []
    for metric, title in (
        ("rollout_rmse", "Position error of rollouts"),
        ("residual_acceleration", "Residual acceleration"),
    ):
        rows = []
        for r in report.rounds:
            after = "after" if r.adopted else "after (not adopted)"
            for label, errors, color in (
                ("before", r.before, BEFORE),
                (after, r.after, AFTER),
                ("noise floor", r.floor, FLOOR),
            ):
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
    caption = "Error on held-out data before and after every round"
    has_floor = any(row[3] == FLOOR for _, rows in panels for row in rows)
    caption += ", and the floor set by the noise" if has_floor else ""
    caption += "; logarithmic where dots stand for bars." if any(map(_is_log, panels)) else "."
    return caption, figure


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
            panel.annotate(
                with_unit(format_number(value), unit), (value, where), (5, 0),
                textcoords="offset points", va="center", color=INK,
            )  # fmt: skip
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
