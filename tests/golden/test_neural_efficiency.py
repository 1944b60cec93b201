"""What `experiments/neural_efficiency.py` calls the true law."""

import sys
from pathlib import Path

import pytest

from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.force import ForceLaw, Term

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
GRAVITY = "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
PUSH = "c2 * m_i * m_j * normalize(p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)"
REBOUND = (
    "c2 * m_i * m_j / (m_i + m_j) * project_abs(v_i - v_j, normalize(p_i - p_j)) "
    "* normalize(p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)"
)


@pytest.fixture(scope="module")
def study(shared_data):
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(EXPERIMENTS))
    patch.setenv("BSP_GP_DATA", str(shared_data))
    import neural_efficiency

    yield neural_efficiency
    patch.undo()
    for name in ("neural_efficiency", "neural_judges", "data_efficiency", "scenes", "common"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (GRAVITY, True),
        (PUSH, False),
        (f"{GRAVITY} + {REBOUND}", True),
        (f"{GRAVITY} + {PUSH}", False),
    ],
)
def test_a_sum_is_the_true_law_if_it_leaves_nothing(study, text, expected):
    formula = parse_formula(text, study.scenario("nbody").input_types)
    constants = {"c1": 8167.007, "c2": 100.0}
    constants = {name: constants[name] for name in formula.constants}
    assert study.is_right("nbody", ForceLaw((Term(formula, "pair"),), constants)) is expected


@pytest.mark.slow
def test_a_pull_and_two_contacts_are_told_apart(study):
    """Squares rank the pull 38th: what fits two violent rows by chance comes first."""
    scenes = [study.scenario("nbody").scene(name) for name in ("30", "42")]
    best, _ = study.searched("nbody", scenes, "exhaustive, sums", 0, 0)
    assert study.is_right("nbody", ForceLaw((Term(best.formula, "pair"),), best.constants))
    assert sorted(best.constants.values()) == pytest.approx([-8167.007, 100.0], rel=1e-9)
