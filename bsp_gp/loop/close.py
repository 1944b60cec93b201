"""Closing the loop on a data set: made ready, rounds, removal of what is superfluous, report."""

import math
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import asdict, replace
from functools import cached_property

import numpy as np

from bsp_gp.data.blocks import in_blocks
from bsp_gp.data.flat import held_flat
from bsp_gp.data.logged import asked_of
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.parts import part_of, rows_of
from bsp_gp.data.scene import Dataset
from bsp_gp.data.split import choose_split
from bsp_gp.data.stretches import in_stretches
from bsp_gp.data.torn import without_torn_ends
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.followed import about_ends, about_lost, followed
from bsp_gp.fitting.hands import without_hands
from bsp_gp.fitting.hypothesis import Hypothesis, TrackNoise, read_law
from bsp_gp.fitting.law_fit import (
    about_noise,
    about_outliers,
    constant_estimates,
    training_part,
    unset,
)
from bsp_gp.fitting.parts.latents import unknown_properties
from bsp_gp.fitting.parts.orbits import velocity_of
from bsp_gp.fitting.parts.rails import rail_of
from bsp_gp.fitting.rests import without_rests, without_still_ends
from bsp_gp.fitting.unseen import without_unseen
from bsp_gp.inference.latents import declared_latents
from bsp_gp.language.grammar import Grammar, load_grammar
from bsp_gp.language.inputs import DIRECTIONS, STATE_INPUTS
from bsp_gp.language.operators import is_across_in
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop import writing_up
from bsp_gp.loop.accounts import Accounts
from bsp_gp.loop.backward import prune
from bsp_gp.loop.carried import carried
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.constancy import Constancy, constancy
from bsp_gp.loop.criteria import VERDICTS, Criteria
from bsp_gp.loop.foresight import Foresight, is_refuted, that_foresee
from bsp_gp.loop.kept import rounds_from
from bsp_gp.loop.kinked import bounce, bounce_oddly, in_flights, in_parts, is_astray, lacks
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.outcome import LoopReport
from bsp_gp.loop.proposal import FAULTS, continued
from bsp_gp.loop.proposers import standard
from bsp_gp.loop.proposers.kicks import is_kicked
from bsp_gp.loop.questions import hidden_bound
from bsp_gp.loop.retraced import is_likelier, retraced
from bsp_gp.loop.slight import MOST_CAUSES
from bsp_gp.loop.unknown import unknowns
from bsp_gp.loop.view import View
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.physics.bodies import dataset_types, input_types_of, stack
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.masses import check_properties, with_usable_masses
from bsp_gp.physics.metrics import METRICS
from bsp_gp.randomness import Random, generator
from bsp_gp.search.choice import BUDGET
from bsp_gp.workers import Crew

