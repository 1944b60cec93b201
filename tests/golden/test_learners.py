"""The learning searches on the paper's scenes: they find the true laws within few scored laws."""


import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.cross_entropy import CrossEntropy
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search

NEWTONIAN = load_grammar("newtonian")
# Scenes, scored laws, constant, law.
PROBLEMS = {
    "nbody": ([1], 5000, 8167.007, "m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"),
    "mat": ([1, 2], 5000, -0.8, "mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)"),
    "bounce": (
        [1, 2], 20_000, 100.0,
        "m_i * m_j / (m_i + m_j) * project(v_i - v_j, normalize(p_i - p_c)) "
        "* normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)",
    ),
}  # fmt: skip
STRATEGIES = {"cross_entropy": CrossEntropy(), "genetic": Genetic()}


@pytest.fixture(scope="module")
def problem(shared_data):
    made = {}

    def make(name):
        if name not in made:
            numbers = PROBLEMS[name][0]
            dataset = load_dataset(shared_data / "synth" / name)
            types = dataset_types(dataset)
            grammar, _ = NEWTONIAN.masked(set(types), 2)
            scenes = list(dataset.select([str(number) for number in numbers]))
            made[name] = build_regression(scenes, sigma=1e-3), grammar, types
        return made[name]

    return make


def explains_all(_, objective):
    return any(score.loss < 1e-12 * objective.total for _, score in objective.best.values())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", PROBLEMS)
def test_learners_find_the_true_law(problem, name, strategy, seed):
    _, cap, constant, text = PROBLEMS[name]
    regression, grammar, types = problem(name)
    objective = Objective(regression, grammar, "pair", beta=1e-3)
    result = run_search(
        STRATEGIES[strategy], objective, Budget(n_scored=cap), rng=np.random.default_rng(seed),
        callback=explains_all,
    )  # fmt: skip
    assert objective.n_scored < cap
    best = result.best
    assert best.loss < 1e-12 * best.total
    # It is the true law, with the true constant, up to the equality of laws on these scenes.
    (free,) = best.constants
    found = regression.column(Term(split_linear(best.formula)[1], "pair"))[0][:, 0]
    true = regression.column(
        Term(parse_formula(text, types, operators=NEWTONIAN.operators), "pair")
    )[0][:, 0]
    np.testing.assert_allclose(
        best.constants[free] * found, constant * true, atol=1e-6 * np.abs(constant * true).max()
    )
    # Nothing as simple is as good, and the front ends with it.
    assert result.front[-1].loss < 1e-12 * best.total
    assert objective.n_trees == objective.n_repeats + len(objective._scores)
