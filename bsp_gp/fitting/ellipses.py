"""Kepler's ellipses as they are seen on the sky, from nothing but dates and places.

With the period, the eccentricity and the time of the closest pass a place is linear in four numbers
(Thiele and Innes) and in where the focus is seen: these are projected out, and the three are sought
on a grid. The four are a picture of the orbit: its long axis as it is, and what lies across the
line of nodes foreshortened.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

N_PERIODS, N_PHASES, N_BEST = 36, 18, 4
"""Periods and times of the closest pass on the grid, and the best of these that are looked at."""
SHORTEST, LONGEST = 0.15, 8.0
"""Periods, in the time of the recording."""
ECCENTRICITIES = (0.02, 0.2, 0.35, 0.5, 0.65, 0.75, 0.82, 0.88, 0.93, 0.96)
HIGHEST = 0.995
FEWEST = 6
"""Places by which seven numbers are told, and one is left."""
ROUNDING = 1e-12
START, MOST_STEPS, SMALL = 0.85, 20, 1e-5
"""Where Kepler's equation is begun (Danby), and steps up to one so small that its cube is none."""
MOST_LOOKED_AT = 200
"""Places by which starts are chosen, spread evenly."""


@dataclass(frozen=True)
class Ellipse:
    """An orbit as it is seen.

    Attributes
    ----------
    period, closest : float, s
        And when it is closest to the focus.
    focus : tuple of float, m
    picture : tuple of two tuples of float, m
        What makes places of those in an orbit of half axis one, x to where it is closest.
    """

    period: float
    closest: float
    eccentricity: float
    focus: tuple
    picture: tuple
    chisqr: float

    @property
    def axis(self):
        """Half of the long axis in the plane of the orbit, m."""
        return float(np.linalg.norm(self.picture, 2))

    @property
    def inclination(self):
        """Of that plane to the sky, rad."""
        return math.acos(min(np.linalg.norm(self.picture, -2) / self.axis, 1.0))

    @property
    def node(self):
        """Angle of the line of nodes from x to y, rad, from 0 to pi: it has no end of its own."""
        along = np.linalg.svd(self.picture)[0][:, 0]
        return math.atan2(along[1], along[0]) % math.pi

    @property
    def strength(self):
        """Acceleration times the square of the distance, m^3/s^2 (Kepler's third law)."""
        return 4 * math.pi**2 * self.axis**3 / self.period**2

    def nodes(self, times):
        """Places and velocities of the lone body at times of shape (T, S), (2, 1, 2, T, S)."""
        rate = 2 * math.pi / self.period
        anomaly = eccentric_anomaly(rate * (times - self.closest), self.eccentricity)
        cos, sin, flat = np.cos(anomaly), np.sin(anomaly), math.sqrt(1 - self.eccentricity**2)
        place = np.stack([cos - self.eccentricity, flat * sin])
        velocity = np.stack([-sin, flat * cos]) * rate / (1 - self.eccentricity * cos)
        seen = np.einsum("ij,vj...->vi...", np.array(self.picture), np.stack([place, velocity]))
        seen[0] += np.reshape(self.focus, (2, 1, 1))
        return seen[:, None]


