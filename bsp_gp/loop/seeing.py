"""An observation as a corrected measurement would have it, and what a correction does to a fit.

Derivatives are those of the whitened residual at the states and constants of a fit, with what
these could take up themselves projected out: what is left is what the data see of a correction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.loop.arcs import orthonormal_rows
from bsp_gp.loop.denoise import tracks_of
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.noise import TrackNoise
from bsp_gp.physics.shooting import cut_segments, fit_rollout

__all__ = [
    "Linearised", "corrected", "corrected_scenes", "corrected_train", "train_tracks", "with_scenes",
]  # fmt: skip

STEP = 1e-4
"""Of a correction's number, in the largest that is believed, for its derivative."""


def corrected_scenes(scenes, correction, values, tracks=None):
    """Scenes as they were, by a correction.

    Parameters
    ----------
    scenes : sequence of Scene
    correction : Correction
    values : array-like
    tracks : dict of str to ndarray, optional
        Scene name -> predicted positions (T, R, d), where the correction needs them; a scene
        without is left as it is.
    """
    if correction.needs_track:
        return tuple(
            correction.undo(s, values, tracks[s.name]) if s.name in tracks else s for s in scenes
        )
    return tuple(correction.undo(scene, values, None) for scene in scenes)


def corrected_train(observation, correction, values, tracks=None):
    """The observation with corrected training scenes; its regression is the old one."""
    length, time = correction.quoted(values)
    train = corrected_scenes(observation.train, correction, values, tracks)
    bend = length / time**2 if observation.method == "derivative" else length
    return replace(
        observation, train=train, segments=tuple(cut_segments(train, observation.segment_rows)),
        sigma=observation.sigma * length, memory=observation.memory * time,
        regression_sigma=observation.regression_sigma * bend,
        noise=replace(observation.noise, sigma=tuple(np.array(observation.noise.sigma) * length)),
    )  # fmt: skip


def corrected(observation, correction, values, fit):
    """The whole observation as a corrected measurement would have it, held-out scenes too.

    Parameters
    ----------
    observation : Observation
    correction : Correction
    values : array-like
    fit : Fit
        Of the law under the correction; where tracks are needed they are its own.
    """
    tracks, test_tracks = {}, {}
    if correction.needs_track:
        tracks = train_tracks(fit, observation.train)
        test_tracks = _tracks_of_test(observation, fit.law)
    changed = corrected_train(observation, correction, values, tracks)
    test = observation.test
    if correction.holds_for_all:
        test = corrected_scenes(test, correction, values, test_tracks)
    return with_scenes(changed, changed.train, test)


def with_scenes(observation, train, test):
    """The observation with other scenes, and all that is made of them.

    A data set whose scenes are neither (they were cut in time) keeps its own: it is asked for
    its units, its entities and its names only.
    """
    new = {scene.name: scene for scene in (*train, *test)}
    dataset = observation.dataset
    dataset = replace(dataset, scenes=tuple(new.get(s.name, s) for s in dataset.scenes))
    changed = replace(
        observation, dataset=dataset, train=tuple(train), test=tuple(test),
        segments=tuple(cut_segments(train, observation.segment_rows)),
    )  # fmt: skip
    return replace(
        changed,
        train_regression=changed.regression(changed.train),
        test_regression=changed.regression(changed.test),
    )


def train_tracks(fit, scenes):
    """Predicted positions of the training scenes by name."""
    return {name: track for name, (track, _) in tracks_of(fit.whole, scenes).items()}


def _tracks_of_test(observation, law):
    whole = fit_rollout(
        cut_segments(observation.test, observation.segment_rows), law, observation.sigma, free=(),
        integrator=observation.integrator, substeps=observation.substeps,
        up=observation.dataset.up, memory=observation.memory,
    )  # fmt: skip
    return {name: track for name, (track, _) in tracks_of(whole, observation.test).items()}


