"""Errors on held-out data before and after, the floor below which noise keeps them, and intervals.

Copies of the held-out scenes, made by the last law with the noise that was estimated, are scored
as the measured ones are, initial states refitted: that is the floor. Five or more held-out scenes
are resampled whole, quantiles taken further out as few scenes need it (expanded percentiles:
T. Hesterberg, The American Statistician 69 (2015) 371); with fewer, the spread is that of the
copies, what the measured errors have beyond noise carried over.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from bsp_gp.fitting.held_out import errors_of, held_out_rows, scatter_of
from bsp_gp.fitting.simulated import simulated
from bsp_gp.physics.metrics import ERRORS, METRICS
from bsp_gp.workers import Crew

FEWEST_SCENES = 5
"""That are resampled."""
N_RESAMPLES = 999
TAIL = 0.05
RARE = 0.01
"""Part of the copies whose errors are larger than what noise is said to make at the most."""
NO_FLOOR = 3.0
"""Times the least error, which one track in hundreds is below its floor by chance."""
FLOOR_SCENES = 20
"""Copied scenes behind a floor, at least."""
MOST_POINTS, FEWEST_COPIES = 200_000, 3
"""Coordinates that are copied at the most, and copies at the least."""


@dataclass(frozen=True)
class Ratio:
    """After divided by before, with its 90 % interval.

    Attributes
    ----------
    method : str
        "resampled", "parametric" or "none".
    """

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    method: str = "none"


class Accounts:
    """Errors of some fits on scenes that none of them has seen.

    Parameters
    ----------
    fits : sequence of Fit
        The last one makes the copies.
    scenes : sequence of Scene
        Held out.
    n_copies : int
        Simulated copies of the scenes behind intervals; 0 = neither floor nor intervals from them.
    crew : Crew, optional
        By whom scenes are scored.
    kept : dict, optional
        Rows of fits on these scenes, by the identity of the fit and with it; what is missing is
        put in.

    Attributes
    ----------
    rows : list of list of dict
        Of every fit, scene by scene, see `held_out_rows`.
    scatter : tuple of float or None
        Of the scenes, see `scatter_of`; None without any.
    """

    def __init__(self, fits, dataset, scenes, rng, n_copies=40, crew=None, kept=None):
        self._crew = crew or Crew()
        self.fits, self.dataset, self.scenes = fits, dataset, tuple(scenes)
        self.scatter = scatter_of(dataset, self.scenes) if self.scenes else None
        self._copies_rng, picks_rng, self._mixed_rng = rng.spawn(3)
        self.rows = self._rows(fits, {} if kept is None else kept)
        n = len(self.scenes)
        self.is_parametric = n < FEWEST_SCENES
        self._picks = () if self.is_parametric else picks_rng.integers(n, size=(N_RESAMPLES, n))
        self._n_copies = self._count(n_copies)
        self._kept = {}

    def _rows(self, fits, kept):
        new = list({id(fit): fit for fit in fits if id(fit) not in kept}.values())
        made = self._crew.map(_rows_of, (self.dataset, self.scenes, self.scatter), new)
        kept.update({id(fit): (fit, rows) for fit, rows in zip(new, made, strict=True)})
        return [kept[id(fit)][1] for fit in fits]

    def _count(self, wanted):
        """Copies that are made."""
        n, points = len(self.scenes), sum(scene.positions.size for scene in self.scenes)
        if not wanted or not n:
            return 0
        if not self.is_parametric:
            wanted = min(wanted, -(-FLOOR_SCENES // n))
        return int(np.clip(MOST_POINTS // points, min(FEWEST_COPIES, wanted), wanted))

    @cached_property
    def copies(self):
        """Simulated held-out scenes, list of list of Scene."""
        fit = self.fits[-1]
        if not self.rows[-1]:
            return []
        return simulated(fit, self.dataset, self.scenes, self._n_copies, self._copies_rng)

    @cached_property
    def _copied_rows(self):
        """Rows of every fit on every copy; all copies are scored together."""
        scenes = [scene for copy in self.copies for scene in copy]
        first = 0 if self.is_parametric else len(self.fits) - 1
        made = self._crew.map(_rows_of, (self.dataset, scenes, self.scatter), self.fits[first:])
        made = [[] for _ in range(first)] + made
        n = max(len(self.scenes), 1)
        return [[rows[k : k + n] for k in range(0, len(rows), n)] for rows in made]

    # --- what is asked ---------------------------------------------------------------------------

    def errors(self, k):
        """Errors of a fit with 90 % intervals, an `Errors`."""
        told = errors_of(self.rows[k], self.dataset.units)
        if not self.rows[k]:
            return told
        return replace(told, intervals={m: self._interval_of(k, m) for m in METRICS})

    @cached_property
    def floor(self):
        """The same metrics under the last law with its noise, an `Errors`."""
        copies = self._copied_rows[-1]
        return errors_of([row for copy in copies for row in copy], self.dataset.units)

    @cached_property
    def told_floor(self):
        """The same as it is told: nothing, of noise that was taken for all of a motion.

        What is left of a motion that nothing explains may be more on average than at the end of a
        track, which is foreseen better than noise of that size would let it be.
        """
        ends = [errors_of(self.rows[k], self.dataset.units).rollout_rmse for k in (0, -1)]
        floor, least = self.floor, np.fmin(*ends)
        if not floor.rollout_rmse > NO_FLOOR * least:
            return floor
        return replace(floor, **dict.fromkeys(METRICS, math.nan))

    @cached_property
    def noisiest(self):
        """Position error of the last law's predictions that noise exceeds in a hundredth, metres.

        Of copies of every scene any is as likely as another, whatever the others are.
        """
        field, told_by, error = ERRORS["rollout_rmse"]
        told = [[told_by(row[field]) for row in copy] for copy in self._copied_rows[-1]]
        if not told:
            return math.nan
        picks = self._mixed_rng.integers(len(told), size=(N_RESAMPLES, len(self.scenes)))
        with np.errstate(all="ignore"):
            draws = [error([told[c][s] for s, c in enumerate(pick)]) for pick in picks]
        return float(np.nanquantile(draws, 1 - RARE))

    def ratio(self, before, after, metric="rollout_rmse"):
        """Error of one fit divided by that of another, a `Ratio`."""
        if not self.rows[before] or not self.rows[after]:
            return Ratio()
        (bottom, bottoms), (top, tops) = (self._of(k, metric) for k in (before, after))
        if not bottom > 0:
            return Ratio()
        with np.errstate(all="ignore"):
            typical = _typical(tops) / _typical(bottoms)
            low, high = self._interval(tops / bottoms, top / bottom, typical)
        method = "parametric" if self.is_parametric else "resampled"
        return Ratio(top / bottom, low, high, method if math.isfinite(low) else "none")

    def by_scene(self, before, after):
        """Position errors of every held-out scene, list of dict."""
        told = []
        for b, a in zip(self.rows[before], self.rows[after], strict=False):
            told.append({
                "scene": b["scene"], "before": errors_of([b], self.dataset.units).rollout_rmse,
                "after": errors_of([a], self.dataset.units).rollout_rmse,
            })  # fmt: skip
        return told

    # --- intervals -------------------------------------------------------------------------------

    def _interval_of(self, k, metric):
        point, draws = self._of(k, metric)
        return self._interval(draws, point, _typical(draws))

    def _of(self, k, metric):
        """An error and its draws."""
        if (k, metric) not in self._kept:
            field, told_by, error = ERRORS[metric]
            with np.errstate(all="ignore"):
                fields = [row[field] for row in self.rows[k]]
                scenes = [told_by(f) for f in fields]
                if self.is_parametric:
                    copies = [[row[field] for row in copy] for copy in self._copied_rows[k]]
                    draws = [error([told_by(f) for f in c]) for c in _carried(fields, copies)]
                else:
                    draws = [error([scenes[j] for j in pick]) for pick in self._picks]
            self._kept[k, metric] = error(scenes), np.array(draws, dtype=float)
        return self._kept[k, metric]

    def _interval(self, draws, point, typical):
        draws = draws[np.isfinite(draws)]
        if not len(draws) or not math.isfinite(point):
            return math.nan, math.nan
        if self.is_parametric:
            # Errors are skew: the pivot is how many times the typical one an error is.
            high, low = np.quantile(draws, (TAIL, 1 - TAIL))
            if not low > 0 or not high > 0:  # nothing is left to be in error
                return point, point
            low, high = point * typical / low, point * typical / high
        else:
            n = len(self.scenes)
            tail = special.ndtr(special.stdtrit(n - 1, TAIL) * math.sqrt(n / (n - 1)))
            low, high = np.quantile(draws, (tail, 1 - tail))
        return float(min(low, point)), float(max(high, point))


def _rows_of(shared, fit):
    dataset, scenes, scatter = shared
    return held_out_rows(fit, dataset, scenes, scatter=scatter)


def _typical(draws):
    """Root mean square of the finite ones."""
    draws = draws[np.isfinite(draws)]
    return float(np.sqrt(np.mean(np.square(draws)))) if len(draws) else math.nan


def _carried(fields, copies):
    """Simulated errors and what the measured ones have beyond them on the mean: misfit.

    As much of it as is not to be expected from noise.
    """
    if not copies:
        return []
    means = [np.mean(group, axis=0) for group in zip(*copies, strict=True)]
    beyond = [f - mean for f, mean in zip(fields, means, strict=True)]
    spread = sum(
        _total([c - mean for c, mean in zip(copy, means, strict=True)]) for copy in copies
    )
    total = _total(beyond)
    part = math.sqrt(max(1 - spread / max(len(copies) - 1, 1) / total, 0.0)) if total > 0 else 0.0
    return [[c + part * m for c, m in zip(copy, beyond, strict=True)] for copy in copies]


def _total(fields):
    return sum(float(np.nansum(np.square(f))) for f in fields)
