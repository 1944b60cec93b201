"""One turn of the loop: what is missing, which term explains it, is it real, what did it buy."""

from __future__ import annotations

import time
from dataclasses import replace

from bsp_gp.language.render import to_text
from bsp_gp.loop.attempts import attempts_of, choose, evaluate, named
from bsp_gp.loop.defects import defect_rivals
from bsp_gp.loop.endings import (
    Streams,
    Turn,
    ends_empty,
    ends_in_law,
    ends_in_noise,
    ends_in_rival,
    ends_quiet,
)
from bsp_gp.loop.guide import guided
from bsp_gp.loop.known import joined, known_attempts, leaves_noise
from bsp_gp.loop.measurement import measurement_rivals
from bsp_gp.loop.memory import search_with_memory
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.rivals import explanations, winner_of, without_memory
from bsp_gp.loop.telling import freed_attempt
from bsp_gp.loop.trace import trace_residual
from bsp_gp.loop.verdict import MIN_BIC_GAIN, number_wins

__all__ = ["run_round"]

MOST_REFINEMENTS = 2
MOST_BESIDE_DEFECT = 2
"""Laws that are fitted beside a defect of the tracks that leaves noise alone."""


def run_round(
    number, model, search, alpha, rng, progress, workers=None, n_bootstrap=99, guide="order",
    ask_held_out=True,
):  # fmt: skip
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
    ask_held_out : bool
        Whether the held-out tracks are asked as well before nothing is called missing.

    Returns
    -------
    round : Round
    model : Model
        The one to go on with: the new one if a term was adopted.
    search : EffectSearch
        On the observation with the noise under which `model` was fitted.
    """
    turn = Turn(
        number=number, model=model, search=search, entering=model, complete=search, alpha=alpha,
        rngs=Streams(*rng.spawn(len(Streams._fields))), progress=progress, workers=workers,
        n_bootstrap=n_bootstrap, ask_held_out=ask_held_out, started=time.perf_counter(),
    )  # fmt: skip
    turn.says("testing the residual against noise")
    turn.missing = examine_residual(turn.observation, model.fit, alpha)
    if not turn.missing.is_missing:
        return ends_quiet(turn)
    turn.says("tracing the residual")
    turn.trace = turn.first_trace = trace_residual(turn.observation, model.fit, turn.rngs.trace)
    turn.search, turn.guidance = guided(search, turn.trace, guide)
    turn.first_guidance = turn.guidance
    ended = _defect_alone(turn)
    if ended is not None:
        return ended
    known, ended = _search(turn)
    if ended is not None:
        return ended
    observation, model = turn.observation, turn.model
    turn.says(f"fitting {len(turn.proposals.shortlist)} proposals jointly")
    attempts = attempts_of(observation, model, turn.proposals, workers)
    n_failed = len(turn.proposals.shortlist) - len(attempts)
    attempts = joined(attempts, known)
    chosen = choose(observation, model, turn.search, attempts, alpha)
    chosen, turn.attempts, near = _along_the_best(turn, chosen, attempts)
    shown = _told_of(turn, chosen)
    turn.says("weighing errors of the measurement")
    laws = [a.fit for a in (shown, *turn.attempts) if a is not None]
    least = min((fit.chisqr for fit in laws), default=None)
    others = explanations(observation, model, turn.rngs.rival, workers, least)
    if observation is not turn.complete.observation and not observation.is_exact:
        simpler, seen, weighed = without_memory(
            turn.complete, turn.entering, shown, turn.rngs.memory, alpha, workers
        )
        if simpler is not None:
            return ends_in_rival(_as_it_began(turn, turn.missing, weighed), simpler, seen)
    winner = winner_of(model, laws, others)
    if winner is not None:
        return ends_in_rival(turn, winner, others)
    if shown is None:
        return ends_empty(turn, others)
    return ends_in_law(turn, shown, chosen, near, others, n_failed)


def _defect_alone(turn):
    """The end of the round, where a defect of single tracks leaves nothing but noise; else None.

    Swapped and lost tracks show in the positions, whatever the law; laws that are fitted to them
    lead nowhere and take long. So the best of the search alone are weighed beside a defect.
    """
    observation, model = turn.observation, turn.model
    alone = [e for e in defect_rivals(observation, model) if not e.reason]
    alone = [e for e in alone if examine_residual(e.observation, e.fit, turn.alpha).is_noise]
    if not alone:
        return None
    least = min(alone, key=lambda e: e.fit.chisqr)
    turn.says(f"weighing {least.name}")
    turn.proposals = turn.search.propose(model.fit, turn.rngs.search)
    best = replace(turn.proposals, shortlist=turn.proposals.shortlist[:MOST_BESIDE_DEFECT])
    turn.attempts = attempts_of(observation, model, best, turn.workers)
    others = measurement_rivals(
        observation, model, turn.rngs.rival, workers=turn.workers, to_beat=least.fit.chisqr
    )
    winner = winner_of(model, [a.fit for a in turn.attempts], others)
    if winner is None or winner.name not in {e.name for e in alone}:
        return None
    return ends_in_rival(turn, winner, others)


def _search(turn):
    """Search for what is missing, the noise estimated beside it where it may have a memory.

    Returns
    -------
    known : list of Attempt
        What needed no search.
    ended : tuple or None
        The end of the round, where a memory of the noise explains what is left.
    """
    turn.says("searching for what is missing")
    observation, model, search = turn.observation, turn.model, turn.search
    known = known_attempts(search, model, turn.missing, turn.alpha)
    # Along tracks that lack a strong effect everything looks like noise with a memory.
    if observation.may_have_memory and leaves_noise(observation, known, turn.alpha):
        turn.proposals = search.propose(model.fit, turn.rngs.search)
        return known, None
    turn.search, fit, turn.proposals = search_with_memory(search, model.fit, turn.rngs.search)
    if turn.observation is observation:
        return known, None
    turn.model = evaluate(turn.observation, fit.law, fit)
    entered = turn.missing
    turn.missing = examine_residual(turn.observation, fit, turn.alpha)
    _trace_again(turn)
    if turn.missing.is_missing:
        return known_attempts(turn.search, turn.model, turn.missing, turn.alpha), None
    if not turn.observation.memory or turn.missing.is_failed:
        return known, ends_quiet(turn)
    # What was measured wrongly looks like noise with a memory, too.
    simpler, seen, _ = without_memory(
        turn.complete, turn.entering, None, turn.rngs.memory, turn.alpha, turn.workers
    )
    if simpler is None:
        return known, ends_in_noise(turn)
    # Nothing is to be seen that a simulation could show to be chance.
    turn = replace(_as_it_began(turn, entered, []), n_bootstrap=0)
    return known, ends_in_rival(turn, simpler, seen)


def _trace_again(turn):
    """The trace under the noise that was found; what a search was restricted to stays as it was."""
    turn.says("tracing the residual under the noise that was found")
    turn.trace = trace_residual(turn.observation, turn.model.fit, turn.rngs.trace)
    if turn.guidance.used == "order":
        _, turn.guidance = guided(turn.search, turn.trace, "order")


def _as_it_began(turn, missing, attempts):
    """The turn under the noise with which the round began."""
    return replace(
        turn, search=turn.complete, model=turn.entering, missing=missing, attempts=attempts,
        trace=turn.first_trace, guidance=turn.first_guidance,
    )  # fmt: skip


def _along_the_best(turn, chosen, attempts):
    """Search again at the states of the best attempt, until it stays the best.

    A model that lacks much leads its tracks far astray; laws are then better told apart along
    the track of even a rough stand-in. Also returned are the texts of all laws that are not ruled
    out there.
    """
    observation, model, search = turn.observation, turn.model, turn.search
    near = ()
    for _ in range(MOST_REFINEMENTS):
        if chosen is None or observation.is_exact or chosen.n_effects > 1:
            break
        again = search.propose(model.fit, turn.rngs.search, along=chosen.fit, n_null=0)
        near = tuple(to_text(named(p, model.law)) for p in again.near)
        known = {attempt.text for attempt in attempts}
        fresh = attempts_of(observation, model, again, turn.workers)
        fresh = [a for a in fresh if a.text not in known]
        attempts = [*attempts, *fresh]
        better = choose(observation, model, search, attempts, turn.alpha)
        if not fresh or better.text == chosen.text:
            break
        chosen = better
    return chosen, attempts, near


def _told_of(turn, chosen):
    """The attempt that a round tells of: the chosen one, a freed number that wins, or None."""
    observation, model, attempts = turn.observation, turn.model, turn.attempts
    p_value, alpha = turn.proposals.p_value, turn.alpha
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
