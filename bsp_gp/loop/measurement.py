"""The measurement as a rival: what a wrong scale, clock or camera would leave, fitted and ranked.

Every correction is screened by what it does to the residual to first order, beside the initial
states and the constants of the law. One that these could take up is not visible in the data, and
that is recorded; two that do the same cannot be told apart, whatever their names. Only those that
explain enough are fitted, jointly with the law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bsp_gp.language.formula import Call, Constant
from bsp_gp.language.render import to_text
from bsp_gp.loop.correcting import fit_correction, inflation, linear_step
from bsp_gp.loop.corrections import corrections_of
from bsp_gp.loop.defects import defect_rivals
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.explanation import MEASUREMENT, Explanation, not_fitted
from bsp_gp.loop.naming import fresh_name
from bsp_gp.loop.outcome import ConstantEstimate
from bsp_gp.loop.seeing import Linearised
from bsp_gp.loop.separating import symmetry_text
from bsp_gp.physics.force import ForceLaw, Term

__all__ = ["measurement_rivals", "parted_by", "same_numbers"]

PARALLEL = 1e-6
"""One minus the cosine up to which two changes of the data are one and the same."""
ROUNDING = 1e-4
"""Part of a change that is left beside initial states and constants by rounding alone."""
WORTH = 0.25
"""Part of what the best law or correction explains that one must explain, to first order."""
LITTLE = 2.0
"""Fall of chi-squared, in variances of the noise, of what explains nothing."""
MOST_FITTED = 5
Z90 = 1.6448536269514722


@dataclass(frozen=True, eq=False)
class _Screened:
    """A correction to first order: what it explains, and whether the data see it."""

    correction: object
    columns: np.ndarray
    gain: float
    start: np.ndarray

    @property
    def direction(self):
        """Its change of the data at unit length, if it has one number; else None."""
        if len(self.columns) != 1:
            return None
        return self.columns[0] / np.linalg.norm(self.columns[0])


def measurement_rivals(observation, model, rng, *, workers=None, to_beat=None):
    """Errors of the measurement that may leave what a law leaves.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    rng : numpy.random.Generator
        Not used: nothing is drawn.
    workers : concurrent.futures.Executor, optional
        For the fits; the answer does not depend on it.
    to_beat : float, optional
        Chi-squared of the best law: what explains next to nothing of its gain is not fitted.

    Returns
    -------
    list of Explanation
        Best first. Those with a `reason` cannot hold, or are not visible in these data; their
        `fit` is that of the model.
    """
    linear = Linearised(observation, model.fit)
    screened, out = [], []
    for correction in corrections_of(observation):
        found, reason = or_fault(_screen, linear, correction)
        if reason:
            out.append(_dropped(observation, model, correction, reason))
        elif found is None:
            out.append(_unseen(observation, model, correction))
        else:
            screened.append(found)
    defects = defect_rivals(observation, model)
    target = min([model.fit.chisqr, *(e.fit.chisqr for e in defects if not e.reason)])
    target = target if to_beat is None else min(to_beat, target)
    misfit = max(target / max(model.fit.n_rows, 1), 1.0)
    least = max(WORTH * (model.fit.chisqr - target), misfit * LITTLE)
    if to_beat is None:
        least = max([least, *(WORTH * s.gain for s in screened)])
    screened.sort(key=lambda s: -s.gain)
    worth = [s for s in screened if s.gain >= least][:MOST_FITTED]
    rest = [s for s in screened if s not in worth]
    out += [_unworthy(observation, model, s) for s in rest]
    same = _same_as(observation, model, linear, screened)
    job = partial(_fitted, observation, model, len(screened))
    run = map if workers is None else workers.map
    for s, (explained, reason) in zip(worth, run(partial(or_fault, job), worth), strict=True):
        explained = explained or _dropped(observation, model, s.correction, reason)
        out.append(replace(explained, equivalents=same[s.correction.name]))
    out += defects
    n_eff = model.fit.n_effective
    return sorted(out, key=lambda e: (bool(e.reason), e.bic(n_eff)))


def _screen(linear, correction):
    """What a correction explains to first order; None if the data do not see it."""
    columns, whole = linear.columns(correction)
    beside = np.linalg.norm(columns, axis=1)
    seen = (beside * correction.sizes > 1) & (beside > ROUNDING * whole)
    if not seen.any():
        return None
    if not seen.all():
        correction, columns = _only(correction, seen), columns[seen]
    step, gain = linear_step(columns, linear.residual)
    return _Screened(correction, columns, gain, np.clip(step, correction.low, correction.high))


def _only(correction, seen):
    """A correction with some of its numbers, the others at 0."""
    numbers = tuple(n for n, is_seen in zip(correction.numbers, seen, strict=True) if is_seen)
    return replace(
        correction, numbers=numbers, undo=partial(_undo_some, correction, seen),
        factors=partial(_quoted_by_some, correction, seen),
        text=correction.text if len(numbers) > 3 else _trimmed(correction, seen),
    )  # fmt: skip


def _trimmed(correction, seen):
    text = correction.text
    for number, is_seen in zip(correction.numbers, seen, strict=True):
        text = text if is_seen else text.replace(f"{{{number.name}}}", "0")
    return text


def _all_values(seen, values):
    out = np.zeros(len(seen))
    out[seen] = values
    return out


def _undo_some(correction, seen, scene, values, track=None):
    return correction.undo(scene, _all_values(seen, values), track)


def _quoted_by_some(correction, seen, values):
    return correction.quoted(_all_values(seen, values))


# --- what is one and the same ---------------------------------------------------------------------


def same_numbers(observation, fit):
    """Which errors of the measurement do to a fit exactly what a declared number does.

    Found from the rank of the derivatives of the tracks, not from the form of the law.

    Parameters
    ----------
    observation : Observation
    fit : Fit

    Returns
    -------
    dict of str to (tuple of str or None)
        Text of every declared term with a fixed number -> names of corrections; None where the
        data do not see the number.
    """
    if all(term.formula.constants for term in fit.law.terms if term.is_declared):
        return {}
    if not np.isfinite(fit.chisqr):  # the law runs away: there is nothing to be told apart
        return {}
    linear = Linearised(observation, fit)
    single = [c for c in corrections_of(observation) if len(c) == 1 and not c.needs_track]
    found = [s for s in (or_fault(_screen, linear, c)[0] for c in single) if s is not None]
    out = {}
    for text, column in _declared_columns(linear, fit.law):
        size = float(np.linalg.norm(column))
        out[text] = None
        if np.isfinite(size) and size > 0:
            bar = (1 - PARALLEL) * size
            out[text] = tuple(s.correction.name for s in found if abs(s.direction @ column) > bar)
    return out


def parted_by(observation, fit, text, names):
    """Which further recording would part a declared number from errors that do the same.

    Parameters
    ----------
    observation : Observation
    fit : Fit
    text : str
        Of the declared term.
    names : sequence of str
        Of corrections, as `same_numbers` gives them.

    Returns
    -------
    str
    """
    (changed, name) = next(law for t, *law in _freed_laws(fit.law) if t == text)
    corrections = [c for c in corrections_of(observation) if c.name in names]
    return symmetry_text(
        observation, fit, corrections, lambda linear: linear.column_of_law(changed, name)
    )


def _declared_columns(linear, law):
    """Text of every declared term with a fixed number, and what a factor on it does."""
    for text, changed, name in _freed_laws(law):
        column, reason = or_fault(linear.column_of_law, changed, name)
        if not reason:
            yield text, column


def _freed_laws(law):
    """Text of every declared term with a fixed number, the law with a factor on it, its name."""
    for index, term in enumerate(law.terms):
        if not term.is_declared or term.formula.constants:
            continue
        name = fresh_name(law, "s")
        scaled = Term(Call("mul", Constant(name), term.formula), term.kind, is_declared=True)
        terms = (*law.terms[:index], scaled, *law.terms[index + 1 :])
        yield to_text(term.formula), ForceLaw(terms, {**law.constants, name: 1.0}), name


def _same_as(observation, model, linear, screened):
    """For every correction the names of all that do the same to the tracks."""
    directions = [(s.correction.name, s.direction) for s in screened if s.direction is not None]
    for text, column in _declared_columns(linear, model.law):
        size = np.linalg.norm(column)
        if size > 0:
            directions.append((f"another number in {text}", column / size))
    out = {s.correction.name: () for s in screened}
    for name, direction in directions:
        if name in out:
            out[name] = tuple(
                other
                for other, theirs in directions
                if other != name and abs(direction @ theirs) > 1 - PARALLEL
            )
    return out


# --- explanations ---------------------------------------------------------------------------------


def _fitted(observation, model, n_tested, screened):
    correction = screened.correction
    values, covariance, seen, fit = fit_correction(
        observation, model.fit, correction, screened.start
    )
    halves = Z90 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    units = observation.dataset.units
    constants = tuple(
        ConstantEstimate(
            n.name, float(v), float(v - h), float(v + h),
            "" if n.unit.is_dimensionless else units.text(n.unit),
        )
        for n, v, h in zip(correction.numbers, values, halves, strict=True)
    )  # fmt: skip
    gain = model.fit.chisqr - fit.chisqr
    reason = ""
    if not gain > 0:
        reason = "it explains nothing of what is left"
    elif np.any(np.abs(values) > correction.sizes):
        reason = "it would have to be larger than anyone would believe: " + _sized(constants)
    elif np.isfinite(correction.low) and np.all(values <= correction.low):
        reason = "its number would have to be negative: the sign of another cause"
    return Explanation(
        MEASUREMENT, correction.name, _text_of(correction.text, constants), correction.latex, seen,
        fit, len(correction), constants, reason,
        details={
            "p_value": _p_of(gain / inflation(fit), len(correction), n_tested),
            "linear_gain": screened.gain,
        },
        view=partial(_viewed, correction, values) if correction.holds_for_all else None,
    )  # fmt: skip


def _viewed(correction, values, scene, track=None):
    return correction.undo(scene, values, track)


def _p_of(gain, k, n_tested):
    """Chance that the best of `n_tested` corrections explains as much of noise alone."""
    from scipy import stats

    return float(min(1.0, n_tested * stats.chi2.sf(max(gain, 0.0), k)))


def _text_of(text, constants):
    for c in constants:
        half = (c.high - c.low) / 2
        number = f"{c.value:.4g} ± {half:.2g}" + (f" {c.unit}" if c.unit else "")
        text = text.replace(f"{{{c.name}}}", f"({number})")
    return text


def _sized(constants):
    return ", ".join(f"{c.name} = {c.value:.3g} {c.unit}".strip() for c in constants[:3])


def _dropped(observation, model, correction, reason):
    return not_fitted(observation, model, MEASUREMENT, correction.name, reason, len(correction))


def _unseen(observation, model, correction):
    """A correction that initial states and constants take up, or nearly."""
    return Explanation(
        MEASUREMENT, correction.name, _bare(correction.text), correction.latex, observation,
        model.fit, len(correction),
        reason="these data do not see it: initial states and the constants of the law would take "
        "it up",
        details={"is_visible": False},
    )  # fmt: skip


def _unworthy(observation, model, screened):
    """A correction that explains too little to be fitted."""
    share = max(screened.gain, 0.0) / model.fit.chisqr
    fit = replace(model.fit, chisqr=model.fit.chisqr - max(screened.gain, 0.0))
    correction = screened.correction
    return Explanation(
        MEASUREMENT, correction.name, _bare(correction.text), correction.latex, observation, fit,
        len(correction),
        reason=f"it would explain {100 * share:.2g} % of what is left, to first order",
        details={"is_visible": True, "linear_gain": screened.gain},
    )  # fmt: skip


def _bare(text):
    return text.replace("{", "").replace("}", "")
