"""Frequencies at which tracks move: the start of every constant that is a rate."""

import numpy as np

OVERSAMPLING = 4
MOST_RATES = 8
MOST_FREQUENCIES = 20_000


def leading_rates(groups, noises):
    """Angular frequencies of the highest peaks of the tracks' periodogram, highest first.

    Lines and parabolas are taken out of every track first; between half a turn a track and the
    Nyquist frequency of the median spacing.

    Returns
    -------
    list of float, rad/s
    """
    span = max(float(np.nanmax(c.times) - np.nanmin(c.times)) for c in groups)
    step = min(float(np.nanmedian(np.diff(c.times, axis=0))) for c in groups)
    count = int(min(OVERSAMPLING * span / step / 2, MOST_FREQUENCIES))
    rates = np.linspace(np.pi / span, np.pi / step, max(count, 8))
    power = np.zeros(len(rates))
    for chains, noise in zip(groups, noises, strict=True):
        for s in range(chains.n_chains):
            times = chains.times[: chains.lengths[s], s]
            for r in range(chains.n_moving):
                for k in range(chains.n_dims):
                    x = chains.observed[: len(times), s, r, k]
                    variance = noise.variance[: len(times), s, r, k]
                    seen = np.isfinite(x) & np.isfinite(variance)
                    if seen.sum() > 6:
                        power += _power(times[seen], x[seen], variance[seen], rates)
    peaks = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    peaks = peaks[np.argsort(-power[peaks])][:MOST_RATES]
    return [float(rates[p]) for p in peaks]


def _power(times, x, variance, rates):
    """Fall of chi-squared by a sine and a cosine of each rate, beside a parabola."""
    weight = 1.0 / np.sqrt(variance)
    u = (times - times.mean()) / np.ptp(times)
    smooth, _ = np.linalg.qr(weight[:, None] * np.stack([np.ones_like(u), u, u * u], axis=1))
    left = weight * x
    left = left - smooth @ (smooth.T @ left)
    out = np.empty(len(rates))
    for first in range(0, len(rates), 512):
        block = rates[first : first + 512]
        angle = np.multiply.outer(block, times - times[0])
        waves = np.stack([np.cos(angle), np.sin(angle)]) * weight
        waves = waves - (waves @ smooth) @ smooth.T
        a, b = waves
        aa, bb, ab = (a * a).sum(1), (b * b).sum(1), (a * b).sum(1)
        ya, yb = a @ left, b @ left
        det = np.maximum(aa * bb - ab * ab, 1e-12 * (aa * bb + 1e-300))
        out[first : first + 512] = (bb * ya**2 - 2 * ab * ya * yb + aa * yb**2) / det
    return out
