"""A medium that moves: a declared drag acts against a wind or a current, not against what rests.

Where all forces depend on velocities alone a camera that drifts looks the same, and is told too.
"""

from __future__ import annotations

import numpy as np

from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, Input, factors, substitute
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.physics.force import ForceLaw, Term, fresh_name

__all__ = ["Winds"]

_VELOCITY = Input("v_i", STATE_INPUTS["v_i"])
_AXES = "xyz"


class Winds:
    """The velocity of the medium, as constants in all declared drags, as a proposer."""

    name = "winds"

    def propose(self, view):
        """The one cause, where drag was declared.

        Parameters
        ----------
        view : View
        """
        law, n_dims = view.fit.law, view.dataset.n_dims
        drags = [(k, t) for k, t in view.single_terms if t.is_declared and _is_drag(t.formula)]
        if not drags:
            return Family(self.name)
        names, wind = [], None
        for axis in _AXES[:n_dims]:
            names.append(fresh_name(law, f"wind_{axis}"))
            part = Call("mul", Constant(names[-1]), Input(f"e_{axis}", STATE_INPUTS[f"e_{axis}"]))
            wind = part if wind is None else Call("add", wind, part)
        against = {_VELOCITY: Call("sub", _VELOCITY, wind)}
        blown = [(k, Term(substitute(t.formula, against), t.kind)) for k, t in drags]
        columns = self._columns(view, [term for _, term in blown], names)
        score = view.score_forces(columns)
        null = as_pair(view.null_forces(columns), max(score.rank, 1))
        if not score.rank:
            return Family(self.name, (), 0.0, 2, null, n_tried=1)
        hypothesis = view.hypothesis
        for k, term in blown:
            hypothesis = with_term_at(hypothesis, k, term.formula, dict.fromkeys(names, 0.0))
        starts = dict(zip(names, map(float, score.amplitudes), strict=True))
        proposal = Proposal(
            "wind", f"the medium moves: v_i - ({to_text(wind)}) for v_i in drag",
            hypothesis, -view.criteria.cause_nats, score.statistic, score.rank, starts=starts,
        )  # fmt: skip
        gain = float(as_pair(score.statistic, score.rank))
        return Family(self.name, (proposal,), gain, 2, null, n_tried=1)

    @staticmethod
    def _columns(view, terms, names):
        """Moments of what the terms change by each component of a weak wind, (n, d)."""
        columns = 0.0
        for term in terms:
            known = {n: view.fit.law.constants.get(n, 0.0) for n in term.formula.constants}
            slopes = view.response.regression.gradient(ForceLaw((term,), known), term)
            columns = columns + np.stack([slopes[name] for name in names], axis=1)
        return columns


def _is_drag(formula):
    """Whether a term brakes the more the faster a body is; friction of constant size does not."""
    above, below = factors(formula)
    if below or "v_j" in formula.inputs:
        return False
    sizes = [part for part in above if "v_i" in part.inputs]
    return _VELOCITY in sizes or any(part.type.shape == "scalar" for part in sizes)
