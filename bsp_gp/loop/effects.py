"""Question 4: which law is it? Proposals from the search, refitted, named and ranked."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.language.inputs import SHORT, property_of
from bsp_gp.language.render import to_text
from bsp_gp.loop.leftover import Leftover
from bsp_gp.loop.significance import log_evidence, null_targets, p_value
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.search.exhaustive import MOST_TIES, law_pool, search_exhaustive

__all__ = ["CLASS_BIC", "EffectSearch", "Proposal", "Proposals", "allowed_sign", "sign_bounds"]

SHORTLIST = 6
TOP_K = 40


CLASS_BIC = 10.0
"""Laws whose BIC is higher by less than this are not ruled out: a wrong name is worse than two."""


SHORTLIST_NATS = 12.0
"""Proposals whose evidence is within this of the best are fitted jointly, to whole tracks."""


COLLINEAR = 1e-6
"""A term whose acceleration is parallel to a declared one to this part is that term, freed."""


@dataclass(frozen=True)
class Proposal:
    """A term that may be what is missing.

    Attributes
    ----------
    formula : Formula
        With the single free constant `constant`.
    kind : str
        "pair" or "field".
    constant : str
    per_entity : bool
        Whether every receiver has a constant of its own.
    complexity : float
    share : float
        Of the training residual's sum of squares that it explains.
    evidence : float
        Log-evidence on the regression, nats.
    ties : tuple of Formula
        Equal on these data.
    redoes_declared : bool
        Parallel to a declared term: the same as freeing its number.
    """

    formula: object
    kind: str
    constant: str
    per_entity: bool
    complexity: float
    share: float
    evidence: float
    ties: tuple = ()
    redoes_declared: bool = False

    def term(self):
        return Term(self.formula, self.kind)

    def text(self):
        return to_text(self.formula)


@dataclass(frozen=True)
class Proposals:
    """Outcome of one search for what is missing.

    Attributes
    ----------
    shortlist : tuple of Proposal
        Best evidence first.
    p_value : float
        On simulated residuals, the model's fit and the denoised states kept.
    certificates : tuple of str
    n_scored : int
    seconds : float
    null_evidence : float
        Greatest evidence on a simulated residual, nats.
    near : tuple of Proposal
        All that are not ruled out beside the best, likeliest first under the grammar's prior.
    """

    shortlist: tuple[Proposal, ...]
    p_value: float
    certificates: tuple[str, ...]
    n_scored: int
    seconds: float
    null_evidence: float = float("nan")
    near: tuple = ()


@dataclass(eq=False)
class EffectSearch:
    """The search for a missing term on one observation.

    Attributes
    ----------
    observation : Observation
    grammar : Grammar
        Unmasked; it is masked to the data here.
    max_levels, n_null : int
    per_entity : bool or "auto"
        Whether to try a constant of its own for every body. "auto": where every scene has one
        moving body and the same bodies occur in several scenes.
    exclude : collection of str
        Inputs that laws may not use.
    whole : EffectSearch, optional
        Of a search that was narrowed after a look at the same data: the search of the whole
        grammar, whose best on noise alone the p-value is about.
    """

    observation: object
    grammar: object
    max_levels: int = 8
    n_null: int = 299
    per_entity: object = "auto"
    exclude: tuple = ("t",)
    notes: list = field(default_factory=list)
    whole: object = None
    _pools: dict = field(default_factory=dict)

    def __post_init__(self):
        dataset = self.observation.dataset
        types = dataset_types(dataset)
        vectors = {
            property_of(n)[0] for n, t in types.items() if property_of(n) and t.shape == "vector"
        }
        columns = {
            property_of(n)[0]: t.unit
            for n, t in types.items()
            if property_of(n) and t.shape == "scalar"
        }
        grammar = self.grammar.for_properties(columns, vectors)
        available = set(types) - set(self.exclude) - self._unknown_inputs(dataset)
        self.masked, self.missing = grammar.masked(available, dataset.n_dims)
        self._leftover = Leftover(self.observation)
        self.pooled_scenes = _pooled(self.observation)
        self.kinds = [k for k in grammar.start if k == "field" or self.observation.sources]
        if self.per_entity == "auto":
            self.per_entity = self._entities_recur()

    def without_inputs(self, names):
        """The same search over the laws that name none of these inputs."""
        narrow = copy(self)
        narrow.masked = self.masked.without_inputs(names)
        least = narrow.masked.min_levels
        narrow.kinds = [k for k in self.kinds if least[narrow.masked.start[k]] < float("inf")]
        narrow.whole, narrow._pools = self, {}
        return narrow

    def usable_inputs(self):
        """Names of the inputs that laws may have, a set."""
        rules = self.masked.rules_of.values()
        return {name for rule in rules for r in rule for name in r.inputs}

    def _unknown_inputs(self, dataset):
        """Properties that some source lacks: a law for all bodies cannot name them as ``_j``."""
        sources = [e for scene in dataset.scenes for e in _sources_of(scene)]
        out = set()
        for column in dataset.property_names:
            lost = sorted({e.name for e in sources if not _is_known(e, column)})
            if lost:
                out |= {f"{column}_j", f"{SHORT.get(column, column)}_j"}
                self.notes.append(
                    f"laws with {column}_j were not searched: unknown for {', '.join(lost[:5])}"
                )
        return out

    def _entities_recur(self):
        scenes = (*self.observation.train, *self.observation.test)
        single = all(len(scene.dynamic) == 1 for scene in scenes)
        names = [scene.names[scene.dynamic[0]] for scene in scenes] if single else []
        test = (
            {scene.names[scene.dynamic[0]] for scene in self.observation.test} if single else set()
        )
        train = (
            {scene.names[scene.dynamic[0]] for scene in self.observation.train} if single else set()
        )
        return single and len(set(names)) >= 2 and bool(test & train)

    def on(self, observation):
        """The same search on another observation of the data set."""
        moved = copy(self)
        moved.observation = observation
        moved.pooled_scenes = _pooled(observation)
        moved._leftover = Leftover(observation)
        moved._pools = {}
        moved.whole = self.whole and self.whole.on(observation)
        return moved

    def propose(
        self, fit, rng, progress=None, *, along=None, n_null=None, top_k=TOP_K, max_ties=MOST_TIES
    ):
        """Search what the fitted model leaves.

        Parameters
        ----------
        fit : Fit
        rng : numpy.random.Generator
            For the simulated residuals of the significance test.
        along : Fit, optional
            Evaluate laws at the states of this fit in the place of the model's own: those of the
            best attempt so far lie nearer to the truth.
        n_null : int, optional
            Simulated residuals, by default the search's; 0 = no p-value (nan).
        top_k : int
            Laws kept per unit of complexity, and overall.
        max_ties : int, optional
            Laws named beside each of them, being equal to it on these data.

        Returns
        -------
        Proposals
        """
        n_null = self.n_null if n_null is None else n_null
        self._leftover = Leftover(self.observation, along or fit)
        if self.whole is None or not n_null:
            outcomes = reference = self._outcomes(fit, rng, n_null, top_k, max_ties, progress)
        else:
            # The choice of channels has looked at the data: noise may choose among all laws.
            self.whole._leftover = self._leftover
            reference = self.whole._outcomes(fit, rng, n_null, 1, 0, progress)
            outcomes = self._outcomes(fit, rng, 0, top_k, max_ties, progress)
        return self._collect(outcomes, reference, fit.law)

    def _outcomes(self, fit, rng, n_null, top_k, max_ties, progress):
        """Results of all searches: (result, whether constants are per entity, number, rows)."""
        regression = self._regression(self.pooled_scenes)
        outcomes = []
        null_rng, own_rng = rng.spawn(2)
        residual, jacobian = self._leftover.residual(regression, fit.law)
        null = null_targets(regression, null_rng, n_null)
        for kind in self.kinds:
            result = search_exhaustive(
                regression,
                self.masked,
                kind=kind,
                target=residual,
                nuisance=jacobian,
                max_levels=self.max_levels,
                missing_inputs=self.missing,
                null_targets=null,
                top_k=top_k,
                max_ties=max_ties,
                progress=progress,
            )
            outcomes.append((result, False, 1, regression))
        if self.per_entity and "field" in self.kinds:
            outcomes.append(self._own_constants(fit, own_rng, n_null, top_k, max_ties, progress))
        return outcomes

    def left(self, fit, proposal=None):
        """What a fitted law leaves, to be explained by its own constants and a proposal's.

        Parameters
        ----------
        fit : Fit
        proposal : Proposal, optional

        Returns
        -------
        regression : Regression
        residual : ndarray, shape (n,)
            Whitened.
        columns : ndarray, shape (n, k)
            Of the law's constants, then of the proposal's.
        """
        leftover = Leftover(self.observation, fit)
        own = proposal is not None and proposal.per_entity
        scenes = [_with_unit_masses(s) for s in self.observation.train] if own else None
        regression = leftover.regression(scenes or self.pooled_scenes)
        residual, columns = leftover.residual(regression, fit.law)
        if proposal is not None:
            rest = split_linear(proposal.formula)[1]
            more = regression.column(Term(rest, proposal.kind), per_entity=own)[0]
            columns = np.column_stack([columns, more])
        return regression, residual, columns

    def pool(self, kind, wanted):
        """All laws of a kind with one of the wanted property factors, as columns (kept)."""
        key = (kind, wanted)
        if key not in self._pools:
            self._pools[key] = law_pool(
                self.observation.train_regression,
                self.masked,
                kind=kind,
                is_left=wanted.__contains__,
                max_levels=self.max_levels,
            )
        return self._pools[key]

    def _own_constants(self, fit, rng, n_null, top_k, max_ties, progress):
        """The field search with a constant per receiver; properties cannot matter there."""
        grammar = self.masked.without_inputs(
            {n for n in self.masked.inputs if property_of(n)} - {"m_i"}
        )
        scenes = [_with_unit_masses(s) for s in self.observation.train]
        regression = self._regression(scenes)
        residual, jacobian = self._leftover.residual(regression, fit.law)
        groups = [column != 0 for column in self._groups(regression)]
        result = search_exhaustive(
            regression,
            grammar.without_inputs({"m_i"}),
            kind="field",
            target=residual,
            nuisance=jacobian,
            max_levels=self.max_levels,
            missing_inputs=self.missing,
            groups=groups,
            null_targets=null_targets(regression, rng, n_null),
            top_k=top_k,
            max_ties=max_ties,
            progress=progress,
        )
        return result, True, len(groups), regression

    def _groups(self, regression):
        columns = []
        for name in regression.receiver_names():
            parts = []
            for batch in regression.batches:
                mine = np.array([[n == name for n in row] for row in batch.bodies.receiver_names])
                parts.append(np.broadcast_to(mine[..., None], batch.target.shape).ravel())
            columns.append(np.concatenate(parts))
        return columns

    def _regression(self, scenes):
        return self._leftover.regression(scenes)

    def _collect(self, outcomes, reference, law):
        observed, proposals = [], []
        for result, own, n_constants, regression in outcomes:
            n = regression.n_rows
            for candidate in result.candidates:
                proposals.append(self._proposal(candidate, own, n_constants, n))
            best = result.best.share if result.best else 0.0
            observed.append(log_evidence(best, n, n_constants))
        null = [
            log_evidence(np.array(result.null_gains), regression.n_rows, n_constants)
            for result, _, n_constants, regression in reference
        ]
        proposals = self._flag_declared(proposals, law, outcomes[0][3])
        proposals.sort(key=lambda p: (-p.evidence, p.complexity))
        return Proposals(
            tuple(_shortlist(proposals, self.observation.is_exact)),
            p_value(observed, null) if len(null[0]) else float("nan"),
            tuple(r.certificate.text() for r, *_ in outcomes),
            sum(r.n_evaluated for r, *_ in outcomes),
            sum(r.seconds for r, *_ in outcomes),
            float(np.max(null)) if len(null[0]) else float("nan"),
            _near(proposals),
        )

    def _proposal(self, candidate, own, n_constants, n_rows):
        name, _ = split_linear(candidate.formula)
        return Proposal(
            candidate.formula,
            candidate.kind,
            name,
            own,
            candidate.complexity,
            candidate.share,
            float(log_evidence(candidate.share, n_rows, n_constants)),
            candidate.ties,
        )

    def _flag_declared(self, proposals, law, regression):
        """Mark proposals that only change the number of a declared term."""
        declared = []
        for term in law.terms:
            if term.is_declared and not term.formula.constants:
                column = _unit(regression.column(term)[0][:, 0])
                if column.any():
                    declared.append(column)
        if not declared:
            return proposals
        out = []
        for proposal in proposals:
            rest = split_linear(proposal.formula)[1]
            column = _unit(regression.column(Term(rest, proposal.kind))[0][:, 0])
            parallel = any(1 - (column @ d) ** 2 < COLLINEAR for d in declared)
            out.append(replace(proposal, redoes_declared=bool(parallel)))
        return out


def _unit(column):
    """A column at unit length, whatever its size; zeros stay zeros."""
    top = np.max(np.abs(column), initial=0.0)
    return column / top / np.linalg.norm(column / top) if top > 0 else column


def _near(proposals):
    """Proposals not ruled out beside the best, by evidence or as simpler, likeliest first."""
    able = [p for p in proposals if not p.redoes_declared]
    nats = CLASS_BIC / 2
    near = [
        p
        for p in able
        if p.evidence - able[0].evidence + nats >= min(p.complexity - able[0].complexity, 0)
    ]
    return tuple(sorted(near, key=lambda p: p.complexity - p.evidence))


def _shortlist(proposals, is_exact):
    """The best by evidence and the simplest of those near it; at least two.

    On exact data near means within a tenth of the sum of squares left: what remains there is
    misfit, and evidence in nats says nothing of it.
    """
    able = [p for p in proposals if not p.redoes_declared]
    if not able:
        return proposals[:2]
    best = able[0]
    if is_exact:
        near = [p for p in able if 1 - p.share <= 1.1 * (1 - best.share) + 1e-12]
    else:
        near = [p for p in able if p.evidence >= best.evidence - SHORTLIST_NATS]
    simple = sorted(near, key=lambda p: p.complexity)[: SHORTLIST // 2]
    out = near[: SHORTLIST - SHORTLIST // 2]
    out += [p for p in simple if p not in out]
    out = out if len(out) > 1 else able[:2]
    freed = [p for p in proposals if p.redoes_declared and p.evidence >= best.evidence]
    return out + sorted(freed, key=lambda p: p.complexity)[:1]


def _sources_of(scene):
    """Entities that act on some receiver: all of them if several move, else the others."""
    if len(scene.dynamic) > 1:
        return scene.entities
    return tuple(e for k, e in enumerate(scene.entities) if k not in scene.dynamic)


def _is_known(entity, column):
    if column == "radius":
        return np.isfinite(entity.radius)
    return bool(np.all(np.isfinite(entity.properties.get(column, np.nan))))


def _pooled(observation):
    """The training scenes for laws of all bodies."""
    return [s for s in map(_without_unknown_masses, observation.train) if s]


def _without_unknown_masses(scene):
    """The scene with bodies of unknown mass as sources only; None if nothing is left to move."""
    entities = tuple(
        replace(e, is_static=True) if not e.is_static and not np.isfinite(e.mass) else e
        for e in scene.entities
    )
    scene = replace(scene, entities=entities)
    return scene if len(scene.dynamic) else None


def _with_unit_masses(scene):
    return replace(
        scene,
        entities=tuple(
            e if e.is_static else replace(e, properties={**e.properties, "mass": 1.0})
            for e in scene.entities
        ),
    )


def sign_bounds(observation, law):
    """Intervals of the constants of all found terms, for which none pushes forward.

    Returns
    -------
    dict of str to (float, float)
        Only constants that are bounded on a side.
    """
    kept = observation.__dict__.setdefault("_bounds", {})
    out = {}
    for term in law.terms:
        name, rest = split_linear(term.formula)
        if term.is_declared or name is None or rest.constants:
            continue
        if term.formula not in kept:
            kept[term.formula] = allowed_sign(observation, term)
        if kept[term.formula] != (-np.inf, np.inf):
            out[name] = kept[term.formula]
    return out


def allowed_sign(observation, proposal):
    """Interval of the constant for which the term does not push forward.

    A term that is parallel to the velocity of its receiver wherever it acts can only brake: a
    friction or drag that drives a body on is the sign of another cause.

    Parameters
    ----------
    observation : Observation
    proposal : Proposal or Term
        Anything with a `formula` (linear in one constant) and a `kind`.

    Returns
    -------
    (low, high) : tuple of float
        (-inf, inf) for terms that are not parallel to the velocity throughout.
    """
    rest = split_linear(proposal.formula)[1]
    term = Term(rest, proposal.kind)
    along, size = [], []
    for batch in observation.train_regression.batches:
        value = observation.train_regression.predict(batch, _bare(term))
        velocity = batch.velocities[:, :, batch.bodies.receivers]
        mask = batch.valid.any(axis=-1)
        along.append(np.einsum("...d,...d->...", value, velocity)[mask])
        size.append((np.linalg.norm(value, axis=-1) * np.linalg.norm(velocity, axis=-1))[mask])
    along, size = np.concatenate(along), np.concatenate(size)
    total = float(size.sum())
    # Noise turns the measured velocity of a body at rest about, so not every row has to agree.
    if total > 0 and np.abs(along).sum() > 0.999 * total and abs(along.sum()) > 0.99 * total:
        return (-np.inf, 0.0) if along.sum() > 0 else (0.0, np.inf)
    return -np.inf, np.inf


def _bare(term):
    from bsp_gp.physics.force import ForceLaw

    return ForceLaw((term,), {})
