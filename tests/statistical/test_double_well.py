"""A wheel between two rests, of which the declared spring knows nothing."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp

pytestmark = pytest.mark.slow


def test_the_well_and_the_drag_are_found_and_nothing_beside_them():
    """The sum that moments choose has a third term, of which the fit leaves nothing."""
    t = np.arange(600) * 0.05
    made = solve_ivp(
        lambda t, y: [y[1], -10 * y[0] + 10.6 * np.sin(y[0]) - 0.1 * y[1]], (0, t[-1]), [1.6, 0.0],
        t_eval=t, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    x = made.y[0] + 2e-3 * np.random.default_rng(0).standard_normal(600)
    dataset = bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": t, "x": x}), units={"length": "rad", "time": "s"}
    )
    report = bsp_gp.close_loop(dataset, "-k * m_i * theta_i", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    (effect,) = [r.effect for r in report.rounds if r.adopted]
    well, drag = effect.law.split(" + ")
    assert well.startswith("c1 * (sin(") and "v_i" in drag
    told = {c.name: c for c in effect.constants}
    assert set(told) == {"c1", "h_x1", "c2"}
    assert told["c1"].low < 10.6 < told["c1"].high and told["h_x1"].low < 0 < told["h_x1"].high
    assert told["c2"].value == pytest.approx(-0.1, abs=3e-4)
