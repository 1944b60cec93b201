"""Where bodies that forces do not move are between the measured rows."""

from __future__ import annotations

import numpy as np

__all__ = ["Driven"]


class Driven:
    """Tracks of the driven bodies of some chains: at rest, or a curve through what was measured.

    Parameters
    ----------
    chains : Chains
    """

    def __init__(self, chains):
        track = chains.driven
        self.count = track.shape[2]
        self._last = (None, None)
        if not self.count:
            return
        seen = np.isfinite(track).all(axis=-1)
        first = np.take_along_axis(track, np.argmax(seen, axis=0)[None, ..., None], axis=0)[0]
        self.first = np.moveaxis(first, 0, -1)  # (D, d, S)
        moving = np.any((track != first) & seen[..., None], axis=(0, -1))
        self.curves = {
            (s, k): self._curve(chains, s, k, np.flatnonzero(seen[:, s, k]))
            for s, k in np.argwhere(moving).tolist()
        }

    @staticmethod
    def _curve(chains, s, k, rows):
        """A spline, the times between which it holds, and its slope."""
        from scipy.interpolate import CubicHermiteSpline, make_interp_spline

        times, places = chains.driven_times[rows, s], chains.driven[rows, s, k]
        given = chains.driven_velocities
        if given is not None and np.isfinite(given[rows, s, k]).all():
            curve = CubicHermiteSpline(times, places, given[rows, s, k])
        else:
            degree = 5 if len(rows) > 5 else 1 if len(rows) < 4 else 3
            curve = make_interp_spline(times, places, k=degree)
        return curve, curve.derivative(), times[0], times[-1]

    def at(self, times, chain):
        """Places and velocities, shape (2, D, d, M); None without driven bodies."""
        if not self.count:
            return None
        if not self.curves and self._last[0] is chain:  # stages of a step share their chains
            return self._last[1]
        first = self.first[..., chain]
        out = np.stack([first, np.zeros_like(first)])
        self._last = (chain, out)
        for (s, k), (curve, slope, begin, end) in self.curves.items():
            mine = np.flatnonzero(chain == s)
            inside = np.clip(times[mine], begin, end)
            velocity = slope(inside)
            # Before the first and after the last seen row: straight on.
            out[0, k][:, mine] = (curve(inside) + velocity * (times[mine] - inside)[:, None]).T
            out[1, k][:, mine] = velocity.T
        return out

    def pull(self, times, chain):
        """Accelerations, shape (D, d, M)."""
        out = np.zeros(self.first[..., chain].shape)
        for (s, k), (_, slope, begin, end) in self.curves.items():
            mine = np.flatnonzero((chain == s) & (times >= begin) & (times <= end))
            out[k][:, mine] = slope.derivative()(times[mine]).T
        return out
