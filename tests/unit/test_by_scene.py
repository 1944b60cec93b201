"""Laws with a constant of each scene: found where one for all does not do, and only there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposers.by_scene import ByScene
from bsp_gp.loop.view import selected
from bsp_gp.physics.bodies import dataset_types
from tests.loop_views import throws, view_of

TEXTS = ("c1 * v_i", "c1 * e_x", "c1 * m_i * perp(v_i)")


def blown(pushes):
    """Throws of unit masses, each scene in a wind of its own."""
    data = throws(np.random.default_rng(3), n_scenes=len(pushes), sigma=0.002)
    scenes = []
    for scene, push in zip(data.scenes, pushes, strict=True):
        crew = tuple(replace(e, properties={"mass": 1.0}) for e in scene.entities)
        shift = 0.5 * push * scene.times[:, None, None] ** 2 * [1, 0]
        scenes.append(replace(scene, positions=scene.positions + shift, entities=crew))
    return replace(data, scenes=tuple(scenes))


def proposed(pushes):
    data = blown(pushes)
    view, types = view_of(data), dataset_types(data)
    laws = SimpleNamespace(common=[parse_formula(text, types) for text in TEXTS])
    family = ByScene(laws).propose(view)
    return data, family, selected(family.gain, family.rank, family.null, view.noise_dof)


def test_winds_of_both_signs_are_found():
    pushes = np.array([0.3, -0.4, 0.1, -0.1, 0.25])
    data, family, chance = proposed(pushes)
    assert chance < 1e-6
    best = family.proposals[0]
    assert best.text == "c1[scene] * e_x"
    found = fit(best.hypothesis, data)
    table = found.law.constants["c1[scene]"]
    assert list(table.values()) == pytest.approx(pushes, abs=0.02)
    assert found.chi2_red < 1.2


def test_one_wind_for_all_needs_no_numbers_of_scenes():
    assert not proposed(np.full(5, 0.3))[1].proposals


def test_nothing_is_left_alone_and_two_scenes_are_not_asked():
    _, family, chance = proposed(np.zeros(5))
    assert chance > 0.01 and not family.proposals
    assert not proposed(np.array([0.3, -0.3]))[1].n_tried
