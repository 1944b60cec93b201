"""Closing the loop: rounds of finding what is missing, until nothing is, or it cannot be named."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.guide import check_guide
from bsp_gp.loop.memory import with_memory
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.pruning import prune
from bsp_gp.loop.rounds import run_round
from bsp_gp.loop.seeing import with_scenes
from bsp_gp.loop.writing_up import corrections, write_up
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.masses import check_properties

__all__ = ["close_loop", "declared_law"]


def declared_law(dataset, texts):
    """Read declared laws; LawError names the text that is wrong.

    Parameters
    ----------
    dataset : Dataset
    texts : sequence of str
        One force each, e.g. ``"9.81 [m/s^2] * m_i * down"``. Named constants are fitted.

    Returns
    -------
    ForceLaw
        Constants at 1 until they are fitted.
    """
    law = read_law(dataset, texts)
    return law.with_constants(dict.fromkeys(law.names, 1.0))


def close_loop(
    dataset,
    declared=(),
    *,
    rng,
    grammar="physics",
    alpha=0.01,
    max_rounds=5,
    max_levels=8,
    n_null=299,
    n_bootstrap=None,
    per_entity="auto",
    exclude=("t",),
    guide="order",
    ask_held_out=True,
    seed=None,
    workers=None,
    progress=None,
):
    """Find what a declared model lacks, add it, and report the error before and after.

    Parameters
    ----------
    dataset : Dataset
        Properties that it declares latent are inferred under the model, and again under the
        law that is found; their recorded values, if any, are not used.
    declared : ForceLaw or sequence of str
        The model that is believed: typed laws. Empty: no force at all.
    rng : numpy.random.Generator
        Splits, simulated residuals, resampling.
    grammar : str or Grammar
        What may be missing: a name, a path, or a grammar.
    alpha : float
        Level of the tests, 0 to 1.
    max_rounds : int
    max_levels : int
        Bound of the search, in levels of a derivation.
    n_null : int
        Simulated residuals behind the p-value; at least 1 / alpha - 1.
    n_bootstrap : int
        Data sets that are simulated and searched at most to test a finding that is not far beyond
        those residuals; 0 = none, else at least 1 / alpha - 1. By default 99, or 1 / alpha.
    per_entity : bool or "auto"
        Whether an effect may have a constant of its own for every body.
    exclude : sequence of str
        Inputs that the search may not use (by default time).
    guide : str
        What the trace of the residual does for the search: "order" (laws of the leading channels
        stand first among equals), "restrict" (only they are searched), or "off".
    ask_held_out : bool
        Whether the held-out tracks are asked as well before nothing is called missing; if they
        alone lack something, and the split was not declared, it is turned round. Not where what is
        known of their bodies was inferred from their first rows.
    seed : int, optional
        Recorded in the report.
    workers : concurrent.futures.Executor, optional
        For fitting proposals; the answer does not depend on it.
    progress : callable, optional
        ``progress(text)`` at every stage.

    Returns
    -------
    LoopReport

    Raises
    ------
    BspError
        If the data, the law or a setting is unusable.
    """
    started = time.perf_counter()
    progress = progress or (lambda text: None)
    if n_bootstrap is None:
        n_bootstrap = max(99, round(1 / alpha)) if 0 < alpha < 1 else 0
    _check(alpha, max_rounds, n_null, n_bootstrap, max_levels)
    check_guide(guide)
    declared = (declared,) if isinstance(declared, str) else declared
    if dataset.latents:
        from bsp_gp.loop.unknowns import close_with_unknowns

        return close_with_unknowns(
            dataset, declared, close_loop, declared_law, rng=rng, progress=progress,
            grammar=grammar, alpha=alpha, max_rounds=max_rounds, max_levels=max_levels,
            n_null=n_null, n_bootstrap=n_bootstrap, per_entity=per_entity, exclude=exclude,
            guide=guide, seed=seed, workers=workers,
        )  # fmt: skip
    law = declared if isinstance(declared, ForceLaw) else declared_law(dataset, declared)
    grammar = (
        load_grammar(grammar) if isinstance(grammar, str) or hasattr(grammar, "suffix") else grammar
    )
    if not isinstance(rng, np.random.Generator):
        raise SettingsError(f"rng must be a numpy.random.Generator, got {type(rng).__name__}")
    unknown = sorted(set(exclude) - set(grammar.inputs) - {"t"})  # left out by default
    if unknown:
        raise SettingsError(
            f"exclude names {unknown}, which are no inputs of grammar {grammar.name}; "
            f"present are {', '.join(sorted(grammar.inputs))}"
        )
    sources = max(len(scene.entities) for scene in dataset.scenes) > 1 and (
        "pair" in grammar.start or any(term.kind == "pair" for term in law.terms)
    )
    split_rng, final_rng, *round_rngs = rng.spawn(2 + max_rounds)
    progress("reading the data set")
    observation = observe(dataset, law, split_rng, sources=sources)
    _check_masses(observation, law)
    search = EffectSearch(observation, grammar, max_levels, n_null, per_entity, tuple(exclude))
    if not search.kinds:
        raise SettingsError(
            f"grammar {grammar.name} knows forces between bodies only, and no scene has two bodies"
        )
    first, model, search, rounds = _rounds(
        law, search, alpha, round_rngs, progress, workers, n_bootstrap, guide, ask_held_out
    )
    there = rounds[0].missing_held_out
    if there is not None and there.is_missing and not (dataset.train or dataset.test):
        progress("what is missing shows in the held-out scenes: learning from them")
        observation = _turned_round(observation, rounds[0].missing, there)
        search = search.on(observation)
        first, model, search, rounds = _rounds(
            law, search, alpha, rng.spawn(max_rounds), progress, workers, n_bootstrap, guide, False
        )
    progress("writing up")
    model, rounds = prune(search.observation, model, rounds, alpha)
    measured = _as_measured(observation, search.observation, rounds)
    if measured is not observation:  # the noise was found to have a memory
        is_same = not any(done.adopted for done in rounds)
        first = model if is_same else evaluate(measured, law)
    return write_up(
        search, measured, law, first, model, rounds, grammar, alpha, seed, final_rng, started
    )


def _rounds(law, search, alpha, rngs, progress, workers, n_bootstrap, guide, ask_held_out):
    """Rounds up to the first that adopts nothing: the declared model, the last, search, rounds."""
    progress("fitting the declared model")
    first = model = evaluate(search.observation, law)
    rounds = []
    for number, rng in enumerate(rngs, 1):
        done, model, search = run_round(
            number, model, search, alpha, rng, progress, workers, n_bootstrap, guide, ask_held_out
        )
        rounds.append(done)
        if not done.adopted:
            break
    return first, model, search, rounds


def _turned_round(observation, here, there):
    """The observation that learns from the scenes held out, and holds out the others.

    What was drawn to be held out is as good as what was drawn to be learned from, as long as one
    part is learned from and the other is not. On data that lack nothing this is come by with the
    probability alpha at most, in which at most so much is added to that of a false finding.
    """
    turned = with_scenes(observation, observation.test, observation.train)
    note = (
        f"the split was turned round: nothing is missing from the scenes that were drawn to be "
        f"learned from (p = {here.p_value:.3g}), and something from those that were held out "
        f"(p = {there.p_value:.3g}); these are learned from here, and the others held out"
    )
    return replace(turned, split_note=f"{observation.split_note}; {note}")


def _as_measured(observation, final, rounds):
    """The observation as measured, under the noise that was found in the end."""
    if not corrections(rounds):
        return final
    if final.memory == observation.memory:
        return observation
    factor = float(np.nanmean(np.array(final.noise.sigma) / np.array(observation.noise.sigma)))
    return with_memory(observation, final.memory, factor)


def _check(alpha, max_rounds, n_null, n_bootstrap, max_levels):
    if not 0 < alpha < 1:
        raise SettingsError(f"alpha must be between 0 and 1, got {alpha!r}")
    if max_rounds < 1:
        raise SettingsError(f"max_rounds must be at least 1, got {max_rounds!r}")
    if max_levels < 1:
        raise SettingsError(f"max_levels must be at least 1, got {max_levels!r}")
    if n_null < 1 / alpha - 1:
        raise SettingsError(
            f"n_null must be at least 1/alpha - 1 = {1 / alpha - 1:.0f} for a p-value to reach "
            f"alpha = {alpha:g}, got {n_null!r}"
        )
    if n_bootstrap and n_bootstrap < 1 / alpha - 1:
        raise SettingsError(
            f"n_bootstrap must be 0, or at least 1/alpha - 1 = {1 / alpha - 1:.0f} for a p-value "
            f"to reach alpha = {alpha:g}, got {n_bootstrap!r}"
        )


def _check_masses(observation, law):
    """A declared pooled term must be able to act on every body that moves."""
    check_properties(observation.train_regression.batches, law)
