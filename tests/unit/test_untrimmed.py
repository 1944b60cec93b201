"""Recordings that begin before a body is let go and go on after it has landed."""

import numpy as np
import pandas as pd

import bsp_gp
from bsp_gp.loop.proposers.defects import Defects
from tests.loop_views import view_of

FALL = "9.81 [m/s^2] * m_i * down"
SIGMA, STEP = 0.002, 0.02


def drops(held, landed, seed=0):
    """Four drops by 30 rows, held before for some rows, and readings that are none behind."""
    rng, frames = np.random.default_rng(seed), {}
    for k in range(4):
        t = np.arange(30) * STEP
        fall = 2.0 + 0.1 * k - 4.905 * t**2
        y = np.concatenate([np.full(held, fall[0]), fall, np.full(landed, 0.9 + 0.1 * k)])
        y = y + SIGMA * rng.standard_normal(len(y))
        frames[f"d{k}"] = pd.DataFrame({"t": np.arange(len(y)) * STEP, "x": 0.0, "y": y})
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    units = {"length": "m", "time": "s", "mass": "kg"}
    return bsp_gp.Dataset.from_frames(frames, bodies, units=units, up="y")


def untrimmed_of(data):
    return [p for p in Defects().propose(view_of(data, FALL)).proposals if p.code == "untrimmed"]


def test_what_is_before_and_behind_the_motion_is_left_out_at_once():
    held, landed = 12, 9
    (found,) = untrimmed_of(drops(held, landed))
    ends = [(part.row, part.stop) for part in found.hypothesis.parts if hasattr(part, "stop")]
    assert len(ends) == 8
    heads = [stop for row, stop in ends if row == 0]
    tails = [row for row, _ in ends if row]
    assert np.abs(np.array(heads) - held).max() <= 3  # what has just been let go hardly moves
    assert np.abs(np.array(tails) - held - 30).max() <= 1
    assert found.promise > 100


def test_drops_that_are_trimmed_stay_whole():
    assert not untrimmed_of(drops(0, 0))
