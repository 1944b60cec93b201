"""Forces whose strength is any function of one variable: shapes, bred on profiles.

What a force along a direction explains is known once for all its shapes: of cubic splines over the
values of the variable (a *profile*) the moments are worked out once, and a shape is then scored by
its values at the knots alone, at a cost that does not grow with the data. What the splines explain
together bounds what any smooth shape may. Strengths are projected out (variable projection, Golub
and Pereyra 1973), constants inside are fitted to the profile by damped Gauss-Newton steps, from
several points at once.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import chi2, qmc

from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import smallest, to_formula
from bsp_gp.language.formula import (
    Call,
    Constant,
    Formula,
    Input,
    Number,
    evaluate,
    factors,
    product,
    substitute,
    walk,
)
from bsp_gp.language.operators import Type
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.language.render import to_text
from bsp_gp.language.tidy import power_of, tidied
from bsp_gp.physics.force import Term, kind_of
from bsp_gp.search.candidate import front_of
from bsp_gp.search.inner import Form, expanded, sayable
from bsp_gp.search.objective import Score
from bsp_gp.search.run import Budget, run_search
from bsp_gp.units import DIMENSIONLESS

KNOTS = 48
"""Of a profile."""
FLAT = 1e-10
"""Part of what a profile explains that is nothing, and of its size below which a shape is none."""
STARTS = {1: 24, 2: 64, 3: 128}
"""Points at which a shape of so many constants is first scored; of more, as of three."""
MOST_CONSTANTS = 5
BY_CHANCE = 0.01
"""Chance that a profile gains as much of mere noise as is taken to be noise."""
POLISHED, N_POLISHED = ((0.25, 3), (0.25, 12)), 3
"""Parts of new shapes that are fitted, the best, with steps at the most, and again of these; and
points from which each is."""
STEEPEST = 1e100
"""Slope of a shape by a constant that says something."""
MOST_SIMPLE = 6000
"""Shapes with which a search begins: all of so many rules, of which there are no more."""
IDLE, WORTH = 5, 0.1
"""Generations without a better shape after which a search ends, and by how much of what is left a
shape is to be better."""
SETTLED = 1e-10
"""Part of what is left by which a step must better it."""
MOST_WAYS, MOST_SHAPES = 2, 6
"""Ways in which shapes are bred, the best; and shapes of each that are handed on."""
DIGITS = 9
"""Of a gain: shapes that explain as much are one."""
LEVELS = 8
"""Of derivations of shapes."""
X, SIZE = Input("x", Type("scalar", DIMENSIONLESS)), Input("z", Type("scalar", DIMENSIONLESS))
"""What a shape is a function of, and the size of it where it takes both signs."""
SIGN = Call("sign", X)


@dataclass(frozen=True, eq=False)
class Way:
    """A direction and what is multiplied, and the variable on which the strength depends.

    Attributes
    ----------
    term : Term
        The force of strength one.
    variable : Formula
        A scalar.
    scale, offset : str
        Names of the constants that make a number of it: ``(variable - offset) / scale``; no offset
        where it has a zero of its own.
    """

    term: Term
    variable: Formula
    scale: str
    offset: str = ""

    @property
    def constants(self):
        return (self.scale, self.offset) if self.offset else (self.scale,)

    def form(self, shape, is_scaled=True):
        """The force with a shape, a formula in ``x``; without its strength."""
        at = self.variable
        if self.offset:
            at = Call("sub", at, Constant(self.offset))
        if is_scaled:
            at = Call("div", at, Constant(self.scale))
        placed = substitute(shape, {X: at, SIZE: Call("abs", at)})
        return Form(Term(Call("mul", placed, self.term.formula), self.term.kind), 0.0)


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape that was found, where it does best.

    Attributes
    ----------
    form : Form
    at : dict of str to float
        Its constants.
    gain : float
        Of the whitened sum of squares.
    nats : float
        What it costs beforehand that it is this shape.
    """

    form: Form
    at: dict
    gain: float
    nats: float = 0.0


