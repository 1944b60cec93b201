"""A lone body that swings without a cause is asked for what drives it back."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.periodogram import swing_of
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.inside import Inside
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.swings import Swings
from bsp_gp.loop.view import View
from bsp_gp.report.page import page_of
from tests.loop_views import GRAVITY
from tests.unit.test_response import thrown

STRENGTH, DRAG = 8.2e-4, 1.3e-3


def balance(creep, seed=0, n=110, step=10.0, sigma=3e-4):
    """The spot of a torsion balance on its scale, whose rest point creeps at some m/s."""

    def rate(t, z):
        return [z[1], STRENGTH * (0.275 + creep * t - z[0]) - DRAG * z[1]]

    times = np.arange(n) * step
    places = solve_ivp(
        rate, (0, times[-1]), [0.284, 0.0], t_eval=times, rtol=1e-9, atol=1e-11, max_step=5.0
    ).y[0]
    noise = sigma * np.random.default_rng(seed).standard_normal(n)
    table = pd.DataFrame({"t": times, "x": places + noise})
    return bsp_gp.Dataset.from_frames(
        table, units={"length": "m", "time": "s"}, properties={"mass": "1[kg]"}
    )


def view_of(data, laws=()):
    hypothesis = Hypothesis.from_laws(data, laws)
    found = fit(hypothesis, data)
    return View(found, continued(hypothesis, found), data, np.random.default_rng(0))


def proposed(data, laws=()):
    proposer = Swings(Inside(Laws(load_grammar("physics"), data), data))
    return proposer.propose(view_of(data, laws))


def test_a_swing_is_asked_for_a_spring_and_a_drag_and_begins_near_them():
    data = balance(creep=-3e-7)
    view = view_of(data)
    family = proposed(data)
    (both,) = family.proposals
    assert family.is_control and not family.n_tried
    starts = list(both.starts.values())
    assert starts[0] == pytest.approx(0.275, abs=2e-3)
    assert starts[1] == pytest.approx(STRENGTH, rel=0.15)
    assert starts[2] == pytest.approx(-DRAG, rel=0.5)
    found = both.fitted(view.near, data, criteria=view.criteria)
    constants = dict(found.law.constants)
    assert constants["c1"] == pytest.approx(STRENGTH, rel=0.02)
    assert found.chi2_red < 4.0


def test_a_swing_that_a_law_foresees_is_not_asked():
    laws = ["8.2e-4 [kg/s^2] * (origin + 0.275 [m] * e_x - p_i)", "-1.3e-3 [kg/s] * v_i"]
    assert not proposed(balance(creep=0.0), laws).proposals


def test_what_does_not_swing_is_not_asked():
    data = thrown(n_scenes=2, n_rows=40)
    assert not proposed(data, [GRAVITY]).proposals


@pytest.mark.slow
def test_a_torsion_balance_whose_rest_point_creeps_is_no_periodic_push():
    """The push explains nearly all of the moments, and a spring less than half."""
    done = bsp_gp.close_loop(balance(-1.5e-6, seed=1), [], rng=np.random.default_rng(1))
    assert [r.effect.code for r in done.rounds if r.adopted] == ["law", "drift"]
    assert done.law.constants["c1"] == pytest.approx(STRENGTH, rel=0.02)


def test_nothing_is_asked_where_the_grammar_has_no_spring():
    data = balance(creep=0.0)
    inside = Inside(Laws(load_grammar("physics"), data), data)
    inside.forms = [form for form in inside.forms if "centre" not in form.term.formula.inputs]
    assert not Swings(inside).propose(view_of(data)).proposals


LONG_STRENGTH, NATURAL, POST = 6.0, 0.1, np.array([0.05, -0.02])


def about_a_post(n=160, dt=1 / 30, sigma=1e-3, seed=0):
    """A puck of 1 kg on an air table, tied to a post by a spring of ten centimetres."""

    def rate(t, z):
        way = z[:2] - POST
        far = np.hypot(*way)
        return [*z[2:], *(-LONG_STRENGTH * (far - NATURAL) * way / far)]

    t = np.arange(n) * dt
    made = solve_ivp(rate, (0, t[-1]), [*(POST + [0.4, 0]), 0.1, 0.8], t_eval=t, rtol=1e-9,
                     atol=1e-11)  # fmt: skip
    x, y = made.y[:2] + sigma * np.random.default_rng(seed).standard_normal((2, n))
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": t, "x": x, "y": y}), units={"length": "m", "time": "s"},
        properties={"mass": "1[kg]"},
    )  # fmt: skip


def test_in_a_plane_a_spring_that_has_a_length_is_asked_for_as_well():
    data = about_a_post()
    view = view_of(data)
    _, longer = proposed(data).proposals
    found = longer.fitted(view.near, data, criteria=view.criteria)
    constants = dict(found.law.constants)
    assert constants["D1"] == pytest.approx(NATURAL, abs=5e-3)
    assert constants["c1"] == pytest.approx(LONG_STRENGTH, rel=0.02)
    assert found.chi2_red == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_a_puck_that_is_tied_to_a_post_is_not_kicked_at_random():
    """Random kicks in a trap were told as its cause: they leave nothing of any motion."""
    report = bsp_gp.close_loop(about_a_post(), [], rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    (effect,) = [done.effect for done in report.rounds if done.adopted]
    assert page_of(report).rounds[0].effect.name == "spring of some length to a post"
    (length,) = [c for c in effect.constants if c.name == "D1"]
    assert length.low < NATURAL < length.high


def moons(n=60, span=40.0, seed=0, periods=(1.769, 3.551, 7.155)):
    """Three moons that are seen from the side, at uneven epochs (days; radii of their planet)."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, span, n))
    far, periods = np.array([5.9, 9.4, 15.0]), np.array(periods)
    angles = 2 * np.pi * times[:, None] / periods + rng.uniform(0, 6, 3)
    places = far * np.sin(angles) + 0.15 * rng.standard_normal((n, 3))
    rows = [{"t": t, "entity": name, "x": x}
            for t, row in zip(times, places, strict=True)
            for name, x in zip("abc", row, strict=True)]  # fmt: skip
    frame = pd.DataFrame(rows)
    return bsp_gp.Dataset.from_frames(frame, units={"length": "Rjup", "time": "day"}), periods


