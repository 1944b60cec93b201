"""Laws with constants inside: found on grids, fitted in place, and no rivals of special cases."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.errors import GrammarError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposers.inside import SINES, Inside, inner_search
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.view import View
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.force import Term
from bsp_gp.report.naming import describe
from bsp_gp.report.sentences import parting_sentence
from bsp_gp.search.inner import Axis, Form, _are_told, expanded
from bsp_gp.units import Unit, UnitSystem
from tests.fitted_tracks import body, dataset_of, scene_of
from tests.unit.test_decide import decided, row

SIGMA = 0.003
TIMES = np.linspace(0.0, 1.5, 40)


def proposed(data):
    """The form that promises most beside laws without inner constants, and its fit."""
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    laws = Laws(load_grammar("physics"), data, max_levels=6)
    plain = next(p for p in laws.propose(view).proposals if len(p.formulas) == 1)
    best = Inside(laws, data).propose(view).proposals[0]
    assert best.promise > plain.promise + 3
    return best, fit(best.hypothesis, data, starts=best.starts)


def pushed(push, n_scenes=3, seed=0):
    """Bodies thrown about, with accelerations ``push(place, velocity, time)``."""
    rng, scenes = np.random.default_rng(seed), []
    for k in range(n_scenes):
        start = np.concatenate([rng.uniform(0.0, 2.0, 2), rng.uniform(-3.0, 3.0, 2)])
        track = solve_ivp(
            lambda t, y: np.concatenate([y[2:], push(y[:2], y[2:], t)]), (0.0, TIMES[-1]), start,
            t_eval=TIMES, rtol=1e-9, atol=1e-10, max_step=0.005,
        )  # fmt: skip
        places = track.y[:2].T + SIGMA * rng.standard_normal((len(TIMES), 2))
        scenes.append(scene_of(TIMES, (body("ball"),), places[:, None], name=f"s{k}"))
    return dataset_of(scenes, noise=(SIGMA, SIGMA))


def value(found, stem):
    """The constant whose name begins so, and its standard error."""
    k = next(k for k, (name, _) in enumerate(found.parameters) if name.startswith(stem))
    return found.values[k], found.errors[k]


def is_within(found, **truth):
    return all(
        abs(value(found, stem)[0] - true) < 4 * value(found, stem)[1]
        for stem, true in truth.items()
    )


def test_a_spring_about_an_unknown_rest_point_leads():
    rng, t = np.random.default_rng(0), np.linspace(0.0, 6.0, 200)
    x = 3.0 + 0.5 * np.cos(2.0 * t + 0.3) + 0.01 * rng.standard_normal(200)
    places = np.stack([x, np.zeros(200)], axis=1)
    best, found = proposed(dataset_of([scene_of(t, (body("cart"),), places[:, None])]))
    assert best.text == "c1 * (origin + centre_x1 * e_x - p_i)"
    assert describe(best.formulas[0]) == "spring to a rest point"
    assert is_within(found, c=4.0, centre_x=3.0)


def test_a_push_beyond_a_height_leads():
    def push(place, velocity, time):
        return np.array([3.0 * (place[1] > 1.2), 0.0])

    best, found = proposed(pushed(push))
    assert "sign(y_i - h_y1)" in best.text
    assert is_within(found, c=3.0, h_y=1.2)


@pytest.mark.slow
def test_a_push_in_a_window_of_time_leads():
    def push(place, velocity, time):
        return np.array([3.0 * (0.4 < time < 0.9), 0.0])

    best, found = proposed(pushed(push))
    assert "sign(t - t1)" in best.text and "sign(t - t2)" in best.text
    assert is_within(found, t1=0.4, t2=0.9)


def test_a_drag_between_the_powers_of_the_grammar_leads():
    def push(place, velocity, time):
        return -np.sqrt(np.linalg.norm(velocity)) * velocity

    best, found = proposed(pushed(push))
    assert best.text == "c1 * (norm(v_i)^n1 * normalize(v_i))"
    assert is_within(found, n=1.5)


@pytest.mark.slow
def _to_a_rest_point(size):
    return lambda p, v, t: np.array([-4.0 * size(p[0] - 1.1), 0.0])


@pytest.mark.parametrize(
    ("push", "name", "truth"),
    [
        (_to_a_rest_point(lambda x: np.tanh(x / 0.3)), "spring along x that levels off",
         {"h_x": 1.1, "D": 0.3}),
        (_to_a_rest_point(lambda x: x / (1 + abs(x) / 0.3)), "spring along x that levels off",
         {"h_x": 1.1, "D": 0.3}),
        (_to_a_rest_point(lambda x: np.exp(-x / 0.7) - np.exp(-2 * x / 0.7)),
         "force along x as of a bond (Morse)", {"h_x": 1.1, "D": 0.7}),
        (lambda p, v, t: -2.0 * np.tanh(np.hypot(*v) / 1.5) * v / np.hypot(*v),
         "friction that sets in over a range of speeds", {"u": 1.5}),
    ],
)  # fmt: skip
def test_what_levels_off_leads_with_the_place_and_the_size_at_which_it_does(push, name, truth):
    """Springs that level off were four forces, or the cubic and the fifth power of a stretch."""
    best, found = proposed(pushed(push))
    assert describe(best.formulas[0]) == name
    assert is_within(found, **truth)


def test_a_pull_to_a_wall_leads_with_its_power():
    scenes, rng, times = [], np.random.default_rng(2), np.linspace(0.0, 2.0, 50)
    for k in range(4):
        start = [rng.uniform(0.7, 1.0), 0.0, rng.uniform(-0.25, 0.0), rng.uniform(-0.3, 0.3)]
        track = solve_ivp(
            lambda t, y: [y[2], y[3], -0.02 / y[0] ** 4, 0.0], (0.0, 2.0), start, t_eval=times,
            rtol=1e-9, atol=1e-10, events=_near_the_wall,
        )  # fmt: skip
        places = track.y[:2].T + 0.001 * rng.standard_normal((len(track.t), 2))
        scenes.append(scene_of(track.t, (body("puck"),), places[:, None], name=f"s{k}"))
    best, found = proposed(dataset_of(scenes, noise=(0.001, 0.001)))
    assert best.text == "c1 * (abs(x_i)^w1 * sign(x_i) * e_x)"
    assert describe(best.formulas[0]) == "force along x, to a fitted power of x"
    assert is_within(found, w=-4.0)


def _near_the_wall(t, y):
    return y[0] - 0.3


_near_the_wall.terminal = True


@pytest.mark.slow
def test_a_magnet_beneath_the_plane_leads_with_its_depth():
    def push(place, velocity, time):
        away = place - np.array([1.0, 0.4])
        return 0.5 * away / (away @ away + 0.3**2) ** 2.5

    best, found = proposed(pushed(push, n_scenes=6))
    assert "^-2.5 * (origin + centre_x1 * e_x + centre_y1 * e_y - p_i)" in best.text
    told = describe(best.formulas[0], value(found, "c")[0])
    assert told.startswith("force away from a point, softened within a length")
    assert is_within(found, centre_x=1.0, centre_y=0.4, D=0.3)


@pytest.mark.slow
def test_springs_of_two_strengths_are_a_spring_and_more_of_it_along_an_axis():
    def push(place, velocity, time):
        return np.array([-6.0, -9.0]) * (place - np.array([0.4, -0.2]))

    data = pushed(push)
    report = close_loop(data, rng=0, n_bootstrap=0)
    assert report.verdict in ("effect adopted", "effective law")
    scene = scene_of(TIMES, (body("ball"),), np.zeros((len(TIMES), 1, 2)))
    (batch,) = stack((scene,))
    p = np.array([[1.0, 0.7]])
    told = report.law.acceleration(batch.bodies, p, np.zeros_like(p), np.zeros(1))[0, 0]
    np.testing.assert_allclose(told, push(p[0], None, 0.0), rtol=0.03)


@pytest.mark.parametrize("size", [math.nan, 0.0, 2.0])
def test_no_power_is_fitted_of_a_property_that_is_unknown_or_the_same_everywhere(size):
    scenes = []
    for k in range(6):
        ball = body("ball", mass=1.0 + k, properties={"size": size + 0.0 * k})
        places = np.outer(TIMES, [1.0 + k, 2.0])[:, None]
        scenes.append(scene_of(TIMES, (ball,), places, name=f"s{k}"))
    data = dataset_of(scenes, noise=(SIGMA, SIGMA))
    formula = parse_formula("size_i^a * v_i", input_types({"size": Unit.of(m=1)}))
    assert not _are_told(formula, data)
    formula = parse_formula("m_i^a * v_i", input_types({"mass": Unit.of(kg=1)}))
    assert _are_told(formula, data)


def test_no_sine_of_a_length_is_asked():
    """A telephone on a spring had been driven by the sine of its place, in metres."""
    places = np.stack([0.2 * np.cos(3 * TIMES), 0 * TIMES], axis=-1)[:, None]
    data = dataset_of([scene_of(TIMES, (body("telephone"),), places)])
    laws = Laws(load_grammar("physics"), data, max_levels=4)
    sines = []
    for unit in ("m", "rad"):
        units = UnitSystem.from_declared({"length": unit, "time": "s"})
        forms = Inside(laws, replace(data, units=units)).forms
        sines.append(any(to_text(form.term.formula) in SINES for form in forms))
    assert sines == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize(("n_scenes", "n_forms"), [(6, 1), (3, 0)])
def test_a_power_of_the_mass_is_fitted_where_there_are_masses_enough(n_scenes, n_forms):
    rng, scenes = np.random.default_rng(0), []
    for k in range(n_scenes):
        mass, start = 1.0 + 0.8 * k, np.array([0.0, 0.0, *rng.uniform(2.0, 4.0, 2)])

        def rate(t, y, mass=mass):
            return np.concatenate([y[2:], -0.5 * mass**-0.3 * np.linalg.norm(y[2:]) ** 0.5 * y[2:]])

        places = solve_ivp(rate, (0.0, TIMES[-1]), start, t_eval=TIMES, rtol=1e-9).y[:2].T
        places += SIGMA * rng.standard_normal(places.shape)
        scenes.append(scene_of(TIMES, (body("ball", mass=mass),), places[:, None], name=f"s{k}"))
    data = dataset_of(scenes, noise=(SIGMA, SIGMA))
    laws = Laws(load_grammar("physics"), data, max_levels=4)
    forms = [to_text(form.term.formula) for form in Inside(laws, data).forms]
    assert forms.count("m_i^a * norm(v_i)^n * normalize(v_i)") == n_forms
    if n_forms:
        best, found = proposed(data)
        assert is_within(found, a1=0.7, n1=1.5)
        told = describe(best.formulas[0], -0.5)
        assert told == "force along the velocity, to a fitted power of speed, times m_i^a1"


@pytest.mark.parametrize(("masses", "is_same"), [((2.0, 2.0), True), ((2.0, 3.0), False)])
def test_a_form_is_scanned_once_for_all_properties_that_bodies_have_alike(masses, is_same):
    rng, scenes = np.random.default_rng(0), []
    for k, mass in enumerate(masses):
        ball = body("ball", mass=mass, properties={"charge": 0.0, "size": 3.0})
        places = np.stack([TIMES + k, TIMES**2], axis=1)
        places += SIGMA * rng.standard_normal(places.shape)
        scenes.append(scene_of(TIMES, (ball,), places[:, None], name=f"s{k}"))
    data = dataset_of(scenes, noise=(SIGMA, SIGMA))
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    search = inner_search(view, load_grammar("physics"), view.moment_draws)
    types = input_types({"mass": Unit.of(kg=1), "charge": Unit.of(A=1), "size": Unit.of(m=1)})

    def scan(text):
        return search.scan(Form(Term(parse_formula(text, types), "field"), 1.0))

    plain = scan("norm(v_i)^n * v_i")
    assert plain.gain > 10
    for text, same in (("size_i * norm(v_i)^n * v_i", True), ("m_i * norm(v_i)^n * v_i", is_same)):
        other = scan(text)
        assert to_text(other.form.term.formula) == text and other.ties is not plain.ties
        assert (other.peaks is plain.peaks) == same
        by_itself = search._scan(other.form, other.axes, 1)
        assert other.gain == pytest.approx(by_itself.gain, rel=1e-9)
    nothing = scan("charge_i * norm(v_i)^n * v_i")
    assert nothing.n_points == 0 and nothing.gain == 0.0


def test_inner_constants_stay_in_the_ranges_that_the_data_give_them():
    def push(place, velocity, time):
        return np.array([3.0 * (place[1] > 1.2), 0.0])

    data = pushed(push)
    best, found = proposed(data)
    (height,) = [p for p in best.hypothesis.parameters if p.name == "h_y1"]
    seen = np.concatenate([scene.positions[:, 0, 1] for scene in data.scenes])
    assert seen.min() - 0.1 < height.low < 1.2 < height.high < seen.max() + 0.1
    assert math.isfinite(log_evidence(found, best.hypothesis))


def test_a_wider_form_keeps_its_special_case_from_being_a_fact_only_where_it_is_better():
    wide = decided(row(1), row(2, gain=102.0, prior=-6.0, is_wide=True, n_free=6))
    assert [r.id for r in wide.rivals] == [2] and wide.is_fact
    better = decided(row(1, prior=0.0), row(2, gain=106.0, prior=-6.0, is_wide=True, n_free=6))
    assert better.best.id == 1 and not better.is_fact


def test_the_recording_that_parts_a_law_from_a_push_in_time_is_named():
    push = "(a1 * cos(w1 * t) + b1 * sin(w1 * t)) * e_x"
    spring = SimpleNamespace(law="c1 * (origin - p_i)", equivalents=("c1 * v_i", push))
    assert push in parting_sentence(spring)
    assert not parting_sentence(SimpleNamespace(law=push, equivalents=(push,)))
    assert not parting_sentence(SimpleNamespace(law="c1 * v_i", equivalents=("c1 * e_x",)))


def test_a_cause_of_another_kind_with_the_same_track_is_told():
    other = row(2, code="period", prior=-4.0, log_evidence=25.0, n_free=6)
    assert [r.id for r in decided(row(1), other).rivals] == [2]
    more = row(2, code="period", prior=-4.0, log_evidence=25.0, n_free=9)
    assert not decided(row(1), more).rivals


def test_braces_stand_for_each_text_of_their_list():
    lists = {"own": ["1", "{0}_i"], "0": ["q", "k"]}
    assert expanded("{own} * v_i", lists) == ["1 * v_i", "q_i * v_i", "k_i * v_i"]
    assert expanded("{none} * v_i", lists) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"laws": "v_i"}, "lists of texts"),
        ({"ranges": {"n": "4 .. -4"}}, "give numbers"),
        ({"laws": ["norm(v_i)^w * v_i"]}, "'w' has no range"),
        ({"laws": ["norm(v_i)^n"]}, "must be a vector"),
        ({"laws": ["v_i"]}, "must be a vector with constants inside"),
    ],
)
def test_a_form_that_cannot_be_scanned_is_refused_at_once(changes, said):
    inside = {"ranges": {"n": "-4 .. 4"}, **changes}
    source = {**load_grammar("physics").source, "inside": inside, "beyond": {}, "shapes": {}}
    data = dataset_of([scene_of(TIMES, (body("ball"),), np.zeros((40, 1, 2)))])
    with pytest.raises(GrammarError, match=said):
        Inside(Laws(read_grammar(source), data), data)


@pytest.mark.parametrize("axis", [Axis("h", -1.0, 3.0), Axis("x", 0.0, 0.0, cauchy=(1.0, 2.0))])
def test_grids_are_even_under_the_prior(axis):
    line = axis.line(100)
    assert np.all(np.diff(line[:, 0]) > 0)
    assert np.median(line[:, 0]) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(np.diff(line[:, 0])[40:60], line[40:60, 1], rtol=0.1)
