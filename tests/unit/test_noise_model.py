"""The noise of a fit: what is known stays, what is free is found, chance is not taken for more."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import FitError
from bsp_gp.fitting import noise_task
from bsp_gp.fitting.channels import Channels, join
from bsp_gp.fitting.noise_estimate import estimate, estimate_beside
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.noise_task import MAX_TIME
from bsp_gp.fitting.restricted import Restricted
from bsp_gp.fitting.student import log_likelihood
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.force import ForceLaw

STEP = 0.1


def channels(n_rows, n_scenes=1, n_bodies=1, n_dims=2):
    shape = (n_scenes, n_bodies, n_dims)
    scene, body, axis = np.indices(shape).reshape(3, -1)
    times = np.broadcast_to(STEP * np.arange(n_rows)[:, None], (n_rows, scene.size))
    return Channels(
        times=times,
        seen=np.ones(times.shape, dtype=bool),
        axis=axis,
        body=body,
        scene=scene,
        chain=scene,
        body_names=tuple(f"body{k}" for k in range(n_bodies)),
        scene_names=tuple(f"scene{k}" for k in range(n_scenes)),
    )


def free_model(n_dims=2, **changes):
    plain = NoiseModel((1.0,) * n_dims, ("estimated",) * n_dims, (1e-12,) * n_dims, (0.0,) * n_dims)
    return replace(plain, **changes)


def polynomials(found, degree):
    """A polynomial in time for every body and axis of a chain: what a fit has free locally."""
    t = found.times[:, 0] / found.times.max()
    places = {(b, a) for b, a in zip(found.body, found.axis, strict=True)}
    masks = [(found.body == b) & (found.axis == a) for b, a in sorted(places)]
    return np.array([t[:, None] ** k * mask for mask in masks for k in range(degree + 1)])


def drawn(model, found, rng):
    return model.whitener(found).colour(rng.standard_normal(found.times.shape))


def adopted(model):
    return [f.part for f in model.findings if f.is_adopted]


def dense_restricted(whitener_of, residual, columns):
    """Restricted log-likelihood and leverage from dense matrices, columns made orthonormal."""
    n = residual.size
    colour = whitener_of.colour(np.eye(n).reshape(n, *residual.shape)).reshape(n, n).T
    inverse = np.linalg.inv(colour @ colour.T)
    u, s, _ = np.linalg.svd(columns.reshape(len(columns), -1).T, full_matrices=False)
    u = u[:, s > 1e-9 * s[0]]
    gram = u.T @ inverse @ u
    y = residual.ravel()
    rest = inverse @ (y - u @ np.linalg.solve(gram, u.T @ inverse @ y))
    value = 2 * np.log(np.abs(np.linalg.det(colour))) + np.linalg.slogdet(gram)[1] + y @ rest
    white = np.linalg.qr(np.linalg.solve(colour, u))[0]
    n_left = n - u.shape[1]
    return -0.5 * (value + n_left * math.log(2 * math.pi)), n_left, 1 - (white**2).sum(axis=1)


def test_restricted_likelihood_is_that_of_dense_matrices():
    rng = np.random.default_rng(0)
    found = replace(channels(9, 3), chain=np.array([2, 0, 0, 2, 1, 1]))
    residual = rng.standard_normal(found.times.shape)
    shared, local = rng.standard_normal((3, 9, 6)), rng.standard_normal((4, 9, 6))
    local[3][:, found.chain == 1] = 0.0
    shared[2] = shared[1] + local[0] * (found.chain == 1)  # says nothing new
    every = [*shared, *(np.where(found.chain == k, x, 0.0) for x in local for k in range(3))]
    task = Restricted(residual, found.seen, found.chain, np.ones(found.times.shape), shared, local)
    for model in (
        free_model(),
        free_model(levels=(0.3, 2.0), correlated=0.6, correlation_time=0.3),
        free_model(correlated=1.0, correlation_time=0.01),
    ):
        whitener = model.whitener(found)
        value, n_left, remaining = dense_restricted(whitener, residual, np.array(every))
        assert task.n_rows - task.n_free == n_left
        assert task.value(whitener) == pytest.approx(value, rel=1e-10)
        error = task.pure_error(whitener)
        assert error.remaining.sum() == pytest.approx(n_left, rel=1e-10)
        np.testing.assert_allclose(error.remaining.ravel(), remaining, atol=1e-10)


def test_a_column_of_one_chain_is_as_good_shared_as_its_own():
    rng = np.random.default_rng(7)
    found = channels(12, 4)
    residual = rng.standard_normal(found.times.shape)
    shared, local = rng.standard_normal((2, 12, 8)), polynomials(found, 1)
    own = [rng.standard_normal((12, 8)) * (found.chain == k) for k in (0, 0, 1, 3)]
    known = residual, found.seen, found.chain, np.ones(found.times.shape)
    task = Restricted(*known, np.array([*shared, *own]), local)
    assert len(task._rows) == len(local) + 5  # two of chains, two shared, the residual
    whitener = free_model(levels=(0.3, 2.0), correlated=0.6, correlation_time=0.3).whitener(found)
    every = [*shared, *own, *(np.where(found.chain == k, x, 0.0) for x in local for k in range(4))]
    value, n_left, _ = dense_restricted(whitener, residual, np.array(every))
    assert task.n_rows - task.n_free == n_left
    assert task.value(whitener) == pytest.approx(value, rel=1e-10)


def test_levels_are_unbiased_where_most_rows_pay_for_local_numbers():
    found = channels(8, n_scenes=150)
    local = polynomials(found, 2)
    errors = np.array([0.01, 0.03])[found.axis] * np.random.default_rng(1).standard_normal(
        found.times.shape
    )
    model = estimate(free_model(), found, errors + 7.0 * local.sum(axis=0), local=local)
    sampling = 1 / math.sqrt(2 * 150 * 5)
    assert model.levels == pytest.approx((0.01, 0.03), rel=4 * sampling)
    assert adopted(model) == []


@pytest.mark.parametrize(
    "truth",
    [
        {"levels": (0.02, 0.05), "correlated": 0.7, "correlation_time": 0.5},
        {"levels": (0.02, 0.05), "speed_growth": 0.05},
    ],
)
def test_a_search_that_begins_on_a_sample_of_chains_ends_where_one_on_all_does(truth, monkeypatch):
    found = channels(12, n_scenes=120)
    rng = np.random.default_rng(6)
    speed = np.broadcast_to(rng.uniform(0.0, 2.0, (1, 240)), (12, 240))
    found = replace(found, speed=speed)
    errors, local = drawn(free_model(**truth), found, rng), polynomials(found, 1)
    whole = estimate(free_model(), found, errors, local=local)
    monkeypatch.setattr(noise_task, "_SAMPLE", 30)
    few = estimate(free_model(), found, errors, local=local)
    assert adopted(few) == adopted(whole) and adopted(whole)
    assert few.levels == pytest.approx(whole.levels, rel=1e-3)
    for name in truth:
        assert getattr(few, name) == pytest.approx(getattr(whole, name), rel=5e-3)


@pytest.mark.slow
def test_memory_is_recovered_beside_white_noise_and_local_columns():
    found = channels(40, n_scenes=25)
    local = polynomials(found, 1)
    shared = np.sin(np.outer([3.0, 5.0], found.times[:, 0]))[:, :, None] * np.cos(found.axis)
    truth = free_model(levels=(0.02, 0.05), correlated=0.7, correlation_time=0.5)
    seen = []
    for rng in np.random.default_rng(2).spawn(10):
        model = estimate(free_model(), found, drawn(truth, found, rng), shared, local)
        assert adopted(model) == ["correlation"]
        seen.append([*np.log(model.levels), model.correlated, np.log(model.correlation_time)])
    seen = np.array(seen)
    errors = seen.std(axis=0, ddof=1)
    assert np.all(errors < [0.06, 0.06, 0.1, 0.35])
    expected = [*np.log(truth.levels), 0.7, math.log(0.5)]
    assert np.all(np.abs(seen.mean(axis=0) - expected) < 4 * errors / math.sqrt(10))


@pytest.mark.slow
def test_a_memory_that_short_tracks_hardly_bound_is_neither_the_shortest_nor_the_longest():
    found = channels(40, n_scenes=4)
    local = polynomials(found, 6)
    truth = free_model(levels=(0.02, 0.02), correlated=1.0, correlation_time=4.5 * STEP)
    seen = []
    for rng in np.random.default_rng(5).spawn(30):
        model = estimate(free_model(), found, drawn(truth, found, rng), local=local)
        seen.append(math.log(model.correlation_time / truth.correlation_time))
    assert np.std(seen) < 0.3  # 0.48 by the maximum, which is often the longest that is allowed
    assert abs(np.mean(seen)) < 4 * np.std(seen) / math.sqrt(30)


@pytest.mark.parametrize(("strength", "expected"), [(0.0, []), (1.0, ["speed"])])
def test_what_shows_beside_probes_alone_must_need_the_probes(strength, expected):
    """Rows that probes follow by chance leave a rest that seems to grow with the speed."""
    found = channels(40)
    found = replace(found, speed=np.ones((40, 2)) * np.abs(np.arange(40) - 12.0)[:, None])
    every = polynomials(found, 20)
    is_own = np.arange(len(every)) % 21 < 2
    basis = np.linalg.qr(every.reshape(len(every), -1).T)[0]
    rng = np.random.default_rng(4)
    white, grown = rng.standard_normal((2, 80)) * [[0.022], [0.02]]
    grown *= found.speed.ravel() / np.sqrt(np.mean(np.square(found.speed)))
    errors = basis @ (basis.T @ white) + grown - basis @ (basis.T @ grown)
    lacks = strength * np.sin(5.0 * found.times / found.times.max())
    known = (free_model(), found, errors.reshape(40, 2) + lacks)
    assert adopted(estimate(*known, local=every)) == ["speed"]
    model = estimate_beside(*known, None, every[is_own], every[~is_own])
    assert adopted(model) == expected


def test_white_noise_is_not_said_to_have_parts():
    found = replace(channels(60, 3, 2), speed=np.ones((60, 12)) * np.arange(60)[:, None])
    local, claims = polynomials(found, 2), []
    for rng in np.random.default_rng(3).spawn(40):
        errors = 0.02 * rng.standard_normal(found.times.shape)
        claims += adopted(estimate(free_model(), found, errors, local=local))
    assert len(claims) <= 2  # 5 parts, 40 sets, one in a thousand: 0.2 expected


def test_a_body_and_a_scene_of_their_own_level_are_found():
    found = channels(80, 3, 2)
    factor = np.where(found.body == 1, 3.0, 1.0) * np.where(found.scene == 2, 2.0, 1.0)
    errors = 0.01 * factor * np.random.default_rng(4).standard_normal(found.times.shape)
    model = estimate(free_model(), found, errors, local=polynomials(found, 2))
    assert sorted(adopted(model)) == ["bodies", "scenes"]
    bodies, scenes = dict(model.bodies), dict(model.scenes)
    assert bodies["body1"] / bodies["body0"] == pytest.approx(3, rel=4 / math.sqrt(450))
    assert scenes["scene2"] / scenes["scene0"] == pytest.approx(2, rel=4 / math.sqrt(300))
    sizes = model.sizes(found)[0]
    np.testing.assert_allclose(sizes, 0.01 * factor, rtol=0.25)
    assert math.prod(bodies.values()) == pytest.approx(1)
    assert "body1" in model.describe() and "sigma[body body1]" in {p.name for p in model.parameters}


def test_jitter_of_time_stamps_is_found():
    speed = np.abs(5 * np.sin(np.arange(300) / 20))[:, None] * np.ones((1, 4))
    found = replace(channels(300, 2), speed=speed)
    size = np.sqrt(0.01**2 + (0.01 * speed) ** 2)
    errors = size * np.random.default_rng(5).standard_normal(size.shape)
    model = estimate(free_model(), found, errors, local=polynomials(found, 2))
    assert adopted(model)[0] == "speed"
    assert model.speed_growth == pytest.approx(0.01, rel=4 / math.sqrt(1200))
    assert model.levels == pytest.approx((0.01, 0.01), rel=0.4)


def test_tails_are_found_and_bad_rows_do_not_carry_the_level():
    found = channels(300, 2)
    errors = 0.01 * np.random.default_rng(6).standard_t(3, found.times.shape)
    model = estimate(free_model(), found, errors, local=polynomials(found, 2))
    assert adopted(model) == ["tails"]
    assert 2 < model.degrees < 4.5
    assert model.levels == pytest.approx((0.01, 0.01), rel=0.2)
    assert log_likelihood(model, found, errors) > 30 + log_likelihood(
        estimate(model.plain(), found, errors, adopt=False), found, errors
    )
    again = estimate(model, found, errors, local=polynomials(found, 2), adopt=False)
    assert again.degrees == pytest.approx(model.degrees, rel=0.02)


def test_plain_likelihood():
    found = channels(50)
    errors = np.random.default_rng(7).standard_normal(found.times.shape)
    model = free_model(levels=(0.5, 2.0))
    expected = stats.norm.logpdf(errors, scale=[0.5, 2.0]).sum()
    assert log_likelihood(model, found, errors) == pytest.approx(expected)
    expected = stats.t.logpdf(errors, 4.0, scale=[0.5, 2.0]).sum()
    assert log_likelihood(replace(model, degrees=4.0), found, errors) == pytest.approx(expected)
    with_memory = replace(model, correlated=0.5, correlation_time=0.3)
    limit = replace(with_memory, degrees=1e8)
    assert log_likelihood(limit, found, errors) == pytest.approx(
        log_likelihood(with_memory, found, errors), rel=1e-5
    )


def test_the_same_in_other_units_and_a_second_time():
    found = channels(60, 4)
    truth = free_model(levels=(0.02, 0.05), correlated=0.7, correlation_time=0.4)
    errors = drawn(truth, found, np.random.default_rng(8))
    local = polynomials(found, 2)
    metres = estimate(free_model(), found, errors, local=local)
    assert metres == estimate(free_model(), found, errors, local=local)
    smaller = estimate(free_model(), found, 1e-6 * errors, local=1e3 * local)
    assert adopted(smaller) == adopted(metres) == ["correlation"]
    assert np.multiply(1e6, smaller.levels) == pytest.approx(metres.levels, rel=1e-3)
    assert smaller.correlation_time == pytest.approx(metres.correlation_time, rel=1e-2)


def test_an_offset_of_every_track_is_no_long_memory():
    found = channels(50, 10)
    rng = np.random.default_rng(9)
    errors = 0.01 * rng.standard_normal(found.times.shape) + 0.05 * rng.standard_normal((1, 20))
    model = estimate(free_model(), found, errors)
    assert model.correlation_time <= 1.001 * MAX_TIME * found.times.max()


def orbit(n=60, grid=0.0):
    times = STEP * np.arange(float(n))
    track = np.stack([np.cos(times), np.sin(1.3 * times)], axis=-1)[:, None]
    return Scene("a", times, grid * np.round(track / grid) if grid else track, [Entity("ball")])


def test_levels_do_not_fall_below_the_rounding_even_where_all_differences_are_zero():
    dataset = Dataset("d", (orbit(grid=0.01),))
    model = NoiseModel.of(dataset)
    assert model.steps == pytest.approx((0.01, 0.01))
    found = Channels.of(build_chains(ForceLaw(), dataset.scenes))
    nothing = estimate(model, found, np.zeros(found.times.shape))
    assert nothing.levels == pytest.approx((0.01 / math.sqrt(12),) * 2, rel=1e-9)
    assert adopted(nothing) == []
    white, _ = replace(nothing, bodies=(("ball", 0.1),)).parts(found)
    assert white == pytest.approx(0.01**2 / 12)


def test_exact_data_have_the_least_noise_that_numbers_have():
    dataset = Dataset("d", (orbit(),))
    model = NoiseModel.of(dataset)
    found = Channels.of(build_chains(ForceLaw(), dataset.scenes))
    nothing = estimate(model, found, np.zeros(found.times.shape))
    span = np.ptp(dataset.scenes[0].positions[:, 0], axis=0)
    assert nothing.levels == pytest.approx(tuple(1e-12 * span))


@pytest.mark.parametrize("memory", [None, 0.0, 0.4])
@pytest.mark.parametrize("noise", [(0.05, 0.002), (0.0,), None])
def test_declared_and_quoted_sizes_stay(noise, memory):
    quoted = np.abs(np.random.default_rng(10).normal(0.03, 0.005, (60, 1, 2)))
    scene = orbit() if noise else replace(orbit(), sigma=quoted)
    dataset = Dataset("d", (scene,), noise=noise, noise_memory=memory)
    model = NoiseModel.of(dataset)
    assert set(model.sources) == {"declared" if noise else "quoted"}
    found = Channels.of(build_chains(ForceLaw(), dataset.scenes))
    span = np.ptp(scene.positions[:, 0], axis=0)
    truth = quoted[:, 0] if noise is None else np.maximum(noise, 1e-12 * span)
    errors = 20 * np.random.default_rng(11).standard_normal((60, 2))
    after = estimate(model, found, errors, local=polynomials(found, 1))
    np.testing.assert_allclose(after.sizes(found), np.broadcast_to(truth, (60, 2)), rtol=1e-12)
    if memory is not None:
        assert (after.correlated, after.correlation_time) == (float(memory > 0), memory)
        assert after.findings == ()
    assert {f.part for f in after.findings} <= {"correlation"}
    white, amplitude = after.parts(found)
    np.testing.assert_allclose(white + amplitude**2, after.sizes(found) ** 2, rtol=1e-12)


def test_channels_of_chains_that_differ_in_length_and_gaps():
    short = replace(orbit(20), name="b")
    both = Scene(
        "c",
        STEP * np.arange(30.0),
        np.concatenate([orbit(30).positions, 3 + orbit(30).positions], axis=1),
        [Entity("ball"), Entity("other")],
    )
    gap = orbit().positions.copy()
    gap[5, 0, 1] = np.nan
    scenes = [replace(orbit(), positions=gap), short, both]
    found = Channels.of(build_chains(ForceLaw(), scenes, coupled=True))
    assert found.times.shape == (60, 2 * 2 + 2 * 2)
    assert found.body_names == ("ball", "other") and found.scene_names == ("a", "b", "c")
    assert found.body.tolist() == [0, 0, 0, 0, 0, 0, 1, 1]
    assert found.chain.tolist() == [0, 0, 1, 1, 2, 2, 2, 2]
    assert np.count_nonzero(found.seen, axis=0).tolist() == [60, 59, 20, 20, 30, 30, 30, 30]
    errors = join([0.01 * np.ones((60, 2, 1, 2)), 0.01 * np.ones((30, 1, 2, 2))])
    model = estimate(free_model(), found, errors, adopt=False)
    assert model.levels == pytest.approx((0.01, 0.01))


def test_no_row_left_is_an_error():
    found = channels(3)
    with pytest.raises(FitError, match="6 measured values, 6 free numbers; declare noise"):
        estimate(free_model(), found, np.ones((3, 2)), local=polynomials(found, 2))


def test_long_tracks_tell_the_kind_of_their_noise_in_stretches():
    """All rows of 100,000 took minutes, however short the time that was left."""
    rng = np.random.default_rng(11)
    found = channels(50_000)
    truth = free_model(levels=(0.3, 2.0), correlated=0.6, correlation_time=0.4)
    local = polynomials(found, 2)
    residual = drawn(truth, found, rng)
    model = estimate(free_model(), found, residual, None, local)
    assert adopted(model) == ["correlation"]
    assert model.correlation_time == pytest.approx(0.4, rel=0.15)
    assert model.correlated == pytest.approx(0.6, abs=0.05)
    np.testing.assert_allclose(model.levels, truth.levels, rtol=0.015)  # as all rows tell them
    tailed = residual * rng.standard_t(4, residual.shape)
    assert "tails" in adopted(estimate(free_model(), found, tailed, None, local))
    white = drawn(free_model(levels=(0.3, 2.0)), found, rng)
    assert not adopted(estimate(free_model(), found, white, None, local))
