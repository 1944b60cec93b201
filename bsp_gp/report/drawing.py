"""How figures look and how they become files: one style, the same bytes every time."""

import io
import math
import re
import warnings

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend_handler import HandlerTuple
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter

from bsp_gp.report.numbers import power_of_ten, pretty_unit

# Okabe and Ito's colours: told apart by colour-blind readers, and in grey by their darkness.
BEFORE = "#D55E00"
AFTER = "#0072B2"
FLOOR = "#7F7F7F"
INK = "#222222"
WIDTH = 7.6
_DPI = 200
_STYLE = {
    "font.family": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 8.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#555555",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.formatter.useoffset": True,
    "axes.formatter.limits": (-4, 5),
    "svg.hashsalt": "bsp_gp",
    "svg.fonttype": "path",
    "path.simplify": True,
}
_DAY_S = 86400.0
_YEAR_S = 365.25 * _DAY_S
_LENGTHS = {
    ("m", -9): (1e9, "nm"), ("m", -6): (1e6, "µm"), ("m", -3): (1e3, "mm"), ("m", 3): (1e-3, "km"),
    ("m", 6): (1e-6, "10³ km"), ("m", 9): (1e-9, "10⁶ km"), ("m/s", 3): (1e-3, "km/s"),
} | {("m", k): (1 / 149597870700.0, "au") for k in (12, 15)}  # fmt: skip
"""Metres to a power of ten, as people call them: factor and unit."""
_TIMES = ((3 * _YEAR_S, _YEAR_S, "years"), (3 * _DAY_S, _DAY_S, "days"))


def new_figure(draw, height, width=WIDTH):
    """Make a figure, with `draw(figure)` called in the style of the report."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        figure.get_layout_engine().set(w_pad=0.04, h_pad=0.05)
        draw(figure)
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            if type(axis.get_major_formatter()) is ScalarFormatter:
                axis.set_major_formatter(_Plain())
    return figure


class _Plain(ScalarFormatter):
    """Powers of ten as letters: labels that are set as formulas take most of a figure's time."""

    def get_offset(self):
        """What all numbers of an axis share: "×10⁶"."""
        return re.sub(r"(\d[.\d]*)e(−?\d+)", _in_letters, super().get_offset())


def _in_letters(found):
    digits, power = found[1], power_of_ten(int(found[2].replace("−", "-")))
    return power.strip() if digits == "1" else digits + power


def svg_text(figure):
    """The figure as SVG, without dates, with the same names inside every time."""
    out = io.StringIO()
    _save(figure, out, "svg", {"Date": None, "Creator": None})
    return out.getvalue()


def png_bytes(figure):
    """The figure as PNG."""
    out = io.BytesIO()
    _save(figure, out, "png", {"Software": None})
    return out.getvalue()


def _save(figure, out, form, metadata):
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        # Names of entities may be in any script; a box is drawn for a letter that is missing.
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .*missing", category=UserWarning)
        figure.savefig(out, format=form, dpi=_DPI, metadata=metadata)
    figure.set_layout_engine("none")  # once laid out, it stays so in every form


def plain(text, max_length=28):
    """Text of a user, safe to draw: no formulas, no line breaks, not too long."""
    text = "".join(c if c.isprintable() else " " for c in str(text))
    if len(text) > max_length:
        text = text[: max_length - 1] + "…"
    return text.replace("$", r"\$")


def axis_label(name, unit):
    """Label of an axis: ``speed (m/s)``."""
    unit = pretty_unit(unit)
    return plain(f"{name} ({unit})" if unit else name, 60)


def scaled(unit, *arrays):
    """Factor and unit, a power of ten in front if need be, that make numbers of readable size."""
    size = max((float(np.nanmax(np.abs(a))) for a in arrays if np.isfinite(a).any()), default=0.0)
    if size == 0 or not math.isfinite(size) or 1e-2 <= size < 1e4:
        return 1.0, unit
    exponent = 3 * math.floor(math.log10(size) / 3)
    if (unit, exponent) in _LENGTHS:
        return _LENGTHS[unit, exponent]
    power = power_of_ten(exponent).removeprefix(" × ")
    return 10.0**-exponent, f"{power} {unit}".strip()


def time_scaled(unit, times):
    """Factor and unit for times: long ones in days or years."""
    finite = times[np.isfinite(times)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    if unit == "s":
        for least, length, name in _TIMES:
            if span > least:
                return 1 / length, name
    return scaled(unit, finite) if finite.size else (1.0, unit)


def spans_decades(values, n_decades=2.0):
    """Whether the bulk (5 % to 95 %) of the positive values covers more than `n_decades`.

    Sizes of normal noise alone cover one and a half.
    """
    positive = np.asarray(values, dtype=float)
    positive = positive[np.isfinite(positive) & (positive > 0)]
    if positive.size < 2:
        return False
    low, high = np.quantile(positive, [0.05, 0.95])
    return bool(high > low * 10**n_decades)


def tidy(axes, n_ticks=5):
    """Remove what carries no information: two of the four edges, and most of the ticks."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=2.5, width=0.7)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "linear":
            axis.set_major_locator(MaxNLocator(n_ticks))


def log_ticks(axis):
    """Few ticks on a logarithmic axis, none of the small ones labelled."""
    axis.set_major_locator(LogLocator(numticks=6))
    axis.set_minor_formatter(NullFormatter())


def panels_of(figure, n_panels):
    """So many panels, three in a row."""
    n_columns = min(n_panels, 3)
    n_rows = math.ceil(n_panels / n_columns)
    panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for panel in panels[n_panels:]:
        panel.set_axis_off()
    return panels[:n_panels]


def legend_above(figure, handles, labels):
    """One legend for all panels, above them."""
    figure.legend(
        handles, labels, loc="outside upper center", ncols=len(labels), frameon=False,
        handlelength=2.2, columnspacing=1.6, handler_map={tuple: HandlerTuple(None)},
    )  # fmt: skip
