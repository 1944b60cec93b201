"""A data set made ready for the loop: split, noise, likelihood, integrator; fits and errors.

Everything that a round asks of the data goes through one `Observation`, so that residuals,
predictions and errors always use the same model, the same rows and the same noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.noise import NoiseEstimate
from bsp_gp.data.scene import Scene
from bsp_gp.fitting.estimates import Errors
from bsp_gp.loop.denoise import tracks_of
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.fitted import Fit
from bsp_gp.loop.tracks import fit_tracks, is_lost, starts_of
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.masses import NO_MASS
from bsp_gp.physics.metrics import (
    METRICS,
    error_of,
    one_step_errors,
    residual_acceleration,
    residual_accelerations,
)
from bsp_gp.physics.noise import draw_noise
from bsp_gp.physics.shooting import cut_segments, fit_rollout, predict, track_blocks
from bsp_gp.search.constants import fit_constants
from bsp_gp.units import ACCELERATION, Unit

__all__ = ["Observation", "contradicts"]

N_FLOOR = 64
"""Simulated copies of the held-out data behind the noise floor and parametric intervals."""
FEWEST_FLOOR = 8
"""The same where so many would have more than `MOST_POINTS` points."""
MOST_POINTS = 500_000
TOO_FAR = 2.33
"""Standard errors by which held-out tracks must fall short of a law to contradict it (1 %)."""
_SAME_CHISQR = 1e-6


def contradicts(gain, sight, seen):
    """Whether held-out tracks contradict a law.

    They must be less likely under it than without it, and more so than chance would have it were
    it true: the gain is the square of the sight, give or take twice the sight, and its part of
    that square by which the term's strength is off. Unknown numbers contradict.

    Parameters
    ----------
    gain, sight : float
        Of `Observation.held_out_gain` and `Observation.held_out_sight`.
    seen : float
        Signal-to-noise ratio at which training tracks show what the law has more.
    """
    if gain > 0:
        return False
    spread = 2 * sight * np.hypot(1.0, sight / seen if seen > 0 else np.inf)
    return not gain > sight**2 - TOO_FAR * spread


@dataclass(frozen=True, eq=False)
class Observation:
    """See the module; made by `observe`."""

    dataset: object
    train: tuple[Scene, ...]
    test: tuple[Scene, ...]
    split_note: str
    noise: NoiseEstimate
    sigma: np.ndarray
    is_exact: bool
    method: str
    regression_sigma: np.ndarray
    integrator: str
    substeps: int
    segments: tuple[Scene, ...]
    train_regression: object
    test_regression: object
    sources: bool
    memory: float = 0.0
    segment_rows: int | None = None
    n_unseen: int = 0
    """Bodies that no track shows, the last of every scene: never scored."""

    def __getstate__(self):
        """What travels to workers: everything but what is kept for the running loop."""
        return {k: v for k, v in self.__dict__.items() if not k.startswith("_")}

    # --- fitting ---------------------------------------------------------------------------------

    def fit(self, law, bounds=None, start=None, states=None):
        """Fit the constants of a law to the training scenes.

        Noisy positions: regression first, then whole tracks with free initial states. Exact or
        measured-velocity data: the regression is the likelihood.

        Parameters
        ----------
        law : ForceLaw
        bounds : dict, optional
        start : ForceLaw, optional
            Constants that are surely near, in the place of those of the regression.
        states : mapping, optional
            Initial states to start from, as for `shooting.fit_rollout`.
        """
        first = fit_constants(self.train_regression, law)
        if self.is_exact:
            n_eff = self._effective(self.train_regression, first.residual)
            chisqr = 2 * first.loss
            n_rows = int(self.train_regression.n_rows)
            # Misfit per row, and fewer independent rows than rows.
            inflation = chisqr / max(n_rows - len(first.values), 1) * (n_rows / n_eff)
            # What exact data leave is misfit, not noise: every row counts in a comparison.
            return Fit(
                first.law,
                first.parameters,
                first.values,
                first.covariance * inflation,
                chisqr,
                n_rows,
                float(n_rows),
                first.jacobian,
                first.residual,
                True,
                dof=max(n_eff - len(first.values), 1.0),
            )
        whole = fit_tracks(
            self, start or first.law, bounds, is_sure=start is not None, states=states,
            sizes=dict(zip(first.parameters, first.values, strict=True)),
        )  # fmt: skip
        n_eff = self._effective_positions(whole)
        dof = max(whole.n_rows - whole.n_free, 1)
        # Misfit beyond the noise counts against the constants, with as many independent rows
        # as the autocorrelation of the residual leaves.
        misfit = max(whole.chisqr / dof, 1.0)
        inflation = misfit * (max(whole.n_rows / n_eff, 1.0) if misfit > 1.5 else 1.0)
        residual = self.train_regression.residual(whole.law)
        return Fit(
            whole.law,
            whole.parameters,
            whole.values,
            whole.covariance * inflation,
            whole.chisqr,
            whole.n_rows,
            n_eff,
            first.jacobian,
            residual,
            whole=whole,
            converged=whole.converged,
            dof=self.noise_dof if misfit == 1.0 else float(dof),
        )

    def track_blocks(self, whole):
        """Residuals of a fit to whole tracks and their derivatives, see `shooting.track_blocks`."""
        return track_blocks(
            whole, self.sigma, integrator=self.integrator, substeps=self.substeps,
            memory=self.memory,
        )  # fmt: skip

    def fit_beyond(self, law, contained, bounds=None):
        """Fit a law that contains a fitted one, never worse than that one.

        Started from the contained fit if that is not far from the tracks; otherwise from the
        constants of the regression, and where these lead astray, from those of the contained law.

        Parameters
        ----------
        law : ForceLaw
            Its constants reproduce the contained law.
        contained : Fit
        bounds : dict, optional

        Returns
        -------
        Fit
        """
        if self.is_exact:
            return self.fit(law, bounds)
        enough = contained.chisqr * (1 + _SAME_CHISQR)
        near = self.fit(law, bounds, start=law, states=starts_of(contained.whole, self.segments))
        if near.converged and near.chisqr <= enough and not is_lost(contained.whole):
            return near
        fit = self.fit(law, bounds)
        return fit if fit.chisqr <= near.chisqr else near

    def _effective(self, regression, residual):
        """Number of rows discounted for lag-one autocorrelation of the whitened residual."""
        start, tops, bottoms = 0, 0.0, 0.0
        n_tracks = 0
        for batch in regression.batches:
            part = residual[start : start + batch.target.size].reshape(batch.target.shape)
            start += batch.target.size
            with np.errstate(over="ignore", invalid="ignore"):
                tops += float((part[1:] * part[:-1]).sum())
                bottoms += float((part * part).sum())
            n_tracks += int(batch.valid.any(axis=0).sum())
        rho = _correlation(tops, bottoms)
        return max(regression.n_rows * (1 - rho) / (1 + rho), 4.0 * n_tracks, 8.0)

    def _effective_positions(self, fit):
        tops = bottoms = 0.0
        n_tracks = 0
        for error in fit.whitened:
            with np.errstate(over="ignore", invalid="ignore"):
                tops += float((error[1:] * error[:-1]).sum())
                bottoms += float((error * error).sum())
            n_tracks += int((error != 0).any(axis=0).sum())
        rho = _correlation(tops, bottoms)
        return max(fit.n_rows * (1 - rho) / (1 + rho), 4.0 * n_tracks, 8.0)

    # --- errors on held-out data -----------------------------------------------------------------

    def n_initial(self, scene):
        """First rows on which the initial state of a held-out scene is fitted.

        As declared; otherwise a fifth of the scene, so that a higher frame rate does not make
        the start worse known, and at least 12 rows where a third of the scene has them.
        """
        if self.velocity == "measured":
            return 1
        n = len(scene.times)
        wanted = self.dataset.evaluation.initial_rows
        return min(wanted if wanted is not None else max(min(12, max(3, n // 3)), n // 5), n - 1)

    @property
    def may_have_memory(self):
        """Whether a correlation time of the noise is to be estimated."""
        return self.method == "gls" and self.dataset.noise_memory is None

    @property
    def noise_dof(self):
        """Degrees of freedom behind the noise level; infinite for a declared one."""
        if self.noise.source != "estimated" and self.method != "derivative":
            return np.inf
        counts = [n for n in self.noise.n_effective if np.isfinite(n)]
        return float(sum(counts)) if counts else np.inf

    @property
    def has_masses(self):
        """Whether bodies have masses that were measured, and not ones in their place."""
        return NO_MASS not in self.dataset.notes

    @property
    def velocity(self):
        return "measured" if self.method == "derivative" else "ignore"

    def predictions(self, law, scenes=None):
        """Predicted positions of the receivers of held-out scenes, list of (T, R, d)."""
        if scenes is None or scenes is self.test:
            # Kept for the law objects of the running loop, which are asked for again.
            kept = self.__dict__.setdefault("_predictions", {})
            if id(law) not in kept:
                kept[id(law)] = (law, self._predict(law, self.test))
            return kept[id(law)][1]
        return self._predict(law, scenes)

    def _predict(self, law, scenes):
        tracks = predict(
            scenes,
            law,
            self.sigma,
            n_initial=self.n_initial,
            integrator=self.integrator,
            substeps=self.substeps,
            up=self.dataset.up,
            velocity=self.velocity,
            memory=self.memory,
        )
        for scene, track in zip(scenes, tracks, strict=True):
            track[:, self.is_late(scene)] = np.nan
        return tracks

    def is_late(self, scene):
        """Which receivers the first rows do not show often enough to know their initial state."""
        head = scene.positions[: self.n_initial(scene), scene.dynamic]
        least = 1 if self.velocity == "measured" else 2
        return np.isfinite(head).all(axis=-1).sum(axis=0) < least

    def errors(self, law, scenes=None):
        """Errors of a law on held-out scenes, and what they are made of.

        Returns
        -------
        errors : Errors
        rows : list of dict
            Per scene: scene; sum_squares and n of positions; endpoints, those of the bodies that
            have one; and nan where there is none, vectors along the last axis: track (T, R, d),
            ends (R, d), steps (T - 2, N, 1) of all bodies seen, accelerations (n, R, d).
        """
        rows = self._rows(law, self.test if scenes is None else scenes)
        return self._errors_of(rows), rows

    def _errors_of(self, rows):
        units = self.dataset.units
        return Errors(
            **{metric: error_of(metric, rows) for metric in METRICS},
            unit=units.text(Unit.of(m=1)), acceleration_unit=units.text(ACCELERATION),
        )  # fmt: skip

    def _rows(self, law, scenes):
        regression = self.test_regression if scenes is self.test else self.regression(scenes)
        accelerations = residual_accelerations(regression, law)
        steps = one_step_errors(scenes, law, self.dataset.up)
        rows = self._score(law, scenes)
        for scene, row, step in zip(scenes, rows, steps, strict=True):
            step = step[:, : len(scene.entities) - self.n_unseen, None]
            row.update(steps=step, accelerations=accelerations[scene.name])
        return rows

    def headline_error(self, law):
        """The one held-out error by which laws are compared: cheap, one number.

        Residual acceleration on exact data, the rollout error on noisy data.
        """
        if self.is_exact:
            return residual_acceleration(self.test_regression, law)
        rows = self._score(law, self.test)
        count = sum(row["n"] for row in rows)
        total = sum(row["sum_squares"] for row in rows)
        return float(np.sqrt(total / count)) if count else float("nan")

    def headline_rollout(self, law):
        """Root mean square rollout error on the training scenes."""
        rows = self._score(law, self.train)
        return float(
            np.sqrt(sum(r["sum_squares"] for r in rows) / max(sum(r["n"] for r in rows), 1))
        )

    def _score(self, law, scenes):
        return [
            self._scene_errors(scene, predicted)
            for scene, predicted in zip(scenes, self.predictions(law, scenes), strict=True)
        ]

    def score_copies(self, law, copies):
        """Rows of `errors` of copies of the held-out scenes, made together: a list of lists.

        The law that made the copies was scored on them for its `floor`.
        """
        _, _, made, rows = self.__dict__.get("_floors", {}).get(id(law), (None,) * 4)
        if rows is not None and made is copies:
            return rows
        scenes = [scene for copy in copies for scene in copy]
        rows = iter(self._rows(law, scenes) if scenes else ())
        return [[next(rows) for _ in copy] for copy in copies]

    def _scene_errors(self, scene, predicted):
        observed = scene.positions[:, scene.dynamic]
        error = np.where(np.isfinite(self.sigma), observed - predicted, 0.0)
        error[: self.n_initial(scene)] = np.nan
        with np.errstate(over="ignore"):  # of a rollout that runs away
            squares = np.square(error).sum(axis=-1)
        row = self.dataset.evaluation.endpoint_row
        index = (row - 1) if row is not None else len(scene.times) - 1
        # Where a track ends before the end-point row there is no end-point to score.
        ends = error[index] if index < len(scene.times) else np.full_like(error[0], np.nan)
        sizes = np.linalg.norm(ends, axis=-1)
        return {
            "scene": scene.name,
            "sum_squares": float(np.nansum(squares)),
            "n": int(np.isfinite(squares).sum()),
            "endpoints": [float(end) for end in sizes if np.isfinite(end)],
            "track": error,
            "ends": ends,
        }

    def regression(self, scenes, states=None):
        """The accelerations of some scenes, read off as the training scenes' are.

        Parameters
        ----------
        scenes : sequence of Scene
        states : dict, optional
            As for `build_regression`.
        """
        return build_regression(
            scenes, method=self.method, sigma=self.regression_sigma, up=self.dataset.up,
            sources=self.sources, states=states, memory=self.memory,
        )  # fmt: skip

    def with_train(self, train):
        """The observation with other positions in the training scenes."""
        return replace(
            self, train=tuple(train), segments=tuple(cut_segments(train, self.segment_rows)),
            train_regression=self.regression(train),
        )  # fmt: skip

    def floor(self, law, rng):
        """Errors that a perfect model would still make.

        The law is rolled out on the held-out scenes, noise is added, and the simulated scenes
        are scored like measured ones, initial states refitted. On exact data the floor is the
        numerical one and is not simulated.

        Returns
        -------
        floor : Errors
        copies : list of tuple of Scene
            The simulated held-out data, for parametric intervals of other quantities.
        """
        if self.is_exact:
            return self._numerical_floor(), ()
        kept = self.__dict__.setdefault("_floors", {})
        if id(law) not in kept:
            kept[id(law)] = (law, *self._simulated_floor(law, rng))
        return kept[id(law)][1:3]

    def _simulated_floor(self, law, rng):
        copies = []
        states = self._states(law, self.test)
        points = sum(scene.positions.size for scene in self.test)
        n_copies = int(np.clip(MOST_POINTS // max(points, 1), FEWEST_FLOOR, N_FLOOR))
        for k, child in enumerate(rng.spawn(n_copies)):
            copy = self._noisy(states, self.test, child)
            copies.append(tuple(replace(scene, name=f"{scene.name} copy {k}") for scene in copy))
        rows, _ = or_fault(self.score_copies, law, copies)
        if rows is None:  # under a law that runs away no copy can be scored, and no floor is known
            nothing = dict.fromkeys(METRICS, math.nan)
            return replace(self._numerical_floor(), **nothing), (), []
        return self._errors_of([row for copy in rows for row in copy]), copies, rows

    def _numerical_floor(self):
        units = self.dataset.units
        position = float(np.sqrt(np.nansum(self.sigma**2)))
        steps = [np.median(np.diff(s.times)) for s in self.test]
        acceleration = (
            float(np.sqrt(np.nansum(self.regression_sigma**2)))
            if self.method == "derivative"
            else position * np.sqrt(6.0) / float(np.median(steps)) ** 2
        )
        return Errors(
            acceleration,
            position,
            position,
            position,
            units.text(Unit.of(m=1)),
            position,
            units.text(ACCELERATION),
        )

    def _noisy(self, states, scenes, rng):
        """Scenes as a law would have made them: its rollouts from fitted states, and noise."""
        out = []
        for scene, predicted in zip(scenes, states, strict=True):
            noise = draw_noise(scene, self.sigma, self.memory, rng)
            measured = scene.positions[:, scene.dynamic]
            keep = np.where(np.isfinite(self.sigma), predicted, measured)
            out.append(scene.on_track(keep + noise))
        return tuple(out)

    def _states(self, law, scenes):
        """Best whole-track predictions of a law (initial states fitted on all rows)."""
        if self.velocity == "measured":
            return self.predictions(law, scenes)
        fit = fit_rollout(
            scenes,
            law,
            self.sigma,
            free=(),
            integrator=self.integrator,
            substeps=self.substeps,
            up=self.dataset.up,
            memory=self.memory,
        )
        found = {}
        for batch, predicted in zip(fit.batches, fit.predicted, strict=True):
            for s, scene in enumerate(batch.scenes):
                found[scene.name] = predicted[: len(scene.times), s]
        return [found[scene.name] for scene in scenes]

    def held_out_gain(self, before, after):
        """Fall of the chi-squared of held-out tracks, their initial states fitted on all rows.

        Laws keep their constants. Much of what a weak effect does to a track is seen here, while
        predictions from the first rows blur it. Exact and measured-velocity data: nan.

        Parameters
        ----------
        before, after : ForceLaw
        """
        return self.held_out_chisqr(before) - self.held_out_chisqr(after)

    def held_out_chisqr(self, law):
        """Chi-squared of held-out tracks, their initial states fitted on all rows.

        Laws keep their constants. Exact and measured-velocity data: nan.
        """
        if self.is_exact or self.velocity == "measured":
            return float("nan")
        return float(self._held_out_fit(law).chisqr)

    def held_out_sight(self, before, after):
        """Signal-to-noise ratio at which held-out tracks would show that one law follows another.

        That of the tracks which the later law has for them against the best of the earlier law,
        both with free initial states. Were it true with these constants, `held_out_gain` would be
        the square of the ratio, give or take twice the ratio. Exact and measured-velocity data:
        nan.

        Parameters
        ----------
        before, after : ForceLaw
        """
        if self.is_exact or self.velocity == "measured":
            return float("nan")
        tracks = self.held_out_tracks(after)
        made = [
            replace(scene.on_track(tracks[scene.name][0]), velocities=None)
            for scene in self.test if scene.name in tracks
        ]  # fmt: skip
        return float(np.sqrt(self._fit_states(made, before).chisqr)) if made else float("nan")

    def held_out_contradict(self, before, after):
        """Whether held-out tracks contradict that one fitted law follows another.

        Parameters
        ----------
        before, after : Fit
            See `contradicts`.
        """
        gain = self.held_out_gain(before.law, after.law)
        if gain > 0:
            return False
        seen = np.sqrt(max(before.chisqr - after.chisqr, 0.0))
        return contradicts(gain, self.held_out_sight(before.law, after.law), seen)

    def held_out_tracks(self, law):
        """Held-out tracks under a law, initial states fitted on all rows, see `tracks_of`.

        Parameters
        ----------
        law : ForceLaw
            It keeps its constants.
        """
        return tracks_of(self._held_out_fit(law), self.test)

    def _held_out_fit(self, law):
        """Held-out tracks under a law that keeps its constants (kept)."""
        kept = self.__dict__.setdefault("_held_out", {})
        if id(law) not in kept:
            kept[id(law)] = (law, self._fit_states(self.test, law))
        return kept[id(law)][1]

    def _fit_states(self, scenes, law):
        return fit_rollout(
            cut_segments(scenes, self.segment_rows), law, self.sigma, free=(),
            integrator=self.integrator, substeps=self.substeps, up=self.dataset.up,
            memory=self.memory,
        )  # fmt: skip


def _correlation(tops, bottoms):
    """Of neighbouring rows, from sums of products; 0 where a failed fit leaves none."""
    if not (np.isfinite([tops, bottoms]).all() and bottoms > 0):
        return 0.0
    return min(max(tops / bottoms, 0.0), 0.999)
