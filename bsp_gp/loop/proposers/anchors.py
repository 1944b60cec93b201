"""Where bodies are held, if not as was typed: an origin that is off, a length that is not right.

A body that stays as far from one point, and not from another, tells where it is held whatever moves
it. Forces that are missing as well would hide that, or stand in for it.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.fitting.parts.constraints import freed_of, left_by, read_constraint
from bsp_gp.fitting.tangent import columns_beside
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.loop.proposers.rods import beside_probes
from bsp_gp.loop.proposers.steady import CONSTANT, deviation
from bsp_gp.loop.view import gains
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.force import fresh_names
from bsp_gp.threads import one_thread

CLEAR = 100.0
"""Chi-squared of distances alone from which they tell where a body is held."""
NEAR = 20.0
"""Of the same, within which the constraint with fewest names is as good as any."""


class Anchors:
    """Numbers that were typed in constraints, freed, as a proposer."""

    name = "anchors"
    asks_rows = True

    def propose(self, view):
        """The family of all constraints that have such numbers."""
        law, tried = view.fit.law, []
        for part in constraints_of(law):
            told = _nearest(view.dataset, part, law)
            if told is None:
                continue
            freed, typed, _ = told
            frame = tuple(freed if p is part else p for p in law.frame)
            with one_thread(), np.errstate(all="ignore"):
                columns = columns_beside(view.fit, frame, typed)
            score = view.tangent.score(columns)
            if score.rank:
                by_chance = gains(view.tangent.projected(columns), view.row_draws)
                tried.append((_proposal(view, part, told, score), by_chance))
        if not tried:
            return Family(self.name)
        best, null = max(tried, key=lambda pair: pair[0].gain)
        return Family(
            self.name, tuple(p for p, _ in tried), best.gain, best.rank, null, n_tried=len(tried)
        )


def _nearest(dataset, part, law):
    """The freed constraint that the rows keep to, what was typed, and the level of their noise.

    The level is 0 where rows by themselves do not tell it apart from the one that was typed. None
    where no number was typed.
    """
    names = fresh_names(law, [f"pivot_{axis}" for axis in "xyz"[: dataset.n_dims]] + ["L"])
    *point, length = names.values()
    found = freed_of(dataset, part, point, length)
    if not found:
        return None
    left = [left_by(dataset, freed) for freed, _ in found]
    spread, level = deviation(dict(enumerate(left[-1])))
    before = left_by(dataset, read_constraint(dataset, part.text, part.pairs))
    size, *sizes = (float(np.square(np.concatenate(rows)).sum()) for rows in (before, *left))
    limit = min(sizes) + NEAR * level**2
    freed, typed = next(f for f, mine in zip(found, sizes, strict=True) if mine <= limit)
    is_told = size - min(sizes) > CLEAR * level**2 and spread <= CONSTANT * level
    return freed, typed, level if is_told else 0.0


def _proposal(view, part, told, score):
    """The freed constraint; judged beside forces that know no physics where rows alone tell it."""
    freed, typed, level = told
    code, kind = ("origin", "measurement") if len(typed) > 1 else ("length", "constraint")
    hypothesis = _with(view.hypothesis, part, freed)
    more = {}
    if level and np.isfinite(np.array(view.fit.noise.levels)).all():
        judged = beside_probes(view.fit, hypothesis)
        more = {"judged": judged, "error": level, "is_sole": judged is not None}
    return Proposal(
        code, freed.text, hypothesis, -view.criteria.cause_nats, score.statistic, score.rank,
        kind=kind, is_afresh=True, patience=PATIENT, **more,
    )  # fmt: skip


def _with(hypothesis, part, other):
    """The hypothesis with another constraint in the place of one."""
    parts = []
    for own in hypothesis.parts:
        if own is part:
            own = other
        elif isinstance(own, Forces) and part in own.law.frame:
            frame = tuple(other if p is part else p for p in own.law.frame)
            starts = {p.name: p.start for p in other.parameters}
            law = replace(own.law, frame=frame, constants={**own.law.constants, **starts})
            own = replace(own, law=law)
        parts.append(own)
    return Hypothesis(tuple(parts))
