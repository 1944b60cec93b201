import dataclasses

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import EvaluationError, LawError, SettingsError
from bsp_gp.inference.horizon import HorizonMisfit
from bsp_gp.inference.latents import latents_of
from bsp_gp.inference.likelihood import Likelihood
from bsp_gp.inference.misfit import DirectMisfit, ReducedMisfit, averaged
from bsp_gp.inference.priors import Prior
from bsp_gp.inference.separation import separate
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from tests.latent_worlds import DRAG, PULL, SI, law_of, masses_of, scenes

LAWS = {
    "pull": (PULL,),
    "pull and drag": (PULL, DRAG),
    "no mass in it": ("c1 * normalize(p_j - p_i)",),
    "a quotient": ("c1 * m_i * m_j / (m_i + m_j) * norm(v_i - v_j)^2 * normalize(v_i)",),
    "a declared number": ("3 [kg/s] * v_i",),
}

NO_PRODUCT = "c1 * (m_i + m_j * norm(v_i) / (norm(v_i) + norm(v_j))) * normalize(v_i)"


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("kind", ["one_step", "gls"])
@pytest.mark.parametrize("velocities", ["backward", "central"])
def test_compressed_and_direct_agree(name, kind, velocities):
    some = scenes(2, noise=0.01, c2=0.3)
    law, latents = law_of(*LAWS[name], c1=20.0, c2=0.3), masses_of(some)
    likelihood = Likelihood(kind, sigma=0.01, velocities=velocities)
    reduced = likelihood.misfit(law, latents, some)
    assert isinstance(reduced, ReducedMisfit)
    direct = DirectMisfit(law, latents, likelihood.regression(some), likelihood.is_smooth)
    rng = np.random.default_rng(0)
    values = latents.sample(7, rng=rng)
    constants = rng.uniform(0.5, 2, (7, len(law.names))) * reduced.start
    assert reduced.chisq(values, constants) == pytest.approx(
        direct.chisq(values, constants), rel=1e-9
    )


def test_laws_that_are_no_product_are_evaluated_everywhere():
    some = scenes(1)
    law = law_of("c1 * (m_i + norm(p_i - p_j) * c2) * normalize(v_i)")
    misfit = Likelihood(sigma=0.1).misfit(law, masses_of(some), some)
    assert isinstance(misfit, DirectMisfit)
    (term,) = law_of(NO_PRODUCT).terms
    assert separate(term, {"mass"}) is None


def test_misfit_of_one_draw_is_that_of_the_filled_scenes():
    some = scenes(2)
    law, latents = law_of(PULL, c1=20.0), masses_of(some)
    likelihood = Likelihood(sigma=0.05)
    (draw,) = latents.sample(1, rng=np.random.default_rng(3))
    filled = likelihood.regression(latents.filled(some, draw))
    expected = np.square(filled.residual(law)).sum()
    assert likelihood.misfit(law, latents, some).chisq(draw[None]).sum() == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["one_step", "gls"])
@pytest.mark.parametrize("column", ["mass", "radius"])
def test_contacts_and_walls_for_many_draws_are_those_of_the_filled_scenes(column, kind):
    """Draws share the motion, also where the unknown property is a size and where rows differ."""
    rng = np.random.default_rng(4)
    wall = Entity("wall", "rect_wall", width=8.0, height=0.5, is_static=True)
    some = []
    for k, n_times in enumerate((12, 9)):
        discs = [Entity(f"d{j}", "disc", 0.5, properties={"mass": 1.0 + j}) for j in range(3)]
        positions = rng.uniform(-1, 1, (n_times, 4, 2))
        positions[:, 3] = (0.0, -1.0)
        some.append(Scene(f"w{k}", 0.1 * np.arange(n_times), positions, [*discs, wall]))
    prior = Prior("uniform", 0.3, 0.8)
    latents = latents_of(some, column, prior, entities=lambda scene, entity: entity.shape == "disc")
    types = dataset_types(Dataset("walls", some, units=SI))
    touch = "normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)"
    text = f"c1 * (m_i * norm(v_i) + m_i * norm(v_j)) * {touch}"
    law = ForceLaw((Term(parse_formula(text, types)),), {"c1": 3.0})
    likelihood = Likelihood(kind, sigma=0.05)
    misfit = likelihood.misfit(law, latents, some)
    direct = DirectMisfit(law, latents, likelihood.regression(some), likelihood.is_smooth)
    values = latents.sample(5, rng=rng)
    constants = np.linspace(2.0, 4.0, 5)[:, None]
    expected = []
    for draw, (c1,) in zip(values, constants, strict=True):
        regression = likelihood.regression(latents.filled(some, draw))
        expected.append(np.square(regression.residual(law.with_constants({"c1": c1}))).sum())
    assert len(set(np.round(expected, 6))) == 5
    for one in (misfit, direct):
        assert one.chisq(values, constants).sum(axis=1) == pytest.approx(expected, rel=1e-9)


def test_the_true_law_with_the_true_values_leaves_rounding():
    some = scenes(2)
    law, latents = law_of(PULL, c1=20.0), masses_of(some)
    misfit = Likelihood(sigma=0.01).misfit(law, latents, some)
    assert misfit.chisq(latents.truth[None]).sum() < 1e-15