def read_ways(grammar, dataset, properties, types, available):
    """The ways of a grammar's ``[shapes]`` of which a data set has all inputs."""
    table, ways, seen = grammar.source.get("shapes", {}), [], set()
    lists = {**grammar.inside, "0": properties}
    for one in table.get("of", ()):
        variables = list(sayable([one["variable"]], types, dataset.units, available))
        texts = [e for text in one["times"] for e in expanded(text, lists)]
        for _, variable in variables:
            for _, force in sayable(texts, types, dataset.units, available):
                if variable.type.shape != "scalar" or force.type.shape != "vector":
                    raise GrammarError(
                        f"[shapes] of {one['variable']!r}: must be a scalar, times vectors"
                    )
                if (variable, force) not in seen:
                    seen.add((variable, force))
                    kind = kind_of(Call("mul", variable, force))
                    way = Way(Term(force, kind), variable, one["scale"], one.get("offset", ""))
                    ways.append(way)
    return ways


class ShapeSearch:
    """Breeds shapes in the ways in which the most may be explained.

    Parameters
    ----------
    grammar : Grammar
        Of shapes: functions of ``x``, and of ``z``, the size of an ``x`` that takes both signs.
    inner : InnerSearch
        What is to be explained, on which data, and the ranges of constants.
    ways : sequence of Way
    budget : int
        Shapes that are scored in each way, beside all small ones.
    chance : float
        See `ShapeObjective`.
    """

    def __init__(self, grammar, inner, ways, budget, chance=1.0):
        self.grammar, self.inner, self.ways, self.budget = grammar, inner, ways, budget
        self.chance = chance
        self.gain, self.null = 0.0, np.zeros(inner.draws.shape[1])
        self.n_tried, self.bounds, self.found = 0, {}, ()

    def run(self, strategy, rng, *, least=0.0, progress=None):
        """Breed shapes in the ways that promise the most: those `found`, best first.

        Parameters
        ----------
        strategy : callable
            ``strategy(max_levels, seeds)`` is a strategy of `run_search` that sets out from seeds:
            here from all small shapes.
        least : float
            What a way must be able to explain, beside noise, for shapes to be bred in it.
        progress : callable, optional
            Told the number of every generation; True ends the search.
        """
        found, most = [], least
        for profile in self._profiles():
            if profile.bound - self.chance * chi2.isf(BY_CHANCE, profile.rank) <= most:
                break  # no shape of it explains more, nor of those that come after
            objective = ShapeObjective(self.grammar, profile, self.inner.axis, self.chance)
            simple = smallest(objective.grammar, objective.start, MOST_SIMPLE)
            run_search(
                strategy(LEVELS, tuple(simple)), objective,
                Budget(n_scored=len(simple) + self.budget), rng=rng, is_part=True,
                callback=_Patience(progress),
            )  # fmt: skip
            self.gain = max(self.gain, objective.first_gain)
            self.null = np.maximum(self.null, objective.null_gain)
            self.n_tried += objective.n_scored
            self.bounds[profile.way] = profile.bound
            found += objective.found(MOST_SHAPES)
            most = max([most, *(shape.gain for shape in found)])
        self.found = tuple(sorted(found, key=lambda shape: shape.nats - 0.5 * shape.gain))
        return self.found

    def text(self):
        """What was searched, and the bound."""
        parts = [
            f"{to_text(way.term.formula)} times a function of {to_text(way.variable)} explains "
            f"{bound:.6g} at the most" for way, bound in self.bounds.items()
        ]  # fmt: skip
        return f"{self.n_tried} shapes bred: " + "; ".join(parts)

    def _profiles(self):
        """The ways in which most may be explained."""
        profiles = [p for way in self.ways if (p := Profile.of(self.inner, way)) is not None]
        profiles.sort(key=lambda p: -p.bound)
        return profiles[:MOST_WAYS]


