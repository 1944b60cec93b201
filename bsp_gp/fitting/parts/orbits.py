"""What an unseen companion adds to velocities along the line of sight: Kepler's orbit of the star.

``v = K (cos(nu + omega) + e cos(omega))``, with the true anomaly nu of Kepler's equation. It is
added to what is seen: no track of velocities is integrated through thousands of turns.
"""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.ellipses import eccentric_anomaly
from bsp_gp.fitting.hypothesis import Numbered

HIGHEST = 0.97
"""Eccentricity up to which orbits are sought."""


@dataclass(frozen=True)
class AnyAngle:
    """The prior of an angle that is as likely all round, and told beyond a turn as within."""

    is_logarithmic = False
    pull = (0.0, math.inf)
    spread = 2 * math.pi / math.sqrt(12)

    def log_prob(self, x):
        return np.full(np.shape(x), -math.log(2 * math.pi))


@dataclass(frozen=True)
class Orbit(Numbered):
    """The turns of a star about the centre of mass that it shares with a companion.

    Attributes
    ----------
    numbers : tuple of Parameter
        Period, semi-amplitude and mean longitude at the epoch (the angle from the node at which a
        body on a circle would be); of an ellipse also its eccentricity and the angle of the closest
        approach from the node.
    epoch : float, s
    axis : int
        Of the coordinate in whose place velocities stand.
    """

    numbers: tuple
    epoch: float
    axis: int = 0
    code = "orbit"
    kind = "instrument"

    @property
    def is_circle(self):
        return len(self.numbers) == 3

    @property
    def angles(self):
        """Names of its numbers that are angles."""
        return tuple(name for name in self.names if name.startswith(("longitude", "omega")))

    def undo(self, g, place, time, is_driven):
        """Places as they are: what is added to what is seen moves nothing."""
        return place, time

    def added(self, times, values):
        """Velocities at times of any shape, and their changes by each number, (k, ...)."""
        numbers = [values[name] for name in self.names]
        return _circle(times, self.epoch, *numbers) if self.is_circle else _ellipse(
            times, self.epoch, *numbers
        )

    def describe(self):
        period, size, *_ = self.names
        shape = "cos" if self.is_circle else "Kepler"
        return f"{size} {shape}(2 pi t / {period}) of a companion"

    @property
    def latex(self):
        """Its velocity as LaTeX; t counts from the epoch."""
        number = self.names[0][1:]
        mean = rf"2\pi t / P_{{{number}}} + \lambda_{{{number}}}"
        if self.is_circle:
            return rf"K_{{{number}}} \cos\left({mean}\right)"
        whole = rf"\cos\left(\nu_{{{number}}} + \omega_{{{number}}}\right)"
        return rf"K_{{{number}}} \left({whole} + e_{{{number}}} \cos\omega_{{{number}}}\right)"


@dataclass(frozen=True)
class Trend(Numbered):
    """A velocity along the line of sight that changes steadily: a companion far out.

    Attributes
    ----------
    numbers : tuple of Parameter
        The acceleration at the epoch; where it changes as well, also by how much.
    epoch : float, s
    """

    numbers: tuple
    epoch: float
    axis: int = 0
    code = "trend"
    kind = "instrument"

    def undo(self, g, place, time, is_driven):
        return place, time

    def added(self, times, values):
        powers = np.stack([(times - self.epoch) ** k / k for k in range(1, len(self.names) + 1)])
        return np.tensordot([values[name] for name in self.names], powers, 1), powers

    def describe(self):
        powers = zip(self.names, ("t", "t^2 / 2"), strict=False)
        return " + ".join(f"{name} {power}" for name, power in powers)

    @property
    def latex(self):
        return " + ".join((r"a\, t", r"\dot{a}\, t^2 / 2")[: len(self.names)])


def velocity_of(law):
    """A velocity along the line of sight under a law, as text and as LaTeX."""
    parts = [part for part in law.frame if isinstance(part, Orbit | Trend)]
    text = " + ".join(["v = V", *(part.describe() for part in parts)])
    return text, " + ".join(["v = V", *(part.latex for part in parts)])


def _circle(times, epoch, period, size, longitude):
    turn = 2 * math.pi * (times - epoch) / period
    cos, sin = np.cos(turn + longitude), np.sin(turn + longitude)
    return size * cos, np.stack([size * sin * turn / period, cos, -size * sin])


def _ellipse(times, epoch, period, size, longitude, eccentricity, omega):
    turn = 2 * math.pi * (times - epoch) / period
    anomaly = eccentric_anomaly(turn + longitude - omega, eccentricity)
    cos, sin, flat = np.cos(anomaly), np.sin(anomaly), math.sqrt(1 - eccentricity**2)
    near = 1 - eccentricity * cos
    cos_nu, sin_nu = (cos - eccentricity) / near, flat * sin / near
    cos_w, sin_w = math.cos(omega), math.sin(omega)
    shape = cos_nu * cos_w - sin_nu * sin_w + eccentricity * cos_w
    across = sin_nu * cos_w + cos_nu * sin_w  # of the argument of latitude
    by_mean = -across * flat / near**2  # the true anomaly by the mean one is flat / near^2
    by_shape = cos_w - across * sin_nu * (1 / near + 1 / flat**2)
    by_angle = -across - eccentricity * sin_w
    return size * shape, np.stack([
        -size * by_mean * turn / period, shape, size * by_mean, size * by_shape,
        size * (by_angle - by_mean),
    ])  # fmt: skip
