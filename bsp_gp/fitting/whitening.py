"""Errors of tracks made white: a white and an exponentially correlated part, in O(rows).

A channel is one coordinate of one body in one scene. Its errors are e = w + a u, with w white of
a variance told row by row and u a stationary Ornstein-Uhlenbeck process of unit size: two of its
values that lie a time g apart have the correlation rho = exp(-g / correlation time). The Kalman
filter of u is the Cholesky factorisation of the covariance of e, with positive numbers only, so
that neither a correlation time of no length nor an endless one costs digits:

    Q = rho^2 P + 1 - rho^2       the variance of u before its row
    S = a^2 Q + variance          that of the innovation
    P = Q variance / S            and of u after it

The recursions of P and of the mean run in compiled loops. A search over noise laws makes tens of
thousands of them for a few hundred rows: times are turned into gaps once (`gaps_of`).
"""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.compiling import compiled
from bsp_gp.errors import FitError


class Whitener:
    """Whitens errors of independent channels.

    Parameters
    ----------
    times : array-like, shape (T, C) or (T, 1), s
        Increasing along every channel; nan = no row.
    variance : array-like, shape (T, C), squared units of the errors
        Of the white part; nan or inf = not seen.
    amplitude : array-like, shape (C,) or (T, C)
        Standard deviation of the correlated part.
    correlation_time : array-like, shape () or (C,), s
        Zero makes the correlated part white, inf makes it an offset.
    gaps : ndarray, shape (T, C), optional
        `gaps_of` the times, where they are known.

    Attributes
    ----------
    seen : ndarray of bool, shape (T, C)
    spread : ndarray, shape (T, C)
        Standard deviation of every innovation: what an error that is not foreseen is divided by.
    """

    def __init__(self, times, variance, amplitude=0.0, correlation_time=0.0, gaps=None):
        variance = np.asarray(variance, dtype=float)
        times = np.broadcast_to(np.asarray(times, dtype=float), variance.shape)
        amplitude = np.asarray(amplitude, dtype=float)
        self.seen = np.isfinite(variance) & np.isfinite(times)
        self._foreseen = None
        if np.any(variance[self.seen] < 0) or not np.all(amplitude >= 0):
            raise FitError("the noise of a track must not be negative or nan")
        white = np.where(self.seen, variance, 1.0)
        if not amplitude.any():
            self.spread = np.sqrt(white)
        else:
            gaps = gaps_of(times) if gaps is None else gaps
            self._remember(gaps, correlation_time, white, amplitude)
        if not np.all(self.spread > 0):
            raise FitError("the noise of a track must not be zero where a row is seen")
        self._per_spread = np.where(self.seen, 1.0 / self.spread, 0.0)

    def _remember(self, gaps, correlation_time, white, amplitude):
        """The innovations' variances, and the recursion of the mean foreseen."""
        amplitude = np.where(self.seen, amplitude, 0.0)
        self.spread, self._kept, self._gain, self._rho = (np.empty(white.shape) for _ in range(4))
        lasting = np.full(white.shape[1], correlation_time, dtype=float)
        _filter(gaps, lasting, white, amplitude, self.spread, self._kept, self._gain, self._rho)
        self._foreseen = amplitude

    @property
    def log_dets(self):
        """Logarithm of the determinant of the covariance of every channel, shape (C,)."""
        return 2.0 * np.where(self.seen, np.log(self.spread), 0.0).sum(axis=0)

    @property
    def log_det(self):
        """Logarithm of the determinant of the covariance of everything seen."""
        return float(self.log_dets.sum())

    def innovations(self, errors):
        """What of every error was not foreseen from the rows before; 0 where not seen."""
        if self._foreseen is None:
            return np.where(self.seen, errors, 0.0)
        return self._beside(errors, self._kept, -self._foreseen, self.seen.astype(float))

    def _beside(self, values, kept, foreseen, scale):
        """Values beside what those before them foresee, times a scale; 0 where not seen."""
        values = np.ascontiguousarray(values, dtype=float)
        out = np.empty(values.shape)
        each = (-1, *values.shape[-2:])
        _recur(values.reshape(each), self.seen, kept, self._gain, foreseen, scale,
               out.reshape(each))  # fmt: skip
        return out

    def whiten(self, errors):
        """Errors (..., T, C), finite where seen, of unit covariance; 0 where not seen."""
        if self._foreseen is None:  # the quotient itself, not a product with a rounded inverse
            return np.where(self.seen, errors, 0.0) / self.spread
        return self._beside(errors, self._kept, -self._foreseen, self._per_spread)

    def colour(self, whitened):
        """Errors that `whiten` makes of unit covariance: its inverse; 0 where not seen."""
        innovations = np.where(self.seen, whitened, 0.0) * self.spread
        if self._foreseen is None:
            return innovations
        return self._beside(innovations, self._rho, self._foreseen, self.seen.astype(float))


