"""Laws with a constant of each scene or body: a spin, a wind, a roughness that nobody noted."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, Formula, factors, quotient
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.laws import SAME, declared_directions, is_along
from bsp_gp.loop.proposers.libraries import SEPARATE
from bsp_gp.loop.proposers.priors import drives
from bsp_gp.loop.proposers.varying import columns_by, owners
from bsp_gp.physics.force import Term, fresh_name, fresh_names, split_linear
from bsp_gp.search.columns import orthonormal

FEWEST, LEAST = 3, 2
"""Scenes, or bodies, of which numbers of their own are no mere pair; beside a law for all."""
MOST_SHARED, MOST_OWNERS = 3, 12
"""Laws of one strength for all beside which one of a strength for each is asked for, and owners."""
SIZES = np.geomspace(1e-3, 1e6, 73)
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
        asked = []
        promised, least = view.promised, view.criteria.noise_nats
        forms = forms_of(self.laws, view)
        declared = declared_directions(view)
        for by, ties in owners(view, LEAST).items():
            for rest, cost in _bare_forms(forms, view, by).items():
                try:
                    keys, columns = columns_by(view, Term(rest), {}, by)
                except EvaluationError:  # some body lacks a property that it names
                    continue
                if not np.isfinite(columns).all():
                    continue
                if is_along(columns.sum(axis=1), declared):
                    continue  # another number of a declared term for each, see `Varying`
                if len(keys) < FEWEST:
                    if by == "body" and not ties and np.any(columns, axis=0).all():
                        together = evidence_of(view, columns.sum(axis=1, keepdims=True))
                        asked.append(_Asked(rest, by, keys, columns, cost, together))
                    continue
                score = view.score_forces(columns)
                if score.rank < FEWEST:
                    continue
                n_tried += 1
                null = np.maximum(null, as_pair(view.null_forces(columns), score.rank))
                best = max(best, float(as_pair(score.statistic, score.rank)))
                height = evidence_of(view, columns)
                together = evidence_of(view, columns.sum(axis=1, keepdims=True))
                promised = max(promised, together - view.criteria.cause_nats)
                asked.append(_Asked(rest, by, keys, columns, cost, together))
                if height - together > least:
                    own = _proposal(view, rest, by, keys, score, height, ties, cost)
                    _add(found, score.statistic, own)
        # Where some law with one number for all does as well, no other is asked for.
        proposals = [p for _, p in found] + list(_sums(view, asked, least))
        proposals = [p for p in proposals if p.promise > promised - least]
        proposals.sort(key=lambda p: -p.promise)
        if not n_tried:  # of a pair sums alone are asked, where others show that there is more
            return Family(self.name, tuple(proposals), n_tried=len(asked), is_led=True)
        return Family(self.name, tuple(proposals), best, 2, null, n_tried=n_tried)


@dataclass(frozen=True, eq=False)
class _Asked:
    """A form with a constant of each owner.

    `columns` (n, B) are its moments on each; `together` is the evidence of one number for all.
    """

    form: Formula
    by: str
    keys: list
    columns: np.ndarray
    cost: float
    together: float


def _sums(view, asked, least):
    """Laws of one strength for all and one of a strength for each owner: a weight, and drags.

    Of what acts on bodies alone. Such a sum is none of what noise alone is asked for, so that it
    cannot make it speak.
    """
    asked = [one for one in asked if not {"p_j", "v_j"} & set(one.form.inputs)]
    alike = {one.form: (one, one.columns.sum(axis=1, keepdims=True)) for one in asked}.values()
    # What drives a body along its way cannot set it off: a weight does, and looks the same.
    alike = [(one, column) for one, column in alike
             if not drives(one.form, float(view.beside(column)[:, 0] @ view.left))]  # fmt: skip
    for first, column in sorted(alike, key=lambda pair: -pair[0].together)[:MOST_SHARED]:
        beside = view.beside(column)
        taken = orthonormal(beside, len(column))
        for own in asked:
            if len(own.keys) > MOST_OWNERS:
                continue
            basis = orthonormal(view.beside(own.columns), len(column))
            rest = beside - basis @ (basis.T @ beside)
            if not np.linalg.norm(rest) > SEPARATE * np.linalg.norm(beside):
                continue  # numbers of the owners make it up
            height = evidence_of(view, own.columns, taken)
            if height - evidence_of(view, own.columns.sum(axis=1, keepdims=True), taken) > least:
                yield _sum(view, first, own, column, height)


def _sum(view, first, own, column, height):
    """A proposal of two laws, the second with a constant of each owner."""
    both = view.beside(np.concatenate([column, own.columns], axis=1))
    amounts = np.linalg.lstsq(both, view.left, rcond=1e-10)[0]
    one, other = fresh_names(view.fit.law, range(2), "c").values()
    other = f"{other}[{own.by}]"
    terms = Call("mul", Constant(one), first.form), Call("mul", Constant(other), own.form)
    table = dict(zip(own.keys, amounts[1:].tolist(), strict=True))
    hypothesis = with_term(view.hypothesis, Term(terms[0]), {one: float(amounts[0])})
    hypothesis = with_term(hypothesis, Term(terms[1]), {other: table})
    return Proposal(
        f"law_by_{own.by}", " + ".join(map(to_text, terms)), hypothesis,
        -own.cost - 2 * view.criteria.cause_nats, 2 * (first.together + height),
        len(amounts), is_wide=True, formulas=terms, n_dims=view.dataset.n_dims,
    )  # fmt: skip


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


def evidence_of(view, columns, taken=None):
    """Log-evidence of independent normal numbers before columns beside none, nats.

    Parameters
    ----------
    taken : ndarray, shape (n, k), optional
        Orthonormal columns that are in the law as well.
    """
    beside = view.beside(columns)
    if taken is not None:
        beside = beside - taken @ (taken.T @ beside)
    beside = beside / (np.abs(beside).max() or 1.0)  # squares of what is tiny would be nothing
    basis, sizes, _ = np.linalg.svd(beside, full_matrices=False)
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
