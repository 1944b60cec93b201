"""Explanations that are no force between visible bodies, beside the laws of a round.

They are ranked by BIC in one table with the laws. One that is clearly better than the best law is
the effect of the round, and is adopted if it passes the tests of a law; one that is about as good
stands beside the law as a member of its class.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bsp_gp.loop.attempts import TIE_BIC, evaluate
from bsp_gp.loop.before_after import compared
from bsp_gp.loop.corrections import corrections_of
from bsp_gp.loop.dropping import NOT_FITTED, or_fault
from bsp_gp.loop.effects import CLASS_BIC, sign_bounds
from bsp_gp.loop.explanation import HIDDEN_BODY, not_fitted
from bsp_gp.loop.hidden import hidden_body
from bsp_gp.loop.measurement import measurement_rivals
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.outcome import Effect, Rival
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.separating import Member, separating_text
from bsp_gp.loop.telling import freed_attempt
from bsp_gp.loop.verdict import MIN_BIC_GAIN, MIN_SHARE, explained_share

__all__ = [
    "UNOPPOSED", "Judged", "as_attempt", "explanations", "in_class", "is_unopposed", "judge",
    "rival_rows", "told_beside", "winner_of", "without_memory",
]  # fmt: skip

UNOPPOSED = "no error of the measurement could be fitted, so that it was weighed with none"


def explanations(observation, model, rng, workers=None, to_beat=None):
    """Every explanation of a residual that is no force between visible bodies.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    rng : numpy.random.Generator
    workers : concurrent.futures.Executor, optional
        The answer does not depend on it.
    to_beat : float, optional
        Chi-squared of the best law.

    Returns
    -------
    list of Explanation
    """
    measurement_rng, hidden_rng = rng.spawn(2)
    out = measurement_rivals(observation, model, measurement_rng, workers=workers, to_beat=to_beat)
    least = [e.fit.chisqr for e in _able(out)] + ([] if to_beat is None else [to_beat])
    unseen = partial(hidden_body, workers=workers, to_beat=min(least, default=None))
    found, reason = or_fault(unseen, observation, model, hidden_rng)
    if reason:
        found = not_fitted(observation, model, HIDDEN_BODY, "an unseen body", reason)
    return out if found is None else [*out, found]


def _rows_that_count(*fits):
    """Effective rows by which fits are compared: those of the best."""
    return min(fits, key=lambda f: f.chisqr).n_effective


def _able(found):
    return [e for e in found if not e.reason]


def winner_of(model, laws, found):
    """The explanation that is clearly better than every law, or None.

    Parameters
    ----------
    model : Model
        The one entering the round.
    laws : list of Fit
        Of the laws that were tried, and of a changed number: a law that is ruled out and
        explains more tells that the explanation is not the cause either.
    found : list of Explanation
    """
    able = _able(found)
    if not able:
        return None
    n_eff = _rows_that_count(*laws, *(e.fit for e in able))
    best = min(able, key=lambda e: e.bic(n_eff))
    if model.fit.bic(n_eff) - best.bic(n_eff) < MIN_BIC_GAIN:
        return None
    if any(law.bic(n_eff) - best.bic(n_eff) < CLASS_BIC for law in laws):
        return None
    return best


def is_unopposed(observation, found):
    """Whether every error of the measurement came to grief, so that none could be weighed.

    Defects of single frames and tracks do not count: they leave nothing that a force leaves.
    """
    names = {correction.name for correction in corrections_of(observation)}
    weighed = [e for e in found if e.name in names]
    return bool(weighed) and all(e.reason.startswith(NOT_FITTED) for e in weighed)


def without_memory(search, model, shown, rng, alpha, workers=None):
    """The explanation that makes a memory of the noise needless, and what it is weighed with.

    What a wrong measurement leaves looks like noise with a memory, as a missing force does, and
    under such noise it is hard to see. So where a memory was found, explanations are sought
    under white noise as well: one that leaves nothing but that is simpler.

    Parameters
    ----------
    search : EffectSearch
        On the observation before a memory was estimated.
    model : Model
        The one entering the round, under white noise.
    shown : Attempt or None
        The law that the round would tell of.
    rng : numpy.random.Generator
    alpha : float
    workers : concurrent.futures.Executor, optional

    Returns
    -------
    winner : Explanation or None
    found : list of Explanation
    laws : list of Attempt
        The law under white noise.
    """
    observation = search.observation
    laws = []
    if shown is not None:
        bounds = sign_bounds(observation, shown.law)
        fit = observation.fit(shown.law, bounds, start=shown.law)
        laws = [replace(shown, law=fit.law, fit=fit)]
    least = min((a.fit.chisqr for a in laws), default=None)
    found = explanations(observation, model, rng, workers, least)
    winner = winner_of(model, [a.fit for a in laws], found)
    if winner is None:
        return None, found, laws
    if not examine_residual(winner.observation, winner.fit, alpha).is_noise:
        return None, found, laws
    return winner, found, laws


def in_class(fit, found, n_free=0):
    """The explanations that data cannot tell from a fitted one, best first.

    Parameters
    ----------
    fit : Fit
    found : list of Explanation
    n_free : int
        Numbers of the fitted one beside its law's constants.
    """
    able = [e for e in found if not e.reason or e.is_open]
    if not able:
        return []
    n_eff = _rows_that_count(fit, *(e.fit for e in able))
    bar = fit.bic(n_eff) + n_free * np.log(max(n_eff, 2.0)) + CLASS_BIC
    return sorted((e for e in able if e.bic(n_eff) < bar), key=lambda e: e.bic(n_eff))


def told_beside(observation, effect, shown, found):
    """The effect of a round with the explanations that fit as well named beside it.

    Returns
    -------
    effect : Effect
    names : tuple of str
        Of those explanations.
    """
    alike = in_class(shown.fit, found)
    if shown.fit.is_exact:
        # A declared number is believed, and what does the same as another one falls with it.
        alike = [e for e in alike if not any("another number" in text for text in e.equivalents)]
    if not alike:
        return effect, ()
    members = [Member(shown.name, shown.fit), *_members(alike)]
    which = separating_text(observation, members)
    names = tuple(e.name for e in alike)
    return replace(
        effect,
        equivalents=tuple(dict.fromkeys((*names, *effect.equivalents))),
        separated_by="; ".join(filter(None, (effect.separated_by, which))),
    ), names  # fmt: skip


def _members(found):
    """Those of which it can be said what they make of a further recording."""
    return [Member(e.name, e.fit, e.view) for e in found if e.view is not None]


def as_attempt(explanation):
    """An explanation in the place of a law in a table: its own numbers count as constants."""
    e, k = explanation, explanation.n_free
    fit = replace(
        e.fit, parameters=(*e.fit.parameters, *((f"of the explanation {n}", "") for n in range(k))),
        values=np.append(e.fit.values, np.zeros(k)),
    )  # fmt: skip
    return Attempt(e.fit.law, fit, float(k), e.name, e.text, e.latex, e.kind)


def rival_rows(model, best, found, but=None):
    """Rows of the table, best first: those that were fitted, and those that cannot hold.

    Parameters
    ----------
    model : Model
    best : Fit
        Of what the round tells of; `delta_bic` is against it.
    found : list of Explanation
    but : Explanation, optional
        The effect of the round, which is no rival of its own.

    Returns
    -------
    ranked, ruled_out : list of Rival
    """
    n_eff = best.n_effective
    level = best.bic(n_eff)
    ranked, ruled_out = [], []
    for e in sorted(found, key=lambda e: (bool(e.reason), e.bic(n_eff))):
        if e is but:
            continue
        delta = float(e.bic(n_eff) - level)
        reason = e.reason
        if not reason and delta < TIE_BIC:
            reason = "fits as well"
        elif not reason and delta < CLASS_BIC:
            reason = f"fits nearly as well: BIC higher by {delta:.1f}, too little to tell"
        elif not reason:
            reason = f"fits worse: BIC higher by {delta:.1f}"
        if e.equivalents and not e.reason:
            reason += f"; one and the same in these data: {', '.join(e.equivalents)}"
        is_fitted = e.fit is not model.fit and e.constants
        ratio = _ratio(e, model) if is_fitted else float("nan")
        share = float(1 - e.fit.chisqr / model.fit.chisqr) if model.fit.chisqr > 0 else 0.0
        (ruled_out if e.reason else ranked).append(
            Rival(e.name, e.kind, e.text, e.latex, delta, share, ratio, float(e.n_free), reason)
        )
    return ranked, ruled_out


def _ratio(explanation, model):
    """Held-out error under an explanation over that of the model entering the round."""
    seen = explanation.observation
    bottom = model.errors.residual_acceleration if seen.is_exact else model.errors.rollout_rmse
    with np.errstate(over="ignore", invalid="ignore"):
        return seen.headline_error(explanation.fit.law) / bottom if bottom else float("nan")


# --- the explanation as the effect of a round -----------------------------------------------------


@dataclass(frozen=True, eq=False)
class Judged:
    """What became of an explanation that is better than every law.

    Attributes
    ----------
    adopted : bool
    verdict, reason : str
    effect : Effect
    after : Model
        Under the explanation; its errors are those of positions as they were by it.
    floor : Errors
    errors : BeforeAfter
    """

    adopted: bool
    verdict: str
    reason: str
    effect: Effect
    after: object
    floor: object
    errors: object


def judge(observation, model, best, found, p_value, alpha, rng):
    """Adopt an explanation, or say why not: no test is easier than that of a law.

    Parameters
    ----------
    observation : Observation
        As measured.
    model : Model
        The one entering the round.
    best : Explanation
        Of `winner_of`.
    found : list of Explanation
    p_value : float
        Of the search of the round; that of the explanation counts if it is greater.
    alpha : float
    rng : numpy.random.Generator

    Returns
    -------
    Judged
    """
    seen = best.observation
    after = evaluate(seen, best.fit.law, best.fit)
    floor_rng, ratio_rng = rng.spawn(2)
    floor, copies = seen.floor(after.law, floor_rng)
    errors = compared(seen, model, after, copies, ratio_rng)
    own = best.details.get("p_value", p_value)
    p_value = max(p_value, own) if np.isfinite(own) else 1.0  # what failed shows nothing
    alike = [e for e in in_class(best.fit, found, best.n_free) if e is not best]
    names = list(dict.fromkeys((*best.equivalents, *(e.name for e in alike))))
    freed = freed_attempt(observation, model)
    if freed is not None and not any("another number" in n for n in names):
        n_eff = _rows_that_count(freed.fit, best.fit)
        if freed.fit.bic(n_eff) < best.bic(n_eff) + CLASS_BIC:
            names.append(freed.name)
    adopted, verdict, reason = _verdict(
        observation, model, best, after, names, floor, errors.ratio, p_value, alpha
    )
    separated_by = best.separated_by
    if names:
        which = separating_text(observation, _members([best, *alike])) or (
            "a known length and a known time in the same recording" if best.equivalents else ""
        )
        separated_by = "; ".join(filter(None, (separated_by, which)))
    effect = Effect(
        best.name, best.kind, best.text, best.latex, (), best.constants, p_value,
        tuple(names), separated_by, best.details if best.kind == HIDDEN_BODY else {},
    )  # fmt: skip
    return Judged(adopted, verdict, reason, effect, after, floor, errors)


def _verdict(observation, model, best, after, names, floor, ratio, p_value, alpha):
    n_eff = _rows_that_count(best.fit)
    gain = model.fit.bic(n_eff) - best.bic(n_eff)
    if p_value > alpha:
        return False, "cannot tell", (
            "something is left, but noise alone would let the best of all rivals explain as much "
            f"(p = {p_value:.3g}, alpha = {alpha:g})"
        )  # fmt: skip
    if names:
        return False, "cannot tell", (
            f"{best.name} explains it better than any law (BIC lower by {gain:.1f} than without), "
            f"and so does {' or '.join(names)}: these data cannot tell them apart"
        )  # fmt: skip
    seen = best.observation
    left = examine_residual(seen, best.fit, alpha)
    # Differences of measured velocities are alike from row to row by themselves.
    if not (left.tests.get("size", 0.0) > alpha if seen.is_exact else left.is_noise):
        # A law may be rough and of use; a measurement that is put right leaves noise.
        return False, "seen, not adopted", (
            f"{best.name} fits better than any law, but leaves more than noise: the cause is not "
            "among what was tried"
        )  # fmt: skip
    is_defect = best.details.get("is_defect", False)
    share = explained_share(seen, model.errors, after.errors, floor)
    if seen.memory > 0 and seen.may_have_memory and not is_defect and not share >= MIN_SHARE:
        # A memory that was estimated takes up what is left: then only errors can tell.
        return False, "seen, not adopted", (
            f"{best.name} fits better than any law, but it removes only {max(share, 0):.0%} of the "
            f"held-out error above the noise floor, less than {MIN_SHARE:.0%}"
        )  # fmt: skip
    said = f"BIC falls by {gain:.1f}, p = {p_value:.3g} with the selection counted"
    if is_defect:
        return True, "effect adopted", (
            f"{said}; it concerns single rows, which were put right or left out: held-out data "
            "have no say in it"
        )  # fmt: skip
    if observation.is_exact:
        return True, "effect adopted", f"{said}, and {share:.0%} of the held-out error is gone"
    held_out = observation.held_out_chisqr(model.law) - seen.held_out_chisqr(after.law)
    if not (np.isfinite(held_out) and held_out > 0 and ratio.low <= 1):
        return False, "seen, not adopted", (
            f"held-out tracks do not confirm it: their chi-squared falls by {held_out:.3g}, the "
            f"error of predictions has the ratio {ratio.value:.2f} "
            f"[{ratio.low:.2f}, {ratio.high:.2f}]"
        )  # fmt: skip
    return True, "effect adopted", (
        f"{said}, and held-out tracks confirm it (their chi-squared falls by {held_out:.3g})"
    )  # fmt: skip