class _Patience:
    """Ends a search that gets no further, or no simpler."""

    def __init__(self, progress):
        self.progress, self.cost, self.since = progress, math.inf, 0

    def __call__(self, step, objective):
        least = max(objective.chance, WORTH * objective.left)
        if objective.cost < self.cost - least:
            self.cost, self.since = objective.cost, step
        is_over = objective.is_exact or step - self.since >= IDLE
        return is_over or bool(self.progress and self.progress(step))


class Profile:
    """What a way may explain with a shape, by its values at knots.

    Attributes
    ----------
    knots : ndarray, shape (M,)
        Values of the variable.
    moments : ndarray, shape (M, M)
        By values at the knots, in an orthonormal basis of what all shapes explain.
    target, draws : ndarray, shapes (M,) and (M, B)
        In the same basis.
    bound : float
        The most that any smooth shape explains.
    """

    def __init__(self, way, axes, knots, moments, target, draws):
        self.way, self.axes, self.knots, self.moments = way, axes, knots, moments
        self.target, self.draws = target, draws
        self.rank = len(target)
        self.bound = float(target @ target)
        self.is_signed = bool(way.offset) or bool((knots < 0).any())

    @classmethod
    def of(cls, inner, way):
        """The profile of a way; None where these data do not show it, or nothing varies."""
        axes = {name: inner.axis(name) for name in way.constants}
        knots = _knots(inner.values_of(way.variable, way.term.kind))
        if knots is None or None in axes.values():
            return None
        spline = CubicSpline(_even(knots), np.eye(len(knots)))
        columns = inner.moments_of_functions(
            way.term, way.variable, lambda u: spline(_even(u, knots))
        )
        top = np.abs(columns).max(initial=0.0)
        if not 0 < top < np.inf:
            return None
        basis, moments = np.linalg.qr(inner.beside(columns))
        return cls(way, axes, knots, moments, basis.T @ inner.target, basis.T @ inner.draws)

    @property
    def size(self):
        return float(np.abs(np.diag(self.moments)).max())

    def unit(self, values):
        """Moments of shapes with these values at the knots (..., M), of unit length, (..., M)."""
        top = np.abs(values).max(axis=-1, keepdims=True)
        fine = np.isfinite(top) & (top > 0)
        moments = np.where(fine, values / np.where(fine, top, 1.0), 0.0) @ self.moments.T
        size = np.linalg.norm(moments, axis=-1, keepdims=True)
        fine = size > FLAT * self.size
        return np.where(fine, moments / np.where(fine, size, 1.0), 0.0)


def _knots(values):
    """Knots between values as even in the coordinate as in the data; None where these are few."""
    values = np.unique(values[np.isfinite(values)])
    if len(values) < KNOTS:
        return None
    share = np.linspace(0, 1, KNOTS)
    low, high = values[0], values[-1]
    even = low + share * (high - low) if low <= 0 else low * (high / low) ** share
    return np.unique((np.quantile(values, share) + even) / 2)


def _even(values, knots=None):
    """The coordinate in which a profile is smooth: the logarithm of what is never negative."""
    knots = values if knots is None else knots
    return np.log(np.clip(values, knots[0], knots[-1])) if knots[0] > 0 else values


