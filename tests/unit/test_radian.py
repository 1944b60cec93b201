"""Where places are angles, sines are those of angles."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import Dataset, close_loop, parse_formula
from bsp_gp.errors import LawError
from bsp_gp.language.formula import evaluate
from bsp_gp.language.inputs import input_types
from bsp_gp.language.render import to_text
from bsp_gp.units import UnitSystem

TYPES = input_types({}, n_dims=2)
PLACE = {"p_i": np.array([0.7, 0.0]), "origin": np.zeros(2), "e_x": np.array([1.0, 0.0])}
ANGLES = UnitSystem.from_declared({"length": "rad", "time": "s"})


@pytest.mark.parametrize("text", ["c1 * (sin(x_i - h) * e_x)", "c1 * (cos(x_i) * e_x)"])
def test_a_sine_of_an_angle_is_that_of_its_radians(text):
    formula = parse_formula(text, TYPES, units=ANGLES)
    written = to_text(formula)
    assert "/ 1 [rad])" in written
    same = evaluate(parse_formula(written, TYPES, units=ANGLES), PLACE, {"c1": 1.0, "h": 0.2})
    assert evaluate(formula, PLACE, {"c1": 1.0, "h": 0.2}) == pytest.approx(same)


def test_a_sine_of_a_length_is_none():
    metres = UnitSystem.from_declared({"length": "m", "time": "s"})
    with pytest.raises(LawError, match="sin takes a dimensionless number, got m"):
        parse_formula("c1 * sin(x_i) * e_x", TYPES, units=metres)
    text = "c1 * (sin(x_i / 1 [m]) * e_x)"
    assert to_text(parse_formula(text, TYPES, units=metres)) == text


def test_a_pendulum_on_an_axle_is_driven_back_by_the_sine_of_its_angle():
    t = np.linspace(0, 6, 240)
    found = solve_ivp(lambda _, z: [z[1], -20 * np.sin(z[0]) - 0.1 * z[1]], (0, 6), [1.1, 0.0],
                      "DOP853", t, rtol=1e-9, atol=1e-9)  # fmt: skip
    angle = found.y[0] + np.random.default_rng(3).normal(0, 0.003, len(t))
    data = Dataset.from_frames(
        pd.DataFrame({"t": t, "entity": "arm", "x": angle}), units={"length": "rad", "time": "s"}
    )
    report = close_loop(data, "nothing", rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=1)
    assert report.verdict == "effect adopted"
    assert "sin((x_i - h_x1) / 1 [rad])" in report.rounds[0].effect.name
    assert "sin(theta_i - " in report.law.text()
    assert abs(abs(report.law.constants["c1"]) - 20) < 0.2
