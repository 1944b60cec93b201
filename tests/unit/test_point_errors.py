"""Gross errors and bodies that are seen worse: found before any law is fitted, kept and told."""


import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.point_errors import are_smooth, gross_errors
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.law_fit import fit_law

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


@pytest.mark.parametrize("n_rows", [8, 13, 29, 30, 60])
def test_tracks_that_are_passed_over_have_no_gross_error(n_rows):
    rng = np.random.default_rng(5)
    tracks = np.array([swinging(rng)[:n_rows] for _ in range(60)])
    tracks[::3, n_rows // 2] += 0.3
    tracks[1, 0, 1] = np.nan
    sigma = np.full(2, SIGMA)
    passed = are_smooth(np.broadcast_to(TIMES[:n_rows], (60, n_rows)), tracks, sigma)
    has_none = np.array([np.all(gross_errors(TIMES[:n_rows], x, sigma) == 1) for x in tracks])
    assert not passed[1] and not np.any(passed & ~has_none)
    assert np.count_nonzero(passed) >= (20 if n_rows > 20 else 5)


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


FALL = 0.04 * np.arange(16)


def short_fall(rng, sigma=0.002):
    x = np.stack([1.5 * FALL, 3 + 2 * FALL - 4.905 * FALL**2], axis=1)
    return x + sigma * rng.standard_normal(x.shape)


@pytest.mark.parametrize("row", range(16))
def test_a_gross_error_is_found_in_any_row_of_a_short_track(row):
    """Of 16 rows one changes what is usual; at an end no row beyond it speaks for it."""
    for seed in range(5):
        rng = np.random.default_rng([seed, row])
        x = short_fall(rng)
        x[row] += 0.6 * np.array([1, -1])
        off = gross_errors(FALL, x, np.full(2, 0.002))
        assert np.flatnonzero(off > 1).tolist() == [row]
        assert off[row] > 100


@pytest.mark.parametrize("row", [0, 1, 2, 3, 4, 55, 56, 57, 58, 59])
def test_a_gross_error_near_an_end_is_found(row):
    for seed in range(5):
        x = swinging(np.random.default_rng([seed, row]))
        x[row, 0] += 0.6
        off = gross_errors(TIMES, x, np.full(2, SIGMA))
        assert np.flatnonzero(off > 1).tolist() == [row]


def test_a_body_that_is_hit_near_an_end_is_left_alone():
    """Two rows and more on the far side of a blow are where the motion went."""
    rng = np.random.default_rng(8)
    for n in (16, 60):
        times = 0.05 * np.arange(n)
        for row in (2, 3, 4, 5, n - 6, n - 5, n - 4, n - 3):
            for start in (0.0, 1.0):
                after = np.maximum(times - 0.05 * row, 0.0)
                x = np.stack([start * times, start * times - 3.0 * after], axis=1)
                x = x + SIGMA * rng.standard_normal(x.shape)
                assert np.all(gross_errors(times, x, np.full(2, SIGMA)) == 1)


def clean_tracks(rng, n_tracks=60):
    """Motions of many kinds: smooth, bouncing, stopped, close to the sampling limit, at rest."""
    for k in range(n_tracks):
        n = int(rng.integers(16, 60))
        t = 0.05 * np.arange(n)
        w, f = rng.uniform(0.5, 8), rng.uniform(0, 6)
        fast = np.pi / 0.05 * rng.uniform(0.5, 0.95)
        up = (t + f) % 0.6
        yield t, (
            np.stack([np.cos(w * t + f), 0.6 * np.sin(w * t + f)], axis=1),
            np.stack([0.5 * t, 4.9 * up * (0.6 - up)], axis=1),
            np.stack([np.cos(fast * t + f), np.sin(0.7 * fast * t)], axis=1),
            np.stack([np.minimum(t, 0.4 * t[-1]), 1 - np.exp(-w * t)], axis=1),
            np.stack([t, -4.9 * t**2], axis=1),
            np.zeros((n, 2)),
        )[k % 6]


def test_clean_tracks_of_many_kinds_have_none():
    rng = np.random.default_rng(9)
    for t, x in clean_tracks(rng):
        sigma = 10.0 ** rng.uniform(-4, -1.5)
        seen = x + sigma * rng.standard_normal(x.shape)
        assert np.all(gross_errors(t, seen, np.full(2, sigma)) == 1)
        assert np.all(gross_errors(t, x, np.full(2, 1e-7), is_exact=True) == 1)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.0, 0.002])
@pytest.mark.parametrize("row", [0, 3, 8, 15])
def test_a_fit_tells_a_gross_error_of_sixteen_rows_and_stands_it(row, sigma):
    x = short_fall(np.random.default_rng(row), sigma)
    x[row, 1] += 1.5
    others = [short_fall(np.random.default_rng(ord(s)), sigma) for s in "bcd"]
    tracks = dict(zip("abcd", [x, *others], strict=True))
    frames = {s: pd.DataFrame({"t": FALL, "x": y[:, 0], "y": y[:, 1]}) for s, y in tracks.items()}
    units = {"length": "m", "time": "s"}
    data = Dataset.from_frames(frames, units=units, train=["a", "b", "c"])
    fit = fit_law(data, ["-g * m_i * e_y"], rng=np.random.default_rng(0))
    assert f"object of a at t = {FALL[row]:.4g}" in fit.text()
    assert fit.constants[0].value == pytest.approx(9.81, rel=0.01)




def test_a_close_passage_in_coarse_steps_is_no_error():
    """A hyperbola whose nearest minutes are seen in steps of a minute, of a noise far smaller."""
    from scipy.integrate import solve_ivp

    t = 60.0 * np.arange(180)

    def rate(t, s):
        return [*s[2:], *(-3.986e14 * s[:2] / np.linalg.norm(s[:2]) ** 3)]

    way = solve_ivp(rate, (0, t[-1]), [-4.0e7, 2.6e7, 6e3, -3.5e3], t_eval=t, rtol=1e-10).y[:2].T
    assert np.linalg.norm(way, axis=1).min() < 1.2e7
    noise = 150.0 * np.random.default_rng(0).standard_normal(way.shape)
    assert (gross_errors(t, way + noise, np.full(2, 150.0)) == 1).all()
    noise[40] += 5e3
    assert np.flatnonzero(gross_errors(t, way + noise, np.full(2, 150.0)) > 1).tolist() == [40]
