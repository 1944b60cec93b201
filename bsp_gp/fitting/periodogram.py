"""Frequencies at which tracks move: the start of every constant that is a rate."""

import numpy as np
from scipy.signal import zoom_fft

from bsp_gp.fitting.channels import join
from bsp_gp.language.formula import Call, walk
from bsp_gp.physics.engine.chains import spread

OVERSAMPLING = 4
MOST_RATES = 8
MOST_FREQUENCIES = 20_000
SWINGING = 0.5
"""Part of what tracks are beside parabolas that one rate must make of them to be a swing."""
SHOWN = 100.0
"""Chi-squared that a swing must make at the least, in that of the noise or of what it leaves."""
ROUNDING = 1e-9
"""Chi-squared that rounding may make of the straight track that no force foresees."""
FEWEST_TURNS = 1.5
"""In the longest track, below which nothing is called a swing."""
FADING = (0.0, 3.0, 6.0, 12.0)
"""Times the longest track in decay times of a swing, first none; and SEEN decay times show it."""
SEEN = 3.0
FAR_TURNS, BETWEEN = 4.0, 21
"""Turns by which a second rate differs from the first in the longest track, at the least, and rates
between neighbours of a grid at which the first is looked for."""
MOST_TRACKS = 100
"""Coordinates of bodies that tell whether all of them swing."""
MOST_ROWS, WITHIN = 8_000, 0.01
"""Of a track in which a swing is sought, and the part of its variance that may lie within means."""
EVEN, MOST_EMPTY = 0.05, 8
"""Steps by which times may miss an even grid on which rows are summed, and its places per row."""
ALIKE = 1e-8
"""Part of what waves are, below which what is left of them beside others is rounding."""
OVERTONES = {1: 1.0, 2: 0.5, 3: 0.5}
"""Multiples of a swing's rate, and how many turns a track nearer a push looks like what the swing
lacks: a change of its size or rate, or of the form of what drives it back."""


def leading_rates(groups, noises):
    """Angular frequencies of the highest peaks of the tracks' periodogram, highest first, rad/s.

    Lines and parabolas are taken out of every track first; between half a turn a track and the
    Nyquist frequency of the median spacing.
    """
    rates = _rates(
        max(float(np.nanmax(c.times) - np.nanmin(c.times)) for c in groups),
        min(float(np.nanmedian(np.diff(c.times, axis=0))) for c in groups),
    )
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
                        t, x, own = times[seen], x[seen], variance[seen]
                        if len(t) > MOST_ROWS:
                            t, x = _lesser(t, x)
                            own = np.full(len(t), np.median(own))
                        power += _power(t, x, own, rates)
    peaks = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    peaks = peaks[np.argsort(-power[peaks])][:MOST_RATES]
    return [float(rates[p]) for p in peaks]


def is_of_swing(rate, found):
    """Whether a push of some rate, rad/s, has the period of the swing that a fit without it has.

    What an oscillator lacks, or has otherwise, looks like a push with its own period; and where a
    law foresees no swing, what drives back from both sides makes the same track as such a push. A
    second track, from elsewhere, tells these apart.
    """
    return is_at(rate, own_rate(found), longest(found))


def own_rate(found):
    """The rate at which tracks swing as a law has them, or where it has none one track; 0: none."""
    swing = swing_of(found, foreseen=True)
    if not swing and len(found.channels.scene_names) == 1:
        swing = swing_of(found)
    return swing


def is_at(rate, swing, span):
    """Whether a rate is that of a swing, or an overtone, in tracks of so many seconds."""
    return any(
        abs(rate - n * swing) * span < 2 * np.pi * turns for n, turns in OVERTONES.items() if swing
    )


def rates_in(formula):
    """Names of constants that are rates of waves in time."""
    waves = (node.args[0] for node in walk(formula)
             if isinstance(node, Call) and node.operator in ("cos", "sin"))  # fmt: skip
    return dict.fromkeys(
        name for wave in waves if {*wave.inputs} == {"t"} for name in wave.constants
    )


def longest(found):
    """Seconds from the first to the last row of the longest track of a fit."""
    return float(spread(found.channels.times).max())


