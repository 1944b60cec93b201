"""Errors on held-out data before and after an effect is added, with 90 % intervals.

Five or more held-out scenes are resampled whole; the quantiles asked for lie further out than 5
and 95 %, as few scenes need it (expanded percentiles: T. Hesterberg, The American Statistician 69
(2015) 371). With fewer, held-out data are simulated; what the measured errors have beyond noise,
misfit, is carried over.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import special

from bsp_gp.loop.outcome import Ratio
from bsp_gp.physics.metrics import ERRORS, METRICS

__all__ = ["BeforeAfter", "compared"]

FEWEST_SCENES = 5
"""That are resampled."""
N_RESAMPLES = 999
TAIL = 0.05


class BeforeAfter(NamedTuple):
    """What held-out data say of a law and of the one that follows it.

    Attributes
    ----------
    before, after : Errors
        With `intervals`.
    ratios : dict of str to Ratio
        After / before of every error; without an interval where there is neither noise nor enough
        scenes.
    """

    before: object
    after: object
    ratios: dict

    @property
    def ratio(self):
        """That of the rollout error, by which the loop decides."""
        return self.ratios["rollout_rmse"]


def compared(observation, before, after, copies, rng):
    """Every error before and after, and their ratios, with intervals.

    Parameters
    ----------
    observation : Observation
    before, after : Model
    copies : sequence of tuple of Scene
        Held-out data as the later law would have made them, of `Observation.floor`; none for
        exact data.
    rng : numpy.random.Generator

    Returns
    -------
    BeforeAfter
    """
    draws = _Draws(before.rows, after.rows, rng)
    if draws.is_parametric:
        draws.simulated = [observation.score_copies(m.law, copies) for m in (before, after)]
    errors = [
        replace(model.errors, intervals={m: draws.interval(k, m) for m in METRICS})
        for k, model in enumerate((before, after))
    ]
    return BeforeAfter(*errors, {m: draws.ratio(m) for m in METRICS})


class _Draws:
    """Errors of resampled or simulated held-out data, before (0) and after (1).

    Attributes
    ----------
    simulated : list of list of list of dict
        Before and after: rows of every copy.
    """

    def __init__(self, before, after, rng):
        n = len(before)
        self.rows = (before, after)
        self.is_parametric = n < FEWEST_SCENES
        self.simulated = ((), ())
        self.picks = () if self.is_parametric else rng.integers(n, size=(N_RESAMPLES, n))
        self.method = (
            "parametric: fewer than five held-out scenes" if self.is_parametric
            else f"resampling {n} held-out scenes"
        )  # fmt: skip
        self.kept = {}

    def ratio(self, metric):
        """After / before, a `Ratio`."""
        (before, bottoms), (after, tops) = (self._of(k, metric) for k in (0, 1))
        point = after / before if before > 0 else float("nan")
        with np.errstate(divide="ignore", invalid="ignore"):
            draws = tops / bottoms
            typical = _typical(tops) / _typical(bottoms)
        return Ratio(point, *self._interval(draws, point, typical), self.method)

    def interval(self, k, metric):
        """Interval of an error, (low, high)."""
        point, draws = self._of(k, metric)
        return self._interval(draws, point, _typical(draws))

    def _interval(self, draws, point, typical):
        draws = draws[np.isfinite(draws)]
        if not len(draws) or not np.isfinite(point):
            return float("nan"), float("nan")
        if self.is_parametric:
            # Errors are skew: the pivot is how many times the typical one an error is.
            high, low = np.quantile(draws, (TAIL, 1 - TAIL))
            if not low > 0 or not high > 0:  # nothing is left to be in error
                return point, point
            low, high = point * typical / low, point * typical / high
        else:
            n = len(self.rows[0])
            tail = special.ndtr(special.stdtrit(n - 1, TAIL) * np.sqrt(n / (n - 1)))
            low, high = np.quantile(draws, (tail, 1 - tail))
        return float(min(low, point)), float(max(high, point))

    def _of(self, k, metric):
        """An error and its draws."""
        if (k, metric) not in self.kept:
            rows, (field, told_by, error) = self.rows[k], ERRORS[metric]
            fields = [row[field] for row in rows]
            scenes = [told_by(f) for f in fields]
            if self.is_parametric:
                copies = [[row[field] for row in copy] for copy in self.simulated[k]]
                draws = [error([told_by(f) for f in copy]) for copy in _carried(fields, copies)]
            else:
                draws = [error([scenes[j] for j in pick]) for pick in self.picks]
            self.kept[k, metric] = error(scenes), np.array(draws, dtype=float)
        return self.kept[k, metric]


def _typical(draws):
    """Root mean square of the finite ones."""
    draws = draws[np.isfinite(draws)]
    return float(np.sqrt(np.mean(np.square(draws)))) if len(draws) else float("nan")


def _carried(fields, copies):
    """Simulated errors and what the measured ones have beyond them on the mean: misfit.

    As much of it as is not to be expected from noise.

    Parameters
    ----------
    fields : list of ndarray
        Measured, per scene.
    copies : list of list of ndarray
        Simulated.
    """
    if not copies:
        return []
    with np.errstate(invalid="ignore"):
        means = [np.mean(group, axis=0) for group in zip(*copies, strict=True)]
        beyond = [f - mean for f, mean in zip(fields, means, strict=True)]
        spread = [_total([c - mean for c, mean in zip(copy, means, strict=True)])
                  for copy in copies]  # fmt: skip
        noise = np.sum(spread) / max(len(copies) - 1, 1)
        total = _total(beyond)
        part = np.sqrt(max(1 - noise / total, 0.0)) if total > 0 else 0.0
        return [[c + part * m for c, m in zip(copy, beyond, strict=True)] for copy in copies]


def _total(fields):
    return sum(float(np.nansum(np.square(f))) for f in fields)
