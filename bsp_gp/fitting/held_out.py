"""Errors of a fitted law on scenes that it was not fitted to.

The initial state of a held-out scene is fitted on its first rows, with the law as it is; the rest
of the scene is foreseen from there.
"""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.scene import FirstState
from bsp_gp.fitting.estimates import Errors
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, Hypothesis, Parameter, Positions, TrackNoise
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.outliers import is_exact, without_outliers
from bsp_gp.fitting.parts.latents import About, filled, unknown_beyond
from bsp_gp.fitting.rolling import flow_of, roll
from bsp_gp.fitting.unseen import shown
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.linked import is_held
from bsp_gp.physics.engine.seen import sight
from bsp_gp.physics.force import key_of, tabled
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import METRICS, error_of, one_step_errors, residual_accelerations
from bsp_gp.units import ACCELERATION, METRE

LEAST_ROWS = 3
"""Rows that a state is fitted on, at least."""
STEP_ERROR = 0.02
"""Error of the integration over a whole track, in standard deviations of a position."""
STATES_EFFORT = 600
"""Steps after which states are taken as they are then: no path may lead where a track goes."""
ROUNDING = 1e-13
"""The same as a part of the largest coordinate, at least, for every row."""


@dataclass(frozen=True)
class FixedForces(Forces):
    """Forces whose constants keep their values, but `own` ones of unknown bodies and scenes."""

    own: tuple = ()

    @property
    def parameters(self):
        return self.own


def _own(law, scenes):
    """Indexed constants of bodies and scenes that a law was not fitted to."""
    out = []
    for name, table in tabled(law, scenes).constants.items():
        if not hasattr(table, "items") or not name.endswith("]"):
            continue
        known = law.constants[name]
        values = np.array(list(known.values()))
        mean, spread = float(values.mean()), float(values.std())
        prior = About(mean, spread or abs(mean) or 1.0)
        new = (key for key in table if key_of(key, known) not in known)
        out += [Parameter(name, key, start=mean, prior=prior) for key in new]
    return tuple(out)


def known_in(found, dataset, scenes, *, deadline=None):
    """A fit whose law knows what belongs to other scenes alone, from their first rows."""
    if not _own(found.law, scenes) and not unknown_beyond(found.law, scenes):
        return found
    head = _on_heads(found, dataset, scenes, deadline)
    return found if head.is_failed else replace(found, law=head.law)


def _on_heads(found, dataset, scenes, deadline):
    """A fit with the states of scenes fitted on their first rows."""
    heads = tuple(s.rows(0, _n_head(dataset, s, False)) for s in scenes)
    heads, _ = without_outliers(heads, found.noise.levels)
    return with_states(found, dataset, heads, deadline=deadline)


def held_out_errors(found, dataset, scenes, *, deadline=None):
    """Errors of a fit on scenes that it has not seen.

    They are nan where nothing is held out, or the fit has no finite constants.
    """
    return errors_of(held_out_rows(found, dataset, scenes, deadline=deadline), dataset.units)


def errors_of(rows, units):
    """The errors of rows of `held_out_rows`; nan where there are none."""
    said = {"unit": units.text(METRE), "acceleration_unit": units.text(ACCELERATION)}
    if not rows:
        return Errors(**dict.fromkeys(METRICS, float("nan")), **said)
    with np.errstate(all="ignore"):  # a law that runs away has endless errors, and says so
        return Errors(**{metric: error_of(metric, rows) for metric in METRICS}, **said)


def predictions(found, dataset, scenes, *, deadline=None):
    """Positions that a fitted law foresees, from states fitted on the first rows.

    One array (T, R, d) per scene: inf where the motion runs away, nan for bodies that the first
    rows do not show.
    """
    scenes = shown(found, scenes)
    if dataset.is_of_sight:
        scenes = _at_rest(scenes)
    measured = _is_measured(dataset, scenes)
    begun = _begun(found.law, dataset, scenes, measured)
    is_asked = begun and not measured
    states = _states_of(_on_heads(found, dataset, begun, deadline)) if is_asked else {}
    tracks = {scene.name: np.full(scene.positions[:, scene.dynamic].shape, np.nan)
              for scene in scenes}  # fmt: skip
    bodies = {s.name: [s.names[k] for k in s.dynamic] for s in scenes}
    for chains in build_chains(found.law, begun, dataset.up, dataset.velocity):
        first = _stacked(chains, states, measured)
        tolerance = _tolerance(found, chains)
        nodes = roll(found.law, chains, first, tolerance, found.paper_steps)
        seen = sight(flow_of(found.law, chains, tolerance, found.paper_steps), nodes).places
        for scene, name, s, r in chains.members():
            track = tracks[scene]
            track[:, bodies[scene].index(name)] = seen[: len(track), s, r]
    for scene in scenes:
        tracks[scene.name][:, _is_late(dataset, scene, measured)] = np.nan
    return [tracks[scene.name] for scene in scenes]