class Linearised:
    """What a fit leaves, and what changes of the measurement do to it.

    Parameters
    ----------
    observation : Observation
        As measured.
    fit : Fit
        Under `correction` at `values`, or as measured.
    correction : Correction, optional
    values : array-like, optional

    Attributes
    ----------
    residual : ndarray, shape (n,)
        Whitened, less what initial states and constants could take up.
    """

    def __init__(self, observation, fit, correction=None, values=None):
        self.measured, self.fit = observation, fit
        self.tracks = {}
        if fit.whole is not None:
            self.tracks = train_tracks(fit, observation.train)
        self.here = observation
        if correction is not None:
            self.here = corrected_train(observation, correction, values, self.tracks)
        if fit.whole is None:
            self._states = []
            residual, self._constants = fit.residual, fit.jacobian.T
        else:
            blocks = self.here.track_blocks(fit.whole)
            self._states = [orthonormal_rows(js[s]) for _, _, js in blocks for s in range(len(js))]
            self._predicted = fit.whole.predicted
            residual = self._by_segment([flat for flat, _, _ in blocks])
            constants = [
                self._by_segment([jc[:, k] for _, jc, _ in blocks])
                for k in range(len(fit.whole.parameters))
            ]
            self._constants = np.array(constants).reshape(len(constants), len(residual))
        self._constants = orthonormal_rows(self._constants)
        self.residual = self._beside(residual)

    def columns(self, correction, values=None):
        """Derivatives of the residual by the numbers of a correction.

        Returns
        -------
        beside : ndarray, shape (k, n)
            Less what initial states and constants could take up.
        whole : ndarray, shape (k,)
            Length of each before that.
        """
        # At zero the tracks themselves are corrected: noise that is turned along is no signal.
        source = self._without_noise() if values is None else self.measured
        values = np.zeros(len(correction)) if values is None else np.array(values, dtype=float)
        beside, whole = [], []
        for k, size in enumerate(correction.sizes):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[k] += sign * STEP * size
                changed = corrected_train(source, correction, moved, self.tracks)
                ends.append(self._residual_of(changed, self.fit.law))
            with np.errstate(over="ignore", invalid="ignore"):
                slope = [(up - down) / (2 * STEP * size) for up, down in zip(*ends, strict=True)]
                whole.append(float(np.sqrt(sum(np.square(part).sum() for part in slope))))
            if not np.isfinite(whole[-1]):  # tracks that run away show no correction
                slope = [np.zeros_like(part) for part in slope]
            beside.append(self._beside(self._joined(slope)))
        return np.array(beside), np.array(whole)

    def column_of_law(self, law, name):
        """The same for one more constant `name` of a law, at its value there."""
        value, ends = law.constants[name], []
        for sign in (1, -1):
            changed = law.with_constants({name: value * (1 + sign * STEP)})
            ends.append(self._residual_of(self.here, changed))
        slope = [(up - down) / (2 * STEP * value) for up, down in zip(*ends, strict=True)]
        return self._beside(self._joined(slope))

    def _without_noise(self):
        """The observation with the predicted positions of the training scenes, gaps kept."""
        if not self.tracks:
            return self.measured
        scenes = tuple(
            scene.on_track(self.tracks[scene.name]) if scene.name in self.tracks else scene
            for scene in self.measured.train
        )
        return replace(self.measured, train=scenes)

    def _residual_of(self, observation, law):
        """Whitened residual at the states of the fit, one array (S, n) per batch."""
        if self.fit.whole is None:
            is_new = observation is not self.measured
            regression = (
                observation.regression(observation.train)
                if is_new
                else observation.train_regression
            )
            return [regression.residual(law)]
        whole = self.fit.whole
        out = []
        batches = stack(observation.segments, observation.dataset.up)
        for k, (batch, old) in enumerate(zip(batches, whole.batches, strict=True)):
            predicted = self._predicted[k]
            if law is not whole.law or not _is_same_stage(batch, old):
                predicted = rollout(
                    law, batch, whole.positions[k], whole.velocities[k],
                    integrator=observation.integrator, substeps=observation.substeps,
                )  # fmt: skip
            noise = TrackNoise(batch, observation.sigma, observation.memory)
            observed = np.where(noise.seen, batch.positions[:, :, batch.bodies.receivers], 0.0)
            error = noise.whiten(observed - predicted)
            out.append(np.nan_to_num(np.moveaxis(error, 1, 0).reshape(error.shape[1], -1)))
        return out

    def _joined(self, parts):
        return parts[0] if self.fit.whole is None else self._by_segment(parts)

    def _by_segment(self, parts):
        """Batches (S, n) as one vector, less what the initial states of each segment take up."""
        rows = [row for part in parts for row in part]
        out = []
        for row, basis in zip(rows, self._states, strict=True):
            row = np.nan_to_num(row)
            out.append(row - basis.T @ (basis @ row) if len(basis) else row)
        return np.concatenate(out)

    def _beside(self, vector):
        basis = self._constants
        return vector - basis.T @ (basis @ vector) if len(basis) else vector


def _is_same_stage(batch, old):
    """Whether times and all that forces do not move are as in the other batch."""
    fixed = np.setdiff1d(np.arange(batch.positions.shape[2]), batch.bodies.receivers)
    return np.array_equal(batch.times, old.times, equal_nan=True) and np.array_equal(
        batch.positions[:, :, fixed], old.positions[:, :, fixed], equal_nan=True
    )
