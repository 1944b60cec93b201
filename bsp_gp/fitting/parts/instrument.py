"""What a measurement may do to places and times: parts of a hypothesis, one class each.

A part says how what is seen is undone, as an expression: the law is then moved to seen coordinates
with exact derivatives (`bsp_gp.fitting.seen`). The last part of a hypothesis is undone first.
Numbers are 0 where the measurement is as declared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bsp_gp.fitting.hypothesis import Parameter, Part
from bsp_gp.units import DIMENSIONLESS, Unit

__all__ = [
    "Clock", "Delay", "Drift", "Exposure", "Instrument", "Lens", "Offset", "Perspective", "Scale",
    "Slant", "Tilt",
]  # fmt: skip

LENGTH, TIME = Unit.of(m=1), Unit.of(s=1)
LARGE = 0.3
"""A relative error or an angle beyond which nobody would believe a measurement."""


@dataclass(frozen=True)
class Instrument(Part):
    """One way in which a measurement may be wrong.

    Attributes
    ----------
    axes : tuple of int
        Along which it acts.
    limit : float
        The largest value that is believed, SI.
    values : tuple of float
        Where a fit begins; none = at zero.
    """

    axes: tuple = ()
    limit: float = LARGE
    values: tuple = ()
    kind = "instrument"
    code: ClassVar[str] = ""
    unit: ClassVar[Unit] = DIMENSIONLESS
    text: ClassVar[str] = ""
    """What is seen (x, t) of the true (X, T)."""

    @property
    def names(self):
        """Of its parameters."""
        return (f"{self.code}_{'xyz'[self.axes[0]]}",) if self.axes else (f"{self.code}_error",)

    @property
    def parameters(self):
        """One per name."""
        values = self.values or (0.0,) * len(self.names)
        return tuple(
            Parameter(name, "", self.unit, self.lowest, self.limit, float(value))
            for name, value in zip(self.names, values, strict=True)
        )

    @property
    def lowest(self):
        """The least value that is believed."""
        return -self.limit

    def at(self, values):
        """The part at other values, mapping of name to number."""
        return replace(self, values=tuple(float(values[name]) for name in self.names))

    def undo(self, g, place, time, is_driven):
        """True place and time of a body from what is seen of it.

        Parameters
        ----------
        g : Graph
        place : tuple of int
            Nodes, one per axis.
        time, is_driven : int
            Nodes; whether forces do not move the body.
        """
        return place, time

    def describe(self):
        """Formula-like."""
        return self.text.format(*self.names)


class Scale(Instrument):
    """Lengths, about the origin."""

    code, text = "scale", "x = (1 + {}) X"

    def undo(self, g, place, time, is_driven):
        """Divided by the factor."""
        return tuple(g.div(x, _more(g, self.names[0])) for x in place), time


class Clock(Instrument):
    """Times."""

    code, text = "clock", "t = (1 + {}) T"

    def undo(self, g, place, time, is_driven):
        """Divided by the factor."""
        return place, g.div(time, _more(g, self.names[0]))


class Tilt(Instrument):
    """Both axes turned about the origin; an angle."""

    code, text = "tilt", "x = R({}) X"

    @property
    def names(self):
        """Named by the plane."""
        return (f"tilt_{''.join('xyz'[k] for k in self.axes)}",)

    def undo(self, g, place, time, is_driven):
        """Turned back."""
        angle = g.constant(self.names[0])
        c, s = g.call("cos", angle), g.call("sin", angle)
        a, b = (place[k] for k in self.axes)
        true = list(place)
        true[self.axes[0]] = g.add(g.mul(c, a), g.mul(s, b))
        true[self.axes[1]] = g.sub(g.mul(c, b), g.mul(s, a))
        return tuple(true), time


@dataclass(frozen=True)
class Picture(Instrument):
    """What is told about the middle of the picture.

    Attributes
    ----------
    middle : tuple of float, metres
    size : float, metres
        Half its width.
    """

    middle: tuple = ()
    size: float = 1.0

    def _away(self, g, place):
        """From the middle, in sizes."""
        size = g.number(self.size)
        return [g.div(g.sub(x, g.number(m)), size) for x, m in zip(place, self.middle, strict=True)]

    def _grown(self, g, place, axes, strength, growth):
        """The place with the distances along axes from the middle times 1 + strength * growth."""
        factor = g.mul(g.constant(strength), growth)
        away = self._away(g, place)
        by = g.mul(factor, g.number(self.size))
        return tuple(
            g.add(x, g.mul(by, away[k])) if k in axes else x for k, x in enumerate(place)
        )


class Slant(Picture):
    """One axis is foreshortened: lengths along it differ from those along the others."""

    code, text = "slant", "X - M = (1 + {}) (x - M) along one axis"

    def undo(self, g, place, time, is_driven):
        """Stretched."""
        return self._grown(g, place, self.axes[:1], self.names[0], g.one), time


class Perspective(Picture):
    """The scale grows in proportion to the way across the picture."""

    code, text = "perspective", "X - M = (1 + {} u) (x - M)"

    def undo(self, g, place, time, is_driven):
        """Stretched by where it is along the axis."""
        along = self._away(g, place)[self.axes[0]]
        return self._grown(g, place, range(len(place)), self.names[0], along), time


class Lens(Picture):
    """Radial distortion about the middle, in the plane of the axes."""

    code, text = "lens", "X - M = (1 + {} r^2) (x - M)"

    @property
    def names(self):
        """One for all axes."""
        return ("lens_error",)

    def undo(self, g, place, time, is_driven):
        """Stretched by the distance from the middle."""
        away = self._away(g, place)
        distance = g.sum(g.call("square", away[k]) for k in self.axes)
        return self._grown(g, place, self.axes, self.names[0], distance), time


@dataclass(frozen=True)
class Drift(Instrument):
    """The origin of moving bodies moves; with `scenes`, differently in each.

    Attributes
    ----------
    epoch : float, s
        When it is at rest where it should be.
    scenes : tuple of str
    """

    epoch: float = 0.0
    scenes: tuple = ()
    code: ClassVar[str] = "drift"
    unit: ClassVar[Unit] = LENGTH / TIME

    @property
    def names(self):
        """Per axis and scene."""
        letters = ["xyz"[k] for k in self.axes]
        if not self.scenes:
            return tuple(f"drift_{k}" for k in letters)
        return tuple(f"drift_{k} of {scene}" for scene in self.scenes for k in letters)

    def undo(self, g, place, time, is_driven):
        """Moved back."""
        late = g.mul(g.sub(g.one, is_driven), g.sub(time, g.number(self.epoch)))
        true = list(place)
        for n, name in enumerate(self.names):
            axis = self.axes[n % len(self.axes)]
            way = g.mul(g.constant(name), late)
            if self.scenes:
                way = g.mul(way, g.input("is_scene", self.scenes[n // len(self.axes)]))
            true[axis] = g.sub(true[axis], way)
        return tuple(true), time

    def describe(self):
        """Formula-like."""
        return "x = X + u t of moving bodies" + (", u of each scene" if self.scenes else "")


class Offset(Instrument):
    """Where bodies that forces do not move are, against those that they do."""

    code, unit = "offset", LENGTH

    @property
    def names(self):
        """Per axis."""
        return tuple(f"offset_{'xyz'[k]}" for k in self.axes)

    def undo(self, g, place, time, is_driven):
        """Moved back."""
        true = list(place)
        for axis, name in zip(self.axes, self.names, strict=True):
            true[axis] = g.sub(true[axis], g.mul(is_driven, g.constant(name)))
        return tuple(true), time

    def describe(self):
        """Formula-like."""
        return "x = X + a of fixed bodies"


@dataclass(frozen=True)
class Delay(Instrument):
    """One body is seen late.

    Attributes
    ----------
    body : str
    """

    body: str = ""
    code: ClassVar[str] = "delay"
    unit: ClassVar[Unit] = TIME
    text: ClassVar[str] = "x(t) = X(t - {})"

    @property
    def names(self):
        """Named by the body."""
        return (f"delay_{self.body}",)

    def is_late(self, chains):
        """Which bodies are, (R, S)."""
        return np.array([[name == self.body for name in row] for row in chains.bodies]).T


class Exposure(Instrument):
    """Places are averages over a while; the variance of the times of which they are."""

    code, unit, text = "exposure", TIME**2, "x = X + {} / 2 X''"

    @property
    def names(self):
        """One for all."""
        return ("exposure",)

    @property
    def lowest(self):
        """A variance."""
        return 0.0


def _more(g, name):
    return g.add(g.one, g.constant(name))
