"""What is filmed in class rooms: carts that meet, paper cups that fall."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import Dataset, close_loop
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import verdict_sentence


def closed(frame, units):
    data = Dataset.from_frames(frame, units=units)
    return close_loop(data, "nothing", rng=np.random.default_rng(0), n_bootstrap=0)


@pytest.mark.slow
def test_two_carts_that_meet_push_each_other_where_they_touch():
    rng, t = np.random.default_rng(8), np.arange(60) / 30

    def rates(_, z):
        push = 400.0 * max(0.0, 0.1 - (z[1] - z[0]))
        return [z[2], z[3], -push, push]

    places = solve_ivp(rates, (0, t[-1]), [0, 0.7, 0.6, 0], t_eval=t, max_step=0.005).y[:2]
    frame = pd.DataFrame({"t": t, **{f"x{k + 1}": p + rng.normal(0, 0.002, len(t))
                                     for k, p in enumerate(places)}})  # fmt: skip
    report = closed(frame, {"length": "m", "time": "s"})
    assert "of bodies that touch, nearer than a distance" in verdict_sentence(page_of(report))
    (reach,) = (c for c in report.constants if c.name.startswith("L"))
    assert reach.low <= 0.1 <= reach.high


@pytest.mark.slow
def test_a_paper_cup_has_weight_and_drag_and_no_air_that_thins():
    """Its drag faded with a length of many times its way: plain drag with a number more."""
    rng, t = np.random.default_rng(7), np.arange(28) / 25
    fastest = rng.uniform(1, 2)
    fall = 2.0 - fastest**2 / 9.81 * np.log(np.cosh(9.81 * t / fastest))
    frame = pd.DataFrame({"t": t, "y": fall + rng.normal(0, 0.004, len(t))})
    report = closed(frame, {"length": "m", "time": "s"})
    assert "exp(" not in report.law_text
    assert [len(term.formula.constants) for term in report.law.terms] == [1, 1]
