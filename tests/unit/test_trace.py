"""Questions 2 and 3 of the loop on worlds with a known effect in them."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import SettingsError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.channels import directions_of
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.exponents import exponents_of
from bsp_gp.loop.guide import guided, in_guided_order, inputs_left_out
from bsp_gp.loop.outcome import _plain
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.shares import Resampling, explain
from bsp_gp.loop.smooth_view import MAX_TRACKS, runs_of, smooth_view, spline_basis
from bsp_gp.loop.trace import trace_residual
from bsp_gp.loop.traced import Channel, Exponent, Guidance, Trace
from bsp_gp.report.figures import build_figures
from bsp_gp.report.html import render_html
from bsp_gp.report.summary import summary_text
from bsp_gp.report.traces import exponent_text, guidance_sentence, trace_sentence
from bsp_gp.simulate.effects import effect
from bsp_gp.simulate.synth import make, preset
from tests.planted import SI, orbit_dataset
from tests.throws import throws
from tests.worlds import (
    WEIGHT,
    flights,
    gusts,
    head_wind,
    linear_drag,
    magnetic,
    nothing,
    quadratic_drag,
    red_noise,
    tied,
    trap,
    wind,
)

RED_MEMORY = -0.05 / math.log(0.8)  # of red_noise, s


def fitted(data, *laws):
    law = declared_law(data, laws)
    observation = observe(data, law, np.random.default_rng(0))
    return observation, observation.fit(law)


def traced(data, *laws, seed=1):
    return trace_residual(*fitted(data, *laws), np.random.default_rng(seed))


def made(name, value, *, kind="fall", n_scenes=8, noise=0.005, seed=3, **options):
    change = effect(name, value, is_declared=False, **options)
    extra = {"has_table": False} if kind == "fall" else {}
    settings = preset(kind, [change], n_scenes=n_scenes, noise=noise, **extra)
    data, truth = make(settings, np.random.default_rng(seed))
    return data, truth.declared


def exponent(trace, variable, channel=None):
    (found,) = [
        e for e in trace.exponents if e.variable == variable and channel in (None, e.channel)
    ]
    return found


def channel(trace, name):
    (found,) = [c for c in trace.channels if c.name == name]
    return found


# --- the smooth view ------------------------------------------------------------------------------


def test_splines_are_a_partition_of_one():
    times = np.array([0.0, 0.3, 0.35, 1.0, 2.0, np.nan])
    for n in (1, 2, 3, 5):
        basis = spline_basis(times, n)
        assert basis.shape == (6, n)
        np.testing.assert_allclose(basis[:5].sum(axis=1), 1.0)
        assert not basis[5].any()
    assert spline_basis(np.array([1.0, np.nan]), 3)[0, 0] == 1.0


def test_runs_are_stretches_of_a_mask():
    assert runs_of(np.array([1, 1, 0, 1, 0, 0, 1], bool)) == [(0, 2), (3, 4), (6, 7)]
    assert runs_of(np.zeros(3, bool)) == []


@pytest.mark.parametrize("law", [WEIGHT, "g * m_i * down"])
def test_noise_has_unit_variance_in_every_coordinate(law):
    squares, size = 0.0, 0
    for seed in range(6):
        view = smooth_view(*fitted(flights(seed, nothing), law))
        assert view.constants.shape[1] == (law != WEIGHT)
        squares += sum(float(np.square(z).sum()) for z in view.target)
        size += view.size
    # A sum of squares of `size` normals, 4.5 standard errors.
    assert abs(squares - size) < 4.5 * math.sqrt(2 * size)


def with_quoted_errors(data, seed):
    """More noise, of another size at every point, that the points quote."""
    rng = np.random.default_rng(seed)

    def quoted(scene):
        size = 0.02 * 10 ** rng.uniform(0, 1, (len(scene.times), 1, 1))
        size = np.broadcast_to(size, scene.positions.shape)
        positions = scene.positions + size * rng.standard_normal(size.shape)
        return replace(scene, positions=positions, sigma=np.hypot(size, 0.005))

    return replace(data, scenes=[quoted(scene) for scene in data.scenes])


@pytest.mark.parametrize("kind", ["with a memory", "quoted by points"])
def test_noise_that_is_not_white_has_unit_variance_as_well(kind):
    squares, size = 0.0, 0
    for seed in range(6):
        if kind == "with a memory":
            data = replace(flights(seed, nothing, noise=red_noise), noise_memory=RED_MEMORY)
        else:
            data = with_quoted_errors(flights(seed, nothing), seed)
        view = smooth_view(*fitted(data, WEIGHT))
        squares += sum(float(np.square(z).sum()) for z in view.target)
        size += view.size
    # A sum of squares of `size` normals, 4.5 standard errors.
    assert abs(squares - size) < 4.5 * math.sqrt(2 * size)


def test_free_pushes_along_all_axes_explain_everything():
    view = smooth_view(*fitted(flights(0, linear_drag), WEIGHT))
    everything = [np.broadcast_to(np.eye(g.shape[2]), (*g.shape, g.shape[2])) for g in view.groups]
    explained = explain(view, everything)
    assert explained.n_free == view.size
    assert Resampling(view, np.random.default_rng(0)).share(explained)[0] == pytest.approx(1.0)
    assert view.beside(everything).size == 0


def test_constants_of_the_law_are_never_credited_to_a_channel():
    """A wrong g that is free: nothing is left for the vertical."""
    trace = traced(flights(0, nothing), "g * m_i * down")
    assert all(not c.is_leading for c in trace.channels)
    assert not trace.exponents
    fixed = traced(flights(0, nothing), "9 [m/s^2] * m_i * down")
    assert [c.name for c in fixed.leading] == ["along y (vertical)"]


def test_very_many_tracks_are_thinned_and_it_is_said():
    trace = traced(flights(0, linear_drag, n_train=MAX_TRACKS + 20, n_test=1, n_times=12), WEIGHT)
    assert len(trace.scenes) <= MAX_TRACKS
    assert f"of {MAX_TRACKS + 20} training scenes were traced" in trace.notes[0]


# --- where ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "name"),
    [
        (linear_drag, "along the velocity"),
        (quadratic_drag, "along the velocity"),
        (magnetic, "across the velocity"),
        (wind, "along x"),
        (gusts, "along x"),
    ],
)
def test_a_planted_force_is_found_in_its_channel(force, name):
    trace = traced(flights(0, force, n_train=6), WEIGHT)
    assert [c.name for c in trace.leading] == [name]
    assert trace.leading[0].share > 0.9
    assert trace.leading[0].low <= trace.leading[0].share <= trace.leading[0].high
    assert "6 whole scenes" in trace.method


def test_directions_in_space():
    trace = traced(flights(0, linear_drag, n_dims=3, n_train=6), WEIGHT)
    assert [c.name for c in trace.leading] == ["along the velocity"]
    across = channel(trace, "across the velocity")
    assert across.freedom == 2 * trace.leading[0].freedom
    assert exponent(trace, "speed").low < 1 < exponent(trace, "speed").high


def test_two_effects_lead_together_and_scale_each_by_itself():
    trace = traced(flights(0, head_wind, n_train=6, sigma=0.02), WEIGHT)
    names = {c.name for c in trace.leading}
    assert {"along the velocity", "along x"} <= names
    drag = exponent(trace, "speed", "along the velocity")
    push = exponent(trace, "speed", "along x")
    assert drag.value == pytest.approx(1.0, abs=0.2)
    assert push.value == pytest.approx(0.0, abs=0.2)


def test_a_spring_to_nothing_seen_leads_to_its_place():
    data, declared = made("spring", 3.0, x=0.0, y=0.0, noise=0.002)
    trace = traced(data, *declared)
    best = trace.channels[0]
    assert (best.kind, best.is_leading) == ("point", True)
    true = traced(flights(0, trap, n_train=6), WEIGHT).channels[0]
    np.testing.assert_allclose(true.place, (2.0, 15.0), atol=0.1)


def test_lines_to_bodies_are_channels():
    trace = traced(tied(0, n_train=5))
    assert trace.leading[0].name == "along the line to post"
    trace = traced(orbit_dataset(0, n_train=5))
    assert trace.leading[0].name == "along the line to body0"


def test_few_scenes_have_simulated_intervals():
    trace = traced(flights(0, linear_drag, n_train=2), WEIGHT)
    assert "simulated" in trace.method
    best = trace.leading[0]
    assert 0.9 < best.low < best.high <= 1


def test_who_carries_it():
    """Two balls a scene, of which one is charged in a magnetic field."""

    def scene(name, rng):
        t = 0.05 * np.arange(30)
        v = rng.uniform(2.0, 4.0, 2)
        straight = t[:, None] * v
        turn = 3.0
        arc = np.stack([np.sin(turn * t), 1 - np.cos(turn * t)], axis=1) * 2.0
        p = np.stack([straight + [20.0, 0.0], arc], axis=1)
        p = p + 0.003 * rng.standard_normal(p.shape)
        balls = [Entity(n, properties={"mass": 1.0}) for n in ("plain", "charged")]
        return Scene(name, t, p, balls)

    scenes = [scene(f"s{k}", r) for k, r in enumerate(np.random.default_rng(0).spawn(6))]
    trace = traced(Dataset("two", scenes, units=SI, test=("s5",)))
    assert [c.name for c in trace.entities] == ["charged", "plain"]
    assert trace.entities[0].share > 0.99 and trace.entities[1].high < 0.01
    assert len(trace.scenes) == 5
    assert sum(c.share for c in trace.scenes) == pytest.approx(1.0, abs=1e-6)


# --- when -----------------------------------------------------------------------------------------


def test_what_acts_over_a_region_only_is_seen_there():
    t = 0.02 * np.arange(60)
    scenes = []
    for k, rng in enumerate(np.random.default_rng(1).spawn(6)):
        start, speed, brake = rng.uniform(-2.5, -2.0), rng.uniform(3.0, 4.0), 3.0
        x, v, path = start, speed, []
        for _ in range(60 * 20):
            path.append(x)
            v -= 0.001 * brake * (abs(x) <= 1.0)
            x += 0.001 * v
        p = np.stack([np.array(path[::20]), np.zeros(60)], axis=1)
        p = p + 0.001 * rng.standard_normal(p.shape)
        mat = np.zeros((60, 2))
        entities = [
            Entity("puck", "disc", radius=0.05, properties={"mass": 1.0}),
            Entity("mat", "rect_mat", width=2.0, height=2.0, is_static=True,
                   properties={"friction": 0.3}),
        ]  # fmt: skip
        scenes.append(Scene(f"s{k}", t, np.stack([p, mat], axis=1), entities))
    trace = traced(Dataset("mat", scenes, units=SI, noise=(0.001,), test=("s5",)))
    parts = {s.name: s for s in trace.segments}
    assert parts["over a region"].share > 0.95 > parts["free flight"].share
    assert any(c.kind == "region" and c.share > 0.9 for c in trace.channels)


def test_an_inelastic_loss_is_seen_in_contact():
    settings = preset("bounce", [effect("inelastic", 0.5, is_declared=False)], n_scenes=8)
    data, truth = make(settings, np.random.default_rng(3))
    trace = traced(data, *truth.declared)
    parts = {s.name: s for s in trace.segments}
    assert parts["in contact"].share > 0.5
    assert trace.channels[0].kind in ("contact", "line")


# --- how it scales --------------------------------------------------------------------------------


CASES = {
    "drag": (lambda: made("drag", 0.1), "along the velocity", "speed", 1.0),
    "quadratic drag": (lambda: made("quadratic_drag", 0.02), "along the velocity", "speed", 2.0),
    "wind": (lambda: made("wind", 0.5), "along x", "speed", 0.0),
    "attraction": (lambda: (orbit_dataset(0), ()), "along the line to body0", "distance", -2.0),
    "spring": (lambda: (tied(0, rest=0.0), ()), "along the line to post", "distance", 1.0),
}


@pytest.mark.parametrize("name", CASES)
def test_exponents_of_known_forces(name):
    build, where, variable, true = CASES[name]
    data, declared = build()
    trace = traced(data, *declared)
    assert channel(trace, where).is_leading
    found = exponent(trace, variable, where)
    assert found.is_determined and found.profile is not None
    # Twice the half-width of 90 % are 3.3 standard errors, and the states are denoised.
    half = (found.high - found.low) / 2
    assert abs(found.value - true) < 2 * half + 0.01
    assert half < 0.3


def test_properties_have_exponents():
    trace = traced(flights(0, magnetic, n_train=8), WEIGHT)
    assert exponent(trace, "q_i").value == pytest.approx(1.0, abs=0.1)
    mass = exponent(trace, "m_i")
    assert mass.of_force and mass.value == pytest.approx(0.0, abs=0.1)


def test_masses_of_both_bodies_in_an_attraction():
    data = orbit_dataset(0)
    view = smooth_view(*fitted(data))
    (lines,) = [d for d in directions_of(view) if d.name == "along the lines to all other bodies"]
    found = {e.variable: e.value for e in exponents_of(view, lines, data)}
    assert found["m_i"] == pytest.approx(1.0, abs=0.05)
    assert found["m_j"] == pytest.approx(1.0, abs=0.05)
    assert found["distance"] == pytest.approx(-2.0, abs=0.02)


def test_what_hardly_varies_is_not_determined():
    t = 0.05 * np.arange(30)
    scenes = []
    for k, rng in enumerate(np.random.default_rng(0).spawn(5)):
        p = np.stack([50.0 * t - 0.5 * t**2, 0.1 * k + 0 * t], axis=1)
        p = p + 0.001 * rng.standard_normal(p.shape)
        scenes.append(Scene(f"s{k}", t, p[:, None], [Entity("ball", properties={"mass": 1.0})]))
    trace = traced(Dataset("fast", scenes, units=SI, noise=(0.001,), test=("s4",)))
    found = exponent(trace, "speed", trace.leading[0].name)
    assert not found.is_determined and math.isnan(found.value)
    assert "varies by" in found.reason
    assert exponent_text(found) == "not determined"


def test_a_force_of_time_alone_has_no_power_law():
    trace = traced(flights(0, gusts, n_train=6), WEIGHT)
    assert not any(e.is_determined for e in trace.exponents)
    assert all("powers explain" in e.reason for e in trace.exponents)


def test_the_profile_follows_the_law_without_knowing_it():
    found = exponent(traced(flights(0, quadratic_drag, n_train=8), WEIGHT), "speed")
    x, y, error = (np.array(v) for v in (found.profile.x, found.profile.y, found.profile.error))
    law = np.interp(x, found.profile.law_x, found.profile.law_y)
    # Piecewise linear through a parabola: as far off as a chord is, beyond the noise.
    chord = np.max(np.abs(law)) * np.max(np.diff(x)) ** 2 / x[-1] ** 2
    assert np.all(np.abs(y - law) < 5 * error + chord)
    assert found.unit == "m/s" and found.size_unit == "m/s^2"


def test_the_same_seed_gives_the_same_trace():
    data = flights(0, linear_drag)
    observation, fit = fitted(data, WEIGHT)
    one, two = (trace_residual(observation, fit, np.random.default_rng(5)) for _ in range(2))
    assert one == two
    assert json.loads(json.dumps(_plain(one), allow_nan=False))["channels"][0]["is_leading"]


def test_exact_data_are_traced_as_well():
    trace = traced(throws(n_scenes=6, n_times=30), WEIGHT)
    assert channel(trace, "along the velocity").is_leading
    assert exponent(trace, "speed").value == pytest.approx(1.0, abs=0.05)


# --- as a guide -----------------------------------------------------------------------------------


def told(variable, value, half, name="along the velocity"):
    return Exponent(name, variable, value, value - half, value + half, True)


def toy_trace(*exponents, inputs=("v_i", "v_j"), kind="velocity"):
    name = exponents[0].channel if exponents else "along the velocity"
    lead = Channel(name, kind, 0.9, 0.8, 1.0, 5, 100.0, True, inputs)
    other = Channel("along x", "axis", 0.1, 0.0, 0.2, 5, -1.0, False, ("e_x",))
    return Trace((lead, other), (), (), (), tuple(exponents), "", 10.0)


INPUTS = ("e_x", "e_y", "m_i", "m_j", "p_i", "p_j", "q_i", "t", "v_i", "v_j")


def test_directions_that_lead_nowhere_are_left_out():
    assert inputs_left_out(toy_trace(), INPUTS) == ("e_x", "e_y")


def test_quantities_are_left_out_only_if_they_are_known_not_to_matter():
    free = [told("speed", 1.0, 0.1), told("q_i", 0.0, 0.1), told("time", 0.02, 0.1)]
    assert inputs_left_out(toy_trace(*free), INPUTS) == ("e_x", "e_y", "q_i", "t")
    unsure = [told("q_i", 0.0, 0.6), replace(told("time", 0.0, 0.1), is_determined=False)]
    assert inputs_left_out(toy_trace(*unsure), INPUTS) == ("e_x", "e_y")
    # The mass of the receiver stays whatever its exponent.
    assert "m_i" not in inputs_left_out(toy_trace(told("m_i", 0.0, 0.1)), INPUTS)


def test_an_unseen_point_alone_leaves_nothing_out():
    assert inputs_left_out(toy_trace(inputs=(), kind="point"), INPUTS) == ()


def test_order_moves_laws_within_ties_only():
    guidance = Guidance("order", ("e_x",))
    laws = [("c1 * e_x", 0.0), ("c1 * v_i", 1.0), ("c2 * e_x", 5.0), ("c3 * v_i", 50.0)]
    rows = in_guided_order(laws, guidance, law=lambda r: r[0], score=lambda r: r[1])
    assert [r[1] for r in rows] == [1.0, 0.0, 5.0, 50.0]
    assert in_guided_order(["e_x", "v_i"], guidance) == ("v_i", "e_x")
    for used in ("off", "restrict"):
        assert in_guided_order(["e_x", "v_i"], Guidance(used, ("e_x",))) == ("e_x", "v_i")


def test_an_unknown_guide_is_refused():
    with pytest.raises(SettingsError, match="off, order, restrict"):
        close_loop(throws(), [WEIGHT], rng=np.random.default_rng(0), guide="strict")


@pytest.fixture(scope="module")
def reports():
    data = flights(0, linear_drag, n_train=5, n_test=5, sigma=0.02)
    settings = {"max_levels": 6, "n_null": 99, "max_rounds": 2}
    return {
        guide: close_loop(data, [WEIGHT], rng=np.random.default_rng(0), guide=guide, **settings)
        for guide in ("off", "order", "restrict")
    }


def test_an_ordered_search_finds_what_an_unguided_one_finds(reports):
    off, order = (reports[k].rounds[0] for k in ("off", "order"))
    for item in fields(off):
        if item.name not in ("seconds", "guidance", "rivals", "effect"):
            assert getattr(off, item.name) == getattr(order, item.name), item.name
    assert sorted(map(str, off.rivals)) == sorted(map(str, order.rivals))
    one, two = off.effect, order.effect
    assert replace(one, equivalents=()) == replace(two, equivalents=())
    assert sorted(one.equivalents) == sorted(two.equivalents)


def test_a_restricted_search_says_what_it_left_out(reports):
    done = reports["restrict"].rounds[0]
    assert done.effect.name == reports["off"].rounds[0].effect.name
    assert done.guidance.used == "restrict" and {"e_x", "e_y"} <= set(done.guidance.left_out)
    laws = [done.effect.law, *done.effect.equivalents]
    laws += [r.law for r in done.rivals if r.kind != "declared_term_change"]
    assert not any(name in law for law in laws for name in done.guidance.left_out)
    page = render_html(reports["restrict"])
    assert "Only laws of the leading directions were searched" in page and "e_x, e_y" in page


def test_the_p_value_of_a_restricted_search_counts_the_whole_grammar():
    """Noise alone may choose its channel, too."""
    data = flights(3, nothing, n_train=4, n_test=2)
    observation, fit = fitted(data, WEIGHT)
    search = EffectSearch(observation, load_grammar("physics"), max_levels=6, n_null=99)
    whole = search.propose(fit, np.random.default_rng(1))
    names = set(search.masked.inputs) - {"m_i", "e_x"}
    narrow = search.without_inputs(names).propose(fit, np.random.default_rng(1))
    assert narrow.n_scored < whole.n_scored
    assert narrow.p_value >= whole.p_value


def test_where_no_law_is_left_all_are_searched():
    data = flights(3, linear_drag, n_train=4, n_test=2)
    observation, _ = fitted(data, WEIGHT)
    search = EffectSearch(observation, load_grammar("physics"), max_levels=6, n_null=99)
    lonely = toy_trace(inputs=("nothing",))
    exponents = tuple(told(v, 0.0, 0.1) for v in ("speed", "time", "distance"))
    same, guidance = guided(search, replace(lonely, exponents=exponents), "restrict")
    assert same is search and guidance.used == "off" and "all were searched" in guidance.note


# --- for people -----------------------------------------------------------------------------------


def test_page_figure_and_summary_show_the_trace(reports):
    report = reports["order"]
    figures = build_figures(report)
    assert "trace_1" in figures and "exponent" in figures["trace_1"].caption
    assert figures["trace_1"].png.startswith(b"\x89PNG")
    page = render_html(report)
    assert "Where it is, and what it depends on" in page
    assert "along the velocity" in page and "of speed" in page
    text = " ".join(summary_text(report).split())
    assert "Traced in round 1: The residual lies along the velocity" in text
    contents = report.to_dict()["rounds"]
    assert contents[0]["trace"]["exponents"] and contents[0]["guidance"]["used"] == "order"
    assert contents[1]["trace"] is None


def test_exponents_are_written_with_the_digits_they_have():
    assert exponent_text(told("speed", 1.8, 0.21)) == "1.80 ± 0.21"
    assert exponent_text(told("speed", 1.81, 0.4)) == "1.8 ± 0.4"
    assert exponent_text(told("speed", -0.001, 0.02)) == "−0.001 ± 0.020"
    skew = Exponent("x", "speed", 1.0, 0.9, 1.8, True)
    assert exponent_text(skew) == "1.0 [0.9, 1.8]"


def test_sentences_of_little():
    assert trace_sentence(None) == "" and guidance_sentence(None) == ""
    none = replace(toy_trace(), channels=())
    assert "No direction" in trace_sentence(none)
