"""Rows of a round: what was fitted of what was proposed, and what each fit leaves."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.fitting.followed import PASSES, cut_short
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.fitting.periodogram import is_at, longest, own_rate, rates_in
from bsp_gp.fitting.student import log_likelihood
from bsp_gp.loop.decide import SWAMPED
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.forms import without_open_kicks
from bsp_gp.loop.proposal import FAULTS, UNIFORM
from bsp_gp.loop.rivals import Explained
from bsp_gp.loop.slight import LITTLE, size_left
from bsp_gp.loop.table import SAME_MINIMUM, HeldOut, Row, held_out_gain

EXPLAINED = 1.5
"""Reduced chi-squared below which a cause beside free forces explains the tracks."""
FAR_BEHIND = 100.0
"""Nats by which a promise is behind one that was kept and explained all there is: what explains as
much is told from the same moments as it."""
SPARE = {True: 0.02, False: 0.002}
"""Of a kept promise: what others may be off by that rows make, since they are not linear in the
numbers of an instrument; and moments, beside what the kept one leaves of them beyond the noise."""
FEWER = 2
"""Times fewer fits and no seconds where rounds before have left little of what is missing."""
MOST_SCATTER = 2.0
"""Times as much as neighbouring rows differ by, from which what is measured is no noise of it."""
WITHIN_NOISE = 3.0
"""Standard deviations of chi-squared within which a law leaves nothing for a sum with more laws."""
NEARLY_NOTHING, CLEARLY_LESS = 1e-3, 0.7
"""Part of chi-squared that a law leaves which tells of others nearly as one that leaves nothing, in
place of which another comes that leaves less than so much of it."""
MOST_LEFT = 0.3
"""Part of the reduced chi-squared that may be left by what comes before all other causes."""


class Rows:
    """Rows, fits and hypotheses of a round, and what was kept of what they promised."""

    def __init__(self, run, found, hypothesis, is_little=False, known=None):
        self.run, self.base = run, found
        # Fits to the same base before, by key: of source, proposal and what `fit_of` told each.
        self.known, self._taken = {} if known is None else known, set()
        self.most_fits = run.criteria.most_fits // (FEWER if is_little else 1)
        self.near, self.missing = found, 0.0  # where fits begin; chi-squared that is to be gained
        evidence = log_evidence(found, hypothesis, run.criteria)
        base = (found.status, evidence, 0.0, found.log_likelihood, found.n_free)
        self.rows = [Row(0, "base", "", "", *base, left=_left_by(found, 0))]
        self.fits, self.hypotheses, self.proposals = {0: found}, {0: hypothesis}, {}
        self.families, self.left_out, self.p_value, self.chances = [], [], np.nan, {}
        self.unasked = []  # proposers for which there was no time before the fits
        self.levels = np.array(found.noise.levels)  # of the noise by which promises are made
        self.judged = {}  # reduced chi-squared of what was judged by more than itself
        # By what proposers look at, rows or forces: nats that a fit has promised and kept, and the
        # greatest promise that was kept by what leaves no misfit, and what that may be off by.
        self.measure = {p.name: getattr(p, "asks_rows", False) for p in run.proposers}
        self.found, self.kept, self.spare = ({False: 0.0, True: 0.0} for _ in range(3))
        self.leaving_nothing = []  # laws that do: row, numbers, and how likely they are
        self.explained = None  # what the first of those says of others
        self.has_most = False  # whether what is asked before all else explains most

    def note_time(self, code):
        """Note what may be left out; whether the time is up."""
        if self.run.clock.is_over:
            self.note(code)
        return self.run.clock.is_over

    def note(self, code):
        """Note what was left out."""
        if code not in self.left_out:
            self.left_out.append(code)

    @property
    def _fitted_keys(self):
        """Keys of what was fitted, a set."""
        return {row.key for row in self.rows if row.is_fit}

    @property
    def _likeliest(self):
        """The row of the likeliest proposal that was fitted, or None."""
        fitted = (row for row in self.rows[1:] if row.is_fit and row.id in self.proposals)
        return max(fitted, key=lambda row: row.log_posterior, default=None)

    def share_noise(self):
        """Tell what leaves less than the likeliest cause under its noise, where it is likelier so.

        What a law leaves may pass for noise with a memory while less of it does not, beside
        another: how much is noise is told from what is smooth in what each leaves. Noise that is
        told as such is no measure: beside it the best of all laws that were tried looks better.
        """
        fitted = [r for r in self.rows[1:] if r.is_fit and r.kind != "noise" and r.id in self.fits]
        top = max(fitted, key=lambda row: row.log_posterior, default=None)
        for row in fitted:
            found = self.fits[row.id]
            if not row.left < top.left or found.n_rows != self.fits[top.id].n_rows:
                continue
            reached = log_likelihood(self.fits[top.id].noise, found.channels, found.residual)
            more = float(reached) - row.log_likelihood
            if more > 0:
                self.rows[row.id] = replace(
                    row, log_likelihood=row.log_likelihood + more,
                    log_evidence=row.log_evidence + more,
                )  # fmt: skip

    @cached_property
    def swamped(self):
        """Size of the noise with a memory that the base has, in that of the motion."""
        return swamped_by(self.base, self.run.dataset) if self.base.shows_tracks else 0.0

    @property
    def enough(self):
        """How many numbers leave nothing beyond the noise, and are as likely as any, about."""
        least = max(row.log_posterior for row in self.rows) - 2 * self.run.criteria.class_nats
        return min((n for _, n, nats in self.leaving_nothing if nats > least), default=math.inf)

    @property
    def nearly(self):
        """How many laws leave little of what the base does, and are likelier.

        What more than one beside these would take off is asked for in the next round; of sums with
        one that is too much the rest may be better.
        """
        base = self.rows[0]
        return min((
            self.proposals[row.id].n_laws for row in self.rows[1:]
            if row.is_fit and row.left < LITTLE * base.left and self.proposals[row.id].formulas
            and row.log_posterior > base.log_posterior
        ), default=math.inf)  # fmt: skip

    def _explained(self, row, proposal, found):
        """What a law that leaves nothing, or next to it, says of others that promise much."""
        if not proposal.promise > FAR_BEHIND or self.run.clock.is_over:
            return None
        try:
            return Explained(row, proposal, found, self.run.dataset, self._left(found))
        except FAULTS:
            return None

    def nats_behind(self, proposal):
        """How far a proposal is behind a law that leaves nothing; nan where that is not told."""
        return self.explained.behind(proposal) if self.explained else math.nan

    def is_ahead(self, row):
        """Whether a descent was left where less is unexplained than beside any fit so far."""
        others = (self._left(f) for k, f in self.fits.items() if k != row.id and not f.is_failed)
        return self._left(self.fits[row.id]) < min(others, default=math.inf)

    def _followed(self, source, proposal, found):
        """The row of a fit, on tracks as far as its law can follow them, and its proposal.

        Tracks are cut where less is left of all others than beside any fit so far.
        """
        row = self._fitted(source, proposal, found)
        for _ in range(PASSES):
            new = self.fits.get(row.id)
            if new is None or not new.lost or not self.is_ahead(row) or self.note_time("fits"):
                break
            hypothesis = cut_short(proposal.hypothesis, new)
            proposal = replace(proposal, hypothesis=hypothesis, starts=new.starts)
            row = self._fitted(source, proposal, fit_of(self._shared, (source, proposal)))
        while row.is_fit and row.code == "contact" and not self.note_time("fits"):
            less = without_open_kicks(proposal, self.fits[row.id], self.hypotheses[0])
            if less is None:
                break
            new = self._fitted(source, less, fit_of(self._shared, (source, less)))
            if not new.is_fit:
                break
            self.rows[row.id] = replace(row, status="idle")
            row, proposal = new, less
        price = self._price_of_cuts(proposal) if row.is_fit else 0.0
        if price:
            proposal = self.proposals[row.id] = replace(
                proposal, log_prior=proposal.log_prior - price
            )
            row = self.rows[row.id] = replace(row, log_prior=proposal.log_prior)
        return row, proposal

    def _price_of_cuts(self, proposal):
        """Nats that a law has not earned whose tracks are cut short.

        Those of a cause for every one; and all that cuts give the base, where that leaves nothing
        beside them.
        """
        base = self.hypotheses[0]
        cuts = [p for p in proposal.hypothesis.parts
                if isinstance(p, CutShort) and p not in base.parts]  # fmt: skip
        price = self.run.criteria.cause_nats * len({(cut.scene, cut.bodies) for cut in cuts})
        if not cuts or self.base.is_failed:
            return price
        alike = replace(
            proposal, hypothesis=base + Hypothesis(tuple(cuts)), starts={}, bounds={},
            formulas=(), judged=None,
        )  # fmt: skip
        found = fit_of(self._shared, ("", alike))
        if found is None or found[0].is_failed or not self._left(found[0]) < EXPLAINED:
            return price
        return price + max(found[2] - self.rows[0].log_evidence, 0.0)

    @property
    def _shared(self):
        """What all fits of this turn share."""
        run = self.run
        return self.near, run.dataset, run.criteria, run.bounds, run.clock

    def is_most(self, row):
        """Whether a fit takes off most of what was unexplained, and is likelier for it.

        Where the law as it is could not be fitted that is all of it.
        """
        if self.base.is_failed:
            return self._left(self.fits[row.id]) < EXPLAINED
        left = self._left(self.fits[row.id]) / self._left(self.fits[0])
        return left < MOST_LEFT and row.log_posterior > self.rows[0].log_posterior

    def _left(self, found):
        """Reduced chi-squared of what is followed under the noise by which promises are made."""
        chi2 = found.chi2_others if found.lost and found.is_failed else found.chi2_red
        return float(np.nanmax(np.array(found.noise.levels) / self.levels)) ** 2 * chi2

    def note_gain(self, row, proposal, measure):
        """Remember what a fit has gained of what it promised."""
        new, gained = self.fits[row.id], row.log_posterior - self.rows[0].log_posterior
        # Promises are made under the pure error; the base may have been fitted under a larger one.
        dof = new.n_rows - new.n_free
        left = max(self._left(new) - 1.0, 0.0) * dof
        leaves_nothing = left < WITHIN_NOISE * math.sqrt(2.0 * dof)
        if proposal.formulas and leaves_nothing:
            # A sum has a strength for each law: some single law has as many numbers inside.
            n_numbers = sum(len(formula.constants) for formula in proposal.formulas)
            self.leaving_nothing.append((row.id, n_numbers, row.log_posterior))
        is_likelier = row.log_posterior > self.rows[0].log_posterior
        is_new = self.explained is None or self._left(new) < CLEARLY_LESS * self.explained.left
        leaves_nothing |= self._left(new) < NEARLY_NOTHING * self._left(self.base)
        if proposal.formulas and is_likelier and is_new and leaves_nothing:
            self.explained = self._explained(row, proposal, new) or self.explained
        gained = max(gained, proposal.promise - 0.5 * (proposal.gain - self.missing + left))
        self.found[measure] = max(self.found[measure], min(gained, proposal.promise))
        is_kept = self._left(new) < EXPLAINED and gained > 0.8 * proposal.promise
        if is_kept and proposal.promise > self.kept[measure]:
            left = 0.0 if measure else 0.5 * (self.missing - proposal.gain)
            self.kept[measure] = proposal.promise
            self.spare[measure] = max(SPARE[measure] * proposal.promise, left)

    def _fit_after(self, row, proposal):
        """The row of a proposal whose fit begins at that of another row."""
        shared = self.fits[row.id], *self._shared[1:]
        found = fit_of(shared, (row.source, proposal))
        return self._fitted(row.source, replace(proposal, after=self.proposals[row.id]), found)

    def _fitted(self, source, proposal, found):
        """Add the row of a proposal that was fitted."""
        if found is None:
            nothing = ("nonfinite", -math.inf, -math.inf, 0, HeldOut())
            return self._add(source, proposal, *nothing)
        new, best, evidence = found
        if (proposal.error or proposal.judged is not None) and not new.is_failed:
            level = float(np.nanmax(np.array(best.noise.levels)))
            told = proposal.error or level  # noise that grew with the misfit explains none of it
            self.judged[len(self.rows)] = (level / told) ** 2 * best.chi2_red
        self.fits[len(self.rows)] = new
        status = "idle" if self._is_idle(proposal, new) else new.status
        more = more_under(self.base.noise, best) if self.base.shows_tracks else 0.0
        is_worse = self.rows[0].is_fit and not new.is_failed and is_less(self.base, best, more)
        # What takes the motion itself for noise explains nothing better than any law.
        is_worse = is_worse and self.swamped <= SWAMPED
        if is_worse or self._is_open_series(proposal, new):
            status = "less"
        # Kicks have every row told by those before it, and no rows of a fit to be compared.
        held_out = HeldOut() if proposal.is_last else held_out_gain(self.base, best)
        return self._add(
            source, proposal, status, evidence + more, best.log_likelihood + more, best.n_free,
            held_out, self._twin(source, proposal, best),
        )  # fmt: skip

    def _is_open_series(self, proposal, new):
        """Whether a series, which can stand for any force, does not even explain the tracks.

        It would be likelier than a law that is a part of the truth, and hide the rest of it.
        """
        return bool(proposal.news) and not new.is_failed and not self._left(new) < EXPLAINED

    def _is_idle(self, proposal, new):
        """Whether a part that a proposal adds does nothing: none of its numbers is told.

        A wall that has moved to where nothing meets it is no cause, whatever stands beside it.
        """
        if new.is_failed:
            return False
        is_told = {}  # of what is fitted: numbers of the noise are none of it
        for (name, _), error in zip(new.parameters, new.errors, strict=True):
            is_told[name] = is_told.get(name, False) or bool(np.isfinite(error))
        for parameter in self.hypotheses[0].parameters:  # not told under the base either
            is_told.pop(parameter.name, None)
        for part in proposal.hypothesis.parts:
            own = [is_told[p.name] for p in part.parameters if p.name in is_told]
            if own and not any(own):
                return True
        return False

    def _is_echo(self, proposal, found):
        """Whether a sum has a push in it with the period of the swing: a harmonic of anything."""
        is_sum = found is not None and not found.is_failed and len(proposal.formulas) > 1
        if not is_sum or not self.base.shows_tracks:
            return False
        rates = [name for formula in proposal.formulas for name in rates_in(formula)]
        constants = found.law.constants
        rates = [constants[name] for name in rates if name in constants]
        return any(is_at(rate, self.own_rate, longest(self.base)) for rate in rates)

    @cached_property
    def own_rate(self):
        """The rate of the swing that the base has, or its tracks, rad/s."""
        return own_rate(self.base)

    def _twin(self, source, proposal, new):
        """The key of an earlier row to whose minimum a descent from elsewhere has come; or None."""
        may_be = proposal.starts and not proposal.formulas and not new.is_failed
        for row in self.rows[1:] if may_be else ():  # laws know their forms, and tie
            is_like = (row.source, row.code, row.n_free) == (source, proposal.code, new.n_free)
            if is_like and abs(row.log_likelihood - new.log_likelihood) < SAME_MINIMUM:
                return row.key
        return None

    def _add(
        self, source, proposal, status, evidence, log_likelihood, n_free, held_out, twin=None
    ):  # fmt: skip
        """Add the row of a proposal."""
        number = len(self.rows)
        self.hypotheses[number], self.proposals[number] = proposal.hypothesis, proposal
        self.rows.append(
            Row(
                number, proposal.code, proposal.text, source, status, evidence,
                proposal.log_prior, log_likelihood, n_free, proposal.kind, held_out,
                key=twin or proposal.key, ties=() if status == "scored" else proposal.texts_of_ties,
                is_wide=proposal.is_wide, n_terms=len(proposal.formulas),
                n_pushes=sum(set(formula.inputs) <= UNIFORM for formula in proposal.formulas),
                n_kicks=_n_kicks(proposal.hypothesis) - _n_kicks(self.hypotheses[0]),
                is_of_pairs=any(n[-2:] == "_j" for f in proposal.formulas for n in f.inputs),
                is_alike=proposal.is_alike, is_echo=self._is_echo(proposal, self.fits.get(number)),
                left=_left_by(self.fits.get(number), self.fits[0].n_rows),
            )
        )  # fmt: skip
        return self.rows[-1]


def fit_of(shared, job):
    """The fit of a proposal, that which it is judged by, and its evidence; None if it has none."""
    (base, dataset, criteria, bounds, clock), (_, proposal) = shared, job

    def fitted(proposal):
        new = proposal.fitted(base, dataset, criteria=criteria, bounds=bounds, deadline=clock.left)
        return new, log_evidence(new, proposal.hypothesis, criteria)

    try:
        new, evidence = fitted(proposal)
        best = new
        if proposal.judged is not None and not new.is_failed:
            other, theirs = fitted(replace(proposal, hypothesis=proposal.judged))
            if theirs > evidence:
                best, evidence = other, theirs
    except FAULTS:
        return None
    return new, best, evidence


def more_under(noise, found):
    """Nats by which a fit is likelier under a noise up to as large as that of another fit.

    What a law leaves is told from its noise by what is smooth in it. So a cause that does not
    explain all may have less noise than the law without it, and would be less likely for that.
    """
    is_free = found.noise.is_free & noise.is_free
    if not is_free.any() or found.is_failed:
        return 0.0
    levels = np.array(noise.levels)[is_free] / np.array(found.noise.levels)[is_free]
    most = float(np.exp(np.mean(np.log(levels))))
    size = min(math.sqrt(found.chisqr / found.n_rows), most)
    if not size > 1.0:
        return 0.0
    if math.isinf(found.noise.degrees):
        return 0.5 * found.chisqr * (1.0 - size**-2.0) - found.n_rows * math.log(size)
    # Under tails a likelihood is no quadratic form: it is worked out.
    own = np.array(found.noise.levels)
    larger = replace(found.noise, levels=tuple(np.where(found.noise.is_free, size * own, own)))
    more = log_likelihood(larger, found.channels, found.residual) - found.log_likelihood
    return max(float(more), 0.0)


def is_less(base, found, more=0.0):
    """Whether a wider hypothesis explains the same rows worse than the one that it extends.

    `more` nats are added to its own, of another noise.

    Its maximum cannot lie lower: it has come to another minimum, in which what was declared counts
    for little. Such a one may be likelier because it says less of its numbers; it tells nothing of
    what is missing beside the declared law.
    """

    def numbers(fit):
        noise = {p.name for p in fit.noise.parameters if p.is_free}
        return {name for name, _ in fit.parameters} | noise

    if found.n_rows != base.n_rows or not numbers(base) <= numbers(found):
        return False
    return found.log_likelihood + more < base.log_likelihood - SAME_MINIMUM


def _n_kicks(hypothesis):
    """How many kicks there are in a hypothesis."""
    return len({part.mark for part in hypothesis.parts if isinstance(part, Kick)})


def _left_by(found, n_rows):
    """Root mean square of what a fit leaves of tracks, m; nan where it has none, or fewer rows."""
    if found is None or found.is_failed or not found.shows_tracks or found.n_rows < n_rows:
        return math.nan
    return size_left(found)


def swamped_by(found, dataset):
    """Size of the noise of a fit that has a memory, in how far bodies move about.

    Zero beside a law: where forces explain most of a motion noise may be any part of the rest.
    """
    if found.law.terms:
        return 0.0
    if found.noise.adding:
        return _swamped_added(found, dataset)
    if not found.noise.correlated:
        return 0.0
    moved = extent_of(dataset)
    sizes = np.nan_to_num(np.array(found.noise.levels), posinf=0.0)
    size = math.sqrt(found.noise.correlated) * float(np.linalg.norm(sizes))
    return size / moved if moved else 0.0


def _swamped_added(found, dataset):
    """Size of what is no noise, in all that is taken for it, of what adds up to places.

    Noise is what neighbouring rows differ by.
    """
    scatter, levels = np.array(estimate_noise(dataset).sigma), np.array(found.noise.levels)
    is_more = levels > MOST_SCATTER * scatter
    whole = float(np.square(levels[np.isfinite(levels)]).sum())
    return math.sqrt(float(np.square(levels[is_more]).sum()) / whole) if whole else 0.0


def extent_of(dataset):
    """How far bodies are off the middles of their tracks, root mean square, m."""
    moved = count = 0.0
    for scene in dataset.scenes:
        for track in np.moveaxis(scene.positions[:, scene.dynamic], 1, 0):
            seen = track[np.isfinite(track).all(axis=1)]
            if not len(seen):
                continue
            moved, count = moved + float(seen.var(axis=0).sum()) * len(seen), count + len(seen)
    return math.sqrt(moved / count) if moved else 0.0
