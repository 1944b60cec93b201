"""One turn of the loop: what is missing, which term explains it, is it real, what did it buy."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from bsp_gp.language.render import to_text
from bsp_gp.loop.attempts import attempts_of, choose, evaluate, named
from bsp_gp.loop.bootstrap import bootstrap, strength
from bsp_gp.loop.guide import guided, ordered
from bsp_gp.loop.known import joined, known_attempts, leaves_noise
from bsp_gp.loop.memory import estimate_memory, search_with_memory, with_memory
from bsp_gp.loop.outcome import Rival, Round
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.rivals import (
    as_attempt,
    explanations,
    judge,
    rival_rows,
    told_beside,
    winner_of,
    without_memory,
)
from bsp_gp.loop.telling import (
    effect_of,
    freed_attempt,
    freed_effect,
    freed_numbers,
    held_out_rows,
    rivals_of,
)
from bsp_gp.loop.trace import trace_residual
from bsp_gp.loop.verdict import FREED, MIN_BIC_GAIN, number_wins, put_in_place, verdict_of, weigh
from bsp_gp.units import Unit

__all__ = ["run_round"]

STRONG = 5.0
"""Multiple of the greatest evidence in simulated residuals beyond which no data sets are simulated
and searched: nothing that this leaves out of account is as large."""


MOST_REFINEMENTS = 2


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
    search_rng, floor_rng, ratio_rng, trace_rng, bootstrap_rng, *rival_rngs = rng.spawn(7)
    progress(f"round {number}: testing the residual against noise")
    missing = examine_residual(observation, model.fit, alpha)
    if not missing.is_missing:
        floor, _ = observation.floor(model.law, floor_rng)
        return _quiet_round(number, missing, model, floor, started), model, search
    progress(f"round {number}: tracing the residual")
    trace = trace_residual(observation, model.fit, trace_rng)
    # The choice of channels has looked at the data: what tests a finding knows nothing of it.
    complete = (search, model.fit)
    entering = model
    search, guidance = guided(search, trace, guide)
    progress(f"round {number}: searching for what is missing")
    known = known_attempts(search, model, missing, alpha)
    fit = model.fit
    # Along tracks that lack a strong effect everything looks like noise with a memory.
    if observation.may_have_memory and leaves_noise(observation, known, alpha):
        proposals = search.propose(fit, search_rng)
    else:
        search, fit, proposals = search_with_memory(search, fit, search_rng)
    if search.observation is not observation:
        observation = search.observation
        model = evaluate(observation, fit.law, fit)
        entered, missing = missing, examine_residual(observation, fit, alpha)
        if not missing.is_missing:
            if observation.memory:  # but what was measured wrongly looks like that, too
                simpler, seen, _ = without_memory(
                    complete[0], entering, None, rival_rngs[1], alpha, workers
                )
                if simpler is not None:
                    told = (number, entered, proposals, trace, guidance, started)
                    return _round_of_rival(
                        complete[0], entering, simpler, seen, [],
                        lambda evidence: (proposals.p_value, ""), alpha, ratio_rng, told,
                    )  # fmt: skip
            floor, _ = observation.floor(model.law, floor_rng)
            if observation.memory:
                done = _noise_round(number, observation, missing, model, floor, started)
            else:
                done = _quiet_round(number, missing, model, floor, started)
            return replace(done, trace=trace), model, search.whole or search
        known = known_attempts(search, model, missing, alpha)
    progress(f"round {number}: fitting {len(proposals.shortlist)} proposals jointly")
    attempts = attempts_of(observation, model, proposals, workers)
    n_failed = len(proposals.shortlist) - len(attempts)
    attempts = joined(attempts, known)
    chosen = choose(observation, model, search, attempts, alpha)
    chosen, attempts, near = _along_the_best(
        observation, model, search, chosen, attempts, alpha, search_rng, workers
    )
    shown = _told_of(observation, model, chosen, attempts, proposals.p_value, alpha)
    progress(f"round {number}: weighing errors of the measurement")
    rival_rng, memory_rng = rival_rngs
    laws = [a.fit for a in (shown, *attempts) if a is not None]
    least = min((fit.chisqr for fit in laws), default=None)
    others = explanations(observation, model, rival_rng, workers, least)

    def significance(evidence):
        """p-value of a finding of this evidence, nats, and how it came about."""
        is_weak = evidence < STRONG * max(proposals.null_evidence, 0.0)
        is_open = proposals.p_value <= alpha and is_weak and n_bootstrap
        if not is_open or observation.is_exact:
            return proposals.p_value, ""
        progress(f"round {number}: the same search on simulated data")
        found = bootstrap(
            *complete, evidence, bootstrap_rng, alpha=alpha, n_max=n_bootstrap, workers=workers
        )
        return found.p_value, found.text()

    told = (number, missing, proposals, trace, guidance, started)
    if observation is not complete[0].observation and not observation.is_exact:
        simpler, seen, weighed = without_memory(
            complete[0], entering, shown, memory_rng, alpha, workers
        )
        if simpler is not None:
            return _round_of_rival(
                complete[0], entering, simpler, seen, weighed, significance, alpha, ratio_rng, told
            )
    winner = winner_of(model, laws, others)
    if winner is not None:
        return _round_of_rival(
            search, model, winner, others, attempts, significance, alpha, ratio_rng, told
        )
    if shown is None:
        floor, _ = observation.floor(model.law, floor_rng)
        ranked, ruled_out = rival_rows(model, model.fit, others)
        rivals = [*ranked, *freed_numbers(observation, model), *ruled_out]
        empty = _empty_round(number, missing, model, floor, proposals, attempts, rivals, started)
        return replace(empty, trace=trace, guidance=guidance), model, search.whole or search
    is_freed = shown is not chosen
    p_value, how = proposals.p_value, ""
    if np.isfinite(shown.p_value):  # it was tested by itself, beside the search
        p_value = min(1.0, 2 * min(p_value, shown.p_value))
    elif not is_freed:
        p_value, how = significance(strength(proposals))
    progress(f"round {number}: weighing {shown.name} on held-out data")
    after = evaluate(observation, shown.law, shown.fit)
    floor, copies = observation.floor(after.law, floor_rng)
    ratio = observation.ratio(model.rows, after.rows, ratio_rng, copies, model.law, after.law)
    if is_freed:
        adopted, verdict, reason = False, "cannot tell", FREED
        if shown.freed:
            effect = effect_of(observation, shown, attempts, p_value, near)
        else:
            effect = freed_effect(observation, model, shown, p_value)
    else:
        found = weigh(observation, model, after, floor, ratio, alpha)
        adopted, verdict, reason = verdict_of(
            observation, model, after, chosen, attempts, found, p_value, alpha
        )
        refuted = None
        if not adopted:
            refuted = put_in_place(
                observation, model, after, chosen, attempts, p_value, alpha, ratio_rng
            )
        if refuted is not None:
            chosen = shown = refuted.chosen
            adopted, verdict, reason = True, "effect adopted", refuted.reason
            after, ratio = refuted.after, refuted.ratio
        effect = effect_of(observation, chosen, attempts, p_value, near)
    effect, rivals = ordered(effect, rivals_of(observation, model, shown, attempts), guidance)
    effect, undecided = told_beside(observation, effect, shown, others)
    if undecided and adopted:  # of use for predictions, but no name to be sure of
        verdict = "cannot tell"
        reason += f"; {' and '.join(undecided)} would explain these data as well"
    ranked, ruled_out = rival_rows(model, shown.fit, others)
    rivals = [
        *rivals, *ranked, *freed_numbers(observation, model, chosen, is_freed), *ruled_out
    ]  # fmt: skip
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
        undecided=undecided,
    )
    search = search.whole or search
    if not adopted:
        return done, model, search
    return done, *_without_spurious_memory(after, search)


def _round_of_rival(search, model, winner, others, attempts, significance, alpha, rng, told):
    """A round whose effect is no force between visible bodies."""
    number, missing, proposals, trace, guidance, started = told
    observation = search.observation
    counted = as_attempt(winner)
    n_eff = counted.fit.n_effective
    p_value, how = proposals.p_value, ""
    if "p_value" not in winner.details:  # else the chance of it is known from its own likelihood
        p_value, how = significance((model.fit.bic(n_eff) - counted.fit.bic(n_eff)) / 2)
    judged = judge(observation, model, winner, others, p_value, alpha, rng)
    ranked, ruled_out = rival_rows(model, counted.fit, others, but=winner)
    rivals = [
        *rivals_of(observation, model, counted, attempts), *ranked,
        *freed_numbers(observation, model, against=counted.fit), *ruled_out,
    ]  # fmt: skip
    done = Round(
        number=number, missing=missing, effect=judged.effect, rivals=tuple(rivals),
        adopted=judged.adopted, reason=judged.reason, before=model.errors,
        after=judged.after.errors, floor=judged.floor, ratio=judged.ratio,
        held_out=tuple(held_out_rows(model.rows, judged.after.rows)),
        certificate="; ".join(proposals.certificates), seconds=time.perf_counter() - started,
        verdict=judged.verdict, significance=how, noise_memory=observation.memory, trace=trace,
        guidance=guidance,
    )  # fmt: skip
    search = search.whole or search
    if not judged.adopted:
        return done, model, search
    return done, *_without_spurious_memory(judged.after, search.on(winner.observation))


def _without_spurious_memory(model, search):
    """Model and search under white noise, if the adopted law leaves no trace of a memory.

    What a search sees of a strong effect, evaluated along a track that lacks it, looks like noise
    with a memory.
    """
    observation = search.observation
    if not (observation.memory and observation.may_have_memory):
        return model, search
    noise = estimate_memory(search, model.fit)
    if noise.memory:
        return model, search
    search = search.on(with_memory(observation, 0.0, noise.factor))
    return evaluate(search.observation, model.law), search


def _along_the_best(observation, model, search, chosen, attempts, alpha, rng, workers):
    """Search again at the states of the best attempt, until it stays the best.

    A model that lacks much leads its tracks far astray; laws are then better told apart along
    the track of even a rough stand-in. Also returned are the texts of all laws that are not ruled
    out there.
    """
    near = ()
    for _ in range(MOST_REFINEMENTS):
        if chosen is None or observation.is_exact or chosen.n_effects > 1:
            break
        again = search.propose(model.fit, rng, along=chosen.fit, n_null=0)
        near = tuple(to_text(named(p, model.law)) for p in again.near)
        known = {attempt.text for attempt in attempts}
        fresh = [a for a in attempts_of(observation, model, again, workers) if a.text not in known]
        attempts = [*attempts, *fresh]
        better = choose(observation, model, search, attempts, alpha)
        if not fresh or better.text == chosen.text:
            break
        chosen = better
    return chosen, attempts, near


def _told_of(observation, model, chosen, attempts, p_value, alpha):
    """The attempt that a round tells of: the chosen one, a freed number that wins, or None."""
    if chosen is not None and not number_wins(model, chosen, attempts, p_value, alpha):
        return chosen
    if p_value > alpha or not any(a.redoes_declared for a in attempts):
        return chosen
    freed = freed_attempt(observation, model)
    if freed is None:
        return chosen
    n_eff = freed.fit.n_effective
    wider = [a for a in attempts if a.redoes_declared and a.freed]
    freed = min((freed, *wider), key=lambda a: a.fit.bic(n_eff))
    if chosen is None and min(a.fit.chisqr for a in attempts) < freed.fit.chisqr:
        return None  # what is ruled out explains more: the number is no cause
    is_clear = model.fit.bic(n_eff) - freed.fit.bic(n_eff) >= MIN_BIC_GAIN
    return freed if is_clear else chosen


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
