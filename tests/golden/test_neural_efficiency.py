"""What `experiments/neural_efficiency.py` calls the true law, and the worlds that it judges in."""

import sys
from pathlib import Path

import pytest

from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.metrics import one_step_nrmse

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
    names = ("neural_efficiency", "neural_summary", "neural_judges", "data_efficiency",
             "nbody_contacts", "scenes", "common")  # fmt: skip
    for name in names:
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("text", "c1", "free", "everywhere"),
    [
        (GRAVITY, 8167.007, True, False),
        (GRAVITY, 8167.1, False, False),
        (PUSH, 0.0, False, False),
        (f"{GRAVITY} + {REBOUND}", 8167.007, True, True),
        (f"{GRAVITY} + {PUSH}", 8167.007, True, False),
    ],
)
def test_a_law_is_the_true_one_if_it_leaves_nothing(study, text, c1, free, everywhere):
    formula = parse_formula(text, study.scenario("nbody").input_types)
    constants = {"c1": c1, "c2": 100.0}
    constants = {name: constants[name] for name in formula.constants}
    law = ForceLaw((Term(formula, "pair"),), constants)
    found = study.successes(study.errors_on_test("nbody", law))
    assert found == {"success_free": free, "success": everywhere}


@pytest.mark.parametrize("name", ["nbody", "mat", "bounce"])
def test_the_true_law_leaves_nothing_in_other_worlds(study, name):
    import neural_judges

    law = neural_judges.true_law(name)
    for label, sets in neural_judges.other_worlds(name).items():
        for scenes in sets:
            assert len(scenes) == neural_judges.N_OTHER, label
            assert one_step_nrmse(scenes, law) < 1e-9, label
            # Or there would be nothing to judge.
            assert one_step_nrmse(scenes, ForceLaw(())) > 1e-4, label


def test_scenes_with_a_contact_are_told_by_their_tracks(study):
    import nbody_contacts

    assert nbody_contacts.touching() == [13, 22, 30, 42, 44, 45, 51, 52, 74]


@pytest.mark.slow
def test_a_pull_and_two_contacts_are_told_apart(study):
    """Squares rank the pull 38th: what fits two violent rows by chance comes first."""
    scenes = [study.scenario("nbody").scene(name) for name in ("30", "42")]
    best, _ = study.exhaustive("nbody", scenes)["exhaustive, sums"]
    law = ForceLaw((Term(best.formula, "pair"),), best.constants)
    fresh = [study.scenario("nbody").scene(str(k)) for k in range(11, 31)]
    assert one_step_nrmse(fresh, law) < 1e-9
    assert study.errors_on_test("nbody", law)["nrmse_test"] < 1e-9
    assert sorted(best.constants.values()) == pytest.approx([-8167.007, 100.0], rel=1e-9)


@pytest.mark.parametrize("quick", [True, False])
def test_longer_trainings_come_last_and_the_costly_at_few_numbers_of_scenes(study, quick):
    jobs = study.jobs_of(quick, 0)
    assert len(set(jobs)) == len(jobs)
    longer = [job for job in jobs if job[2] in study.LONGER]
    assert jobs[-len(longer) :] == longer
    at = {}
    for name, n, method, *_ in longer:
        at.setdefault((name, method.removesuffix(", longer")), set()).add(n)
    every = {name: {job[1] for job in jobs if job[0] == name} for name in study.PAPER_ZERO}
    assert at["mat", "HOGN"] == {max(every["mat"])}
    assert at["nbody", "OGN"] == {max(every["nbody"])}
    assert at.get(("nbody", "HOGN"), set()) == every["nbody"] & {5, 10}
    assert not any(name == "bounce" for name, _ in at)
