"""Motion parts of laws on linearised tracks: products compressed, other laws evaluated."""

import numpy as np

from bsp_gp.inference.misfit import DirectMisfit, MotionBank
from bsp_gp.inference.propagation import compressed, together
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.regression import Regression, RegressionBatch


class TrackBank(MotionBank):
    """Accelerations at the points of reference tracks, whitened as whole tracks.

    Parameters
    ----------
    paths : sequence of ScenePath
    scenes : sequence of Scene
        With the reference values of the latents filled in.
    law : ForceLaw
        With the reference values of its constants.
    up : str or None
    sigma : ndarray, shape (d,)
    """

    def __init__(self, paths, scenes, law, up, sigma):
        by_name = {path.scene: path for path in paths}
        batches = [
            _batch_of(by_name[batch.scenes[0].name], batch.bodies, law)
            for scene in scenes for batch in stack([scene], up)
        ]  # fmt: skip
        super().__init__(Regression(tuple(batches), "track", sigma, tuple(scenes)))
        self.paths = [by_name[scene.name] for scene in scenes]
        # What the reference leaves, and what the law put into it.
        self.offsets = [
            path.residual + path.apply(batch.target.reshape(len(batch.target), -1, 1))[:, 0]
            for path, batch in zip(self.paths, batches, strict=True)
        ]

    def direct(self, law, latents):
        """The misfit of a law that is no product."""
        return _DirectTracks(law, latents, self)

    def factors(self, parts, index):
        """As `MotionBank.factors`, all receivers of a scene together: R is 1."""
        key = (parts, index)
        if key not in self._factors:
            columns = np.concatenate([self.field(k, m, index) for k, m in parts], axis=3)
            matrix = self.paths[index].apply(together(columns[:, 0]))
            triangle, target, rest = compressed(matrix, self.offsets[index])
            self._factors[key] = (triangle[None, None], target[None, None], np.array([rest]))
        return self._factors[key]


class _DirectTracks(DirectMisfit):
    """Whitened residuals of whole tracks, the law evaluated at all points of the reference."""

    def __init__(self, law, latents, bank):
        super().__init__(law, latents, bank.regression)
        self._bank = bank
        self._sizes = np.bincount(self.row_scene)
        sizes = [len(path.residual) for path in bank.paths]
        self.row_scene = np.repeat(np.arange(len(sizes)), sizes)
        self._starts = np.searchsorted(self.row_scene, np.arange(len(sizes)))

    def _residual(self, values, constants):
        raw = super()._residual(values, constants)  # reference less law, at every point
        parts, first = [], 0
        for path, batch, size in zip(
            self._bank.paths, self.regression.batches, self._sizes, strict=True
        ):
            change = raw[:, first : first + size].T.reshape(len(batch.times), -1, len(raw))
            parts.append((path.residual[:, None] + path.apply(change)).T)
            first += size
        return np.concatenate(parts, axis=1)


def _batch_of(path, bodies, law):
    """The points of one scene as a batch; its target is the law at the reference."""
    positions, velocities = np.moveaxis(path.states, (0, 3, 1, 2), (0, 1, 2, 3))[:, :, None]
    times = path.times[:, None]
    with np.errstate(all="ignore"):
        target = law.acceleration(bodies, positions, velocities, times)
    if path.is_free:
        target = np.zeros_like(target)
    valid = np.ones(target.shape, dtype=bool)
    n_counted = max(path.n_seen - path.n * path.n_pieces, 1)
    return RegressionBatch(
        bodies, times, positions, velocities, target, valid, valid.astype(float), (path.scene,),
        kept=np.ones(n_counted, dtype=bool),
    )  # fmt: skip
