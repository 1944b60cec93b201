"""The loop closed on worlds of a physics engine: what was undeclared is found, and scored apart."""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from bsp_gp.simulate.effects import effect
from bsp_gp.simulate.synth import RECORDED, make, preset

CASES = {
    "quadratic drag": (effect("quadratic_drag", 0.02, is_declared=False), -0.02),
    "drag": (effect("drag", 0.1, is_declared=False), -0.1),
    "wind": (effect("wind", 0.5, is_declared=False), 0.5),
    "magnetic": (effect("magnetic", 0.3, is_declared=False), 0.3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_an_undeclared_effect_is_found(name):
    change, coefficient = CASES[name]
    settings = preset("fall", [change], n_scenes=8, has_table=False, noise=0.005)
    dataset, truth = make(settings, np.random.default_rng(3))
    report = close_loop(dataset, truth.declared, rng=np.random.default_rng(0), seed=0)
    assert report.verdict == "effect adopted"
    (constant,) = report.constants
    assert constant.value == pytest.approx(coefficient, rel=0.1)
    assert abs(constant.value - coefficient) < 2 * (constant.high - constant.low)


@pytest.mark.slow
def test_nothing_is_found_where_all_is_declared():
    settings = preset("fall", [effect("drag", 0.1)], n_scenes=8, has_table=False, noise=0.005)
    dataset, truth = make(settings, np.random.default_rng(3))
    report = close_loop(dataset, truth.declared, rng=np.random.default_rng(0), seed=0)
    assert report.verdict == "nothing missing"


@pytest.mark.long
@pytest.mark.slow
def test_a_drag_is_found_where_orbits_without_it_reach_no_track():
    drag = effect("drag", 0.1, is_declared=False)
    settings = preset("nbody", [drag], n_scenes=8, **{**RECORDED["nbody"], "noise": 0.05})
    dataset, truth = make(settings, np.random.default_rng(1))
    report = close_loop(dataset, truth.declared, rng=np.random.default_rng(0), seed=0)
    assert report.verdict == report.rounds[0].verdict == "effect adopted"
    (found,) = report.constants
    assert found.low - 0.002 < -0.1 < found.high + 0.002
    assert report.total["after"].rollout_rmse < 0.1 * report.total["before"].rollout_rmse
