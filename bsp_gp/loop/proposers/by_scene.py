"""Laws whose constant is another in every scene: a spin, a charge, a wind that nobody noted."""

from __future__ import annotations

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.varying import MOST, columns_by
from bsp_gp.physics.force import Term, fresh_name, split_linear

__all__ = ["ByScene"]

FEWEST = 3
"""Scenes of which numbers of their own are no mere pair."""
SIZES = np.geomspace(1e-3, 1e3, 49)
"""Spreads of the numbers that are tried, in their typical standard error."""


class ByScene:
    """Laws of textbooks, and the leading ones of a grammar, each with a constant of its scene.

    Parameters
    ----------
    laws : Laws
        Asked before in every round.
    """

    name = "by_scene"

    def __init__(self, laws):
        self.laws = laws

    def propose(self, view):
        """The family of all such laws.

        Parameters
        ----------
        view : View
        """
        null, proposals, best, n_tried = np.zeros(view.moment_draws.shape[1]), [], 0.0, 0
        if not FEWEST <= len(view.dataset.scenes) <= MOST:
            return Family(self.name, null=null)
        promised, least = view.promised, view.criteria.noise_nats
        known = [split_linear(term.formula)[1] for term in view.fit.law.terms]
        forms = [*self.laws.common, *view.leading]
        forms = dict.fromkeys(split_linear(f)[1] for f in forms)
        for rest in (f for f in forms if not f.constants and f not in known):
            try:
                keys, columns = columns_by(view, Term(rest), {}, "scene")
            except EvaluationError:  # some body lacks a property that it names
                continue
            if not np.isfinite(columns).all():
                continue
            score = view.score_forces(columns)
            if score.rank < FEWEST:
                continue
            n_tried += 1
            null = np.maximum(null, as_pair(view.null_forces(columns), score.rank))
            best = max(best, float(as_pair(score.statistic, score.rank)))
            height = _evidence(view, columns)
            together = _evidence(view, columns.sum(axis=1, keepdims=True))
            promised = max(promised, together - view.criteria.cause_nats)
            if height - together > least:
                proposals.append(_proposal(view, rest, keys, score, height))
        # Where some law with one number for all does as well, no other is asked for.
        proposals = [p for p in proposals if p.promise > promised - least]
        proposals.sort(key=lambda p: -p.promise)
        return Family(self.name, tuple(proposals), best, 2, null, n_tried=n_tried)


def _evidence(view, columns):
    """Log-evidence of independent normal numbers before columns beside none, nats."""
    basis, sizes, _ = np.linalg.svd(view.beside(columns), full_matrices=False)
    squares, sizes = np.square(basis.T @ view.left), np.square(sizes)
    share = np.square(SIZES)[:, None] * sizes / sizes.mean()
    heights = 0.5 * (squares * share / (1 + share) - np.log1p(share)).sum(axis=1)
    return float(np.logaddexp.reduce(heights) - np.log(len(SIZES)))


def _proposal(view, rest, keys, score, height):
    name = f"{fresh_name(view.fit.law)}[scene]"
    formula = Call("mul", Constant(name), rest)
    table = {key: float(value) for key, value in zip(keys, score.amplitudes, strict=True)}
    return Proposal(
        "law_by_scene", to_text(formula), with_term(view.hypothesis, Term(formula), {name: table}),
        -view.criteria.cause_nats, 2 * height, score.rank, is_wide=True,
    )  # fmt: skip