LATE_S = 3.0
"""Seconds after a time limit that errors on held-out rows may take; then they are left out."""
AGAIN = 0.5
"""Part of the time for a part of the rows that all take, a row, with what was found there."""
FIRST_LOOK = 0.6
"""Part of the time for a first look at bodies that bounce, behind which flights are followed."""
WRITING_SHARE = 0.25
"""Part of a time limit that is kept for what comes after the rounds."""


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
    (
        split_rng, round_rng, account_rng, swapped_rng, asked_rng, foresight_rng, parts_rng,
        flights_rng, retraced_rng, few_rng,
    ) = generator(rng).spawn(10)  # fmt: skip
    crew = Crew(workers, needs=run_rounds)
    says("reading the data set")
    known = {"t", *dataset.logged}
    dataset = without_torn_ends(asked_of(dataset, _words(declared), exclude))
    dataset = dataset if all_rows else in_stretches(in_blocks(dataset))
    ready = _Ready(dataset, declared, split_rng)
    grammar = grammar if isinstance(grammar, Grammar) else load_grammar(grammar)
    unknown = sorted(set(exclude) - set(grammar.inputs) - known)
    if unknown:
        raise SettingsError(
            f"exclude names {unknown}, which are no inputs of grammar {grammar.name}; present are "
            f"{', '.join(sorted(grammar.inputs))}"
        )
    settings = {
        "criteria": criteria, "max_rounds": max_rounds, "starts": starts, "bounds": bounds,
        "progress": progress, "looks": 2 if ready.has_more else 1,
        "crew": crew, "is_enough": _is_enough,
    }  # fmt: skip

    def look(ready, rng, begun, clock=clock, **more):
        able = standard(
            grammar, ready.train, max_levels=max_levels, exclude=tuple(exclude), search=search,
            budget=search_budget,
        )  # fmt: skip
        able = [p for p in able if not (all_rows and p.name == "hands")]
        return run_rounds(
            ready.hypothesis, ready.train, able, rng=rng, begun=begun, clock=clock, **settings,
            **more,
        )

    left = None if time_limit is None else time_limit - (time.monotonic() - began)
    until = Clock(None if left is None else left + LATE_S)
    how = starts, bounds, clock

    def begin(ready, rng, is_cut=all_rows):
        begun = ready.begin(*how)
        return (ready, begun) if is_cut else _in_parts(ready, begun, declared, rng, how, criteria)

    def first_look(ready, rng, begun, rng_ahead, **more):
        foreseen: dict = {}
        ahead = Foresight(
            lambda found, hypothesis: ready.refitted(found, hypothesis, bounds, until),
            ready.dataset, ready.split.test, rng_ahead.spawn(max_rounds), crew, foreseen,
        )  # fmt: skip
        more |= {"is_refused": ahead.refuses, "instead": ahead.instead}
        return look(ready, rng, begun, **more), ahead, foreseen

    begin_rng, look_rng, ahead_rng = few_rng.spawn(3)
    small = _part_of(ready, declared, begin_rng) if earlier is None and not all_rows else None
    part, is_all = None, True
    if small is not None:
        says("looking at a part of the rows")
        since = time.monotonic()
        is_cut = any(scene.part_of for scene in small.dataset.scenes)  # no hand throws a window
        small, begun = begin(small, begin_rng, is_cut)
        part = (small, *first_look(small, look_rng, begun, ahead_rng))
        times = rows_of(ready.train.scenes) / rows_of(small.train.scenes)
        needed = AGAIN * times * (time.monotonic() - since)
        is_all = clock.left is None or clock.left > needed
    if is_all:
        says("fitting the declared model")
        ready, begun = begin(ready, parts_rng)
    if earlier is not None:
        earlier = rounds_from(
            earlier, ready.hypothesis, ready.train, begun, bounds=bounds, criteria=criteria
        )
    elif part is not None and is_all:
        says("fitting what was found in a part to all rows")
        earlier = carried(
            part[1], ready.hypothesis, ready.train, begun, criteria=criteria, bounds=bounds,
            clock=clock,
        )  # fmt: skip
        if on_round is not None:
            for done in earlier:
                on_round(done)

    # Where a body bounces it may have to be followed anew, from wall to wall.
    may_fly = is_all and not all_rows and lacks(begun, ready.noise.sigma) and ready.bounces
    flights = in_flights(ready.dataset) if may_fly else None
    if part is None or is_all:
        rounds, foresight, foreseen = first_look(
            ready, round_rng, begun, foresight_rng, on_round=on_round, earlier=earlier,
            clock=clock if flights is None else clock.share(FIRST_LOOK),
        )
    else:
        ready, rounds, foresight, foreseen = part
    if flights is not None and not clock.is_over and _asks_flights(rounds, ready.noise.sigma):
        says("following flights from wall to wall")
        other, rng_split = _Ready(flights, declared, flights_rng), flights_rng.spawn(2)
        found = first_look(other, rng_split[0], other.begin(starts, bounds, clock), rng_split[1])
        if any(done.decision.is_adopted for done in found[0]):
            ready, (rounds, foresight, foreseen) = other, found
    if (before := retraced(rounds)) is not None and not clock.is_over:
        says("asking for more beside laws of textbooks")
        look_rng, ahead_rng = retraced_rng.spawn(2)
        found = first_look(ready, look_rng, begun, ahead_rng, earlier=before)
        if is_likelier(found[0], rounds, criteria):
            rounds, foresight, foreseen = found
    is_cut = False
    if ready.has_more and rounds[0].decision.verdict == "nothing missing":
        # What acts in held-out scenes only would be missed.
        says("looking at what was held out")
        other = ready.swapped(rounds[0].entering.noise)
        found = look(other, swapped_rng, other.begin(starts, bounds, clock))
        is_cut = bool(found[0].left_out)
        if found[0].decision.verdict not in ("nothing missing", "cannot tell"):
            ready, rounds = other, found
    if not ready.is_swapped:  # what acts in those scenes only foresees nothing of the others
        rounds = that_foresee(rounds, foresight)
    pruned = prune(
        rounds, ready.train, criteria=criteria, bounds=bounds, clock=clock, progress=progress
    )
    says("writing up")
    left = None if time_limit is None else time_limit - (time.monotonic() - began)
    whole, late = Clock(left), Clock(None if left is None else left + LATE_S)
    asked = None if whole.is_over else _asked(ready, rounds, pruned, asked_rng, criteria)
    written = _written(
        ready, rounds, pruned, bounds, account_rng, n_bootstrap, whole, asked, criteria,
        crew, late, foreseen,
    )
    left_out = [code for done in rounds for code in done.left_out]
    left_out += ["held_out"] if is_cut else []
    left_out += [] if is_all else ["rows"]
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


