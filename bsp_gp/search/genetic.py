"""Genetic programming on DEAP: strongly typed, types are nonterminals with units.

Individuals are expressions with a DEAP fitness. They start from the
PCFG under the bound on levels; crossover swaps subtrees of one type and mutation draws a subtree
anew, both within the bound, so that no unit and no bound is ever broken. Selection is NSGA-II
on (loss, complexity) among distinct laws; constants come from the inner level alone. Our own
variation takes the generator as an argument: DEAP's picks types from a set in memory order and
draws from the global `random`.
"""

from dataclasses import dataclass

from deap import base, tools

from bsp_gp.language.expression import Expression
from bsp_gp.language.pcfg import Pcfg


class _Fitness(base.Fitness):
    """Loss and complexity, both minimised."""

    weights = (-1.0, -1.0)


class _Individual:
    """An expression with its DEAP fitness."""

    __slots__ = ("cost", "expression", "fitness")

    def __init__(self, expression, score):
        self.expression = expression
        self.cost = score.cost
        self.fitness = _Fitness((score.loss, score.complexity))


@dataclass(frozen=True)
class Genetic:
    """Settings of a genetic search.

    Attributes
    ----------
    offspring : int
        Trees bred per generation.
    p_crossover : float
        Otherwise a subtree is mutated.
    immigrants : float
        Part of the offspring drawn from the PCFG, against stagnation.
    patience : int or None
        Generations without a law of lower cost after which all but the best are drawn anew.
    seeds : tuple of Expression
        In the first population, beside what is drawn.
    """

    population: int = 200
    offspring: int = 600
    max_levels: int = 10
    p_crossover: float = 0.5
    immigrants: float = 0.15
    patience: int | None = 12
    name: str = "genetic"
    seeds: tuple = ()

    def init(self, objective, rng):
        """Draw from the uniform PCFG."""
        pcfg = Pcfg.uniform(objective.grammar)
        trees = pcfg.sample_many(rng, objective.start, self.max_levels, self.offspring)
        return self._selected([*self.seeds, *trees], [], objective, None, 0)

    def step(self, state, objective, rng):
        """Breed, score, select."""
        grammar = objective.grammar
        pcfg = Pcfg.uniform(grammar)
        parents = list(state["population"])
        is_stuck = self.patience is not None and state["stuck"] >= self.patience
        if is_stuck or not parents:
            trees = pcfg.sample_many(rng, objective.start, self.max_levels, self.offspring)
            parents.sort(key=lambda tree: objective.known([tree])[0].cost)
            return self._selected(trees, parents[:1], objective, state["best"], 0)
        n_new = int(self.immigrants * self.offspring)
        trees = pcfg.sample_many(rng, objective.start, self.max_levels, n_new)
        variation = _Variation(grammar, pcfg, self.max_levels, rng)
        while len(trees) < self.offspring:
            if rng.random() < self.p_crossover:
                one, other = (parents[k] for k in self._picked(rng, len(parents)))
                trees.extend(variation.crossover(one, other))
            else:
                trees.append(variation.mutate(parents[self._picked(rng, len(parents))[0]]))
        trees = trees[: self.offspring]
        return self._selected(trees, parents, objective, state["best"], state["stuck"])

    def _picked(self, rng, n):
        """Two tournaments of two; parents are in the order of NSGA-II, best first."""
        return rng.integers(n, size=(2, 2)).min(axis=1)

    def _selected(self, trees, parents, objective, best, stuck):
        everyone = [*parents, *trees]
        scores = [*objective.known(parents), *objective.score(trees)]
        simplest = {}
        for expression, score in zip(everyone, scores, strict=True):
            known = simplest.get(score.law)
            if score.law >= 0 and (known is None or score.complexity < known[1].complexity):
                simplest[score.law] = (expression, score)
        pool = [_Individual(expression, score) for expression, score in simplest.values()]
        # The default sorting of selNSGA2 takes seconds where "log" takes milliseconds.
        chosen = tools.selNSGA2(pool, min(self.population, len(pool)), nd="log")
        lowest = min((individual.cost for individual in pool), default=None)
        improved = best is None or (lowest is not None and lowest < best)
        return {
            "population": [individual.expression for individual in chosen],
            "best": lowest if improved else best,
            "stuck": 0 if improved else stuck + 1,
        }


class _Variation:
    """Typed crossover and mutation within a bound on levels."""

    def __init__(self, grammar, pcfg, max_levels, rng):
        self.grammar = grammar
        self.draw = pcfg.sampler(rng).draw
        self.max_levels = max_levels
        self.rng = rng
        self._nodes = {}

    def crossover(self, one, other):
        """Swap a subtree of one type; `one` is mutated where none can be swapped in bounds."""
        path, node = self._pick(one)
        partners = [
            (p, n)
            for p, n in self._by_type(other).get(self._type(node), ())
            if n is not node
            and len(path) + n.levels <= self.max_levels
            and len(p) + node.levels <= self.max_levels
        ]
        if not partners:
            return [self.mutate(one)]
        where, partner = partners[int(self.rng.integers(len(partners)))]
        return [_replaced(one, path, partner), _replaced(other, where, node)]

    def mutate(self, expression):
        """Draw a subtree anew, within the levels that its place leaves."""
        path, node = self._pick(expression)
        new = self.draw(self._type(node), self.max_levels - len(path))
        return _replaced(expression, path, new)

    def _type(self, node):
        return self.grammar.rules[node.rule].nonterminal

    def _by_type(self, expression):
        """Nonterminal -> (path, node) of every node of that type; kept, since parents recur."""
        if expression not in self._nodes:
            table = self._nodes[expression] = {}
            for path, node in _nodes(expression):
                table.setdefault(self._type(node), []).append((path, node))
        return self._nodes[expression]

    def _pick(self, expression):
        """A node, all equally likely, and its path from the root (indices of children)."""
        index, path, node = int(self.rng.integers(expression.size)), [], expression
        while index:
            index -= 1
            for k, child in enumerate(node.children):
                if index < child.size:
                    path.append(k)
                    node = child
                    break
                index -= child.size
        return tuple(path), node


def _nodes(expression):
    """Every node with its path from the root (indices of children)."""
    stack = [((), expression)]
    while stack:
        path, node = stack.pop()
        yield path, node
        stack.extend(((*path, k), child) for k, child in enumerate(node.children))


def _replaced(expression, path, new):
    """The tree with the node at `path` replaced."""
    if not path:
        return new
    children = list(expression.children)
    children[path[0]] = _replaced(children[path[0]], path[1:], new)
    return Expression(expression.rule, children)
