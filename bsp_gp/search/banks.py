"""Bottom-up enumeration: every value that a nonterminal can take on the data, each once.

Derivations with the same values on the rows are merged (the one with fewest levels, then the
likeliest, is kept), so that a bank holds a few hundred distinct values where the grammar has
millions of derivations.
"""

import functools
import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import UnitError
from bsp_gp.language.expression import Expression
from bsp_gp.language.formula import evaluate, input_types_of
from bsp_gp.language.grammar import fill
from bsp_gp.language.inputs import property_of
from bsp_gp.physics.bodies import law_inputs

MOST_TIES = 60
"""Entries remembered as merged into one."""
DIGITS = 11
"""Values that agree to this many digits (of their norm) are one value."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One distinct value of a nonterminal.

    Attributes
    ----------
    formula : Formula
    expression : Expression
    complexity : float
        -log p under the uniform PCFG, nats.
    value : ndarray
        On the rows, flat: (P,) or (P, d).
    operator : str
        How it enters as a right-hand factor: "mul", or the grammar's division.
    ties : list of Entry
        Merged entries that are equal or proportional on the data, without their values.
    sign : float
        Of a tie: 1 where it is a positive multiple of the entry, -1 where a negative one.
    """

    formula: object
    expression: object
    complexity: float
    levels: int
    value: np.ndarray
    operator: str = "mul"
    ties: list = field(default_factory=list)
    sign: float = 1.0

    def family(self):
        """The entry and all that were merged into it."""
        return [self, *self.ties]

    @property
    def is_static(self):
        """Whether it depends on properties only, which do not vary along time."""
        return all(property_of(name) is not None for name in self.formula.inputs)


class Rows:
    """The places where a law of one kind is evaluated, flat over the batches of a regression.

    Attributes
    ----------
    shapes : list of tuple
        ``(n, S, R, J)`` of each batch; J is 1 for field laws.
    n_rows : int
    """

    def __init__(self, regression, kind):
        self.kind = kind
        self.regression = regression
        self.lookups = [
            law_inputs(kind, b.bodies, b.positions, b.velocities, b.times)
            for b in regression.batches
        ]
        self.shapes = []
        self.valid = []
        for batch in regression.batches:
            n_sources = batch.bodies.others.shape[1] if kind == "pair" else 1
            shape = (*batch.target.shape[:3], n_sources)
            self.shapes.append(shape)
            self.valid.append(np.broadcast_to(batch.valid.any(axis=-1)[..., None], shape).ravel())
        self.keep = np.concatenate(self.valid) if self.valid else np.zeros(0, dtype=bool)
        self.n_rows = int(self.keep.sum())
        self.n_dims = regression.batches[0].bodies.n_dims
        self._inputs = {}

    @functools.cached_property
    def receiver(self):
        """Which (instant, scene, receiver) each valid row belongs to."""
        parts, offset = [], 0
        for shape in self.shapes:
            n = int(np.prod(shape[:3]))
            parts.append(np.repeat(np.arange(offset, offset + n), shape[3]))
            offset += n
        return np.concatenate(parts)[self.keep]

    def input(self, name, is_vector):
        """Values of an input on the valid rows, (P,) or (P, d)."""
        if name not in self._inputs:
            parts = []
            for lookup, shape in zip(self.lookups, self.shapes, strict=True):
                value = lookup[name]
                full = (
                    *shape[: 3 if self.kind == "field" else 4],
                    *((self.n_dims,) if is_vector else ()),
                )
                value = np.broadcast_to(value, full)
                parts.append(value.reshape(-1, self.n_dims) if is_vector else value.ravel())
            self._inputs[name] = np.concatenate(parts)[self.keep]
        return self._inputs[name]

    def shape_input(self, name):
        """Shapes of receivers or sources on the valid rows."""
        from bsp_gp.physics.geometry import Shapes

        if name not in self._inputs:
            columns = []
            for attribute in ("code", "radius", "width", "height"):
                parts = [
                    np.broadcast_to(getattr(lookup[name], attribute), shape).ravel()
                    for lookup, shape in zip(self.lookups, self.shapes, strict=True)
                ]
                columns.append(np.concatenate(parts)[self.keep])
            self._inputs[name] = Shapes(*columns)
        return self._inputs[name]

    def inputs_for(self, formula_inputs, types):
        """Mapping of the named inputs, flat."""
        out = {}
        for name in formula_inputs:
            shape = types[name].shape
            out[name] = (
                self.shape_input(name)
                if shape == "shape"
                else self.input(name, shape in ("vector", "point"))
            )
        return out

    def unflatten(self, value):
        """Put flat values back: one array (n, S, R, J[, d]) per batch, 0 at invalid rows."""
        tail = value.shape[1:]
        full = np.zeros((len(self.keep), *tail))
        full[self.keep] = value
        out, start = [], 0
        for shape in self.shapes:
            size = int(np.prod(shape))
            out.append(full[start : start + size].reshape(*shape, *tail))
            start += size
        return out


