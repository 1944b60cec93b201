"""Closing the loop: propose, fit, compare, decide, until nothing is missing or can be named."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.fitting.fit import fit
from bsp_gp.loop.aside import Aside, is_hopeless, law_beside, settled
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import decide
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.questions import hidden_bound, noise_findings
from bsp_gp.loop.retraced import usual_law
from bsp_gp.loop.slight import leaves_little, without_the_slight
from bsp_gp.loop.table import HypothesisTable
from bsp_gp.loop.trace import trace
from bsp_gp.loop.turn import Turn
from bsp_gp.loop.view import View
from bsp_gp.physics.force import split_linear
from bsp_gp.workers import Crew

__all__ = ["Round", "run_rounds"]

MOST_HELD = 3
"""Rods and rails that are fitted before all else."""
MOST_TOLD = 10
"""Variables with which what is missing changes."""


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
        turn, asked, view = Turn(self, found, hypothesis, is_little), {}, None
        if found.shows_tracks:
            view = self.view_of(found, hypothesis, rng)
            if not found.is_failed:
                view.noise_findings = noise_findings(view)
            held = self.held(number, turn, view)
            held = held or self.drawn(number, found, hypothesis, view)
            if held is None:
                known, turn.families = turn.families, []
                rest = [p for p in self.proposers if not (known and _is_structural(p))]
                turn.propose(number, view, rest, is_told=True)
                turn.families += known
            turn = held or turn
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

    def held(self, number, whole, view):
        """A turn that asks for rods and rails alone, where one is surely seen; else None.

        What was proposed then, and fits, are left to the turn that asks all others.

        Nothing else keeps a body at one distance while its speed changes: where such a rod leaves
        little of what the law before it did, forces are asked for beside it, and not in its place.
        """
        if whole.base.is_failed:
            return None
        turn = Turn(self, whole.base, whole.hypotheses[0], known=whole.known)
        turn.propose(number, view, list(filter(_is_structural, self.proposers)))
        whole.families = [] if turn.left_out or turn.unasked else list(turn.families)
        sole = [(f.name, p) for f in turn.families for p in f.proposals if p.is_sole]
        if not sole or turn.p_of_all(view, self.looks) > self.criteria.alpha:
            return None
        is_whole = turn.fit_held(sole[:MOST_HELD]) and not (turn.left_out or turn.unasked)
        if not is_whole and self.clock.is_over and len(turn.rows) > 1:
            turn.note("proposers")  # there is no time to ask any other: what was seen is told
            return turn
        return turn if is_whole else None

    def drawn(self, number, found, hypothesis, view):
        """A turn that asks for gravity alone, where the sky shows it and it takes most; else None.

        Hardly anything else moves what is up there: before it is known no other form is asked for,
        of which many explain orbits of few turns as well.
        """
        if found.is_failed or found.law.terms or not view.is_sky:
            return None
        turn = Turn(self, found, hypothesis)
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


def _is_structural(proposer):
    """Whether a proposer looks for what holds bodies, which is asked before forces are."""
    return getattr(proposer, "is_structural", False)
