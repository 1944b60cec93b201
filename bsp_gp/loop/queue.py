"""Which proposals of a round are fitted, and in which order."""

import math
import operator
from dataclasses import replace

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.loop.forms import in_place_of
from bsp_gp.loop.proposal import PATIENT
from bsp_gp.loop.rows import EXPLAINED, FAR_BEHIND

UNEVEN = 0.02
"""Of the greatest promise, for each number that a cause adds: by so much promises are off far from
the tracks, and of those that differ by less the simpler is fitted first."""
MANY = 4
"""Numbers beyond which more of them (one of each body, say) count no further for that."""
LESS = 0.9
"""Of the reduced chi-squared of a fit, below which another has left less."""
REACH = 1.5
"""Times what it promised that a fit may gain; what stays behind with that is not fitted."""
MOST_UNKEPT = 3
"""Fits of a family that are no likelier than the law as it is, though they promised to be, or, of
what is no law, that lead nowhere, after which no more of it are made: what its promises are made of
is noise of another kind."""
MOST_BETTER = 2
"""Laws that are fitted after one that leaves nothing, since they do better as far as that tells."""
MOST_AGAIN = 3
"""Fits that did not converge and are gone on with, with patience, at the end of a round."""


class Queue:
    """Proposals that wait for a fit, and what fits tell of those that still do.

    Parameters
    ----------
    turn : Turn
    every : list of (str, Proposal)
        All there are, by family, those that promise most first.

    Attributes
    ----------
    jobs : list of (str, Proposal)
        What is fitted, in this order; it grows while fits end.
    above : dict of str to dict of int to (float, float)
        Posteriors and likelihoods above what was promised, by family and rank, nats.
    highest : dict of str to float
        The greatest promise of what was fitted of a family, nats.
    """

    def __init__(self, turn, every):
        self.turn, self.every = turn, every
        families, chances = turn.families, turn.chances
        controls = [(f.name, p) for f in families for p in f.controls]
        self.of_no_promise = {f.name for f in families if f.is_control}  # like that of others
        clear = [name for name, p in chances.items() if p <= turn.run.criteria.alpha]
        clear += [f.name for f in families if f.is_led and clear]
        chosen = [p for p in chosen_of(every, clear, turn.run.criteria) if p not in controls]
        self.jobs = [*controls, *chosen]
        self.n_controls, self.n_first = len(controls), len(self.jobs)
        self.heads = {f.name: f.proposals[0] for f in families if f.proposals}
        self.n_left = turn.most_fits
        self.above, self.least, self.highest = {}, {}, {}
        self._fewest = {}  # by family, numbers of what has had its turn
        self._again = {}  # rows that are gone on with, by their place
        self._broken = []  # proposals of all there is that left much, and reduced chi-squared
        self._unkept = {}  # by family, fits that are no likelier than the law as it is

    @property
    def n_most(self):
        """Fits that there may be."""
        most = min(self.n_first, self.n_controls + self.turn.most_fits)
        return most + len(self.jobs) - self.n_first

    @property
    def doubted(self):
        """Families whose promises some fits kept and others not, a set."""
        return {
            source for source, known in self.above.items()
            if max(nats for nats, _ in known.values()) > self.least[source] + FAR_BEHIND
        }  # fmt: skip

    def passes_over(self, at):
        """Whether what is at a place is by now not worth its fit; asked of each once, in turn."""
        turn, (source, proposal) = self.turn, self.jobs[at]
        # A single cause is of its family's own measure, like the best.
        is_lesser = proposal.rank < self._fewest.get(source, math.inf)
        is_head = proposal is self.heads.get(source)
        self._fewest[source] = min(proposal.rank, self._fewest.get(source, math.inf))
        measure = turn.measure.get(source, False)
        is_first = at < self.n_first and (is_lesser or is_head)
        if at < self.n_controls and source in self.of_no_promise and proposal.formulas:
            # What is fitted whatever it promises is spare only where all is explained.
            return proposal.n_laws > turn.enough or turn.nats_behind(proposal) > 0.0
        if turn.is_behind(proposal, {measure} if is_first else {False, True}):
            return True
        reach = REACH * (proposal.promise + turn.run.criteria.class_nats)
        if reach < turn.kept[not measure] and not turn.base.is_failed:
            return True  # whatever its measure, when all is explained
        if at in self._again and not turn.is_ahead(self._again[at]):
            return True  # of another fit since less is left
        if self._is_spare(proposal, at in self._again):
            return True
        is_counted = self.n_controls <= at < self.n_first
        if self._unkept.get(source, 0) >= MOST_UNKEPT:
            self.n_left -= is_counted  # nothing else takes its place
            return True
        if is_counted and self.n_left <= 0 and not is_head:
            return True  # many forms of one family leave none to those of others
        self.n_left -= is_counted
        return False

    def ends_with(self, at, row, proposal):
        """Note what the fit of what is at a place tells of the others; whether it is the last."""
        turn, (source, _) = self.turn, self.jobs[at]
        is_again, judged = at in self._again, turn.judged.get(row.id)
        is_lost = row.status == "unconverged" and proposal.instead is None
        is_open = is_lost and turn.is_ahead(row)
        if is_open and not is_again and len(self._again) < MOST_AGAIN:
            self._again[len(self.jobs)] = row
            self.jobs.append((source, replace(proposal, patience=PATIENT)))
        if row.status == "unconverged" and not is_again:
            self.jobs += [(source, other) for other in in_place_of(source, proposal)]
        if proposal.is_sole and row.is_fit and judged is not None and judged < EXPLAINED:
            return True
        is_left = judged is not None and judged > EXPLAINED
        if proposal.is_sole and is_left and proposal.instead is None:
            self._broken.append((proposal, judged))
        turn.has_most |= proposal.is_first and row.is_fit and turn.is_most(row)
        is_followed = at + 1 < self.n_first and self.jobs[at + 1][1].is_first
        if turn.has_most and not is_followed:
            return True
        if row.is_fit or not (is_open or proposal.formulas or proposal.instead):
            is_likelier = row.log_posterior > turn.rows[0].log_posterior
            self._unkept[source] = -math.inf if is_likelier else self._unkept.get(source, 0) + 1
        if row.is_fit:
            self._note_fit(source, row, proposal)
        return False

    def _note_fit(self, source, row, proposal):
        turn, was_open = self.turn, self.turn.explained is None
        turn.note_gain(row, proposal, turn.measure.get(source, False))
        if was_open and turn.explained:
            self.jobs += self._better()
        if source in self.of_no_promise:
            return
        own = row.log_posterior - proposal.promise, row.log_likelihood - 0.5 * proposal.gain
        known = self.above.setdefault(source, {}).get(proposal.rank, own)
        self.above[source][proposal.rank] = tuple(map(max, own, known))
        self.least[source] = min(self.least.get(source, math.inf), own[0])
        self.highest[source] = max(self.highest.get(source, -math.inf), proposal.promise)

    def _is_spare(self, proposal, is_again):
        """Whether fits before it tell that its own changes nothing."""
        turn, explained = self.turn, self.turn.explained
        if proposal.n_laws > min(turn.enough, turn.nearly + 1):  # a sum, where fewer leave nothing
            return True
        if explained and explained.includes(proposal):  # with another power in it
            return True
        near = 0.0 if is_again else 2 * turn.run.criteria.class_nats
        if explained and explained.proposal.news and not proposal.news:
            near = math.inf  # what a series explains makes no form of a textbook spare
        return _adds_to_failed(proposal, self._broken) or turn.nats_behind(proposal) > near

    def _better(self):
        """Laws that were not chosen, and do better than one that leaves nothing as that tells.

        Beside a law that is far off promises are not exact; at its tracks they nearly are.
        """
        tops = tops_of(self.every)
        able = [
            (source, proposal) for source, proposal in self.every
            if proposal.formulas and len(proposal.formulas) <= self.turn.enough
            and proposal.promise > tops[True] - max(FAR_BEHIND, tops[True] / 50)
            and (source, proposal) not in self.jobs
        ]  # fmt: skip
        behind = [(self.turn.nats_behind(proposal), k) for k, (_, proposal) in enumerate(able)]
        return [able[k] for nats, k in sorted(b for b in behind if b[0] < 0)[:MOST_BETTER]]


