"""The paper's SYNTH scenes for the experiment scripts: data, noise, true laws."""

import functools
from dataclasses import replace

import numpy as np
from common import reference_data

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import EvaluationError
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.physics.likelihood import build_regression

LAWS = {
    "nbody": "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)",
    "mat": "c1 * mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)",
    "bounce": (
        "c1 * m_i * m_j / (m_i + m_j) * (abs(dot(v_i - v_j, e_x) * dot(normalize(p_i - p_c), e_x)) "
        "+ abs(dot(v_i - v_j, e_y) * dot(normalize(p_i - p_c), e_y))) "
        "* normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)"
    ),
}
FRESH = range(11, 31)
"""Scenes that tell laws apart; those of the tests are 81 to 100."""


class Scenario:
    """A SYNTH data set and the types of its inputs."""

    def __init__(self, name):
        self.dataset = load_dataset(reference_data("synth", name))
        self.types = set(dataset_types(self.dataset))
        self.input_types = dataset_types(self.dataset)

    def scene(self, name):
        return self.dataset.scene(name)


@functools.lru_cache(maxsize=3)
def scenario(name):
    """A SYNTH data set by name."""
    return Scenario(name)


def with_noise(scene, noise, rng):
    """The scene with white noise on the bodies that move."""
    if not noise:
        return scene
    positions = np.array(scene.positions)
    shape = positions[:, scene.dynamic].shape
    positions[:, scene.dynamic] += noise * rng.standard_normal(shape)
    return replace(scene, positions=positions)


def noisy_scenes(name, numbers, noise, seed):
    """Scenes by number, each with noise of its own stream."""
    return [
        with_noise(scenario(name).scene(str(k)), noise, np.random.default_rng((abs(seed), k)))
        for k in numbers
    ]


@functools.lru_cache(maxsize=3)
def _fresh(name):
    regression = build_regression([scenario(name).scene(str(k)) for k in FRESH])
    truth = split_linear(parse_formula(LAWS[name], scenario(name).input_types))[1]
    return regression, regression.column(Term(truth, "pair"))[0][:, 0]


def is_true(name, formula):
    """Whether a law is the true one up to a factor, on scenes that no search has seen."""
    regression, truth = _fresh(name)
    try:
        found = regression.column(Term(split_linear(formula)[1], "pair"))[0][:, 0]
    except EvaluationError:
        return False  # the true law has a value everywhere
    sizes = np.linalg.norm(truth) * np.linalg.norm(found)
    return bool(sizes > 0 and abs(truth @ found) > (1 - 1e-9) * sizes)
