"""Throws with known defects, noise and pushes, and fits to them as proposers look at them."""

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.view import View
from tests.throws import SI

GRAVITY = "-9.81 [m/s^2] * m_i * e_y"


def throws(rng, *, n_scenes=4, n_bodies=1, n_rows=40, sigma=0.005, move=None, noise=None):
    """Bodies thrown in parallel fields; ``move(t, mass)`` adds displacements (T, 2).

    Parameters
    ----------
    noise : callable, optional
        ``noise(scene, shape)`` in place of white normal errors of size `sigma`.
    """
    t = 0.025 * np.arange(n_rows)
    scenes = []
    for s in range(n_scenes):
        places, crew = [], []
        for k in range(n_bodies):
            mass = rng.uniform(0.1, 0.5)
            start, v = rng.uniform((-1 + 3 * k, 3), (1 + 3 * k, 5)), rng.uniform((-4, 1), (4, 5))
            path = start + v * t[:, None] - 0.5 * 9.81 * np.square(t)[:, None] * [0, 1]
            places.append(path if move is None else path + move(t, mass))
            crew.append(Entity(str(k + 1), properties={"mass": mass}))
        exact = np.stack(places, axis=1)
        more = sigma * rng.standard_normal(exact.shape) if noise is None else noise(s, exact.shape)
        scenes.append(Scene(str(s + 1), t, exact + more, tuple(crew)))
    return Dataset("throws", tuple(scenes), noise=(sigma,), units=SI)


def edited(dataset, change, scene=0):
    """The data set with the positions of one scene changed in place."""
    from dataclasses import replace

    one = dataset.scenes[scene]
    positions = np.array(one.positions)
    change(positions)
    scenes = list(dataset.scenes)
    scenes[scene] = replace(one, positions=positions)
    return replace(dataset, scenes=tuple(scenes))


def view_of(dataset, *laws, seed=0):
    """The view of a fit of laws, gravity by default."""
    hypothesis = Hypothesis.from_laws(dataset, laws or (GRAVITY,))
    found = fit(hypothesis, dataset)
    return View(found, continued(hypothesis, found), dataset, np.random.default_rng(seed))
