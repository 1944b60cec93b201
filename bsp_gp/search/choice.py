"""Which searches look for a law: exhaustive with its certificate, and those that are guided.

The exhaustive search takes grammars whose laws are products, up to its bound. Cross-entropy and
genetic programming take any grammar, and go deeper, for as many laws as they are allowed.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import GrammarError, SettingsError
from bsp_gp.language.expression import derive
from bsp_gp.search.candidate import SearchResult
from bsp_gp.search.cross_entropy import CrossEntropy
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.factoring import plan_of
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search

SEARCHES = ("exhaustive", "cross_entropy", "genetic", "auto")
BUDGET = 5_000
"""Laws that differ on the data which a guided search may score; those with constants inside count
several times."""
DEEPER = 2
"""Levels beyond the bound of the exhaustive search to which "auto" goes."""
KEPT, N_IDLE = 40, 10
"""Laws that a guided search hands on, and steps without a new one after which it ends."""


def searches_for(search, grammar, kinds, max_levels):
    """The searches that are run, and up to how many levels.

    Parameters
    ----------
    search : str
        One of `SEARCHES`.
    grammar : Grammar
        Masked to the data.

    Raises
    ------
    SettingsError
        If there is no such search.
    GrammarError
        If the search cannot take the grammar; says which can.
    """
    if search not in SEARCHES:
        raise SettingsError(f"search must be one of {', '.join(SEARCHES)}, got {search!r}")
    if search in ("cross_entropy", "genetic"):
        return {search: max_levels}
    try:
        for kind in kinds:
            plan_of(grammar, kind, max_levels)
    except GrammarError as error:
        if search == "auto":
            return {"cross_entropy": max_levels + DEEPER, "genetic": max_levels + DEEPER}
        raise GrammarError(
            f"{error}; --search auto, cross_entropy and genetic take the grammar {grammar.name}"
        ) from None
    if search == "exhaustive":
        return {search: max_levels}
    deeper = max_levels + DEEPER
    return {"exhaustive": max_levels, "cross_entropy": deeper, "genetic": deeper}


class Searching:
    """A search for laws, as often as it is asked for.

    Parameters
    ----------
    searches : mapping of str to int
        As of `searches_for`.
    budget : int
        Laws that each guided search may score for one kind of law.
    missing_inputs : tuple of str
        For the certificate.
    beyond : Grammar, optional
        What is drawn from, if it is not the same; masked to the data.
    """

    def __init__(self, searches, grammar, budget=BUDGET, missing_inputs=(), beyond=None):
        self.searches, self.grammar, self.budget = searches, grammar, budget
        self.missing_inputs, self.beyond = missing_inputs, beyond or grammar

    @property
    def is_exhaustive(self):
        return "exhaustive" in self.searches

    @property
    def is_guided(self):
        return set(self.searches) > {"exhaustive"} or not self.is_exhaustive

    def run(
        self, name, regression, kind, rng, *, target, nuisance, null, max_ties, progress,
        inner=None, known=(),
    ):  # fmt: skip
        """What one of the searches finds.

        Parameters
        ----------
        target, nuisance, null, max_ties, progress
            As of `search_exhaustive`.
        inner : InnerSearch, optional
            Scores laws with constants inside.
        known : sequence of Formula
            Laws from which a guided search sets out.

        Returns
        -------
        result : SearchResult
        text : str
            What it covers.
        """
        if name == "exhaustive":
            result = search_exhaustive(
                regression, self.grammar, kind=kind, target=target, nuisance=nuisance,
                max_levels=self.searches[name], missing_inputs=self.missing_inputs,
                null_targets=null, max_ties=max_ties, progress=progress,
            )  # fmt: skip
            return result, result.certificate.text()
        objective = Objective(
            regression, self.beyond, kind, target=target, nuisance=nuisance, beta=1.0,
            null_targets=null, inner=inner,
        )  # fmt: skip
        result = self._guided(name, objective, rng, known, progress)
        best = max(result.candidates, key=lambda c: c.gain, default=None)
        share = "none" if best is None else f"the best explains {best.share:.1%}"
        text = (
            f"{name} search: {result.n_evaluated} {kind} laws of grammar {self.grammar.name} with "
            f"at most {self.searches[name]} levels visited, {share}; others may do better"
        )
        return result, text

    def _guided(self, name, objective, rng, known, progress):
        levels, kind = self.searches[name], objective.kind
        start = self.beyond.start[kind]
        if self.beyond.min_levels[start] > levels:
            nothing = (0.0,) * objective.null.shape[1]
            return SearchResult(None, (), (), 0, 0, 0.0, null_gains=nothing)
        seeds = (derive(formula, self.beyond, start) for formula in known)
        seeds = tuple(s for s in seeds if s is not None and s.levels <= levels)
        budget = Budget(n_scored=self.budget, n_idle=N_IDLE)
        result = run_search(
            _strategy(name, levels, seeds), objective, budget, rng=rng, keep=KEPT,
            callback=None if progress is None else lambda step, _: bool(progress(step, step)),
            is_part=True,
        )  # fmt: skip
        sizes = np.square(objective.null).sum(axis=0)
        gains = tuple(objective.null_gain / np.where(sizes > 0, sizes, 1.0))
        return replace(result, certificate=None, null_gains=gains)


def _strategy(name, max_levels, seeds):
    if name == "cross_entropy":
        return CrossEntropy(max_levels=max_levels, seeds=seeds)
    from bsp_gp.search.genetic import Genetic  # DEAP is slow to import

    return Genetic(max_levels=max_levels, seeds=seeds)
