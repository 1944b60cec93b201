"""The M-step: laws proposed by any search on a regression averaged over posterior draws."""

from dataclasses import dataclass

import numpy as np

from bsp_gp.physics.regression import stack_draws
from bsp_gp.search.constants import linear_columns
from bsp_gp.search.exhaustive import search_exhaustive


def averaged_regression(scenes, latents, draws, weights, likelihood):
    """One regression whose loss is the expected loss over draws of the latents.

    Parameters
    ----------
    draws : ndarray, shape (S, k)
    weights : ndarray, shape (S,)
    """
    plain = likelihood.for_search
    regressions = [plain.regression(latents.filled(scenes, draw)) for draw in draws]
    return stack_draws(regressions, weights)


@dataclass(frozen=True)
class Exhaustive:
    """Every distinct law up to a bound is scored: the M-step that cannot miss.

    Attributes
    ----------
    top_k : int
        Laws kept for every unit of complexity.
    """

    max_levels: int = 8
    top_k: int = 40

    def candidates(self, regression, grammar, kinds, base, rng):
        """Candidates of all kinds, lowest loss first, and how many laws were scored."""
        target, nuisance = _given(regression, base)
        out, scored = [], 0
        for kind in kinds:
            result = search_exhaustive(
                regression, grammar, kind=kind, max_levels=self.max_levels, top_k=self.top_k,
                target=target, nuisance=nuisance,
            )  # fmt: skip
            out += result.candidates
            scored += result.n_evaluated
        return sorted(out, key=lambda c: c.loss), scored


def _given(regression, base):
    """Target and nuisance columns for searches beside terms that are there already."""
    if base is None or not base.terms:
        return None, None
    linear = linear_columns(regression, base)
    if linear is None:
        return regression.residual(base), None
    fixed, matrix, _ = linear
    return regression.target() - fixed, matrix if np.size(matrix) else None
