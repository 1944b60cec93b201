"""Forces that come back from turn to turn, beside a memory of the noise that looks like them."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.loop.close import close_loop
from bsp_gp.report.page import page_of

UNITS = {"x": "deg", "time": "s"}


def spun(speed, weight, seed, n_rows=300):
    """A wheel that dry friction slows, with a weight off its axis, seen by a coarse encoder."""
    t = 0.12 * np.arange(n_rows)

    def rate(time, state):
        return state[1], -0.06 * np.sign(state[1]) - weight * np.sin(state[0] - 1.0)

    angle = solve_ivp(rate, t[[0, -1]], (0.3, speed), t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    rng = np.random.default_rng(seed)
    angle = np.floor(np.degrees(angle) / 3.6) * 3.6
    return pd.DataFrame({"t": t + 1e-3 * rng.standard_normal(n_rows), "x": angle})


def wheel(weight):
    spins = [
        spun(speed, weight, k).assign(scene=f"s{k}", entity="wheel")
        for k, speed in enumerate((6.4, 5.2, 4.3))
    ]
    return bsp_gp.Dataset.from_frames(pd.concat(spins), units=UNITS)


@pytest.mark.slow
def test_a_wheel_out_of_balance_is_told_from_a_memory_of_the_noise():
    data = wheel(0.24)
    report = close_loop(data, ["-c * m_i * sign(omega_i)"], rng=np.random.default_rng(0))
    first = report.rounds[0]
    assert first.adopted and first.effect.code == "ripple"
    number = next(c for c in first.effect.constants if c.name.startswith("q"))
    assert number.value == pytest.approx(1.0, abs=0.01)  # once in every turn
    assert report.rounds[-1].verdict == "nothing missing"
    assert "comes back once a turn (out of balance)" in page_of(report).rounds[0].effect.name


@pytest.mark.slow
def test_nothing_comes_back_where_the_wheel_is_in_balance():
    report = close_loop(wheel(0.0), ["-c * m_i * sign(omega_i)"], rng=np.random.default_rng(0))
    assert not any(done.adopted for done in report.rounds)
