"""Searches side by side: regret against the certified optimum, the same rows on any executor."""

import signal
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

from bsp_gp.cli import main
from bsp_gp.cli_inputs import masked_grammar
from bsp_gp.data.tables import save_dataset
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.search.compare import certified, compare, run_one
from bsp_gp.search.comparison import compare_searches, regressions
from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget
from tests.planted import orbit_dataset
from tests.unit.test_banks_exhaustive import MIXED, grammar_of, regression_of

SMALL = {"cross_entropy": CrossEntropy(population=100, elite=10), "random": RandomSearch(100)}


def outcomes(executor=None):
    objective = Objective(regression_of(), grammar_of(MIXED), "pair", criterion="mdl")
    return compare(
        objective, Budget(n_steps=4), seeds=2, rng=np.random.default_rng(0), strategies=SMALL,
        executor=executor,
    )  # fmt: skip


def test_the_optimum_is_the_measure_of_the_others():
    found = outcomes()
    assert [o.search for o in found] == ["exhaustive", *["cross_entropy"] * 2, *["random"] * 2]
    assert [o.seed for o in found] == [0, 0, 1, 0, 1]
    # The little grammar has no laws beyond eight levels that are not equal to shallower ones.
    assert all(o.cost >= found[0].cost - 1e-9 for o in found)
    assert any(o.cost == pytest.approx(found[0].cost) for o in found[1:])
    for outcome in found:
        assert 0 < outcome.n_to_best <= outcome.n_evaluated <= outcome.n_trees
        assert 0 <= outcome.seconds_to_best <= outcome.seconds
    assert found[0].certificate is not None


def test_rows_are_the_same_on_an_executor():
    with ThreadPoolExecutor(2) as pool:
        there = outcomes(pool)
    for one, other in zip(outcomes(), there, strict=True):
        assert (one.search, one.seed, one.cost, one.n_evaluated, one.n_to_best) == (
            other.search, other.seed, other.cost, other.n_evaluated, other.n_to_best,
        )  # fmt: skip


def test_a_run_ends_when_it_is_told():
    objective = Objective(regression_of(), grammar_of(MIXED), "pair")
    optimum = certified(objective)
    outcome = run_one(
        objective, "random", RandomSearch(50), 0, Budget(n_steps=400),
        rng=np.random.default_rng(1), is_done=lambda tree, score: score.cost < optimum.cost + 5,
    )  # fmt: skip
    assert outcome.n_trees < 400 * 50
    assert outcome.cost < optimum.cost + 5
    assert objective.n_trees == 0  # runs have objectives of their own


def test_an_interrupt_ends_the_comparison_and_not_one_run_of_it():
    def interrupt(tree, score):
        signal.raise_signal(signal.SIGINT)

    objective = Objective(regression_of(), grammar_of(MIXED), "pair")
    with pytest.raises(KeyboardInterrupt):
        run_one(
            objective, "random", RandomSearch(50), 0, Budget(n_steps=9),
            rng=np.random.default_rng(1), is_done=interrupt,
        )  # fmt: skip


def test_a_model_on_a_users_data():
    """Drag is missing from orbits: the learners and the certified search find the same law."""
    dataset = orbit_dataset(0, n_train=2, n_test=2, drag=0.05, sigma=1e-3)
    grammar, missing = masked_grammar(load_grammar("physics"), dataset)
    rows, certificate, how = compare_searches(
        dataset, ["1 [m^3/(kg s^2)] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"],
        grammar, rng=np.random.default_rng(0), kind="field", seeds=2, n_scored=150,
        searches=("cross_entropy",), exclude=("t",), missing_inputs=missing,
    )  # fmt: skip
    assert [row["search"] for row in rows] == ["exhaustive", "cross_entropy", "cross_entropy"]
    assert how == "gls"
    assert rows[0]["regret_nats"] == 0
    assert "not sayable" in certificate.text()
    for row in rows:
        assert "v_i" in row["law"]
        assert row["share"] > 0.5
        assert row["left_test"] > 0


def test_the_weak_form_on_a_users_data():
    dataset = orbit_dataset(0, n_train=2, n_test=2, drag=0.05, sigma=1e-3)
    grammar, _ = masked_grammar(load_grammar("physics"), dataset)
    rows, _, how = compare_searches(
        dataset, ["1 [m^3/(kg s^2)] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"],
        grammar, rng=np.random.default_rng(0), kind="field", seeds=1, searches=(), exclude=("t",),
        method="weak",
    )  # fmt: skip
    assert how.startswith("weak, test functions of ")
    assert "v_i" in rows[0]["law"] and rows[0]["share"] > 0.5
    law = declared_law(dataset, ["-1 [kg/s] * v_i"])
    with pytest.raises(SettingsError, match="not by 'one_step'"):
        regressions(dataset, law, np.random.default_rng(0), "one_step")


def falling_ball(tmp_path):
    """One body, falling: there is nothing that a pair law could name."""
    t = 0.02 * np.arange(40)
    rng = np.random.default_rng(3)
    x = np.stack([0.5 * t, 2 - 4.9 * t**2], axis=1) + 1e-3 * rng.standard_normal((40, 2))
    frame = pd.DataFrame({"t": t, "x": x[:, 0], "y": x[:, 1]})
    frame.to_csv(tmp_path / "ball.csv", index=False)
    return str(tmp_path / "ball.csv")


@pytest.mark.slow
def test_one_body_is_searched_for_field_laws(tmp_path, capsys):
    words = ["compare", falling_ball(tmp_path), "--units", "length=m", "time=s", "--quiet"]
    assert main([*words, "--seeds", "1", "--laws", "50", "--out", str(tmp_path / "out")]) == 0
    table = pd.read_csv(tmp_path / "out" / "results.csv")
    assert (table["n_evaluated"] > 0).all()
    assert np.isfinite(table["regret_nats"]).all()
    assert "nan" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "remedy"),
    [(["--kind", "pair"], "choose --kind field"), (["--grammar", "newtonian"], "such as physics")],
)
def test_pair_laws_of_one_body_are_refused(tmp_path, capsys, options, remedy):
    words = ["compare", falling_ball(tmp_path), "--units", "length=m", "time=s", "--quiet"]
    assert main([*words, *options]) == 2
    error = capsys.readouterr().err
    assert "every scene has one body only" in error and remedy in error


def test_unknown_searches_are_refused():
    with pytest.raises(SettingsError, match="must be one of cross_entropy, genetic, random"):
        compare_searches(
            None, [], None, rng=np.random.default_rng(0), searches=("annealing",)
        )  # fmt: skip


def test_the_command(tmp_path, capsys):
    save_dataset(orbit_dataset(1, n_train=2, n_test=2, drag=0.05, sigma=1e-3), tmp_path / "orbits")
    words = [
        "compare", str(tmp_path / "orbits"), "--kind", "field", "--seeds", "1", "--laws", "100",
        "--declare", "1 [m^3/(kg s^2)] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)",
        "--out", str(tmp_path / "out"), "--quiet",
    ]  # fmt: skip
    assert main(words) == 0
    printed = capsys.readouterr().out
    table = pd.read_csv(tmp_path / "out" / "results.csv")
    assert list(table["search"]) == ["exhaustive", "cross_entropy", "genetic", "random"]
    assert printed.count("regret") == 4
    assert "all scored with their best constants" in printed
    assert (tmp_path / "out" / "certificate.txt").read_text().startswith("grammar physics")
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