def chosen_of(every, clear, criteria):
    """The first proposal of every family that shows something, then those near the best.

    Promises of different families are not of one measure: laws are held against laws, and what
    corrects or leaves out rows against its like.
    """
    top, tops = every[0][1].promise if every else 0.0, tops_of(every)
    best, simplest, others = {}, {}, {}
    for name, proposal in every:
        if name in clear:
            best.setdefault(name, (name, proposal))
            # A single cause is fitted, however well a set of causes does.
            if name not in simplest or proposal.rank < simplest[name][1].rank:
                simplest[name] = (name, proposal)
            if proposal.has_other_starts:
                others[name, tuple(proposal.starts.values())] = (name, proposal)
            # Beside a law that is far off promises are not exact: of what promises about as much,
            # the best of every size, and of every form that leads a sum.
            # Those that may be all there is are fitted up to the first that is.
            own = tops[bool(proposal.formulas)]
            if proposal.is_sole or proposal.promise > own - max(FAR_BEHIND, own / 50):
                others.setdefault((name, proposal.rank), (name, proposal))
                others.setdefault((name, proposal.lead), (name, proposal))
    near = [
        pair for pair in every
        if pair[1].promise > tops[bool(pair[1].formulas)] - criteria.class_nats
        and (pair[1].formulas or pair[0] in clear)
    ]  # fmt: skip
    chosen, keys, groups = [], set(), ([*best.values(), *simplest.values()], others.values(), near)
    for group in groups:
        # Far from the tracks the simpler may explain all, where a sum does not converge.
        for name, proposal in sorted(group, key=lambda pair: -_evened(pair[1], top)):
            if (name, proposal) not in chosen and (proposal.key not in keys or proposal.starts):
                chosen.append((name, proposal))
                keys.add(proposal.key)
    return sorted(chosen, key=lambda pair: _order(pair[1]))


