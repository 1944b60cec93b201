"""A push that comes and goes with the clock: a motor, a swaying table, a shaken camera.

Time is no input of the search for laws, since nearly anything can be said with it. One thing is
worth a look of its own: the same push on every body, back and forth along an axis with one period.
Frequencies are tried one by one, beside arcs of every track, which any slow force leaves; the
p-value counts how many there were.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.language.formula import Call, Constant, Input, product
from bsp_gp.language.operators import Type
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.arcs import orthonormal_rows, polynomials
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.naming import fresh_name
from bsp_gp.physics.force import Term
from bsp_gp.physics.noise import TrackNoise
from bsp_gp.units import Unit

__all__ = ["Rhythm", "periodic_attempts", "rhythm_of"]

MOST_FREQUENCIES = 200
SLOWEST = 2.0
"""Periods that the longest track must hold: a slower push is an arc like any other."""
ARC = 3
"""Degree of the polynomials of time that are taken out of every track."""
FASTEST = 5
"""Frames that a period must hold."""
AXIS_LEVEL = 0.01
PRIOR_NATS = 6.0
"""Complexity of a periodic push, as that of a short law of a grammar."""


class Rhythm(NamedTuple):
    """The frequency in which the residual of whole tracks stands out most.

    Attributes
    ----------
    frequency : float
        rad/s.
    amplitudes : ndarray, shape (d, 2)
        Of cos and sin in the acceleration along every axis.
    p_value : float
        Of the best of all frequencies, all of them counted.
    axes : tuple of int
        Along which the push is more than noise.
    """

    frequency: float
    amplitudes: np.ndarray
    p_value: float
    axes: tuple


def rhythm_of(observation, whole, blocks, p_of_size):
    """Look for a push with one period in what a fit to whole tracks leaves.

    Parameters
    ----------
    observation : Observation
    whole : RolloutFit
    blocks : list of tuple
        Of `Observation.track_blocks`.
    p_of_size : callable
        ``p_of_size(square, dof)``: p-value of a whitened sum of squares.

    Returns
    -------
    Rhythm or None
        None where no track is long enough.
    """
    frequencies = _frequencies(whole.batches)
    if not len(frequencies):
        return None
    residual, taken, waves = _stacked(observation, whole, blocks, frequencies)
    if len(taken):
        _, values, q = np.linalg.svd(taken, full_matrices=False)
        q = q[values > 1e-10 * max(values[0], 1e-300)]
        residual = residual - (q @ residual) @ q
        waves = waves - (waves @ q.T) @ q
    best = None
    for k, frequency in enumerate(frequencies):
        square, dof, amplitudes = _explained(waves[k].reshape(-1, len(residual)), residual)
        p = p_of_size(square, dof) if dof else 1.0
        if best is None or p < best[0]:
            best = (p, k, frequency, amplitudes)
    p, k, frequency, amplitudes = best
    axes = []
    for axis, wave in enumerate(waves[k]):
        square, dof, _ = _explained(wave, residual)
        if dof and p_of_size(square, dof) <= AXIS_LEVEL / len(waves[k]):
            axes.append(axis)
    # Positions swing against the push: x = -a / w^2.
    amplitudes = -frequency**2 * amplitudes.reshape(-1, 2)
    return Rhythm(float(frequency), amplitudes, min(1.0, len(frequencies) * p), tuple(axes))


def _frequencies(batches):
    """Angular frequencies, two to a line's width."""
    longest, step = 0.0, np.inf
    for batch in batches:
        times = batch.times.reshape(len(batch.times), -1)
        spans = np.nanmax(times, axis=0) - np.nanmin(times, axis=0)
        longest = max(longest, float(np.nanmax(spans)))
        gaps = np.diff(times, axis=0)
        step = min(step, float(np.nanmedian(gaps))) if gaps.size else step
    if not (longest > 0 and np.isfinite(step)):
        return np.zeros(0)
    numbers = np.arange(SLOWEST, longest / (FASTEST * step), 0.5)[:MOST_FREQUENCIES]
    return 2 * np.pi * numbers / longest