def _at_rest(scenes):
    """Scenes of velocities along the line of sight, which stay as they are but for companions."""
    zero = np.zeros(scenes[0].positions.shape[1:])
    return [replace(scene, first=FirstState(zero, zero)) for scene in scenes]


def _is_measured(dataset, scenes):
    """Whether velocities were measured, so that the first row is a state."""
    return dataset.velocity == "measured" and all(s.velocities is not None for s in scenes)


def _n_initial(dataset, scene, measured):
    """First rows on which the initial state is fitted.

    As declared; else a fifth of the scene, so that a higher frame rate does not make the start
    worse known, and at least 12 rows where a third of the scene has them.
    """
    if measured:
        return 1
    n = len(scene.times)
    wanted = dataset.evaluation.initial_rows
    return min(wanted if wanted is not None else max(min(12, max(3, n // 3)), n // 5), n - 1)


def _n_head(dataset, scene, measured):
    """First rows that the initial state is taken from."""
    return 1 if measured else max(_n_initial(dataset, scene, False), LEAST_ROWS)


def _begun(law, dataset, scenes, measured):
    """The scenes with the bodies that their first rows show, from which alone one can foresee.

    Where bodies act on each other, a scene that lacks a moving one is left out.
    """
    begun = []
    for scene in scenes:
        head = scene.positions[: _n_head(dataset, scene, measured)]
        is_shown = np.isfinite(head).all(axis=-1).any(axis=0)
        is_lost = np.isin(np.arange(len(is_shown)), scene.dynamic) & ~is_shown
        if not is_lost.any():
            begun.append(scene)
        elif is_shown[scene.dynamic].any() and not _has_pairs(law):
            begun.append(_only(scene, np.flatnonzero(~is_lost)))
    return tuple(begun)


def _only(scene, kept):
    fields = ("positions", "velocities", "sigma")
    arrays = {name: getattr(scene, name) for name in fields}
    arrays = {name: None if a is None else a[:, kept] for name, a in arrays.items()}
    if scene.first is not None:
        own = {n: getattr(scene.first, n)[kept] for n in ("velocity", "velocity_error")}
        arrays["first"] = replace(scene.first, **own)
    return replace(scene, entities=tuple(scene.entities[k] for k in kept), **arrays)


def _has_pairs(law):
    return any(term.kind == "pair" for term in law.terms)


def _is_late(dataset, scene, measured):
    """Which moving bodies the first rows do not show often enough to know their state."""
    head = scene.positions[: _n_initial(dataset, scene, measured), scene.dynamic]
    return np.isfinite(head).all(axis=-1).sum(axis=0) < (1 if measured else 2)


def _states_of(head):
    """First states of a fit, (scene, body) -> (2, d)."""
    return {
        (scene, name): nodes[:, r, :, 0, s]
        for chains, nodes in zip(head.groups, head.nodes, strict=True)
        for scene, name, s, r in chains.members()
    }


def initial_states(dataset, law, *, paper_steps=False):
    """States at the first row of every scene, fitted on the first rows under a law as it is.

    Places and velocities of the moving bodies, (2, R, d), by the name of the scene. Where
    velocities were measured, the first row is the state.
    """
    scenes = dataset.scenes
    if _is_measured(dataset, scenes):
        rows = ((s.name, s.positions[0, s.dynamic], s.velocities[0, s.dynamic]) for s in scenes)
        return {name: np.stack(state) for name, *state in rows}
    heads = tuple(s.rows(0, _n_head(dataset, s, False)) for s in scenes)
    heads = replace(dataset, scenes=heads, train=(), test=())
    states = _states_of(states_alone(law, paper_steps, NoiseModel.of(dataset), heads))
    return {
        s.name: np.stack([states[s.name, s.names[k]] for k in s.dynamic], axis=1) for s in scenes
    }


def with_states(found, dataset, scenes, *, deadline=None):
    """The law of a fit as it is, with the initial states of other scenes fitted.

    It has no constants but those that belong to these scenes alone.
    """
    scenes = replace(dataset, scenes=tuple(shown(found, scenes)), train=(), test=())
    return states_alone(found.law, found.paper_steps, found.noise, scenes, deadline)


def states_alone(law, paper_steps, noise, dataset, deadline=None):
    """Fit of initial states alone, under noise that is known."""
    noise = replace(noise, sources=("declared",) * len(noise.levels))
    own = _own(law, dataset.scenes)
    law = law.with_constants({
        name: {**law.constants[name], **{p.entity: p.start for p in own if p.name == name}}
        for name in {p.name for p in own}
    })  # fmt: skip
    forces = FixedForces(law, paper_steps, own)
    more = unknown_beyond(law, dataset.scenes)
    hypothesis = Hypothesis((forces, *more, Positions(), TrackNoise(noise)))
    # Without constants there is nothing in which starts could differ.
    return fit(hypothesis, dataset, deadline=deadline, effort=STATES_EFFORT, most_starts=1)


def _stacked(chains, states, measured):
    """States at the first rows of some chains, (2, R, d, S)."""
    if measured:
        first = np.stack([chains.observed[0], chains.velocities[0]])
        return np.moveaxis(first, 1, -1)
    own = [[states[scene, name] for name in members]
           for scene, members in zip(chains.scenes, chains.bodies, strict=True)]  # fmt: skip
    return np.moveaxis(np.array(own), (0, 1, 2, 3), (3, 1, 0, 2))


def _tolerance(found, chains):
    """Error of the integration that whole tracks may have, (S,), metres."""
    level = float(np.nanmin(found.noise.levels))
    largest = np.nanmax(np.abs(chains.observed), axis=(0, 2, 3))
    return np.maximum(STEP_ERROR * level, ROUNDING * chains.lengths * largest)


# --- rows -----------------------------------------------------------------------------------------


def held_out_rows(found, dataset, scenes, *, scatter=None, deadline=None):
    """What the errors are made of, scene by scene.

    Parameters
    ----------
    scatter : tuple of float, metres, optional
        What `scatter_of` tells of the scenes, or of those that these are copies of.
    deadline : float, optional
        Seconds.

    Returns
    -------
    list of dict
        The fields of `bsp_gp.physics.metrics.ERRORS`, the predicted positions `foreseen`
        (T, R, d), and the number of rows `n_initial` that they start from. None of a fit without
        finite constants.
    """
    scenes = tuple(shown(found, scenes))
    if not scenes or not np.isfinite(found.values).all():
        return []
    with np.errstate(all="ignore"):  # a law that runs away has endless errors, and says so
        found = known_in(found, dataset, scenes, deadline=deadline)
        scenes = filled(found.law, scenes)
        tracks = predictions(found, dataset, scenes, deadline=deadline)
        steps = one_step_errors(scenes, found.law, dataset.up, sources=_has_pairs(found.law))
        regression = regression_of(found, dataset, scenes)
        accelerations = residual_accelerations(regression, found.law)
        if is_held(found.law):  # these read the law alone, without what holds the bodies
            steps = [np.full_like(step, np.nan) for step in steps]
            accelerations = {k: np.full_like(v, np.nan) for k, v in accelerations.items()}
        measured = _is_measured(dataset, scenes)
        off = _far_off(scenes, scatter_of(dataset, scenes) if scatter is None else scatter)
        for step, is_off in zip(steps, off, strict=True):
            step[is_off[:-2] | is_off[1:-1] | is_off[2:]] = np.nan
        return [
            {
                "scene": scene.name,
                "steps": step[..., None],
                "accelerations": accelerations[scene.name],
                "foreseen": track,
                "n_initial": _n_initial(dataset, scene, measured),
                **_track_errors(found, dataset, scene, track, measured, is_off),
            }
            for scene, track, step, is_off in zip(scenes, tracks, steps, off, strict=True)
        ]


def scatter_of(dataset, scenes):
    """Noise of each axis that the tracks of some scenes show, metres, whatever their law is."""
    return estimate_noise(replace(dataset, scenes=tuple(scenes), train=(), test=())).sigma


def _far_off(scenes, levels):
    """Rows of bodies that are far off their neighbours, (T, N) per scene: no law foresees them.

    They are told by the tracks alone, so that errors of all laws are of the same rows.
    """
    if is_exact(scenes, levels):
        return [np.zeros(scene.positions.shape[:2], dtype=bool) for scene in scenes]
    kept, _ = without_outliers(scenes, levels)
    return [
        np.isnan(new.positions).any(axis=2) & np.isfinite(old.positions).all(axis=2)
        for new, old in zip(kept, scenes, strict=True)
    ]


def _track_errors(found, dataset, scene, track, measured, is_off):
    """Errors of a foreseen track, and at the row of the end point."""
    observed = np.where(is_off[..., None], np.nan, scene.positions)[:, scene.dynamic]
    error = np.where(np.isfinite(found.noise.levels), observed - track, 0.0)
    error[: _n_initial(dataset, scene, measured)] = np.nan
    row = dataset.evaluation.endpoint_row
    index = (row - 1) if row is not None else len(scene.times) - 1
    # Where a track ends before the end-point row there is no end point to score.
    ends = error[index] if index < len(scene.times) else np.full_like(error[0], np.nan)
    return {"track": error, "ends": ends}


def regression_of(found, dataset, scenes):
    """Accelerations read off the scenes as they can be read best, a Regression without weights."""
    scenes = shown(found, scenes)
    measured = _is_measured(dataset, scenes)
    method = "derivative" if measured else "one_step" if found.paper_steps else "gls"
    pairs = _has_pairs(found.law)
    return build_regression(
        filled(found.law, scenes), method=method, sigma=np.array(found.noise.levels), up=dataset.up,
        sources=pairs and max(len(scene.entities) for scene in scenes) > 1,
        memory=dataset.noise_memory or 0.0, may_be_empty=True, whitened=False,
    )  # fmt: skip
