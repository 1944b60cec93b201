"""Worlds in which `neural_efficiency.py` judges laws and networks besides the test scenes."""

import functools
from dataclasses import replace

import numpy as np
from data_efficiency import COLLIDING
from scenes import LAWS, scenario

from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.simulate.synth import make, preset

CONSTANTS = {"nbody": 8167.007, "mat": -0.8, "bounce": 100.0}
"""Of `scenes.LAWS`."""
OTHER = {
    "nbody": {"other numbers": ({"n_bodies": 3}, {"n_bodies": 6}),
              "other masses": ({"mass": (9.0, 30.0), "central_mass": 2000.0},)},
    "mat": {"other numbers": ({"n_bodies": 3},),
            "other masses": ({"mass": (9.0, 30.0)},)},
    "bounce": {"other numbers": ({"n_bodies": 2}, {"n_bodies": 5}),
               "other masses": ({"mass": (9.0, 30.0)},)},
}  # fmt: skip
"""Numbers of `bsp_gp.simulate.synth.preset` that training scenes do not have."""
N_OTHER = 20


def true_law(name):
    """The law that made a scenario's scenes."""
    formula = parse_formula(LAWS[name], scenario(name).input_types)
    return ForceLaw((Term(formula, "pair"),), {"c1": CONSTANTS[name]})


def rolled(scenes, law):
    """Where a law takes the bodies from the first two rows on: arrays (T - 2, R, 2), receivers.

    Symplectic Euler from finite-difference velocities, which is how the paper's data move.
    """
    out = {}
    for batch in stack(scenes):
        dt = batch.times[1] - batch.times[0]
        r = batch.bodies.receivers
        p0, p1 = batch.positions[0][:, r], batch.positions[1][:, r]
        later = stack([_without_first_row(s) for s in batch.scenes])[0]
        v = (p1 - p0) / dt[:, None, None]
        with np.errstate(all="ignore"):
            path = rollout(law, later, p1, v, integrator="euler")[1:]
        for k, scene in enumerate(batch.scenes):
            out[scene.name] = path[:, k]
    return [out[scene.name] for scene in scenes]


def _without_first_row(scene):
    return replace(scene, times=scene.times[1:], positions=scene.positions[1:], velocities=None,
                   sigma=None)  # fmt: skip


@functools.lru_cache(maxsize=3)
def other_worlds(name):
    """Made-up scenes unlike those of training: {"other numbers": [[Scene]], ...}.

    Their layouts are those of `bsp_gp.simulate.synth`; the scenario's true law moves them from
    their first two rows on, so that its one-step error is zero. Gravity is not the whole truth
    where discs touch; such scenes are passed over.
    """
    rng = np.random.default_rng(20)
    worlds = {}
    for label, changes in OTHER[name].items():
        worlds[label] = []
        for numbers in changes:
            settings = preset(name, n_scenes=3 * N_OTHER, **numbers)
            scenes = [_with_friction(scene) for scene in make(settings, rng)[0].scenes]
            paths = rolled(scenes, true_law(name))
            scenes = [_moved(s, path) for s, path in zip(scenes, paths, strict=True)]
            scenes = [s for s in scenes if name not in COLLIDING or not _touches(s)]
            worlds[label].append(scenes[:N_OTHER])
    return worlds


def _touches(scene):
    """Whether discs of a scene touch in any row."""
    radius = np.array([e.radius for e in scene.entities])
    gap = np.linalg.norm(scene.positions[:, :, None] - scene.positions[:, None], axis=-1)
    near = gap < radius[:, None] + radius
    return bool(near[:, *np.triu_indices(len(radius), 1)].any())


def _moved(scene, path):
    positions = np.array(scene.positions)
    positions[2:, scene.dynamic] = path
    return replace(scene, positions=positions, velocities=None, sigma=None)


def _with_friction(scene):
    """The scene with a coefficient of zero where none is given, as the paper's scenes have it."""
    entities = [replace(e, properties={"friction": 0.0, **e.properties}) for e in scene.entities]
    return replace(scene, entities=tuple(entities))


def free_of_contact(name, scenes):
    """The test scenes in which a scenario's law is the whole truth."""
    return [scene for scene in scenes if scene.name not in COLLIDING.get(name, ())]
