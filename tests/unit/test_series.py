"""Sums of powers, and laws that change at an instant, are chosen as a whole."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.proposal import NEW, Proposal
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.polynomials import ODD, Polynomials
from bsp_gp.loop.proposers.regimes import Regimes
from bsp_gp.loop.view import View
from tests.loop_views import throws, view_of

SIGMA = 5e-3
POWERS = Polynomials(Laws(load_grammar("physics"), throws(np.random.default_rng(0))))


def driven(rate, first, until, n, names="x", sigma=SIGMA, seed=0):
    """What moves under an acceleration, seen with some noise."""
    times = np.linspace(0.0, until, n)
    path = solve_ivp(rate, (0.0, until), first, t_eval=times, rtol=1e-9, atol=1e-11, max_step=0.02)
    noise = sigma * np.random.default_rng(seed).standard_normal((len(names), n))
    columns = {name: row for name, row in zip(names, path.y[: len(names)] + noise, strict=True)}
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": times, **columns}), units={"length": "m", "time": "s"},
        properties={"mass": "1[kg]"},
    )  # fmt: skip


def well(seed=0):
    """A ball that rolls in a well with two bottoms, and slows down."""
    return driven(
        lambda t, s: [s[1], 1.1 * s[0] - s[0] ** 3 - 0.08 * s[1]], [1.6, 0.0], 20.0, 400, seed=seed
    )


def looked_at(data, laws=()):
    """A view of a fit, with what laws of the grammar explain of it."""
    hypothesis = Hypothesis.from_laws(data, laws)
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(0))
    Laws(load_grammar("physics"), data).propose(view)
    return view


def test_powers_of_a_well_are_chosen_and_their_coefficients_fitted():
    data = well()
    view = looked_at(data)
    family = POWERS.propose(view)
    texts = {p.text.replace("c1 ", "c ").replace("c2 ", "c ").replace("c3 ", "c "): p
             for p in family.proposals}  # fmt: skip
    proposal = texts["c * (x_i * e_x) + c * (x_i^3 * e_x) + c * v_i"]
    assert not proposal.is_series
    assert proposal.rank == 3
    found = proposal.fitted(view.near, data, criteria=view.criteria)
    values = [found.law.constants[f"c{k}"] for k in (1, 2, 3)]
    assert values == pytest.approx([1.1, -1.0, -0.08], abs=5e-3)
    assert found.chi2_red == pytest.approx(1.0, abs=0.2)


def test_series_of_many_or_odd_terms_may_stand_for_any_force():
    def proposal(*news):
        formulas = tuple(f"formula {k}" for k in range(len(news)))
        return Proposal(
            "law", "", None, 0.0, 0.0, formulas=formulas,
            news=dict(zip(formulas, news, strict=True)),
        )  # fmt: skip

    assert not proposal(0, NEW, 0).is_series
    assert not proposal(NEW, NEW).is_series
    assert proposal(NEW, NEW, NEW).is_series
    assert proposal(0, ODD).is_series


@pytest.mark.parametrize("proposer", [POWERS, Regimes()], ids=["powers", "regimes"])
def test_a_series_says_nothing_of_whether_anything_is_missing(proposer):
    """It can stand for any force, and for errors with a memory: others have to say so."""
    family = proposer.propose(looked_at(well()))
    assert family.is_led
    assert family.proposals
    assert not proposer.propose(view_of(throws(np.random.default_rng([57, 1])))).proposals


def test_pairs_of_powers_about_a_centre_leave_one_power_to_be_fitted():
    def rate(t, s):
        r = np.hypot(s[0] - 0.2, s[1] + 0.1)
        pull = -(1 / r**3 + 0.05 / r**5)
        return [s[2], s[3], pull * (s[0] - 0.2), pull * (s[1] + 0.1)]

    data = driven(rate, [1.2, -0.1, 0.0, 1.2], 25.0, 350, names="xy", sigma=1e-3)
    family = POWERS.propose(looked_at(data))
    free = [p for p in family.proposals if "^n1 *" in p.text and len(p.formulas) == 2]
    assert free
    assert "^-2 *" in free[0].text
    assert free[0].starts["centre_x1"] == pytest.approx(0.2, abs=0.02)
    assert free[0].starts["centre_y1"] == pytest.approx(-0.1, abs=0.02)


def opened(t1=9.0):
    """A fall whose drag is another one from an instant on."""
    return driven(
        lambda t, s: [s[1], -9.81 - (0.0035 if t < t1 else 0.02) * abs(s[1]) * s[1]],
        [600.0, 0.0], 20.0, 200, names="y", sigma=0.1,
    )  # fmt: skip


def test_a_drag_that_changes_at_an_instant_is_found_with_it():
    data = opened()
    view = looked_at(data)
    family = Regimes().propose(view)
    texts = [p for p in family.proposals if "sign(t - t" in p.text]
    by_time = [p for p in texts if "t_open" not in p.text]
    assert by_time
    assert by_time[0].starts["t1"] == pytest.approx(9.0, abs=0.1)
    in_stages = [p for p in texts if p not in by_time]
    assert in_stages[0].starts["t_open1"] == pytest.approx(9.0, abs=0.2)


@pytest.mark.slow
def test_a_parachute_opens_and_no_velocity_jumps():
    report = bsp_gp.close_loop(opened(), (), rng=np.random.default_rng(0), n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert report.verdict == "effect adopted"
    told = bsp_gp.summary_text(report)
    assert found["t_open1"].value == pytest.approx(9.0, abs=0.02)
    assert "an instant" in told
    assert "velocity jumps" not in told


@pytest.mark.slow
def test_a_well_with_two_bottoms_is_told_by_its_powers():
    report = bsp_gp.close_loop(well(seed=3), (), rng=np.random.default_rng(0), n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert "x_i^3" in report.law_text
    assert "v_i" in report.law_text


@pytest.mark.slow
def test_a_weight_on_a_rubber_band_falls_freely_above_its_end():
    """Told as a dip and a sine, and an effective law: what pulls below a place alone."""
    hung = driven(
        lambda t, s: [s[1], -9.81 + 40 * max(0.0, 2.0 - s[0]) - 0.2 * s[1]], [2.3, 0.0], 6.0, 360,
        names="y", sigma=2e-3, seed=1,
    )  # fmt: skip
    report = bsp_gp.close_loop(hung, (), rng=np.random.default_rng(0), n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert report.verdict == "effect adopted"
    assert found["h_y1"].value == pytest.approx(2.0, abs=0.01)
    assert "rubber band" in bsp_gp.summary_text(report)


def on_a_hoop(rng):
    """The angle of a bead on a hoop that turns, which is driven by two waves a turn."""
    times = np.arange(0.0, 12.0, 0.03)
    angle = solve_ivp(
        lambda _, s: [s[1], (60.0 * np.cos(s[0]) - 32.7) * np.sin(s[0]) - 0.2 * s[1]],
        (0, times[-1]), [1.4, 0.0], t_eval=times, rtol=1e-9,
    ).y[0]  # fmt: skip
    noise = 0.005 * rng.standard_normal(len(times))
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t (s)": times, "theta (rad)": angle + noise}), properties={"mass": "1[kg]"}
    )


@pytest.mark.slow
def test_what_drives_an_angle_is_expanded_in_waves_of_a_turn():
    """Four powers of the angle, an effective law, had been told."""
    report = bsp_gp.close_loop(on_a_hoop(np.random.default_rng(0)), (), rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    told = {c.value for c in report.constants}
    for true in (-32.7, 30.0, -0.2):
        assert any(value == pytest.approx(true, rel=0.02) for value in told)
    assert "sin(2 * theta_i)" in bsp_gp.summary_text(report)


def flight(across, seed=0):
    """What is turned aside in flight at a rate ``across(t, x)``, 1/s, and falls."""

    def rate(t, s):
        turn = across(t, s[0])
        return [s[2], s[3], -turn * s[3], turn * s[2] - 9.81]

    return driven(rate, [0.0, 0.0, 6.0, 8.0], 1.6, 160, "xy", 2e-3, seed)


@pytest.mark.parametrize(
    ("across", "law"),
    [
        (lambda t, x: 0.8 * np.exp(-t / 0.5), "c1 * (exp(-t / T1) * perp(v_i))"),
        (lambda t, x: 0.12 * x, "c1 * (x_i * perp(v_i))"),
    ],
)
def test_what_turns_a_body_aside_may_fade_or_differ_from_place_to_place(across, law):
    weight = "9.81 [m/s^2] * m_i * -e_y"
    report = bsp_gp.close_loop(flight(across), [weight], rng=np.random.default_rng(1))
    assert report.rounds[0].effect.law == law
    assert report.verdict == "effect adopted"
