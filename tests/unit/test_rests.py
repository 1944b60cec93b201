"""Rows at which bodies are held, and ends of tracks that show something else."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.data.torn import without_torn_ends
from bsp_gp.fitting.hypothesis import NOTHING, read_law
from bsp_gp.fitting.rests import _still_ends, without_rests, without_still_ends
from bsp_gp.loop.ready import Ready

FALL = "9.81 [m/s^2] * m_i * down"
SIGMA, STEP = 0.002, 0.02
UNITS = {"length": "m", "time": "s", "mass": "kg"}


def dropped(held=0, landed=0, behind=(), acceleration=9.81, seed=0, n_scenes=2):
    """Drops by 30 rows, held before, lying behind, and readings of something else at last."""
    rng, frames = np.random.default_rng(seed), {}
    for k in range(n_scenes):
        t = np.arange(30) * STEP
        fall = 5.0 + 0.1 * k - acceleration / 2 * t**2
        y = np.concatenate([np.full(held, fall[0]), fall, np.full(landed, fall[-1])])
        y = np.concatenate([y + SIGMA * rng.standard_normal(len(y)), np.asarray(behind, float)])
        frames[f"d{k}"] = pd.DataFrame({"t": np.arange(len(y)) * STEP, "x": 0.0, "y": y})
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    return bsp_gp.Dataset.from_frames(frames, bodies, units=UNITS, up="y")


def bared(dataset, law=FALL):
    return without_rests(dataset, read_law(dataset, [law]))


def checks(dataset):
    return [note for note in dataset.notes if note.startswith("check: ")]


def test_a_long_rest_behind_a_motion_of_many_rows_is_left_out():
    """A pendulum that friction stops lay still for three quarters of its recording and more."""
    t = 0.02 * np.arange(1200)
    x = np.maximum(1 - 0.2 * t, 0) * np.cos(8 * t)
    data = bsp_gp.Dataset.from_frames(pd.DataFrame({"t": t, "x": x, "y": 0.0}), units=UNITS)
    cut = without_still_ends(data)
    assert 200 < len(cut.scenes[0].times) < 400 and len(checks(cut)) == 1


def test_a_bead_that_wanders_is_held_by_nobody():
    rng = np.random.default_rng(0)
    places = np.cumsum(rng.standard_normal((2000, 2)), axis=0)
    places[:40] = places[0] + 0.5 * (places[:40] - places[0])
    table = pd.DataFrame({"t": 0.1 * np.arange(2000), "x": places[:, 0], "y": places[:, 1]})
    data = bsp_gp.Dataset.from_frames(table, units=UNITS)
    assert without_still_ends(data) is data


def test_rows_before_a_body_is_let_go_and_after_it_has_landed_are_left_out():
    found = bared(dropped(held=15, landed=12))
    for scene in found.scenes:
        first, last = scene.times[0] / STEP, scene.times[-1] / STEP
        assert 15 <= first <= 20 and 40 <= last <= 45
    (note,) = checks(found)
    assert "stands still" in note and "'d0'" in note


@pytest.mark.parametrize(("decay", "rate"), [(2.5, 12.0), (1.0, 6.0), (3.0, 0.0)])
def test_what_settles_where_forces_balance_is_motion(decay, rate):
    """A mass on a spring that nobody declared: at rest it tells most of it."""
    t = np.arange(300) * STEP
    y = 1 - 0.5 * np.exp(-decay * t) * np.cos(rate * t)
    y += 1e-3 * np.random.default_rng(0).standard_normal(300)
    frame = pd.DataFrame({"t": t, "x": 0.0, "y": y})
    dataset = bsp_gp.Dataset.from_frames(frame, [bsp_gp.Entity("object", properties={"mass": 1.0})],
                                         units=UNITS, up="y")  # fmt: skip
    assert bared(dataset) is dataset


def test_bodies_far_from_the_origin_stand_still_as_others_do():
    dataset = dropped(held=26)
    far = replace(dataset, scenes=tuple(
        replace(s, positions=s.positions + [1e9, 1e9]) for s in dataset.scenes
    ))  # fmt: skip
    near, away = bared(dataset), bared(far)
    assert [len(s.times) for s in near.scenes] == [len(s.times) for s in away.scenes]


def test_a_free_constant_of_the_law_is_fitted_to_the_motion_alone():
    found = bared(dropped(held=15, landed=12), "g * m_i * down")
    assert all(len(scene.times) < 35 for scene in found.scenes)


@pytest.mark.parametrize("acceleration", [9.81, 1.0])
def test_what_sets_off_from_rest_stays_whole(acceleration):
    dataset = dropped(acceleration=acceleration)
    assert bared(dataset) is dataset


def test_rest_that_the_law_allows_is_motion():
    dataset = dropped(held=15, landed=12)
    assert bared(dataset, NOTHING) is dataset


def test_readings_of_something_else_behind_a_leap_are_left_out():
    dataset = dropped(behind=[9.0, 9.4, 9.1, 8.7, 9.2])
    assert [len(scene.times) for scene in dataset.scenes] == [35, 35]  # nothing is lost at reading
    found = without_torn_ends(dataset)
    assert [len(scene.times) for scene in found.scenes] == [30, 30]
    (note,) = checks(found)
    assert "leaps" in note and "5 of 'd0' after t = 0.58 s" in note


def test_a_tracker_that_finds_its_mark_late_is_told():
    frame = pd.DataFrame({"t": np.arange(40.0), "x": np.r_[np.full(6, 900.0), np.arange(34.0)]})
    found = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"})
    found = without_torn_ends(found)
    assert found.scenes[0].times[0] == 6.0


@pytest.mark.parametrize(
    "x",
    [
        np.r_[np.zeros(30), np.arange(1.0, 11.0)],  # hit: goes on as fast
        np.r_[0.01 * np.arange(30.0), 0.3 + np.arange(1.0, 11.0)],
        np.r_[np.arange(38.0), 900.0, 901.0],  # rows that are off, and too few
        np.r_[np.arange(30.0), 400.0, np.arange(31.0, 40.0)],  # one row that is off
        np.r_[np.arange(30.0), np.arange(28.0, 18.0, -1)],  # turns back
        np.r_[np.zeros(28), 0.86, 0.98, np.ones(10)] + 1e-3 * np.sin(np.arange(40.0) ** 2),  # step
        np.mod(0.033 * np.arange(40.0), 1.0),  # out of a box and in again
        np.r_[np.zeros(28), np.ones(12)] + 0.02 * np.sin(np.arange(40.0) ** 2),  # hops
    ],
)
def test_what_a_body_may_do_is_no_leap(x):
    frame = pd.DataFrame({"t": np.arange(40.0), "x": x})
    found = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"})
    found = without_torn_ends(found)
    assert len(found.scenes[0].times) == 40


def test_of_two_bodies_none_is_cut():
    x = np.r_[np.arange(30.0), np.full(10, 900.0)]
    frame = pd.DataFrame({"t": np.arange(40.0), "red_x": x, "blue_x": np.arange(40.0) - 50})
    found = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"})
    found = without_torn_ends(found)
    assert len(found.scenes[0].times) == 40


def lone(y, seed=0, sigma=1e-3, step=STEP):
    """A recording of one body along y."""
    y = y + sigma * np.random.default_rng(seed).standard_normal(len(y))
    frame = pd.DataFrame({"t": np.arange(len(y)) * step, "x": 0.0, "y": y})
    return bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"}, up="y")


def kept_rows(dataset):
    (scene,) = without_still_ends(dataset).scenes
    return round(scene.times[0] / STEP), len(scene.times)


def test_a_hand_that_trembles_and_a_first_row_that_is_off_hold_a_body_all_the_same():
    """Of a ball that bounced the fall had been left out as a hand's, and the law was none."""
    fall = 0.48 - 4.9 * (np.arange(14) * STEP) ** 2
    hand = 0.48 + 0.002 * np.sin(2.0 * np.arange(20))
    first, n = kept_rows(lone(np.concatenate([[0.09], hand, fall]), sigma=3e-4))
    assert 19 <= first <= 25 and n == 35 - first


