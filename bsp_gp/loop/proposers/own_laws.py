"""Laws of their own for each of a few bodies: one that hunts, one that flees, each as it does."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant
from bsp_gp.language.operators import is_across_in
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.by_owner import evidence_of, forms_of
from bsp_gp.loop.proposers.laws import SAME
from bsp_gp.loop.proposers.libraries import moving_axes
from bsp_gp.loop.proposers.varying import columns_by
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, fresh_names

FEWEST, MOST = 2, 4
"""Bodies that may each have laws of their own."""
MOST_FORMS = 4
"""Forms of all bodies together."""
SHARE = 0.05
"""Part of what is left that a form must take off: far from the tracks moments err by as much."""
LEAST = 1e-3
"""Part of a column that must be left beside others."""
FORMS = (
    *(f"norm(p_i - p_j)^{n} * normalize(p_i - p_j)" for n in (-3, -2, -1)),
    "norm(p_i - p_j) * normalize(p_i - p_j)", "normalize(p_i - p_j)",
    "perp(normalize(p_i - p_j))", "v_i - v_j", "v_j", "v_i", "norm(v_i) * v_i", "normalize(v_i)",
    "perp(v_i)",
)  # fmt: skip


class OwnLaws:
    """Sums of forms, every one with a strength for each body, chosen body by body.

    Parameters
    ----------
    laws : Laws
        Asked before in every round.
    """

    name = "own_laws"
    is_alone = False

    def __init__(self, laws):
        self.laws = laws

    def propose(self, view):
        """The family of the sum that suits each body best."""
        null = np.zeros(view.moment_draws.shape[1])
        names = {s.names[k] for s in view.dataset.scenes for k in s.dynamic}
        meet = any(len(s.dynamic) > 1 for s in view.dataset.scenes)
        if view.is_sky or not (meet and FEWEST <= len(names) <= MOST):
            return Family(self.name, null=null)
        forms, keys, columns = self._columns(view)
        if not forms:
            return Family(self.name, null=null)
        flat = np.moveaxis(columns, 2, 1).reshape(-1, columns.shape[1])
        unit, told = _unit(view.beside(flat.T), flat)
        null = as_pair(np.square(unit.T @ view.draws_left).max(axis=0), 1)
        best = float(as_pair(np.square(unit.T @ view.left).max(), 1))
        family = Family(self.name, (), best, 2 if told.any() else 0, null, n_tried=len(flat))
        # Which way goes at first what starts at rest is told by an axis alone, not by its velocity.
        even = [k for k, form in enumerate(forms) if set(form.inputs) <= {"e_x", "e_y", "e_z"}]
        for allowed in (range(len(forms)), even):
            own = _own(view, [forms[k] for k in allowed], keys, columns[list(allowed)])
            if own is not None:
                return replace(family, proposals=(own,))
        return family

    def _columns(self, view):
        """Forms, names of bodies, and moments of each form on each body, (F, n, B)."""
        types, n_dims = dataset_types(view.dataset), view.dataset.n_dims
        axes = [f"e_{'xyz'[axis]}" for axis in moving_axes(view)]
        texts = (*axes, *FORMS)
        own = [parse_formula(text, types) for text in texts if is_across_in(text, n_dims)]
        kept, keys, out = [], [], []
        for form in forms_of(self.laws, view, own):
            try:
                keys, columns = columns_by(view, Term(form), {}, "body")
            except EvaluationError:
                continue
            if np.isfinite(columns).all() and columns.any(axis=0).all():
                kept.append(form)
                out.append(columns)
        return kept, keys, np.array(out)


def _own(view, forms, keys, columns):
    """The sum that suits each body best, of (F, n, B); None where one for all does as well."""
    flat = np.moveaxis(columns, 2, 1).reshape(-1, columns.shape[1])
    chosen = sorted({k // len(keys) for k in _chosen(view, flat)}) if len(flat) else []
    if not chosen:
        return None
    own = columns[chosen].transpose(1, 0, 2).reshape(columns.shape[1], -1)
    score, height = view.score_forces(own), evidence_of(view, own)
    together = evidence_of(view, columns[chosen].sum(axis=2).T)
    if height - together <= view.criteria.noise_nats:
        return None
    return _proposal(view, [forms[k] for k in chosen], keys, score, height)


def _chosen(view, columns):
    """Which columns (C, n) are needed one beside the other, those that later ones replace aside."""
    left, rest, out = view.left, view.beside(columns.T), []
    # What chance gives the best of so many, and a cause more.
    needed = 2 * (np.log(len(columns)) + view.criteria.cause_nats)
    least = max(needed, SHARE * float(left @ left))
    for _ in range(MOST_FORMS):
        unit, _ = _unit(rest, columns)
        gains = np.square(left @ unit)
        # Laws that differ by what a constant of a body takes up are one: the first has no more.
        k = int(np.argmax(gains >= (1 - SAME) * gains.max()))
        if gains[k] < least:
            break
        out.append(k)
        left = left - unit[:, k] * (unit[:, k] @ left)
        rest = rest - np.outer(unit[:, k], unit[:, k] @ rest)
    while len(out) > 1:
        fewer = [[k for k in out if k != one] for one in out]
        gain, *others = (view.score_forces(columns[own].T).statistic for own in (out, *fewer))
        losses = [gain - other for other in others]
        if min(losses) > needed:
            break
        del out[int(np.argmin(losses))]
    return out


def _unit(rest, columns):
    """What is left of columns (n, C) in units, 0 where it is all but nothing; and where it is."""
    lengths = np.linalg.norm(rest, axis=0)
    told = lengths > LEAST * np.linalg.norm(columns, axis=1)
    return np.where(told, rest / np.where(told, lengths, 1.0), 0.0), told


def _proposal(view, forms, keys, score, height):
    hypothesis, formulas = view.hypothesis, []
    amplitudes = score.amplitudes.reshape(len(forms), len(keys))
    names = fresh_names(view.fit.law, range(len(forms)), "c").values()
    for stem, form, own in zip(names, forms, amplitudes, strict=True):
        name = f"{stem}[body]"
        formulas.append(Call("mul", Constant(name), form))
        table = dict(zip(keys, own.tolist(), strict=True))
        hypothesis = with_term(hypothesis, Term(formulas[-1]), {name: table})
    return Proposal(
        "law_by_body", " + ".join(map(to_text, formulas)), hypothesis,
        -len(forms) * view.criteria.cause_nats, 2 * height, score.rank, is_wide=True,
        formulas=tuple(formulas), n_dims=view.dataset.n_dims,
    )  # fmt: skip
