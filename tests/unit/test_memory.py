"""Noise with a memory beside a law, and findings tested by the whole search on simulated data."""

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from scipy.stats import chi2

from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.bootstrap import ENOUGH, LEAST, _decided, _tail, bootstrap, strength
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.memory import (
    estimate_memory,
    p_value_of,
    plausible_memories,
    search_with_memory,
    widened,
    with_memory,
)
from bsp_gp.loop.preparing import observe
from tests.worlds import WEIGHT, flights, linear_drag, nothing, red_noise, wind

STEP = 0.05
TRUE = -STEP / math.log(0.8)  # of red_noise


def searching(dataset, max_levels=4):
    law = declared_law(dataset, [WEIGHT])
    observation = observe(dataset, law, np.random.default_rng(0), sources=False)
    search = EffectSearch(observation, load_grammar("physics"), max_levels, n_null=99)
    return search, observation.fit(law)


def test_the_memory_of_red_noise_is_found_and_that_of_white_noise_is_none():
    found = []
    for seed in range(6):
        assert estimate_memory(*searching(flights(seed, nothing))).memory == 0
        noise = estimate_memory(*searching(flights(seed, nothing, noise=red_noise)))
        found.append(noise.memory)
        assert noise.gain > 50
    assert np.mean(found) == pytest.approx(TRUE, rel=0.15)


def test_a_law_is_not_taken_for_memory():
    search, fit = searching(flights(0, linear_drag))
    assert estimate_memory(search, fit).memory > 0  # the drag itself, where nothing may explain it
    new, _, proposals = search_with_memory(search, fit, np.random.default_rng(1))
    assert new.observation.memory == 0
    assert "norm(v_i)" in proposals.shortlist[0].text()


def test_a_declared_memory_is_believed():
    dataset = replace(flights(0, nothing, noise=red_noise), noise_memory=TRUE)
    search, fit = searching(dataset)
    assert search.observation.memory == TRUE and not search.observation.may_have_memory
    new, _, _ = search_with_memory(search, fit, np.random.default_rng(1))
    assert new is search


def test_red_noise_is_told_and_nothing_adopted():
    report = close_loop(
        flights(1, nothing, noise=red_noise), [WEIGHT], rng=np.random.default_rng(0), max_levels=4,
        n_null=99,
    )  # fmt: skip
    (done,) = report.rounds
    assert (done.adopted, done.verdict) == (False, "cannot tell")
    assert "memory" in done.reason
    assert report.noise["memory_s"] == pytest.approx(TRUE, rel=0.5)
    assert report.total["ratio"].value == 1


def test_memory_widens_what_is_estimated():
    dataset = replace(flights(0, nothing, noise=red_noise), noise=(0.02,))
    law = declared_law(dataset, ["g * m_i * down"])
    white = observe(dataset, law, np.random.default_rng(0), sources=False)
    red = with_memory(white, TRUE)
    assert red.fit(law).intervals[0] > 1.5 * white.fit(law).intervals[0]


def test_an_uncertain_memory_widens_intervals_further():
    data = flights(0, nothing, noise=red_noise, n_train=1)
    law = declared_law(data, ["g * m_i * down"])
    observation = observe(data, law, np.random.default_rng(0), sources=False)
    search = EffectSearch(observation, load_grammar("physics"), 4, n_null=99)
    fit = observation.fit(law)
    assert widened(search, fit) is fit  # white noise so far
    noise = estimate_memory(search, fit)
    assert 0.2 < noise.spread < 2.0
    search = search.on(with_memory(observation, noise.memory, noise.factor))
    fit = search.observation.fit(law)
    wide = widened(search, fit)
    assert wide.values is fit.values
    assert 1.02 < wide.intervals[0] / fit.intervals[0] < 2.0


def test_the_memory_of_many_tracks_is_known_better():
    few = estimate_memory(*searching(flights(0, nothing, noise=red_noise, n_train=2)))
    many = estimate_memory(*searching(flights(0, nothing, noise=red_noise, n_train=8)))
    assert many.spread < few.spread


def test_memories_that_the_noise_may_have():
    weights = {}
    for kind, noise in (("white", None), ("red", red_noise)):
        search, fit = searching(flights(0, nothing, noise=noise))
        found = plausible_memories(search, fit)
        assert sum(weight for weight, *_ in found) == pytest.approx(1.0)
        weights[kind] = {memory: weight for weight, memory, _ in found}
        assert all(factor == 1.0 for _, memory, factor in found if memory == 0)
    assert weights["white"][0.0] > 0.7 and max(weights["white"]) < 2 * STEP
    assert 0.0 not in weights["red"]
    mean = sum(memory * weight for memory, weight in weights["red"].items())
    assert mean == pytest.approx(TRUE, rel=0.35)


def test_white_noise_has_its_own_level_where_a_memory_was_taken_for_real():
    search, fit = searching(flights(0, nothing))
    level = search.observation.sigma[0]
    noise = estimate_memory(search, fit)
    assert noise.memory == 0
    search = search.on(with_memory(search.observation, STEP, 1.3))
    fit = search.observation.fit(fit.law)
    white = {m: factor for _, m, factor in plausible_memories(search, fit)}[0.0]
    assert white * search.observation.sigma[0] == pytest.approx(level, rel=0.1)