class Banks:
    """Distinct values of every nonterminal within a bound on levels.

    Parameters
    ----------
    grammar : Grammar
        Masked to what the data supply.
    log_probs : ndarray, shape (n_rules,)
        Under the uniform PCFG.
    """

    def __init__(self, grammar, rows, log_probs):
        self.grammar = grammar
        self.rows = rows
        self.log_probs = log_probs
        self.n_failed = 0
        self._levels = {}
        self._seen = {}
        self._weights = np.random.default_rng(20211).standard_normal((rows.n_rows, rows.n_dims, 3))

    def bank(self, nonterminal, max_levels):
        """All distinct entries of at most `max_levels` levels, fewest levels first."""
        out = []
        for level in range(1, max_levels + 1):
            out.extend(self.level(nonterminal, level))
        return out

    def level(self, nonterminal, level):
        """The distinct entries of exactly this many levels."""
        key = (nonterminal, level)
        if key not in self._levels:
            self._levels[key] = []  # a recursive nonterminal sees only lower levels
            if level > 1:
                self.level(nonterminal, level - 1)
            self._levels[key] = self._new_entries(nonterminal, level)
        return self._levels[key]

    def _new_entries(self, nonterminal, level):
        found = {}
        seen = self._seen.setdefault(nonterminal, {})
        for rule in self.grammar.rules_of[nonterminal]:
            for children in self._child_tuples(rule, level):
                entry = self._build(rule, children)
                if entry is None:
                    continue
                key = fingerprints([entry.value], self._weights, merge_scale=False)[0]
                if key in seen:
                    _remember(seen[key], entry)
                elif key not in found:
                    found[key] = entry
                elif entry.complexity < found[key].complexity:
                    _remember(entry, found[key])
                    found[key] = entry
                else:
                    _remember(found[key], entry)
        seen.update(found)
        return list(found.values())

    def _child_tuples(self, rule, level):
        if not rule.children:
            return [()] if level == 1 else []
        if level == 1:
            return []
        lower = [self.bank(child, level - 1) for child in rule.children]
        return (
            children
            for children in itertools.product(*lower)
            if max(child.levels for child in children) == level - 1
        )

    def _build(self, rule, children):
        try:
            formula = fill(rule.body, [child.formula for child in children])
        except UnitError:
            self.n_failed += 1
            return None
        value = self._value(rule, children, formula)
        if value is None or not np.any(value):
            return None
        complexity = sum(child.complexity for child in children) - self.log_probs[rule.index]
        expression = Expression(rule.index, [child.expression for child in children])
        return Entry(formula, expression, complexity, expression.levels, value)

    def _value(self, rule, children, formula):
        stored = {child.formula: child.value for child in children}
        if formula in stored:
            return stored[formula]
        inputs = self.rows.inputs_for(formula.inputs, input_types_of(formula))
        value = evaluate(formula, inputs, cache=_Overlay(stored))
        shape = (self.rows.n_rows, self.rows.n_dims)
        value = np.broadcast_to(
            value, shape if formula.type.shape in ("vector", "point") else shape[:1]
        ).astype(float)
        if not np.all(np.isfinite(value)):
            self.n_failed += 1
            return None
        return value


