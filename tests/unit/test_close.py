import json
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.split import choose_split
from bsp_gp.errors import BspError, LawError, SettingsError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.outcome import SCHEMA, VERDICTS
from tests.planted import GRAVITY as PULL
from tests.planted import SI, orbit_dataset
from tests.throws import GRAVITY, throws
from tests.worlds import WEIGHT, flights, linear_drag, magnetic, nothing, quadratic_drag, tied, wind

FAST = {"max_levels": 5, "n_null": 99}


def close(dataset, *laws, seed=0, **settings):
    return close_loop(dataset, laws, rng=np.random.default_rng(seed), **{**FAST, **settings})


def timeless(report):
    """report.json without what differs from run to run."""
    data = report.to_dict()
    data.pop("wall_s")
    for done in data["rounds"]:
        done.pop("seconds")
        done["certificate"] = ""  # it tells the seconds of the search
    return data


@pytest.fixture(scope="module")
def noisy():
    return replace(
        throws(n_scenes=8, n_times=25, sigma=0.01, noise=(0.01,)),
        test=("s1", "s3", "s5", "s6", "s7"),
    )


@pytest.fixture(scope="module")
def report(noisy):
    return close(noisy, GRAVITY, seed=3)


# --- settings -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"alpha": 0}, "alpha must be between 0 and 1, got 0"),
        ({"alpha": 1}, "alpha"),
        ({"alpha": math.nan}, "alpha"),
        ({"max_rounds": 0}, "max_rounds must be at least 1, got 0"),
        ({"max_levels": 0}, "max_levels must be at least 1"),
        ({"n_null": 98, "alpha": 0.01}, "n_null must be at least 1/alpha - 1 = 99"),
        ({"exclude": ("t", "v_k")}, r"exclude names \['v_k'\], which are no inputs of grammar"),
        ({"grammar": "phsyics"}, "phsyics"),
    ],
)
def test_bad_settings_are_refused_before_any_work(noisy, settings, message):
    with pytest.raises(BspError, match=message) as caught:
        close(noisy, GRAVITY, **settings)
    assert isinstance(caught.value, SettingsError) or "grammar" in settings


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("9.81 [m/s^2] * down", "has the unit m/s\\^2, but a force"),
        ("c1 * m_i", "must be a vector"),
        ("c1 * q_i * v_i", "q_i"),
        ("9.81 * m_i * (down", "down"),
    ],
)
def test_bad_laws_name_their_text(noisy, law, message):
    with pytest.raises(LawError, match=message):
        declared_law(noisy, [GRAVITY, law])


def test_declared_may_be_a_law_and_a_grammar_may_be_read_already(noisy, report):
    again = close_loop(
        noisy,
        declared_law(noisy, [GRAVITY]),
        rng=np.random.default_rng(3),
        grammar=load_grammar("physics"),
        **FAST,
    )
    assert timeless(again) == timeless(report)


# --- the report -----------------------------------------------------------------------------------

TOP = {
    "schema",
    "dataset",
    "declared",
    "grammar",
    "seed",
    "alpha",
    "noise",
    "rounds",
    "law",
    "total",
    "verdict",
    "stop_reason",
    "versions",
    "wall_s",
}
ROUND = {
    "missing",
    "effect",
    "rivals",
    "adopted",
    "reason",
    "before",
    "after",
    "floor",
    "ratio",
    "held_out",
    "certificate",
}
EFFECT = {"name", "kind", "law", "latex", "entities", "constants", "p_value", "equivalents",
          "n_unnamed"}  # fmt: skip
ERRORS = {"residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint", "unit"}


def test_report_json_keeps_its_contract(report):
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["schema"] == SCHEMA == "bsp_gp/report/1"
    assert TOP <= set(data)
    assert data["verdict"] in VERDICTS
    assert {"sigma", "unit", "source"} <= set(data["noise"])
    assert {"name", "fingerprint"} <= set(data["grammar"])
    assert {"text", "latex"} <= set(data["law"])
    assert set(data["total"]) >= {"before", "after", "floor", "ratio"}
    assert {"low", "high", "value"} <= set(data["total"]["ratio"])
    for done in data["rounds"]:
        assert ROUND <= set(done)
        assert {"statistic", "p_value", "detectable"} <= set(done["missing"])
        assert ERRORS <= set(done["before"]) and ERRORS <= set(done["floor"])
    first = data["rounds"][0]
    assert EFFECT <= set(first["effect"])
    assert {"name", "value", "low", "high", "unit"} <= set(first["effect"]["constants"][0])
    assert first["effect"]["kind"] in (
        "pair",
        "field",
        "hidden_body",
        "measurement",
        "declared_term_change",
    )
    assert data["alpha"] == 0.01
    assert data["declared"][0]["law"] == GRAVITY


