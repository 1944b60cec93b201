"""Laws with constants inside, scored on grids over these: exponents, lengths, thresholds, places.

The forms stand in the grammar, with the quantity of the data among whose values each constant lies.
Strengths are projected out (variable projection, Golub and Pereyra 1973): what a form explains is a
function of its inner constants alone. It is scored on a grid, and where it does best on finer ones.
"""

import re
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import product as every

import numpy as np

from bsp_gp.errors import BspError, GrammarError
from bsp_gp.language.formula import Call, Constant, Input, Number, evaluate, substitute, walk
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.operators import Type, is_across_in
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types, law_inputs
from bsp_gp.physics.evaluation import Settling
from bsp_gp.physics.force import Term, kind_of, split_linear
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.recognition import CACHE_BYTES, BoundedCache

N_POINTS, N_ACROSS, N_PLACES, N_LINE = 12, 8, 300, 40
"""Values of a constant that is alone inside, of each of several; places, and along an axis."""
BEYOND = 12.0
"""Times that a length may be shorter than the shortest in the data, or longer than the longest."""
COARSE = 2
"""Times as coarse that grids are for laws that are drawn, of which there are many."""
FEWEST_VALUES = 4
"""Values of a property from which a power of it is fitted: two tell it, two more check it."""
MOST_INNER = 3
"""Inner constants of a law that was drawn; coordinates of a place count each."""
FARTHEST = 30.0
"""Places are sought up to so many sizes of the data from their middle."""
ZOOMS, CLOSER = 5, 3.0
"""Finer grids about the best, and how much finer each is."""
SAME = 1e-9
"""Part of a gain by which two forms that are one on these data may differ."""
MOVES, LITTLE = 6, 1e-3
"""Times that a finer grid moves along, and the part of a gain that is worth it."""
MOST_PEAKS = 3
"""Places on the first grid that are looked at more closely."""
CHUNK = 1 << 19
"""Numbers in one array at a time."""
CENTRE, MIDDLE = (Input(name, STATE_INPUTS["p_i"]) for name in ("centre", "middle"))
ABOUT = "about "
"""Before a quantity whose values reach as far beyond those of the data as these are apart."""
PLACE = "centre_"
"""How names of the coordinates of a place begin."""
LEAST_BESIDE = 1e-4
"""Part of a form, squared, that must lie beside what constants of the law take up: from far away,
or over lengths beyond the tracks, every form is a push and a spring."""


@dataclass(frozen=True, eq=False)
class Form:
    """A law with constants inside and without its strength.

    Attributes
    ----------
    term : Term
        Its inner constants, and the place ``centre``, are what is sought.
    nats : float
        What it costs beforehand that it is one of several forms.
    """

    term: Term
    nats: float


