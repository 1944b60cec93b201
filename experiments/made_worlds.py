"""Made-up worlds that the studies of the loop share: smooth motion, a few hundred rows a set."""

import itertools

import numpy as np

from bsp_gp.simulate.synth import make, preset

CLOSEST = 3.0
"""Metres; flights of bodies past each other nearer than this are drawn again, as near-chaos."""

FALL = {"has_table": False, "noise": 0.005, "n_frames": 40, "dt": 0.025}
SPRING = {"noise": 0.003, "n_frames": 50}
MAT = {"forces": (), "noise": 0.05, "n_frames": 40}
NBODY = {"n_bodies": 3, "pull": 1.0, "mass": (1.0, 5.0), "radius": 0.1, "distance": (15.0, 30.0),
         "jitter": (-1.0, 1.0), "noise": 0.01, "n_frames": 40, "dt": 0.15,
         "substeps": 50}  # fmt: skip


PUCKS = {"noise": 0.01, "n_frames": 50}


def make_apart(settings, entropy, engine=None, closest=CLOSEST):
    """Data set and truth in which moving bodies keep their distance.

    Parameters
    ----------
    settings : Settings
    entropy : tuple of int
        Of the random generator; a last number is counted up until the bodies keep apart.
    engine : callable, optional
    closest : float, metres
    """
    extra = () if engine is None else (engine,)
    for attempt in itertools.count():
        dataset, truth = make(settings, np.random.default_rng((*entropy, attempt)), *extra)
        if all(_gap(scene) >= closest for scene in dataset.scenes):
            return dataset, truth


def _gap(scene):
    p = scene.positions[:, scene.dynamic]
    pairs = itertools.combinations(range(p.shape[1]), 2)
    return min((np.linalg.norm(p[:, i] - p[:, j], axis=-1).min() for i, j in pairs), default=np.inf)


def world(name, numbers, effects=(), **changes):
    """Settings of a preset with some numbers changed."""
    return preset(name, effects, **{**numbers, **changes})
