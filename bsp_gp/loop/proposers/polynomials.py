"""Forces that are sums of powers: wells, springs that harden, fed swings, orbits that turn.

What drives one body to and fro, or about a point, need be no form of a textbook, but can be
expanded. Moments are linear in the coefficients, so that sets of powers are chosen as a whole
(sparse regression in weak form; Brunton et al. 2016, Messenger and Bortz 2021): of coordinates
about the origin, on a line about a place that is fitted, and of the distance to such a place.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.optimize import minimize, minimize_scalar

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.ranged import RangedForces
from bsp_gp.inference.priors import Prior
from bsp_gp.language.formula import Call, Constant, Input, Number, product, substitute
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.periods import coordinate_of, wave_beside, waves_alone
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.inner import PLACE
from bsp_gp.search.subsets import best_subsets

HIGHEST, HIGHEST_IN_PLANE, HIGHEST_OF_DRAG = 5, 3, 2
"""Powers of the place on a line, in a plane, and of the place by which a drag changes."""
LARGEST, LARGEST_ABOUT, BEAM = 5, 3, 100
"""Powers in one sum, and in one about a centre; and sums that are extended."""
NEW = 2
"""What makes a sum no law of the grammar: one power of a coordinate, two of a distance."""
MOST = 2
"""Sums of each size about one place that are proposed."""
SHAKEN = 1.5
"""Reduced chi-squared beyond which a push with a period is asked for beside all powers."""
REACH = 3.0
"""Times what the best sum leaves that others may leave to be proposed."""
SEPARATE = 0.02
"""Part of a power that must lie beside the law, and beside a wave, to count as its own."""
FAR = 2.0
"""Extents of the tracks from the origin at which powers are still taken about it."""
PLACES, ACROSS = 41, 5
"""Places within the tracks at which odd powers are tried; and centres along every axis."""
OF_DISTANCE = (-5, -4, -3, -2, -1, 0, 1, 2, 3)
"""Powers of the distance to a centre."""
LOWEST = -8.0
"""Of one that is fitted."""
MOST_LOOKS = 100
"""Centres that are tried near the best of these."""


class Polynomials:
    """Sums of powers of place and speed, for a body that moves alone, as a proposer."""

    name = "polynomials"
    is_alone = False

    def propose(self, view):
        """The family of the likeliest sums, where no law of the grammar explains all."""
        axes = np.flatnonzero(np.isfinite(view.fit.noise.levels))
        is_lone = all(len(scene.dynamic) == 1 for scene in view.dataset.scenes)
        if not is_lone or view.is_sky or not len(axes):
            return Family(self.name)
        left = view.left @ view.left - view.explained
        if stats.chi2.sf(left, max(view.n_left, 1)) > view.criteria.alpha:
            return Family(self.name)
        libraries, extents = [], [_extent(view, axis) for axis in axes]
        is_flat = len(axes) <= 2
        if is_flat and all(max(abs(low), abs(high)) < FAR * (high - low) for low, high in extents):
            libraries.append(_about_origin(view, axes))
        if len(axes) == 1:
            libraries.append(_about_a_place(view, axes[0], *extents[0]))
        else:
            libraries.append(_about_a_centre(view, axes, extents))
        found, alone = [], None
        for library in filter(None, libraries):
            found += _sums(view, library)
            if _left_by(view, library.columns) > SHAKEN * view.n_left:
                alone = waves_alone(view) if alone is None else alone
                wave = wave_beside(view, library.columns, alone)
                found += _sums(view, library, wave) if wave is not None else []
        least = min((loss for loss, *_ in found), default=0.0)
        near = [each for _, *each in found if _ <= REACH * least]
        proposals = [p for each in near for p in _proposals(view, *each)]
        proposals.sort(key=lambda p: -p.promise)
        return Family(self.name, tuple(proposals), n_tried=len(found))


@dataclass(frozen=True, eq=False)
class _Library:
    """Powers, and their moments beside the law.

    Attributes
    ----------
    formulas : tuple of Formula
        Without their coefficients.
    news : ndarray of int, shape (c,)
        How much each adds to what no grammar has, of which a sum needs `NEW`.
    columns : ndarray, shape (n, c)
    places : tuple of Parameter
        Coordinates of the place about which they are taken, which are in them by their names.
    at : tuple of float
        Where that is.
    freed : dict of Formula to (Formula, int)
        Powers of a distance with a constant in the place of the power, and what that was.
    """

    formulas: tuple
    news: np.ndarray
    columns: np.ndarray
    places: tuple = ()
    at: tuple = ()
    freed: dict = field(default_factory=dict)


def _about_origin(view, axes):
    """Powers of the coordinates."""
    types = dataset_types(view.dataset)
    coordinates = [coordinate_of(types, axis) for axis in axes]
    highest = HIGHEST if len(axes) == 1 else HIGHEST_IN_PLANE
    return _library(view, _rows(view, coordinates, highest))


def _about_a_place(view, axis, low, high):
    """Odd powers about the place on a line where these explain most."""
    coordinate, direction = coordinate_of(dataset_types(view.dataset), axis)
    name = fresh_name(view.fit.law, f"h_{'xyz'[axis]}")
    shifted = Call("sub", coordinate, Constant(name))
    rows = _rows(view, [(shifted, direction)], HIGHEST, is_odd=True)
    placed = _Placed(view, rows, (name,), ((low, high),), coordinate.type.unit)
    line = np.linspace(low, high, PLACES)
    best = line[int(np.argmin([placed.unexplained((at,)) for at in line]))]
    step = line[1] - line[0]
    near = (best - step, best + step)
    found = minimize_scalar(lambda at: placed.unexplained((at,)), bounds=near, method="bounded")
    return placed.library((found.x,))


def _about_a_centre(view, axes, extents):
    """Powers of the distance to the point where these explain most."""
    types = dataset_types(view.dataset)
    names = tuple(fresh_name(view.fit.law, f"{PLACE}{'xyz'[axis]}") for axis in axes)
    way, origin = None, Input("origin", types["origin"])
    for name, axis in zip(names, axes, strict=True):
        _, direction = coordinate_of(types, axis)
        origin = Call("add", origin, Call("mul", Constant(name), direction))
    way = Call("sub", origin, Input("p_i", types["p_i"]))
    distance, towards = Call("norm", way), Call("normalize", way)
    rows = [(product([_power(distance, k), towards]) if k else towards, 1) for k in OF_DISTANCE]
    power = Constant(fresh_name(view.fit.law, "n"))
    free = product([Call("pow", distance, power), towards])
    freed = {formula: (free, k) for (formula, _), k in zip(rows, OF_DISTANCE, strict=True)}
    rows += [(coordinate_of(types, axis)[1], 0) for axis in axes] + _drags(view, axes)
    placed = _Placed(view, rows, names, tuple(extents), STATE_INPUTS["p_i"].unit)
    lines = [np.linspace(*extent, ACROSS + 2)[1:-1] for extent in extents]
    grid = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, len(axes))
    best = grid[int(np.argmin([placed.unexplained(at) for at in grid]))]
    found = minimize(
        placed.unexplained, best, method="Nelder-Mead", options={"maxfev": MOST_LOOKS, "xatol": 0.0}
    )  # fmt: skip
    library = placed.library(found.x)
    return library and replace(library, freed=freed)


class _Placed:
    """A library about a place that is sought.

    Parameters
    ----------
    rows : list of (Formula, int)
        Powers, and how much of each is new, as a library has it.
    names : tuple of str
        Coordinates of the place.
    extents : tuple of (float, float)
        Within which they lie.
    unit : Unit
        Of them.
    """

    def __init__(self, view, rows, names, extents, unit):
        self.view, self.rows, self.unit, self.names = view, rows, unit, names
        self.places = tuple(
            Parameter(name, low=low, high=high, prior=Prior("uniform", low, high))
            for name, (low, high) in zip(names, extents, strict=True)
        )
        self.target = float(view.left @ view.left)

    def library(self, at):
        """The powers about a place; None where none is left beside the law."""
        at = tuple(map(float, at))
        here = {Constant(n): Number(x, self.unit) for n, x in zip(self.names, at, strict=True)}
        found = _library(self.view, self.rows, here)
        return found and replace(found, places=self.places, at=at)

    def unexplained(self, at):
        """What is left by all powers about a place."""
        is_within = all(p.low <= x <= p.high for p, x in zip(self.places, at, strict=True))
        known = self.library(at) if is_within else None
        return _left_by(self.view, known.columns) if known else self.target


def _rows(view, coordinates, highest, is_odd=False):
    """Powers of coordinates along every axis, and drags that change with them."""
    powers = range(highest + 1)
    degrees = [(a, b) for a in powers for b in powers if a + b <= highest]
    degrees = degrees if len(coordinates) > 1 else [(a,) for a in powers]
    own = [each for each in degrees if not is_odd or each[0] % 2]
    rows = [
        (product([*_factors(coordinates, each), direction]), 2 * (sum(each) > 1))
        for _, direction in coordinates for each in own
    ]  # fmt: skip
    velocity = Input("v_i", STATE_INPUTS["v_i"])
    for each in degrees:
        is_even = not is_odd or not each[0] % 2
        if 0 < sum(each) <= HIGHEST_OF_DRAG and is_even:
            rows.append((product([*_factors(coordinates, each), velocity]), 2))
    return rows + _drags(view, coordinates)


def _drags(view, axes):
    """What brakes, or turns a body aside, everywhere alike."""
    velocity = Input("v_i", STATE_INPUTS["v_i"])
    mass = Input("m_i", dataset_types(view.dataset)["m_i"])
    rows = [velocity, Call("mul", Call("norm", velocity), velocity),
            product([mass, Call("normalize", velocity)])]  # fmt: skip
    rows += [Call("perp", velocity)] * (len(axes) == 2 and view.dataset.n_dims == 2)
    return [(row, 0) for row in rows]


def _library(view, rows, at=None):
    """The powers that the law does not take up; None where none is left."""
    formulas, news, columns = [], [], []
    for formula, new in rows:
        try:
            column = view.force_columns([substitute(formula, at) if at else formula])
        except EvaluationError:  # it grows beyond all numbers
            continue
        size = np.linalg.norm(column)
        beside = view.beside(column)
        if size > 0 and np.linalg.norm(beside) > SEPARATE * size:
            formulas.append(formula)
            news.append(new)
            columns.append(beside)
    if not columns:
        return None
    return _Library(tuple(formulas), np.array(news), np.concatenate(columns, axis=1))


def _factors(coordinates, powers):
    """Powers of coordinates as factors."""
    pairs = zip(coordinates, powers, strict=True)
    return [_power(coordinate, power) for (coordinate, _), power in pairs if power]


def _power(base, power):
    return base if power == 1 else Call("pow", base, Number(float(power)))


def _sums(view, library, wave=None):
    """The best sums of every size, beside a wave if there is one, as (loss, library, sum, wave)."""
    waves = view.left[:, None][:, :0] if wave is None else wave.columns
    taken = orthonormal(waves, len(waves))
    size = np.linalg.norm(library.columns, axis=0)
    beside = library.columns - taken @ (taken.T @ library.columns)
    is_own = np.linalg.norm(beside, axis=0) > SEPARATE * size
    rest = view.left - taken @ (taken.T @ view.left)
    largest = LARGEST_ABOUT if library.freed else LARGEST
    subsets = best_subsets(np.where(is_own, beside, 0.0), rest, largest, beam=BEAM)
    out = []
    for found in subsets.values():
        new = [each for each in found if library.news[list(each[1])].sum() >= NEW]
        out += [(loss, library, members, wave) for loss, members in new[:MOST]]
    return out


def _proposals(view, library, members, wave):
    """A sum, and one in which the lesser of two powers of a distance is fitted."""
    columns = library.columns[:, members]
    both = columns if wave is None else np.concatenate([columns, wave.columns], axis=1)
    size = np.linalg.norm(both, axis=0)
    size = np.where(size > 0, size, 1.0)
    amounts = np.linalg.lstsq(both / size, view.left, rcond=1e-10)[0] / size
    gain = float(view.left @ view.left - np.square(view.left - both @ amounts).sum())
    own = [library.formulas[k] for k in members]
    of_distance = [k for k, formula in enumerate(own) if formula in library.freed]
    if len(of_distance) > 1:
        least = min(of_distance, key=lambda k: abs(amounts[k]) * size[k])
        formula, power = library.freed[own[least]]
        loose = [*own[:least], formula, *own[least + 1 :]]
        (name,) = set(formula.constants) - {place.name for place in library.places}
        n = Parameter(name, low=LOWEST, high=-LOWEST, prior=Prior("uniform", LOWEST, -LOWEST))
        yield _proposal(view, library, loose, amounts, gain, wave, ((n, power),))
    yield _proposal(view, library, own, amounts, gain, wave)


def _proposal(view, library, own, amounts, gain, wave, more=()):
    """A sum of formulas as a proposal, with further constants in them and where these begin."""
    law, terms, starts = view.fit.law, [], {}
    for formula, amount in zip(own, amounts, strict=False):
        name = fresh_name(law, "c")
        term = Term(Call("mul", Constant(name), formula), "field")
        law, terms = law.plus(term, {name: float(amount)}), [*terms, term]
        starts[name] = float(amount)
    named = {name for term in terms for name in term.formula.constants}
    inner = [*zip(library.places, library.at, strict=True), *more]
    starts |= {p.name: float(at) for p, at in inner if p.name in named}
    ranges = tuple(p for p, _ in inner if p.name in named)
    hypothesis = view.hypothesis + RangedForces(ForceLaw(tuple(terms), dict(starts)), None, ranges)
    bounds, formulas, n_causes = {}, [term.formula for term in terms], len(terms)
    if wave is not None:
        hypothesis, n_causes = hypothesis + wave.part, n_causes + 1
        starts |= dict(zip(wave.names, (*amounts[-3:-1], wave.rate), strict=True))
        bounds = {wave.names[-1]: wave.bounds}
        formulas += [term.formula for term in wave.part.law.terms]
    return Proposal(
        "law", " + ".join(map(to_text, formulas)), hypothesis, -view.criteria.cause_nats * n_causes,
        gain, len(amounts) + len(ranges), starts=starts, bounds=bounds,
        formulas=tuple(formulas), n_dims=view.dataset.n_dims, is_wide=True,
    )  # fmt: skip


def _extent(view, axis):
    """Where tracks go along an axis, m."""
    places = [s.positions[:, s.dynamic, axis].ravel() for s in view.dataset.scenes]
    places = np.concatenate(places)
    return float(np.nanmin(places)), float(np.nanmax(places))


def _gain(view, columns):
    basis = orthonormal(columns, len(columns))
    return float(np.square(basis.T @ view.left).sum())


def _left_by(view, columns):
    """Chi-squared that columns leave."""
    return float(view.left @ view.left) - _gain(view, columns)
