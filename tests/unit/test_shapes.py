"""Shapes of one variable: bounded by their profile, bred, fitted, told with simple numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import to_formula
from bsp_gp.language.formula import Constant, Number, evaluate, substitute
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.language.render import to_text
from bsp_gp.language.tidy import tidied
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, constant_units
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.report.naming import describe
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.inner import InnerSearch
from bsp_gp.search.shapes import Profile, ShapeSearch, X, read_ways
from tests.fitted_tracks import body, dataset_of, scene_of
from tests.unit.test_constancy import GRAVITY, thrown

PHYSICS = load_grammar("physics")
DT = 0.05


def discs(pull, seed=0, n_frames=40, n_scenes=3):
    """Discs of unlike masses that a pull moves, step by step as a regression has it."""
    rng, scenes = np.random.default_rng(seed), []
    while len(scenes) < n_scenes:
        mass = rng.uniform(1.0, 9.0, 4)
        p = rng.uniform(-12.0, 12.0, (4, 2))
        track = [p, p + DT * rng.normal(0.0, 2.0, (4, 2))]
        while len(track) < n_frames:
            gap = track[-1][None] - track[-1][:, None]
            r = np.linalg.norm(gap, axis=-1) + np.eye(4)
            force = pull(mass[:, None], mass, r) * (1 - np.eye(4)) / mass[:, None]
            a = (force[..., None] * gap / r[..., None]).sum(axis=1)
            track.append(2 * track[-1] - track[-2] + DT**2 * a)
        apart = np.linalg.norm(np.diff(np.array(track)[:, [0, 0, 0, 1, 1, 2, 1, 2, 3, 2, 3, 3]]
                                       .reshape(n_frames, 2, 6, 2), axis=1), axis=-1)  # fmt: skip
        if apart.min() > 2.0:
            bodies = tuple(body(str(k), mass=float(m)) for k, m in enumerate(mass))
            times = DT * np.arange(n_frames)
            scenes.append(scene_of(times, bodies, np.array(track), name=str(len(scenes))))
    return dataset_of(scenes)


def search_of(data, draws=0, seed=0):
    """The search for constants inside, and ways between pairs."""
    regression, types = build_regression(data.scenes, sigma=1e-3), dataset_types(data)
    target = regression.target()
    noise = np.random.default_rng(seed).standard_normal((len(target), draws))
    inner = InnerSearch(regression, target, noise, lambda columns: columns, np.ones(2, dtype=bool),
                        PHYSICS.inside["ranges"], types)  # fmt: skip
    ways = read_ways(PHYSICS, data, (), types, set(types))
    return inner, [way for way in ways if way.term.kind == "pair"]


def bred(data):
    inner, ways = search_of(data)
    search = ShapeSearch(PHYSICS.shapes, inner, ways, 15_000, chance=0.0)
    found = search.run(
        lambda levels, seeds: Genetic(max_levels=levels, seeds=seeds), np.random.default_rng(1)
    )
    return found[0], search


def test_a_shape_that_no_form_has_is_found_with_its_constants():
    data = discs(lambda a, b, r: 50 * a * b / (r + 3) ** 2)
    shape, search = bred(data)
    assert to_text(shape.form.term.formula) == (
        "inverse((1 + norm(p_i - p_j) / L)^2) * (m_i * m_j * normalize(p_i - p_j))"
    )
    assert shape.at == pytest.approx({"L": 3.0}, rel=1e-3)
    assert shape.gain == pytest.approx(max(search.bounds.values()), rel=1e-6)


def test_a_power_is_told_as_one_without_a_length():
    shape, _ = bred(discs(lambda a, b, r: 5 * a * b / r**1.37))
    assert to_text(shape.form.term.formula) == (
        "norm(p_i - p_j)^n1 * (m_i * m_j * normalize(p_i - p_j))"
    )
    assert shape.at == pytest.approx({"n1": -1.37}, abs=1e-3)


def test_no_shape_explains_more_than_its_profile():
    data = discs(lambda a, b, r: 8 * a * b * r / (r**2 + 25))
    inner, ways = search_of(data, draws=3)
    way = next(w for w in ways if to_text(w.term.formula).startswith("m_i * m_j"))
    profile = Profile.of(inner, way)
    assert profile.bound <= inner.target @ inner.target * (1 + 1e-12)
    knots = profile.knots
    for values in (knots, 1 / knots, np.sin(knots), knots / (knots**2 + 25)):
        unit = profile.unit(values)
        assert np.square(unit @ profile.target) <= profile.bound * (1 + 1e-9)
        form = parse_formula("norm(p_i - p_j) * m_i * m_j * normalize(p_i - p_j)", inner._types)
    own = np.square(profile.unit(knots) @ profile.target)  # as a law has it, without a profile
    column = build_regression(data.scenes, sigma=1e-3).column(Term(form))[0][:, 0]
    assert own == pytest.approx((column @ inner.target) ** 2 / (column @ column), rel=1e-6)


def test_a_way_that_is_infinite_on_a_body_is_none():
    data = discs(lambda a, b, r: a * b / r, n_scenes=1)
    inner, ways = search_of(data)
    way = replace(ways[0], term=Term(parse_formula(
        "inverse(m_i - m_i) * normalize(p_i - p_j)", dataset_types(data))))  # fmt: skip
    assert Profile.of(inner, way) is None
    assert Profile.of(inner, ways[0]) is not None


def test_ways_that_cannot_explain_enough_are_not_searched():
    data = discs(lambda a, b, r: 50 * a * b / (r + 3) ** 2)
    inner, ways = search_of(data)
    search = ShapeSearch(PHYSICS.shapes, inner, ways, 15_000)
    rest = search.run(None, np.random.default_rng(1), least=2 * float(inner.target @ inner.target))
    assert rest == () and search.n_tried == 0 and not search.bounds


def test_a_search_is_the_same_for_the_same_seed():
    data = discs(lambda a, b, r: 25 * a * b * np.cos(r / 3) / r)
    (one, first), (other, second) = bred(data), bred(data)
    assert to_text(one.form.term.formula) == to_text(other.form.term.formula)
    assert (one.at, one.gain, first.n_tried) == (other.at, other.gain, second.n_tried)


VARIANTS = {
    "1 + (x - 1)": "x", "1 - (x + 1)": "-x", "x - -2": "2 + x", "pow(x, -2)": "inverse(x^2)",
    "x * inverse(sqrt(x))": "sqrt(x)", "x * inverse(x)": "1", "pow(x, 1)": "x",
    "sqrt(x) * exp(-x) * x": "exp(-x) * x^1.5", "x * inverse(1 - 1)": "inverse(0) * x",
    "x * sqrt(0 - 2)": "sqrt(-2) * x", "x * 3": "3 * x",
}  # fmt: skip


@pytest.mark.parametrize("text", VARIANTS)
def test_formulas_are_told_without_what_cancels(text):
    formula = parse_formula(text, {"x": X.type})
    assert to_text(tidied(formula)) == VARIANTS[text]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_tidied_shapes_have_the_same_values(seed):
    rng = np.random.default_rng(seed)
    grammar, _ = PHYSICS.shapes.masked({"x"})
    formula = to_formula(Pcfg.uniform(grammar).sample(rng, "Shape", 8), grammar)
    constants = {name: float(rng.integers(-4, 5)) / 2 for name in ("n", "d", "k")}
    values = {"x": np.array([0.3, 1.1, 2.7])}
    numbers = {Constant(name): Number(value) for name, value in constants.items()}
    short = tidied(substitute(formula, numbers))
    before, after = (np.broadcast_to(evaluate(f, values, constants), 3) for f in (formula, short))
    good = np.isfinite(before) & np.isfinite(after)
    np.testing.assert_allclose(after[good], before[good], rtol=1e-9, atol=1e-12)


def test_lengths_in_shapes_have_units():
    data = discs(lambda a, b, r: a * b / r, n_scenes=1)
    text = "c1 * (sin(norm(p_i - p_j) / L - d) * (m_i * m_j * normalize(p_i - p_j)))"
    units = constant_units(Term(parse_formula(text, dataset_types(data))))
    assert {name: str(unit) for name, unit in units.items()} == {"L": "m", "c1": "m/(kg s^2)"}


def test_a_bred_force_is_named_by_what_it_depends_on():
    data = discs(lambda a, b, r: a * b / r, n_scenes=1)
    types = dataset_types(data)
    names = {
        "c1 * (inverse(1 + norm(p_i - p_j) / L) * (m_i * m_j * normalize(p_i - p_j)))":
            "force along the line to the other body, a function of distance of no listed form",
        "c1 * (sin(norm(v_i) / u) * (m_i * normalize(v_i)))":
            "force along the velocity, a function of speed of no listed form",
        "c1 * (cos((dot(p_i - origin, e_y) - h) / D) * (m_i * e_x))":
            "force along x, a function of y of no listed form",
    }  # fmt: skip
    for text, name in names.items():
        assert describe(parse_formula(text, types), is_bred=True) == name


@pytest.mark.parametrize(("change", "message"), [
    (lambda shapes: shapes.pop("rules"), "has a list, of"),
    (lambda shapes: shapes["rules"].pop("Shape"), "among them Shape"),
    (lambda shapes: shapes["of"][0].pop("scale"), "each needs a variable"),
    (lambda shapes: shapes.update(of=[]), "each needs a variable"),
    (lambda shapes: shapes["of"][0].update(scale="Q"), "'Q' has no range"),
    (lambda shapes: shapes["of"][0].update(times="v_i"), "each needs a variable"),
    (lambda shapes: shapes["rules"].update(Factor="sin(p_i)"), "unknown name 'p_i'"),
])  # fmt: skip
def test_a_grammar_with_odd_shapes_is_refused(change, message):
    source = json.loads(json.dumps(dict(PHYSICS.source)))
    change(source["shapes"])
    with pytest.raises(GrammarError, match=message):
        read_grammar(source)


@pytest.mark.slow
def test_a_drag_that_waves_along_the_way_is_found_by_its_wave():
    """It had been a drag with a strength for each scene."""
    data = thrown(lambda t, p, v: 0.15 + 0.12 * np.sin(2.5 * p[0]), n_scenes=8)
    report = close_loop(data, (GRAVITY,), rng=0, n_bootstrap=0, max_rounds=2)
    effect = report.rounds[0].effect
    assert (effect.code, report.rounds[1].verdict) == ("shape", "nothing missing")
    known = {c.name: c.value for c in effect.constants}
    assert 1 / known["D1"] == pytest.approx(2.5, rel=0.03)


@pytest.mark.slow
def test_a_drag_with_a_peak_beside_a_weight_is_told_as_a_description():
    def braked(v):
        return -1.2 * v / (1 + (np.hypot(*v) / 3) ** 3)

    rng, t, scenes = np.random.default_rng(3), np.linspace(0.0, 4.0, 120), []
    for k in range(5):
        start = [*rng.uniform(-8.0, 8.0, 2), *rng.normal(0.0, 2.5, 2)]
        track = solve_ivp(
            lambda t, y: [*y[2:], *(braked(y[2:]) + [0.0, -2.0])], (0.0, 4.0), start, t_eval=t,
            rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        places = track.y[:2].T + rng.normal(0.0, 0.01, (len(t), 2))
        scenes.append(scene_of(t, (body("ball"),), places[:, None], name=f"s{k}"))
    data = dataset_of(scenes, noise=(0.01, 0.01))
    report = close_loop(data, [], n_bootstrap=0, rng=np.random.default_rng(1))
    assert (report.verdict, report.rounds[0].effect.code) == ("effective law", "shape")
    assert report.rounds[0].reason == "bred" and report.total["ratio"].value < 0.02
