"""Numerators and denominators of the best constants of all products at once.

The scorers take ``(search, block, vector, q, ys, mask)``: a direction with its condition as a
vector per unit force, orthonormal columns of what is fitted beside (n, k), targets (n, y) without
their part along these, and the rows that are looked at (n,), None for all. ``products(known)``
gives numerators (y, left, right), denominators (left, right), and the squared sizes of the laws
(left, right), which depend on the rows only and may be handed in again.

Two layouts, one arithmetic: where the left factors depend on properties only, rows of one
receiver and source are summed first (`GroupScorer`), which also allows any covariance along
time; otherwise they live on rows (`RowScorer`) and errors must be independent. Mixed factors
under correlated errors are parted in `correlated`.
"""

import numpy as np

TILE_BYTES = 1 << 26
"""Upper bound of one work array, so that memory does not grow with the data."""
COLLINEAR = 1e-10
"""A candidate whose part orthogonal to the law's free terms is below this is one of them."""
CANCELLED = 1e-13
"""Forces on a body whose squared sum is below this share of their squares are rounding."""


class RowScorer:
    """Left factors on rows; errors independent. Cross terms of sources are pairs of rows."""

    def __init__(self, search, block, vector, q, ys, mask=None):
        self.block = block
        self.rows = rows = search.rows
        regression = search.regression
        scale = flat_scale(regression, rows)
        weighted = vector * scale
        if mask is not None:
            weighted = weighted * _spread(regression, rows, mask)
        active = np.flatnonzero(np.any(weighted, axis=1))
        self.active = active
        self.weighted = weighted[active]
        self.receiver = rows.receiver[active]
        targets = [_spread(regression, rows, ys[:, k])[active] for k in range(ys.shape[1])]
        self.q_rows = np.stack([np.einsum("rd,rd->r", self.weighted, t) for t in targets])
        self.g_rows = [
            np.einsum("rd,rd->r", self.weighted, _spread(regression, rows, q[:, k])[active])
            for k in range(q.shape[1])
        ]

    def products(self, known=None):
        left = self._active(self.block.left)
        right = self._active(self.block.right)
        numerators = [(left * q) @ right.T for q in self.q_rows]
        raw = self._sizes(left, right) if known is None else known
        denominator = raw.copy()
        for g in self.g_rows:
            denominator -= np.square((left * g) @ right.T)
        return numerators, np.where(denominator > COLLINEAR * raw, denominator, 0.0), raw

    def _active(self, side):
        """Values of the rows in which the direction is not zero."""
        values = side.values
        return values if len(self.active) == values.shape[1] else values[:, self.active]

    def _sizes(self, left, right):
        first, second = self._pairs()
        k = np.einsum("rd,rd->r", self.weighted[first], self.weighted[second])
        own = first == second
        apart = self._paired(left, right, first, second, k, np.flatnonzero(own & (k != 0)))
        crossed = np.flatnonzero(~own & (k != 0))
        total = apart + self._paired(left, right, first, second, 2 * k, crossed)
        # Forces of several bodies that cancel leave rounding, which is no law.
        return np.where(total > CANCELLED * apart, total, 0.0)

    def _pairs(self):
        """Pairs of rows with one receiver; the last ones are kept, since directions share them."""
        known = self.rows.__dict__.setdefault("_row_pairs", {})
        key = self.receiver.tobytes()
        if key not in known:
            known.clear()
            known[key] = _row_pairs(self.receiver)
        return known[key]

    def _paired(self, left, right, first, second, k, used):
        """Sum over the pairs of rows `used` of the products of their values, (n_left, n_right)."""
        total = np.zeros((len(left), len(right)))
        step = max(1, TILE_BYTES // (8 * (len(left) + len(right))))
        for start in range(0, len(used), step):
            part = used[start : start + step]
            i, j = first[part], second[part]
            total += (left[:, i] * left[:, j] * k[part]) @ (right[:, i] * right[:, j]).T
        return total


def _row_pairs(receiver):
    """All pairs (first <= second) of rows with one receiver; rows of a receiver are adjacent."""
    firsts, seconds = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    n = len(receiver)
    lag = 0
    while True:
        index = np.arange(n - lag)
        same = index[receiver[: n - lag] == receiver[lag:]] if lag else index
        if not len(same):
            break
        firsts.append(same)
        seconds.append(same + lag)
        lag += 1
    return np.concatenate(firsts), np.concatenate(seconds)


def flat_scale(regression, rows):
    """Scale of the receiver of every row that is kept, axis by axis, shape (P, d)."""
    parts = [
        np.broadcast_to(batch.scale[:, :, :, None], (*shape, batch.scale.shape[-1])).reshape(
            -1, batch.scale.shape[-1]
        )
        for batch, shape in zip(regression.batches, rows.shapes, strict=True)
    ]
    return np.concatenate(parts)[rows.keep]


def _spread(regression, rows, flat):
    """A whitened vector of all receivers repeated for every source row, shape (P, d)."""
    parts, start = [], 0
    for batch, shape in zip(regression.batches, rows.shapes, strict=True):
        n_dims = batch.target.shape[-1]
        size = batch.target.size
        values = flat[start : start + size].reshape(*shape[:3], 1, n_dims)
        parts.append(np.broadcast_to(values, (*shape, n_dims)).reshape(-1, n_dims))
        start += size
    return np.concatenate(parts)[rows.keep]


class GroupScorer:
    """Left factors are constant in time: rows of one receiver and source are summed first."""

    def __init__(self, search, block, vector, q, ys, mask=None):
        self.search = search
        self.block = block
        self.vector = vector
        self.q = q
        self.ys = ys
        self.mask = mask

    def products(self, known=None):
        rows, regression = self.search.rows, self.search.regression
        left = _group_values(self.block.left, rows)
        n_left, n_right = len(left[0]), len(self.block.right.entries)
        numerators = np.zeros((self.ys.shape[1], n_left, n_right))
        raw = np.zeros((n_left, n_right)) if known is None else known
        explained = np.zeros((self.q.shape[1], n_left, n_right))
        vectors = rows.unflatten(self.vector)
        start = 0
        for index, batch in enumerate(regression.batches):
            size = batch.kept.size
            part = slice(start, start + size)
            start += size
            found = numerators, raw if known is None else None, explained
            self._batch(batch, vectors[index], left[index], part, index, *found)
        denominator = raw - np.square(explained).sum(axis=0)
        return numerators, np.where(denominator > COLLINEAR * raw, denominator, 0.0), raw

    def _batch(self, batch, vector, left, part, index, numerators, raw, explained):
        n, s, r, j = self.search.rows.shapes[index]
        d = vector.shape[-1]
        shape = batch.target.shape
        ys = self.ys[part].reshape(*shape, -1)
        q = self.q[part].reshape(*shape, -1)
        seen = None if self.mask is None else self.mask[part].reshape(shape)
        a = left.reshape(len(left), -1)  # (n_left, S R J)
        pairs = (left[..., :, None] * left[..., None, :]).reshape(len(left), -1)
        right = self.block.right.values
        step = max(1, TILE_BYTES // (8 * n * s * r * j * d))
        for first in range(0, len(right), step):
            tile = slice(first, first + step)
            features = self._features(batch, vector, right[tile], index)
            if seen is not None:
                features *= seen[:, :, :, None]
            if raw is not None:
                gram = np.einsum("bnsrjd,bnsrkd->bsrjk", features, features, optimize=True)
                raw[:, tile] += pairs @ gram.reshape(len(gram), -1).T
            dots = np.einsum("bnsrjd,nsrdy->ybsrj", features, ys, optimize=True)
            for y, dot in enumerate(dots):
                numerators[y][:, tile] += a @ dot.reshape(len(features), -1).T
            if q.shape[-1]:
                dots = np.einsum("bnsrjd,nsrdy->ybsrj", features, q, optimize=True)
                for y, dot in enumerate(dots):
                    explained[y][:, tile] += a @ dot.reshape(len(features), -1).T

    def _features(self, batch, vector, right, index):
        """Whitened accelerations of direction x right factor, (b, n, S, R, J, d)."""
        out = []
        for value in right:
            field = vector * self.search.rows.unflatten(value)[index][..., None]
            out.append(batch.whiten(field))
        return np.stack(out)


def _group_values(side, rows):
    """Property factors at one instant of every (scene, receiver, source), per batch."""
    if not hasattr(side, "_grouped"):
        stacked = []
        for index in range(len(rows.shapes)):
            parts = []
            for value in side.values:
                full = rows.unflatten(value)[index]
                # Constant in time: the value of largest size is the value (0 = invalid row).
                pick = np.argmax(np.abs(full), axis=0)
                parts.append(np.take_along_axis(full, pick[None], axis=0)[0])
            stacked.append(np.stack(parts))
        side._grouped = stacked
    return side._grouped
