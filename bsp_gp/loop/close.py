"""Closing the loop on a data set: made ready, rounds, removal of what is superfluous, report."""

import math
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace

from bsp_gp.data.blocks import in_blocks
from bsp_gp.data.logged import asked_of
from bsp_gp.data.scene import Dataset
from bsp_gp.data.stretches import in_stretches
from bsp_gp.data.torn import without_torn_ends
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.law_fit import (
    about_noise,
    constant_estimates,
)
from bsp_gp.fitting.parts.orbits import velocity_of
from bsp_gp.fitting.unseen import without_unseen
from bsp_gp.language.grammar import Grammar, load_grammar
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop import writing_up
from bsp_gp.loop.accounts import Accounts
from bsp_gp.loop.backward import prune
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.constancy import Constancy, constancy
from bsp_gp.loop.criteria import VERDICTS, Criteria
from bsp_gp.loop.foresight import is_refuted
from bsp_gp.loop.looks import Looks
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.outcome import LoopReport
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers import standard
from bsp_gp.loop.questions import hidden_bound
from bsp_gp.loop.ready import Ready
from bsp_gp.loop.slight import MOST_CAUSES
from bsp_gp.loop.unknown import unknowns
from bsp_gp.loop.view import View
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.metrics import METRICS
from bsp_gp.randomness import Random, generator
from bsp_gp.search.choice import BUDGET
from bsp_gp.workers import Crew

LATE_S = 3.0
"""Seconds after a time limit that errors on held-out rows may take; then they are left out."""
WRITING_SHARE = 0.25
"""Part of a time limit that is kept for what comes after the rounds."""
STREAMS = (
    "split", "rounds", "accounts", "swapped", "asked", "foresight", "parts", "flights", "retraced",
    "few",
)  # fmt: skip
"""Random streams, in this order: a new one at the end leaves the others as they are."""