class ShapeObjective:
    """Scores shapes on a profile: what `run_search` and its strategies ask for.

    Parameters
    ----------
    grammar : Grammar
    profile : Profile
    axis : callable
        ``axis(name)`` is the range of a constant inside.
    chance : float
        What a number gains where there is but noise, chi-squared; 0 where there is none.

    Attributes
    ----------
    best : dict of int to (Expression, Score)
    first_gain, null_gain : float and ndarray, shape (B,)
        The most that any shape explains of the target, and of each draw of noise, at the points at
        which its constants are first scored: like beside like.
    """

    n_grids = 0

    def __init__(self, grammar, profile, axis, chance=1.0):
        inputs = {"x", "z"} if profile.is_signed else {"x"}
        self.grammar, _ = grammar.masked(inputs)
        self.profile, self._axis, self.chance = profile, axis, chance
        self.start = self.grammar.start["field"]
        self.first_gain, self.null_gain = 0.0, np.zeros(profile.draws.shape[1])
        self.n_scored = self.n_failed = 0
        self.best, self._scores, self._fits, self._numbers = {}, {}, {}, {}
        probabilities = Pcfg.uniform(self.grammar).probabilities
        self._nats = -np.log(np.maximum(probabilities, np.finfo(float).tiny))
        self._most = 0.0

    @property
    def is_exact(self):
        """Whether a shape explains all that any may."""
        return self.left <= FLAT * self.profile.bound

    @property
    def left(self):
        """What the best shape leaves of what all of them may explain."""
        return self.profile.bound - self._most

    @property
    def cost(self):
        """The least of any shape, nats."""
        return min((score.cost for _, score in self.best.values()), default=math.inf)

    def score(self, expressions):
        """Scores of expressions, in order."""
        new = [e for e in dict.fromkeys(expressions) if e not in self._scores]
        fits = [self._fit(e) for e in new]
        for fit in fits:
            fit.design()
            self.first_gain = max(self.first_gain, fit.gain)
        best = fits
        for share, steps in POLISHED:
            best = sorted(best, key=lambda fit: -fit.gain)[: math.ceil(share * len(best))]
            for fit in best:
                fit.polish(steps)
        for expression, fit in zip(new, fits, strict=True):
            self._settle(expression, fit)
        return self.known(expressions)

    def _fit(self, expression):
        formula = _numbered(to_formula(expression, self.grammar))
        return _Fit(self.profile, formula, {name: self._axis(name) for name in formula.constants})

    def known(self, expressions):
        """Scores of expressions that were scored before."""
        return [self._scores[e] for e in expressions]

    def _settle(self, expression, fit):
        """Note the score of a shape; those that explain as much are one."""
        complexity = float(sum(self._nats[rule] for rule in expression.rules()))
        if not fit.gain > 0:
            self.n_failed += 1
            self._scores[expression] = Score(-1, np.inf, complexity, np.inf)
            return
        self._most = max(self._most, fit.gain)
        self.null_gain = np.maximum(self.null_gain, fit.null_gain)
        self._fits[expression] = fit
        number = self._numbers.setdefault(f"{fit.gain:.{DIGITS}e}", self.n_scored)
        self.n_scored += number == self.n_scored
        loss = 0.5 * max(self.profile.bound - fit.gain, 0.0)
        free = 0.5 * math.log(self.profile.rank) * len(fit.axes)
        score = Score(number, loss, complexity, loss + free + complexity)
        self._scores[expression] = score
        kept = self.best.get(number)
        if kept is None or complexity < kept[1].complexity:
            self.best[number] = expression, score

    def candidate(self, expression):
        """A shape that was scored, with simple numbers where these do as well."""
        fit, score = self._fits[expression], self._scores[expression]
        allowed = self.chance * math.log(self.profile.rank) + self.profile.bound - fit.gain
        return replace(fit.simplified(allowed).shape(), nats=score.complexity)

    def front(self):
        """Best distinct shapes per complexity."""
        return list(front_of(self.best.values(), lambda entry: entry[1]))

    def found(self, most):
        """The cheapest shapes, and the best of every complexity."""
        ranked = sorted(self.best.values(), key=lambda e: (e[1].cost, e[1].complexity))[:most]
        chosen = dict.fromkeys(e for e, _ in (*ranked, *self.front()[-most:]))
        distinct = {}
        for shape in map(self.candidate, chosen):
            distinct.setdefault(shape.form.term.formula, shape)
        return list(distinct.values())


