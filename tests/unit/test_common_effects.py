"""Effects that are looked for by name: common ones, a period, an exponent of a declared term."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.declared_exponents import exponent_attempts
from bsp_gp.loop.known import PRIOR_NATS, joined
from bsp_gp.loop.models import Attempt
from bsp_gp.loop.periodic import periodic_attempts
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.residual import examine_residual
from tests.worlds import WEIGHT, flights, orbits

GRAVITY = "G * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
SIGMA = 0.005


def fitted(data, declared, sources=False):
    law = declared_law(data, [declared])
    observation = observe(data, law, np.random.default_rng(0), sources=sources)
    return observation, evaluate(observation, law)


def examined(data, declared=WEIGHT, sources=False):
    observation, model = fitted(data, declared, sources)
    return observation, model, examine_residual(observation, model.fit, 0.01)


def nothing(t, p, v, m, q):
    return np.zeros_like(p)


def dragged(t, p, v, m, q):
    return -0.01 * v


def pushed(t, p, v, m, q):
    return 3.0 * np.cos(2 * np.pi * t / 0.5 + 0.7) * np.array([1.0, 0.0])


def test_a_score_is_what_the_effect_would_gain():
    """Rao's statistic of a weak effect is the fall of chi-squared when its term is fitted."""
    data = replace(flights(1, dragged, sigma=SIGMA), noise=(SIGMA,))
    observation, model, missing = examined(data)
    found = {d.name: d for d in missing.directions}["drag, linear in speed"]
    law = model.law.plus(declared_law(data, ["c1 * v_i"]).terms[0], {"c1": 0.0})
    gain = model.fit.chisqr - observation.fit(law).chisqr
    score = chi2.isf(found.p_value / found.n_tried, 1)
    assert gain > 10
    assert score == pytest.approx(gain, rel=0.05)


def test_common_effects_are_not_seen_in_noise():
    p = []
    for seed in range(12):
        _, _, missing = examined(flights(seed, nothing, sigma=SIGMA))
        p.append(missing.directions[0].p_value)
        names = [d.name for d in missing.directions]
        assert "drag, square in speed" in names and len(set(names)) == len(names)
    assert min(p) > 1e-4
    assert np.mean(np.array(p) < 0.2) < 0.6


def test_in_three_dimensions_nothing_is_across_the_velocity():
    _, _, missing = examined(flights(0, nothing, sigma=SIGMA, n_dims=3))
    names = [d.name for d in missing.directions]
    assert "a push along z" in names and not [n for n in names if "across" in n]


def test_a_period_is_found_with_its_size():
    observation, model, missing = examined(flights(2, pushed, sigma=SIGMA))
    rhythm = missing.rhythm
    assert rhythm.p_value < 1e-6
    assert rhythm.axes == (0,)
    assert 2 * np.pi / rhythm.frequency == pytest.approx(0.5, rel=0.1)
    same_force, same_acceleration = periodic_attempts(observation, model, rhythm)
    law = same_force.law
    assert same_force.fit.chisqr < same_acceleration.fit.chisqr
    assert 2 * np.pi / law.constants["w1"] == pytest.approx(0.5, rel=0.01)
    assert abs(law.constants["a1"]) == pytest.approx(3.0, rel=0.15)
    assert same_force.p_value == rhythm.p_value
    assert "0.5" in same_force.name


def test_a_steady_push_has_no_period():
    """An arc is taken out of every track first: what is slow is left to the laws."""
    _, _, missing = examined(flights(3, lambda t, p, v, m, q: np.array([0.5, 0.0]), sigma=SIGMA))
    assert missing.is_missing
    assert missing.rhythm.p_value > 1e-3


def test_a_periodic_push_is_adopted_by_the_loop():
    report = close_loop(
        flights(2, pushed, sigma=SIGMA), [WEIGHT], rng=np.random.default_rng(0), max_rounds=1
    )
    (done,) = report.rounds
    assert done.adopted and "period" in done.effect.name
    assert {c.name for c in done.effect.constants} == {"a1", "w1", "f1"}
    assert report.to_dict()["rounds"][0]["missing"]["rhythm"]["axes"] == [0]


def test_a_wrong_exponent_is_found_with_its_value():
    data = orbits(0, exponent=2.05)
    observation, model = fitted(data, GRAVITY, sources=True)
    (attempt,) = exponent_attempts(observation, model)
    (name,) = attempt.freed
    k = [n for n, _ in attempt.fit.parameters].index(name)
    value, half = attempt.fit.values[k], attempt.fit.intervals[k]
    assert value == pytest.approx(-0.05, abs=3 * half)
    assert half < 0.02
    assert attempt.name.startswith("exponent of norm(p_i - p_j)")
    assert not attempt.redoes_declared and not attempt.reason


def test_a_declared_number_is_held_at_a_typical_distance_or_freed_as_well():
    data = orbits(0, exponent=2.0)
    declared = GRAVITY.replace("G", "1 [m^3/(kg s^2)]")
    observation, model = fitted(data, declared, sources=True)
    held, freed = exponent_attempts(observation, model)
    assert len(held.freed) == 1 and not held.redoes_declared
    assert len(freed.freed) == 2 and freed.redoes_declared and "number" in freed.reason
    assert freed.fit.chisqr <= held.fit.chisqr * (1 + 1e-6)


def test_a_law_without_a_power_has_no_exponent_to_change():
    observation, model = fitted(flights(0, nothing, sigma=SIGMA), WEIGHT)
    assert exponent_attempts(observation, model) == []


def test_a_common_effect_that_the_search_finds_as_well_keeps_its_prior():
    observation, model = fitted(flights(0, dragged, sigma=SIGMA), WEIGHT)
    searched = Attempt(model.law, model.fit, 9.0, "drag", "c1 * v_i", "", "field")
    other = replace(searched, text="c1 * e_x")
    known = replace(searched, complexity=PRIOR_NATS, p_value=1e-6)
    both, alone = joined([searched, other], [known])
    assert (both.text, both.complexity, both.p_value) == ("c1 * v_i", PRIOR_NATS, 1e-6)
    assert alone is other
    simple = replace(searched, complexity=2.0)
    assert joined([simple], [known])[0].complexity == 2.0
