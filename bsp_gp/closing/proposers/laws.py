"""Laws of a grammar: every one of them scored on the moments of the tracks."""

from __future__ import annotations

import numpy as np

from bsp_gp.closing.proposal import Family, Proposal, with_term
from bsp_gp.errors import SettingsError
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.inputs import SHORT, property_of
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, fresh_name, split_linear
from bsp_gp.search.exhaustive import search_exhaustive

__all__ = ["Laws"]

MOST_NEAR, MOST_TIES = 1000, 20
"""Laws that are kept beside the best, and that are named with each as equal to it."""
MOST_PAIRED, MOST_PAIRS = 150, 40
"""Laws of which two at once are tried, and pairs that are proposed."""
LEAST_APART = 0.02
"""Part of a law, squared, that must lie beside another for the two to be told apart."""
PARALLEL = 1e-6
"""A law whose moments are parallel to a declared term's to this part is that term, freed."""


class Laws:
    """The laws of a grammar as a proposer.

    Parameters
    ----------
    grammar : Grammar
    dataset : Dataset
        Training scenes.
    max_levels : int
    exclude : sequence of str
        Inputs that laws may not use.
    """

    name = "laws"

    def __init__(self, grammar, dataset, max_levels=8, exclude=("t",)):
        self.max_levels = max_levels
        types = dataset_types(dataset)
        columns = {property_of(n)[0]: t for n, t in types.items() if property_of(n)}
        vectors = {c for c, t in columns.items() if t.shape == "vector"}
        scalars = {c: t.unit for c, t in columns.items() if t.shape == "scalar"}
        available = set(types) - set(exclude) - _unknown_of_sources(dataset)
        grammar = grammar.for_properties(scalars, vectors)
        self.grammar, self.missing = grammar.masked(available, dataset.n_dims)
        has_pairs = max(len(scene.entities) for scene in dataset.scenes) > 1
        if not has_pairs and "field" not in self.grammar.start:
            raise SettingsError(
                f"grammar {grammar.name} knows forces between bodies only, and no scene has two "
                "bodies; choose one with forces on each body, such as physics"
            )
        least = self.grammar.min_levels
        self.kinds = [
            kind for kind, start in self.grammar.start.items()
            if (kind == "field" or has_pairs) and least[start] <= max_levels
        ]  # fmt: skip

    def propose(self, view):
        """The family of all laws.

        Parameters
        ----------
        view : View
        """
        regression = view.response.regression
        target, columns = view.response.left()
        total = float(view.left @ view.left)
        found, null, certificates, n_tried = [], np.zeros(view.moment_draws.shape[1]), [], 0
        sizes = np.square(view.draws_left).sum(axis=0)
        for kind in self.kinds:
            result = search_exhaustive(
                regression, self.grammar, kind=kind, target=target,
                nuisance=columns if columns.size else None, max_levels=self.max_levels,
                missing_inputs=self.missing, null_targets=view.moment_draws,
                max_ties=MOST_TIES, progress=view.tick,
            )  # fmt: skip
            null = np.maximum(null, np.array(result.null_gains) * sizes)
            found += result.candidates
            certificates.append(result.certificate.text())
            n_tried += result.n_evaluated
        found.sort(key=lambda c: c.complexity - 0.5 * c.share * total)
        declared = self._declared(view)
        proposals = [
            self._proposal(view, candidate, total)
            for candidate in found[:MOST_NEAR]
            if not _is_parallel(view, candidate, declared)
        ]
        best = max((p.gain for p in proposals), default=0.0)
        pairs = _pairs(view, found[:MOST_PAIRED], proposals)
        proposals = sorted([*pairs, *proposals], key=lambda p: -p.promise)
        return Family(
            self.name, tuple(proposals), best, 1 if proposals else 0, null,
            "\n".join(certificates), n_tried,
        )  # fmt: skip

    def _declared(self, view):
        """Moments of declared terms without constants, at unit length."""
        terms = [
            term for term in view.fit.law.terms if term.is_declared and not term.formula.constants
        ]
        out = []
        for term in terms:
            column = view.response.regression.column(term)[0][:, 0]
            size = np.linalg.norm(column)
            if size > 0:
                out.append(column / size)
        return out

    def _proposal(self, view, candidate, total):
        law = view.fit.law
        old, _ = split_linear(candidate.formula)
        name = fresh_name(law)
        formula = rename_constants(candidate.formula, {old: name})
        value = float(candidate.constants[old])
        term = Term(formula, candidate.kind)
        return Proposal(
            "law", to_text(candidate.formula), with_term(view.hypothesis, term, {name: value}),
            -candidate.complexity, candidate.share * total, formula=formula, ties=candidate.ties,
            n_dims=view.dataset.n_dims,
        )  # fmt: skip


