"""What a measurement may do to places and times: parts of a hypothesis, one function each.

A function says how what is seen (x, t) is undone, as an expression: the law is then moved to seen
coordinates with exact derivatives (`bsp_gp.physics.engine.seen`). The last part is undone first.
Numbers are 0 where the measurement is as declared.
"""

from dataclasses import dataclass, replace
from functools import reduce

from bsp_gp.fitting.hypothesis import Parameter, Valued
from bsp_gp.units import DIMENSIONLESS, METRE, SECOND

LARGE = 0.3
"""A relative error or an angle beyond which nobody would believe a measurement."""
ASIDE = 1.0
"""Half widths of the picture by which the middle of a lens may be off its own."""
UNITS = {
    "drift": METRE / SECOND, "offset": METRE, "delay": SECOND, "exposure": SECOND**2,
    "shutter": SECOND / METRE, "zero": METRE, "zoom": DIMENSIONLESS / SECOND,
}  # fmt: skip
TEXTS = {
    "scale": "x = (1 + {}) X", "clock": "t = (1 + {}) T", "tilt": "x = R({}) X",
    "slant": "X - M = (1 + {}) (x - M) along the axis",
    "perspective": "X - M = (1 + {} u) (x - M)", "lens": "x - M = (1 - {} r^2) (X - M)",
    "decentred": "x - M = (1 - {} r^2) (X - M), off the middle",
    "zoom": "x - M = (1 + {} t) (X - M)",
    "drift": "x = X + ({}) t of moving bodies", "offset": "x = X + ({}) of fixed bodies",
    "delay": "x(t) = X(t - {})", "exposure": "x = X + {} / 2 X''",
    "shutter": "x(t) = X(t + {} (x - M))", "zero": "x = X - {}",
    "pivot": "X = x + asin(({})(cos x, sin x))",
}  # fmt: skip
"""What is seen of the true X and T; u and r are ways from the middle M in its sizes."""


@dataclass(frozen=True)
class Instrument(Valued):
    """One way in which a measurement may be wrong.

    Attributes
    ----------
    code : str
        Of `TEXTS`.
    axes : tuple of int
        Along which it acts.
    limit : float
        The largest value that is believed, SI.
    values : tuple of float
        Where a fit begins; none = at zero.
    whose : tuple of str
        The body of a delay; the scenes in which there is a drift, a scale or a clock, each with
        numbers of its own.
    middle, size : tuple of float, float, metres
        Of the picture; half its width.
    epoch : float, s
        When what drifts is where it should be.
    """

    code: str
    axes: tuple = ()
    limit: float = LARGE
    values: tuple = ()
    whose: tuple = ()
    middle: tuple = ()
    size: float = 1.0
    epoch: float = 0.0
    kind = "instrument"

    @property
    def names(self):
        """Of its numbers: offsets and drifts have one per axis."""
        axes = ["xyz"[k] for k in self.axes]
        marks = axes if self.code in ("drift", "offset") else ["".join(axes)]
        marks = ["across", "along"] if self.code == "pivot" else marks
        marks = ["", *axes] if self.code in ("decentred", "tangential", "zoom") else marks
        code = "decentred" if self.code == "tangential" else self.code
        return tuple(
            "_".join(filter(None, (code, mark, who)))
            for who in self.whose or ("",) for mark in marks
        )  # fmt: skip

    @property
    def lowest(self):
        """The least value that is believed; an exposure is a variance of times."""
        return 0.0 if self.code == "exposure" else -self.limit

    @property
    def parameters(self):
        unit, values = UNITS.get(self.code, DIMENSIONLESS), self.values or (0.0,) * len(self.names)
        ends = [(self.lowest, self.limit)] * len(self.names)
        if self.code == "decentred":
            ends[1:] = [(-ASIDE, ASIDE)] * len(self.axes)
        return tuple(
            Parameter(name, "", unit, *own, float(value))
            for name, own, value in zip(self.names, ends, values, strict=True)
        )

    @property
    def in_small(self):
        """What does the same while its numbers are small, and is linear in each of them.

        A lens whose middle is elsewhere bends tangentially too (Brown 1966): where that is says
        nothing while it does not bend.
        """
        return replace(self, code="tangential") if self.code == "decentred" else self

    def with_small(self, values):
        """The part by numbers of what it is `in_small`."""
        bend, *rest = map(float, values)
        if self.code == "decentred":
            rest = [max(-ASIDE, min(-number / bend, ASIDE)) if bend else 0.0 for number in rest]
        return replace(self, values=(bend, *rest))

    def undo(self, g, place, time, is_driven):
        """True place and time, nodes of a graph; `is_driven` where forces do not move a body."""
        numbers = [g.constant(name) for name in self.names]
        if self.code == "clock":
            return place, g.div(time, g.add(g.one, self.here(g, numbers)))
        if self.code in _UNDO:
            place = _UNDO[self.code](self, g, place, time, is_driven, numbers)
        return tuple(place), time

    def here(self, g, numbers):
        """The one number, or that of the scene: nothing in others."""
        if not self.whose:
            return numbers[0]
        here = (g.mul(c, g.input("is_scene", s)) for c, s in zip(numbers, self.whose, strict=True))
        return reduce(g.add, here)

    def describe(self):
        each = " in each scene" if len(self.whose) > 1 else ""
        shown = self.names[: max(len(self.axes), 1)] if each else self.names
        return TEXTS[self.code].format(", ".join(shown)) + each


