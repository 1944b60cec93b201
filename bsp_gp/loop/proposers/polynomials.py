"""Forces that are sums of powers: wells, springs that harden, fed swings, orbits that turn.

What drives one body to and fro, or about a point, need be no form of a textbook, but can be
expanded. Moments are linear in the coefficients, so that sets of powers are chosen as a whole
(sparse regression in weak form; Brunton et al. 2016, Messenger and Bortz 2021): of coordinates
about the origin, on a line about a place that is fitted, and of the distance to such a place. What
drives an angle is expanded in waves of a turn.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from bsp_gp.language.formula import Call, Constant, Input, Number, product
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.proposal import NEW, Family
from bsp_gp.loop.proposers.libraries import (
    Placed,
    Rows,
    asks_series,
    drags,
    extent_of,
    family_of,
    moving_axes,
)
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name, split_linear
from bsp_gp.search.inner import PLACE

HIGHEST, HIGHEST_IN_PLANE, HIGHEST_OF_DRAG = 5, 3, 2
"""Powers of the place on a line, in a plane, and of the place by which a drag changes."""
LARGEST_ABOUT = 3
"""Terms in one sum about a centre."""
ODD = NEW + 1
"""How much a term adds that no textbook has: a power beyond the third, a drag by a place."""
WAVES = {1: (1, ODD), 2: (NEW, ODD)}
"""Waves a turn of what drives an angle, and how new their sines and cosines are."""
FAR = 2.0
"""Extents of the tracks from the origin at which powers are still taken about it."""
ACROSS = 5
"""Centres along every axis that are tried at first."""
OF_DISTANCE = (-5, -4, -3, -2, -1, 0, 1, 2, 3)
"""Powers of the distance to a centre."""
MOST_LOOKS = 100
"""Centres that are tried near the best of these."""
POST_REACH, ACROSS_POSTS, BEST_POSTS = 4.0, 13, 3
"""Extents of the tracks within which a post lies, posts along every axis that are tried at first,
and of these the best, from which others are looked for."""
LARGEST_ABOUT_POSTS = 4
"""Terms in one sum about a post."""


class Polynomials:
    """Sums of powers of place and speed, for a body that moves alone, as a proposer.

    Parameters
    ----------
    laws : Laws
        Asked before in every round.
    """

    name = "polynomials"
    is_alone = False

    def __init__(self, laws):
        self.laws = laws

    def propose(self, view):
        """The family of the likeliest sums, where no law of the grammar explains all."""
        axes = moving_axes(view)
        # In pictures of the sky bodies go round others that are not seen; a satellite's places are
        # known in space, and its centre need be no point.
        if not asks_series(view) or (view.is_sky and len(axes) < 3):
            return Family(self.name)
        libraries, extents = [], [extent_of(view, axis) for axis in axes]
        is_flat = len(axes) <= 2
        if is_flat and all(max(abs(low), abs(high)) < FAR * (high - low) for low, high in extents):
            libraries.append(_about_origin(view, axes))
        if view.dataset.units.is_angle:
            libraries.append(_of_an_angle(view, axes[0]))
        if len(axes) == 1:
            libraries.append(_about_a_place(view, axes[0], *extents[0]))
        else:
            libraries.append(_about_a_centre(view, axes, extents, self._placed()))
            if not view.is_sky:  # there nothing is tied by springs
                libraries.append(_about_a_post(view, axes, extents))
        return family_of(self.name, view, [library for library in libraries if library])

    def _placed(self):
        """Laws of textbooks by which a place matters to a body alone: an oblate centre."""
        forms = [split_linear(law)[1] for law in self.laws.common]
        return [form for form in forms if "p_i" in form.inputs and "p_j" not in form.inputs]


def _about_origin(view, axes):
    """Powers of the coordinates."""
    types = dataset_types(view.dataset)
    coordinates = [coordinate_of(types, axis) for axis in axes]
    highest = HIGHEST if len(axes) == 1 else HIGHEST_IN_PLANE
    return Rows(view, _rows(view, coordinates, highest)).library()


def _of_an_angle(view, axis):
    """Waves in an angle, as weights, fields and turning frames make them: one and two a turn."""
    types = dataset_types(view.dataset)
    coordinate, direction = coordinate_of(types, axis)
    turned = Call("div", coordinate, Number(1.0, coordinate.type.unit, "1 [rad]"))
    rows = [(direction, 0), *drags(view, [axis])]
    for often, new_ones in WAVES.items():
        angle = Call("mul", Number(float(often)), turned) if often > 1 else turned
        rows += [(product([Call(wave, angle), direction]), new)
                 for wave, new in zip(("sin", "cos"), new_ones, strict=True)]  # fmt: skip
    return Rows(view, rows).library()


def _about_a_place(view, axis, low, high):
    """Odd powers about the place on a line where these explain most."""
    coordinate, direction = coordinate_of(dataset_types(view.dataset), axis)
    name = fresh_name(view.fit.law, f"h_{'xyz'[axis]}")
    shifted = Call("sub", coordinate, Constant(name))
    rows = _rows(view, [(shifted, direction)], HIGHEST, is_odd=True)
    return Placed(view, rows, (name,), ((low, high),)).best_on_line()


def _about_a_centre(view, axes, extents, placed):
    """Powers of the distance to the point where these explain most, beside what is placed."""
    types = dataset_types(view.dataset)
    names, distance, towards = _towards(view, axes)
    rows = [(product([_power(distance, k), towards]) if k else towards, 1) for k in OF_DISTANCE]
    power = Constant(fresh_name(view.fit.law, "n"))
    free = product([Call("pow", distance, power), towards])
    freed = {formula: (free, k) for (formula, _), k in zip(rows, OF_DISTANCE, strict=True)}
    rows += [(coordinate_of(types, axis)[1], 0) for axis in axes] + drags(view, axes)
    rows += [(form, 1) for form in placed]
    placed = Placed(view, rows, names, tuple(extents))
    lines = [np.linspace(*extent, ACROSS + 2)[1:-1] for extent in extents]
    grid = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, len(axes))
    best = grid[int(np.argmin(placed.left_at(grid)))]
    found = minimize(
        placed.unexplained, best, method="Nelder-Mead", options={"maxfev": MOST_LOOKS, "xatol": 0.0}
    )  # fmt: skip
    library = placed.library(found.x)
    return library and replace(library, freed=freed, largest=LARGEST_ABOUT)


def _about_a_post(view, axes, extents):
    """A spring of some length to the point where it explains most beside a weight and a drag.

    Both of its parts, one as the distance and one of constant size, are linear in what they pull
    with, so that the point alone is sought.
    """
    types = dataset_types(view.dataset)
    names, distance, towards = _towards(view, axes)
    beside = [(coordinate_of(types, axis)[1], 0) for axis in axes] + drags(view, axes)
    reach = POST_REACH * max(high - low for low, high in extents)
    wide = [((low + high) / 2 - reach, (low + high) / 2 + reach) for low, high in extents]
    loose = [(Call("mul", distance, towards), 0), (towards, 0), *beside]
    placed = Placed(view, loose, names, tuple(wide))
    lines = [np.linspace(*extent, ACROSS_POSTS) for extent in wide]
    grid = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, len(axes))
    heights = placed.left_at(grid)
    found = min((
        minimize(placed.unexplained, grid[k], method="Nelder-Mead",
                 options={"maxfev": MOST_LOOKS, "xatol": 0.0})
        for k in np.argsort(heights)[:BEST_POSTS]
    ), key=lambda each: each.fun)  # fmt: skip
    library = placed.library(found.x)
    if library is None or library.formulas[:2] != (loose[0][0], towards):
        return None
    spring, even = np.linalg.lstsq(library.columns, view.left, rcond=1e-10)[0][:2]
    length = float(-even / spring) if spring else math.nan
    if not 0 < length < reach:
        return None
    name = fresh_name(view.fit.law, "D")
    tied = Call("mul", Call("sub", distance, Constant(name)), towards)
    rows, ends = [(tied, NEW), *beside], (*wide, (0.0, reach))
    whole = Placed(view, rows, (*names, name), ends).library((*found.x, length))
    return whole and replace(whole, largest=LARGEST_ABOUT_POSTS)


def _towards(view, axes):
    """Names of the coordinates of a point, the distance to it, and the way."""
    types = dataset_types(view.dataset)
    names = tuple(fresh_name(view.fit.law, f"{PLACE}{'xyz'[axis]}") for axis in axes)
    centre = Input("origin", types["origin"])
    for name, axis in zip(names, axes, strict=True):
        _, direction = coordinate_of(types, axis)
        centre = Call("add", centre, Call("mul", Constant(name), direction))
    way = Call("sub", centre, Input("p_i", types["p_i"]))
    return names, Call("norm", way), Call("normalize", way)


def _rows(view, coordinates, highest, is_odd=False):
    """Powers of coordinates along every axis, and what brakes or turns aside by place."""
    powers = range(highest + 1)
    degrees = [(a, b) for a in powers for b in powers if a + b <= highest]
    degrees = degrees if len(coordinates) > 1 else [(a,) for a in powers]
    own = [each for each in degrees if not is_odd or each[0] % 2]
    rows = [
        (product([*_factors(coordinates, each), direction]), _news(sum(each), (2, 3)))
        for _, direction in coordinates for each in own
    ]  # fmt: skip
    velocity = Input("v_i", STATE_INPUTS["v_i"])
    for each in degrees:
        is_even = not is_odd or not each[0] % 2
        if 0 < sum(each) <= HIGHEST_OF_DRAG and is_even:
            drag = product([*_factors(coordinates, each), velocity])
            rows.append((drag, _news(max(each), (2,))))
            if len(coordinates) == view.dataset.n_dims == 2:  # a field that is not even
                across = product([*_factors(coordinates, each), Call("perp", velocity)])
                rows.append((across, _news(sum(each), (1,))))
    return rows + drags(view, coordinates)


def _news(power, known):
    """How much a term adds to what a grammar has: little where textbooks know such a power."""
    return 0 if power < min(known) and len(known) > 1 else NEW if power in known else ODD


def _factors(coordinates, powers):
    """Powers of coordinates as factors."""
    pairs = zip(coordinates, powers, strict=True)
    return [_power(coordinate, power) for (coordinate, _), power in pairs if power]


def _power(base, power):
    return base if power == 1 else Call("pow", base, Number(float(power)))
