"""An invisible attractor among five visible discs: found, placed, and not invented."""

import numpy as np
import pytest

from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.hidden import hidden_body
from bsp_gp.loop.preparing import observe
from tests.hidden_worlds import GRAVITY, discs

pytestmark = pytest.mark.slow

ALPHA = 0.01
LEAST_BIC = 6.0


def sought(seed, hidden):
    """Whether one is claimed, and the error of its place in posterior standard deviations."""
    dataset, place = discs(seed, hidden)
    law = declared_law(dataset, [GRAVITY])
    rng = np.random.default_rng(seed)
    observation = observe(dataset, law, rng)
    model = evaluate(observation, law)
    found = hidden_body(observation, model, rng)
    if found is None or "p_value" not in found.details:
        return False, np.nan
    n = found.fit.n_effective
    gain = model.fit.bic(n) - found.bic(n)
    claimed = found.details["p_value"] <= ALPHA and gain > LEAST_BIC and not found.reason
    error = np.linalg.norm(np.array(found.details["best"][:2]) - place)
    return claimed, error / np.linalg.norm(found.details["sd"][:2])


def test_an_invisible_attractor_is_found_where_it_is():
    results = [sought(seed, True) for seed in range(8)]
    errors = [error for claimed, error in results if claimed]
    assert len(errors) >= 7
    assert np.mean(np.array(errors) <= 3.0) >= 0.85


def test_none_is_invented():
    """At alpha 0.01, 20 scenes: more than one would happen by chance once in 60 times."""
    assert sum(sought(seed, False)[0] for seed in range(100, 120)) <= 1
