"""All products of two banks of scalar factors, and the law that each of them is."""

import functools
import heapq
import itertools
from dataclasses import dataclass

import numpy as np

from bsp_gp.language.formula import Call, Constant


class Side:
    """A bank of scalar factors: values (n, P), complexities, entries; entry 0 may be the 1."""

    def __init__(self, entries):
        self.entries = entries
        self.complexity = np.array([min(e.complexity for e in x.family()) for x in entries])

    @functools.cached_property
    def values(self):
        """Values (n, P), each scaled to a greatest size of one: constants take up the scale."""
        stacked = np.stack([entry.value for entry in self.entries])
        return stacked / np.max(np.abs(stacked), axis=1, keepdims=True)


@dataclass(eq=False)
class Block:
    """All products of two sides."""

    left: Side
    right: Side
    allowed: np.ndarray
    cost: float
    constant: str
    needs_factor: bool = False

    @functools.cached_property
    def is_static(self):
        """Whether the left factors depend on properties only."""
        return all(entry.is_static for entry in self.left.entries)

    def formulas(self, a, b, directed, most):
        """The law of this product and those merged into it.

        Returns
        -------
        list of (complexity, Formula)
            Simplest first, at most `most` + 1.
        """
        left, right = self.left.entries[a], self.right.entries[b]
        if not most:
            sides = left.family(), right.family(), (directed, *directed.ties)
            choice = [min(side, key=lambda part: part.complexity) for side in sides]
            if self._is_sayable(choice):
                complexity = self.cost + sum(part.complexity for part in choice)
                return [(complexity, self.formula_of(*choice))]
        options = []
        for choice in itertools.islice(
            itertools.product(left.family(), right.family(), (directed, *directed.ties)), 4000
        ):
            if not self._is_sayable(choice):
                continue
            complexity = self.cost + sum(part.complexity for part in choice)
            options.append((complexity, len(options), choice))
        best = heapq.nsmallest(most + 1, options)
        return [(complexity, self.formula_of(*choice)) for complexity, _, choice in best]

    def _is_sayable(self, choice):
        """Whether a choice is in the grammar, and not only equal to a law that is."""
        left, right, _ = choice
        if self.needs_factor and left.expression is right.expression is None:  # 1 * 1
            return False
        return left.expression is not None or right.operator == "mul"  # no 1 / b

    def formula_of(self, left, right, directed):
        """Law of one choice: constant * (left op right) * direction [* condition]."""
        coefficient = _combine(right.operator, left, right)
        body = (
            directed.direction
            if coefficient is None
            else Call("mul", coefficient, directed.direction)
        )
        if directed.condition is not None:
            body = Call("mul", body, directed.condition)
        return Call("mul", Constant(self.constant), body)


def _combine(operator, left, right):
    is_one = [entry.expression is None for entry in (left, right)]
    if all(is_one):
        return None
    if is_one[1]:
        return left.formula
    if is_one[0] and operator == "mul":
        return right.formula
    return Call(operator, left.formula, right.formula)


class Kept:
    """The best laws of every unit of complexity, with bounded memory."""

    def __init__(self, top_k):
        self.top_k = top_k
        self.bins = {}

    def add(self, gain, complexity, source):
        flat = gain.ravel()
        bins = np.floor(complexity).astype(int).ravel()
        for level in np.unique(bins):
            members = np.flatnonzero((bins == level) & (flat > self._threshold(level)))
            if len(members) > self.top_k:
                members = members[np.argpartition(-flat[members], self.top_k - 1)[: self.top_k]]
            if len(members):
                self._insert(level, flat, complexity.ravel(), members, source, gain.shape[1])

    def _threshold(self, level):
        items = self.bins.get(level)
        return items[-1][0] if items and len(items) >= self.top_k else 0.0

    def _insert(self, level, flat, complexity, members, source, width):
        items = self.bins.setdefault(level, [])
        items.extend(
            (float(flat[m]), float(complexity[m]), source, int(m) // width, int(m) % width)
            for m in members
        )
        items.sort(key=lambda item: (-item[0], item[1]))
        del items[self.top_k :]

    def items(self):
        """All kept laws, greatest gain first."""
        everything = [item for items in self.bins.values() for item in items]
        return sorted(everything, key=lambda item: (-item[0], item[1]))
