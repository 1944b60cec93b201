"""Errors before and after, floors and intervals, against what can be said by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Scene
from bsp_gp.fitting.channels import Channels
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import predictions
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.parts.instrument import Instrument
from bsp_gp.fitting.simulated import draw_noise, simulated
from bsp_gp.loop.accounts import Accounts
from bsp_gp.physics.engine.lowering import fades_at_rest
from tests.fitted_tracks import body
from tests.throws import SI

SIGMA, N_ROWS, HEAD = 0.01, 30, 10


def coasting(n_scenes, seed=0, sigma=SIGMA):
    """Bodies on which nothing acts."""
    rng = np.random.default_rng(seed)
    times = 0.1 * np.arange(N_ROWS)
    scenes = []
    for k in range(n_scenes):
        p = rng.normal(0, 1, 2) + np.outer(times, rng.normal(0, 1, 2))
        p = p + sigma * rng.standard_normal(p.shape)
        scenes.append(Scene(f"s{k}", times, p[:, None], [body("a")]))
    return Dataset("coasting", tuple(scenes), units=SI, up="y", noise=(sigma, sigma))


def accounts_of(n_scenes, *laws, seed=0, **settings):
    data = coasting(n_scenes, seed)
    fits = [fit(Hypothesis.from_laws(data, texts), data) for texts in laws]
    return Accounts(fits, data, data.scenes, np.random.default_rng(1), **settings)


def test_the_floor_is_that_of_a_line_through_the_first_rows():
    """A line fitted to h rows misses row t by sigma^2 (1 + 1/h + (t - mean)^2 / sum)."""
    accounts = accounts_of(4, ["0 [N] * e_x"], n_copies=200)
    heads = np.arange(HEAD)
    rows = np.arange(HEAD, N_ROWS)
    leverage = 1 / HEAD + (rows - heads.mean()) ** 2 / np.square(heads - heads.mean()).sum()
    expected = SIGMA * math.sqrt(2 * np.mean(1 + leverage))  # both axes
    assert accounts.rows[0][0]["n_initial"] == HEAD
    # 800 independent starts, of which each moves 20 rows together.
    assert accounts.floor.rollout_rmse == pytest.approx(expected, rel=4 * 0.7 / math.sqrt(800))


def test_one_of_a_hundred_recordings_of_a_true_law_is_noisier_than_the_noisiest():
    """Three of 34 true frictions were refused: what noise had made of three tracks was a misfit."""
    noisiest = accounts_of(3, ["0 [N] * e_x"], n_copies=100).noisiest
    errors = [
        accounts_of(3, ["0 [N] * e_x"], seed=seed, n_copies=0).errors(0).rollout_rmse
        for seed in range(2, 202)
    ]
    assert np.mean(np.array(errors) > noisiest) < 0.01 + 3 * math.sqrt(0.01 / 200)
    assert noisiest > np.median(errors)


def test_an_error_that_is_half_of_another_has_the_ratio_one_half():
    accounts = accounts_of(6, ["0 [N] * e_x"], ["0 [N] * e_y"])
    assert not accounts.is_parametric
    for before, after in zip(*accounts.rows, strict=True):
        after["track"] = 0.5 * before["track"]
    ratio = accounts.ratio(0, 1)
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((0.5, 0.5, 0.5))
    assert ratio.method == "resampled"
    low, high = accounts.errors(0).intervals["rollout_rmse"]
    assert low < accounts.errors(0).rollout_rmse < high


@pytest.mark.slow
def test_intervals_of_few_scenes_cover_what_other_draws_show():
    """The error of a true law on other noise lies in nine of ten intervals."""
    inside, n_worlds = 0, 24
    floor = None
    for seed in range(n_worlds):
        accounts = accounts_of(2, ["0 [N] * e_x"], seed=seed, n_copies=40)
        low, high = accounts.errors(0).intervals["rollout_rmse"]
        floor = accounts.floor.rollout_rmse if floor is None else floor
        inside += low < floor < high
    # 0.9 of them within four standard deviations; the typical error stands for the true one.
    assert abs(inside / n_worlds - 0.9) < 4 * math.sqrt(0.09 / n_worlds)


def test_without_held_out_scenes_there_is_nothing_to_tell():
    data = coasting(1)
    found = fit(Hypothesis.from_laws(data, ["0 [N] * e_x"]), data)
    accounts = Accounts([found], data, (), np.random.default_rng(0))
    assert math.isnan(accounts.floor.rollout_rmse)
    assert math.isnan(accounts.ratio(0, 0).value)
    assert accounts.errors(0).intervals == {}


def test_no_copies_no_floor():
    accounts = accounts_of(2, ["0 [N] * e_x"], n_copies=0)
    assert math.isnan(accounts.floor.rollout_rmse)
    assert np.isfinite(accounts.errors(0).rollout_rmse)
    assert accounts.ratio(0, 0).method == "none"


# --- simulated scenes -----------------------------------------------------------------------------


def test_copies_lie_about_the_measured_tracks_and_keep_their_gaps():
    data = coasting(2)
    scene = data.scenes[0]
    holed = scene.positions.copy()
    holed[7] = np.nan
    data = Dataset("holed", (Scene("s0", scene.times, holed, scene.entities), data.scenes[1]),
                   units=SI, up="y", noise=(SIGMA, SIGMA))  # fmt: skip
    found = fit(Hypothesis.from_laws(data, ["0 [N] * e_x"]), data)
    copies = simulated(found, data, data.scenes, 3, np.random.default_rng(0))
    assert [len(copy) for copy in copies] == [2, 2, 2]
    for copy in copies:
        assert np.isnan(copy[0].positions[7]).all()
        for made, measured in zip(copy, data.scenes, strict=True):
            difference = made.positions - measured.positions
            assert np.nanmax(np.abs(difference)) < 8 * SIGMA
            assert np.nanstd(difference) == pytest.approx(math.sqrt(2) * SIGMA, rel=0.3)
    assert not np.array_equal(copies[0][1].positions, copies[1][1].positions)


def channels_of(n_rows):
    times = 0.1 * np.arange(n_rows)[:, None]
    one = np.zeros(1, dtype=int)
    return Channels(times, np.ones((n_rows, 1), dtype=bool), one, one, one, one, ("a",), ("s",))


def model_of(**settings):
    return NoiseModel((2.0,), ("estimated",), (0.0,), (0.0,), **settings)


def test_remembered_noise_has_its_size_and_its_correlation():
    model = model_of(correlated=0.75, correlation_time=0.2)
    errors = draw_noise(model, channels_of(12), 20_000, np.random.default_rng(0))[..., 0]
    assert errors.std(axis=0) == pytest.approx(np.full(12, 2.0), rel=0.03)
    products = (errors[:, :-1] * errors[:, 1:]).mean() / 4.0
    assert products == pytest.approx(0.75 * math.exp(-0.5), rel=0.03)


def test_tails_of_students_t_are_drawn():
    errors = draw_noise(model_of(degrees=4.0), channels_of(10), 20_000, np.random.default_rng(0))
    assert np.median(np.abs(errors)) == pytest.approx(2.0 * 0.7407, rel=0.02)  # of Student's t


@pytest.mark.parametrize(
    ("text", "fades"),
    [
        ("-c * v_i", True),
        ("-c * norm(v_i) * normalize(v_i)", True),
        ("-c * norm(v_i)^2 * normalize(v_i)", True),
        ("-c * m_i * normalize(v_i)", False),
        ("-c * inverse(norm(v_i)) * normalize(v_i)", False),
        ("-c * norm(v_i)^n * normalize(v_i)", False),
        ("9.81 [m/s^2] * m_i * down", False),
    ],
)
def test_only_what_keeps_its_size_brings_to_rest(text, fades):
    law = read_law(coasting(1), [text])
    assert fades_at_rest(law.terms[0].formula) is fades


def test_what_a_delay_shows_is_what_is_foreseen_and_copied():
    """Thrown upwards and seen 0.3 s late along a parabola, from states fitted to its first rows."""
    times = 0.1 * np.arange(N_ROWS)
    on_time = np.stack([times, 4 * times - 4.905 * times**2], axis=1)
    late = np.stack([times - 0.3, 4 * (times - 0.3) - 4.905 * (times - 0.3) ** 2], axis=1)
    noise = 1e-4 * np.random.default_rng(0).standard_normal((N_ROWS, 2, 2))
    places = np.stack([on_time, late], axis=1) + noise
    scene = Scene("s", times, places, [body("a"), body("b")])
    data = Dataset("late", (scene,), units=SI, up="y", noise=(1e-4, 1e-4))
    delay = Instrument("delay", whose=("b",))
    hypothesis = Hypothesis.from_laws(data, ["9.81 [m/s^2] * m_i * down"]) + delay
    found = replace(fit(hypothesis, data), noise=NoiseModel.of(data))
    found = replace(found, law=found.law.with_constants({delay.names[0]: 0.3}))
    (track,) = predictions(found, data, data.scenes)
    # Ten rows of 1e-4 m foresee thirty to some of their errors.
    assert np.abs(track - scene.positions).max() < 3e-3
    ((copy,),) = simulated(found, data, data.scenes, 1, np.random.default_rng(0))
    assert np.abs(copy.positions - scene.positions).max() < 1e-3
