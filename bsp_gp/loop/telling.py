"""What a round tells: constants with intervals, the effect, its rivals and why each lost."""

from __future__ import annotations

import numpy as np

from bsp_gp.language.formula import Call, Constant, Number, factors
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.attempts import TIE_BIC
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.effects import CLASS_BIC, sign_bounds
from bsp_gp.loop.measurement import same_numbers
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.naming import fresh_name
from bsp_gp.loop.outcome import ConstantEstimate, Effect, Rival
from bsp_gp.loop.planning import MOST_EQUALS
from bsp_gp.physics.force import ForceLaw, Term, constant_units, split_linear

__all__ = [
    "alike_numbers",
    "constant_estimates",
    "effect_of",
    "freed_attempt",
    "freed_effect",
    "freed_numbers",
    "held_out_rows",
    "rivals_of",
]

MAX_RIVALS = 8
MOST_NEAR = 60
"""Laws named at most as not ruled out, of those that were not fitted to whole tracks."""


def constant_estimates(observation, fit):
    """Constants of a fitted law with 90 % intervals and units."""
    units = {}
    for term in fit.law.terms:
        for name, unit in constant_units(term).items():
            units[name] = observation.dataset.units.text(unit)
    out, bounds = [], sign_bounds(observation, fit.law)
    for (name, entity), value, half in zip(fit.parameters, fit.values, fit.intervals, strict=True):
        unit = units.get(name, "")
        if entity and _mass_unknown(observation, entity) and unit:
            unit = f"{unit} per unit mass"
        out.append(
            ConstantEstimate(
                name, float(value), float(value - half), float(value + half), unit, entity,
                _state(value, half, bounds.get(name)),
            )
        )
    return tuple(out)


def _state(value, half, bounds):
    if not np.isfinite([value, half]).all():
        return "undetermined"
    return "at_bound" if bounds is not None and value in bounds else ""


def _mass_unknown(observation, entity):
    return any(
        e.name == entity and not np.isfinite(e.mass) for s in observation.train for e in s.entities
    )


def effect_of(observation, chosen, attempts, p_value, near=()):
    """The chosen attempt as an Effect: constants, bodies, what it cannot be told from.

    Parameters
    ----------
    observation : Observation
    chosen : Attempt
    attempts : list of Attempt
        All that were fitted.
    p_value : float
    near : sequence of str
        Further laws that were not fitted to whole tracks, but are not ruled out.
    """
    names = {split_linear(t.formula)[0] for t in chosen.law.terms if not t.is_declared}
    names |= set(chosen.freed)
    estimates = tuple(c for c in constant_estimates(observation, chosen.fit) if c.name in names)
    entities = tuple(dict.fromkeys(e for e in observation.train_regression.receiver_names()))
    zero = {c.entity for c in estimates if c.entity and c.value == 0.0}
    n_eff = chosen.fit.n_effective
    # A much simpler law is not ruled out either, though it fits a little worse.
    fitted = {
        a.text: min(
            a.fit.bic(n_eff) - chosen.fit.bic(n_eff), a.score(n_eff) - chosen.score(n_eff)
        )
        for a in attempts
        if (not a.reason or (a.freed and not a.fit.is_exact)) and a.text != chosen.text
    }
    as_good = sorted((t for t, delta in fitted.items() if delta < CLASS_BIC), key=fitted.get)
    searched = [a for a in attempts if not a.freed and a.n_effects == 1]
    further = []
    if any(a.text == chosen.text or fitted.get(a.text, np.inf) < CLASS_BIC for a in searched):
        further = [text for text in near if text != chosen.text and text not in fitted]
    equivalents = (*as_good, *chosen.equivalents, *further[:MOST_NEAR], *chosen.ties)
    named = tuple(dict.fromkeys(equivalents))[: MOST_NEAR + MOST_EQUALS]
    return Effect(
        name=chosen.name,
        kind=chosen.kind,
        law=chosen.text,
        latex=chosen.latex,
        entities=tuple(e for e in entities if e not in zero),
        constants=estimates,
        p_value=p_value,
        equivalents=named,
        n_unnamed=len({*equivalents, *further} - set(named)),
        separated_by=_separated_by(chosen.text, equivalents),
    )


