import dataclasses
import math

import numpy as np
import pytest

from bsp_gp.cli import main
from bsp_gp.data.noise import declare_noise, estimate_noise
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.fitting.law_fit import fit_law

BALL = Entity("ball")


def fall(t):
    return np.stack([3 * t, 50 - 4.905 * t**2], axis=1)


def orbit(t):
    return np.stack([np.cos(math.tau * t), np.sin(math.tau * t)], axis=1)


def oscillator(t):
    return np.stack([np.exp(-0.1 * t) * np.cos(3 * t), np.exp(-0.2 * t) * np.sin(2 * t)], axis=1)


MOTIONS = {"fall": (fall, 1 / 30), "orbit": (orbit, 1 / 50), "oscillator": (oscillator, 0.05)}


def make_scene(motion, rng=None, sigma=0.0, n_times=400, jitter=0.0, name="s"):
    law, dt = MOTIONS[motion]
    t = np.arange(n_times) * dt
    if jitter:
        t = np.sort(t + jitter * dt * rng.uniform(-1, 1, n_times))
    x = law(t)
    if sigma:
        x = x + sigma * rng.normal(size=x.shape)
    return Scene(name, t, x[:, None], (BALL,))


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("sigma", [1e-3, 1e-2])
def test_white_noise_is_found(motion, sigma, jitter):
    ratios, n_effective = [], []
    for seed in range(20):
        scene = make_scene(motion, np.random.default_rng(seed), sigma, jitter=jitter)
        estimate = estimate_noise([scene])
        assert estimate.source == "estimated"
        ratios.extend(np.array(estimate.sigma) / sigma)
        n_effective.extend(estimate.n_effective)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    # 0.71/sqrt(n) is the sampling error; three of them are near 15 % here
    assert np.std(ratios) < 1.5 / math.sqrt(2 * np.mean(n_effective))
    assert np.mean(np.abs(np.array(ratios) - 1) < 0.15) > 0.9


@pytest.mark.parametrize("motion", MOTIONS)
def test_many_short_scenes_are_pooled(motion):
    rng = np.random.default_rng(31)
    scenes = [make_scene(motion, rng, 1e-2, n_times=30, name=str(k)) for k in range(40)]
    assert estimate_noise(scenes).sigma == pytest.approx((1e-2, 1e-2), rel=0.1)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("motion", MOTIONS)
def test_exact_data_are_seen_as_exact(motion, jitter):
    scene = make_scene(motion, np.random.default_rng(1), n_times=200, jitter=jitter)
    relative = np.array(estimate_noise([scene]).sigma) / np.ptp(scene.positions[:, 0], axis=0)
    assert np.all(relative >= 1e-12)
    assert np.all(relative < 1e-9)


def test_contacts_do_not_count():
    rng = np.random.default_rng(31)
    t = np.arange(400) * 0.02
    bouncing = np.stack([0.4 * t, np.abs((2 * t) % 4 - 2)], axis=1)
    scene = Scene("s", t, (bouncing + 0.01 * rng.normal(size=(400, 2)))[:, None], (BALL,))
    assert estimate_noise([scene]).sigma == pytest.approx((0.01, 0.01), rel=0.15)


def test_noise_may_differ_between_axes():
    scene = make_scene("orbit")
    rng = np.random.default_rng(31)
    noisy = scene.positions + rng.normal(size=scene.positions.shape) * [0.001, 0.02]
    estimate = estimate_noise([dataclasses.replace(scene, positions=noisy)])
    assert estimate.sigma == pytest.approx((0.001, 0.02), rel=0.15)


def test_static_entities_and_gaps_do_not_matter():
    rng = np.random.default_rng(31)
    scene = make_scene("orbit", rng, 0.01)
    positions = np.concatenate([scene.positions, np.full((400, 1, 2), 7.0)], axis=1)
    positions[::10, 0] = np.nan
    both = Scene("s", scene.times, positions, (BALL, Entity("wall", is_static=True)))
    assert estimate_noise([both]).sigma == pytest.approx((0.01, 0.01), rel=0.15)


def test_an_axis_without_variation_is_left_out():
    rng = np.random.default_rng(31)
    scene = make_scene("fall", rng, 0.01)
    flat = scene.positions.copy()
    flat[..., 0] = 1.25
    estimate = estimate_noise([dataclasses.replace(scene, positions=flat)])
    assert estimate.inactive_axes == ("x",)
    assert estimate.notes == ("nothing moves along x: that axis is left out",)
    assert math.isnan(estimate.sigma[0])
    assert estimate.sigma[1] == pytest.approx(0.01, rel=0.15)


