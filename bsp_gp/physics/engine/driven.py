"""Where bodies that forces do not move are between the measured rows."""

import math

import numpy as np

N_POWERS = 6
"""Coefficients of a piece of a curve, of which the highest degree is 5."""
MOST_KEPT = 1 << 27
"""Bytes of places at instants that were asked for before, which are kept."""


class Driven:
    """Tracks of the driven bodies of some chains: at rest, or a curve through what was measured."""

    def __init__(self, chains):
        track = chains.driven
        self.count = track.shape[2]
        self._last, self._known, self._size = (None, None), {}, 0
        if not self.count:
            return
        seen = np.isfinite(track).all(axis=-1)
        first = np.take_along_axis(track, np.argmax(seen, axis=0)[None, ..., None], axis=0)[0]
        self.first = np.moveaxis(first, 0, -1)  # (D, d, S)
        moving = np.any((track != first) & seen[..., None], axis=(0, -1))
        known = {}  # chains that stand side by side share the bodies that lead them
        self.curves = _Curves(
            {(k, s): _shared(known, chains, s, k, seen) for s, k in np.argwhere(moving).tolist()},
            (self.count, track.shape[1]),
        )

    def at(self, times, chain):
        """Places and velocities, shape (2, D, d, M), to be read alone; None without driven bodies.

        Parameters
        ----------
        times : ndarray, shape (M,)
            Or (s, M), those of several stages: what has shape (2, D, d, s M) then, unless all are
            at rest.
        chain : ndarray of int, shape (M,), or slice
        """
        if not self.count:
            return None
        if not self.curves:  # stages of a step share their chains
            if self._last[0] is not chain:
                self._last = (chain, self._at_rest(chain))
            return self._last[1]
        # A descent asks for the same instants again and again: those of the stages of its steps.
        key = times.tobytes(), repr(chain) if isinstance(chain, slice) else chain.tobytes()
        if key not in self._known:
            if times.ndim == 2:
                chain = np.tile(np.arange(self.first.shape[-1])[chain], len(times))
            out = self._moved(times.ravel(), chain)
            if self._size + out.nbytes > MOST_KEPT:
                self._known, self._size = {}, 0
            self._known[key] = out
            self._size += out.nbytes
        return self._known[key]

    def _at_rest(self, chain):
        first = self.first[..., chain]
        return np.stack([first, np.zeros_like(first)])

    def _moved(self, times, chain):
        if self.curves.is_shared:
            number = self.curves.number[:, chain]
            instants, at = np.unique(times, return_inverse=True)
            n_apart = self.curves.count * len(instants)
            if 2 * n_apart <= number.size and (number >= 0).all():  # many ask for the same
                table = self.curves.table(instants)
                return np.ascontiguousarray(np.moveaxis(table[:, number, at], -1, 2))
        out = self._at_rest(chain)
        which, beyond, (places, velocities) = self.curves.at(times, chain, 2)
        # Before the first and after the last seen row: straight on.
        body, point = which
        out[0][body, :, point] = places + velocities * beyond[:, None]
        out[1][body, :, point] = velocities
        return out

    def pull(self, times, chain):
        """Accelerations, shape (D, d, M)."""
        out = np.zeros(self.first[..., chain].shape)
        if self.curves:
            (body, point), beyond, (*_, pulls) = self.curves.at(times, chain, 3)
            out[body, :, point] = np.where(beyond[:, None], 0.0, pulls)
        return out


def _shared(known, chains, s, k, seen):
    """The curve of one body, made once for all chains of its scene."""
    rows = np.flatnonzero(seen[:, s, k])
    times, places = chains.driven_times[rows, s], np.ascontiguousarray(chains.driven[rows, s, k])
    given = chains.driven_velocities
    given = None if given is None else given[rows, s, k]
    key = times.tobytes(), places.tobytes(), b"" if given is None else given.tobytes()
    if key not in known:
        known[key] = _in_powers(curve_through(times, places, given))
    return known[key]


