"""Data sets that lack one thing their declared model does not know: a force, a body, a measurement.

Every kind makes exact positions of a given strength, as a camera that may be wrong sees them; noise
is added to what it sees. `KINDS` says which there are, and which codes of the loop are right.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from made_worlds import SPRING, make_apart, world
from power import (
    CASES,
    ORBITING,
    THROWN,
    declared_of,
    engine_of,
    for_engine,
    seen_against,
    strength_at,
)
from scenes import with_noise
from scipy.interpolate import make_interp_spline

from bsp_gp.errors import BspError
from bsp_gp.simulate.effects import effect
from bsp_gp.simulate.layouts import polar

FORCES = (
    "linear drag", "quadratic drag", "uniform wind", "magnetic", "spring to a point",
    "periodic push", "friction on a mat", "pair force", "changed exponent",
)  # fmt: skip
TIED = {**SPRING, "n_scenes": 10}
FAR = (35.0, 50.0)
"""Distance of the hidden body from the middle, m: beyond the orbits, which end at 30 m."""
WIND_OF_DRAG = 4.0
"""Wind in N per drag in kg/s where both act, m/s: each is then as well seen beside the other."""
SWAPPED_ROWS = (10, 30)
LATE = "2"
"""Name of the light body that is shown late."""


@dataclass(frozen=True)
class Kind:
    """One thing that the declared model lacks.

    Attributes
    ----------
    preset : str
    numbers : dict
        Of the preset.
    strength : float
        To begin with; `AS_IT_IS` where there is nothing to tune.
    effects : callable
        ``effects(strength, rng) -> tuple of Effect``; not declared.
    warp : callable or None
        ``warp(scene, strength, rng) -> Scene``: what the camera makes of exact positions.
    where : int or None
        The one scene that is warped; None: all.
    names : tuple of str
        Codes of causes that are right; empty where laws are compared.
    of : str
        The number that a cause must name beside; "" = any.
    same : tuple of Effect
        Forces that do the same to these data: not right, but in the class.
    """

    preset: str
    numbers: dict
    strength: float
    effects: Callable = lambda strength, rng: ()
    warp: Callable = None
    where: int = None
    names: tuple = ()
    of: str = ""
    same: tuple = ()

    @property
    def noise(self):
        return self.numbers["noise"]


AS_IT_IS = 0.0


@dataclass(frozen=True, eq=False)
class Made:
    """Exact positions as the camera sees them, the truth, and the declared laws."""

    dataset: object
    truth: object
    declared: tuple


# --- what a camera does ---------------------------------------------------------------------------


def _scaled(scene, strength, rng):
    return replace(scene, positions=(1 + strength) * scene.positions)


def _clocked(scene, strength, rng):
    return replace(scene, times=(1 + strength) * scene.times)


def _tilted(scene, strength, rng):
    c, s = np.cos(strength), np.sin(strength)
    return replace(scene, positions=scene.positions @ np.array([[c, s], [-s, c]]))


def _late(scene, strength, rng):
    positions = np.array(scene.positions)
    body = scene.names.index(LATE)
    track = make_interp_spline(scene.times, positions[:, body], k=5)
    positions[:, body] = track(scene.times - strength)
    return replace(scene, positions=positions)


def _swapped(scene, strength, rng):
    positions = np.array(scene.positions)
    row, pair = rng.integers(*SWAPPED_ROWS), scene.dynamic[-2:]
    positions[row:, pair] = positions[row:, pair[::-1]]
    return replace(scene, positions=positions)


# --- the kinds ------------------------------------------------------------------------------------


def _named(name, value, **options):
    return effect(name, value, is_declared=False, **options)


def _force(case):
    preset, numbers, build, strength = CASES[case]
    return Kind(preset, numbers, strength, lambda value, rng: (build(value),))


def _hidden(strength, rng):
    x, y = polar(rng.uniform(*FAR), rng.uniform(0, 2 * np.pi))
    return (_named("hidden", strength, x=x, y=y),)


def _drag_and_wind(strength, rng):
    return _named("drag", strength), _named("wind", WIND_OF_DRAG * strength)


KINDS = {
    **{case: _force(case) for case in FORCES},
    "hidden body": Kind("nbody", ORBITING, 10.0, _hidden, names=("hidden_body",)),
    "length scale": Kind(
        "spring", TIED, 0.01, warp=_scaled, names=("scale",)
    ),
    "tilted camera": Kind(
        "fall", THROWN, 0.005, warp=_tilted,
        names=("tilt",),
        same=(_named("field", 1.0, angle=0.0),),
    ),
    "clock": Kind("fall", THROWN, 0.005, warp=_clocked, names=("clock",)),
    "delay of a body": Kind(
        "nbody", ORBITING, 0.01, warp=_late, names=("delay",), of=f"delay_{LATE}"
    ),
    "swapped tracks": Kind(
        "nbody", ORBITING, AS_IT_IS, warp=_swapped, where=0, names=("swapped_tracks",)
    ),
    "drag and wind": Kind("fall", THROWN, 0.005, _drag_and_wind),
}  # fmt: skip


def _settings(kind, strength, rng):
    numbers = {**kind.numbers, "noise": 0.0}
    return world(kind.preset, numbers, kind.effects(strength, rng))


def able(name, engine):
    """Whether an engine has a kind."""
    kind = KINDS[name]
    return engine_of(engine, _settings(kind, kind.strength, np.random.default_rng(0))) is not None


def made(name, strength, seed, engine):
    """Exact positions of a kind.

    Returns
    -------
    Made
    """
    kind, entropy = KINDS[name], (list(KINDS).index(name), seed)
    rng = np.random.default_rng(entropy)
    settings = for_engine(_settings(kind, strength, rng), engine)
    run = engine_of(engine, settings)
    if run is None:
        raise BspError(f"{engine} has no {name}")
    dataset, truth = make_apart(settings, entropy, run)
    if kind.warp is not None:
        dataset = replace(dataset, scenes=tuple(
            kind.warp(scene, strength, rng) if kind.where in (None, k) else scene
            for k, scene in enumerate(dataset.scenes)
        ))  # fmt: skip
    return Made(dataset, truth, declared_of(name, truth))


def noisy(name, exact, rng):
    """The data set of exact positions with the noise of its kind, which it declares."""
    noise = KINDS[name].noise
    scenes = tuple(with_noise(scene, noise, rng) for scene in exact.dataset.scenes)
    return replace(exact.dataset, scenes=scenes, noise=(noise,))


def tuned_to(name, snr, seed, engine):
    """Exact data that differ from the refitted declared model by a signal-to-noise ratio.

    Returns
    -------
    strength, found : float
        Strength, and the SNR that it has; any SNR where there is nothing to tune.
    exact : Made
    """
    kind = KINDS[name]

    def seen(strength):
        exact = made(name, strength, seed, engine)
        return seen_against(exact.dataset, exact.declared, "", kind.noise)

    strength = kind.strength
    if strength != AS_IT_IS:
        strength, _ = strength_at(snr, strength, seen)
    return strength, seen(strength), made(name, strength, seed, engine)
