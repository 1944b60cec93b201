"""Exponents of the trace over many seeds: no bias, and intervals that hold what they promise."""

import numpy as np
import pytest

from bsp_gp.loop.close import declared_law
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.trace import trace_residual
from tests.planted import GRAVITY, orbit_dataset
from tests.worlds import WEIGHT, flights, linear_drag, quadratic_drag, tied, wind

N_SEEDS = 12
ALONG = "along the velocity"
CASES = (
    (lambda s: flights(s, linear_drag, sigma=0.05, n_train=6), [WEIGHT], ALONG, "speed", 1.0),
    (lambda s: flights(s, quadratic_drag, sigma=0.1, n_train=6), [WEIGHT], ALONG, "speed", 2.0),
    (lambda s: flights(s, wind, sigma=0.1, n_train=6), [WEIGHT], "along x", "speed", 0.0),
    (lambda s: orbit_dataset(s, drag=0.1, sigma=0.03), [GRAVITY], ALONG, "speed", 1.0),
    (lambda s: tied(s, rest=0.0, sigma=0.02), [], "along the line to post", "distance", 1.0),
)


@pytest.mark.slow
def test_intervals_of_exponents_cover_the_truth():
    """Exponents that are told without reserve; 90 % intervals, all cases together."""
    held = []
    for build, laws, where, variable, true in CASES:
        for seed in range(N_SEEDS):
            data = build(seed)
            law = declared_law(data, laws)
            observation = observe(data, law, np.random.default_rng(0))
            trace = trace_residual(observation, observation.fit(law), np.random.default_rng(1))
            for e in trace.exponents:
                told = e.is_determined and not e.reason
                if told and (e.channel, e.variable) == (where, variable):
                    held.append((where, true, seed, e.low <= true <= e.high))
    n = len(held)
    coverage = np.mean([row[-1] for row in held])
    assert n >= 0.75 * N_SEEDS * len(CASES)
    # Three binomial standard errors either way.
    assert abs(coverage - 0.9) < 3 * np.sqrt(0.09 / n), [row for row in held if not row[-1]]
