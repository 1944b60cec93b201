"""The paper's SYNTH scenarios with unknown properties: data, true laws, priors, noise."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from common import reference_data

from bsp_gp.data.tables import load_dataset
from bsp_gp.inference.latents import latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.priors import Prior
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.physics.likelihood import build_regression

TOUCHING = {13, 22, 30, 42, 44, 45, 51, 52, 74, 82, 84, 97}
"""NBODY scenes in which bodies touch, so that a collision acts beside gravity."""
TRAIN, TEST = range(1, 81), range(81, 101)
EQUAL = 1e-10
LAWS = {
    "nbody": ("c1 * (m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i))", 8167.007),
    "bounce": (
        "c1 * (m_i * m_j / (m_i + m_j) * project(v_i - v_j, normalize(p_i - p_c)) "
        "* normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j))",
        100.0,
    ),
    "mat": ("c1 * (mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j))", -0.8),
}


@dataclass(frozen=True)
class Scenario:
    """What a scenario leaves unknown.

    `level` is the protocol's noise level: sigma of the one-step likelihood, and the level of the
    several-step one.
    """

    name: str
    column: str
    prior: Prior
    level: float

    def is_unknown(self, scene, entity):
        if self.name == "mat":
            return entity.shape == "rect_mat"
        return not entity.is_static and entity.mass < 100  # the central body is known


SCENARIOS = {
    "nbody": Scenario("nbody", "mass", Prior("uniform", 0.02, 9.0), 0.01),
    "bounce": Scenario("bounce", "mass", Prior("uniform", 0.02, 9.0), 0.01),
    "mat": Scenario("mat", "friction", Prior("uniform", 5.0, 20.0), 0.001),
}


@cache
def dataset_of(name):
    return load_dataset(reference_data("synth", name))


@cache
def grammar_of(name):
    dataset = dataset_of(name)
    return load_grammar("newtonian").masked(set(dataset_types(dataset)), dataset.n_dims)[0]


@cache
def true_law(name):
    text, constant = LAWS[name]
    formula = parse_formula(
        text, dataset_types(dataset_of(name)), operators=load_grammar("newtonian").operators
    )
    law = ForceLaw((Term(formula),))
    return law.with_constants({law.names[0]: constant})


def scenes_of(name, numbers):
    return tuple(dataset_of(name).select([str(n) for n in numbers]))


def unknowns(name, scenes):
    scenario = SCENARIOS[name]
    return latents_of(scenes, scenario.column, scenario.prior, entities=scenario.is_unknown)


def likelihood_of(name, noise=0.0):
    """One step with the protocol's level for exact data; GLS with the noise's sigma otherwise.

    Posteriors under noise use its `for_posterior`.
    """
    if noise:
        return Likelihood("gls", sigma=noise, drops_unsure=True)
    return Likelihood("one_step", sigma=SCENARIOS[name].level)


def five_step(name):
    """The protocol's literal likelihood of the E-step."""
    return Likelihood("ahead", sigma=SCENARIOS[name].level, n_ahead=5)


def with_noise(scenes, sigma, rng):
    """White noise on the places of moving bodies."""
    if not sigma:
        return tuple(scenes)
    out = []
    for scene in scenes:
        positions = np.array(scene.positions)
        moving = scene.dynamic
        positions[:, moving] += sigma * rng.standard_normal(positions[:, moving].shape)
        out.append(replace(scene, positions=positions))
    return tuple(out)


@cache
def _everywhere(name):
    regression = build_regression(dataset_of(name).scenes)
    return regression, _direction(regression, true_law(name).terms[0].formula)


def _direction(regression, formula):
    _, rest = split_linear(formula)
    column = regression.column(Term(rest, "pair"))[0][:, 0]
    size = np.linalg.norm(column)
    return column / size if size > 0 else column


def is_true(name, formula):
    """Whether a formula is the true law up to its constant, on all 100 scenes."""
    regression, true = _everywhere(name)
    return bool(abs(abs(_direction(regression, formula) @ true) - 1) < EQUAL)