def close_loop(
    dataset: Dataset, declared: ForceLaw | str | Sequence[str] = (), *, rng: Random = None,
    grammar: str | os.PathLike | Grammar = "physics", criteria: Criteria | None = None,
    alpha: float | None = None, max_rounds: int = 5, max_levels: int = 8,
    search: str = "exhaustive", search_budget: int = BUDGET,
    starts: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None, time_limit: float | None = None,
    n_bootstrap: int = 40, exclude: Sequence[str] = ("t",), seed: int | None = None,
    workers=None, progress=None, on_round: Callable | None = None, earlier=None,
    all_rows: bool = False,
) -> LoopReport:  # fmt: skip
    """Find what a declared model lacks, add it, and report the error before and after.

    Parameters
    ----------
    dataset : Dataset
    declared : ForceLaw, str or sequence of str
        The model that is believed: typed laws. Empty: no force at all.
    rng : numpy.random.Generator, int or None
        Splits, simulated noise, resampling.
    grammar : str, path or Grammar
        What may be missing.
    criteria : Criteria, optional
        Levels on which the verdict depends.
    alpha : float, optional
        One of them, in place of that of `criteria`.
    max_rounds, max_levels : int
        Rounds, and levels of a derivation in the search, at the most.
    search : str
        "exhaustive", of every law up to the bound; "cross_entropy" or "genetic", which take
        grammars that are no products as well; "auto": exhaustive where it can, and the others two
        levels beyond its bound.
    search_budget : int
        Laws of a kind that each of the others may score in a round.
    starts, bounds : dict, optional
        Of constants of the declared model, SI: where they begin, and between what they stay.
    time_limit : float, optional
        Seconds. What there is no time for is told, and never makes a verdict stronger.
    n_bootstrap : int
        Simulated copies of the held-out data behind the floor and intervals; 0 = none.
    exclude : sequence of str
        Inputs that laws may not use.
    seed : int, optional
        Recorded in the report.
    workers : concurrent.futures.Executor or distributed.Client, optional
        Who else may work; the answer does not depend on it.
    progress : callable, optional
        ``progress(text)`` at every stage.
    on_round : callable, optional
        ``on_round(round)`` after every round; `bsp_gp.loop.kept.text_of` makes text of them.
    earlier : str, optional
        Such text of a run with the same data and settings, to go on from.
    all_rows : bool
        Take every row as it is; by default long tracks of dense rows are averaged, recordings of
        very many turns cut into stretches, see `bsp_gp.data.blocks` and `bsp_gp.data.stretches`,
        and ends left out at which a hand moves the body.

    Returns
    -------
    LoopReport

    Raises
    ------
    BspError
        If the data, the law or a setting is unusable.
    """
    began = time.monotonic()
    criteria = _criteria(criteria, alpha)
    numbers = {
        "max_rounds": max_rounds, "max_levels": max_levels, "search_budget": search_budget,
        "n_bootstrap": n_bootstrap,
    }  # fmt: skip
    _check(dataset, criteria, numbers, time_limit)
    says = progress or (lambda text: None)
    clock = Clock(None if time_limit is None else (1 - WRITING_SHARE) * time_limit)
    streams = dict(zip(STREAMS, generator(rng).spawn(len(STREAMS)), strict=True))
    crew = Crew(workers, needs=run_rounds)
    says("reading the data set")
    known = {"t", *dataset.logged}
    dataset = without_torn_ends(asked_of(dataset, _words(declared), exclude))
    dataset = dataset if all_rows else in_stretches(in_blocks(dataset))
    ready = Ready(dataset, declared, streams["split"], all_rows)
    grammar = grammar if isinstance(grammar, Grammar) else load_grammar(grammar)
    unknown = sorted(set(exclude) - set(grammar.inputs) - known)
    if unknown:
        raise SettingsError(
            f"exclude names {unknown}, which are no inputs of grammar {grammar.name}; present are "
            f"{', '.join(sorted(grammar.inputs))}"
        )
    left = None if time_limit is None else time_limit - (time.monotonic() - began)
    looks = Looks(
        declared,
        lambda train: [
            p for p in standard(
                grammar, train, max_levels=max_levels, exclude=tuple(exclude), search=search,
                budget=search_budget,
            )
            if not (all_rows and p.name == "hands")
        ],
        clock=clock, until=Clock(None if left is None else left + LATE_S), starts=starts,
        bounds=bounds, all_rows=all_rows, progress=says,
        settings={"criteria": criteria, "max_rounds": max_rounds, "crew": crew,
                  "is_enough": _is_enough},
    )  # fmt: skip
    look = looks.found(ready, streams, earlier, on_round)
    ready, rounds = look.ready, look.rounds
    left = None if time_limit is None else time_limit - (time.monotonic() - began)
    pruned = prune(
        rounds, ready.train, criteria=criteria, bounds=bounds, clock=clock, late=Clock(left),
        progress=progress,
    )  # fmt: skip
    says("writing up")
    left = None if time_limit is None else time_limit - (time.monotonic() - began)
    whole, late = Clock(left), Clock(None if left is None else left + LATE_S)
    asked = None if whole.is_over else _asked(ready, rounds, pruned, streams["asked"], criteria)
    written = _written(
        ready, rounds, pruned, bounds, streams["accounts"], n_bootstrap, whole, asked, criteria,
        crew, late, look.foreseen,
    )
    left_out = [code for done in rounds for code in done.left_out]
    left_out += ["held_out"] if look.is_cut else []
    left_out += [] if look.is_all else ["rows"]
    left_out += [] if pruned.is_complete else ["removal"]
    left_out += written.pop("left_out")
    return LoopReport(
        declared=tuple(
            {
                "law": to_text(t.formula), "latex": to_latex(t.formula),
                "is_displaced": to_text(t.formula) in pruned.displaced,
            }
            for t in ready.law.terms
        ),
        grammar={"name": grammar.name, "fingerprint": grammar.fingerprint},
        search=search, seed=seed, criteria=asdict(criteria),
        stop_reason=_stop_reason(rounds), left_out=tuple(dict.fromkeys(left_out)),
        n_fits=sum(len(done.fits) - 1 for done in rounds) + 1 + pruned.n_fits,
        versions=writing_up.versions(), wall_s=time.monotonic() - began, **written,
    )  # fmt: skip


