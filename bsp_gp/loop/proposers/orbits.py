"""Unseen companions of a star by its velocities along the line of sight.

With period, eccentricity and the time of the closest approach a velocity is linear in two numbers:
these are projected out. Circles of every period are scored first, and ellipses at the best of them.
"""

import math
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from bsp_gp.fitting.ellipses import eccentric_anomaly
from bsp_gp.fitting.hypothesis import Hypothesis, Parameter, TrackNoise
from bsp_gp.fitting.parts.orbits import HIGHEST, AnyAngle, Orbit, Trend
from bsp_gp.inference.priors import Prior
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.physics.force import fresh_names
from bsp_gp.search.columns import orthonormal
from bsp_gp.units import DIMENSIONLESS, Unit

LONGEST, OVERSAMPLING, MOST_PERIODS, MOST_NUMBERS = 2.5, 5, 40_000, 16_000_000
"""The longest period in spans of the recording, frequencies in each turn more, all of them, and all
of them times the rows: what is kept of them has twice as many numbers."""
CLOSE, EVEN, SHORTEST = 0.05, 0.02, {True: 2.0, False: 0.25}
"""The part of all steps that are short ones; by how much of such a one all others may miss whole
numbers of it where rows are evenly spaced; the shortest period in these, of even rows (Nyquist's)
and of others, which show much shorter ones."""
SLOWER = 1.2
"""Times the longest period, up to which that of an orbit may be fitted."""
BLOCK = 400
"""Periods that are scored at a time."""
N_FIRSTS, N_PAIR_DRAWS = 60, 20
"""Periods beside which a second is sought, and draws of noise in which it is."""
SIDEREAL_DAY, N_ALIASED = 86164.09, 6
"""A turn of the Earth, s, after which the sky comes back; and peaks with which that is reckoned."""
N_PEAKS, PEAK_ROWS, N_PHASES = (30, 300), 15_000, 16
"""Fewest and most periods at which ellipses are tried, these times rows, and times of the closest
approach."""
BESIDE, NEAR = 1e-6, 1e-5
"""Part of how far an orbit's numbers go by which slopes are told, and of what is left by which a
step may do better at the end: fits go on from there."""
N_BEST, N_DESCENTS = 2, 12
"""Descents that begin at one period, and periods at which they do."""
ECCENTRICITIES = (0.1, 0.3, 0.5, 0.7, 0.85, 0.93)
NAMES = ("P", "K", "longitude", "e", "omega")
LENGTH, TIME = Unit.of(m=1), Unit.of(s=1)


class Orbits:
    """Companions on circles and ellipses as a proposer."""

    name = "orbits"
    asks_rows = True
    is_alone = False

    def __init__(self):
        self._kept = None

    def scan_of(self, view):
        """The scan of a view, which two proposers share."""
        if self._kept is None or self._kept[0] is not view:
            self._kept = view, _Scan(view)
        return self._kept[1]

    def propose(self, view):
        """The family of all periods, from those of two steps to those of more than the recording.

        A circle has three numbers, an ellipse five.
        """
        scan = self.scan_of(view)
        trends = tuple(_trends(view, scan))
        if not len(scan.rates):
            return Family(self.name, trends, null=np.zeros(len(view.row_draws)))
        gains = scan.circles
        rates = scan.peaks(gains[:, 0])
        found = scan.closer(rates[0]), scan.ellipse(scan.with_aliases(rates))
        proposals = (*trends, *(_proposal(view, scan, (orbit,)) for orbit in found))
        return _family(self.name, scan, proposals, gains.max(axis=0), 2)


class OrbitPairs:
    """Two companions at once as a proposer: what one leaves of two hides that one.

    Beside each of the likeliest circles a second is sought.

    Parameters
    ----------
    orbits : Orbits
    """

    name = "orbit pairs"
    asks_rows = True
    is_alone = False

    def __init__(self, orbits):
        self._orbits = orbits

    def propose(self, view):
        """The family of all pairs of periods."""
        scan = self._orbits.scan_of(view)
        if not len(scan.rates):
            return Family(self.name, null=np.zeros(len(view.row_draws)))
        gains = scan.circles
        firsts = _peaks(gains[:, 0], N_FIRSTS)
        more = scan.seconds(scan.rates[firsts], np.zeros(len(firsts), dtype=int))
        second = np.argmax(more, axis=0)
        both = gains[firsts, 0] + more.max(axis=0)
        k = int(np.argmax(both))
        best, rates = both[k], (scan.rates[firsts[k]], scan.rates[second[k]])
        draws = np.arange(1, min(1 + N_PAIR_DRAWS, gains.shape[1]))
        firsts = np.argmax(gains[:, draws], axis=0)
        null = gains[firsts, draws] + scan.seconds(scan.rates[firsts], draws).max(axis=0)
        pairs = scan.pairs(*rates)
        oval = scan.ellipse(scan.peaks(gains[:, 0]))
        beside = scan.beside(oval)
        other = beside.closer(beside.rates[int(np.argmax(beside.circles_beside()))])
        pairs += [(oval, other), (scan.beside(other).ellipse([oval[0]]), other)]
        proposals = [_proposal(view, scan, pair) for pair in pairs]
        proposals += _beside_trends(view, scan)
        return _family(self.name, scan, proposals, np.array([best, *null]), 4)


