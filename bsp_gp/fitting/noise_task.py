"""The free numbers of a noise law at the maximum of its restricted likelihood.

Sizes (levels, factors of scenes and bodies) follow from a fixed point: every group's whitened
squares are as large as its degrees of freedom. What has a shape (memory, growth with speed) is
searched for by L-BFGS-B; weights of rows under Student's t come in turn with both.
"""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from bsp_gp.errors import FitError
from bsp_gp.fitting.ascent import maximise
from bsp_gp.fitting.restricted import Restricted
from bsp_gp.fitting.student import fit_degrees, scaled_without_tails
from bsp_gp.fitting.whitening import log_likelihood
from bsp_gp.physics.engine.chains import spread

_SCALE = (math.log(1e-6), math.log(1e6))
_SHARE = (-6.0, 14.0)
"""Logit of the correlated part of the variance: 0.0025 to all but a millionth."""
_GROWTH = 7.0
_LEAST = 1e-3
"""Degrees of freedom left on an axis, below which its level stays at the first guess."""
_MIN_REMAINING = 0.05
_N_MEAN = 8
_N_PASSES = 60
_N_ROUNDS = 8
_N_TAILS = 12
_PRECISE_TAILS = 1e-4
_SMALL_GAIN = 1e-3
_FEW_FREE = 0.1
"""Part of the rows that free numbers may take where the projected residual alone is a likeness."""
_FEWER_FREE = 2e-3
"""The same where its maximum lies at that of the restricted likelihood, far within its errors."""
_SAMPLE = 100
"""Chains that tell well where a search over all of four times as many may begin."""
LEVEL = 1e-3
"""Chance of a further part in noise that lacks it, for each part: five are asked for in every fit,
and a wrong memory hides effects."""
MAX_TIME = 0.2
"""Longest correlation time, as a part of the longest track: what lasts longer is a different offset
in every scene, and belongs to the motion."""
MIN_TIME = 0.3
"""Shortest correlation time, in median intervals between rows; a shorter one is white."""
MIN_ROWS = 4.0
"""Degrees of freedom left that a body or scene must have for a factor of its own."""
PRECISION = 1e-6
"""Largest change of the logarithm of a level in the last pass."""


