"""Errors of measured positions along a track: their size at every point, and their memory.

The size is quoted for every point (`Scene.sigma`) or one for each axis. The memory is that of an
Ornstein-Uhlenbeck process: two errors of a track that lie a time t apart have the correlation
exp(-t / memory), on uniform times a first-order autoregression. Zero is white noise.
"""

from __future__ import annotations

import numpy as np

__all__ = ["TrackNoise", "draw_noise", "relative_sizes", "sizes_of"]


class TrackNoise:
    """Whitens the position errors of the receivers of a batch.

    Parameters
    ----------
    batch : Batch
    sigma : array-like, shape (d,), metres
        Where no point quotes its own; a nan axis counts as not seen.
    memory : float
        Correlation time of the errors, s.

    Attributes
    ----------
    seen : ndarray of bool, shape (T, S, R, d)
    """

    def __init__(self, batch, sigma, memory=0.0):
        receivers = batch.bodies.receivers
        sigma = np.broadcast_to(np.asarray(sigma, dtype=float), batch.positions.shape[-1:])
        size = np.broadcast_to(sigma, batch.positions[:, :, receivers].shape)
        if batch.sigma is not None:
            quoted = batch.sigma[:, :, receivers]
            # An axis along which nothing moves stays left out.
            size = np.where((quoted > 0) & np.isfinite(size), quoted, size)
        known = np.isfinite(size)
        self.seen = known & np.isfinite(batch.positions[:, :, receivers])
        self._weight = np.where(self.seen, 1.0 / np.where(known, size, 1.0), 0.0)
        self._past = None
        if memory > 0:
            self._remember(batch.times, memory)

    def _remember(self, times, memory):
        """The last seen row before each, and the correlation with it."""
        rows = np.arange(len(times))[:, None, None, None]
        last = np.maximum.accumulate(np.where(self.seen, rows, -1), axis=0)
        past = np.concatenate([np.full_like(last[:1], -1), last[:-1]])
        self._past = np.maximum(past, 0)
        clock = np.nan_to_num(times)[:, :, None, None]
        gap = clock - np.take_along_axis(np.broadcast_to(clock, last.shape), self._past, axis=0)
        self._carried = np.where((past >= 0) & self.seen, np.exp(-gap / memory), 0.0)
        self._fresh = 1.0 / np.sqrt(1.0 - np.square(self._carried))

    def whiten(self, errors):
        """Whitened errors; what is not seen is 0.

        Parameters
        ----------
        errors : ndarray, shape (..., T, S, R, d), metres
            Finite where seen.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = np.where(self.seen, errors, 0.0) * self._weight
            if self._past is None:
                return scaled
            past = np.broadcast_to(self._past, scaled.shape)
            before = np.take_along_axis(scaled, past, axis=-4)
            return (scaled - self._carried * before) * self._fresh


def relative_sizes(batch, sigma):
    """Size of the error of every point as a part of the typical one, shape (T, S, N).

    Returns
    -------
    ndarray or None
        None where no point quotes its own.
    """
    return None if batch.sigma is None else sizes_of(batch.sigma, sigma)


def sizes_of(quoted, sigma):
    """Quoted errors (..., d) as parts of the typical ones (d,), axes averaged; 1 where none is."""
    with np.errstate(invalid="ignore"):
        ratio = np.where(quoted > 0, quoted / np.asarray(sigma), np.nan)
    known = np.isfinite(ratio)
    squares = np.where(known, np.square(np.where(known, ratio, 0.0)), 0.0).sum(axis=-1)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), 1.0)


def draw_noise(scene, sigma, memory, rng):
    """Errors of the receivers of a scene, shape (T, R, d), metres; 0 on axes with sigma nan."""
    sigma = np.asarray(sigma, dtype=float)
    shape = (len(scene.times), len(scene.dynamic), len(sigma))
    size = np.broadcast_to(np.where(np.isfinite(sigma), sigma, 0.0), shape)
    if scene.sigma is not None:
        quoted = scene.sigma[:, scene.dynamic]
        size = np.where((quoted > 0) & np.isfinite(sigma), quoted, size)
    drawn = rng.standard_normal(shape)
    if memory > 0:
        carried = np.exp(-np.diff(scene.times) / memory)
        for k, rho in enumerate(carried, 1):
            drawn[k] = rho * drawn[k - 1] + np.sqrt(1.0 - rho**2) * drawn[k]
    return drawn * size
