"""Errors of constants from how parts of the tracks disagree."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.jackknife import jackknife_errors
from bsp_gp.fitting.law_fit import constant_estimates

RATE, NOISE = 4.0, 1e-3


def swinging(n_scenes, rng, noise=NOISE, stiffer=0.0):
    """A body on a spring that is stiffer where it is stretched."""
    scenes, times = [], 0.05 * np.arange(60)
    for k in range(n_scenes):
        state, places = np.array([rng.uniform(0.5, 1.5), rng.uniform(-1, 1)]), []
        for _ in times:
            places.append(state[0])
            for _ in range(50):  # symplectic, of small steps
                x = state[0] + 0.0005 * state[1]
                v = state[1] - 0.001 * RATE * x * (1 + stiffer * x * x)
                state = np.array([x + 0.0005 * v, v])
        places = np.array(places) + noise * rng.standard_normal(len(times))
        places = np.stack([places, 0 * times], axis=1)[:, None]
        scenes.append(Scene(str(k), times, places, (Entity("bob", properties={"mass": 1.0}),)))
    return Dataset("springs", tuple(scenes))


def fitted(dataset):
    hypothesis = Hypothesis.from_laws(dataset, ["c1 * (origin - p_i)"])
    return fit(hypothesis, dataset)


@pytest.mark.parametrize("n_scenes", [1, 24])
def test_of_noise_alone_they_are_as_the_information_has_them(n_scenes):
    ratios = []
    for stream in np.random.default_rng(5).spawn(12):
        found = fitted(swinging(n_scenes, stream))
        errors, n_parts = jackknife_errors(found)
        assert n_parts == (4 if n_scenes == 1 else 8)
        ratios.append(float(errors[0] / found.errors[0]))
    assert 0.5 < np.median(ratios) < 2.0


@pytest.mark.parametrize("n_scenes", [1, 8])
def test_where_more_than_noise_is_left_intervals_hold_what_parts_of_the_tracks_say(n_scenes):
    """An unseen body's mass was told to a tenth of the error that its Moon made."""
    rng = np.random.default_rng(7)
    dataset = swinging(n_scenes, rng, noise=1e-6, stiffer=0.02)
    found = fitted(dataset)
    (told,) = constant_estimates(found, dataset)
    half = (told.high - told.low) / 2
    assert half > 50 * found.errors[0]
    for part in halves(dataset):
        assert abs(fitted(part).values[0] - told.value) < 3 * half


def test_a_law_without_constants_has_none():
    dataset = swinging(1, np.random.default_rng(0))
    errors, _ = jackknife_errors(fit(Hypothesis.from_laws(dataset, []), dataset))
    assert errors.shape == (0,)


def halves(dataset):
    """Its scenes, or the one that it has, in two."""
    if len(dataset.scenes) > 1:
        parts = dataset.scenes[::2], dataset.scenes[1::2]
    else:
        (scene,) = dataset.scenes
        parts = [
            (replace(scene, times=scene.times[rows], positions=scene.positions[rows]),)
            for rows in (np.s_[:30], np.s_[30:])
        ]
    return [replace(dataset, scenes=tuple(part)) for part in parts]
