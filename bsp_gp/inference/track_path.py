"""Tracks linearised about a reference: what small changes of the forces do to everything seen.

Along a reference motion x(t) a change of the acceleration, da(t), moves the end of every interval
between two rows by the integral of Phi(end, t) [0, da(t)], Phi the transition of the state; moved
ends are carried on along the track, and the unknown initial states are taken out by an orthogonal
projection. So the whitened residual of a whole track is an affine function of the accelerations at
fixed points of the reference, whichever way they hang on masses and constants.
"""

from copy import copy

import numpy as np

POINTS = {"rk45": 3, "dop853": 5}
"""Gauss points in a step of the pair: exact to the order at which the pair is."""
CURVE_POINTS = 6
MOST_PANELS = 12
"""Steps of an interval that have points of their own; of more steps, even parts have them."""


class ScenePath:
    """The linearised track of one scene.

    Parameters
    ----------
    scene : str
    times : ndarray, shape (P,), s
        Points at which accelerations are asked, in order of time.
    states : ndarray, shape (2, N, d, P)
        Places and velocities of all bodies there, in the order of the scene.
    impulses : ndarray, shape (P, n, h)
        Change of the end of its interval by an acceleration at a point; h = n / 2 coordinates.
    interval : ndarray of int, shape (P,)
        Interval of every point, ascending.
    transitions : ndarray, shape (K, n, n)
    gaps : ndarray, shape (K, n)
        How far intervals miss the next node.
    left : ndarray, shape (T, h)
        Observed minus reference places; nan = not seen.
    sigma : ndarray, shape (T, h)
    prior : ndarray, shape (n,)
        Inverse prior deviations of an initial state.
    rows : sequence of (int, int)
        Pieces of the track with initial states of their own: first row, end.
    is_free : bool
        Whether the reference moves without forces: all of a law is still to be added.
    """

    def __init__(self, scene, times, states, impulses, interval, transitions, gaps, left, sigma,
                 prior, rows, is_free=False):  # fmt: skip
        self.is_free = is_free
        self.scene, self.times, self.states = scene, times, states
        self._impulses = impulses
        self._interval_starts = np.flatnonzero(np.diff(interval, prepend=-1))
        self._interval_ids = interval[self._interval_starts]
        self._sigma = sigma
        self._seen = np.isfinite(left) & np.isfinite(sigma)
        self.n, self.n_intervals, self.n_pieces = prior.size, len(transitions), len(rows)
        length = max(stop - first for first, stop in rows)
        grid = np.array([first for first, _ in rows])[:, None] + np.arange(length)
        self._inside = grid < np.array([stop for _, stop in rows])[:, None]
        self._grid = np.where(self._inside, grid, grid[:, :1])
        inner = self._inside[:, 1:]
        self._steps = np.where(inner, self._grid[:, :-1], 0)  # interval behind a row
        self._moved = np.where(inner[..., None, None], transitions[self._steps], 0.0)
        self._inner = inner
        self._projector = self._columns(prior)
        self.n_seen = int(self._seen.sum())
        left = np.where(self._seen, left, 0.0)
        self.residual = self._whitened(left[..., None], gaps[..., None], sign=-1.0)[:, 0]

    def _columns(self, prior):
        """Orthonormal columns of the whitened initial states, (V, L * h + n, n)."""
        n_pieces, length = self._grid.shape
        x = np.broadcast_to(np.eye(self.n), (n_pieces, self.n, self.n))
        places = [x[:, : self.n // 2]]
        for row in range(length - 1):
            x = self._moved[:, row] @ x
            places.append(x[:, : self.n // 2])
        white = self._white(np.stack(places, axis=1))
        own = np.broadcast_to(np.diag(prior), (n_pieces, self.n, self.n))
        return np.linalg.qr(np.concatenate([white, own], axis=1))[0]

    def _white(self, places):
        """Places (V, L, h, C) over sigma where they were seen, (V, L * h, C)."""
        seen = self._seen[self._grid] & self._inside[..., None]
        white = np.where(seen[..., None], places / self._sigma[self._grid][..., None], 0.0)
        return white.reshape(len(places), -1, places.shape[-1])

    def _carried(self, gaps):
        """Places (V, L, h, C) after gaps (K, n, C) were carried along."""
        n_pieces, length = self._grid.shape
        x = np.zeros((n_pieces, self.n, gaps.shape[-1]))
        places = np.zeros((n_pieces, length, self.n // 2, gaps.shape[-1]))
        jumps = np.where(self._inner[..., None, None], gaps[self._steps], 0.0)
        for row in range(length - 1):
            x = self._moved[:, row] @ x
            x += jumps[:, row]
            places[:, row + 1] = x[:, : self.n // 2]
        return places

    def _whitened(self, left, gaps, sign):
        """Whitened rows of ``left + sign * carried gaps``, initial states taken out, (m, C)."""
        total = self._carried(gaps)
        total *= sign
        if left is not None:
            total += left[self._grid]
        white = self._white(total)
        q = self._projector
        rows = white.shape[1]
        own = np.swapaxes(q[:, :rows], 1, 2) @ white
        white = white - q[:, :rows] @ own
        return np.concatenate([white, -q[:, rows:] @ own], axis=1).reshape(-1, total.shape[-1])

    def apply(self, accelerations):
        """What accelerations at the points add to the whitened prediction.

        Parameters
        ----------
        accelerations : ndarray, shape (P, h, C)

        Returns
        -------
        ndarray, shape (m, C)
        """
        moved = np.add.reduceat(self._impulses @ accelerations, self._interval_starts, axis=0)
        gaps = np.zeros((self.n_intervals, *moved.shape[1:]))
        gaps[self._interval_ids] = moved
        return self._whitened(None, gaps, sign=1.0)

    def axis_squares(self, residual, n_dims):
        """Sum of squares of a whitened residual (m,), and count of what was seen, per axis."""
        pieces = residual.reshape(len(self._grid), -1)[:, : self._grid.shape[1] * (self.n // 2)]
        squares = np.square(pieces).reshape(-1, n_dims).sum(axis=0)
        return squares, self._seen.reshape(-1, n_dims).sum(axis=0)


def paths_of(shooting, nodes, mesh, receivers):
    """Linearise all scenes of a group.

    Parameters
    ----------
    shooting : Shooting
        Whose chains are whole scenes; its motion has the reference's properties and constants.
    nodes : ndarray, shape (2, R, d, T, S)
    receivers : ndarray of int
        Places of the moving bodies among those of a scene.
    """
    flow = shooting.flow
    ends, transitions = flow.run(nodes, mesh)
    transitions = transitions[..., : flow.n_state]
    interval, offset, weight = _points(flow, mesh)
    states, impulses = _impulses(flow, nodes, interval, offset, weight, transitions)
    return _scenes(
        shooting, nodes, ends, transitions, (interval, offset), states, impulses, receivers
    )


def curve_paths(shooting, nodes, receivers):
    """As `paths_of`, about a curve through the nodes: no forces need to be known.

    Coarse rows show accelerations only integrated from row to row; along a curve through what was
    seen they are nearly right whatever the law, and its constants can be read off.
    """
    flow = shooting.flow
    n, half = flow.n_state, flow.n_state // 2
    places, weights = np.polynomial.legendre.leggauss(CURVE_POINTS)
    share = (1 + places) / 2
    interval = np.repeat(np.arange(flow.n_intervals), CURVE_POINTS)
    length = flow.length[interval]
    offset = length * np.tile(share, flow.n_intervals)
    first, last = (nodes[..., flow.row + k, flow.chain][..., interval] for k in (0, 1))
    states = _hermite(first, last, length, offset)
    weight = length * np.tile(weights / 2, flow.n_intervals)
    left = length - offset
    one = np.eye(half)
    impulses = np.concatenate(
        [(left * weight)[:, None, None] * one, weight[:, None, None] * one], axis=1
    )
    transitions = np.broadcast_to(np.eye(n), (flow.n_intervals, n, n)).copy()
    transitions[:, :half, half:] = flow.length[:, None, None] * one
    ends = nodes[..., flow.row, flow.chain].copy()
    ends[0] += ends[1] * flow.length
    return _scenes(
        shooting, nodes, ends, transitions, (interval, offset), states, impulses, receivers,
        is_free=True,
    )  # fmt: skip


def _hermite(first, last, length, offset):
    """States on cubic curves between states (2, R, d, P)."""
    s = offset / length
    p0, v0, p1, v1 = first[0], first[1] * length, last[0], last[1] * length
    place = (
        (2 * s**3 - 3 * s**2 + 1) * p0 + (s**3 - 2 * s**2 + s) * v0
        + (3 * s**2 - 2 * s**3) * p1 + (s**3 - s**2) * v1
    )  # fmt: skip
    slope = (
        6 * (s**2 - s) * (p0 - p1) + (3 * s**2 - 4 * s + 1) * v0 + (3 * s**2 - 2 * s) * v1
    )
    return np.stack([place, slope / length])


def _scenes(
    shooting, nodes, ends, transitions, points, states, impulses, receivers, is_free=False
):
    """The paths of all scenes of a group."""
    flow, chains = shooting.flow, shooting.chains
    interval, offset = points
    gaps = (ends - nodes[..., flow.row + 1, flow.chain]).reshape(flow.n_state, -1).T
    times = flow.start[interval] + offset
    driven = flow.driven.at(times, flow.chain[interval])
    n_own, n_dims = chains.n_moving, chains.n_dims
    n_all = n_own + (0 if driven is None else driven.shape[1])
    everyone = np.empty((2, n_all, n_dims, len(times)))
    everyone[:, receivers] = states
    if driven is not None:
        everyone[:, np.setdiff1d(np.arange(n_all), receivers)] = driven
    out = []
    for s, name in enumerate(chains.scenes):
        mine = flow.chain == s
        number = np.cumsum(mine) - 1  # of a scene's intervals: its rows
        own = np.flatnonzero(mine[interval])
        own = own[np.lexsort((times[own], number[interval[own]]))]
        n_rows = int(chains.lengths[s])
        places = np.moveaxis(nodes[0][..., :n_rows, s], -1, 0)
        left = (chains.observed[:n_rows, s] - places).reshape(n_rows, -1)
        sigma = np.sqrt(shooting.noise.variance[:n_rows, s]).reshape(n_rows, -1)
        pieces = shooting.windows.chain == s
        rows = list(
            zip(shooting.windows.first[pieces], shooting.windows.stop[pieces], strict=True)
        )
        out.append(
            ScenePath(
                name, times[own], everyone[..., own], impulses[own], number[interval[own]],
                transitions[mine], gaps[mine], left, sigma, shooting.prior[:, s], rows, is_free,
            )
        )  # fmt: skip
    return out


def _points(flow, mesh):
    """Interval, time since its start and weight (s) of every quadrature point."""
    if mesh.scheme == "euler":
        return np.arange(flow.n_intervals), np.zeros(flow.n_intervals), flow.length
    count = POINTS[mesh.scheme]
    places, weights = np.polynomial.legendre.leggauss(count)
    interval = np.concatenate([mesh.order[: len(h)] for h in mesh.steps])
    begin, size = np.concatenate(mesh.starts), np.concatenate(mesh.steps)
    many = np.flatnonzero(mesh.counts > MOST_PANELS)
    if len(many):
        few = ~np.isin(interval, many)
        part = np.repeat(flow.length[many] / MOST_PANELS, MOST_PANELS)
        interval = np.concatenate([interval[few], np.repeat(many, MOST_PANELS)])
        begin = np.concatenate([begin[few], np.tile(np.arange(MOST_PANELS), len(many)) * part])
        size = np.concatenate([size[few], part])
    offset = begin[:, None] + size[:, None] * (1 + places) / 2
    weight = size[:, None] * weights / 2
    return np.repeat(interval, count), offset.ravel(), weight.ravel()


def _impulses(flow, nodes, interval, offset, weight, transitions):
    """States at the points, (2, R, d, P), and what accelerations there do, (P, n, h)."""
    n = flow.n_state
    half = n // 2
    if flow.paper_steps:  # v += a h, then p += v h
        h = flow.length[interval, None, None]
        impulses = np.concatenate([h**2 * np.eye(half), h * np.eye(half)], axis=1)
        return nodes[..., flow.row[interval], flow.chain[interval]], impulses
    leg = copy(flow)
    leg.row, leg.chain, leg.start = (v[interval] for v in (flow.row, flow.chain, flow.start))
    leg.length = offset
    states, moved = leg.run(nodes, leg.mesh(nodes))
    # From a point to the end of its interval = over the whole of it, the part before undone.
    rest = np.linalg.solve(
        np.swapaxes(moved[..., :n], 1, 2), np.swapaxes(transitions[interval][..., :n], 1, 2)
    )
    rest = np.swapaxes(rest, 1, 2)[:, :, half:]
    return states, rest * weight[:, None, None]
