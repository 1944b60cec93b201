"""Products of factors that mix properties and motion, under errors correlated along time.

Of two factors that multiply, if either depends on properties only, rows of one receiver and
source can be summed first. Only products of two factors that vary along time are formed one by
one, whitened as columns: some thousand per direction.
"""

import numpy as np

from bsp_gp.search.columns import BATCH_BYTES, Columns
from bsp_gp.search.moments import MomentScorer
from bsp_gp.search.products import Block, Side
from bsp_gp.search.scoring import COLLINEAR, GroupScorer


class CorrelatedScorer(GroupScorer):
    """Numerators and denominators of all products of two mixed banks; see `scoring`."""

    def products(self, known=None):
        """As `scoring` has it, but that no sizes are kept."""
        parts = _parts(self.block)
        shape = self.block.allowed.shape
        numerators = np.zeros((self.ys.shape[1], *shape))
        denominator = np.zeros(shape)
        for block, rows, columns, is_turned in parts.static:
            found, size = self._grouped(block)
            if is_turned:
                found, size = np.swapaxes(found, 1, 2), size.T
            numerators[:, rows[:, None], columns] = found
            denominator[np.ix_(rows, columns)] = size
        self._moving(parts.moving_left, parts.moving_right, numerators, denominator)
        return numerators, denominator, None

    def _grouped(self, block):
        scorer = group_scorer(self.search.regression)
        return scorer(self.search, block, self.vector, self.q, self.ys, self.mask).products()[:2]

    def _moving(self, rows, columns, numerators, denominator):
        """Products of two factors that both vary along time, as whitened columns."""
        left, right = self.block.left.values, self.block.right.values
        made = Columns(self.search.rows, self.ys[:, 0], self.q)
        step = max(1, BATCH_BYTES // (8 * self.vector.size))
        for a in rows:
            wanted = columns[self.block.allowed[a, columns]]
            for start in range(0, len(wanted), step):
                part = wanted[start : start + step]
                spread = made.spread(left[a] * right[part], self.vector)
                if self.mask is not None:
                    spread = spread * self.mask
                raw = np.einsum("kn,kn->k", spread, spread)
                size = raw - np.square(spread @ self.q).sum(axis=1)
                numerators[:, a, part] = (spread @ self.ys).T
                denominator[a, part] = np.where(size > COLLINEAR * raw, size, 0.0)


def group_scorer(regression):
    """Scores products whose left factors are constant in time."""
    return MomentScorer if regression.method == "response" else GroupScorer


class _Parts:
    """A block parted by whether its factors vary along time."""

    def __init__(self, block):
        left, right = (
            np.array([e.is_static for e in s.entries]) for s in (block.left, block.right)
        )
        everything = np.arange(len(right))
        self.moving_left, self.moving_right = np.flatnonzero(~left), np.flatnonzero(~right)
        still_left, still_right = np.flatnonzero(left), np.flatnonzero(right)
        self.static = []
        if len(still_left):
            part = _block(block, _some(block.left, still_left), block.right)
            self.static.append((part, still_left, everything, False))
        if len(still_right) and len(self.moving_left):
            # A product is the same with its factors turned round; inverses are values here.
            one, other = _some(block.right, still_right), _some(block.left, self.moving_left)
            part = _block(block, one, other)
            self.static.append((part, self.moving_left, still_right, True))


def _parts(block):
    if not hasattr(block, "_parts"):
        block._parts = _Parts(block)
    return block._parts


def _some(side, index):
    return Side([side.entries[k] for k in index])


def _block(block, left, right):
    allowed = np.ones((len(left.entries), len(right.entries)), dtype=bool)
    return Block(left, right, allowed, block.cost, block.constant)
