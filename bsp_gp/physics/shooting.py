"""The rollout likelihood: constants and initial states fitted to whole tracks.

Every scene (or segment of one: multiple shooting) has initial states of its own; constants are
shared. Levenberg-Marquardt on the whitened position errors, with the initial states of each
segment eliminated from the normal equations (they touch no other segment), so that the cost
grows with the number of segments and not with its cube.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.noise import TrackNoise

__all__ = [
    "RolloutFit", "cut_segments", "fit_rollout", "guess_state", "parameter_list", "predict",
    "track_blocks",
]  # fmt: skip

MAX_ITERATIONS = 40
TOLERANCE = 1e-7
UNDETERMINED = 1e-10
"""Eigenvalues of the scaled information below this part of the largest determine nothing."""
_HUGE = 1e150
"""Products of slopes beyond this are those of a rollout that runs away."""
DESCENT = 1e-4
"""A fit has converged when chi-squared falls by less than this (a hundredth of a sigma), or by
less than `TOLERANCE` of itself where the law does not fit."""
NEGLIGIBLE = 0.01
"""Part of that fall, foreseen by the slopes, at which a step is the last."""
WEAK = 1e-3
"""Damping up to which a small step means that little is to be gained."""
LEAST_DAMPING = 1e-9
MAX_ATTEMPTS = 12
"""Steps of growing damping before a fit is taken to have no descent left."""


@dataclass(frozen=True, eq=False)
class RolloutFit:
    """Result of a fit to whole tracks.

    Attributes
    ----------
    law : ForceLaw
        With the fitted constants.
    parameters : tuple of (name, entity)
        Entity is "" for shared constants.
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Inverse of the Fisher information of the constants, initial states marginalised, for the
        sigma given (not rescaled by the misfit).
    chisqr : float
        Whitened sum of squared position errors.
    n_rows : int
        Number of observed coordinates.
    n_free : int
        Free parameters, initial states included.
    batches : tuple of Batch
        The segments, stacked.
    positions, velocities : tuple of ndarray, (S, R, d)
        Fitted initial states per batch.
    predicted : tuple of ndarray, (T, S, R, d)
    whitened : tuple of ndarray, (T, S, R, d)
        Whitened position errors, 0 where not seen.
    converged : bool
    """

    law: object
    parameters: tuple
    values: np.ndarray
    covariance: np.ndarray
    chisqr: float
    n_rows: int
    n_free: int
    batches: tuple
    positions: tuple
    velocities: tuple
    predicted: tuple
    whitened: tuple
    converged: bool

    def __getstate__(self):
        """What travels to workers: everything but what is kept for the running loop."""
        return {k: v for k, v in self.__dict__.items() if not k.startswith("_")}

    @property
    def bic(self):
        """Bayesian information criterion of the constants: chi-squared + k log n."""
        return self.chisqr + len(self.parameters) * np.log(max(self.n_rows, 2))


def parameter_list(law, names=None):
    """Free constants of a law as (name, entity) pairs."""
    out = []
    for name in law.names if names is None else names:
        value = law.constants[name]
        if isinstance(value, Mapping):
            out.extend((name, entity) for entity in value)
        else:
            out.append((name, ""))
    return tuple(out)


def _get(law, parameters):
    return np.array(
        [law.constants[n][e] if e else law.constants[n] for n, e in parameters], dtype=float
    )


def cut_segments(scenes, rows):
    """Cut scenes into segments of about `rows` rows (None: whole), none shorter than four."""
    if rows is None:
        return list(scenes)
    out = []
    for scene in scenes:
        n = len(scene.times)
        count = max(1, n // max(rows, 4))
        edges = np.linspace(0, n, count + 1).astype(int)
        for start, stop in zip(edges[:-1], edges[1:], strict=True):
            out.append(replace(scene.rows(start, stop), name=f"{scene.name}[{start}:{stop}]"))
    return out


def guess_state(batch, rows=5):
    """Initial states of the receivers from a straight or quadratic line through the first rows.

    Returns
    -------
    positions, velocities : ndarray, shape (S, R, d)
    """
    receivers = batch.bodies.receivers
    p = batch.positions[:, :, receivers]
    n_scenes, n_receivers, n_dims = p.shape[1:]
    positions, velocities = np.zeros(p.shape[1:]), np.zeros(p.shape[1:])
    for s in range(n_scenes):
        times = batch.times[:, s] - batch.times[0, s]
        for r in range(n_receivers):
            seen = np.flatnonzero(np.isfinite(p[:, s, r]).all(axis=-1))[:rows]
            degree = min(2, len(seen) - 1) if len(seen) < 5 else 2
            if len(seen) == 0:
                continue
            step = times[seen[-1]] or 1.0
            fit = np.polynomial.polynomial.polyfit(times[seen] / step, p[seen, s, r], degree)
            positions[s, r] = fit[0]
            velocities[s, r] = fit[1] / step if degree else 0.0
    if batch.velocities is not None:
        first = batch.velocities[0][:, receivers]
        positions = np.where(np.isfinite(p[0]), p[0], positions)
        velocities = np.where(np.isfinite(first), first, velocities)
    return positions, velocities


def fit_rollout(
    scenes,
    law,
    sigma,
    *,
    free=None,
    integrator="rk4",
    substeps=1,
    up=None,
    velocity="ignore",
    bounds=None,
    max_iterations=MAX_ITERATIONS,
    fit_states=True,
    memory=0.0,
    states=None,
    sizes=None,
):
    """Fit constants and initial states to whole tracks.

    Parameters
    ----------
    scenes : sequence of Scene
        Or segments (`cut_segments`).
    law : ForceLaw
        Start values in its constants.
    sigma : array-like, shape (d,), metres
        Position noise where no point quotes its own; axes with nan are left out.
    free : sequence of str, optional
        Constants to fit; all of the law by default. Empty: initial states only.
    integrator, substeps
        As in `rollout`.
    bounds : dict of str to (float, float), optional
        Interval of a constant (of every entity's).
    fit_states : bool
        False keeps the initial states at the (measured) first row.
    memory : float
        Correlation time of the position noise, s; 0 = white.
    states : mapping of str to (ndarray, ndarray), optional
        Scene name -> initial positions and velocities, shape (R, d), to start from; by default a
        parabola through the first rows.
    sizes : mapping of (str, str) to float, optional
        Typical sizes of parameters, for those that start at 0.

    Returns
    -------
    RolloutFit
    """
    problem = _Problem(
        scenes, law, sigma, free, integrator, substeps, up, velocity, bounds, fit_states, memory
    )
    problem.sizes = np.array([abs((sizes or {}).get(p, 0.0)) for p in problem.parameters])
    return problem.solve(max_iterations, states or {})


def track_blocks(fit, sigma, *, integrator="rk4", substeps=1, memory=0.0):
    """Whitened residuals of a fit and what its parameters do to them, segment by segment.

    Parameters
    ----------
    fit : RolloutFit
    sigma, integrator, substeps, memory
        As for the fit.

    Returns
    -------
    list of tuple, one per batch
        Residuals (S, n), derivatives of the tracks by the constants (S, k, n) and by the initial
        states (S, 2 R d, n); n = T R d.
    """
    problem = object.__new__(_Problem)
    problem.law, problem.integrator, problem.substeps = fit.law, integrator, substeps
    problem.fit_states = True
    problem.sizes = np.zeros(len(fit.parameters))
    problem.batches, problem.parameters = fit.batches, fit.parameters
    problem.attach_noise(sigma, memory)
    blocks, _, _ = problem._linearise(
        fit.values, list(zip(fit.positions, fit.velocities, strict=True))
    )
    return blocks


class _Problem:
    def __init__(
        self, scenes, law, sigma, free, integrator, substeps, up, velocity, bounds, fit_states,
        memory,
    ):  # fmt: skip
        self.law = law
        self.integrator = integrator
        self.substeps = substeps
        self.fit_states = fit_states
        self.batches = stack(scenes, up, velocity)
        self.parameters = parameter_list(law, free)
        self.attach_noise(sigma, memory)
        low = np.array([(bounds or {}).get(n, (-np.inf, np.inf))[0] for n, _ in self.parameters])
        high = np.array([(bounds or {}).get(n, (-np.inf, np.inf))[1] for n, _ in self.parameters])
        self.low, self.high = low, high

    def attach_noise(self, sigma, memory):
        """Observed positions, and what whitens their errors."""
        self.observed, self.noise = [], []
        for batch in self.batches:
            noise = TrackNoise(batch, sigma, memory)
            observed = batch.positions[:, :, batch.bodies.receivers]
            self.observed.append(np.where(noise.seen, observed, 0.0))
            self.noise.append(noise)

    def solve(self, max_iterations, known):
        states = [_start(batch, known) for batch in self.batches]
        x = np.clip(_get(self.law, self.parameters), self.low, self.high)
        damping, converged = 1e-7, False
        blocks, chisqr, predicted = self._linearise(x, states)
        for _ in range(max_iterations):
            if not np.isfinite(chisqr) or not self._has_unknowns():
                converged = bool(np.isfinite(chisqr))
                break
            enough, accepted, is_last = TOLERANCE * chisqr + DESCENT, False, False
            for attempt in range(MAX_ATTEMPTS):
                try:
                    dx, dstates = self._step(blocks, damping, x)
                except np.linalg.LinAlgError:  # a rollout near running away: smaller steps
                    damping = max(damping * 16, 1e-6)
                    continue
                new_x = np.clip(x + dx, self.low, self.high)
                new_states = [
                    (p + d[0], v + d[1]) for (p, v), d in zip(states, dstates, strict=True)
                ]
                foreseen = _foreseen(blocks, new_x - x, dstates)
                is_last = damping <= WEAK and abs(foreseen) <= NEGLIGIBLE * enough
                # The last step hardly changes the slopes; most others are good at once, and
                # slopes cost little more than the motion alone.
                has_slopes = attempt == 0 and not is_last
                trial = (
                    self._linearise(new_x, new_states)
                    if has_slopes
                    else self._moved(new_x, new_states, blocks)
                )
                accepted = bool(np.isfinite(trial[1]) and trial[1] <= chisqr * (1 + 1e-15))
                if accepted or is_last:
                    break
                damping = max(damping * 10, 1e-6)
            if not accepted:
                converged = is_last  # no descent left at working precision
                break
            done = is_last or chisqr - trial[1] <= enough
            x, states = new_x, new_states
            damping = max(damping * 0.2, LEAST_DAMPING)
            is_new = has_slopes or is_last
            blocks, chisqr, predicted = trial if is_new else self._linearise(x, states)
            if done:
                converged = True
                break
        return self._result(x, states, blocks, chisqr, predicted, converged)

    def _has_unknowns(self):
        return self.fit_states or len(self.parameters) > 0

    def _roll(self, batch, x, p, v):
        """Rollout with copies of constants x (B, k) and of states (B, S, R, d)."""
        values = self._values(batch, x)
        return rollout(
            self.law, batch, p, v, integrator=self.integrator, substeps=self.substeps, values=values
        )

    def _values(self, batch, x):
        values = self.law.values(batch.bodies)
        lead = x.shape[:-1]
        names = batch.bodies.receiver_names
        for name in dict.fromkeys(n for n, _ in self.parameters):
            columns = [k for k, (n, _) in enumerate(self.parameters) if n == name]
            if self.parameters[columns[0]][1]:
                by_entity = {self.parameters[k][1]: x[..., k] for k in columns}
                array = np.stack(
                    [
                        np.stack([by_entity.get(n, np.full(lead, np.nan)) for n in row], axis=-1)
                        for row in names
                    ],
                    axis=-2,
                )
                values["field"][name], values["pair"][name] = array, array[..., None]
            else:
                value = x[..., columns[0]]
                values["field"][name] = value[..., None, None]
                values["pair"][name] = value[..., None, None, None]
        return values

    def _sum(self, k, predicted):
        with np.errstate(over="ignore", invalid="ignore"):
            error = self.noise[k].whiten(self.observed[k] - predicted)
            return float(np.square(error).sum())

    def _moved(self, x, states, blocks):
        """What `_linearise` gives, with the slopes of a point nearby."""
        moved, chisqr, all_predicted = [], 0.0, []
        for k, (batch, (_, jc, js)) in enumerate(zip(self.batches, blocks, strict=True)):
            p, v = states[k]
            predicted = self._roll(batch, x[None], p[None], v[None])[:, 0]
            moved.append((self._residual(k, predicted), jc, js))
            chisqr += self._sum(k, predicted)
            all_predicted.append(predicted)
        return moved, chisqr, all_predicted

    def _residual(self, k, predicted):
        """Whitened residuals of a batch, segment by segment, shape (S, n)."""
        residual = np.moveaxis(self.noise[k].whiten(self.observed[k] - predicted), 1, 0)
        return residual.reshape(len(residual), -1)

    def _linearise(self, x, states):
        """Whitened residuals and Jacobians per segment, by central differences of copies."""
        blocks, chisqr, all_predicted = [], 0.0, []
        for k, batch in enumerate(self.batches):
            p, v = states[k]
            predicted, by_constant, by_state = self._derivatives(k, batch, x, p, v)
            # Shorter scenes are padded: the prediction has no number there.
            whiten = self.noise[k].whiten
            flat = self._residual(k, predicted)
            chisqr += self._sum(k, predicted)
            n_scenes = len(flat)
            jc = np.moveaxis(whiten(by_constant), 2, 0).reshape(n_scenes, len(x), flat.shape[1])
            js = np.zeros((n_scenes, 0, flat.shape[1]))
            if self.fit_states:
                js = np.moveaxis(whiten(by_state), 2, 0).reshape(n_scenes, -1, flat.shape[1])
            blocks.append((flat, jc, js))
            all_predicted.append(predicted)
        return blocks, chisqr, all_predicted

    def _derivatives(self, k, batch, x, p, v):
        n_c, size = len(x), p[0].size
        n_s = 2 * size if self.fit_states else 0
        scale_p, scale_v = self._scales(k, batch, p, v)
        steps_c = 1e-5 * np.maximum(np.abs(x), self._constant_scale(x))
        count = n_c + n_s
        xs = np.broadcast_to(x, (2 * count + 1, n_c)).copy()
        ps = np.broadcast_to(p, (2 * count + 1, *p.shape)).copy()
        vs = np.broadcast_to(v, (2 * count + 1, *v.shape)).copy()
        for c in range(n_c):
            xs[1 + 2 * c, c] += steps_c[c]
            xs[2 + 2 * c, c] -= steps_c[c]
        for q in range(n_s):
            target, scale = (ps, scale_p) if q < size else (vs, scale_v)
            r, d = np.unravel_index(q % size, p.shape[1:])
            target[1 + 2 * (n_c + q), :, r, d] += scale
            target[2 + 2 * (n_c + q), :, r, d] -= scale
        rolled = self._roll(batch, xs, ps, vs)  # (T, B, S, R, d)
        rolled = np.nan_to_num(rolled, nan=np.nan, posinf=np.nan, neginf=np.nan)
        up, down = rolled[:, 1::2], rolled[:, 2::2]
        with np.errstate(invalid="ignore"):
            slopes = np.moveaxis(up - down, 1, 0)
        widths = np.concatenate(
            [2 * steps_c, np.full(size, 2 * scale_p), np.full(size, 2 * scale_v)]
        )
        with np.errstate(over="ignore"):  # told by `_step`: beyond `_HUGE`
            slopes = slopes / widths[:count, None, None, None, None]
        slopes = np.nan_to_num(slopes)
        return rolled[:, 0], slopes[:n_c], slopes[n_c:]

    def _scales(self, k, batch, p, v):
        extent = np.nanmax(np.abs(self.observed[k] - self.observed[k][:1])) or 1.0
        duration = np.nanmax(batch.times) - np.nanmin(batch.times)
        return 1e-5 * extent, 1e-5 * extent / duration

    def _constant_scale(self, x):
        """A size for constants that are 0: the one given, that of the others, or one."""
        others = np.abs(x[x != 0])
        unknown = others.mean() if others.size else 1.0
        given = np.where(self.sizes > 0, self.sizes, unknown)
        return np.where(x == 0, given, np.abs(x))

    def _step(self, blocks, damping, x):
        """Solve the damped normal equations with the states of every segment eliminated."""
        n_c = len(x)
        matrix, vector = np.zeros((n_c, n_c)), np.zeros(n_c)
        stored = []
        for flat, jc, js in blocks:
            for s in range(len(flat)):
                with np.errstate(over="ignore", invalid="ignore"):
                    hcc, hcs, hss = jc[s] @ jc[s].T, jc[s] @ js[s].T, js[s] @ js[s].T
                    gc, gs = jc[s] @ flat[s], js[s] @ flat[s]
                # Not a number is not within bounds either.
                if not all((np.abs(part) < _HUGE).all() for part in (hcc, hcs, hss, gc, gs)):
                    raise np.linalg.LinAlgError("slopes of a rollout that runs away")
                hss = hss + damping * np.diag(np.diag(hss)) + _tiny(hss)
                solved = np.zeros((0, n_c + 1))
                if len(gs):
                    solved = np.linalg.solve(hss, np.column_stack([hcs.T, gs]))
                matrix += hcc + damping * np.diag(np.diag(hcc)) - hcs @ solved[:, :n_c]
                vector += gc - hcs @ solved[:, n_c]
                stored.append((solved[:, n_c], solved[:, :n_c]))
        dx = _solve_bounded(matrix + _tiny(matrix), vector, x, self.low, self.high)
        dstates, index = [], 0
        for observed in self.observed:
            n_scenes, n_receivers, n_dims = observed.shape[1:]
            dp = np.zeros((n_scenes, n_receivers, n_dims))
            dv = np.zeros_like(dp)
            for s in range(n_scenes):
                own, coupling = stored[index]
                index += 1
                if len(own):
                    change = (own - coupling @ dx).reshape(2, n_receivers, n_dims)
                    dp[s], dv[s] = change
            dstates.append((dp, dv))
        return dx, dstates

    def _result(self, x, states, blocks, chisqr, predicted, converged):
        n_c = len(x)
        information = np.zeros((n_c, n_c))
        n_states = 0
        for flat, jc, js in blocks:
            for s in range(len(flat)):
                with np.errstate(over="ignore", invalid="ignore"):
                    hcc, hcs, hss = (a @ b.T for a, b in ((jc[s], jc[s]), (jc[s], js[s]),
                                                          (js[s], js[s])))  # fmt: skip
                if not all(np.isfinite(part).all() for part in (hcc, hcs, hss)):
                    continue  # a rollout that ran away says nothing of the constants
                information += hcc - hcs @ np.linalg.pinv(hss, hermitian=True) @ hcs.T
                n_states += int((np.abs(np.diag(hss)) > 0).sum())
        covariance = covariance_of(information)
        n_rows = int(sum(noise.seen.sum() for noise in self.noise))
        return RolloutFit(
            self.law.with_values(self.parameters, x),
            self.parameters,
            x,
            covariance,
            float(chisqr),
            n_rows,
            n_c + n_states,
            tuple(self.batches),
            tuple(p for p, _ in states),
            tuple(v for _, v in states),
            tuple(predicted),
            tuple(
                noise.whiten(observed - track)
                for noise, observed, track in zip(self.noise, self.observed, predicted, strict=True)
            ),
            converged,
        )


def _foreseen(blocks, dx, dstates):
    """Fall of chi-squared by a step if tracks were linear in constants and states."""
    fall = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for (flat, jc, js), change in zip(blocks, dstates, strict=True):
            left = flat - np.einsum("k,skn->sn", dx, jc)
            if js.shape[1]:
                own = np.stack(change, axis=1).reshape(len(flat), -1)
                left = left - np.einsum("sk,skn->sn", own, js)
            fall += float(np.square(flat).sum() - np.square(left).sum())
    return fall


def _start(batch, known):
    """Initial states of a batch: given ones, or guessed."""
    positions, velocities = guess_state(batch)
    for s, scene in enumerate(batch.scenes):
        if scene.name in known:
            positions[s], velocities[s] = known[scene.name]
    return positions, velocities


def covariance_of(information):
    """Inverse of a Fisher information; infinite for parameters that it does not determine.

    Where only a combination of parameters is determined (the product of three constants), each
    of them alone can take any value.
    """
    n = len(information)
    if not n:
        return np.zeros((0, 0))
    if not np.isfinite(information).all():
        return np.diag(np.full(n, np.inf))
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    lost = values <= UNDETERMINED * values[-1]
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T / np.outer(size, size)
    free = (np.abs(vectors[:, lost]) > 0.05).any(axis=1) | (np.diag(information) <= 0)
    covariance[free, free] = np.inf
    return covariance


def _tiny(matrix):
    diagonal = np.diag(matrix)
    if not len(diagonal):
        return np.zeros((0, 0))
    return np.diag(np.where(diagonal > 0, 1e-14 * diagonal, 1.0))


def _solve_bounded(matrix, vector, x, low, high):
    """Newton step within the bounds: the minimum of the quadratic model in the box."""
    if not len(vector):
        return np.zeros(0)
    dx = np.linalg.solve(matrix, vector)
    if np.all((x + dx >= low) & (x + dx <= high)):
        return dx
    from scipy.optimize import lsq_linear

    # Unit diagonal first: constants differ by many orders of magnitude.
    size = np.sqrt(np.diag(matrix))
    factor = np.linalg.cholesky(matrix / np.outer(size, size))
    box = ((low - x) * size, (high - x) * size)
    open_box = (np.minimum(box[0], -1e-300), np.maximum(box[1], 1e-300))
    target = np.linalg.solve(factor, vector / size)
    return lsq_linear(factor.T, target, open_box, method="bvls").x / size


def predict(
    scenes, law, sigma, *, n_initial, integrator="rk4", substeps=1, up=None, velocity="ignore",
    memory=0.0,
):  # fmt: skip
    """Predict scenes whose initial states are fitted on their first rows only.

    Parameters
    ----------
    n_initial : callable
        ``n_initial(scene) -> int``: rows used; 1 = take the measured state of the first row.
    memory : float
        Correlation time of the position noise, s.

    Returns
    -------
    list of ndarray, one per scene, shape (T, R, d)
        Predicted positions of the receivers.
    """
    heads = [scene.rows(0, max(n_initial(scene), 3)) for scene in scenes]
    known = velocity == "measured" and all(scene.velocities is not None for scene in scenes)
    fit = fit_rollout(
        heads,
        law,
        sigma,
        free=(),
        integrator=integrator,
        substeps=substeps,
        up=up,
        velocity=velocity,
        fit_states=not known,
        memory=memory,
    )
    start = {}
    for batch, p, v in zip(fit.batches, fit.positions, fit.velocities, strict=True):
        for s, scene in enumerate(batch.scenes):
            start[scene.name] = (p[s], v[s])
    out = {}
    for batch in stack(scenes, up, velocity):
        p = np.stack([start[scene.name][0] for scene in batch.scenes])
        v = np.stack([start[scene.name][1] for scene in batch.scenes])
        rolled = rollout(law, batch, p, v, integrator=integrator, substeps=substeps)
        for s, scene in enumerate(batch.scenes):
            out[scene.name] = rolled[: len(scene.times), s]
    return [out[scene.name] for scene in scenes]
