"""Where a residual is and what it depends on: the words, the tables and the figure of a round."""

from __future__ import annotations

import math

import numpy as np

from bsp_gp.report.drawing import AFTER, BEFORE, FLOOR, axis_label, new_figure, plain, scaled, tidy
from bsp_gp.report.numbers import format_number, is_number, rounded

__all__ = ["exponent_text", "guidance_sentence", "trace_figure", "trace_section", "trace_sentence"]

MAX_CHANNELS = 10
_MAX_CARRIERS = 5
_MAX_PANELS = 2
_GUIDES = {
    "off": "The search was not guided by this.",
    "order": "The whole grammar was searched; among laws that fit alike, those of the leading "
    "directions stand first.",
    "restrict": "Only laws of the leading directions were searched.",
}


def exponent_text(exponent):
    """An exponent with its interval, ``1.8 ± 0.2`` where that is as wide on either side."""
    if not exponent.is_determined:
        return "not determined"
    half = (exponent.high - exponent.low) / 2
    middle = (exponent.high + exponent.low) / 2
    if not half > 0 or abs(exponent.value - middle) > 0.2 * half:
        value, below, above, power = rounded(exponent.value, exponent.low, exponent.high)
        return f"{value} [{below}, {above}]{power}"
    place = -math.floor(math.log10(half))
    decimals = max(place if half * 10.0**place >= 2.95 else place + 1, 0)
    text = f"{exponent.value:.{decimals}f}"
    text = text.replace("-", "−") if float(text) else text.replace("-", "")
    return f"{text} ± {half:.{decimals}f}"


def share_text(part):
    """A share with its interval in per cent."""
    if not is_number(part.share):
        return "–"
    return f"{100 * part.share:.0f} % [{100 * part.low:.0f}, {100 * part.high:.0f}]"


def _subject(exponent):
    return "a force" if exponent.of_force else "an acceleration"


def trace_sentence(trace):
    """Where the residual of a round is, and how it scales, in one or two sentences; "" if unknown.

    Parameters
    ----------
    trace : Trace or None
    """
    if trace is None:
        return ""
    leading = trace.leading
    if not leading:
        return "No direction explains more of the residual than noise would."
    parts = [f"{c.name} ({share_text(c)})" for c in leading[:3]]
    text = "The residual lies " + ", ".join(parts)
    first = next((e for e in trace.exponents if e.profile is not None), None)
    if first is not None:
        where = f", {first.channel}," if len(leading) > 1 else ""
        text += f"; its size{where} goes with the power {exponent_text(first)} of {_word(first)}"
    return text + "."


def _word(exponent):
    return exponent.variable if "_" not in exponent.variable else f"property {exponent.variable}"


def guidance_sentence(guidance):
    """What the trace did for the search; "" where there was none."""
    if guidance is None:
        return ""
    parts = [_GUIDES.get(guidance.used, guidance.used)]
    if guidance.left_out:
        verb = "Left out" if guidance.used == "restrict" else "Named by no leading direction"
        parts.append(f"{verb}: {', '.join(guidance.left_out)}.")
    if guidance.note and guidance.used != "order":
        note = guidance.note
        parts.append(note[:1].upper() + note[1:] + ".")
    return " ".join(parts)


def trace_section(round_):
    """Words and tables of a traced round for the page; None where nothing was traced."""
    trace = round_.trace
    if trace is None:
        return None
    return {
        "sentence": trace_sentence(trace),
        "guidance": guidance_sentence(round_.guidance),
        "figure": f"trace_{round_.number}",
        "channels": [
            (c.name, share_text(c), str(c.freedom), format_number(c.evidence), c.is_leading)
            for c in trace.channels[:MAX_CHANNELS]
        ],
        "segments": [(s.name, str(s.n_rows), share_text(s)) for s in trace.segments],
        "carriers": [
            (kind, c.name, share_text(c))
            for kind, group in (("entity", trace.entities), ("scene", trace.scenes))
            if len(group) > 1
            for c in group[:_MAX_CARRIERS]
        ],
        "exponents": [
            (e.channel, e.variable, exponent_text(e), ", ".join(e.beside), e.reason)
            for e in trace.exponents
        ],
        "of": _subject(trace.exponents[0]) if trace.exponents else "",
        "method": trace.method,
        "notes": trace.notes,
    }


