"""Constraints that tracks betray are proposed, adopted, and told in plain words."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposers import rods
from bsp_gp.loop.proposers.rods import Rods
from bsp_gp.loop.view import View
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.masses import with_usable_masses
from bsp_gp.report.page import page_of
from tests.swings import LENGTH, PIVOT, WEIGHT, bob, double_bob


def looked_at(data, laws):
    hypothesis = Hypothesis.from_laws(data, laws)
    return View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(0))


def track(t, x, y, sigma=1e-3):
    noise = sigma * np.random.default_rng(0).standard_normal((2, len(t)))
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": t, "x": x + noise[0], "y": y + noise[1]}),
        units={"length": "m", "time": "s"}, up="y",
    )  # fmt: skip


def test_a_small_swing_in_pixels_is_that_of_a_rod_and_no_rail():
    """A parabola had left as little: a curve that is kept to, and four forces beside it."""
    t = np.arange(300) / 60
    angle = 0.2 * np.sin(6.2 * t)
    data = track(t, 384 + 216 * np.sin(angle), 85 - 216 * np.cos(angle), sigma=0.3)
    (best, *_) = Rods().propose(looked_at(data, ())).proposals
    assert best.code == "rod"
    assert float(best.text.split("= ")[-1]) == pytest.approx(216, rel=0.1)


@pytest.mark.slow
def test_a_rod_and_then_the_drag_are_found_from_the_weight_alone():
    data = bob(lambda v: -0.15 * v, n=150)
    report = bsp_gp.close_loop(data, [WEIGHT], rng=np.random.default_rng(0), n_bootstrap=0)
    rod, drag = (done.effect for done in report.rounds if done.adopted)
    assert (rod.code, drag.code) == ("rod", "law")
    names = [drag.name, *drag.equivalents]
    assert any("norm(v_i) * normalize(v_i)" in name for name in names)
    found = {c.name: c for c in report.constants}
    length = found["L1"]
    assert abs(length.value - LENGTH) < 2 * (length.high - length.low)
    assert 0 < length.high - length.low < 2e-3
    assert abs(found["pivot_y1"].value - PIVOT[1]) < 3e-3
    told = page_of(report).rounds[0].effect.name
    assert re.fullmatch(
        r"distance to \(0\.020\d, 1\.61\) m is constant, 0\.800 m: a string or rod", told
    )


@pytest.mark.slow
def test_a_weight_that_would_take_a_bob_far_off_is_fitted_all_the_same():
    """Twelve seconds of free fall end 700 m below a track that spans a metre."""
    data = bob(n=360, dt=1 / 30)
    found = fit(Hypothesis.from_laws(data, [WEIGHT]), data)
    assert found.status == "converged" and found.chi2_red > 100


def test_what_is_held_already_is_not_proposed_again():
    view = looked_at(bob(n=60), [WEIGHT, "norm(p_i - (0.02, 1.61)) = 0.8"])
    assert Rods().propose(view).proposals == ()


def test_a_wire_is_proposed_where_the_weight_would_have_the_body_leave_it():
    t = np.arange(80) * 0.02
    way = 0.5 * 2.0 * t**2
    (proposal,) = Rods().propose(looked_at(track(t, -0.8 * way, -0.6 * way), [WEIGHT])).proposals
    assert proposal.code == "wire"


def rolling(steep=0.72, n=150):
    """A bead that slides to and fro along a parabola."""

    def rate(t, s):
        x, v = s
        a = 2 * steep
        return [v, -(a * a * x * v * v + 9.81 * a * x + 0.05 * v) / (1 + a * a * x * x)]

    t = np.arange(n) / 30
    x = solve_ivp(rate, (0, t[-1]), [0.4, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    return track(t, x, steep * x**2)


def test_a_curve_along_which_a_body_comes_back_is_a_wire():
    (proposal,) = Rods().propose(looked_at(rolling(), [WEIGHT])).proposals
    assert proposal.code == "wire"
    assert float(proposal.text.split("+ ")[-1].split(" ")[0]) == pytest.approx(0.72, abs=0.02)


def filmed(n=900, dt=1 / 30, sigma=3e-4):
    """A bob 1.17 m below its pivot that a camera sees a little aslant, and leaves its plane."""
    t = dt * np.arange(n)
    angle = 0.4 * np.exp(-0.01 * t) * np.cos(2.88 * t)
    aslant = 1 + 0.004 * np.sin(angle) + 0.002 * np.cos(0.5 * t)
    return track(t, 1.17 * np.sin(angle) * aslant, -1.17 * np.cos(angle) * aslant, sigma)


def test_a_distance_is_about_constant_where_a_camera_is_not_straight():
    (proposal,) = Rods().propose(looked_at(filmed(), [])).proposals
    assert proposal.code == "rod"
    assert float(proposal.text.split("= ")[-1]) == pytest.approx(1.17, abs=0.02)


def test_what_is_thrown_along_a_parabola_is_on_no_wire():
    t = np.arange(60) * 0.02
    family = Rods().propose(looked_at(track(t, 1.2 * t, 5.0 * t - 4.905 * t**2), []))
    assert family.proposals == ()


def test_a_rod_brings_a_weight_where_no_force_is_declared():
    (proposal,) = Rods().propose(looked_at(bob(n=150), [])).proposals
    (push,) = proposal.hypothesis.law.terms
    assert "e_y" in to_text(push.formula)


@pytest.mark.slow
def test_a_filmed_pendulum_needs_no_declaration():
    data = bob(lambda v: -0.15 * v, n=150)
    report = bsp_gp.close_loop(data, [], rng=np.random.default_rng(0), n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert [done.effect.code for done in report.rounds if done.adopted] == ["rod", "law"]
    assert found["c1"].value == pytest.approx(-9.81, abs=0.05)


@pytest.mark.parametrize("rate", [9.0, 6.0])
def test_a_fall_along_a_line_is_on_no_wire(rate):
    t = np.arange(60) * 0.02
    family = Rods().propose(looked_at(track(t, 0.1 * t, -0.5 * rate * t**2), [WEIGHT]))
    assert family.proposals == ()


@pytest.mark.slow
def test_moments_of_a_held_body_tell_all_that_a_fit_with_the_drag_gains():
    data = bob(lambda v: -0.002 * v, n=280)
    laws = [WEIGHT, f"norm(p_i - ({PIVOT[0]}, {PIVOT[1]})) = {LENGTH}"]
    view = looked_at(data, laws)
    drag = Hypothesis.from_laws(data, [*laws, "-c * m_i * v_i"])
    gained = 2 * (fit(drag, data).log_likelihood - view.fit.log_likelihood)
    formula = parse_formula("m_i * v_i", dataset_types(data))
    assert gained > 25
    assert view.score_forces(view.force_columns([formula])).statistic > 0.8 * gained


def test_errors_with_a_memory_are_larger_than_their_changes_tell():
    """A body at rest was put on a wire, since changes from row to row told a third of its noise."""
    rng, memory = np.random.default_rng(0), 0.8
    errors = rng.standard_normal(20000)
    for k in range(1, len(errors)):
        errors[k] = memory * errors[k - 1] + 0.6 * errors[k]
    told = np.sqrt(np.mean(np.square(np.diff(errors, 3))) / 20)
    data = track(0.1 * np.arange(30), np.arange(30.0), np.arange(30.0))
    noise = replace(
        fit(Hypothesis.from_laws(data, ["nothing"]), data).noise,
        correlated=1.0, correlation_time=-0.1 / np.log(memory),
    )  # fmt: skip
    assert told * rods._unseen(noise, 0.1) == pytest.approx(errors.std(), rel=0.05)
    assert rods._unseen(replace(noise, correlated=0.0), 0.1) == 1.0


@pytest.mark.slow
def test_a_bob_that_goes_over_the_top_and_is_slowed_is_held_beside_a_drag():
    """Without it no weight leads there, and four forces were told in the place of the rod."""
    times = np.arange(240) / 60
    angle = solve_ivp(
        lambda _, s: [s[1], -9.81 / 0.8 * np.sin(s[0]) - 0.08 * s[1]], (0, times[-1]),
        [0.0, np.sqrt(5.5 * 9.81 / 0.8)], t_eval=times, rtol=1e-9,
    ).y[0]  # fmt: skip
    data = track(times, 0.3 + 0.8 * np.sin(angle), 1 - 0.8 * np.cos(angle), sigma=3e-3)
    report = bsp_gp.close_loop(data, (), rng=np.random.default_rng(0), n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "rod"
    told = " ".join(bsp_gp.summary_text(report).split())
    assert "What acts on it under way: uniform push along y; drag, linear in speed" in told


def test_bobs_that_hang_from_one_another_are_held_at_once_and_tell_their_masses():
    """Equal masses had been taken, and lengths and weight bent until they did."""
    data = with_usable_masses(double_bob())
    (hung,) = [p for p in Rods().propose(looked_at(data, [])).proposals if p.code == "rods"]
    found = fit(hung.hypothesis, data)
    assert found.status == "converged"
    told = found.law.constants
    assert told["mass[B]"] == pytest.approx(1.5, rel=0.02)
    assert told["c1"] == pytest.approx(-9.81, abs=0.1)
    assert (told["L1"], told["L2"]) == pytest.approx((0.15, 0.25), abs=2e-3)


def test_bobs_may_hang_from_what_is_marked_and_never_moves():
    """A traceback: a rod to a body that stays where it is had no way that a weight pulls."""
    data = with_usable_masses(double_bob(marks_nail=True))
    proposals = Rods().propose(looked_at(data, [])).proposals
    (hung,) = [p for p in proposals if p.code == "rods" and "nail" in p.text]
    found = fit(hung.hypothesis, data)
    assert found.law.constants["mass[B]"] == pytest.approx(1.5, rel=0.02)
    assert (found.law.constants["L1"], found.law.constants["L2"]) == pytest.approx(
        (0.15, 0.25), abs=2e-3
    )


def test_all_rods_of_a_chain_come_before_each_alone():
    """The lower bob of a small swing is about on a circle: an effective law was told of that."""
    data = with_usable_masses(double_bob(begin=(0.3, 0.35)))
    first, *others = Rods().propose(looked_at(data, [])).proposals
    assert first.code == "rods" and first.gain >= max(p.gain for p in others)
    assert "v_i" in to_text(first.instead.hypothesis.law.terms[-1].formula)


def test_masses_told_by_one_recording_are_those_of_another():
    """Beyond the recordings that were fitted the mass was one."""
    data = with_usable_masses(double_bob(ratio=3.0, n=120))
    (hung,) = [p for p in Rods().propose(looked_at(data, [])).proposals if p.code == "rods"]
    (part,) = [part for part in hung.hypothesis.parts if "mass[B]" in getattr(part, "names", ())]
    other = replace(data.scenes[0], name="another")
    (scene,) = part.at({"mass[B]": 3.0}).filled((other,))
    assert [e.mass for e in scene.entities] == [1.0, 3.0]


def test_masses_that_were_given_are_kept_by_rods():
    entities = pd.DataFrame({"entity": ["A", "B"], "mass": [1.0, 1.0]})
    data = double_bob(ratio=1.0, entities=entities)
    (hung,) = [p for p in Rods().propose(looked_at(data, [])).proposals if p.code == "rods"]
    assert not any(p.name.startswith("mass") for p in hung.hypothesis.parameters)


def test_rods_of_two_bodies_on_points_of_their_own_are_no_chain():
    t = np.arange(200) / 60
    frames = [
        pd.DataFrame({"t": t, "entity": name,
                      "x": at + 0.4 * np.sin(angle), "y": -0.4 * np.cos(angle)})
        for name, at, angle in (("A", 0.0, 0.8 * np.sin(5 * t)), ("B", 2.0, 0.7 * np.cos(4 * t)))
    ]  # fmt: skip
    rows = pd.concat(frames)
    rows[["x", "y"]] += 1e-3 * np.random.default_rng(0).standard_normal((len(rows), 2))
    data = bsp_gp.Dataset.from_frames(rows, units={"length": "m", "time": "s"}, up="y")
    family = Rods().propose(looked_at(with_usable_masses(data), []))
    assert {p.code for p in family.proposals} == {"rod"}


@pytest.mark.slow
def test_a_filmed_double_pendulum_needs_no_declaration():
    report = bsp_gp.close_loop(double_bob(), [], rng=np.random.default_rng(0), n_bootstrap=0)
    assert [done.effect.code for done in report.rounds if done.adopted] == ["rods"]
    found = {c.name: c for c in report.constants}
    mass = found["mass[B]"]
    assert abs(mass.value - 1.5) < 2 * (mass.high - mass.low)
    told = page_of(report)
    assert "hang from one another" in told.rounds[0].effect.name
    assert any("told in that of the one that hangs first" in note for note in told.notes)
