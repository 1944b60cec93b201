"""Probabilistic grammars: sampling under a bound on levels, log-probabilities, refitting."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import Expression


@dataclass(frozen=True, eq=False)
class Pcfg:
    """A grammar with one probability per rule (paper, section 3.3.1).

    Attributes
    ----------
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
        known = grammar.__dict__.get("_uniform")  # with the tables of its samplers
        if known is None:
            known = cls.from_counts(grammar, np.zeros(len(grammar.rules)), smoothing=1.0)
            object.__setattr__(grammar, "_uniform", known)
        return known

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

        Raises
        ------
        GrammarError
            If the bound is below the least number of levels of `nonterminal`.
        """
        return self.sample_many(rng, nonterminal, max_levels, 1)[0]

    def sampler(self, rng):
        """A source of derivations, for many draws: ``sampler.draw(nonterminal, max_levels)``.

        Random numbers are drawn in blocks.
        """
        return _Sampler(self, rng)

    def sample_many(self, rng, nonterminal, max_levels, n):
        """Draw `n` derivations."""
        self._check_bound(nonterminal, max_levels)
        draw = self.sampler(rng).draw
        return [draw(nonterminal, max_levels) for _ in range(n)]

    def sample_crossed(self, rng, nonterminal, max_levels, n, pool=(64, 4)):
        """Draw `n` derivations that are products of pools of subtrees.

        At the first rule with several nonterminals, subtrees are drawn for its scalars and for
        its vector and conditions, all are combined, and again until there are enough. Every tree
        has the distribution of `sample`, since a context-free grammar derives siblings
        independently; the trees of one pool are not independent of each other. Laws that share
        a direction, or their coefficients, are cheap to score together.

        Parameters
        ----------
        pool : (int, int)
            Scalars and vectors drawn at a time. Scalars vary more, so they need be more.
        """
        self._check_bound(nonterminal, max_levels)
        sampler = self.sampler(rng)
        spines = self._spines(nonterminal, max_levels)
        probabilities = np.array([p for _, p in spines])
        counts = rng.multinomial(n, probabilities / probabilities.sum())
        return [
            tree
            for (spine, _), count in zip(spines, counts.tolist(), strict=True)
            if count
            for block in _blocks(count, pool[0] * pool[1])
            for tree in self._crossed(sampler, spine, max_levels - len(spine), block, pool)
        ]

    def _crossed(self, sampler, spine, levels, n, pool):
        *above, rule = spine
        one, other = self._sides(rule)
        n_one = max(1, round((n * pool[0] / pool[1]) ** 0.5))
        n_other = -(-n // n_one)
        if not (one and other):
            n_one, n_other = (n, 1) if one else (1, n)
        first = [[sampler.draw(rule.children[k], levels) for k in one] for _ in range(n_one)]
        second = [[sampler.draw(rule.children[k], levels) for k in other] for _ in range(n_other)]
        order = np.argsort([*one, *other]).tolist()
        trees = []
        for b in second:
            for a in first:
                parts = [*a, *b]
                tree = Expression(rule.index, [parts[k] for k in order])
                for outer in reversed(above):
                    tree = Expression(outer.index, (tree,))
                trees.append(tree)
        return trees[:n]

    def _sides(self, rule):
        """Positions of a rule's children in two groups: scalars, and vectors with conditions."""
        shapes = [self.grammar.types[child].shape for child in rule.children]
        one = [k for k, shape in enumerate(shapes) if shape == "scalar"]
        other = [k for k, shape in enumerate(shapes) if shape != "scalar"]
        return (one, other) if one or len(other) < 2 else (other[:1], other[1:])

    def _spines(self, nonterminal, levels):
        """Chains of rules down to the first that does not have one child, with probabilities."""
        out = []
        rules, cumulative = self._choices(nonterminal, levels)
        for rule, weight in zip(rules, np.diff(cumulative, prepend=0.0), strict=True):
            share = weight / cumulative[-1]
            if len(rule.children) == 1:
                below = self._spines(rule.children[0], levels - 1)
                out += [((rule, *spine), share * p) for spine, p in below]
            else:
                out.append(((rule,), share))
        return out

    def _check_bound(self, nonterminal, max_levels):
        if self.grammar.min_levels[nonterminal] > max_levels:
            raise GrammarError(
                f"{nonterminal} needs at least {self.grammar.min_levels[nonterminal]} levels, "
                f"got a bound of {max_levels}"
            )

    def _table(self, nonterminal, levels):
        """What a sampler draws from: cumulative weights, their sum, and rules with what is below.

        A rule is (index, nonterminals below, and the whole tree where there are none).
        """
        rules, cumulative = self._choices(nonterminal, levels)
        below = [(r.index, r.children, None if r.children else Expression(r.index)) for r in rules]
        return cumulative.tolist(), float(cumulative[-1]), below, len(rules) - 1

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


def _blocks(n, most):
    """Split a number into nearly equal parts of at most `most`."""
    parts = -(-n // most)
    return [n // parts + (k < n % parts) for k in range(parts)]


class _Sampler:
    """Draws derivations; random numbers are drawn in blocks."""

    def __init__(self, pcfg, rng, block=4096):
        self.pcfg, self.rng, self.block = pcfg, rng, block
        self.tables = pcfg.__dict__.setdefault("_tables", {})
        self.values = []

    def draw(self, nonterminal, levels):
        key = (nonterminal, levels)
        table = self.tables.get(key)
        if table is None:
            table = self.tables[key] = self.pcfg._table(nonterminal, levels)
        cumulative, total, rules, last = table
        if not self.values:
            self.values = self.rng.random(self.block).tolist()
        chosen = bisect_right(cumulative, self.values.pop() * total)
        index, children, leaf = rules[min(chosen, last)]
        if leaf is not None:
            return leaf
        levels -= 1
        return Expression(index, [self.draw(child, levels) for child in children])
