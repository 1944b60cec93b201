"""One turn of the loop: what is missing, which term explains it, is it real, what did it buy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bsp_gp.loop.attempts import TIE_BIC, attempts_of, choose, evaluate
from bsp_gp.loop.bootstrap import bootstrap, strength
from bsp_gp.loop.guide import guided, ordered
from bsp_gp.loop.memory import search_with_memory
from bsp_gp.loop.models import Attempt, Model
from bsp_gp.loop.outcome import Rival, Round
from bsp_gp.loop.replacing import blurred_constants, in_place_of_declared, refuted_rival
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.telling import (
    effect_of,
    freed_attempt,
    freed_effect,
    freed_numbers,
    held_out_rows,
    rivals_of,
)
from bsp_gp.loop.trace import trace_residual
from bsp_gp.units import Unit

__all__ = ["run_round"]

MIN_BIC_GAIN = 6.0


FREED = (
    "a change of a declared number fits better than any new term; a wrong number, a wrong length "
    "scale and a wrong clock do the same, and these data cannot tell them apart"
)


STRONG = 5.0
"""Multiple of the greatest evidence in simulated residuals beyond which no data sets are simulated
and searched: nothing that this leaves out of account is as large."""


MOST_REFINEMENTS = 2
MIN_SHARE = 0.75
"""Part of the held-out error above the noise floor (squared) that a term must remove."""


def run_round(
    number, model, search, alpha, rng, progress, workers=None, n_bootstrap=99, guide="order"
):
    """Run one round on a fitted model.

    Parameters
    ----------
    number : int
    model : Model
    search : EffectSearch
        With the observation.
    alpha : float
    rng : numpy.random.Generator
    progress : callable
    workers : concurrent.futures.Executor, optional
    n_bootstrap : int
        Data sets simulated at most to test a finding; 0 = simulated residuals alone.
    guide : str
        One of `guide.GUIDES`.

    Returns
    -------
    round : Round
    model : Model
        The one to go on with: the new one if a term was adopted.
    search : EffectSearch
        On the observation with the noise under which `model` was fitted.
    """
    started = time.perf_counter()
    observation = search.observation
    search_rng, floor_rng, ratio_rng, trace_rng, bootstrap_rng = rng.spawn(5)
    progress(f"round {number}: testing the residual against noise")
    missing = examine_residual(observation, model.fit, alpha)
    if not missing.is_missing:
        floor, _ = observation.floor(model.law, floor_rng)
        return _quiet_round(number, missing, model, floor, started), model, search
    progress(f"round {number}: tracing the residual")
    trace = trace_residual(observation, model.fit, trace_rng)
    # The choice of channels has looked at the data: what tests a finding knows nothing of it.
    complete = (search, model.fit)
    search, guidance = guided(search, trace, guide)
    progress(f"round {number}: searching for what is missing")
    search, fit, proposals = search_with_memory(search, model.fit, search_rng)
    if search.observation is not observation:
        observation = search.observation
        model = evaluate(observation, fit.law, fit)
        missing = examine_residual(observation, fit, alpha)
        if not missing.is_missing:
            floor, _ = observation.floor(model.law, floor_rng)
            done = _noise_round(number, observation, missing, model, floor, started)
            return replace(done, trace=trace), model, search.whole or search
    progress(f"round {number}: fitting {len(proposals.shortlist)} proposals jointly")
    attempts = attempts_of(observation, model, proposals, workers)
    n_failed = len(proposals.shortlist) - len(attempts)
    chosen = choose(observation, model, search, attempts)
    chosen, attempts = _along_the_best(
        observation, model, search, chosen, attempts, search_rng, workers
    )
    shown = _told_of(observation, model, chosen, attempts, proposals.p_value, alpha)
    if shown is None:
        floor, _ = observation.floor(model.law, floor_rng)
        rivals = freed_numbers(observation, model)
        empty = _empty_round(number, missing, model, floor, proposals, attempts, rivals, started)
        return replace(empty, trace=trace, guidance=guidance), model, search.whole or search
    is_freed = shown is not chosen
    p_value, how = proposals.p_value, ""
    is_weak = strength(proposals) < STRONG * max(proposals.null_evidence, 0.0)
    if p_value <= alpha and is_weak and n_bootstrap and not observation.is_exact and not is_freed:
        progress(f"round {number}: the same search on simulated data")
        significance = bootstrap(
            *complete, strength(proposals), bootstrap_rng, alpha=alpha, n_max=n_bootstrap,
            workers=workers,
        )  # fmt: skip
        p_value, how = significance.p_value, significance.text()
    progress(f"round {number}: weighing {shown.name} on held-out data")
    after = evaluate(observation, shown.law, shown.fit)
    floor, copies = observation.floor(after.law, floor_rng)
    ratio = observation.ratio(model.rows, after.rows, ratio_rng, copies, model.law, after.law)
    if is_freed:
        adopted, verdict, reason = False, "cannot tell", FREED
        effect = freed_effect(observation, model, shown, p_value)
    else:
        found = _weighed(observation, model, after, floor, ratio, alpha)
        adopted, verdict, reason = _verdict(
            observation, model, after, chosen, attempts, found, p_value, alpha
        )
        refuted = None
        if not adopted:
            refuted = _in_place(
                observation, model, after, chosen, attempts, p_value, alpha, ratio_rng
            )
        if refuted is not None:
            chosen = shown = refuted.chosen
            adopted, verdict, reason = True, "effect adopted", refuted.reason
            after, ratio = refuted.after, refuted.ratio
        effect = effect_of(observation, chosen, attempts, p_value)
    effect, rivals = ordered(effect, rivals_of(observation, model, shown, attempts), guidance)
    rivals = [*rivals, *freed_numbers(observation, model, chosen, is_freed)]
    if not is_freed and refuted is not None:
        rivals.insert(0, refuted.rival)
    done = Round(
        number=number,
        missing=missing,
        effect=effect,
        rivals=tuple(rivals),
        adopted=adopted,
        reason=reason,
        before=model.errors,
        after=after.errors,
        floor=floor,
        ratio=ratio,
        held_out=tuple(held_out_rows(model.rows, after.rows)),
        certificate="; ".join(
            [*proposals.certificates]
            + ([f"{n_failed} proposals without a finite fit were left out"] if n_failed else [])
        ),
        seconds=time.perf_counter() - started,
        verdict=verdict,
        significance=how,
        noise_memory=observation.memory,
        trace=trace,
        guidance=guidance,
    )
    return done, (after if adopted else model), search.whole or search


def _along_the_best(observation, model, search, chosen, attempts, rng, workers):
    """Search again at the states of the best attempt, until it stays the best.

    A model that lacks much leads its tracks far astray; laws are then better told apart along
    the track of even a rough stand-in.
    """
    for _ in range(MOST_REFINEMENTS):
        if chosen is None or observation.is_exact:
            break
        again = search.propose(model.fit, rng, along=chosen.fit, n_null=0)
        known = {attempt.text for attempt in attempts}
        fresh = [a for a in attempts_of(observation, model, again, workers) if a.text not in known]
        attempts = [*attempts, *fresh]
        better = choose(observation, model, search, attempts)
        if not fresh or better.text == chosen.text:
            break
        chosen = better
    return chosen, attempts


def _told_of(observation, model, chosen, attempts, p_value, alpha):
    """The attempt that a round tells of: the chosen one, a freed number that wins, or None."""
    if chosen is not None and not _number_wins(model, chosen, attempts, p_value, alpha):
        return chosen
    if p_value > alpha or not any(a.redoes_declared for a in attempts):
        return chosen
    freed = freed_attempt(observation, model)
    if freed is None:
        return chosen
    if chosen is None and min(a.fit.chisqr for a in attempts) < freed.fit.chisqr:
        return None  # what is ruled out explains more: the number is no cause
    n_eff = freed.fit.n_effective
    is_clear = model.fit.bic(n_eff) - freed.fit.bic(n_eff) >= MIN_BIC_GAIN
    return freed if is_clear else chosen


class Weighed(NamedTuple):
    """What was found out about a term: error floor, ratio, gain on held-out tracks, what is left.

    Attributes
    ----------
    floor : Errors
    ratio : Ratio
    held_out : float
        Fall of the chi-squared of held-out tracks; nan on exact data.
    is_left : bool
        Whether the law with the term still leaves more than noise.
    """

    floor: object
    ratio: object
    held_out: float
    is_left: bool


def _weighed(observation, model, after, floor, ratio, alpha):
    is_left = observation.is_exact or examine_residual(observation, after.fit, alpha).is_missing
    return Weighed(floor, ratio, observation.held_out_gain(model.law, after.law), is_left)


def _verdict(observation, model, after, chosen, attempts, found, p_value, alpha):
    """Adopt, or say why not."""
    ratio, held_out = found.ratio, found.held_out
    n_eff = chosen.fit.n_effective
    gain = model.fit.bic(n_eff) - chosen.fit.bic(n_eff)
    share = _explained(observation, model.errors, after.errors, found.floor)
    if p_value > alpha:
        return (
            False,
            "cannot tell",
            (
                "something is left, but no law of the grammar explains more of it than noise alone "
                f"would let the best of all laws explain (p = {p_value:.3g}, alpha = {alpha:g})"
            ),
        )
    if gain < MIN_BIC_GAIN:
        return (
            False,
            "seen, not adopted",
            (f"the evidence for it is weak: BIC falls by {gain:.1f}, less than {MIN_BIC_GAIN:g}"),
        )
    if _number_wins(model, chosen, attempts, p_value, alpha):
        return False, "cannot tell", FREED
    if found.is_left and not share >= MIN_SHARE:
        rivals = [
            a
            for a in attempts
            if not a.reason
            and a.name != chosen.name
            and a.fit.bic(n_eff) - chosen.fit.bic(n_eff) < TIE_BIC
        ]
        verdict = "cannot tell" if rivals else "seen, not adopted"
        return (
            False,
            verdict,
            (
                f"the best term removes only {max(share, 0):.0%} of the held-out error above the "
                f"noise floor, less than {MIN_SHARE:.0%}, and leaves more than noise: the cause is "
                "not among the laws tried"
            ),
        )
    blurred = _blurred(model.fit, after.fit)
    if blurred:
        return (
            False,
            "seen, not adopted",
            (f"beside it {blurred}: these data hardly tell the two terms apart"),
        )
    if not observation.is_exact and (not held_out > 0 or ratio.low > 1):
        return (
            False,
            "seen, not adopted",
            (
                f"held-out tracks do not confirm it: their chi-squared falls by {held_out:.3g}, "
                f"the error of predictions has the ratio {ratio.value:.2f} "
                f"[{ratio.low:.2f}, {ratio.high:.2f}]"
            ),
        )
    extra = f"; it takes the place of {', '.join(chosen.replaces)}" if chosen.replaces else ""
    return (
        True,
        "effect adopted",
        (
            f"BIC falls by {gain:.1f}, p = {p_value:.3g} with the selection counted, and "
            + _on_held_out(observation, share, held_out, ratio)
            + extra
        ),
    )


def _on_held_out(observation, share, gain, ratio):
    """What held-out data say of an adopted term."""
    if share >= MIN_SHARE and (observation.is_exact or ratio.high < 1):
        return f"{share:.0%} of the held-out error above the noise floor is gone"
    return (
        f"held-out tracks confirm it (their chi-squared falls by {gain:.3g}), though noise hides "
        "most of what it does to predictions"
    )


@dataclass(frozen=True, eq=False)
class _Refuted:
    """A declared term is out, the found one in its place."""

    chosen: Attempt
    after: Model
    ratio: object
    reason: str
    rival: Rival


def _in_place(observation, model, both, chosen, attempts, p_value, alpha, rng):
    """The found term in place of a declared one, if it passes there and the two beside it do not.

    `both` is the model with the two. The term alone must pass every test of a new term against
    the declared law, and the declared term, added to it again, must fail as a further term.
    """
    attempt = in_place_of_declared(observation, model, chosen)
    if attempt is None or not np.isfinite(attempt.fit.chisqr):
        return None
    after = evaluate(observation, attempt.law, attempt.fit)
    floor, copies = observation.floor(after.law, rng)
    ratio = observation.ratio(model.rows, after.rows, rng, copies, model.law, after.law)
    found = _weighed(observation, model, after, floor, ratio, alpha)
    adopted, _, reason = _verdict(
        observation, model, after, attempt, attempts, found, p_value, alpha
    )
    if not adopted or _explained(observation, after.errors, both.errors, floor) >= MIN_SHARE:
        return None
    left = observation.headline_error(both.law) / observation.headline_error(after.law)
    rival = refuted_rival(model, attempt, chosen, left)
    return _Refuted(attempt, after, ratio, reason, rival)


def _number_wins(model, chosen, attempts, p_value, alpha):
    """Whether something is there, and a change of a declared number explains it best."""
    n_eff = chosen.fit.n_effective
    if p_value > alpha or model.fit.bic(n_eff) - chosen.fit.bic(n_eff) < MIN_BIC_GAIN:
        return False
    return any(a.redoes_declared and _is_better(a.fit, chosen.fit, n_eff) for a in attempts)


def _is_better(fit, other, n_eff):
    """Whether a fit is clearly better: by its BIC; on exact data by leaving next to nothing."""
    if fit.is_exact:
        return fit.chisqr < 0.01 * other.chisqr
    return fit.bic(n_eff) < other.bic(n_eff) - TIE_BIC


def _blurred(before, after):
    """Which constant loses its meaning when a term is added; "" if none does.

    A term that nearly repeats one of the law's inflates that one's error bar and may flip its
    sign; it explains nothing that can be named.
    """
    for name, was, width in blurred_constants(before, after):
        return f"the relative error of {name} grows from {was:.1g} to {width:.1g}"
    return ""


def _explained(observation, before, after, floor):
    """Share of the squared held-out error above the floor that is gone."""
    if observation.is_exact:
        b, a, f = before.residual_acceleration, after.residual_acceleration, 0.0
    else:
        b, a, f = before.rollout_rmse, after.rollout_rmse, floor.rollout_rmse
    above = b**2 - f**2
    if not above > 0:
        return 0.0
    return float((b**2 - a**2) / above)


def _quiet_round(number, missing, model, floor, started):
    return Round(
        number,
        missing,
        None,
        (),
        False,
        "the residual is as large and as uncorrelated as the noise: nothing is missing that these "
        "data could show",
        model.errors,
        None,
        floor,
        None,
        (),
        "",
        time.perf_counter() - started,
        "nothing missing",
    )


def _noise_round(number, observation, missing, model, floor, started):
    unit = observation.dataset.units.text(Unit.of(s=1))
    return Round(
        number=number, missing=missing, effect=None, rivals=(), adopted=False,
        reason=(
            "positions are wrong for longer than a frame, and that explains what is left: noise "
            f"with a memory of {observation.memory:.2g} {unit} leaves as much, so no law is needed "
            "and none can be seen"
        ),
        before=model.errors, after=None, floor=floor, ratio=None, held_out=(), certificate="",
        seconds=time.perf_counter() - started, verdict="cannot tell",
        noise_memory=observation.memory,
    )  # fmt: skip


def _empty_round(number, missing, model, floor, proposals, attempts, freed, started):
    rivals = [
        Rival(
            a.name,
            a.kind,
            a.text,
            a.latex,
            float("nan"),
            a.share,
            float("nan"),
            a.complexity,
            a.reason,
        )
        for a in attempts
    ]
    return Round(
        number,
        missing,
        None,
        (*rivals, *freed),
        False,
        "something is left, but every law that was tried is ruled out by its sign or is only a "
        "change of a declared number",
        model.errors,
        None,
        floor,
        None,
        (),
        "; ".join(proposals.certificates),
        time.perf_counter() - started,
        "seen, not adopted",
    )
