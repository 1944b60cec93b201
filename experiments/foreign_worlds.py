"""Kinds of causes, by family, that the loop was not built for.

Every kind says where it acts, on what its strength depends, and which codes of the loop would be
near it. Two families are set aside: no number of the package may be chosen by them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import foreign_forces as f
import numpy as np

ASIDE = ("medium", "friction")
"""Families that are looked at once, at the end."""


@dataclass(frozen=True)
class Kind:
    """One foreign cause.

    Attributes
    ----------
    family, layout : str
    strength : float
        At which its signal-to-noise ratio is about ten.
    build : callable
        ``build(strength, rng) -> force``, with ``force(at)`` in newtons.
    varies : tuple of str
        On what its strength depends, of `VARIABLES`.
    properties : tuple of str
        That the data show.
    has_space : bool
        Whether some sets are in three dimensions.
    near : tuple of str
        Codes of causes that are near it, beside laws that act in its direction.
    """

    family: str
    layout: str
    strength: float
    build: Callable
    varies: tuple
    properties: tuple = ("mass",)
    has_space: bool = False
    near: tuple = ()

    @property
    def is_aside(self):
        return self.family in ASIDE


def _kind(family, layout, strength, build, *varies, **more):
    return Kind(family, layout, strength, build, varies, **more)


_ODD = {"properties": ("mass", "charge", "spin")}
_CHARGED = {"properties": ("mass", "charge")}
_SPACE = {"has_space": True}

KINDS = {
    "speed to the 1.5": _kind("drag", "thrown", 0.0016, f.drag(lambda at: at.speed**1.5), "speed"),
    "speed to the 2.6": _kind(
        "drag", "thrown", 0.00018, f.drag(lambda at: at.speed**2.6), "speed", **_SPACE),
    "speed to the 0.5": _kind("drag", "sliding", 0.0021, f.drag(lambda at: at.speed**0.5), "speed"),
    "saturating drag": _kind(
        "drag", "thrown", 0.0094, f.drag(lambda at: at.speed / (1 + at.speed / 2)), "speed",
        **_SPACE),
    "rising then falling drag": _kind(
        "drag", "sliding", 0.0007, f.drag(lambda at: at.speed / (0.2 + at.speed**2)), "speed"),
    "thin air above": _kind(
        "medium", "thrown", 0.0005, f.drag(lambda at: at.speed**2 * np.exp(-at.p[:, -1:] / 2)),
        "y", "speed"),
    "drag in a window": _kind("medium", "sliding", 0.016, f.in_window, "x", "speed"),
    "drag near a wall": _kind("medium", "sliding", 0.0021, f.near_wall, "x", "speed"),
    "growing drag": _kind(
        "time", "thrown", 0.0042, f.drag(lambda at: at.speed * at.t / at.span), "time", "speed"),
    "fading push": _kind(
        "time", "sliding", 0.0041,
        f.push(lambda at, a: np.exp(-at.t / (0.1 + 0.3 * a[0]) / at.span)), "time"),
    "push from some time on": _kind(
        "time", "sliding", 0.0041,
        f.push(lambda at, a: f.edge(at.t / at.span - 0.3 - 0.4 * a[0], 0.03), is_oblique=True),
        "time"),
    "chirp": _kind(
        "time", "sliding", 0.013,
        f.push(lambda at, a: np.sin(6 * a[0] + at.t * (3 + 2 * a[1] + 2 * at.t))), "time"),
    "shear": _kind(
        "place", "sliding", 0.0013, f.push(lambda at, a: at.p[:, 1:2] - a[0]), "y", **_SPACE),
    "hill": _kind(
        "place", "sliding", 0.0026, f.hill, "x", "y", "distance", near=("hidden_body",)),
    "corrugation": _kind(
        "place", "sliding", 0.0021, f.push(lambda at, a: np.sin(6 * a[0] + 5 * at.p[:, :1])), "x"),
    "drag along one axis": _kind("direction", "sliding", 0.001, f.by_axis, "speed", **_SPACE),
    "drag along a grain": _kind("direction", "thrown", 0.0018, f.by_grain, "speed"),
    "lift of an odd power": _kind("direction", "thrown", 0.0009, f.lift, "speed"),
    "late drag": _kind("history", "sliding", 0.0021, f.Lagged, "time", "speed"),
    "Basset drag": _kind("history", "thrown", 0.0006, f.Basset, "time", "speed", **_SPACE),
    "Maxwell spring": _kind("history", "tied", 0.014, f.Maxwell, "time", "speed"),
    "spring with a cube": _kind(
        "spring", "tied", 0.017, f.spring(lambda c, at: c * f.length(at) ** 2), "distance",
        **_SPACE),
    "spring on one side": _kind("spring", "tied", 0.019, f.one_sided, "x", "distance"),
    "saturating spring": _kind(
        "spring", "tied", 0.045, f.spring(lambda c, at: c / (1 + 4 * f.length(at) ** 2)),
        "distance"),
    "softened pull": _kind("pull", "orbiting", 0.19, f.pull(f.softened), "distance"),
    "Yukawa": _kind(
        "pull", "orbiting", 0.006,
        f.pull(lambda c, r, at: c * (1 + r / 12) * np.exp(-r / 12) / r**2), "distance", **_SPACE),
    "pull of an odd power": _kind(
        "pull", "orbiting", 0.0006, f.pull(lambda c, r, at: c * r**-1.4), "distance"),
    "retarded pull": _kind("pull", "trio", 0.001, f.retarded, "distance", "speed"),
    "three bodies at once": _kind("pair", "trio", 0.005, f.three_bodies, "distance"),
    "chase": _kind("pair", "charged", 0.008, f.chase, "body", **_CHARGED),
    "drag of neighbours": _kind("pair", "charged", 0.08, f.viscous_pair, "distance", **_CHARGED),
    "swirl": _kind("pair", "charged", 0.05, f.swirl, "distance", **_CHARGED),
    "drag with the cube root of mass": _kind(
        "property", "thrown", 0.005, f.drag(lambda at: np.cbrt(at.m) * at.speed), "body", "speed"),
    "drag with the root of charge": _kind(
        "property", "thrown", 0.0003,
        f.drag(lambda at: np.sqrt(at.props["charge"]) * at.speed**2), "body", "speed", **_ODD),
    "push with an odd mix": _kind(
        "property", "sliding", 0.0012,
        f.push(lambda at, a: at.props["spin"] ** 1.5 * np.cbrt(at.m)), "body", **_ODD),
    "parametric spring": _kind("driving", "tied", 0.01, f.parametric, "time", "distance"),
    "losing mass": _kind("driving", "tied", 0.011, f.losing_mass, "time", "distance"),
    "two tones": _kind(
        "driving", "sliding", 0.003,
        f.push(lambda at, a: np.sin(3.1 * at.t + 6 * a[0]) + np.sin(7.3 * at.t + 6 * a[1]), True),
        "time"),
    "spun-up frame": _kind("frame", "sliding", 0.002, f.spun_up, "time", "speed", "x", "y"),
    "shaken table": _kind("frame", "sliding", 0.015, f.shaken, "time"),
    "rocked table": _kind("frame", "thrown", 0.016, f.rocked, "time"),
    "unseen body on an odd path": _kind(
        "unseen", "orbiting", 0.05, f.odd_path, "time", "x", "y", near=("hidden_body",)),
    "unseen flyby": _kind(
        "unseen", "sliding", 0.018, f.flyby, "time", "x", "y", near=("hidden_body",)),
    "Stribeck": _kind(
        "friction", "sliding", 0.0022,
        f.drag(lambda at: at.m * (1 + 2 * np.exp(-(at.speed / 0.4) ** 2))), "speed"),
    "friction that lets go": _kind(
        "friction", "sliding", 0.023, f.drag(lambda at: at.m / np.cosh(at.speed / 0.5)), "speed"),
    "friction with a memory": _kind(
        "friction", "sliding", 0.0023, f.StateFriction, "time", "speed"),
    "many kicks": _kind("kicks", "sliding", 0.003, f.kicks(30), "time", near=("noise", "kicks")),
    "three kicks": _kind(
        "kicks", "sliding", 0.004, f.kicks(3), "time", near=("noise", "contact", "kicks")),
}  # fmt: skip
