"""Defects of recordings as parts of a hypothesis: found, undone, and paid for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.defects import LeftOut, Shifted, Swapped
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import CAUSES
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposers.clocks import put_forward
from bsp_gp.loop.proposers.defects import Defects, leave_motion
from bsp_gp.loop.proposers.stuck import is_broken
from bsp_gp.loop.view import selected
from bsp_gp.report.page import page_of
from tests.loop_views import GRAVITY, edited, throws, view_of


def swap(positions):
    positions[17:] = positions[17:, ::-1]


def spoil(positions):
    positions[12, 0] += (0.3, -0.2)


def lose(positions):
    positions[25:, 1] = positions[25, 1] + 0.4


def drop(positions):
    positions[20:-2] = positions[22:]
    positions[-2:] = np.nan


def repeat(positions):
    positions[21:] = positions[20:-1].copy()
    positions[20] = positions[19] + 1e-4


def best_of(data):
    """The family, and the likeliest of its proposals once fitted, beside the base."""
    view = view_of(data)
    family = Defects().propose(view)
    heights = [
        log_evidence(fit(p.hypothesis, data), p.hypothesis) + p.log_prior for p in family.proposals
    ]
    k = int(np.argmax(heights))
    chance = selected(family.gain, family.rank, family.null, view.noise_dof)
    return family.proposals[k], heights[k] - log_evidence(view.fit, view.hypothesis), chance


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (swap, "swapped_tracks", "1, 2 swapped[2, 17:]"),
        (spoil, "bad_row", "1 left out[2, 12:13]"),
        (lose, "lost_track", "2 left out[2, 25:40]"),
        (drop, "clock_jump", "t +0.05 s[2, 20:]"),
        (repeat, "clock_jump", "t -0.025 s[2, 20:]"),
    ],
)
def test_a_defect_is_named_with_its_row(change, code, text):
    data = edited(throws(np.random.default_rng(2), n_bodies=2), change, scene=1)
    best, gain, chance = best_of(data)
    assert (best.code, best.text) == (code, text)
    assert code in CAUSES
    assert gain > 20
    assert chance < 1e-6


def test_two_bad_rows_are_left_out_at_once():
    def change(positions):
        positions[5, 0, 0] += 0.2
        positions[30, 1, 1] -= 0.2

    data = edited(throws(np.random.default_rng(2), n_bodies=2), change)
    best, _, _ = best_of(data)
    assert set(best.text.split("; ")) == {"1 left out[1, 5:6]", "2 left out[1, 30:31]"}


def test_a_promise_is_what_the_fit_keeps():
    data = edited(throws(np.random.default_rng(2), n_bodies=2), lose, scene=1)
    view = view_of(data)
    base = log_evidence(view.fit, view.hypothesis)
    best = Defects().propose(view).proposals[0]
    height = log_evidence(fit(best.hypothesis, data), best.hypothesis) + best.log_prior
    assert best.code == "lost_track"
    assert height - base == pytest.approx(best.promise, abs=5)  # less the volume of the states


def test_without_defects_none_is_likelier_than_the_law_alone():
    for seed in range(3):
        _, gain, _ = best_of(throws(np.random.default_rng(seed), n_bodies=2))
        assert gain < 0


def test_bodies_that_meet_and_are_explained_are_not_swapped():
    def meet(t, mass):
        return 0.0 * t[:, None]

    data = throws(np.random.default_rng(2), n_bodies=2, move=meet)

    def cross(positions):  # two tracks through one point, as the law has them
        positions[:, 1] = positions[:, 0] + 0.1 * np.linspace(-1, 1, 40)[:, None] * [1, 0]
        positions[:, 1, 1] += 0.001

    family = Defects().propose(view_of(edited(data, cross)))
    assert all(p.code != "swapped_tracks" for p in family.proposals)


def test_swapping_twice_is_nothing_and_other_scenes_are_left_alone():
    data = throws(np.random.default_rng(0), n_bodies=2)
    part = Swapped("2", 10, "1", "2")
    once = part.seen(data)
    assert np.array_equal(once.scenes[1].positions[10:], data.scenes[1].positions[10:, ::-1])
    assert np.array_equal(once.scenes[1].positions[:10], data.scenes[1].positions[:10])
    assert once.scenes[0] is data.scenes[0]
    both = (Hypothesis() + part + part).seen(data)
    assert np.array_equal(both.scenes[1].positions, data.scenes[1].positions)


def test_rows_left_out_are_not_seen_and_are_paid_for():
    data = throws(np.random.default_rng(0), n_bodies=2)
    part = LeftOut("1", 3, 5, "2", n_left_out=4, extent=5.0)
    positions = part.seen(data).scenes[0].positions
    assert np.isnan(positions[3:5, 1]).all()
    assert np.isfinite(positions).sum() == data.scenes[0].positions.size - 4
    assert np.isnan(LeftOut("1", 3, 4, "").seen(data).scenes[0].positions[3]).all()
    whole = Hypothesis.from_laws(data, [GRAVITY])
    found = fit(whole + part, data)
    assert found.n_rows == fit(whole, data).n_rows - 4
    paid = log_evidence(found, whole + part) - log_evidence(found, whole)
    assert paid == pytest.approx(-4 * math.log(5.0))


def test_repeated_frames_are_cut_and_missing_ones_open_a_gap():
    data = throws(np.random.default_rng(0))
    later = Shifted("1", 20, 0.05).seen(data).scenes[0]
    assert np.diff(later.times)[19] == pytest.approx(0.075)
    assert len(later.times) == 40
    shorter = Shifted("1", 20, -0.025).seen(data).scenes[0]
    assert np.diff(shorter.times) == pytest.approx(np.full(38, 0.025))
    assert np.array_equal(shorter.positions[20:], data.scenes[0].positions[21:])


def test_rows_that_lose_repeated_frames_keep_what_was_logged_at_them():
    data = throws(np.random.default_rng(0))
    thrust = np.arange(40.0)[:, None]
    logged = replace(data.scenes[0], inputs={"thrust": thrust})
    data = replace(data, scenes=(logged, *data.scenes[1:]))
    shorter = Shifted("1", 20, -0.05).seen(data).scenes[0]
    kept = np.delete(thrust, (20, 21), axis=0)
    assert np.array_equal(shorter.inputs["thrust"], kept)


def test_evidence_of_a_defect_does_not_change_with_the_unit_of_length():
    """What is left out has a density in metres, as what is kept has."""
    gains = []
    for unit in (1.0, 1000.0):
        data = throws(np.random.default_rng(4), n_bodies=1)
        data = edited(data, spoil)
        scenes = tuple(replace(s, positions=s.positions * unit) for s in data.scenes)
        data = replace(data, scenes=scenes, noise=(data.noise[0] * unit,))
        view = view_of(data, f"{-9.81 * unit} [m/s^2] * m_i * e_y")
        best = next(p for p in Defects().propose(view).proposals if p.code == "bad_row")
        new = fit(best.hypothesis, data)
        gains.append(
            log_evidence(new, best.hypothesis) - log_evidence(view.fit, view.hypothesis)
        )
    assert gains[0] == pytest.approx(gains[1], abs=1e-4)


def with_outliers(noise):
    data = replace(throws(np.random.default_rng(1), n_scenes=5, n_rows=50), noise=noise)
    for scene, row, by in ((3, 20, 0.2), (2, 0, -0.15)):
        data = edited(data, lambda p, row=row, by=by: p.__setitem__(row, p[row] + by), scene)
    return data


@pytest.mark.slow
def test_rows_that_are_left_out_are_foreseen_by_nobody():
    """Of another scene's outlier no scene foretells anything: it was refused for that."""
    report = close_loop(with_outliers((0.005, 0.005)), [GRAVITY], rng=0, n_bootstrap=20)
    assert [r.reason for r in report.rounds] == ["adopted", "not_significant"]
    assert report.rounds[0].effect.code == "bad_row"


