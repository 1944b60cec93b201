"""The restricted likelihood of noise: what a residual says of it that no free number can change.

Everything that the fit has free is a column: shared ones that reach every channel, and those of
one chain alone. They are made orthonormal once, chain by chain, and taken out of the residual;
under every noise law that is tried thereafter the Gram matrices are well conditioned, and the
columns of the chains are eliminated by Schur complements. The cost is O(rows) per law.
"""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import FitError

_RANK = 1e-10
_LOG_2_PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class PureError:
    """A residual with every column projected out, whitened.

    Attributes
    ----------
    value : float
        Restricted log-likelihood.
    whitened : ndarray, shape (T, C)
    remaining : ndarray, shape (T, C)
        One less the leverage: the variance that the whitened residual has; 0 where not seen.
    """

    value: float
    whitened: np.ndarray
    remaining: np.ndarray


class Restricted:
    """Restricted likelihood of a residual under any noise.

    Parameters
    ----------
    residual : ndarray, shape (T, C)
    seen : ndarray of bool, shape (T, C)
    chain : ndarray of int, shape (C,)
    scale : ndarray, shape (T, C)
        A first guess of the size of the noise; nan = not seen.
    columns : ndarray, shape (p, T, C), optional
        Changes of the residual by what is shared.
    local : ndarray, shape (q, T, C), optional
        Changes by what every chain has of its own.

    Attributes
    ----------
    n_rows, n_free : int
        Rows seen, and the rank of the columns.
    """

    def __init__(self, residual, seen, chain, scale, columns=None, local=None):
        blank = np.empty((0, *residual.shape))
        columns = blank if columns is None else columns
        local = blank if local is None else local
        columns, local = _by_chain(columns, local, chain)
        self._order = np.argsort(chain, kind="stable")
        self._back = np.argsort(self._order)
        ordered = chain[self._order]
        self._first = np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1))
        self._chain = np.cumsum(np.diff(ordered, prepend=ordered[:1]) != 0)
        seen = seen[:, self._order]
        scale = np.where(seen, scale[:, self._order], 1.0)
        rows = np.concatenate([local, columns, residual[None]])[..., self._order]
        rows = np.where(seen, rows, 0.0) / scale
        if not np.all(np.isfinite(rows)):
            raise FitError("the residual and its columns must be finite where a row is seen")
        self._q = len(local)
        self.n_rows = int(np.count_nonzero(seen))
        local, dead = self._local_basis(rows[: self._q])
        rest = rows[self._q :]
        by_channel = _by_channel(local)
        for _ in range(2):  # twice is enough
            along = self._sums(by_channel, _by_channel(rest))
            rest = rest - self._spread(by_channel, along).transpose(1, 2, 0)
        shared = _shared_basis(rest[:-1], rows[self._q : -1])
        residual = rest[-1] - np.tensordot(np.tensordot(shared, rest[-1], 2), shared, 1)
        rows = np.concatenate([local, shared, residual[None]]) * scale
        self._rows = np.ascontiguousarray(rows[..., self._back])
        self._dead = dead.astype(float)[:, :, None] * np.eye(self._q)
        self.n_free = int(dead.size - np.count_nonzero(dead)) + len(shared)

    def _local_basis(self, local):
        """Orthonormal columns of every chain, and which are none, shape (n_chains, q)."""
        n_columns, n_rows, _ = local.shape
        sizes = np.diff(self._first, append=len(self._chain))
        basis = np.zeros_like(local)
        dead = np.ones((len(sizes), n_columns), dtype=bool)
        for size in np.unique(sizes) if n_columns else ():
            chains = np.flatnonzero(sizes == size)
            at = self._first[chains][:, None] + np.arange(size)
            flat = local[:, :, at].transpose(2, 1, 3, 0)
            flat = flat.reshape(len(chains), n_rows * size, n_columns)
            norm = np.linalg.norm(flat, axis=1, keepdims=True)
            flat = flat / np.where(norm > 0, norm, 1.0)
            u, s, _ = np.linalg.svd(flat, full_matrices=False)
            kept = (s > _RANK * s[:, :1]) & (s > 0)
            u = (u * kept[:, None]).reshape(len(chains), n_rows, size, -1)
            found = u.shape[-1]
            basis[:found, :, at] = u.transpose(3, 1, 0, 2)
            dead[chains[:, None], np.arange(found)] = ~kept
        return basis, dead

    def _sums(self, left, right):
        """Scalar products of rows (C, a, T) and (C, b, T) by chain, shape (n_chains, a, b)."""
        return np.add.reduceat(left @ right.transpose(0, 2, 1), self._first, axis=0)

    def _spread(self, left, amounts):
        """Columns (C, a, T) times amounts (n_chains, a, b), shape (C, b, T)."""
        return amounts[self._chain].transpose(0, 2, 1) @ left

    def value(self, whitener):
        """Restricted log-likelihood under a noise; -inf where it cannot be computed."""
        found = self._eliminate(whitener)
        return -math.inf if found is None else found[0]

    @property
    def residual(self):
        """What the columns leave, shape (T, C); 0 where not seen."""
        return self._rows[-1]

    def _eliminate(self, whitener):
        q = self._q
        rows = self._whiten(whitener)
        gram = self._sums(rows, rows)
        try:
            lower = np.linalg.cholesky(gram[:, :q, :q] + self._dead)
            across = np.linalg.solve(lower, gram[:, :q, q:])
            left = gram[:, q:, q:].sum(axis=0) - np.einsum("gqa,gqb->ab", across, across)
            shared = np.linalg.cholesky(left[:-1, :-1])
            along = np.linalg.solve(shared, left[:-1, -1])
        except np.linalg.LinAlgError:
            return None
        square = float(left[-1, -1] - along @ along)
        dets = 2.0 * float(
            np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() + np.log(np.diag(shared)).sum()
        )
        n_left = self.n_rows - self.n_free
        value = -0.5 * (whitener.log_det + dets + square + n_left * _LOG_2_PI)
        if not math.isfinite(value):
            return None
        return value, rows, lower, across, shared, along

    def _whiten(self, whitener):
        """Rows under a noise, shape (C, q + p + 1, T), channels of a chain beside each other."""
        return np.ascontiguousarray(whitener.whiten(self._rows).transpose(2, 0, 1)[self._order])

    def pure_error(self, whitener):
        """The whitened residual after the projection, and its leverage."""
        found = self._eliminate(whitener)
        if found is None:
            raise FitError(
                "the noise of the residual cannot be separated from what is fitted: "
                f"{self.n_rows} numbers were measured, {self.n_free} of what is fitted are free",
                remedy="see whether every column is what it is taken for (bsp-gp check), leave out "
                "stretches in which nothing moves, or add rows",
            )
        value, rows, lower, across, shared, along = found
        q = self._q
        local = np.linalg.solve(lower, np.broadcast_to(np.eye(q), lower.shape))
        local = self._spread(rows[:, :q], local.transpose(0, 2, 1))
        rest = rows[:, q:] - self._spread(local, across)
        inverse = np.linalg.solve(shared, np.eye(len(shared)))
        basis = inverse @ rest[:, :-1]
        leverage = np.square(local).sum(axis=1) + np.square(basis).sum(axis=1)
        whitened = np.empty(leverage.shape[::-1])
        remaining = np.empty(leverage.shape[::-1])
        whitened[:, self._order] = (rest[:, -1] - along @ basis).T
        remaining[:, self._order] = np.clip(1.0 - leverage, 0.0, 1.0).T
        return PureError(value, whitened, np.where(whitener.seen, remaining, 0.0))


