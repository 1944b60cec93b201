"""The weak form: the equation of motion integrated against compact test functions.

Multiplied by test functions and integrated by parts, the equation of motion asks for no
derivative of noise (Messenger and Bortz 2021, Multiscale Model. Simul. 19, 1474). White noise of
positions gives the residuals of overlapping test functions a covariance that is known exactly;
they are whitened by its Cholesky factor. With the narrowest test functions this is the
generalised least squares of ``gls`` with a better quadrature; wider ones leave out what is noise
alone.

The width is chosen from the tracks, never from a law: see `weak_width`.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import DataError
from bsp_gp.physics.differences import DENSE_LIMIT
from bsp_gp.physics.engine.chains import spread
from bsp_gp.physics.weak_states import states_of
from bsp_gp.physics.weak_tracks import Track, reach_of, runs_of
from bsp_gp.physics.weak_width import Widths, choose_spacing

BRIDGED = 1.8
"""Steps longer than this many usual ones part a track, where test functions are narrow."""
LEAST_ROWS = 5
FLOOR = 1e-12
"""Quoted errors are at least this part of the range of the positions."""


@dataclass(frozen=True, eq=False)
class WeakPart:
    """The weak form of one batch: see `RegressionBatch` for shapes."""

    rows: slice
    positions: np.ndarray
    velocities: np.ndarray
    target: np.ndarray
    valid: np.ndarray
    kept: np.ndarray
    observed: np.ndarray
    whitener: np.ndarray


class WeakForm:
    """The weak form of some batches, their width in common.

    Parameters
    ----------
    sigma : ndarray, shape (d,)
        Standard deviation of positions, m (of velocities, m/s, where they are measured), in rows
        for which the scene quotes none; nan: the axis is left out.
    level : ndarray, shape (d,), optional
        Noise with which the width is chosen, by default `sigma`.
    width : float, optional
        Reach of the test functions, s; chosen if None.
    sources : bool
        Whether laws may name other bodies.
    is_stepped : bool
        Motion made by steps of the paper's kind: forces act at rows, with backward velocities.
    is_measured : bool
        Whether velocities are measured, with noise of their own.
    is_unsure : callable, optional
        ``is_unsure(bodies, positions) -> (T, S, R)``: rows at which no force is to be asked for.
    """

    def __init__(
        self,
        batches,
        sigma,
        *,
        level=None,
        width=None,
        sources=True,
        is_stepped=False,
        is_measured=False,
        is_unsure=None,
    ):
        self.batches = batches
        self.sigma = np.asarray(sigma, dtype=float)
        self.level = self.sigma if level is None else np.asarray(level, dtype=float)
        self.sources = sources
        self.is_stepped = is_stepped
        self.is_measured = is_measured
        self.is_unsure = is_unsure
        self._tracks = {}
        self._check()
        steps = np.concatenate([np.diff(b.times, axis=0).ravel() for b in batches])
        self.step = float(np.nanmedian(steps))
        tried = ()
        if width is None:
            self.spacing, tried = choose_spacing(self._series(), self.step, is_measured)
        else:
            self.spacing = 0.0 if width <= 2 * self.step else width / reach_of(is_measured)
        self.parts = [self._part(batch) for batch in batches]
        longest = max(float(spread(b.times).max()) for b in batches)
        reach = min(reach_of(is_measured) * self.spacing or 2 * self.step, longest)
        n_functions = int(sum(part.kept.sum() for part in self.parts))
        self.widths = Widths(reach, reach / self.step, self.spacing, n_functions, tried)

    def _check(self):
        rows = max(len(batch.times) for batch in self.batches)
        if rows > DENSE_LIMIT:
            raise DataError(
                f"tracks of {rows} rows are too long for the exact covariance",
                remedy=f"split them into scenes of at most {DENSE_LIMIT} rows",
            )
        if self.is_measured and any(batch.velocities is None for batch in self.batches):
            raise DataError(
                "the weak form was asked to use measured velocities and there are none",
                remedy='give columns vx, vy and [columns] velocity = "measured"',
            )
        runs = [
            run
            for batch in self.batches
            for s in range(batch.times.shape[1])
            for runs in self._runs_of_scene(batch, s, 0.0)
            for run in runs
        ]
        if max((len(run.nodes) for run in runs), default=0) < LEAST_ROWS:
            raise DataError(
                f"no track has {LEAST_ROWS} rows in succession, which a test function needs",
                remedy="record longer tracks, mend their gaps, or use the likelihood one_step",
            )

    def _series(self):
        """Tracks to choose a width for: times, runs, sigma (T,), values (T, k)."""
        found = {}
        for batch in self.batches:
            values = batch.velocities if self.is_measured else batch.positions
            for s in range(batch.times.shape[1]):
                times = batch.times[:, s]
                all_runs = self._runs_of_scene(batch, s, 0.0)
                for runs, index in zip(all_runs, batch.bodies.receivers, strict=True):
                    sigma = self._noise(batch, s, index, self.level)
                    for axis in np.flatnonzero(np.isfinite(sigma).all(axis=0)):
                        key = _key(times, runs, sigma[:, axis])
                        found.setdefault(key, (times, runs, sigma[:, axis], []))
                        found[key][3].append(_centred(values[:, s, index, axis]))
        return [(t, r, n, np.stack(v, axis=1)) for t, r, n, v in found.values()]

    # --- tracks ----------------------------------------------------------------------------------

    def _runs_of_scene(self, batch, s, spacing, usable=None):
        """Runs of every receiver of a scene; rows without the bodies that a law needs are gaps."""
        times = batch.times[:, s]
        seen = np.isfinite(batch.positions[:, s]).all(axis=-1) & np.isfinite(times)[:, None]
        if self.is_measured:
            seen &= np.isfinite(batch.velocities[:, s]).all(axis=-1)
        everything = seen.all(axis=1)
        limit = self._limit(times, spacing)
        # Between steps there is nothing to bridge: the row before is needed.
        clock = np.arange(len(times), dtype=float) if self.is_stepped else times
        out = []
        for r, index in enumerate(batch.bodies.receivers):
            mine = seen[:, index]
            nodes = mine if self.is_stepped or not self.sources else everything
            live = (everything if self.sources else mine) if usable is None else usable[:, r]
            out.append(runs_of(clock, nodes, nodes & live, limit, self.is_measured))
        return out

    def _limit(self, times, spacing):
        """Longest step that is bridged: what test functions do not resolve."""
        if self.is_stepped:
            return 1.5
        steps = np.diff(times)
        usual = np.quantile(steps[np.isfinite(steps)], 0.9)
        return max(BRIDGED * float(usual), spacing)

    def _noise(self, batch, s, index, level):
        """Standard deviations of one track, shape (T, d); nan: the axis is left out."""
        sigma = np.tile(level, (len(batch.times), 1))
        scene = batch.scenes[s]
        if scene.sigma is None or self.is_measured:
            return sigma
        quoted = scene.sigma[:, index]
        floor = FLOOR * spread(batch.positions[:, s, index])
        rows = slice(0, len(quoted))
        known = np.isfinite(quoted) & np.isfinite(level)
        sigma[rows] = np.where(known, np.maximum(quoted, floor), sigma[rows])
        return sigma

    def _track(self, times, runs, spacing, sigma):
        """Whitened test functions, kept: many tracks have the same times."""
        key = (*_key(times, runs, sigma), spacing)
        if key not in self._tracks:
            self._tracks[key] = Track.of(
                times,
                runs,
                spacing,
                sigma,
                is_measured=self.is_measured,
                is_stepped=self.is_stepped,
            )
        return self._tracks[key]

    # --- a batch ---------------------------------------------------------------------------------

    def _part(self, batch):
        positions, velocities = self._states(batch)
        usable = self._usable(batch, positions, velocities)
        values = batch.velocities if self.is_measured else batch.positions
        n, n_scenes, _, d = values.shape
        shape = (n, n_scenes, len(batch.bodies.receivers), d)
        target, observed = np.zeros(shape), np.zeros(shape)
        valid, kept = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        tracks = np.empty(shape[1:], dtype=object)
        for s in range(n_scenes):
            times = batch.times[:, s]
            all_runs = self._runs_of_scene(batch, s, self.spacing, usable[:, s])
            for r, (runs, index) in enumerate(zip(all_runs, batch.bodies.receivers, strict=True)):
                sigma = self._noise(batch, s, index, self.sigma)
                own = values[:, s, index]
                for run in runs:
                    target[run.nodes[run.inner], s, r] = self._raw(times, own, run)
                for axis in range(d):
                    is_in = bool(np.isfinite(sigma[:, axis]).all())
                    noise = sigma[:, axis] if is_in else np.ones(n)
                    track = self._track(times, runs, self.spacing, noise)
                    tracks[s, r, axis] = track
                    k = len(track.observe)
                    observed[:k, s, r, axis] = track.observe @ _centred(own[:, axis])
                    kept[:k, s, r, axis] = is_in
                    valid[:, s, r, axis] = track.inner & is_in
        # Positions at both ends serve differences alone; a law is asked for between them.
        rows = slice(None) if self.is_measured else slice(1, n - 1)
        whitener = _stacked(tracks, rows)
        return WeakPart(
            rows,
            positions[rows],
            velocities[rows],
            np.where(valid, target, 0.0)[rows],
            valid[rows],
            kept[: len(valid[rows])],
            np.where(kept, observed, 0.0)[: len(valid[rows])],
            whitener,
        )

    def _raw(self, times, own, run):
        """Accelerations of a track at the rows of a run, for the eye."""
        t, x = times[run.nodes], own[run.nodes]
        if self.is_measured:
            return np.gradient(x, t, axis=0)
        slopes = np.diff(x, axis=0) / np.diff(t)[:, None]
        return np.diff(slopes, axis=0) / ((t[2:] - t[:-2]) / 2)[:, None]

    def _states(self, batch):
        """States at which laws are evaluated, (T, S, N, d) each."""
        if self.is_measured:
            return batch.positions, batch.velocities
        positions = np.array(batch.positions)
        velocities = np.full(positions.shape, np.nan)
        for s in range(batch.times.shape[1]):
            times = batch.times[:, s]
            bodies = range(positions.shape[2])
            noise = np.stack([self._noise(batch, s, k, self.level) for k in bodies], axis=1)
            positions[:, s], velocities[:, s] = states_of(
                times,
                batch.positions[:, s],
                noise,
                spacing=self.spacing,
                limit=self._limit(times, self.spacing),
                is_stepped=self.is_stepped,
            )
        p, still = batch.positions, batch.is_still[:, None]
        return np.where(still, p, positions), np.where(still & np.isfinite(p), 0.0, velocities)

    def _usable(self, batch, positions, velocities):
        """Rows at which a law can be evaluated, (T, S, R)."""
        seen = (np.isfinite(positions) & np.isfinite(velocities)).all(axis=-1)
        usable = seen[:, :, batch.bodies.receivers]
        if self.sources:
            usable = usable & seen.all(axis=-1)[..., None]
        if self.is_unsure is not None:
            usable = usable & ~self.is_unsure(batch.bodies, positions)
        return usable


def _stacked(tracks, rows):
    """What turns accelerations at instants into whitened integrals, in the least axes."""
    first = tracks.flat[0]
    if all(track is first for track in tracks.flat):
        return first.predict[:, rows]
    most = max(len(track.predict) for track in tracks.flat)
    shared = all(track is own[0] for own in tracks.reshape(-1, tracks.shape[-1]) for track in own)
    wanted = tracks[..., 0] if shared else tracks
    n = first.predict[:, rows].shape[1]
    out = np.zeros((*wanted.shape, most, n))
    for place in np.ndindex(wanted.shape):
        predict = wanted[place].predict[:, rows]
        out[place][: len(predict)] = predict
    return out


def _centred(values):
    """Values less their mean, 0 where not seen: far from 0 digits would be lost."""
    seen = np.isfinite(values)
    return np.where(seen, values - (values[seen].mean() if seen.any() else 0.0), 0.0)


def _key(times, runs, sigma):
    """What tells tracks with test functions of their own apart."""
    nodes = tuple(run.nodes.tobytes() for run in runs)
    return np.nan_to_num(times).tobytes(), nodes, sigma.tobytes()
