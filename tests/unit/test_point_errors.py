"""Gross errors and bodies that are seen worse: found before any law is fitted, kept and told."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.point_errors import gross_errors, with_point_errors
from bsp_gp.data.scene import Dataset, Entity, Scene

TIMES = 0.05 * np.arange(60)
SIGMA = 0.01


def swinging(rng, sigma=SIGMA):
    track = np.stack([np.sin(2 * TIMES), TIMES**2], axis=1)
    return track + sigma * rng.standard_normal(track.shape)


def test_gross_errors_are_found_and_others_are_not():
    rng = np.random.default_rng(0)
    false = 0
    for _ in range(50):
        x = swinging(rng)
        x[20] += 0.3
        x[41, 1] -= 0.3
        off = gross_errors(TIMES, x, np.full(2, SIGMA))
        assert off[20] == pytest.approx(30, abs=6) and off[41] > 10
        false += np.count_nonzero(off > 1) - 2
    assert false <= 1


def test_a_collision_is_no_gross_error():
    rng = np.random.default_rng(1)
    for at in (1.0, 1.02, 1.04):
        x = np.abs(TIMES - at)[:, None] * np.array([3.0, 1.0])
        x = x + SIGMA * rng.standard_normal(x.shape)
        assert np.all(gross_errors(TIMES, x, np.full(2, SIGMA)) == 1)


def test_uneven_times_and_gaps():
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(0.03, 0.07, 60))
    x = np.stack([times**2, np.cos(times)], axis=1) + SIGMA * rng.standard_normal((60, 2))
    x[30] += 0.5
    x[10:13] = np.nan
    off = gross_errors(times, x, np.full(2, SIGMA))
    assert np.flatnonzero(off > 1).tolist() == [30]


def test_rough_motion_and_short_tracks_are_left_alone():
    rng = np.random.default_rng(3)
    assert np.all(gross_errors(TIMES, rng.standard_normal((60, 2)), np.full(2, 1e-3)) == 1)
    assert np.all(gross_errors(TIMES[:12], rng.standard_normal((12, 2)), np.full(2, 1e-3)) == 1)
    assert np.all(gross_errors(TIMES, swinging(rng), np.full(2, np.nan)) == 1)


def dataset(rng, factor=1.0, gross=False):
    scenes = []
    for k in range(4):
        p = np.stack([swinging(rng), swinging(rng, factor * SIGMA)], axis=1)
        if gross and k == 2:
            p[25, 0] += 0.4
        scenes.append(Scene(f"s{k}", TIMES, p, [Entity("a"), Entity("b")]))
    return Dataset("two", scenes)


def test_nothing_is_changed_where_all_is_alike():
    data = dataset(np.random.default_rng(4))
    same, notes = with_point_errors(data, estimate_noise(data))
    assert same is data and notes == ()


def test_a_body_that_is_seen_worse_has_its_own_noise():
    data = dataset(np.random.default_rng(5), factor=5.0)
    new, notes = with_point_errors(data, estimate_noise(data))
    sizes = np.median([s.sigma for s in new.scenes], axis=(0, 1, 3))
    assert sizes == pytest.approx([SIGMA, 5 * SIGMA], rel=0.15)
    assert any(note.startswith("b is seen with") for note in notes)


def test_a_gross_error_is_kept_with_an_error_of_its_own():
    data = dataset(np.random.default_rng(6), gross=True)
    new, (note,) = with_point_errors(data, estimate_noise(data))
    assert "a of s2 at t = 1.25" in note
    assert new.scenes[2].sigma[25, 0, 0] > 10 * SIGMA
    assert np.array_equal(new.scenes[2].positions, data.scenes[2].positions)
    assert new.scenes[0].sigma is None


def test_quoted_errors_stay_and_are_multiplied():
    data = dataset(np.random.default_rng(7), gross=True)
    quoted = np.full(data.scenes[0].positions.shape, SIGMA)
    data = replace(data, scenes=tuple(replace(s, sigma=quoted) for s in data.scenes))
    new, notes = with_point_errors(data, estimate_noise(data))
    assert len(notes) == 1
    assert np.count_nonzero(new.scenes[2].sigma != SIGMA) == 2
