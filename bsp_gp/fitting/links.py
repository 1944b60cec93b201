"""What joins the pieces of a track: how forces move it from one piece to the next.

Every piece tells its own first state, whatever forces did before it. That these states must follow
from one another tells what acts slowly: of a constant force a track of k pieces shows k^4 times as
much as a piece of it. States at the begin of every piece are linear in the state at the begin of
the track and in all forces up to there; with the former projected out, what is left are further
moments of independent errors of size one.
"""

from dataclasses import dataclass

import numpy as np

MOST_NUMBERS = 2 * 10**7
"""Bound on a matrix of states by forces."""
GROWN = 1e7
"""Growth of what the first state shows, beyond which nothing is carried on."""


@dataclass(frozen=True, eq=False)
class Links:
    """Moments of C runs of pieces that follow one another, of V pieces at the most.

    Attributes
    ----------
    pieces : ndarray of int, shape (C, V)
        -1 behind the end of a run.
    by_force : ndarray, shape (C, m, V, F)
    by_constant : ndarray, shape (C, m, k)
    left : ndarray, shape (C, m)
    values : ndarray, shape (C, m)
        What forces show in each, squared; they rise.
    """

    pieces: np.ndarray
    by_force: np.ndarray
    by_constant: np.ndarray
    left: np.ndarray
    values: np.ndarray

    def is_exact(self, error):
        """Whether errors of forces, of variances (W, F), show less than noise in all moments."""
        if not error.any():
            return True
        own = np.where((self.pieces >= 0)[..., None], error[self.pieces], 0.0)
        shown = self.by_force * np.sqrt(own)[:, None]
        return bool(np.square(shown).sum(axis=(2, 3)).max(initial=0.0) < 1.0)

    def believed(self, error):
        """The same with larger errors where much is left: by that part of it, on the average."""
        rms = np.sqrt(np.mean(np.square(self.left[self.values > 0]))) if self.values.any() else 0.0
        size = float(np.hypot(1.0, error * rms))
        return Links(
            self.pieces, self.by_force / size, self.by_constant / size, self.left / size,
            self.values / size**2,
        )  # fmt: skip

    def kept(self, keep):
        """The same with the last moments that count in some run, and which do."""
        count = int(keep.sum(axis=1).max(initial=1))
        last, keep = np.s_[:, -count:], keep[:, -count:]
        mine = keep[..., None]
        return Links(
            self.pieces, self.by_force[last] * mine[..., None], self.by_constant[last] * mine,
            self.left[last], self.values[last],
        ), keep  # fmt: skip


def link(pieces, changes, white, nodes, n_state):
    """Join pieces; None where no piece leads to another.

    Parameters
    ----------
    changes : ndarray, shape (L, W, n, F + n + k + 1)
        Of states at every instant, see `_Group.linearised`.
    white : ndarray, shape (W, rows, F + n + k + 1)
        Of whitened rows, what is left of them last.
    nodes : ndarray, shape (2, R, d, L, W)
        States about which this is linear.
    """
    ends = np.isfinite(nodes).all(axis=(0, 1, 2)).sum(axis=0) - 1
    n_forces = changes.shape[0] * n_state // 2
    most = max(int(np.sqrt(MOST_NUMBERS / (n_state * n_forces))), 1)
    found = []
    for run in pieces.runs(most):
        while len(run) > 1:
            rows, count = _states(run, changes, white, nodes, ends, n_state)
            if count > 1:
                found.append((run[:count], _projected(rows, n_state)))
            run = run[max(count, 1) :]
    return _stacked(found, n_forces) if found else None


def _states(run, changes, white, nodes, ends, n):
    """What pieces tell of their first states, (count n, n + V F + k + 1), and up to which, `count`.

    Columns are by the first state of all, forces, constants, and what is left; at `count` changes
    have grown too much.
    """
    n_forces = changes.shape[0] * n // 2
    k = white.shape[2] - n_forces - n - 1
    state = np.eye(n, n + len(run) * n_forces + k + 1)
    rows = []
    for place, piece in enumerate(run):
        mine = slice(n + place * n_forces, n + (place + 1) * n_forces)
        own = white[piece, :, n_forces : n_forces + n]
        q = orthonormal(own[None])[0].T
        row = q @ own @ state
        row[:, -1] *= -1
        row[:, mine] += q @ white[piece, :, :n_forces]
        row[:, -k - 1 :] += q @ white[piece, :, n_forces + n :]
        size = np.abs(row[:, :n]).max()
        if not np.isfinite(row).all() or rows and size > GROWN * np.abs(rows[0][:, :n]).max():
            break
        rows.append(row)
        if place + 1 < len(run):
            moved = changes[ends[piece], piece]
            state = moved[:, n_forces : n_forces + n] @ state
            state[:, mine] += moved[:, :n_forces]
            state[:, -k - 1 :] += moved[:, n_forces + n :]
            gap = nodes[..., ends[piece], piece] - nodes[..., 0, run[place + 1]]
            state[:, -1] += gap.ravel()
    rows = np.concatenate(rows) if rows else np.zeros((0, state.shape[1]))
    count = len(rows) // n
    unused = np.s_[n + count * n_forces : n + len(run) * n_forces]
    return np.delete(rows, unused, axis=1), count


def _projected(rows, n):
    """The same rows without what the first state of all shows, and without its columns."""
    q = orthonormal(rows[None, :, :n])[0]
    return rows[:, n:] - q @ (q.T @ rows[:, n:])


def _stacked(found, n_forces):
    """Runs of pieces in arrays, shorter ones padded."""
    most = max(len(run) for run, _ in found)
    n_rows = max(len(rows) for _, rows in found)
    k = found[0][1].shape[1] - len(found[0][0]) * n_forces - 1
    count = len(found)
    pieces = np.full((count, most), -1)
    by_force = np.zeros((count, n_rows, most * n_forces))
    rest, values = np.zeros((count, n_rows, k + 1)), np.zeros((count, n_rows))
    for at, (run, rows) in enumerate(found):
        pieces[at, : len(run)] = run
        width, height = len(run) * n_forces, len(rows)
        shown, vectors = np.linalg.eigh(rows[:, :width] @ rows[:, :width].T)
        turned = vectors.T @ rows
        by_force[at, -height:, :width] = turned[:, :width]
        rest[at, -height:] = turned[:, width:]
        values[at, -height:] = np.maximum(shown, 0.0)
    shape = (count, n_rows, most, n_forces)
    return Links(pieces, by_force.reshape(shape), rest[..., :-1], rest[..., -1], values)


def less_exact(by_force, moments, error):
    """Moments (W, m, c) of unit error that were so but for errors of forces, variances (W, F)."""
    if not error.any():
        return moments
    covariance = (by_force * error[:, None]) @ np.swapaxes(by_force, 1, 2)
    lower = np.linalg.cholesky(covariance + np.eye(covariance.shape[1]))
    return np.linalg.solve(lower, moments)


def orthonormal(matrices):
    """Orthonormal bases of the columns of matrices (W, m, n); columns without effect give none."""
    size = np.linalg.norm(matrices, axis=1, keepdims=True)
    u, s, _ = np.linalg.svd(matrices / np.where(size > 0, size, 1.0), full_matrices=False)
    return u * (s > 1e-9 * s.max(axis=1, keepdims=True))[:, None]
