from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS, Dataset, Entity, Scene
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.inputs import input_types, property_of
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.effects import (
    SHORTLIST,
    EffectSearch,
    Proposal,
    _shortlist,
    allowed_sign,
    sign_bounds,
)
from bsp_gp.loop.naming import describe, fresh_name, rename_constant
from bsp_gp.loop.preparing import observe
from bsp_gp.physics.force import ForceLaw, Term
from tests.planted import GRAVITY as PULL
from tests.planted import SI, orbit_dataset
from tests.throws import DRAG, GRAVITY, throws

TYPES = input_types(PROPERTY_UNITS, up="y")
R = "norm(p_i - p_j)"


def formula(text):
    return parse_formula(text, TYPES)


# --- names in plain words -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "value", "name"),
    [
        ("c1 * norm(v_i) * normalize(v_i)", -0.1, "drag, linear in speed"),
        ("c1 * v_i", -0.1, "drag, linear in speed"),
        ("c1 * v_i", None, "drag, linear in speed"),
        ("c1 * v_i", 0.1, "forward push, linear in speed"),
        ("c1 * norm(v_i) * v_i", -0.1, "drag, quadratic in speed"),
        ("c1 * norm(v_i)^2 * normalize(v_i)", -0.1, "drag, quadratic in speed"),
        ("c1 * norm(v_i)^3 * normalize(v_i)", -0.1, "drag, cubic in speed"),
        ("c1 * inverse(norm(v_i)) * normalize(v_i)", -0.1, "drag, power -1 in speed"),
        ("c1 * R_i^2 * norm(v_i)^2 * normalize(v_i)", -0.1, "drag, quadratic in speed"),
        ("c1 * normalize(v_i)", -0.1, "friction of constant size"),
        ("c1 * normalize(v_i)", 0.1, "forward push of constant size"),
        ("c1 * m_i * mu_j * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)", -9.8,
         "friction of constant size while on the mat"),
        ("c1 * q_i * norm(v_i) * perp(normalize(v_i))", 1.0,
         "force across the velocity, speed^1 (magnetic or Magnus)"),
        ("c1 * norm(v_i) * cross(e_x, normalize(v_i))", 1.0,
         "force across the velocity, speed^1 (magnetic or Magnus)"),
        ("c1 * e_x", 1.0, "uniform push along x"),
        ("c1 * m_i * e_y", 1.0, "uniform push along y"),
        ("c1 * norm(v_i) * e_y", 1.0, "uniform push along y, as speed"),
        (f"c1 * m_i * m_j * inverse(square({R})) * normalize(p_i - p_j)", -1.0,
         "pull to the other body, as distance^-2"),
        (f"c1 * q_i * q_j * inverse(square({R})) * normalize(p_i - p_j)", 1.0,
         "push from the other body, as distance^-2"),
        (f"c1 * pow({R}, -3) * normalize(p_i - p_j)", None,
         "force along the line to the other body, as distance^-3"),
        (f"c1 * ({R} - l_i) * normalize(p_i - p_j)", -8.0, "spring towards the other body"),
        (f"c1 * m_j * {R} * normalize(p_i - p_j)", -8.0, "pull to the other body, as distance"),
        ("c1 * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j)", -8.0,
         "pull to the other body, as radial speed"),
        ("c1 * normalize(v_i - v_j)", -8.0, "force along the relative velocity"),
        ("c1 * normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)", 1.0,
         "push from the other body at contact"),
    ],
)  # fmt: skip
def test_describe(law, value, name):
    assert describe(formula(law), value) == name


def test_a_spring_that_depends_on_speed_is_not_called_a_spring():
    """What tests/statistical/test_other_effects.py met: (r - l) / |v| named like Hooke's law."""
    hooke = describe(formula(f"c1 * ({R} - l_i) * normalize(p_i - p_j)"), -1.0)
    odd = describe(formula(f"c1 * ({R} - l_i) * inverse(norm(v_i)) * normalize(p_i - p_j)"), -1.0)
    assert odd != hooke


def test_constants_get_fresh_names():
    law = ForceLaw([Term(formula("c1 * v_i")), Term(formula("c3 * e_x"))], {"c1": 1.0, "c3": 1.0})
    assert fresh_name(law) == "c2"
    assert fresh_name(law, "s") == "s1"
    renamed = rename_constant(formula("c1 * norm(v_i) * v_i"), "c1", "c7")
    assert renamed.constants == ("c7",)
    assert rename_constant(renamed, "c1", "c2") == renamed


# --- signs ----------------------------------------------------------------------------------------


def observed(dataset, *laws, seed=0):
    law = declared_law(dataset, laws)
    return observe(dataset, law, np.random.default_rng(seed)), law


@pytest.fixture(scope="module")
def thrown():
    return observed(throws(n_scenes=6, n_times=30, sigma=0.01, noise=(0.01,)), GRAVITY)


def proposal(text, kind="field", **settings):
    values = {"complexity": 5.0, "share": 0.5, "evidence": 10.0, **settings}
    return Proposal(formula(text), kind, "c1", False, **values)


