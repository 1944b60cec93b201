"""Laws of a grammar: every one of them scored on the moments of the tracks."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import BspError, EvaluationError, SettingsError
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.response import RESOLVED
from bsp_gp.language.formula import Input, rename_constants, walk
from bsp_gp.language.grammar import PLACED
from bsp_gp.language.inputs import SHORT, property_of
from bsp_gp.language.operators import is_across_in
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.inside import inner_search
from bsp_gp.loop.proposers.kin import kin_of
from bsp_gp.loop.proposers.odd_tracks import without_odd_track
from bsp_gp.loop.proposers.priors import cost_of, drives
from bsp_gp.loop.proposers.sums import pairs_of, properties_of, sets_of
from bsp_gp.loop.proposers.varying import beside_unknown
from bsp_gp.loop.view import MOST_PAIRS, selected
from bsp_gp.physics.bodies import angles_of, dataset_types, input_types_of, signed_of
from bsp_gp.physics.force import ForceLaw, Term, fresh_names, split_linear
from bsp_gp.search.candidate import Candidate
from bsp_gp.search.choice import BUDGET, Searching, searches_for
from bsp_gp.search.inner import expanded

MOST_NEAR, MOST_TIES = 1000, 20
"""Laws that are kept beside the best, and that are named with each as equal to it."""
MOST_ANEW, CLEAR = 20, 1000.0
"""Draws of noise that are searched anew, and times below the level of chance where none is."""
MOST_LEADING = 12
"""Laws of which others ask whether their constants are another in every scene."""
MOST_SCORED_ANEW = 12
"""Laws of pairs that are scored on all data where a part was searched."""
MOST_SEEDS = 20
"""Laws from which a guided search sets out."""
WORDY = 0.02
"""Nats for every part of a formula: of laws that are about as likely the shortest is told."""
PARALLEL = 1e-6
"""A law whose moments are parallel to a declared term's to this part is that term, freed."""
SAME = 1e-9
"""Part of what is left by which laws that are one law may differ in what they explain."""


