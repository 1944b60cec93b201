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
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.arcs import orthonormal_rows, polynomials
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.naming import fresh_name
from bsp_gp.physics.bodies import dataset_types
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
    tracks = _Tracks(observation, whole, blocks)
    best = None
    for frequency in frequencies:
        waves = tracks.waves(frequency)
        square, dof, amplitudes = _explained(np.concatenate(waves), tracks.residual)
        p = p_of_size(square, dof) if dof else 1.0
        if best is None or p < best[0]:
            best = (p, frequency, waves, amplitudes)
    p, frequency, waves, amplitudes = best
    axes = []
    for axis, wave in enumerate(waves):
        square, dof, _ = _explained(wave, tracks.residual)
        if dof and p_of_size(square, dof) <= AXIS_LEVEL / len(waves):
            axes.append(axis)
    # Positions swing against the push: x = -a / w^2.
    amplitudes = -frequency**2 * amplitudes.reshape(-1, 2)
    p = float(np.minimum(1.0, len(frequencies) * p))
    return Rhythm(float(frequency), amplitudes, p, tuple(axes))


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


class _Tracks:
    """The residual of whole tracks without what initial states, arcs and constants can take up.

    One frequency at a time, so that memory grows with the rows alone.
    """

    def __init__(self, observation, whole, blocks):
        self.parts, residuals, constants = [], [], []
        for batch, (flat, by_constant, by_state) in zip(whole.batches, blocks, strict=True):
            noise = TrackNoise(batch, observation.sigma, observation.memory)
            arcs = polynomials(batch, noise, ARC)
            bases = [
                orthonormal_rows(np.concatenate([by_state[s], arcs[:, s]]))
                for s in range(len(flat))
            ]
            self.parts.append((np.nan_to_num(batch.times), noise, bases))
            residuals += [_without(q, rows) for q, rows in zip(bases, flat, strict=True)]
            constants += [_without(q, rows) for q, rows in zip(bases, by_constant, strict=True)]
        self.taken = orthonormal_rows(np.concatenate(constants, axis=1))
        self.residual = _without(self.taken, np.concatenate(residuals))

    def waves(self, frequency):
        """What cos and sin in every coordinate leave beside all that, shape (d, 2, n)."""
        out = []
        for times, noise, bases in self.parts:
            n_dims = noise.seen.shape[-1]
            moved = np.zeros((n_dims, 2, *noise.seen.shape))
            for axis in range(n_dims):
                moved[axis, 0, ..., axis] = np.cos(frequency * times)[..., None]
                moved[axis, 1, ..., axis] = np.sin(frequency * times)[..., None]
            moved = noise.whiten(moved.reshape(-1, *noise.seen.shape))
            for s, q in enumerate(bases):
                mine = np.ascontiguousarray(moved[:, :, s]).reshape(len(moved), -1)
                out.append(_without(q, mine))
        waves = _without(self.taken, np.concatenate(out, axis=1))
        return waves.reshape(-1, 2, waves.shape[1])


def _without(basis, rows):
    """Rows (n,) or (k, n) less their part in the span of an orthonormal basis (m, n)."""
    return rows - (rows @ basis.T) @ basis


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
    masses = [e.mass for s in observation.train for e in s.entities if not e.is_static]
    mass = float(np.median(masses))
    if not np.isfinite(mass):
        return []
    out = [_attempt(observation, model, rhythm, "", mass)]
    if len(set(masses)) > 1:
        out.append(_attempt(observation, model, rhythm, "m_i * ", 1.0))
    return [attempt for attempt in out if attempt is not None]


def _attempt(observation, model, rhythm, factor, size):
    """A push of `factor` times a wave; `size` is the typical strength for unit acceleration."""
    law, dataset = model.law, observation.dataset
    types, n_own = dataset_types(dataset), len(model.law.terms)
    frequency = fresh_name(law, "w")
    for axis in rhythm.axes:
        cosine, sine = rhythm.amplitudes[axis]
        amplitude, phase = fresh_name(law, "a"), fresh_name(law, "f")
        text = f"{amplitude} * {factor}cos({frequency} * t + {phase}) * e_{'xyz'[axis]}"
        term = Term(parse_formula(text, types, units=dataset.units), "field")
        start = {
            amplitude: float(np.hypot(cosine, sine)) * size,
            phase: float(np.arctan2(-sine, cosine)),
            frequency: rhythm.frequency,
        }
        law = law.plus(term, start)
    try:
        fit = observation.fit(law, sign_bounds(observation, law), start=law)
    except EvaluationError:
        return None
    if not np.isfinite(fit.chisqr):
        return None
    period = 2 * np.pi / abs(fit.law.constants[frequency] or 1e-300)
    if not 0.5 < period / (2 * np.pi / rhythm.frequency) < 2:
        return None  # the fit has gone elsewhere: no push with the period that was seen
    formulas = [term.formula for term in law.terms[n_own:]]
    return Attempt(
        fit.law, fit, PRIOR_NATS,
        f"a push with a period of {period:.3g} {dataset.units.text(Unit.of(s=1))}",
        " + ".join(map(to_text, formulas)), " + ".join(map(to_latex, formulas)), "field",
        share=float(1 - fit.chisqr / model.fit.chisqr),
        freed=tuple(n for n in law.names if n not in model.law.names), p_value=rhythm.p_value,
    )  # fmt: skip
