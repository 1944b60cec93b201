"""What `experiments/neural_summary.py` reads from a table, on a made-up one."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
ZERO = 0.06


@pytest.fixture(scope="module")
def said():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import neural_summary

        yield neural_summary
    for name in ("neural_summary", "neural_judges", "data_efficiency", "scenes", "common"):
        sys.modules.pop(name, None)


def rows(method, n, errors, share=0.5, name="bounce"):
    """A row per draw."""
    return [
        {"scenario": name, "n_scenes": n, "shuffle": k + 1, "method": method, "nrmse_test": error,
         "nrmse_test_free": error, "share_predicted": share, "rollout": 10 * error,
         "other numbers": np.nan if "position" in method else error, "other masses": error,
         "seconds": 1.0}
        for k, error in enumerate(errors)
    ]  # fmt: skip


@pytest.fixture
def table():
    found = []
    for n, exact in ((1, 1), (2, 2), (5, 3)):
        found += rows("zero force", n, 3 * [ZERO])
        found += rows("exhaustive", n, exact * [1e-15] + (3 - exact) * [0.01])
        found += rows("IN, paper", n, [0.2, 0.3, 0.4])
        found += rows("OGN, tuned", n, 3 * [ZERO * 1.0004], share=0.001)
        found += rows("MLP (position), tuned", n, [0.5, np.inf, np.inf])
    return pd.DataFrame(found)


def test_medians_and_quartiles_of_every_point(said, table):
    text = "\n".join(said.errors_table("bounce", table, "nrmse_test", "all"))
    assert "| method | 1 | 2 | 5 |" in text
    assert "| IN, paper | 0.3 [0.25, 0.35] |" in text
    exact = "1e-15 [1e-15, 0.005] | 1e-15 [1e-15, 1e-15]"
    assert f"| exhaustive | 0.01 [0.005, 0.01] | {exact} |" in text
    assert "| MLP (position), tuned | inf [" in text


def test_the_ratio_is_a_bound_where_the_law_is_exact(said, table):
    line = said.ratio_line(table, "nrmse_test")
    assert "At n = 5 the best network (OGN, tuned) errs by 0.06002 m, 1.0004 of zero force" in line
    assert "at least 6e+10 times less" in line
    table.loc[table["method"] == "exhaustive", "nrmse_test"] = 0.02
    assert said.ratio_line(table, "nrmse_test").endswith("by 0.02 m: 3 times less.")


def test_networks_that_predict_nothing_are_called_so(said, table):
    text = "\n".join(said.number_table(table, "nrmse_test", "all"))
    assert text.count("| 1.0004 | 0.001 | equal within 1 %: it predicts no force |") == 3


@pytest.mark.parametrize(
    ("ratio", "share", "words"),
    [(0.98, 0.9, "below"), (1.02, 0.9, "above"), (1.005, 0.9, "equal within 1 %"),
     (0.995, 0.01, "equal within 1 %: it predicts no force")],
)  # fmt: skip
def test_an_error_against_zero_force_in_words(said, ratio, share, words):
    assert said.verdict(ratio, share) == words


def test_the_draws_that_a_median_hides_are_said(said, table):
    line = said.exact_line(table, "nrmse_test")
    assert "below 1e-09 m from n = 2 on; all draws are from n = 5 on" in line
    assert "(of 3: 1 at n = 1, 2 at n = 2, 3 at n = 5)" in line
    # The counts are of one search, not of the luckiest.
    other = pd.DataFrame(rows("genetic", 2, 3 * [1e-15]))
    assert "2 at n = 2" in said.exact_line(pd.concat([table, other]), "nrmse_test")
    table.loc[(table["n_scenes"] == 5) & (table["method"] == "exhaustive"), "nrmse_test"] = 0.1
    assert "exhaustive search is not below" in said.exact_line(table, "nrmse_test")


def test_where_the_searches_are_not_ahead_is_said(said, table):
    assert "at 3 of 3 numbers of scenes; in the paper" in said.lead_line(table, "nrmse_test")
    worse = (table["n_scenes"] == 1) & (table["method"] == "exhaustive")
    table.loc[worse, "nrmse_test"] = 1.0
    line = said.lead_line(table, "nrmse_test", exceptions=(1, 2))
    assert "at 2 of 3 numbers of scenes (not at n = 1); in the paper" in line
    assert line.endswith("at all but n = 1, 2 of 10.")


def test_the_claim_on_bounce_is_judged(said, table):
    papers, every = said.claim_lines(table)
    assert "n = 1, 2, 5: it is not reached; least ratio 5.0000 (IN, paper, n = 1)" in papers
    assert "reached within 1 % at n = 1, 2, 5 with forces of 0.001 of the true" in every
    assert "that is by predicting none; least ratio 1.0004" in every
    below = (table["n_scenes"] == 2) & (table["method"] == "IN, paper")
    table.loc[below, "nrmse_test"] = 0.03
    papers, every = said.claim_lines(table)
    assert "beaten at n = 2; least ratio 0.5000" in papers
    assert "beaten at n = 2; reached within 1 % at n = 1, 5 with" in every


def test_nbody_is_read_with_and_without_contact(said, table):
    table["scenario"] = "nbody"
    lines = said.reading(table)
    assert len(lines) == 3  # no claim of the paper's on NBODY's zero force
    assert "the 17 test scenes without contact" in lines[1]
    assert "all 20 test scenes" in lines[2]


def test_a_summary_has_no_need_of_networks(said, table):
    text = said.summary(table[table["method"].isin(said.SYMBOLIC)])
    assert "Law found, of 3 draws" in text
    assert "| exhaustive | 1 | 2 | 3 |" in text
    assert "The best network" not in text


def test_what_cannot_be_asked_is_said(said, table):
    text = "\n".join(said.other_table("bounce", table))
    assert "| MLP (position), tuned | inf [" in text
    assert "| cannot be asked | inf [" in text