def rolled_errors(law, scene, n_ahead):
    """The several-step errors by plain loops over instants and steps."""
    regression = build_regression([scene])
    bodies = regression.batches[0].bodies
    times, p = scene.times, scene.positions
    total = 0.0
    for t in range(1, len(times) - n_ahead):
        here, v = p[t], (p[t] - p[t - 1]) / (times[t] - times[t - 1])
        for k in range(n_ahead):
            h = times[t + k + 1] - times[t + k]
            a = law.acceleration(bodies, here[None], v[None], times[t + k : t + k + 1])[0]
            v = v + h * a
            here = here + h * v
            total += np.square(here - p[t + k + 1]).sum()
    return total / n_ahead


def test_several_steps_ahead_as_by_loops():
    (some,) = scenes(1, n_times=12)
    law, latents = law_of(PULL, c1=21.0), masses_of((some,))
    misfit = HorizonMisfit(law, latents, (some,), n_ahead=5, level=0.01)
    draws = latents.sample(3, rng=np.random.default_rng(1))
    expected = [
        -rolled_errors(law, latents.filled((some,), draw)[0], 5) / 0.01 for draw in draws
    ]
    assert misfit.log_likelihood(draws) == pytest.approx(expected, rel=1e-9)
    other = law_of(NO_PRODUCT)
    general = HorizonMisfit(other, latents, (some,), n_ahead=2, level=0.01)
    expected = [
        -rolled_errors(other, latents.filled((some,), draw)[0], 2) / 0.01 for draw in draws
    ]
    assert general.log_likelihood(draws) == pytest.approx(expected, rel=1e-9)


def test_numerov_is_exact_to_fourth_order():
    """An oscillation: second differences against accelerations, step halved."""
    errors = []
    for n in (20, 40):
        times = np.linspace(0, 2, n)
        some = scenes(1, n_times=n)[0]
        track = np.stack([np.sin(2 * times), np.cos(2 * times)], axis=1)
        positions = np.array(some.positions)
        positions[:, 1] = track
        scene = dataclasses.replace(some, times=times, positions=positions)
        (batch,) = build_regression([scene], method="gls").batches
        exact = -4 * np.array(batch.positions[:, :, batch.bodies.receivers])
        gap = (averaged(exact, batch) - batch.target)[1:-1, 0, 1]
        errors.append(np.abs(gap).max())
    assert errors[0] / errors[1] > 14  # 16 for the fourth order


def test_a_law_without_value_and_a_law_without_terms_are_refused():
    some = scenes(1)
    latents = masses_of(some)
    with pytest.raises(EvaluationError):
        Likelihood(sigma=1.0).misfit(law_of("c1 / norm(p_i - p_i) * v_i"), latents, some)
    with pytest.raises(LawError):
        Likelihood(sigma=1.0).misfit(ForceLaw(), latents, some)
    with pytest.raises(SettingsError, match="sigma"):
        Likelihood(sigma=0.0)
    with pytest.raises(SettingsError, match="likelihood must be"):
        Likelihood("three_step")


def test_rows_with_an_unsure_contact_are_left_out():
    x = np.linspace(-1.0, 1.0, 21)
    positions = np.zeros((21, 2, 2))
    positions[:, 0, 0] = x
    mat = Entity("mat", "rect_mat", width=1.0, height=1.0, is_static=True)
    scene = Scene("m", 0.1 * np.arange(21), positions, [Entity("ball", "disc", 0.1), mat])
    everything = build_regression([scene])
    fewer = build_regression([scene], unsure=0.12)
    lost = everything.batches[0].valid[:, 0, 0, 0] & ~fewer.batches[0].valid[:, 0, 0, 0]
    assert x[1:-1][lost] == pytest.approx([-0.6, -0.5, -0.4, 0.4, 0.5, 0.6])


@pytest.mark.parametrize("text", [PULL, NO_PRODUCT])
def test_propagated_noise_compressed_and_direct_agree(text):
    some = scenes(2, noise=0.02)
    law, latents = law_of(text, c1=20.0), masses_of(some)
    likelihood = Likelihood("propagated", sigma=0.02)
    misfit = likelihood.misfit(law, latents, some)
    draws = latents.sample(4, rng=np.random.default_rng(0))
    if isinstance(misfit, ReducedMisfit):
        bank = likelihood._propagated(law, latents, some)
        direct = bank.direct(law, latents)
        assert misfit.chisq(draws) == pytest.approx(direct.chisq(draws), rel=1e-8)
    else:
        assert np.isfinite(misfit.log_likelihood(draws)).all()


def test_propagated_noise_has_the_chi_squared_of_its_numbers():
    """Twenty tracks with noise: under the truth chi-squared is the number of rows, within 4 sd."""
    total, n = 0.0, 0
    for seed in range(20):
        clean = scenes(1, n_times=20)[0]
        noise = 0.05 * np.random.default_rng([3, seed]).standard_normal(clean.positions.shape)
        some = (dataclasses.replace(clean, positions=clean.positions + noise),)
        latents = masses_of(some)
        misfit = Likelihood("propagated", sigma=0.05).misfit(
            law_of(PULL, c1=20.0), latents, some
        )
        total += misfit.chisq(latents.truth[None]).sum()
        n += misfit.n_rows
    assert abs(total - n) < 4 * np.sqrt(2 * n)
