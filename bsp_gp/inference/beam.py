"""The profile beam: laws compared after their latents and constants were refitted jointly.

A posterior can only repair a law that contains the latent, so a share of the places is reserved
for laws that do: at drawn values of the latents a law without them may lead by chance.
"""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.inference.profile import Profile, fit_profile
from bsp_gp.inference.separation import coefficient, depends_on, separate
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import ForceLaw, Term

CHANGES = 1e-6
"""Relative change of the pull on a body, between draws, above which a law contains a latent."""
HOPELESS = 200.0
"""Factor on the best loss above which a fit is not finished."""
PER_COMPLEXITY, SIMPLE = 2, 14.0
"""Places for every unit of complexity, up to so many nats."""
EXACT = 1e-9
"""Losses below this are those of a law that fits exactly."""
POLISHED = 3
"""Leaders that are refitted from more starts."""


@dataclass(frozen=True, eq=False)
class Contender:
    """A law after its joint refit.

    Attributes
    ----------
    law : ForceLaw
        With refitted constants.
    formula : Formula
        The found term.
    ties : tuple of Formula
        Laws equal on the data whatever the latents.
    complexity : float
        nats.
    cost : float
        loss + beta * complexity.
    """

    law: ForceLaw
    formula: object
    ties: tuple
    complexity: float
    profile: Profile = field(repr=False)
    cost: float
    has_latent: bool

    @property
    def loss(self):
        return self.profile.loss

    @property
    def text(self):
        return to_text(self.formula)


class Beam:
    """Keeps joint refits of laws on fixed scenes; asking again costs nothing.

    Parameters
    ----------
    scenes, latents, likelihood
        As in `bsp_gp.inference.e_step.infer`.
    n_best, n_reserved : int
        Places for the best laws of an M-step, and more for laws that contain a latent.
    beta : float
        Weight of the complexity, nats per nat.
    base : ForceLaw, optional
        Terms that are there already; their constants are refitted too.
    """

    def __init__(
        self, scenes, latents, likelihood, *, n_best=15, n_reserved=40, beta=1e-6, base=None
    ):
        self.scenes = tuple(scenes)
        self.latents = latents
        self.likelihood = likelihood
        self.n_best = n_best
        self.n_reserved = n_reserved
        self.beta = beta
        self.base = base or ForceLaw()
        self.bank = likelihood.bank(self.scenes)
        self.contenders = {}
        self.n_failed = 0
        self._has_latent = {}
        self._polished = set()

    def choose(self, candidates):
        """The candidates that get a place.

        The best; then the best that contain a latent; and the best few of every unit of
        complexity of each kind, since a simple law may need its latents to be right before it
        shows.
        """
        ordered = sorted(candidates, key=lambda c: c.loss + self.beta * c.complexity)
        chosen = ordered[: self.n_best]
        rest = [c for c in ordered[self.n_best :] if self.contains(c.formula, c.kind)]
        simple, counts = [], {}
        for candidate in ordered:
            level = (candidate.kind, int(candidate.complexity))
            counts[level] = counts.get(level, 0) + 1
            if counts[level] <= PER_COMPLEXITY and candidate.complexity <= SIMPLE:
                simple.append(candidate)
        chosen += rest[: self.n_reserved] + simple
        out = {(c.formula, c.kind): c for c in chosen}
        return list(out.values())

    def contains(self, formula, kind):
        """Whether accelerations under a law depend on a latent; kept."""
        key = (formula, kind)
        if key not in self._has_latent:
            term = Term(formula, kind)
            self._has_latent[key] = contains_latent(term, self.latents.columns)
        return self._has_latent[key]

    def refit(self, candidates, starts, *, rng):
        """Refit candidates that have not been refitted before, and polish the leaders.

        Parameters
        ----------
        starts : ndarray, shape (B, k)
            Values of the latents.

        Returns
        -------
        list of Contender
            All so far, lowest cost first.
        """
        for candidate in candidates:
            key = (candidate.formula, candidate.kind)
            if key not in self.contenders:
                self._add(candidate, key, starts)
        leaders = self.ranked()[:POLISHED]
        more = self.latents.sample(2 * max(len(starts), 4), rng=rng)
        for leader in leaders:
            self._polish(leader, more)
        return self.ranked()

    def ranked(self):
        """All contenders, lowest cost first."""
        return sorted(self.contenders.values(), key=lambda c: (c.cost, c.complexity, c.text))

    def law_of(self, candidate):
        """The base law plus the candidate's term, its constants renamed where names clash."""
        values = {
            name: value if not hasattr(value, "items") else float(np.mean(list(value.values())))
            for name, value in candidate.constants.items()
        }
        taken = set(self.base.names)
        free = (f"c{k}" for k in itertools.count(1) if f"c{k}" not in taken)
        names = {n: n if n not in taken else next(free) for n in candidate.formula.constants}
        term = Term(rename_constants(candidate.formula, names), candidate.kind)
        return self.base.plus(term, {names[n]: values.get(n, 1.0) for n in names})

    def _add(self, candidate, key, starts):
        law = self.law_of(candidate)
        try:
            misfit = self.likelihood.misfit(law, self.latents, self.scenes, self.bank)
        except EvaluationError:
            self.n_failed += 1
            return
        best = min((c.loss for c in self.contenders.values()), default=np.inf)
        profile = fit_profile(misfit, starts, give_up=HOPELESS * (best + 1.0))
        if not np.isfinite(profile.loss):
            self.n_failed += 1
            return
        self.contenders[key] = Contender(
            profile.law, candidate.formula, tuple(candidate.ties), candidate.complexity, profile,
            profile.loss + self.beta * candidate.complexity,
            self.contains(candidate.formula, candidate.kind),
        )  # fmt: skip

    def _polish(self, contender, starts):
        key = (contender.formula, contender.law.terms[-1].kind)
        if contender.loss < EXACT or key in self._polished:
            return
        self._polished.add(key)
        misfit = self.likelihood.misfit(contender.law, self.latents, self.scenes, self.bank)
        again = fit_profile(misfit, np.concatenate([contender.profile.values[None], starts]))
        if again.loss < contender.loss:
            self.contenders[key] = replace(
                contender,
                law=again.law,
                profile=again,
                cost=again.loss + self.beta * contender.complexity,
            )


def contains_latent(term, columns):
    """Whether the acceleration that a term gives depends on one of these properties.

    Masses cancel: ``m_i m_j`` pulls with m_j. The property factor is tried with random numbers in
    the place of every property, known ones fixed, and once more with new ones for the unknown.
    """
    separated = separate(term, columns)
    if separated is None:
        return depends_on(term.acceleration_formula, columns) or (
            term.needs_mass and "mass" in columns
        )
    rng = np.random.default_rng(20211)
    known = {}

    def lookup_with(stream):
        fresh = {}

        def lookup(name):
            column, role = property_of(name)
            if column in columns:
                return fresh.setdefault((column, role), stream.uniform(1, 2, (1, 1, 8, 1)))
            return known.setdefault((column, role), rng.uniform(1, 2, (1, 1, 8, 1)))

        return lookup

    first, second = (
        np.broadcast_to(
            coefficient(separated, lookup_with(np.random.default_rng(seed))), (1, 1, 8, 1)
        )
        for seed in (1, 2)
    )
    return bool(np.max(np.abs(first - second)) > CHANGES * np.max(np.abs(first)))
