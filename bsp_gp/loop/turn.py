"""A round while it runs: whom it asks, and what it fits of what they propose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bsp_gp.loop.clock import TimeIsUp
from bsp_gp.loop.decide import SWAMPED
from bsp_gp.loop.foresight import is_foreseen
from bsp_gp.loop.forms import led_by, with_one_strength, without_weakest
from bsp_gp.loop.proposal import UNIFORM, both_of
from bsp_gp.loop.queue import REACH, Queue, is_misread
from bsp_gp.loop.rows import (
    CLEARLY_LESS,
    EXPLAINED,
    FAR_BEHIND,
    Rows,
    extent_of,
    fit_of,
)
from bsp_gp.loop.table import HeldOut, part_of
from bsp_gp.loop.view import selected

HALF_AS_MUCH = 0.5
"""Part of what a memory of the noise promises that forces must, to be fitted in its place."""
MOST_OF_ALL = 0.9
"""Part of all that is missing by the moments that a cause must explain not to stay behind what
tracks have gained otherwise."""
MOST_BESIDE = 0.1
"""Part of what a law leaves, up to which a rod or a rail leaves little."""
MOST_IN_TIME, MOST_FORESEEN = 0.3, 0.5
"""The same of a law that is told as a description where the time is up, and of one that scenes
which are left out in turn bear out."""
ALL_IN_TIME = 1e-3
"""The same of one that is adopted all the same."""
PROPOSERS, PROPOSING = 0.5, 0.6
"""Part of the time that all proposers may take, and each of what is left of that."""
MOST_DOUBTED = 3
"""Rivals that are fitted where promises of their family were off; where none of so many does as
well as it was expected to, no more of the family are told."""
MOST_LIMITS = 3
"""Simpler forms that are fitted in the place of one whose numbers end at their bounds."""
MOST_FIRSTS, MOST_SECONDS = 3, 2
"""Laws beside which a second is asked for, where each leaves much, and seconds that are fitted."""
MOST_USUAL = 2
"""Laws of textbooks, alone or two, that are fitted before another cause is told."""
WEIGHTY = 0.8
"""Part of chi-squared, as forces see it, that a steady push takes away to be fitted always."""


class Turn(Rows):
    """What proposers are asked, and which of their proposals are fitted."""

    def in_time(self, decision):
        """A decision as it stands where the time was up; as it is where it was not.

        What was not looked at might have changed it. A law that leaves nothing is adopted all the
        same, though not as fact: of what was proposed, all that promised more was fitted before it.
        One that leaves little of the motion, or is foreseen by other scenes, describes it, and is
        told as that.
        """
        if not self.left_out:
            return decision
        moved = self.rows[0].left
        moved = moved if math.isfinite(moved) else extent_of(self.run.dataset)
        stands = decision.is_adopted and set(self.left_out) <= {"fits", "proposers"}
        is_all = stands and (
            decision.best.left < ALL_IN_TIME * moved
            or any(key == decision.best.id for key, *_ in self.leaving_nothing)
        )
        if is_all:
            return replace(decision, is_fact=False)
        most = MOST_FORESEEN if stands and is_foreseen(decision.best) else MOST_IN_TIME
        if stands and decision.best.left < most * moved:
            return replace(decision, verdict="effective law", reason="time_is_up", is_fact=False)
        return replace(
            decision, verdict="cannot tell", reason="time_is_up", is_adopted=False, is_fact=False
        )

    def propose(self, number, view, proposers, is_told=False):
        """Ask those proposers for which there is time, and tell whom if it takes long."""
        # What noise with a memory takes of a motion no law has explained.
        is_swamped = self.swamped > SWAMPED
        self.levels = view.scatter if is_swamped else np.array(view.fit.noise.levels)
        self.near, self.missing = view.near, max(float(view.left @ view.left) - view.n_left, 0.0)
        able = [p for p in proposers if self._may_ask(p)]
        here = [p for p in able if not getattr(p, "is_alone", True)]
        others = [p for p in able if p not in here]
        # What begins with what another has told the view is asked here, and meanwhile the rest by
        # whoever is free.
        clock = self.run.clock.share(PROPOSERS)
        shared = others, view, clock
        parts = self.run.crew.work(_proposed, shared, list(range(len(others))))
        found, queue, self.unasked = {}, [*here, *others], []
        for at, proposer in enumerate(queue):
            if clock.is_over:
                self.unasked = queue[at:]
                break
            k = self.run.proposers.index(proposer)
            if is_told:
                place = f"{proposers.index(proposer) + 1} of {len(proposers)}"
                self.run.says(f"round {number}: {proposer.name} ({place})")
            if proposer in here:
                parts.begin()
                found[k] = _proposed(([proposer], view, clock), 0)
            else:
                found[k] = parts.result(others.index(proposer))
        parts.end()
        if any(family is None or family.is_partial for family in found.values()):
            self.note("proposers")
        view.tick = self.run.clock.tick
        self.families += [family for _, family in sorted(found.items()) if family is not None]

    def ask_the_rest(self, number, view):
        """Ask those for which there was no time before, if there is some now; whether any was."""
        rest = self.unasked
        if not rest or self.run.clock.is_over:
            return False
        self.run.says(f"round {number}: {len(rest)} kinds of causes for which there is time now")
        self.propose(number, view, rest)
        return len(self.unasked) < len(rest)

    def fit_the_rest(self, number, view):
        """The same, and fit the likeliest of what they propose."""
        before = self.families
        if not self.ask_the_rest(number, view):
            return
        self.p_value = self.p_of_all(view, self.run.looks)
        self.families, every = self.families[len(before) :], self.families
        self.fit_best()
        self.families = every

    def _may_ask(self, proposer):
        """Whether a proposer can tell anything of the fit as it is."""
        sees_places = getattr(proposer, "sees_places", not self.measure[proposer.name])
        return sees_places or not self.base.is_failed

    def ask_without_memory(self, number, view):
        """Look for what a memory of the noise may have taken for its own, where nothing else shows.

        What a force does that comes back from place to place looks like noise with a memory, and
        under such noise nothing is left of it. Forces that promise half as much as the memory does
        and more are fitted, since to first order a large one promises less than it holds; where
        none is likelier in the end, nothing was seen.
        """
        white = view.in_white()
        if white is None:
            return
        view, less = white
        if self.unasked:  # what is asked now is asked under other noise
            self.note("proposers")
        before = self.families, self.near, self.missing, self.levels, self.chances
        self.families = []
        self.known.clear()  # under the noise of the base
        self.propose(number, view, self.run.proposers, is_told=True)
        found = [p.promise for f in self.families for p in f.proposals if p.kind != "noise"]
        if max(found, default=-math.inf) > HALF_AS_MUCH * less + self.run.criteria.noise_nats:
            by_chance = self.p_of_all(view, self.run.looks)
            self.fit_best()
            least = self.rows[0].log_posterior + self.run.criteria.noise_nats
            if any(row.kind != "noise" and row.log_posterior > least for row in self.rows[1:]):
                self.p_value = by_chance
                return
        self.families, self.near, self.missing, self.levels, self.chances = before

    def ask_swamped(self):
        """Fit what swings may be, where noise with a memory is as large as the motion.

        A swing of a few rows a turn is such noise to moments. Whole tracks tell: by how much a
        cause is likelier than that noise is the chance that it is noise.
        """
        told = [(f.name, p) for f in self.families for p in f.controls]
        controls = [job for job in told if job[1].kind not in ("noise", "wall")]
        if not self.p_value > self.run.criteria.alpha or not self.swamped > SWAMPED:
            return
        rows = [
            self._followed(*job, fit_of(self._shared, job))[0] for job in controls
            if not self.note_time("fits")
        ]
        best = max((row.log_posterior for row in rows if row.is_fit), default=-math.inf)
        if best > self.rows[0].log_posterior + self.run.criteria.noise_nats:
            self.p_value = min(self.p_value, math.exp(self.rows[0].log_posterior - best))

    def p_of_all(self, view, looks):
        """Chance that noise alone shows as much in any family, or at another look."""
        self.chances = {
            f.name: selected(f.gain, f.rank, f.null, view.noise_dof, f.is_continuum)
            for f in self.families
            if (f.n_tried or f.rank) and not f.is_led
        }
        if not self.chances:
            return 1.0
        least = min(*self.chances.values(), 1 - 1e-16)
        return float(-np.expm1(looks * len(self.chances) * np.log1p(-least)))

    def fit_best(self):
        """Fit the likeliest proposals of all families; what lies near gets rows without a fit."""
        every = sorted(
            ((f.name, p) for f in self.families for p in f.proposals),
            key=lambda pair: -pair[1].promise,
        )
        queue = Queue(self, every)
        fits, n_fits = self._fits(queue.jobs), 0
        for at, (source, proposal) in enumerate(queue.jobs):
            if any([queue.ends_with(at, *told) for told in self._take_over(proposal.key)]):
                break
            if proposal.key in self._taken:
                continue
            if self.note_time("fits"):
                break
            if queue.passes_over(at):
                continue
            n_fits += 1  # proposals that are passed over are none of the fits that may yet come
            self.run.says(f"fit {n_fits} of {max(n_fits, queue.n_most)}: {proposal.text}")
            row, proposal = self._followed(source, proposal, fits.result(at))
            if queue.ends_with(at, row, proposal):
                break
        fits.end()
        for key in list(self.known):  # there was no time to come to them
            self._take_over(key)
        self.share_noise()
        self._fit_weight(every)
        self._fit_usual(every)
        self._fit_limits()
        self._fit_shared()
        self._prune()
        self._tell_near(queue)
        self._fit_foreseen()
        self._fit_part()

    def _take_over(self, key):
        """Rows and proposals of what was fitted before under a key, once."""
        found = self.known.pop(key, ())
        self._taken |= {key} if found else set()
        return [self._followed(*each) for each in found]

    def _fit_foreseen(self):
        """Fit what is foreseen to be likelier than all that was fitted, with fewer numbers.

        A law whose rest point the data put at the origin is one without a rest point.
        """
        best = self._likeliest
        simpler = [
            row for row in self.rows[1:] if best and row.status == "scored"
            and row.source == best.source and row.n_free < best.n_free
        ]  # fmt: skip
        row = max(simpler, key=lambda row: row.log_posterior, default=None)
        if row is not None and row.log_posterior > best.log_posterior:
            self._fit_scored(row)

    def _fit_part(self):
        """Fit what would be taken in the place of the likeliest sum, where it was scored only."""
        best = self._likeliest
        if best is None or best.n_terms < 2:
            return
        part = part_of(best, self.rows[1:], self.run.criteria)
        if part.status == "scored":
            self._fit_scored(part)

    def _fit_scored(self, row):
        if not self.note_time("fits"):
            proposal = self.proposals[row.id]
            self.run.says(f"fit of a part: {proposal.text}")
            self._fitted(row.source, proposal, fit_of(self._shared, (row.source, proposal)))

    def _fit_weight(self, every):
        """Fit the likeliest steady push where no force is known, and that takes most away.

        It comes before laws that explain more, see `decide`, however much more they promise.
        """
        plain = ((source, p) for source, p in every if p.formulas
                 and all(set(f.inputs) <= UNIFORM for f in p.formulas))  # fmt: skip
        source, best = next(plain, ("", None))
        is_most = best is not None and best.gain > WEIGHTY * self.missing
        is_new = is_most and best.key not in self._fitted_keys
        if is_new and not self.base.law.terms and not self.note_time("fits"):
            self.run.says(f"fit of a weight: {best.text}")
            self._followed(source, best, fit_of(self._shared, (source, best)))

    def _fit_usual(self, every):
        """Fit the likeliest laws of textbooks, alone or two, where none is the likeliest cause.

        A camera that zooms, or a wind straight up, leaves as little as weight and drag do: no such
        thing is told before these were tried.
        """
        row, is_usual = self._likeliest, self.run.is_usual
        if row is None or is_usual(self.proposals[row.id]):
            return
        least = self.proposals[row.id].promise - 2 * self.run.criteria.class_nats
        near = [(source, p) for source, p in every if p.promise > least and is_usual(p)]
        for source, proposal in near[:MOST_USUAL]:
            if proposal.key in self._fitted_keys or self.note_time("fits"):
                continue
            self.run.says(f"fit of usual laws: {proposal.text}")
            self._followed(source, proposal, fit_of(self._shared, (source, proposal)))

    def fit_held(self, queue):
        """Fit rods and rails, beside a drag what slows down too much; whether one leaves little.

        The others are not asked where one leaves noise alone: a piece of a circle is nearly a
        parabola.
        """
        leaves_little = False
        for k, (source, proposal) in enumerate(queue, 1):
            before = None
            for one in filter(None, (proposal, proposal.instead)):
                if self.note_time("fits"):
                    return leaves_little
                self.run.says(f"fit {k} of {len(queue)}: {one.text}")
                found = fit_of(self._shared, (source, one))
                one = replace(one, instead=None)
                row, _ = self._followed(source, one, found)
                known = self.known.setdefault(one.key, [])
                if before is not None and row.is_fit and row.left < CLEARLY_LESS * before.left:
                    # Beside forces that know no physics the rod alone is as good: it is no law.
                    self.rows[before.id] = replace(before, status="less")
                    known.clear()
                known.append((source, one, found))
                before = row
                if row.is_fit and row.left < MOST_BESIDE * self.rows[0].left:
                    leaves_little = True
                    break
            if leaves_little and self.judged.get(row.id, 0.0) < EXPLAINED:
                break
        return leaves_little

    def fit_seconds(self, number, rng):
        """Ask beside each of the likeliest laws for a second one, where all leave much.

        Sums are foreseen along the tracks as they were seen, and no better than these are known;
        of single laws one that takes up some of a second cause may be likelier than the true one.
        Two that leave much as well have no such claim: the first is adopted, and the next round
        asks for the second by itself.
        """
        ends = self._ends()
        firsts = ends + [row for row in self._firsts() if row not in ends]
        able = [p for p in self.run.proposers if getattr(p, "asks_seconds", False)]
        for row, stream in zip(firsts, rng.spawn(len(firsts)), strict=True):
            if self.leaving_nothing and row not in ends:  # beside one of those before
                break
            view = self.run.view_of(self.fits[row.id], self.hypotheses[row.id], stream)
            for proposer in able:
                self.run.says(f"round {number}: {proposer.name} beside {row.text}")
                self._fit_beside(row, proposer, view)
        if firsts:
            self._prune()

    def _fit_beside(self, row, proposer, view):
        """Fit the likeliest of a proposer beside the law of a row, at whose tracks a view looks."""
        run, found = self.run, self.fits[row.id]
        try:
            seconds = () if self.note_time("fits") else proposer.propose(view).proposals
        except TimeIsUp:
            self.note_time("fits")
            return
        for second in seconds[:MOST_SECONDS]:
            if self.note_time("fits"):
                return
            job = proposer.name, both_of(self.proposals[row.id], second)
            run.says(f"fit of two: {job[1].text}")
            shared = found, run.dataset, run.criteria, run.bounds, run.clock
            both = fit_of(shared, job)
            if both is not None and self._left(both[0]) < EXPLAINED:
                after = replace(job[1], after=self.proposals[row.id])
                self._fitted(job[0], after, both)

    def _ends(self):
        """Rows in which ends of tracks are left out that are no part of the motion.

        They hide what forces do between them, and forces of some form explain them as well.
        """
        return [
            row for row in self.rows[1:]
            if row.is_fit and row.source == "hands" and self._left(self.fits[row.id]) > EXPLAINED
        ]  # fmt: skip

    def _firsts(self):
        """Rows of the likeliest laws, of each form one.

        None where some cause leaves little, or a sum is likeliest: they were foreseen well enough.
        """
        # Random kicks leave nothing of any motion.
        fitted = [row for row in self.rows[1:] if row.is_fit and row.source != "kicks"]
        if min((self._left(self.fits[row.id]) for row in fitted), default=0.0) < EXPLAINED:
            return []
        fitted.sort(key=lambda row: -row.log_posterior)
        if len(self.proposals[fitted[0].id].formulas) > 1:
            return []
        out: dict = {}
        for row in fitted:
            proposal = self.proposals[row.id]
            # Ends that are no part of the motion hide what forces do between them.
            may_be = proposal.formulas or proposal.code == "untrimmed"
            if may_be and row.log_posterior > self.rows[0].log_posterior:
                out.setdefault((proposal.code, proposal.lead), row)
        return list(out.values())[:MOST_FIRSTS]

    def _fit_limits(self):
        """Fit simpler forms in the place of one whose numbers end at their bounds.

        There a form has become another one: the sine of a wave that is long is a spring.
        """
        row = self._likeliest
        if row is None or row.status != "at_bound":
            return
        proposal, found = self.proposals[row.id], self.fits[row.id]
        own = [p for f in self.families if f.name == row.source for p in f.proposals]
        if proposal.formulas:
            n_numbers = len(proposal.formulas[0].constants)
            forms = [form for form in own if len(form.formulas) == 1
                     and len(form.formulas[0].constants) < n_numbers]  # fmt: skip
        else:  # the likeliest of every size
            lesser = reversed([form for form in own if form.rank < proposal.rank])
            forms = list({form.rank: form for form in lesser}.values())
        for simpler in forms[:MOST_LIMITS]:
            if proposal.formulas:
                simpler = led_by(simpler, proposal, found, self.run.criteria)
            if simpler.key in self._fitted_keys or self.note_time("fits"):
                continue
            self.run.says(f"fit of a limit: {simpler.text}")
            self._fit_after(row, simpler)

    def _fit_shared(self):
        """Fit the likeliest law of a strength for each owner with one strength for all of them.

        Where bodies come close a strength for each scene promises more than one for all: moments
        are told of what the law as it is leaves, not of the tracks that the new law follows.
        """
        row = self._likeliest
        shared = row and with_one_strength(
            self.proposals[row.id], self.hypotheses[0], self.fits[row.id], self.run.criteria
        )
        if shared is None or shared.key in self._fitted_keys or self.note_time("fits"):
            return
        self.run.says(f"fit with one strength for all: {shared.text}")
        self._fit_after(row, shared)

    def _prune(self):
        """Leave terms out of the likeliest sum of laws while that makes it likelier.

        Sums are found by their size: of one that is larger than it need be no part was tried. Of
        series and of forms of textbooks the likeliest of either kind.
        """
        self._prune_those([r.id for r in self.rows if r.id in self.proposals
                           and not self.proposals[r.id].news])  # fmt: skip
        self._prune_those([r.id for r in self.rows if r.id in self.proposals])

    def _prune_those(self, ids):
        """The same of rows, and of what becomes of them."""
        ids = set(ids)
        while not self.run.clock.is_over:
            fitted = (r for r in self.rows if r.is_fit and r.id in ids)
            row = max(fitted, key=lambda r: r.log_posterior, default=None)
            if row is None or not row.log_posterior > self.rows[0].log_posterior:
                return
            proposal, found = self.proposals[row.id], self.fits[row.id]
            if proposal.judged is not None or len(proposal.formulas) < 2:
                return
            smaller = without_weakest(proposal, found, self.run.criteria)
            if smaller is None or smaller.key in self._fitted_keys:
                return
            same = (p for f in self.families for p in f.proposals if p.rank == smaller.rank)
            twin = next((p for p in same if p.key == smaller.key), None)
            if twin is not None:  # it was proposed itself: that is what it costs
                smaller = replace(smaller, log_prior=twin.log_prior, ties=twin.ties)
            self.run.says(f"fit without the weakest term: {smaller.text}")
            new = self._fit_after(row, smaller)
            ids.add(new.id)
            if not (new.is_fit and new.log_posterior > row.log_posterior):
                return

    def is_behind(self, proposal, measures):
        """Whether a proposal promises too little beside what was found to be worth a fit.

        What moments promise of a force and rows of an instrument is not of one measure: the first
        of a family is held against what was found in the same way only.
        """
        found = max(self.found[m] for m in measures)
        far = (self.kept[m] - max(FAR_BEHIND, self.spare[m]) for m in measures)
        # Rows that are left out take along whatever is wrong with them, names that are swapped too.
        if proposal.promise < max(far) and not is_misread(proposal):
            return True
        if measures == {False} and proposal.gain > MOST_OF_ALL * self.missing:
            return False  # moments cannot promise more
        return REACH * (proposal.promise + self.run.criteria.class_nats) < found

    def _tell_near(self, queue):
        """Rows of what was scored only, in the terms of what was fitted of its family.

        Of what promises much more than the greatest of what was fitted nothing is foreseen: it was
        asked for and did not fit. Of families whose promises some kept and others not, the
        likeliest are fitted.
        """
        off = queue.doubted
        criteria = self.run.criteria
        least = max(row.log_posterior for row in self.rows) - criteria.class_nats
        highest = max(row.log_evidence for row in self.rows)
        equal = highest - 2 * criteria.tie_nats
        known = {row.key for row in self.rows}
        best = self.proposals.get(max(self.rows, key=lambda row: row.log_posterior).id)
        # Sums that are as long as the likeliest one are told, too.
        enough = max(self.enough, len(best.formulas) if best else 0)
        near = []
        for source, proposal in queue.every:
            if source not in queue.above or len(proposal.formulas) > enough:
                continue
            loss = self.explained.loss(proposal) if self.explained else math.nan
            if not math.isnan(loss):  # told by more than promises
                row, mine = self.explained.row, self.explained.proposal
                evidence = row.log_evidence - loss + proposal.volume - mine.volume
                height, is_foreseen = row.log_likelihood - loss, True
            else:
                # Where none of so many numbers was fitted, no more is expected than of any other.
                own = queue.above[source]
                offset, height = own.get(proposal.rank) or tuple(np.min(list(own.values()), axis=0))
                evidence = offset + proposal.promise - proposal.log_prior
                height += 0.5 * proposal.gain
                is_foreseen = proposal.promise <= queue.highest[source] + criteria.class_nats
            is_near = evidence + proposal.log_prior > least or evidence > equal
            if is_near and is_foreseen and proposal.key not in known:
                known.add(proposal.key)
                near.append((min(evidence, highest), height, source, proposal))
        fitted, unkept = {source: 0 for source in off}, dict.fromkeys(off, 0)
        for evidence, height, source, proposal in sorted(
            near, key=lambda each: -each[0] - each[-1].log_prior
        ):
            if fitted.get(source, math.inf) < MOST_DOUBTED and not self.run.clock.is_over:
                self.run.says(f"fit of a rival: {proposal.text}")
                found = fit_of(self._shared, (source, proposal))
                row = self._fitted(source, proposal, found)
                fitted[source] += 1
                unkept[source] += not row.log_evidence > evidence - criteria.class_nats
            elif unkept.get(source, 0) < MOST_DOUBTED:
                self._add(
                    source, proposal, "scored", evidence, height,
                    self.base.n_free + proposal.rank, HeldOut(),
                )  # fmt: skip

    def _fits(self, queue):
        """The fits of a queue of proposals, as `Work`; what is far behind is not begun early."""
        both, known = {False, True}, set(self.known)
        return self.run.crew.work(
            fit_of, self._shared, queue,
            lambda job: not (job[1].key in known or self.is_behind(job[1], both)),
        )


def _proposed(shared, number):
    """The family of a proposer; None if its time was up."""
    proposers, view, clock = shared
    # What one of them takes long for must leave time to others, and to fits.
    view.tick = clock.share(PROPOSING).tick
    try:
        return proposers[number].propose(view)
    except TimeIsUp:
        return None
    finally:
        view.tick = clock.tick