def _separated_by(text, equivalents):
    """Which further measurement would tell equal laws apart."""
    import re

    def words(law):
        found = set(re.findall(r"[A-Za-z_]\w*", law))
        return {w for w in found if property_of(w)}, {
            w for w in ("v_i", "v_j", "p_j") if w in found
        }

    own, motion = words(text)
    properties, motions = set(), set()
    for law in equivalents:
        p, m = words(law)
        properties |= p ^ own
        motions |= m ^ motion
    parts = []
    if properties:
        columns = sorted({property_of(p)[0] for p in properties})
        parts.append(f"bodies that differ in {' and '.join(columns)}")
    if motions or (equivalents and not properties):
        parts.append(
            "tracks on which speed and distance vary independently (another start, another orbit)"
        )
    return "; ".join(parts)


def rivals_of(observation, model, chosen, attempts):
    """The other attempts, best first, each with why it lost."""
    n_eff = chosen.fit.n_effective
    out, seen = [], {chosen.text}
    for attempt in sorted(attempts, key=lambda a: a.score(n_eff)):
        if attempt.text in seen or len(out) >= MAX_RIVALS:
            continue
        seen.add(attempt.text)
        delta = attempt.fit.bic(n_eff) - chosen.fit.bic(n_eff)
        reason = attempt.reason
        if not reason and delta < TIE_BIC:
            reason = "fits as well" + (
                "; less simple" if attempt.complexity > chosen.complexity else ""
            )
        elif not reason and delta < CLASS_BIC:
            reason = f"fits nearly as well: BIC higher by {delta:.1f}, too little to tell"
        elif not reason:
            reason = f"fits worse: BIC higher by {delta:.1f}"
        out.append(
            Rival(
                attempt.name,
                attempt.kind,
                attempt.text,
                attempt.latex,
                float(delta),
                attempt.share,
                _ratio_of(observation, attempt.fit.law, model.errors),
                attempt.complexity,
                reason,
            )
        )
    return out


def _ratio_of(observation, law, before):
    """Held-out error of a law over that of the model entering the round."""
    bottom = before.residual_acceleration if observation.is_exact else before.rollout_rmse
    with np.errstate(over="ignore", invalid="ignore"):  # a rival may run away on held-out data
        return observation.headline_error(law) / bottom if bottom else float("nan")


def _freed_fits(observation, base, contained):
    """Fits of a law with each declared number free: (term, scaled term, name of scale, fit)."""
    for index, term in enumerate(base.terms):
        if not term.is_declared or term.formula.constants:
            continue
        name = fresh_name(base, "s")
        scaled = Term(Call("mul", Constant(name), term.formula), term.kind, is_declared=True)
        terms = (*base.terms[:index], scaled, *base.terms[index + 1 :])
        law = ForceLaw(terms, {**base.constants, name: 1.0})
        bounds = sign_bounds(observation, law)
        fit, reason = or_fault(observation.fit_beyond, law, contained, bounds)
        if reason:
            continue
        yield term, scaled, name, fit


def alike_numbers(observation, fit):
    """Which errors of the measurement look exactly like another number in a declared term.

    Found from the derivatives of the tracks; where these say nothing, from the form of the law.

    Parameters
    ----------
    observation : Observation
    fit : Fit

    Returns
    -------
    dict of str to tuple of str
        By the text of every declared term with a fixed number.
    """
    out = {}
    for text, names in same_numbers(observation, fit).items():
        if names is None:
            names = ALIKE if _is_only_number(fit.law) else ()
        out[text] = names
    return out


ALIKE = ("a length scale that is off", "a clock that is off")


def freed_numbers(observation, model, chosen=None, wins=False, against=None):
    """What freeing each declared number would do, alone and beside the chosen effect.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    chosen : Attempt, optional
        The best new term; without one the numbers are weighed against the model itself.
    wins : bool
        Whether a freed number, not the chosen term, is the effect of the round.
    against : Fit, optional
        Of an effect that is no term of a law; the numbers are weighed against it.

    Returns
    -------
    list of Rival
    """
    out = []
    best = against or (chosen.fit if chosen else model.fit)
    effect = "the effect" if not wins else chosen.name if chosen else "a new term"
    bases = [(model.law, model.fit, f"instead of {effect}" if chosen else "alone")]
    if chosen:
        bases.append((chosen.fit.law, chosen.fit, f"beside {effect}"))
    if against is not None:
        bases = [(model.law, model.fit, "instead of the effect")]
    for base, contained, label in bases:
        alike = alike_numbers(observation, contained)
        for term, scaled, name, fit in _freed_fits(observation, base, contained):
            factor, half = _scale_of(fit, name)
            same = alike.get(to_text(term.formula), ()) if factor > 0 else ()
            delta = fit.bic(best.n_effective) - best.bic()
            out.append(
                Rival(
                    f"declared number freed, {label}",
                    "declared_term_change",
                    to_text(scaled.formula),
                    to_latex(scaled.formula),
                    float(delta),
                    float(1 - (fit.chisqr / model.fit.chisqr)),
                    _ratio_of(observation, fit.law, model.errors),
                    0.0,
                    _freed_reason(factor, half, delta, same),
                )
            )
    return out


