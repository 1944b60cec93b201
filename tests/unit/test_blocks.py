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
