"""Libraries of terms from which sums are chosen as a whole, and made proposals of.

Moments are linear in the coefficients of terms: of a library all sums of a few are weighed at once,
about a place that is sought, and beside a push with a period where they leave much.
"""

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.optimize import minimize_scalar

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.ranged import RangedForces
from bsp_gp.inference.priors import Prior
from bsp_gp.language.formula import Call, Constant, Input, product
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import NEW, Family, Proposal
from bsp_gp.loop.proposers.periods import coordinate_of, wave_beside, waves_alone
from bsp_gp.loop.proposers.priors import drives, edges_cost
from bsp_gp.loop.view import MOST_WEIGHTS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.subsets import best_subsets

LARGEST, BEAM = 5, 100
"""Terms in one sum, and sums that are extended."""
MOST = 2
"""Sums of each size of a library that are proposed."""
SHAKEN = 1.5
"""Reduced chi-squared beyond which a push with a period is asked for beside all terms."""
REACH = 3.0
"""Times what the best sum leaves that others may leave to be proposed."""
PLACES = 41
"""Places on a line that are tried at first."""
SETTLING = 0.05
"""Part of a line within which every sum looks for a place of its own."""
SERIES = 12.0
"""Nats against a series that may stand for a force of any form: forms of textbooks cost their inner
numbers, which coefficients of a series do not have."""
SEPARATE = 0.02
"""Part of a term that must lie beside the law, and beside a wave, to count as its own."""
LOWEST = -8.0
"""Of a power that is fitted."""
MOST_AT_ONCE = 1 << 21
"""Numbers of the accelerations that are told at once."""


def moving_axes(view):
    """Axes along which anything moves, ndarray of int."""
    return np.flatnonzero(np.isfinite(view.fit.noise.levels))


def asks_series(view):
    """Whether bodies move alone, and no law of the grammar leaves mere noise."""
    is_lone = all(len(scene.dynamic) == 1 for scene in view.dataset.scenes)
    left = view.left @ view.left - view.explained
    is_noise = stats.chi2.sf(left, max(view.n_left, 1)) > view.criteria.alpha
    return is_lone and len(moving_axes(view)) > 0 and not is_noise


def family_of(name, view, libraries, has_waves=True):
    """The likeliest sums of libraries as a family.

    Parameters
    ----------
    name : str
        Of the proposer.
    view : View
    libraries : sequence of Library
    has_waves : bool
        Whether a push with a period may act beside them.
    """
    found, alone = [], None
    for library in libraries:
        sums = sums_of(view, library)
        found += [settled(each) for each in sums] if library.placed else sums
        if has_waves and left_by(view, library.columns) > SHAKEN * view.n_left:
            alone = waves_alone(view) if alone is None else alone
            wave = wave_beside(view, library.columns, alone)
            found += sums_of(view, library, wave) if wave is not None else []
    # What noise leaves is no reason against a shorter sum, whatever longer ones take off that.
    reach = max(REACH * min((loss for loss, *_ in found), default=0.0), view.n_left)
    near = [each for loss, *each in found if loss <= reach]
    proposals = [p for each in near for p in _proposals(view, *each)]
    proposals.sort(key=lambda p: -p.promise)
    return Family(name, tuple(proposals), n_tried=len(found), is_led=True)


@dataclass(frozen=True, eq=False)
class Library:
    """Terms, and their moments beside the law.

    Attributes
    ----------
    formulas : tuple of Formula
        Without their coefficients.
    news : ndarray of int, shape (c,)
        How much each adds to what a grammar has, of which a sum needs `NEW`; see `Proposal.news`.
    columns : ndarray, shape (n, c)
    places : tuple of Parameter
        Coordinates of the place about which they are, in which their names stand for it.
    at : tuple of float
        Where that is.
    freed : dict of Formula to (Formula, int)
        Powers of a distance with a constant in the place of the power, and what that was.
    largest : int
        Terms in one sum.
    placed : Placed or None
        By which every sum has a place of its own, where that is one number: that of all terms
        together is not that of a few.
    """

    formulas: tuple
    news: np.ndarray
    columns: np.ndarray
    places: tuple = ()
    at: tuple = ()
    freed: dict = field(default_factory=dict)
    largest: int = LARGEST
    placed: object = None


