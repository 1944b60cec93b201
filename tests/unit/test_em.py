import numpy as np
import pytest

from bsp_gp.errors import SettingsError
from bsp_gp.inference.beam import Beam, contains_latent
from bsp_gp.inference.e_step import EStep
from bsp_gp.inference.em import EmSettings, fit_em
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.m_step import Exhaustive, averaged_regression
from bsp_gp.language.grammar import load_grammar
from bsp_gp.physics.bodies import dataset_types
from tests.latent_worlds import PULL, dataset, grammar_file, law_of, masses_of, scenes

QUICK = EmSettings(
    e_step=EStep(n_eff=60, max_steps=400), final=EStep(n_eff=100, max_steps=600), refine=False
)
LIKELIHOOD = Likelihood(sigma=0.002)


@pytest.fixture(scope="module")
def grammar(tmp_path_factory):
    path = grammar_file(tmp_path_factory.mktemp("grammar"))
    return load_grammar(path).masked(set(dataset_types(dataset(1))), 2)[0]


@pytest.fixture(scope="module")
def learnt(grammar):
    some = scenes(2)
    return fit_em(
        some, masses_of(some), grammar, LIKELIHOOD, rng=np.random.default_rng(0), settings=QUICK,
        m_step=Exhaustive(max_levels=7, top_k=10),
    )  # fmt: skip


@pytest.mark.slow
def test_law_and_masses_are_learnt_together(learnt):
    text = learnt.best.text
    assert "m_i * m_j / norm(p_i - p_j)^2" in text
    assert abs(learnt.best.profile.constants[0]) == pytest.approx(20, rel=1e-6)
    assert learnt.best.profile.values == pytest.approx(masses_of(scenes(2)).truth, rel=1e-5)
    assert learnt.best.loss < 1e-9


def test_the_trace_begins_with_the_prior_and_keeps_every_law(learnt):
    first, second = learnt.trace[:2]
    assert (first.iteration, first.law_text, first.posterior.method) == (0, "0", "prior")
    assert np.isfinite(second.expected_log_joint) and second.n_scored > 100
    assert learnt.n_scored == sum(step.n_scored for step in learnt.trace)
    assert "fit as well" in learnt.text() or "mass[s0:b1]" in learnt.text()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_answer(grammar, learnt):
    some = scenes(2)
    again = fit_em(
        some, masses_of(some), grammar, LIKELIHOOD, rng=np.random.default_rng(0), settings=QUICK,
        m_step=Exhaustive(max_levels=7, top_k=10),
    )  # fmt: skip
    assert np.array_equal(again.posterior.draws, learnt.posterior.draws)
    assert again.law.text() == learnt.law.text()


def test_em_alone_takes_the_m_steps_law_as_it_is(grammar):
    some = scenes(1)
    settings = EmSettings(
        use_beam=False, n_starts=1, max_iterations=1, refine=False, final=None,
        e_step=EStep(n_eff=50, max_steps=200),
    )  # fmt: skip
    em = fit_em(
        some, masses_of(some), grammar, LIKELIHOOD, rng=np.random.default_rng(2),
        settings=settings, m_step=Exhaustive(max_levels=5, top_k=5),
    )  # fmt: skip
    assert len(em.contenders) == 1
    assert em.contenders[0].law.constants != em.best.profile.law.constants


@pytest.mark.slow
def test_terms_that_are_there_already_are_kept_and_refitted(grammar):
    some = scenes(2, c2=2.0)
    base = law_of("-c1 * (mu_i * v_i)")
    em = fit_em(
        some, masses_of(some), grammar, LIKELIHOOD, rng=np.random.default_rng(0), settings=QUICK,
        m_step=Exhaustive(max_levels=7, top_k=10), base=base,
    )  # fmt: skip
    assert em.law.terms[0].formula == base.terms[0].formula
    assert em.law.constants["c1"] == pytest.approx(2.0, rel=1e-5)
    assert len(em.law.names) == 2 and em.best.loss < 1e-9


def test_the_expected_loss_is_the_mean_over_draws():
    some = scenes(1, noise=0.01)
    latents, law = masses_of(some), law_of(PULL, c1=20.0)
    draws = latents.sample(3, rng=np.random.default_rng(0))
    weights = np.array([0.5, 0.3, 0.2])
    stacked = averaged_regression(some, latents, draws, weights, LIKELIHOOD)
    each = LIKELIHOOD.misfit(law, latents, some).chisq(draws).sum(axis=1)
    assert np.square(stacked.residual(law)).sum() == pytest.approx(weights @ each)


@pytest.mark.parametrize(
    ("text", "columns", "answer"),
    [
        ("c1 * m_i * v_i", {"mass"}, False),
        ("c1 * v_i", {"mass"}, True),
        ("c1 * m_i * m_j * normalize(p_j - p_i)", {"mass"}, True),
        ("c1 * m_i * m_j / m_j * v_i", {"mass"}, False),
        ("c1 * m_i * mu_j * v_i", {"friction"}, True),
        ("c1 * m_i * mu_j * v_i", {"mass"}, False),
    ],
)
def test_masses_cancel(text, columns, answer):
    (term,) = law_of(text).terms
    assert contains_latent(term, columns) is answer


def test_places_are_reserved_for_laws_with_a_latent(grammar):
    from bsp_gp.search.candidate import Candidate

    some = scenes(1)
    beam = Beam(some, masses_of(some), LIKELIHOOD, n_best=1, n_reserved=1)
    laws = ["c1 * m_i * v_i", "c1 * m_i * v_j", "c1 * m_i * m_j * v_i"]
    candidates = [
        Candidate(law_of(text).terms[0].formula, "pair", {"c1": 1.0}, float(k), 20.0, 1.0, 1.0)
        for k, text in enumerate(laws)
    ]
    assert [c.loss for c in beam.choose(candidates)] == [0.0, 2.0]


def test_bad_settings_are_refused():
    with pytest.raises(SettingsError, match="n_starts"):
        EmSettings(n_starts=0)
    assert EmSettings.for_noise(Likelihood("gls", sigma=1.0)).beta == 1.0
