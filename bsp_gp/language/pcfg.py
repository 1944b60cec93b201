"""Probabilistic grammars: sampling under a bound on levels, log-probabilities, refitting."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import Expression

__all__ = ["Pcfg"]


@dataclass(frozen=True, eq=False)
class Pcfg:
    """A grammar with one probability per rule (paper, section 3.3.1).

    Attributes
    ----------
    grammar : Grammar
    probabilities : ndarray, shape (n_rules,)
        Sums to one over the enabled rules of every nonterminal; 0 for masked rules.
    """

    grammar: object
    probabilities: np.ndarray

    def __post_init__(self):
        probabilities = np.array(self.probabilities, dtype=float)
        if probabilities.shape != (len(self.grammar.rules),):
            raise GrammarError(
                f"a PCFG needs {len(self.grammar.rules)} probabilities, got {probabilities.shape}"
            )
        probabilities.setflags(write=False)
        object.__setattr__(self, "probabilities", probabilities)

    @classmethod
    def uniform(cls, grammar):
        """Every enabled rule of a nonterminal equally likely: the paper's prior P0."""
        return cls.from_counts(grammar, np.zeros(len(grammar.rules)), smoothing=1.0)

    @classmethod
    def from_counts(cls, grammar, counts, smoothing=0.0):
        """Maximum likelihood from rule counts plus a pseudo-count; uniform where both are 0."""
        weights = (np.asarray(counts, dtype=float) + smoothing) * np.array(grammar.enabled)
        probabilities = np.zeros(len(grammar.rules))
        for rules in grammar.rules_of.values():
            index = [rule.index for rule in rules]
            if index:
                total = weights[index].sum()
                probabilities[index] = weights[index] / total if total > 0 else 1 / len(index)
        return cls(grammar, probabilities)

    def mixed(self, other, share):
        """``(1 - share) * self + share * other``, rule by rule."""
        return Pcfg(self.grammar, (1 - share) * self.probabilities + share * other.probabilities)

    def counts(self, expressions):
        """How often each rule occurs in `expressions`, shape (n_rules,)."""
        counts = np.zeros(len(self.grammar.rules))
        for expression in expressions:
            for rule in expression.rules():
                counts[rule] += 1
        return counts

    def log_prob(self, expression):
        """Log-probability of a derivation, in nats; -inf if a rule of it is masked."""
        with np.errstate(divide="ignore"):
            logs = np.log(self.probabilities)
        return float(sum(logs[rule] for rule in expression.rules()))

    def sample(self, rng, nonterminal, max_levels):
        """Draw a derivation with at most `max_levels` levels, without retries.

        At every node only rules that can still be finished within the bound are drawn, with
        their probabilities renormalised.

        Parameters
        ----------
        rng : numpy.random.Generator
        nonterminal : str
        max_levels : int

        Raises
        ------
        GrammarError
            If the bound is below the least number of levels of `nonterminal`.
        """
        if self.grammar.min_levels[nonterminal] > max_levels:
            raise GrammarError(
                f"{nonterminal} needs at least {self.grammar.min_levels[nonterminal]} levels, "
                f"got a bound of {max_levels}"
            )
        return self._draw(rng, nonterminal, max_levels)

    def sample_many(self, rng, nonterminal, max_levels, n):
        """Draw `n` derivations; the same distribution as `sample`, ten times as fast.

        Random numbers are drawn in blocks, and equal subtrees are one object.
        """
        if self.grammar.min_levels[nonterminal] > max_levels:
            self.sample(rng, nonterminal, max_levels)  # raises with the reason
        draws = _Draws(rng)
        made = {}

        def draw(nonterminal, levels):
            cumulative, rules, last = self._table(nonterminal, levels)
            rule = rules[min(bisect_right(cumulative, draws.next() * last), len(rules) - 1)]
            children = tuple([draw(child, levels - 1) for child in rule.children])
            key = (rule.index, children)
            tree = made.get(key)
            if tree is None:
                tree = made[key] = Expression(rule.index, children)
            return tree

        return [draw(nonterminal, max_levels) for _ in range(n)]

    def _table(self, nonterminal, levels):
        tables = self.__dict__.setdefault("_tables", {})
        key = (nonterminal, levels)
        if key not in tables:
            rules, cumulative = self._choices(nonterminal, levels)
            tables[key] = (cumulative.tolist(), rules, float(cumulative[-1]))
        return tables[key]

    def _draw(self, rng, nonterminal, levels):
        rules, cumulative = self._choices(nonterminal, levels)
        rule = rules[int(np.searchsorted(cumulative, rng.random() * cumulative[-1], "right"))]
        return Expression(rule.index, [self._draw(rng, c, levels - 1) for c in rule.children])

    def _choices(self, nonterminal, levels):
        cache = self.__dict__.setdefault("_cache", {})
        key = (nonterminal, levels)
        if key not in cache:
            least = self.grammar.min_levels
            rules = [
                rule
                for rule in self.grammar.rules_of[nonterminal]
                if 1 + max((least[c] for c in rule.children), default=0) <= levels
            ]
            weights = self.probabilities[[rule.index for rule in rules]]
            if weights.sum() == 0:
                weights = np.ones(len(rules))
            cache[key] = (rules, np.cumsum(weights))
        return cache[key]


class _Draws:
    """Uniform random numbers, drawn in blocks."""

    def __init__(self, rng, block=4096):
        self.rng = rng
        self.block = block
        self.values = []

    def next(self):
        if not self.values:
            self.values = self.rng.random(self.block).tolist()
        return self.values.pop()
