"""Declared noise that the pure error contradicts: a hypothesis beside the causes."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, TrackNoise
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.noise import Noise
from bsp_gp.loop.questions import noise_findings
from bsp_gp.loop.ready import Ready
from tests.loop_views import GRAVITY, throws, view_of

SIGMA = 0.005


def louder(rng):
    """A declared level that is half of the true one in one scene of four."""
    return lambda s, shape: SIGMA * (2.0 if s == 2 else 1.0) * rng.standard_normal(shape)


def with_memory(rng, shape, memory):
    """Errors of size one of which each is correlated with the last one."""
    steps, out = rng.standard_normal(shape), np.empty(shape)
    out[0] = steps[0]
    for k in range(1, len(out)):
        out[k] = memory * out[k - 1] + np.sqrt(1 - memory**2) * steps[k]
    return out


def remembered(seed, n_scenes):
    """Throws that lack nothing, of unknown noise with a memory."""
    rng = np.random.default_rng(seed)
    noise = lambda s, shape: SIGMA * with_memory(rng, shape, 0.8)  # noqa: E731
    return replace(throws(rng, n_scenes=n_scenes, noise=noise), noise=None)


def proposed(view):
    view.noise_findings = noise_findings(view)
    return Noise().propose(view).proposals


def test_declared_noise_is_believed_while_nothing_speaks_against_it():
    rng = np.random.default_rng(1)
    assert proposed(view_of(throws(rng))) == ()


def test_declared_noise_that_is_contradicted_is_estimated():
    rng = np.random.default_rng(1)
    view = view_of(throws(rng, noise=louder(rng)))
    (proposal,) = proposed(view)
    assert proposal.kind == "noise"
    assert view.fit.noise.is_free.tolist() == [False, False]
    assert proposal.hypothesis.noise.is_free.tolist() == [True, True]


@pytest.mark.slow
@pytest.mark.parametrize("is_odd", [True, False])
def test_a_missing_force_is_found_whether_the_declared_noise_is_true_or_not(is_odd):
    rng = np.random.default_rng(2)

    def move(t, mass):
        return np.outer(0.5 * 0.4 / mass * t**2, [1.0, 0.0])

    data = throws(rng, n_scenes=6, move=move, noise=louder(rng) if is_odd else None)
    report = close_loop(data, GRAVITY, rng=0)
    assert report.verdict == "effect adopted"
    assert [done.verdict for done in report.rounds].count("effect adopted") == 1
    (constant,) = report.constants
    assert constant.low - 0.02 < 0.4 < constant.high + 0.02


@pytest.mark.slow
def test_odd_noise_alone_is_no_effect():
    rng = np.random.default_rng(3)
    report = close_loop(throws(rng, n_scenes=6, noise=louder(rng)), GRAVITY, rng=0)
    assert report.verdict in ("the noise is not as assumed", "nothing missing")


def test_noise_is_a_rival_of_a_quick_force_and_no_more():
    def move(t, mass):
        return np.outer(0.05 * np.sin(25 * t), [1.0, 0.0])

    data = throws(np.random.default_rng(4), move=move)
    view = view_of(data)
    assert len(proposed(view)) == 1
    assert min(f.p_value for f in view.noise_findings) < 1e-6, "the questions alone are misled"
    report = close_loop(data, GRAVITY, rng=0, n_bootstrap=0, max_rounds=1)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "period"


def test_a_slow_weak_memory_is_proposed_whatever_forces_explain():
    """Slow errors were taken for kicks and unseen bodies, which explain as much of them."""

    rng = np.random.default_rng(5)

    def slow(s, shape):
        correlated = np.sqrt(0.4) * with_memory(rng, shape, 0.95)
        return SIGMA * (correlated + np.sqrt(0.6) * rng.standard_normal(shape))

    data = replace(throws(rng, n_scenes=5, noise=slow), noise=None)
    (proposal,) = proposed(view_of(data))
    assert proposal.text == "a memory of the noise"
    report = close_loop(data, GRAVITY, rng=0, n_bootstrap=0)
    assert report.verdict in ("the noise is not as assumed", "nothing missing")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_memory_of_the_noise_is_not_taken_for_forces_however_many_tracks_there_are(seed):
    """A memory was given up by some nats for each track, whose first state it tells less of."""
    rng = np.random.default_rng(seed)

    def slow(s, shape):
        return SIGMA * with_memory(rng, shape, 0.8)

    view = view_of(replace(throws(rng, n_scenes=5, n_rows=20, n_bodies=4, noise=slow), noise=None))
    assert view.fit.noise.correlated > 0.5
    assert not view.is_memory_doubted


@pytest.mark.parametrize("lacks", [False, True])
def test_a_memory_is_told_from_all_that_is_left_unless_forces_do_more_than_chance(lacks):
    """Forces that know no physics take most of a slow noise off, and all of what a law lacks."""
    rng = np.random.default_rng(0)

    def slow(s, shape):
        return SIGMA * with_memory(rng, shape, 0.8)

    def move(t, mass):
        return np.outer(0.4 * np.sin(6 * t), [1.0, 0.0])

    changes = {"move": move} if lacks else {"noise": slow}
    data = replace(throws(rng, n_scenes=2, n_rows=40, **changes), noise=None)
    law = Hypothesis.from_laws(data, GRAVITY)
    noise = replace(fit(law, data).noise.plain(), correlated=0.9, correlation_time=0.1)
    beside = fit(law + TrackNoise(noise, is_given=True), data).noise
    alone = fit(law + TrackNoise(noise, is_given=True, is_all=True), data).noise
    if lacks:
        assert alone == beside
    else:
        assert alone != beside
        assert alone.levels == pytest.approx((SIGMA, SIGMA), rel=0.4)


@pytest.mark.parametrize("seed", [2, 4])
def test_a_fit_comes_to_its_end_beside_noise_that_looks_like_forces(seed):
    data = remembered(seed, 1)
    law = Hypothesis.from_laws(data, ["c1 * m_i * e_y"])
    found = fit(law, data, near=view_of(data).near, effort=600)
    assert found.status == "converged"


def test_a_memory_of_the_noise_is_known_in_held_out_scenes():
    data, rng = remembered(0, 5), np.random.default_rng(0)
    ready = Ready(data, GRAVITY, rng)
    found = fit(ready.hypothesis, ready.train)
    assert found.noise.correlated > 0
    noise = ready.swapped(found.noise).hypothesis.noise
    assert noise.is_correlation_known
    assert noise.correlation_time == found.noise.correlation_time
    white = replace(found.noise, correlated=0.0, correlation_time=0.0)
    assert not ready.swapped(white).hypothesis.noise.is_correlation_known


def test_noise_with_a_memory_is_asked_for_again_where_it_was_told_beside_other_forces():
    """What is slow in a memory passes for a force where it is told beside what forces might do."""
    rng = np.random.default_rng(3)
    noise = lambda s, shape: SIGMA * with_memory(rng, shape, 0.9)  # noqa: E731
    view = view_of(replace(throws(rng, n_rows=80, noise=noise), noise=None))
    assert view.fit.noise.correlated
    (proposal,) = proposed(view)
    assert proposal.hypothesis.leaves_noise
    alone = fit(proposal.hypothesis, view.dataset, near=view.fit)
    assert alone.noise.correlated and alone.log_likelihood > view.fit.log_likelihood - 0.5
