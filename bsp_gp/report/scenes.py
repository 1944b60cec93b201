"""A picture of scenes: where bodies go, and in grey what does not move (paper, figure 3)."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.patches import Circle, Rectangle

from bsp_gp.report.drawing import WIDTH, axis_label, new_figure, panels_of

# Okabe and Ito's colours, in the order of the films.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_WALL, _MAT, _ANCHOR = "#969696", "#DEDEDE", "#5A5A5A"
_MOST = 3
_LEAST_DISC = 0.012  # of the width of a panel


def draw_scenes(scenes):
    """Draw the first scenes of a data set in 2-D, a panel each; returns the figure.

    A track fades towards its beginning; a body is drawn where it is at last.
    """
    scenes = scenes[:_MOST]

    def draw(figure):
        for axes, scene in zip(panels_of(figure, len(scenes)), scenes, strict=True):
            _draw_scene(axes, scene)
            axes.set_title(f"scene {scene.name}")

    return new_figure(draw, WIDTH / _MOST, WIDTH * len(scenes) / _MOST)


def _draw_scene(axes, scene):
    low, high = _view(scene)
    side = high[0] - low[0]
    moving = 0
    for k, entity in enumerate(scene.entities):
        track = scene.positions[:, k]
        last = track[np.isfinite(track).all(axis=-1)][-1]
        if entity.shape.startswith("rect"):
            corner = last - (entity.width / 2, entity.height / 2)
            colour = _MAT if entity.shape == "rect_mat" else _WALL
            order = 0 if entity.shape == "rect_mat" else 1
            axes.add_patch(
                Rectangle(corner, entity.width, entity.height, color=colour, lw=0, zorder=order)
            )
            continue
        radius = max(entity.radius if entity.radius > 0 else 0.0, _LEAST_DISC * side)
        colour = _ANCHOR if entity.is_static else COLOURS[moving % len(COLOURS)]
        if not entity.is_static:
            moving += 1
            _draw_track(axes, track, colour)
        axes.add_patch(Circle(last, radius, facecolor=colour, edgecolor="white", lw=0.5, zorder=4))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel(axis_label("x", "m"))
    for spine in axes.spines.values():
        spine.set_linewidth(0.5)


def _draw_track(axes, track, colour):
    pieces = np.stack([track[:-1], track[1:]], axis=1)
    fade = np.tile(to_rgba(colour), (len(pieces), 1))
    fade[:, 3] = np.linspace(0.08, 1.0, len(pieces))
    axes.add_collection(LineCollection(pieces, colors=fade, linewidths=1.1, zorder=3))
    axes.plot(*track.T, ".", ms=1.2, color=colour, alpha=0.5, mew=0, zorder=3)


def _view(scene):
    """A square that holds all tracks, and mats; walls only where bodies meet them."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k, entity in enumerate(scene.entities):
        track = scene.positions[:, k]
        if entity.shape == "rect_wall":
            continue
        half = np.zeros(2)
        if entity.shape == "rect_mat":
            half = np.array([entity.width, entity.height]) / 2
        elif entity.radius > 0:
            half = np.full(2, entity.radius)
        low = np.minimum(low, np.nanmin(track, axis=0) - half)
        high = np.maximum(high, np.nanmax(track, axis=0) + half)
    middle, side = (low + high) / 2, 1.1 * float(np.max(high - low)) or 1.0
    return middle - side / 2, middle + side / 2
