"""What a small push does to the tracks, linearised about a fit: the cheap view of a search.

A hidden body's pull is small beside what is declared, and what it does to a track follows from
the equation of motion linearised along the track: ``d'' = (da/dp) d + (da/dv) d' + h(t)``, from
the first row on, through every gap, however sparse the rows. Whitened by the errors of the
positions, with initial states and constants of the law projected out, a hypothesis is one vector;
its strength follows in closed form, and noise alone is a standard normal vector.

On exact data (and with measured velocities) the accelerations themselves are the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.loop.denoise import smooth
from bsp_gp.loop.hidden_response import (
    MOST_NODES,
    curve_of,
    gradient_along,
    interpolation,
    nodes_of,
    propagated,
)
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.evaluation import PreparedLaw
from bsp_gp.physics.noise import TrackNoise

__all__ = ["View", "view_of"]

MOST_VALUES = 2_000_000
"""Numbers in memory at once for a chunk of hypotheses."""
KEPT = 1e-3
"""Singular values of the response below this part of the greatest are left out."""
EXACT_ROWS = 400


@dataclass(frozen=True, eq=False)
class _Part:
    """One stretch of track: states of the receivers at nodes, and what pushes there do to y."""

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    pull: object
    matrix: object  # (n R d, K), or None: rows are the whitened pushes themselves
    whiten: object = None


@dataclass(frozen=True, eq=False)
class View:
    """Residual and responses in whitened coordinates without nuisance.

    Attributes
    ----------
    parts : tuple
    y : ndarray, shape (K,)
        What an unseen source is to explain.
    rest : float
        Sum of squares of the residual that no push can explain.
    dof : int
        Rows less nuisance.
    nuisance : ndarray, shape (K, c)
        Orthonormal; projected out of responses.
    pull : Pull
    is_exact : bool
    """

    parts: tuple
    y: np.ndarray
    rest: float
    dof: int
    nuisance: np.ndarray
    pull: object
    is_exact: bool

    @property
    def total(self):
        """Sum of squares to be explained, unexplainable ones included."""
        return float(self.y @ self.y) + self.rest

    @property
    def times(self):
        """First and last instant, s."""
        return min(p.times[0] for p in self.parts), max(p.times[-1] for p in self.parts)

    def response(self, track, parameters):
        """What unit sources do to y.

        Parameters
        ----------
        track : callable
            ``track(parameters, times)`` -> places and velocities (C, n, d).
        parameters : ndarray, shape (C, k)

        Returns
        -------
        ndarray, shape (C, K)
        """
        parameters = np.atleast_2d(parameters)
        most = max(p.positions.size for p in self.parts)
        step = max(1, MOST_VALUES // most)
        chunks = [
            self._response(track, parameters[k : k + step]) for k in range(0, len(parameters), step)
        ]
        return np.concatenate(chunks)

    def _response(self, track, parameters):
        found = []
        for part in self.parts:
            places, velocities = track(parameters, part.times)
            push = part.pull(part.positions, part.velocities, part.times, places, velocities)
            found.append(
                part.whiten(push)
                if part.matrix is None
                else push.reshape(len(parameters), -1) @ part.matrix
            )
        out = np.concatenate(found, axis=1) if self.is_exact else sum(found)
        return out - (out @ self.nuisance) @ self.nuisance.T

    def strengths(self, response, targets=None):
        """Best strengths and what they explain.

        Parameters
        ----------
        response : ndarray, shape (C, K)
        targets : ndarray, shape (K, B), optional
            By default the residual.

        Returns
        -------
        strength, gain : ndarray, shape (C,) or (C, B)
            Strengths below zero count as 0 where the law's property has none below zero.
        """
        targets = self.y if targets is None else targets
        size = np.square(response).sum(axis=1)
        size = np.where(size > 0, size, np.inf)
        size = size if targets.ndim == 1 else size[:, None]
        strength = (response @ targets) / size
        if self.pull.is_positive:
            strength = np.maximum(strength, 0.0)
        return strength, np.square(strength) * np.where(np.isfinite(size), size, 0.0)

    def null(self, rng, n_draws):
        """Noise alone: targets (K, B) and their sums of squares, unexplainable part included."""
        targets = rng.standard_normal((len(self.y), n_draws))
        targets -= self.nuisance @ (self.nuisance.T @ targets)
        inside = len(self.y) - self.nuisance.shape[1]
        rest = rng.chisquare(max(self.dof - inside, 1), n_draws) if self.dof > inside else 0.0
        return targets, np.square(targets).sum(axis=0) + rest


def view_of(observation, fit, pull, hidden=None, stride=True):
    """The view about a fit.

    Parameters
    ----------
    observation : Observation
    fit : Fit
        Of a law without an unseen source, or with one in the scenes of `observation`.
    pull : Pull
    hidden : tuple of (callable, ndarray, float), optional
        Track, parameters and strength of the source that `fit` has: it is handed back to the
        residual, so that y is what all of it is to explain.
    stride : bool
        Exact data: leave out rows beyond `EXACT_ROWS` a scene.

    Returns
    -------
    View
    """
    if observation.is_exact:
        view = _exact_view(observation, fit, pull, stride)
    else:
        view = _track_view(observation, fit, pull)
    if hidden is None:
        return view
    track, parameters, strength = hidden
    return replace(view, y=view.y + strength * view.response(track, parameters)[0])


def _exact_view(observation, fit, pull, stride):
    regression = observation.train_regression
    residual = regression.residual(fit.law)
    parts, kept, start = [], [], 0
    for batch, scenes in zip(regression.batches, _scenes_by_batch(regression), strict=True):
        n, n_scenes, n_receivers, n_dims = batch.target.shape
        index = np.arange(batch.target.size).reshape(batch.target.shape) + start
        start += batch.target.size
        step = max(1, -(-n // EXACT_ROWS)) if stride else 1
        for s in range(n_scenes):
            rows = np.flatnonzero(batch.valid[:, s].any(axis=(1, 2)))[::step]
            receivers = batch.bodies.receivers
            entities = [scenes[s].entities[k] for k in receivers]
            scale = batch.scale[rows, s]
            flat = lambda push, w=scale: (push * w).reshape(len(push), -1)  # noqa: E731
            parts.append(
                _Part(
                    batch.times[rows, s],
                    batch.positions[rows, s][:, receivers],
                    batch.velocities[rows, s][:, receivers],
                    pull.on(entities, n_dims, observation.dataset.up),
                    None,
                    flat,
                )
            )
            kept.append(index[rows, s].ravel())
    kept = np.concatenate(kept)
    nuisance = _basis(fit.jacobian[kept])
    y = residual[kept]
    y = y - nuisance @ (nuisance.T @ y)
    return View(tuple(parts), y, 0.0, len(y) - nuisance.shape[1], nuisance, pull, True)


def _scenes_by_batch(regression):
    by_name = {scene.name: scene for scene in regression.scenes}
    return [[by_name[name] for name in batch.scene_names] for batch in regression.batches]


def _basis(columns):
    """Orthonormal basis of some columns, those without size left out."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0] / size[size > 0]
    if not columns.shape[1]:
        return columns
    u, values, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, values > 1e-10 * values[0]]


