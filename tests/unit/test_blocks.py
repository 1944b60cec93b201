"""Dense tracks averaged over blocks: as much is told by the means, and what is quick stays."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.blocks import in_blocks
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.scene import Dataset, Entity, Evaluation, Scene

SIGMA = 0.01


def recording(n=4000, seed=0, more=0.0, sigma=SIGMA, **settings):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, n)
    x = np.stack([np.cos(t), np.sin(t)], axis=-1) + more
    x = x + sigma * rng.standard_normal(x.shape)
    scene = Scene("a", t, x[:, None], (Entity("bob", properties={"mass": 1.0}),))
    return Dataset("d", (scene,), **settings)


def test_means_lie_on_the_track_with_the_noise_of_means():
    made = in_blocks(recording(), 400)
    (scene,) = made.scenes
    assert len(scene.times) == 400
    left = scene.positions[:, 0, 0] - np.cos(scene.times)
    assert np.std(left) == pytest.approx(SIGMA / np.sqrt(10), rel=0.1)
    assert estimate_noise(made).sigma[0] == pytest.approx(SIGMA / np.sqrt(10), rel=0.15)
    assert "4,000 dense rows" in made.notes[-1]


def test_declared_noise_becomes_that_of_the_means():
    made = in_blocks(recording(noise=(SIGMA,)), 400)
    assert made.scenes[0].sigma == pytest.approx(SIGMA / np.sqrt(10))


def test_blocks_are_no_longer_than_the_track_is_straight():
    made = in_blocks(recording(sigma=1e-4), 40)
    step = np.diff(made.scenes[0].times).max() if len(made.scenes[0].times) < 4000 else 0.0
    assert step < 0.1  # of blocks of half a second 1 % of an amplitude would be lost


def test_a_vibration_within_blocks_is_not_averaged_away():
    t = np.linspace(0.0, 10.0, 4000)
    shaking = 0.05 * np.sin(2 * np.pi * 30 * t)[:, None]
    made = in_blocks(recording(more=shaking), 400)
    assert len(made.scenes[0].times) >= 2000  # 200 rows a second show 30 Hz, 40 do not


def test_the_bend_of_a_track_is_in_no_mean():
    """Of blocks of a tenth of a radian a mean would be off by as much as its error."""
    sigma = 0.4 * SIGMA
    (scene,) = in_blocks(recording(n=8000, sigma=sigma), 100).scenes
    assert len(scene.times) == 100
    left = scene.positions[:, 0, 0] - np.cos(scene.times)
    bent, error = np.cos(scene.times) * 0.1**2 / 24, sigma / np.sqrt(80)
    assert abs(left @ bent / (bent @ bent)) < 4 * error / np.sqrt(bent @ bent) < 0.7
    assert np.std(left) == pytest.approx(error, rel=0.25)


def test_a_kick_within_blocks_keeps_them_short():
    t = np.linspace(0.0, 10.0, 4000)
    kicked = recording(more=3.0 * np.maximum(t - 5.01, 0.0)[:, None])
    lengths = [len(in_blocks(data, 100).scenes[0].times) for data in (recording(), kicked)]
    assert lengths[0] == 100 and lengths[1] >= 400


def test_sums_of_velocities_are_taken_at_the_ends_of_blocks():
    """A phone's gyroscope for three minutes, 18,000 rows, had no answer in any time."""
    rng, t = np.random.default_rng(3), np.linspace(0.0, 40.0, 4001)
    speed = np.cos(t) + 0.001 * rng.standard_normal(len(t))
    x = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))])
    scene = Scene("a", t, np.stack([x, 0 * x], axis=-1)[:, None], (Entity("bob"),))
    made = in_blocks(Dataset("d", (scene,), velocity="only"), 1000)
    assert len(made.scenes[0].times) == 801 and "every 5 rows' end" in made.notes[-1]
    assert np.array_equal(made.scenes[0].positions, scene.positions[::5])
    shaken = replace(scene, positions=scene.positions + 0.001 * np.sin(60 * t)[:, None, None])
    assert in_blocks(Dataset("d", (shaken,), velocity="only"), 1000).scenes[0] is shaken


def test_gross_errors_are_in_no_mean():
    data = recording()
    x = data.scenes[0].positions.copy()
    x[1234, 0] += 5.0
    data = replace(data, scenes=(replace(data.scenes[0], positions=x),))
    made = in_blocks(data, 400)
    assert "far off their neighbours are in none: 1" in made.notes[-1]
    left = made.scenes[0].positions[:, 0, 0] - np.cos(made.scenes[0].times)
    assert np.abs(left).max() < 6 * SIGMA / np.sqrt(10)


@pytest.mark.parametrize(
    "data",
    [
        recording(n=300), recording(evaluation=Evaluation(initial_rows=5)),
        recording(noise_memory=0.1), recording(sigma=0.0),
    ],
)  # fmt: skip
def test_nothing_is_averaged_that_is_short_counted_remembered_or_exact(data):
    assert in_blocks(data, 400) is data


def test_rounded_tracks_are_left_as_they_are():
    data = recording(sigma=1e-3)
    scene = replace(data.scenes[0], positions=np.round(data.scenes[0].positions, 2))
    data = replace(data, scenes=(scene,))
    assert in_blocks(data, 400) is data


def test_dense_rows_of_an_encoder_are_averaged_all_the_same():
    """Of 231,757 rows in steps of 9 thousandths of a degree each was taken for a hit."""
    t = np.linspace(0.0, 10.0, 30_000)
    x = 1e-3 * np.round(np.sin(3 * t) * np.exp(-0.1 * t) / 1e-3)
    scene = Scene("a", t, np.stack([x, 0 * x], axis=-1)[:, None], (Entity("bob"),))
    (made,) = in_blocks(Dataset("d", (scene,))).scenes
    assert len(made.times) <= 1300
    off = made.positions[:, 0, 0] - np.sin(3 * made.times) * np.exp(-0.1 * made.times)
    assert np.abs(off).max() < 1e-3
    few = replace(scene, times=t[::20], positions=scene.positions[::20])
    assert in_blocks(Dataset("d", (few,))).scenes[0] is few


def test_what_wanders_is_not_averaged_over_two_rows():
    """Two rows always lie on a line: means of them had a memory that no noise has."""
    rng = np.random.default_rng(4)
    places = np.cumsum(0.1 * rng.standard_normal((2000, 1, 2)), axis=0)
    places += 0.02 * rng.standard_normal(places.shape)
    scene = Scene("a", 0.01 * np.arange(2000), places, (Entity("bead", properties={"mass": 1.0}),))
    assert in_blocks(Dataset("d", (scene,))).scenes[0] is scene
