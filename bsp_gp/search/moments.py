"""Scores of products on moments of tracks, in which forces on several bodies mix.

On other regressions every row belongs to one receiver. Where a force on one body moves another
one's track, the rows of a scene have to be taken together: what each receiver and source adds to
the moments is computed first, and property factors weigh these.
"""

import numpy as np

from bsp_gp.search.scoring import TILE_BYTES, GroupScorer

SAME = 1e-13
"""Part of the patterns of sources that is rounding."""


class MomentScorer(GroupScorer):
    """As `GroupScorer`, for batches whose `whitener` leads to moments (S, m, n, R, d)."""

    def _batch(self, batch, vector, left, part, index, numerators, raw, explained):
        n, s, r, j = self.search.rows.shapes[index]
        m = batch.whitener.shape[1]
        targets = np.concatenate([self.ys[part], self.q[part]], axis=1)
        n_y = self.ys.shape[1]
        targets = np.moveaxis(targets.reshape(m, s, -1), 1, 0)  # (S, m, y)
        whitener = np.ascontiguousarray(np.moveaxis(batch.whitener, 3, 1)).reshape(s, r, m, -1)
        weights, groups = _patterns(left.reshape(len(left), s, r, j))
        right = self.block.right.values
        own = groups.shape[2] // r  # patterns, or sources, of each receiver
        widest = max(n * max(vector.shape[-1] * own, j), max(m, targets.shape[2]) * own)
        step = max(1, TILE_BYTES // (8 * s * r * widest))
        for first in range(0, len(right), step):
            tile = slice(first, first + step)
            seen = self._seen(whitener, vector, right[tile], index, weights)  # (S, m, b, g)
            if self.mask is not None:
                mask = self.mask[part].reshape(m, s).T
                seen = seen * mask[:, :, None, None]
            flat = seen.reshape(s, m, -1)
            dots = (np.swapaxes(targets, 1, 2) @ flat).reshape(s, -1, *seen.shape[2:])
            found = np.einsum("sybg,lsg->ylb", dots, groups, optimize=True)
            numerators[:, :, tile] += found[:n_y]
            explained[:, :, tile] += found[n_y:]
            if raw is not None:
                raw[:, tile] += _sizes(seen, groups)

    def _seen(self, whitener, vector, right, index, weights):
        """What direction x right factor adds to the moments by every receiver and source.

        Or by every pattern of sources, where there are `weights` (S, R, K, J).
        """
        n, s, r, j, d = vector.shape
        values = np.stack([self.search.rows.unflatten(value)[index] for value in right])
        if weights is None:
            field = vector[None] * values[..., None]  # (b, n, S, R, J, d)
            field = field.transpose(2, 3, 1, 5, 0, 4)
        else:
            j = weights.shape[2]
            weighed = np.einsum("nsrjd,srkj->srndkj", vector, weights).reshape(s, r, n, d * j, -1)
            field = weighed @ np.ascontiguousarray(values.transpose(2, 3, 1, 4, 0))
            field = np.swapaxes(field.reshape(s, r, n, d, j, -1), 4, 5)
        field = np.ascontiguousarray(field).reshape(s, r, n * d, -1)
        seen = whitener @ field  # (S, R, m, b J)
        seen = seen.reshape(s, r, -1, len(right), j)
        return np.ascontiguousarray(seen.transpose(0, 2, 3, 1, 4)).reshape(
            s, seen.shape[2], len(right), r * j
        )


def _patterns(left):
    """Patterns in which left factors weigh the sources of a receiver, where these are fewer.

    Sources of equal properties are one, and a factor of the receiver's own weighs all alike: of
    many sources few sums have to be seen. Weights are (S, R, K, J), None where every source is its
    own pattern; groups, (n_left, S, R K), are what each factor makes of every pattern.
    """
    n_left, s, r, j = left.shape
    if j > 1:
        size = np.abs(left).max(axis=3, keepdims=True)
        rows = np.moveaxis(left / np.where(size > 0, size, 1.0), 0, 2)  # (S, R, left, J)
        u, share, weights = np.linalg.svd(rows, full_matrices=False)
        count = max(int((share > SAME * share[..., :1]).sum(axis=2).max()), 1)
        if count < j:
            of_each = u[..., :count] * share[..., None, :count]
            groups = np.moveaxis(of_each, 2, 0) * size
            return weights[:, :, :count], groups.reshape(n_left, s, r * count)
    return None, left.reshape(n_left, s, r * j)


def _sizes(seen, groups):
    """Squared sizes of all products, (left, b)."""
    n_groups = seen.shape[3]
    if n_groups == 1:
        own = np.square(seen[..., 0]).sum(axis=1)  # (S, b)
        return np.square(groups[..., 0]) @ own
    if n_groups**2 <= seen.shape[1]:
        gram = np.einsum("smbg,smbh->sbgh", seen, seen, optimize=True)
        return np.einsum("sbgh,lsg,lsh->lb", gram, groups, groups, optimize=True)
    out = np.zeros((len(groups), seen.shape[2]))
    for k, weights in enumerate(groups):
        out[k] = np.square(seen @ weights[:, None, :, None]).sum(axis=(0, 1))[:, 0]
    return out