class _Fit:
    """The constants of one shape on a profile.

    Parameters
    ----------
    formula : Formula
        Of ``x`` and ``z``.
    axes : mapping of str to Axis
        Ranges of the constants in it.

    Attributes
    ----------
    gain : float
        0 where no constants make it finite.
    at : ndarray, shape (k,)
        Coordinates of the constants on their axes.
    """

    def __init__(self, profile, formula, axes):
        self.profile, self.formula = profile, formula
        self.null_gain = np.zeros(profile.draws.shape[1])
        self.axes = {**profile.axes, **{name: axes[name] for name in formula.constants}}
        ends = [(axis.low, axis.high) for axis in self.axes.values()]
        self.low, self.high = np.array(ends).T
        self.gain, self.at, self._starts, self._damping = 0.0, None, None, None

    def design(self):
        """Score it at points all over the ranges of its constants."""
        if len(self.axes) > MOST_CONSTANTS:
            return
        points = self.low + _points(len(self.axes)) * (self.high - self.low)
        unit = self.profile.unit(self.values(points))
        gains = np.square(unit @ self.profile.target)
        self.null_gain = np.square(unit @ self.profile.draws).max(axis=0, initial=0.0)
        best = np.argsort(-gains, kind="stable")[:N_POLISHED]
        self.gain, self.at, self._starts = float(gains[best[0]]), points[best[0]], points[best]

    def polish(self, n_steps=POLISHED[-1][1]):
        """Fit the constants, from the best of these points, or go on with that."""
        if not self.gain > 0:
            return
        at, target, damping = self._starts, self.profile.target, self._damping
        if damping is None:
            damping = np.full(len(at), 1e-2)
        gains = np.square(self.profile.unit(self.values(at)) @ target)
        for _ in range(n_steps):
            steps = self._steps(at, damping)
            trial = np.clip(at + steps, self.low, self.high)
            unit = self.profile.unit(self.values(trial))
            new = np.square(unit @ target)
            is_better = new > gains
            settled = new - gains <= SETTLED * (self.profile.bound - gains)
            at = np.where(is_better[:, None], trial, at)
            gains = np.where(is_better, new, gains)
            damping = np.where(is_better, damping / 5, damping * 5)
            if (settled & is_better).any() or damping.min() > 1e6:
                break
        self._starts, self._damping = at, damping
        best = int(np.argmax(gains))
        if gains[best] > self.gain:
            self.gain, self.at = float(gains[best]), at[best]

    def simplified(self, allowed):
        """The same with simple numbers for constants, where that costs no more than is allowed."""
        fit = self
        for name in self.formula.constants:
            value = float(fit.axes[name].values(fit.at[list(fit.axes).index(name)]))
            for simple in dict.fromkeys((0.0, round(2 * value) / 2)):
                other = fit._with_number(name, simple)
                if other is not None and other.gain >= self.gain - allowed:
                    fit = other
                    break
        return fit

    def _with_number(self, name, value):
        """The same shape with a number in the place of a constant; None where that is less."""
        formula = tidied(substitute(self.formula, {Constant(name): Number(value)}))
        if not _is_folded(formula):
            return None
        other = _Fit(self.profile, formula, self.axes)
        kept = [k for k, each in enumerate(self.axes) if each in other.axes]
        other.at = self.at[kept]
        unit = other.profile.unit(other.values(other.at[None]))
        other.gain, other._starts = float(np.square(unit @ self.profile.target)[0]), other.at[None]
        other.polish()
        return other

    def _steps(self, at, damping):
        """Damped Gauss-Newton steps, the strength projected out, shape (S, k)."""
        n, k = at.shape
        change = 1e-6 * (self.high - self.low)
        change = np.where(at + change > self.high, -change, change)
        points = np.concatenate([at[:, None], at[:, None] + change[:, :, None] * np.eye(k)], axis=1)
        values = self.values(points.reshape(-1, k)).reshape(n, k + 1, -1)
        top = np.abs(values[:, :1]).max(axis=2, keepdims=True)
        is_fine = np.isfinite(values) & (top > 0)
        values = np.where(is_fine, values / np.where(top > 0, top, 1.0), 0.0)
        moments = values @ self.profile.moments.T
        own, by = moments[:, 0], (moments[:, 1:] - moments[:, :1]) / change[:, :, None]
        size, target = np.square(own).sum(axis=1)[:, None], self.profile.target
        is_seen = size > np.square(FLAT * self.profile.size)
        size = np.where(is_seen, size, 1.0)
        strength = np.where(is_seen, (own @ target)[:, None] / size, 0.0)
        left = target - strength * own
        along = np.einsum("skm,sm->sk", by, own) / size
        slopes = strength[:, :, None] * (by - along[:, :, None] * own[:, None])
        slopes = np.where(np.abs(slopes) < STEEPEST, slopes, 0.0)  # squares must be numbers
        gram = np.einsum("skm,slm->skl", slopes, slopes)
        towards = np.einsum("skm,sm->sk", slopes, left)
        diagonal = np.einsum("skk->sk", gram)
        most = diagonal.max(axis=1, keepdims=True)
        damped = damping[:, None] * diagonal + 1e-14 * most + np.finfo(float).tiny
        gram = gram + damped[:, :, None] * np.eye(k)
        return np.linalg.solve(gram, towards[:, :, None])[:, :, 0]

    def values(self, points):
        """The shape at the knots, for constants at coordinates (C, k); shape (C, M)."""
        found = {name: axis.values(points[:, j, None])
                 for j, (name, axis) in enumerate(self.axes.items())}  # fmt: skip
        way = self.profile.way
        x = self.profile.knots - found[way.offset] if way.offset else self.profile.knots
        x = x / found[way.scale]
        with np.errstate(all="ignore"):
            value = evaluate(self.formula, {"x": x, "z": np.abs(x)}, found)
        return np.broadcast_to(value, (len(points), len(self.profile.knots)))

    def shape(self):
        """The force with this shape; one that is a power has no scale, which is but a strength."""
        at = {name: float(axis.values(c))
              for (name, axis), c in zip(self.axes.items(), self.at, strict=True)}  # fmt: skip
        way, parts = self.profile.way, factors(tidied(self.formula))[0]
        formula = product([part for part in parts if not isinstance(part, Number)])  # a strength
        power = _power_in(formula, at)
        if power is None:
            return Shape(way.form(formula), at, self.gain)
        own = {name: value for name, value in at.items() if name == way.offset}
        signed = [SIGN] if SIGN in factors(formula)[0] else []
        base = SIZE if SIZE in walk(formula) else X
        form = way.form(product([Call("pow", base, Constant("n1")), *signed]), is_scaled=False)
        return Shape(form, {**own, "n1": power}, self.gain)


def _power_in(formula, at):
    """The power of its variable that a shape is, but for its sign; None for all others."""
    total = 0.0
    for part in factors(formula)[0]:
        base, power = power_of(part)
        if isinstance(base, Call) and base.operator == "pow" and base.args[1].constants:
            power, base = power * at[base.args[1].name], base.args[0]
        if base in (X, SIZE):
            total += power
        elif base != SIGN and not isinstance(base, Number):
            return None
    return total


def _is_folded(formula):
    """Whether nothing in a formula is a function of numbers and constants alone."""
    return all(node.inputs for node in walk(formula) if isinstance(node, Call))


def _numbered(formula):
    """A formula in which every constant that is named again is another."""
    counts = {}

    def renamed(node):
        if isinstance(node, Constant):
            counts[node.name] = counts.get(node.name, 0) + 1
            return Constant(f"{node.name}{counts[node.name]}")
        if isinstance(node, Call):
            return Call(node.operator, *map(renamed, node.args))
        return node

    return renamed(formula)


@cache
def _points(k):
    """Points that fill a cube evenly, shape (C, k)."""
    halton = qmc.Halton(k, scramble=False)
    halton.fast_forward(1)  # the first is a corner
    return halton.random(STARTS.get(k, max(STARTS.values())))
