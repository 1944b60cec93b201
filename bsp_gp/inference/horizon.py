"""The paper's likelihood over several steps ahead, as its code has it.

From every instant the law is rolled out K symplectic Euler steps, from the measured place and the
backward velocity; the K squared errors are averaged, and the log-likelihood is minus their sum
divided by the noise *level* (a Gaussian of variance level / 2, without its normaliser).
"""

import numpy as np

from bsp_gp.errors import DataError
from bsp_gp.inference.latents import PropertyTable
from bsp_gp.inference.misfit import CHUNK_NUMBERS, _Misfit, constant_values, repeated
from bsp_gp.inference.separation import coefficient, separate
from bsp_gp.language.formula import evaluate
from bsp_gp.physics.bodies import law_inputs, stack


class HorizonMisfit(_Misfit):
    """Of any law under the K-step likelihood.

    Parameters
    ----------
    scenes : sequence of Scene
        Without gaps, one time step per scene.
    n_ahead : int
        K.
    level : float
        The protocol's noise level, metres squared.
    up : str, optional
    """

    def __init__(self, law, latents, scenes, *, n_ahead=5, level=0.01, up=None):
        self.n_ahead = n_ahead
        self.level = level
        self.groups = []
        names, row_scene = [], []
        by_length = {}
        for scene in scenes:
            if not np.isfinite(scene.positions).all():
                raise DataError(f"scene {scene.name!r}: the several-step likelihood allows no gaps")
            if len(scene.times) < n_ahead + 2:
                raise DataError(f"scene {scene.name!r} is shorter than {n_ahead + 2} rows")
            by_length.setdefault(len(scene.times), []).append(scene)
        for group in by_length.values():
            for batch in stack(group, up):
                n_starts = len(batch.times) - 1 - n_ahead
                s, r, d = len(batch.scenes), len(batch.bodies.receivers), batch.bodies.n_dims
                table = PropertyTable(batch.bodies, tuple(x.name for x in batch.scenes), latents)
                self.groups.append((batch, table, n_starts))
                size = n_ahead * n_starts * r * d
                row_scene.append(np.repeat(np.arange(s) + len(names), size))
                names += [scene.name for scene in batch.scenes]
        super().__init__(law, latents, names, np.concatenate(row_scene), np.zeros(len(names)))
        self.n_rows = len(self.row_scene)

    def _residual(self, values, constants):
        """Weighted errors (W, m); half their sum of squares is minus the log-likelihood."""
        size = sum(
            n * b.positions[0].size * max(1, b.bodies.others.shape[1]) for b, _, n in self.groups
        )
        step = max(1, CHUNK_NUMBERS // size)
        parts = [
            self._chunk(values[k : k + step], constants[k : k + step])
            for k in range(0, len(values), step)
        ]
        return np.concatenate(parts)

    def _chunk(self, values, constants):
        out = []
        weight = np.sqrt(2 / (self.level * self.n_ahead))
        for batch, table, n_starts in self.groups:
            errors = weight * self._rolled(batch, table, n_starts, values, constants)
            # (K, n, W, S, R, d) -> draws, scenes, rest
            errors = np.moveaxis(errors, (2, 3), (0, 1))
            out.append(errors.reshape(len(values), -1))
        return np.concatenate(out, axis=1)

    def _rolled(self, batch, table, n_starts, values, constants):
        """Errors (K, n, W, S, R, d) of the roll-outs from every instant."""
        n_draws, s = len(values), len(batch.scenes)
        push = self._push(batch, table, values, constants)
        receivers = batch.bodies.receivers
        track = batch.positions
        h = np.diff(batch.times, axis=0)[..., None, None]
        velocity = np.diff(track, axis=0) / h
        still = np.array([i for i in range(track.shape[2]) if i not in set(receivers)], dtype=int)
        fixed = bool(np.all(track[:, :, still] == track[:1, :, still]))
        if fixed:
            velocity[:, :, still] = 0.0
        p, v = track[1 : n_starts + 1], velocity[:n_starts]
        out = []
        for k in range(self.n_ahead):
            rows = slice(1 + k, 1 + k + n_starts)
            step = np.tile(h[rows], (1, n_draws, 1, 1))
            a = push(p, v, batch.times[rows])  # on the first step all draws are at one place
            if k == 0:
                p, v = (np.tile(part, (1, n_draws, 1, 1)) for part in (p, v))
            elif not fixed:
                p[:, :, still] = np.tile(track[rows][:, :, still], (1, n_draws, 1, 1))
                v[:, :, still] = np.tile(velocity[rows][:, :, still], (1, n_draws, 1, 1))
            a *= step
            a += v[:, :, receivers]
            v[:, :, receivers] = a
            a *= step
            p[:, :, receivers] += a
            seen = track[2 + k : 2 + k + n_starts][:, :, receivers]
            shape = (n_starts, n_draws, s, *seen.shape[2:])
            out.append(seen[:, None] - p[:, :, receivers].reshape(shape))
        return np.stack(out)

    def _push(self, batch, table, values, constants):
        """Acceleration (n, W S, R, d) as a function of states of S or W S scenes."""
        n_draws = len(values)
        bodies = repeated(batch.bodies, n_draws, table.columns(values))
        given = constant_values(self.law, self.constants, constants, bodies)
        separated = [separate(term, self.latents.columns) for term in self.law.terms]
        if any(part is None for part in separated):

            def push(p, v, times):
                if p.shape[1] < bodies.n_scenes:
                    p, v = (np.tile(part, (1, n_draws, 1, 1)) for part in (p, v))
                return np.array(
                    self.law.acceleration(bodies, p, v, np.tile(times, (1, n_draws)), given)
                )

            return push
        s = batch.bodies.n_scenes
        weights = [
            np.broadcast_to(
                coefficient(part, table.inputs(term.kind, values)), self._shape(term, batch, values)
            )
            * (1.0 if part.constant is None else given["pair"][part.constant].reshape(-1, s, 1, 1))
            for term, part in zip(self.law.terms, separated, strict=True)
        ]
        weights = [w.reshape(n_draws * s, *w.shape[2:]) for w in weights]

        def push(p, v, times):
            first = p.shape[1] < bodies.n_scenes
            here = batch.bodies if first else bodies
            times = times if first else np.tile(times, (1, n_draws))
            total = 0.0
            for term, part, weight in zip(self.law.terms, separated, weights, strict=True):
                motion = evaluate(part.motion, law_inputs(term.kind, here, p, v, times))
                if term.kind == "field":
                    shape = (*p.shape[:2], weight.shape[1], p.shape[-1])
                    motion = np.broadcast_to(motion, shape)[:, :, :, None]
                if first:
                    motion = np.tile(motion, (1, n_draws, *(1,) * (motion.ndim - 2)))
                for j in range(weight.shape[-1]):  # faster than a sum over a short axis
                    total = total + motion[:, :, :, j] * weight[:, :, j, None]
            return total

        return push

    def _shape(self, term, batch, values):
        r, j = batch.bodies.others.shape
        return (len(values), batch.bodies.n_scenes, r, j if term.kind == "pair" else 1)
