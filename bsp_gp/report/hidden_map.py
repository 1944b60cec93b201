"""A map of where an unseen body must be: draws from the posterior among the visible tracks."""

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bsp_gp.report.drawing import AFTER, BEFORE, INK, WIDTH, axis_label, new_figure, plain, scaled
from bsp_gp.report.drawing import tidy as tidied
from bsp_gp.report.numbers import format_p

SHARES = (0.9, 0.5)
"""Probabilities of the regions that are shaded."""
GRID = 120
SEEN = 6.0
"""Reach of the map, in extents of the tracks: a body may be anywhere far off."""


def draw_hidden_map(details, truth=None):
    """Draw where an unseen body must be.

    In 3-D there are two panels: x against y, and x against z.

    Parameters
    ----------
    details : dict
        `Explanation.details` of a hidden body, or the same read from JSON.
    truth : sequence of float, optional
        Its true place at that instant, where it is known.
    """
    draws = np.asarray(details["draws"], dtype=float)
    n_dims = len(details["centre"])
    planes = [(0, 1)] if n_dims == 2 else [(0, 1), (0, 2)]
    visible = {
        name: np.array([[np.nan if x is None else x for x in p] for p in track], dtype=float)
        for name, track in details["visible"].items()
    }
    own = np.asarray(details["track"], dtype=float)
    everything = np.concatenate([*visible.values(), draws[:, :n_dims]])
    factor, unit = scaled(details["length_unit"], everything)

    def draw(figure):
        panels = figure.subplots(1, len(planes) + 1, width_ratios=[3] * len(planes) + [2])
        for axes, plane in zip(panels[:-1], planes, strict=True):
            _draw_plane(axes, plane, visible, own, draws, details, truth, factor)
            axes.set_xlabel(axis_label("xyz"[plane[0]], unit))
            axes.set_ylabel(axis_label("xyz"[plane[1]], unit))
        where = " in the plane of the orbit" if "seen_at" in details else ""
        title = f"{details['motion']}{where}; {format_p(details['p_value'])}"
        panels[0].set_title(plain(title, 60), loc="left")
        _draw_strength(panels[-1], draws[:, -1], details)
        _add_key(figure, truth is not None)

    return new_figure(draw, 3.0 if n_dims == 3 else 3.4, WIDTH if n_dims == 3 else 0.85 * WIDTH)


def _draw_plane(axes, plane, visible, own, draws, details, truth, factor):
    plane = list(plane)
    for track in visible.values():
        moves = np.nanmax(np.abs(track - track[0])) > 0
        x, y = factor * track[:, plane].T
        axes.plot(x, y, lw=0.9, color=AFTER, alpha=0.75, zorder=3) if moves else None
        axes.plot(x[-1], y[-1], "o", ms=3, color=AFTER, mec="white", mew=0.4, zorder=4)
    places = factor * draws[:, plane]
    low, high = _window(factor, plane, visible, own, places)
    _shade(axes, places, low, high)
    if details["motion"] != "at rest":
        axes.plot(*(factor * own[:, plane].T), lw=0.9, ls="--", color=BEFORE, zorder=3)
    best = factor * np.asarray(details["best"])[plane]
    axes.plot(*best, "+", ms=8, mew=1.4, color=BEFORE, zorder=6)
    if truth is not None:
        at = factor * np.asarray(truth)[plane]
        axes.plot(*at, "x", ms=6, mew=1.2, color=INK, zorder=7)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tidied(axes, 4)


def _window(factor, plane, visible, own, places):
    """A square that holds the tracks and nine tenths of the places, unless these lie far off."""
    seen = factor * np.concatenate([t[:, plane] for t in visible.values()])
    low, high = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    middle, reach = (low + high) / 2, SEEN * np.max(high - low)
    shown = np.concatenate([np.quantile(places, [0.05, 0.95], axis=0), factor * own[:, plane]])
    shown = np.clip(shown, middle - reach, middle + reach)
    low, high = np.minimum(low, shown.min(axis=0)), np.maximum(high, shown.max(axis=0))
    middle, side = (low + high) / 2, 1.15 * np.max(high - low)
    return middle - side / 2, middle + side / 2


def _shade(axes, places, low, high):
    """Regions of highest density that hold the given shares of the draws; dots where too thin."""
    axes.plot(*places.T, ".", ms=1.5, color=BEFORE, alpha=0.25, mew=0, zorder=2)
    inside = places[((places > low) & (places < high)).all(axis=1)]
    if len(inside) < 50 or np.linalg.matrix_rank(np.cov(inside.T)) < 2:
        return
    from scipy.stats import gaussian_kde

    spread = 4 * inside.std(axis=0)
    middle = inside.mean(axis=0)
    axis = [
        np.linspace(max(a, m - s), min(b, m + s), GRID)
        for a, b, m, s in zip(low, high, middle, spread, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axis), axis=-1)
    density_of = gaussian_kde(inside.T)
    density = density_of(grid.reshape(-1, 2).T).reshape(GRID, GRID)
    levels = np.quantile(density_of(inside.T), [1 - share for share in SHARES])
    if levels[0] < levels[1] < density.max():
        axes.contourf(
            grid[..., 0], grid[..., 1], density, [*levels, density.max()],
            colors=[BEFORE, BEFORE], alpha=0.3, zorder=1,
        )  # fmt: skip


def _draw_strength(axes, values, details):
    factor, unit = scaled(details["unit"], values)
    axes.hist(factor * values, bins=30, color=BEFORE, alpha=0.45, lw=0)
    axes.axvline(factor * details["best"][-1], color=BEFORE, lw=1.2)
    axes.set_xlabel(axis_label(details["property"], unit))
    axes.set_yticks([])
    tidied(axes, 3)
    axes.spines["left"].set_visible(False)
    axes.set_yticks([])


def _add_key(figure, has_truth):
    handles = [
        Line2D([], [], color=AFTER, lw=1),
        Line2D([], [], color=BEFORE, marker="+", ls="", ms=7, mew=1.4),
        Patch(color=BEFORE, alpha=0.5, lw=0),
        Patch(color=BEFORE, alpha=0.25, lw=0),
    ]
    labels = ["visible bodies", "unseen body, best fit", "50 %", "90 % of the posterior"]
    if has_truth:
        handles.append(Line2D([], [], color=INK, marker="x", ls="", ms=6, mew=1.2))
        labels.append("true place")
    figure.legend(
        handles, labels, loc="outside upper center", ncols=len(labels), frameon=False,
        handlelength=1.6, columnspacing=1.4,
    )  # fmt: skip