def curve_through(times, places, velocities=None):
    """A curve through places (n, d) of which all are seen, a spline of SciPy."""
    from scipy.interpolate import CubicHermiteSpline, make_interp_spline

    if velocities is not None and np.isfinite(velocities).all():
        return CubicHermiteSpline(times, places, velocities)
    return make_interp_spline(times, places, k=5 if len(times) > 5 else 1 if len(times) < 4 else 3)


def _in_powers(spline):
    """The curve as a PPoly, which knows its coefficients piece by piece."""
    from scipy.interpolate import PPoly

    if isinstance(spline, PPoly):
        return spline
    degree = spline.k
    knots = spline.t[degree : len(spline.t) - degree]
    powers = [spline(knots[:-1], nu=k) / math.factorial(k) for k in range(degree, -1, -1)]
    return PPoly(np.array(powers), knots)


class _Curves:
    """The pieces of all curves, by (body, chain), in one table: points are looked up at once."""

    def __init__(self, curves, shape):
        each = list({id(curve): curve for curve in curves.values()}.values())
        self.number, self.count = np.full(shape, -1), len(each)
        self.is_shared = len(each) < len(curves)
        place = {id(curve): n for n, curve in enumerate(each)}
        for key, curve in curves.items():
            self.number[key] = place[id(curve)]
        if not curves:
            return
        self.begin, self.end = (np.array([curve.x[k] for curve in each]) for k in (0, -1))
        count = np.array([len(curve.x) - 1 for curve in each])
        self.last = np.cumsum(count) - 1
        self.starts = np.concatenate([curve.x[:-1] for curve in each])
        # Every curve has its own stretch of length 1 among these keys.
        self.keys = self._keys(self.starts, np.repeat(np.arange(len(each)), count))
        # Coefficients of a piece lie side by side: they are looked up together.
        self.powers = np.zeros((len(self.starts), N_POWERS, each[0].c.shape[-1]))
        first = 0
        for curve in each:
            n_powers, n, _ = curve.c.shape
            self.powers[first : first + n, N_POWERS - n_powers :] = np.swapaxes(curve.c, 0, 1)
            first += n

    def __bool__(self):
        return self.count > 0

    def _keys(self, times, number):
        begin, end = self.begin[number], self.end[number]
        return 2.0 * number + (times - begin) / (end - begin)

    def at(self, times, chain, count):
        """Values and derivatives of the bodies that move.

        Parameters
        ----------
        times : ndarray, shape (M,)
        chain : ndarray of int, shape (M,)
        count : int
            2: places and velocities, 3: accelerations as well.

        Returns
        -------
        which : (ndarray, ndarray), shape (N,)
            Bodies, and points that they are asked for.
        beyond : ndarray, shape (N,)
            Times from the curve's end; 0 within it.
        values : list of ndarray, shape (N, d)
        """
        number = self.number[:, chain]
        which = np.nonzero(number >= 0)
        return which, *self._of(number[which], times[which[1]], count)

    def table(self, times):
        """Places and velocities of all curves at some instants, shape (2, C, M, d).

        Straight on before the first and after the last seen row.
        """
        number = np.repeat(np.arange(self.count), len(times))
        beyond, (places, velocities) = self._of(number, np.tile(times, self.count), 2)
        places = places + velocities * beyond[:, None]
        return np.stack([places, velocities]).reshape(2, self.count, len(times), -1)

    def _of(self, number, times, count):
        """Values and derivatives of curves at times, and how far these are beyond their ends."""
        inside = np.clip(times, self.begin[number], self.end[number])
        piece = np.searchsorted(self.keys, self._keys(inside, number), side="right") - 1
        piece = np.minimum(piece, self.last[number])
        past = (inside - self.starts[piece])[:, None]
        values = [np.zeros((len(past), self.powers.shape[-1])) for _ in range(count)]
        for power in np.swapaxes(self.powers[piece], 0, 1):  # Horner's scheme, with derivatives
            for order in range(count - 1, 0, -1):
                values[order] = values[order] * past + order * values[order - 1]
            values[0] = values[0] * past + power
        return times - inside, values
