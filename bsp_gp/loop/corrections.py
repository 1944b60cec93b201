"""What a measurement may have done to positions and times, and how it is undone.

A correction has a few free numbers, all 0 where the measurement is as declared. It turns a
measured scene into the scene as it was, so that a law is fitted to it by the same machinery;
standard deviations are turned along, and chi-squared compares with that of the positions as
measured. What cannot be undone (a delay, a smoothing) is taken from the tracks of the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from bsp_gp.units import DIMENSIONLESS, Unit

__all__ = ["Correction", "FreeNumber", "corrections_of", "extent_of", "moved_scene"]

LENGTH, TIME = Unit.of(m=1), Unit.of(s=1)
LARGE = 0.3
"""A relative error or an angle beyond which nobody would believe a measurement."""
HALF, TWICE = -0.5, 1.0
"""Relative errors of a scale between which it is fitted: beyond, times may run backwards."""
FRAMES = 3.0
"""Delays and exposures that are believed, in median time steps."""
MOST_BODIES = 6
"""Bodies up to which each is asked for a delay of its own."""


@dataclass(frozen=True)
class FreeNumber:
    """A free number of a correction.

    Attributes
    ----------
    name : str
    unit : Unit
    size : float
        The largest that is believed, SI: data that leave it more open than this do not see it.
    """

    name: str
    unit: Unit
    size: float


@dataclass(frozen=True, eq=False)
class Correction:
    """One way in which a measurement may be wrong.

    Attributes
    ----------
    name : str
        In a few words.
    text, latex : str
        The measured in terms of the true, with the names of the numbers in braces in `text`.
    numbers : tuple of FreeNumber
    undo : callable
        ``undo(scene, values, track) -> Scene``: the scene as it was; `track` are the predicted
        positions of the receivers, shape (T, R, d), None if it needs none.
    needs_track : bool
    factors : callable, optional
        ``factors(values) -> (length, time)``: by what lengths and times of the corrected data
        differ from the measured ones, for what is quoted beside the scenes; None: by nothing.
    low, high : float
        Least and greatest value that make sense.
    holds_for_all : bool
        False if the numbers say nothing of scenes other than those they were fitted to.
    """

    name: str
    text: str
    latex: str
    numbers: tuple
    undo: Callable
    needs_track: bool = False
    factors: Callable = None
    low: float = -np.inf
    high: float = np.inf
    holds_for_all: bool = True

    def __len__(self):
        return len(self.numbers)

    def quoted(self, values):
        """By what corrected lengths and times differ from measured ones: (length, time)."""
        return (1.0, 1.0) if self.factors is None else self.factors(values)

    @property
    def sizes(self):
        return np.array([number.size for number in self.numbers])


def corrections_of(observation):
    """The corrections that make sense for a data set.

    Parameters
    ----------
    observation : Observation

    Returns
    -------
    list of Correction
    """
    scenes = observation.train
    axes = np.flatnonzero(np.isfinite(observation.sigma))
    extent, middle = extent_of(scenes)
    duration = max(float(np.ptp(s.times)) for s in scenes)
    step = float(np.median(np.concatenate([np.diff(s.times) for s in scenes])))
    out = [_scale(), _clock()]
    if len(axes) > 1:
        out.append(_rotation(axes))
        out += [_slant(axis, middle, extent) for axis in axes]
    if any(e.is_static for s in scenes for e in s.entities):
        out.append(_offset(axes, 0.1 * extent))
    out.append(_drift(axes, LARGE * extent / duration))
    if len(scenes) > 1:
        out.append(_drift(axes, LARGE * extent / duration, [s.name for s in scenes]))
    if not observation.is_exact:  # what is taken from tracks needs a fit to tracks
        names = list(dict.fromkeys(s.names[k] for s in scenes for k in s.dynamic))
        if 1 < max(len(s.entities) for s in scenes) and len(names) <= MOST_BODIES:
            out += [_delay(name, FRAMES * step) for name in names]
        out.append(_smoothing((FRAMES * step) ** 2))
    return out


def extent_of(scenes):
    """Half the span of the positions, and their middle, shape (d,), metres."""
    places = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in scenes])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    return float(np.max(high - low)) / 2 or 1.0, (low + high) / 2


def moved_scene(scene, shift):
    """The scene with its receivers moved by `shift`, shape (T, R, d), metres."""
    positions = np.array(scene.positions)
    positions[:, scene.dynamic] += shift
    return replace(scene, positions=positions)


# --- length and time ------------------------------------------------------------------------------


def _scale():
    return Correction(
        "a length scale that is off", "measured lengths = (1 + {epsilon}) * true lengths",
        r"\hat{x} = (1 + \epsilon)\, x", (FreeNumber("epsilon", DIMENSIONLESS, LARGE),),
        _unscaled, factors=_scale_factors, low=HALF, high=TWICE,
    )  # fmt: skip


def _scale_factors(values):
    return 1 / (1 + values[0]), 1.0


def _unscaled(scene, values, track=None):
    return _stretched(scene, *_scale_factors(values))


def _clock():
    return Correction(
        "a clock that is off", "measured times = (1 + {epsilon}) * true times",
        r"\hat{t} = (1 + \epsilon)\, t", (FreeNumber("epsilon", DIMENSIONLESS, LARGE),),
        _unclocked, factors=_clock_factors, low=HALF, high=TWICE,
    )  # fmt: skip


def _clock_factors(values):
    return 1.0, 1 / (1 + values[0])


def _unclocked(scene, values, track=None):
    return _stretched(scene, *_clock_factors(values))


def _stretched(scene, length, time):
    def by(array, factor):
        return None if array is None else array * factor

    return replace(
        scene, times=scene.times * time, positions=scene.positions * length,
        velocities=by(scene.velocities, length / time), sigma=by(scene.sigma, length),
    )  # fmt: skip


# --- the camera -----------------------------------------------------------------------------------


def _rotation(axes):
    planes = list(combinations(axes, 2))
    names = ["angle"] if len(planes) == 1 else [f"angle_{'xyz'[a]}{'xyz'[b]}" for a, b in planes]
    return Correction(
        "a camera that is tilted (its axes rotated)",
        "measured axes = true axes turned by " + ", ".join(f"{{{n}}} rad" for n in names),
        r"\hat{x} = R(\theta)\, x",
        tuple(FreeNumber(n, DIMENSIONLESS, LARGE) for n in names), partial(_unturned, planes),
    )  # fmt: skip


def _unturned(planes, scene, values, track=None):
    matrix = np.eye(scene.n_dims)
    for (a, b), angle in zip(planes, values, strict=True):
        turn = np.eye(scene.n_dims)
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[b, a], turn[a, b] = np.sin(angle), -np.sin(angle)
        matrix = matrix @ turn
    velocities = None if scene.velocities is None else scene.velocities @ matrix
    return replace(scene, positions=scene.positions @ matrix, velocities=velocities)


def _slant(axis, middle, extent):
    name = "xyz"[axis]
    return Correction(
        f"a camera that looks at a slant along {name}",
        f"measured lengths shrink by {{slant}} over {extent:.4g} along {name}",
        r"\hat{x} = x\,(1 - \epsilon\, u)", (FreeNumber("slant", DIMENSIONLESS, LARGE),),
        partial(_unslanted, axis, middle, extent),
    )  # fmt: skip


def _unslanted(axis, middle, extent, scene, values, track=None):
    away = scene.positions - middle
    growth = 1 + values[0] * away[..., axis : axis + 1] / extent
    slope = growth + values[0] * away / extent * (np.arange(scene.n_dims) == axis)
    # A trial value may be so great that the picture folds; an error has a size all the same.
    sigma = None if scene.sigma is None else scene.sigma * np.abs(slope)
    velocities = None
    if scene.velocities is not None:
        change = values[0] * scene.velocities[..., axis : axis + 1] / extent
        velocities = scene.velocities * growth + away * change
    return replace(scene, positions=middle + away * growth, sigma=sigma, velocities=velocities)


def _offset(axes, size):
    numbers = tuple(FreeNumber(f"offset_{'xyz'[k]}", LENGTH, size) for k in axes)
    return Correction(
        "an offset between moving and fixed bodies",
        "fixed bodies are measured off by (" + ", ".join(f"{{{n.name}}}" for n in numbers) + ")",
        r"\hat{x}_j = x_j + a", numbers, partial(_unoffset, axes),
    )  # fmt: skip


def _unoffset(axes, scene, values, track=None):
    positions = np.array(scene.positions)
    fixed = [k for k, e in enumerate(scene.entities) if e.is_static]
    for axis, value in zip(axes, values, strict=True):
        positions[:, fixed, axis] -= value
    return replace(scene, positions=positions)


def _drift(axes, size, scenes=None):
    letters = ["xyz"[k] for k in axes]
    if scenes is None:
        numbers = tuple(FreeNumber(f"drift_{k}", LENGTH / TIME, size) for k in letters)
        text = "moving bodies drift by (" + ", ".join(f"{{{n.name}}}" for n in numbers) + ")"
        name = "a camera that drifts"
    else:
        numbers = tuple(
            FreeNumber(f"drift_{k} of {scene}", LENGTH / TIME, size)
            for scene in scenes
            for k in letters
        )
        text = "moving bodies drift, differently in every scene"
        name = "a camera that drifts, differently in every scene"
    return Correction(
        name, text, r"\hat{x} = x + u\, t", numbers, partial(_undrifted, axes, scenes),
        holds_for_all=scenes is None,
    )  # fmt: skip


def _undrifted(axes, scenes, scene, values, track=None):
    values = np.reshape(values, (-1, len(axes)))
    if scenes is not None and scene.name not in scenes:
        return scene
    own = values[0 if scenes is None else scenes.index(scene.name)]
    shift = np.zeros((len(scene.times), len(scene.dynamic), scene.n_dims))
    shift[..., axes] = own * (scene.times - scene.times[0])[:, None, None]
    moved = moved_scene(scene, -shift)
    if scene.velocities is None:
        return moved
    velocities = np.array(scene.velocities)
    velocities[np.ix_(range(len(scene.times)), scene.dynamic, axes)] -= own
    return replace(moved, velocities=velocities)


# --- along the track ------------------------------------------------------------------------------


def _delay(name, size):
    return Correction(
        f"a delay of {name}", f"{name} is shown {{delay}} late", r"\hat{x}(t) = x(t - \tau)",
        (FreeNumber("delay", TIME, size),), partial(_undelayed, name), needs_track=True,
    )  # fmt: skip


def _undelayed(name, scene, values, track):
    shift = np.zeros_like(track)
    names = [scene.names[k] for k in scene.dynamic]
    if name in names:
        r = names.index(name)
        shift[:, r] = _spline(scene.times, track[:, r])(scene.times - values[0]) - track[:, r]
    return moved_scene(scene, -shift)


def _smoothing(size):
    return Correction(
        "positions smoothed over time (exposure, filter)",
        "positions are averages over time with the variance {variance}",
        r"\hat{x} = x + \frac{1}{2} w^2\, \ddot{x}", (FreeNumber("variance", TIME**2, size),),
        _unsmoothed, needs_track=True, low=0.0,
    )  # fmt: skip


def _unsmoothed(scene, values, track):
    bend = _spline(scene.times, track).derivative(2)(scene.times)
    return moved_scene(scene, -0.5 * values[0] * bend)


def _spline(times, track):
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(times, track, k=5 if len(times) > 5 else 3 if len(times) > 3 else 2)