def test_what_creeps_before_it_is_let_go_is_held():
    t = np.arange(200) * STEP
    swing = 1.0 - np.exp(-t) * np.cos(9 * t)
    first, _ = kept_rows(lone(np.concatenate([np.linspace(0, 0.02, 80), swing])))
    assert 75 <= first <= 88


def test_of_a_long_rest_behind_a_swing_a_part_is_kept():
    t = np.arange(300) * STEP
    y = 1.0 - np.exp(-1.5 * t) * np.cos(9 * t)
    y[90:] = y[90]  # it sticks
    _, n = kept_rows(lone(y))
    assert 80 <= n <= 110


def test_what_turns_back_slowly_stays_whole():
    t = np.arange(300) * STEP
    data = lone(np.cos(2.0 * t))
    assert without_still_ends(data) is data


@pytest.mark.parametrize("n", [0, 1, 2, 5, 6])
def test_a_recording_that_shows_hardly_a_row_has_no_rest(n):
    (scene,) = lone(np.linspace(0, 1, 40)).scenes
    places = scene.positions.copy()
    places[n:] = np.nan
    assert _still_ends(replace(scene, positions=places), np.full(2, 1e-3)) == (0, 0)


def test_what_swings_less_and_less_is_no_rest():
    """Of a damped swing, told to six digits, more than half of the rows had been left out."""
    t = 0.1 * np.arange(315)
    y = np.round(np.exp(-0.25 * t) * np.cos(2 * t), 6)
    data = lone(y, sigma=0.0)
    assert without_still_ends(data) is data


def test_all_rows_are_all_rows():
    """`--all-rows` kept none of those at which a body was told to stand still."""
    data = dropped(held=12, landed=12)
    counts = [
        len(Ready(data, [FALL], np.random.default_rng(0), all_rows).dataset.scenes[0].times)
        for all_rows in (True, False)
    ]
    assert counts[0] == 54 and counts[1] <= 30
