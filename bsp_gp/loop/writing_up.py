"""What a closed loop reports: errors, noise, notes, tracks and residuals before and after."""

from __future__ import annotations

import hashlib
import time
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from scipy import special

from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.before_after import compared
from bsp_gp.loop.dropping import dropped_rivals
from bsp_gp.loop.explanation import HIDDEN_BODY, MEASUREMENT
from bsp_gp.loop.measurement import parted_by
from bsp_gp.loop.memory import widened
from bsp_gp.loop.outcome import VERDICTS, LoopReport, Overlay, ResidualTable
from bsp_gp.loop.pruning import unsupported
from bsp_gp.loop.telling import alike_numbers, constant_estimates
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.units import Unit

__all__ = ["corrections", "write_up"]

TOO_QUIET = 0.001
"""Chance of as little residual from the declared noise, below which that is said to be too much."""
PACKAGES = ("bsp_gp", "numpy", "scipy", "pandas", "deap")


def write_up(search, measured, law, first, model, rounds, grammar, alpha, seed, rng, started):
    """The report of a closed loop.

    Parameters
    ----------
    search : EffectSearch
        On the observation as it was in the end, corrections and hidden bodies included.
    measured : Observation
        Of the positions as measured, under the same noise.
    law : ForceLaw
        The declared one.
    first, model : Model
        The declared model on `measured`, and the last one.
    rounds : list of Round
    grammar : Grammar
    alpha : float
    seed : int or None
    rng : numpy.random.Generator
    started : float
        Of `time.perf_counter`.

    Returns
    -------
    LoopReport
    """
    observation = search.observation
    floor_rng, ratio_rng = rng.spawn(2)
    dataset = observation.dataset
    floor, copies = observation.floor(model.law, floor_rng)
    errors = compared(observation, first, model, copies, ratio_rng)
    verdicts = {r.verdict for r in rounds}
    verdict = next(v for v in VERDICTS if v in verdicts)
    if verdict == "nothing missing" and "seen, not adopted" in verdicts:
        verdict = "seen, not adopted"
    if any(r.adopted for r in rounds) and "effect adopted" not in verdicts:
        verdict = "cannot tell"  # all that was adopted has a rival that explains as much
    wide = replace(model, fit=widened(search, model.fit))
    constants = constant_estimates(observation, wide.fit)
    units = {c.name: c.unit for c in constants if not c.entity}
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
        constants=constants,
        total={"before": errors.before, "after": errors.after, "floor": floor,
               "ratio": errors.ratio, "ratios": errors.ratios},  # fmt: skip
        verdict=verdict,
        stop_reason=_stop_reason(rounds),
        versions=_versions(),
        wall_s=time.perf_counter() - started,
        overlays=tuple(_overlays(measured, observation, first.law, model.law)),
        residuals=_residual_table(measured, observation, first.law, model.law),
        corrections=corrections(rounds),
        notes=(
            *_effective(rounds),
            *_corrected(rounds),
            *unsupported(observation, wide),
            *_one_and_the_same(observation, model.fit),
            *dataset.notes,
            observation.split_note,
            *_too_much_noise(observation, model.fit),
            *aliasing_notes(model.law, observation.train, dataset.units),
            *_caveats(observation, search),
            *dropped_rivals(rounds),
        ),
    )


def corrections(rounds):
    """What was adopted and is no force between visible bodies."""
    return tuple(
        {"name": e.name, "kind": e.kind, "text": e.law, "constants": e.constants}
        for e in (r.effect for r in rounds if r.adopted)
        if e.kind in (HIDDEN_BODY, MEASUREMENT)
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
    for correction in corrections(rounds):
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


def _too_much_noise(observation, fit):
    """A warning where the declared noise is more than what is left can be."""
    if fit.whole is None or observation.noise.source not in ("declared", "quoted"):
        return
    if not np.allclose(observation.sigma, observation.noise.sigma, equal_nan=True):
        return  # exact data, fitted to a resolution
    dof = max(fit.whole.n_rows - fit.whole.n_free, 1)
    if special.chdtr(dof, fit.whole.chisqr) < TOO_QUIET:
        yield (
            "the declared noise is more than there is: what is left has "
            f"{fit.whole.chisqr / dof:.2g} of its variance; weak effects go unseen for it, and "
            "intervals are too wide"
        )


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