@pytest.mark.parametrize(
    ("law", "bounds"),
    [
        ("c1 * v_i", (-np.inf, 0)),
        ("c1 * norm(v_i)^2 * normalize(v_i)", (-np.inf, 0)),
        ("-c1 * v_i", (0, np.inf)),
        ("c1 * normalize(v_i) / m_i", (-np.inf, 0)),
        ("c1 * e_x", (-np.inf, np.inf)),
        ("c1 * norm(v_i) * perp(normalize(v_i))", (-np.inf, np.inf)),
        ("c1 * m_i * down", (-np.inf, np.inf)),
    ],
)
def test_what_is_along_the_velocity_throughout_can_only_brake(thrown, law, bounds):
    assert allowed_sign(thrown[0], proposal(law)) == bounds


def test_in_a_straight_fall_a_vertical_push_is_along_the_velocity():
    """Then even it has only one sign: the data cannot tell it from a drag."""
    t = 0.05 * np.arange(20)[:, None, None]
    scenes = []
    for k, child in enumerate(np.random.default_rng(0).spawn(4)):
        p = np.array([k, 50.0]) + np.array([0.0, -1.0]) * (t + 0.5 * 9.81 * t**2)
        p = p + [0.0, 1.0] * (0.01 * child.standard_normal(t.shape))
        scenes.append(Scene(f"s{k}", t[:, 0, 0], p, [Entity("ball", properties={"mass": 1.0})]))
    data = Dataset("falls", scenes, units=SI, up="y", noise=(0.01,))
    observation, _ = observed(data, GRAVITY)
    assert allowed_sign(observation, proposal("c1 * e_y")) == (0, np.inf)


def test_signs_of_all_found_terms_are_held(thrown):
    observation, law = thrown
    found = law.plus(Term(formula("c1 * v_i")), {"c1": 0.0}).plus(
        Term(formula("c2 * e_x")), {"c2": 0.0}
    )
    assert sign_bounds(observation, found) == {"c1": (-np.inf, 0.0)}
    assert sign_bounds(observation, declared_law(observation.dataset, [DRAG])) == {}


# --- the shortlist --------------------------------------------------------------------------------


def test_shortlist_has_the_best_and_the_simplest_near_it():
    crowd = [
        proposal(f"c1 * norm(v_i)^{k} * v_i", evidence=100.0 - k, complexity=20.0 - k)
        for k in range(1, 11)
    ]
    chosen = _shortlist(crowd, False)
    assert len(chosen) == SHORTLIST
    assert chosen[:3] == crowd[:3]
    assert set(map(id, chosen[3:])) == set(map(id, crowd[:-4:-1]))
    far = [replace(p, evidence=p.evidence - 50 * k) for k, p in enumerate(crowd)]
    assert _shortlist(far, False) == far[:2]  # at least two
    assert _shortlist(far[:1], False) == far[:1]


def test_shortlist_on_exact_data_goes_by_what_is_left():
    crowd = [
        proposal("c1 * e_x", share=s, evidence=e)
        for s, e in ((0.999, 100.0), (0.99895, 99.0), (0.998, 98.0))
    ]
    assert _shortlist(crowd, True) == crowd[:2]


def test_a_freed_declared_number_is_tried_beside_but_not_in_the_place_of_new_terms():
    new = [proposal("c1 * e_x", evidence=50.0), proposal("c1 * v_i", evidence=45.0)]
    better = proposal("c1 * m_i * down", evidence=60.0, redoes_declared=True)
    worse = replace(better, evidence=40.0)
    assert _shortlist([better, *new], False) == [*new, better]
    assert _shortlist([*new, worse], False) == new
    assert _shortlist([better], False) == [better]


# --- searches -------------------------------------------------------------------------------------


def test_the_planted_drag_is_proposed_first(thrown):
    observation, law = thrown
    search = EffectSearch(observation, load_grammar("physics"), max_levels=6, n_null=99)
    found = search.propose(observation.fit(law), np.random.default_rng(0))
    assert found.p_value == 1 / 100
    assert describe(found.shortlist[0].formula, -1.0) == "drag, linear in speed"
    assert found.n_scored >= 10  # with equal laws merged
    assert len(found.certificates) == len(search.kinds)
    evidence = [p.evidence for p in found.shortlist]
    assert evidence[0] == max(evidence)
    assert not any(p.redoes_declared for p in found.shortlist)


def test_redoes_declared_marks_what_is_parallel_to_a_declared_number():
    data = throws(n_scenes=6, n_times=30, sigma=0.01, noise=(0.01,))
    observation, law = observed(data, "9 [m/s^2] * m_i * down", "-0.2 [kg/s] * v_i")
    search = EffectSearch(observation, load_grammar("physics"), max_levels=6, n_null=99)
    found = search.propose(observation.fit(law), np.random.default_rng(0))
    marked = {describe(p.formula) for p in found.shortlist if p.redoes_declared}
    assert marked == {"uniform push along y"}
    flagged = search._flag_declared(
        [proposal(t) for t in ("c1 * m_i * e_y", "c1 * v_i", "c1 * norm(v_i)^2 * v_i", "c1 * e_x")],
        law,
        search._regression(search.pooled_scenes),
    )
    assert [p.redoes_declared for p in flagged] == [True, True, False, False]
    # A declared constant with a name is fitted, so there is no number to change.
    named = declared_law(data, ["g * m_i * down"])
    again = search._flag_declared(
        [proposal("c1 * m_i * e_y")], named, search._regression(search.pooled_scenes)
    )
    assert not again[0].redoes_declared


