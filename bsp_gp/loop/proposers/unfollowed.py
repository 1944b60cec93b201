"""Laws beside one that no path follows: fitted from the data, as its own tracks tell nothing."""

import numpy as np

from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.formula import rename_constants, walk
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.kin import kin_of
from bsp_gp.physics.force import Term, fresh_names, split_linear


class Unfollowed:
    """Kin of the declared terms, or laws of textbooks where these have none, as a proposer.

    Where no minimum was reached, bodies would have to be where they are not long before the end,
    as moons that are led by one mass where one of them feels more. What is missing cannot be asked
    of such tracks: laws are tried one after the other.

    Parameters
    ----------
    laws : Laws
        Of a grammar, of which the common ones are taken.
    """

    name = "unfollowed"

    def __init__(self, laws):
        self.laws = laws

    def propose(self, view):
        """The family of all such laws; an empty one where the declared law was fitted."""
        if not view.is_lost:
            return Family(self.name)
        law, n_dims = view.hypothesis.law, view.dataset.n_dims
        known = {_key(term.formula, n_dims) for term in law.terms}
        formulas = _unlike(known, kin_of(law, n_dims), self.laws.kinds, n_dims)
        common = [f for f in self.laws.common if _may_act(f, view.fit.noise.levels)]
        formulas = formulas or _unlike(known, common, self.laws.kinds, n_dims)
        gain = float(np.nan_to_num(view.left @ view.left))
        return Family(
            self.name, tuple(_proposal(view, f, gain) for f in formulas.values()), gain, 1,
            np.zeros(1), n_tried=len(formulas),
        )  # fmt: skip


def _may_act(formula, levels):
    """Whether a law may push along an axis along which bodies move: one that has errors, (d,)."""
    still = {f"e_{axis}" for axis, level in zip("xyz", levels, strict=False)
             if not np.isfinite(level)}  # fmt: skip
    is_across = any(getattr(node, "operator", "") in ("perp", "cross") for node in walk(formula))
    return not formula.inputs & still and not (is_across and len(levels) - len(still) < 2)


def _unlike(known, formulas, kinds, n_dims):
    """Those that are not known, each once, by what they are."""
    found = {}
    for formula in formulas:
        if (key := _key(formula, n_dims)) not in known and Term(formula).kind in kinds:
            found.setdefault(key, formula)
    return found


def _key(formula, n_dims):
    """What a law is but for its strength."""
    return canonical_key(split_linear(formula)[1], n_dims)


def _proposal(view, formula, gain):
    law = view.hypothesis.law
    own = split_linear(formula)[0]
    names = fresh_names(law, [own])
    term = Term(rename_constants(formula, names))
    hypothesis = with_term(view.hypothesis, term, {})
    return Proposal(
        "law", to_text(term.formula), hypothesis, -view.criteria.cause_nats, gain, 1,
        formulas=(term.formula,), n_dims=view.dataset.n_dims, is_afresh=True,
    )  # fmt: skip