@pytest.mark.parametrize("slowest", [7.155, 32.0])
def test_bodies_that_swing_at_rates_of_their_own_are_asked_for_a_spring_of_each(slowest):
    """Of the moons but one all had been told as noise beside one spring.

    Of one that is seen for little more than a turn nothing alone would call that a swing.
    """
    data, periods = moons(periods=(1.769, 3.551, slowest))
    view = view_of(data)
    (each,) = proposed(data).proposals
    assert each.code == "law_by_body"
    found = each.fitted(view.near, data, criteria=view.criteria)
    (table,) = (v for name, v in found.law.constants.items() if name.endswith("[body]"))
    told = [2 * np.pi / np.sqrt(table[name]) / 86400 for name in "abc"]
    np.testing.assert_allclose(told, periods, rtol=5e-3)
    assert found.noise.levels[0] < 0.25 * 7.1492e7


def logged_angle(amplitude, rng):
    """A pendulum's angle with rows that are lost, as a sensor logs it."""
    times = np.arange(300) / 20
    angle = solve_ivp(
        lambda _, s: [s[1], -12 * np.sin(s[0]) - 0.1 * s[1]], (0, times[-1]), [amplitude, 0.0],
        t_eval=times, rtol=1e-9,
    ).y[0]  # fmt: skip
    kept = rng.random(300) > 0.15
    kept[100:130] = False
    degrees = np.degrees(angle) + 0.3 * rng.standard_normal(300)
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t (s)": times[kept], "Angle (deg)": degrees[kept]}),
        properties={"mass": "1[kg]"},
    )


