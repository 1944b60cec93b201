"""Sets of terms chosen as wholes, on exact data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.language.formula import Call, Constant, Number, factors, product
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.effects import COLLINEAR
from bsp_gp.loop.models import Attempt, is_property
from bsp_gp.loop.naming import describe, fresh_name
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.subsets import best_subsets

__all__ = ["FREES", "MOST_EQUALS", "plan_ahead"]

REVISION_SHARE = 0.5
"""A set takes the place of terms found one by one where it leaves at most this part."""


SAME_LOSS = 1.2
"""On exact data, sets whose losses differ by less than this factor fit practically equally."""


MOST_EQUALS = 24
"""Laws listed as not separable from an effect."""


FREES = " (frees a declared number)"


MAX_SET = 4
"""Largest set of found terms that is chosen as a whole."""


def plan_ahead(observation, law, best, search):
    """Choose the found terms anew as part of the best set, on exact data.

    Added one at a time, a proxy (a cube of speed for an inverse cube of distance) may be taken
    first and never be parted with. So sets of terms are scored as wholes; where a larger set
    leaves far less, its strongest members are what is adopted now.
    """
    declared = [term for term in law.terms if term.is_declared]
    found = [term for term in best.law.terms if not term.is_declared]
    pool = _Pool(observation, declared, best, search)
    if not pool.laws:
        return best
    sets = pool.sets(min(len(found) + 2, MAX_SET))
    size = _worthwhile(sets, len(found), pool.floor)
    if not sets.get(size) or (size == len(found) == 1):
        return best
    chosen = pool.simplest(sets[size])
    order = pool.by_gain(chosen)[: len(found)]
    planned = pool.attempt(order, best)
    if size == len(found) and planned.fit.chisqr > REVISION_SHARE * best.fit.chisqr:
        planned = best
    same = pool.equals(size, sets[size][0][0], chosen) if size == len(found) else ()
    return replace(planned, equivalents=tuple(same))


def _worthwhile(sets, size, floor):
    """Grow the size of the set while that leaves a hundredth of the sum of squares or less."""
    while size + 1 in sets and sets[size + 1] and sets[size]:
        further = min(
            (max(sets[s][0][0], floor) for s in sets if s > size and sets[s]), default=np.inf
        )
        if further > 0.01 * max(sets[size][0][0], floor):
            break
        size += 1
    return size


class _Pool:
    """Columns of all laws with the declared (or best) property factors."""

    def __init__(self, observation, declared, best, search):
        self.observation = observation
        regression = observation.train_regression
        found = [term for term in best.law.terms if not term.is_declared]
        wanted = {_property_part(term.formula) for term in found}
        kinds = dict.fromkeys(term.kind for term in found)
        self.laws, columns = [], []
        for kind in kinds:
            laws, matrix = search.pool(kind, frozenset(wanted))
            self.laws += [(formula, complexity, kind) for formula, complexity in laws]
            columns.append(matrix)
        self.declared = ForceLaw(
            declared, {n: best.law.constants[n] for t in declared for n in t.formula.constants}
        )
        fit = observation.fit(self.declared)
        q = orthonormal(fit.jacobian, len(fit.residual))
        matrix = np.concatenate(columns, axis=1)
        self.frozen = _parallel(matrix, _fixed_directions(regression, declared))
        self.matrix = matrix - q @ (q.T @ matrix)
        self.target = fit.residual - q @ (q.T @ fit.residual)
        self.floor = 0.5 * regression.n_rows

    def sets(self, size):
        """Best sets of each size up to `size` that leave the declared numbers alone."""
        free = np.flatnonzero(~self.frozen)
        found = best_subsets(self.matrix[:, free], self.target, size)
        return {
            count: [(loss, tuple(int(free[k]) for k in chosen)) for loss, chosen in members]
            for count, members in found.items()
        }

    def simplest(self, sets):
        """Of the sets that fit practically as well as the best, the least complex."""
        bar = max(sets[0][0], self.floor) * SAME_LOSS
        near = [chosen for loss, chosen in sets if max(loss, self.floor) <= bar]
        return min(near, key=lambda chosen: round(sum(self.laws[k][1] for k in chosen), 6))

    def by_gain(self, chosen):
        """Order a set so that each next member explains most of what is left."""
        order, left = [], list(chosen)
        while left:
            losses = []
            for k in left:
                columns = self.matrix[:, [*order, k]]
                columns = columns / np.linalg.norm(columns, axis=0)
                coefficients, *_ = np.linalg.lstsq(columns, self.target, rcond=None)
                losses.append(float(np.square(self.target - columns @ coefficients).sum()))
            order.append(left.pop(int(np.argmin(losses))))
        return order

    def attempt(self, order, best):
        """The declared law with these members, fitted."""
        law, complexity = self.declared, 0.0
        for k in order:
            formula, cost, kind = self.laws[k]
            name = fresh_name(law)
            law = law.plus(Term(Call("mul", Constant(name), formula), kind), {name: 0.0})
            complexity += cost
        fit = self.observation.fit(law)
        old = {
            to_text(split_linear(t.formula)[1]): t for t in best.law.terms[:-1] if not t.is_declared
        }
        terms = [t for t in fit.law.terms if not t.is_declared]
        texts = [to_text(split_linear(t.formula)[1]) for t in terms]
        new = [t for t, text in zip(terms, texts, strict=True) if text not in old]
        new = new or terms
        gone = [describe(t.formula) for text, t in old.items() if text not in texts]
        constants = fit.law.constants
        return Attempt(
            fit.law,
            fit,
            complexity,
            " and ".join(describe(t.formula, constants[split_linear(t.formula)[0]]) for t in new),
            " + ".join(to_text(t.formula) for t in new),
            " + ".join(to_latex(t.formula) for t in new),
            new[-1].kind,
            replaces=tuple(gone),
        )

    def equals(self, size, best_loss, chosen):
        """Texts of the sets that these data cannot tell from the chosen one, simplest first.

        Sets in which a declared number is freed are among them, and are marked.
        """
        bar = max(best_loss, self.floor) * SAME_LOSS
        found = best_subsets(self.matrix, self.target, size).get(size, ())
        near = [members for loss, members in found if max(loss, self.floor) <= bar]
        near.sort(key=lambda members: round(sum(self.laws[k][1] for k in members), 6))
        for members in near[:MOST_EQUALS]:
            if set(members) != set(chosen):
                text = " + ".join(
                    f"c{n} * {to_text(self.laws[k][0])}" for n, k in enumerate(members, 1)
                )
                yield text + (FREES if self.frozen[list(members)].any() else "")


def _property_part(formula):
    """Product of the property factors, as the left bank of the search writes it."""
    above, below = factors(formula)
    above = [f for f in above if is_property(f)]
    below = [f for f in below if is_property(f)]
    if not above and not below:
        return Number(1.0)
    top = product(above)
    return Call("div", top, product(below)) if below else top


def _fixed_directions(regression, declared):
    out = []
    for term in declared:
        if not term.formula.constants:
            column = regression.column(term)[0][:, 0]
            if np.any(column):
                out.append(column / np.linalg.norm(column))
    return out


def _parallel(matrix, fixed):
    """Which columns are parallel to a declared term of fixed number."""
    sizes = np.linalg.norm(matrix, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    out = np.zeros(matrix.shape[1], dtype=bool)
    for direction in fixed:
        out |= 1 - (direction @ matrix / sizes) ** 2 < COLLINEAR
    return out
