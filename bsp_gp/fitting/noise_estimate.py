"""The noise of a fit from its residual: levels by restricted likelihood, further parts by evidence.

White noise with a level per axis comes first. Memory, factors of scenes and of bodies, growth with
speed and tails are each tried in turn; the one whose gain of restricted likelihood lies furthest
above what chance gives is adopted, and the others are asked again beside it.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.special import chdtri, fdtrc

from bsp_gp.fitting.noise_model import NoiseFinding
from bsp_gp.fitting.noise_task import LEVEL, NoiseTask
from bsp_gp.fitting.student import fit_student

PARTS = ("correlation", "scenes", "bodies", "speed", "tails")
_N_TIMES = 6
NORMAL = 100.0
"""Degrees of freedom from which on Student's t is the normal distribution."""
_PROMISE = 0.5
"""A part is estimated where screening promises this much of the gain that it needs."""
_NEEDED = 0.01
"""Chance of what probes take off, below which a law lacks something that they stand for."""
MOST_ROWS = 8000
"""Measured values of long tracks by which the kind of noise is told: its sizes are told by all."""
STRETCH = 64
"""Rows on end of the stretches, spread evenly, that these are taken from."""


def estimate(model, channels, residual, columns=None, local=None, adopt=True, parts=PARTS):
    """Estimate what is free of the noise from the residual of a fit.

    Parameters
    ----------
    model : NoiseModel
        What is known; levels serve as a first guess.
    residual : ndarray, shape (T, C), metres
    columns : ndarray, shape (p, T, C), optional
        Derivatives of the residual to what the fit has free everywhere.
    local : ndarray, shape (q, T, C), optional
        Derivatives to what each chain has of its own.
    adopt : bool
        Whether parts are chosen anew; otherwise those of `model` are estimated again.
    parts : collection of str
        Those that may be chosen.

    Raises
    ------
    FitError
        No row is left after what is free, though a level is to be estimated.
    """
    rows = _stretches(model, channels)
    if rows is not None:
        found = estimate(model, *_at(rows, channels, residual, columns, local), adopt, parts)
        return _sized(found, channels, residual, columns, local)
    model = model.plain() if adopt else model
    task = NoiseTask(model, channels, residual, columns, local)
    if not task.can_estimate:
        return model
    if not adopt:
        return task.averaged(task.refit(model))
    model = task.refit(task.start)
    findings, parts = [], [part for part in _parts(task, model) if part in parts]
    while parts:
        tried = {part: _with_part(task, part, model) for part in parts}
        needed = {part: _needed(task, part) for part in parts}
        best = max(parts, key=lambda part: tried[part][1] - needed[part])
        is_adopted = tried[best][1] > needed[best]
        told = [best] if is_adopted else parts
        findings += [NoiseFinding(p, tried[p][1], needed[p], is_adopted) for p in told]
        if not is_adopted:
            break
        model = tried[best][0]
        model = model if math.isinf(model.degrees) else task.refit(model)
        parts.remove(best)
    if NORMAL < model.degrees < math.inf:  # further parts have taken over what was told by tails
        model = task.refit(replace(model, degrees=math.inf))
    return replace(task.averaged(model), findings=tuple(findings))


def _stretches(model, channels):
    """Rows of long tracks that tell the kind of their noise, ndarray of int; None for all."""
    n_rows, n_seen = len(channels.times), int(channels.seen.sum())
    count = n_rows * MOST_ROWS // max(n_seen, 1) // STRETCH
    if n_seen <= MOST_ROWS or not 1 < count < n_rows // STRETCH or model.adding:
        return None
    firsts = np.linspace(0, n_rows - STRETCH, count).astype(int)
    return np.unique(firsts[:, None] + np.arange(STRETCH))


def _at(rows, channels, *arrays):
    """Channels, and arrays (..., T, C) of theirs, at some rows."""
    return channels.at_rows(rows), *(None if a is None else a[..., rows, :] for a in arrays)


def _sized(model, channels, residual, columns, local):
    """The model with the sizes that all rows tell, where no row has a weight of its own."""
    if math.isfinite(model.degrees):
        return model
    task = NoiseTask(model, channels, residual, columns, local)
    return task.rescale(model, is_rough=True)[0] if task.can_estimate else model


def estimate_beside(model, channels, residual, columns, local, probes):
    """The noise beside probes (q, T, C), columns of each chain for what the fit's law may lack.

    Where the probes take off no more than chance would, rows that they happen to follow may show
    parts of the noise that the law itself does not bear out: both must show them then.
    """
    rows = _stretches(model, channels)
    if rows is not None:
        found = estimate_beside(model, *_at(rows, channels, residual, columns, local, probes))
        return _sized(found, channels, residual, columns, np.concatenate([local, probes]))
    both = np.concatenate([local, probes])
    beside = estimate(model, channels, residual, columns, both)
    adopted = _adopted(beside)
    if not adopted or needs(model.plain(), channels, residual, columns, local, probes):
        return beside
    parts = adopted & _adopted(estimate(model, channels, residual, columns, local))
    if parts == adopted:
        return beside
    return estimate(model, channels, residual, columns, both, parts=parts)