def _track_view(observation, fit, pull):
    pieces = []
    for batch, predicted in zip(fit.whole.batches, fit.whole.predicted, strict=True):
        for s, scene in enumerate(batch.scenes):
            track = predicted[: len(scene.times), s]
            if np.isfinite(track).all():
                pieces.append(_piece(observation, fit, scene, track, pull))
    blocks = [piece["basis"] for piece in pieces]
    constants = np.concatenate([piece["constants"] for piece in pieces])
    residual = np.concatenate([piece["residual"] for piece in pieces])
    stacked = np.zeros((len(residual), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        stacked[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    own = _basis(constants)
    residual = residual - own @ (own.T @ residual)
    basis = _basis(stacked - own @ (own.T @ stacked))
    y = basis.T @ residual
    parts, row = [], 0
    for piece in pieces:
        stop = row + len(piece["residual"])
        part = piece["part"]
        parts.append(
            _Part(
                part.times, part.positions, part.velocities, part.pull,
                piece["response"] @ basis[row:stop],
            )
        )  # fmt: skip
        row = stop
    dof = sum(piece["dof"] for piece in pieces) - own.shape[1]
    rest = max(float(residual @ residual - y @ y), 0.0)
    return View(tuple(parts), y, rest, dof, np.zeros((len(y), 0)), pull, False)


def _piece(observation, fit, scene, track, pull):
    """One stretch: residual, response to pushes at nodes, constants; initial states taken out."""
    batch = stack([scene], observation.dataset.up)[0]
    noise = TrackNoise(batch, observation.sigma, observation.memory)
    receivers = scene.dynamic
    observed = scene.positions[:, receivers]
    path = track + smooth(scene.times, np.where(np.isfinite(observed), observed - track, np.nan))
    n_rows = len(scene.times)
    times = nodes_of(scene.times)
    states = [curve_of(scene.times, scene.positions[:, k], times) for k in range(len(scene.names))]
    positions = np.stack([p for p, _ in states], axis=1)
    velocities = np.stack([v for _, v in states], axis=1)
    for r, k in enumerate(receivers):
        positions[:, k], velocities[:, k] = curve_of(scene.times, path[:, r], times)
    to_rows = interpolation(times, scene.times)
    n_bins = min(n_rows, MOST_NODES)
    bins = np.arange(n_rows) * n_bins // n_rows

    def rows_of(curves):
        """Whitened rows of curves (c, n, R, d) given at nodes, averaged in bins: (c, rows)."""
        at_rows = np.einsum("tn,cnrd->ctrd", to_rows, curves)
        return binned(noise.whiten(at_rows[:, :, None])[:, :, 0])

    def binned(whitened):
        if n_bins == n_rows:
            return whitened.reshape(len(whitened), -1)
        out = np.zeros((len(whitened), n_bins, *whitened.shape[2:]))
        np.add.at(out, (slice(None), bins), whitened)
        count = np.bincount(bins)[:, None, None]
        return (out / np.sqrt(count)).reshape(len(whitened), -1)

    law = PreparedLaw(fit.law, batch.bodies)
    gradient = gradient_along(law, positions, velocities, times, receivers)
    push, start = propagated(times, gradient)
    shape = (len(times), len(receivers), scene.n_dims)
    response = _chunked(rows_of, np.moveaxis(push, -1, 0), shape)
    initial = rows_of(np.moveaxis(start, -1, 0).reshape(-1, *shape))
    by_constant = _by_constant(fit, batch.bodies, positions, velocities, times)
    constants = by_constant.reshape(len(fit.values), len(response)) @ response
    difference = np.where(np.isfinite(observed), observed - track, 0.0)
    residual = binned(noise.whiten(difference[:, None])[None, :, 0])[0]
    own = _basis(initial.T)

    def free(rows):
        return rows - (rows @ own) @ own.T

    response, constants, residual = free(response), free(constants), free(residual)
    entities = [scene.entities[k] for k in receivers]
    part = _Part(
        times, positions[:, receivers], velocities[:, receivers],
        pull.on(entities, scene.n_dims, observation.dataset.up), None,
    )  # fmt: skip
    seen = binned(noise.seen[None, :, 0].astype(float))[0] > 0
    values, vectors = np.linalg.eigh(response.T @ response)
    basis = vectors[:, values > KEPT**2 * max(values[-1], 1e-300)]
    return {
        "part": part, "response": response, "constants": constants.T, "residual": residual,
        "basis": basis, "dof": int(seen.sum()) - own.shape[1],
    }  # fmt: skip


def _chunked(rows_of, curves, shape):
    """`rows_of` many curves (c, n, R d), a few at a time."""
    step = max(1, MOST_VALUES // max(int(np.prod(shape)), 1))
    return np.concatenate(
        [rows_of(curves[k : k + step].reshape(-1, *shape)) for k in range(0, len(curves), step)]
    )


def _by_constant(fit, bodies, positions, velocities, times):
    """Derivatives of the accelerations by the free constants, (k, n, R, d)."""
    out = []
    for k, value in enumerate(fit.values):
        step = 1e-6 * (abs(value) or 1.0)
        changed = []
        for sign in (1, -1):
            values = np.array(fit.values)
            values[k] += sign * step
            law = fit.law.with_values(fit.parameters, values)
            a = law.acceleration(bodies, positions[:, None], velocities[:, None], times[:, None])
            changed.append(a[:, 0])
        out.append((changed[0] - changed[1]) / (2 * step))
    n = (len(times), len(bodies.receivers), bodies.n_dims)
    return np.nan_to_num(np.array(out).reshape(len(fit.values), *n))
