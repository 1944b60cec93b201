"""Quick looks: tracks and constants drawn into axes of matplotlib that come in and go out."""

import numpy as np

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's, told apart by colour-blind readers."""
_MOST_NAMES = 8


def new_axes(axes=None):
    """The axes given, or new ones."""
    if axes is not None:
        return axes
    import matplotlib.pyplot as plt

    return plt.figure(layout="constrained").subplots()


def _moving(positions):
    """The two axes with the most motion, or the one that has any."""
    flat = positions.reshape(-1, positions.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=1)]
    spans = np.ptp(flat, axis=0) if len(flat) else np.zeros(positions.shape[-1])
    order = sorted(np.argsort(-spans, kind="stable")[:2])
    return [int(k) for k in order if spans[k] > 0] or [0]


def plot_tracks(scene, axes=None, *, length="m", time="s"):
    """Draw the tracks of a scene: the path, or the place over time where one axis moves.

    Axes are those of matplotlib, by default new ones; `length` and `time` are units as they are
    told.
    """
    axes = new_axes(axes)
    moving = _moving(scene.positions)
    for k, name in enumerate(scene.names):
        place = scene.positions[:, k]
        x = place[:, moving[0]] if len(moving) > 1 else scene.times
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(x, place[:, moving[-1]], ".-", ms=2.5, lw=0.8, color=colour,
                  label=name.replace("$", r"\$"))  # fmt: skip
    _label(axes, moving, length, time)
    axes.set_title(f"scene {scene.name}".replace("$", r"\$"))
    if 1 < len(scene.names) <= _MOST_NAMES:
        axes.legend(frameon=False)
    return axes


def _label(axes, moving, length, time):
    if len(moving) > 1:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{'xyz'[moving[0]]} ({length})" if len(moving) > 1 else f"t ({time})")
    axes.set_ylabel(f"{'xyz'[moving[-1]]} ({length})")


def plot_models(times, observed, models, axes=None, *, length="m", time="s"):
    """Draw one track as observed (dots) and as models foresee it (lines).

    Parameters
    ----------
    times : ndarray, shape (T,)
    observed : ndarray, shape (T, d)
    models : mapping of str to ndarray, shape (T, d)
    axes, length, time
        As for `plot_tracks`.
    """
    axes = new_axes(axes)
    moving = _moving(observed)
    is_path = len(moving) > 1
    axes.plot(observed[:, moving[0]] if is_path else times, observed[:, moving[-1]], "o", ms=3,
              mfc="white", mec="#555555", label="observed")  # fmt: skip
    for (name, place), colour, style in zip(models.items(), COLOURS[1::-1], ("--", "-"),
                                            strict=False):  # fmt: skip
        x = place[:, moving[0]] if is_path else times
        axes.plot(x, place[:, moving[-1]], style, color=colour, lw=1.3, label=name)
    _label(axes, moving, length, time)
    axes.legend(frameon=False)
    return axes


def plot_constants(constants, axes=None):
    """Draw constants with their 90 % intervals, each in per cent of its value."""
    axes = new_axes(axes)
    for k, c in enumerate(constants):
        size = abs(c.value) or 1.0
        ends = 100 * (np.array([c.low, c.high]) - c.value) / size
        axes.plot(ends, [k, k], "-", color=COLOURS[0], lw=2)
        axes.plot(0, k, "o", color=COLOURS[0], ms=4)
    names = [f"{c.name} {c.entity} = {c.value:.4g} {c.unit}" for c in constants]
    axes.set_yticks(range(len(names)), [n.replace("$", r"\$") for n in names])
    axes.set_xlabel("90 % interval, % of the value")
    return axes
