"""Laws as a proposer: in space as in the plane."""

import numpy as np

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.view import View
from tests.fitted_tracks import body, dataset_of, scene_of


def test_laws_in_space_are_told_apart():
    rng, times = np.random.default_rng(0), np.linspace(0.0, 1.0, 25)
    scenes = []
    for k in range(3):
        start = rng.uniform(-3.0, 3.0, 3)
        places = start * times[:, None] + np.array([0.0, 0.0, 0.2]) * times[:, None] ** 2
        places = places + 0.005 * rng.standard_normal(places.shape)
        scenes.append(scene_of(times, (body("ball"),), places[:, None], name=f"s{k}"))
    data = dataset_of(scenes, noise=(0.005, 0.005, 0.005))
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    family = Laws(load_grammar("physics"), data, max_levels=6).propose(view)
    first = family.proposals[0]
    assert "e_z" in first.text
    keys = [p.key for p in family.proposals[:50]]
    assert len(set(keys)) > 1 and keys.count(first.key) == 1


def test_a_measured_spin_across_the_velocity_leads():
    rng, times, scenes = np.random.default_rng(0), np.linspace(0.0, 1.0, 30), []
    for k in range(4):
        spin, start = rng.uniform(-1.0, 1.0, 3), rng.uniform(-4.0, 4.0, 3)
        turn = 0.3 * np.array([np.cross(spin, axis) for axis in np.eye(3)]).T
        places = np.array([_turned(turn, start, t) for t in times])
        places = places + 0.003 * rng.standard_normal(places.shape)
        ball = body("ball", properties={"spin": tuple(spin)})
        scenes.append(scene_of(times, (ball,), places[:, None], name=f"s{k}"))
    data = dataset_of(scenes, noise=(0.003,) * 3)
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    family = Laws(load_grammar("physics"), data, max_levels=6).propose(view)
    assert next(p.text for p in family.proposals if len(p.formulas) == 1) == (
        "c1 * cross(spin_i, v_i)"
    )


def _turned(turn, start, time):
    """Displacement under v' = turn v, by its series."""
    total, term = np.zeros(3), start * time
    for k in range(2, 40):
        total, term = total + term, turn @ term * time / k
    return total