def _adopted(model):
    return {finding.part for finding in model.findings if finding.is_adopted}


def needs(model, channels, residual, columns, local, probes):
    """Whether probes take off more than chance of what a fit leaves under a noise: an F test.

    Memory is as the noise has it; free levels are told beside the probes.
    """
    rows = _stretches(model, channels)
    if rows is not None:
        return needs(model, *_at(rows, channels, residual, columns, local, probes))
    both = np.concatenate([local, probes])
    wide, plain = (
        NoiseTask(model, channels, residual, columns, c) for c in (both, local)
    )
    whitener = wide.rescale(wide.start)[0].whitener(channels)
    most, least = (
        np.square(t.restricted.pure_error(whitener).whitened).sum() for t in (plain, wide)
    )
    n_more = plain.n_left - wide.n_left
    if n_more <= 0 or not least > 0:
        return False
    ratio = (most - least) / n_more / (least / wide.n_left)
    return float(fdtrc(n_more, wide.n_left, max(ratio, 0.0))) < _NEEDED


def _parts(task, model):
    """Parts that these channels can tell."""
    found = [] if model.is_correlation_known else ["correlation"]
    if task.free.any():
        for part, index, names in task.groups:
            if names and len(np.unique(index[task.free])) > 1:
                found.append(part)
        speed = None if model.adding else task.channels.speed
        is_moving = speed is not None and np.any(speed[task.channels.seen & task.free] > 0)
        found += ["speed", "tails"] if is_moving else ["tails"]
    if np.max(np.count_nonzero(task.channels.seen, axis=0)) < 4 and "correlation" in found:
        found.remove("correlation")
    return found


def _needed(task, part):
    """Gain of log-likelihood that chance exceeds with the probability `level`."""
    n_free = {"correlation": 3, "speed": 1, "tails": 1}.get(part)  # times are searched over
    if n_free is None:
        index = next(index for name, index, _ in task.groups if name == part)
        n_free = len(np.unique(index[task.free])) - 1
    return 0.5 * float(chdtri(n_free, LEVEL))


def _with_part(task, part, model):
    """The model with one part more, and what that gains.

    Rows keep the weights that tails gave them, which makes the gain a lower bound, as in an
    EM step.
    """
    if part == "tails":
        return _student(task, model)
    value = task.value(model)
    starts = _starts(task, part, model)
    if part == "correlation":
        best, promise = _screened(task, starts, value)
    else:
        best, promise = task.likeliest(starts)
        promise -= value
    if promise < _PROMISE * _needed(task, part):
        return best, promise
    found, reached = task.refit_normal(best)
    return found, reached - value


def _starts(task, part, model):
    """Models with one part more, where a search for its numbers may begin."""
    if part == "correlation":
        times = np.geomspace(*task.time_bounds(), _N_TIMES)
        return [replace(model, correlated=0.5, correlation_time=float(t)) for t in times]
    if part == "speed":
        speed = task.channels.speed[task.channels.seen & task.free]
        typical = math.sqrt(float(np.nanmean(np.square(speed))))
        level = math.sqrt(float(np.mean(np.square(np.array(model.levels)[model.is_free]))))
        growths = [k * level / typical for k in (0.3, 1.0, 3.0)]
        return [replace(model, speed_growth=growth) for growth in growths]
    index, names = next((i, n) for name, i, n in task.groups if name == part)
    used = np.unique(index[task.free])
    return [replace(model, **{part: tuple((names[k], 1.0) for k in used)})]


def _screened(task, starts, value):
    """The best of the correlation times, and the gain that a parabola in its share promises."""
    best, most = starts[0], 0.0
    small = min(2.0 / math.sqrt(task.n_left), 0.2)
    for start in starts:
        one, two = (
            task.value(replace(start, correlated=share)) - value for share in (small, 2.0 * small)
        )
        slope, bend = (4.0 * one - two) / (2.0 * small), (two - 2.0 * one) / small**2
        gain = -0.5 * slope**2 / bend if slope > 0 > bend else two
        if gain > most:
            best, most = start, gain
    return best, most


def _student(task, model):
    """The model with tails, and what they gain over the normal, on the pure error."""
    error = task.restricted.pure_error(model.whitener(task.channels))
    used = task.informative(model, error)
    z = error.whitened[used] / np.sqrt(error.remaining[used])
    if not z.any():
        return model, 0.0
    scale, degrees, gain = fit_student(z)
    scaled = np.maximum(scale * np.array(model.levels), model.lowest)
    levels = np.where(model.is_free, scaled, model.levels)
    gain *= min(task.n_left / len(z), 1.0)
    return replace(model, levels=tuple(levels.tolist()), degrees=degrees), gain
