"""How a round ends: with nothing, with noise, with a law, with another explanation."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bsp_gp.errors import ResourceError
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.before_after import compared
from bsp_gp.loop.bootstrap import bootstrap, strength
from bsp_gp.loop.dropping import FAULTS
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.guide import ordered
from bsp_gp.loop.memory import estimate_memory, p_value_of, widened, with_memory
from bsp_gp.loop.outcome import Missing, Rival, Round
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.rivals import (
    UNOPPOSED,
    as_attempt,
    is_unopposed,
    judge,
    rival_rows,
    told_beside,
)
from bsp_gp.loop.seeing import with_scenes
from bsp_gp.loop.telling import effect_of, freed_effect, freed_numbers, held_out_rows, rivals_of
from bsp_gp.loop.verdict import FREED, TURNED, put_in_place, verdict_of, weigh
from bsp_gp.units import Unit

__all__ = [
    "Streams", "Turn", "ends_empty", "ends_in_law", "ends_in_noise", "ends_in_rival", "ends_quiet",
]  # fmt: skip

STRONG = 5.0
"""Multiple of the greatest evidence in simulated residuals beyond which no data sets are simulated
and searched: nothing that this leaves out of account is as large."""
FAILED = (
    "the model could not be fitted: it has no finite value along these tracks, so that what it "
    "leaves could not be tested"
)


class Streams(NamedTuple):
    """Random numbers of a round, a stream for each purpose."""

    search: np.random.Generator
    floor: np.random.Generator
    ratio: np.random.Generator
    trace: np.random.Generator
    bootstrap: np.random.Generator
    rival: np.random.Generator
    memory: np.random.Generator


@dataclass
class Turn:
    """What is known in the course of a round.

    Attributes
    ----------
    number : int
    model : Model
        The one that the round is about, under the noise of `search`.
    search : EffectSearch
        With the observation; narrowed by the trace where that was asked for.
    entering : Model
        As the round began.
    complete : EffectSearch
        As the round began: the choice of channels looks at the data, what tests a finding knows
        nothing of it.
    alpha : float
    rngs : Streams
    progress : callable
    workers : concurrent.futures.Executor or None
    n_bootstrap : int
    ask_held_out : bool
    started : float
        Of `time.perf_counter`.
    missing : Missing
    trace : Trace
        Under the noise of `search`.
    guidance : Guidance
    first_trace : Trace
    first_guidance : Guidance
        As the round began.
    proposals : Proposals
    attempts : list of Attempt
    """

    number: int
    model: object
    search: object
    entering: object
    complete: object
    alpha: float
    rngs: Streams
    progress: object
    workers: object
    n_bootstrap: int
    ask_held_out: bool
    started: float
    missing: Missing = None
    trace: object = None
    guidance: object = None
    first_trace: object = None
    first_guidance: object = None
    proposals: object = None
    attempts: list = None

    @property
    def observation(self):
        return self.search.observation

    def says(self, text):
        """Tell what is being done."""
        self.progress(f"round {self.number}: {text}")

    def is_clear(self, evidence):
        """Whether a finding is so far beyond all simulated residuals that no more are needed."""
        return evidence >= STRONG * max(self.proposals.null_evidence, 1.0)

    def significance(self, evidence):
        """p-value of a finding of this evidence, nats, and how it came about."""
        proposals = self.proposals
        is_weak = not self.is_clear(evidence)
        is_open = proposals.p_value <= self.alpha and is_weak and self.n_bootstrap
        if not is_open or self.observation.is_exact:
            return proposals.p_value, ""
        self.says("the same search on simulated data")
        found = bootstrap(
            self.complete, self.entering.fit, evidence, self.rngs.bootstrap, alpha=self.alpha,
            n_max=self.n_bootstrap, workers=self.workers,
        )  # fmt: skip
        return found.p_value, found.text()

    def floor(self):
        """Noise floor of the law as it stands."""
        return self.observation.floor(self.model.law, self.rngs.floor)[0]

    def unchanged(self, done):
        """What a round without an adoption hands on: (round, model, search)."""
        return done, self.model, self.search.whole or self.search

    def changed(self, done, after, search):
        """What a round with an adoption hands on: (round, model, search)."""
        return done, *_without_spurious_memory(after, search.whole or search)

    def round(self, errors=None, **told):
        """The round, of what is known, what held-out data say (`BeforeAfter`) and `told`."""
        if errors is None:
            told.update(before=self.model.errors, after=None, ratio=None)
        else:
            told.update(before=errors.before, after=errors.after, ratio=errors.ratio,
                        ratios=errors.ratios)  # fmt: skip
        told = {"certificate": "; ".join(self.proposals.certificates) if self.proposals else "",
                "trace": self.trace, "guidance": self.guidance,
                "noise_memory": self.observation.memory, **told}  # fmt: skip
        seconds = time.perf_counter() - self.started
        return Round(number=self.number, missing=self.missing, seconds=seconds, **told)


def ends_quiet(turn):
    """A round that finds nothing missing from the tracks that it learns from."""
    verdict, reason = "nothing missing", (
        "the residual is as large and as uncorrelated as the noise: nothing is missing that these "
        "data could show"
    )  # fmt: skip
    if turn.missing.is_failed:
        return turn.unchanged(turn.round(
            effect=None, rivals=(), adopted=False, floor=turn.floor(), held_out=(),
            verdict="cannot tell", certificate="", reason=FAILED,
        ))  # fmt: skip
    there = _held_out(turn)
    if there is not None and there.is_missing:
        verdict, reason = "cannot tell", (
            "nothing is missing from the tracks that were learned from, but the held-out ones "
            "leave more than noise even when the law is fitted to them (p = "
            f"{there.p_value:.3g}): what is missing shows there; a split that learns from some of "
            "them can find it"
        )  # fmt: skip
    return turn.unchanged(turn.round(
        effect=None, rivals=(), adopted=False, floor=turn.floor(),
        held_out=(), verdict=verdict, certificate="", reason=reason, missing_held_out=there,
    ))  # fmt: skip


def _held_out(turn):
    """What is missing from the held-out tracks when the law is fitted to them; None if unasked."""
    observation, law = turn.observation, turn.model.law
    if not turn.ask_held_out or observation.is_exact or observation.velocity == "measured":
        return None
    try:
        there = with_scenes(observation, observation.test, observation.train)
        fit = there.fit(law, sign_bounds(there, law), start=law)
    except ResourceError:
        raise
    except FAULTS:  # too few rows, or the law has no value there
        return None
    return examine_residual(there, fit, turn.alpha)


def ends_in_noise(turn):
    """A round in which noise with a memory explains what is left."""
    unit = turn.observation.dataset.units.text(Unit.of(s=1))
    return turn.unchanged(turn.round(
        effect=None, rivals=(), adopted=False, floor=turn.floor(),
        held_out=(), verdict="cannot tell", certificate="",
        reason=(
            "positions are wrong for longer than a frame, and that explains what is left: noise "
            f"with a memory of {turn.observation.memory:.2g} {unit} leaves as much, so no law is "
            "needed and none can be seen"
        ),
    ))  # fmt: skip


def ends_empty(turn, others):
    """A round in which something is left and no law is able to explain it."""
    ranked, ruled_out = rival_rows(turn.model, turn.model.fit, others)
    tried = [
        Rival(a.name, a.kind, a.text, a.latex, float("nan"), a.share, float("nan"), a.complexity,
              a.reason)
        for a in turn.attempts
    ]  # fmt: skip
    rivals = [*tried, *ranked, *freed_numbers(turn.observation, turn.model), *ruled_out]
    return turn.unchanged(turn.round(
        effect=None, rivals=tuple(rivals), adopted=False, floor=turn.floor(),
        held_out=(), verdict="seen, not adopted",
        reason=(
            "something is left, but every law that was tried is ruled out by its sign or is only "
            "a change of a declared number"
        ),
    ))  # fmt: skip


def ends_in_rival(turn, winner, others):
    """A round whose effect is no force between visible bodies.

    Parameters
    ----------
    turn : Turn
    winner : Explanation
    others : list of Explanation
        What it was weighed with.
    """
    observation, model, search = turn.observation, turn.model, turn.search
    counted = as_attempt(winner)
    n_eff = counted.fit.n_effective
    p_value, how = turn.proposals.p_value, ""
    if "p_value" not in winner.details:  # else the chance of it is known from its own likelihood
        p_value, how = turn.significance((model.fit.bic(n_eff) - counted.fit.bic(n_eff)) / 2)
    judged = judge(observation, model, winner, others, p_value, turn.alpha, turn.rngs.ratio)
    if judged.adopted and is_unopposed(observation, others):
        judged = replace(judged, adopted=False, verdict="seen, not adopted", reason=UNOPPOSED)
    ranked, ruled_out = rival_rows(model, counted.fit, others, but=winner)
    rivals = [
        *rivals_of(observation, model, counted, turn.attempts), *ranked,
        *freed_numbers(observation, model, against=counted.fit), *ruled_out,
    ]  # fmt: skip
    done = turn.round(
        effect=judged.effect, rivals=tuple(rivals), adopted=judged.adopted, reason=judged.reason,
        errors=judged.errors, floor=judged.floor, significance=how,
        held_out=tuple(held_out_rows(model.rows, judged.after.rows)), verdict=judged.verdict,
    )  # fmt: skip
    if not judged.adopted:
        return turn.unchanged(done)
    whole = search.whole or search
    return turn.changed(done, judged.after, whole.on(winner.observation))


def ends_in_law(turn, shown, chosen, near, others, n_failed):
    """A round that tells of a law, or of another number in a declared one.

    Parameters
    ----------
    turn : Turn
    shown : Attempt
    chosen : Attempt or None
        The best law, which is `shown` unless a declared number is.
    near : tuple of str
        Laws that were not fitted to whole tracks and are not ruled out.
    others : list of Explanation
    n_failed : int
        Proposals without a finite fit.
    """
    observation, model, alpha = turn.observation, turn.model, turn.alpha
    is_freed = shown is not chosen
    p_value, how, is_clear = turn.proposals.p_value, "", False
    if np.isfinite(shown.p_value):  # it was tested by itself, beside the search
        own = shown.p_value
        if 2 * own <= alpha:
            own = p_value_of(turn.search, model.fit, shown.fit, own)
        if 2 * own > alpha:
            p_value, how = turn.significance(strength(turn.proposals))
        p_value = min(1.0, 2 * min(p_value, own))
    elif not is_freed:
        p_value, how = turn.significance(strength(turn.proposals))
        is_clear = turn.is_clear(strength(turn.proposals))
    turn.says(f"weighing {shown.name} on held-out data")
    after = evaluate(observation, shown.law, shown.fit)
    floor, copies = observation.floor(after.law, turn.rngs.floor)
    errors = compared(observation, model, after, copies, turn.rngs.ratio)
    refuted = None
    if is_freed:
        adopted, verdict, reason = False, "cannot tell", FREED
        if shown.freed:
            effect = effect_of(observation, shown, turn.attempts, p_value, near)
        else:
            effect = freed_effect(observation, model, shown, p_value)
            reason = TURNED if effect.name.endswith("sign is wrong") else FREED
    else:
        found = weigh(observation, model, after, floor, errors.ratio, alpha, is_clear)
        adopted, verdict, reason = verdict_of(
            observation, model, after, chosen, turn.attempts, found, p_value, alpha
        )
        if not adopted:
            refuted = put_in_place(
                observation, model, after, chosen, turn.attempts, p_value, alpha, turn.rngs.ratio
            )
        if refuted is not None:
            chosen = shown = refuted.chosen
            adopted, verdict, reason = True, "effect adopted", refuted.reason
            after, errors = refuted.after, refuted.errors
        told = replace(chosen, fit=widened(turn.search, chosen.fit))
        effect = effect_of(observation, told, turn.attempts, p_value, near)
    if adopted and is_unopposed(observation, others):
        adopted, verdict, reason = False, "seen, not adopted", UNOPPOSED
    rivals = rivals_of(observation, model, shown, turn.attempts)
    effect, rivals = ordered(effect, rivals, turn.guidance)
    effect, undecided = told_beside(observation, effect, shown, others)
    if undecided and adopted:  # of use for predictions, but no name to be sure of
        verdict = "cannot tell"
        reason += f"; {' and '.join(undecided)} would explain these data as well"
    ranked, ruled_out = rival_rows(model, shown.fit, others)
    numbers = freed_numbers(observation, model, chosen, is_freed)
    first = [] if refuted is None else [refuted.rival]
    certificates = list(turn.proposals.certificates)
    if n_failed:
        certificates.append(f"{n_failed} proposals without a finite fit were left out")
    done = turn.round(
        effect=effect, rivals=(*first, *rivals, *ranked, *numbers, *ruled_out), adopted=adopted,
        reason=reason, errors=errors, floor=floor, significance=how,
        held_out=tuple(held_out_rows(model.rows, after.rows)), verdict=verdict,
        certificate="; ".join(certificates), undecided=undecided,
    )  # fmt: skip
    if not adopted:
        return turn.unchanged(done)
    return turn.changed(done, after, turn.search)


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
