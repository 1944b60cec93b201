"""A flight in stages: a motor, a coast, a parachute."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp import close_loop

THRUST, BURN, DRAG, OPEN, CHUTE = 75.7, 2.25, 2.5e-3, 11.6, 0.0457


def flight(seed, noise=0.5):
    """Heights of a rocket, m."""
    times, places, state = np.arange(0, 39, 0.05), [], np.zeros(2)

    def rate(t, y, thrust, drag):
        return [y[1], thrust - 9.81 - drag * abs(y[1]) * y[1]]

    for begin, end, push, drag in (
        (0, BURN, THRUST, DRAG), (BURN, OPEN, 0, DRAG), (OPEN, 39, 0, CHUTE),
    ):  # fmt: skip
        own = times[(times >= begin) & (times < end)]
        found = solve_ivp(rate, (begin, end), state, t_eval=[*own, end], args=(push, drag),
                          rtol=1e-9, max_step=0.05)  # fmt: skip
        places += found.y[0, :-1].tolist()
        state = found.y[:, -1]
    height = np.array(places) + noise * np.random.default_rng(seed).standard_normal(len(places))
    frame = pd.DataFrame({"t": times, "y": height})
    return bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"})


@pytest.mark.slow
def test_a_motor_a_coast_and_a_parachute_are_found_together():
    """What came before the parachute had been left out as what a hand does."""
    report = close_loop(flight(2), "nothing", rng=0, n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    true = {"c1": -9.81, "c2": THRUST, "c3": -DRAG, "c4": -CHUTE, "t1": BURN, "t_open1": OPEN}
    assert set(true) <= set(found), report.law_text
    for name, value in true.items():
        assert found[name].value == pytest.approx(value, rel=0.02)
    assert not any("hand" in note for note in report.dataset["notes"])
