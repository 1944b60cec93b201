"""Exhaustive search by factors: every distinct law up to a bound, scored with its best constant.

A law is ``c * a * b * u [* condition]`` with a from one bank of distinct values, b from another
and u a distinct direction. For all products at once the best constant's numerator is one matrix
product and its denominator another (EXHAUSTIVE in the README's terms), so that millions of laws
are scored a second and none is missed. Terms already in the law are projected out of the target
and of every candidate (Frisch and Waugh 1933), which is a joint refit of their free constants.

Two layouts, one arithmetic: where the a's depend on properties only, rows of one receiver and
source are summed first (``_GroupScorer``), which also allows any covariance along time;
otherwise a's live on rows (``_RowScorer``) and errors must be independent.
"""

from __future__ import annotations

import heapq
import itertools
import time
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from bsp_gp.errors import GrammarError, SettingsError
from bsp_gp.language.formula import Call, Constant, Number
from bsp_gp.language.grammar import Slot
from bsp_gp.language.inputs import property_of
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
from bsp_gp.search.candidate import Candidate, Certificate, SearchResult

__all__ = ["Plan", "law_pool", "plan_of", "search_exhaustive"]

TILE_BYTES = 1 << 26
"""Upper bound of one work array, so that memory does not grow with the data."""
COLLINEAR = 1e-10
"""A candidate whose part orthogonal to the law's free terms is below this is one of them."""


@dataclass(frozen=True)
class Plan:
    """One way in which a start symbol factors.

    Attributes
    ----------
    constant : str
        Name of the constant.
    left, right : (nonterminal, budget) or None
        Scalar factors; None is the number 1.
    operator : str
        "mul", or the grammar's division.
    direction, condition : (nonterminal, budget), condition may be None
    rules : tuple of int
        Rules used on the way, for the complexity.
    """

    constant: str
    left: tuple | None
    right: tuple | None
    operator: str
    direction: tuple
    condition: tuple | None
    rules: tuple[int, ...]


def plan_of(grammar, kind, max_levels):
    """Factor the start symbol of a grammar.

    Raises
    ------
    GrammarError
        If a rule of the start symbol is not a product of a constant, scalars, one direction and
        at most one condition.
    """
    plans = []
    _expand(grammar, grammar.start[kind], max_levels, (), plans)
    return plans


def _expand(grammar, nonterminal, budget, rules, plans):
    for rule in grammar.rules_of[nonterminal]:
        used = (*rules, rule.index)
        if isinstance(rule.body, Slot):
            _expand(grammar, rule.body.nonterminal, budget - 1, used, plans)
            continue
        plans.extend(_plans_of_rule(grammar, rule, budget - 1, used))


def _plans_of_rule(grammar, rule, budget, used):
    constant, scalars, directions, conditions = None, [], [], []
    for nonterminal in _product_slots(rule):
        shape = grammar.types[nonterminal].shape
        first = grammar.rules_of[nonterminal]
        if first and all(isinstance(r.body, Constant) for r in first):
            constant = first[0].body.name
            used = (*used, first[0].index)
        else:
            {"scalar": scalars, "vector": directions, "bool": conditions}[shape].append(nonterminal)
    if constant is None or len(directions) != 1 or len(conditions) > 1 or len(scalars) > 2:
        raise GrammarError(
            f"exhaustive search needs rules of the form constant * scalars * direction "
            f"[* condition]; rule {rule.nonterminal} -> {rule.text} is not"
        )
    direction = (directions[0], budget)
    condition = (conditions[0], budget) if conditions else None
    for left, operator, right, extra in _coefficients(grammar, scalars, budget):
        yield Plan(constant, left, right, operator, direction, condition, (*used, *extra))


def _product_slots(rule):
    def collect(body):
        if isinstance(body, Slot):
            return [body.nonterminal]
        if isinstance(body, tuple) and body[0] == "mul":
            return [name for part in body[1:] for name in collect(part)]
        raise GrammarError(
            f"exhaustive search needs products; rule {rule.nonterminal} -> {rule.text} is none"
        )

    return collect(rule.body)