@pytest.mark.slow
def test_tails_tell_which_row_is_furthest_off():
    """Where noise is estimated, tails take gross errors: a user wants to know which rows."""
    report = close_loop(with_outliers(None), [GRAVITY], rng=0, n_bootstrap=0)
    assert report.verdict == "nothing missing"
    (found,) = report.rounds[0].noise_findings
    assert (found["code"], found["scene"], found["entity"], found["row"]) == ("tails", "4", "1", 20)
    assert page_of(report).rounds[0].noise == (
        "it has heavier tails than a normal distribution (furthest off: 1, 4, row 21)",
    )


def with_clock_put_on(data, row, seconds, scene=1):
    """The data with the clock of a scene put forward at a row."""
    scenes = list(data.scenes)
    times = scenes[scene].times + np.where(np.arange(len(scenes[scene].times)) >= row, seconds, 0.0)
    scenes[scene] = replace(scenes[scene], times=times)
    return replace(data, scenes=tuple(scenes))


@pytest.mark.parametrize("seconds", [0.0375, 0.075])  # one and a half steps, and three
def test_a_clock_that_was_put_forward_is_found(seconds):
    data = with_clock_put_on(throws(np.random.default_rng(2), n_bodies=2), 17, seconds)
    best, gain, chance = best_of(data)
    name = data.scenes[1].name
    assert best.code == "clock_jump"
    assert f"t -{seconds:.4g} s[{name}, 17:]" in best.text
    assert gain > 20
    assert chance < 1e-6
    seen = best.hypothesis.parts[-1].seen(data)
    np.testing.assert_allclose(np.diff(seen.scenes[1].times), np.diff(data.scenes[0].times))


def test_rows_that_are_missing_are_no_clock_put_forward():
    data = throws(np.random.default_rng(2), n_bodies=2)
    kept = np.delete(np.arange(40), [8, 9])
    scenes = tuple(
        replace(s, times=s.times[kept], positions=s.positions[kept]) for s in data.scenes
    )
    assert put_forward(view_of(replace(data, scenes=scenes)))[0] == []


def test_what_starts_slowly_is_no_lost_track():
    """A body that sets off from rest stood still in its first rows: they were left out."""
    times = np.arange(60) / 20
    way = np.column_stack([0.4 * times**2, 0.1 * times**2])
    rng = np.random.default_rng(0)
    places = way + 0.02 * rng.standard_normal(way.shape)
    scene = Scene("run", times, places[:, None], (Entity("ball", "disc", radius=0.1),))
    assert not is_broken(scene, "ball", 6)
    held = np.where(np.arange(60)[:, None] < 20, way[40] + 0.02 * rng.standard_normal((60, 2)), way)
    lost = replace(scene, positions=held[:, None])
    assert is_broken(lost, "ball", 20)


def test_what_stands_still_is_no_motion_that_is_left():
    """Of a cart that was pushed once all rows that moved were left out, and a track was lost."""
    rng = np.random.default_rng(0)
    x = np.where(np.arange(80) < 30, np.arange(80) / 10.0, 3.0)
    body = Entity("cart", properties={"mass": 1.0})
    places = np.stack([x, 0 * x], axis=1) + 1e-3 * rng.standard_normal((80, 2))
    data = Dataset("pushed", (Scene("1", 0.02 * np.arange(80), places[:, None], (body,)),))
    levels = np.array([1e-3, 1e-3])
    assert not leave_motion(data, [LeftOut("1", 0, 32, "cart")], levels)
    assert leave_motion(data, [LeftOut("1", 60, 80, "cart")], levels)
