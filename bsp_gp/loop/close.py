"""Closing the loop: rounds of finding what is missing, until nothing is, or it cannot be named."""

from __future__ import annotations

import hashlib
import time
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from bsp_gp.errors import LawError, SettingsError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.explanation import HIDDEN_BODY, MEASUREMENT
from bsp_gp.loop.guide import check_guide
from bsp_gp.loop.measurement import parted_by
from bsp_gp.loop.memory import with_memory
from bsp_gp.loop.outcome import VERDICTS, LoopReport, Overlay, ResidualTable
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.rounds import run_round
from bsp_gp.loop.telling import alike_numbers, constant_estimates
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.evaluation import unknown_receivers
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.units import FORCE, Unit

__all__ = ["close_loop", "declared_law"]

PACKAGES = ("bsp_gp", "numpy", "scipy", "pandas", "deap")


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
    types = dataset_types(dataset)
    terms = []
    for text in texts:
        formula = parse_formula(text, types, units=dataset.units)
        unit = formula.type.unit
        if unit is not None and unit != FORCE:
            raise LawError(
                f"law {text!r} has the unit {unit}, but a force has {FORCE}; "
                "give its number a unit, as in 9.81 [m/s^2]"
            )
        terms.append(Term(formula, is_declared=True))
    law = ForceLaw(tuple(terms), {})
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
    progress("fitting the declared model")
    first = model = evaluate(observation, law)
    rounds = []
    for number, round_rng in enumerate(round_rngs, 1):
        done, model, search = run_round(
            number, model, search, alpha, round_rng, progress, workers, n_bootstrap, guide
        )
        rounds.append(done)
        if not done.adopted:
            break
    progress("writing up")
    measured = _as_measured(observation, search.observation, rounds)
    if measured is not observation:  # the noise was found to have a memory
        is_same = not any(done.adopted for done in rounds)
        first = model if is_same else evaluate(measured, law)
    return _report(
        search, measured, law, first, model, rounds, grammar, alpha, seed, final_rng, started
    )


def _as_measured(observation, final, rounds):
    """The observation as measured, under the noise that was found in the end."""
    if not _corrections(rounds):
        return final
    if final.memory == observation.memory:
        return observation
    factor = float(np.nanmean(np.array(final.noise.sigma) / np.array(observation.noise.sigma)))
    return with_memory(observation, final.memory, factor)


def _corrections(rounds):
    """What was adopted and is no force between visible bodies."""
    return tuple(
        {"name": e.name, "kind": e.kind, "text": e.law, "constants": e.constants}
        for e in (r.effect for r in rounds if r.adopted)
        if e.kind in (HIDDEN_BODY, MEASUREMENT)
    )


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
    for batch in observation.train_regression.batches:
        mass = batch.bodies.column("mass")[:, batch.bodies.receivers]
        for term in law.terms:
            lost = unknown_receivers(term, batch.bodies) | (term.needs_mass & np.isnan(mass))
            if lost.any():
                s, r = np.argwhere(lost)[0]
                raise LawError(
                    f"declared law {to_text(term.formula)} needs a property of "
                    f"{batch.bodies.receiver_names[s][r]!r} that is unknown; give it in "
                    "entities.csv, or leave the body out"
                )


