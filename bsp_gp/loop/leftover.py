"""What a fitted law leaves of the accelerations, for searches and for tracing.

On noisy data laws are evaluated at denoised states (`denoise`), and what the finite step alone
leaves is taken off: the second differences of the fitted track itself, which obeys its law exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bsp_gp.loop.denoise import states_of, tracks_of
from bsp_gp.search.constants import fit_constants

__all__ = ["Leftover"]


@dataclass(frozen=True, eq=False)
class Leftover:
    """Residuals of the training scenes at the states of one fit.

    Attributes
    ----------
    observation : Observation
    along : Fit or None
        The fit at whose states laws are evaluated; None for the measured states.
    use_tracks : bool
        Whether these are the states of the fitted track itself, not the denoised ones.
    """

    observation: object
    along: object = None
    use_tracks: bool = False
    _states: dict = field(init=False, repr=False)
    _tracks: dict = field(init=False, repr=False)

    def __post_init__(self):
        whole = getattr(self.along, "whole", None)
        train = self.observation.train
        tracks = tracks_of(whole, train) if whole else {}
        states = states_of(whole, train) if whole and not self.use_tracks else tracks
        object.__setattr__(self, "_states", states)
        object.__setattr__(self, "_tracks", tracks)

    def regression(self, scenes):
        """The regression of training scenes, or of versions of them, at the denoised states."""
        return self._built(scenes, self._kept_of(self._states, scenes))

    def residual(self, regression, law):
        """Whitened residual of a fitted law, and the columns of its free constants.

        Parameters
        ----------
        regression : Regression
            Of `regression`.
        law : ForceLaw

        Returns
        -------
        residual : ndarray, shape (n,)
        jacobian : ndarray, shape (n, k)
        """
        fitted = fit_constants(regression, law)
        if self.observation.is_exact:
            return fitted.residual, fitted.jacobian
        residual = regression.residual(law)
        if self._tracks:
            residual = residual - self._step_error(regression)
        return residual, fitted.jacobian

    def _built(self, scenes, states):
        return self.observation.regression(scenes, states)

    def _kept_of(self, states, scenes):
        """States of the bodies that are receivers in these versions of the scenes."""
        whole = {scene.name: scene for scene in self.observation.train}
        out = {}
        for scene in scenes:
            if scene.name in states:
                p, v = states[scene.name]
                kept = np.isin(whole[scene.name].dynamic, scene.dynamic)
                out[scene.name] = (p[:, kept], v[:, kept])
        return out

    def _step_error(self, regression):
        """Whitened residual of the fitted tracks under the law that made them."""
        states = self._kept_of(self._tracks, regression.scenes)
        if len(states) < len(regression.scenes):
            return 0.0
        scenes = [scene.on_track(states[scene.name][0]) for scene in regression.scenes]
        return self._built(scenes, states).residual(self.along.law)