def balls(*names, n_dynamic=1, test=("s4", "s5")):
    """Six throws of balls with these names in turn."""
    data = throws(n_scenes=6, n_times=20, sigma=0.01, noise=(0.01,))
    scenes = []
    for k, scene in enumerate(data.scenes):
        crew = [replace(scene.entities[0], name=names[k % len(names)])]
        p = scene.positions
        if n_dynamic == 2:
            crew.append(replace(crew[0], name="other"))
            p = np.concatenate([p, p + 30.0], axis=1)
        scenes.append(replace(scene, entities=crew, positions=p))
    return replace(data, scenes=tuple(scenes), test=test)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (balls("a", "b"), True),
        (balls("a", "b", "c"), True),
        (balls("a"), False),  # one body: one constant anyway
        (balls("a", "b", n_dynamic=2), False),
        (balls("a", "b", "c", "d", "e", "f"), False),  # none is seen again
    ],
    ids=["two", "three", "one", "several in a scene", "all different"],
)
def test_a_constant_for_every_body_is_tried_where_bodies_recur(data, expected):
    observation, _ = observed(data, GRAVITY)
    grammar = load_grammar("physics")
    assert EffectSearch(observation, grammar).per_entity is expected
    assert EffectSearch(observation, grammar, per_entity=False).per_entity is False


def test_drags_that_differ_from_ball_to_ball_get_a_constant_each():
    """Drag constants that follow no property of the balls: 0.2 and 0.5 kg/s at equal mass."""
    t = 0.05 * np.arange(25)[:, None]
    scenes = []
    for k, child in enumerate(np.random.default_rng(2).spawn(8)):
        c = (0.2, 0.5)[k % 2]
        fall, v = np.array([0.0, -9.81 / c]), np.array([3.0 + k % 3, 4.0 - k % 4])
        p = [0.0, 10.0] + fall * t + (v - fall) / c * (1 - np.exp(-c * t))
        p = p + 0.01 * child.standard_normal(p.shape)
        ball = Entity("ab"[k % 2], properties={"mass": 1.0})
        scenes.append(Scene(f"s{k}", t[:, 0], p[:, None], [ball]))
    data = Dataset("two balls", scenes, units=SI, up="y", noise=(0.01,), test=("s5", "s6", "s7"))
    report = close_loop(data, [GRAVITY], rng=np.random.default_rng(0), max_levels=6, max_rounds=1)
    effect = report.rounds[0].effect
    assert (report.verdict, effect.name) == ("effect adopted", "drag, linear in speed")
    values = {c.entity: c for c in effect.constants}
    assert set(values) == {"a", "b"}
    for name, c in (("a", 0.2), ("b", 0.5)):
        sd = (values[name].high - values[name].low) / 2 / 1.645
        assert abs(values[name].value + c) < 4 * sd
    assert any("one for each body" in note for note in report.notes)


def test_a_body_of_unknown_mass_gets_no_constant_in_pooled_laws():
    data = orbit_dataset(0, n_train=2, n_test=1, drag=0.05)
    scenes = tuple(
        replace(s, entities=[*s.entities[:2], Entity("body2", properties={})]) for s in data.scenes
    )
    observation, law = observed(replace(data, scenes=scenes))
    search = EffectSearch(observation, load_grammar("physics"), max_levels=4)
    # As a source its mass is unknown too, so laws cannot name the mass of a source.
    assert "m_j" in search.missing
    assert "m_i" not in search.missing
    regression = search._regression(search.pooled_scenes)
    assert regression.receiver_names() == ("body0", "body1")


def test_inputs_that_are_excluded_or_missing_are_not_used(thrown):
    observation, _ = thrown
    search = EffectSearch(observation, load_grammar("physics"), exclude=("t", "v_i"))
    assert {"t", "v_i", "q_i", "e_z"} <= set(search.missing)
    pooled = EffectSearch(observation, load_grammar("physics"), exclude=())
    assert "t" not in pooled.missing


def test_a_pair_pull_is_proposed_among_all_pair_laws():
    data = orbit_dataset(1, n_train=2, n_test=1)
    observation, _ = observed(data)
    search = EffectSearch(
        observation, load_grammar("physics"), max_levels=6, n_null=99, exclude=("t", "v_i", "v_j")
    )
    found = search.propose(observation.fit(ForceLaw()), np.random.default_rng(0))
    texts = [describe(p.formula, -1.0) for p in found.shortlist]
    assert texts[0] == "pull to the other body, as distance^-2"
    properties = {n for n in found.shortlist[0].formula.inputs if property_of(n)}
    assert properties <= {"m_i", "m_j"}
    assert not declared_law(data, [PULL]).names