def _report(search, measured, law, first, model, rounds, grammar, alpha, seed, rng, started):
    observation = search.observation
    floor_rng, ratio_rng = rng.spawn(2)
    dataset = observation.dataset
    floor, copies = observation.floor(model.law, floor_rng)
    ratio = observation.ratio(first.rows, model.rows, ratio_rng, copies, first.law, model.law)
    verdicts = {r.verdict for r in rounds}
    verdict = next(v for v in VERDICTS if v in verdicts)
    if verdict == "nothing missing" and "seen, not adopted" in verdicts:
        verdict = "seen, not adopted"
    if any(r.adopted for r in rounds) and "effect adopted" not in verdicts:
        verdict = "cannot tell"  # all that was adopted has a rival that explains as much
    units = {c.name: c.unit for c in constant_estimates(observation, model.fit) if not c.entity}
    return LoopReport(
        dataset=_about(measured),
        declared=tuple(
            {"law": to_text(t.formula), "latex": to_latex(t.formula)} for t in law.terms
        ),
        grammar={"name": grammar.name, "fingerprint": grammar.fingerprint},
        seed=seed,
        alpha=alpha,
        noise={
            "sigma": [float(s) for s in observation.sigma],
            "unit": dataset.units.text(Unit.of(m=1)),
            "source": observation.noise.source,
            "method": observation.noise.method,
            "likelihood": observation.method,
            "sigma_used": [float(s) for s in observation.regression_sigma],
            "memory_s": observation.memory,
        },
        rounds=tuple(rounds),
        law=model.law,
        law_text=model.law.text(units=units),
        law_latex=model.law.latex(units=units),
        constants=constant_estimates(observation, model.fit),
        total={"before": first.errors, "after": model.errors, "floor": floor, "ratio": ratio},
        verdict=verdict,
        stop_reason=_stop_reason(rounds),
        versions=_versions(),
        wall_s=time.perf_counter() - started,
        overlays=tuple(_overlays(measured, observation, first.law, model.law)),
        residuals=_residual_table(measured, observation, first.law, model.law),
        corrections=_corrections(rounds),
        notes=(
            *_effective(rounds),
            *_corrected(rounds),
            *_one_and_the_same(observation, model.fit),
            *dataset.notes,
            observation.split_note,
            *_caveats(observation, search),
        ),
    )


def _effective(rounds):
    """A warning where something was adopted and more than noise is left all the same."""
    last = rounds[-1]
    if any(r.adopted for r in rounds) and last.missing.is_missing and not last.adopted:
        yield (
            "what was adopted is an effective law of these data: it still leaves "
            f"{last.missing.statistic:.3g} times the variance of the noise, so its form and its "
            "constants hold for this recording and are no discovery about nature"
        )


def _corrected(rounds):
    """What the errors after a correction are errors of."""
    for correction in _corrections(rounds):
        if correction["kind"] == MEASUREMENT:
            yield (
                f"the measurement was put right before laws were fitted and scored: "
                f"{correction['text']}"
            )


def _one_and_the_same(observation, fit):
    """Declared numbers that these data cannot tell from errors of the measurement."""
    for text, alike in alike_numbers(observation, fit).items():
        if alike:
            yield (
                f"{' and '.join(alike)} cannot be told from another number in {text}: under this "
                "law they do exactly the same to the tracks; "
                + parted_by(observation, fit, text, alike)
            )


def _stop_reason(rounds):
    last = rounds[-1]
    if last.adopted:
        return f"the limit of {len(rounds)} rounds was reached; more may be left"
    return last.reason


def _caveats(observation, search):
    dataset = observation.dataset
    if dataset.units.symbols:
        yield (
            "not calibrated: "
            + ", ".join(f"{v} stands for {k}" for k, v in dataset.units.symbols.items())
            + "; constants are in the data's own units"
        )
    if observation.noise.source == "estimated":
        yield f"the noise level was estimated from the data: {observation.noise.method}"
    yield from observation.noise.notes
    if observation.memory:
        unit = dataset.units.text(Unit.of(s=1))
        source = "estimated beside the law" if observation.may_have_memory else "declared"
        yield f"position errors have a memory of {observation.memory:.3g} {unit} ({source})"
    if len(observation.segments) > len(observation.train):
        yield (
            f"tracks depend so strongly on their start that they were fitted in "
            f"{len(observation.segments)} segments"
        )
    late = [s.name for s in observation.test if observation.is_late(s).any()]
    if late:
        yield f"bodies that the first rows do not show are not scored: in {', '.join(late)}"
    unknown = sorted(
        {
            e.name
            for s in dataset.scenes
            for e in s.entities
            if not e.is_static and not np.isfinite(e.mass)
        }
    )
    if unknown:
        yield f"mass unknown: {', '.join(unknown)}; left out of laws for all bodies that need it"
    yield from search.notes
    if search.per_entity:
        yield "effects were tried with one constant for all bodies and with one for each body"
    if search.exclude:
        yield f"not used by the search: {', '.join(search.exclude)}"