def _family(name, scan, proposals, gains, rank):
    """The family of orbits, from the greatest gains (1 + B,) on the data and on noise."""
    gains = _beside_noise(gains, np.square(scan.targets[: len(gains)]).sum(axis=1))
    proposals = sorted(proposals, key=lambda p: -p.promise)
    return Family(
        name, tuple(proposals), float(gains[0]), rank, gains[1:], n_tried=len(scan.rates),
        is_continuum=True,
    )  # fmt: skip


def _beside_noise(gain, total):
    """Gains of all there is of squares, where the noise is told from the same rows.

    What takes most of them away is as likely as it makes what is left small.
    """
    return -total * np.log1p(-np.minimum(gain / total, 1 - 1e-9))


class _Scan:
    """Gains of velocities on what a fit leaves of the rows, and on draws of noise.

    Attributes
    ----------
    epoch, span : float, s
    extent, error : float
        From the lowest to the highest velocity, and of one of them.
    rates : ndarray, shape (F,), rad/s
    """

    def __init__(self, view):
        self.view, channels = view, view.fit.channels
        self.axis = int(np.flatnonzero(np.isfinite(view.fit.noise.levels))[0])
        self.is_own = (channels.axis == self.axis) & channels.seen
        times = np.where(self.is_own, channels.times, np.nan)
        self.epoch = float((np.nanmin(times) + np.nanmax(times)) / 2)
        self.times = np.nan_to_num(times - self.epoch)
        self.span = float(np.nanmax(times) - np.nanmin(times))
        own = [s.positions[:, s.dynamic, self.axis] for s in view.dataset.scenes]
        self.extent = max(float(np.nanmax(x) - np.nanmin(x)) for x in own)
        white, amplitude = view.fit.noise.parts(channels)
        self.error = float(np.sqrt(np.nanmedian((white + amplitude**2)[self.is_own])))
        low = 1.0 / (LONGEST * self.span)
        high = 1.0 / _shortest(times)
        count = int((high - low) * OVERSAMPLING * self.span)
        most = min(MOST_PERIODS, MOST_NUMBERS // max(int(self.is_own.sum()), 1))
        steps = np.arange(max(min(count, most), 0))
        self.rates = 2 * math.pi * (low + steps / (OVERSAMPLING * self.span))
        self.targets = np.concatenate([view.tangent.residual[None], view.row_draws])
        self.total = float(np.square(self.targets[0]).sum())
        self.basis = np.zeros((0, self.targets.shape[1]))  # of what other orbits take up

    def projected(self, columns):
        """Velocities (c, T, C), beside everything free, (c, n)."""
        return self._without(self.view.tangent.projected(np.where(self.is_own, columns, 0.0)))

    def _without(self, rows):
        """Rows (c, n) beside what other orbits take up."""
        return rows - (rows @ self.basis.T) @ self.basis

    def gains(self, columns):
        """Chi-squared that pairs of velocities (f, 2, T, C) gain on the data, (f,)."""
        rows = self.projected(columns.reshape(-1, *columns.shape[2:]))
        return _gains(_grams(rows), rows @ self.targets[:1].T)[:, 0]

    @cached_property
    def circles(self):
        """Chi-squared that circles of every period gain, (F, 1 + B)."""
        return np.concatenate([
            _gains(own, rows @ self.targets.T)
            for rows, own in zip(self.blocks, self.grams, strict=True)
        ])  # fmt: skip

    def circles_beside(self):
        """The same beside what other orbits take up, on the data alone, (F,)."""
        found, target = [], self.targets[:1].T
        for rows, own in zip(self.blocks, self.grams, strict=True):
            inside = rows @ self.basis.T
            found.append(_gains(own - _grams(inside), rows @ target)[:, 0])
        return np.concatenate(found)

    def seconds(self, rates, which):
        """Chi-squared that circles of every period gain beside one of each rate, (F, k).

        Parameters
        ----------
        rates : ndarray, shape (k,)
        which : ndarray of int, shape (k,)
            The target of each.
        """
        n = self.targets.shape[1]
        firsts = [self.projected(self._columns(rate, 0.0, 0.0)) for rate in rates]
        bases = np.stack([orthonormal(first.T, n).T for first in firsts])  # (k, 2, n)
        targets = self.targets[which]
        taken = np.einsum("kbn,kn->kb", bases, targets)
        looks = np.concatenate([bases.reshape(-1, n), targets]).T
        found = []
        for rows, grams in zip(self.blocks, self.grams, strict=True):
            inside, dots = np.split(rows @ looks, [2 * len(rates)], axis=1)
            inside = inside.reshape(len(rows), len(rates), 2)
            dots = dots - np.einsum("fkb,kb->fk", inside, taken)
            found.append(_gains(grams[..., None] - _grams(inside), dots))
        return np.concatenate(found)

    @cached_property
    def grams(self):
        """Of the blocks."""
        return [_grams(rows) for rows in self.blocks]

    @cached_property
    def blocks(self):
        """Cosines and sines of all rates, one behind the other, by blocks of rates (2 f, n)."""
        out = []
        for first in range(0, len(self.rates), BLOCK):
            angle = self.rates[first : first + BLOCK, None, None] * self.times
            waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            waves = np.where(self.is_own, waves, 0.0).reshape(-1, *self.times.shape)
            out.append(self.view.tangent.projected(waves))
        return out

    def beside(self, point):
        """The same beside an orbit, and small changes of its numbers."""
        columns = self._columns(*point)
        amounts = self._left(columns)[1]
        steps = (1e-4 / self.span, 1e-4, 1e-4)[: 3 if point[1] else 1]
        moved = (
            tuple(x + (k == i) * step for k, x in enumerate(point)) for i, step in enumerate(steps)
        )
        changes = [np.tensordot(amounts, self._columns(*m) - columns, 1) for m in moved]
        return self.without(self.projected(np.concatenate([columns, changes])))

    def without(self, rows):
        """The same beside what rows (c, n) take up."""
        other, rows = copy(self), np.concatenate([self.basis, rows])
        other.basis = orthonormal(rows.T, rows.shape[1]).T
        other.targets = other._without(self.targets)
        return other

    def pairs(self, one, other):
        """Pairs of orbits near two rates, circles and ellipses."""
        one, other = self.closer(one), self.closer(other)
        for _ in range(2):  # beside each other
            one, other = self.beside(other).closer(one[0]), self.beside(one).closer(other[0])
        round_, oval = (one, other), (
            self.beside(other).ellipse([one[0]]), self.beside(one).ellipse([other[0]])
        )  # fmt: skip
        return [(a, b) for a in (round_[0], oval[0]) for b in (round_[1], oval[1])]

    def peaks(self, gains):
        """Rates about which ellipses are tried: of what is far from a circle few circles gain much.

        The fewer rows there are, the more.
        """
        count = PEAK_ROWS // max(int(self.is_own.sum()), 1)
        return self.rates[_peaks(gains, int(np.clip(count, *N_PEAKS)))]

    def with_aliases(self, rates):
        """Rates, and those that look like the first of them to who looks once a day.

        Of an orbit that is no circle the alias may be the higher peak.
        """
        day = 2 * math.pi / SIDEREAL_DAY
        others = np.abs(rates[:N_ALIASED, None] + day * np.array([-2, -1, 1, 2])).ravel()
        is_asked = (others > self.rates[0]) & (others < self.rates[-1])
        return np.concatenate([rates, others[is_asked]])

    def closer(self, rate):
        """The best circle near a rate: rate, eccentricity 0, phase."""
        step = 2 * math.pi / (OVERSAMPLING * self.span)

        def left(numbers):
            return self._left(self._columns(numbers[0], 0.0, 0.0))[0]

        found = least_squares(left, [rate], bounds=([rate - step], [rate + step]), x_scale=step)
        return float(found.x[0]), 0.0, 0.0

    def ellipse(self, rates):
        """The best ellipse of those near some rates: rate, eccentricity, mean anomaly at the epoch.

        A short approach is seen best in a multiple of its rate: twice and three times as long
        periods are tried as well.
        """
        low = self.rates[0] / 2
        rates = np.asarray(rates)
        rates = np.concatenate([rates, rates[:5] / 2, rates[:5] / 3])
        rates = rates[rates > low] if (rates > low).any() else np.array([low])
        phases = 2 * math.pi * np.arange(N_PHASES) / N_PHASES
        grid = np.stack(np.meshgrid(rates, ECCENTRICITIES, phases, indexing="ij"), axis=-1)
        grid = grid.reshape(-1, 3)
        gained = np.concatenate([
            self.gains(np.moveaxis(self._columns(*grid[first : first + BLOCK].T[:, :, None, None]),
                                   0, 1))
            for first in range(0, len(grid), BLOCK)
        ])  # fmt: skip
        step = 2 * math.pi / self.span
        scales = np.array([step / OVERSAMPLING, 0.1, 0.3])

        def left(numbers):
            return self._left(self._columns(*numbers))[0]

        def slopes(numbers):  # those of what amounts that follow leave, to first order (Kaufman)
            moved = np.concatenate([[numbers], numbers + np.diag(BESIDE * scales)])
            columns = np.moveaxis(self._columns(*moved.T[:, :, None, None]), 0, 1)
            rows = self.projected(columns.reshape(-1, *columns.shape[2:]))
            rows = rows.reshape(len(moved), 2, -1)
            amounts = np.linalg.lstsq(rows[0].T, self.targets[0], rcond=1e-10)[0]
            changes = (amounts @ (rows[1:] - rows[0])) / (BESIDE * scales)[:, None]
            basis = orthonormal(rows[0].T, rows.shape[-1])
            return -(changes.T - basis @ (basis.T @ changes.T))

        best, tried = None, []
        for k in np.argsort(-gained):
            rate, e, phase = grid[k]
            if tried.count(rate) == N_BEST:
                continue
            tried.append(rate)
            if len(tried) > N_BEST * N_DESCENTS:
                break
            found = least_squares(
                left, grid[k], jac=slopes, x_scale=scales, ftol=NEAR, xtol=NEAR,
                bounds=((max(rate - step, low / 4), 0.0, phase - 4.0),
                        (rate + step, HIGHEST, phase + 4.0)),
            )  # fmt: skip
            if best is None or found.cost < best.cost:
                best = found
        return tuple(map(float, best.x))

    def _columns(self, rate, eccentricity, phase):
        """The two velocities of an orbit, (2, T, C); of numbers (F, 1, 1) (2, F, T, C)."""
        anomaly = eccentric_anomaly(rate * self.times + phase, eccentricity)
        near = 1 - eccentricity * np.cos(anomaly)
        cos = (np.cos(anomaly) - eccentricity) / near
        sin = np.sqrt(1 - eccentricity**2) * np.sin(anomaly) / near
        return np.stack([cos + eccentricity, -sin])

    def _left(self, columns):
        """What two velocities leave of the rows, and their amounts."""
        rows, target = self.projected(columns), self.targets[0]
        amounts = np.linalg.lstsq(rows.T, target, rcond=1e-10)[0]
        return target - amounts @ rows, amounts

    def orbits(self, points):
        """Numbers of orbits that act together, and the chi-squared that they gain.

        Each: period, size, mean longitude at the epoch, eccentricity, omega.
        """
        left, amounts = self._left(np.concatenate([self._columns(*point) for point in points]))
        total = self.total
        gain = float(_beside_noise(total - np.square(left).sum(), total))
        numbers = []
        for (rate, eccentricity, phase), (one, other) in zip(
            points, amounts.reshape(-1, 2), strict=True
        ):
            omega, size = math.atan2(other, one), math.hypot(one, other)
            longitude = math.remainder(phase + omega, 2 * math.pi)
            numbers.append((2 * math.pi / rate, size, longitude, eccentricity, omega))
        return numbers, gain


def _shortest(times):
    """The shortest period that rows at times (T, C) tell from others, s."""
    steps = [np.diff(np.sort(own[np.isfinite(own)])) for own in times.T]
    steps = np.concatenate(steps)
    steps = steps[steps > 0]
    step = float(np.quantile(steps, CLOSE))
    off = np.abs(steps / step - np.round(steps / step))
    return SHORTEST[bool((off < EVEN * np.maximum(steps / step, 1.0)).all())] * step


def _grams(rows):
    """Products of pairs of rows (2 f, ..., n), each with the next and themselves, (3, f, ...)."""
    one, other = rows[::2], rows[1::2]
    pairs = (one, one), (one, other), (other, other)
    return np.stack([np.einsum("f...n,f...n->f...", x, y) for x, y in pairs])


def _gains(grams, dots):
    """Chi-squared that pairs gain, (f, B), from products with themselves and with targets.

    The former are one for all targets, (3, f), or one for each, (3, f, B).
    """
    a, b, c = grams if grams.ndim == 3 else grams[:, :, None]
    u, v = dots[::2], dots[1::2]
    area = a * c - b * b
    is_pair = area > 1e-9 * a * c
    both = (c * u * u - 2 * b * u * v + a * v * v) / np.where(is_pair, area, 1.0)
    return np.where(is_pair, both, u * u / np.where(a > 0, a, np.inf))


def _peaks(gains, most):
    """The highest peaks of a curve, the best first."""
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((gains >= padded[:-2]) & (gains > padded[2:]))
    return peaks[np.argsort(-gains[peaks])][:most]


def _proposal(view, scan, points, trend=None):
    """Orbits; one of no eccentricity is a circle. A trend may stand beside them."""
    found, gain = scan.orbits(points)
    law, parts = view.fit.law, [trend] if trend else []
    for numbers in found:
        part = Orbit(_numbers(law, scan, numbers), scan.epoch, scan.axis)
        law, parts = replace(law, frame=(*law.frame, part)), [*parts, part]
    return _of_parts(view, "orbit", parts, gain)


def _of_parts(view, code, parts, gain):
    """What companions add to velocities as a cause; what is left may have a memory: the star's."""
    noise = TrackNoise(replace(view.hypothesis.noise, is_correlation_known=False))
    return Proposal(
        code, " + ".join(["v = V", *(part.describe() for part in parts)]),
        view.hypothesis + Hypothesis((*parts, noise)), -view.criteria.cause_nats * len(parts), gain,
        sum(len(part.numbers) for part in parts), kind="hidden_body", patience=PATIENT,
    )  # fmt: skip


def _numbers(law, scan, values):
    """Numbers of an orbit, which begin at some values, tuple of Parameter."""
    error = scan.error
    # Of what turns still more slowly a steady change is all that shows.
    period = Prior("log_uniform", math.pi / scan.rates[-1], 2 * math.pi * SLOWER / scan.rates[0])
    size = Prior("log_uniform", error / 100, 1e6 * error)
    angle, ever = AnyAngle(), (-math.inf, math.inf)
    number = fresh_names(law, NAMES[:1])[NAMES[0]][1:]  # a circle before it has fewer names
    names = [name + number for name in NAMES]
    of = (
        (TIME, period.low, period.high, period), (LENGTH, 0.0, size.high, size),
        (DIMENSIONLESS, *ever, angle),
        (DIMENSIONLESS, 0.0, HIGHEST, Prior("uniform", 0.0, 1.0)), (DIMENSIONLESS, *ever, angle),
    )  # fmt: skip
    n_numbers = len(of) if values[3] else 3
    return tuple(
        Parameter(name, "", unit, low, high, value, prior)
        for name, (unit, low, high, prior), value in list(
            zip(names, of, values, strict=True)
        )[:n_numbers]
    )  # fmt: skip


def _trends(view, scan):
    """A steady change, and one that changes steadily itself, as far as the rows tell them."""
    for code, n in (("trend", 1), ("bent_trend", 2)):
        trend, rows = _trend(view, scan, n)
        left = float(np.square(scan.without(rows).targets[0]).sum())
        yield _of_parts(view, code, [trend], float(_beside_noise(scan.total - left, scan.total)))


def _beside_trends(view, scan):
    """A circle and an ellipse, each beside a steady change, and beside one that changes itself."""
    rates, out = None, []
    for n in (1, 2):
        trend, rows = _trend(view, scan, n)
        beside = scan.without(rows)
        rates = beside.peaks(beside.circles_beside()) if rates is None else rates
        found = beside.closer(rates[0]), beside.ellipse(rates)
        out += [_proposal(view, beside, (orbit,), trend) for orbit in found]
        rates = [orbit[0] for orbit in found]
    return out


def _trend(view, scan, n):
    """A polynomial of velocities in time of so many powers, and its rows (n, rows)."""
    powers = np.stack([scan.times ** (k + 1) / (k + 1) for k in range(n)])
    rows = scan.projected(np.where(scan.is_own, powers, 0.0))
    amounts = np.linalg.lstsq(rows.T, scan.targets[0], rcond=1e-10)[0]
    widths = scan.extent / scan.span, 8 * scan.extent / scan.span**2
    names = fresh_names(view.fit.law, ("trend", "bend")[:n]).values()
    numbers = tuple(
        Parameter(name, "", LENGTH / TIME**power, start=float(amount),
                  prior=Prior("truncated_normal", mean=0.0, sd=width))
        for power, (name, amount, width) in enumerate(zip(names, amounts, widths, strict=False), 1)
    )  # fmt: skip
    return Trend(numbers, scan.epoch, scan.axis), rows
