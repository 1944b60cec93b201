"""Constants fitted to whole tracks, and the way back where an oscillation fell out of step."""

from __future__ import annotations

import numpy as np

from bsp_gp.loop.fitted import clipped
from bsp_gp.physics.shooting import cut_segments, fit_rollout

__all__ = ["fit_tracks"]

LOST = 4.0
"""Chi-squared per degree of freedom above which a fit may have gone astray."""


SHORTEST_PIECE = 16
"""Rows."""


APART = 0.02
"""Relative difference of a constant from which the whole tracks are fitted again."""


SURELY_LESS = 0.99


def fit_tracks(observation, law, bounds=None, is_sure=False):
    """Fit constants and initial states to the training tracks.

    Started from a wrong period, an oscillation that is fitted over many periods stays out of step
    for good: the nearest minimum is not the least. Over a quarter of the track it is not yet out
    of step. So where much is left, the quarters are fitted, and the whole again from where they
    lead; the better one counts.

    Parameters
    ----------
    observation : Observation
    law : ForceLaw
        Start values in its constants.
    bounds : dict of str to (float, float), optional
    is_sure : bool
        The start values are those of a fit already: the first fit counts.

    Returns
    -------
    RolloutFit
    """

    def fit(scenes, start):
        return fit_rollout(
            scenes,
            clipped(start, bounds),
            observation.sigma,
            integrator=observation.integrator,
            substeps=observation.substeps,
            up=observation.dataset.up,
            bounds=bounds,
        )

    whole = fit(observation.segments, law)
    if is_sure or not whole.chisqr > LOST * max(whole.n_rows - whole.n_free, 1):
        return whole
    longest = max(len(scene.times) for scene in observation.segments)
    pieces = cut_segments(observation.segments, max(longest // 4, SHORTEST_PIECE))
    if len(pieces) == len(observation.segments):
        return whole
    near = fit(pieces, law)
    apart = np.abs(near.values - whole.values) > APART * np.abs(whole.values)
    if not np.isfinite(near.chisqr) or not apart.any():
        return whole
    again = fit(observation.segments, near.law)
    return again if again.chisqr < SURELY_LESS * whole.chisqr else whole
