"""What forces beside a fitted law would do to its tracks, as a regression for searches.

A force that acts along a track moves it by the response of the linearised motion (MECHANICS,
"Effect of a force on a track"). In few moments of the track, of independent errors of size one and
with all initial states projected out, this is a linear regression in the force: laws of a grammar,
smooth forces that know no physics, and noise that was simulated are all weighed on the same rows,
whether they are dense or coarse.

Forces are evaluated where the bodies were: on tracks smoothed by a free force as strong and as
smooth as the data ask for, so that the answer does not hang on how wrong the fitted law is. These
places are in error, and so are forces that change with the place: moments count as far as that
allows.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bsp_gp.fitting.channels import split
from bsp_gp.fitting.free_force import NOTHING, STRENGTHS, FreeForce, in_units
from bsp_gp.fitting.links import less_exact, link, orthonormal
from bsp_gp.fitting.parts.inclined import stretched
from bsp_gp.fitting.pieces import cut_pieces
from bsp_gp.fitting.shooting import known_states
from bsp_gp.fitting.tracks import chain_noises
from bsp_gp.fitting.unseen import as_driven
from bsp_gp.fitting.weighing import as_normal, bears_outliers, to_begin_with
from bsp_gp.physics.bodies import stack, subset, under
from bsp_gp.physics.engine.chains import spread
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from bsp_gp.physics.engine.seen import sight
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.physics.evaluation import Instants
from bsp_gp.physics.regression import Regression, RegressionBatch, checked
from bsp_gp.threads import one_thread

PHASE = 0.4
"""Radians that a motion may turn between two instants at which forces are evaluated."""
MOST_INSTANTS = 8
"""Instants per row at the most."""
HIT_ERROR = 1e-6
"""Error of an interval, in the largest coordinate, when bounces are counted."""
MOST_LOOKED_AT = 20_000
"""Intervals by which that is told, spread evenly."""
LOST, LEAST_SHOWN, MOST_SHOWN = 0.1, 100.0, 1e6
"""Chi-squared that moments may lose which are left out, where forces show so much at least; what
shows more may lose as great a part of it."""
MUCH_LOWER, SURELY = 0.7, 10.0
"""Level of the pure error that counts, in that of a fit, and nats by which it must be likelier."""
RESOLVED = 1e-6
"""Part of what is left that is beyond the moments: forces act in steps from instant to instant."""
PASSES, WORSE = 3, 2.0
"""Times that tracks are smoothed, and how many times as much may be left of them afterwards."""
INEXACT = 0.02
"""Part of what is left of slow motion that is not believed: no exacter are forces between rows."""
MEMORIES = 3.0
"""Correlation times that pieces must last for their noise to be independent of one another."""
MOST_KEPT = 1 << 24
"""Moments of laws that are kept, in numbers."""
ALIKE = 1e-8
"""Part of what a force shows by which it may differ from what it shows elsewhere."""
MOST_JOINED = 2000
"""Instants of joined pieces whose memory of a free force is followed."""


@dataclass(frozen=True, eq=False)
class ResponseBatch(RegressionBatch):
    """Pieces of tracks of like-built scenes.

    Attributes
    ----------
    whitener : ndarray, shape (S, m, n, R, d)
        Moments of unit error by the acceleration at every instant.
    kept : ndarray of bool, shape (m, S, 1, 1)
    moments : ndarray, shape (m, S)
        What is to be explained.
    """

    moments: np.ndarray | None = None

    def whiten(self, values):
        """Moments of accelerations (n, S, R, ..., d), shape (m, S, 1, ..., 1)."""
        valid = self.valid[(slice(None),) * 3 + (None,) * (values.ndim - 4)]
        values = np.where(valid, values, 0.0)
        (n, s, r), d = values.shape[:3], values.shape[-1]
        flat = np.moveaxis(values, (1, -1), (0, 3)).reshape(s, n * r * d, -1)
        with np.errstate(over="ignore", invalid="ignore"):
            out = self.whitener.reshape(s, -1, n * r * d) @ flat
            # Of a force that acts along a rod rounding is left, which must not pass for a trace.
            most = self._reach * np.linalg.norm(flat, axis=1, keepdims=True)
            size = np.abs(out).max(axis=1, keepdims=True, initial=0.0)
            out = np.where(size > NOTHING * most, out, 0.0)
        return np.moveaxis(out, 0, 1).reshape(*out.shape[1::-1], 1, *values.shape[3:-1], 1)

    def of(self, chosen):
        """The same of some of the pieces, by their numbers."""
        return replace(
            self, bodies=subset(self.bodies, chosen),
            scene_names=tuple(self.scene_names[k] for k in chosen),
            whitener=self.whitener[chosen],
            **{name: getattr(self, name)[:, chosen]
               for name in ("times", "positions", "velocities", "target", "valid", "scale", "kept",
                            "moments")},
        )  # fmt: skip

    def in_plane(self, matrix):
        """The same of forces in a plane to whose places a matrix (d, d) takes those seen."""
        return replace(
            self, positions=self.positions @ matrix.T, velocities=self.velocities @ matrix.T,
            whitener=self.whitener @ np.linalg.inv(matrix),
        )  # fmt: skip

    @cached_property
    def _reach(self):
        """What a force of length one may show in a moment, at the most, (S, 1, 1)."""
        rows = self.whitener.reshape(*self.whitener.shape[:2], -1)
        return np.linalg.norm(rows, axis=2).max(axis=1, initial=0.0)[:, None, None]

    def whitened_target(self):
        """The moments, shape (m, S, 1, 1)."""
        return self.moments[..., None, None]

    def whitened_residual(self, predicted):
        return self.whitened_target() - self.whiten(predicted)


class ResponseRegression(Regression):
    """A regression on moments of tracks, which are costly: those of laws are kept."""

    @cached_property
    def _known(self):
        return {}

    def in_plane(self, matrix):
        return replace(self, batches=tuple(batch.in_plane(matrix) for batch in self.batches))

    def scaled(self, scale):
        """The same with moments scaled, (n,)."""
        batches, first = [], 0
        for batch in self.batches:
            shape = batch.kept.shape[:2]
            own = scale[first : first + batch.kept.size].reshape(shape)
            first += batch.kept.size
            whitener = batch.whitener * own.T[:, :, None, None, None]
            batches.append(replace(batch, whitener=whitener, moments=batch.moments * own))
        return replace(self, batches=tuple(batches))

    def part(self, share):
        """Chains, spread evenly over all, no more than such a share of them.

        Returns
        -------
        regression : ResponseRegression
            Of one chain at least.
        rows : ndarray of int
            Where its moments stand among all.
        """
        counts = [batch.target.shape[1] for batch in self.batches]
        wanted = int(np.clip(share * sum(counts), 1, sum(counts)))
        every = np.unique(np.linspace(0, sum(counts) - 1, wanted).astype(int))
        batches, rows, first, begin = [], [], 0, 0
        for batch, count in zip(self.batches, counts, strict=True):
            chosen = every[(first <= every) & (every < first + count)] - first
            numbers = begin + np.arange(batch.kept.size).reshape(-1, count)
            first, begin = first + count, begin + batch.kept.size
            if len(chosen):
                batches.append(batch.of(chosen))
                rows.append(numbers[:, chosen].ravel())
        return replace(self, batches=tuple(batches)), np.concatenate(rows)

    def instants(self, terms):
        """Terms of a kind at the instants of every batch, list of `Instants`."""
        return [Instants(terms, b.bodies, b.positions, b.velocities, b.times) for b in self.batches]

    def columns_at(self, instants, constants):
        """Moments of terms for P values of the constants inside them, shape (n, P, c).

        A column whose term has no finite value at some instant that counts is nan.
        """
        parts, lost = [], False
        for batch, own in zip(self.batches, instants, strict=True):
            values = own.accelerations(constants)
            bad = ~np.isfinite(values) & batch.valid[:, :, :, None, None]
            lost = lost | bad.any(axis=(0, 1, 2, 5))
            moments = batch.whiten(np.where(np.isfinite(values), values, 0.0))
            parts.append(moments.reshape(-1, *moments.shape[3:5]))
        out = np.concatenate(parts)
        out[:, lost] = np.nan
        return out

    def column(self, term, per_entity=False, cache=None):
        """As `Regression.column`; bodies are told apart before their moments are taken."""
        if not per_entity:
            if term not in self._known:
                if len(self._known) * self.n_rows > MOST_KEPT:
                    self._known.clear()
                self._known[term] = super().column(term, False, cache)
                self._known[term][0].flags.writeable = False
            return self._known[term]
        columns = [
            self._flat(b.whiten(value) for b, value in zip(self.batches, own, strict=True))
            for own in self._by_receiver(list(self._accelerations(term, True)))
        ]
        return np.stack(columns, axis=1), self.receiver_names()


@dataclass(frozen=True, eq=False)
class Response:
    """The response of a fit.

    Attributes
    ----------
    regression : ResponseRegression
        What is left of the tracks, in moments, at the smoothed states.
    columns : ndarray, shape (n, k)
        Moments of the changes by the constants of the law.
    share : float
        Part of the rows that is looked at.
    level : float
        Level of the noise beside a force that knows no physics, in that of the fit; 1 where the
        data do not ask for another.
    free_gain : float, nats
        Log-evidence of such a force beside white noise alone of a level that is estimated; the
        level beside the force is the declared one, if all is declared.
    free_height : float, nats
        The same beside white noise of the level of the fit.
    nodes : tuple of ndarray, shape (2, R, d, T, S)
        States of the fit, smoothed where pieces were looked at, per group of like-built chains.
    """

    regression: ResponseRegression
    columns: np.ndarray
    share: float
    level: float = 1.0
    free_gain: float = 0.0
    free_height: float = 0.0
    nodes: tuple = ()

    def left(self):
        """Residual and columns, as searches take them."""
        return self.regression.target(), self.columns

    def scaled(self, scale):
        """The same with moments scaled, (n,)."""
        return replace(
            self, regression=self.regression.scaled(scale), columns=self.columns * scale[:, None]
        )

    def moments_of(self, law):
        """Moments of a law with values, (n,)."""
        parts = [
            batch.whiten(checked(self.regression.predict(batch, law), batch)).ravel()
            for batch in self.regression.batches
        ]
        return np.concatenate(parts)


def respond(fit, dataset, is_quick=False):
    """The response of a fit to forces beside its law.

    Parameters
    ----------
    is_quick : bool
        Whether forces count that change from row to row: of all others few moments tell as much.
    """
    fit, dataset = as_driven(fit, dataset)
    with one_thread(), np.errstate(all="ignore"):
        batches, columns, levels, smoothed = [], [], [], []
        free, used, total = np.zeros(2), 0, 0
        plain = as_normal(fit)
        if plain is fit:
            groups, dataset = _without_outliers(fit, dataset)
        else:
            fit, groups = plain, _weighed(fit, plain)
        stacked = stack(dataset.scenes, dataset.up, dataset.velocity)
        noises = chain_noises(groups, *fit.noise.parts(fit.channels), fit.noise)
        for chains, nodes, noise, batch in zip(groups, fit.nodes, noises, stacked, strict=True):
            batch = replace(batch, bodies=under(fit.law, batch.bodies))
            pairs = [pair for part in constraints_of(fit.law) for pair in part.pairs]
            n_held = sum(pair[0] in chains.bodies[0] for pair in pairs)
            per_row = 1 if fit.paper_steps else _instants_per_row(fit, chains, nodes)
            hits = _hits(fit, chains, nodes)
            pieces = cut_pieces(chains, batch, n_held, per_row, hits)
            lost = NOTHING if is_quick else LOST
            group = _Group(_flying(fit), chains, nodes, noise, pieces, per_row, lost)
            own = group.batches()
            columns += group.columns(own)
            batches += own
            levels.append(group.level)
            smoothed.append(pieces.put(nodes, group.nodes[..., group.at_rows, :]))
            free += group.free_gain, group.free_height
            used += pieces.n_rows
            total += int(chains.lengths.sum())
    regression = ResponseRegression(
        tuple(batches), "response", np.array(fit.noise.levels), tuple(dataset.scenes)
    )
    plane = stretched(fit.law)
    regression = regression if plane is None else regression.in_plane(plane)
    level = float(np.exp(np.mean(np.log(levels))))
    share = used / max(total, 1)
    return Response(
        regression, np.concatenate(columns), share, level, *free.tolist(), tuple(smoothed)
    )


def _without_outliers(fit, dataset):
    """Groups of chains of a fit, and data, in which rows far off their neighbours are not seen.

    Tails of the noise that are told from the data weigh them in fits: here they would pull.
    """
    if not bears_outliers(fit.noise, is_exact=False):
        return fit.groups, dataset
    seen = to_begin_with(dataset, fit.noise)
    if seen is dataset:
        return fit.groups, dataset
    scenes, groups = {scene.name: scene for scene in seen.scenes}, []
    for chains in fit.groups:
        observed = chains.observed.copy()
        for s, (name, bodies) in enumerate(zip(chains.scenes, chains.bodies, strict=True)):
            scene, n = scenes[name], int(chains.lengths[s])
            places = scene.positions[:n, [scene.names.index(body) for body in bodies]]
            observed[:n, s] = np.where(np.isfinite(places), observed[:n, s], np.nan)
        groups.append(replace(chains, observed=observed))
    return groups, seen


def _weighed(fit, plain):
    """Groups of chains of a fit with rows where its like without tails has them."""
    change = np.nan_to_num(plain.residual - fit.residual)
    pairs = zip(fit.groups, split(change, fit.groups), strict=True)
    return [replace(chains, observed=chains.observed + own) for chains, own in pairs]


def _hits(fit, chains, nodes):
    """Chains and rows behind which bodies bounce under the law of a fit."""
    if not walls_of(fit.law) or fit.paper_steps:
        return ()
    motion = Motion(fit.law, chains, fit.parameters)
    motion.set_constants(fit.values)
    size = np.nanmax(np.abs(chains.observed), initial=0.0)
    flow = Flow(motion, np.full(chains.n_chains, HIT_ERROR * size))
    found = flow.quick_mesh(nodes).n_hits > 0
    return list(zip(flow.chain[found].tolist(), flow.row[found].tolist(), strict=True))


def _flying(fit):
    """A fit between bounces: no wall is met there."""
    law = fit.law
    return replace(fit, law=replace(law, frame=tuple(p for p in law.frame if p.kind != "wall")))


def _instants_per_row(fit, chains, nodes):
    """How many instants it takes that the motion turns little between two of them."""
    motion = Motion(fit.law, chains, fit.parameters)
    motion.set_constants(fit.values)
    flow = Flow(motion, np.ones(chains.n_chains))
    count = flow.n_intervals
    some = np.linspace(0, count, min(count, MOST_LOOKED_AT), endpoint=False).astype(int)
    points = flow.at(nodes, flow.row[some], flow.chain[some])
    by_state, _ = flow.motion.slopes(points)
    half = flow.n_state // 2
    stiffness = np.abs(by_state[:, :, :half]).sum(axis=-1).max(axis=-1)
    # How fast a velocity turns; one that goes through zero and back only changes its size.
    v, a = points.state[1], flow.motion.acceleration(points)  # (R, d, N)
    size = np.square(v).sum(axis=1)
    size = np.where(size > 0, size, np.inf)
    across = a - (a * v).sum(axis=1)[:, None] / size[:, None] * v
    turning = (np.square(across).sum(axis=1) / size).max(axis=0)
    rate = np.sqrt(np.maximum(stiffness, turning))
    turned = np.nan_to_num(rate * flow.length[some])
    typical = float(np.quantile(turned, 0.9)) if len(turned) else 0.0
    return int(np.clip(np.ceil(typical / PHASE), 1, MOST_INSTANTS))


class _Group:
    """The pieces of one group of like-built chains."""

    def __init__(self, fit, chains, nodes, noise, pieces, per_row, lost):
        self.fit, self.pieces, self.per_row, self.lost = fit, pieces, per_row, lost
        self.chains, self.noise = pieces.chains(chains), pieces.noise(noise)
        self.motion = Motion(fit.law, self.chains, fit.parameters)
        self.motion.set_constants(fit.values)
        self.tolerance = pieces.tolerance(noise)
        self.rows = pieces.nodes(nodes)
        self.fine = _refined(self.chains, self.per_row)
        self.at_rows = np.arange(0, self.fine.times.shape[0], self.per_row)
        self.nodes = self._flow(self.fine).held(self._between())
        self.level, self.free_gain, self.free_height = 1.0, 0.0, 0.0
        self.free = FreeForce(np.zeros((0, 0, 0)), self.fine.times)
        self.n_own, self.n_dims = chains.n_moving, chains.n_dims
        # Axes along which nothing moves; what a rounding error leads to there is nothing either.
        levels = np.array(fit.noise.levels)
        seen = np.isfinite(chains.observed).any(axis=(0, 1, 2))
        self.is_idle = seen & np.isnan(levels)
        constraints = constraints_of(fit.law)
        self.is_held, self.n_told = bool(constraints), None
        held = {name for part in constraints for name in part.names}
        self.held = np.array([name in held for name, _ in fit.parameters], dtype=bool)

    def _flow(self, chains):
        motion = self.motion.on(chains, self.fit.law)
        motion.set_constants(self.fit.values)
        # Errors of all intervals add up on the way to the last row.
        return Flow(motion, self.tolerance / chains.times.shape[0], self.fit.paper_steps)

    def _between(self):
        """States at all instants, from those of the rows."""
        fine, step = self.fine, self.per_row
        n, w = fine.times.shape
        nodes = np.full((*self.rows.shape[:3], n, w), np.nan)
        nodes[..., self.at_rows, :] = self.rows
        if step > 1:
            flow = self._flow(self.chains)
            row, chain = flow.row, flow.chain
            for k in range(1, step):
                at = row * step + k
                state = self.rows[..., row, chain]
                nodes[..., at, chain] = flow.advance(
                    state, chain, flow.start, fine.times[at, chain]
                )
        return nodes

    # --- the linearised motion -------------------------------------------------------------------

    def linearised(self):
        """Changes of states at instants, by forces, states, constants, and what nodes lack to join.

        Shape (L, W, n, F + n + k + 1), F = L R d accelerations first.
        """
        flow = self._flow(self.fine)
        mesh = flow.quick_mesh(self.nodes)
        ends, transitions = flow.run(self.nodes, mesh)
        n, k = flow.n_state, flow.n_constants
        half = n // 2
        n_fine, n_pieces = self.fine.times.shape
        gaps = (ends - self.nodes[..., flow.row + 1, flow.chain]).reshape(n, -1).T
        good = np.isfinite(gaps).all(axis=1) & np.isfinite(transitions).all(axis=(1, 2))
        if not good.all():
            transitions, gaps = transitions.copy(), np.where(good[:, None], gaps, 0.0)
            transitions[~good] = np.eye(n, n + k)
        n_forces = n_fine * half
        before, after_ = self._kicks()
        # Nothing is led along axes along which nothing moves.
        idle = np.tile(self.is_idle, n // self.n_dims)
        led, pushed = np.flatnonzero(~idle), np.flatnonzero(~idle[:half])
        n_led, n_pushed = len(led), len(pushed)
        first = n_fine * n_pushed
        kept, felt = self._kept_states(flow)[:, :, led], self._felt(flow)
        of_states = kept[..., np.concatenate([led, np.arange(n, n + k)])]
        of_forces = kept[..., half + pushed]  # of a force what constraints leave
        if felt is not None:
            of_forces = of_forces @ felt[:, :, pushed[:, None], pushed]
        transitions = transitions[:, led]
        by_state, by_constant = transitions[..., led], transitions[..., n:]
        gaps = gaps[:, led]
        found = np.zeros((n_fine, n_pieces, n_led, first + n_led + k + 1))
        found[0, :, :, first : first + n_led + k] = of_states[0]
        number = np.full((n_fine, n_pieces), -1)
        number[flow.row, flow.chain] = np.arange(flow.n_intervals)
        for row in range(n_fine):
            at = slice(row * n_pushed, (row + 1) * n_pushed)
            found[row, :, :, at] += before[row, :, None, None] * of_forces[row]
            open_ = np.flatnonzero(number[row] >= 0)
            if row + 1 == n_fine or not len(open_):
                break
            kicked = found[row, open_]
            kicked[:, :, at] += after_[row, open_, None, None] * of_forces[row, open_]
            moved = number[row, open_]
            later = by_state[moved] @ kicked
            later[:, :, first + n_led : first + n_led + k] += by_constant[moved]
            later[:, :, -1] += gaps[moved]
            found[row + 1, open_] = later
        if not idle.any():
            return found
        changes = np.zeros((n_fine, n_pieces, n, n_forces + n + k + 1))
        columns = (np.arange(n_fine)[:, None] * half + pushed).ravel()
        columns = np.concatenate([columns, n_forces + led, n_forces + n + np.arange(k + 1)])
        changes[:, :, led[:, None], columns] = found
        return changes

    def _kept_states(self, flow):
        """What constraints leave of changes of states and constants, (L, W, n, n + k)."""
        n, k = flow.n_state, flow.n_constants
        out = np.broadcast_to(np.eye(n, n + k), (*self.fine.times.shape, n, n + k))
        row, chain = np.nonzero(np.isfinite(self.fine.times))
        kept = flow.tangent(self.nodes, row, chain)
        if kept is not None:
            out = out.copy()
            out[row, chain] = kept
        return out

    def _felt(self, flow):
        """Accelerations by forces on arms that hang on one another, (L, W, half, half); or None."""
        linkages, half = flow.motion.linkages, flow.n_state // 2
        if not linkages:
            return None
        out = np.tile(np.eye(half), (*self.fine.times.shape, 1, 1))
        row, chain = np.nonzero(np.isfinite(self.fine.times))
        points = flow.at(self.nodes, row, chain)
        own = np.arange(self.n_own) * self.n_dims
        out[row[:, None, None], chain[:, None, None], own[:, None], own] = np.linalg.inv(
            linkages.matrix(points)
        )
        return out

    def _kicks(self):
        """Change of velocity by an acceleration of one, up to and from every instant, (L, W)."""
        step = np.nan_to_num(np.diff(self.fine.times, axis=0))
        zero = np.zeros((1, step.shape[1]))
        if self.fit.paper_steps:  # v += a h, and then p += v h
            return np.zeros((len(step) + 1, step.shape[1])), np.concatenate([step, zero])
        return np.concatenate([zero, step]) / 2, np.concatenate([step, zero]) / 2

    def _white(self, changes):
        """Whitened changes and residuals of the rows, (W, L R d, F + n + k + 1)."""
        at = changes[self.at_rows]
        n_rows, n_pieces = at.shape[:2]
        nodes = self.nodes[..., self.at_rows, :]
        seen = sight(self._flow(self.chains), nodes)
        shape, first = seen.places.shape, at.shape[-1] - 1 - len(self.fit.values)
        shown = seen.shown(at, np.arange(n_rows)[:, None], np.arange(n_pieces), first)
        left = self.chains.observed - seen.places - shown[..., -1].reshape(shape)
        moved = np.moveaxis(shown[..., :-1], -1, 0).reshape(-1, *shape)
        moved = np.where(np.isfinite(self.chains.observed), moved, np.nan)
        stacked = np.concatenate([moved, left[None]])
        rows = np.broadcast_to(np.arange(n_rows)[:, None], (n_rows, n_pieces))
        white = self.noise.whiten(stacked, rows, np.arange(n_pieces))
        white = np.moveaxis(white, 2, 0).reshape(n_pieces, len(stacked), -1).swapaxes(1, 2)
        white = np.concatenate([white, *self._known(white, first)], axis=1)
        return white[:, white.any(axis=(0, 2))]  # of axes along which nothing moves nothing is told

    def _known(self, white, first):
        """Rows of what is known of first states, none or one array (W, n, F + n + k + 1)."""
        known = known_states(self.chains, self.noise)
        if known is None:
            return ()
        values, errors = known
        n = len(values)
        left = np.nan_to_num((values - self.nodes[..., 0, :].reshape(n, -1)) / errors)
        rows = np.zeros((white.shape[0], n, white.shape[2]))
        own = np.arange(n)
        rows[:, own, first - n + own] = np.nan_to_num(1.0 / errors).T
        rows[:, :, -1] = left.T
        return (rows,)

    def moments(self):
        """Tracks smoothed, then moments by force, of what is left, and which of them count.

        Returns
        -------
        by_force : ndarray, shape (W, m, L, R, d)
        left : ndarray, shape (W, m)
        kept : ndarray of bool, shape (W, m)
        """
        n = 2 * self.n_own * self.n_dims
        before, near, kept, is_last = None, None, (np.inf, self.nodes), False
        for turn in range(PASSES + 1):
            changes = self.linearised()
            white = self._white(changes)
            n_forces = white.shape[2] - n - len(self.fit.values) - 1
            own = white[:, :, n_forces : n_forces + n]
            q = orthonormal(own)
            every = white - q @ (np.swapaxes(q, 1, 2) @ white)
            beyond = self._telling(every, n_forces)
            by_force, left = beyond[:, :, :n_forces], beyond[:, :, -1]
            if is_last:
                break
            shown = float(np.square(every[:, :, -1]).sum())
            if shown > WORSE * kept[0] + every[:, :, -1].size:  # so far off nothing is linear
                self.nodes, is_last = kept[1], True
                continue
            # Where places do not matter to what forces do, one pass leads to the smoothed tracks.
            is_last = turn + 1 >= PASSES or turn > 0 and _are_alike(every[:, :, :n_forces], before)
            before, kept = every[:, :, :n_forces], (shown, self.nodes)
            if is_last or not self._smoothed(changes, white, by_force, left, near):
                break
            near = self.free
        error = self._inexact(by_force, left)
        strength = self.free.strength(left) if self.free.memory else None
        self._linked = self._links(changes, white, error)
        beyond = less_exact(by_force, beyond, error)
        by_force = beyond[:, :, :n_forces]
        values, vectors = FreeForce(by_force, self.fine.times).shown
        self._weigh(left, _n_open(values))
        left = beyond[:, :, -1]
        expected = None  # where what is left may change at once, it tells no smoothness
        if strength is not None:
            expected = self.free.on(by_force, self.fine.times).expected(strength, vectors)
        keep = self._kept(values, left, expected)
        count = int(keep.sum(axis=1).max(initial=1))
        # Eigenvalues rise: the strongest moments stand last.
        vectors = vectors[:, :, -count:] * keep[:, None, -count:]
        turned, keep = np.swapaxes(vectors, 1, 2), keep[:, -count:]
        by_constant, force = beyond[:, :, n_forces + n : -1], turned @ by_force
        if self.held.any():  # what bodies are held by shows where no force does, too
            rest = by_constant[:, :, self.held]
            more = np.swapaxes(orthonormal(rest - vectors @ (turned @ rest)), 1, 2)
            turned = np.concatenate([turned, more], axis=1)
            keep = np.concatenate([keep, more.any(axis=2)], axis=1)
            force = np.concatenate([force, np.zeros((*more.shape[:2], n_forces))], axis=1)
        self.by_constant = np.swapaxes(turned @ by_constant, 0, 1)
        shape = (*turned.shape[:2], -1, self.n_own, self.n_dims)
        return force.reshape(shape), (turned @ left[..., None])[..., 0], keep

    def _telling(self, moments, n_forces):
        """Moments (W, m, F + n + k + 1) of bodies that are held, turned into those of forces.

        What holds them shows where no force does, too: it has moments of its own. A rod takes up
        forces along it. Tracks that are smoothed lead from row to row as no fit does, and there a
        little of such a force shows: a free force without bound would be told by that from whatever
        is left. How many moments show any is counted at the fit itself.
        """
        if not self.is_held:
            return moments
        values, vectors = FreeForce(moments[:, :, :n_forces], self.fine.times).shown
        told = values > NOTHING * values.max(axis=1, keepdims=True, initial=0.0)
        if self.n_told is None:
            self.n_told = told.sum(axis=1, keepdims=True)
        told &= np.arange(values.shape[1]) >= values.shape[1] - self.n_told
        count = int(told.sum(axis=1).max(initial=1))
        vectors = vectors[:, :, -count:] * told[:, None, -count:]  # eigenvalues rise
        found = np.swapaxes(vectors, 1, 2) @ moments
        if self.held.any():
            rest = moments[:, :, n_forces + 2 * self.n_own * self.n_dims : -1][:, :, self.held]
            more = orthonormal(rest - vectors @ (np.swapaxes(vectors, 1, 2) @ rest))
            beside = np.swapaxes(more, 1, 2) @ moments
            beside[:, :, :n_forces] = 0.0
            found = np.concatenate([beside, found], axis=1)
        return found

    def _inexact(self, by_force, left):
        """Variances of forces at instants, (W, F): they are evaluated at places that have errors.

        What is missing changes along a track with the place, and is as much in error as the place
        times that: small beside a law that is nearly right, and all there is beside one that is
        far off, of which a track shows the errors of many turns.
        """
        error = np.zeros((by_force.shape[0], by_force.shape[2]))
        force = self.free.smoothest(left) if self.free.memory else None
        if force is None:
            return error
        n_fine, n_pieces = self.fine.times.shape
        shape = (n_pieces, n_fine, self.n_own, self.n_dims)
        force = np.moveaxis(force.reshape(shape), 0, -1)[self.at_rows]  # (rows, R, d, W)
        places = np.moveaxis(self.nodes[0, ..., self.at_rows, :], 2, 0)
        changes = [
            np.nansum(np.square(np.diff(values, axis=0)), axis=(0, 1, 2))
            for values in (force, places)
        ]  # fmt: skip
        slope = np.where(changes[1] > 0, changes[0] / np.where(changes[1] > 0, changes[1], 1), 0.0)
        variance = np.moveaxis(np.nan_to_num(self.noise.variance), 1, 0)  # (W, rows, R, d)
        # What is in error at a row is so at the instants up to the next one.
        own = slope[:, None, None, None] * variance * self.per_row**2
        error.reshape(shape)[:, self.at_rows] = own
        return error

    def _kept(self, values, left, expected=None):
        """Moments without which less than `lost` is lost of what a force may show.

        Of a force white in time, that shows as much as is left; where what is left tells how smooth
        the force is, of that one, and of a white one that shows little.
        """
        shown = float(np.square(left).sum()) - np.count_nonzero(left)
        # Beside what a law leaves that is far off, a little more or less of it tells no cause.
        lost = self.lost * max(shown / MOST_SHOWN, 1.0)
        shown = max(shown, LEAST_SHOWN) if expected is None else LEAST_SHOWN
        tail = np.cumsum(values, axis=1)  # eigenvalues rise
        keep = tail * shown > lost * tail[:, -1:].max()
        return keep if expected is None else keep | (np.cumsum(expected, axis=1) > lost)

    def _smoothed(self, changes, white, by_force, left, near):
        """Move the nodes to tracks smoothed by a free force; whether they moved at all."""
        self.free = FreeForce(by_force, self.fine.times).chosen(left, near)
        force = self.free.smoothest(left)
        if force is None:
            return False
        n_forces, n = by_force.shape[2], 2 * self.n_own * self.n_dims
        own = white[:, :, n_forces : n_forces + n]
        rest = white[:, :, -1] - (white[:, :, :n_forces] @ force[..., None])[..., 0]
        start = (np.linalg.pinv(own) @ rest[..., None])[..., 0]
        k = len(self.fit.values)
        weights = np.concatenate(
            [force, start, np.zeros((len(force), k)), np.ones((len(force), 1))], axis=1
        )
        change = np.einsum("lwij,wj->lwi", changes, weights)
        shape = (*change.shape[:2], 2, self.n_own, self.n_dims)
        self.nodes = self.nodes + np.moveaxis(change.reshape(shape), (2, 3, 4), (0, 1, 2))
        self.nodes = self._flow(self.fine).held(self.nodes)
        return True

    def _weigh(self, left, count):
        """Find the level of the noise beside a free force, in that of the fit, and what that gains.

        What a law leaves, moments (W, m) of which forces reach `count`, may have been taken for
        noise: its level is that of the pure error.
        """
        values, turned = self.free.seen(left)
        scaled, top = in_units(values)
        if not np.any(top > 0):
            return
        parts = [(turned, scaled)]
        if self._linked is not None:
            links = self._linked[0]
            mean = np.where(links.pieces >= 0, top[links.pieces, 0], np.nan)
            mean = np.nanmean(mean, axis=1)[:, None]
            times = self._joined(self.fine.times)
            if not self.free.memory:
                parts.append((links.left, links.values / mean))
                count += _n_open(links.values)
            elif len(times) <= MOST_JOINED:
                joined = links.by_force.reshape(*links.left.shape, -1)
                values, turned = self.free.on(joined, times).seen(links.left)
                parts.append((turned, values / mean))
                count += _n_open(links.values)
        square, scaled = (np.concatenate([part[k].ravel() for part in parts]) for k in (0, 1))
        square, count = np.square(square), max(count, 1)
        if not (np.isfinite(square) & np.isfinite(scaled)).all():
            return  # of tracks that the law runs away from
        given, freed = [], []
        for s in (0.0, *STRENGTHS):
            size = 1 + s * scaled
            rest, volume = float((square / size).sum()), float(np.log(size).sum())
            given.append(-0.5 * (rest + volume))
            level = max(rest / count, np.finfo(float).tiny)
            freed.append((-0.5 * (count * (np.log(level) + 1) + volume), level))
        best, _ = max(freed)
        # Where all there is may be force as well as noise, the level is the greatest that may be.
        level = max(level for height, level in freed if height > best - SURELY)
        level = max(level, RESOLVED * float(square.sum()) / count)
        is_lower = level < MUCH_LOWER**2 and best > max(given) + SURELY
        self.level = float(np.sqrt(level)) if is_lower else 1.0
        best = best if self.fit.noise.is_free.any() else max(given)
        self.free_gain, self.free_height = best - freed[0][0], best - given[0]

    def _links(self, changes, white, error):
        """Moments of what joins the pieces, and which count; None where nothing does."""
        leads = self.pieces.leads
        if not leads.any():
            return None
        # Across pieces a memory is not followed.
        lasts = spread(self.fine.times)[leads].min()
        if self.noise.amplitude.any() and lasts < MEMORIES * self.noise.correlation_time:
            return None
        links = link(self.pieces, changes, white, self.nodes, 2 * self.n_own * self.n_dims)
        if links is None or not links.is_exact(error):
            return None
        return links.believed(INEXACT).kept(self._kept(links.values, links.left))

    # --- batches of the regression ---------------------------------------------------------------

    def batches(self):
        """The pieces as a batch of a regression, and what joins them as another, if anything."""
        pieces = self._batch()
        if self._linked is None:
            return [pieces]
        links, kept = self._linked
        shape = (*links.by_force.shape[:2], -1, self.n_own, self.n_dims)
        times, *tracks = (self._joined(a) for a in (pieces.times, pieces.positions,
                          pieces.velocities, pieces.valid))  # fmt: skip
        return [pieces, replace(
            pieces, bodies=subset(pieces.bodies, links.pieces[:, 0]), times=times,
            positions=tracks[0], velocities=tracks[1], valid=tracks[2],
            target=np.zeros(tracks[2].shape), scale=np.ones(tracks[2].shape),
            scene_names=tuple(pieces.scene_names[k] for k in links.pieces[:, 0]),
            whitener=links.by_force.reshape(shape), kept=kept.T[..., None, None],
            moments=links.left.T,
        )]  # fmt: skip

    def _joined(self, values):
        """Values at the instants of pieces (L, W, ...) at those of runs of them, (V L, C, ...)."""
        which = self._linked[0].pieces
        taken = np.moveaxis(values[:, which], 2, 0)  # (V, L, C, ...)
        inside = (which >= 0).T[:, None].reshape(-1, 1, len(which), *(1,) * (taken.ndim - 3))
        blank = False if taken.dtype == bool else np.nan
        joined = np.where(inside, taken, blank)
        return joined.reshape(taken.shape[0] * taken.shape[1], *taken.shape[2:])

    def _batch(self):
        by_force, left, kept = self.moments()
        times = self.fine.times
        positions, velocities = self.pieces.states(self.chains, times, self.nodes)
        own = slice(None, self.n_own)
        valid = np.isfinite(positions[:, :, own]) & np.isfinite(velocities[:, :, own])
        kept = np.swapaxes(kept, 0, 1)[..., None, None]
        return ResponseBatch(
            bodies=self.pieces.bodies, times=times, positions=positions, velocities=velocities,
            target=np.zeros(valid.shape), valid=valid, scale=np.ones(valid.shape),
            scene_names=self.chains.scenes, whitener=by_force, kept=kept, moments=left.T,
        )  # fmt: skip

    def columns(self, batches):
        """Moments of the changes by the constants, (n, k), in the way that those of laws are."""
        row, chain = np.nonzero(np.isfinite(self.fine.times))
        flow = self._flow(self.fine)
        points = flow.at(self.nodes, row, chain)
        by_constant = np.nan_to_num(flow.motion.slopes(points)[1])
        if flow.motion.linkages:  # as forces
            shaped = by_constant.reshape(len(row), self.n_own, self.n_dims, -1)
            force = np.einsum("mij,mjak->miak", flow.motion.linkages.matrix(points), shaped)
            by_constant = np.concatenate([force[:, :, :1], shaped[:, :, 1:]], axis=2).reshape(
                by_constant.shape
            )
        k = by_constant.shape[-1]
        slopes = np.zeros((*self.fine.times.shape, self.n_own, k, self.n_dims))
        shaped = by_constant.reshape(len(row), self.n_own, self.n_dims, k)
        slopes[row, chain] = np.swapaxes(shaped, 2, 3)
        found = [(slopes, self.by_constant)]
        if self._linked is not None:
            found.append((self._joined(slopes), np.swapaxes(self._linked[0].by_constant, 0, 1)))
        columns = []
        for batch, (slopes, direct) in zip(batches[-len(found) :], found, strict=True):
            out = batch.whiten(slopes)[:, :, 0, :, 0].reshape(batch.moments.size, k)
            # What constants of constraints change is more than forces: where bodies can be.
            out[:, self.held] = direct.reshape(out.shape)[:, self.held]
            columns.append(out)
        return columns


def _are_alike(one, other):
    """Whether two arrays differ by rounding only."""
    top = np.abs(other).max(initial=0.0)
    return bool(np.abs(one - other).max(initial=0.0) <= ALIKE * top)


def _n_open(values):
    """How many moments there are: noise shows nothing in what states and the like take up."""
    return int((values > NOTHING * values.max(axis=1, keepdims=True, initial=0.0)).sum())


def _refined(chains, per_row):
    """Chains with instants between their rows, at which nothing was seen."""
    if per_row == 1:
        return chains
    times = chains.times
    share = np.arange(per_row) / per_row
    between = times[:-1, None] + np.diff(times, axis=0)[:, None] * share[:, None]
    fine = np.concatenate([between.reshape(-1, times.shape[1]), times[-1:]])
    observed = np.full((len(fine), *chains.observed.shape[1:]), np.nan)
    observed[::per_row] = chains.observed
    # The last row of a shorter chain is followed by nothing.
    last = (chains.lengths - 1) * per_row
    fine[last, np.arange(times.shape[1])] = times[chains.lengths - 1, np.arange(times.shape[1])]
    return replace(chains, times=fine, observed=observed, sigma=None, velocities=None)
