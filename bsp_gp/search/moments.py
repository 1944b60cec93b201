"""Scores of products on moments of tracks, in which forces on several bodies mix.

On other regressions every row belongs to one receiver. Where a force on one body moves another
one's track, the rows of a scene have to be taken together: what each receiver and source adds to
the moments is computed first, and property factors weigh these.
"""

from __future__ import annotations

import numpy as np

from bsp_gp.search.scoring import TILE_BYTES, GroupScorer, values_of

__all__ = ["MomentScorer"]


class MomentScorer(GroupScorer):
    """As `GroupScorer`, for batches whose `whitener` leads to moments (S, m, n, R, d)."""

    def _batch(self, batch, vector, left, part, index, numerators, raw, explained):
        n, s, r, j = self.search.rows.shapes[index]
        m = batch.whitener.shape[1]
        targets = np.concatenate([self.ys[part], self.q[part]], axis=1)
        n_y = self.ys.shape[1]
        targets = np.moveaxis(targets.reshape(m, s, -1), 1, 0)  # (S, m, y)
        whitener = np.ascontiguousarray(np.moveaxis(batch.whitener, 3, 1)).reshape(s, r, m, -1)
        groups = left.reshape(len(left), s, r * j)
        right = values_of(self.block.right)
        widest = max(n * vector.shape[-1], m, targets.shape[2])
        step = max(1, TILE_BYTES // (8 * s * r * j * widest))
        for first in range(0, len(right), step):
            tile = slice(first, first + step)
            seen = self._seen(whitener, vector, right[tile], index)  # (S, m, b, g)
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

    def _seen(self, whitener, vector, right, index):
        """What direction x right factor adds to the moments by every receiver and source."""
        n, s, r, j, d = vector.shape
        values = np.stack([self.search.rows.unflatten(value)[index] for value in right])
        field = vector[None] * values[..., None]  # (b, n, S, R, J, d)
        field = np.ascontiguousarray(field.transpose(2, 3, 1, 5, 0, 4)).reshape(s, r, n * d, -1)
        seen = whitener @ field  # (S, R, m, b J)
        seen = seen.reshape(s, r, -1, len(right), j)
        return np.ascontiguousarray(seen.transpose(0, 2, 3, 1, 4)).reshape(
            s, seen.shape[2], len(right), r * j
        )


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