class Rows:
    """Terms about places, and what of their moments the law does not take up.

    Parameters
    ----------
    rows : list of (Formula, int)
        Terms, and how much of each is new, as a library has it.
    names : tuple of str
        Constants inside them.
    """

    def __init__(self, view, rows, names=()):
        self.view, self.rows, self.names = view, rows, names
        is_moving = np.array([bool(set(names) & set(formula.constants)) for formula, _ in rows])
        regression = view.response.regression
        states = max(sum(batch.target.size for batch in regression.batches), 1)
        self.n_at_once = max(MOST_AT_ONCE // states, 1)  # terms, or places of them
        moving = np.flatnonzero(is_moving)
        self._moving = [
            (some, regression.instants([Term(rows[k][0], "field") for k in some]))
            for some in np.split(moving, range(self.n_at_once, len(moving), self.n_at_once))
            if len(some)
        ]  # fmt: skip
        self._still = np.full((len(view.left), len(rows)), np.nan)
        for k in np.flatnonzero(~is_moving):
            with suppress(EvaluationError):  # it grows beyond all numbers
                self._still[:, [k]] = view.force_columns([rows[k][0]])

    def moments(self, places):
        """Moments beside the law of all terms about places (P, k), shape (P, n, c).

        0 where the law takes a term up, or it grows beyond all numbers.
        """
        columns = np.repeat(self._still[:, None], len(places), axis=1)
        known = dict(zip(self.names, np.transpose(places), strict=True))
        for some, instants in self._moving:
            columns[..., some] = self.view.response.regression.columns_at(instants, known)
        columns = np.where(np.isfinite(columns).all(axis=0), columns, 0.0)
        flat = columns.reshape(len(columns), -1)
        beside = self.view.beside(flat)
        is_own = np.linalg.norm(beside, axis=0) > SEPARATE * np.linalg.norm(flat, axis=0)
        return np.moveaxis(np.where(is_own, beside, 0.0).reshape(columns.shape), 1, 0)

    def library(self, at=()):
        """The terms that the law does not take up; None where none is left."""
        columns = self.moments(np.reshape(at, (1, -1)))[0]
        own = np.flatnonzero(columns.any(axis=0))
        formulas, news = tuple(self.rows[k][0] for k in own), [self.rows[k][1] for k in own]
        return Library(formulas, np.array(news), columns[:, own]) if len(own) else None


class Placed:
    """A library about a place that is sought.

    Parameters
    ----------
    rows : list of (Formula, int)
        Terms, and how much of each is new, as a library has it.
    names : tuple of str
        Coordinates of the place.
    extents : tuple of (float, float)
        Within which they lie.
    """

    def __init__(self, view, rows, names, extents):
        self.view, self.names, self.extents = view, names, extents
        self.places = tuple(
            Parameter(name, low=low, high=high, prior=Prior("uniform", low, high))
            for name, (low, high) in zip(names, extents, strict=True)
        )
        lesser, _ = view.lesser(MOST_WEIGHTS)  # by which the place is sought
        self._sought = Rows(lesser, rows, names)
        self._rows = self._sought if lesser is view else Rows(view, rows, names)

    def library(self, at):
        """The terms about a place; None where none is left beside the law."""
        at = tuple(map(float, at))
        found = self._rows.library(at)
        return found and replace(found, places=self.places, at=at)

    def best_on_line(self):
        """The library where all of it explains most, of a place that is one number."""
        ((low, high),) = self.extents
        line = np.linspace(low, high, PLACES)
        best = line[int(np.argmin(self.left_at(line[:, None])))]
        return self.near(best, line[1] - line[0])

    def near(self, at, step):
        """The same within a step of a place."""
        found = minimize_scalar(
            lambda at: self.unexplained((at,)), bounds=(at - step, at + step), method="bounded"
        )
        return self.library((found.x,))

    def unexplained(self, at):
        """What is left by all terms about a place, of so many chains as are looked at."""
        return self.left_at(np.array([at]))[0]

    def left_at(self, places):
        """The same about each of places (P, k), shape (P,)."""
        sought, view = self._sought, self._sought.view
        out = np.full(len(places), float(view.left @ view.left))
        low, high = np.transpose(self.extents)
        within = np.flatnonzero(((places >= low) & (places <= high)).all(axis=1))
        n_at_once = max(sought.n_at_once // len(sought.rows), 1)
        for first in range(0, len(within), n_at_once):
            if self.view.tick is not None:
                self.view.tick()
            some = within[first : first + n_at_once]
            out[some] = [left_by(view, columns) for columns in sought.moments(places[some])]
        return out


def settled(sum_):
    """A sum of `sums_of` about the place where it explains most."""
    loss, library, members, wave = sum_
    placed, own = library.placed, [library.formulas[k] for k in members]
    if not any(set(placed.names) & set(formula.constants) for formula in own):
        return sum_
    rows = [(library.formulas[k], int(library.news[k])) for k in members]
    ((low, high),) = placed.extents
    few = Placed(placed.view, rows, placed.names, placed.extents)
    other = few.near(library.at[0], SETTLING * (high - low))
    if other is None or len(other.formulas) < len(rows):
        return sum_
    left = left_by(placed.view, other.columns)
    return (left, other, tuple(range(len(rows))), wave) if left < loss else sum_


def sums_of(view, library, wave=None):
    """The best sums of every size, beside a wave if there is one, as (loss, library, sum, wave)."""
    waves = view.left[:, None][:, :0] if wave is None else wave.columns
    taken = orthonormal(waves, len(waves))
    size = np.linalg.norm(library.columns, axis=0)
    beside = library.columns - taken @ (taken.T @ library.columns)
    is_own = np.linalg.norm(beside, axis=0) > SEPARATE * size
    rest = view.left - taken @ (taken.T @ view.left)
    subsets = best_subsets(np.where(is_own, beside, 0.0), rest, library.largest, beam=BEAM)
    out = []
    for found in subsets.values():
        news = [int(library.news[list(members)].sum()) for _, members in found]
        # What textbooks have is likelier: every further term that is new costs as a cause does.
        costs = [loss + view.criteria.cause_nats * new / NEW
                 for (loss, _), new in zip(found, news, strict=True)]  # fmt: skip
        best = [k for k in np.argsort(costs, kind="stable") if news[k] >= NEW][:MOST]
        out += [(found[k][0], library, found[k][1], wave) for k in best]
    return out


def _proposals(view, library, members, wave):
    """A sum, and one in which the lesser of two powers of a distance is fitted."""
    columns = library.columns[:, members]
    both = columns if wave is None else np.concatenate([columns, wave.columns], axis=1)
    amounts, size, gain = view.fitted_to(both)
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
    law, terms, starts, news = view.fit.law, [], {}, {}
    known = dict(zip(library.formulas, library.news.tolist(), strict=True))
    # It is one of all sums of so many terms.
    odd_nats = math.log(math.comb(len(library.formulas), len(own)))
    for formula, amount in zip(own, amounts, strict=False):
        name = fresh_name(law, "c")
        term = Term(Call("mul", Constant(name), formula), "field")
        law, terms = law.plus(term, {name: float(amount)}), [*terms, term]
        starts[name] = float(amount)
        news[term.formula] = known.get(formula, 0)
        odd_nats += view.criteria.cause_nats * drives(term.formula, float(amount))
    named = {name for term in terms for name in term.formula.constants}
    inner = [*zip(library.places, library.at, strict=True), *more]
    starts |= {p.name: float(at) for p, at in inner if p.name in named}
    ranges = tuple(p for p, _ in inner if p.name in named)
    hypothesis = view.hypothesis + RangedForces(ForceLaw(tuple(terms), dict(starts)), None, ranges)
    bounds, formulas = {}, [term.formula for term in terms]
    places = [(p.name[2], float(at)) for p, at in inner if p.name.startswith("h_")]
    edges = max(edges_cost(formula, places, view.dataset) for formula in formulas)
    n_causes = len(terms) + len(ranges) + edges  # what fades is no plain drag
    if wave is not None:
        hypothesis, n_causes = hypothesis + wave.part, n_causes + 1
        starts |= dict(zip(wave.names, (*amounts[-3:-1], wave.rate), strict=True))
        bounds = {wave.names[-1]: wave.bounds}
        formulas += [term.formula for term in wave.part.law.terms]
    proposal = Proposal(
        "law", " + ".join(map(to_text, formulas)), hypothesis,
        -view.criteria.cause_nats * n_causes - odd_nats, gain, len(amounts) + len(ranges),
        starts=starts, bounds=bounds, formulas=tuple(formulas), n_dims=view.dataset.n_dims,
        is_wide=True, news=news,
    )  # fmt: skip
    dearer = SERIES if proposal.is_series else 0.0
    return replace(proposal, log_prior=proposal.log_prior - dearer)


def drags(view, axes):
    """What brakes, or turns a body aside, everywhere alike."""
    velocity = Input("v_i", STATE_INPUTS["v_i"])
    mass = Input("m_i", dataset_types(view.dataset)["m_i"])
    rows = [velocity, Call("mul", Call("norm", velocity), velocity),
            product([mass, Call("normalize", velocity)])]  # fmt: skip
    if view.dataset.n_dims == 2:
        rows += [Call("perp", velocity)] * (len(axes) == 2)
    else:
        types = dataset_types(view.dataset)
        rows += [Call("cross", coordinate_of(types, axis)[1], velocity) for axis in range(3)]
    return [(row, 0) for row in rows]


def extent_of(view, axis):
    """Where tracks go along an axis, m."""
    places = [s.positions[:, s.dynamic, axis].ravel() for s in view.dataset.scenes]
    places = np.concatenate(places)
    return float(np.nanmin(places)), float(np.nanmax(places))


def left_by(view, columns):
    """Chi-squared that columns leave."""
    return float(view.left @ view.left) - view.gain_of(columns)
