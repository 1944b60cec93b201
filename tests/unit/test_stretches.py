"""Recordings of very many turns are followed in stretches."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.data.stretches import in_stretches

UNITS = {"length": "m", "time": "s"}


def swung(n_turns, rows_a_turn=14, drag=0.005, sigma=2e-3, seed=0):
    """A mass on a spring of 1 /s^2 with drag, let go at 1 m, as one recording."""
    t = np.arange(n_turns * rows_a_turn) * 2 * np.pi / rows_a_turn
    made = solve_ivp(lambda t, y: [y[1], -y[0] - drag * y[1]], (0, t[-1]), [1.0, 0.0],
                     t_eval=t, rtol=1e-10, atol=1e-12)  # fmt: skip
    x = made.y[0] + sigma * np.random.default_rng(seed).standard_normal(len(t))
    return bsp_gp.Dataset.from_frames(pd.DataFrame({"t": t, "x": x}), units=UNITS)


def test_many_turns_are_cut_and_nothing_is_lost():
    dataset = swung(100)
    found = in_stretches(dataset)
    (whole,) = dataset.scenes
    assert len(found.scenes) == 8
    assert {scene.part_of for scene in found.scenes} == {whole.name}
    assert np.array_equal(np.concatenate([s.times for s in found.scenes]), whole.times)
    assert np.array_equal(np.concatenate([s.positions for s in found.scenes]), whole.positions)
    assert "100 turns" in found.notes[-1] or "99 turns" in found.notes[-1]
    assert in_stretches(found) is found


@pytest.mark.parametrize("n_turns", [3, 30])
def test_what_is_followed_as_a_whole_stays_whole(n_turns):
    dataset = swung(n_turns)
    assert in_stretches(dataset) is dataset


def test_noise_about_a_place_is_no_turn():
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"t": np.arange(500.0), "x": rng.standard_normal(500)})
    dataset = bsp_gp.Dataset.from_frames(frame, units=UNITS)
    assert in_stretches(dataset) is dataset


def test_a_declared_split_holds_out_the_stretches_of_what_it_names():
    one, two = swung(100), swung(100, seed=1)
    dataset = bsp_gp.Dataset.from_frames(
        {name: pd.DataFrame({"t": d.scenes[0].times, "x": d.scenes[0].positions[:, 0, 0]})
         for name, d in (("one", one), ("two", two))},
        units=UNITS, test=["two"],
    )  # fmt: skip
    found = in_stretches(dataset)
    assert found.test == tuple(f"two/{k}" for k in range(1, 9))


@pytest.mark.slow
def test_what_a_hundred_turns_lack_is_found():
    report = bsp_gp.close_loop(swung(100), "-k * m_i * (p_i - origin)", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    (effect,) = [r.effect for r in report.rounds if r.adopted]
    assert effect.law.split(" * ", 1)[1] in ("v_i", "(norm(v_i) * normalize(v_i))")
    (constant,) = effect.constants
    assert constant.low < -0.005 < constant.high