def _coefficients(grammar, scalars, budget):
    if not scalars:
        yield None, "mul", None, ()
    elif len(scalars) == 2:
        yield (scalars[0], budget), "mul", (scalars[1], budget), ()
    else:
        yield from _split_coefficient(grammar, scalars[0], budget)


def _split_coefficient(grammar, nonterminal, budget):
    """A coefficient whose rules are products of two nonterminals factors; others stay whole."""
    rules = grammar.rules_of[nonterminal]
    binary = [r for r in rules if _binary(r)]
    if not any(isinstance(r.body, Slot) for r in rules) or not binary:
        yield (nonterminal, budget), "mul", None, ()
        return
    for rule in rules:
        if isinstance(rule.body, Slot):
            yield (rule.body.nonterminal, budget - 1), "mul", None, (rule.index,)
        elif _binary(rule):
            left, right = rule.children
            yield (left, budget - 1), rule.body[0], (right, budget - 1), (rule.index,)
        else:
            raise GrammarError(
                f"exhaustive search cannot factor rule {rule.nonterminal} -> {rule.text}"
            )


def _binary(rule):
    return (
        isinstance(rule.body, tuple)
        and rule.body[0] in ("mul", "div", "div_guarded")
        and all(isinstance(part, Slot) for part in rule.body[1:])
    )


class _Side:
    """A bank of scalar factors: values (n, P), complexities, entries; entry 0 may be the 1."""

    def __init__(self, entries):
        self.entries = entries
        self.complexity = np.array([entry.complexity for entry in entries])

    def values(self):
        """Values (n, P), each scaled to a greatest size of one: constants take up the scale."""
        stacked = np.stack([entry.value for entry in self.entries])
        return stacked / np.max(np.abs(stacked), axis=1, keepdims=True)


