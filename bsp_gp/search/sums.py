"""Sums of forces by exhaustive search: one term at a time, each revised when others have come.

No search over all sets of terms can be exhaustive: a hundred thousand laws make 10^15 sums of
three. Terms are added one at a time with a joint refit, every term of the best set is searched
anew beside the others until nothing changes, and terms that do not pay for themselves are
removed. What that guarantees is said in the certificate: no law of the grammar can be added, put
in the place of one term, or left out, to shorten the description.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.errors import GrammarError
from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.grammar import Slot, joined_slots
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.search.candidate import Candidate, SearchResult, front_of
from bsp_gp.search.columns import Projected, orthonormal
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.exhaustive import Exhaustive, search_exhaustive

BETTER = 1e-6
"""Gain in nats below which a change is rounding."""
FLOOR = 1e-24
"""Share of the whitened sum of squares that is rounding."""
WIDTH = 4
"""First terms that are tried."""
BOUNDS = ("max_levels", "top_k")
"""Settings of a search that are the same for all its targets."""
CONDITIONS = ("does_collide", "is_on")
MOST_TOUCHED = 0.2
"""Part of the rows that may be left out as those of a contact."""


def terms_of(grammar, kind):
    """Nonterminals that a start symbol adds up, one per term; its own name if it adds none.

    Raises
    ------
    GrammarError
        If terms are not alike but for the names of their constants, or a rule is neither a
        nonterminal nor a sum of nonterminals.
    """
    start = grammar.start[kind]
    sums = [joined_slots(rule.body, "add") for rule in grammar.rules_of[start]]
    if all(slots is None for slots in sums) or max(len(slots or ()) for slots in sums) < 2:
        return (start,)
    if None in sums:
        raise GrammarError(
            f"exhaustive search of sums needs rules {start} -> term, {start} -> add(term, term)"
        )
    longest = tuple(slot.nonterminal for slot in max(sums, key=len))
    shapes = {_shape(grammar, slot.nonterminal) for slots in sums for slot in slots}
    if len(shapes) > 1:
        raise GrammarError(
            f"exhaustive search of sums needs terms that differ in their constants only; "
            f"{', '.join(longest)} of grammar {grammar.name} do not"
        )
    return longest


def _shape(grammar, nonterminal):
    """The rules of a nonterminal, constants' nonterminals made alike."""

    def shape(body):
        if isinstance(body, Slot):
            bodies = [rule.body for rule in grammar.rules_of[body.nonterminal]]
            is_constant = all(isinstance(each, Constant) for each in bodies)
            return "constant" if is_constant else body.nonterminal
        return (body[0], *map(shape, body[1:])) if isinstance(body, tuple) else repr(body)

    return tuple(shape(rule.body) for rule in grammar.rules_of[nonterminal])


@dataclass(frozen=True)
class _Chosen:
    """One set of terms: laws without their constants, complexities, loss after a joint refit."""

    terms: tuple
    complexities: tuple
    loss: float

    def cost(self, n_rows, floor):
        """Description length: fit with the noise profiled out, half a log n a constant, prior."""
        spread = max(2 * self.loss, floor) / n_rows
        constants = 0.5 * len(self.terms) * np.log(n_rows)
        return 0.5 * n_rows * np.log(spread) + constants + sum(self.complexities)


def search_sums(regression, grammar, *, kind, nuisance=None, target=None, **settings):
    """Find the best sum of terms of a grammar.

    Parameters
    ----------
    regression, grammar, kind, nuisance, target, **settings
        As in `search_exhaustive`; the number of terms is the grammar's. A grammar without sums
        is searched by `search_exhaustive` itself.

    Returns
    -------
    SearchResult
        `best` has the shortest description; `candidates` are the sets of shortest description
        that were met, lowest loss first.
    """
    if len(terms_of(grammar, kind)) == 1:
        return search_exhaustive(
            regression, grammar, kind=kind, nuisance=nuisance, target=target, **settings
        )
    started = time.perf_counter()
    search = _Sums(regression, grammar, kind, nuisance, target, dict(settings))
    search.run()
    ranked = sorted(search.found.values(), key=search.cost)
    candidates = [search.candidate(chosen) for chosen in ranked[: settings.get("top_k", 40)]]
    best = candidates[0] if candidates else None
    certificate = replace(
        search.certificate,
        n_derivations=grammar.count(grammar.start[kind], settings.get("max_levels", 8)),
        guarantee=search.guarantee(),
    )
    return SearchResult(
        best, tuple(sorted(candidates, key=lambda c: c.loss)), front_of(candidates),
        search.n_evaluated, search.n_failed, time.perf_counter() - started, certificate,
    )  # fmt: skip


