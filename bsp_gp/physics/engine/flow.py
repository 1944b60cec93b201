"""Motion from every measured row to the next, with its exact derivatives.

All intervals between rows of all chains are integrated at once, each from a state of its own
(a *node*): `Flow.run` gives where every interval ends and how that depends on its start and on the
constants (the variational equations, MECHANICS "Effect of a force on a track"). How nodes are
joined to tracks is the business of `bsp_gp.fitting.shooting`.

Steps are chosen interval by interval by the error estimate of an embedded Runge-Kutta pair and are
then frozen (a `Mesh`), so that a fit sees one smooth function of its unknowns. Where a condition
changes within a step, the step ends there, and the derivatives jump (saltation).
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import DOP853, RK45

from bsp_gp.physics.engine.chains import spread
from bsp_gp.physics.engine.driven import Driven
from bsp_gp.physics.engine.events import chained, passed_over, through_events, up_to_events
from bsp_gp.physics.engine.motion import Points

BLOCK, MOST_NUMBERS = 2048, 1 << 24
"""Intervals that are integrated together, and derivatives of accelerations in all stages of a
step: bound the memory, and how long it is until the time is looked at."""
MAX_STEPS = 400
FINER, AMPLIFIED, MAX_CHECKS = 30.0, 3.0, 4
"""Errors are asked to be so many times smaller in a check; ends may move by so many tolerances;
checks after which steps are not complete."""
BRIEF = 1e-4
"""Part of an interval within which a contact may begin and end unseen."""
FEW_STEPS = 2
"""Steps up to which an interval is cheapest by the pair of lower order."""
CALL = 50
"""Intervals whose step costs as much as what a step costs however few they are."""
MANY_SLOPES, MOST_CARRIED = 18, 48
"""Derivatives of accelerations up to which they are multiplied one by one, and numbers of a state
up to which compiled loops are faster at it than products of matrices."""
SAFETY, LEAST_FACTOR, LARGEST_FACTOR = 0.9, 0.2, 6.0


@dataclass(frozen=True, eq=False)
class Scheme:
    """An explicit Runge-Kutta pair.

    Attributes
    ----------
    a : ndarray, shape (s, s)
    b, c : ndarray, shape (s,)
    errors : tuple of ndarray, shape (s + 1,)
        Weights of the stages (the last is at the end of the step) in the error estimates.
    exponent : float
        A step's error grows as h to the power 1 / exponent.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    errors: tuple
    exponent: float

    @property
    def n_stages(self):
        return len(self.b)


SCHEMES = {
    "rk45": Scheme(np.ascontiguousarray(RK45.A), RK45.B, RK45.C, (RK45.E,), 1 / 5),
    "dop853": Scheme(
        np.ascontiguousarray(DOP853.A), DOP853.B, DOP853.C, (DOP853.E5, DOP853.E3), 1 / 8
    ),
}
"""Dormand and Prince's pairs of order 5(4) and 8(5, 3), as scipy has them."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Steps of every interval.

    Attributes
    ----------
    scheme : str
        Name in `SCHEMES`, or "euler": the paper's single symplectic step (its equation 1).
    order : ndarray of int, shape (K,)
        Intervals, those of most steps first.
    starts, steps : tuple of ndarray
        Per step number the time since the interval's start and the length of the step, s, of the
        first intervals in that order.
    hits : tuple of ndarray of int
        Likewise the bounces at the ends of steps, as of `Walls.hits`.
    is_complete : bool
        Whether the integration came to the end of every interval.
    """

    scheme: str
    order: np.ndarray
    starts: tuple
    steps: tuple
    hits: tuple
    is_complete: bool = True

    @property
    def counts(self):
        """Steps of every interval, shape (K,)."""
        counts = np.zeros(len(self.order), dtype=int)
        for steps in self.steps:
            counts[self.order[: len(steps)]] += 1
        return counts

    @property
    def n_hits(self):
        """Bounces within every interval, shape (K,)."""
        counts = np.zeros(len(self.order), dtype=int)
        for hits in self.hits:
            counts[self.order[: len(hits)]] += hits >= 0
        return counts

    @property
    def cost(self):
        """What a run costs, in evaluations at one point."""
        return SCHEMES[self.scheme].n_stages * sum(CALL + len(steps) for steps in self.steps)

    def is_as_fine_as(self, other):
        """Whether it has at least the other's steps in every interval."""
        if self.scheme != other.scheme or not self.is_complete:
            return False
        has_these = np.array_equal(self.n_hits, other.n_hits)
        return has_these and bool(np.all(self.counts >= other.counts))