def _part_of(ready, declared, rng):
    """A part of the rows of a large data set as fits take it; None where all are looked at at once.

    Nor is one taken of bodies that bounce, which are followed from wall to wall, or where nothing
    moves in it.
    """
    few = part_of(ready.dataset)
    if few is None or ready.bounces:
        return None
    try:
        return _Ready(few, declared, rng)
    except DataError:
        return None


def _words(declared):
    """What declared laws name."""
    laws = (declared,) if isinstance(declared, str) else declared
    if isinstance(laws, ForceLaw):
        laws = [to_text(term.formula) for term in laws.terms]
    return set(re.findall(r"\w+", " ".join(laws)))


def _asks_flights(rounds, levels):
    """Whether no wall was adopted, and something is left, or rows are far off what is foreseen."""
    found = [done.decision.best for done in rounds if done.decision.is_adopted]
    if any(row.kind == "wall" for row in found):
        return False
    is_left = rounds[-1].decision.verdict != "nothing missing"
    return is_left or is_astray(rounds[-1].after, levels)


def _in_parts(ready, begun, declared, rng, how, criteria):
    """The data set and its first fit, without hands at the ends of recordings, these cut in parts.

    Bodies that bounce as no wall foretells are followed from flight to flight, with no hands.

    Where velocities jump, and not where that leaves nothing: then kicks are all that is missing,
    and are found as such. What is kicked at random is taken whole.
    """
    def anew(dataset):
        made = _Ready(dataset, declared, rng)
        return made, made.begin(*how)

    whole = ready, begun
    if ready.dataset.is_of_sight or not lacks(begun, ready.noise.sigma):
        return whole
    bounces = ready.bounces
    # What nothing moves may rest for as long as it likes: no law says that it is held.
    dataset = without_still_ends(ready.dataset) if bounces or not ready.law.terms else None
    if dataset is not None and dataset is not ready.dataset:
        ready, begun = whole = anew(dataset)
    if bounces:
        flights = in_flights(ready.dataset) if bounce_oddly(ready.dataset) else None
        return whole if flights is None else anew(flights)
    dataset = without_hands(ready.dataset, ready.law)
    if dataset is not None:
        ready, begun = anew(dataset)
    still_lacks = dataset is None or lacks(begun, ready.noise.sigma)
    dataset = in_parts(ready.dataset, begun) if still_lacks else None
    if dataset is not None:
        other, found = anew(dataset)
        if lacks(found, other.noise.sigma):
            ready, begun = other, found
    if ready is not whole[0] and is_kicked(whole[0].dataset, whole[1], criteria):
        return whole
    return ready, begun


