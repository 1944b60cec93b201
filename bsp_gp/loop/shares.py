"""How much of a residual a free push in some direction explains beyond what noise would."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.loop.smooth_view import spanned

__all__ = ["Explained", "Resampling", "carriers", "explain"]

N_RESAMPLED = 1000
MIN_UNITS = 5
"""Scenes or objects below which intervals come from simulated copies."""
LEVELS = (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class Explained:
    """What the columns of a channel explain.

    Attributes
    ----------
    gain : ndarray, shape (n_tracks,)
        Fall of the sum of squares of every track.
    freedom : ndarray, shape (n_tracks,)
        Constants that fitted it: the gain that noise alone would give.
    fitted : ndarray, shape (n,)
        Coordinates of the fitted push, all tracks.
    """

    gain: np.ndarray
    freedom: np.ndarray
    fitted: np.ndarray

    @property
    def n_free(self):
        """Constants, all tracks together."""
        return int(round(float(self.freedom.sum())))

    def evidence(self, n):
        """Gain in log-likelihood less the BIC penalty, nats."""
        return 0.5 * float(self.gain.sum()) - 0.5 * self.n_free * np.log(max(n, 2))


def explain(view, columns):
    """Fit the columns of every track, and the law's constants over all tracks, to the residual.

    Parameters
    ----------
    view : SmoothView
    columns : list of ndarray, shape (S, R, D, C)
        Per group.

    Returns
    -------
    Explained
    """
    bases, ranks, parts = [], [], []
    for target, block in zip(view.target, columns, strict=True):
        u, rank = spanned(block)
        bases.append(u)
        ranks.append(rank.ravel())
        parts.append(_onto(u, target[..., None])[..., 0])
    freedom = np.concatenate(ranks).astype(float)
    target = view.flat(view.target)
    fitted = view.flat(parts)
    if view.constants.shape[1] and freedom.sum():
        # The constants of the law are free as well (Frisch and Waugh): what they can do beside
        # the push, less what they did without it, which is taken off already.
        shared = [_onto(u, c) for u, c in zip(bases, _split(view, view.constants), strict=True)]
        left = view.constants - view.flat(shared)
        q, sizes, _ = np.linalg.svd(left, full_matrices=False)
        q = q[:, sizes > 1e-6]
        fitted = fitted + q @ (q.T @ (target - fitted))
        lost = view.constants.shape[1] - q.shape[1]
        freedom = freedom * max(1 - lost / freedom.sum(), 0.0)
    gain = per_track(view, 2 * fitted * target - fitted**2)
    return Explained(gain, freedom, fitted)


def _onto(u, values):
    """Projection of (S, R, D, C) onto the span of u, (S, R, D, B)."""
    return u @ (np.swapaxes(u, -1, -2) @ values)


def _split(view, columns):
    parts = [view.split(column) for column in columns.T]
    return [np.stack(group, axis=-1) for group in zip(*parts, strict=True)]


def per_track(view, flat):
    """Sums over the coordinates of every track, shape (n_tracks,)."""
    return np.concatenate([part.sum(axis=2).ravel() for part in view.split(flat)])


class Resampling:
    """Intervals of shares, from resampled scenes or objects, or from simulated copies.

    Parameters
    ----------
    view : SmoothView
    rng : numpy.random.Generator

    Attributes
    ----------
    method : str
    total : ndarray, shape (n_tracks,)
        Sum of squares of every track less its expectation under noise.
    """

    def __init__(self, view, rng):
        self.view, self.rng = view, rng
        target = view.flat(view.target)
        self.target = target
        dimensions = np.concatenate([np.ravel(d) for d in view.dimensions]).astype(float)
        # The law's constants have taken their share of the noise.
        dimensions *= view.size / max(dimensions.sum(), 1.0)
        self.total = per_track(view, target**2) - dimensions
        self.dimensions = dimensions
        self.weights, self.method = self._weights()

    def _weights(self):
        """Multiplicities of tracks in every resample, (n_draws, n_tracks), or None."""
        for place, word in ((0, "scenes"), (1, "objects")):
            units = [track[place] for track in self.view.tracks]
            names = list(dict.fromkeys(units))
            if len(names) >= MIN_UNITS:
                index = np.array([names.index(unit) for unit in units])
                counts = self.rng.multinomial(
                    len(names), np.full(len(names), 1 / len(names)), size=N_RESAMPLED
                )
                return counts[:, index], f"resampling of {len(names)} whole {word}"
        return None, "simulated copies (fewer than five scenes or objects)"

    def share(self, explained):
        """Share of the residual above noise that was explained, with its interval.

        Returns
        -------
        share, low, high : float
            nan where nothing is left above the noise.
        """
        net = explained.gain - explained.freedom
        if not self.total.sum() > 0:
            return (float("nan"),) * 3
        share = float(net.sum() / self.total.sum())
        if self.weights is not None:
            tops, bottoms = self.weights @ net, self.weights @ self.total
        else:
            tops, bottoms = self._simulated(explained)
        left = bottoms > 0  # a resample in which nothing is left above noise has no share
        if not left.any():
            return _clipped(share), float("nan"), float("nan")
        low, high = np.quantile(tops[left] / bottoms[left], LEVELS)
        return _clipped(share), _clipped(low), _clipped(high)

    def _simulated(self, explained):
        """Explained and total sums of squares of copies with fresh noise.

        A coordinate along the fitted push and the rest are independent normals about what they
        were, shrunk to the size that they have without noise.
        """
        inside = float(explained.gain.sum())
        outside = float(self.target @ self.target) - inside
        n_in = max(explained.n_free, 1)
        n_out = max(int(round(self.dimensions.sum())) - n_in, 1)
        draws = [
            self.rng.noncentral_chisquare(n, max(size - n, 0.0), N_RESAMPLED) - n
            for n, size in ((n_in, inside), (n_out, outside))
        ]
        return draws[0], draws[0] + draws[1]


def _clipped(value):
    return float(np.clip(value, 0.0, 1.0))


def carriers(resampling, place):
    """Shares of the residual above noise by scene (place 0) or by entity (place 1).

    Returns
    -------
    list of (name, share, low, high)
        Largest first; intervals from noise alone.
    """
    total = resampling.total.sum()
    if not total > 0:
        return []
    units = np.array([track[place] for track in resampling.view.tracks], dtype=object)
    out = []
    for name in dict.fromkeys(units):
        mine = units == name
        above = float(resampling.total[mine].sum())
        n = float(resampling.dimensions[mine].sum())
        others = resampling.total[~mine].sum()
        draws = resampling.rng.noncentral_chisquare(n, max(above, 0.0), N_RESAMPLED) - n
        bottoms = draws + others
        shares = np.where(bottoms > 0, draws / np.where(bottoms > 0, bottoms, 1.0), 1.0)
        low, high = np.quantile(shares, LEVELS)
        out.append((str(name), _clipped(above / total), _clipped(low), _clipped(high)))
    return sorted(out, key=lambda row: -row[1])