def trace_figure(round_):
    """Draw the shares of the directions, and the residual against what it depends on.

    Parameters
    ----------
    round_ : Round

    Returns
    -------
    (caption, Figure) or None
    """
    trace = round_.trace
    if trace is None or not any(is_number(c.share) for c in trace.channels):
        return None
    profiles = [e for e in trace.exponents if e.profile is not None]
    clear = [e for e in profiles if not e.reason]
    profiles = (clear or profiles)[:_MAX_PANELS]
    channels = trace.channels[:MAX_CHANNELS]
    height = max(0.75 + 0.2 * len(channels), 2.5 if profiles else 1.4)
    figure = new_figure(lambda f: _draw(f, channels, profiles), height)
    caption = (
        "Share of the smooth residual, noise taken off, that a free push in each direction "
        f"explains, with 90\u00a0% intervals ({trace.method}); filled: leading directions. "
        "Directions overlap, so shares may add up to more than one."
    )
    for exponent in profiles:
        caption += (
            f" Residual acceleration {exponent.channel} against {exponent.variable}, with "
            f"standard errors, free of any law (dots), and the power law, exponent "
            f"{exponent_text(exponent)} (line)."
        )
    return caption, figure


def _draw(figure, channels, profiles):
    ratios = [1.0] + [1.0] * len(profiles)
    panels = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
    _draw_shares(panels[0], channels)
    for panel, exponent in zip(panels[1:], profiles, strict=True):
        _draw_profile(panel, exponent)


def _draw_shares(panel, channels):
    rows = np.arange(len(channels))
    for row, channel in zip(rows, channels, strict=True):
        color = AFTER if channel.is_leading else FLOOR
        panel.hlines(row, 100 * channel.low, 100 * channel.high, color=color, lw=1.6)
        panel.plot(100 * channel.share, row, "o", ms=4.2, color=color,
                   mfc=color if channel.is_leading else "white")  # fmt: skip
    panel.set_ylim(len(channels) - 0.4, -0.6)
    panel.set_xlim(-3, 103)
    tidy(panel)
    panel.set_yticks(rows, [plain(c.name, 40) for c in channels])
    panel.spines["left"].set_visible(False)
    panel.tick_params(axis="y", length=0)
    panel.grid(axis="y", lw=0.3, color="#DDDDDD")
    panel.set_xlabel("residual explained (%)")


def _draw_profile(panel, exponent):
    profile = exponent.profile
    x, y, error = (np.array(values) for values in (profile.x, profile.y, profile.error))
    law_x, law_y = np.array(profile.law_x), np.array(profile.law_y)
    factor, unit = scaled(exponent.size_unit, y, law_y)
    x_factor, x_unit = scaled(exponent.unit, x)
    panel.plot(x_factor * law_x, factor * law_y, color=AFTER, lw=1.4, zorder=2)
    panel.errorbar(x_factor * x, factor * y, factor * error, fmt="o", ms=3.6, lw=1.0, color=BEFORE,
                   zorder=3)  # fmt: skip
    low = min(0.0, factor * float(law_y.min()))
    high = max(0.0, factor * float(law_y.max()))
    seen = np.abs(error) < 0.5 * (high - low) / factor  # nodes that hardly any row determines
    low = min([low, *(factor * (y - error)[seen])])
    high = max([high, *(factor * (y + error)[seen])])
    panel.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))
    panel.axhline(0, lw=0.6, color="#AAAAAA", zorder=0)
    tidy(panel)
    panel.set_xlabel(axis_label(exponent.variable, x_unit))
    panel.set_ylabel(axis_label("residual acceleration", unit))
    panel.set_title(
        f"{plain(exponent.channel, 44)}\nexponent {exponent_text(exponent)}", loc="left"
    )