def _scale_of(fit, name):
    """Value and 90 % half-width of the factor on a declared number."""
    k = [n for n, _ in fit.parameters].index(name)
    return float(fit.values[k]), float(fit.intervals[k])


def freed_attempt(observation, model):
    """The declared number whose change explains most, as an Attempt; None if none is fixed."""
    fits = list(_freed_fits(observation, model.law, model.fit))
    if not fits:
        return None
    term, scaled, _, fit = min(fits, key=lambda found: found[3].chisqr)
    return Attempt(
        fit.law, fit, 0.0, f"declared number {_number_of(term)[0]}", to_text(scaled.formula),
        to_latex(scaled.formula), "declared_term_change",
        float(1 - fit.chisqr / model.fit.chisqr),
    )  # fmt: skip


def _number_of(term):
    """Name of the number of a declared term and the Number, None if it is the term's strength."""
    above, _ = factors(term.formula)
    numbers = [part for part in above if isinstance(part, Number) and abs(part.value) != 1]
    if len(numbers) == 1:
        return numbers[0].text, numbers[0]
    return f"in front of {to_text(term.formula)}", None


def freed_effect(observation, model, freed, p_value):
    """The change of a declared number as an Effect: what it was declared as and what it would be.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    freed : Attempt
        Of `freed_attempt`.
    p_value : float

    Returns
    -------
    Effect
    """
    (scale,) = set(freed.law.names) - set(model.law.names)
    index = next(k for k, t in enumerate(freed.law.terms) if scale in t.formula.constants)
    name, number = _number_of(model.law.terms[index])
    factor, half = _scale_of(freed.fit, scale)
    declared, unit = (number.value, number.type.unit) if number else (1.0, None)
    low, high = sorted((declared * (factor - half), declared * (factor + half)))
    text = "" if unit is None or unit.is_dimensionless else observation.dataset.units.text(unit)
    alike = alike_numbers(observation, model.fit)[to_text(model.law.terms[index].formula)]
    has_other_sign = factor + half < 0
    if has_other_sign:
        alike = ()  # no scale and no clock turns a force round
    return Effect(
        name=freed.name + (": its sign is wrong" if has_other_sign else ""),
        kind=freed.kind,
        law=freed.text,
        latex=freed.latex,
        entities=tuple(dict.fromkeys(observation.train_regression.receiver_names())),
        constants=(ConstantEstimate(name, declared * factor, low, high, text),),
        p_value=p_value,
        equivalents=alike,
        separated_by="a known length and a known time in the same recording" if alike else "",
    )


def _is_only_number(law):
    """Whether one term has a fixed number and no term knows a length of its own."""
    fixed = [term for term in law.terms if not term.formula.constants]
    own_lengths = {"s_i", "s_j", "p_c", "R_i", "R_j", "l_i", "l_j"}
    return len(fixed) == 1 and not any(term.formula.inputs & own_lengths for term in law.terms)


def _freed_reason(factor, half, delta, alike):
    """What freeing a declared number says, and of which errors of the measurement it says it."""
    size = f"{100 * (factor - 1):.4g}% ± {100 * half:.2g}% of its value"
    text = f"the declared number would have to be off by {size}"
    if delta < -TIE_BIC:
        text += ", and that fits better"
    elif delta < TIE_BIC:
        text += ", and that fits as well"
    else:
        text += f"; BIC higher by {delta:.1f}"
    if set(alike) == set(ALIKE):
        # The constants of the other terms take up any rescaling of length and time.
        text += (
            "; a length scale or a clock that is off looks exactly like a wrong number: these "
            "data cannot tell the three apart"
        )
    elif alike:
        text += (
            f"; {' or '.join(alike)} looks exactly like a wrong number: these data cannot tell "
            "them apart"
        )
    return text


def held_out_rows(before, after):
    """Errors of every held-out scene before and after, as dicts, in the unit of position."""
    for b, a in zip(before, after, strict=True):
        n = max(b["n"], 1)
        yield {
            "scene": b["scene"],
            "before": float(np.sqrt(b["sum_squares"] / n)),
            "after": float(np.sqrt(a["sum_squares"] / n)),
            "endpoint_before": float(np.mean(b["endpoints"])) if b["endpoints"] else None,
            "endpoint_after": float(np.mean(a["endpoints"])) if a["endpoints"] else None,
        }