def test_a_memory_beyond_what_was_tried_is_never_asked_about():
    """A random walk: the likelihood hardly says how long the memory is."""
    walk = lambda rng, shape: 0.01 * np.cumsum(rng.standard_normal(shape), axis=0)  # noqa: E731
    data = flights(3, nothing, noise=walk, n_train=1)
    law = declared_law(data, ["g * m_i * down"])
    observation = observe(data, law, np.random.default_rng(0), sources=False)
    search = EffectSearch(observation, load_grammar("physics"), 4, n_null=99)
    noise = estimate_memory(search, observation.fit(law))
    search = search.on(with_memory(observation, noise.memory, noise.factor))
    fit = search.observation.fit(law)
    wide = widened(search, fit)
    assert np.isfinite(wide.intervals).all() and (wide.intervals >= 0.5 * fit.intervals).all()


def test_what_a_memory_would_explain_is_less_significant():
    """A slight push on one short track, in white noise and in noise with a memory."""
    grown = []
    for noise in (lambda rng, shape: 0.02 * rng.standard_normal(shape), red_noise):
        data = flights(4, lambda t, p, v, m, q: wind(t, p, v, m, q, c=0.1), noise=noise, n_train=1)
        search, before = searching(data)
        law = declared_law(data, [WEIGHT, "c * e_x"]).with_constants({"c": 0.0})
        after = search.observation.fit(law, start=law)
        p = 5 * chi2.sf(before.chisqr - after.chisqr, 1)
        grown.append(p_value_of(search, before, after, p) / p)
    assert 0.3 < grown[0] < 10
    assert grown[1] > 100


def test_a_strong_effect_stays_significant_whatever_the_memory():
    data = flights(0, linear_drag)
    search, before = searching(data)
    law = declared_law(data, [WEIGHT, "c * v_i"]).with_constants({"c": 0.0})
    after = search.observation.fit(law, start=law)
    assert p_value_of(search, before, after, 1e-12) < 1e-11


@pytest.mark.slow
def test_intervals_under_an_estimated_memory_cover_the_truth():
    """From one track, whose memory is hardly known; g and a drag, 90 %."""
    held = []
    for seed in range(60):
        data = flights(seed, linear_drag, noise=red_noise, n_train=1)
        law = declared_law(data, ["g * m_i * down", "c * v_i"])
        observation = observe(data, law, np.random.default_rng(0), sources=False)
        search = EffectSearch(observation, load_grammar("physics"), 4, n_null=99)
        noise = estimate_memory(search, observation.fit(law))
        search = search.on(with_memory(observation, noise.memory, noise.factor))
        fit = widened(search, search.observation.fit(law))
        held += list(np.abs(fit.values - (9.81, -0.3)) <= fit.intervals)
    # Three binomial standard errors either way.
    assert abs(np.mean(held) - 0.9) < 3 * np.sqrt(0.09 / len(held))


# --- bootstrap ------------------------------------------------------------------------------------


def test_it_stops_when_enough_findings_are_as_strong():
    strengths = [5.0] * ENOUGH
    done = _decided(strengths, 0, 4.0, 0.01, 99)
    assert done.p_value == 1 and done.n_done == ENOUGH
    assert _decided(strengths[:-1], 0, 4.0, 0.01, 99) is None


def test_it_stops_when_none_comes_near():
    strengths = list(np.random.default_rng(0).gumbel(3.0, 1.0, LEAST))
    far = _decided(strengths, 0, 40.0, 0.01, 99)
    assert far.is_extrapolated and far.p_value < 1e-6
    assert _decided(strengths, 0, max(strengths) + 0.5, 0.01, 99) is None
    assert _decided(strengths[:-1], 0, 40.0, 0.01, 99) is None
    assert _decided([*strengths[:-1], math.inf], 1, 40.0, 0.01, 99) is None


def test_the_tail_is_never_too_thin():
    assert _tail(np.full(19, 2.0), 12.0) > math.exp(-11)
    draws = np.random.default_rng(1).gumbel(0.0, 1.0, (4000, 19))
    at = -math.log(-math.log1p(-0.001))  # exceeded by one in a thousand
    assert np.mean([_tail(d, at) for d in draws] < np.float64(0.001)) < 0.1


def test_the_answer_does_not_depend_on_workers():
    search, fit = searching(flights(3, nothing, n_train=3, n_test=1), max_levels=3)
    _, _, proposals = search_with_memory(search, fit, np.random.default_rng(0), n_null=0)
    alone = bootstrap(search, fit, strength(proposals), np.random.default_rng(5))
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        shared = bootstrap(search, fit, strength(proposals), np.random.default_rng(5), workers=pool)
    assert alone == shared
    assert 0 < alone.p_value <= 1 and "simulated data sets" in alone.text()


def test_a_real_effect_is_beyond_what_is_simulated():
    search, fit = searching(flights(0, linear_drag, n_train=3, n_test=1), max_levels=3)
    _, _, proposals = search_with_memory(search, fit, np.random.default_rng(0), n_null=0)
    found = bootstrap(search, fit, strength(proposals), np.random.default_rng(5), n_max=LEAST + 5)
    assert found.p_value < 0.01 and found.is_extrapolated and found.n_as_strong == 0