class _Ready:
    """A data set as fits take it.

    Attributes
    ----------
    dataset : Dataset
        All scenes.
    law : ForceLaw
        The declared one.
    split : Split
    train : Dataset
        What is learned from.
    before_cut : Dataset or None
        Of scenes that are cut in time, what comes before the cut.
    hypothesis : Hypothesis
        The declared one, with the properties that are unknown; tracks that no path under the
        declared law follows are cut short in it.
    far_off : tuple
        Rows in it that are far off their neighbours.
    noise : NoiseEstimate
    is_swapped : bool
        Whether train and test were swapped.
    """

    is_swapped = False

    def __init__(self, dataset, declared, rng):
        latents = declared_latents(dataset) if dataset.latents else None
        if latents is not None:
            everywhere = unknown_properties(dataset, latents, dataset.scenes)
            dataset = replace(everywhere.seen(dataset), latents=())
        declared = (declared,) if isinstance(declared, str) else declared
        is_law = isinstance(declared, ForceLaw)
        self.law = unset(declared) if is_law else read_law(dataset, declared)
        if latents is None:
            dataset = without_rests(dataset, self.law)
        self.dataset = held_flat(with_usable_masses(dataset), _spoken(self.law, dataset))
        self.noise = estimate_noise(self.dataset)
        self.rail = None if self.law.frame or self.law.unseen else rail_of(
            self.dataset, self.noise.inactive_axes
        )
        self.latents = latents
        self._learn_from(choose_split(self.dataset, rng))

    @cached_property
    def bounces(self):
        """Whether bodies turn back at walls; of long recordings it takes seconds to tell."""
        return not self.dataset.is_of_sight and bounce(self.dataset)

    def _learn_from(self, split):
        self.split, self._refitted = split, {}
        self.train, self.far_off = training_part(self.dataset, split.learned, self.noise)
        self.is_weeded = self.train.scenes is not split.learned
        self.before_cut = None
        if split.whole and split.test:
            self.before_cut, _ = training_part(self.dataset, split.train, self.noise)
        check_properties(stack(self.train.scenes, self.dataset.up), self.law)
        self.hypothesis = self._declared(self.train)

    def _declared(self, train):
        hypothesis = Hypothesis.from_laws(train, self.law)
        if self.rail is not None:
            hypothesis += self.rail
        if self.latents is not None:
            hypothesis += unknown_properties(self.dataset, self.latents, train.scenes)
        return hypothesis

    @property
    def has_more(self):
        """Whether scenes are held out that are not learned from."""
        return bool(self.split.test) and self.before_cut is None

    def everything(self):
        """All scenes as fits take them."""
        scenes = (*self.split.learned, *self.split.test)
        return training_part(self.dataset, scenes, self.noise)[0]

    def swapped(self, noise):
        """The same with train and test swapped; a memory of the noise that was told is known there.

        Few scenes tell little of it, and what it does there would pass for a force.
        """
        other = copy(self)
        other.is_swapped = True
        other._learn_from(self.split.swapped)
        model = other.hypothesis.noise
        if noise.correlated and model.is_free.any() and not model.is_correlation_known:
            model = replace(
                model, correlated=noise.correlated, correlation_time=noise.correlation_time,
                is_correlation_known=True,
            )  # fmt: skip
            other.hypothesis += TrackNoise(model)
        return other

    def begin(self, starts, bounds, clock):
        """The fit of what is declared, to tracks as far as it can follow them."""
        found, self.hypothesis = followed(
            self.hypothesis, self.train, starts=starts, bounds=bounds, deadline=clock.left
        )
        return found

    def refitted(self, found, hypothesis, bounds, clock):
        """A fit as it would be without the rows that are held out.

        Only where the scenes were cut in time has it seen any of them. It begins at the fit, and
        ends where the rows that are left lead; one that cannot be fitted to these foresees nothing.
        """
        if self.before_cut is None:
            return found
        if found not in self._refitted:
            self._refitted[found] = self._without_held_out(found, hypothesis, bounds, clock)
        return self._refitted[found]

    def _without_held_out(self, found, hypothesis, bounds, clock):
        nothing = replace(found, status="nonfinite", values=np.full(len(found.values), np.nan))
        hypothesis = continued(hypothesis, found)
        if found.is_failed or not _shows_motion(hypothesis.seen(self.before_cut).scenes):
            return nothing
        try:
            return fit(
                hypothesis, self.before_cut, bounds=hypothesis.own(bounds), deadline=clock.left,
                near=_cut(found, hypothesis.seen(self.before_cut).scenes),
            )
        except FAULTS:
            return nothing

    def notes(self, found, hypothesis):
        """What is known of the data beside a hypothesis that was fitted to them."""
        return (
            *self.noise.notes, *about_lost(hypothesis), *about_ends(hypothesis, self.train),
            *about_outliers(found, self.is_weeded, self.far_off, self.dataset.units),
            *aliasing_notes(found.law, self.train.scenes, self.dataset.units),
        )  # fmt: skip


def _spoken(law, dataset):
    """Axes of which a law speaks; all where it has constraints or frames, or the data vectors.

    Products across are no vectors in a plane.
    """
    types, axes = dataset_types(dataset) | input_types_of(dataset), set()
    vectors = [n for n in types if n not in STATE_INPUTS and types[n].shape == "vector"]
    is_across = not all(is_across_in(to_text(term.formula), 2) for term in law.terms)
    if law.frame or law.unseen or vectors or is_across:
        return set("xyz"[: dataset.n_dims])
    for name in {name for term in law.terms for name in term.formula.inputs} & {*DIRECTIONS}:
        axes.add(dataset.up.strip("-") if name in ("up", "down") else name[-1])
    return axes


def _cut(found, scenes):
    """A fit at the rows of scenes that end before its own, as where another begins; or None."""
    times, nodes = {scene.name: scene.times for scene in scenes}, []
    for chains, states in zip(found.groups, found.nodes, strict=True):
        own = [times.get(name, np.zeros(0)) for name in chains.scenes]
        kept = np.zeros((*states.shape[:3], max(map(len, own)), states.shape[4]))
        for s, rows in enumerate(own):
            n = min(len(rows), int(chains.lengths[s]))  # some are cut short
            if not n or not np.array_equal(chains.times[:n, s], rows[:n]):
                return None
            kept[..., :n, s] = states[..., :n, s]
        nodes.append(kept)
    return replace(found, nodes=tuple(nodes))


def _shows_motion(scenes):
    """Whether every body that forces move is seen at least twice in every scene."""
    seen = (np.isfinite(s.positions[:, s.dynamic]).all(axis=-1).sum(axis=0) for s in scenes)
    return all((count >= 2).all() for count in seen)


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
        "before": accounts.errors(begin), "after": accounts.errors(end), "floor": accounts.floor,
        "ratio": accounts.ratio(begin, end),
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