def test_the_data_set_is_described(report, noisy):
    about = report.dataset
    assert (about["n_scenes"], about["n_rows"], about["n_entities"]) == (8, 8 * 25, 1)
    assert set(about["train"]) | set(about["test"]) == {s.name for s in noisy.scenes}
    assert about["units"]["length"] == "m"
    first, *rest = noisy.scenes
    moved = replace(noisy, scenes=(replace(first, positions=first.positions + 1), *rest))
    assert close(moved, GRAVITY, max_rounds=1).dataset["fingerprint"] != about["fingerprint"]


def test_seed_is_recorded(noisy):
    assert close(noisy, GRAVITY, max_rounds=1).seed is None
    run = close_loop(noisy, [GRAVITY], rng=np.random.default_rng(5), seed=5, max_rounds=1, **FAST)
    assert run.seed == 5


def test_the_same_seed_gives_the_same_report(noisy, report):
    assert timeless(close(noisy, GRAVITY, seed=3)) == timeless(report)


def test_another_seed_changes_only_what_is_drawn(noisy, report):
    other = close(noisy, GRAVITY, seed=4)
    assert other.law_text == report.law_text  # the split is declared
    assert other.total["ratio"].value == report.total["ratio"].value
    assert other.total["floor"] != report.total["floor"]


def test_workers_do_not_change_the_answer(noisy, report):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as workers:
        run = close(noisy, GRAVITY, seed=3, workers=workers)
    assert timeless(run) == timeless(report)


def test_progress_names_the_stages(noisy):
    said = []
    close(noisy, GRAVITY, max_rounds=1, progress=said.append)
    assert said[0] == "reading the data set"
    assert said[-1] == "writing up"
    assert any("round 1: searching" in text for text in said)


# --- unusual data ---------------------------------------------------------------------------------


def test_two_scenes_without_a_split_are_cut_in_time():
    data = flights(0, linear_drag, n_train=1, n_test=1, n_times=60)
    data = replace(data, train=(), test=())
    report = close(data, "9.81 [m/s^2] * m_i * down")
    assert any("last 30%" in note for note in report.notes)
    assert report.dataset["train"] == ["0 (train)", "1 (train)"]
    assert report.total["ratio"].method.startswith("parametric")
    assert report.rounds[0].effect.name == "drag, linear in speed"
    assert report.verdict == "effect adopted"


def test_three_dimensions():
    data = flights(0, quadratic_drag, n_dims=3)
    report = close(data, "9.81 [m/s^2] * m_i * down")
    assert report.dataset["n_dims"] == 3
    assert report.dataset["up"] == "z"
    effect = report.rounds[0].effect
    assert (report.verdict, effect.name) == ("effect adopted", "drag, quadratic in speed")
    assert abs(effect.constants[0].value + 0.05) < 0.001
    assert len(report.noise["sigma"]) == 3


def test_one_body_and_no_declared_model():
    data = flights(0, nothing, n_train=4, n_test=5)
    report = close(data)
    assert report.declared == ()
    effect = report.rounds[0].effect
    assert effect.name == "uniform push along y"
    assert report.verdict == "effect adopted"
    assert "m_i" in effect.law
    assert abs(effect.constants[0].value + 9.81) < 0.02
    assert effect.kind == "field"
    assert report.law_text.startswith("-9.8") and "[m/s^2]" in report.law_text


def test_no_declared_model_and_a_spring():
    report = close(tied(0, n_train=3, n_test=5), max_levels=6)
    assert report.rounds[0].effect.name == "spring towards the other body"
    assert report.rounds[0].effect.kind == "pair"


def ragged():
    """Tables as trackpy gives them: one row per seen particle, late comers, gaps, early leavers."""
    frames = {}
    for scene in flights(0, wind, n_train=4, n_test=4, same_mass=True).scenes:
        track = pd.DataFrame(
            {
                "frame": np.arange(40),
                "x": scene.positions[:, 0, 0],
                "y": scene.positions[:, 0, 1],
                "particle": 0,
            }
        )
        other = track.assign(x=track.x + 30.0, particle=1)
        seen = pd.concat([track.iloc[:-6], other.iloc[8:]])
        frames[scene.name] = seen[~((seen.particle == 0) & seen.frame.between(15, 17))]
    return Dataset.from_frames(
        frames,
        entities=[Entity("0", properties={"mass": 1.0}), Entity("1", properties={"mass": 2.0})],
        fps=20,
        units={"length": "m", "time": "s", "mass": "kg"},
        up="y",
        name="ragged",
        noise=0.005,
    )