def tops_of(every):
    """What laws, and what is none, promise at the most, by whether it is a law."""
    tops: dict = {}
    for _, proposal in every:
        tops.setdefault(bool(proposal.formulas), proposal.promise)
    return tops


def _order(proposal):
    """False before true: what is fitted before what promises more.

    Beside a law that is far off forces promise so much that tracks which only bear the wrong names
    would be behind a dozen of them.
    """
    is_series = bool(proposal.news)  # it can stand for any form: those of textbooks come first
    return not proposal.is_first, not proposal.is_sole, not is_misread(proposal), is_series


def is_misread(proposal):
    """Whether it says that tracks bear wrong names or times, or are none in part."""
    return proposal.kind == "measurement" and proposal.is_afresh


def _evened(proposal, top):
    """What a proposal promises, of those that differ by less than promises are off the simplest."""
    return proposal.promise - UNEVEN * top * min(proposal.rank, MANY)


def _adds_to_failed(proposal, broken):
    """Whether it adds more forces to one that failed, of which none alone left less.

    Flights do not tell which: a drag that they hardly show makes contacts late by many rows.
    """
    own = [part for part in proposal.hypothesis.parts if not isinstance(part, Forces)]
    left = {}
    for failed, chi2 in broken:
        theirs = [part for part in failed.hypothesis.parts if not isinstance(part, Forces)]
        if len(own) == len(theirs) and all(map(operator.is_, own, theirs)):
            left[failed.rank] = min(chi2, left.get(failed.rank, math.inf))
    plain = min(left, default=math.inf)
    more = [chi2 for rank, chi2 in left.items() if plain < rank < proposal.rank]
    return bool(more) and not min(more) < LESS * left[plain]