class Flow:
    """Integrates a law over all intervals of some chains.

    Parameters
    ----------
    tolerance : ndarray, shape (S,), metres
        Error that one interval of a chain may have.
    paper_steps : bool
        Take the paper's symplectic Euler step from row to row, conditions as they are at its
        start.
    max_steps : int
        Steps within one interval beyond which an integration is given up.
    is_over : callable, optional
        Asked before every step, with the share of all intervals that take it; where it is true,
        meshes are not complete and ends are nan.
    """

    def __init__(
        self, motion, tolerance, paper_steps=False, max_steps=MAX_STEPS, is_over=None
    ):  # fmt: skip
        chains = motion.chains
        self.motion, self.chains = motion, chains
        self.tolerance = np.asarray(tolerance, dtype=float)
        self.paper_steps, self.max_steps = paper_steps, max_steps
        self.is_over = is_over or (lambda share: False)
        with np.errstate(invalid="ignore"):
            running = np.isfinite(chains.times[1:]) & np.isfinite(chains.times[:-1])
        self.row, self.chain = np.nonzero(running)
        self.start = chains.times[self.row, self.chain]
        self.length = chains.times[self.row + 1, self.chain] - self.start
        self.driven = Driven(chains)
        self.n_state = 2 * chains.n_moving * chains.n_dims
        self.n_constants = len(motion.parameters)
        self.pattern = np.array(motion.slope_pattern(), dtype=np.int64).reshape(-1, 2)
        is_plain = not motion.linkages and (motion.is_folded or not motion.constraints)
        self.is_compiled = is_plain and motion.compiled is not None
        self.is_carried = self.is_compiled and self.n_state <= MOST_CARRIED
        self.is_sparse = self.is_carried or len(self.pattern) <= MANY_SLOPES

    @property
    def has_events(self):
        """Whether steps may have to end where a condition changes or a body stops."""
        return self.motion.has_modes or self.motion.has_stops

    @property
    def n_intervals(self):
        return len(self.row)

    def _share(self, n_open):
        """What a step of some intervals costs, as a share of a step of all of them."""
        return (n_open + CALL) / (self.n_intervals + CALL)

    def count(self, n_open):
        """Count a step of some intervals as work."""
        self.is_over(self._share(n_open))

    # --- points ----------------------------------------------------------------------------------

    def points(self, state, times, chain, modes=None):
        """Points with their driven bodies and, unless given, the modes that hold there."""
        found = Points(state, times, chain, self.driven.at(times, chain), modes or [])
        if modes is not None:
            return found
        return Points(state, times, chain, found.driven, self.motion.modes_at(found))

    def at(self, nodes, row, chain, modes=None):
        """Points at nodes (2, R, d, T, S) of some rows."""
        return self.points(nodes[..., row, chain], self.chains.times[row, chain], chain, modes)

    def held(self, nodes):
        """Nodes (2, R, d, T, S) put on the constraints of the law."""
        own = self.motion.constraints
        return self._changed(nodes, own.held, []) if own else nodes

    def righted(self, nodes):
        """Nodes behind walls as they are in front of them."""
        walls = self.motion.walls
        if not walls:
            return nodes
        return self._changed(nodes, lambda points: walls.righted(points, self.motion.acceleration))

    def _changed(self, nodes, change, modes=None):
        """Nodes (2, R, d, T, S) with states in the place of those at measured rows."""
        row, chain = np.nonzero(np.isfinite(self.chains.times))
        changed = nodes.copy()
        changed[..., row, chain] = change(self.at(nodes, row, chain, modes))
        return changed

    def tangent(self, nodes, row, chain):
        """Derivatives of nodes that are put on the constraints, (M, n, n + k); None if none are."""
        if not self.motion.constraints:
            return None
        return self.motion.constraints.tangent(self.at(nodes, row, chain, []))

    def step(self, scheme, points, h):
        """One step of a scheme with the modes frozen.

        Returns
        -------
        end : ndarray, shape (2, R, d, M)
        rates : ndarray, shape (s, 2, R, d, M)
        """
        stages = _Stages(self, scheme, points, h)
        if not self.is_compiled or stages.has_rest():
            stages.take()
        return stages.end, stages, stages.rates

    def _rate(self, points):
        return np.stack([points.state[1], self.motion.acceleration(points)])

    def step_slopes(self, scheme, stages, h, first=None):
        """Derivatives at the end of a step by something before it and by the constants.

        They are of the shape of `first`.

        Parameters
        ----------
        first : ndarray, shape (n, n + k, M) or (M, n, n + k), optional
            Derivatives of the start of the step, by default by itself. Points stand on the last
            axis where few derivatives of the law differ from zero (`is_sparse`).
        """
        n, m = self.n_state, len(h)
        if first is None:
            first = self.first_slopes(m)
        if self.is_carried and stages.inputs is not None:
            return stages.carry(first)
        carried = self._sparse_slopes if self.is_sparse else self._dense_slopes
        return carried(scheme, stages, h, first, n // 2, m)

    def first_slopes(self, m):
        """Derivatives of m starts by themselves, as `step_slopes` takes them."""
        one = np.eye(self.n_state, self.n_state + self.n_constants)
        return np.tile(one[..., None], m) if self.is_sparse else np.tile(one, (m, 1, 1))

    def _sparse_slopes(self, scheme, stages, h, first, half, m):
        by_state, by_constant = self.motion.slope_rows(stages.joined())
        rates = np.empty((scheme.n_stages, *first.shape))
        for s in range(scheme.n_stages):
            change = first + h * _weighted(scheme.a[s, :s], rates) if s else first
            part = slice(s * m, (s + 1) * m)
            rates[s, :half] = change[half:]
            forces = rates[s, half:]
            forces[:, : 2 * half] = 0.0
            forces[:, 2 * half :] = by_constant[..., part]
            for row, column in self.pattern.tolist():
                forces[row] += by_state[row, column, part] * change[column]
        return first + h * _weighted(scheme.b, rates)

    def _dense_slopes(self, scheme, stages, h, first, half, m):
        by_state, by_constant = self.motion.slopes(stages.joined())
        rates = np.empty((scheme.n_stages, *first.shape))
        h = h[:, None, None]
        for s in range(scheme.n_stages):
            change = first + h * _weighted(scheme.a[s, :s], rates) if s else first
            part = slice(s * m, (s + 1) * m)
            rates[s, :, :half] = change[:, half:]
            np.matmul(by_state[part], change, out=rates[s, :, half:])
            rates[s, :, half:, 2 * half :] += by_constant[part]
        return first + h * _weighted(scheme.b, rates)

    # --- steps -----------------------------------------------------------------------------------

    def mesh(self, nodes):
        """Steps with which every interval ends where it should, or which are not complete.

        Errors that single steps make within their bound may grow behind them (a passage near a
        centre): meshes for smaller errors are compared until the ends stay.
        """
        mesh, ends = self._quick_mesh(nodes)
        factor = 1.0
        if self.paper_steps or not mesh.is_complete:
            return mesh
        for _ in range(MAX_CHECKS):
            factor /= FINER
            finer, better = self._mesh(nodes, mesh.scheme, factor)
            if not finer.is_complete:
                break
            change = np.abs(better - ends)[0].max(axis=(0, 1))
            if np.all(change <= AMPLIFIED * self.tolerance[self.chain]):
                return mesh
            mesh, ends = finer, better
        return replace(mesh, is_complete=False)

    def quick_mesh(self, nodes):
        """Steps chosen by the error of the embedded pair alone: good enough on the way."""
        return self._quick_mesh(nodes)[0]

    def _quick_mesh(self, nodes):
        """The same with where the intervals end."""
        if self.paper_steps:
            order = np.arange(self.n_intervals)
            none = (np.full(len(order), -1),)
            return Mesh("euler", order, (np.zeros(len(order)),), (self.length,), none), None
        low = self._mesh(nodes, "rk45")
        n_low = sum(len(h) for h in low[0].steps)
        is_short = n_low <= FEW_STEPS * self.n_intervals and len(low[0].steps) <= 2 * FEW_STEPS
        if is_short and low[0].is_complete:
            return low
        high = self._mesh(nodes, "dop853")
        if high[0].is_complete and low[0].is_complete:
            return high if high[0].cost < low[0].cost else low
        return high if high[0].is_complete else low

    def _mesh(self, nodes, name, factor=1.0, has_aims=True):
        """Steps of a scheme by its error estimate, within a part of the tolerance; their ends.

        With `has_aims` the next node tells where a bounce is that an interval leaves undecided.
        """
        scheme = SCHEMES[name]
        n = self.n_intervals
        state = nodes[..., self.row, self.chain]
        done, h = np.zeros(n), np.abs(self.length)
        cut = np.full(n, np.inf)  # steps that a wall ends
        taken = []
        open_, complete = np.arange(n), True
        scale = factor * self._scales(nodes)
        modes = self.points(state, self.start, self.chain).modes
        for _ in range(self.max_steps):
            if not len(open_) or self.is_over(self._share(len(open_))):
                break
            points = self.points(
                state[..., open_], self.start[open_] + done[open_], self.chain[open_],
                [mode[..., open_] for mode in modes],
            )  # fmt: skip
            left, whole = self.length[open_] - done[open_], np.abs(self.length[open_])
            size = left / np.ceil(np.abs(left) / np.maximum(h[open_], 1e-300) - 1e-9)
            size = np.minimum(size, cut[open_])
            with np.errstate(all="ignore"):
                end, stages, rates = self.step(scheme, points, size)
                error = self._error(scheme, end, points, rates, size, scale[:, self.chain[open_]])
                good = error <= 1.0
                growth = SAFETY * np.where(error > 0, error, 1e-12) ** -scheme.exponent
            growth = np.where(np.isfinite(growth), growth, LEAST_FACTOR)
            if self.has_events:
                passed = passed_over(self, points, end, size) & (np.abs(size) > BRIEF * whole)
                good, growth = good & ~passed, np.where(passed, LEAST_FACTOR, growth)
            h[open_] = np.abs(size) * np.clip(growth, LEAST_FACTOR, LARGEST_FACTOR)
            if self.has_events:
                end, size, good = up_to_events(
                    self, scheme, stages, end, size, modes, open_, good
                )
            hit = np.full(len(open_), -1)
            if self.motion.walls:
                end, hit, cut[open_] = self._turned_back(
                    points, end, size, left, whole, nodes[..., self.row[open_] + 1, points.chain]
                    if has_aims else None,
                )
                good &= np.isinf(cut[open_])
            gone = open_[good]
            taken.append((gone, done[gone], size[good], hit[good]))
            state[..., gone] = end[..., good]
            done[gone] += size[good]
            lost = h[open_] < 1e-12 * whole
            complete &= not lost.any()
            open_ = open_[~lost & (np.abs(done[open_]) < whole * (1 - 1e-12))]
        return _packed(name, n, taken, complete and not len(open_)), state

    def _turned_back(self, points, end, size, left, whole, aims):
        """Ends of steps behind bounces, which these are, lengths of steps that end too late."""
        there = self.points(end, points.times + size, points.chain, points.modes)
        pull = self.motion.acceleration(there)
        hit, cut = self.motion.walls.hits(end, points.chain, pull, size, left, whole, aims)
        return self._bounced(there, hit), hit, np.where(cut < size, cut, np.inf)

    def _bounced(self, there, hit, total=None):
        """States at ends of steps behind their bounces; derivatives `total` change in place."""
        end = there.state.copy()
        for number in np.unique(hit[hit >= 0]).tolist():
            which = np.flatnonzero(hit == number)
            state, by_state, by_constant = self.motion.walls.bounced(
                there.pick(which), number, self.motion.acceleration, total is not None
            )
            end[..., which] = state
            if total is not None:
                moved = np.concatenate([by_state, by_constant], axis=2)
                if self.is_sparse:
                    before = np.moveaxis(total[..., which], -1, 0)
                    total[..., which] = np.moveaxis(chained(before, moved, self.n_state), 0, -1)
                else:
                    total[which] = chained(total[which], moved, self.n_state)
        return end

    def advance(self, state, chain, begin, end):
        """States (2, R, d, M) of chains at other times, earlier or later; nan where that fails."""
        leg = copy(self)
        # A chain may be asked for at several times: each has a row of its own.
        order = np.argsort(chain, kind="stable")
        row = np.empty(len(chain), dtype=int)
        row[order] = np.arange(len(chain)) - np.searchsorted(chain[order], chain[order])
        leg.row, leg.chain = row, chain
        leg.start, leg.length = begin, end - begin
        nodes = np.zeros((*state.shape[:-1], row.max(initial=0) + 1, self.chains.n_chains))
        nodes[..., row, chain] = state
        mesh, ends = leg._mesh(nodes, "dop853", has_aims=False)
        if not mesh.is_complete:
            gone = np.zeros(len(chain))
            for steps in mesh.steps:
                gone[mesh.order[: len(steps)]] += steps
            ends[..., np.abs(gone - leg.length) > 1e-9 * np.abs(leg.length)] = np.nan
        return ends

    def _scales(self, nodes):
        """Error that a place and a velocity of each chain may have in one step, (2, S)."""
        extent = np.ptp(nodes[0], axis=2).max(axis=(0, 1))
        speed = np.abs(nodes[1]).max(axis=(0, 1, 2))
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = np.where(extent > 0, speed / extent, 0.0)
        span = spread(self.chains.times)
        span = np.where(span > 0, span, 1.0)
        rate = np.where(np.isfinite(rate) & (rate > 0), rate, 1.0 / span)
        return np.stack([self.tolerance, self.tolerance * np.maximum(rate, 1.0 / span)])

    def _error(self, scheme, end, points, rates, h, scale):
        """Estimated error of a step in parts of what it may have, (M,)."""
        last = self._rate(self.points(end, points.times + h, points.chain, points.modes))
        parts = []
        for weights in scheme.errors:
            error = h * (_weighted(weights[:-1], rates) + weights[-1] * last)
            parts.append(np.abs(error / scale[:, None, None]).max(axis=(0, 1, 2)))
        if len(parts) == 1:
            return parts[0]
        fifth, third = parts  # Hairer, Norsett and Wanner, II.10
        size = np.sqrt(fifth**2 + 0.01 * third**2)
        return np.where(size > 0, fifth**2 / np.where(size > 0, size, 1.0), 0.0)

    # --- runs ------------------------------------------------------------------------------------

    def run(self, nodes, mesh, slopes=True):
        """Integrate every interval from its node.

        Parameters
        ----------
        nodes : ndarray, shape (2, R, d, T, S)

        Returns
        -------
        ends : ndarray, shape (2, R, d, K)
        transitions : ndarray, shape (K, n, n + k) or None
            Derivatives of the ends by the nodes and by the constants.
        """
        n, k = self.n_state, self.n_constants
        ends = np.empty((2, self.chains.n_moving, self.chains.n_dims, self.n_intervals))
        transitions = np.empty((self.n_intervals, n, n + k)) if slopes else None
        with np.errstate(all="ignore"):
            size = 12 * max(n * n // 2, 1)
            length = int(np.clip(MOST_NUMBERS // size, 1, BLOCK))
            for first in range(0, self.n_intervals, length):
                block = slice(first, first + length)
                index = mesh.order[block]
                if mesh.scheme == "euler":
                    end, moved = self._run_euler(nodes, index, slopes)
                else:
                    end, moved = self._run_block(nodes, mesh, index, block, slopes)
                ends[..., index] = end
                if slopes:
                    transitions[index] = moved
        return ends, transitions

    def _run_block(self, nodes, mesh, index, block, slopes):
        scheme = SCHEMES[mesh.scheme]
        state = nodes[..., self.row[index], self.chain[index]]
        start, chain = self.start[index], self.chain[index]
        modes = self.points(state, start, chain).modes
        total = None
        for begin, size, hits in zip(mesh.starts, mesh.steps, mesh.hits, strict=True):
            n_open = min(len(size) - block.start, len(index))
            if n_open <= 0:
                break
            if self.is_over(self._share(n_open)):
                state = np.full_like(state, np.nan)
                break
            open_ = slice(0, n_open)
            h = size[block][:n_open]
            points = self.points(
                state[..., open_], start[open_] + begin[block][:n_open], chain[open_],
                [mode[..., open_] for mode in modes],
            )  # fmt: skip
            end, stages, _ = self.step(scheme, points, h)
            if slopes:
                if total is None:
                    total = self.first_slopes(len(index))
                part = (..., open_) if self.is_sparse else open_
                before = total[part].copy()
                total[part] = self.step_slopes(scheme, stages, h, before)
            if self.has_events:
                end, own = through_events(
                    self, scheme, stages, end, h, modes, np.arange(n_open), slopes
                )
                for m, moved in own.items():
                    at = (..., m) if self.is_sparse else m
                    total[at] = chained(before[at], moved, self.n_state)
            if self.motion.walls:
                there = self.points(end, points.times + h, points.chain, points.modes)
                end = self._bounced(there, hits[block][:n_open], total)
            state[..., open_] = end
        if slopes and total is None:
            total = np.full((len(index), self.n_state, self.n_state + self.n_constants), np.nan)
        elif slopes and self.is_sparse:
            total = np.moveaxis(total, -1, 0)
        return state, total

    def _run_euler(self, nodes, index, slopes):
        """The paper's step: v += a h, then p += v h."""
        chain, h = self.chain[index], self.length[index]
        points = self.points(nodes[..., self.row[index], chain], self.start[index], chain)
        p, v = points.state
        v = v + self.motion.acceleration(points, holds=False) * h
        end = np.stack([p + v * h, v])
        if not slopes:
            return end, None
        n, k = self.n_state, self.n_constants
        half = n // 2
        by_state, by_constant = self.motion.slopes(points, holds=False)
        moved = np.zeros((len(h), n, n + k))
        h = h[:, None, None]
        moved[:, half:, :n] = by_state * h
        moved[:, np.arange(n), np.arange(n)] += 1.0
        moved[:, half:, n:] = by_constant * h
        moved[:, :half] += moved[:, half:] * h
        return end, moved


class _Stages:
    """One step of a scheme with the modes frozen, and the stages (s, 2, R, d, M) that it came by.

    `inputs` is what compiled loops read beside states, if it was taken by these.
    """

    def __init__(self, flow, scheme, points, h):
        self.flow, self.scheme, self.first, self.h = flow, scheme, points, h
        self.times, self.inputs = points.times + scheme.c[:, None] * h, None
        if flow.is_compiled:
            compiled = flow.motion.compiled
            driven = flow.driven.at(self.times, points.chain)
            self.inputs = compiled.inputs(self.times, points.chain, driven, points.modes)
            self.end, self.states, self.rates = compiled.step(
                scheme, points.state, h, self.inputs
            )

    def take(self):
        """Take it stage by stage: forces act through constraints, or hold who is at rest."""
        scheme, points, h = self.scheme, self.first, self.h
        y, motion = points.state, self.flow.motion
        self.inputs = None
        self.states, self.rates = (np.empty((scheme.n_stages, *y.shape)) for _ in range(2))
        self.states[0], self.rates[0, 0] = y, y[1]
        self.rates[0, 1] = motion.acceleration(points)
        for k in range(1, scheme.n_stages):
            state = y + h * _weighted(scheme.a[k, :k], self.rates)
            here = self.flow.points(state, self.times[k], points.chain, points.modes)
            self.states[k], self.rates[k, 0] = state, state[1]
            self.rates[k, 1] = motion.acceleration(here)
        self.end = y + h * _weighted(scheme.b, self.rates)

    def has_rest(self):
        """Whether a body that friction may stop is at rest in a stage: it may be held there."""
        motion, velocities = self.flow.motion, self.states[:, 1]
        return any(
            motion.are_at_rest(group, self.first, velocities).any()
            for group in range(len(motion.stops))
        )

    def joined(self):
        """The points of all stages, one stage after the other."""
        n_stages, *shape, n = self.states.shape
        chain = np.tile(np.arange(self.flow.chains.n_chains)[self.first.chain], n_stages)
        driven = self.flow.driven.at(self.times, self.first.chain)
        if driven is not None and driven.shape[-1] == n:
            driven = np.tile(driven, n_stages)
        return Points(
            np.moveaxis(self.states, 0, -2).reshape(*shape, n_stages * n), self.times.ravel(),
            chain, driven, [np.tile(mode, n_stages) for mode in self.first.modes],
        )  # fmt: skip

    def carry(self, first):
        """Derivatives at the end by what they are of at the start, (n, n + k, M)."""
        return self.flow.motion.compiled.carry(
            self.scheme, self.states, self.h, self.inputs, self.flow.pattern, first
        )


def _weighted(weights, rates):
    """Sum of the first rates, each times its weight: one matrix product."""
    count = len(weights)
    flat = rates[:count].reshape(count, -1)
    return (weights @ flat).reshape(rates.shape[1:])


def _packed(name, n, taken, is_complete):
    """Steps (intervals, times since their starts, lengths, hits) in the order taken, as a mesh."""
    if not taken:
        return Mesh(name, np.arange(n), (), (), (), is_complete)
    interval, begin, size, hit = (np.concatenate(part) for part in zip(*taken, strict=True))
    counts = np.bincount(interval, minlength=n)
    order = np.argsort(-counts, kind="stable")
    by_interval = np.argsort(interval, kind="stable")
    begin, size, hit = begin[by_interval], size[by_interval], hit[by_interval]
    first = np.cumsum(counts) - counts
    starts, lengths, hits = [], [], []
    for number in range(counts.max(initial=0)):
        rows = first[order[: int((counts > number).sum())]] + number
        starts.append(begin[rows])
        lengths.append(size[rows])
        hits.append(hit[rows])
    return Mesh(name, order, tuple(starts), tuple(lengths), tuple(hits), is_complete)
