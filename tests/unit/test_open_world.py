"""The open world of `experiments/open_world.py`: what it makes, and how it judges a report."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
MODULES = (
    "open_world", "open_judge", "open_tables", "foreign_worlds", "foreign_forces",
    "foreign_motion", "foreign_layouts", "odd_noise", "power", "causes", "common", "made_worlds",
)  # fmt: skip


@pytest.fixture(scope="module")
def study():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import open_world

        yield open_world
    for name in MODULES:
        sys.modules.pop(name, None)


# --- what is made ---------------------------------------------------------------------------------


def test_there_are_kinds_enough_and_whole_families_aside(study):
    kinds = study.KINDS.values()
    kept = {kind.family for kind in kinds if not kind.is_aside}
    assert len(study.KINDS) >= 30
    assert len(kept) >= 8
    assert len({kind.family for kind in kinds if kind.is_aside}) == 2
    assert len(study.NOISES) - len(study.NOISES_ASIDE) >= 10
    assert set(study.NOISES_ASIDE) <= set(study.NOISES)
    assert not set(study.KINDS) & set(study.NOISES)


def test_what_is_aside_is_run_when_it_is_asked_for_only(study):
    aside = {name for name, kind in study.KINDS.items() if kind.is_aside} | {*study.NOISES_ASIDE}
    usual, every = (
        {name for name, _, _ in study.jobs_of(False, 2000, 0, with_aside)}
        for with_aside in (False, True)
    )
    assert not usual & aside
    assert every == set(study.KINDS) | set(study.NOISES)


def test_half_of_the_sets_are_long_and_half_declare_their_noise(study):
    jobs = study.jobs_of(False, 3000, 0, True)
    assert len(set(jobs)) == len(jobs) == 3000
    plans = [study.plan_of(*job) for job in jobs]
    declared = [study.is_declared(*job) for job in jobs]
    both = [p.is_long and d for p, d in zip(plans, declared, strict=True)]
    assert np.mean([p.is_long for p in plans]) == pytest.approx(0.5, abs=0.03)
    assert np.mean(declared) == pytest.approx(0.5, abs=0.03)
    assert np.mean(both) == pytest.approx(0.25, abs=0.05)
    assert {p.n_dims for p in plans} == {2, 3}


def test_a_long_set_has_six_scenes_or_more(study):
    plan = replace(study.plan_of("speed to the 1.5", 5.0, 0), is_long=True)
    assert 6 <= len(study.moved(plan)[0].scenes) <= 12


@pytest.mark.slow
@pytest.mark.parametrize("name", ["speed to the 1.5", "Basset drag", "chase", "many kicks"])
def test_a_set_is_the_same_each_time_and_another_with_another_seed(study, name):
    def made(seed):
        strength = study.KINDS[name].strength
        dataset, _ = study.foreign(name, strength, study.plan_of(name, 5.0, seed))
        return dataset

    one, again, other = made(0), made(0), made(2)
    for a, b in zip(one.scenes, again.scenes, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
    assert not np.array_equal(one.scenes[0].positions[0], other.scenes[0].positions[0])


@pytest.mark.slow
def test_every_kind_moves_bodies_as_its_force_says_in_newtons(study):
    for name, kind in study.KINDS.items():
        plan = replace(study.plan_of(name, 5.0, 0), is_long=False)
        dataset, truth = study.foreign(name, kind.strength, plan)
        assert dataset.n_dims == plan.n_dims
        assert 3 <= len(dataset.scenes) < 6
        exact = truth.scene(len(dataset.scenes) - 1)
        assert 50 <= len(exact.times) <= 200
        assert not np.array_equal(truth.total, truth.declared), name
        # The accelerations that judges are told of are those of the motion.
        v, a = exact.velocities[:, exact.dynamic], truth.total[-1][:, exact.dynamic]
        t, middle = exact.times, slice(1, -1)
        slope = (v[2:] - v[:-2]) / (t[2:] - t[:-2])[:, None, None]
        size = np.abs(a).max() + np.abs(np.diff(a, axis=0)).max()
        assert np.abs(slope - a[middle]).max() < 0.2 * size, name


def test_a_drag_is_what_an_integration_by_hand_gives(study):
    plan, c = study.plan_of("speed to the 1.5", 5.0, 0), 0.05
    dataset, truth = study.foreign("speed to the 1.5", c, plan)
    scene, exact = dataset.scenes[0], truth.scene(0)
    mass = scene.entities[0].mass

    def slope(t, y):
        v = y[2:]
        return [*v, *(np.array([0, -9.81]) - c / mass * np.linalg.norm(v) ** 0.5 * v)]

    y = np.concatenate([exact.positions[0, 0], exact.velocities[0, 0]])
    out = solve_ivp(slope, scene.times[[0, -1]], y, t_eval=scene.times, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(scene.positions[:, 0], out.y[:2].T, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "snr"), [("speed to the 0.5", 10.0), ("saturating spring", 30.0), ("chirp", 5.0)]
)
def test_a_set_is_as_strong_as_is_asked(study, name, snr):
    _, found, exact, _ = study.tuned(name, snr, study.plan_of(name, snr, 1))
    assert found == pytest.approx(snr, rel=0.05)
    assert exact.noise is None


# --- odd noise ------------------------------------------------------------------------------------


def noisy(study, name, seed=0):
    plan = study.plan_of(name, 0.0, seed)
    exact, truth = study.moved(plan)
    sigma = study.LAYOUTS[plan.layout].sigma
    scenes, gain = study.NOISES[name].draw(truth.scenes, sigma, np.random.default_rng(seed))
    return exact, scenes, gain, study._size(exact.scenes, scenes) / sigma


@pytest.mark.slow
def test_odd_noise_is_of_its_size_and_beats_white_noise(study):
    for name in study.NOISES:
        if name != "missing rows":
            # What shakes a body that is alone is white.
            seed = next(s for s in range(9) if name != "shaking camera"
                        or study.plan_of(name, 0.0, s).layout == "charged")  # fmt: skip
            _, scenes, gain, size = noisy(study, name, seed)
            assert all(scene.velocities is None for scene in scenes)
            assert 0.5 < size < 5, name
            assert gain > 10, name


def test_rows_that_are_missing_are_gone_and_their_noise_is_white(study):
    plan = study.plan_of("missing rows", 0.0, 0)
    exact, truth = study.moved(plan)
    noise = study.NOISES["missing rows"]
    scenes, gain = noise.draw(truth.scenes, 0.01, np.random.default_rng(0))
    for whole, cut in zip(exact.scenes, scenes, strict=True):
        assert 0.5 * len(whole.times) < len(cut.times) < 0.8 * len(whole.times)
        left_out = set(whole.times) - set(cut.times)
        kept = [k for k, t in enumerate(whole.times) if t not in left_out]
        error = cut.positions - whole.positions[kept]
        assert 0.005 < error[:, cut.dynamic].std() < 0.02
    assert gain == 0


def test_white_noise_beats_no_odd_noise(study):
    # What a description of errors gains is not positive by construction.
    import odd_noise

    truth = study.moved(study.plan_of("tails", 0.0, 0))[1]
    plain = odd_noise._independent(lambda scene, rng: stats.norm())
    _, gain = plain(truth.scenes, 0.01, np.random.default_rng(0))
    assert -5 < gain <= 0


def test_times_on_a_grid_are_told_in_the_times(study):
    exact, scenes, _, _ = noisy(study, "times on a grid")
    steps = np.diff(scenes[0].times)
    assert np.ptp(steps) > 0.1 * steps.mean()
    assert np.ptp(np.diff(exact.scenes[0].times)) < 1e-9


# --- the judge ------------------------------------------------------------------------------------

DRAG, OTHER = "c * norm(v_i)^0.5 * v_i", "c * e_x"
NEAR = "c * v_i"


@pytest.fixture(scope="module")
def referee(study):
    name = "speed to the 1.5"
    plan = study.plan_of(name, 5.0, 0)
    dataset, truth = study.foreign(name, 0.05, plan)
    declared = study.LAYOUTS["thrown"].declared(2)
    from open_judge import Referee

    return Referee(dataset, truth, declared, near=("hidden_body",))


def one_round(law=None, *, others=(), verdict="effect adopted", adopted=True, is_fact=None,
              code="law", p_value=1e-6, findings=()):  # fmt: skip
    """A round as a report has it; by default a form that stands alone is a fact."""
    is_fact = not others if is_fact is None else is_fact
    effect = law and SimpleNamespace(
        code=code, law=law, name=law, equivalents=tuple(others), constants=(), is_fact=is_fact,
        probability=0.9,
    )  # fmt: skip
    return SimpleNamespace(
        effect=effect, hypotheses=[], adopted=adopted, verdict=verdict,
        missing=SimpleNamespace(p_value=p_value), varies_with=(),
        noise_findings=[{"code": c} for c in findings],
    )  # fmt: skip


def report_of(referee, *rounds, verdict=None):
    return SimpleNamespace(
        rounds=rounds, verdict=verdict or rounds[0].verdict, law=referee.judge.declared,
    )


OPEN = {"adopted": False, "verdict": "seen, not adopted"}
NOTHING = {"verdict": "nothing missing", "adopted": False, "p_value": 0.5}
UNTOLD = {"verdict": "cannot tell", "is_fact": False}


@pytest.mark.parametrize(
    ("rounds", "outcome"),
    [
        ([one_round(DRAG)], "fact"),
        ([one_round(DRAG), one_round(**NOTHING)], "fact"),
        ([one_round(NEAR, others=(DRAG,))], "class"),
        ([one_round(OTHER, others=(DRAG,), **UNTOLD)], "class"),
        ([one_round(NEAR, verdict="effective law", is_fact=False)], "effective"),
        ([one_round(NEAR, **OPEN)], "open"),
        ([one_round(DRAG, **OPEN)], "open"),
        ([one_round(NEAR, others=(OTHER,))], "open"),
        ([one_round(NEAR)], "neighbour"),
        ([one_round("c * m_i * normalize(v_i)")], "neighbour"),
        ([one_round("x = (1 + s) X", code="hidden_body")], "neighbour"),
        ([one_round("(norm(v_i) / 2 [m/s])^n1 * (c * v_i)", code="exponent")], "fact"),
        ([one_round("c[body] * v_i", code="constant_per_body")], "neighbour"),
        ([one_round(OTHER)], "wrong"),
        ([one_round("x = (1 + s) X", code="scale")], "wrong"),
        ([one_round("a * v_i + b * e_x")], "wrong"),
        ([one_round(DRAG), one_round(OTHER)], "wrong"),
        ([one_round(NEAR, verdict="effective law", is_fact=False), one_round(OTHER)], "wrong"),
        ([one_round(**NOTHING)], "missed"),
        ([one_round(NEAR, p_value=0.5, **{k: OPEN[k] for k in OPEN})], "open"),
        ([one_round("a memory", code="noise", verdict="the noise is not as assumed")], "missed"),
    ],
)  # fmt: skip
def test_each_outcome_of_a_foreign_cause(study, referee, rounds, outcome):
    assert study.judge_foreign(report_of(referee, *rounds), referee, 0.01)["outcome"] == outcome


def test_a_class_without_the_truth_is_counted(study, referee):
    told = study.judge_foreign(report_of(referee, one_round(NEAR, others=(OTHER,))), referee, 0.01)
    assert (told["is_class_without_truth"], told["n_class"]) == (True, 2)
    told = study.judge_foreign(report_of(referee, one_round(NEAR, others=(DRAG,))), referee, 0.01)
    assert not told["is_class_without_truth"]


def test_a_final_law_that_is_the_truth_is_right(study, referee):
    from bsp_gp.physics.force import Term

    law = referee.judge.declared
    (cause,) = [study.Cause("law", DRAG)]
    terms, start = referee.judge.terms(cause)
    report = report_of(referee, one_round(NEAR))
    report.law = law.plus(Term(terms[0].formula), start)
    assert study.judge_foreign(report, referee, 0.01)["outcome"] == "fact"


@pytest.mark.parametrize(
    ("rounds", "outcome", "is_named"),
    [
        ([one_round(**NOTHING)], "right_null", False),
        ([one_round(**NOTHING, findings=("tails",))], "right_null", True),
        ([one_round(**NOTHING, findings=("grid",))], "right_null", False),
        ([one_round("a row", code="bad_row")], "right_null", True),
        ([one_round(NEAR)], "false_adoption", False),
        ([one_round(NEAR, **OPEN)], "false_alarm", False),
        ([one_round("a row", code="bad_row"), one_round(NEAR, **OPEN)], "false_alarm", True),
        ([one_round("a memory", code="noise", verdict="the noise is not as assumed"),
          one_round(**NOTHING, findings=("row",))], "right_null", True),
    ],
)  # fmt: skip
def test_each_outcome_of_a_null(study, referee, rounds, outcome, is_named):
    told = study.judge_null(report_of(referee, *rounds), study.NOISES["outliers"])
    assert (told["outcome"], told["noise_named"]) == (outcome, is_named)


# --- what is told ---------------------------------------------------------------------------------


def test_intervals_draw_whole_kinds_again(study):
    from open_tables import interval

    kinds = np.repeat([f"k{n}" for n in range(20)], 50)
    by_kind = np.repeat(np.arange(20) < 2, 50)  # all of two kinds: ten per cent
    spread = np.tile(np.arange(50) < 5, 20)  # a tenth of each
    low, high = interval(kinds, by_kind)
    assert low <= 0.05
    assert high >= 0.2
    assert interval(kinds, spread) == (0.1, 0.1)


def test_the_summary_keeps_apart_what_is_set_aside(study):
    import pandas as pd

    row = {
        "family": "drag", "kind": "a", "snr": 10.0, "aside": False, "outcome": "wrong",
        "separation": 3.0, "lead_right": True, "is_class_without_truth": False, "cpu_s": 2.0,
    }  # fmt: skip
    null = {
        "family": "odd noise", "kind": "tails", "snr": 0.0, "aside": False, "outcome": "right_null",
        "noise_gain": 20.0, "noise_named": True, "cpu_s": 1.0,
    }  # fmt: skip
    rows = [row, {**row, "kind": "b", "aside": True, "outcome": "fact"}, null]
    text = study.summary(pd.DataFrame(rows))
    assert "1 sets: wrong and confident 100.0%" in text
    assert "1 sets set aside: wrong and confident 0.0%" in text
    assert "100% of 1" in text


def test_reliability_tells_of_names_that_are_told_too_surely(study):
    import pandas as pd
    import reliability

    rng = np.random.default_rng(0)
    told = rng.uniform(size=4000)
    honest = pd.DataFrame({"probability": told, "right": rng.uniform(size=4000) < told})
    assert reliability.calibration_error(reliability.bins(honest)) < 0.03
    boasting = honest.assign(probability=np.sqrt(told))
    assert reliability.calibration_error(reliability.bins(boasting)) > 0.1


def test_what_the_loop_learned_from_is_cut_out_of_the_exact_data(study):
    import pandas as pd

    exact, _ = study.moved(replace(study.plan_of("chirp", 5.0, 0), is_long=False))
    first, second = exact.scenes[:2]
    rows = [
        {"scene": f"{first.name}", "split": "train", "t": t} for t in first.times[:20]
    ]
    rows += [{"scene": f"{first.name} (test)", "split": "test", "t": t} for t in first.times[25:]]
    rows += [{"scene": second.name, "split": "train", "t": t} for t in second.times]
    report = SimpleNamespace(residuals=pd.DataFrame(rows))
    part = study.learned_from(exact, report)
    assert [scene.name for scene in part.scenes] == [first.name, second.name]
    assert [len(scene.times) for scene in part.scenes] == [20, len(second.times)]
    assert study.learned_from(exact, SimpleNamespace(residuals=None)) is None
