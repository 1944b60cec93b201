"""Exhaustive search by factors: every distinct law up to a bound, scored with its best constant.

A law is ``c * a * b * u [* condition]`` with a from one bank of distinct values, b from another
and u a distinct direction. For all products at once the best constant's numerator is one matrix
product and its denominator another, so that millions of laws are scored in seconds and none is
missed. Terms already in the law are projected out of the target and of every candidate (Frisch
and Waugh 1933), which is a joint refit of their free constants.
"""

import itertools
import time
from dataclasses import replace

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.language.formula import Number
from bsp_gp.language.operators import OPERATORS
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.search.banks import (
    Banks,
    Entry,
    Rows,
    distinct_directions,
    fingerprints,
    merge_proportional,
)
from bsp_gp.search.candidate import Candidate, Certificate, SearchResult, front_of, merge_equal
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.correlated import CorrelatedScorer, group_scorer
from bsp_gp.search.factoring import plan_of
from bsp_gp.search.products import Block, Kept, Side
from bsp_gp.search.recognition import CACHE_BYTES, BoundedCache
from bsp_gp.search.room import require_room
from bsp_gp.search.scoring import RowScorer
from bsp_gp.threads import one_thread

SIZES_BYTES = 1 << 27
"""Upper bound of what is kept of one search for the next."""
MOST_TIES, MOST_TIED = 250, 100
"""Laws equal to a candidate on the data that are named beside it, and candidates beside which they
are, the likeliest ones."""


def search_exhaustive(
    regression, grammar, *, kind, nuisance=None, target=None, max_levels=8, top_k=40,
    max_ties=MOST_TIES, missing_inputs=(), seen=None, null_targets=None, progress=None,
):  # fmt: skip
    """Score every distinct law of a grammar on a regression.

    Parameters
    ----------
    regression : Regression
    grammar : Grammar
        Masked to what the data supply.
    kind : str
        Start symbol: "pair" or "field".
    nuisance : ndarray, shape (n, k), optional
        Whitened columns of the law's free constants, refitted jointly with every candidate.
    target : ndarray, shape (n,), optional
        Whitened residual of the fixed part of the law; by default the accelerations themselves.
    max_levels : int
        Bound on the levels of a derivation.
    top_k : int
        Candidates kept per unit of complexity, and overall.
    max_ties : int
        Laws that are named beside each candidate at most, being equal to it on these data.
    missing_inputs : tuple of str
        For the certificate.
    seen : ndarray of bool, shape (n,), optional
        The rows that count; by default all.
    null_targets : ndarray, shape (n, B), optional
        Simulated targets; the greatest share explained by any law is returned for each.
    progress : callable, optional
        ``progress(done, of)`` after every direction.

    Returns
    -------
    SearchResult
        With its certificate.

    Raises
    ------
    SettingsError
        If the grammar has no laws of this kind.
    ResourceError
        If the search would not fit into memory; proposes a bound on the levels that does.
    """
    if kind not in grammar.start:
        raise SettingsError(
            f"grammar {grammar.name} has no {kind} laws, only {list(grammar.start)}"
        )
    start = time.perf_counter()
    with one_thread():
        search = Exhaustive(regression, grammar, kind, max_levels, top_k)
    result = search.search(
        nuisance=nuisance, target=target, seen=seen, null_targets=null_targets,
        max_ties=max_ties, missing_inputs=missing_inputs, progress=progress,
    )  # fmt: skip
    return replace(result, seconds=time.perf_counter() - start)


def law_pool(regression, grammar, *, kind, is_left, max_levels=8):
    """All laws of a grammar whose property factor is one of a few, as columns.

    Parameters
    ----------
    is_left : callable
        ``is_left(formula) -> bool`` for property factors; Number(1) stands for none.

    Returns
    -------
    laws : list of (Formula, float)
        Without constants, and their complexity.
    columns : ndarray, shape (n, len(laws))
        Whitened accelerations.
    """
    with one_thread():
        search = Exhaustive(regression, grammar, kind, max_levels, 1)
        return search.pool(is_left)