def search_exhaustive(
    regression,
    grammar,
    *,
    kind,
    nuisance=None,
    target=None,
    max_levels=8,
    top_k=40,
    missing_inputs=(),
    groups=None,
    null_targets=None,
    progress=None,
):
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
    missing_inputs : tuple of str
        For the certificate.
    groups : sequence of ndarray of bool, shape (n,), optional
        Parts of the rows with a constant of their own; by default one constant for all.
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
        If errors are correlated and the grammar does not factor into properties and motion.
    """
    if kind not in grammar.start:
        raise SettingsError(f"grammar {grammar.name} has no {kind} laws, only {list(grammar.start)}")
    start = time.perf_counter()
    with threadpool_limits(limits=1, user_api="blas"):
        search = _Exhaustive(regression, grammar, kind, max_levels, top_k)
        search.set_target(target, nuisance, groups, null_targets)
        search.run(progress)
        candidates = search.candidates()
    front = _front(candidates)
    certificate = Certificate(
        grammar.name, grammar.fingerprint, max_levels,
        grammar.count(grammar.start[kind], max_levels), search.n_scored, search.banks.n_failed,
        tuple(missing_inputs), tuple(search.parts),
    )
    best = candidates[0] if candidates else None
    return SearchResult(best, tuple(candidates), front, search.n_scored, search.banks.n_failed,
                        time.perf_counter() - start, certificate, tuple(search.null_best))


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
    with threadpool_limits(limits=1, user_api="blas"):
        search = _Exhaustive(regression, grammar, kind, max_levels, 1)
        return search.pool(is_left)


class _Exhaustive:
    def __init__(self, regression, grammar, kind, max_levels, top_k):
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
        self.n_scored = 0
        self.parts = []
        self.kept = _Kept(top_k)
        self.null_best = []

    def set_target(self, target, nuisance, groups, null_targets):
        y = self.regression.target() if target is None else np.asarray(target, dtype=float)
        self.groups = list(groups) if groups is not None else [np.ones(len(y), dtype=bool)]
        self.y_groups, self.q_groups = [], []
        null = np.zeros((len(y), 0)) if null_targets is None else np.asarray(null_targets)
        self.total, self.null_total = 0.0, np.zeros(null.shape[1])
        for mask in self.groups:
            q = _orthonormal(None if nuisance is None else nuisance * mask[:, None], len(y))
            ys = np.column_stack([y, null]) * mask[:, None]
            ys = ys - q @ (q.T @ ys)
            self.q_groups.append(q)
            self.y_groups.append(ys)
            self.total += float(ys[:, 0] @ ys[:, 0])
            self.null_total += np.square(ys[:, 1:]).sum(axis=0)
        self.null_gain = np.zeros(null.shape[1])

    def run(self, progress):
        plans = plan_of(self.grammar, self.kind, self.max_levels)
        families = {}
        for plan in plans:
            families.setdefault((plan.direction, plan.condition), []).append(plan)
        merged = self._directions(families)
        for done, (family, directed) in enumerate(merged, 1):
            for block in self._blocks(families[family]):
                self._score(block, directed)
            if progress is not None:
                progress(done, len(merged))
        if self.null_total.size:
            self.null_best = self.null_gain / np.where(self.null_total > 0, self.null_total, 1.0)

    def _directions(self, families):
        """Distinct directions x conditions over all families of plans, as weighted vectors."""
        inverse_mass = 1.0 / self.rows.input("m_i", False)
        out, seen = [], {}
        for family, plans in families.items():
            (name, budget), condition = family
            directions = self.banks.bank(name, budget)
            conditions = [None] if condition is None else self.banks.bank(*condition)
            items = distinct_directions(directions, conditions, inverse_mass, self.weights)
            for item in items:
                # The same vector in another family with the same coefficients is the same law.
                key = (self._coefficient_key(plans), fingerprint_of(item.value, self.weights))
                if key not in seen:
                    seen[key] = True
                    out.append((family, item))
        self.parts.append(f"{len(out)} directions")
        return out

    def _coefficient_key(self, plans):
        return tuple(sorted((str(p.left), p.operator, str(p.right)) for p in plans))

    def _blocks(self, plans):
        key = self._coefficient_key(plans)
        cache = self.__dict__.setdefault("_block_cache", {})
        if key not in cache:
            cache[key] = self._make_blocks(plans)
        return cache[key]

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
            ones = _Side([self._one()])
            for plan in plans:
                # On the right, where factors may vary in time under any covariance.
                right = ones if plan.left is None else self._side(self.banks.bank(*plan.left))
                blocks.append(_Block(ones, right, np.ones((1, len(right.entries)), bool),
                                     self._rule_cost(plan), plan.constant))
        return blocks

    def _one(self):
        return Entry(Number(1.0), None, 0.0, 0, np.ones(self.rows.n_rows))

    def _side(self, entries):
        return _Side(merge_proportional(entries, self.weights))

    def _rule_cost(self, plan):
        return -float(sum(self.log_probs[r] for r in plan.rules))

    def _self_product(self, plans, squares):
        left = self._side(self.banks.bank(*squares[0].left))
        operators = {p.operator: p for p in squares}
        single = next((p for p in plans if p.right is None and p.left is not None), squares[0])
        cost = self._rule_cost(squares[0])
        one = Entry(self._one().formula, None, self._rule_cost(single) - cost, 0, self._one().value)
        right_entries = [one]
        if "mul" in operators:
            right_entries += left.entries
        for name in operators:
            if name != "mul":
                inverses = [self._inverse(entry, name) for entry in left.entries]
                right_entries += [entry for entry in inverses if entry is not None]
        # Members of the left bank are preferred, so that a*b and b*a can be told to be one law.
        right = _Side(merge_proportional(right_entries, self.weights, preferred=left.entries))
        index = {id(entry): k for k, entry in enumerate(left.entries)}
        allowed = np.ones((len(left.entries), len(right.entries)), dtype=bool)
        for column, entry in enumerate(right.entries):
            if id(entry) in index:  # a * b and b * a are one law
                allowed[index[id(entry)] + 1 :, column] = False
        self.parts.append(f"{len(left.entries)} x {len(right.entries)} coefficients")
        return _Block(left, right, allowed, cost, squares[0].constant)

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
        return Entry(entry.formula, entry.expression, entry.complexity, entry.levels, value, operator,
                     [replace(tie, operator=operator) for tie in entry.ties])

    def _two_banks(self, plans, plan):
        """left x right, with 1 in either bank where the grammar allows a factor alone."""
        cost = self._rule_cost(plan)

        def with_one(name, partner):
            alone = [p for p in plans if p.right is None and p.left and p.left[0] == partner]
            if not alone:
                return []
            base = self._one()
            return [Entry(base.formula, None, self._rule_cost(alone[0]) - cost, 0, base.value)]

        left = self._side(with_one(plan.left, plan.right[0]) + self.banks.bank(*plan.left))
        right = self._side(with_one(plan.right, plan.left[0]) + self.banks.bank(*plan.right))
        allowed = np.ones((len(left.entries), len(right.entries)), dtype=bool)
        needs_factor = not any(p.left is None for p in plans)
        for a, one in enumerate(left.entries):
            for b, other in enumerate(right.entries):
                if needs_factor and one.expression is other.expression is None:
                    # 1 * 1 stands for itself alone, or for factors that are constant here.
                    allowed[a, b] = bool(one.ties or other.ties)
        self.parts.append(f"{len(left.entries)} x {len(right.entries)} coefficients")
        return _Block(left, right, allowed, cost, plan.constant, needs_factor)

    def _score(self, block, directed):
        self.n_scored += int(block.allowed.sum())
        scorer = _GroupScorer if block.is_static(self.rows) else _RowScorer
        gain = np.zeros(block.allowed.shape)
        null_gain = np.zeros((len(self.null_gain), *block.allowed.shape))
        vector = directed.value / np.max(np.abs(directed.value))
        for ys, q in zip(self.y_groups, self.q_groups, strict=True):
            numerators, denominator = scorer(self, block, vector, q, ys).products()
            safe = np.where(denominator > 0, denominator, np.inf)
            gain += np.square(numerators[0]) / safe
            for k in range(len(null_gain)):
                null_gain[k] += np.square(numerators[k + 1]) / safe
        gain = np.where(block.allowed, gain, 0.0)
        if len(null_gain):
            flat = np.where(block.allowed, null_gain, 0.0).reshape(len(null_gain), -1)
            self.null_gain = np.maximum(self.null_gain, flat.max(axis=1))
        total = (directed.complexity + block.cost + block.left.complexity[:, None]
                 + block.right.complexity)
        self.kept.add(gain, total, (block, directed))

    def pool(self, is_left):
        """See `law_pool`."""
        families = {}
        for plan in plan_of(self.grammar, self.kind, self.max_levels):
            families.setdefault((plan.direction, plan.condition), []).append(plan)
        laws, columns = [], []
        for family, directed in self._directions(families):
            for block in self._blocks(families[family]):
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
                        laws.append((rest, block.left.complexity[a] + block.right.complexity[b]
                                     + block.cost + directed.complexity))
                        columns.append(column)
        if not columns:
            return [], np.zeros((len(self.regression.target()), 0))
        return laws, np.stack(columns, axis=1)

    def candidates(self):
        """The kept laws with exact losses, equal ones merged, lowest loss first."""
        rescored = []
        for _, _, (block, directed), a, b in self.kept.items():
            (complexity, formula), *ties = block.formulas(a, b, directed)
            rescored.append(self.rescore(formula, complexity, tuple(law for _, law in ties)))
        return _merge_equal(rescored)

    def rescore(self, formula, complexity, ties=()):
        """Candidate with its exact loss, and its fitted whitened accelerations."""
        name, rest = split_linear(formula)
        column = self.regression.column(Term(rest, self.kind))[0][:, 0]
        scale = np.max(np.abs(column)) or 1.0
        column = column / scale
        constants, fitted, total = [], np.zeros(len(column)), 0.0
        for mask, ys, q in zip(self.groups, self.y_groups, self.q_groups, strict=True):
            x = column * mask
            x = x - q @ (q.T @ x)
            x = x - q @ (q.T @ x)
            size = float(x @ x)
            y = ys[:, 0]
            total += float(y @ y)
            c = float(x @ y) / size if size > 0 else 0.0
            constants.append(c / scale)
            fitted += c * x
        y = sum(ys[:, 0] for ys in self.y_groups)
        loss = 0.5 * float(np.square(y - fitted).sum())
        value = constants[0] if len(constants) == 1 else dict(enumerate(constants))
        candidate = Candidate(formula, self.kind, {name: value}, loss, complexity,
                              total - 2 * loss, total, ties=ties)
        return candidate, fitted


def fingerprint_of(value, weights):
    """Scale-free fingerprint of one vector field."""
    return fingerprints([value], weights, merge_scale=True)[0]


def _orthonormal(columns, n):
    if columns is None or not columns.size:
        return np.zeros((n, 0))
    live = columns[:, np.any(columns, axis=0)]
    if not live.size:
        return np.zeros((n, 0))
    scaled = live / np.linalg.norm(live, axis=0)
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return u[:, s > 1e-10 * s[0]]


@dataclass(eq=False)
class _Block:
    """All products of two sides."""

    left: _Side
    right: _Side
    allowed: np.ndarray
    cost: float
    constant: str
    needs_factor: bool = False

    def is_static(self, rows):
        """Whether the left factors depend on properties only."""
        if not hasattr(self, "_static"):
            self._static = all(
                property_of(name) is not None
                for entry in self.left.entries
                for name in entry.formula.inputs
            )
        return self._static

    def formulas(self, a, b, directed, most=60):
        """The law of this product and those merged into it.

        Returns
        -------
        list of (complexity, Formula)
            Simplest first, at most `most` + 1.
        """
        left, right = self.left.entries[a], self.right.entries[b]
        options = []
        for choice in itertools.islice(
            itertools.product(left.family(), right.family(), (directed, *directed.ties)), 4000
        ):
            if self.needs_factor and choice[0].expression is choice[1].expression is None:
                continue  # 1 * 1: not in the grammar, though equal to a law that is
            complexity = self.cost + sum(part.complexity for part in choice)
            options.append((complexity, len(options), choice))
        best = heapq.nsmallest(most + 1, options)
        return [(complexity, self.formula_of(*choice)) for complexity, _, choice in best]

    def formula_of(self, left, right, directed):
        """Law of one choice: constant * (left op right) * direction [* condition]."""
        coefficient = _combine(right.operator, left, right)
        body = directed.direction if coefficient is None else Call("mul", coefficient, directed.direction)
        if directed.condition is not None:
            body = Call("mul", body, directed.condition)
        return Call("mul", Constant(self.constant), body)


def _combine(operator, left, right):
    is_one = [entry.expression is None for entry in (left, right)]
    if all(is_one):
        return None
    if is_one[1]:
        return left.formula
    if is_one[0] and operator == "mul":
        return right.formula
    return Call(operator, left.formula, right.formula)


class _RowScorer:
    """Left factors on rows; errors independent. Cross terms of sources are pairs of rows."""

    def __init__(self, search, block, vector, q, ys):
        self.block = block
        rows = search.rows
        regression = search.regression
        if any(batch.whitener is not None for batch in regression.batches):
            raise SettingsError(
                f"grammar {search.grammar.name} mixes motion and properties in one factor, which "
                "exhaustive search scores under independent errors only; use the likelihood "
                "'one_step', or the grammar physics"
            )
        scale = _flat_scale(regression, rows)
        weighted = vector * scale
        active = np.flatnonzero(np.any(weighted, axis=1))
        self.active = active
        self.weighted = weighted[active]
        receiver = _receiver_index(rows)[active]
        self.receiver = receiver
        targets = [_spread(regression, rows, ys[:, k])[active] for k in range(ys.shape[1])]
        self.q_rows = np.stack([np.einsum("rd,rd->r", self.weighted, t) for t in targets])
        self.g_rows = [
            np.einsum("rd,rd->r", self.weighted, _spread(regression, rows, q[:, k])[active])
            for k in range(q.shape[1])
        ]

    def products(self):
        left = _values(self.block.left)[:, self.active]
        right = _values(self.block.right)[:, self.active]
        numerators = [(left * q) @ right.T for q in self.q_rows]
        raw = self._denominator(left, right)
        denominator = raw.copy()
        for g in self.g_rows:
            denominator -= np.square((left * g) @ right.T)
        return numerators, np.where(denominator > COLLINEAR * raw, denominator, 0.0)

    def _denominator(self, left, right):
        first, second = _row_pairs(self.receiver)
        k = np.einsum("rd,rd->r", self.weighted[first], self.weighted[second])
        k = np.where(first == second, k, 2 * k)
        used = np.flatnonzero(k)
        total = np.zeros((len(left), len(right)))
        step = max(1, TILE_BYTES // (8 * (len(left) + len(right))))
        for start in range(0, len(used), step):
            part = used[start : start + step]
            i, j = first[part], second[part]
            total += (left[:, i] * left[:, j] * k[part]) @ (right[:, i] * right[:, j]).T
        return total


def _values(side):
    if not hasattr(side, "_stacked"):
        side._stacked = side.values()
    return side._stacked


def _receiver_index(rows):
    """Which (instant, scene, receiver) each valid row belongs to."""
    if not hasattr(rows, "_receiver"):
        parts, offset = [], 0
        for shape in rows.shapes:
            n = int(np.prod(shape[:3]))
            parts.append(np.repeat(np.arange(offset, offset + n), shape[3]))
            offset += n
        rows._receiver = np.concatenate(parts)[rows.keep]
    return rows._receiver


def _row_pairs(receiver):
    """All pairs (first <= second) of rows with one receiver; rows of a receiver are adjacent."""
    firsts, seconds = [], []
    n = len(receiver)
    lag = 0
    while True:
        index = np.arange(n - lag)
        same = index[receiver[: n - lag] == receiver[lag:]] if lag else index
        if not len(same):
            break
        firsts.append(same)
        seconds.append(same + lag)
        lag += 1
    return np.concatenate(firsts), np.concatenate(seconds)


def _flat_scale(regression, rows):
    parts = [
        np.broadcast_to(batch.scale[:, :, :, None], (*shape, batch.scale.shape[-1])).reshape(
            -1, batch.scale.shape[-1]
        )
        for batch, shape in zip(regression.batches, rows.shapes, strict=True)
    ]
    return np.concatenate(parts)[rows.keep]


def _spread(regression, rows, flat):
    """A whitened vector of all receivers repeated for every source row, shape (P, d)."""
    parts, start = [], 0
    for batch, shape in zip(regression.batches, rows.shapes, strict=True):
        n_dims = batch.target.shape[-1]
        size = batch.target.size
        values = flat[start : start + size].reshape(*shape[:3], 1, n_dims)
        parts.append(np.broadcast_to(values, (*shape, n_dims)).reshape(-1, n_dims))
        start += size
    return np.concatenate(parts)[rows.keep]


class _GroupScorer:
    """Left factors are constant in time: rows of one receiver and source are summed first."""

    def __init__(self, search, block, vector, q, ys):
        self.search = search
        self.block = block
        self.vector = vector
        self.q = q
        self.ys = ys

    def products(self):
        rows, regression = self.search.rows, self.search.regression
        left = _group_values(self.block.left, rows)
        n_left, n_right = len(left[0]), len(self.block.right.entries)
        numerators = np.zeros((self.ys.shape[1], n_left, n_right))
        raw = np.zeros((n_left, n_right))
        explained = np.zeros((self.q.shape[1], n_left, n_right))
        vectors = rows.unflatten(self.vector)
        start = 0
        for index, batch in enumerate(regression.batches):
            size = batch.target.size
            part = slice(start, start + size)
            start += size
            self._batch(batch, vectors[index], left[index], part, index, numerators, raw, explained)
        denominator = raw - np.square(explained).sum(axis=0)
        return numerators, np.where(denominator > COLLINEAR * raw, denominator, 0.0)

    def _batch(self, batch, vector, left, part, index, numerators, raw, explained):
        n, s, r, j = self.search.rows.shapes[index]
        d = vector.shape[-1]
        shape = batch.target.shape
        ys = self.ys[part].reshape(*shape, -1)
        q = self.q[part].reshape(*shape, -1)
        a = left.reshape(len(left), -1)  # (n_left, S R J)
        pairs = (left[..., :, None] * left[..., None, :]).reshape(len(left), -1)
        right = _values(self.block.right)
        step = max(1, TILE_BYTES // (8 * n * s * r * j * d))
        for first in range(0, len(right), step):
            tile = slice(first, first + step)
            features = self._features(batch, vector, right[tile], index)
            gram = np.einsum("bnsrjd,bnsrkd->bsrjk", features, features, optimize=True)
            raw[:, tile] += pairs @ gram.reshape(len(gram), -1).T
            dots = np.einsum("bnsrjd,nsrdy->ybsrj", features, ys, optimize=True)
            for y, dot in enumerate(dots):
                numerators[y][:, tile] += a @ dot.reshape(len(gram), -1).T
            if q.shape[-1]:
                dots = np.einsum("bnsrjd,nsrdy->ybsrj", features, q, optimize=True)
                for y, dot in enumerate(dots):
                    explained[y][:, tile] += a @ dot.reshape(len(gram), -1).T

    def _features(self, batch, vector, right, index):
        """Whitened accelerations of direction x right factor, (b, n, S, R, J, d)."""
        out = []
        for value in right:
            field = vector * self.search.rows.unflatten(value)[index][..., None]
            out.append(batch.whiten(field))
        return np.stack(out)


def _group_values(side, rows):
    """Property factors at one instant of every (scene, receiver, source), per batch."""
    if not hasattr(side, "_grouped"):
        stacked = []
        for index in range(len(rows.shapes)):
            parts = []
            for value in _values(side):
                full = rows.unflatten(value)[index]
                # Constant in time: the value of largest size is the value (0 = invalid row).
                pick = np.argmax(np.abs(full), axis=0)
                parts.append(np.take_along_axis(full, pick[None], axis=0)[0])
            stacked.append(np.stack(parts))
        side._grouped = stacked
    return side._grouped


class _Kept:
    """The best laws of every unit of complexity, with bounded memory."""

    def __init__(self, top_k):
        self.top_k = top_k
        self.bins = {}

    def add(self, gain, complexity, source):
        flat = gain.ravel()
        bins = np.floor(complexity).astype(int).ravel()
        for level in np.unique(bins):
            members = np.flatnonzero((bins == level) & (flat > self._threshold(level)))
            if len(members) > self.top_k:
                members = members[np.argpartition(-flat[members], self.top_k - 1)[: self.top_k]]
            if len(members):
                self._insert(level, flat, complexity.ravel(), members, source, gain.shape[1])

    def _threshold(self, level):
        items = self.bins.get(level)
        return items[-1][0] if items and len(items) >= self.top_k else 0.0

    def _insert(self, level, flat, complexity, members, source, width):
        items = self.bins.setdefault(level, [])
        items.extend(
            (float(flat[m]), float(complexity[m]), source, int(m) // width, int(m) % width)
            for m in members
        )
        items.sort(key=lambda item: (-item[0], item[1]))
        del items[self.top_k :]

    def items(self):
        """All kept laws, greatest gain first."""
        everything = [item for items in self.bins.values() for item in items]
        return sorted(everything, key=lambda item: (-item[0], item[1]))


def _merge_equal(rescored):
    """Sort by loss, merge laws whose fitted accelerations are equal on the data."""
    if not rescored:
        return []
    total = max(candidate.total for candidate, _ in rescored)
    floor = 1e-20 * total
    order = sorted(rescored, key=lambda item: (item[0].loss, item[0].complexity))
    merged = []
    for candidate, fitted in order:
        for k, (other, other_fitted) in enumerate(merged):
            close = abs(candidate.loss - other.loss) <= 1e-9 * (candidate.loss + other.loss) + floor
            if close and np.square(fitted - other_fitted).sum() <= 1e-16 * np.square(fitted).sum() + floor:
                merged[k] = (_absorb(other, candidate), other_fitted)
                break
        else:
            merged.append((candidate, fitted))
    candidates = sorted((c for c, _ in merged), key=lambda c: c.loss)
    return candidates


def _absorb(kept, other):
    """Of two equal laws the least complex leads, the other becomes a tie."""
    lead, tail = (kept, other) if kept.complexity <= other.complexity else (other, kept)
    names = dict.fromkeys((*kept.ties, *other.ties, tail.formula))
    names.pop(lead.formula, None)
    return replace(lead, ties=tuple(names))


def _front(candidates):
    """Best per complexity: each member better than every simpler law."""
    front = []
    for candidate in sorted(candidates, key=lambda c: (c.complexity, c.loss)):
        if not front or candidate.loss < front[-1].loss:
            front.append(candidate)
    return tuple(front)
