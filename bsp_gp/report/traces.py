"""Where a residual force is and on what it depends: the words, the table and the figure."""

import numpy as np

from bsp_gp.report.codes import DIRECTIONS, VARIABLES
from bsp_gp.report.drawing import (
    AFTER,
    BEFORE,
    FLOOR,
    axis_label,
    new_figure,
    plain,
    scaled,
    tidy,
    time_scaled,
)
from bsp_gp.report.numbers import format_number, format_p, is_number

MAX_CHANNELS = 10


def trace_sentence(trace):
    """Where the residual force of a round is, in a sentence; "" where it was not traced."""
    if trace is None or not trace.channels:
        return ""
    best = trace.channels[0]
    if best.evidence <= 0:
        return "No direction explains more of what is left than noise would."
    text = f"What was missing is best described as a push {_direction(best)}"
    text += f" that changes with {_variable(best)}" if best.variable else " of constant size"
    share = f"{_share(best)} of it, " if is_number(best.share) else ""
    return f"{text} ({share}{format_p(best.p_value)})."


def _direction(channel):
    name, _, body = channel.direction.partition(":")
    if body:
        return f"along the line to {body}"
    return DIRECTIONS.get(name, f"along {name}")


def _variable(channel):
    return VARIABLES.get(channel.variable, channel.variable)


def _share(channel):
    # A part of an estimate, which may be larger than what it is of.
    return f"{100 * min(channel.share, 1.0):.0f} %" if is_number(channel.share) else "–"


def trace_section(round_):
    """Words and table of a traced round for the page; None where nothing was traced."""
    trace = round_.trace
    if trace is None or not trace.channels:
        return None
    return {
        "sentence": trace_sentence(trace),
        "figure": f"trace_{round_.number}",
        "channels": [
            (_direction(c), _variable(c) if c.variable else "–", _share(c), str(c.rank),
             format_number(c.evidence), format_p(c.p_value))
            for c in trace.channels[:MAX_CHANNELS]
        ],
    }  # fmt: skip


def trace_figure(round_):
    """Draw evidence of channels, and the push of the best: (caption, Figure), or None."""
    trace = round_.trace
    if trace is None or not trace.channels or not is_number(trace.channels[0].evidence):
        return None
    best, channels = trace.channels[0], trace.channels[:MAX_CHANNELS]
    has_profile = bool(best.variable) and len(trace.at) > 1 and np.isfinite(trace.values).any()
    height = max(0.75 + 0.2 * len(channels), 2.5 if has_profile else 1.4)
    figure = new_figure(lambda f: _draw(f, trace, channels, round_, has_profile), height)
    caption = (
        "Evidence for a free push in each direction, as a smooth function of each variable, beside "
        "none at all; channels overlap."
    )
    if has_profile:
        caption += f" The push {_direction(best)} against {_variable(best)}, with standard errors."
    return caption, figure


def _draw(figure, trace, channels, round_, has_profile):
    panels = figure.subplots(1, 1 + has_profile, squeeze=False)[0]
    _draw_evidence(panels[0], channels)
    if has_profile:
        _draw_profile(panels[1], trace, round_)


def _draw_evidence(panel, channels):
    rows = np.arange(len(channels))
    values = [c.evidence if is_number(c.evidence) else 0.0 for c in channels]
    panel.barh(rows, values, color=[AFTER, *[FLOOR] * (len(channels) - 1)], height=0.6)
    panel.set_ylim(len(channels) - 0.4, -0.6)
    tidy(panel)
    labels = [_direction(c) + (f", {_variable(c)}" if c.variable else "") for c in channels]
    panel.set_yticks(rows, [plain(label, 44) for label in labels])
    panel.spines["left"].set_visible(False)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("evidence (nats)")


def _draw_profile(panel, trace, round_):
    best, before = trace.channels[0], round_.before
    y, error = np.array(trace.values, dtype=float), np.array(trace.errors, dtype=float)
    error = np.where(np.isfinite(error), error, np.nan)
    factor, unit = scaled(round_.missing.unit, y)
    if best.variable in ("body", "scene"):
        x = np.arange(len(y), dtype=float)
        panel.set_xticks(x, [plain(name, 12) for name in trace.at])
        panel.set_xlabel(best.variable)
    else:
        time = round_.time_unit
        own = {"time": time, "speed": f"{before.unit}/{time}" if before.unit else ""}
        x = np.array(trace.at, dtype=float)
        scale = time_scaled if best.variable == "time" else scaled
        x_factor, x_unit = scale(own.get(best.variable, before.unit), x)
        x = x_factor * x
        panel.set_xlabel(axis_label(_variable(best), x_unit))
    panel.errorbar(x, factor * y, factor * error, fmt="o", ms=3.6, lw=1.0, color=BEFORE)
    panel.axhline(0, lw=0.6, color="#AAAAAA", zorder=0)
    tidy(panel)
    panel.set_ylabel(axis_label("push", unit))
    panel.set_title(plain(_direction(best), 44), loc="left")
