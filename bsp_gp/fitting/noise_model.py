"""The noise of measured tracks as a part of a hypothesis: what is known of it, what is estimated.

The size of an error is the level of its axis, times a factor of its body and one of its scene.
A part of its square, `correlated`, belongs to an Ornstein-Uhlenbeck process, the rest is white, so
that a declared level says the same with and without memory. The white variance may grow with the
speed (time stamps that jitter by b seconds: (b * speed)^2), have the tails of Student's t, and is
never below that of rounding, step^2 / 12. Quoted and declared sizes are taken as they are.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bsp_gp.data.noise import estimate_noise, finest_noise
from bsp_gp.fitting.whitening import Adding, whitener_of

KNOWN = ("quoted", "declared")
ANYWHERE = {1: 100.0, 2: 1.0}
"""Extents of tracks by which places that were added up may begin elsewhere. Sums of sums may go as
far in one step, which is at any speed; beside what rows weigh there more would be lost to rounding.
"""
LEAST_BESIDE = 0.1
"""Of quoted errors, what is at least beside them: a hundredth of the variance."""
ADDED = {1: ("m/s", "velocities"), 2: ("m/s^2", "accelerations")}
"""Unit and name of what is added up to places, by how often."""


@dataclass(frozen=True)
class NoiseParameter:
    """A number of the noise.

    Attributes
    ----------
    unit : str
        "m", "s" or "".
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    is_free: bool


@dataclass(frozen=True)
class NoiseFinding:
    """One part of the noise that was asked for.

    Attributes
    ----------
    part : str
        "correlation", "scenes", "bodies", "speed" or "tails".
    gain, needed : float, nats
        Of restricted log-likelihood.
    """

    part: str
    gain: float
    needed: float
    is_adopted: bool


