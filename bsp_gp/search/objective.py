"""The objective that all searches share: Expression -> loss with its best constants, and cost.

Bilevel (paper, section 3.3.1): the outer level is symbolic, the inner level finds the constants.
Constants that multiply the terms of a law are solved in closed form, many laws at a time; others
go through `fit_constants`. Laws that are equal on the data are scored once (`recognition`).
"""

import functools
from typing import NamedTuple

import numpy as np

from bsp_gp.errors import EvaluationError, SettingsError
from bsp_gp.language.formula import summands
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.search.banks import Rows
from bsp_gp.search.candidate import Candidate, front_of
from bsp_gp.search.columns import BATCH_BYTES, Columns, Projected, orthonormal
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.recognition import Recogniser
from bsp_gp.search.scoring import COLLINEAR

CRITERIA = ("prior", "mdl")


class Score(NamedTuple):
    """Score of one law.

    Attributes
    ----------
    law : int
        Number of the law among those that differ on the data; -1 if it has no finite value.
    loss : float
        Half the whitened residual sum of squares, nats; inf if there is no finite value.
    complexity : float
        -log p of the expression under the uniform PCFG, nats.
    cost : float
        What searches minimise.
    """

    law: int
    loss: float
    complexity: float
    cost: float


class Objective:
    """Scores expressions on a regression.

    Parameters
    ----------
    regression : Regression
        For an expectation over draws of latent properties: the draws' regressions stacked, the
        scale of each times the root of its weight (`bsp_gp.physics.regression.stack_draws`).
    grammar : Grammar
        Masked to the data.
    kind : str
    target, nuisance : ndarray, optional
        As in `search_exhaustive`: residual of a law that is there already, columns of its free
        constants.
    criterion : str
        "prior": loss + beta * complexity, as in the paper; "mdl": loss with the noise level
        profiled out, half a log n per constant, and the complexity.
    beta : float
        Weight of the complexity under "prior".
    starts : int
        Start points of constants that do not multiply a term.
    null_targets : ndarray, shape (n, B), optional
        Simulated targets.
    inner : InnerSearch, optional
        Scores laws whose inner constants have ranges on grids, beside the same free constants.

    Attributes
    ----------
    null_gain : ndarray, shape (B,)
        The most that any law which was scored explains of each simulated target; of constants that
        do not multiply a term the fitted values are taken.
    n_trees, n_scored, n_repeats, n_failed : int
        Trees asked for; laws that differ on the data; trees that had been asked for before; new
        trees without a finite value, without any effect on the data, or with terms that are not
        independent of each other there.
    best : dict of int to (Expression, Score)
        Law -> its least complex expression seen so far.
    """

    def __init__(
        self, regression, grammar, kind, *, target=None, nuisance=None, criterion="prior",
        beta=1e-3, starts=3, null_targets=None, inner=None,
    ):  # fmt: skip
        if criterion not in CRITERIA:
            raise SettingsError(f"criterion must be one of {CRITERIA}, got {criterion!r}")
        if kind not in grammar.start:
            raise SettingsError(f"grammar {grammar.name} has no {kind} laws")
        self._given = {
            "regression": regression, "grammar": grammar, "kind": kind, "target": target,
            "nuisance": nuisance, "criterion": criterion, "beta": beta, "starts": starts,
            "null_targets": null_targets, "inner": inner,
        }  # fmt: skip
        self.regression = regression
        self.grammar = grammar
        self.kind = kind
        self.start = grammar.start[kind]
        self.criterion, self.inner = criterion, inner
        self.beta = beta
        self.starts = starts
        self.rows = Rows(regression, kind)
        self.recogniser = Recogniser(grammar, self.rows)
        y = regression.target() if target is None else np.asarray(target, dtype=float)
        self.q = orthonormal(nuisance, len(y))
        self.y = y - self.q @ (self.q.T @ y)
        self.total = float(self.y @ self.y)
        null = np.zeros((len(y), 0)) if null_targets is None else np.asarray(null_targets)
        self.null = null - self.q @ (self.q.T @ null)
        self.null_gain = np.zeros(self.null.shape[1])
        self.columns = Columns(self.rows, self.y, self.q)
        self.projected = Projected(regression, self.y, self.q)
        self.n_trees = self.n_scored = self.n_repeats = self.n_failed = self.n_grids = 0
        self._log_probs = _log_probs(grammar)
        self._complexities = {}
        self._scores = {}
        self._laws = {}
        self._fits = {}
        self.best = {}

    def fresh(self):
        """The same objective, nothing scored yet."""
        return Objective(**self._given)

    def __reduce__(self):
        # To another process go the data, not what was computed from them.
        return (functools.partial(Objective, **self._given), ())

    # --- scores ----------------------------------------------------------------------------------

    def score(self, expressions):
        """Scores of expressions, in order; equal laws share theirs."""
        self.n_trees += len(expressions)
        scores, law_of = self._scores, self.recogniser.law
        new = {}
        for expression in expressions:
            if expression not in scores and expression not in new:
                new[expression] = law_of(expression)
        self._score_new(new)
        self.n_repeats += len(expressions) - len(new)
        return self.known(expressions)

    def known(self, expressions):
        """Scores of expressions that were scored before; not counted."""
        scores = self._scores
        return [scores[expression] for expression in expressions]

    def complexity(self, expression):
        """-log p of an expression under the uniform PCFG, nats; kept for its subtrees."""
        known, total = self._complexities, -self._log_probs[expression.rule]
        for child in expression.children:
            part = known.get(child)
            if part is None:
                part = known[child] = self.complexity(child)
            total += part
        return total

    def _score_new(self, new):
        singles, sums = {}, {}
        for law in new.values():
            key = _key(law)
            if key is None or key in self._laws:
                continue
            if law.whole is not None:
                self._fit_whole(key, law.whole)
            elif len(law.terms) == 1:
                a, b = law.terms[0]
                singles.setdefault(b, {})[a] = None
            else:
                sums.setdefault(len(law.terms), {})[law.terms] = None
        for b, members in singles.items():
            self._score_singles(b, list(members))
        for laws in sums.values():
            self._score_sums(list(laws))
        for expression, law in new.items():
            self._finish(expression, _key(law))

    def _finish(self, expression, key):
        complexity = self.complexity(expression)
        number, loss, n_constants = (-1, np.inf, 0) if key is None else self._laws[key]
        if number < 0:
            self.n_failed += 1
            self._scores[expression] = Score(-1, np.inf, complexity, np.inf)
            return
        cost = self.cost(loss, complexity, n_constants)
        score = self._scores[expression] = Score(number, loss, complexity, cost)
        kept = self.best.get(number)
        if kept is None or complexity < kept[1].complexity:
            self.best[number] = (expression, score)

    def cost(self, loss, complexity, n_constants):
        """What searches minimise, nats."""
        if self.criterion == "prior":
            return loss + self.beta * complexity
        n = self.regression.n_rows
        profiled = 0.5 * n * np.log(max(2 * loss / n, 1e-30)) + 0.5 * n_constants * np.log(n)
        return profiled + complexity

    def _settle(self, key, loss, n_constants):
        """Give a law its number; a loss that is not finite is no law."""
        if not np.isfinite(loss):
            self._laws[key] = (-1, np.inf, 0)
            return
        self._laws[key] = (self.n_scored, max(loss, 0.0), n_constants)
        self.n_scored += 1

    def _score_singles(self, b, members):
        """Laws of one term that share a direction: two dot products each."""
        vector = self.recogniser.values("direction", b)
        values = [self.recogniser.values("coefficient", a) for a in members]
        dots, sizes = self.columns.dots_and_sizes(values, vector)
        if self.null.size:
            self._note_null(self.columns.columns(values, vector))
        with np.errstate(divide="ignore", invalid="ignore"):
            losses = np.where(sizes > 0, 0.5 * (self.total - dots**2 / sizes), np.inf).tolist()
        for a, loss in zip(members, losses, strict=True):
            self._settle(((a, b),), loss, 1)

    def _score_sums(self, laws):
        """Laws of several terms, all of as many: small normal equations, many at a time."""
        step = max(1, BATCH_BYTES // (8 * len(self.y) * len(laws[0])))
        for start in range(0, len(laws), step):
            part = laws[start : start + step]
            terms = {term: k for k, term in enumerate(sorted({t for law in part for t in law}))}
            columns = self._term_columns(list(terms))
            if self.null.size:
                self._note_null(columns)
            chosen = columns[[[terms[term] for term in law] for law in part]]
            gram = np.einsum("lin,ljn->lij", chosen, chosen, optimize=True)
            dots = np.einsum("lin,n->li", chosen, self.y, optimize=True)
            for key, loss in zip(part, _losses(gram, dots, self.total), strict=True):
                self._settle(key, loss, len(key))

    def _term_columns(self, terms):
        """Columns of terms, scaled to unit norm; shape (len(terms), n)."""
        out = np.zeros((len(terms), len(self.y)))
        by_direction = {}
        for k, (a, b) in enumerate(terms):
            by_direction.setdefault(b, []).append((k, a))
        for b, members in by_direction.items():
            vector = self.recogniser.values("direction", b)
            values = [self.recogniser.values("coefficient", a) for _, a in members]
            out[[k for k, _ in members]] = self.columns.columns(values, vector)
        norms = np.linalg.norm(out, axis=1, keepdims=True)
        return out / np.where(norms > 0, norms, 1.0)

    def _fit_whole(self, key, formula):
        """Laws whose constants do not all multiply a term: the full inner level."""
        scan = None if self.inner is None else self.inner.of_law(formula, self.kind)
        if scan is not None:
            self.null_gain = np.maximum(self.null_gain, scan.null)
            self._fits[formula] = scan
            self.n_grids += 1
            self._settle(key, 0.5 * (self.total - scan.gain) if scan.gain > 0 else np.inf, 1)
            return
        law = self._law(formula, dict.fromkeys(formula.constants, 1.0))
        try:
            fit = fit_constants(self.projected, law, starts=self.starts)
        except EvaluationError:
            self._laws[key] = (-1, np.inf, 0)
            return
        if self.null.size:
            self._note_null((self.y - fit.residual)[None])
        self._fits[formula] = tuple(float(fit.law.constants[n]) for n in formula.constants)
        self._settle(key, fit.loss, len(formula.constants))

    def _note_null(self, columns):
        """Note what columns (k, n) explain of the simulated targets; of sums term by term."""
        size = np.linalg.norm(columns, axis=1, keepdims=True)
        dots = (columns / np.where(size > 0, size, 1.0)) @ self.null
        self.null_gain = np.maximum(self.null_gain, np.square(dots).max(axis=0, initial=0.0))

    def _law(self, formula, constants):
        return ForceLaw(tuple(Term(part, self.kind) for part in summands(formula)), constants)

    # --- candidates ------------------------------------------------------------------------------

    def candidate(self, expression):
        """A scored expression as a Candidate, with its constants and exactly recomputed loss."""
        (score,) = self.known([expression])
        formula = self.recogniser.formula(expression)
        law = self.recogniser.law(expression)
        names = formula.constants
        if law.whole is not None and not isinstance(self._fits[law.whole], tuple):
            # Its inner constants are where the grid has it; a fit sets out from there.
            gain = self.total - 2 * score.loss
            return Candidate(formula, self.kind, {}, score.loss, score.complexity, gain,
                             self.total, expression)  # fmt: skip
        if law.whole is not None:
            constants = dict(zip(names, self._fits[law.whole], strict=True))
            residual = self.projected.residual(self._law(formula, constants))
        else:
            start = self._law(formula, dict.fromkeys(names, 1.0))
            fit = fit_constants(self.projected, start)
            constants, residual = dict(fit.law.constants), fit.residual
        loss = 0.5 * float(np.square(residual).sum())
        return Candidate(
            formula, self.kind, constants, loss, score.complexity, self.total - 2 * loss,
            self.total, expression,
        )  # fmt: skip

    def front(self):
        """Best distinct laws per complexity, each better than every simpler one.

        Returns
        -------
        list of (Expression, Score), simplest first
        """
        return list(front_of(self.best.values(), lambda entry: entry[1]))


def _key(law):
    """What a law is known by: its terms, or its formula."""
    if law is None:
        return None
    return law.terms if law.whole is None else law.whole


def _losses(gram, dots, total):
    """Least squares of unit columns from their products, (k,) nats; inf where not independent."""
    eigenvalues = np.linalg.eigvalsh(gram)
    fine = eigenvalues[:, 0] > COLLINEAR * eigenvalues[:, -1]
    safe = np.where(fine[:, None, None], gram, np.eye(gram.shape[1]))
    explained = np.einsum("li,li->l", dots, np.linalg.solve(safe, dots[..., None])[..., 0])
    return np.where(fine, 0.5 * (total - explained), np.inf).tolist()


def _log_probs(grammar):
    with np.errstate(divide="ignore"):
        return np.log(Pcfg.uniform(grammar).probabilities).tolist()