def _remember(lead, other):
    """Note that `other` was merged into `lead`."""
    sign = -1.0 if float(np.vdot(lead.value, other.value)) < 0 else 1.0
    for entry in other.family():
        if len(lead.ties) < MOST_TIES and entry.formula != lead.formula:
            lead.ties.append(replace(entry, value=None, ties=[], sign=sign * entry.sign))


class _Overlay(dict):
    """A cache that knows the children's values and does not keep intermediate ones."""

    def __setitem__(self, key, value):
        pass


def fingerprints(values, weights, merge_scale):
    """Hashable keys: equal values have equal keys; with `merge_scale` proportional ones too.

    Three random projections of the normalised values, rounded to `DIGITS` digits; the sign is
    taken from the first projection that is not 0.
    """
    keys = []
    for value in values:
        matrix = weights[:, 0] if value.ndim == 1 else weights.reshape(-1, weights.shape[-1])
        size = float(np.linalg.norm(value))
        if size == 0 or not np.isfinite(size):
            keys.append(None)
            continue
        projections = np.ravel(value) @ matrix / size
        if merge_scale:
            if projections[np.argmax(np.abs(projections) > 1e-9)] < 0:
                projections = -projections
            keys.append((value.ndim, *np.round(projections, DIGITS - 2)))
        else:
            scale = float(f"{size:.{DIGITS}g}")
            keys.append((value.ndim, scale, *np.round(projections, DIGITS - 2)))
    return keys


def _classes(entries, weights):
    """Lists of entries whose values are proportional; what is nothing on the rows is in none."""
    classes = {}
    keys = fingerprints([entry.value for entry in entries], weights, merge_scale=True)
    for entry, key in zip(entries, keys, strict=True):
        if key is not None:
            classes.setdefault(key, []).append(entry)
    return classes.values()


def merge_proportional(entries, weights, preferred=()):
    """Keep the least complex of entries whose values are proportional; the rest become its ties.

    Parameters
    ----------
    preferred : collection of Entry
        Kept before others of their class whatever the complexity; the array of their values
        stays the same object.
    """
    preferred = {id(entry) for entry in preferred}
    out = []
    for members in _classes(entries, weights):
        members.sort(key=lambda e: (id(e) not in preferred, e.complexity, e.levels))
        lead = members[0]
        if len(members) > 1:
            lead = replace(lead, ties=list(lead.ties))
            for other in members[1:]:
                _remember(lead, other)
        out.append(lead)
    return out


def distinct_directions(directions, conditions, masses, weights):
    """Directions x conditions as vectors per unit force, proportional ones merged.

    Parameters
    ----------
    directions, conditions : list of Entry
        Conditions may hold None for "always".
    masses : ndarray, shape (P,)
        1 / mass of the receiver, 0 where unknown.
    """
    combined = []
    for condition in conditions:
        for direction in directions:
            value = direction.value * masses[:, None]
            complexity = direction.complexity
            if condition is not None:
                value = value * condition.value[:, None]
                complexity += condition.complexity
            combined.append(
                Directed(direction.formula, condition and condition.formula, value, complexity)
            )
    out = []
    for members in _classes(combined, weights):
        members.sort(key=lambda item: item.complexity)
        out.append(replace(members[0], ties=tuple(members[1:])))
    return out


@dataclass(frozen=True, eq=False)
class Directed:
    """A direction, where its condition holds, per unit force: acceleration vectors (P, d)."""

    direction: object
    condition: object
    value: np.ndarray
    complexity: float
    ties: tuple = ()
