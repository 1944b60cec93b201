"""The set-ups around the other tools: objective, polishing, dictionary; no tool is needed."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
REST_LENGTH = "(norm(p_i - p_j) - L) * normalize(p_i - p_j)"


@pytest.fixture(scope="module")
def tools():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import peers_tools

        yield peers_tools
    for name in ("peers_tools", "peers_tasks", "peers", "common"):
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def pairs(tools):
    """Gravity in motion, and what is pulled of which."""
    task = sys.modules["peers_tasks"].TASKS["gravity"]
    return tools.pairs_of(task, tools.motion(task, 0)[0])


def test_the_misfit_of_the_truth_is_nothing_whatever_its_factor(tools, pairs):
    assert tools.misfit(pairs, pairs.pull) < 1e-12
    assert tools.misfit(pairs, -3 * pairs.pull) < 1e-12


def test_the_misfit_is_what_the_best_factor_leaves(tools, pairs):
    pull = pairs.pull * (1 + 0.5 * np.sin(np.arange(len(pairs.pull))))
    factor = tools.scale_of(pairs, pull)
    left = [((f * pairs.summed(pull) - pairs.seen) ** 2).sum() / (pairs.seen**2).sum()
            for f in (factor, 1.01 * factor, 0.99 * factor)]  # fmt: skip
    assert tools.misfit(pairs, pull) == pytest.approx(left[0])
    assert left[0] < min(left[1:])


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_pulls_that_explain_nothing_leave_all(tools, pairs, value):
    assert tools.misfit(pairs, np.full(len(pairs.pull), value)) == 1.0


def test_the_factor_is_that_of_the_law(tools, pairs):
    m_i, m_j, r = pairs.x.T
    assert tools.scale_of(pairs, m_i * m_j / r**2) == pytest.approx(50.0)


def test_constants_are_polished_to_the_truth_and_never_worsened(tools, pairs):
    m_i, m_j, r = pairs.x.T

    def pull_with(constants):
        return constants[0] * m_i * m_j * r ** constants[1]

    known = tools.Known(pairs.x, pairs=pairs)
    assert known.polished(pull_with, [1.0, -1.5])[1] == pytest.approx(-2.0, abs=1e-6)
    np.testing.assert_array_equal(known.polished(pull_with, [7.0, -2.0]), [7.0, -2.0])
    nothing = known.polished(lambda constants: m_i * np.nan, [1.0])
    np.testing.assert_array_equal(nothing, [1.0])
    assert len(known.polished(lambda constants: m_i, [])) == 0
    seen = tools.Known(pairs.x, pairs.pull)
    np.testing.assert_allclose(seen.polished(pull_with, [40.0, -1.9]), [50.0, -2.0], rtol=1e-6)
    assert seen.error(2 * pairs.pull) == pytest.approx(1.0)
    assert known.error(2 * pairs.pull) < 1e-12
    assert seen.error(np.nan * m_i) == pytest.approx(1.0)
    assert known.error(np.nan * m_i) == pytest.approx(1.0)


def test_a_program_of_gplearn_gets_other_constants(tools):
    program = SimpleNamespace(program=["mul", 0.5, "exp", 2, 1.5])
    assert tools.with_constants(program, [3.0, 4.0]).program == ["mul", 3.0, "exp", 2, 4.0]
    assert program.program == ["mul", 0.5, "exp", 2, 1.5]


@pytest.mark.parametrize(("is_wide", "n"), [(False, 36), (True, 4 * (17 + 9))])
def test_the_dictionary_has_what_its_names_say(tools, is_wide, n):
    x = np.array([[2.0, 3.0, 4.0], [5.0, 7.0, 9.0]])
    columns = tools.dictionary(x, is_wide)
    assert len(columns) == n
    np.testing.assert_allclose(columns["m_i m_j r^-2"], [6 / 16, 35 / 81])
    np.testing.assert_allclose(columns["1 r^0"], 1.0)
    if is_wide:
        np.testing.assert_allclose(columns["m_j r^-1.5"], [3 / 8, 7 / 27])
        np.testing.assert_allclose(columns["m_i exp(-r/3) r^-1"], x[:, 0] * np.exp(-x[:, 2] / 3)
                                   / x[:, 2])  # fmt: skip


def test_the_dictionary_has_the_depth_of_a_contact_where_radii_are_known(tools):
    x = np.array([[2.0, 3.0, 4.0, 5.5], [5.0, 7.0, 9.0, 5.0]])
    columns = tools.dictionary(x)
    assert len(columns) == 36 + 8
    np.testing.assert_array_equal(columns["1 max(s - r, 0)"], [1.5, 0.0])
    np.testing.assert_array_equal(columns["m_j max(s - r, 0)^2"], [6.75, 0.0])


def test_laws_are_judged_beyond_what_was_learned_from_too(tools):
    tasks = sys.modules["peers_tasks"]
    for name in ("gravity", "contact"):
        task = tasks.TASKS[name]
        known, fresh, far = (tools.pairs_of(task, scenes) for scenes in tasks.motion(task, 0))
        depth = [(p.x[:, -1] if task.has_contact else 0) - p.x[:, 2] for p in (known, fresh, far)]
        if task.has_contact:
            assert depth[2].max() > max(depth[0].max(), depth[1].max())
        else:
            assert depth[2].min() < 1.3 * min(depth[0].min(), depth[1].min())


def test_forms_with_constants_inside_are_found_on_single_steps(tools):
    """As the peers' study searches them: a regression of one step, of any layout of moments."""
    from bsp_gp.physics.bodies import dataset_types
    from bsp_gp.physics.likelihood import build_regression
    from bsp_gp.search.inner import ZOOMS, InnerSearch, read_forms

    tasks = sys.modules["peers_tasks"]
    scenes = tasks.motion(tasks.TASKS["rest length"], 0)[0]
    data, known = tasks.dataset_of(scenes), build_regression(scenes, sigma=1e-3)
    grammar, types = load_grammar("physics"), dataset_types(tasks.dataset_of(scenes))
    forms = read_forms(grammar, data, (), set(types))
    (form,) = [f for f in forms if to_text(f.term.formula) == REST_LENGTH]
    target = known.target()
    search = InnerSearch(
        known, target, np.zeros((len(target), 0)), lambda columns: columns,
        np.ones(2, dtype=bool), grammar.inside["ranges"], types,
    )  # fmt: skip
    scan = search.scan(form)
    for zoom in range(ZOOMS):
        scan = search.closer(scan, zoom)
    assert scan.axes[0].values(scan.at[0]) == pytest.approx(6.5, rel=1e-2)
    assert scan.best == pytest.approx(target @ target, rel=1e-3)
