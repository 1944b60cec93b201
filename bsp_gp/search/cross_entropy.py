"""Cross-entropy search over a probabilistic grammar (paper, section 3.3.1 and algorithm 2).

Trees are drawn from the PCFG under the bound on levels; its probabilities are refitted to the
rules of the elite. The defaults differ from the paper in four points, each for a reason: the elite
is small and taken among *distinct* laws (a good law drawn a hundred times would otherwise be the
whole elite), a part of the uniform grammar is mixed in (no rule dies out), the search starts anew
when nothing better has come for a while (known laws cost nothing), and populations are products of
pools of subtrees, which are scored at three times the rate.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.language.pcfg import Pcfg


@dataclass(frozen=True)
class CrossEntropy:
    """Settings of a cross-entropy search.

    Attributes
    ----------
    population : int
        Trees drawn per step.
    max_levels : int
        Bound on the levels of a tree.
    elite : int
        Trees (or distinct laws) that the grammar is refitted to.
    smoothing : float
        Pseudo-count added to every rule.
    distinct : bool
        Whether the elite is taken among distinct laws.
    uniform_share : float
        Part of the uniform grammar mixed into the refitted one.
    patience : int or None
        Steps without a better law after which the grammar is made uniform again.
    pool : (int, int) or None
        Scalars and vectors of the pools whose products make up a population, which are cheap to
        score (`Pcfg.sample_crossed`); None draws tree by tree.
    seeds : tuple of Expression
        In the first population, beside what is drawn.
    """

    population: int = 2000
    max_levels: int = 10
    elite: int = 60
    smoothing: float = 0.5
    distinct: bool = True
    uniform_share: float = 0.15
    patience: int | None = 8
    pool: tuple[int, int] | None = (64, 4)
    name: str = "cross_entropy"
    seeds: tuple = ()

    def init(self, objective, rng):
        """Draw from the uniform grammar."""
        return self._drawn(Pcfg.uniform(objective.grammar), objective, rng, None, 0, self.seeds)

    def step(self, state, objective, rng):
        """Refit to the elite and draw again; begin anew when stuck."""
        uniform = Pcfg.uniform(objective.grammar)
        if self.patience is not None and state["stuck"] >= self.patience:
            return self._drawn(uniform, objective, rng, None, 0)
        fitted = Pcfg.from_counts(objective.grammar, state["counts"], self.smoothing)
        pcfg = fitted.mixed(uniform, self.uniform_share)
        return self._drawn(pcfg, objective, rng, state["best"], state["stuck"])

    def _drawn(self, pcfg, objective, rng, best, stuck, seeds=()):
        where = (rng, objective.start, self.max_levels, self.population)
        trees = pcfg.sample_crossed(*where, self.pool) if self.pool else pcfg.sample_many(*where)
        trees = [*seeds, *trees]
        scores = objective.score(trees)
        order = np.argsort([score.cost for score in scores], kind="stable")
        elite, seen = [], set()
        for k in order:
            if len(elite) >= self.elite or not np.isfinite(scores[k].cost):
                break
            if self.distinct and scores[k].law in seen:
                continue
            seen.add(scores[k].law)
            elite.append(trees[k])
        lowest = float(scores[order[0]].cost)
        improved = best is None or lowest < best
        return {
            "counts": pcfg.counts(elite).tolist(),
            "best": lowest if improved else best,
            "stuck": 0 if improved else stuck + 1,
        }


@dataclass(frozen=True)
class RandomSearch:
    """The uniform grammar without learning: the yardstick of the others."""

    population: int = 800
    max_levels: int = 10
    name: str = "random"

    def init(self, objective, rng):
        """Nothing to prepare."""
        return {}

    def step(self, state, objective, rng):
        """Draw and score."""
        pcfg = Pcfg.uniform(objective.grammar)
        draw = pcfg.sample_many
        objective.score(draw(rng, objective.start, self.max_levels, self.population))
        return state
