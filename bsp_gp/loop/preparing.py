"""Making a data set ready for the loop: split, noise, likelihood, integrator, step size."""

from __future__ import annotations

from collections import Counter
from copy import deepcopy
from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import estimate_noise, is_declared_noisy
from bsp_gp.data.point_errors import with_point_errors
from bsp_gp.data.scene import Entity, Scene
from bsp_gp.data.split import choose_split
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.loop.observation import Observation
from bsp_gp.physics.bodies import law_inputs, stack
from bsp_gp.physics.differences import too_many
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.masses import with_usable_masses
from bsp_gp.physics.shooting import cut_segments, guess_state
from bsp_gp.search.constants import fit_constants

__all__ = ["observe"]

EXACT = 1e-9
"""Noise below this part of the range is numerical: the data count as exact."""


RESOLUTION = 1e-7
"""Part of the range to which exact positions of a continuous motion are fitted."""


MOST_ROWS = 1500
"""Longest track that is used with all its rows."""
MAX_SUBSTEPS = 16


CHECKED_ROWS = 250
"""First rows of every scene on which the step size is chosen."""


LASTING = 3
"""Rows from which on a contact is a smooth motion, and no impulse of one step."""
CHAOS = 30.0
"""Growth of a small change of the initial state at which a track is cut for shooting."""


def observe(dataset, law, rng, *, sources=True, noise=None, method=None):
    """Make a data set ready for the loop.

    Parameters
    ----------
    dataset : Dataset
    law : ForceLaw
        The declared model. Where it says that bodies touch, the paper's step is used, unless the
        positions show that contacts last over several rows.
    rng : numpy.random.Generator
        For a split that is not declared.
    sources : bool
        Whether laws may name other bodies.
    noise : NoiseEstimate, optional
        Overrides the data set's.
    method : str, optional
        How accelerations are read off noisy positions: "gls" (the default) or "weak", see
        `build_regression`.

    Returns
    -------
    Observation

    Raises
    ------
    SettingsError
        If a method is asked for that these data have no use for.
    """
    dataset = _thinned(with_usable_masses(dataset))
    estimate = noise or estimate_noise(dataset)
    sigma = np.array(estimate.sigma, dtype=float)
    if not np.isfinite(sigma).any():
        raise DataError("nothing moves: no dynamic entity changes its position on any axis")
    measured = dataset.velocity == "measured" and all(
        s.velocities is not None for s in dataset.scenes
    )
    extent = _extent(dataset)
    is_exact = measured or bool(np.nanmax(sigma) <= EXACT * extent)
    resolved, told = estimate, ""
    if is_exact and not measured:
        train = choose_split(dataset, deepcopy(rng)).train  # as below
        is_exact = _made_in_steps(train, law, dataset.up, sources)
        # Noise that is declared is never replaced, however small it is.
        is_declared = estimate.source != "estimated" and is_declared_noisy(dataset)
        if not is_exact and not is_declared:
            sigma = np.where(np.isfinite(sigma), np.maximum(sigma, RESOLUTION * extent), sigma)
            resolved = replace(estimate, sigma=tuple(sigma))
            told = (
                f"; the positions are exact and the motion looks continuous: they are fitted to "
                f"{RESOLUTION:g} of their range"
            )
    if not is_exact:
        dataset, more = with_point_errors(dataset, resolved, is_exact=resolved is not estimate)
        estimate = replace(estimate, notes=(*estimate.notes, *more))
    train, test, note = choose_split(dataset, rng)
    if not is_exact:
        estimate = replace(estimate, notes=(*estimate.notes, *_unheeded(train)))
    note += told
    given, method = method, "derivative" if measured else "one_step" if is_exact else "gls"
    if given is not None:
        if method != "gls" or given not in ("gls", "weak"):
            raise SettingsError(
                f"accelerations are read off these data by {method!r}, not by {given!r}: 'gls' and "
                "'weak' are for positions with noise"
            )
        method = given
    regression_sigma = _acceleration_sigma(train, dataset.up) if measured else sigma
    integrator = "euler" if _touches(law) or method == "one_step" else "rk4"
    memory = dataset.noise_memory or 0.0
    common = {
        "method": method, "sigma": regression_sigma, "up": dataset.up, "sources": sources,
        "memory": memory,
    }  # fmt: skip
    observation = Observation(
        dataset,
        tuple(train),
        tuple(test),
        note,
        estimate,
        sigma,
        is_exact,
        method,
        np.asarray(regression_sigma),
        integrator,
        1,
        tuple(train),
        build_regression(train, **common),
        build_regression(test, **common),
        sources,
        memory,
    )
    if measured and integrator == "rk4":
        # Steps must be finer than what a wrong law does to a track, not than the noise.
        start = fit_constants(observation.train_regression, law).law
        error = observation.headline_rollout(start)
        return replace(observation, substeps=_substeps(observation, start, 0.1 * error))
    if is_exact:
        return observation
    start = fit_constants(observation.train_regression, law).law
    if integrator == "rk4" or _contacts_last(train, dataset.up):
        observation = replace(observation, integrator="rk4")
        observation = replace(
            observation, substeps=_substeps(observation, start, observation.sigma)
        )
    rows = _segment_rows(observation, start)
    return replace(observation, segments=tuple(cut_segments(train, rows)), segment_rows=rows)


