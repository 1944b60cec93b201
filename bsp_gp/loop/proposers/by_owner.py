"""Laws with a constant of each scene or body: a spin, a wind, a roughness that nobody noted."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, factors, quotient
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.laws import SAME, declared_directions, is_along
from bsp_gp.loop.proposers.varying import columns_by, owners
from bsp_gp.physics.force import Term, fresh_name, split_linear

FEWEST = 3
"""Scenes, or bodies, of which numbers of their own are no mere pair."""
SIZES = np.geomspace(1e-3, 1e3, 49)
"""Spreads of the numbers that are tried, in their typical standard error."""


class ByOwner:
    """Laws of textbooks, and the leading ones of a grammar, each with a constant of its owner.

    Parameters
    ----------
    laws : Laws
        Asked before in every round.
    """

    name = "by_owner"
    is_alone = False

    def __init__(self, laws):
        self.laws = laws

    def propose(self, view):
        """The family of all such laws."""
        null, found, best, n_tried = np.zeros(view.moment_draws.shape[1]), [], 0.0, 0
        promised, least = view.promised, view.criteria.noise_nats
        forms = forms_of(self.laws, view)
        declared = declared_directions(view)
        for by, ties in owners(view, FEWEST).items():
            for rest, cost in _bare_forms(forms, view, by).items():
                try:
                    keys, columns = columns_by(view, Term(rest), {}, by)
                except EvaluationError:  # some body lacks a property that it names
                    continue
                if not np.isfinite(columns).all():
                    continue
                if is_along(columns.sum(axis=1), declared):
                    continue  # another number of a declared term for each, see `Varying`
                score = view.score_forces(columns)
                if score.rank < FEWEST:
                    continue
                n_tried += 1
                null = np.maximum(null, as_pair(view.null_forces(columns), score.rank))
                best = max(best, float(as_pair(score.statistic, score.rank)))
                height = evidence_of(view, columns)
                together = evidence_of(view, columns.sum(axis=1, keepdims=True))
                promised = max(promised, together - view.criteria.cause_nats)
                if height - together > least:
                    own = _proposal(view, rest, by, keys, score, height, ties, cost)
                    _add(found, score.statistic, own)
        # Where some law with one number for all does as well, no other is asked for.
        proposals = [p for _, p in found if p.promise > promised - least]
        proposals.sort(key=lambda p: -p.promise)
        return Family(self.name, tuple(proposals), best, 2, null, n_tried=n_tried)


def forms_of(laws, view, more=()):
    """Formulas without constants of their own that the law has not yet.

    Parameters
    ----------
    laws : Laws
        Asked before in this round.
    more : sequence of Formula
        Forms beside those of textbooks and the leading ones of the search.
    """
    known = [split_linear(term.formula)[1] for term in view.fit.law.terms]
    common = [split_linear(f)[1] for f in (*more, *laws.common)]
    forms = dict.fromkeys((*common, *view.leading))
    return [f for f in forms if not f.constants and f not in known]


def _bare_forms(forms, view, by):
    """Forms without what is one number for each owner, and what they cost beforehand, nats.

    The owner's constant takes that up: of a spin that is told once in every scene no power shows.
    """
    fixed, out = _fixed_inputs(view.dataset.scenes, by), {}
    for form in forms:
        above, below = ([f for f in part if not _is_of(f, fixed)] for part in factors(form))
        bare = quotient(above, below)
        cost = view.leading.get(form, view.criteria.cause_nats)
        out[bare] = min(cost, out.get(bare, cost))
    return out


def _fixed_inputs(scenes, by):
    """Names of measured numbers that are one within a scene, or along all tracks of a body."""
    values = {}
    for scene in scenes:
        for name, rows in scene.inputs.items():
            for k, body in enumerate(scene.names if rows.ndim == 2 else ()):
                seen = rows[:, k][np.isfinite(rows[:, k])]
                owner = scene.name if by == "scene" else body
                values.setdefault(name, {}).setdefault(owner, set()).update(np.unique(seen))
    return {n for n, own in values.items() if all(len(seen) < 2 for seen in own.values())}


def _is_of(factor, names):
    """Whether a factor is a function of these inputs alone."""
    return bool(factor.inputs) and set(factor.inputs) <= names


def _add(found, statistic, proposal):
    """Keep a proposal; a constant of a body takes up its mass, and laws that differ by it tie."""
    for k, (other, twin) in enumerate(found):
        if twin.code == proposal.code and abs(other - statistic) <= SAME * other:
            found[k] = other, replace(twin, ties=(*twin.ties, proposal.text, *proposal.ties))
            return
    found.append((statistic, proposal))


def evidence_of(view, columns):
    """Log-evidence of independent normal numbers before columns beside none, nats."""
    basis, sizes, _ = np.linalg.svd(view.beside(columns), full_matrices=False)
    squares, sizes = np.square(basis.T @ view.left), np.square(sizes)
    share = np.square(SIZES)[:, None] * sizes / sizes.mean()
    heights = 0.5 * (squares * share / (1 + share) - np.log1p(share)).sum(axis=1)
    return float(np.logaddexp.reduce(heights) - np.log(len(SIZES)))


def _proposal(view, rest, by, keys, score, height, ties, cost):
    name = f"{fresh_name(view.fit.law)}[{by}]"
    formula = Call("mul", Constant(name), rest)
    table = {key: float(value) for key, value in zip(keys, score.amplitudes, strict=True)}
    return Proposal(
        f"law_by_{by}", to_text(formula), with_term(view.hypothesis, Term(formula), {name: table}),
        -cost - view.criteria.cause_nats, 2 * height, score.rank, is_wide=True,
        formulas=(formula,), n_dims=view.dataset.n_dims,
        ties=tuple(to_text(formula).replace(f"[{by}]", f"[{other}]") for other in ties),
    )  # fmt: skip
