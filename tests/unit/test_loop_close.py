"""The new loop from a data set to its report: contract, time limit, removal, words."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.errors import DataError, SettingsError
from bsp_gp.fitting.fit import STATUSES, fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.backward import prune
from bsp_gp.loop.clock import Clock, TimeIsUp
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import CAUSES, LEFT_OUT, REASONS, STOP_REASONS, VERDICTS, Criteria
from bsp_gp.loop.decide import Decision
from bsp_gp.loop.kept import text_of
from bsp_gp.loop.loop import Round, run_rounds
from bsp_gp.loop.proposal import Proposal, continued, with_term
from bsp_gp.loop.proposers.exponents import Declared
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.table import HypothesisTable, Row
from bsp_gp.report.html import render_html
from bsp_gp.report.summary import summary_text
from tests import worlds
from tests.worlds import WEIGHT

TOP = {
    "schema", "dataset", "declared", "grammar", "search", "seed", "alpha", "criteria", "noise",
    "rounds", "law", "total", "verdict", "probability", "equivalents", "hidden_bound",
    "stop_reason", "complete", "left_out", "n_fits", "versions", "wall_s", "extras",
}  # fmt: skip
ROUND = {
    "missing": {"statistic", "p_value", "detectable"},
    "effect": {
        "name", "code", "kind", "law", "latex", "entities", "constants", "p_value", "probability",
        "equivalents",
    },
    "hypotheses": None, "varies_with": None, "noise_findings": None, "hidden_bound": None,
    "adopted": None, "reason": None, "held_out": None, "certificate": None,
    "before": {"residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint", "unit"},
    "after": {"residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint", "unit"},
    "floor": {"residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint", "unit"},
    "ratio": {"value", "low", "high"},
}  # fmt: skip
HYPOTHESIS = {
    "id", "code", "law", "source", "status", "log_evidence", "held_out", "p_value", "probability",
    "model",
}  # fmt: skip


def dragged():
    """Two held-out flights: intervals are parametric."""
    return worlds.flights(3, worlds.linear_drag, n_train=5, n_test=2)


@pytest.fixture(scope="module")
def report():
    return close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), seed=0)


# --- the report -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_report_json_has_the_contracts_keys_and_closed_codes(report):
    data = report.to_dict()
    json.dumps(data, allow_nan=False)
    assert set(data) == TOP
    assert data["schema"] == "bsp_gp/report/2"
    assert {"text", "latex"} <= set(data["law"])
    assert set(data["total"]) == {"before", "after", "floor", "ratio"}
    assert {"sigma", "unit", "source", "correlation_time", "tails"} <= set(data["noise"])
    assert data["alpha"] == data["criteria"]["alpha"] == Criteria().alpha
    assert data["verdict"] in VERDICTS
    assert data["stop_reason"] in STOP_REASONS
    for done in data["rounds"]:
        assert set(ROUND) <= set(done)
        for name, keys in ROUND.items():
            if keys is not None and done[name] is not None:
                assert keys <= set(done[name]), name
        assert done["reason"] in REASONS
        for row in done["hypotheses"]:
            assert set(row) == HYPOTHESIS
            assert row["code"] in ("base", *CAUSES)
            assert row["status"] in ("scored", "linearised", "idle", *STATUSES)
            assert set(row["held_out"]) == {"gain", "se", "promised"}


def test_a_drag_is_found_with_its_constant_and_its_errors(report):
    assert report.verdict == "effect adopted"
    assert report.stop_reason == "nothing_left"
    assert report.complete
    first, last = report.rounds
    assert first.effect.kind == "field"
    (constant,) = first.effect.constants
    assert constant.low < -0.3 < constant.high
    assert constant.unit == "kg/s"
    assert not last.adopted
    assert last.reason == "not_significant"
    total = report.total
    assert total["ratio"].low < total["ratio"].value < total["ratio"].high < 0.5
    assert total["ratio"].method == "parametric"
    assert 0.3 < total["after"].rollout_rmse / total["floor"].rollout_rmse < 2
    low, high = total["before"].intervals["rollout_rmse"]
    assert low < total["before"].rollout_rmse < high


def test_the_table_has_every_hypothesis(report):
    table = report.table()
    assert len(table) == sum(len(done.hypotheses) for done in report.rounds)
    assert (table[table["round"] == 1]["probability"].sum()) == pytest.approx(1.0)


def test_tracks_and_residuals_are_those_of_the_data(report):
    assert [o.scene for o in report.overlays] == ["5", "6"]
    overlay = report.overlays[0]
    late = slice(overlay.n_initial, None)
    errors = [np.abs(overlay.observed - p)[late].max() for p in (overlay.declared, overlay.adopted)]
    assert errors[1] < 0.2 * errors[0]
    table = report.residuals
    assert set(table.split) == {"train", "test"}
    assert len(table.t) == 7 * 38  # second differences have two rows less
    # Along the velocity drag takes 0.3 v / m away, and nothing is left of it afterwards.
    assert abs(np.mean(table.after_along)) < 0.3 * abs(np.mean(table.before_along))


@pytest.mark.slow
def test_one_seed_gives_one_report(report):
    again = close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), seed=0).to_dict()
    for data in (again, once := report.to_dict()):
        data.pop("wall_s")
        for done in data["rounds"]:
            done.pop("seconds")
    assert again == once


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"search": "luck"}, "search must be one of"),
        ({"alpha": 1.5}, "alpha must be between"),
        ({"max_rounds": 0}, "max_rounds must be at least 1"),
        ({"time_limit": 0.0}, "time_limit must be a positive"),
        ({"exclude": ("nonsense",)}, "exclude names"),
    ],
)
def test_unusable_settings_are_refused(settings, said):
    with pytest.raises(SettingsError, match=said):
        close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), **settings)


# --- words ----------------------------------------------------------------------------------------


def test_page_and_summary_say_what_was_found(report):
    text = summary_text(report)
    assert "lacks drag, linear in speed" in text
    assert "nothing is left above the noise" in text
    html = render_html(report)
    assert "Everything that was weighed" in html
    assert ">None<" not in html
    assert "nan" not in text


# --- time -----------------------------------------------------------------------------------------


class Asked(Clock):
    """A clock that is over once it has been asked so often."""

    def __init__(self, times):
        super().__init__()
        self.times = times

    @property
    def is_over(self):
        self.times -= 1
        return self.times < 0


@pytest.mark.slow
def test_less_time_never_adopts_more_and_says_what_it_left_out():
    data = worlds.flights(3, worlds.head_wind, n_train=4, n_test=0, sigma=0.02)
    data = replace(data, train=(), test=())
    hypothesis = Hypothesis.from_laws(data, [WEIGHT])
    grammar = load_grammar("physics")

    def adopted(clock):
        rounds = run_rounds(
            hypothesis, data, (Laws(grammar, data, max_levels=5), Declared()), max_rounds=3,
            rng=np.random.default_rng(0), clock=clock,
        )  # fmt: skip
        return rounds, [r.decision.best.text for r in rounds if r.decision.is_adopted]

    whole, full = adopted(Clock())
    assert full
    assert not any(done.left_out for done in whole)
    told = set()
    for times in (0, 1, 5, 12, 20):
        rounds, some = adopted(Asked(times))
        assert some == full[: len(some)]
        last = rounds[-1]
        if last.left_out:
            told |= set(last.left_out)
            assert not last.decision.is_fact
            if last.decision.is_adopted:  # it leaves nothing, and promised most
                assert set(last.left_out) <= {"proposers", "fits"}
                continue
            assert last.decision.verdict == "cannot tell"
            assert last.decision.reason in ("time_is_up", "declared_model_not_fitted")
    assert {"proposers", "fits"} <= told <= set(LEFT_OUT)


@pytest.mark.slow
def test_what_acts_in_held_out_scenes_only_is_found():
    """Train and test are swapped, and what is told is of both looks."""
    calm = worlds.flights(3, worlds.nothing, n_train=4, n_test=0)
    windy = worlds.flights(4, worlds.head_wind, n_train=0, n_test=3)
    windy = [replace(scene, name=f"windy {scene.name}") for scene in windy.scenes]
    names = tuple(scene.name for scene in windy)
    data = replace(calm, scenes=(*calm.scenes, *windy), train=calm.train, test=names)
    done = close_loop(data, [WEIGHT], rng=np.random.default_rng(0), n_bootstrap=0)
    assert done.verdict == "effect adopted"
    assert set(done.dataset["train"]) == set(names)
    still = replace(calm, train=calm.train[:3], test=calm.train[3:])
    done = close_loop(still, [WEIGHT], rng=np.random.default_rng(0), n_bootstrap=0)
    assert done.verdict == "nothing missing"
    assert set(done.dataset["train"]) == set(still.train)


def test_a_time_limit_that_is_no_time_ends_with_a_report():
    done = close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), time_limit=1e-3)
    assert not done.complete
    assert done.stop_reason == "time_is_up"
    assert done.verdict == "cannot tell"
    assert not any(r.adopted for r in done.rounds)
    assert "time limit" in summary_text(done)
    assert set(done.to_dict()) == TOP


def test_a_clock_counts_down():
    assert Clock().left is None
    assert not Clock().is_over
    Clock().tick()
    over = Clock(0.0)
    assert over.left == 0.0
    with pytest.raises(TimeIsUp):
        over.tick(3, 7)


# --- going on ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_goes_on_from_its_rounds_to_the_same_bits(report):
    """From none, from the first and from all of them."""
    rounds = []

    def run(**settings):
        done = close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), seed=0, **settings)
        data = done.to_dict()
        data.pop("wall_s")
        data.pop("n_fits")  # those of an earlier run are not counted again
        for each in data["rounds"]:
            each.pop("seconds")
        return data

    whole = run(on_round=rounds.append)
    assert len(rounds) == 2
    for count in (1, 2):
        made = []
        again = run(earlier=text_of(rounds[:count]), on_round=made.append)
        assert len(made) == 2 - count
        assert again == whole


def test_what_is_no_round_is_refused():
    other = '[{"c": "pathlib:Path", "k": {}}]'
    for text in ("", "[[", '[{"c": "os:system", "a": ["true"]}]', other):
        with pytest.raises(DataError, match="kept rounds cannot be read"):
            close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), earlier=text)


# --- removal --------------------------------------------------------------------------------------


def rounds_of(data, *texts, codes=("law", "law")):
    """Rounds that adopt these laws one after the other, whatever the evidence says."""
    hypothesis = Hypothesis.from_laws(data, [WEIGHT])
    found, rounds = fit(hypothesis, data), []
    for number, text in enumerate(texts, 1):
        hypothesis = continued(hypothesis, found)
        law = read_law(data, [text])
        more = with_term(hypothesis, replace(law.terms[0], is_declared=False), law.constants)
        new = fit(more, data)
        said = 1, codes[number - 1], text, "test", new.status
        best = Row(*said, 0.0, -3.0, new.log_likelihood, new.n_free)
        table = HypothesisTable((best,), 0.0)
        decision = Decision("effect adopted", "adopted", best, True)
        rounds.append(
            Round(number, found, table, decision, {0: found, 1: new}, {0: hypothesis, 1: more}, ())
        )
        found, hypothesis = new, more
    return rounds


def unsplit(world):
    return replace(worlds.flights(3, world, n_train=6, n_test=0, noise=None), train=(), test=())


def test_what_later_causes_explain_is_taken_back():
    data = unsplit(worlds.linear_drag)
    # A push along x is what a drag looks like to flights that mostly go one way.
    pruned = prune(rounds_of(data, "a * e_x", "-c * v_i"), data)
    assert pruned.removed == {1}
    assert pruned.is_complete
    assert pruned.n_fits == 1
    assert [name for name, _ in pruned.fit.parameters] == ["c"]
    assert pruned.fit.values[0] == pytest.approx(0.3, abs=4 * pruned.fit.errors[0])


def test_what_the_evidence_asks_for_stays():
    data = unsplit(worlds.head_wind)
    rounds = rounds_of(data, "a * e_x", "-c * v_i")
    pruned = prune(rounds, data)
    assert pruned.removed == frozenset()
    assert pruned.fit is rounds[-1].after


def test_numbers_of_each_scene_become_one_where_later_causes_make_them_superfluous():
    data = unsplit(worlds.head_wind)
    codes = "law_by_scene", "law"
    pruned = prune(rounds_of(data, "a[scene] * e_x", "-c * v_i", codes=codes), data)
    assert pruned.removed == frozenset()
    assert [name for name, _ in pruned.fit.parameters] == ["a", "c"]
    restated = pruned.restated[1]
    assert (restated.code, restated.text) == ("law", "a * e_x")
    alone = prune(rounds_of(data, "a * e_x", "-c * v_i"), data)
    assert pruned.fit.log_likelihood == pytest.approx(alone.fit.log_likelihood, abs=1e-6)


def test_a_term_of_a_sum_that_may_be_zero_is_shed():
    data = unsplit(worlds.linear_drag)
    last_rounds = summed(data)
    pruned = prune(last_rounds, data)
    assert [name for name, _ in pruned.fit.parameters] == ["c"]
    assert pruned.shed == {last_rounds[0].proposals[1].formulas[0]}


def test_a_term_that_may_be_zero_beside_what_no_law_explains_is_shed():
    data = replace(unsplit(worlds.linear_drag), noise=(0.005,))
    rng = np.random.default_rng(1)
    scenes = []
    for scene in data.scenes:  # a camera that wanders, farther than the noise
        way = np.cumsum(rng.standard_normal((len(scene.times), 1, 1)), axis=0) * [1.0, 0.0]
        scenes.append(replace(scene, positions=scene.positions + 0.02 * way, velocities=None))
    rounds = summed(replace(data, scenes=tuple(scenes)))
    found = rounds[-1].after
    a = next(k for k, (name, _) in enumerate(found.parameters) if name == "a")
    assert abs(found.values[a]) > 3 * found.errors[a]  # of noise alone
    for clock in (None, Clock(0.0)):  # and where there is no time left, too
        pruned = prune(rounds, replace(data, scenes=tuple(scenes)), clock=clock, late=Clock(60.0))
        assert pruned.shed == {rounds[0].proposals[1].formulas[0]}


def summed(data):
    """Rounds the first of which adopted a push and a drag as one sum."""
    first, second = rounds_of(data, "a * e_x", "-c * v_i")
    terms = first.continuing.law.terms[1:] + second.continuing.law.terms[2:]
    proposal = Proposal(
        "law", "both", second.continuing, 0.0, 1.0, formulas=tuple(t.formula for t in terms)
    )
    both = replace(
        first, fits={0: first.entering, 1: second.after},
        hypotheses={0: first.hypotheses[0], 1: second.continuing}, proposals={1: proposal},
    )  # fmt: skip
    last = replace(
        second, entering=second.after, fits={0: second.after, 1: second.after},
        hypotheses={0: second.continuing, 1: second.continuing},
    )  # fmt: skip
    return [both, last]


def test_removal_without_time_says_so():
    data = unsplit(worlds.linear_drag)
    pruned = prune(rounds_of(data, "a * e_x", "-c * v_i"), data, clock=Clock(0.0))
    assert not pruned.is_complete
    assert pruned.removed == frozenset()


def test_errors_that_would_take_longer_than_the_time_limit_are_left_out(monkeypatch):
    monkeypatch.setattr("bsp_gp.loop.close.LATE_S", 0.0)
    done = close_loop(dragged(), [WEIGHT], rng=np.random.default_rng(0), time_limit=1e-3)
    assert done.verdict == "cannot tell" and "errors" in done.left_out
    assert not np.isfinite(done.total["before"].rollout_rmse)
    assert "errors on what is held out were not found out" in " ".join(summary_text(done).split())