def _made_in_steps(scenes, law, up, sources):
    """Whether exact positions come from steps of the paper's kind rather than from a smooth motion.

    Under the law the step with the backward velocity is compared with the one with the central
    velocity, which is a step order better for smooth motion. Where the law cannot tell, bodies
    that can touch decide: contacts are impulses of one step.
    """
    misfits = []
    for method in ("one_step", "central"):
        regression = build_regression(scenes, method=method, up=up, sources=sources)
        misfits.append(fit_constants(regression, law).loss)
    if max(misfits) > 2 * min(misfits):
        return misfits[0] < misfits[1]
    bodies = [e for scene in scenes for e in scene.entities]
    can_touch = sum(e.shape != "point" for e in bodies) > sum(1 for _ in scenes)
    return can_touch or _touches(law)


def _extent(dataset):
    spans = [np.nanmax(s.positions) - np.nanmin(s.positions) for s in dataset.scenes]
    return float(np.max(spans)) or 1.0


def _unheeded(scenes):
    """A note where errors of single points are too many to count in the search as well."""
    tracks = Counter()
    for scene in scenes:
        tracks[len(scene.times)] += len(scene.dynamic)
    if any(s.sigma is not None for s in scenes) and any(too_many(*t) for t in tracks.items()):
        yield (
            "errors of single points count in fits to whole tracks; the search takes one error "
            "for all, since these data are too large for more"
        )


def _touches(law):
    return any(node in term.formula.inputs for term in law.terms for node in ("s_i", "s_j", "p_c"))


def _thinned(dataset):
    """Long tracks with every k-th row only: more rows cost much and say little."""
    longest = max(len(scene.times) for scene in dataset.scenes)
    if longest <= MOST_ROWS:
        return dataset
    scenes, most = [], 1
    for scene in dataset.scenes:
        step = -(-len(scene.times) // MOST_ROWS)
        most = max(most, step)
        scenes.append(scene if step == 1 else _every(scene, step))
    note = f"tracks of more than {MOST_ROWS} rows were thinned: up to every {most}th row was used"
    return replace(dataset, scenes=tuple(scenes), notes=(*dataset.notes, note))


def _every(scene, step):
    def cut(values):
        return None if values is None else values[::step]

    return replace(
        scene,
        times=scene.times[::step],
        positions=scene.positions[::step],
        velocities=cut(scene.velocities),
        sigma=cut(scene.sigma),
    )


def _acceleration_sigma(scenes, up):
    """Noise of accelerations that are differences of measured velocities, per axis."""
    regression = build_regression(scenes, method="derivative", up=up, sources=False)
    series = []
    for batch in regression.batches:
        for s in range(batch.target.shape[1]):
            n = int(np.isfinite(batch.times[:, s]).sum())
            names = batch.bodies.receiver_names[s]
            series.append(
                Scene(
                    f"{s}",
                    batch.times[:n, s],
                    batch.target[:n, s],
                    tuple(Entity(name) for name in names),
                )
            )
    return np.array(estimate_noise(series).sigma)


def _contacts_last(scenes, up):
    """Whether bodies that touch do so for several rows on end, and not for one step."""
    lengths = []
    for batch in stack(scenes, up):
        states = batch.positions, np.zeros_like(batch.positions), batch.times
        inputs = law_inputs("pair", batch.bodies, *states)
        touching = inputs["s_i"].collides(inputs["p_i"], inputs["s_j"], inputs["p_j"])
        for track in touching.reshape(len(touching), -1).T:
            edges = np.flatnonzero(np.diff(np.concatenate([[0.0], track, [0.0]])))
            lengths += (edges[1::2] - edges[::2]).tolist()
    return bool(lengths) and float(np.median(lengths)) >= LASTING


def _substeps(observation, law, tolerance):
    """Double the sub-steps until predictions move by less than a tenth of the tolerance."""
    heads = [scene.rows(0, CHECKED_ROWS) for scene in observation.train]
    batches = stack(heads, observation.dataset.up, observation.velocity)
    substeps = 1
    while substeps < MAX_SUBSTEPS:
        worst = 0.0
        for batch in batches:
            p, v = guess_state(batch)
            coarse = rollout(law, batch, p, v, substeps=substeps)
            fine = rollout(law, batch, p, v, substeps=2 * substeps)
            with np.errstate(invalid="ignore"):
                change = np.abs(coarse - fine) / tolerance
            worst = max(worst, float(np.nanmax(np.where(np.isfinite(change), change, 0.0))))
        if worst < 0.1:
            break
        substeps *= 2
    return substeps


def _segment_rows(observation, law):
    """Rows after which a small change of the initial state has grown `CHAOS` times, or None."""
    shortest = None
    for batch in stack(observation.train, observation.dataset.up):
        p, v = guess_state(batch)
        step = 1e-6 * (np.nanmax(np.abs(batch.positions)) or 1.0)
        base = rollout(
            law, batch, p, v, substeps=observation.substeps, integrator=observation.integrator
        )
        moved = rollout(
            law,
            batch,
            p + step,
            v,
            substeps=observation.substeps,
            integrator=observation.integrator,
        )
        with np.errstate(over="ignore", invalid="ignore"):  # what runs away has grown
            growth = np.linalg.norm(moved - base, axis=-1) / step
        running = np.isfinite(batch.times)[..., None]
        grown = np.flatnonzero((running & ~(growth < CHAOS)).any(axis=(1, 2)))
        if len(grown):
            shortest = min(shortest or len(growth), max(int(grown[0]), 8))
    return shortest
