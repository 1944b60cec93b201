"""A ball that spins about an axis that lies aslant is turned aside by three numbers."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.loop.close import close_loop
from bsp_gp.report.page import page_of

SPIN, DRAG, G = np.array([0.25, -0.3, 0.2]), 0.12, 9.81


def flights(n=4, rows=60, sigma=3e-4, seed=0):
    """Throws of one ball in space, all with the same spin."""
    rng, frames = np.random.default_rng(seed), []
    times = np.linspace(0.0, 0.6, rows)

    def rate(_, z):
        v = z[3:]
        push = np.array([0.0, 0.0, -G]) - DRAG * np.linalg.norm(v) * v + np.cross(SPIN, v)
        return np.r_[v, push]

    for k in range(n):
        first = np.r_[rng.normal(0, 0.1, 3), rng.normal([0, 0, 2], 1) + [4.0, -3.0, 1.0]]
        places = solve_ivp(rate, (0, 0.6), first, t_eval=times, rtol=1e-9, atol=1e-10).y[:3].T
        places = places + sigma * rng.standard_normal(places.shape)
        frames.append(pd.DataFrame(
            {"t": times, "scene": f"s{k}", **dict(zip("xyz", places.T, strict=True))}
        ))  # fmt: skip
    return bsp_gp.Dataset.from_frames(
        pd.concat(frames, ignore_index=True), units={"length": "m", "time": "s"}, up="z"
    )


def test_weight_drag_and_a_spin_of_three_numbers_are_told_together():
    """Springs to far points had stood in for it: sums of so many terms were not looked at."""
    report = close_loop(flights(), "nothing", rng=0, n_bootstrap=0)
    first = report.rounds[0]
    assert first.adopted
    found = {}
    for term, value in zip(first.effect.law.split(" + "), first.effect.constants, strict=True):
        found[term.split(" * ", 1)[1]] = value.value
    assert found["e_z"] == pytest.approx(-G, abs=0.2)
    spin = [found[f"cross(e_{axis}, v_i)"] for axis in "xyz"]
    assert spin == pytest.approx(SPIN, abs=0.03)
    told = page_of(report).rounds[0].effect.parts
    assert sum("across the velocity, linear in speed" in part for part in told) == 1
