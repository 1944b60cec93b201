"""Laws with a constant of each scene or body: found where one for all does not do, only there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.forms import with_one_strength
from bsp_gp.loop.proposal import Proposal
from bsp_gp.loop.proposers.by_owner import ByOwner
from bsp_gp.loop.view import selected
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw
from tests.loop_views import throws, view_of

BALLS = "steel", "tennis", "foam"
TEXTS = ("c1 * v_i", "c1 * e_x", "c1 * m_i * perp(v_i)")


def blown(pushes):
    """Throws of unit masses, each scene in a wind of its own."""
    data = throws(np.random.default_rng(3), n_scenes=len(pushes), sigma=0.002)
    scenes = []
    for scene, push in zip(data.scenes, pushes, strict=True):
        crew = tuple(replace(e, properties={"mass": 1.0}) for e in scene.entities)
        shift = 0.5 * push * scene.times[:, None, None] ** 2 * [1, 0]
        scenes.append(replace(scene, positions=scene.positions + shift, entities=crew))
    return replace(data, scenes=tuple(scenes))


def proposed(pushes, texts=TEXTS, names=None):
    data = blown(pushes)
    if names is not None:
        data = replace(data, scenes=tuple(
            replace(scene, entities=(replace(scene.entities[0], name=name),))
            for scene, name in zip(data.scenes, names, strict=True)
        ))  # fmt: skip
    view, types = view_of(data), dataset_types(data)
    laws = SimpleNamespace(common=[parse_formula(text, types) for text in texts])
    family = ByOwner(laws).propose(view)
    return data, family, selected(family.gain, family.rank, family.null, view.noise_dof)


def test_winds_of_both_signs_are_found():
    pushes = np.array([0.3, -0.4, 0.1, -0.1, 0.25])
    data, family, chance = proposed(pushes)
    assert chance < 1e-6
    best = family.proposals[0]
    assert best.text == "c1[scene] * e_x"
    found = fit(best.hypothesis, data)
    table = found.law.constants["c1[scene]"]
    assert list(table.values()) == pytest.approx(pushes, abs=0.02)
    assert found.chi2_red < 1.2


def test_bodies_of_a_scene_each_have_constants_of_their_own_that_hold_elsewhere():
    _, family, _ = proposed(np.array([0.3, -0.4, 0.1, -0.1, 0.25]), names="abcde")
    best = family.proposals[0]
    assert best.code == "law_by_body"
    assert (best.text, best.ties) == ("c1[body] * e_x", ("c1[scene] * e_x",))


def test_bodies_seen_twice_are_told_from_scenes():
    pushes, names = np.array([0.3, -0.4, 0.1, 0.3, -0.4, 0.1]), "abcabc"
    best = proposed(pushes, names=names)[1].proposals[0]
    assert (best.text, best.ties) == ("c1[body] * e_x", ())


def test_a_constant_of_a_body_takes_up_its_mass():
    texts = ("c1 * m_i * e_x", "c1 * e_x")
    _, family, _ = proposed(np.array([0.3, -0.4, 0.1, -0.1, 0.25]), texts, "abcde")
    ties = ("c1[scene] * (m_i * e_x)", "c1[body] * e_x", "c1[scene] * e_x")
    assert [(p.text, p.ties) for p in family.proposals] == [("c1[body] * (m_i * e_x)", ties)]


def test_one_wind_for_all_needs_no_numbers_of_scenes():
    assert not proposed(np.full(5, 0.3))[1].proposals


def test_nothing_is_left_alone_and_two_scenes_are_not_asked():
    _, family, chance = proposed(np.zeros(5))
    assert chance > 0.01 and not family.proposals
    assert not proposed(np.array([0.3, -0.3]))[1].n_tried


@pytest.mark.slow
def test_a_weight_for_all_and_a_drag_for_each_ball_are_found_as_one():
    """A vortex half a kilometre away was told for the weight, and the drags beside it."""
    rng, times, columns = np.random.default_rng(0), np.arange(78) / 60, {}
    for ball, drag in zip(BALLS, (0.004, 0.03, 0.12), strict=True):
        speed, angle = rng.uniform(7, 10), rng.uniform(0.7, 1.1)
        first = [0.0, 1.5, speed * np.cos(angle), speed * np.sin(angle)]

        def rate(_, s, drag=drag):
            speed = np.hypot(s[2], s[3])
            return [s[2], s[3], -drag * speed * s[2], -9.81 - drag * speed * s[3]]

        path = solve_ivp(rate, (0, times[-1]), first, t_eval=times, rtol=1e-9).y[:2]
        noise = 0.003 * rng.standard_normal(path.shape)
        columns |= {f"{axis}_{ball}": row for axis, row in zip("xy", path + noise, strict=True)}
    data = bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": times, **columns}), units={"length": "m", "time": "s"}
    )
    report = bsp_gp.close_loop(data, (), rng=np.random.default_rng(0), n_bootstrap=0)
    assert report.verdict == "effect adopted"
    found = {(c.name, c.entity): c for c in report.constants}
    assert found["c1", ""].value == pytest.approx(-9.81, abs=0.03)
    assert found["c2[body]", "foam"].value == pytest.approx(-0.12, abs=0.003)
    told = bsp_gp.summary_text(report)
    assert "uniform push along y" in told
    assert "of another strength for each body" in " ".join(told.split())


def two_sinking(rng):
    """Two balls that sink in one film, each with a drag of its own."""
    times, rows = np.arange(60) / 50, []
    for name, drag in (("small", 8.0), ("big", 2.4)):
        depth = solve_ivp(
            lambda _, s, drag=drag: [s[1], -5.9 - drag * s[1] * abs(s[1])], (0, times[-1]),
            [0.0, 0.0], t_eval=times, rtol=1e-9,
        ).y[0]  # fmt: skip
        rows.append(pd.DataFrame({"t": times, "entity": name,
                                  "y": depth + 1e-3 * rng.standard_normal(60)}))  # fmt: skip
    return bsp_gp.Dataset.from_frames(
        pd.concat(rows), units={"length": "m", "time": "s"}, properties={"mass": "1[kg]"}
    )


@pytest.mark.slow
def test_two_balls_share_a_weight_and_have_drags_of_their_own():
    """A clock that jumps had been told: of a pair no number of each was asked."""
    report = bsp_gp.close_loop(two_sinking(np.random.default_rng(1)), (), rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    drags = {c.entity: -c.value for c in report.constants if c.entity}
    assert drags["small"] == pytest.approx(8.0, rel=0.1)
    assert drags["big"] == pytest.approx(2.4, rel=0.1)


@pytest.mark.slow
def test_two_pendulums_of_a_sensor_are_no_noise_as_large_as_they_swing():
    """Springs leave what the sine does: beside noise that took up all it had counted as less."""
    rng = np.random.default_rng(0)
    rows = []
    for name, sign, late in (("A", 1, 0.0), ("B", -1, 0.025)):
        times = 0.05 * np.arange(300) + late
        angle = solve_ivp(
            lambda _, s: [s[1], -21.0 * np.sin(s[0]) - 0.04 * s[1]], (0, times[-1]),
            [0.5 * sign, 0.0], t_eval=times, rtol=1e-9,
        ).y[0]  # fmt: skip
        counts = np.round(440 + 500 * angle + rng.standard_normal(300))
        rows += [{"t": t, "entity": name, "x": x} for t, x in zip(times, counts, strict=True)]
    data = bsp_gp.Dataset.from_frames(pd.DataFrame(rows), units={"length": "px", "time": "s"})
    report = bsp_gp.close_loop(data, [], rng=0, n_bootstrap=0, max_rounds=1)
    (done,) = report.rounds
    assert done.adopted
    assert report.total["ratio"].value < 0.1
    assert report.verdict not in ("the noise is not as assumed", "nothing missing")


def test_a_strength_for_each_scene_has_one_for_all_beside_it():
    data = throws(np.random.default_rng(3))
    base = Hypothesis.from_laws(data, ["-9.81 [m/s^2] * m_i * e_y"])
    types = dataset_types(data)
    formulas = {name: parse_formula(f"{name} * v_i", types) for name in ("c1[scene]", "c1")}
    own = Proposal("law_by_scene", "", base, -6.0, 9.0, 3, formulas=(formulas["c1[scene]"],))
    table = {"1": 1.0, "2": 1.1, "3": 5.0}
    found = SimpleNamespace(law=ForceLaw((), {"c1[scene]": table}))
    shared = with_one_strength(own, base, found, Criteria())
    assert shared.code == "law" and shared.formulas == (formulas["c1"],)
    assert shared.starts == {"c1": 1.1} and shared.rank == 1
    assert shared.log_prior == own.log_prior + Criteria().cause_nats
    assert with_one_strength(shared, base, found, Criteria()) is None
