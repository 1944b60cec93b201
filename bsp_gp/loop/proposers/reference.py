"""Places that count from a body which the others pull, as a proposer: heliocentric tables."""

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.parts.reference import Reference, pulls_on_origin
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.physics.force import ForceLaw


class References:
    """The acceleration of the body from which places count, by the declared pulls."""

    name = "reference"

    def propose(self, view):
        """The family of that one cause, which has no free number."""
        null = np.zeros(view.moment_draws.shape[1])
        is_known = any(isinstance(part, Reference) for part in view.hypothesis.parts)
        terms = tuple(t for term in view.fit.law.terms for t in pulls_on_origin(term))
        if is_known or not view.reference or not terms:
            return Family(self.name, null=null)
        names = {name for term in terms for name in term.formula.constants}
        values = {name: view.fit.law.constants[name] for name in names}
        try:
            column = view.beside(view.response.moments_of(ForceLaw(terms, values))[:, None])[:, 0]
        except EvaluationError:
            return Family(self.name, null=null)
        size = float(column @ column)
        gain = 2.0 * float(column @ view.left) - size
        null = np.maximum(2.0 * (column @ view.draws_left) - size, 0.0)
        # Whoever is pulled by others pulls them: that is no more than the declared law says.
        proposal = Proposal(
            "reference", view.reference, view.hypothesis + Reference(ForceLaw(terms, {})), 0.0,
            gain, 1, is_first=True, formulas=tuple(t.formula for t in terms),
            n_dims=view.dataset.n_dims,
        )  # fmt: skip
        return Family(self.name, (proposal,), max(gain, 0.0), 1, null, n_tried=1)
