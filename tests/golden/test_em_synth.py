"""EM on the paper's scenes with unknown properties: the law, or the class of laws that fit."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.inference.e_step import EStep
from bsp_gp.inference.em import CLASS_NATS, EmSettings, fit_em
from bsp_gp.inference.latents import latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.priors import Prior
from bsp_gp.inference.profile import fit_profile
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term

MAT = "c1 * (mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j))"
SETTINGS = EmSettings(
    refine=False, final=None, n_starts=1, e_step=EStep(n_eff=60, max_steps=400)
)


@pytest.fixture(scope="module")
def synth(shared_data):
    def load(name):
        folder = shared_data / "synth" / name
        if not folder.is_dir():
            pytest.skip(f"no reference data in {folder}")
        dataset = load_dataset(folder)
        grammar, _ = load_grammar("newtonian").masked(set(dataset_types(dataset)), 2)
        return dataset, grammar

    return load


@pytest.mark.slow
def test_gravity_is_learnt_with_three_unknown_masses_a_scene(synth):
    dataset, grammar = synth("nbody")
    scenes = dataset.select(["1", "2", "3"])
    latents = latents_of(scenes, "mass", Prior("uniform", 0.02, 9.0), entities=["2", "3", "4"])
    em = fit_em(
        scenes, latents, grammar, Likelihood(sigma=0.01), rng=np.random.default_rng(0),
        settings=SETTINGS,
    )  # fmt: skip
    assert em.best.text == "c1 * (m_i * m_j / norm(p_i - p_j)^2 * normalize(p_i - p_j))"
    assert em.best.profile.constants == pytest.approx([-8167.007], rel=1e-7)
    assert em.best.profile.values == pytest.approx(latents.truth, abs=1e-6)


def test_the_class_of_mat_is_listed(synth):
    """1/mu maps the prior's range onto itself: m / mu fits as well as m mu."""
    dataset, grammar = synth("mat")
    scenes = dataset.select(["1", "2", "3", "4", "5"])
    latents = latents_of(scenes, "friction", Prior("uniform", 5.0, 20.0), entities=["2"])
    likelihood = Likelihood(sigma=0.001)
    em = fit_em(
        scenes, latents, grammar, likelihood, rng=np.random.default_rng(0), settings=SETTINGS
    )
    true = ForceLaw((Term(parse_formula(MAT, dataset_types(dataset))),), {"c1": 1.0})
    profile = fit_profile(
        likelihood.misfit(true, latents, scenes),
        latents.sample(8, rng=np.random.default_rng(1)),
    )
    assert profile.loss <= em.best.loss + CLASS_NATS
    listed = {c.text for c in em.equivalents()}
    assert any("m_j / mu_j * normalize(v_i)" in text for text in listed)
    assert any("mu_j * (m_i * m_j) * normalize(v_i)" in text for text in listed)