def test_quoted_before_declared_before_estimated():
    scene = make_scene("orbit", np.random.default_rng(31), 0.01)
    declared = Dataset("d", (scene,), noise=(0.5, 0.25))
    assert estimate_noise(declared).source == "declared"
    assert estimate_noise(declared).sigma == (0.5, 0.25)
    assert estimate_noise(dataclasses.replace(declared, noise=(0.5,))).sigma == (0.5, 0.5)
    sigma = np.full(scene.positions.shape, np.nan)
    sigma[::2] = [3.0, 4.0]
    quoted = dataclasses.replace(declared, scenes=(dataclasses.replace(scene, sigma=sigma),))
    assert estimate_noise(quoted).source == "quoted"
    assert estimate_noise(quoted).sigma == (3.0, 4.0)
    assert estimate_noise(quoted).n_effective == (math.inf, math.inf)


def test_zero_means_exact_and_is_floored():
    scene = make_scene("orbit")
    estimate = estimate_noise(Dataset("d", (scene,), noise=(0.0,)))
    assert estimate.sigma == pytest.approx((2e-12, 2e-12), rel=1e-2)


def drift(t):
    """Slow enough for a track to stay in one pixel over many frames."""
    return np.stack([7.3 * t + 100.0, 3 * np.sin(2 * t)], axis=1)


T = np.arange(200) / 30


def estimate(x):
    return estimate_noise([Scene("s", T, x[:, None], (BALL,))])


@pytest.mark.parametrize("step", [1.0, 0.5, 0.00173, 1e-6])
def test_positions_on_a_grid_are_no_better_than_its_step(step):
    found = estimate(np.round(drift(T)) * step + 0.4 * step)
    assert found.sigma == pytest.approx((step / math.sqrt(12),) * 2, rel=1e-6)
    assert found.n_effective == (math.inf, math.inf)
    assert f"x is rounded to steps of {step:.4g}" in found.notes[0]
    assert "/ sqrt(12)" in found.method


def test_a_whole_number_of_pixels_a_frame_is_rounded_like_the_other_axis():
    x = np.round(100 * fall(T))
    assert np.all(np.diff(x[:, 0]) == 10)
    found = estimate(x)
    assert found.sigma[0] == pytest.approx(1 / math.sqrt(12))
    assert found.sigma[1] == pytest.approx(1 / math.sqrt(12), rel=0.15)
    assert len(found.notes) == 2


def test_noise_above_the_step_is_estimated_as_before():
    x = np.round(drift(T) + 2 * np.random.default_rng(31).normal(size=(200, 2)))
    found = estimate(x)
    assert found.sigma == pytest.approx((2.0, 2.0), rel=0.2)
    assert found.notes == ()
    assert np.all(np.isfinite(found.n_effective))


def elastic(t):
    """Pieces of uniform motion with all values on one grid, exactly."""
    return np.stack([0.4 * t, np.abs((2 * t) % 4 - 2)], axis=1)


@pytest.mark.parametrize(
    "x",
    [
        fall(T),
        np.stack([3 * np.arange(200.0), np.arange(200.0) ** 2], axis=1),
        elastic(np.arange(200) * 0.02),
        drift(T),
        orbit(T),
    ],
    ids=["fall", "whole numbers", "elastic", "drift", "orbit"],
)
def test_exact_motion_is_no_grid(x):
    found = estimate(x)
    assert found.notes == ()
    assert np.all(np.array(found.sigma) < 1e-7 * np.ptp(x, axis=0))


