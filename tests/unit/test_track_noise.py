"""Position errors along a track: quoted for single points, and with a memory."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.folder import save_dataset
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.noise import TrackNoise, draw_noise
from bsp_gp.units import UnitSystem

SIGMA = np.array([0.02, 0.05])


def scene(n=400, step=0.1, sigma=None):
    times = step * np.arange(float(n))
    return Scene("a", times, np.zeros((n, 1, 2)), [Entity("ball")], sigma=sigma)


def whitened(track, memory):
    (batch,) = stack([track])
    noise = TrackNoise(batch, SIGMA, memory)
    return noise.whiten(batch.positions)[:, 0, 0]


@pytest.mark.parametrize("memory", [0.0, 0.05, 0.3, 2.0])
def test_what_is_drawn_is_whitened_again(memory):
    quoted = np.linspace(0.01, 0.1, 400)[:, None, None] * np.ones((1, 1, 2))
    for sigma in (None, quoted):
        plain = scene(sigma=sigma)
        z = []
        for rng in np.random.default_rng(0).spawn(20):
            errors = draw_noise(plain, SIGMA, memory, rng)
            z.append(whitened(replace(plain, positions=errors), memory))
        z = np.array(z)
        n = z.size
        assert z.var() == pytest.approx(1, abs=4 * np.sqrt(2 / n))
        assert (z[:, 1:] * z[:, :-1]).mean() == pytest.approx(0, abs=4 / np.sqrt(n))


def test_gaps_are_bridged_by_the_time_that_passed():
    memory, draws = 0.3, []
    for rng in np.random.default_rng(1).spawn(40):
        errors = draw_noise(scene(), SIGMA, memory, rng)
        errors[3::7] = errors[4::7] = np.nan
        draws.append(whitened(replace(scene(), positions=errors), memory))
    z = np.array(draws)
    seen = z[z != 0]
    assert len(seen) == 40 * 2 * (400 - 57 - 57)
    assert seen.var() == pytest.approx(1, abs=4 * np.sqrt(2 / len(seen)))


def test_an_axis_without_motion_and_points_without_a_quoted_error():
    quoted = np.full((400, 1, 2), np.nan)
    quoted[0], quoted[1] = 0.2, 0.0
    (batch,) = stack([scene(sigma=quoted)])
    noise = TrackNoise(batch, np.array([0.02, np.nan]))
    assert not noise.seen[..., 1].any()
    one = noise.whiten(np.ones((400, 1, 1, 2)))[:, 0, 0, 0]
    assert one[:3] == pytest.approx([5.0, 50.0, 50.0])
    assert not draw_noise(scene(), [0.02, np.nan], 0.0, np.random.default_rng(0))[..., 1].any()


@pytest.mark.parametrize("memory", [0.0, 0.25])
def test_regression_whitens_second_differences_of_such_noise(memory):
    quoted = np.linspace(0.01, 0.1, 60)[:, None, None] * np.ones((1, 1, 2))
    plain, squares, products, n = scene(60, sigma=quoted), 0.0, 0.0, 0
    for rng in np.random.default_rng(2).spawn(60):
        track = replace(plain, positions=draw_noise(plain, SIGMA, memory, rng))
        regression = build_regression([track], method="gls", sigma=SIGMA, memory=memory)
        z = regression.target().reshape(58, 2)
        squares, products, n = squares + (z**2).sum(), products + (z[1:] * z[:-1]).sum(), n + z.size
    # Sizes of points are shared by the axes, so that each axis is off by its part of the mean.
    assert squares / n == pytest.approx((SIGMA.mean() ** 2 / SIGMA**2).mean(), rel=0.6)
    assert products / n == pytest.approx(0, abs=0.2)


def test_log_scale_is_the_determinant_of_the_whitening():
    track = scene(30)
    for memory in (0.0, 0.4):
        regression = build_regression([track], method="gls", sigma=SIGMA, memory=memory)
        (batch,) = regression.batches
        columns = np.zeros((28, 1, 1, 28, 2))
        for k in range(28):
            columns[k, 0, 0, k] = 1.0
        matrices = batch.whiten(columns)[:, 0, 0]
        total = sum(np.linalg.slogdet(matrices[..., axis])[1] for axis in range(2))
        assert regression.log_scale() == pytest.approx(total)


def test_a_declared_memory_is_read_in_the_units_of_the_data_and_written(tmp_path):
    (tmp_path / "trajectories.csv").write_text("t,x,y\n0,0,0\n10,1,2\n20,2,5\n30,3,9\n")
    (tmp_path / "dataset.toml").write_text(
        'noise_memory = 40\n[units]\ntime = "ms"\nlength = "m"\n'
    )
    dataset = load_dataset(tmp_path)
    assert dataset.noise_memory == pytest.approx(0.04)
    save_dataset(dataset, tmp_path / "again")
    assert load_dataset(tmp_path / "again").noise_memory == pytest.approx(0.04)
    (tmp_path / "dataset.toml").write_text("noise_memory = -1\n")
    with pytest.raises(DataError, match="noise_memory must not be negative"):
        load_dataset(tmp_path)
    units = UnitSystem.from_declared({})
    assert Dataset("plain", (scene(),), units=units).noise_memory is None
