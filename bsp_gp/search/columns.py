"""Whitened accelerations of coefficients times directions, many at a time.

The best constant of a single term needs only two numbers, its product with the target and its own
size; where errors are independent they come from the rows on which the direction is not zero,
without the columns ever being spread out. Sums of terms need the columns themselves.
"""

import numpy as np

from bsp_gp.search.scoring import COLLINEAR, flat_scale

BATCH_BYTES = 1 << 25
"""Bound on one work array."""
CANCELLED = 1e-24
"""Forces on a body whose squared sum is below this share of their squares are rounding."""


class Columns:
    """Columns of a regression beside the free terms of a law that is there already.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Whitened target, free terms projected out.
    q : ndarray, shape (n, k)
        Orthonormal basis of the free terms.
    """

    def __init__(self, rows, y, q):
        self.rows = rows
        self.regression = rows.regression
        self.y = y
        self.q = q
        self.is_white = all(batch.whitener is None for batch in self.regression.batches)
        self.receiver = rows.receiver
        self._scale = flat_scale(self.regression, rows) if self.is_white else None
        if self.is_white:
            shape = (len(y) // rows.n_dims, rows.n_dims)
            self._y, self._q = y.reshape(shape), q.T.reshape(q.shape[1], *shape)

    def dots_and_sizes(self, coefficients, vector):
        """Products with the target and squared norms, free terms projected out.

        Parameters
        ----------
        coefficients : list of ndarray, shape (P,)
        vector : ndarray, shape (P, d)

        Returns
        -------
        dots, sizes : ndarray, shape (k,)
            A size is 0 where the column is one of the free terms, or nothing.
        """
        step = max(1, BATCH_BYTES // (8 * vector.size))
        parts = [
            self._some(np.array(coefficients[start : start + step]), vector)
            for start in range(0, len(coefficients), step)
        ]
        dots, sizes = (np.concatenate(part) for part in zip(*parts, strict=True))
        return dots, sizes

    def _some(self, coefficients, vector):
        if not self.is_white:
            columns, sizes = self._projected(coefficients, vector)
            return columns @ self.y, sizes
        active, _, firsts, weighted = self._active(vector)
        if not len(active):
            return np.zeros(len(coefficients)), np.zeros(len(coefficients))
        if len(active) < coefficients.shape[1]:
            coefficients = coefficients[:, active]
        targets = np.concatenate([self._y[None], self._q])[:, self.receiver[active]]
        dots = coefficients @ np.einsum("rd,mrd->rm", weighted, targets)
        raw = np.zeros(len(coefficients))
        for axis in range(weighted.shape[1]):
            field = coefficients * weighted[:, axis]
            if len(firsts) < len(active):
                field = np.add.reduceat(field, firsts, axis=1)
            raw += np.einsum("kr,kr->k", field, field)
        sizes = raw - np.square(dots[:, 1:]).sum(axis=1)
        # What is left of a law that is there already is rounding, not a law; so is what is left
        # of forces of several bodies that cancel.
        apart = np.square(coefficients) @ np.square(weighted).sum(axis=1)
        is_law = (sizes > COLLINEAR * raw) & (raw > CANCELLED * apart)
        return dots[:, 0], np.where(is_law, sizes, 0.0)

    def columns(self, coefficients, vector):
        """Whitened accelerations (k, n), free terms projected out; 0 for one of the free terms."""
        columns, sizes = self._projected(np.array(coefficients), vector)
        return np.where((sizes > 0)[:, None], columns, 0.0)

    def _projected(self, coefficients, vector):
        """Columns less what the free terms explain, and squared sizes; 0 where that is all."""
        columns = self.spread(coefficients, vector)
        raw = np.einsum("kn,kn->k", columns, columns)
        columns = self._less(columns)
        sizes = np.einsum("kn,kn->k", columns, columns)
        return columns, np.where(sizes > COLLINEAR * raw, sizes, 0.0)

    def _active(self, vector):
        """Rows on which a direction acts, their receivers, and where each receiver begins."""
        active = np.flatnonzero(vector.any(axis=1))
        receiver = self.receiver[active]
        firsts = np.flatnonzero(np.concatenate([[True], receiver[1:] != receiver[:-1]]))
        weighted = vector[active] if self._scale is None else (vector * self._scale)[active]
        return active, receiver[firsts] if len(active) else receiver, firsts, weighted

    def spread(self, coefficients, vector):
        """Whitened accelerations (k, n) of coefficients (k, P) times a direction (P, d)."""
        active, receivers, firsts, weighted = self._active(vector)
        n_receivers = sum(int(np.prod(shape[:3])) for shape in self.rows.shapes)
        full = np.zeros((len(coefficients), n_receivers, vector.shape[1]))
        if len(active):
            fields = coefficients[:, active, None] * weighted
            summed = np.add.reduceat(fields, firsts, axis=1)
            apart = np.square(fields).sum(axis=(1, 2))
            is_law = np.square(summed).sum(axis=(1, 2)) > CANCELLED * apart
            full[:, receivers] = np.where(is_law[:, None, None], summed, 0.0)
        if self.is_white:
            return full.reshape(len(coefficients), -1)
        out, offset = [], 0
        for batch, shape in zip(self.regression.batches, self.rows.shapes, strict=True):
            count = int(np.prod(shape[:3]))
            part = full[:, offset : offset + count]
            part = np.moveaxis(part.reshape(len(coefficients), *shape[:3], -1), 0, 3)
            out.append(np.moveaxis(batch.whiten(part), 3, 0).reshape(len(coefficients), -1))
            offset += count
        return np.concatenate(out, axis=1)

    def _less(self, columns):
        """Columns (k, n) less what the free terms of the law explain of them."""
        return columns - (columns @ self.q) @ self.q.T if self.q.shape[1] else columns


class Projected:
    """A regression as the inner level sees it: residual target, free terms projected out."""

    def __init__(self, regression, y, q):
        self.regression = regression
        self.y = y
        self.q = q

    def target(self):
        return self.y

    def residual(self, law):
        predicted = self.regression.target() - self.regression.residual(law)
        return self.y - self._less(predicted)

    def column(self, term, per_entity=False):
        columns, names = self.regression.column(term, per_entity)
        return self._less(columns), names

    def gradient(self, law, term):
        slopes = self.regression.gradient(law, term)
        return {name: self._less(slope) for name, slope in slopes.items()}

    def _less(self, values):
        """Values (n[, k]) less what the free terms explain of them."""
        return values - self.q @ (self.q.T @ values) if self.q.shape[1] else values


def balanced(columns):
    """Columns (n, m) over powers of two that bring their largest numbers next to one.

    Squares then neither overflow nor vanish, and the digits stay as they are.
    """
    _, power = np.frexp(np.max(np.abs(columns), axis=0, initial=0.0))
    return np.ldexp(columns, -power)


def orthonormal(columns, n):
    """Orthonormal basis (n, k) of what columns (n, m) span, whatever their scales; None is none."""
    if columns is None or not np.size(columns):
        return np.zeros((n, 0))
    columns = np.asarray(columns, dtype=float)
    live = balanced(columns[:, np.any(columns, axis=0)])
    if not live.size:
        return np.zeros((n, 0))
    u, s, _ = np.linalg.svd(live / np.linalg.norm(live, axis=0), full_matrices=False)
    return u[:, s > 1e-10 * s[0]]