class NoiseTask:
    """One residual, and the noise laws that are tried on it.

    Attributes
    ----------
    start : NoiseModel
        With free levels guessed from the residual.
    free : ndarray of bool, shape (C,)
        Channels whose level is estimated.
    n_left : int
        Rows less the rank of the columns.
    weights : ndarray, shape (T, C), or None
        That tails give the rows; those of the last model with tails.
    """

    def __init__(self, model, channels, residual, columns, local):
        self.channels = channels
        self._known = model, residual, columns, local
        self.free = model.is_free[channels.axis]
        size = model.sizes(channels)
        known = np.isfinite(size)
        if self.free.any():
            model = _guessed(model, channels, residual)
            size = model.sizes(channels)
        self.start = model
        seen = known & channels.seen & np.isfinite(channels.times)
        self.restricted = Restricted(residual, seen, channels.chain, size, columns, local)
        self.n_left = self.restricted.n_rows - self.restricted.n_free
        if self.n_left < 1 and self.free.any():
            raise FitError(
                f"the noise cannot be estimated: {self.restricted.n_rows} measured values, "
                f"{self.restricted.n_free} free numbers; declare noise"
            )
        self.weights = None

    @property
    def can_estimate(self):
        """Whether anything is free, and rows are left to tell it."""
        return self.n_left > 0 and bool(self.free.any() or not self.start.is_correlation_known)

    @property
    def groups(self):
        """Parts that are factors of groups: name, index of every channel, names of the groups."""
        c = self.channels
        return (("scenes", c.scene, c.scene_names), ("bodies", c.body, c.body_names))

    def value(self, model):
        """Restricted log-likelihood of a model, rows weighted as they are."""
        return self.restricted.value(model.whitener(self.channels, self.weights))

    def _plain(self, model):
        """Log-likelihood of the projected residual alone: cheaper, and nearly as curved."""
        if model.adding:
            whitener = model.whitener(self.channels, self.weights)
            square = float(np.square(whitener.whiten(self.restricted.residual)).sum())
            return -0.5 * (square + whitener.log_det)
        white, amplitude = model.parts(self.channels)
        if self.weights is not None:
            white = white / self.weights
        seen = self.channels.seen & np.isfinite(white)
        return log_likelihood(
            self.restricted.residual, seen, self.channels.gaps, white, amplitude,
            model.correlation_time,
        )  # fmt: skip

    @property
    def sample(self):
        """The same task on some chains, evenly spread; None where there are not many."""
        if self._sampled is None:
            return None
        task, kept = self._sampled
        task.weights = None if self.weights is None else self.weights[:, kept]
        return task

    @cached_property
    def _sampled(self):
        chains = np.unique(self.channels.chain)
        if len(chains) < 4 * _SAMPLE:
            return None
        kept = chains[np.linspace(0, len(chains) - 1, _SAMPLE).astype(int)]
        kept = np.isin(self.channels.chain, kept)
        model, residual, columns, local = self._known
        parts = (None if x is None else x[..., kept] for x in (residual, columns, local))
        return NoiseTask(model, self.channels.only(kept), *parts), kept

    @property
    def has_many_rows(self):
        """Whether free numbers are so few that they need not be asked at every step of a search."""
        return self.restricted.n_free < _FEWER_FREE * self.restricted.n_rows

    def refit(self, model):
        """A model with its free numbers at the maximum."""
        if math.isfinite(model.degrees):
            return self._refit_tails(model)
        return self.refit_normal(model)[0]

    def refit_normal(self, model):
        """The same with the weights of rows as they are, and its restricted log-likelihood."""
        shape = self._shape(model)
        model, value = self.rescale(model)
        for _ in range(_N_ROUNDS if shape else 0):
            model, before = self._optimise(model, shape)
            model, value = self.rescale(model)
            if value - before < _SMALL_GAIN:
                break
        return model, value

    def _refit_tails(self, model):
        """Weights of rows, the other numbers and degrees of freedom in turn."""
        for _ in range(_N_TAILS):
            before = np.log(np.array(model.levels)[model.is_free])
            whitener = model.whitener(self.channels, self.weights)
            error = self.restricted.pure_error(whitener)
            innovations = error.whitened * whitener.spread
            scaled, _ = scaled_without_tails(
                model, self.channels, whitener, self.weights, innovations
            )
            self.weights = model.tail_weights(scaled, self.channels)
            model = self.refit_normal(model)[0]
            degrees = fit_degrees(scaled[self.informative(model, error)], model.degrees)
            model = replace(model, degrees=degrees)
            after = np.log(np.array(model.levels)[model.is_free])
            if np.abs(after - before).max() < _PRECISE_TAILS:
                break
        return model

    def informative(self, model, error):
        """Rows that tell of tails: of a free level that is no floor, and not taken by a column."""
        above = np.array(model.levels) > 1.001 * model.lowest
        return (error.remaining > _MIN_REMAINING) & (self.free & above[self.channels.axis])

    def time_bounds(self):
        """Shortest and longest correlation time that these tracks can tell."""
        times = np.where(self.channels.seen, self.channels.times, np.nan)
        steps = np.diff(times, axis=0)
        steps = steps[np.isfinite(steps)]
        if not steps.size:  # bodies that are seen by turns: from one sight to the next
            steps = np.concatenate([np.diff(column[np.isfinite(column)]) for column in times.T])
        low = MIN_TIME * float(np.median(steps))
        return low, max(MAX_TIME * float(spread(times).max()), 2.0 * low)

    def averaged(self, model):
        """The model with the mean of the correlation time's logarithm in place of its maximum.

        Short tracks hardly tell a long memory from a longer one: the likelihood is a plateau, and
        its maximum lies at either end of it as chance will have it. The time has a log-uniform
        prior within its bounds; share and sizes are those at the maximum beside each time.
        """
        if not model.correlated or model.is_correlation_known or math.isfinite(model.degrees):
            return model
        low, high = np.log(self.time_bounds())
        best = math.log(model.correlation_time)
        times = np.union1d(np.linspace(low, high, _N_MEAN), best)
        values = [
            self.rescale(replace(model, correlation_time=math.exp(t)), is_rough=True)[1]
            for t in times
        ]
        weights = np.exp(np.array(values) - max(values)) * np.gradient(times)
        time = float(weights @ times / weights.sum())
        return self.rescale(replace(model, correlation_time=math.exp(time)))[0]

    def _shape(self, model):
        """Names of free numbers that are no mere factors of size, with their bounds."""
        found = {}
        if model.correlated and not model.is_correlation_known:
            low, high = self.time_bounds()
            found["correlated"] = _SHARE
            found["correlation_time"] = (math.log(low), math.log(high))
        if model.speed_growth:
            middle = math.log(model.speed_growth)
            found["speed_growth"] = (middle - _GROWTH, middle + _GROWTH)
        return found

    def _optimise(self, model, shape):
        """Numbers of the shape, and all free levels by one common factor, at the maximum."""
        names = ["levels", *shape] if self.free.any() else list(shape)
        bounds = [_SCALE, *shape.values()] if self.free.any() else list(shape.values())
        likeness = None
        if self.restricted.n_free < _FEW_FREE * self.restricted.n_rows:

            def likeness(values):
                return self._plain(_decoded(model, names, values))

        if self.has_many_rows:
            start = [_coded(model, name) for name in names]
            found = _decoded(model, names, maximise(likeness, start, bounds)[0])
            return found, self.value(found)
        if self.sample is not None:
            model = self.sample._optimise(model, shape)[0]
        start = [_coded(model, name) for name in names]
        values, reached = maximise(
            lambda values: self.value(_decoded(model, names, values)), start, bounds, likeness
        )
        return _decoded(model, names, values), reached

    def likeliest(self, starts):
        """Of models with their sizes at the maximum, roughly, the best; and what it reaches."""
        if len(starts) > 1 and self.sample is not None:
            starts = [self.sample.likeliest(starts)[0]]
        found = (self.rescale(start, is_rough=True) for start in starts)
        return max(found, key=lambda pair: pair[1])

    def rescale(self, model, is_rough=False):
        """Levels and factors at the maximum, the shape as it is: every z^2 as large as expected.

        Roughly: to a hundredth of a nat, where the best of several starts is asked for.
        """
        precision = max(PRECISION, 0.1 / math.sqrt(self.n_left)) if is_rough else PRECISION
        for _ in range(_N_PASSES):
            error = self.restricted.pure_error(model.whitener(self.channels, self.weights))
            change, other = self._rescaled(model, error)
            if change <= precision:
                return model, error.value
            model = other
        return model, self.value(model)

    def _rescaled(self, model, error):
        """One pass: axes, then scenes, then bodies; the largest change of a logarithm."""
        share = self._share(model)
        squares = (np.square(error.whitened) * share).sum(axis=0)
        expected = (error.remaining * share).sum(axis=0)
        squares, expected = squares[self.free], expected[self.free]
        axis = self.channels.axis[self.free]
        levels, largest = np.array(model.levels), 0.0
        for k in np.flatnonzero(model.is_free):
            mine = axis == k
            factor = _factor(squares[mine].sum(), expected[mine].sum(), _LEAST)
            level = max(levels[k] * factor, model.lowest[k])
            largest = max(largest, abs(math.log(level / levels[k])))
            squares[mine] /= (level / levels[k]) ** 2
            levels[k] = level
        found = {}
        for part, index, names in self.groups:
            if factors := dict(getattr(model, part)):
                of = index[self.free]
                sums = np.bincount(of, squares, len(names))
                rest = np.bincount(of, expected, len(names))
                steps = np.ones(len(names))
                for k in np.unique(of):
                    name = names[k]
                    old = factors.get(name, 1.0)
                    factor = _factor(sums[k], rest[k], MIN_ROWS)
                    new = min(max(old * factor, 1e-4), 1e4)
                    steps[k], factors[name] = new / old, new
                    largest = max(largest, abs(math.log(new / old)))
                squares = squares / np.square(steps[of])
                middle = math.exp(float(np.mean(np.log(list(factors.values())))))
                levels = levels * middle
                found[part] = tuple((name, value / middle) for name, value in factors.items())
        levels = np.where(model.is_free, np.maximum(levels, model.lowest), model.levels)
        return largest, replace(model, levels=tuple(levels.tolist()), **found)

    def _share(self, model):
        """Part of the variance of every row that grows with the size, shape (T, C)."""
        size = model.sizes(self.channels)
        white, amplitude = model.parts(self.channels, size)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.square(size) / (white + np.square(amplitude))
        return np.where(np.isfinite(share), np.minimum(share, 1.0), 0.0)