@dataclass(frozen=True)
class Adding:
    """How errors add up from row to row.

    Attributes
    ----------
    step : float, s
        Interval in which a level is added.
    begin : float, metres
        Standard deviation of where a track begins; of sums of sums also of what is gone until its
        second row.
    order : int
        1 = to places; 2 = to velocities, which add up to places.
    """

    step: float
    begin: float
    order: int = 1


class SummedWhitener(Whitener):
    """Whitens errors that add up from row to row: of places that are sums of what was measured.

    Parameters
    ----------
    times : array-like, shape (T, C) or (T, 1), s
    variance : array-like, shape (T, C), squared units of the errors
        Of what is added from the row before, if that lies one step back; nan or inf = not seen.
    """

    def __init__(self, times, variance, adding):
        super().__init__(times, variance)
        times = np.broadcast_to(np.asarray(times, dtype=float), self.seen.shape)
        rows = np.where(self.seen, np.arange(len(times))[:, None], -1)
        before = np.maximum.accumulate(rows, axis=0)
        before = np.concatenate([np.full_like(before[:1], -1), before[:-1]])
        self._before, self._order = np.maximum(before, 0), adding.order
        self._has_before = self.seen & (before >= 0)
        earlier = np.take_along_axis(times, self._before, axis=0)
        self._gaps = np.where(self._has_before, times - earlier, adding.step)
        is_second = self._has_before & ~np.take_along_axis(self._has_before, self._before, axis=0)
        is_begin = ~self._has_before
        if adding.order == 1:
            self.spread = self.spread * np.sqrt(self._gaps / adding.step)
        else:
            widths = (self._gaps + np.take_along_axis(self._gaps, self._before, axis=0)) / 2
            self.spread = self.spread * self._gaps * widths / adding.step**2
            is_begin = is_begin | is_second
        self.spread[self.seen & is_begin] = adding.begin
        if not np.all(self.spread > 0):
            raise FitError("the noise of what is added up must not be zero where a row is seen")
        self._per_spread = np.where(self.seen, 1.0 / self.spread, 0.0)

    def innovations(self, errors):
        added = self._added(np.where(self.seen, errors, 0.0))
        if self._order == 1:
            return added
        speed = np.where(self._has_before, added / self._gaps, 0.0)
        return np.where(self._has_before, self._added(speed) * self._gaps, added)

    def _added(self, values):
        """What is added to values since the row before that is seen."""
        rows = np.broadcast_to(self._before, values.shape)
        earlier = np.take_along_axis(values, rows, axis=-2)
        return np.where(self._has_before, values - earlier, values)

    def whiten(self, errors):
        return self.innovations(errors) * self._per_spread

    def colour(self, whitened):
        added = np.where(self.seen, whitened, 0.0) * self.spread
        if self._order == 2:
            speed = np.cumsum(np.where(self._has_before, added / self._gaps, 0.0), axis=-2)
            added = np.where(self._has_before, speed * self._gaps, added)
        return np.where(self.seen, np.cumsum(added, axis=-2), 0.0)


def whitener_of(times, variance, amplitude, correlation_time, adding=None, gaps=None):
    """Whitens errors with a memory, or such as add up from row to row."""
    if adding:
        return SummedWhitener(times, variance, adding)
    return Whitener(times, variance, amplitude, correlation_time, gaps)


def log_likelihood(errors, seen, gaps, variance, amplitude, correlation_time):
    """Logarithm of the density of errors, but for a constant, without what whitens them.

    It is -inf where a variance is no positive number.

    Parameters
    ----------
    errors : ndarray, shape (T, C)
        Finite where seen.
    seen : ndarray of bool, shape (T, C)
    gaps : ndarray, shape (T, C), s
        `gaps_of` their times.
    variance, amplitude : ndarray, shape (T, C)
        As `Whitener` takes them, positive and finite where seen.
    correlation_time : float, s
    """
    return -0.5 * _sum_of_squares(errors, seen, gaps, variance, amplitude, float(correlation_time))


