"""Angles that were read about a point beside the pivot, or from a zero that is off."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.loop.proposers.measurement import Measurement
from tests.loop_views import view_of

RATE, SIGMA = 12.0, 2e-3


def read_off(across=0.0, along=0.0, zero=0.0, drag=0.0, seed=0, n=400):
    """Angles of a pendulum of length one as they are seen from a point beside its pivot."""
    t = np.arange(n) * 0.03
    made = solve_ivp(lambda t, y: [y[1], -RATE * np.sin(y[0]) - drag * y[1]], (0, t[-1]),
                     [0.9, 0.0], t_eval=t, rtol=1e-10, atol=1e-12)  # fmt: skip
    x, y = np.sin(made.y[0]) - across, np.cos(made.y[0]) + along
    seen = np.arctan2(x, y) - zero + SIGMA * np.random.default_rng(seed).standard_normal(n)
    frame = pd.DataFrame({"t": t, "x": seen})
    return bsp_gp.Dataset.from_frames(frame, units={"length": "rad", "time": "s"})


def proposed(dataset):
    view = view_of(dataset, "-k * m_i * sin(x_i / 1 [rad]) * (1 [rad] * e_x)")
    return {p.code: p for p in Measurement().propose(view).proposals}


@pytest.mark.parametrize(
    ("code", "said", "values"),
    [("pivot", {"across": 0.05, "along": 0.03}, (0.05, 0.03)), ("zero", {"zero": 0.04}, (0.04,))],
)
def test_what_is_off_is_proposed_with_its_numbers(code, said, values):
    dataset = read_off(**said)
    best = max(proposed(dataset).values(), key=lambda p: p.promise)
    assert best.code == code
    names = best.hypothesis.parts[-1].names
    found = fit(best.hypothesis, dataset, starts=best.starts)
    at = [k for k, (name, _) in enumerate(found.parameters) if name in names]
    errors = np.sqrt(np.diag(found.covariance))[at]
    assert np.all(np.abs(found.values[at] - values) < 4 * errors) and errors.max() < 0.01
    assert found.chi2_red == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_drag_is_told_from_a_point_beside_the_pivot():
    dataset = read_off(across=0.05, along=0.03, drag=0.1)
    report = bsp_gp.close_loop(dataset, "-k * m_i * sin(theta_i)", rng=0, n_bootstrap=0)
    codes = [r.effect.code for r in report.rounds if r.adopted]
    assert sorted(codes) == ["law", "pivot"]
    (drag,) = [r.effect for r in report.rounds if r.adopted and r.effect.code == "law"]
    assert drag.law.split(" * ", 1)[1] in ("v_i", "(norm(v_i) * normalize(v_i))")
    (constant,) = [c for c in report.constants if c.name == drag.law.split(" * ")[0]]
    assert constant.low < -0.1 < constant.high
