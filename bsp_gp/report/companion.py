"""A companion that is told by velocities along the line of sight alone, in words."""

import math
import re

from scipy.optimize import brentq

from bsp_gp.data.ephemeris import GRAVITATIONAL_CONSTANT
from bsp_gp.errors import UnitError
from bsp_gp.report.numbers import format_number, format_value
from bsp_gp.units import parse_unit

_MASSES = (("Msun", 0.08), ("Mjup", 0.1), ("Mearth", 0.0))
"""Units of masses, and how much of one there must be to be told in it."""


def companion_of(effect):
    """Its period, how fast it makes the star go, the shape of the orbit, and the least mass."""
    known: dict = {}
    for c in effect.constants:
        if found := re.fullmatch(r"(P|K|e)(\d+)", c.name):
            known.setdefault(found[2], {})[found[1]] = c
    whole = [own for own in known.values() if {"P", "K"} <= set(own)]
    seen = [own for own in whole if own["K"].low > 0]  # others have become superfluous
    told = [_orbit(own["P"], own["K"], own.get("e")) for own in seen or whole]
    if not told:
        return effect.name
    bent = any(c.name.startswith("trend") for c in effect.constants)
    beside = " beside a velocity that goes on changing, as one far out makes it" if bent else ""
    return f"an unseen companion {' and another '.join(told)}{beside}"


def _orbit(period, size, eccentricity):
    shape = "on a circle"
    if eccentricity is not None:
        low, high = max(eccentricity.low, 0.0), min(eccentricity.high, 1.0)
        shape = f"of eccentricity {format_value(eccentricity.value, low, high)}"
    told = [
        f"velocity up to {format_value(size.value, size.low, size.high, size.unit)}", shape,
        _least_mass(period, size, eccentricity),
    ]  # fmt: skip
    length = format_value(period.value, period.low, period.high, period.unit)
    return f"with a period of {length} ({'; '.join(filter(None, told))})"


def _least_mass(period, size, eccentricity):
    """Mass times the sine of the inclination, beside a star like the sun; "" without units."""
    try:
        (second, _), (speed, _) = parse_unit(period.unit), parse_unit(size.unit)
    except UnitError:
        return ""
    flat = math.sqrt(1 - min(eccentricity.value, 0.999) ** 2) if eccentricity is not None else 1.0
    motion = abs(size.value) * speed * flat
    function = period.value * second * motion**3 / (2 * math.pi * GRAVITATIONAL_CONSTANT)
    sun = parse_unit("Msun")[0]
    if not 0 < function < 1e3 * sun:
        return ""
    mass = brentq(lambda m: m**3 - function * (sun + m) ** 2, 0.0, 2e3 * sun)
    unit, kilograms = next(
        (u, parse_unit(u)[0]) for u, least in _MASSES if mass >= least * parse_unit(u)[0]
    )
    return (
        f"mass times sin i {format_number(mass / kilograms, 2)} {unit} if the star has 1 Msun; "
        f"mass function {format_number(function / sun, 3)} Msun"
    )