def _words(declared):
    """What declared laws name."""
    laws = (declared,) if isinstance(declared, str) else declared
    if isinstance(laws, ForceLaw):
        laws = [to_text(term.formula) for term in laws.terms]
    return set(re.findall(r"\w+", " ".join(laws)))


def _asked(ready, rounds, pruned, rng, criteria):
    """What is asked of what was found, under the final law."""
    first, last = rounds[0].entering, pruned.fit
    if last is first or last.is_failed or rounds[-1].is_last:
        return Constancy()
    view = View(last, continued(pruned.hypothesis, last), ready.train, rng, criteria)
    known = {term.formula for term in first.law.terms}
    found = [term for term in last.law.terms if term.formula not in known]
    gain = 2 * (last.log_likelihood - first.log_likelihood)
    return replace(
        constancy(view), unknown=unknowns(view, found, gain), bound=hidden_bound(view)
    )


def _written(
    ready, rounds, pruned, bounds, rng, n_copies, clock, asked, criteria, crew, late, foreseen
):  # fmt: skip
    """What is told of the rounds, the final law and the tracks, by names of `LoopReport`."""
    first, last, dataset = rounds[0].entering, pruned.fit, ready.train
    rounds = [_without_shed(done, pruned.shed) for done in rounds]
    left_out = ["intervals"] if n_copies and clock.is_over else []
    scored = _scored(rounds, pruned)
    fits = [found for found, _ in scored]
    if ready.before_cut is not None:
        fits = crew.map(_refitted, ready, [(*each, bounds, late) for each in scored])
    n_copies = 0 if left_out else n_copies
    is_late = late.is_over
    left_out += ["errors"] if is_late else []
    scenes = () if is_late else ready.split.test
    accounts = Accounts(fits, ready.dataset, scenes, rng, n_copies, crew, foreseen)
    at = {id(f): k for k, (f, _) in enumerate(scored)}
    bound = (asked.bound if asked else None) or rounds[-1].hidden_bound
    doubt = (
        writing_up.doubt_of_periods(rounds, pruned.removed)
        or writing_up.doubt_of_orbits(rounds, pruned.removed, criteria)
        or writing_up.doubt_of_sources(rounds, pruned.removed)
        or writing_up.doubt_of_bounds(rounds, pruned.removed)
        or writing_up.doubt_of_axes(rounds, pruned.removed, dataset)
        or writing_up.doubt_of_rest(first, last, rounds, bound, dataset, pruned.removed)
    )
    doubt = "many_causes" if writing_up.is_many(rounds, pruned.removed) else doubt
    may_ask = last is not first and not is_late and ready.has_more and not ready.is_swapped
    if may_ask and not doubt:
        refuted = is_refuted(last, pruned.hypothesis, accounts, ready.everything, late.left)
        doubt = "held_out_disagrees" if refuted else ""
    records = [
        writing_up.record_of(
            done, _fits_of(done, at), accounts, dataset, bounds, done.number in pruned.removed,
            asked, criteria, doubt, pruned.restated.get(done.number),
        )
        for done in rounds
    ]
    total = _total(accounts, at[id(first)], at[id(last)])
    records = writing_up.not_foreseen(records, total["ratio"], accounts)
    records = writing_up.judged_together(records)
    verdict = min((r.verdict for r in records), key=VERDICTS.index)
    if writing_up.is_idle(rounds, pruned.removed, total["ratio"]):
        verdict = records[-1].verdict
    effect = next((r.effect for r in records if r.verdict == verdict and r.effect), None)
    constants = constant_estimates(last, dataset, bounds)
    for done in rounds:
        constants = writing_up.told(constants, done.details, last)
    units = {c.name: c.unit for c in constants if not c.entity}
    law = without_unseen(last.law)
    text, latex = law.text(units=units), law.latex(units=units)
    if dataset.is_of_sight:
        text, latex = velocity_of(last.law)
    notes = ready.notes(last, pruned.hypothesis)
    return {
        "dataset": writing_up.about_data(ready.dataset, ready.split, notes),
        "noise": about_noise(last.noise, ready.noise, dataset.units),
        "rounds": records, "law": last.law, "law_text": text, "law_latex": latex,
        "constants": constants,
        "total": total, "verdict": verdict,
        "probability": math.nan if effect is None else effect.probability,
        "equivalents": () if effect is None else effect.equivalents,
        "hidden_bound": writing_up.bound_of(bound, dataset.units),
        "overlays": writing_up.overlays(accounts, at[id(first)]),
        "residuals": writing_up.residual_table(first, last, ready.dataset, ready.split),
        "fit": last, "hypothesis": pruned.hypothesis, "left_out": left_out,
    }  # fmt: skip


