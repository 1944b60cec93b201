"""Tasks of the comparison with other tools: what is handed over is what was meant."""

import numpy as np
import pytest

from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import one_step_nrmse, residual_acceleration
from experiments import peers_tasks as P

TASKS = list(P.TASKS.values())
GRAVITY = "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def gravity(scenes):
    formula = parse_formula(GRAVITY, dataset_types(P.dataset_of(scenes)))
    return ForceLaw((Term(formula, "pair"),), {"c1": 50.0})


@pytest.mark.parametrize("task", TASKS, ids=lambda t: t.name)
def test_pulls_summed_over_pairs_are_the_accelerations_seen(task):
    pairs = P.pairs_of(task, P.motion(task, 0)[0])
    assert P.relative(pairs.summed(pairs.pull) - pairs.seen, pairs.seen) < 1e-10
    assert pairs.x.shape == (len(pairs.pull), len(task.columns))


@pytest.mark.parametrize("task", TASKS, ids=lambda t: t.name)
def test_the_table_is_the_law_at_its_rows(task):
    parts = P.table(task, 1)
    for x, y in parts:
        s = x[:, 3] if task.has_contact else np.zeros(len(x))
        np.testing.assert_array_equal(task.pull(*x[:, :3].T, s), y)
        assert y.any()
    known, *others = (set(map(tuple, x)) for x, _ in parts)
    assert all(known.isdisjoint(rows) for rows in others)


def test_the_table_as_motion_shows_the_same_pulls():
    task = P.TASKS["gravity"]
    scenes = P.table_scenes(task, *(part[:20] for part in P.table(task, 0)[0]))
    law = gravity(scenes)
    regression = build_regression(scenes, sigma=1e-3)
    nothing = residual_acceleration(regression, ForceLaw(()))
    assert residual_acceleration(regression, law) < 1e-8 * nothing


def test_a_law_of_our_own_explains_the_motion():
    for scenes in P.motion(P.TASKS["gravity"], 2):
        assert one_step_nrmse(scenes, gravity(scenes)) < 1e-12


def test_the_same_seed_gives_the_same_scenes_and_another_others():
    task = P.TASKS["contact"]
    first, again, other = (P.motion(task, seed)[0][0].positions for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_discs_of_the_contact_law_touch():
    pairs = P.pairs_of(P.TASKS["contact"], P.motion(P.TASKS["contact"], 0)[0])
    assert 0 < (pairs.pull != 0).mean() < 0.5


def test_an_error_that_is_no_number_is_infinite():
    assert P.relative([np.nan, 1.0], [1.0, 1.0]) == np.inf
    assert P.relative([0.3, 0.4], [3.0, 4.0]) == pytest.approx(0.1)