def swing_of(found, foreseen=False, body=None, turns=FEWEST_TURNS, n_modes=1):
    """The rate at which tracks swing as they were seen, rad/s; 0 where they do not.

    Parameters
    ----------
    foreseen : bool
        As its law has them, then.
    body : str, optional
        Whose tracks; those of all.
    turns : float
        In the longest track, below which nothing is a swing.
    n_modes : int
        Rates that may make it together, one or two: bodies that are tied to each other beat.
    """
    shown = _shown(found, foreseen, body, turns, n_modes)
    return 0.0 if shown is None else float(shown[1][shown[2]])


def modes_of(found, body=None):
    """The same of two rates, and one far from it that shows beside it; 0 where there is none."""
    shown = _shown(found, False, body, FEWEST_TURNS, 2)
    return (0.0, 0.0) if shown is None else (float(shown[1][shown[2]]), _beside(*shown))


def _shown(found, foreseen, body, turns, n_modes):
    """Tracks that swing, rates, the number of theirs, how it fades, and seconds; or None."""
    tracks = join(chains.observed for chains in found.groups)
    if foreseen:
        tracks = tracks - found.residual
    times = found.channels.times
    sizes = np.array(found.noise.levels)[found.channels.axis]  # nan where nothing moves
    # A swing is wide: what a tracker does across it, however surely, is none of it.
    sizes = np.where(np.isfinite(sizes), np.nanmax(sizes, initial=0.0), np.nan)
    seen = [np.isfinite(tracks[:, k]) & np.isfinite(times[:, k]) for k in range(tracks.shape[1])]
    kept = [k for k, own in enumerate(seen) if own.sum() > 6 and np.isfinite(sizes[k])]
    if body is not None:
        kept = [k for k in kept if found.channels.body_names[found.channels.body[k]] == body]
    if (foreseen and found.is_failed) or not kept:
        return None
    kept = kept[:: -(-len(kept) // MOST_TRACKS)]
    lesser = {k: _lesser(times[seen[k], k], tracks[seen[k], k]) for k in kept}
    span = float(max(np.ptp(t) for t, _ in lesser.values()))
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in lesser.values()])))
    rates, whole, count, own = _rates(span, step), 0.0, 0, []
    for k, (t, x) in lesser.items():
        own.append((t, x, np.full(len(t), sizes[k] ** 2)))
        u = (t - t.mean()) / np.ptp(t)
        left = x - np.polynomial.Polynomial.fit(u, x, 2)(u)
        whole, count = whole + float(left @ left) / sizes[k] ** 2, count + len(t) - 5
    every = rates
    for fading in FADING:  # what dies away soon has no sharp rate: fewer of them show it
        rates = every[:: max(round(fading), 1)]
        power = sum(_power(*track, rates, fading / span) for track in own)
        best = int(np.argmax(power))
        made = power[best]
        if n_modes > 1:
            made += np.max(power[np.abs(rates - rates[best]) > 2 * np.pi / span], initial=0.0)
        # What nobody has explained may be all of what was taken for noise.
        noise = min(max(whole - made, 0.0) / max(count, 1), 1.0)
        is_shown = made > max(SWINGING * whole, SHOWN * noise, ROUNDING)
        shown = span * min(SEEN / fading, 1.0) if fading else span
        if is_shown and rates[best] * shown > 2 * np.pi * turns:
            return own, rates, best, fading / span, span
    return None


def _beside(own, rates, best, fading, span):
    """The rate that tracks show beside a wave that is taken away, and far from it; 0 if none does.

    What is left of a wave whose rate is not quite that of the grid stands close to it.
    """
    near = np.linspace(rates[max(best - 1, 0)], rates[min(best + 1, len(rates) - 1)], BETWEEN)
    rate = near[np.argmax(sum(_power(*track, near, fading) for track in own))]
    rest, whole, count = [], 0.0, 0
    for t, x, variance in own:
        since, u = t - t[0], (t - t.mean()) / np.ptp(t)
        wave = np.exp(-fading * since) * np.stack([np.cos(rate * since), np.sin(rate * since)])
        columns = np.column_stack([np.ones_like(u), u, u * u, *wave])
        left = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
        rest.append((t, left, variance))
        whole, count = whole + float(np.sum(np.square(left) / variance)), count + len(t) - 5
    power = sum(_power(*track, rates, fading) for track in rest)
    power = np.where(np.abs(rates - rate) > FAR_TURNS * 2 * np.pi / span, power, 0.0)
    second = int(np.argmax(power))
    noise = min(max(whole - power[second], 0.0) / max(count, 1), 1.0)
    return float(rates[second]) if power[second] > max(SHOWN * noise, ROUNDING) else 0.0