class _Sums:
    def __init__(self, regression, grammar, kind, nuisance, target, settings):
        self.regression = regression
        self.grammar = grammar
        self.kind = kind
        self.target = regression.target() if target is None else np.asarray(target, dtype=float)
        n = len(self.target)
        self.nuisance = np.zeros((n, 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
        q = orthonormal(self.nuisance, n)
        self.projected = Projected(regression, self.target - q @ (q.T @ self.target), q)
        self.names = terms_of(grammar, kind)
        # Of one term: the start symbol is replaced, everything else stays.
        single = replace(grammar, start={**grammar.start, kind: self.names[0]})
        bounds = {name: settings.pop(name) for name in BOUNDS if name in settings}
        self.single = Exhaustive(regression, single, kind, **bounds, has_more=True)
        self.settings = settings
        self.found = {}
        self.memo = {}
        self.columns = {}
        self.n_evaluated = self.n_failed = 0
        self.certificate = None
        self.floor = FLOOR * float(self.target @ self.target)

    def run(self):
        """Add, exchange and remove terms."""
        beam = self.extended(_Chosen((), (), np.inf))[:WIDTH] + self.untouched()
        for _ in self.names[1:]:
            if not beam or 2 * beam[0].loss <= self.floor:
                break
            best = self.best()
            grown = []
            for chosen in beam:
                grown += self.extended(chosen)[:WIDTH]
                if grown and 2 * grown[0].loss <= self.floor:
                    break  # exact data are explained
            beam = sorted({c.terms: c for c in grown}.values(), key=lambda c: c.loss)[:WIDTH]
            self.exchange(min(grown, key=self.cost, default=best))
            if self.best() is best:
                break
        while self.found:
            best = self.best()
            self.remove(best)
            self.exchange(best)
            if len(best.terms) < len(self.names) and 2 * best.loss > self.floor:
                self.extended(best)
            if self.best() is best:
                break

    def untouched(self):
        """First terms by the rows in which nothing touches.

        In the sum of squares a contact of one row outweighs hundreds of rows of a pull: what fits
        it by chance comes first. What acts always is better seen where contacts are left out.
        """
        out = []
        for condition in CONDITIONS:
            rows = self.touched(condition)
            if not 0 < len(rows) <= MOST_TOUCHED * len(self.target):
                continue
            others = np.ones(len(self.target), dtype=bool)
            others[rows] = False
            found = self.searched(self.nuisance, seen=others)
            laws = [(split_linear(c.formula)[1], c.complexity) for c in found.candidates[:WIDTH]]
            out += [self.refitted([law]) for law in laws]
        return out

    def touched(self, condition):
        """Rows of receivers for which a condition of the grammar holds with some source."""
        names = ("s_i", "p_i", "s_j", "p_j")
        rules = [rule for rules in self.grammar.rules_of.values() for rule in rules]
        has_it = any(condition in rule.operators for rule in rules)
        if not has_it or self.kind != "pair" or not set(names) <= set(self.grammar.inputs):
            return np.zeros(0, dtype=int)
        s_i, p_i, s_j, p_j = (Input(n, self.grammar.inputs[n]) for n in names)
        apart = Call("normalize", Call("sub", p_i, p_j))
        held = Call("mul", apart, Call(condition, s_i, p_i, s_j, p_j))
        hit = self.column(held).reshape(-1, self.regression.batches[0].target.shape[-1])
        return np.flatnonzero(np.repeat(hit.any(axis=1), hit.shape[1]))

    def best(self):
        """The set of the shortest description so far."""
        return min(self.found.values(), key=self.cost, default=None)

    def cost(self, chosen):
        return chosen.cost(self.regression.n_rows, self.floor)

    def extended(self, chosen):
        """The set with one more term, all laws of the grammar tried; lowest loss first."""
        if chosen.terms not in self.memo:
            columns = [self.column(term)[:, None] for term in chosen.terms]
            result = self.searched(np.concatenate([self.nuisance, *columns], axis=1))
            self.certificate = result.certificate
            wider = []
            for candidate in result.candidates:
                term = split_linear(candidate.formula)[1]
                if term in chosen.terms:
                    continue
                pairs = sorted(
                    [
                        *zip(chosen.terms, chosen.complexities, strict=True),
                        (term, candidate.complexity),
                    ],
                    key=lambda pair: (pair[1], repr(pair[0])),
                )
                terms, complexities = zip(*pairs, strict=True)
                wider.append(_Chosen(terms, complexities, candidate.loss))
            wider.sort(key=lambda c: (c.loss, sum(c.complexities)))
            for one in wider:
                self.found.setdefault(one.terms, one)
            self.memo[chosen.terms] = wider
        return self.memo[chosen.terms]

    def searched(self, nuisance, **options):
        """The search for one more term beside columns that are fitted."""
        settings = {**self.settings, **options}
        result = self.single.search(nuisance=nuisance, target=self.target, **settings)
        self.n_evaluated += result.n_evaluated
        # The same sub-expressions in every search.
        self.n_failed = max(self.n_failed, result.n_failed)
        return result

    def exchange(self, chosen):
        """Search every term anew beside the others, until none is bettered."""
        while chosen is not None:
            options = [
                option
                for term in chosen.terms
                for option in self.extended(self.without(chosen, term))
            ]
            better = min(options, key=self.cost, default=chosen)
            if self.cost(better) > self.cost(chosen) - BETTER:
                return
            chosen = better

    def remove(self, chosen):
        """Note the set without each of its terms, so that they are compared."""
        for term in chosen.terms if len(chosen.terms) > 1 else ():
            option = self.without(chosen, term)
            self.found.setdefault(option.terms, option)

    def without(self, chosen, term):
        """The set without a term, refitted."""
        kept = [
            pair
            for pair in zip(chosen.terms, chosen.complexities, strict=True)
            if pair[0] is not term
        ]
        return self.refitted(kept)

    def refitted(self, pairs):
        """The set of these (term, complexity), with the loss of a joint fit."""
        if not pairs:
            return _Chosen((), (), np.inf)
        terms, complexities = zip(*pairs, strict=True)
        matrix = np.column_stack([self.nuisance, *(self.column(term) for term in terms)])
        norms = np.linalg.norm(matrix, axis=0)
        matrix = matrix / np.where(norms > 0, norms, 1.0)
        values, *_ = np.linalg.lstsq(matrix, self.target, rcond=1e-13)
        residual = self.target - matrix @ values
        return _Chosen(terms, complexities, 0.5 * float(residual @ residual))

    def column(self, term):
        if term not in self.columns:
            self.columns[term] = self.regression.column(Term(term, self.kind))[0][:, 0]
        return self.columns[term]

    def candidate(self, chosen):
        """The set as one law c1 * ... + c2 * ..., its constants fitted jointly."""
        parts = [Call("mul", Constant(f"c{k}"), term) for k, term in enumerate(chosen.terms, 1)]
        formula = parts[-1]
        for part in reversed(parts[:-1]):
            formula = Call("add", part, formula)
        law = ForceLaw(tuple(Term(part, self.kind) for part in parts))
        fit = fit_constants(self.projected, law)
        total = float(self.projected.target() @ self.projected.target())
        # The choice among the rules of the start symbol is a part of the prior.
        choice = np.log(len(self.grammar.rules_of[self.grammar.start[self.kind]]))
        return Candidate(
            formula, self.kind,
            {name: float(fit.law.constants[name]) for name in formula.constants}, fit.loss,
            sum(chosen.complexities) + float(choice), total - 2 * fit.loss, total,
        )  # fmt: skip

    def guarantee(self):
        return (
            f"sums of up to {len(self.names)} terms: every step tried all these laws, all "
            "constants refitted jointly; no law can be added to the best sum, take the place of "
            "one of its terms or be left out and shorten its description (fit, constants and "
            "prior); a better sum that differs in two terms or more is not ruled out"
        )
