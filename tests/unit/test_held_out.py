"""Errors on held-out rows that do not show every body."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Entity
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.physics.metrics import METRICS
from tests.throws import GRAVITY, MASS, throws

PULL = "c / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def two_balls(seen):
    """A ball that is always seen, and one whose rows are `seen`, over one scene of 40 rows."""
    data = throws(n_scenes=1, n_times=40, sigma=0.01)
    (scene,) = data.scenes
    other = np.array(throws(n_scenes=1, n_times=40, sigma=0.01, seed=1).scenes[0].positions)
    other += [5.0, 1.0]
    other[~np.isin(np.arange(40), seen)] = np.nan
    crew = (*scene.entities, Entity("other", "disc", radius=0.05, properties={"mass": MASS}))
    positions = np.concatenate([scene.positions, other], axis=1)
    return replace(data, scenes=(replace(scene, positions=positions, entities=crew),))


def fitted(seen, *laws):
    return fit_law(two_balls(seen), [GRAVITY, *laws], rng=np.random.default_rng(0), noise=0.01)


def numbers_of(errors):
    return [getattr(errors, name) for name in METRICS]


@pytest.mark.parametrize("seen", [range(12), range(0, 40, 2)], ids=["early", "every second"])
def test_a_body_that_held_out_rows_lack_is_scored_nowhere(seen):
    found = fitted(seen, "-c1 * v_i")
    assert found.status == "converged"
    assert np.isfinite(numbers_of(found.errors)).all()
    assert found.errors.rollout_rmse < 0.2


def test_bodies_that_may_pull_each_other_are_not_foreseen_without_one_of_them():
    found = fitted(range(12), PULL)
    assert np.isfinite(found.constants[0].value)
    assert np.isnan(numbers_of(found.errors)).all()


def test_a_body_that_only_held_out_rows_show_does_not_count_in_the_fit():
    found = fitted(range(30, 40), "-c1 * v_i")
    assert found.status == "converged"
    assert np.isfinite(numbers_of(found.errors)).all()


def test_tracks_without_three_successive_rows_have_errors_of_places_alone():
    data = two_balls(range(40))
    (scene,) = data.scenes
    positions = np.array(scene.positions)
    positions[30::3] = np.nan
    data = replace(data, scenes=(replace(scene, positions=positions),))
    errors = fit_law(data, [GRAVITY], rng=np.random.default_rng(0), noise=0.01).errors
    assert np.isfinite([errors.rollout_rmse]).all()
    assert np.isnan([errors.one_step_nrmse, errors.residual_acceleration]).all()
