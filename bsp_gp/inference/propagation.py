"""Position noise followed through the law: the covariance that inference under noise needs.

A law is evaluated at measured, noisy states, so the noise enters the residual twice: by the second
difference, and by the forces at wrong places and speeds. To first order the residual of a scene is
M times the noise of its positions; M is found by differences at a reference, and the residual is
whitened by the covariance sigma^2 M M^T. That is the likelihood of the noise-free motion with its
initial states free, linearised about the data.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.inference.misfit import DirectMisfit, MotionBank, averaged
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.regression import Regression

STEP = 1e-3
"""Finite-difference step, in sigma."""
REACH = 3
"""Rows of positions that one residual depends on."""


class PropagatedBank(MotionBank):
    """Motion parts whitened scene by scene with the propagated covariance.

    Parameters
    ----------
    regression : Regression
        "gls" or one-step; its own whitening is replaced.
    scenes : sequence of Scene
        With the reference values of the latents filled in.
    law : ForceLaw
        With the reference values of its constants.
    settings : dict
        With which `regression` was built: method, up, sources; and ``states(scene)`` or None.
    is_smooth : bool
    """

    def __init__(self, regression, scenes, law, settings, is_smooth=False):
        raw = tuple(
            replace(b, whitener=None, scale=b.valid.astype(float)) for b in regression.batches
        )
        plain = Regression(raw, regression.method, regression.sigma, regression.scenes)
        super().__init__(plain, is_smooth)
        by_name = {scene.name: scene for scene in scenes}
        self.whiteners = []
        for batch in plain.batches:
            self.whiteners.append([
                _whitener(by_name[name], batch, s, law, settings, regression.sigma, is_smooth)
                for s, name in enumerate(batch.scene_names)
            ])  # fmt: skip

    def direct(self, law, latents):
        """The misfit of a law that is no product, whitened alike."""
        whiteners = [pair for batch in self.whiteners for pair in batch]
        return _Whitened(law, latents, self.regression, self.is_smooth, whiteners)

    def factors(self, parts, index):
        """As `MotionBank.factors`, all receivers of a scene together: R is 1."""
        key = (parts, index)
        if key not in self._factors:
            batch = self.regression.batches[index]
            columns = np.concatenate([self.field(k, m, index) for k, m in parts], axis=3)
            n, n_scenes, r, p, d = columns.shape
            triangles, targets, rests = [], [], []
            for s in range(n_scenes):
                rows, whitener = self.whiteners[index][s]
                matrix = whitener @ together(columns[:, s]).reshape(n * r * d, r * p)[rows]
                y = whitener @ batch.target[:, s].reshape(-1)[rows]
                triangle, target, rest = compressed(matrix, y)
                triangles.append(triangle)
                targets.append(target)
                rests.append(rest)
            self._factors[key] = (
                np.stack(triangles)[:, None], np.stack(targets)[:, None], np.array(rests)
            )  # fmt: skip
        return self._factors[key]


class _Whitened(DirectMisfit):
    """Residuals of all instants, whitened scene by scene."""

    def __init__(self, law, latents, regression, is_smooth, whiteners):
        super().__init__(law, latents, regression, is_smooth)
        self._sizes = np.bincount(self.row_scene)
        self._ends = np.cumsum(self._sizes)
        # (S, n, R, d) is how a scene's residuals lie, as are the rows of the whiteners.
        self._whiteners = whiteners
        self.row_scene = np.concatenate(
            [np.full(len(rows), s) for s, (rows, _) in enumerate(whiteners)]
        )
        self._starts = np.searchsorted(self.row_scene, np.arange(len(whiteners)))

    def _residual(self, values, constants):
        raw = super()._residual(values, constants)
        parts = []
        for s, (rows, whitener) in enumerate(self._whiteners):
            scene = raw[:, self._ends[s] - self._sizes[s] : self._ends[s]]
            parts.append(scene[:, rows] @ whitener.T)
        return np.concatenate(parts, axis=1)


def together(columns):
    """Columns of each receiver, (n, R, P, d), as those of all of them, (n, R * d, R * P)."""
    n, r, p, d = columns.shape
    spread = np.zeros((n, r, d, r, p))
    for k in range(r):
        spread[:, k, :, k] = np.swapaxes(columns[:, k], 1, 2)
    return spread.reshape(n, r * d, r * p)


def compressed(matrix, y):
    """QR with as many rows as columns, whatever the number of rows of the scene."""
    p = matrix.shape[1]
    q, triangle = np.linalg.qr(matrix)
    target = q.T @ y
    rest = float(np.square(y - q @ target).sum())
    short = p - len(triangle)
    if short > 0:
        triangle = np.concatenate([triangle, np.zeros((short, p))])
        target = np.concatenate([target, np.zeros(short)])
    return triangle, target, rest


def _whitener(scene, batch, s, law, settings, sigma, is_smooth):
    """Valid rows (flat over time, receiver, axis) and the inverse Cholesky factor on them."""
    rows = np.flatnonzero(batch.valid[:, s].reshape(-1))
    moving = scene.dynamic
    d = scene.n_dims
    steps = [
        (phase, r, k) for phase in range(REACH) for r in range(len(moving)) for k in range(d)
        if np.isfinite(sigma[k])
    ]  # fmt: skip
    copies = []
    for j, (phase, r, k) in enumerate(steps):
        positions = np.array(scene.positions)
        positions[phase::REACH, moving[r], k] += STEP * sigma[k]
        copies.append(replace(scene, name=f"{scene.name}#{j}", positions=positions))
    base = replace(scene, name=f"{scene.name}#")
    everything = [base, *copies]
    make_states = settings.get("states")
    states = {c.name: make_states(c) for c in everything} if make_states else None
    regression = build_regression(
        everything, method=settings["method"], sigma=sigma, up=settings["up"], states=states,
        sources=settings["sources"],
    )  # fmt: skip
    (part,) = regression.batches
    predicted = regression.predict(part, law)
    if is_smooth:
        predicted = averaged(predicted, part)
    residual = np.where(part.valid, part.target - predicted, 0.0)
    change = (residual[:, 1:] - residual[:, :1]) / STEP  # (n, copies, R, d)
    n = len(residual)
    full = np.zeros((n, len(moving), d, n + 2, len(moving), d))
    for j, (phase, r, k) in enumerate(steps):
        for t in range(n):  # residual t sees the positions t, t + 1, t + 2
            full[t, :, :, t + (phase - t) % REACH, r, k] = change[t, j]
    matrix = full.reshape(n * len(moving) * d, -1)[rows]
    covariance = matrix @ matrix.T
    covariance[np.diag_indices_from(covariance)] *= 1 + 1e-9
    factor = np.linalg.cholesky(covariance)
    return rows, np.linalg.inv(factor)