def test_a_column_of_two_values_is_no_better_than_their_distance():
    """Of a set point that was logged as a place the noise was told to be 5e-16 m."""
    x = np.where(np.arange(200) // 70 % 2, 0.0050, 0.0045)
    found = estimate(np.stack([x, np.zeros(200)], axis=1))
    assert found.sigma[0] == pytest.approx(5e-4 / np.sqrt(12))


def test_what_is_declared_is_not_changed_by_a_grid():
    scene = Scene("s", T, np.round(drift(T))[:, None], (BALL,))
    found = estimate_noise(Dataset("d", (scene,), noise=(0.01,)))
    assert found.sigma == (0.01, 0.01)
    assert found.notes == ()


def test_three_frames_are_enough_to_answer():
    scene = Scene("s", [0, 1, 2], [[[0, 0]], [[1, 1]], [[2, 4]]], (BALL,))
    assert estimate_noise([scene]).sigma[1] == pytest.approx(2 / math.sqrt(6), rel=1)


def test_nothing_dynamic():
    scene = Scene("s", [0, 1, 2], np.zeros((3, 1, 2)), (Entity("a", is_static=True),))
    with pytest.raises(DataError, match="no entity is dynamic"):
        estimate_noise([scene])


def test_reference_scenes(shared_data):
    from bsp_gp.data.tables import load_dataset

    rng = np.random.default_rng(31)
    for kind in ("bounce", "mat"):
        scenes = load_dataset(shared_data / "synth" / kind).scenes
        noisy = [
            dataclasses.replace(
                s, positions=s.positions + 0.01 * rng.normal(size=s.positions.shape)
            )
            for s in scenes
        ]
        assert estimate_noise(noisy).sigma == pytest.approx((0.01, 0.01), rel=0.05)


def quoting(folder, toml=""):
    rows = "".join(f"{0.1 * k},{k},{k * k},0.01,0.02\n" for k in range(12))
    (folder / "trajectories.csv").write_text(f"t,x,y,sx,sy\n{rows}", encoding="utf-8")
    (folder / "dataset.toml").write_text(toml, encoding="utf-8")
    return folder


def test_declared_noise_beside_quoted_errors_is_told(tmp_path):
    data = load_dataset(quoting(tmp_path, "noise = 0.5\n"))
    assert any("the quoted ones count" in note for note in data.notes)
    assert estimate_noise(data).sigma == pytest.approx((0.01, 0.02))
    assert load_dataset(quoting(tmp_path, 'noise = {"*" = 0.5}\n')).notes == ()


def test_an_option_of_noise_beside_quoted_errors_is_refused(tmp_path, capsys):
    words = ["fit", str(quoting(tmp_path)), "--law", "c * m_i * e_y", "--quiet"]
    assert main([*words, "--noise", "0.5"]) == 2
    assert "the points quote errors of their own" in capsys.readouterr().err
    data = load_dataset(tmp_path)
    with pytest.raises(SettingsError, match="leave the option out"):
        fit_law(data, ["c * m_i * e_y"], rng=np.random.default_rng(0), noise=0.5)


def test_an_option_of_noise_stands_in_for_the_declared():
    data = Dataset("d", (make_scene("fall"),), noise=(0.5,))
    assert estimate_noise(data).sigma == (0.5, 0.5)
    assert estimate_noise(declare_noise(data, [0.25])).sigma == (0.25, 0.25)


@pytest.mark.parametrize("scale", [1.0, 0.3048])
def test_numbers_with_as_many_digits_each_are_as_coarse_as_the_large_ones(scale):
    """A swing that dies away, as %g prints it: the grid of its end says nothing of its begin."""
    times = np.arange(300) * 0.1
    x = np.array([float(f"{v:.6g}") for v in np.exp(-0.25 * times) * np.cos(2 * times)])
    found = estimate_noise([Scene("a", times, scale * np.stack([x, 0 * x], axis=1)[:, None],
                                  (Entity("bob"),))])  # fmt: skip
    assert found.sigma[0] == pytest.approx(scale * 1e-6 / np.sqrt(12), rel=1e-6)
    plain = x.round(6)  # as many decimals each: one grid, which is that of all
    found = estimate_noise([Scene("a", times, np.stack([plain, 0 * x], axis=1)[:, None],
                                  (Entity("bob"),))])  # fmt: skip
    assert found.sigma[0] < 4e-7


def test_a_grid_of_its_own_counts_whatever_that_of_the_other_axis_is():
    """Numbers in few digits beside ones in few decimals, most of which repeat the row before."""
    times = np.arange(400) * 0.04
    fine = np.array([float(f"{v:.4g}") for v in 0.14 * np.exp(-0.2 * times) * np.cos(3 * times)])
    coarse = np.round(0.33 + 0.006 * np.cos(0.7 * times), 3)
    assert np.mean(np.diff(coarse) == 0) > 0.5
    for places in ((fine, coarse), (coarse, fine)):
        scene = Scene("s", times, np.stack(places, axis=1)[:, None], (BALL,))
        found = dict(zip(places[0][:1].tolist() + places[1][:1].tolist(),
                         estimate_noise([scene]).sigma, strict=True))  # fmt: skip
        assert found[coarse[0]] == pytest.approx(1e-3 / math.sqrt(12), rel=1e-6)


def test_an_axis_that_hardly_ever_moves_is_not_exact_for_it():
    """What moves in one row of fifty is clipped, and nothing would be left but zeros."""
    rng = np.random.default_rng(5)
    levels = np.repeat(rng.normal(size=8), 50)
    found = estimate_noise([Scene("s", np.arange(400.0), levels[:, None, None] * [1.0, 0.0],
                                  (BALL,))])  # fmt: skip
    assert found.sigma[0] > 1e-6 * np.ptp(levels)
