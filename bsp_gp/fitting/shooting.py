"""Nodes joined to tracks: whole-track least squares with the initial states eliminated.

Every row of a track has a node, the state from which the interval behind it is integrated. The
linearised condition that intervals join end to end expresses all nodes of a *window* (a piece of
a track, at last the whole of it) by its first one and the constants (condensing; Bock's multiple
shooting); the first node is then eliminated by an orthogonal factorisation, window by window. What
remains is a small dense problem in the constants. Nodes need not join while a fit is under way,
which makes its basin wide: from nodes read off the data, a law linear in its constants is fitted
in a step or two, however long the track.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bsp_gp.fitting.unseen import tied
from bsp_gp.physics.engine.chains import spread
from bsp_gp.physics.engine.seen import sight

STATE_PRIOR = 1e4
"""Prior standard deviation of an initial state, in extents of its track (and that over its span):
determines what the data do not, and nothing else."""
EXACT = 1e-3
"""Deviation of what is exact of a first state, in those of a row (and that over a span)."""
CLOSED = 0.1
"""Errors of rows that what is known of a first state may move them, for it not to be open."""
TALL = 128
"""Rows of a block in factorisations of tall matrices: blocks stay in the cache."""
MOST_DAMPINGS = 60
ROUNDED = 4
"""Last digits of a state that an integration loses."""
ROUNDINGS = 16
"""Gaps of so many last digits of the largest coordinate are none."""
FARTHEST = 0.5
"""Extents of a window that its nodes may move in one step."""
GROUPED = 2.0
"""Mean step in median ones from which rows come in groups, as in nights."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Rows ``first:stop`` of each `chain` (W,) that have initial states of their own."""

    chain: np.ndarray
    first: np.ndarray
    stop: np.ndarray

    @property
    def length(self):
        return self.stop - self.first