def _refitted(ready, job):
    return ready.refitted(*job)


def _without_shed(done, shed):
    """A round whose cause is told without the terms that later ones have made superfluous."""
    best = done.decision.best
    proposal = done.proposals.get(best.id) if best else None
    if proposal is None or not shed & set(proposal.formulas):
        return done
    kept = replace(proposal, formulas=tuple(f for f in proposal.formulas if f not in shed))
    return replace(done, proposals={**done.proposals, best.id: kept})


def _scored(rounds, pruned):
    """Fits that are scored on held-out rows, with their hypotheses, the final one last.

    What was seen in the last round and not adopted is among them.
    """
    fits = [(done.entering, done.hypotheses[0]) for done in rounds]
    end, best = rounds[-1], rounds[-1].decision.best
    if best is not None:
        fits.append((end.fits[best.id], end.hypotheses[best.id]))
    others = {id(f): (f, hypothesis) for f, hypothesis in fits if f is not pruned.fit}
    return [*others.values(), (pruned.fit, pruned.hypothesis)]


def _total(accounts, begin, end):
    """Errors of the declared and the final law."""
    return {
        "before": accounts.errors(begin), "after": accounts.errors(end),
        "floor": accounts.told_floor, "ratio": accounts.ratio(begin, end),
        "ratios": {metric: accounts.ratio(begin, end, metric) for metric in METRICS},
    }  # fmt: skip


def _fits_of(done, at):
    """Which fits entered a round and came out of it; a cause that was only seen counts as well."""
    best = done.decision.best
    return at[id(done.entering)], None if best is None else at.get(id(done.fits.get(best.id)))


def _stop_reason(rounds):
    """Why there was no further round, of `STOP_REASONS`."""
    last = rounds[-1]
    if last.left_out:
        return "time_is_up"
    if last.is_last:
        return "nothing_left"
    if last.decision.is_adopted:
        return "many_causes" if _is_enough(rounds) else "most_rounds"
    if last.decision.reason == "declared_model_not_fitted":
        return "failed"
    return "nothing_left" if last.decision.verdict == "nothing missing" else "nothing_adopted"


def _is_enough(rounds):
    """Whether so many causes were found that they only describe the tracks: no more are asked."""
    return writing_up.n_causes(rounds) > MOST_CAUSES


def _criteria(criteria, alpha):
    criteria = criteria or Criteria()
    return criteria if alpha is None else replace(criteria, alpha=alpha)


def _check(dataset, criteria, numbers, time_limit):
    """Refuse settings that cannot be."""
    for latent in dataset.latents:
        if latent.values or latent.name == "radius":
            raise SettingsError(
                f"latent {latent.name} must be a continuous property that is no size, since it is "
                "fitted together with the law; give its values, or use infer"
            )
    if not 0 < criteria.alpha < 1:
        raise SettingsError(f"alpha must be between 0 and 1, got {criteria.alpha!r}")
    for name, value in numbers.items():
        least = 0 if name == "n_bootstrap" else 1
        if value < least:
            raise SettingsError(f"{name} must be at least {least}, got {value!r}")
    if time_limit is not None and not 0 < time_limit < math.inf:
        raise SettingsError(
            f"time_limit must be a positive number of seconds, got {time_limit!r:.60}"
        )