@dataclass(frozen=True)
class Axis:
    """The range of one inner constant, in the coordinate in which it is even.

    Attributes
    ----------
    low, high : float
        In that coordinate.
    cauchy : tuple of float or None
        Centre and scale of where a place is likely, whose range has no end.
    """

    name: str
    low: float
    high: float
    is_log: bool = False
    cauchy: tuple | None = None

    def values(self, coordinates):
        """The constant at coordinates."""
        return np.exp(coordinates) if self.is_log else coordinates

    def coordinate(self, value):
        """The coordinate of a value of the constant."""
        return np.log(value) if self.is_log else value

    @property
    def spacing(self):
        """The distance of neighbours on a grid."""
        return self.line(N_POINTS)[N_POINTS // 2, 1]

    def line(self, count):
        """Coordinates that are even under the prior, and their spacing, shape (count, 2)."""
        share = (np.arange(count) + 0.5) / count
        if self.cauchy is None:
            step = (self.high - self.low) / count
            return np.stack([self.low + share * (self.high - self.low), np.full(count, step)], 1)
        widest = np.arctan(FARTHEST)
        line = np.tan(widest * (2 * share - 1))
        step = (1 + np.square(line)) * 2 * widest / count
        return np.stack([self.cauchy[0] + self.cauchy[1] * line, self.cauchy[1] * step], axis=1)


@dataclass(frozen=True, eq=False)
class Scan:
    """What a form explains.

    Attributes
    ----------
    axes : tuple of Axis
    gain : float
        Greatest on the first grid.
    null : ndarray, shape (B,)
        The same of every draw of noise.
    volume : float
        Logarithm of the part of the grid that the data leave.
    best : float
        Greatest, as far as it was looked for.
    at, spacing : ndarray, shape (k,)
        Coordinates of that, and the distance to its neighbours on the grid.
    peaks : sequence of ndarray, shape (k, 2)
        Where on the grid it may be, with the distance to neighbours there.
    ties : list of Scan
        That are the same on these data.
    found : tuple of Scan
        The best near every peak, once it was looked for.
    """

    form: Form
    axes: tuple
    n_points: int
    gain: float
    null: np.ndarray
    volume: float
    best: float
    at: np.ndarray
    spacing: np.ndarray
    peaks: tuple
    ties: list = field(default_factory=list)
    found: tuple = ()

    @property
    def promise(self):
        """Log posterior up to what all forms share, nats."""
        return 0.5 * self.best + self.volume - self.form.nats

    def is_like(self, other):
        """Whether two forms are the same on these data."""
        return abs(self.best - other.best) <= SAME * self.best and self.axes == other.axes


def read_forms(grammar, dataset, properties, available):
    """The forms of a grammar of which a data set has all inputs.

    Parameters
    ----------
    properties : sequence of str
        Short names of properties that may stand for ``{0}``.
    available : set of str
        Inputs that laws may use.

    Raises
    ------
    GrammarError
        If a form is no force, or one of its constants has no range.
    """
    table = grammar.inside
    planes = () if dataset.n_moving_axes == 1 else table.get("planes", ())
    types = dataset_types(dataset) | {node.name: node.type for node in (CENTRE, MIDDLE)}
    available = available | {"t", "origin", "centre", "middle"}
    lists = {**table, "0": properties}
    forms = []
    for part in (table.get("common", ()), (*table.get("laws", ()), *planes)):
        own = {}
        texts = (e for text in part for e in expanded(text, lists))
        for each, formula in sayable(texts, types, dataset.units, available):
            if is_across_in(each, dataset.n_dims) and _are_told(formula, dataset):
                _check(formula, each, table.get("ranges", {}))
                own[formula] = None
        forms += [Form(Term(f, kind_of(f)), float(np.log(len(own)))) for f in own]
    return forms


def _are_told(formula, dataset):
    """Whether the properties of which it has fitted powers have values enough to tell these."""
    for node in walk(formula):
        if isinstance(node, Call) and node.operator == "pow" and node.args[1].constants:
            columns = {name[0] for name in map(property_of, node.args[0].inputs) if name}
            if any(_n_values(dataset, column) < FEWEST_VALUES for column in columns):
                return False
    return True


def _n_values(dataset, column):
    """Values of a property that are known and not zero; a vector is none."""
    found = (e.properties.get(column) for s in dataset.scenes for e in s.entities)
    known = {value for value in found if isinstance(value, (int, float)) and np.isfinite(value)}
    return len(known - {0.0})


def _check(formula, text, ranges):
    """Refuse a form that cannot be scanned."""
    lost = [n for n in formula.constants if n not in ranges and not n.startswith(PLACE)]
    if lost:
        raise GrammarError(
            f"[inside] {text!r}: constant {lost[0]!r} has no range; give it under [inside.ranges]"
        )
    if formula.type.shape != "vector" or not (formula.constants or "centre" in formula.inputs):
        raise GrammarError(
            f"[inside] {text!r} must be a vector with constants inside, without its strength"
        )


def sayable(texts, types, units, available):
    """Of texts of forms those that name nothing but what is available, each with its formula."""
    for text in texts:
        try:
            formula = parse_formula(text.removeprefix("1 * "), types, units=units)
        except BspError:  # it names what these data do not have
            continue
        if formula.inputs <= available:
            yield text, formula


def expanded(text, lists):
    """A text with every name in braces replaced by each text of its list."""
    match = re.search(r"\{(\w+)\}", text)
    if match is None:
        return [text]
    texts = lists.get(match[1], ())
    return [e for each in texts for e in expanded(text.replace(match[0], each), lists)]


class InnerSearch:
    """Scores of forms on a regression.

    Parameters
    ----------
    target, draws : ndarray, shapes (n,) and (n, B)
        What is to be explained, and simulated noise, beside what constants of the law take up.
    beside : callable
        ``beside(columns)`` projects columns (n, c) in the same way.
    moving : ndarray of bool, shape (d,)
        Axes along which something is seen.
    ranges : mapping of str to str
        Of the grammar.
    types : mapping of str to Type
        Inputs of the data.
    """

    def __init__(self, regression, target, draws, beside, moving, ranges, types):
        self.batches, self.target, self.draws = regression.batches, target, draws
        self.beside, self._texts = beside, ranges
        self._types = types | {node.name: node.type for node in (CENTRE, MIDDLE)}
        self.axes = ["xyz"[k] for k in np.flatnonzero(moving)]
        rows = np.concatenate([
            b.positions[:, :, b.bodies.receivers][b.valid.any(axis=-1)] for b in self.batches
        ])  # fmt: skip
        self.size = float(np.max(np.ptp(rows, axis=0))) / 2 or 1.0
        grain = 10.0 ** np.floor(np.log10(self.size / 10))
        self.span = rows.min(axis=0), rows.max(axis=0)
        self.middle = np.round((self.span[0] + self.span[1]) / 2 / grain) * grain
        self._known, self._lookups, self._placed, self._cached = {}, {}, {}, {}
        self._scanned, self._alike = {}, {}

    def of_target(self, target):
        """The same for another target, beside what constants take up."""
        other = copy(self)
        other.target, other._scanned = target, {}
        return other

    def besides(self, columns):
        """The same beside further moments (n, c)."""
        q, own = orthonormal(columns, len(self.target)), self.beside
        other = copy(self)
        other.beside = lambda some: (rest := own(some)) - q @ (q.T @ rest)
        other.target, other.draws = (some - q @ (q.T @ some) for some in (self.target, self.draws))
        other._scanned = {}
        return other

    def of_part(self, regression, rows, beside):
        """The same of a part of the regression, whose moments stand at `rows` among all."""
        other = copy(self)
        other.batches, other.beside = regression.batches, beside
        other.target, other.draws = beside(self.target[rows]), beside(self.draws[rows])
        other._lookups, other._cached, other._scanned = {}, {}, {}
        return other

    def anew(self, scan):
        """A scan of a part with what its best explains here."""
        return self._best_near(scan, scan.at[None, None])[0]

    def axes_of(self, form):
        """Ranges of the inner constants of a form; None where one has none on these data."""
        names = list(form.term.formula.constants)
        if "centre" in form.term.formula.inputs:
            names += [PLACE + axis for axis in self.axes]
        elif len(self.axes) == 1 and any(name.startswith(PLACE) for name in names):
            return None  # a plane is a place in one dimension
        found = tuple(map(self.axis, names))
        return None if None in found else found

    def axis(self, name):
        """The range of a constant, which may be numbered; None where it has none on these data."""
        if name not in self._known:
            is_own = name in self._texts or name.startswith(PLACE)
            found = self._axis(name if is_own else name.rstrip("0123456789"))
            self._known[name] = found and replace(found, name=name)
        return self._known[name]

    def _axis(self, name):
        if name.startswith(PLACE):
            axis = name.removeprefix(PLACE)
            centre = (float(self.middle["xyz".index(axis)]), self.size)
            return Axis(name, -np.inf, np.inf, cauchy=centre) if axis in self.axes else None
        text = self._texts[name]
        if ".." in text:
            return Axis(name, *map(float, text.split("..")))
        formula = parse_formula(text.removeprefix(ABOUT), self._types)
        found = self.values_of(self.placed(formula))
        if text.startswith(ABOUT) and len(found) and np.ptp(found):
            return Axis(name, 2 * found.min() - found.max(), 2 * found.max() - found.min())
        if not isinstance(formula, Call) or formula.operator not in ("norm", "abs"):
            return Axis(name, found.min(), found.max()) if len(found) and np.ptp(found) else None
        found = found[found > 0]
        if not len(found):
            return None
        return Axis(name, *np.log([found.min() / BEYOND, found.max() * BEYOND]), is_log=True)

    def values_of(self, formula, kind=None):
        """Values of a scalar where something is seen."""
        kind, found = kind or kind_of(formula), []
        for batch in self.batches:
            lookup = law_inputs(kind, batch.bodies, batch.positions, batch.velocities, batch.times)
            shown = batch.valid.any(axis=-1)
            shown = shown[..., None] if kind == "pair" else shown
            value, shown = np.broadcast_arrays(evaluate(formula, lookup), shown)
            found.append(value[shown & np.isfinite(value)])
        return np.concatenate(found)

    def of_law(self, formula, kind):
        """The scan of a law, a strength times a form; None if it is no such law.

        A law with more inner constants than `MOST_INNER` gains nothing.
        """
        name, rest = split_linear(formula)
        names = [n for n in rest.constants if not n.startswith(PLACE)]
        if name is None or name in names or not set(names) <= set(self._texts):
            return None
        form = Form(Term(rest, kind), 0.0)
        axes = self.axes_of(form)
        if not axes or len(axes) > MOST_INNER:
            return self._nothing(form, axes or ())
        return self.scan(form, COARSE)

    def scan(self, form, coarse=1):
        """A form on its first grid, or one so many times as coarse; None if it has none."""
        axes = self.axes_of(form)
        if axes is None:
            return None
        key = self._bare(form.term.formula), form.term.kind, coarse
        if key[0] is None:
            return self._nothing(form, axes)
        if key not in self._scanned:
            self._scanned[key] = self._scan(form, axes, coarse)
        return replace(self._scanned[key], form=form, ties=[])

    def _nothing(self, form, axes):
        """The scan of a form that gains nothing anywhere."""
        none, null = np.zeros(0), np.zeros(self.draws.shape[1])
        return Scan(form, axes, 0, 0.0, null, 0.0, 0.0, none, none, ())

    def _scan(self, form, axes, coarse):
        n_places = sum(axis.cauchy is not None for axis in axes)
        alone = -(-(N_POINTS if len(axes) == 1 else N_ACROSS) // coarse)
        across = min(round(N_PLACES ** (1 / n_places)), N_LINE) // coarse if n_places else 0
        lines = [axis.line(across if axis.cauchy else alone) for axis in axes]
        grid = np.array(list(every(*lines)))  # (C, k, 2)
        unit = self._unit(form, axes, grid[..., 0])
        gains = np.square(unit.T @ self.target)
        k = int(np.argmax(gains))
        volume = float(np.log(np.mean(np.exp(0.5 * (gains - gains[k])))))
        null = np.square(unit.T @ self.draws).max(axis=0, initial=0.0)
        best, peaks = float(gains[k]), _peaks(grid, gains)
        return Scan(form, axes, len(gains), best, null, volume, best, *grid[k].T, peaks)

    def _bare(self, formula):
        """A formula without factors that all bodies have alike; None if one of them is zero.

        Forms of which it is the same have moments that are parallel. It may have units of its own,
        and is never evaluated.
        """
        if not isinstance(formula, Call) or formula.operator != "mul":
            return formula
        kept = []
        for arg in formula.args:
            value = self._shared(arg)
            if value == 0.0:
                return None
            if value is None:
                kept.append(self._bare(arg))
        if None in kept:
            return None
        return kept[0] if len(kept) == 1 else Call("mul", *(kept or formula.args))

    def _shared(self, node):
        """The value of a property that all bodies have alike; None if it is none such."""
        if node not in self._alike:
            named = property_of(node.name) if isinstance(node, Input) else None
            self._alike[node] = None
            if named and node.type.shape == "scalar":
                column, role = named
                values = np.concatenate([
                    b.bodies.column(column)[:, b.bodies.receivers if role == "i" else slice(None)]
                    .ravel() for b in self.batches
                ])  # fmt: skip
                if np.all(values == values[0]):
                    self._alike[node] = float(values[0])
        return self._alike[node]

    def closer(self, scan, zoom):
        """The same with the best sought on a finer grid, which moves along while that gains.

        Parameters
        ----------
        scan : Scan
        zoom : int
            0 for the first of `ZOOMS`; others go on from the one before.
        """
        span = np.linspace(-1, 1, 5 if len(scan.axes) < 3 else 3)
        steps = np.array(list(every(span, repeat=len(scan.axes))))
        found = list(scan.found) or [
            replace(scan, at=p[:, 0], spacing=p[:, 1], best=0.0) for p in scan.peaks
        ]
        moving = list(range(len(found)))
        for _ in range(MOVES if len(scan.axes) > 1 else 1):
            if not moving:
                break
            before = [found[m].best for m in moving]
            near = [found[m].at + steps * found[m].spacing / CLOSER**zoom for m in moving]
            better = self._best_near(scan, np.clip(near, *_ends(scan.axes)))
            for m, other in zip(moving, better, strict=True):
                if other.best > found[m].best:
                    found[m] = replace(found[m], best=other.best, at=other.at)
            moving = [m for m, b in zip(moving, before, strict=True)
                      if found[m].best > (1 + LITTLE) * b]  # fmt: skip
        best = max([scan, *found], key=lambda one: one.best)
        return replace(best, found=tuple(replace(one, found=()) for one in found))

    def _best_near(self, scan, points):
        """The best of each group of points (P, C, k), all of them evaluated together."""
        unit = self._unit(scan.form, scan.axes, points.reshape(-1, points.shape[-1]))
        gains = np.square(unit.T @ self.target).reshape(points.shape[:2])
        best = np.argmax(gains, axis=1)
        return [replace(scan, best=float(own[k]), at=at[k])
                for k, own, at in zip(best, gains, points, strict=True)]  # fmt: skip

    def linearised(self, scan):
        """Moments of a form where it does best, and of changes of its inner constants.

        Returns
        -------
        ndarray, shape (n, 1 + k)
            Beside what constants of the law take up.
        """
        step = scan.spacing / CLOSER**ZOOMS
        ends = np.concatenate([scan.at + np.diag(step), scan.at - np.diag(step)])
        points = np.clip(np.concatenate([scan.at[None], ends]), *_ends(scan.axes))
        values = _constants(scan.axes, points)
        columns = self.beside(self._columns(self._term(scan.form.term), values))
        k = len(scan.axes)
        apart = np.diag(points[1 : k + 1] - points[k + 1 :])
        changes = (columns[:, 1 : k + 1] - columns[:, k + 1 :]) / np.where(apart > 0, apart, 1.0)
        return np.concatenate([columns[:, :1], changes], axis=1)

    def moved(self, scan, steps):
        """A scan with its inner constants changed by steps (k,) in their coordinates."""
        return replace(scan, at=np.clip(scan.at + steps, *_ends(scan.axes)))

    def strength(self, scan):
        """The strength of a form where it does best; nan where numbers do not carry it."""
        column = self._columns(self._term(scan.form.term), _constants(scan.axes, scan.at[None]))
        top = float(np.abs(column).max())  # squares of the columns may be beyond all numbers
        if not 0 < top < np.inf:
            return np.nan
        row = self.beside(column / top)[:, 0]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = float(row @ self.target / (row @ row) / top)
        return found if np.isfinite(found) else np.nan

    def _unit(self, form, axes, points):
        """Moments of a form at points (C, k), beside what constants take up, of unit length."""
        term = self._term(form.term)
        size = sum(
            b.target.size * (b.bodies.others.shape[1] if term.kind == "pair" else 1)
            for b in self.batches
        )
        step = max(CHUNK // size, 1)
        columns = np.concatenate([
            self._columns(term, _constants(axes, points[k : k + step]))
            for k in range(0, len(points), step)
        ], axis=1)  # fmt: skip
        is_passed = self._is_passed(form, _constants(axes, points))
        columns = np.where(np.isfinite(columns) & ~is_passed, columns, 0.0)
        top = np.abs(columns).max(axis=0)
        columns = columns / np.where(top > 0, top, 1.0)
        rows = self.beside(columns)
        square = np.square(rows).sum(axis=0)
        good = square > LEAST_BESIDE * np.square(columns).sum(axis=0)
        return np.where(good, rows / np.sqrt(np.where(good, square, 1.0)), 0.0)

    def _is_passed(self, form, values):
        """Whether a body passes a place on its line, or a plane, where its force is infinite, (C,).

        None does: it is thrown back, or held there. What such a force gains is a row that happens
        to lie near.
        """
        places = [name for name in values if name.startswith(PLACE)]
        if len(places) != 1:
            return False
        k, at = "xyz".index(places[0].removeprefix(PLACE)), values[places[0]]
        is_within = (self.span[0][k] < at) & (at < self.span[1][k])
        powers = [0.0]
        for node in walk(form.term.formula):
            if isinstance(node, Call) and ("centre" in node.inputs or places[0] in node.constants):
                if node.operator == "inverse":
                    powers.append(-1.0)
                elif node.operator == "pow" and isinstance(node.args[1], Number):
                    powers.append(node.args[1].value)
                elif node.operator == "pow" and isinstance(node.args[1], Constant):
                    powers.append(values[node.args[1].name])
        return is_within & (np.minimum.reduce(np.broadcast_arrays(*powers)) < 0)

    def _columns(self, term, values):
        """Moments of a term for many values of its constants, (n, C)."""
        parts = []
        for index, batch in enumerate(self.batches):
            tail = (1,) * (batch.target.ndim - 1 + (term.kind == "pair"))
            constants = {name: value.reshape(-1, *tail) for name, value in values.items()}
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                force = evaluate(
                    term.acceleration_formula, self._lookup(index, term), constants,
                    self._cache(index, term),
                )  # fmt: skip
            count = len(next(iter(values.values())))
            value = Settling(term, batch.bodies)(force, (count, *batch.target.shape))
            moments = batch.whiten(np.moveaxis(value, 0, 3))
            parts.append(np.moveaxis(moments, 3, -1).reshape(-1, count))
        return np.concatenate(parts)

    def moments_of_functions(self, term, variable, functions):
        """Moments of a term times each of some functions of a scalar, (n, C).

        They are not finite where the term is not, on a body that is seen.

        Parameters
        ----------
        functions : callable
            Values of any shape -> the same shape with one more axis (C,).
        """
        term, variable, parts = self._term(term), self.placed(variable), []
        for index, batch in enumerate(self.batches):
            lookup, cache = self._lookup(index, term), self._cache(index, term)
            force = evaluate(term.acceleration_formula, lookup, {}, cache)
            value = np.nan_to_num(functions(evaluate(variable, lookup, {}, cache)))
            with np.errstate(invalid="ignore", over="ignore"):
                value = np.moveaxis(value, -1, 0)[..., None] * force
                whole = Settling(term, batch.bodies)(value, (len(value), *batch.target.shape))
                whole = np.where(batch.valid, whole, 0.0)
                moments = batch.whiten(np.moveaxis(whole, 0, 3))
            parts.append(np.moveaxis(moments, 3, -1).reshape(-1, len(value)))
        return np.concatenate(parts)

    def _lookup(self, index, term):
        """Inputs of a batch for terms of a kind, each worked out once."""
        key = index, term.kind
        if key not in self._lookups:
            b = self.batches[index]
            self._lookups[key] = law_inputs(
                term.kind, b.bodies, b.positions, b.velocities, b.times
            )
        return self._lookups[key]

    def _cache(self, index, term):
        """What is known of a batch of sub-formulas without constants, for terms of a kind."""
        share = CACHE_BYTES // max(len(self.batches), 1)
        return self._cached.setdefault((index, term.kind), BoundedCache(share))

    def _term(self, term):
        """A term of a form with its places written out."""
        if term not in self._placed:
            self._placed[term] = Term(self.placed(term.formula), term.kind)
        return self._placed[term]

    def placed(self, formula):
        """A formula with its places written out.

        Axes along which nothing is seen have the coordinate at which everything is.
        """
        middle = [self._number(k) for k in range(len(self.middle))]
        centre = [
            Constant(PLACE + axis) if axis in self.axes else number
            for axis, number in zip("xyz", middle, strict=False)
        ]
        return substitute(formula, {MIDDLE: _point(middle), CENTRE: _point(centre)})

    def _number(self, k):
        value = float(f"{self.middle[k]:.6g}")
        return Number(value, STATE_INPUTS["p_i"].unit, f"{value:g} [m]")


def _ends(axes):
    """Least and greatest coordinates, shape (2, k)."""
    return np.array([[axis.low for axis in axes], [axis.high for axis in axes]])


def _constants(axes, points):
    """Values (C,) of the constants at points (C, k), by name."""
    values = np.stack([axis.values(points[:, k]) for k, axis in enumerate(axes)])
    return {axis.name: value for axis, value in zip(axes, values, strict=True)}


def _peaks(grid, gains):
    """The best points (k, 2) of a grid (C, k, 2) that are no neighbours of one another."""
    chosen = []
    for k in np.argsort(-gains):
        is_new = all(
            (np.abs(grid[k, :, 0] - at[:, 0]) > 1.5 * np.maximum(at[:, 1], grid[k, :, 1])).any()
            for at in chosen
        )
        if is_new:
            chosen.append(grid[k])
        if len(chosen) == MOST_PEAKS:
            break
    return tuple(chosen)


def _point(parts):
    """The point with these coordinates."""
    total = Input("origin", STATE_INPUTS["origin"])
    for axis, part in zip("xyz", parts, strict=False):
        if not isinstance(part, Number) or part.value:
            total = Call("add", total, Call("mul", part, Input(f"e_{axis}", Type("vector"))))
    return total