class Laws:
    """The laws of a grammar as a proposer.

    Parameters
    ----------
    dataset : Dataset
        Training scenes.
    max_levels : int
    exclude : sequence of str
        Inputs that laws may not use.
    search : str
        One of `bsp_gp.search.choice.SEARCHES`.
    budget : int
        Laws that a guided search may score.
    """

    name = "laws"
    asks_seconds, is_alone = True, False

    def __init__(
        self, grammar, dataset, max_levels=8, exclude=("t",), search="exhaustive", budget=BUDGET
    ):
        self.max_levels = max_levels
        types = dataset_types(dataset)
        columns = {property_of(n)[0]: t for n, t in types.items() if property_of(n)}
        scalars = [c for c, t in columns.items() if t.shape == "scalar"]
        self.available = set(types) - set(exclude) - _unknown_of_sources(dataset)
        inputs = input_types_of(dataset)
        self.logged = [Input(n, inputs[n]) for n in dataset.logged if n in self.available]
        grammar = grammar.for_properties(
            columns, inputs, angles_of(dataset), signed_of(dataset), dataset.logged
        )
        self.grammar, self.missing = grammar.masked(self.available, dataset.n_dims)
        beyond, _ = grammar.beyond.masked(self.available | {"t", *PLACED}, dataset.n_dims)
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
        searches = searches_for(search, self.grammar, self.kinds, max_levels)
        self.searching = Searching(searches, self.grammar, budget, self.missing, beyond)
        names = [SHORT.get(c, c) for c in scalars if c != "mass"]
        self.properties = names
        vectors = [c for c, t in columns.items() if t.shape == "vector"]
        measured = [name for name, t in inputs.items() if t.shape == "vector"]
        numbers = [name for name, t in inputs.items() if t.shape == "scalar"]
        lists = {"0": names, "vector": vectors, "measured": measured, "input": numbers}
        common = self.grammar.common
        if dataset.n_moving_axes > 1:
            common += self.grammar.common_of_planes
        logged = [law.replace("{vector}_i", "{measured}") for law in common]
        common = dict.fromkeys((*common, *logged))
        self.common = list(_read(common, lists, self.available, types, dataset))

    def propose(self, view):
        """The family of all laws."""
        target, _ = view.response.left()
        draws = view.moment_draws
        found, null, certificates, n_tried = self._searched(
            view, target, draws, self.searching.searches
        )
        if self.searching.is_guided:
            null = self._searched_anew(view, max((c.gain for c in found), default=0.0), null)
        best = max((c.gain for c in found), default=0.0)
        view.drawn = tuple(c for c in found if not c.constants)  # with constants inside
        found = [c for c in found if c.constants]
        declared = declared_directions(view)
        kin = [
            c
            for formula in kin_of(view.fit.law, view.dataset.n_dims, self.logged)
            if (c := _scored(view, formula)) is not None
        ]
        null = np.maximum(null, _null_of(view, kin, draws[:, : len(null)]))
        ranked = self._ranked(view, found, kin)
        freeing = {id(c) for c in ranked if _is_parallel(view, c, declared)}
        found = [c for c in ranked if id(c) not in freeing]
        usual = {*self.common, *(c.formula for c in kin)}
        # Beside another law a term's number may be another too: a balloon has drag and buoyancy.
        dearer = [
            replace(c, complexity=c.complexity + view.criteria.cause_nats)
            for c in ranked if id(c) in freeing and c.formula in self.common
        ]  # fmt: skip
        sets = pairs_of(view, [*found, *dearer], usual)
        if self.searching.is_exhaustive:
            sets = [*sets, *sets_of(view, self, found, declared)]
        proposals = [_proposal(view, (one,)) for one in found[:MOST_NEAR]]
        proposals = beside_unknown(view, proposals)
        common = [c for c in ranked if c.formula in self.common]
        proposals += [_proposal(view, *each) for each in sets]
        *odd, cut = without_odd_track(view, common, lambda formula: _column(view, formula))
        if cut:
            proposal = _proposal(view, *odd)
            hypothesis = proposal.hypothesis + Hypothesis((cut,))
            proposals.append(replace(proposal, hypothesis=hypothesis))
        view.leading = {}
        for one in found[:MOST_LEADING]:
            view.leading.setdefault(split_linear(one.formula)[1], one.complexity)
        if found:
            view.explained = found[0].gain
            view.promised = 0.5 * found[0].gain - found[0].complexity
        proposals.sort(key=lambda p: -p.promise)
        view.foremost = proposals[0].promise if proposals else -np.inf
        return Family(
            self.name, tuple(proposals), best, 1 if proposals else 0, null,
            "\n".join(certificates), n_tried=n_tried,
        )  # fmt: skip

    def _searched(self, view, target, draws, names):
        """Laws that searches find for a target; gains on noise, certificates, number tried."""
        found, null, certificates, n_tried = [], np.zeros(draws.shape[1]), [], 0
        columns = view.response.left()[1]
        guided = self.searching.is_guided
        inner = inner_search(view, self.grammar, draws) if guided else None
        inner = inner and inner.of_target(view.beside(target))
        for kind in self.kinds:
            is_part = kind == "pair" and view.n_pairs > MOST_PAIRS
            whole = view.response.regression, slice(None), view.beside
            regression, rows, beside = view.part(MOST_PAIRS / view.n_pairs) if is_part else whole
            own = inner.of_part(regression, rows, beside) if inner and is_part else inner
            sizes = np.square(beside(draws[rows])).sum(axis=0)
            for name in names:
                result, text = self.searching.run(
                    name, regression, kind, view.search_rng, target=target[rows],
                    nuisance=columns[rows] if columns.size else None, null=draws[rows],
                    max_ties=MOST_TIES, progress=view.tick, inner=own,
                    known=[c.formula for c in found if c.kind == kind][:MOST_SEEDS],
                )  # fmt: skip
                null = np.maximum(null, np.array(result.null_gains) * sizes)
                candidates = result.candidates
                if is_part:
                    text += (
                        f"\nof {view.n_pairs:,} pairs at all instants, more than {MOST_PAIRS:,}, "
                        f"those of {len(rows):,} moments were searched: the best were scored on all"
                    )
                    candidates = list(_scored_anew(view, candidates))
                found += candidates
                certificates.append(text)
                n_tried += result.n_evaluated
        return found, null, certificates, n_tried

    def _searched_anew(self, view, best, null):
        """Greatest gains on noise, searched for anew where that may change a verdict.

        A search that draws visits laws that suit the data; those that suit some noise it would
        have visited there. Far from the level on which a verdict depends that does not matter.
        """
        alpha = view.criteria.alpha
        if not alpha / CLEAR < selected(best, 1, null, view.noise_dof) <= alpha:
            return null
        names = [name for name in self.searching.searches if name != "exhaustive"]
        anew, nothing = null[:MOST_ANEW].copy(), np.zeros((len(view.left), 0))
        for k in range(len(anew)):
            found, *_ = self._searched(view, view.moment_draws[:, k], nothing, names)
            anew[k] = max([anew[k], *(c.gain for c in found)])
        return anew

    def _ranked(self, view, found, kin):
        """Candidates by their promise: common ones, and kin of the declared, are likelier."""
        own = _declared_properties(view.fit.law)
        common = [_scored(view, f) for f in self.common if Term(f).kind in self.kinds]
        common = [c for c in common if c is not None]
        common += [c for c in kin if not any(_are_one(c, k) for k in common)]
        others = []
        for candidate in found:
            twin = next((k for k, c in enumerate(common) if _are_one(c, candidate)), None)
            if twin is not None:
                ties = (*common[twin].ties, candidate.formula, *candidate.ties)
                common[twin] = replace(common[twin], ties=ties)
                continue
            if any(own) and candidate.kind == "pair":
                candidate = _like(candidate, own, view.criteria.cause_nats)
            wordy = WORDY * sum(1 for _ in walk(candidate.formula))
            others.append(replace(candidate, complexity=candidate.complexity + wordy))
        every = (
            replace(c, complexity=c.complexity + view.odd_of(c.formula, c.kind))
            for c in (*common, *others)
        )
        return sorted(every, key=lambda c: c.complexity - 0.5 * c.gain)


