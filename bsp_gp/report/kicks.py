"""Kicks in plain words: single ones, two bodies that collide, many at once."""

import math
import re
from dataclasses import dataclass

from bsp_gp.report.numbers import format_number, rounded, with_unit

MOST_KICKS = 3
"""That are told one by one."""
FINE = 1e3
"""Times an interval that an instant may be, for three digits to tell it."""
AGAINST = -0.95
"""Cosine between the jumps of two bodies, below which these are against each other."""


def kick(effect):
    """In plain words: "a kick: the velocity of ball jumps by 0.83 m/s at 0.72 s in scene 6".

    Two bodies that are kicked at once, against each other, collide; many kicks are told together.
    """
    found = re.findall(r"(?:^kick |, )(.+?)\[(.+?), [^,\]]*\]", effect.name)
    instants = [c for c in effect.constants if c.name.startswith("t")]
    gains = [c for c in effect.constants if c not in instants]
    n_dims = len(gains) // len(instants)
    kicks = [
        _Kick(body, scene, instant, gains[k * n_dims : (k + 1) * n_dims])
        for k, ((body, scene), instant) in enumerate(zip(found, instants, strict=True))
    ]  # fmt: skip
    if len(kicks) == 2 and kicks[0].is_against(kicks[1], effect.code == "collision"):
        return _collision(*kicks)
    if len(kicks) > MOST_KICKS:
        return _many_kicks(kicks)
    what = "a kick" if len(kicks) == 1 else f"{len(kicks)} kicks"
    told = (f"of {k.body} jumps by {k.size} at {k.when} in scene {k.scene}" for k in kicks)
    return f"{what}: the velocity {', '.join(told)}"


@dataclass(frozen=True)
class _Kick:
    """One body at one instant."""

    body: str
    scene: str
    instant: object
    gains: list

    @property
    def speed(self):
        return math.hypot(*(c.value for c in self.gains))

    @property
    def size(self):
        return with_unit(format_number(self.speed, 2), self.gains[0].unit)

    @property
    def when(self):
        """With the digits that tell it: dates are large numbers that differ little."""
        c = self.instant
        if abs(c.value) < FINE * (c.high - c.low):
            return with_unit(format_number(c.value, 3), c.unit)
        value, _, _, power = rounded(c.value, c.low, c.high)
        return with_unit(value + power, c.unit)

    def is_against(self, other, have_met=False):
        """Whether another body gets a velocity the other way, at an instant that may be the same.

        Or while both are as near as ever: a soft contact lasts. Without intervals nothing is said.
        """
        one, two = self.instant, other.instant
        is_at_once = have_met or max(one.low, two.low) <= min(one.high, two.high)
        along = sum(a.value * b.value for a, b in zip(self.gains, other.gains, strict=True))
        is_opposite = along < AGAINST * self.speed * other.speed
        is_other = (self.scene, self.body) != (other.scene, other.body)
        return is_other and self.scene == other.scene and is_at_once and is_opposite


def _collision(one, two):
    """Of two bodies, with the ratio of masses by which momentum is kept."""
    ratio = format_number(one.speed / two.speed, 3)
    return (
        f"a collision of {one.body} and {two.body} at {one.when} in scene {one.scene}: velocities "
        f"jump by {one.size} and {two.size}, against each other, as where {two.body} has {ratio} "
        f"times the mass of {one.body}"
    )


def _many_kicks(kicks):
    """Of whom, how large, and when."""
    bodies = " and ".join(dict.fromkeys(f"{k.body} in scene {k.scene}" for k in kicks))
    small, large = (choose(kicks, key=lambda k: k.speed).size for choose in (min, max))
    first, last = (choose(kicks, key=lambda k: k.instant.value).when for choose in (min, max))
    return f"{len(kicks)} kicks of {bodies}: by {small} to {large}, from {first} to {last}"
