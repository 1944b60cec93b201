"""An unseen source fitted by the same likelihood as a law: it stands among the sources.

The view of the search is linearised anew about the fit that has the source, and asked where the
source had better be, until chi-squared falls no further. Place, velocity and strength are then
those of the joint optimum with the initial states and the constants of the law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from bsp_gp.errors import DataError, EvaluationError
from bsp_gp.loop.hidden_place import Found, refine
from bsp_gp.loop.hidden_pull import hidden_entity, hidden_name
from bsp_gp.loop.hidden_view import view_of
from bsp_gp.loop.tracks import starts_of
from bsp_gp.physics.shooting import cut_segments

__all__ = ["Polished", "in_pieces", "is_lost", "polish", "with_hidden"]

MOST_STEPS = 8
LEAST_FALL = 0.02
"""A fit is done when chi-squared falls by less."""
LOST, FAR = 1.5, 0.01
"""Chi-squared per row, and error of the tracks as a part of their extent, above which tracks are
fitted in pieces first."""
SHORTEST_PIECE = 16
"""Rows."""


def with_hidden(observation, pull, motion, parameters, strength):
    """The observation with the unseen source among the bodies of every scene.

    Parameters
    ----------
    observation : Observation
    pull : Pull
    motion : Motion
    parameters : ndarray, shape (k,)
    strength : float

    Returns
    -------
    Observation
    """
    scenes = (*observation.train, *observation.test)
    entity = hidden_entity(pull, strength, hidden_name(scenes))

    def extended(scene):
        places, velocities = (x[0][:, None] for x in motion(parameters, scene.times))
        grown = {
            "positions": np.concatenate([scene.positions, places], axis=1),
            "entities": (*scene.entities, entity),
        }
        if scene.velocities is not None:
            grown["velocities"] = np.concatenate([scene.velocities, velocities], axis=1)
        if scene.sigma is not None:
            unquoted = np.full(places.shape, np.nan)
            grown["sigma"] = np.concatenate([scene.sigma, unquoted], axis=1)
        return replace(scene, **grown)

    train, test = (tuple(map(extended, part)) for part in (observation.train, observation.test))
    return replace(
        observation, train=train, test=test, segments=tuple(map(extended, observation.segments)),
        train_regression=observation.regression(train),
        test_regression=observation.regression(test) if test else observation.test_regression,
        n_unseen=observation.n_unseen + 1,
    )  # fmt: skip


def in_pieces(observation, fit):
    """Where the law lost the tracks: the observation with shorter segments, and its fits.

    Along a short piece a push still changes the track by little, which the linear view asks for.
    And a fit to whole tracks that went astray is no measure of a law: it is tried again from the
    states of the pieces.

    Returns
    -------
    list of (Observation, Fit)
        The roughest first; the given observation last, with the better of its fits.
    """
    stages = [(observation, fit)]
    while not observation.is_exact and is_lost(fit):
        longest = max(len(scene.times) for scene in observation.segments)
        if longest // 2 < SHORTEST_PIECE:
            break
        pieces = tuple(cut_segments(observation.train, longest // 2))
        observation = replace(observation, segments=pieces, segment_rows=longest // 2)
        try:
            fit = observation.fit(fit.law, start=fit.law)
        except EvaluationError:
            break
        stages.insert(0, (observation, fit))
    for k in range(1, len(stages)):
        stages[k] = (stages[k][0], _better(*stages[k], stages[k - 1][1]))
        if not is_lost(stages[k][1]):
            stages[:k] = [stages[k]] * k
    return [stage for k, stage in enumerate(stages) if k == 0 or stage is not stages[k - 1]]


def _better(observation, fit, near):
    """A fit, or the one that starts from the states of a fit to pieces, whichever is better."""
    try:
        again = observation.fit(
            near.law, start=near.law, states=starts_of(near.whole, observation.segments)
        )
    except EvaluationError:
        return fit
    return again if again.chisqr < fit.chisqr else fit


def is_lost(fit):
    """Whether a fit to whole tracks follows them no longer: far off by noise and by their size."""
    if fit.whole is None or fit.chisqr <= LOST * max(fit.n_rows, 1):
        return False
    squares, extent = [], 0.0
    for batch, predicted in zip(fit.whole.batches, fit.whole.predicted, strict=True):
        seen = batch.positions[:, :, batch.bodies.receivers]
        extent = max(extent, float(np.nanmax(seen) - np.nanmin(seen)))
        squares.append(np.square(seen - predicted).ravel())
    return not np.nanmean(np.concatenate(squares)) < (FAR * extent) ** 2


@dataclass(frozen=True, eq=False)
class Polished:
    """An unseen source at the optimum of the likelihood.

    Attributes
    ----------
    found : Found
    observation : Observation
        With the source in it.
    fit : Fit
    view : View
        About this fit; its y is what the whole source is to explain.
    """

    found: Found
    observation: object
    fit: object
    view: object

    def bic(self, n_effective):
        """With the source's own numbers counted."""
        return self.fit.bic(n_effective) + self.found.n_free * log(max(n_effective, 2.0))


def polish(stages, law, pull, found, stage, most_steps=MOST_STEPS):
    """Bring a source that was found on a view to the optimum of the likelihood.

    Parameters
    ----------
    stages : list of (Observation, Fit)
        Of `in_pieces`: the law without the source.
    law : ForceLaw
        Start values in its constants.
    pull : Pull
    found : Found
    stage : Stage
    most_steps : int

    Returns
    -------
    Polished or None
        None where the law has no finite fit with a source there.
    """
    near = None
    for observation, fit in stages:
        best = _fitted(observation, law, pull, found, near or fit)
        if best is None:
            return None
        for _ in range(most_steps):
            better = _stepped(observation, best, pull, stage)
            if better is None:
                break
            fall = best.fit.chisqr - better.fit.chisqr
            best = better
            if fall < LEAST_FALL + 1e-6 * best.fit.chisqr:
                break
        found, law, near = best.found, best.fit.law, best.fit
    motion, strength = found.motion, found.strength
    pull = pull.under(best.fit.law)
    view = view_of(
        best.observation, best.fit, pull, (motion, found.parameters, strength), stride=False
    )
    return replace(best, view=view)


def _fitted(observation, law, pull, found, near):
    """The fit with the source there, its tracks started from those of a fit near by."""
    try:
        grown = with_hidden(observation, pull, found.motion, found.parameters, found.strength)
        states = starts_of(near.whole, grown.segments) if near.whole is not None else None
        fit = grown.fit(law, start=law, states=states)
    except (DataError, EvaluationError):
        return None
    return Polished(found, grown, fit, None) if np.isfinite(fit.chisqr) else None


def _stepped(observation, best, pull, stage):
    """The fit with the source moved to where the view would have it, or part of the way."""
    now = best.found
    view = view_of(
        best.observation, best.fit, pull.under(best.fit.law),
        (now.motion, now.parameters, now.strength), stride=False,
    )  # fmt: skip
    wanted = refine(view, now.motion, now.parameters, stage)
    for part in (1.0, 0.5, 0.2):
        parameters = now.parameters + part * (wanted.parameters - now.parameters)
        strength = now.strength + part * (wanted.strength - now.strength)
        moved = Found(now.motion, parameters, strength, wanted.gain)
        tried = _fitted(observation, best.fit.law, pull, moved, best.fit)
        if tried is not None and tried.fit.chisqr < best.fit.chisqr:
            return tried
    return None
