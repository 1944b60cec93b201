"""Constants fitted to whole tracks, and the way back where an oscillation fell out of step."""

from __future__ import annotations

import numpy as np

from bsp_gp.loop.fitted import clipped
from bsp_gp.physics.shooting import cut_segments, fit_rollout

__all__ = ["fit_tracks", "is_lost", "starts_of"]

LOST = 4.0
"""Chi-squared per degree of freedom above which a fit may have gone astray."""


SHORTEST_PIECE = 16
"""Rows."""


SURELY_LESS = 0.99


def fit_tracks(observation, law, bounds=None, is_sure=False, states=None, sizes=None):
    """Fit constants and initial states to the training tracks.

    Started from a wrong period, an oscillation that is fitted over many periods stays out of step
    for good, and bodies that fly past each other closely stay on the wrong course: the nearest
    minimum is not the least. Over a quarter of the track little is lost yet. So where much is
    left, the quarters are fitted, then halves from where these lead, and the whole again; the
    better one counts.

    Parameters
    ----------
    observation : Observation
    law : ForceLaw
        Start values in its constants.
    bounds : dict of str to (float, float), optional
    is_sure : bool
        The start values are those of a fit already: the first fit counts.
    states : mapping, optional
        Initial states to start from, as for `fit_rollout`.
    sizes : mapping, optional
        Typical sizes of parameters that start at 0, as for `fit_rollout`.

    Returns
    -------
    RolloutFit
    """

    def fit(scenes, start, states=None):
        return fit_rollout(
            scenes,
            clipped(start, bounds),
            observation.sigma,
            integrator=observation.integrator,
            substeps=observation.substeps,
            up=observation.dataset.up,
            bounds=bounds,
            memory=observation.memory,
            states=states,
            sizes=sizes,
        )

    whole = fit(observation.segments, law, states)
    if is_sure or not is_lost(whole):
        return whole
    longest = max(len(scene.times) for scene in observation.segments)
    near = whole
    for parts in (4, 2):
        pieces = cut_segments(observation.segments, max(longest // parts, SHORTEST_PIECE))
        if len(pieces) == len(observation.segments):
            continue
        if near is whole:
            closer = fit(pieces, law)
        else:
            closer = fit(pieces, near.law, starts_of(near, pieces))
        if not np.isfinite(closer.chisqr) or is_lost(closer):
            break
        near = closer
    if near is whole:
        return whole
    again = fit(observation.segments, near.law, starts_of(near, observation.segments))
    return again if again.chisqr < SURELY_LESS * whole.chisqr else whole


def is_lost(fit):
    """Whether a fit to whole tracks may have gone astray."""
    return not fit.chisqr <= LOST * max(fit.n_rows - fit.n_free, 1)


def starts_of(fit, scenes):
    """Initial states of scenes or pieces from a fit to other pieces that start at the same row.

    Parameters
    ----------
    fit : RolloutFit
    scenes : sequence of Scene

    Returns
    -------
    dict of str to (ndarray, ndarray)
        Scene name -> positions and velocities (R, d); scenes without such a piece are missing.
    """
    found = {}
    for batch, p, v in zip(fit.batches, fit.positions, fit.velocities, strict=True):
        for s, scene in enumerate(batch.scenes):
            found[_place(scene)] = (p[s], v[s])
    return {scene.name: found[_place(scene)] for scene in scenes if _place(scene) in found}


def _place(scene):
    return scene.name.partition("[")[0], float(scene.times[0])