def cut_windows(lengths, rows=None, times=None):
    """Windows of about so many rows each (None: whole chains), none shorter than three.

    Chains without rows have none.

    Parameters
    ----------
    times : ndarray, shape (T, S), s, optional
        Where they are given, and a chain has gaps, windows end where they would last longer than
        so many rows do: what happens between is not seen. They may have fewer than three rows then.
    """
    chain, first, stop = [], [], []
    for s, n in enumerate(lengths.tolist()):
        if not n:
            continue
        count = 1 if rows is None else max(1, n // max(rows, 3))
        edges = np.linspace(0, n, count + 1).astype(int)
        if rows is not None and times is not None and has_gaps(times[:n, s], max(rows, 3)):
            edges = _edges_of_spans(times[:n, s], max(rows, 3))
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            chain.append(s)
            first.append(a)
            stop.append(b)
    return Windows(*(np.array(v, dtype=int) for v in (chain, first, stop)))


def has_gaps(times, rows=3):
    """Whether a gap between rows is longer than so many usual steps, or rows come in groups."""
    steps = np.diff(times)
    if len(steps) < 2:
        return False
    return bool(steps.max() > rows * np.median(steps) or in_groups(times))


def in_groups(times):
    """Whether rows come in groups, as in nights."""
    steps = np.diff(times)
    return bool(len(steps) > 2 and steps.mean() > GROUPED * np.median(steps))


def most_steps(chains):
    """Usual steps that the longest chain lasts, which is its rows where it has no gaps."""
    most = 0
    for s, n in enumerate(chains.lengths.tolist()):
        times = chains.times[:n, s]
        if has_gaps(times):
            n = int((times[-1] - times[0]) / np.median(np.diff(times))) + 1
        most = max(most, n)
    return most


def _edges_of_spans(times, rows):
    """Where windows end that last no longer than so many steps of the usual length."""
    most = rows * np.median(np.diff(times))
    edges = [0]
    for k in range(1, len(times)):
        if times[k] - times[edges[-1]] > most:
            edges.append(k)
    return np.array([*edges, len(times)])


@dataclass(frozen=True, eq=False)
class Condensed:
    """A group of windows, linearised and with its initial states eliminated.

    Attributes
    ----------
    columns : ndarray, shape (L, W, n, n + k + 1)
        Changes of every node by the window's first node, by the constants, and what the nodes
        lack to join (last column).
    shown : ndarray, shape (L, W, n / 2, n + k + 1)
        What is seen of them.
    factor : ndarray, shape (W, n + k + 1, n + k + 1)
        Triangular factor of the whitened columns.
    """

    columns: np.ndarray
    shown: np.ndarray
    factor: np.ndarray

    def image(self, reins):
        """What the step of every first node takes off the whitened residual, (W, n).

        Levenberg's and Marquardt's where it is to be shorter than Gauss and Newton's: what the
        rows determine least, and where the linearisation goes wrong first, is shortened most.

        Parameters
        ----------
        reins : ndarray, shape (W,)
            Lengths, in those of Gauss-Newton steps.
        """
        n = self.columns.shape[2]
        image = self.factor[:, :n, -1]
        some = np.flatnonzero(reins < 1.0)
        if not len(some):
            return image
        triangle = self.factor[some, :n, :n]
        lengths = np.sqrt(np.square(triangle).sum(axis=1))
        scaled = triangle / np.where(lengths > 0, lengths, 1.0)[:, None]
        is_finite = np.isfinite(scaled).all(axis=(1, 2))
        left, s, _ = np.linalg.svd(np.where(is_finite[:, None, None], scaled, 0.0))
        part = np.einsum("wij,wi->wj", left, np.where(is_finite[:, None], image[some], 0.0))
        damping = _dampings(s, part, reins[some])[:, None]
        image = image.copy()
        image[some] = np.einsum("wij,wj->wi", left, s * s / (s * s + damping) * part)
        return np.where(reins[:, None] > 0, image, 0.0)


def known_states(chains, noise):
    """Known first states of chains and deviations, (n, S), nan = unknown; None if all are."""
    if chains.begun is None or not np.isfinite(chains.begun).any():
        return None
    n_chains, half = chains.n_chains, chains.n_moving * chains.n_dims
    size = np.abs(np.nan_to_num(chains.observed)).max(axis=(0, 2, 3), initial=0.0)
    least = np.maximum(EXACT * noise.least, ROUNDINGS * np.finfo(float).eps * size)
    span = spread(chains.times)
    least = np.repeat(np.stack([least, least / np.where(span > 0, span, 1.0)]), half, axis=0)
    values = chains.begun.reshape(2 * half, n_chains)
    errors = np.maximum(chains.begun_errors.reshape(2 * half, n_chains), least)
    return values, np.where(np.isfinite(values), errors, np.nan)


class Shooting:
    """The tracks of some chains as a least-squares problem in the constants."""

    def __init__(self, flow, noise, windows):
        self.flow = flow
        self.chains = flow.chains
        self.noise = noise
        self.windows = windows
        self._number = np.full(self.chains.times.shape, -1)
        self._number[flow.row, flow.chain] = np.arange(flow.n_intervals)
        self.prior = self._prior()
        self.known = known_states(self.chains, noise)
        self._tied = tied(flow.motion)
        self._extents = self._window_extents()
        size = np.abs(np.nan_to_num(self.chains.observed)).max(axis=(0, 2, 3), initial=0.0)
        self._rounding = ROUNDINGS * np.finfo(float).eps * size

    def _window_extents(self):
        """How far bodies go within each window, (W,), m; at least a part of the whole track's."""
        windows, observed = self.windows, self.chains.observed
        whole = spread(observed).max(axis=(1, 2))
        out = np.empty(len(windows.chain))
        seen = np.isfinite(observed)
        low, high = np.where(seen, observed, np.inf), np.where(seen, observed, -np.inf)
        for k, (s, a, b) in enumerate(zip(windows.chain, windows.first, windows.stop, strict=True)):
            reach = high[a:b, s].max(axis=0) - low[a:b, s].min(axis=0)
            out[k] = max(float(np.max(reach, initial=0.0)), 1e-3 * whole[s])
        return np.where(out > 0, out, np.inf)

    def _prior(self):
        """Inverse prior deviations of the state, (n, S)."""
        chains = self.chains
        extent = spread(chains.observed).max(axis=(1, 2))
        extent = np.where(extent > 0, extent, 1.0)
        span = spread(chains.times)
        half = self.flow.n_state // 2
        return np.repeat(
            np.stack([1 / (STATE_PRIOR * extent), span / (STATE_PRIOR * extent)]), half, axis=0
        )

    # --- linearising -----------------------------------------------------------------------------

    def linearise(self, values, nodes, mesh):
        """Condense all windows about a point.

        Parameters
        ----------
        values : ndarray, shape (k,)
            Of the constants.
        nodes : ndarray, shape (2, R, d, T, S)

        Returns
        -------
        residual : ndarray, shape (m,)
        jacobian : ndarray, shape (m, k)
            States eliminated; a step dx of the constants leaves ``residual - jacobian @ dx``.
        rests : ndarray, shape (W,)
            What of the sum of squares the initial states alone would remove, window by window in
            the order of the groups; nan where a motion is not finite.
        condensed : list of Condensed
            One per group of windows, to hand to `move`.
        """
        flow = self.flow
        flow.motion.set_constants(values)
        ends, transitions = flow.run(nodes, mesh)
        gaps = self._gaps(ends, nodes).reshape(flow.n_state, -1).T
        n, k = flow.n_state, flow.n_constants
        seen = sight(flow, nodes)
        # A motion without finite values is no track; its rows must not pass for unseen ones.
        is_lost = np.zeros(self.chains.times.shape, dtype=bool)
        is_lost[flow.row, flow.chain] = ~np.isfinite(gaps).all(axis=1)
        condensed, residuals, jacobians, rests = [], [], [], []
        for group in self.groups:
            columns = self._columns(group, transitions, gaps, self._begun(group, values, nodes))
            rows, inside = self._rows(group, len(columns))
            shown = seen.shown(columns, rows, self.windows.chain[group], n)
            factor = self._factor(group, shown, seen.places, nodes)
            condensed.append(Condensed(columns, shown, factor))
            residuals.append(factor[:, n:, -1].reshape(-1))
            jacobians.append(factor[:, n:, n : n + k].reshape(len(residuals[-1]), k))
            # The interval behind the last row of a window is not its own.
            chain = self.windows.chain[group]
            lost = (is_lost[rows[:-1], chain] & inside[1:]).any(axis=0)
            rests.append(np.where(lost, np.nan, np.square(factor[:, :n, -1]).sum(axis=1)))
        return (
            np.concatenate(residuals), np.concatenate(jacobians), np.concatenate(rests), condensed
        )  # fmt: skip

    def gaps(self, nodes, mesh):
        """How far intervals miss the next node, in places, shape (R, d, K)."""
        ends, _ = self.flow.run(nodes, mesh, slopes=False)
        return self._gaps(ends, nodes)[0]

    def _gaps(self, ends, nodes):
        """How far intervals miss the next node, (2, R, d, K); what rounding alone makes is none.

        Where tracks part fast, a gap in the last digit at their first row would move their last
        one by more than errors allow.
        """
        flow = self.flow
        gaps = ends - nodes[..., flow.row + 1, flow.chain]
        places = self._rounding[flow.chain]
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.stack([places, places / np.abs(flow.length)])
        return np.where(np.abs(gaps) <= floor[:, None, None], 0.0, gaps)

    @cached_property
    def groups(self):
        """Windows of like length together, so that little is padded: lists of window numbers."""
        sizes = np.ceil(np.log2(np.maximum(self.windows.length, 1)) * 2).astype(int)
        return [np.flatnonzero(sizes == size) for size in np.unique(sizes)]

    def _begun(self, group, values, nodes):
        """How first nodes hang on themselves or, of bodies without rows, on constants."""
        n, k = self.flow.n_state, self.flow.n_constants
        begun = np.tile(np.eye(n, n + k + 1), (len(group), 1, 1))
        first, chain = self.windows.first[group], self.windows.chain[group]
        kept = self.flow.tangent(nodes, first, chain)
        if kept is not None:
            begun[..., : n + k] = kept
        for state, number in self._tied:
            begun[:, state] = 0.0
            begun[:, state, n + number] = 1.0
            now = nodes.reshape(n, *nodes.shape[3:])[state, first, chain]
            begun[:, state, -1] = values[number] - now
        return begun

    def _columns(self, group, transitions, gaps, begun):
        """How all nodes of the windows hang on their first ones, (L, W, n, n + k + 1).

        Long windows are cut into blocks that are condensed side by side and joined afterwards, so
        that the number of steps grows as the root of the number of rows.
        """
        windows = self.windows
        first, chain = windows.first[group], windows.chain[group]
        length = windows.length[group]
        longest = int(length.max())
        size = max(int(np.sqrt(longest / 2)), 8)
        if longest <= 4 * size:
            return self._chained(first, chain, length, transitions, gaps, begun)
        n_blocks = -(-(longest - 1) // size)
        offset = size * np.arange(n_blocks)
        block_first = (first[:, None] + offset).ravel()
        # A block ends with the first node of the next one.
        block_length = np.clip(length[:, None] - offset, 0, size + 1).ravel()
        alone = np.tile(np.eye(*begun.shape[1:]), (len(block_first), 1, 1))
        local = self._chained(
            block_first, np.repeat(chain, n_blocks), block_length, transitions, gaps, alone
        )
        local = local.reshape(size + 1, len(group), n_blocks, *local.shape[2:])
        n = local.shape[-2]
        columns = np.zeros((n_blocks * size + 1, len(group), *local.shape[-2:]))
        start = begun
        for block in range(n_blocks):
            joined = local[:, :, block, :, :n] @ start
            joined[..., n:] += local[:, :, block, :, n:]
            columns[block * size : (block + 1) * size + 1] = joined
            start = joined[-1]
        return columns[:longest]

    def _chained(self, first, chain, length, transitions, gaps, begun):
        """Columns of pieces of tracks from those of their first nodes, step after step."""
        n, k = self.flow.n_state, self.flow.n_constants
        columns = np.zeros((max(int(length.max()), 1), len(first), n, n + k + 1))
        columns[0] = begun
        for row in range(len(columns) - 1):
            open_ = np.flatnonzero(row + 1 < length)
            number = self._number[first[open_] + row, chain[open_]]
            moved = transitions[number]
            after = moved[:, :, :n] @ columns[row, open_]
            after[:, :, n : n + k] += moved[:, :, n:]
            after[:, :, -1] += gaps[number]
            columns[row + 1, open_] = after
        return columns

    def _pulls(self, group, nodes):
        """How far first nodes are from what is known of them, and how sure that is, (W, n) each."""
        n, (values, errors) = self.flow.n_state, self.known
        first, chain = self.windows.first[group], self.windows.chain[group]
        there, surely = values[:, chain], 1.0 / errors[:, chain]
        now = nodes.reshape(n, *nodes.shape[3:])[:, first, chain]
        is_known = np.isfinite(there) & (first == 0)
        return (np.where(is_known, v, 0.0).T for v in (there - now, surely))

    def misfit_of_known(self, nodes):
        """Sum of squares of what nodes miss of known first states, and how many those are."""
        if self.known is None:
            return 0.0, 0
        values, errors = self.known
        left = (values - nodes.reshape(self.flow.n_state, *nodes.shape[3:])[:, 0]) / errors
        half = len(left) // 2  # a place that is exact is a row already
        return float(np.nansum(np.square(left))), int(np.isfinite(left[half:]).sum())

    def _factor(self, group, shown, places, nodes):
        """Triangular factor of the whitened columns and residual of each window."""
        n, k = self.flow.n_state, self.flow.n_constants
        chains, windows = self.chains, self.windows
        n_own, n_dims = chains.n_moving, chains.n_dims
        length, n_windows = shown.shape[:2]
        rows, inside = self._rows(group, length)
        chain = windows.chain[group]
        observed = chains.observed[rows, chain]
        left = observed - places[rows, chain] - shown[..., -1].reshape(observed.shape)
        left = np.where(inside[..., None, None], left, np.nan)  # not seen
        moved = shown[..., :-1].reshape(length, n_windows, n_own, n_dims, n + k)
        stacked = np.concatenate([np.moveaxis(moved, -1, 0), left[None]])
        white = self.noise.whiten(stacked, rows, chain)  # (n + k + 1, L, W, R, d)
        white = np.moveaxis(white, 2, 0).reshape(n_windows, n + k + 1, -1)
        matrix = np.zeros((n_windows, white.shape[2] + n, n + k + 1))
        matrix[:, : white.shape[2]] = np.swapaxes(white, 1, 2)
        own = white.shape[2] + np.arange(n)
        matrix[:, own, np.arange(n)] = self.prior[:, chain].T
        if self.known is not None:
            away, surely = self._pulls(group, nodes)
            matrix[:, own, np.arange(n)] += surely
            matrix[:, own, -1] = away * surely
        return _triangles(matrix)

    def _reined(self, change, inside, group, nodes):
        """Part of its change that each window may make, so that none leaves its surroundings.

        Those are where bodies were seen, and as far beyond as the law would take them.
        """
        half = self.flow.n_state // 2
        farthest = np.where(inside[..., None], np.abs(change[..., :half]), 0.0).max(axis=(0, 2))
        allowed = FARTHEST * self._extents[group]
        for w in np.flatnonzero(farthest > allowed):
            allowed[w] = max(allowed[w], FARTHEST * self._reach(group[w], nodes))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(farthest > allowed, allowed / farthest, 1.0)

    def _reach(self, window, nodes):
        """How far a lasting acceleration under the law takes a body in the time of a window.

        And a velocity that it is known to begin with.
        """
        flow, chain = self.flow, self.windows.chain[window]
        rows = np.arange(self.windows.first[window], self.windows.stop[window])
        rows = rows[rows < self.chains.lengths[chain]]
        times, at = self.chains.times[rows, chain], np.full(len(rows), chain)
        with np.errstate(all="ignore"):
            pushes = flow.motion.acceleration(flow.at(nodes, rows, at))
            lasting = np.abs(np.median(pushes, axis=-1)).max()  # that of an oscillation is none
        lasts = times[-1] - times[0]
        reach = np.nan_to_num(0.5 * lasting * lasts**2, posinf=0.0)
        if self.chains.begun is not None and not rows[0]:
            known = np.abs(self.chains.begun[1, ..., chain])
            reach += np.nan_to_num(known).max() * lasts
        return float(reach) if np.isfinite(reach) else 0.0

    def _rows(self, group, length):
        first, stop = self.windows.first[group], self.windows.stop[group]
        rows = first + np.arange(length)[:, None]
        inside = rows < stop
        return np.where(inside, rows, first), inside

    def columns(self, condensed, n_most):
        """Changes of the predicted places by initial states and constants, whole tracks.

        Local ones are (n_most, T, S, R, d), shared ones (k, T, S, R, d). Local ones beyond the
        chain's own are zero.
        """
        n, k = self.flow.n_state, self.flow.n_constants
        shape = self.chains.observed.shape
        local, shared = np.zeros((n_most, *shape)), np.zeros((k, *shape))
        for group, part in zip(self.groups, condensed, strict=False):
            rows, inside = self._rows(group, len(part.columns))
            places = np.moveaxis(part.shown, -1, 0)
            places = places.reshape(n + k + 1, *places.shape[1:3], *shape[2:])
            at = np.nonzero(inside)
            chain = self.windows.chain[group][at[1]]
            local[:n, rows[at], chain] = places[:n][:, at[0], at[1]]
            shared[:, rows[at], chain] = places[n : n + k][:, at[0], at[1]]
        if self.known is not None:
            local[:n] *= self._is_open(local[:n])[:, None, :, None, None]
        return local, shared

    def _is_open(self, local):
        """Which numbers of first states rows may change, (n, S): others are known better.

        Places are seen at least as well as they are known.
        """
        size = np.sqrt(np.where(np.isfinite(self.noise.variance), self.noise.variance, np.inf))
        most = np.abs(local / size).max(axis=(1, 3, 4))
        errors = np.where(np.isfinite(self.known[1]), self.known[1], np.inf)
        with np.errstate(invalid="ignore"):  # of what nothing is known, and rows tell nothing
            is_open = ~(errors * most < CLOSED)
        is_open[: len(is_open) // 2] = True
        return is_open

    def rounding(self, condensed, nodes):
        """Fall of chi-squared that the last digits of first nodes alone foresee."""
        n, total = self.flow.n_state, 0.0
        for group, part in zip(self.groups, condensed, strict=True):
            lengths = np.sqrt(np.square(part.factor[:, :n, :n]).sum(axis=1))
            first = self.windows.first[group], self.windows.chain[group]
            state = nodes.reshape(n, *nodes.shape[3:])[:, first[0], first[1]].T
            moved = ROUNDED * np.finfo(float).eps * lengths * state
            total += float(np.nansum(np.square(moved)))
        return total

    @property
    def n_blocks(self):
        return sum(map(len, self.groups))

    def chains_of(self, chosen):
        """Chains of the windows that are chosen, (W,) in the order of the groups."""
        order = np.concatenate(self.groups) if self.groups else np.zeros(0, dtype=int)
        return np.unique(self.windows.chain[order[chosen]])

    def move(self, nodes, condensed, step, share=1.0, reins=1.0):
        """The nodes after a step of the constants.

        Parameters
        ----------
        nodes : ndarray, shape (2, R, d, T, S)
        step : ndarray, shape (k,)
        share : float
            Part of the step that initial states and gaps make of their own.
        reins : float or ndarray, shape (W,)
            How long that step of initial states is, see `Condensed.image`, window by window in the
            order of the groups; 0 leaves a window as it is.
        """
        n, k = self.flow.n_state, self.flow.n_constants
        nodes = nodes.copy()
        reins, first = np.broadcast_to(reins, self.n_blocks), 0
        for group, part in zip(self.groups, condensed, strict=True):
            factor = part.factor
            some = reins[first : first + len(group)]
            first += len(group)
            right = share * part.image(some) - factor[:, :n, n : n + k] @ step
            own = np.linalg.solve(factor[:, :n, :n], right[..., None])[..., 0]
            weights = np.concatenate(
                [own, np.broadcast_to(step, (len(group), k)), np.full((len(group), 1), share)],
                axis=1,
            )
            change = np.einsum("lwij,wj->lwi", part.columns, weights)
            change = np.where(some[:, None] > 0, change, 0.0)
            rows, inside = self._rows(group, len(change))
            change *= self._reined(change, inside, group, nodes)[:, None]
            shape = (*change.shape[:2], 2, *nodes.shape[1:3])
            change = np.moveaxis(change.reshape(shape), (2, 3, 4), (0, 1, 2))
            at = np.nonzero(inside)
            chain = self.windows.chain[group][at[1]]
            nodes[..., rows[at], chain] += change[..., at[0], at[1]]
        return nodes


def _dampings(s, image, shares):
    """Dampings (W,) by which ``s / (s**2 + damping) * image`` gets so many times shorter.

    Newton's method on the inverse length, from the left, to 10 %.
    """
    squares = s * s
    step = image / np.where(s > 0, s, 1.0)
    wanted = shares * np.sqrt(np.square(step).sum(axis=1))
    damping = np.zeros(len(s))
    for _ in range(MOST_DAMPINGS):
        damped = squares + damping[:, None]
        step = s / np.where(damped > 0, damped, 1.0) * image
        length = np.sqrt(np.square(step).sum(axis=1))
        open_ = (length > 1.1 * wanted) & (wanted > 0)
        if not open_.any():
            break
        slope = (np.square(step) / np.where(damped > 0, damped, 1.0)).sum(axis=1)
        more = (length - wanted)[open_] / wanted[open_] * np.square(length[open_]) / slope[open_]
        damping[open_] += more
    return damping


def _triangles(matrices):
    """Triangular factors of tall matrices (W, m, c), shape (W, c, c): by blocks of rows first."""
    n_matrices, n_rows, n_columns = matrices.shape
    tall = max(TALL, 2 * n_columns)  # of a block that is not tall nothing is taken away
    while n_rows > 4 * tall:
        n_blocks = n_rows // tall
        whole = matrices[:, : n_blocks * tall].reshape(-1, tall, n_columns)
        factors = np.linalg.qr(whole, mode="r").reshape(n_matrices, -1, n_columns)
        matrices = np.concatenate([factors, matrices[:, n_blocks * tall :]], axis=1)
        n_rows = matrices.shape[1]
    factors = np.linalg.qr(matrices, mode="r")
    return np.pad(factors, ((0, 0), (0, max(n_columns - factors.shape[1], 0)), (0, 0)))
