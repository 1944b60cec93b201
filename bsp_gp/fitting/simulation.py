"""The motion that a law gives, as a data set."""

from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import checked_noise
from bsp_gp.errors import EvaluationError, LawError, SettingsError
from bsp_gp.fitting.held_out import initial_states
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.fitting.rolling import roll
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout, step_of
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.linked import is_held
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.masses import check_properties, with_usable_masses
from bsp_gp.randomness import generator

MAX_SUBSTEPS = 64
STEP_TOLERANCE = 1e-9
"""Simulated positions must not change by more than this part of their range with the step."""


def simulate_law(
    dataset, law, *, constants=None, rng=None, noise=0.0, integrator=None, substeps=None
):
    """Roll a law out from the initial states of every scene of a data set.

    The initial states are fitted on the first rows of every scene under the law. Bodies that
    forces do not move keep their tracks; gaps of the tracks stay gaps.

    Parameters
    ----------
    law : ForceLaw, str or sequence of str
    constants : mapping of str to float, optional
        Values of the constants that typed laws name, SI.
    rng : numpy.random.Generator, int or None
        Of the noise.
    noise : float or sequence of float
        Standard deviation of the noise added to positions, one or one per axis, metres.
    integrator : str, optional
        By default the paper's step for laws with contacts, else "rk4".
    substeps : int, optional
        Steps per row; by default as many as it takes for the positions not to change.

    Returns
    -------
    Dataset
        With simulated positions and without velocities.

    Raises
    ------
    LawError
        If a constant has no value.
    EvaluationError
        If the motion leaves the range of numbers.
    """
    law = _valued(dataset, law, dict(constants or {}))
    noise = checked_noise(noise, dataset.n_dims)
    rng = generator(rng)
    if substeps is not None and not 1 <= substeps <= 1000:
        raise SettingsError(f"substeps must be between 1 and 1000, got {substeps!r}")
    integrator = integrator or ("euler" if _touches(law) else "rk4")
    step_of(integrator)
    usable = with_usable_masses(dataset)
    check_properties(stack(usable.scenes, usable.up), law)
    paths = _paths(usable, law, integrator, substeps)
    scenes = []
    for scene, path in zip(dataset.scenes, paths, strict=True):
        seen = np.isfinite(scene.positions[:, scene.dynamic])
        if not np.isfinite(path[seen]).all():
            raise EvaluationError(
                f"under this law the motion of scene {scene.name!r} leaves the range of numbers"
            )
        if any(noise):
            path = path + rng.standard_normal(path.shape) * np.array(noise)
        scenes.append(replace(scene.on_track(path), velocities=None, sigma=None))
    return replace(
        dataset, name=f"{dataset.name} simulated", scenes=tuple(scenes), noise=noise, steps=(),
        velocity="ignore", notes=(), provenance={
            "simulated law": law.text(), "initial states": f"fitted to {dataset.name}",
            "integrator": integrator,
        },
    )  # fmt: skip


def _valued(dataset, law, constants):
    is_typed = not isinstance(law, ForceLaw)
    law = declared_law(dataset, law) if is_typed else law
    unknown = sorted(set(constants) - set(law.names))
    if unknown:
        raise LawError(
            f"the law has no constant {unknown[0]!r}; it names {', '.join(law.names) or 'none'}"
        )
    missing = [name for name in law.names if is_typed and name not in constants]
    if missing:
        raise LawError(
            f"the constant {missing[0]!r} has no value; give one with --set {missing[0]}=..., or "
            "write a number in its place"
        )
    law = law.with_constants(constants)
    return ForceLaw(law.terms, {name: law.constants[name] for name in law.names}, law.frame)


def _touches(law):
    return any(n in term.formula.inputs for term in law.terms for n in ("s_i", "s_j", "p_c"))


def _paths(dataset, law, integrator, substeps):
    """Predicted positions of the receivers of every scene, list of (T, R, d)."""
    if is_held(law):
        return _held_paths(dataset, law)
    is_paper = integrator == "euler" and (substeps or 1) == 1
    states = initial_states(dataset, law, paper_steps=is_paper)

    def paths(count):
        tracks = {}
        for batch in stack(dataset.scenes, dataset.up, dataset.velocity):
            p, v = np.stack([states[scene.name] for scene in batch.scenes], axis=1)
            rolled = rollout(law, batch, p, v, integrator=integrator, substeps=count)
            for s, scene in enumerate(batch.scenes):
                tracks[scene.name] = rolled[: len(scene.times), s]
        return [tracks[scene.name] for scene in dataset.scenes]

    if substeps or integrator == "euler":
        return paths(substeps or 1)
    count, coarse = 1, paths(1)
    while count < MAX_SUBSTEPS:
        count *= 2
        fine = paths(count)
        if _greatest_change(coarse, fine) < STEP_TOLERANCE:
            return fine
        coarse = fine
    return coarse


def _held_paths(dataset, law):
    """The same under constraints, whose motion is integrated with its error under control."""
    states = initial_states(dataset, law, paper_steps=False)
    tracks = {s.name: np.full(s.positions[:, s.dynamic].shape, np.nan) for s in dataset.scenes}
    place = {s.name: [s.names[k] for k in s.dynamic] for s in dataset.scenes}
    for chains in build_chains(law, dataset.scenes, dataset.up):
        rows = [
            [place[scene].index(name) for name in own]
            for scene, own in zip(chains.scenes, chains.bodies, strict=True)
        ]
        first = np.stack([states[s][:, k] for s, k in zip(chains.scenes, rows, strict=True)], -1)
        size = np.nanmax(np.abs(chains.observed), axis=(0, 2, 3))
        nodes = roll(law, chains, first, STEP_TOLERANCE * size)
        for s, (scene, own) in enumerate(zip(chains.scenes, rows, strict=True)):
            path = np.moveaxis(nodes[0, ..., s], -1, 0)[: len(tracks[scene])]
            tracks[scene][:, own] = path
    return [tracks[scene.name] for scene in dataset.scenes]


def _greatest_change(coarse, fine):
    """Largest difference as a part of the range of each scene."""
    worst = 0.0
    for a, b in zip(coarse, fine, strict=True):
        with np.errstate(invalid="ignore", over="ignore"):
            both = np.isfinite(a) & np.isfinite(b)
            if both.any():
                worst = max(worst, float(np.abs(a - b)[both].max() / (np.ptp(b[both]) or 1.0)))
    return worst