def _stacked(observation, whole, blocks, frequencies):
    """Residual (n,), what constants do to it (k, n) and waves (F, d, 2, n), states taken out."""
    residuals, constants, waves = [], [], []
    for batch, (flat, by_constant, by_state) in zip(whole.batches, blocks, strict=True):
        noise = TrackNoise(batch, observation.sigma, observation.memory)
        n_dims = noise.seen.shape[-1]
        phase = np.multiply.outer(frequencies, np.nan_to_num(batch.times))  # (F, T, S)
        moved = np.zeros((len(frequencies), n_dims, 2, *noise.seen.shape))
        for axis in range(n_dims):
            moved[:, axis, 0, ..., axis] = np.cos(phase)[..., None]
            moved[:, axis, 1, ..., axis] = np.sin(phase)[..., None]
        moved = noise.whiten(moved.reshape(-1, *noise.seen.shape))
        arcs = polynomials(batch, noise, ARC)
        for s in range(len(flat)):
            q = orthonormal_rows(np.concatenate([by_state[s], arcs[:, s]]))
            mine = np.ascontiguousarray(moved[:, :, s]).reshape(len(moved), -1)
            residuals.append(flat[s] - (q @ flat[s]) @ q)
            constants.append(by_constant[s] - (by_constant[s] @ q.T) @ q)
            waves.append(mine - (mine @ q.T) @ q)
    waves = np.concatenate(waves, axis=1)
    shape = (len(frequencies), -1, 2, waves.shape[1])
    return np.concatenate(residuals), np.concatenate(constants, axis=1), waves.reshape(shape)


def _explained(rows, residual):
    """Sum of squares that rows explain, how many they are, and their coefficients."""
    gram = rows @ rows.T
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-8 * max(values.max(), 1e-300)
    part = vectors[:, kept].T @ (rows @ residual)
    square = float(np.sum(part**2 / values[kept]))
    return square, int(kept.sum()), vectors[:, kept] @ (part / values[kept])


def periodic_attempts(observation, model, rhythm):
    """The model with a periodic push, the same force on all bodies or the same acceleration.

    Parameters
    ----------
    observation : Observation
    model : Model
    rhythm : Rhythm or None

    Returns
    -------
    list of Attempt
    """
    if rhythm is None or not rhythm.axes:
        return []
    out = [_attempt(observation, model, rhythm, per_mass) for per_mass in (False, True)]
    return [attempt for attempt in out if attempt is not None]


def _attempt(observation, model, rhythm, per_mass):
    mass = _masses(observation)
    if not np.isfinite(mass) or (per_mass and not _differ(observation)):
        return None
    law, terms, start = model.law, [], {}
    frequency = fresh_name(law, "w")
    start[frequency] = rhythm.frequency
    for axis in rhythm.axes:
        cosine, sine = rhythm.amplitudes[axis]
        amplitude, phase = _free(law, start, "a"), _free(law, start, "f")
        start[amplitude] = float(np.hypot(cosine, sine)) * (1.0 if per_mass else mass)
        start[phase] = float(np.arctan2(-sine, cosine))
        angle = Call("mul", Constant(frequency), Input("t", Type("scalar", Unit.of(s=1))))
        wave = Call("cos", Call("add", angle, Constant(phase)))
        parts = [Constant(amplitude), wave, Input("e_" + "xyz"[axis], Type("vector", Unit.of()))]
        if per_mass:
            parts.insert(1, Input("m_i", Type("scalar", Unit.of(kg=1))))
        terms.append(Term(product(parts), "field"))
    for term in terms:
        law = law.plus(term)
    law = law.with_constants(start)
    try:
        fit = observation.fit(law, sign_bounds(observation, law), start=law)
    except EvaluationError:
        return None
    if not np.isfinite(fit.chisqr):
        return None
    period = 2 * np.pi / abs(fit.law.constants[frequency] or 1e-300)
    if not 0.5 < period / (2 * np.pi / rhythm.frequency) < 2:
        return None  # the fit has gone elsewhere: no push with the period that was seen
    unit = observation.dataset.units.text(Unit.of(s=1))
    return Attempt(
        fit.law, fit, PRIOR_NATS, f"a push with a period of {period:.3g} {unit}",
        " + ".join(to_text(term.formula) for term in terms),
        " + ".join(to_latex(term.formula) for term in terms), "field",
        share=float(1 - fit.chisqr / model.fit.chisqr), freed=tuple(start),
        p_value=rhythm.p_value,
    )  # fmt: skip


def _free(law, taken, stem):
    k = 1
    while f"{stem}{k}" in law.names or f"{stem}{k}" in taken:
        k += 1
    return f"{stem}{k}"


def _masses(observation):
    """Typical mass of what moves."""
    values = [e.mass for s in observation.train for e in s.entities if not e.is_static]
    return float(np.median(values)) if values else float("nan")


def _differ(observation):
    values = {e.mass for s in observation.train for e in s.entities if not e.is_static}
    return len(values) > 1