def _factor(squares, expected, least):
    """By which a size is to grow, at most tenfold either way; none on too few rows."""
    if expected < least:
        return 1.0
    return min(max(math.sqrt(squares / expected), 0.1), 10.0)


def _guessed(model, channels, residual):
    """Free levels from the residual as it is."""
    levels = np.array(model.levels)
    for k in np.flatnonzero(model.is_free):
        values = residual[:, channels.axis == k][channels.seen[:, channels.axis == k]]
        if len(values):
            levels[k] = max(math.sqrt(float(np.mean(np.square(values)))), model.lowest[k])
    return replace(model, levels=tuple(levels.tolist()))


def _coded(model, name):
    """A number as it is searched for: a logit for a share, a logarithm otherwise."""
    if name == "levels":
        return 0.0
    value = getattr(model, name)
    if name == "correlated":
        return math.log(value) - math.log1p(-value) if value < 1.0 else _SHARE[1]
    return math.log(value)


def _decoded(model, names, values):
    changes = {}
    for name, value in zip(names, values, strict=True):
        if name == "levels":
            levels = np.array(model.levels)
            grown = np.maximum(levels * math.exp(value), model.lowest)
            changes[name] = tuple(np.where(model.is_free, grown, levels).tolist())
        else:
            changes[name] = 1 / (1 + math.exp(-value)) if name == "correlated" else math.exp(value)
    return replace(model, **changes)