def ellipse_of(times, places, errors, focus=None):
    """The ellipse nearest to places at some times; None where these are too few.

    Parameters
    ----------
    times : ndarray, shape (T,)
    places, errors : ndarray, shape (T, 2)
    focus : ndarray, shape (2,), m, optional
        Where it is seen; sought as well where that is not known.
    """
    if focus is not None:
        places = places - focus
    if len(times) < FEWEST or not np.ptp(times) > 0:
        return None
    span, first = float(np.ptp(times)), float(times.min())
    periods = span * np.geomspace(SHORTEST, LONGEST, N_PERIODS)
    phases = (np.arange(N_PHASES) + 0.5) / N_PHASES
    starts = np.array(list(product(np.log(periods), ECCENTRICITIES, phases)))
    some = np.linspace(0, len(times) - 1, min(len(times), MOST_LOOKED_AT)).astype(int)
    sizes = np.concatenate([
        _sizes(own, times[some] - first, places[some], errors[some], focus is None)
        for own in np.split(starts, N_PERIODS)
    ])  # fmt: skip

    def left(numbers):
        return _linear(numbers, times - first, places, errors, focus is None)[0]

    low, high = [math.log(periods[0] / 2), 0.0, -2.0], [math.log(2 * periods[-1]), HIGHEST, 3.0]
    found = [
        least_squares(left, starts[k], bounds=(low, high), x_scale=(0.1, 0.05, 0.05))
        for k in np.argsort(sizes)[:N_BEST]
    ]  # fmt: skip
    best = min(found, key=lambda one: one.cost)
    log_period, eccentricity, phase = map(float, best.x)
    period = math.exp(log_period)
    _, found_at, picture = _linear(best.x, times - first, places, errors, focus is None)
    focus = found_at if focus is None else focus
    if not np.linalg.norm(picture) > 0:
        return None
    closest = first + phase * period
    focus, picture = tuple(focus.tolist()), tuple(map(tuple, picture.tolist()))
    return Ellipse(period, closest, eccentricity, focus, picture, 2 * float(best.cost))


def _sizes(starts, times, places, errors, is_free):
    """Chi-squared of the best ellipses at many starts (n, 3), (n,)."""
    columns = _columns(*starts.T[:, :, None], times)[..., not is_free :]  # (n, T, 3)
    weighted = columns[:, None] / errors.T[..., None]  # (n, 2, T, 3)
    target = (places / errors).T  # (2, T)
    along = np.einsum("nats,at->nas", weighted, target)
    gram = np.einsum("nats,natu->nasu", weighted, weighted)
    scale = np.trace(gram, axis1=2, axis2=3)[..., None, None]
    floor = ROUNDING * scale * np.eye(gram.shape[-1])
    amounts = np.linalg.solve(gram + floor, along[..., None])[..., 0]
    return np.square(target).sum() - (along * amounts).sum(axis=(1, 2))


def _linear(numbers, times, places, errors, is_free):
    """What is left in errors, where the focus is seen, and the picture of the orbit (2, 2).

    The focus is at the origin where it is not free.
    """
    columns = _columns(*numbers, times)[..., not is_free :]
    weighted = columns[None] / errors.T[..., None]  # (2, T, 3)
    amounts = np.stack([
        np.linalg.lstsq(own, x, rcond=1e-10)[0]
        for own, x in zip(weighted, (places / errors).T, strict=True)
    ])  # fmt: skip
    left = ((columns @ amounts.T - places) / errors).ravel()
    return (left, amounts[:, 0], amounts[:, 1:]) if is_free else (left, np.zeros(2), amounts)


def _columns(log_period, eccentricity, phase, times):
    """What places are linear in: one, and the places in an orbit of half axis one, (..., T, 3)."""
    anomaly = eccentric_anomaly(2 * math.pi * (times / np.exp(log_period) - phase), eccentricity)
    flat = np.sqrt(1 - eccentricity**2)
    place = np.cos(anomaly) - eccentricity, flat * np.sin(anomaly)
    return np.stack([np.ones_like(anomaly), *place], axis=-1)


def eccentric_anomaly(mean, eccentricity):
    """The eccentric anomaly at mean ones, rad (Kepler's equation).

    By Halley's steps, from where J. M. A. Danby begins (Celestial Mechanics 40 (1987) 303).
    """
    mean = np.mod(mean + math.pi, 2 * math.pi) - math.pi
    found = mean + START * eccentricity * np.sign(mean)
    for _ in range(MOST_STEPS):
        bend = eccentricity * np.sin(found)
        slope = 1 - eccentricity * np.cos(found)
        step = (found - bend - mean) / slope
        step = step / (1 - 0.5 * step * bend / slope)
        found = found - step
        if np.nanmax(np.abs(step)) < SMALL:
            break
    return found