def gaps_of(times):
    """Intervals to the row before, (T, C); inf where a channel begins.

    Parameters
    ----------
    times : ndarray, shape (T, C), s
        nan = no row.

    Raises
    ------
    FitError
        If times do not increase.
    """
    clock = np.maximum.accumulate(np.where(np.isfinite(times), times, -math.inf), axis=0)
    with np.errstate(invalid="ignore"):
        gaps = np.diff(clock, axis=0, prepend=-math.inf)
        if np.any(clock[1:] > times[1:]) or np.any(gaps < 0):
            raise FitError("the times of a track must increase")
    return np.where(np.isfinite(gaps), gaps, math.inf)


@compiled
def _decay(gap, lasting):
    """Correlation of u with its value a time before, its square, and one less that square."""
    if gap == 0.0:
        return 1.0, 1.0, 0.0
    age = math.inf if math.isinf(gap) else gap / lasting
    return math.exp(-age), math.exp(-2.0 * age), -math.expm1(-2.0 * age)


@compiled
def _filter(gaps, lasting, white, amplitude, spread, kept, gain, rho):
    """Innovations' standard deviations and the recursion of the mean, all (T, C), in the last four.

    `amplitude` is 0 where nothing is seen.
    """
    n_rows, n_channels = white.shape
    after, dropped, gained = np.zeros((3, n_channels))
    before = np.full(n_channels, -1.0)  # the gap of the row before: clocks are often even
    one, two, fresh = np.zeros((3, n_channels))
    for t in range(n_rows):
        for c in range(n_channels):
            if gaps[t, c] != before[c]:
                before[c] = gaps[t, c]
                one[c], two[c], fresh[c] = _decay(gaps[t, c], lasting[c])
            here = two[c] * after[c] + fresh[c]
            whole = amplitude[t, c] * amplitude[t, c] + white[t, c]
            part, rest = amplitude[t, c] * amplitude[t, c] / whole, white[t, c] / whole
            innovation = part * here + rest
            after[c] = rest * here / innovation
            spread[t, c] = math.sqrt(whole * innovation)
            rho[t, c] = one[c]
            kept[t, c], gain[t, c] = one[c] * dropped[c], one[c] * gained[c]
            dropped[c] = rest / innovation
            gained[c] = amplitude[t, c] * here / (whole * innovation)


@compiled
def _sum_of_squares(errors, seen, gaps, white, amplitude, lasting):
    """Sum of squares of whitened errors (T, C), and the logarithms of the variances beside it."""
    n_rows, n_channels = errors.shape
    after, dropped, gained, mean, value = np.zeros((5, n_channels))
    before = np.full(n_channels, -1.0)
    one, two, fresh = np.zeros((3, n_channels))
    total = 0.0
    for t in range(n_rows):
        for c in range(n_channels):
            if gaps[t, c] != before[c]:
                before[c] = gaps[t, c]
                one[c], two[c], fresh[c] = _decay(gaps[t, c], lasting)
            here = two[c] * after[c] + fresh[c]
            mean[c] = one[c] * (dropped[c] * mean[c] + gained[c] * value[c])
            if not seen[t, c]:
                after[c], dropped[c], gained[c], value[c] = here, 1.0, 0.0, 0.0
                continue
            whole = amplitude[t, c] * amplitude[t, c] + white[t, c]
            part, rest = amplitude[t, c] * amplitude[t, c] / whole, white[t, c] / whole
            innovation = part * here + rest
            after[c] = rest * here / innovation
            dropped[c] = rest / innovation
            gained[c] = amplitude[t, c] * here / (whole * innovation)
            value[c] = errors[t, c]
            off, variance = errors[t, c] - amplitude[t, c] * mean[c], whole * innovation
            if not variance > 0.0:
                return math.inf
            total += off * off / variance + math.log(variance)
    return total


@compiled
def _recur(values, seen, kept, gain, foreseen, scale, out):
    """Values and what is foreseen of them, (v[t] + foreseen[t] m[t]) scale[t], (n, T, C), in `out`.

    The mean follows m[t] = kept[t] m[t - 1] + gain[t] v[t - 1]; rows that are not seen count as 0.
    """
    n_columns, n_rows, n_channels = values.shape
    for n in range(n_columns):
        mean, before = np.zeros(n_channels), np.zeros(n_channels)
        for t in range(n_rows):
            for c in range(n_channels):
                mean[c] = kept[t, c] * mean[c] + gain[t, c] * before[c]
                before[c] = values[n, t, c] if seen[t, c] else 0.0
                out[n, t, c] = (before[c] + foreseen[t, c] * mean[c]) * scale[t, c]
