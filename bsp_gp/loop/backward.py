"""Backward removal: what was adopted early and what came later has made superfluous."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.language.formula import Call, Constant, Number, factors, summands
from bsp_gp.language.render import to_text
from bsp_gp.loop.clock import Clock, TimeIsUp
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.evidence import WEAK, log_evidence, significance
from bsp_gp.loop.proposal import FAULTS, continued, without_term
from bsp_gp.physics.force import split_linear

OF_ONE = {
    "constant_per_scene": "number", "constant_per_body": "number", "law_by_scene": "law",
    "law_by_body": "law",
}  # fmt: skip
"""What a cause with a number for each scene or body is with one number for all."""

LATE = 0.3
"""Part of the time that is left for writing up in which terms that may be nothing are left out."""
NEEDED = 50.0
"""Standard errors from zero of a strength that cannot be spared: a thousand nats."""


@dataclass(frozen=True, eq=False)
class Restated:
    """What a round found, as causes of later rounds let it be told: with one number for all.

    Attributes
    ----------
    formula : Formula
    fit : Fit
        The final one.
    """

    code: str
    text: str
    formula: object
    fit: object


@dataclass(frozen=True, eq=False)
class Pruned:
    """What is left of what the rounds adopted.

    Attributes
    ----------
    fit : Fit
    hypothesis : Hypothesis
    removed : frozenset of int
        Numbers of the rounds whose cause was taken back.
    shed : frozenset of Formula
        Terms of sums that were adopted, which causes of later rounds have made superfluous.
    restated : dict of int to Restated
        By the number of the round.
    displaced : tuple of str
        Declared terms in whose place an adopted one stands: the declared model asked for them, the
        final one does not.
    is_complete : bool
        False where the time was up before everything was looked at.
    """

    fit: object
    hypothesis: object
    removed: frozenset = frozenset()
    shed: frozenset = frozenset()
    restated: dict = field(default_factory=dict)
    displaced: tuple = ()
    n_fits: int = 0
    is_complete: bool = True


def prune(rounds, dataset, *, criteria=None, bounds=None, clock=None, late=None, progress=None):
    """Refit without each cause that was adopted before the last one.

    What the evidence does not ask for is dropped, the least of all first, until nothing is.

    Parameters
    ----------
    dataset : Dataset
        Training scenes.
    bounds : dict, optional
        Of the constants of what is declared.
    late : Clock, optional
        Until when terms that may be nothing are left out where the time was up.
    progress : callable, optional
    """
    run = _Pruning(rounds, dataset, criteria or Criteria(), bounds, clock or Clock(), progress)
    try:
        run.take_back()
        run.shed_terms()
        run.unify()
        run.displace()
    except TimeIsUp:
        run.is_complete = False
        run.shed_late(late or run.clock)
    restated = {
        number: Restated(code, text, formula, run.found)
        for number, (code, text, formula) in run.restated.items()
    }
    return Pruned(
        run.found, run.hypothesis, frozenset(run.removed), frozenset(run.shed), restated,
        tuple(run.displaced), run.n_fits, run.is_complete,
    )  # fmt: skip


class _Pruning:
    """The hypothesis, and what was removed from it, while it shrinks."""

    def __init__(self, rounds, dataset, criteria, bounds, clock, progress):
        self.dataset, self.criteria, self.bounds, self.clock = dataset, criteria, bounds, clock
        self.says = progress or (lambda text: None)
        self.first = rounds[0].entering
        self.adopted = [done for done in rounds if done.decision.is_adopted]
        self.found, self.hypothesis = rounds[-1].after, rounds[-1].continuing
        self.removed, self.shed, self.restated, self.displaced = set(), set(), {}, []
        self.n_fits, self.is_complete = 0, True

    def take_back(self):
        """Remove causes of earlier rounds while the evidence does not ask for them."""
        while (number := self._shrink(self._without_causes())) is not None:
            self.removed.add(number)

    def shed_terms(self):
        """Remove single terms of sums while the evidence does not ask for them.

        Of the last round as well: a sum is chosen by what moments tell of it, and a fit may leave
        nothing of one of its terms. Only those whose strength may well be zero: of others a fit
        need not tell that.
        """
        while (formula := self._shrink(self._without_terms())) is not None:
            self.shed.add(formula)

    def shed_late(self, clock):
        """The same where there was no time: what may be nothing is told as nothing."""
        self.clock = clock.share(LATE)
        if self.clock.is_over:
            return
        try:
            self.shed_terms()
        except TimeIsUp:
            pass

    def _shrink(self, ways):
        """Take the hypothesis that is likeliest beside the whole one, if one is, and say which.

        Of ``(name, hypothesis or None, text, log prior of what it lacks, what a nat of evidence
        counts)`` each.
        """
        weakest, least = None, 0.0
        for name, smaller, text, log_prior, worth in ways:
            fitted = smaller and self.fitted(smaller, f"without {text}")
            if fitted and fitted[2] * worth + log_prior <= least:
                weakest, least = (name, *fitted[:2]), fitted[2] * worth + log_prior
        if weakest is None:
            return None
        name, self.found, self.hypothesis = weakest
        return name

    def _without_causes(self):
        for done in self.adopted[:-1]:
            if done.number not in self.removed:
                best = done.decision.best
                smaller = _without(self.hypothesis, done)
                yield done.number, smaller, best.text, best.log_prior, 1.0

    def _without_terms(self):
        formulas = self._terms_of_sums()
        told = constant_estimates(self.found, self.dataset) if formulas else ()
        for formula in formulas:
            names = strengths_of(formula)
            own = np.concatenate(
                [significance(self.found, name) for name in names] or [np.zeros(0)]
            )
            # Where more than noise is left the interval that is told is what counts, and nats as
            # many as it makes of them.
            wide = [c for c in told if c.name in names]
            may_be_none = bool(wide) and all(c.low <= 0.0 <= c.high for c in wide)
            if len(own) and (np.all(own < WEAK) or may_be_none):
                smaller, worth = without_term(self.hypothesis, formula), 1.0
                halves = np.array([(c.high - c.low) / 2 for c in wide])
                if may_be_none and own.max() > 0 and halves.min() > 0:
                    sizes = np.abs([c.value for c in wide]) * stats.norm.ppf(0.95) / halves
                    worth = min(float((sizes.max() / own.max()) ** 2), 1.0)
                yield formula, smaller, to_text(formula), -self.criteria.cause_nats, worth

    def _terms_of_sums(self):
        kept = [done for done in self.adopted if done.number not in self.removed]
        made = (done.proposals.get(done.decision.best.id) for done in kept)
        sums = [proposal.formulas for proposal in made if proposal is not None]
        return [f for terms in sums if len(terms) > 1 for f in terms if f not in self.shed]

    def unify(self):
        """Give all scenes, or bodies, one number where the evidence asks for none of their own.

        Beside a cause that was not known yet a number that is off differs from scene to scene.
        """
        for done in self.adopted[:-1]:
            best = done.decision.best
            new = OF_ONE.get(best.code) if done.number not in self.removed else None
            smaller, formula, text = _of_one(self.hypothesis, done) if new else (None, None, "")
            fitted = smaller and self.fitted(smaller, f"one number for all in {best.text}")
            if fitted and fitted[2] - self.criteria.cause_nats <= 0.0:
                self.found, self.hypothesis, _ = fitted
                self.restated[done.number] = new, text, formula

    def displace(self):
        """Remove declared terms in whose place adopted ones stand."""
        kept = [done for done in self.adopted if done.number not in self.removed]
        for formula in [t.formula for t in self.first.law.terms] if kept else ():
            is_asked = self._asked_for(formula) and not self._is_needed(formula)
            smaller = is_asked and without_term(self.hypothesis, formula)
            fitted = smaller and self.fitted(smaller, f"without {to_text(formula)}")
            if fitted and fitted[2] <= 0.0:
                self.found, self.hypothesis, _ = fitted
                self.displaced.append(to_text(formula))

    def _asked_for(self, formula):
        """Whether the declared model has numbers of its own in a term, one of them not zero."""
        least = stats.norm.isf(self.criteria.alpha / 2)
        others = {c for t in self.first.law.terms if t.formula != formula
                  for c in t.formula.constants}  # fmt: skip
        numbers = zip(self.first.parameters, self.first.values, self.first.errors, strict=True)
        return any(
            abs(value) > least * error
            for (name, _), value, error in numbers
            if name in formula.constants and name not in others
        )

    def _is_needed(self, formula):
        """Whether the last fit has the strength of a term so surely that nothing stands for it.

        What could take its place would leave it open; a fit without it would only lose its way.
        """
        name, _ = split_linear(formula)
        own = significance(self.found, name)
        return len(own) > 0 and bool(np.all(own > NEEDED))

    def fitted(self, smaller, text):
        """A smaller hypothesis fitted: (fit, hypothesis, evidence that is lost), or None."""
        if self.clock.is_over:
            raise TimeIsUp
        self.says(text)
        smaller = continued(smaller, self.found)
        self.n_fits += 1
        try:
            other = fit(
                smaller, self.dataset, bounds=smaller.own(self.bounds), deadline=self.clock.left,
                near=self.found, effort=self.criteria.effort,
            )  # fmt: skip
        except FAULTS:  # it cannot be done without
            return None
        if self.clock.is_over:  # it may have been cut short
            raise TimeIsUp
        whole, theirs = (
            log_evidence(f, h, self.criteria)
            for f, h in ((self.found, self.hypothesis), (other, smaller))
        )
        return other, smaller, whole - theirs


def strengths_of(formula):
    """Constants to which a term is proportional: of a wave both amplitudes."""
    name, _ = split_linear(formula)
    return [name] if name else amplitudes_of(formula)


def amplitudes_of(formula):
    """Constants to which a wave is proportional together; none of other formulas."""
    for factor in factors(formula)[0]:
        names = [split_linear(part)[0] for part in summands(factor)]
        if len(names) > 1 and all(names):
            return names
    return []


def _without(hypothesis, done):
    """A later hypothesis with what a round changed put back; None where that is there no more."""
    before = done.hypotheses[0].parts
    known = [_identity(part) for part in before]
    after = [_identity(part) for part in done.continuing.parts]
    cut = [part for part in hypothesis.parts if isinstance(part, CutShort)]  # for all causes
    added = [key for key in after if key not in known and key not in cut]
    parts = [part for part in hypothesis.parts if _identity(part) not in added]
    if not added or len(parts) != len(hypothesis.parts) - len(added):
        return None
    lost = [part for part, key in zip(before, known, strict=True) if key not in after]
    return Hypothesis((*lost, *parts))


def _of_one(hypothesis, done):
    """A hypothesis with one number in place of those that a round gave to each owner, term, text.

    None where the number is there no more, or is a declared one's.
    """
    known = set(done.entering.law.constants)
    for k, part in enumerate(hypothesis.parts):
        for i, term in enumerate(part.law.terms if isinstance(part, Forces) else ()):
            name, rest = split_linear(term.formula)
            table = part.law.constants.get(name) if name and name.endswith("]") else None
            stem = name.split("[")[0] if table is not None else ""
            is_its = not {name, stem} & known and name in done.after.law.constants
            if table is None or not is_its:
                continue
            mean = float(np.mean(list(table.values())))
            one = Constant(stem)
            is_changed = OF_ONE[done.decision.best.code] == "number"
            factor = Call("add", Number(1.0), one) if is_changed else one
            formula = Call("mul", factor, rest)
            constants = {n: v for n, v in part.law.constants.items() if n != name}
            constants[stem] = mean - 1.0 if is_changed else mean
            terms = list(part.law.terms)
            terms[i] = replace(term, formula=formula)
            law = replace(part.law, terms=tuple(terms), constants=constants)
            parts = (*hypothesis.parts[:k], replace(part, law=law), *hypothesis.parts[k + 1 :])
            text = f"number of {to_text(rest)}" if is_changed else to_text(formula)
            return Hypothesis(parts), formula, text
    return None, None, ""


def _identity(part):
    """What a part is, whatever values its numbers have."""
    if isinstance(part, Forces):
        return type(part), tuple(term.formula for term in part.law.terms)
    if isinstance(part, CutShort):
        return part
    return type(part), tuple(p.name for p in part.parameters)