def _by_channel(rows):
    """Rows (a, T, C) with channels first, shape (C, a, T)."""
    return np.ascontiguousarray(rows.transpose(2, 0, 1))


def _by_chain(columns, local, chain):
    """Shared columns and those of chains, in which what reaches one chain alone is its own.

    A constant of every body or scene is a column each: as shared ones their cost is that of their
    number, squared.
    """
    if len(columns) < 2:
        return columns, local
    names, of_chain = np.unique(chain, return_inverse=True)
    reached = np.zeros((len(columns), len(names)), dtype=bool)
    np.logical_or.at(reached.T, of_chain, columns.any(axis=1).T)
    is_own = reached.sum(axis=1) == 1
    if not is_own.any() or len(names) == 1:
        return columns, local
    owner = reached[is_own].argmax(axis=1)
    order = np.argsort(owner, kind="stable")
    slot = np.empty(len(owner), dtype=int)  # how many before it reach the same chain
    slot[order] = np.arange(len(owner)) - np.searchsorted(owner[order], owner[order])
    more = np.zeros((slot.max() + 1, *columns.shape[1:]))
    for column, k in zip(columns[is_own], slot, strict=True):
        more[k] += column  # each in the rows of its chain
    return columns[~is_own], np.concatenate([local, more])


def _shared_basis(rest, before):
    """Orthonormal columns of what chains' own columns leave of the shared ones."""
    size = np.sqrt(np.square(before).sum(axis=(1, 2), keepdims=True))
    rest = rest / np.where(size > 0, size, 1.0)
    flat = rest.reshape(len(rest), math.prod(rest.shape[1:])).T
    u, s, _ = np.linalg.svd(flat, full_matrices=False)
    kept = u.T[s > _RANK]
    return kept.reshape(len(kept), *rest.shape[1:])