@dataclass(frozen=True)
class NoiseModel:
    """Noise of positions.

    Attributes
    ----------
    levels : tuple of float, length d, metres
        Standard deviation per axis, white and correlated parts together; under Student's t its
        scale. nan = an axis along which nothing moves.
    sources : tuple of str, length d
        "quoted", "declared" (both are known, and stay) or "estimated".
    floors, steps : tuple of float, length d, metres
        Least size at all, and the step of the grid of an axis (0 = none).
    bodies, scenes : tuple of (str, float)
        Factors of the size; who is not named has 1. On estimated axes only, as what follows.
    speed_growth : float, s
    degrees : float
        Of Student's t; inf = normal.
    correlated : float
        Part of the variance that has a memory, on every axis.
    correlation_time : float, s
    is_correlation_known : bool
        Declared, white included.
    is_beside_quoted : bool
        Whether what is estimated comes beside quoted errors, whose variances are added to it: what
        spectrographs quote says nothing of the star's own trembling.
    adding : Adding or None
        Of errors that add up from row to row, each by a level: of places that are sums of measured
        velocities, or sums of sums of accelerations.
    findings : tuple of NoiseFinding
        Which parts were asked for when it was estimated.
    """

    levels: tuple[float, ...]
    sources: tuple[str, ...]
    floors: tuple[float, ...]
    steps: tuple[float, ...]
    bodies: tuple = ()
    scenes: tuple = ()
    speed_growth: float = 0.0
    degrees: float = math.inf
    correlated: float = 0.0
    correlation_time: float = 0.0
    is_correlation_known: bool = False
    is_beside_quoted: bool = False
    adding: Adding | None = None
    findings: tuple = field(default=(), compare=False)

    @classmethod
    def of(cls, dataset):
        """What a data set says of its noise; levels not said are estimated from differences."""
        found = estimate_noise(dataset)
        steps, floors = finest_noise(dataset)
        adding, memory = None, dataset.noise_memory
        if dataset.is_summed:
            places = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in dataset.scenes])
            low, high = np.fmin.reduce(places), np.fmax.reduce(places)
            begin = ANYWHERE[dataset.n_sums] * (float(np.nanmax(high - low)) or 1.0)
            adding, memory = Adding(dataset.typical_step, begin, dataset.n_sums), 0.0
        sources = tuple(_source(dataset, axis) for axis in range(len(found.sigma)))
        if dataset.is_of_sight:  # sparse rows cannot tell a memory from companions before these
            memory = memory or 0.0
        is_beside = dataset.is_of_sight and "quoted" in sources
        if is_beside:
            sources = tuple("estimated" if how == "quoted" else how for how in sources)
            floors = tuple(np.fmax(floors, LEAST_BESIDE * np.array(found.sigma)).tolist())
        return cls(
            levels=found.sigma,
            sources=sources,
            floors=floors,
            steps=steps,
            correlated=1.0 if memory else 0.0,
            correlation_time=memory or 0.0,
            is_correlation_known=memory is not None,
            is_beside_quoted=is_beside,
            adding=adding,
        )

    @cached_property
    def is_free(self):
        """Which axes have an estimated level, ndarray of bool, shape (d,)."""
        pairs = zip(self.sources, self.levels, strict=True)
        free = [s not in KNOWN and math.isfinite(x) for s, x in pairs]
        return np.array(free)

    @property
    def lowest(self):
        """Least level that may be estimated, ndarray, shape (d,), metres."""
        rounding = np.array(self.steps) / math.sqrt(12.0)
        return np.maximum(np.maximum(self.floors, rounding), np.finfo(float).tiny)

    def plain(self):
        """The same with nothing adopted: levels per axis and what was declared."""
        model = replace(self, bodies=(), scenes=(), speed_growth=0.0, degrees=math.inf, findings=())
        if self.is_correlation_known:
            return model
        return replace(model, correlated=0.0, correlation_time=0.0)

    def sizes(self, channels):
        """Standard deviation of every row without growth and tails, shape (T, C); nan = none."""
        return np.where(channels.seen, self._sizes(channels), np.nan)

    def _sizes(self, channels):
        """The same, shape (C,) or (T, C), whether rows are seen or not."""
        level = np.maximum(np.array(self.levels), self.floors)[channels.axis]
        size = level * self._factors(channels)
        if channels.quoted is not None and not self.is_beside_quoted:
            floor = np.array(self.floors)[channels.axis]
            # An axis along which nothing moves stays left out.
            is_quoted = (channels.quoted > 0) & np.isfinite(level)
            size = np.where(is_quoted, np.fmax(channels.quoted, floor), size)
        return size

    def _factors(self, channels):
        if not (self.bodies or self.scenes):
            return 1.0
        bodies, scenes = dict(self.bodies), dict(self.scenes)
        of_body = np.array([bodies.get(name, 1.0) for name in channels.body_names])
        of_scene = np.array([scenes.get(name, 1.0) for name in channels.scene_names])
        factor = np.ones(len(channels.axis))
        if bodies:
            factor = factor * of_body[channels.body]
        if scenes:
            factor = factor * of_scene[channels.scene]
        return np.where(self.is_free[channels.axis], factor, 1.0)

    def parts(self, channels, sizes=None):
        """White variance, nan = not seen, and amplitude of the correlated part, both (T, C)."""
        sizes = self._sizes(channels) if sizes is None else sizes
        white = (1.0 - self.correlated) * np.square(sizes)
        free = self.is_free[channels.axis]
        if (self.speed_growth or any(self.steps)) and free.any():
            if self.speed_growth and channels.speed is not None:
                grown = np.square(self.speed_growth * channels.speed)
                white = white + np.where(free & np.isfinite(grown), grown, 0.0)
            if any(self.steps):
                rounding = np.square(np.array(self.steps))[channels.axis] / 12.0
                white = np.maximum(white, np.where(free, rounding, 0.0))
        if self.is_beside_quoted and channels.quoted is not None:
            white = white + np.nan_to_num(np.square(channels.quoted))
        seen = channels.seen
        if not self.correlated:
            return np.where(seen, white, np.nan), np.zeros(seen.shape)
        known = seen & np.isfinite(sizes)
        amplitude = np.where(known, math.sqrt(self.correlated) * sizes, 0.0)
        return np.where(seen, white, np.nan), amplitude

    def whitener(self, channels, weights=None):
        """Whitens errors (..., T, C); white variances are divided by weights (T, C) of the rows."""
        white, amplitude = self.parts(channels)
        if weights is not None:
            white = white / weights
        known = self.correlation_time, self.adding, channels.gaps
        return whitener_of(channels.times, white, amplitude, *known)

    def tail_weights(self, scaled, channels):
        """Weights of rows under Student's t, 1 where it does not apply, shape (T, C).

        They are those of the residual in units of the size that it would have without tails.
        """
        if math.isinf(self.degrees):
            return np.ones(channels.seen.shape)
        weights = (self.degrees + 1.0) / (self.degrees + np.square(scaled))
        return np.where(channels.seen & self.is_free[channels.axis], weights, 1.0)

    @property
    def parameters(self):
        """Everything that is a number, tuple of NoiseParameter."""
        found = [
            NoiseParameter(f"sigma_{'xyz'[k]}", "m", level, self.lowest[k], math.inf, free)
            for k, (level, free) in enumerate(zip(self.levels, self.is_free, strict=True))
            if math.isfinite(level)
        ]
        for kind, factors in (("body", self.bodies), ("scene", self.scenes)):
            found += [
                NoiseParameter(f"sigma[{kind} {name}]", "", value, 0.0, math.inf, True)
                for name, value in factors
            ]
        if self.speed_growth:
            found.append(NoiseParameter("jitter", "s", self.speed_growth, 0.0, math.inf, True))
        if math.isfinite(self.degrees):
            found.append(NoiseParameter("degrees", "", self.degrees, 1.0, math.inf, True))
        if self.correlated:
            free = not self.is_correlation_known
            found.append(NoiseParameter("correlated", "", self.correlated, 0.0, 1.0, free))
            time = self.correlation_time
            found.append(NoiseParameter("correlation_time", "s", time, 0.0, math.inf, free))
        return tuple(found)

    def describe(self):
        axes = zip("xyz", self.levels, self.sources, strict=False)
        per, unit, kind = 1.0, "m", ""
        if self.adding:
            per, (unit, kind) = self.adding.step**self.adding.order, ADDED[self.adding.order]
        said = [f"{axis} {size / per:.4g} {unit} ({how})" for axis, size, how in axes
                if math.isfinite(size)]  # fmt: skip
        if self.adding:
            said.append(f"of {kind}, which add up to places")
        for kind, factors in (("body", self.bodies), ("scene", self.scenes)):
            if factors:
                listed = ", ".join(f"{name} {value:.3g}" for name, value in factors[:6])
                listed += ", ..." if len(factors) > 6 else ""
                said.append(f"times a factor per {kind}: {listed}")
        if self.speed_growth:
            said.append(
                f"grows with speed as time stamps uncertain by {self.speed_growth:.3g} s do"
            )
        if math.isfinite(self.degrees):
            said.append(f"tails of Student's t with {self.degrees:.3g} degrees of freedom")
        if self.correlated:
            said.append(
                f"{100 * self.correlated:.3g} % of its variance has a memory of "
                f"{self.correlation_time:.3g} s"
            )
        rounded = [f"{a} {s:.3g} m" for a, s in zip("xyz", self.steps, strict=False) if s]
        if rounded:
            said.append("rounded to steps of " + ", ".join(rounded))
        return "; ".join(said)


def _source(dataset, axis):
    """Whether the level of an axis is quoted, declared or to be estimated."""
    for scene in dataset.scenes:
        if scene.sigma is not None and np.isfinite(scene.sigma[:, scene.dynamic, axis]).any():
            return "quoted"
    return "estimated" if dataset.noise is None else "declared"