def _about(observation):
    dataset = observation.dataset
    digest = hashlib.sha256()
    for scene in dataset.scenes:
        digest.update(scene.name.encode())
        digest.update(scene.times.tobytes())
        digest.update(scene.positions.tobytes())
    return {
        "name": dataset.name,
        "n_scenes": len(dataset.scenes),
        "n_rows": int(sum(np.isfinite(s.positions).all(axis=-1).sum() for s in dataset.scenes)),
        "n_entities": len({n for s in dataset.scenes for n in s.names}),
        "n_dims": dataset.n_dims,
        "train": [s.name for s in observation.train],
        "test": [s.name for s in observation.test],
        "units": dict(dataset.units.declared),
        "up": dataset.up,
        "provenance": dict(dataset.provenance),
        "fingerprint": digest.hexdigest(),
    }


def _versions():
    out = {}
    for package in PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:  # running from a source tree
            out[package] = "source"
    return out


def _overlays(measured, observation, declared, adopted, most=12):
    before = measured.predictions(declared)
    after = observation.predictions(adopted)
    count = 0
    for scene, seen, b, a in zip(measured.test, observation.test, before, after, strict=True):
        own = {seen.names[index]: (r, index) for r, index in enumerate(seen.dynamic)}
        for r, index in enumerate(scene.dynamic):
            if count < most:
                count += 1
                row, other = own[scene.names[index]]
                # Drawn where it would have been measured.
                shift = scene.positions[:, index] - seen.positions[:, other]
                yield Overlay(
                    scene.name,
                    scene.names[index],
                    scene.times,
                    scene.positions[:, index],
                    b[:, r],
                    a[:, row] + (shift if seen is not scene else 0.0),
                    measured.n_initial(scene),
                )


def _residual_table(measured, observation, declared, adopted):
    columns = {
        name: []
        for name in ("t", "speed", "distance", "before", "after", "before_along", "after_along")
    }
    labels = {"scene": [], "entity": [], "split": []}
    for split, first, last in (
        ("train", measured.train_regression, observation.train_regression),
        ("test", measured.test_regression, observation.test_regression),
    ):
        raw = zip(
            first.batches,
            first.raw_residuals(declared),
            last.raw_residuals(adopted),
            strict=True,
        )
        for batch, before, after in raw:
            _add_rows(batch, before, after, split, columns, labels)
    arrays = {
        name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in columns.items()
    }
    return ResidualTable(**labels, **arrays)


def _add_rows(batch, before, after, split, columns, labels):
    receivers = batch.bodies.receivers
    for s, scene in enumerate(batch.scene_names):
        for r, index in enumerate(receivers):
            seen = batch.valid[:, s, r].any(axis=-1)
            v = batch.velocities[seen, s, index]
            speed = np.linalg.norm(v, axis=-1)
            unit = v / np.where(speed > 0, speed, 1.0)[:, None]
            gaps = (
                np.delete(batch.positions[seen, s], index, axis=1)
                - batch.positions[seen, s, None, index]
            )
            distance = (
                np.linalg.norm(gaps, axis=-1).min(axis=1)
                if gaps.shape[1]
                else np.full(len(speed), np.nan)
            )
            b, a = np.nan_to_num(before[seen, s, r]), np.nan_to_num(after[seen, s, r])
            values = (
                batch.times[seen, s],
                speed,
                distance,
                np.linalg.norm(b, axis=-1),
                np.linalg.norm(a, axis=-1),
                (b * unit).sum(axis=-1),
                (a * unit).sum(axis=-1),
            )
            for name, value in zip(columns, values, strict=True):
                columns[name].append(value)
            labels["scene"] += [scene] * len(speed)
            labels["entity"] += [batch.bodies.names[s][index]] * len(speed)
            labels["split"] += [split] * len(speed)
