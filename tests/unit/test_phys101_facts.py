"""What the Physics 101 experiment says of g, periods and stiffness, on motion that is known."""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture(scope="module")
def experiment():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import phys101_fall
        import phys101_spring

        yield phys101_fall, phys101_spring
    for name in ("phys101_fall", "phys101_spring", "phys101_clips", "common"):
        sys.modules.pop(name, None)


@dataclass
class Clip:
    name: str
    mass: float
    frames: np.ndarray
    px: np.ndarray
    window: tuple


def falling(fall, g, pitch, n=6, starts=(-200.0, -120.0, -160.0, -90.0)):
    t = np.arange(n) - (n - 1) / 2
    rows = [fall.picture_row(s + 50 * t + 0.5 * g * t**2, pitch) for s in starts]
    return [(t, y) for y in rows]


@pytest.mark.parametrize("pitch", [0.0, 0.3])
def test_g_is_found_through_a_tilted_camera(experiment, pitch):
    fall, _ = experiment
    data = falling(fall, 16.0, pitch)
    g, *_, left, dof = fall.fit_falls(data, pitch)
    np.testing.assert_allclose(g, 16.0, rtol=1e-6)
    assert left < 1e-12
    assert dof == 4 * 3
    if pitch:  # a falling block recedes: without the tilt g is the smaller the lower the block is
        flat = fall.fit_falls(data)[0]
        assert np.all(np.diff(flat[[0, 2, 1, 3]]) < 0)
        assert np.ptp(flat) > 0.03 * 16


def test_one_g_and_the_tilt_are_found_together(experiment):
    fall, _ = experiment
    g, _, pitch, pitch_se, left, _ = fall.fit_falls(
        falling(fall, 16.0, 0.3), 0.1, shared=True, free_pitch=True
    )
    np.testing.assert_allclose([g[0], pitch], [16.0, 0.3], rtol=1e-4)
    assert np.isfinite(pitch_se)
    assert left < 1e-6


@pytest.mark.parametrize("n", [3, 4, 6])
def test_the_floor_is_the_error_of_the_fit(experiment, n):
    fall, _ = experiment
    _, se, *_ = fall.fit_falls(falling(fall, 16.0, 0.0, n=n))
    np.testing.assert_allclose(se, fall.unit_error(n), rtol=1e-5)


def test_agreement_is_chi_squared_about_the_weighted_mean(experiment):
    fall, _ = experiment
    mean, chi2, p = fall.agreement(np.array([1.0, 3.0]), np.array([1.0, 1.0]))
    assert (mean, chi2) == (2.0, 2.0)
    assert p == pytest.approx(0.1573, abs=1e-4)


def swinging(mass, period, decay=0.08, late=0.0):
    frames = np.arange(20, 170)
    t = (frames - 20) / 30.0
    w = 2 * np.pi * 30 / period
    y = 600 + 40 * np.exp(-decay * t) * np.cos(w * t + 0.3 + late)
    return Clip("made", mass, frames, np.stack([0 * y, y], axis=1), (20, 66))


def test_period_damping_and_stiffness_of_known_springs(experiment):
    _, spring = experiment
    k, added = 24.6, 0.027
    facts = []
    for mass in (0.1103, 0.1103, 0.2308, 0.2308):
        period = 2 * np.pi * np.sqrt((mass + added) / k) * 30
        facts.append(spring.spring_facts(swinging(mass, period)))
        assert facts[-1]["period_frames"] == pytest.approx(period, rel=1e-5)
        assert facts[-1]["decay_per_s"] == pytest.approx(0.08, rel=1e-3)
        assert facts[-1]["after_px"] < 0.01 < facts[-1]["before_px"]
    found = spring.stiffness(facts)
    assert found["k"] == pytest.approx(k, rel=1e-4)
    assert found["added_kg"] == pytest.approx(added, rel=1e-3)
    assert found["alone"] > 0.05  # the blocks' masses alone do not agree
    assert found["pairs"] < 1e-4


def test_a_clock_that_jitters_shows_in_fast_frames(experiment):
    _, spring = experiment
    rng = np.random.default_rng(5)
    clip = swinging(0.1103, 14.1)
    late = 2 * np.pi / 14.1 * 0.2 * rng.standard_normal(len(clip.frames))  # 0.2 frames
    t, y = spring.spring_track(swinging(0.1103, 14.1, late=late))
    p, _ = spring.oscillation(t, y, True)
    assert spring.clock_jitter(t, y, p) == pytest.approx(0.2, rel=0.3)
