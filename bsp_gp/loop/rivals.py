"""How well other laws would do, told from the tracks of one that leaves nothing, or very little.

Far from the tracks promises are off by some per cent; of a hundred thousand nats that is more than
all that rivals differ by. Where one law was fitted and explains all, what it does is known at its
own tracks: the moments of its force, on which the columns of any other law are set anew.
"""

import math

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.response import respond
from bsp_gp.fitting.starts import EXPONENTS, roles_of
from bsp_gp.loop.proposers.varying import columns_by
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.search.columns import orthonormal

NEXT = 0.1
"""Change of a power over which moments are about linear in it."""
FREE = 5.0
"""Nats that a free power may gain where it is not asked for: on noise it gains half a nat, and
three standard deviations are 4.5."""
PARALLEL = 1e-9
"""Part of a law, squared, that may lie beside another for the two to be one on these data."""
INNER = 1e-4
"""Change of a number inside a form, as a part of it, over which moments are linear."""
DOUBT = 0.5
"""Part that is counted of what is told of a form with numbers inside, where they begin."""


class Explained:
    """What one law explains, at its own tracks.

    Parameters
    ----------
    row : Row
        Of the law.
    proposal : Proposal
        With its `formulas`.
    found : Fit
    dataset : Dataset
        Training scenes.
    left : float
        Reduced chi-squared that it leaves, of the noise by which moments are weighed.
    """

    def __init__(self, row, proposal, found, dataset, left=1.0):
        self.row, self.proposal, self._losses, self._included = row, proposal, {}, {}
        self.left, self._dof = left, max(found.n_rows - found.n_free, 1)
        self._is_estimated = bool(found.noise.is_free.any())
        self.dataset = proposal.hypothesis.seen(dataset)
        self.response = response = respond(found, self.dataset)
        target, columns = response.left()
        own = [term for term in found.law.terms if term.formula in proposal.formulas]
        names = {name for term in own for name in term.formula.constants}
        others = [k for k, (name, _) in enumerate(found.parameters) if name not in names]
        missing = target + response.moments_of(ForceLaw(tuple(own), found.law.constants))
        self._taken = orthonormal(columns[:, others], len(target))
        every = orthonormal(columns, len(target))
        self._missing = self._beside(missing)
        rest = target - every @ (every.T @ target)
        self._gain = float(self._missing @ self._missing - rest @ rest)

    def _beside(self, moments):
        return moments - self._taken @ (self._taken.T @ moments)

    def loss(self, proposal):
        """Nats of likelihood by which another law does worse; nan where that is not told.

        Noise that is estimated grows with what a law leaves.

        Parameters
        ----------
        proposal : Proposal
            Told are sums of forms that have a strength each, or one for each body or scene, and no
            numbers inside.
        """
        if proposal not in self._losses:
            self._losses[proposal] = self._weighed(self._loss(proposal))
        return self._losses[proposal]

    def _weighed(self, nats):
        """Nats under the noise that a law leaves, of those by which moments are weighed."""
        if self.left <= 1.0 or not self._is_estimated or not nats > 0:
            return nats
        return 0.5 * self._dof * math.log1p(2 * nats / (self._dof * self.left))

    def includes(self, proposal):
        """Whether a law is the one that leaves nothing, where a power in it is a whole number.

        And no other power near it does better, as far as moments tell.
        """
        if len(proposal.formulas) != 1 or len(self.proposal.formulas) != 1:
            return False
        if proposal not in self._included:
            self._included[proposal] = self._is_power_of_mine(proposal)
        return self._included[proposal]

    def _is_power_of_mine(self, proposal):
        (mine,) = self.proposal.formulas
        strength, form = split_linear(proposal.formulas[0])
        roles = roles_of(ForceLaw((Term(form),), dict.fromkeys(form.constants, 1.0)))
        if strength is None or len(roles) != 1 or set(roles.values()) != {"exponent"}:
            return False
        (name,) = roles
        own, mine = (split_linear(f)[1] for f in (proposal.formulas[0], mine))
        if mine.constants:
            return False
        wanted = self._unit(ForceLaw((Term(mine),), {}))

        def at(power):
            return self._unit(ForceLaw((Term(own),), {name: power}))

        same = [n for n in EXPONENTS if 1.0 - (wanted @ at(n)) ** 2 < PARALLEL]
        if not same:
            return False
        change = at(same[0] + NEXT) - at(same[0] - NEXT)
        if not np.isfinite(change).all():
            return False
        basis = orthonormal(self._beside(np.stack([wanted, change], axis=1)), len(wanted))
        gain = float(np.square(basis.T @ self._missing).sum())
        return 0.5 * (gain - self._gain) < FREE

    def _unit(self, law):
        """Moments of a law at unit length; nan where it is not finite."""
        try:
            moments = self.response.moments_of(law)
        except EvaluationError:
            return np.full(len(self._missing), np.nan)
        return moments / np.linalg.norm(moments)

    def _loss(self, proposal):
        if self.includes(proposal):
            return 0.0
        if _instruments(proposal) != _instruments(self.proposal):  # what is seen of forces differs
            return np.nan
        return self._nats(proposal, self._columns)

    def _nats(self, proposal, columns_of):
        """Nats by which the columns of the terms of another law take off less."""
        terms = [t for t in proposal.hypothesis.law.terms if t.formula in proposal.formulas]
        if not terms or len(terms) != len(proposal.formulas):
            return np.nan
        try:
            columns = [columns_of(term) for term in terms]
        except EvaluationError:
            return np.nan
        if any(column is None or not np.isfinite(column).all() for column in columns):
            return np.nan
        basis = orthonormal(self._beside(np.concatenate(columns, axis=1)), len(self._missing))
        gain = float(np.square(basis.T @ self._missing).sum())
        return 0.5 * (self._gain - gain)

    def _about(self, proposal):
        """Nats by which a law with numbers inside does worse, as far as these are linear.

        From where its fit would begin; part of that alone is counted.
        """
        values = {**proposal.hypothesis.law.constants, **proposal.starts}

        def columns(term):
            strength, form = split_linear(term.formula)
            if strength is None or strength.endswith("]"):
                return None
            known = {name: values.get(name, math.nan) for name in form.constants}
            if not all(isinstance(v, float) and math.isfinite(v) for v in known.values()):
                return None
            at = self.response.moments_of(ForceLaw((Term(form, term.kind),), known))
            found = [at]
            for name, value in known.items():
                step = INNER * (abs(value) or 1.0)
                moved = ForceLaw((Term(form, term.kind),), {**known, name: value + step})
                found.append((self.response.moments_of(moved) - at) / step)
            return np.stack(found, axis=1)

        nats = self._nats(proposal, columns)
        return DOUBT * self._weighed(nats) if nats > 0 else nats

    def _columns(self, term):
        """Moments of a term for each of its strengths, (n, c); None where more is free in it."""
        strength, form = split_linear(term.formula)
        if strength is None or form.constants:
            return None
        alone = Term(form, term.kind)
        for by in ("body", "scene"):
            if strength.endswith(f"[{by}]"):
                return columns_by(self, alone, {}, by)[1]
        return self.response.regression.column(alone)[0]

    def behind(self, proposal):
        """Nats by which it is behind, with what it costs beforehand and without, the lesser.

        nan where that is not told.
        """
        mine, theirs, nats = self.proposal, proposal, self.loss(proposal)
        if math.isnan(nats) and _instruments(mine) == _instruments(theirs):
            nats = self._about(proposal)
        height = nats + mine.volume - theirs.volume
        return height + min(mine.log_prior - theirs.log_prior, 0.0)


def _instruments(proposal):
    """How motion is seen by a hypothesis, a tuple of texts."""
    parts = proposal.hypothesis.parts
    return tuple(part.describe() for part in parts if part.kind == "instrument")
