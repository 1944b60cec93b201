import json
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import BspError, LawError, SettingsError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import close_loop
from bsp_gp.report.page import page_of
from tests.planted import GRAVITY as PULL
from tests.planted import SI, orbit_dataset
from tests.throws import GRAVITY, throws
from tests.told import is_law
from tests.worlds import flights, linear_drag, nothing, quadratic_drag, tied, wind

FAST = {"max_levels": 5, "n_bootstrap": 8}


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
        ({"n_bootstrap": -1}, "n_bootstrap must be at least 0"),
        ({"search": "luck"}, "search must be one of exhaustive, cross_entropy"),
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
        ("9.81 [m/s] * down", "has the unit m/s, but a force"),
        ("c1 * m_i", "must be a vector"),
        ("c1 * q_i * v_i", "q_i"),
        ("9.81 * m_i * (down", "down"),
    ],
)
def test_bad_laws_name_their_text(noisy, law, message):
    with pytest.raises(LawError, match=message):
        declared_law(noisy, [GRAVITY, law])


@pytest.mark.slow
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


def test_the_data_set_is_described(report, noisy):
    about = report.dataset
    assert (about["n_scenes"], about["n_rows"], about["n_entities"]) == (8, 8 * 25, 1)
    assert set(about["train"]) | set(about["test"]) == {s.name for s in noisy.scenes}
    assert about["units"]["length"] == "m"
    first, *rest = noisy.scenes
    moved = replace(noisy, scenes=(replace(first, positions=first.positions + 1), *rest))
    assert close(moved, GRAVITY, max_rounds=1).dataset["fingerprint"] != about["fingerprint"]


@pytest.mark.slow
def test_seed_is_recorded(noisy):
    assert close(noisy, GRAVITY, max_rounds=1).seed is None
    run = close_loop(noisy, [GRAVITY], rng=np.random.default_rng(5), seed=5, max_rounds=1, **FAST)
    assert run.seed == 5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_report(noisy, report):
    assert timeless(close(noisy, GRAVITY, seed=3)) == timeless(report)


@pytest.mark.slow
def test_another_seed_changes_only_what_is_drawn(noisy, report):
    other = close(noisy, GRAVITY, seed=4)
    assert other.law_text == report.law_text  # the split is declared
    assert other.total["ratio"].value == report.total["ratio"].value
    assert other.total["floor"] != report.total["floor"]


@pytest.mark.slow
def test_workers_do_not_change_the_answer(noisy, report):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as workers:
        run = close(noisy, GRAVITY, seed=3, workers=workers)
    assert timeless(run) == timeless(report)


@pytest.mark.slow
def test_progress_names_the_stages(noisy):
    said = []
    close(noisy, GRAVITY, max_rounds=1, progress=said.append)
    assert said[0] == "reading the data set"
    assert said[-1] == "writing up"
    asked = [text for text in said if text.startswith("round 1: ") and " of " in text]
    assert asked[0].startswith("round 1: laws (1 of ") and asked[0].split()[-1] == f"{len(asked)})"


# --- unusual data ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_scenes_without_a_split_are_cut_in_time():
    data = flights(0, linear_drag, n_train=1, n_test=1, n_times=60)
    data = replace(data, train=(), test=())
    report = close(data, "9.81 [m/s^2] * m_i * down")
    assert "last 30%" in report.dataset["split"]
    assert report.dataset["train"] == ["0", "1"]
    assert report.total["ratio"].method == "parametric"
    assert report.verdict == "effect adopted"
    assert is_law(report.rounds[0].effect, "c * v_i", data)


@pytest.mark.slow
def test_three_dimensions():
    data = flights(0, quadratic_drag, n_dims=3)
    report = close(data, "9.81 [m/s^2] * m_i * down")
    assert report.dataset["n_dims"] == 3
    assert report.dataset["up"] == "z"
    effect = report.rounds[0].effect
    assert report.verdict == "effect adopted"
    assert is_law(effect, "c * norm(v_i) * v_i", data)
    assert effect.probability > 0.9  # what was scored only stands no higher than what was fitted
    assert abs(effect.constants[0].value + 0.05) < 0.001
    assert len(report.noise["sigma"]) == 3


@pytest.mark.slow
def test_one_body_and_no_declared_model():
    data = flights(0, nothing, n_train=4, n_test=5)
    report = close(data)
    assert report.declared == ()
    effect = report.rounds[0].effect
    assert is_law(effect, "c * m_i * e_y", data)
    assert report.verdict == "effect adopted"
    assert abs(effect.constants[0].value + 9.81) < 0.02
    assert effect.kind == "field"
    assert report.law_text.startswith("-9.8") and "[m/s^2]" in report.law_text


@pytest.mark.slow
def test_no_declared_model_and_a_spring():
    data = tied(0, n_train=3, n_test=5)
    effect = close(data, max_levels=6).rounds[0].effect
    assert is_law(effect, "c * (norm(p_i - p_j) - l_i) * normalize(p_i - p_j)", data)
    assert effect.kind == "pair"


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


@pytest.mark.slow
def test_tracks_that_begin_late_and_have_gaps():
    data = ragged()
    assert np.isnan(data.scenes[0].positions[0, 1]).all()
    report = close(
        data, "9.81 [m/s^2] * m_i * down", exclude=("t", "p_j", "v_j"), max_levels=6, max_rounds=1
    )
    assert math.isfinite(report.total["after"].rollout_rmse)
    effect = report.rounds[0].effect
    assert is_law(effect, "c * m_i * e_x", data)
    assert report.verdict == "effect adopted"
    json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.slow
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


@pytest.mark.slow
def test_uncalibrated_data_say_so():
    data = flights(0, wind, n_train=4, n_test=5)
    from bsp_gp.units import UnitSystem

    data = replace(data, units=UnitSystem.from_declared({"length": "px"}), up="y")
    report = close(data, max_rounds=1)
    assert report.dataset["symbols"]
    assert "not calibrated" in " ".join(page_of(report).notes)
    assert report.total["after"].unit == "px"


@pytest.mark.slow
def test_quiet_data_say_what_would_have_been_seen():
    report = close(orbit_dataset(0, n_train=3, n_test=3), PULL)
    assert (report.verdict, len(report.rounds)) == ("nothing missing", 1)
    (done,) = report.rounds
    assert done.effect is None and not done.adopted and math.isnan(done.ratio.value)
    assert 0 < done.missing.detectable < 1
    assert report.total["ratio"].value == 1
    assert (report.stop_reason, done.reason) == ("nothing_left", "not_significant")
    assert 0 < done.hidden_bound["force"] and 0 < done.hidden_bound["percent"] < 1
    scene = Scene("a", np.arange(4.0), np.ones((4, 1, 2)), [Entity("stone")])
    with pytest.raises(BspError, match="nothing moves"):
        close(Dataset("still", [scene], units=SI))


@pytest.mark.slow
def test_a_grammar_without_time_needs_no_other_settings():
    report = close(orbit_dataset(0, n_train=2, n_test=1), grammar="newtonian", max_rounds=1)
    assert report.grammar["name"] == "newtonian"


def test_a_grammar_of_pairs_has_no_law_for_one_body(noisy):
    with pytest.raises(SettingsError, match="newtonian knows forces between bodies only"):
        close(noisy, GRAVITY, grammar="newtonian")