def test_an_angle_is_asked_for_a_weight_on_an_arm_as_well():
    """A power of the angle and a kick were told where rows were missing."""
    data = logged_angle(0.9, np.random.default_rng(0))
    family = proposed(data)
    (sine,) = (p for p in family.proposals if "sin(" in p.text)
    found = sine.fitted(view_of(data).fit, data, criteria=view_of(data).criteria)
    values = {p: v for (p, _), v in zip(found.parameters, found.values, strict=True)}
    assert found.chi2_red < 1.3
    assert values["c1"] == pytest.approx(-12.0, rel=0.03)
    assert "D1" not in values  # a radian is known


def test_counts_of_a_sensor_may_be_an_angle():
    """Its scale is told: a radian is as many counts as make swings as slow as wide ones are."""
    rng, times = np.random.default_rng(0), np.arange(300) / 20
    angle = solve_ivp(
        lambda _, s: [s[1], -12 * np.sin(s[0]) - 0.1 * s[1]], (0, times[-1]), [0.8, 0.0],
        t_eval=times, rtol=1e-9,
    ).y[0]  # fmt: skip
    table = pd.DataFrame({"t": times, "x": 440 + 500 * angle + rng.standard_normal(300)})
    data = bsp_gp.Dataset.from_frames(
        table, units={"length": "px", "time": "s"}, properties={"mass": "1[kg]"}
    )
    view = view_of(data)
    (sine,) = (p for p in proposed(data).proposals if "sin(" in p.text)
    found = sine.fitted(view.fit, data, criteria=view.criteria)
    values = {p: v for (p, _), v in zip(found.parameters, found.values, strict=True)}
    assert found.chi2_red < 1.3
    assert values["D1"] == pytest.approx(500.0, rel=0.03)
    assert values["c1"] == pytest.approx(-12.0 * 500, rel=0.05)


@pytest.mark.parametrize("unit", ["m", "cm"])
def test_a_length_is_no_angle(unit):
    table = pd.DataFrame({"t": np.arange(80) / 20, "x": np.cos(0.15 * np.arange(80))})
    data = bsp_gp.Dataset.from_frames(
        table, units={"length": unit, "time": "s"}, properties={"mass": "1[kg]"}
    )
    assert not any("sin(" in p.text for p in proposed(data).proposals)


@pytest.mark.parametrize("fading", [0.5, 2.5])
def test_a_swing_that_dies_away_soon_is_one(fading):
    """Within two turns it has lost most of itself, and its line in a periodogram is wide."""
    t = np.arange(150) / 30
    rng = np.random.default_rng(2)
    x, y = (np.exp(-fading * t) * np.cos(12.0 * t + p) for p in (0.0, 1.0))
    table = pd.DataFrame({"t": t, "x": x, "y": 0.3 * y}) + 2e-3 * rng.standard_normal((150, 3))
    table["t"] = t
    data = bsp_gp.Dataset.from_frames(table, units={"length": "m", "time": "s"})
    found = fit(Hypothesis.from_laws(data, ()), data)
    assert swing_of(found) == pytest.approx(12.0, rel=0.05)
    assert proposed(data).proposals


def test_a_swing_is_wide():
    """A piston had none, since its tracker jumped surely between two pixels across its way."""
    rng, t = np.random.default_rng(6), np.arange(582) / 60
    across = np.where(np.sin(1.7 * t) > 0, 20.0, -6.0) + 1e-3 * rng.standard_normal(582)
    along = 450.0 * np.cos(16.1 * t) + 3.0 * rng.standard_normal(582)
    table = pd.DataFrame({"t": t, "x": along, "y": across})
    data = bsp_gp.Dataset.from_frames(table, units={"length": "px", "time": "s"})
    data = replace(data, noise=(3.0, 1e-3))
    found = fit(Hypothesis.from_laws(data, ()), data)
    assert swing_of(found) == pytest.approx(16.1, rel=0.02)


def test_what_settles_without_turning_is_no_swing():
    t = np.arange(150) / 30
    table = pd.DataFrame({"t": t, "x": np.exp(-3.0 * t), "y": 1 - np.exp(-2.0 * t)})
    table[["x", "y"]] += 2e-3 * np.random.default_rng(3).standard_normal((150, 2))
    data = bsp_gp.Dataset.from_frames(table, units={"length": "m", "time": "s"})
    assert not swing_of(fit(Hypothesis.from_laws(data, ()), data))