def _scale(part, g, place, time, is_driven, c):
    size = g.add(g.one, part.here(g, c))
    return [g.div(x, size) for x in place]


def _tilt(part, g, place, time, is_driven, c):
    first, second = part.axes
    cos, sin, place = g.call("cos", c[0]), g.call("sin", c[0]), list(place)
    x, y = place[first], place[second]
    place[first] = g.add(g.mul(cos, x), g.mul(sin, y))
    place[second] = g.sub(g.mul(cos, y), g.mul(sin, x))
    return place


def _zero(part, g, place, time, is_driven, c):
    return [g.add(x, c[0]) if k in part.axes else x for k, x in enumerate(place)]


def _pivot(part, g, place, time, is_driven, c):
    """Angles about a point beside the pivot, by its way across and along the rest, in lengths."""
    place, (axis,) = list(place), part.axes
    x = place[axis]
    sine = g.add(g.mul(c[0], g.call("cos", x)), g.mul(c[1], g.call("sin", x)))
    cube = g.mul(sine, g.call("square", sine))  # of the arcsine, beyond what is believed to matter
    place[axis] = g.add(x, g.add(sine, g.div(cube, g.number(6.0))))
    return place


def _picture(part, g, place, time, is_driven, c):
    """Distances from the middle grow by a number, and across the picture or away from there."""
    away = [g.sub(x, g.number(m)) for x, m in zip(place, part.middle, strict=True)]
    sizes = [g.div(away[k], g.number(part.size)) for k in part.axes]
    by, axes = c[0], range(len(place)) if part.code == "perspective" else part.axes
    if part.code == "perspective":
        by = g.mul(by, sizes[0])
    elif part.code == "lens":  # what undoes 1 - c r^2: the root f of f = 1 + c r^2 f^3, by Newton
        bend = g.mul(by, g.dot(sizes, sizes))
        root = g.add(g.one, bend)
        for _ in range(3):
            square = g.mul(bend, g.call("square", root))
            above = g.sub(g.one, g.mul(g.number(2.0), g.mul(square, root)))
            root = g.div(above, g.sub(g.one, g.mul(g.number(3.0), square)))
        by = g.sub(root, g.one)
    return [g.add(x, g.mul(by, away[k])) if k in axes else x for k, x in enumerate(place)]


def _decentred(part, g, place, time, is_driven, c):
    """A lens whose middle is elsewhere."""
    by, shift = part.axes, [g.mul(g.number(part.size), number) for number in c[1:]]
    place = [g.sub(x, shift[by.index(k)]) if k in by else x for k, x in enumerate(place)]
    place = _picture(replace(part, code="lens"), g, place, time, is_driven, c[:1])
    return [g.add(x, shift[by.index(k)]) if k in by else x for k, x in enumerate(place)]


def _tangential(part, g, place, time, is_driven, c):
    """The same to first order in how far off the middle it is."""
    place = _picture(replace(part, code="lens"), g, place, time, is_driven, c[:1])
    own = [g.div(g.sub(place[k], g.number(part.middle[k])), g.number(part.size)) for k in part.axes]
    square, along = g.dot(own, own), g.mul(g.number(2.0), g.dot(own, c[1:]))
    for k, sized, aside in zip(part.axes, own, c[1:], strict=True):
        bend = g.add(g.mul(along, sized), g.mul(square, aside))
        place[k] = g.add(place[k], g.mul(g.number(part.size), bend))
    return place


def _zoom(part, g, place, time, is_driven, c):
    """A picture that grows about a place that may be off its middle."""
    late = g.sub(time, g.number(part.epoch))
    growth = g.add(g.one, g.mul(c[0], late))
    moved = dict(zip(part.axes, c[1:], strict=True))
    out = []
    for k, (x, m) in enumerate(zip(place, part.middle, strict=True)):
        away = g.sub(x, g.number(m))
        if k in moved:
            away = g.sub(away, g.mul(g.mul(g.number(part.size), moved[k]), late))
        out.append(g.add(g.div(away, growth), g.number(m)))
    return out


def _drift(part, g, place, time, is_driven, c):
    late = g.mul(g.sub(g.one, is_driven), g.sub(time, g.number(part.epoch)))
    place, n = list(place), len(part.axes)
    for k, number in enumerate(c):
        way = g.mul(number, late)
        if part.whose:
            way = g.mul(way, g.input("is_scene", part.whose[k // n]))
        place[part.axes[k % n]] = g.sub(place[part.axes[k % n]], way)
    return place


def _offset(part, g, place, time, is_driven, c):
    by = dict(zip(part.axes, c, strict=True))
    return [g.sub(x, g.mul(is_driven, by[k])) if k in by else x for k, x in enumerate(place)]


_UNDO = {
    "scale": _scale, "tilt": _tilt, "slant": _picture, "perspective": _picture, "lens": _picture,
    "decentred": _decentred, "tangential": _tangential, "zoom": _zoom, "drift": _drift,
    "offset": _offset, "zero": _zero, "pivot": _pivot,
}  # fmt: skip