def _pairs(view, found, singles):
    """Two laws at once that promise more than any alone, the best few."""
    if len(found) < 2:
        return []
    terms = [Term(split_linear(c.formula)[1], c.kind) for c in found]
    columns = np.stack([view.response.regression.column(t)[0][:, 0] for t in terms], axis=1)
    rows = view.beside(columns)
    size = np.linalg.norm(rows, axis=0)
    unit = rows / np.where(size > 0, size, 1.0)
    scores, overlap = unit.T @ view.left, unit.T @ unit
    first, second = np.triu_indices(len(found), 1)
    cosine = overlap[first, second]
    apart = 1.0 - np.square(cosine)
    good = apart > LEAST_APART
    first, second, cosine, apart = first[good], second[good], cosine[good], apart[good]
    a, b = scores[first], scores[second]
    gains = (a * a + b * b - 2 * a * b * cosine) / apart
    prior = np.array([-c.complexity for c in found])
    promise = 0.5 * gains + prior[first] + prior[second]
    least = max((p.promise for p in singles), default=0.0)
    out = []
    for k in np.argsort(-promise)[:MOST_PAIRS]:
        if promise[k] <= least:
            break
        i, j = first[k], second[k]
        amounts = np.array([a[k] - b[k] * cosine[k], b[k] - a[k] * cosine[k]]) / apart[k]
        out.append(_both(view, found[i], found[j], amounts / size[[i, j]], gains[k], promise[k]))
    return out


def _both(view, one, other, amounts, gain, promise):
    """The proposal of two laws at once."""
    hypothesis, law, formulas = view.hypothesis, view.fit.law, []
    for candidate, amount in zip((one, other), amounts.tolist(), strict=True):
        name = fresh_name(law)
        old, _ = split_linear(candidate.formula)
        formula = rename_constants(candidate.formula, {old: name})
        term = Term(formula, candidate.kind)
        hypothesis, law = (
            with_term(hypothesis, term, {name: amount}),
            law.plus(term, {name: amount}),
        )
        formulas.append(formula)
    text = " + ".join(map(to_text, formulas))
    return Proposal("law", text, hypothesis, float(promise - 0.5 * gain), float(gain), 2)


def _is_parallel(view, candidate, declared):
    """Whether a law only changes the number of a declared term."""
    if not declared:
        return False
    _, rest = split_linear(candidate.formula)
    column = view.response.regression.column(Term(rest, candidate.kind))[0][:, 0]
    size = np.linalg.norm(column)
    return size > 0 and any(1 - (column @ d / size) ** 2 < PARALLEL for d in declared)


def _unknown_of_sources(dataset):
    """Properties that some source lacks: a law for all bodies cannot name them as ``_j``."""
    out = set()
    for column in dataset.property_names:
        for scene in dataset.scenes:
            sources = (
                scene.entities
                if len(scene.dynamic) > 1
                else tuple(e for k, e in enumerate(scene.entities) if k not in scene.dynamic)
            )
            if any(not _is_known(e, column) for e in sources):
                out |= {f"{column}_j", f"{SHORT.get(column, column)}_j"}
    return out


def _is_known(entity, column):
    if column == "radius":
        return np.isfinite(entity.radius)
    return bool(np.all(np.isfinite(entity.properties.get(column, np.nan))))
