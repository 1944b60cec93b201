"""Closing the loop: propose, fit, compare, decide, until nothing is missing or can be named."""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.followed import PASSES, cut_short
from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.fitting.student import log_likelihood
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.loop.aside import Aside, is_hopeless, law_beside, settled
from bsp_gp.loop.clock import Clock, TimeIsUp
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import SWAMPED, decide
from bsp_gp.loop.evidence import WEAK, log_evidence, significance
from bsp_gp.loop.foresight import is_foreseen
from bsp_gp.loop.proposal import FAULTS, PATIENT, both_of, continued, without_term
from bsp_gp.loop.questions import hidden_bound, noise_findings
from bsp_gp.loop.retraced import usual_law
from bsp_gp.loop.rivals import Explained
from bsp_gp.loop.slight import LITTLE, leaves_little, size_left, without_the_slight
from bsp_gp.loop.table import SAME_MINIMUM, HeldOut, HypothesisTable, Row, held_out_gain, part_of
from bsp_gp.loop.trace import trace
from bsp_gp.loop.view import View, selected
from bsp_gp.physics.force import ForceLaw, Term, kind_of, split_linear
from bsp_gp.workers import Crew

__all__ = ["Round", "run_rounds"]

EXPLAINED = 1.5
"""Reduced chi-squared below which a cause beside free forces explains the tracks."""
FAR_BEHIND = 100.0
"""Nats by which a promise is behind one that was kept and explained all there is: what explains as
much is told from the same moments as it."""
SPARE = {True: 0.02, False: 0.002}
"""Of a kept promise: what others may be off by that rows make, since they are not linear in the
numbers of an instrument; and moments, beside what the kept one leaves of them beyond the noise."""
UNEVEN = 0.02
"""Of the greatest promise, for each number that a cause adds: by so much promises are off far from
the tracks, and of those that differ by less the simpler is fitted first."""
FEWER = 2
"""Times fewer fits and no seconds where rounds before have left little of what is missing."""
MANY = 4
"""Numbers beyond which more of them (one of each body, say) count no further for that."""
WITHIN_NOISE = 3.0
"""Standard deviations of chi-squared within which a law leaves nothing for a sum with more laws."""
NEARLY_NOTHING, CLEARLY_LESS = 1e-3, 0.7
"""Part of chi-squared that a law leaves which tells of others nearly as one that leaves nothing, in
place of which another comes that leaves less than so much of it."""
HALF_AS_MUCH = 0.5
"""Part of what a memory of the noise promises that forces must, to be fitted in its place."""
LESS = 0.9
"""Of the reduced chi-squared of a fit, below which another has left less."""
REACH = 1.5
"""Times what it promised that a fit may gain; what stays behind with that is not fitted."""
MOST_OF_ALL = 0.9
"""Part of all that is missing by the moments that a cause must explain not to stay behind what
tracks have gained otherwise."""
MOST_LEFT = 0.3
"""Part of the reduced chi-squared that may be left by what comes before all other causes."""
MOST_BESIDE = 0.1
"""Part of what a law leaves, up to which a rod or a rail leaves little."""
MOST_IN_TIME, MOST_FORESEEN = 0.3, 0.5
"""The same of a law that is told as a description where the time is up, and of one that scenes
which are left out in turn bear out."""
ALL_IN_TIME = 1e-3
"""The same of one that is adopted all the same."""
MOST_HELD = 3
"""Rods and rails that are fitted before all else."""
MOST_UNKEPT = 3
"""Fits of a family that are no likelier than the law as it is, though they promised to be, or, of
what is no law, that lead nowhere, after which no more of it are made: what its promises are made of
is noise of another kind."""
PROPOSERS, PROPOSING = 0.5, 0.6
"""Part of the time that all proposers may take, and each of what is left of that."""
MOST_BETTER = 2
"""Laws that are fitted after one that leaves nothing, since they do better as far as that tells."""
MOST_AGAIN = 3
"""Fits that did not converge and are gone on with, with patience, at the end of a round."""
MOST_DOUBTED = 3
"""Rivals that are fitted where promises of their family were off; where none of so many does as
well as it was expected to, no more of the family are told."""
MOST_LIMITS = 3
"""Simpler forms that are fitted in the place of one whose numbers end at their bounds."""
MOST_FIRSTS, MOST_SECONDS = 3, 2
"""Laws beside which a second is asked for, where each leaves much, and seconds that are fitted."""
MOST_USUAL = 2
"""Laws of textbooks, alone or two, that are fitted before another cause is told."""
MOST_TOLD = 10
"""Variables with which what is missing changes."""
WEIGHTY = 0.8
"""Part of chi-squared, as forces see it, that a steady push takes away to be fitted always."""
UNIFORM = frozenset(("e_x", "e_y", "e_z", "up", "down", "m_i"))
"""What a uniform push is made of."""


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    entering : Fit
    decision : Decision
    fits : dict of int to Fit
        By the id of the row.
    hypotheses : dict of int to Hypothesis
    families : tuple of Family
    proposals : dict of int to Proposal
    left_out : tuple of str
        What there was no time for, of `LEFT_OUT`.
    details : dict
        What the proposer of the likeliest cause tells beyond its fit.
    detectable : float, m/s^2
        Least constant acceleration that would have been seen, see `View.detectable`.
    hidden_bound, trace : object or None
        What else was asked of the fit that enters.
    aside : Aside or None
        What it would adopt, while laws are asked for without that.
    usual : Aside or None
        What it would adopt of textbooks, where it adopts an odd law that leaves hardly less.
    """

    number: int
    entering: object
    table: HypothesisTable
    decision: object
    fits: dict
    hypotheses: dict
    families: tuple
    proposals: dict = field(default_factory=dict)
    seconds: float = 0.0
    left_out: tuple = ()
    details: dict = field(default_factory=dict)
    detectable: float = np.nan
    noise_findings: tuple = ()
    varies_with: tuple = ()
    hidden_bound: object = None
    trace: object = None
    aside: object = None
    usual: object = None

    @property
    def continuing(self):
        """The hypothesis to go on with."""
        best = self.decision.best
        return self.hypotheses[best.id if self.decision.is_adopted else 0]

    @property
    def is_last(self):
        """Whether nothing is asked for beside what it adopted."""
        best = self.decision.best
        return self.decision.is_adopted and best is not None and self.proposals[best.id].is_last

    @property
    def is_beside_more(self):
        """Whether what it adopts was judged beside forces that are to be found yet."""
        best = self.decision.best
        own = self.proposals.get(best.id) if self.decision.is_adopted and best else None
        is_judged_so = own is not None and own.judged is not None
        return is_judged_so or self.decision.is_beside_more

    @property
    def goes_on(self):
        """Whether a round follows."""
        return self.decision.is_adopted and not self.is_last and not self.left_out

    @property
    def after(self):
        """The fit to go on with."""
        if self.decision.is_adopted:
            return self.fits[self.decision.best.id]
        return self.entering


def run_rounds(
    hypothesis, dataset, proposers, *, rng, criteria=None, max_rounds=5, starts=None, bounds=None,
    clock=None, on_round=None, begun=None, earlier=None, progress=None, looks=1, crew=None,
    is_refused=None, instead=None, is_enough=None,
):  # fmt: skip
    """Rounds up to the first that adopts nothing.

    Parameters
    ----------
    hypothesis : Hypothesis
        What is declared.
    dataset : Dataset
        Training scenes.
    proposers : sequence
        With ``propose(view) -> Family``, and ``asks_rows`` true where they ask what a fit leaves
        of the rows and not what forces do; those are asked of fits only that have succeeded,
        unless ``sees_places`` is true. Where ``is_alone`` is false they tell the view what it may
        leave to others, or read that: they are asked one after the other, in their order.
    rng : numpy.random.Generator
    criteria : Criteria, optional
    max_rounds : int
    starts, bounds : dict, optional
        Of the constants of what is declared.
    clock : Clock, optional
        Ends a round in which something must be left out; such a round adopts nothing.
    on_round : callable, optional
        ``on_round(round)`` after every round.
    begun : Fit, optional
        Of what is declared; it is fitted here where none is given.
    earlier : sequence of Round, optional
        That a run before this one has made; one that its time limit has cut is made again.
    progress : callable, optional
    looks : int
        Data sets, this one among them, of which any may show that something is missing.
    crew : Crew, optional
        By whom proposals are fitted.
    is_refused : callable, optional
        ``is_refused(round)``: whether what a round adopts will be taken back, since it makes
        predictions worse: none is found beside it. Of a cause that was judged beside forces that
        are to be found it is not asked, as long as these are not.
    instead : callable, optional
        ``instead(round, criteria)``: the round with another cause in the place of such a one.
    is_enough : callable, optional
        ``is_enough(rounds)``: whether no more rounds are wanted.
    """
    run = _Run(dataset, proposers, criteria or Criteria(), bounds or {}, clock or Clock(),
               progress or (lambda text: None), looks, crew or Crew())  # fmt: skip
    rounds = [done for done in earlier or () if not done.left_out]
    if rounds:
        found, hypothesis = rounds[-1].after, rounds[-1].continuing
    elif begun is not None:
        found = begun
    else:
        found = fit(hypothesis, dataset, starts=starts, bounds=bounds, deadline=run.clock.left)
    for number, stream in enumerate(rng.spawn(max_rounds), 1):
        if number <= len(rounds):
            continue
        if rounds and (not rounds[-1].goes_on or is_hopeless(rounds)):
            break
        is_open = any(done.aside is not None for done in rounds)
        if rounds and not is_open and is_enough is not None and is_enough(rounds):
            break
        if rounds and not rounds[-1].is_beside_more and is_refused and is_refused(rounds[-1]):
            break
        is_little = bool(rounds) and leaves_little(rounds[0].entering, found)
        done = run.round(number, hypothesis, found, stream, is_little)
        if instead is not None and done.goes_on and not done.is_beside_more:
            done = instead(done, run.criteria)
        if rounds:
            done = without_the_slight(rounds[0].entering, done, dataset)
        rounds.append(done)
        if on_round is not None:
            on_round(done)
        found, hypothesis = done.after, done.continuing
    return settled(rounds)


@dataclass(frozen=True, eq=False)
class _Run:
    """What all rounds share."""

    dataset: object
    proposers: tuple
    criteria: Criteria
    bounds: dict
    clock: Clock
    says: object
    looks: int
    crew: Crew

    @property
    def usual(self):
        """Laws that are asked first of any motion."""
        return next((p.common for p in self.proposers if hasattr(p, "common")), ())

    def is_usual(self, proposal):
        """Whether a proposal is of one or two laws of textbooks and of nothing else."""
        usual = {split_linear(formula)[1] for formula in self.usual}
        rest = [split_linear(formula)[1] for formula in proposal.formulas]
        return proposal.is_usual or 0 < len(rest) <= 2 and usual.issuperset(rest)

    def view_of(self, found, hypothesis, rng):
        """What proposers see of a fit."""
        near = continued(hypothesis, found)
        view = View(found, near, self.dataset, rng, self.criteria, self.usual)
        view.tick, view.seconds_left = self.clock.tick, self.clock.left
        return view

    def round(self, number, hypothesis, found, rng, is_little=False):
        """One round; where little is left of what was missing, with less effort."""
        started = time.monotonic()
        turn = _Turn(self, found, hypothesis, is_little)
        asked, view = {}, None
        if found.shows_tracks:
            view = self.view_of(found, hypothesis, rng)
            if not found.is_failed:
                view.noise_findings = noise_findings(view)
            held = self.held(number, found, hypothesis, view)
            held = held or self.drawn(number, found, hypothesis, view)
            turn = held or turn
            if held is None:
                turn.propose(number, view, self.proposers)
            asked = self.asked(view)
            turn.p_value = turn.p_of_all(view, self.looks)
            if turn.p_value > self.criteria.alpha and turn.ask_the_rest(number, view):
                turn.p_value = turn.p_of_all(view, self.looks)
            if turn.p_value > self.criteria.alpha:
                turn.ask_without_memory(number, view)
                turn.ask_swamped()
            else:
                asked |= self.traced(view, turn)
                if held is None:
                    turn.fit_best()
                    turn.fit_the_rest(number, view)
                    if not is_little:
                        turn.fit_seconds(number, rng)
        if turn.unasked:
            turn.note("proposers")
        turn.note_time("fits")
        turn.share_noise()
        of_noise = (view.noise_chance, view.forced, turn.swamped) if view else ()
        table = HypothesisTable(tuple(turn.rows), turn.p_value, *of_noise)
        table = table.without_repeats().with_probabilities()
        decision, aside = decide(table, self.criteria), None
        law = law_beside(table, decision, turn.proposals, self.criteria)
        if law is not None:
            aside = Aside(decision, self.details(decision.best, turn, view, rng))
            decision = law
        decision, usual = turn.in_time(decision), None
        details = self.details(decision.best, turn, view, rng)
        plain = usual_law(turn, table, decision, self.is_usual)
        if plain is not None:
            usual = Aside(plain, self.details(plain.best, turn, view, rng))
        return Round(
            number, found, table, decision, turn.fits, turn.hypotheses, tuple(turn.families),
            turn.proposals, time.monotonic() - started, tuple(turn.left_out), details,
            aside=aside, usual=usual, **asked,
        )  # fmt: skip

    def held(self, number, found, hypothesis, view):
        """A turn that asks for rods and rails alone, where one is surely seen; else None.

        Nothing else keeps a body at one distance while its speed changes: where such a rod leaves
        little of what the law before it did, forces are asked for beside it, and not in its place.
        """
        if found.is_failed:
            return None
        turn = _Turn(self, found, hypothesis)
        turn.propose(number, view, [p for p in self.proposers if hasattr(p, "is_structural")])
        sole = [(f.name, p) for f in turn.families for p in f.proposals if p.is_sole]
        if not sole or turn.p_of_all(view, self.looks) > self.criteria.alpha:
            return None
        is_whole = turn.fit_held(sole[:MOST_HELD]) and not (turn.left_out or turn.unasked)
        return turn if is_whole else None

    def drawn(self, number, found, hypothesis, view):
        """A turn that asks for gravity alone, where the sky shows it and it takes most; else None.

        Hardly anything else moves what is up there: before it is known no other form is asked for,
        of which many explain orbits of few turns as well.
        """
        if found.is_failed or found.law.terms or not view.is_sky:
            return None
        turn = _Turn(self, found, hypothesis)
        turn.propose(number, view, [p for p in self.proposers if hasattr(p, "is_of_sky")])
        turn.families = [
            replace(f, proposals=first, n_controls=len(first), is_control=False)
            for f in turn.families if (first := tuple(p for p in f.proposals if p.is_first))
        ]  # fmt: skip
        if not turn.families or turn.p_of_all(view, self.looks) > self.criteria.alpha:
            return None
        turn.fit_best()
        return turn if turn.has_most and not (turn.left_out or turn.unasked) else None

    def details(self, best, turn, view, rng):
        """What its proposer tells of the likeliest cause, if it does."""
        proposer = next((p for p in self.proposers if best and p.name == best.source), None)
        if not hasattr(proposer, "details") or best.id not in turn.fits or self.clock.is_over:
            return {}
        self.says(f"drawing from the posterior of {best.text}")
        (stream,) = rng.spawn(1)
        return proposer.details(view, turn.proposals[best.id], turn.fits[best.id], stream)

    def asked(self, view):
        """What else is asked of the fit that enters, by names of `Round`."""
        alpha = self.criteria.alpha
        found = tuple(f for f in view.noise_findings if f.p_value <= alpha)
        return {
            "detectable": view.detectable(alpha), "noise_findings": found,
            "hidden_bound": hidden_bound(view),
        }  # fmt: skip

    def traced(self, view, turn):
        """Where what is missing is, and on what it depends, by names of `Round`."""
        if turn.note_time("fits") or view.dataset.is_of_sight:  # no place is known for a force
            return {}
        found = trace(view)
        varies = tuple(
            {"term": c.direction, "variable": c.variable, "p_value": c.p_value}
            for c in found.channels if c.variable and c.evidence > 0
        )  # fmt: skip
        return {"trace": found, "varies_with": varies[:MOST_TOLD]}


class _Turn:
    """Rows, fits and families of a round while it runs."""

    def __init__(self, run, found, hypothesis, is_little=False):
        self.run, self.base = run, found
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
        moved = moved if math.isfinite(moved) else _extent(self.run.dataset)
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

    def propose(self, number, view, proposers):
        """Ask those proposers for which there is time."""
        self.levels = np.array(view.fit.noise.levels)
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
            k, n = self.run.proposers.index(proposer) + 1, len(self.run.proposers)
            if proposers is self.run.proposers:
                self.run.says(f"round {number}: {proposer.name} ({k} of {n})")
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
        self.propose(number, view, self.run.proposers)
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
            self._followed(*job, _fit_of(self._shared, job))[0] for job in controls
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
        controls = [(f.name, p) for f in self.families for p in f.controls]
        apart = {f.name for f in self.families if f.is_control}  # of no promise like others
        clear = [name for name, p in self.chances.items() if p <= self.run.criteria.alpha]
        clear += [f.name for f in self.families if f.is_led and clear]
        chosen = [p for p in _chosen(every, clear, self.run.criteria) if p not in controls]
        queue = [*controls, *chosen]
        n_first, above, least, highest, asked, left = len(queue), {}, {}, {}, {}, {}
        heads = {f.name: f.proposals[0] for f in self.families if f.proposals}
        broken = []  # proposals of all there is that left much, and reduced chi-squared
        unkept = {}  # by family, fits that are no likelier than the law as it is
        fits, n_left = self._fits(queue), self.most_fits
        n_most, n_fits = len(controls) + n_left, 0
        for k, (source, proposal) in enumerate(queue):
            if self.note_time("fits"):
                break
            # A single cause is of its family's own measure, like the best.
            is_lesser = proposal.rank < asked.get(source, math.inf)
            is_first = k < n_first and (is_lesser or proposal is heads[source])
            asked[source] = min(proposal.rank, asked.get(source, math.inf))
            measure, is_again = self.measure.get(source, False), k in left
            measures = {measure} if is_first else {False, True}
            if self._is_behind(proposal, measures):
                continue
            reach = REACH * (proposal.promise + self.run.criteria.class_nats)
            if reach < self.kept[not measure] and not self.base.is_failed:
                continue  # whatever its measure, when all is explained
            if is_again and not self._is_ahead(left[k]):
                continue  # of another fit since less is left
            if self._is_spare(proposal, broken, is_again):
                continue
            if unkept.get(source, 0) >= MOST_UNKEPT:
                n_left -= len(controls) <= k < n_first  # nothing else takes its place
                continue
            if len(controls) <= k < n_first:
                if n_left <= 0 and proposal is not heads[source]:
                    continue  # many forms of one family leave none to those of others
                n_left -= 1
            n_fits += 1  # proposals that are passed over are none of the fits that may yet come
            most = min(n_first, n_most) + len(queue) - n_first
            self.run.says(f"fit {n_fits} of {most}: {proposal.text}")
            was_open = self.explained is None
            row, proposal = self._followed(source, proposal, fits.result(k))
            is_lost = row.status == "unconverged" and proposal.instead is None
            is_open = is_lost and self._is_ahead(row)
            if is_open and not is_again and len(left) < MOST_AGAIN:
                left[len(queue)] = row
                queue.append((source, replace(proposal, patience=PATIENT)))
            if row.status == "unconverged" and not is_again:
                queue += [(source, other) for other in _in_place_of(source, proposal)]
            if proposal.is_sole and row.is_fit and self.judged.get(row.id, 9.0) < EXPLAINED:
                break
            is_left = self.judged.get(row.id, 0.0) > EXPLAINED
            if proposal.is_sole and is_left and proposal.instead is None:
                broken.append((proposal, self.judged[row.id]))
            self.has_most |= proposal.is_first and row.is_fit and self._is_most(row)
            if self.has_most and not (k + 1 < n_first and queue[k + 1][1].is_first):
                break
            if row.is_fit or not (is_open or proposal.formulas or proposal.instead):
                is_likelier = row.log_posterior > self.rows[0].log_posterior
                unkept[source] = -math.inf if is_likelier else unkept.get(source, 0) + 1
            if row.is_fit:
                self._note_gain(row, proposal, self.measure.get(source, False))
            if was_open and self.explained:
                queue += self._better(every, queue)
            if row.is_fit and source not in apart:
                own = row.log_posterior - proposal.promise, row.log_likelihood - 0.5 * proposal.gain
                known = above.setdefault(source, {}).get(proposal.rank, own)
                above[source][proposal.rank] = tuple(map(max, own, known))
                least[source] = min(least.get(source, math.inf), own[0])
                highest[source] = max(highest.get(source, -math.inf), proposal.promise)
        fits.end()
        self.share_noise()
        self._fit_weight(every)
        self._fit_usual(every)
        self._fit_limits()
        self._fit_shared()
        self._prune()
        off = {
            source for source, known in above.items()
            if max(nats for nats, _ in known.values()) > least[source] + FAR_BEHIND
        }  # fmt: skip
        self._tell_near(every, above, highest, off)
        self._fit_foreseen()
        self._fit_part()

    @property
    def _fitted_keys(self):
        """Keys of what was fitted, a set."""
        return {row.key for row in self.rows if row.is_fit}

    @property
    def _likeliest(self):
        """The row of the likeliest proposal that was fitted, or None."""
        fitted = (row for row in self.rows[1:] if row.is_fit and row.id in self.proposals)
        return max(fitted, key=lambda row: row.log_posterior, default=None)

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
            self._fitted(row.source, proposal, _fit_of(self._shared, (row.source, proposal)))

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
            self._followed(source, best, _fit_of(self._shared, (source, best)))

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
            self._followed(source, proposal, _fit_of(self._shared, (source, proposal)))

    def fit_held(self, queue):
        """Fit rods and rails, beside a drag what slows down too much; whether one leaves little.

        The others are not asked where one leaves noise alone: a piece of a circle is nearly a
        parabola.
        """
        leaves_little = False
        for k, (source, proposal) in enumerate(queue, 1):
            for one in filter(None, (proposal, proposal.instead)):
                if self.note_time("fits"):
                    return leaves_little
                self.run.says(f"fit {k} of {len(queue)}: {one.text}")
                found = _fit_of(self._shared, (source, one))
                row, _ = self._followed(source, replace(one, instead=None), found)
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
            both = _fit_of(shared, job)
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
                simpler = _led_by(simpler, proposal, found, self.run.criteria)
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
        shared = row and _with_one_strength(
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
            smaller = _without_weakest(proposal, found, self.run.criteria)
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

    def _is_behind(self, proposal, measures):
        """Whether a proposal promises too little beside what was found to be worth a fit.

        What moments promise of a force and rows of an instrument is not of one measure: the first
        of a family is held against what was found in the same way only.
        """
        found = max(self.found[m] for m in measures)
        far = (self.kept[m] - max(FAR_BEHIND, self.spare[m]) for m in measures)
        # Rows that are left out take along whatever is wrong with them, names that are swapped too.
        if proposal.promise < max(far) and not _is_misread(proposal):
            return True
        if measures == {False} and proposal.gain > MOST_OF_ALL * self.missing:
            return False  # moments cannot promise more
        return REACH * (proposal.promise + self.run.criteria.class_nats) < found

    def _is_spare(self, proposal, broken, is_again):
        """Whether fits before it tell that its own changes nothing."""
        if proposal.n_laws > min(self.enough, self.nearly + 1):  # a sum, where fewer leave nothing
            return True
        if self.explained and self.explained.includes(proposal):  # with another power in it
            return True
        near = 0.0 if is_again else 2 * self.run.criteria.class_nats
        if self.explained and self.explained.proposal.news and not proposal.news:
            near = math.inf  # what a series explains makes no form of a textbook spare
        return _is_hopeless(proposal, broken) or self._nats_behind(proposal) > near

    @cached_property
    def swamped(self):
        """Size of the noise with a memory that the base has, in that of the motion."""
        return _swamped(self.base, self.run.dataset) if self.base.shows_tracks else 0.0

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

    def _better(self, every, queue):
        """Laws that were not chosen, and do better than one that leaves nothing as that tells.

        Beside a law that is far off promises are not exact; at its tracks they nearly are.
        """
        tops = tops_of(every)
        able = [
            (source, proposal) for source, proposal in every
            if proposal.formulas and len(proposal.formulas) <= self.enough
            and proposal.promise > tops[True] - max(FAR_BEHIND, tops[True] / 50)
            and (source, proposal) not in queue
        ]  # fmt: skip
        behind = [(self._nats_behind(proposal), k) for k, (_, proposal) in enumerate(able)]
        return [able[k] for nats, k in sorted(b for b in behind if b[0] < 0)[:MOST_BETTER]]

    def _explained(self, row, proposal, found):
        """What a law that leaves nothing, or next to it, says of others that promise much."""
        if not proposal.promise > FAR_BEHIND or self.run.clock.is_over:
            return None
        try:
            return Explained(row, proposal, found, self.run.dataset, self._left(found))
        except FAULTS:
            return None

    def _nats_behind(self, proposal):
        """How far a proposal is behind a law that leaves nothing; nan where that is not told."""
        return self.explained.behind(proposal) if self.explained else math.nan

    def _is_ahead(self, row):
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
            if new is None or not new.lost or not self._is_ahead(row) or self.note_time("fits"):
                break
            hypothesis = cut_short(proposal.hypothesis, new)
            proposal = replace(proposal, hypothesis=hypothesis, starts=new.starts)
            row = self._fitted(source, proposal, _fit_of(self._shared, (source, proposal)))
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
        found = _fit_of(self._shared, ("", alike))
        if found is None or found[0].is_failed or not self._left(found[0]) < EXPLAINED:
            return price
        return price + max(found[2] - self.rows[0].log_evidence, 0.0)

    @property
    def _shared(self):
        """What all fits of this turn share."""
        run = self.run
        return self.near, run.dataset, run.criteria, run.bounds, run.clock

    def _is_most(self, row):
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

    def _note_gain(self, row, proposal, measure):
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

    def _tell_near(self, every, above, most, off):
        """Rows of what was scored only, `every`, in the terms of what was fitted of its family.

        `above` are posteriors and likelihoods above what was promised, by family and rank. Of what
        promises much more than `most`, the greatest of what was fitted, nothing is foreseen: it was
        asked for and did not fit. Of families in `off`, whose promises some kept and others not,
        the likeliest are fitted.
        """
        criteria = self.run.criteria
        least = max(row.log_posterior for row in self.rows) - criteria.class_nats
        highest = max(row.log_evidence for row in self.rows)
        equal = highest - 2 * criteria.tie_nats
        known = {row.key for row in self.rows}
        best = self.proposals.get(max(self.rows, key=lambda row: row.log_posterior).id)
        # Sums that are as long as the likeliest one are told, too.
        enough = max(self.enough, len(best.formulas) if best else 0)
        near = []
        for source, proposal in every:
            if source not in above or len(proposal.formulas) > enough:
                continue
            loss = self.explained.loss(proposal) if self.explained else math.nan
            if not math.isnan(loss):  # told by more than promises
                row, mine = self.explained.row, self.explained.proposal
                evidence = row.log_evidence - loss + proposal.volume - mine.volume
                height, is_foreseen = row.log_likelihood - loss, True
            else:
                # Where none of so many numbers was fitted, no more is expected than of any other.
                own = above[source]
                offset, height = own.get(proposal.rank) or tuple(np.min(list(own.values()), axis=0))
                evidence = offset + proposal.promise - proposal.log_prior
                height += 0.5 * proposal.gain
                is_foreseen = proposal.promise <= most[source] + criteria.class_nats
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
                found = _fit_of(self._shared, (source, proposal))
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
        both = {False, True}
        return self.run.crew.work(
            _fit_of, self._shared, queue, lambda job: not self._is_behind(job[1], both)
        )

    def _fit_after(self, row, proposal):
        """The row of a proposal whose fit begins at that of another row."""
        shared = self.fits[row.id], *self._shared[1:]
        found = _fit_of(shared, (row.source, proposal))
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
        more = _more_under(self.base.noise, best) if self.base.shows_tracks else 0.0
        is_less = self.rows[0].is_fit and not new.is_failed and _is_less(self.base, best, more)
        # What takes the motion itself for noise explains nothing better than any law.
        is_less = is_less and self.swamped <= SWAMPED
        if is_less or self._is_open_series(proposal, new):
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
                is_alike=proposal.is_alike,
                left=_left_by(self.fits.get(number), self.fits[0].n_rows),
            )
        )  # fmt: skip
        return self.rows[-1]


def _n_kicks(hypothesis):
    """How many kicks there are in a hypothesis."""
    return len({part.mark for part in hypothesis.parts if isinstance(part, Kick)})


def _left_by(found, n_rows):
    """Root mean square of what a fit leaves of tracks, m; nan where it has none, or fewer rows."""
    if found is None or found.is_failed or not found.shows_tracks or found.n_rows < n_rows:
        return math.nan
    return size_left(found)


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


def _swamped(found, dataset):
    """Size of the noise of a fit that has a memory, in how far bodies move about.

    Zero beside a law: where forces explain most of a motion noise may be any part of the rest.
    """
    if found.law.terms or not found.noise.correlated:
        return 0.0
    moved = _extent(dataset)
    sizes = np.nan_to_num(np.array(found.noise.levels), posinf=0.0)
    size = math.sqrt(found.noise.correlated) * float(np.linalg.norm(sizes))
    return size / moved if moved else 0.0


def _extent(dataset):
    """How far bodies are off the middles of their tracks, root mean square, m."""
    moved = count = 0.0
    for scene in dataset.scenes:
        for track in np.moveaxis(scene.positions[:, scene.dynamic], 1, 0):
            seen = track[np.isfinite(track).all(axis=1)]
            if not len(seen):
                continue
            moved, count = moved + float(seen.var(axis=0).sum()) * len(seen), count + len(seen)
    return math.sqrt(moved / count) if moved else 0.0


def _fit_of(shared, job):
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


def _more_under(noise, found):
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


def _is_less(base, found, more=0.0):
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


def _is_hopeless(proposal, broken):
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


def _without_weakest(proposal, found, criteria):
    """A sum of laws without its weakest term, from where its fit is; None if all are strong."""
    strengths = {}
    for formula in proposal.formulas:
        own = significance(found, split_linear(formula)[0])
        strengths[formula] = own[0] if len(own) == 1 and own[0] >= 0 else math.inf
    weakest = min(strengths, key=strengths.get)
    hypothesis = without_term(proposal.hypothesis, weakest)
    if hypothesis is None or not strengths[weakest] < WEAK:
        return None
    formulas = tuple(f for f in proposal.formulas if f != weakest)
    known = hypothesis.own(found.law.constants).items()
    return replace(
        proposal, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts={name: value for name, value in known if isinstance(value, float)},
        bounds=hypothesis.own(proposal.bounds), formulas=formulas, ties=(),
        rank=proposal.rank - 1, log_prior=min(proposal.log_prior + criteria.cause_nats, 0.0),
        patience=1, after=None,
    )  # fmt: skip


def _led_by(form, proposal, found, criteria):
    """A sum of laws with another form in the place of its first, from where its own fit is."""
    first, *rest = proposal.formulas
    terms = tuple(Term(formula, kind_of(formula)) for formula in rest)
    known = {name: found.law.constants[name] for term in terms for name in term.formula.constants}
    hypothesis = form.hypothesis
    hypothesis = hypothesis + Forces(ForceLaw(terms, known)) if terms else hypothesis
    formulas = (*form.formulas, *rest)
    return replace(
        form, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts={**form.starts, **known}, bounds={**form.bounds, **hypothesis.own(proposal.bounds)},
        formulas=formulas, ties=(), gain=proposal.gain,
        rank=proposal.rank - len(first.constants) + len(form.formulas[0].constants),
        log_prior=form.log_prior - criteria.cause_nats * len(rest),
    )  # fmt: skip


def _with_one_strength(proposal, base, found, criteria):
    """A law of a strength for each owner with one for all; None where it has none such."""
    names = {n: n.partition("[")[0] for f in proposal.formulas for n in f.constants}
    if all(old == new for old, new in names.items()):
        return None
    formulas = tuple(rename_constants(f, names) for f in proposal.formulas)
    values = {new: found.law.constants[old] for old, new in names.items()}
    values = {
        n: float(np.median(list(v.values()))) if isinstance(v, Mapping) else v
        for n, v in values.items()
    }  # fmt: skip
    law = ForceLaw(tuple(Term(formula, kind_of(formula)) for formula in formulas), values)
    return replace(
        proposal, code="law", text=" + ".join(map(to_text, formulas)),
        hypothesis=base + Forces(law, None), formulas=formulas, rank=len(values), ties=(),
        starts=values, log_prior=proposal.log_prior + criteria.cause_nats, is_wide=False,
    )  # fmt: skip


def _in_place_of(source, proposal):
    """What is fitted in the place of a proposal whose fit does not end."""
    if proposal.instead is not None:
        return [proposal.instead]
    is_long = source == "inside" and len(proposal.formulas) > 2
    return [less for less in [_shorter(proposal)] if less is not None] if is_long else []


def _shorter(proposal):
    """A sum of laws without its last term, as it was proposed; None where that says all of it.

    A descent that came to no end says nothing of a sum that is part of it. Of laws without numbers
    inside sums of every size are fitted anyway.
    """
    hypothesis = without_term(proposal.hypothesis, proposal.formulas[-1])
    if hypothesis is None:
        return None
    formulas = proposal.formulas[:-1]
    return replace(
        proposal, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis,
        starts=hypothesis.own(proposal.starts), bounds=hypothesis.own(proposal.bounds),
        formulas=formulas, ties=(), rank=proposal.rank - len(proposal.formulas[-1].constants),
    )  # fmt: skip


def _chosen(every, clear, criteria):
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
    return not proposal.is_first, not proposal.is_sole, not _is_misread(proposal), is_series


def _is_misread(proposal):
    """Whether it says that tracks bear wrong names or times, or are none in part."""
    return proposal.kind == "measurement" and proposal.is_afresh


def _evened(proposal, top):
    """What a proposal promises, of those that differ by less than promises are off the simplest."""
    return proposal.promise - UNEVEN * top * min(proposal.rank, MANY)