def _are_one(one, other):
    """Whether two laws are the same on these data."""
    return one.kind == other.kind and abs(one.gain - other.gain) <= SAME * one.total


def _null_of(view, found, draws):
    """Greatest gains of laws that were typed on draws of noise, (B,)."""
    null = np.zeros(draws.shape[1])
    noise = view.beside(draws)
    for candidate in found:
        row = view.beside(_column(view, candidate.formula)[:, None])[:, 0]
        null = np.maximum(null, np.square(row @ noise) / (row @ row))
    return null


def _like(candidate, own, nats):
    """A law written with the properties of the declared one where it is equal to that."""
    written = (candidate.formula, *candidate.ties)
    same = next((f for f in written if properties_of(f) == own), None)
    if same is None:
        return candidate
    return replace(
        candidate, formula=same, ties=tuple(f for f in written if f is not same),
        complexity=max(candidate.complexity - nats, nats),
    )  # fmt: skip


def _proposal(view, candidates, amounts=None, gain=None):
    """The proposal of one law, or of several at once."""
    hypothesis, law, formulas = view.hypothesis, view.fit.law, []
    cost = cost_of(candidates)
    for k, candidate in enumerate(candidates):
        # A kin of a declared term shares that term's other constants.
        is_own = candidate.constants or candidate.formula.constants
        names = fresh_names(law, [name for name in candidate.formula.constants if name in is_own])
        found = candidate.constants if amounts is None else dict.fromkeys(names, amounts[k])
        values = {new: float(found[old]) for old, new in names.items()}
        term = Term(rename_constants(candidate.formula, names), candidate.kind)
        hypothesis, law = with_term(hypothesis, term, values), law.plus(term, values)
        formulas.append(term.formula)
        if len(names) == 1 and drives(term.formula, *values.values()):
            cost += view.criteria.cause_nats
    gain = candidates[0].gain if gain is None else gain
    most = (1 - RESOLVED) * float(view.left @ view.left)
    return Proposal(
        "law", " + ".join(map(to_text, formulas)), hypothesis, -cost, min(gain, most),
        sum(len(formula.constants) for formula in formulas), formulas=tuple(formulas),
        ties=candidates[0].ties if len(candidates) == 1 else (), n_dims=view.dataset.n_dims,
    )  # fmt: skip