def test_tracks_that_begin_late_and_have_gaps():
    data = ragged()
    assert np.isnan(data.scenes[0].positions[0, 1]).all()
    report = close(
        data, "9.81 [m/s^2] * m_i * down", exclude=("t", "p_j", "v_j"), max_levels=6, max_rounds=1
    )
    assert math.isfinite(report.total["after"].rollout_rmse)
    effect = report.rounds[0].effect
    assert effect is not None and effect.name == "uniform push along x"
    assert report.verdict == "effect adopted"
    json.dumps(report.to_dict(), allow_nan=False)


def test_a_body_that_comes_after_the_first_rows_of_a_held_out_scene():
    """Its initial state cannot be known from rows in which it was not seen."""
    data = flights(0, wind, n_train=4, n_test=5)
    scenes = list(data.scenes)
    p = np.array(scenes[-1].positions)
    p[:20] = np.nan
    scenes[-1] = replace(scenes[-1], positions=p)
    report = close(replace(data, scenes=tuple(scenes)), "9.81 [m/s^2] * m_i * down")
    rest = close(
        replace(data, scenes=data.scenes[:-1], test=data.test[:-1]), "9.81 [m/s^2] * m_i * down"
    )
    after, expected = report.total["after"].rollout_rmse, rest.total["after"].rollout_rmse
    assert after == pytest.approx(expected)
    assert report.verdict == "effect adopted"
    assert np.isnan(report.overlays[-1].adopted).all()
    assert "not scored: in 8" in "; ".join(report.notes)


def test_uncalibrated_data_say_so():
    data = flights(0, wind, n_train=4, n_test=5)
    from bsp_gp.units import UnitSystem

    data = replace(data, units=UnitSystem.from_declared({"length": "px"}), up="y")
    report = close(data, max_rounds=1)
    assert any("not calibrated" in note for note in report.notes)
    assert report.total["after"].unit != "m"


def test_quiet_data_say_what_would_have_been_seen():
    report = close(orbit_dataset(0, n_train=3, n_test=3), PULL)
    assert (report.verdict, len(report.rounds)) == ("nothing missing", 1)
    (done,) = report.rounds
    assert done.effect is None and not done.adopted and done.ratio is None
    assert 0 < done.missing.detectable < 1
    assert report.total["ratio"].value == 1
    assert report.stop_reason == done.reason
    scene = Scene("a", np.arange(4.0), np.ones((4, 1, 2)), [Entity("stone")])
    with pytest.raises(BspError, match="nothing moves"):
        close(Dataset("still", [scene], units=SI))


def test_a_grammar_without_time_needs_no_other_settings():
    report = close(orbit_dataset(0, n_train=2, n_test=1), grammar="newtonian", max_rounds=1)
    assert report.grammar["name"] == "newtonian"


def test_a_grammar_of_pairs_needs_two_bodies(noisy):
    with pytest.raises(SettingsError, match="newtonian knows forces between bodies only"):
        close(noisy, GRAVITY, grammar="newtonian")


# --- what only the held-out scenes show -----------------------------------------------------------


def charged_by_chance():
    """Throws in a magnetic field; only those that are drawn to be held out carry a charge."""
    whole, bare = (
        replace(flights(5, force, n_train=6, n_test=2), train=(), test=())
        for force in (magnetic, nothing)
    )
    drawn = choose_split(whole, np.random.default_rng(0).spawn(1)[0])
    held_out = {scene.name for scene in drawn.test}
    scenes = []
    for charged, plain in zip(whole.scenes, bare.scenes, strict=True):
        if charged.name not in held_out:
            (ball,) = plain.entities
            ball = replace(ball, properties={**ball.properties, "charge": 0.0})
            charged = replace(plain, entities=(ball,))
        scenes.append(charged)
    return replace(whole, scenes=tuple(scenes)), held_out


def test_a_drawn_split_is_turned_round_where_only_held_out_scenes_lack_something():
    dataset, held_out = charged_by_chance()
    report = close_loop(dataset, [WEIGHT], rng=np.random.default_rng(0), max_rounds=2)
    assert report.verdict == "effect adopted"
    assert "perp" in report.law_text and "q_i" in report.law_text
    assert set(report.dataset["train"]) == held_out
    assert any("the split was turned round" in note for note in report.notes)


def test_a_declared_split_is_not_turned_round():
    dataset, held_out = charged_by_chance()
    rest = tuple(s.name for s in dataset.scenes if s.name not in held_out)
    dataset = replace(dataset, train=rest, test=tuple(sorted(held_out)))
    report = close_loop(dataset, [WEIGHT], rng=np.random.default_rng(0), max_rounds=2)
    assert report.verdict == "cannot tell" and set(report.dataset["train"]) == set(rest)
    assert "what is missing shows there" in report.rounds[0].reason
