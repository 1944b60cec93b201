"""Strengths with a period: found with their rate where there is one, and else left alone."""

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.alternating import Alternating
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.pulsing import Pulsing
from bsp_gp.loop.view import View, selected
from tests.fitted_tracks import body, dataset_of, scene_of

SIGMA, RATE, SHARE = 0.003, 7.0, 0.3
SPRING = "k * (p_j - p_i)"


def beside_a_post(pull, start, times, name, rng):
    """A body that is pulled by ``pull(t, place)`` beside a post at the origin."""
    track = solve_ivp(
        lambda t, y: np.concatenate([y[2:], pull(t, y[:2])]), (0.0, times[-1]), start,
        t_eval=times, rtol=1e-9, atol=1e-10,
    )  # fmt: skip
    places = track.y[:2].T + SIGMA * rng.standard_normal((len(times), 2))
    places = np.stack([places, np.zeros_like(places)], axis=1)
    return scene_of(times, (body("bob"), body("post", is_static=True)), places, name=name)


def swung(share):
    """A body on a spring to a post, whose strength has a period."""
    rng, times, scenes = np.random.default_rng(2), np.linspace(0.0, 3.0, 80), []
    for k in range(3):
        start = np.concatenate([rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2)])
        scenes.append(beside_a_post(
            lambda t, p: -6.0 * (1 + share * np.cos(RATE * t)) * p, start, times, f"s{k}", rng
        ))  # fmt: skip
    return dataset_of(scenes, noise=(SIGMA, SIGMA))


def proposed(share):
    data = swung(share)
    hypothesis = Hypothesis.from_laws(data, [SPRING])
    found = fit(hypothesis, data, starts={"k": 6.0})
    view = View(found, continued(hypothesis, found), data, np.random.default_rng(0))
    family = Pulsing().propose(view)
    return data, family, selected(family.gain, family.rank, family.null, view.noise_dof, True)


def test_a_spring_whose_strength_has_a_period_is_found_with_its_rate():
    data, family, chance = proposed(SHARE)
    assert chance < 1e-6
    best = family.proposals[0]
    found = fit(best.hypothesis, data, starts=best.starts, bounds=best.bounds)
    values = found.law.constants
    assert found.chi2_red < 1.2
    assert abs(values["w1"] - RATE) < 0.1
    assert abs(np.hypot(values["a1"], values["b1"]) - SHARE) < 0.05


def test_a_steady_spring_is_left_alone():
    assert proposed(0.0)[2] > 0.01


def alternating():
    """Short flights past a post whose pull changes its sign, from known places."""
    rng, scenes = np.random.default_rng(3), []
    for k in range(16):
        times = np.linspace(0.0, 4.0, 16)
        place = rng.uniform(1, 4, 2) * rng.choice([-1, 1], 2)
        start = np.concatenate([place, rng.normal(0, 0.5, 2)])
        scenes.append(beside_a_post(
            lambda t, p: -np.cos(2.3 * t) * p / (p @ p), start, times, f"s{k}", rng
        ))  # fmt: skip
    return dataset_of(scenes, noise=(SIGMA, SIGMA))


def test_a_pull_that_alternates_about_nothing_is_found_with_its_rate():
    """Neither laws without time nor pushes with a period show it."""
    data = alternating()
    hypothesis = Hypothesis.from_laws(data, [])
    found = fit(hypothesis, data)
    view = View(found, continued(hypothesis, found), data, np.random.default_rng(0))
    laws = Laws(load_grammar("physics"), data)
    laws.propose(view)
    family = Alternating(laws, data).propose(view)
    assert selected(family.gain, family.rank, family.null, view.noise_dof, True) < 1e-6
    best = family.proposals[0]
    assert "inverse(norm(p_i - p_j)) * normalize(p_i - p_j)" in best.text
    fitted = fit(best.hypothesis, data, starts=best.starts, bounds=best.bounds)
    assert fitted.chi2_red < 1.2 and abs(fitted.law.constants["w1"] - 2.3) < 0.02