def _scored_anew(view, candidates):
    """The best candidates of a part of the data as all data have them.

    Those with constants inside have none of their own: these are fitted, see `Inside`.
    """
    for candidate in candidates[:MOST_SCORED_ANEW]:
        known = candidate.constants
        scored = _scored(view, candidate.formula, candidate) if known else candidate
        if scored is not None:
            yield scored


def _scored(view, formula, known=None):
    """A law that was typed, or is known of a part of the data, as a candidate.

    None where these data do not show it.
    """
    name, term = split_linear(formula)[0], Term(formula)
    try:
        column = _column(view, formula)
    except EvaluationError:  # some body lacks a property that it names
        return None
    size = np.linalg.norm(column)
    row = view.beside(column[:, None])[:, 0]
    length = float(row @ row)
    if not np.isfinite(size) or not length > PARALLEL * size**2:
        return None
    value, total = float(row @ view.left) / length, float(view.left @ view.left)
    gain = value**2 * length
    complexity = view.criteria.cause_nats if known is None else known.complexity
    return Candidate(
        formula, term.kind, {name: value}, 0.5 * (total - gain), complexity, gain, total,
        ties=() if known is None else known.ties,
    )  # fmt: skip


def _column(view, formula):
    """Moments of a law for each unit of its own constant; others are those of the view's law."""
    _, rest = split_linear(formula)
    if not rest.constants:
        return view.response.regression.column(Term(rest))[0][:, 0]
    known = {name: view.fit.law.constants[name] for name in rest.constants}
    return view.response.moments_of(ForceLaw((Term(rest),), known))


def _read(texts, lists, available, types, dataset):
    """Common laws of which the data have all inputs."""
    for text in (each for law in texts for each in expanded(law, lists)):
        try:
            formula = parse_formula(text, types, units=dataset.units)
        except BspError:  # it names what these data do not have
            continue
        if is_across_in(text, dataset.n_dims) and formula.inputs <= available:
            yield formula


def _declared_properties(law):
    """Property factors of the declared pair law, if there is one."""
    terms = [term for term in law.terms if term.is_declared and term.kind == "pair"]
    return properties_of(terms[0].formula) if len(terms) == 1 else ((), ())


def declared_directions(view):
    """Moments of declared terms without constants, at unit length."""
    terms = [t for t in view.fit.law.terms if t.is_declared and not t.formula.constants]
    found = [_unit(view.response.regression.column(term)[0][:, 0]) for term in terms]
    return [direction for direction in found if direction is not None]


def is_along(column, directions):
    """Whether moments of a law (n,) are those of a declared term with another number."""
    own = _unit(column) if directions else None
    return own is not None and any(1 - (own @ d) ** 2 < PARALLEL for d in directions)


def _unit(column):
    """Moments at unit length, whatever their size; None where they show nothing."""
    top = np.max(np.abs(column), initial=0.0)
    if not (np.isfinite(top) and top > 0):
        return None
    return column / top / np.linalg.norm(column / top)


def _is_parallel(view, candidate, declared):
    """Whether a law only changes the number of a declared term."""
    _, rest = split_linear(candidate.formula)
    if not declared or rest.constants:
        return False
    return is_along(view.response.regression.column(Term(rest, candidate.kind))[0][:, 0], declared)


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