class Exhaustive:
    """The laws of a grammar on one regression, to be searched for one target after the other.

    Banks, directions and blocks do not depend on the target; neither do the sizes of the laws'
    accelerations, kept within `SIZES_BYTES` if there is more than one search to come.

    Parameters
    ----------
    regression, grammar, kind, max_levels, top_k
        As in `search_exhaustive`.
    has_more : bool
        Whether another search is to come.
    """

    def __init__(self, regression, grammar, kind, max_levels=8, top_k=40, has_more=False):
        self.regression = regression
        self.grammar = grammar
        self.kind = kind
        self.top_k = top_k
        self.max_levels = max_levels
        self.rows = Rows(regression, kind)
        with np.errstate(divide="ignore"):
            self.log_probs = np.log(Pcfg.uniform(grammar).probabilities)
        self.banks = Banks(grammar, self.rows, self.log_probs)
        self.weights = self.banks._weights
        self.is_correlated = any(b.whitener is not None for b in regression.batches)
        self.parts = []
        self.has_more = has_more
        self.sizes, self.bytes = {}, 0
        self._merged, self._made = None, {}
        share = CACHE_BYTES // max(len(regression.batches), 1)
        self.subtrees = [BoundedCache(share) for _ in regression.batches]

    def search(
        self, *, nuisance=None, target=None, seen=None, null_targets=None, max_ties=MOST_TIES,
        missing_inputs=(), progress=None,
    ):  # fmt: skip
        """Search for one target; parameters and result as in `search_exhaustive`."""
        started = time.perf_counter()
        with one_thread():
            self._set_target(target, nuisance, seen, null_targets)
            require_room(self, self.n_columns())
            self._run(progress)
            candidates = self._candidates(max_ties)
        certificate = Certificate(
            self.grammar.name, self.grammar.fingerprint, self.max_levels,
            self.grammar.count(self.grammar.start[self.kind], self.max_levels), self.n_scored,
            self.n_failed + self.banks.n_failed, tuple(missing_inputs), tuple(self.parts),
        )  # fmt: skip
        return SearchResult(
            candidates[0] if candidates else None, tuple(candidates), front_of(candidates),
            self.n_scored, self.n_failed + self.banks.n_failed, time.perf_counter() - started,
            certificate, tuple(self.null_best),
        )  # fmt: skip

    def _set_target(self, target, nuisance, seen, null_targets):
        y = self.regression.target() if target is None else np.asarray(target, dtype=float)
        null = np.zeros((len(y), 0)) if null_targets is None else np.asarray(null_targets)
        own = 1.0 if seen is None else seen[:, None]
        ys = np.column_stack([y, null]) * own
        self.seen = seen
        self.q = orthonormal(None if nuisance is None else nuisance * own, len(y))
        self.ys = ys - self.q @ (self.q.T @ ys)
        self.total = float(self.ys[:, 0] @ self.ys[:, 0])
        self.null_total = np.square(self.ys[:, 1:]).sum(axis=0)
        self.null_gain = np.zeros(null.shape[1])
        self.null_best = []
        self.n_scored = self.n_failed = 0
        self.kept = Kept(self.top_k)

    def n_columns(self):
        """Targets and what is fitted beside, of which every law's products are kept at a time."""
        return self.ys.shape[1] + self.q.shape[1]

    def _run(self, progress):
        for done, (plans, directed) in enumerate(self._directed_plans(), 1):
            for block in self._blocks(plans):
                if block.allowed.size:  # a bank may be empty within the bound
                    self._score(block, directed)
            if progress is not None:
                progress(done, len(self._directed_plans()))
        if self.null_total.size:
            self.null_best = self.null_gain / np.where(self.null_total > 0, self.null_total, 1.0)

    def _directed_plans(self):
        """Every distinct direction with the plans of its coefficients."""
        if self._merged is None:
            families = {}
            for plan in plan_of(self.grammar, self.kind, self.max_levels):
                families.setdefault((plan.direction, plan.condition), []).append(plan)
            directions = self._directions(families)
            self._merged = [(families[family], directed) for family, directed in directions]
        return self._merged

    def _directions(self, families):
        """Distinct directions x conditions over all families of plans, as weighted vectors."""
        inverse_mass = 1.0 / self.rows.input("m_i", False)
        out, seen = [], set()
        for family, plans in families.items():
            (name, budget), condition = family
            directions = self.banks.bank(name, budget)
            conditions = [None] if condition is None else self.banks.bank(*condition)
            items = distinct_directions(directions, conditions, inverse_mass, self.weights)
            for item in items:
                # The same vector in another family with the same coefficients is the same law.
                (own,) = fingerprints([item.value], self.weights, merge_scale=True)
                key = (self._coefficient_key(plans), own)
                if key not in seen:
                    seen.add(key)
                    out.append((family, item))
        self.parts.append(f"{len(out)} directions")
        return out

    def _coefficient_key(self, plans):
        return tuple(sorted((str(p.left), p.operator, str(p.right)) for p in plans))

    def _blocks(self, plans):
        key = self._coefficient_key(plans)
        if key not in self._made:
            self._made[key] = self._make_blocks(plans)
        return self._made[key]

    def _make_blocks(self, plans):
        """Turn the coefficient plans of a family into (left, right, allowed) blocks.

        Products of one bank with itself, its quotients and its members alone become one block:
        left = the bank, right = 1, the bank and its inverses, merged where proportional.
        """
        lefts = {}
        for plan in plans:
            if plan.left is not None and plan.right is None:
                lefts.setdefault(plan.left[0], []).append(plan)
        binary = [p for p in plans if p.right is not None]
        blocks = []
        squares = [p for p in binary if p.left == p.right]
        if squares:
            blocks.append(self._self_product(plans, squares))
        for plan in binary:
            if plan.left != plan.right:
                blocks.append(self._two_banks(plans, plan))
        if not binary:
            ones = Side([self._one()])
            for plan in plans:
                # On the right, where factors may vary in time under any covariance.
                right = ones if plan.left is None else self.side(self.banks.bank(*plan.left))
                blocks.append(
                    Block(
                        ones,
                        right,
                        np.ones((1, len(right.entries)), bool),
                        self._rule_cost(plan),
                        plan.constant,
                    )
                )
        return blocks

    def _one(self):
        return Entry(Number(1.0), None, 0.0, 0, np.ones(self.rows.n_rows))

    def side(self, entries):
        """A bank as one side of a block: proportional factors are one."""
        return Side(merge_proportional(entries, self.weights))

    def _rule_cost(self, plan):
        return -float(sum(self.log_probs[r] for r in plan.rules))

    def _self_product(self, plans, squares):
        left = self.side(self.banks.bank(*squares[0].left))
        operators = {p.operator: p for p in squares}
        single = next((p for p in plans if p.right is None and p.left is not None), squares[0])
        cost = self._rule_cost(squares[0])
        one = Entry(self._one().formula, None, self._rule_cost(single) - cost, 0, self._one().value)
        # Where a property is the same for all, a factor alone is a product with it.
        with_one = merge_proportional([*left.entries, one], self.weights, left.entries)
        left = Side([entry for entry in with_one if entry.value is not one.value])
        right_entries = [one]
        if "mul" in operators:
            right_entries += left.entries
        for name in operators:
            if name != "mul":
                inverses = [self._inverse(entry, name) for entry in left.entries]
                right_entries += [entry for entry in inverses if entry is not None]
        # Members of the left bank are preferred, so that a*b and b*a can be told to be one law.
        right = Side(merge_proportional(right_entries, self.weights, preferred=left.entries))
        index = {id(entry.value): k for k, entry in enumerate(left.entries)}
        allowed = np.ones((len(left.entries), len(right.entries)), dtype=bool)
        for column, entry in enumerate(right.entries):
            if id(entry.value) in index:  # a * b and b * a are one law
                allowed[index[id(entry.value)] + 1 :, column] = False
        self.parts.append(f"{len(left.entries)} x {len(right.entries)} coefficients")
        return Block(left, right, allowed, cost, squares[0].constant, needs_factor=True)

    def _inverse(self, entry, operator):
        with np.errstate(all="ignore"):
            value = OPERATORS[operator].evaluate(
                (Number(1.0).type, entry.formula.type), np.ones_like(entry.value), entry.value
            )
        if not np.all(np.isfinite(value)):
            self.banks.n_failed += 1
            return None
        if not value.any():
            return None
        return Entry(
            entry.formula,
            entry.expression,
            entry.complexity,
            entry.levels,
            value,
            operator,
            # What is guarded against divisors below zero is no multiple of its negative.
            [
                replace(tie, operator=operator)
                for tie in entry.ties
                if tie.sign > 0 or "guarded" not in operator
            ],
        )

    def _two_banks(self, plans, plan):
        """Left x right, with 1 in either bank where the grammar allows a factor alone."""
        cost = self._rule_cost(plan)

        def with_one(name, partner):
            alone = [p for p in plans if p.right is None and p.left and p.left[0] == partner]
            if not alone:
                return []
            base = self._one()
            return [Entry(base.formula, None, self._rule_cost(alone[0]) - cost, 0, base.value)]

        left = self.side(with_one(plan.left, plan.right[0]) + self.banks.bank(*plan.left))
        right = self.side(with_one(plan.right, plan.left[0]) + self.banks.bank(*plan.right))
        allowed = np.ones((len(left.entries), len(right.entries)), dtype=bool)
        needs_factor = not any(p.left is None for p in plans)
        for a, one in enumerate(left.entries):
            for b, other in enumerate(right.entries):
                if needs_factor and one.expression is other.expression is None:
                    # 1 * 1 stands for itself alone, or for factors that are constant here.
                    allowed[a, b] = bool(one.ties or other.ties)
        self.parts.append(f"{len(left.entries)} x {len(right.entries)} coefficients")
        return Block(left, right, allowed, cost, plan.constant, needs_factor)

    def _score(self, block, directed):
        self.n_scored += int(block.allowed.sum())
        if block.is_static:
            scorer = group_scorer(self.regression)
        else:
            scorer = CorrelatedScorer if self.is_correlated else RowScorer
        vector = directed.value / np.max(np.abs(directed.value))
        known = self.sizes.get((block, directed)) if self.seen is None else None
        numerators, denominator, sizes = scorer(
            self, block, vector, self.q, self.ys, self.seen
        ).products(known)
        if self.seen is None and known is None:
            self._keep((block, directed), sizes)
        usable = (denominator > 0) & block.allowed
        inverse = np.where(usable, 1.0 / np.where(usable, denominator, 1.0), 0.0)
        gain = np.square(numerators[0]) * inverse
        room = np.empty_like(inverse)
        for k in range(len(self.null_gain)):
            np.square(numerators[k + 1], out=room)
            np.multiply(room, inverse, out=room)
            self.null_gain[k] = max(self.null_gain[k], room.max())
        total = directed.complexity + block.cost + block.left.complexity[:, None]
        total = total + block.right.complexity
        self.kept.add(gain, total, (block, directed))

    def _keep(self, key, sizes):
        """Keep squared sizes for the next search, as far as there is room."""
        if self.has_more and sizes is not None and self.bytes + sizes.nbytes <= SIZES_BYTES:
            self.sizes[key] = sizes
            self.bytes += sizes.nbytes

    def pool(self, is_left):
        """See `law_pool`."""
        require_room(self, 0)
        laws, columns = [], []
        for plans, directed in self._directed_plans():
            for block in self._blocks(plans):
                lefts = [
                    (a, match)
                    for a, entry in enumerate(block.left.entries)
                    for match in entry.family()
                    if is_left(match.formula)
                ]
                for (a, match), b in itertools.product(lefts, range(len(block.right.entries))):
                    if block.allowed[a, b]:
                        formula = block.formula_of(match, block.right.entries[b], directed)
                        _, rest = split_linear(formula)
                        column = self.regression.column(Term(rest, self.kind))[0][:, 0]
                        complexity = block.left.complexity[a] + block.right.complexity[b]
                        laws.append((rest, complexity + block.cost + directed.complexity))
                        columns.append(column)
        if not columns:
            return [], np.zeros((len(self.regression.target()), 0))
        return laws, np.stack(columns, axis=1)

    def _candidates(self, max_ties):
        """The kept laws with exact losses, equal ones merged, lowest loss first."""
        rescored, sources = [], {}
        for _, _, (block, directed), a, b in self.kept.items():
            ((complexity, formula),) = block.formulas(a, b, directed, 0)
            found = self._rescore(formula, complexity)
            if found is None:
                self.n_failed += 1
            else:
                rescored.append(found)
                sources[formula] = block, a, b, directed
        merged = merge_equal(rescored)
        likeliest = sorted(range(len(merged)), key=lambda k: merged[k].loss + merged[k].complexity)
        for k in likeliest[:MOST_TIED]:
            lead = merged[k].formula
            every: dict = {}
            for formula in (lead, *merged[k].ties):
                block, a, b, directed = sources[formula]
                every |= dict.fromkeys(t for _, t in block.formulas(a, b, directed, max_ties)[1:])
            names = dict.fromkeys((*every, *merged[k].ties))
            names.pop(lead, None)
            merged[k] = replace(merged[k], ties=tuple(names))
        return merged

    def _rescore(self, formula, complexity):
        """Candidate with its exact loss, and its fitted whitened accelerations.

        None where its forces are next to nothing, so that no number is its constant.
        """
        name, rest = split_linear(formula)
        column = self.regression.column(Term(rest, self.kind), cache=self.subtrees)[0][:, 0]
        scale = np.max(np.abs(column)) or 1.0
        x = column / scale if self.seen is None else column / scale * self.seen
        x = x - self.q @ (self.q.T @ x)
        x = x - self.q @ (self.q.T @ x)
        size, y = float(x @ x), self.ys[:, 0]
        c = float(x @ y) / size if size > 0 else 0.0
        with np.errstate(over="ignore"):
            constant = float(c / scale)
        if not np.isfinite(constant):
            return None
        fitted = c * x
        loss = 0.5 * float(np.square(y - fitted).sum())
        candidate = Candidate(
            formula, self.kind, {name: constant}, loss, complexity, self.total - 2 * loss,
            self.total,
        )  # fmt: skip
        return candidate, fitted