def _lesser(times, x):
    """Rows that show a swing as well as so many more: means where these move little within them.

    Else the first rows alone.
    """
    size = -(-len(times) // MOST_ROWS)
    if size == 1:
        return times, x
    kept = len(times) - len(times) % size
    blocks = x[:kept].reshape(-1, size)
    means = blocks.mean(axis=1)
    if np.square(blocks - means[:, None]).mean() < WITHIN * x.var():
        return times[:kept].reshape(-1, size).mean(axis=1), means
    return times[:MOST_ROWS], x[:MOST_ROWS]


def _rates(span, step):
    """From half a turn a track to the Nyquist frequency, rad/s."""
    count = int(min(OVERSAMPLING * span / step / 2, MOST_FREQUENCIES))
    return np.linspace(np.pi / span, np.pi / step, max(count, 8))


def _power(times, x, variance, rates, fading=0.0):
    """Fall of chi-squared by a sine and a cosine of each rate, which fade, beside a parabola."""
    weight, since = 1.0 / np.sqrt(variance), times - times[0]
    u = (times - times.mean()) / np.ptp(times)
    smooth, _ = np.linalg.qr(weight[:, None] * np.stack([np.ones_like(u), u, u * u], axis=1))
    left = weight * x
    left = left - smooth @ (smooth.T @ left)
    envelope = weight * np.exp(-fading * since)
    columns = envelope[:, None] * np.column_stack([smooth, left])
    found, twice = _sums(since, columns, np.square(envelope), rates)
    whole, taken, shown = float(envelope @ envelope), found[:, :3], found[:, 3]
    aa = (whole + twice.real) / 2 - np.square(taken.real).sum(axis=1)
    bb = (whole - twice.real) / 2 - np.square(taken.imag).sum(axis=1)
    ab = twice.imag / 2 - (taken.real * taken.imag).sum(axis=1)
    ya, yb = shown.real, shown.imag
    det, size = aa * bb - ab * ab, np.maximum(aa + bb, ALIKE * whole)
    # At the Nyquist frequency there is no sine beside the cosine, but rounding.
    is_one = det < ALIKE * whole**2
    both = (bb * ya**2 - 2 * ab * ya * yb + aa * yb**2) / np.where(is_one, 1.0, det)
    return np.where(is_one, (ya**2 + yb**2) / size, both)


def _sums(since, columns, squares, rates):
    """Sums of columns (T, c) times exp(i w t), (F, c), and of `squares` (T,) at twice each rate."""
    step = float(np.median(np.diff(since)))
    number = np.rint(since / step).astype(int)
    step = since[-1] / number[-1]
    is_even = np.abs(since - number * step).max() < EVEN * step and (np.diff(number) > 0).all()
    if is_even and number[-1] <= MOST_EMPTY * len(since):
        every = np.zeros((number[-1] + 1, columns.shape[1] + 1))
        every[number] = np.column_stack([columns, squares])
        own, doubled = (
            zoom_fft(part, [n * rates[0], n * rates[-1]], len(rates), fs=2 * np.pi / step,
                     endpoint=True, axis=0).conj()
            for n, part in ((1, every[:, :-1]), (2, every[:, -1]))
        )  # fmt: skip
        return own, doubled
    found, twice = np.empty((len(rates), columns.shape[1]), dtype=complex), []
    for first in range(0, len(rates), 512):
        waves = np.exp(1j * np.multiply.outer(rates[first : first + 512], since))
        found[first : first + 512] = waves @ columns
        twice.append(np.square(waves) @ squares)
    return found, np.concatenate(twice)
