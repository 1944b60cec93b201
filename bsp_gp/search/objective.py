"""The objective that all searches share: Expression -> loss with its best constant, and cost.

Bilevel (paper, section 3.3.1): the outer level is symbolic, the inner level finds the constant
in closed form. Values of factors are kept per data set, so that a new tree pays only for what is
new in it, and laws that are equal on the data are recognised by the values of their factors and
scored once. New laws are scored in batches that share a direction.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import EvaluationError, SettingsError, UnitError
from bsp_gp.language.expression import to_formula
from bsp_gp.language.formula import Call, Constant, Number, evaluate, factors, product
from bsp_gp.language.grammar import fill
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.search.banks import Rows, fingerprints
from bsp_gp.search.candidate import Candidate
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.scoring import COLLINEAR, _receiver_index

__all__ = ["CRITERIA", "Objective", "Score"]

CRITERIA = ("prior", "bic", "mdl")
CACHE_BYTES = 1 << 28
BATCH_BYTES = 1 << 25


@dataclass(frozen=True)
class Score:
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
    constant : float
        The law's constant; of several the first, of none 1.
    """

    law: int
    loss: float
    complexity: float
    cost: float
    constant: float


class Objective:
    """Scores expressions on a regression.

    Parameters
    ----------
    regression : Regression
        For an expectation over draws of latent properties: the draws' regressions stacked, the
        scale of each times the root of its weight (`bsp_gp.physics.likelihood.stack_draws`).
    grammar : Grammar
        Masked to the data.
    kind : str
    target, nuisance : ndarray, optional
        As in `search_exhaustive`: residual of a law that is there already, columns of its free
        constants.
    criterion : str
        "prior": loss + beta * complexity, as in the paper; "bic": loss with the noise level
        profiled out plus half a log n per constant; "mdl": that plus the complexity.
    beta : float
        Weight of the complexity under "prior".

    Attributes
    ----------
    n_trees, n_scored, n_repeats, n_failed : int
        Trees asked for; laws that differ on the data; trees that had been asked for before;
        new trees without a finite value or without any effect on the data.
    best : dict of int to (Expression, Score)
        Law -> its least complex expression seen so far.
    history : list of list of Expression
        All distinct trees, in the order and in the batches in which they were scored: scoring
        the batches again gives the same numbers and the same bits.
    """

    def __init__(
        self, regression, grammar, kind, *, target=None, nuisance=None, criterion="prior", beta=1e-3
    ):
        if criterion not in CRITERIA:
            raise SettingsError(f"criterion must be one of {CRITERIA}, got {criterion!r}")
        if kind not in grammar.start:
            raise SettingsError(f"grammar {grammar.name} has no {kind} laws")
        self.regression = regression
        self.grammar = grammar
        self.kind = kind
        self.start = grammar.start[kind]
        self.criterion = criterion
        self.beta = beta
        self.rows = Rows(regression, kind)
        self.log_probs = _log_probs(grammar)
        y = regression.target() if target is None else np.asarray(target, dtype=float)
        self.q = _orthonormal(nuisance, len(y))
        self.y = y - self.q @ (self.q.T @ y)
        self.total = float(self.y @ self.y)
        self.n_trees = self.n_scored = self.n_repeats = self.n_failed = 0
        self._scores = {}
        self._formulas = {}
        self._classes = {"coefficient": {}, "direction": {}}
        self._of_formula = {}
        self._members = {"coefficient": [], "direction": []}
        self._laws = {}
        self._fits = {}
        self._values = OrderedDict()
        self._bytes = 0
        self._inputs = _FlatInputs(self.rows, grammar)
        self._subtrees = _BoundedCache(CACHE_BYTES)
        self._weights = np.random.default_rng(20211).standard_normal(
            (self.rows.n_rows, self.rows.n_dims, 3)
        )
        mass = self.rows.input("m_i", False)
        self._per_mass = (1.0 / mass)[:, None]
        self.best = {}
        self.history = []

    @property
    def fingerprint(self):
        """Hash of what the scores depend on: grammar and its mask, settings, data."""
        settings = (
            self.grammar.fingerprint,
            tuple(map(bool, self.grammar.enabled)),
            self.kind,
            self.criterion,
            float(self.beta),
        )
        digest = hashlib.sha256(repr(settings).encode())
        for batch in self.regression.batches:
            for array in (batch.times, batch.positions, batch.velocities, batch.scale):
                digest.update(np.ascontiguousarray(array).tobytes())
        for array in (self.y, self.q, self._per_mass):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    # --- scores ----------------------------------------------------------------------------------

    def score(self, expressions):
        """Scores of expressions, in order; equal laws share theirs.

        Parameters
        ----------
        expressions : sequence of Expression

        Returns
        -------
        list of Score
        """
        self.n_trees += len(expressions)
        new = {}
        for expression in expressions:
            if expression not in self._scores and expression not in new:
                new[expression] = self._identify(expression)
        self._score_new(new)
        if new:
            self.history.append(list(new))
        self.n_repeats += len(expressions) - len(new)
        return self.known(expressions)

    def known(self, expressions):
        """Scores of expressions that were scored before; not counted."""
        return [self._scores[expression] for expression in expressions]

    def _identify(self, expression):
        """Key of the law among `_laws`; None without a value.

        (coefficient class, direction class), or ("whole", formula) for laws whose constants do
        not all multiply.
        """
        try:
            formula = self._formula(expression)
        except UnitError:
            return None
        parts = _parts(formula)
        if parts is None:
            return self._fit_whole(formula)
        coefficient, direction = parts
        a = self._class("coefficient", coefficient)
        b = self._class("direction", direction)
        return None if a is None or b is None else (a, b)

    def _formula(self, expression):
        """What an expression means; kept, since trees share their subtrees."""
        formula = self._formulas.get(expression)
        if formula is None:
            children = [self._formula(child) for child in expression.children]
            formula = fill(self.grammar.rules[expression.rule].body, children)
            self._formulas[expression] = formula
        return formula

    def _class(self, role, formula):
        """Number of the class of factors that are proportional on the data; None if not finite."""
        known = self._of_formula
        if formula not in known:
            value = self._value(role, formula)
            if value is None:
                known[formula] = None
            else:
                key = fingerprints([value], self._weights, merge_scale=True)[0]
                classes = self._classes[role]
                if key not in classes:
                    classes[key] = len(self._members[role])
                    self._members[role].append(formula)
                known[formula] = classes[key]
        return known[formula]

    def _value(self, role, formula):
        """Values of a factor on the rows, scaled to a greatest size of one (kept, bounded)."""
        if formula in self._values:
            self._values.move_to_end(formula)
            return self._values[formula]
        value = evaluate(formula, self._inputs, cache=self._subtrees)
        shape = (self.rows.n_rows, self.rows.n_dims) if role == "direction" else (self.rows.n_rows,)
        value = np.broadcast_to(value, shape)
        if role == "direction":
            value = value * self._per_mass
        top = np.max(np.abs(value)) if value.size else 0.0
        if not np.isfinite(top) or top == 0:
            return None
        value = np.ascontiguousarray(value / top)
        self._values[formula] = value
        self._bytes += value.nbytes
        while self._bytes > CACHE_BYTES and len(self._values) > 2:
            _, old = self._values.popitem(last=False)
            self._bytes -= old.nbytes
        return value

    def _score_new(self, new):
        waiting = {}
        for found in new.values():
            if found is not None and found not in self._laws:
                waiting.setdefault(found[1], {})[found[0]] = None
        for b, members in waiting.items():
            self._score_batch(b, list(members))
        for expression, found in new.items():
            self._finish(expression, found)

    def _finish(self, expression, found):
        complexity = -float(sum(self.log_probs[rule] for rule in expression.rules()))
        if found is None or self._laws[found][0] < 0:
            self.n_failed += 1
            self._scores[expression] = Score(-1, np.inf, complexity, np.inf, 0.0)
            return
        number, loss, constant = self._laws[found]
        n_constants = len(self._fits.get(number, (constant,)))
        cost = self._cost(loss, complexity, n_constants)
        score = self._scores[expression] = Score(number, loss, complexity, cost, constant)
        kept = self.best.get(number)
        if kept is None or complexity < kept[1].complexity:
            self.best[number] = (expression, score)

    def _cost(self, loss, complexity, n_constants):
        if self.criterion == "prior":
            return loss + self.beta * complexity
        n = self.regression.n_rows
        profiled = 0.5 * n * np.log(max(2 * loss / n, 1e-30)) + 0.5 * n_constants * np.log(n)
        return profiled + (complexity if self.criterion == "mdl" else 0.0)

    def _score_batch(self, b, members):
        """Losses of laws that share a direction: sums over sources, then two dot products."""
        vector = self._value("direction", self._members["direction"][b])
        step = max(1, BATCH_BYTES // (8 * vector.size))
        for start in range(0, len(members), step):
            part = members[start : start + step]
            values = [self._value("coefficient", self._members["coefficient"][a]) for a in part]
            columns = self._columns(np.stack(values), vector)
            raw = np.einsum("kn,kn->k", columns, columns)
            columns = self._projected(columns.T).T
            dots = columns @ self.y
            sizes = np.einsum("kn,kn->k", columns, columns)
            # What is left of a law that is there already is rounding, not a law.
            sizes = np.where(sizes > COLLINEAR * raw, sizes, 0.0)
            for a, dot, size in zip(part, dots, sizes, strict=True):
                self._settle((a, b), float(dot), float(size))

    def _projected(self, columns):
        """Columns (n[, k]) less what the free terms of the law explain of them."""
        return columns - self.q @ (self.q.T @ columns) if self.q.shape[1] else columns

    def _settle(self, key, dot, size):
        if not size > 0 or not np.isfinite(size):
            self._laws[key] = (-1, np.inf, 0.0)
            return
        loss = 0.5 * max(self.total - dot**2 / size, 0.0)
        self._laws[key] = (self.n_scored, loss, dot / size)
        self.n_scored += 1

    def _columns(self, coefficients, vector):
        """Whitened accelerations (k, n) of coefficients (k, P) times a direction (P, d)."""
        active = np.flatnonzero(np.any(vector, axis=1))
        fields = coefficients[:, active, None] * vector[active]
        starts = self._receiver_starts(active)
        index, firsts = starts
        summed = np.add.reduceat(fields, firsts, axis=1)
        out, offset = [], 0
        for batch, shape in zip(self.regression.batches, self.rows.shapes, strict=True):
            count = int(np.prod(shape[:3]))
            full = np.zeros((len(coefficients), count, vector.shape[1]))
            mine = (index >= offset) & (index < offset + count)
            full[:, index[mine] - offset] = summed[:, mine]
            full = np.moveaxis(full.reshape(len(coefficients), *shape[:3], -1), 0, 3)
            out.append(np.moveaxis(batch.whiten(full), 3, 0).reshape(len(coefficients), -1))
            offset += count
        return np.concatenate(out, axis=1)

    def _receiver_starts(self, active):
        receiver = _receiver_index(self.rows)[active]
        firsts = np.flatnonzero(np.concatenate([[True], receiver[1:] != receiver[:-1]]))
        return receiver[firsts], firsts

    def _fit_whole(self, formula):
        """Laws whose constants do not all multiply: the full inner level."""
        names = {name: f"c{k}" for k, name in enumerate(formula.constants, 1)}
        formula = _renamed(formula, names)
        key = ("whole", formula)
        if key not in self._laws:
            law = ForceLaw((Term(formula, self.kind),), dict.fromkeys(formula.constants, 1.0))
            try:
                fit = fit_constants(_Projected(self), law, starts=3)
            except EvaluationError:
                self._laws[key] = (-1, np.inf, 0.0)
                return key
            values = tuple(float(value) for value in fit.values)
            self._laws[key] = (self.n_scored, fit.loss, values[0] if values else 1.0)
            self._fits[self.n_scored] = values
            self.n_scored += 1
        return key

    # --- candidates ------------------------------------------------------------------------------

    def candidate(self, expression):
        """A scored expression as a Candidate, with its exactly recomputed loss."""
        (score,) = self.known([expression])
        formula = to_formula(expression, self.grammar)
        names = formula.constants
        if score.law in self._fits:
            constants = dict(zip(names, self._fits[score.law], strict=True))
            law = ForceLaw((Term(formula, self.kind),), constants)
            residual = _Projected(self).residual(law)
        else:
            bare = Term(_without_constant(formula, names[0]), self.kind)
            column = self._projected(self.regression.column(bare)[0][:, 0])
            size = float(column @ column)
            constant = float(column @ self.y) / size if size > 0 else 0.0
            constants = {names[0]: constant}
            residual = self.y - constant * column
        loss = 0.5 * float(np.square(residual).sum())
        return Candidate(
            formula,
            self.kind,
            constants,
            loss,
            score.complexity,
            self.total - 2 * loss,
            self.total,
            expression,
        )

    def front(self):
        """Best distinct laws per complexity, each better than every simpler one.

        Returns
        -------
        list of (Expression, Score), simplest first
        """
        out = []
        by_complexity = sorted(self.best.values(), key=lambda e: (e[1].complexity, e[1].loss))
        for expression, score in by_complexity:
            if not out or score.loss < out[-1][1].loss:
                out.append((expression, score))
        return out


class _Projected:
    """The regression as the inner level sees it: residual target, free terms projected out."""

    def __init__(self, objective):
        self.objective = objective
        self.regression = objective.regression

    def target(self):
        return self.objective.y

    def residual(self, law):
        predicted = self.regression.target() - self.regression.residual(law)
        return self.objective.y - self.objective._projected(predicted)

    def column(self, term, per_entity=False):
        columns, names = self.regression.column(term, per_entity)
        return self.objective._projected(columns), names

    def gradient(self, law, term):
        slopes = self.regression.gradient(law, term)
        return {name: self.objective._projected(slope) for name, slope in slopes.items()}


class _FlatInputs(dict):
    """Inputs of a grammar on the rows, looked up when first asked for."""

    def __init__(self, rows, grammar):
        super().__init__()
        self.rows = rows
        self.types = grammar.inputs

    def __missing__(self, name):
        self.update(self.rows.inputs_for([name], self.types))
        return self[name]


class _BoundedCache(dict):
    """Values of sub-formulas; emptied when it has grown beyond its bound."""

    def __init__(self, most_bytes):
        super().__init__()
        self.most_bytes = most_bytes
        self.bytes = 0

    def __setitem__(self, key, value):
        self.bytes += np.asarray(value).nbytes
        if self.bytes > self.most_bytes:
            self.clear()
            self.bytes = np.asarray(value).nbytes
        super().__setitem__(key, value)


def _log_probs(grammar):
    with np.errstate(divide="ignore"):
        return np.log(Pcfg.uniform(grammar).probabilities).tolist()


def _orthonormal(columns, n):
    if columns is None or not np.size(columns):
        return np.zeros((n, 0))
    columns = np.asarray(columns, dtype=float)
    live = columns[:, np.any(columns, axis=0)]
    return np.linalg.qr(live / np.linalg.norm(live, axis=0))[0] if live.size else np.zeros((n, 0))


def _parts(formula):
    """Split constant * scalars * vector [* condition] into (coefficient, direction) formulas.

    None if the formula is not of that form, or has further constants.
    """
    above, below = factors(formula)
    constants = [f for f in above if isinstance(f, Constant)]
    vectors = [f for f in above if f.type.shape == "vector"]
    if len(constants) != 1 or len(vectors) != 1:
        return None
    if not all(f.is_constant_free for f in below):
        return None
    conditions = [f for f in above if f.type.shape == "bool"]
    scalars = [f for f in above if f.type.shape == "scalar" and not isinstance(f, Constant)]
    if not all(f.is_constant_free for f in (*scalars, *vectors)):
        return None
    coefficient = product(scalars)
    if below:
        coefficient = Call("div", coefficient, product(below))
    direction = vectors[0]
    for condition in conditions:
        direction = Call("mul", direction, condition)
    return coefficient, direction


def _without_constant(formula, name):
    """The formula with a multiplying constant replaced by one."""
    if isinstance(formula, Constant) and formula.name == name:
        return Number(1.0)
    if isinstance(formula, Call):
        return Call(formula.operator, *(_without_constant(arg, name) for arg in formula.args))
    return formula


def _renamed(formula, names):
    """The formula with its constants renamed."""
    if isinstance(formula, Constant):
        return Constant(names.get(formula.name, formula.name))
    if isinstance(formula, Call):
        return Call(formula.operator, *(_renamed(arg, names) for arg in formula.args))
    return formula
