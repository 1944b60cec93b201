"""Errors before and after, and how far their intervals may be trusted."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.loop.before_after import compared
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.models import Model
from bsp_gp.loop.preparing import observe
from bsp_gp.physics.metrics import METRICS, error_of, one_step_nrmse, residual_acceleration
from tests.throws import C1, GRAVITY, throws

TRUE = (GRAVITY, f"-{C1} [kg/s] * v_i")
HALF = (GRAVITY, f"-{C1 / 2} [kg/s] * v_i")
FIVE = ("s1", "s3", "s4", "s6", "s7")


def rng(seed=0):
    return np.random.default_rng(seed)


def seen(test, seed=0):
    """Observation of throws with noise, which scenes to hold out given."""
    data = replace(
        throws(n_scenes=8, n_times=30, sigma=0.01, noise=(0.01,), seed=seed), test=tuple(test)
    )
    return observe(data, declared_law(data, TRUE), rng())


def model(observation, texts):
    law = declared_law(observation.dataset, texts)
    return Model(law, None, *observation.errors(law))


def both(observation, texts, seed=0, copies=None):
    before, after = (model(observation, t) for t in ((GRAVITY,), texts))
    if copies is None:
        _, copies = observation.floor(after.law, rng(seed))
    return compared(observation, before, after, copies, rng(seed))


def test_five_scenes_are_resampled():
    observation = seen(FIVE)
    found = both(observation, TRUE, copies=())
    ratio = found.ratio
    assert ratio.method == "resampling 5 held-out scenes"
    assert 0 < ratio.low < ratio.value < ratio.high < 0.2
    assert ratio.value == pytest.approx(found.after.rollout_rmse / found.before.rollout_rmse)
    assert set(found.ratios) == set(METRICS) == set(found.after.intervals)
    for metric, (low, high) in found.after.intervals.items():
        assert low < getattr(found.after, metric) < high
    same = model(observation, TRUE)
    for unchanged in compared(observation, same, same, (), rng()).ratios.values():
        assert (unchanged.value, unchanged.low, unchanged.high) == (1, 1, 1)


def test_errors_are_those_of_the_rows():
    observation = seen(FIVE)
    errors, rows = observation.errors(declared_law(observation.dataset, TRUE))
    for metric in METRICS:
        assert getattr(errors, metric) == error_of(metric, rows)
    regression = observation.test_regression
    law = declared_law(observation.dataset, TRUE)
    assert errors.residual_acceleration == pytest.approx(residual_acceleration(regression, law))
    assert errors.one_step_nrmse == pytest.approx(one_step_nrmse(observation.test, law, "y"))


def test_fewer_scenes_are_simulated():
    observation = seen(FIVE[:4])
    found = both(observation, TRUE)
    assert found.ratio.method == "parametric: fewer than five held-out scenes"
    for metric, ratio in found.ratios.items():
        assert 0 < ratio.low <= ratio.value <= ratio.high
        low, high = found.before.intervals[metric]
        assert low <= getattr(found.before, metric) <= high
    assert found.ratio.high < 0.2
    none = both(observation, TRUE, copies=())
    assert none.ratio.value == found.ratio.value
    assert np.isnan([none.ratio.low, none.ratio.high, *none.after.intervals["endpoint"]]).all()


def test_misfit_is_carried_over():
    """A law that does not fit must not get an interval that presumes that it does."""
    observation = seen(FIVE[:2])
    ratio = both(observation, HALF).ratio
    assert 0.3 < ratio.low <= ratio.value <= ratio.high


@pytest.mark.slow
@pytest.mark.parametrize("test", [FIVE[:2], FIVE[1:2]], ids=["two scenes", "one"])
@pytest.mark.parametrize("texts", [TRUE, HALF], ids=["true law", "half of it"])
def test_simulated_intervals_cover(test, texts):
    """Of the same flights measured again, 90 % of the intervals have the error in them.

    What an error is, is its root mean square over measurements; both laws are given.
    """
    n, found = 100, []
    for seed in range(n):
        found.append(both(seen(test, seed), texts, seed))
    for metric in ("rollout_rmse", "endpoint_mean"):
        squares = [[getattr(f.before, metric) ** 2, getattr(f.after, metric) ** 2] for f in found]
        before, after = np.sqrt(np.mean(squares, axis=0))
        inside = [
            (
                _is_in(f.before.intervals[metric], before),
                _is_in(f.after.intervals[metric], after),
                _is_in((f.ratios[metric].low, f.ratios[metric].high), after / before),
            )
            for f in found
        ]
        # 90 %, give or take three standard errors of the share among n.
        assert np.mean(inside, axis=0) == pytest.approx(0.9, abs=3 * np.sqrt(0.09 / n)), metric


def _is_in(interval, value):
    low, high = interval
    return low <= value <= high
