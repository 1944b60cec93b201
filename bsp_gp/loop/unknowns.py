"""The loop with unknown properties: inferred under the model, and again after every change of it.

Properties of training scenes are fitted to these together with the constants of the model; those
of bodies that only held-out scenes show, to the first rows of these scenes, which do not count.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from bsp_gp.data.split import choose_split
from bsp_gp.errors import EvaluationError
from bsp_gp.inference.beam import contains_latent
from bsp_gp.inference.e_step import EStep, infer
from bsp_gp.inference.em import CLASS_NATS, EmSettings, fit_em
from bsp_gp.inference.findings import CONTRADICTED
from bsp_gp.inference.identifiability import identifiability
from bsp_gp.inference.latents import Latents
from bsp_gp.inference.m_step import Exhaustive
from bsp_gp.inference.problem import latent_problem, stand_ins
from bsp_gp.inference.profile import fit_profile
from bsp_gp.language.inputs import property_of
from bsp_gp.physics.bodies import dataset_types

__all__ = ["close_with_unknowns"]

MOST_PASSES = 3
MOVED = 0.5
"""Shift of an unknown, in posterior standard deviations, after which the loop runs again."""
HEAD = 12
"""First rows of a held-out scene that its own unknowns may be fitted to, a third at most."""


def close_with_unknowns(dataset, declared, close, read_law, *, rng, progress, **settings):
    """Run the loop with the properties that ``[latent.*]`` declares unknown.

    Parameters
    ----------
    dataset : Dataset
        With latents; recorded values of theirs are not used.
    declared : ForceLaw or sequence of str
    close : callable
        ``close(dataset, law, rng=..., progress=..., **settings) -> LoopReport`` for known values.
    read_law : callable
        ``read_law(dataset, texts) -> ForceLaw``.
    rng : numpy.random.Generator
    progress : callable

    Returns
    -------
    LoopReport
        Its notes give the posterior of every unknown, and what the data do not determine.
    """
    split_rng, fit_rng, post_rng, *pass_rngs = rng.spawn(3 + MOST_PASSES)
    progress("unknown properties under the declared model")
    problem = latent_problem(dataset, rng=split_rng, everything=True, test=False)
    latents = problem.latents
    known = replace(problem.dataset, latents=())
    law = declared if hasattr(declared, "terms") else read_law(known, declared)
    train, test, _ = choose_split(known, split_rng)
    if {s.name for s in train}.isdisjoint(s.name for s in test) and not known.train:
        known = replace(known, train=tuple(s.name for s in train), test=tuple(s.name for s in test))
    state = _Unknowns(latents, problem.likelihood, train, test, settings["max_levels"])
    state.start(law, known, settings.get("grammar", "physics"), fit_rng, progress)
    for stream in pass_rngs:
        loop_rng, start_rng = stream.spawn(2)
        filled = replace(known, scenes=latents.filled(known.scenes, state.values))
        # Values in held-out scenes come from their first rows: they are no test of a law.
        report = close(
            filled, law, rng=loop_rng, progress=progress, **{**settings, "ask_held_out": False}
        )
        if not any(r.adopted for r in report.rounds):
            break  # the law is the one that the values were inferred under
        progress("unknown properties under the found law")
        before, moved = state.values.copy(), 0.0
        if state.fit(report.law, start_rng):
            moved = float(np.max(np.abs(state.values - before) / state.sd))
        if moved < MOVED:
            break
    return replace(report, notes=(*report.notes, *state.notes(report.law, post_rng)))


class _Unknowns:
    """Current values of all unknowns of a data set."""

    def __init__(self, latents, likelihood, train, test, max_levels):
        self.latents = latents
        self.max_levels = max_levels
        self.likelihood = likelihood
        self.train = tuple(train)
        self.mine, self.index = latents.of_scenes([scene.name for scene in train])
        self.heads = tuple(
            scene.rows(0, max(min(HEAD, len(scene.times) // 3), 5)) for scene in test
        )
        self.values = np.array([float(item.prior.ppf(0.5)) for item in latents.items])
        self.sd = np.array([item.prior.spread for item in latents.items])
        self.profile = None

    def start(self, law, dataset, grammar, rng, progress):
        """First values.

        Under the declared law if it feels the unknowns and explains the data: a law that lacks
        something bends the unknowns to hide it, and what is missing is then not found. Otherwise
        by EM: the declared law and one term more, fitted together with the unknowns.
        """
        fit_rng, em_rng = rng.spawn(2)
        feels = any(contains_latent(term, self.latents.columns) for term in law.terms)
        if feels and self.fit(law, fit_rng) and not self._is_contradicted():
            return
        grammar = _masked(grammar, dataset)
        progress("unknown properties together with what may be missing")
        em = fit_em(
            self.train, self.mine, grammar, self.likelihood, rng=em_rng, base=law,
            kinds=[k for k in grammar.start if k != "pair" or self.likelihood.sources],
            settings=EmSettings.for_noise(
                self.likelihood, n_starts=2, max_iterations=2, refine=False, final=None
            ),
            m_step=Exhaustive(max_levels=self.max_levels), progress=progress,
        )  # fmt: skip
        if self.profile is None or em.best.loss < self.profile.loss - CLASS_NATS:
            self._take(em.best.profile)
            self._fit_heads(em.law, fit_rng)

    def _is_contradicted(self):
        free = max(self.profile.n_rows - len(self.mine), 1)
        return bool(chi2.logsf(self.profile.chisq, free) < np.log(CONTRADICTED))

    def fit(self, law, rng):
        """Refit under a law; False (and no change) where it has no finite value."""
        train_rng, head_rng = rng.spawn(2)
        try:
            misfit = self.likelihood.for_posterior.misfit(law, self.mine, self.train)
        except EvaluationError:
            return False
        starts = np.concatenate([self.values[self.index][None], self.mine.sample(7, rng=train_rng)])
        profile = fit_profile(misfit, starts)
        if not np.isfinite(profile.loss):
            return False
        self._take(profile)
        self._fit_heads(profile.law, head_rng)
        return True

    def _take(self, profile):
        self.profile = profile
        self.values[self.index] = profile.values
        k = len(self.mine)
        spread = np.array([item.prior.spread for item in self.mine.items])
        information = profile.information.copy()
        information[range(k), range(k)] += 1 / np.square(spread)
        covariance = np.linalg.pinv(information, hermitian=True)
        self.sd[self.index] = np.sqrt(np.maximum(np.diag(covariance)[:k], 1e-30))

    def _fit_heads(self, law, rng):
        """Unknowns that only held-out scenes show, from their first rows."""
        seen = set(self.index.tolist())
        for scene in self.heads:
            items, index = self.latents.of_scenes([scene.name])
            own = [k for k, place in enumerate(index) if place not in seen]
            if not own:
                continue
            fixed = [k for k in range(len(index)) if k not in own]
            (filled,) = Latents(tuple(items.items[k] for k in fixed)).filled(
                (scene,), self.values[index[fixed]]
            )
            mine = Latents(tuple(items.items[k] for k in own))
            posterior = infer(
                law, stand_ins([filled], mine), mine, self.likelihood.for_posterior, rng=rng,
                settings=EStep("laplace", max_steps=2000, n_eff=200),
            )  # fmt: skip
            self.values[index[own]] = posterior.mean

    def notes(self, law, rng):
        """Posterior of every unknown of the training scenes, and what is not determined."""
        posterior = infer(
            law, self.train, self.mine, self.likelihood.for_posterior, rng=rng,
            settings=EStep("laplace", max_steps=3000, n_eff=300),
        )  # fmt: skip
        low, high = posterior.interval().T
        for k, name in enumerate(posterior.names):
            yield (
                f"unknown {name} = {posterior.mean[k]:.4g} (90 %: {low[k]:.4g} to {high[k]:.4g}; "
                f"prior {posterior.priors[k].text()})"
            )
        if self.profile is not None:
            found = identifiability(self.profile, self.mine, posterior)
            for direction in found.directions:
                yield f"{direction.text}; {direction.remedy}"
        yield from posterior.notes


def _masked(grammar, dataset):
    """The grammar masked to a data set, as the loop masks it."""
    from bsp_gp.language.grammar import load_grammar

    if isinstance(grammar, str) or hasattr(grammar, "suffix"):
        grammar = load_grammar(grammar)
    types = dataset_types(dataset)
    columns = {property_of(n)[0]: t for n, t in types.items() if property_of(n)}
    vectors = {name for name, t in columns.items() if t.shape == "vector"}
    units = {name: t.unit for name, t in columns.items() if t.shape == "scalar"}
    types.pop("t", None)
    return grammar.for_properties(units, vectors).masked(types, dataset.n_dims)[0]
