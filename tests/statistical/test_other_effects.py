"""Other effects than drag: what is named, what is left open, and what is got wrong."""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from bsp_gp.simulate import effects
from bsp_gp.simulate.synth import make, preset
from tests import worlds
from tests.planted import GRAVITY
from tests.worlds import WEIGHT, flights, orbits, tied

pytestmark = pytest.mark.slow

WRONG_POWER = "c1 * m_i * m_j / norm(p_i - p_j)^2.5 * normalize(p_j - p_i)"


def orbit_drag(t, p, v, m, q):
    return np.where(m[:, None] > 500, 0, -0.008 * np.linalg.norm(v, axis=1, keepdims=True) * v)


def close(dataset, declared, seed=0, **settings):
    return close_loop(dataset, declared, rng=np.random.default_rng(seed), **settings)


def adopted(report):
    return [r.effect for r in report.rounds if r.adopted]


NAMED = {
    "quadratic drag": (lambda s: flights(s, worlds.quadratic_drag), [WEIGHT],
                       "drag, quadratic in speed", -0.05),
    "linear drag": (lambda s: flights(s, worlds.linear_drag), [WEIGHT],
                    "drag, linear in speed", -0.3),
    "wind": (lambda s: flights(s, worlds.wind), [WEIGHT], "uniform push along x", 1.0),
    "magnetic": (lambda s: flights(s, worlds.magnetic), [WEIGHT],
                 "force across the velocity, speed^1 (magnetic or Magnus)", 1.0),
    "spring": (tied, [], "spring towards the other body", -8.0),
    "quadratic drag in orbits": (lambda s: orbits(s, extra=orbit_drag), [GRAVITY],
                                 "drag, quadratic in speed", -0.008),
    "gravity itself": (orbits, [], "pull to the other body, as distance^-2", -1.0),
    "Coulomb": (lambda s: orbits(s, extra=worlds.repulsion, charges=True), [GRAVITY],
                "push from the other body, as distance^-2", 300.0),
}  # fmt: skip
SEEDS = {"quadratic drag in orbits": 2, "gravity itself": 2, "Coulomb": 2}


@pytest.mark.parametrize(
    ("name", "seed"), [(name, s) for name in NAMED for s in range(SEEDS.get(name, 4))]
)
def test_a_single_effect_is_named_and_sized(name, seed):
    make, declared, words, value = NAMED[name]
    report = close(make(seed), declared, seed)
    (effect,) = adopted(report)
    assert effect.name == words
    (c,) = [c for c in effect.constants if c.name == "c1"]
    assert abs(c.value - value) < 4 * (c.high - c.low) / 2 / 1.645
    assert report.rounds[-1].verdict == "nothing missing"
    assert report.total["ratio"].high < 0.3


def test_properties_that_the_force_follows_are_named():
    """A wind pushes alike on all, a weight on their masses, a magnetic field on their charges."""
    for force, properties in (
        (worlds.wind, set()),
        (worlds.magnetic, {"q_i"}),
        (lambda t, p, v, m, q: m * worlds.wind(t, p, v, m, q), {"m_i"}),
    ):
        (effect,) = adopted(close(flights(5, force), [WEIGHT], 5))
        assert {w for w in ("m_i", "q_i") if w in effect.law} == properties


UNSAYABLE = {
    "trap at an unseen place": (lambda s: flights(s, worlds.trap), [WEIGHT], 3),
}


@pytest.mark.parametrize(
    ("name", "seed"), [(name, s) for name in UNSAYABLE for s in range(UNSAYABLE[name][2])]
)
def test_what_one_term_cannot_say_is_not_adopted(name, seed):
    make, declared, _ = UNSAYABLE[name]
    report = close(make(seed), declared, seed)
    assert not adopted(report)
    assert report.verdict in ("seen, not adopted", "cannot tell")
    assert report.rounds[0].missing.is_missing


@pytest.mark.parametrize("seed", range(3))
def test_two_effects_of_which_neither_explains_much_are_found_together(seed):
    report = close(flights(seed, worlds.head_wind), [WEIGHT], seed)
    (effect,) = adopted(report)
    assert effect.name == "drag, linear in speed and uniform push along x"
    for c, value in zip(effect.constants, (-0.3, 1.5), strict=True):
        assert abs(c.value - value) < 4 * (c.high - c.low) / 2 / 1.645
    assert report.rounds[-1].verdict == "nothing missing"
    assert report.total["ratio"].high < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_a_wrong_declared_power_is_refuted_and_the_right_one_named(seed):
    report = close(orbits(seed), [WRONG_POWER], seed)
    (effect,) = adopted(report)
    assert effect.name.startswith("exponent of norm(p_i - p_j) in a declared term: -2.5 +0.5")
    (change,) = [c for c in effect.constants if c.name.startswith("n")]
    half = (change.high - change.low) / 2
    assert change.value == pytest.approx(0.5, abs=3 * half) and half < 0.01
    assert len(report.law.terms) == 1 and report.total["ratio"].high < 0.3


@pytest.mark.parametrize("seed", range(3))
def test_gusts_are_named_with_their_period(seed):
    """1.5 N along x with a period of 1.3 s: time is no input of the search, periods are tried."""
    report = close(flights(seed, worlds.gusts), [WEIGHT], seed)
    (effect,) = adopted(report)
    found = {c.name: c for c in effect.constants}
    assert abs(found["a1"].value) == pytest.approx(1.5, rel=0.2)
    assert found["w1"].value == pytest.approx(2 * np.pi / 1.3, rel=0.05)
    assert report.total["ratio"].high < 0.7


def scaled(t, p):
    return t, 1.03 * p


def slow_clock(t, p):
    return 1.02 * t, p


@pytest.mark.parametrize("warp", [scaled, slow_clock])
@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_scale_or_clock_is_not_named_as_a_force(warp, seed):
    report = close(flights(seed, worlds.nothing, warp=warp), [WEIGHT], seed)
    assert not adopted(report)
    assert report.verdict == "cannot tell"
    (done,) = report.rounds
    freed = [r for r in done.rivals if r.kind == "declared_term_change" and "instead" in r.name]
    text = done.reason + freed[0].reason
    for word in ("number", "length scale", "clock"):
        assert word in text
    change = float(freed[0].reason.split("off by ")[1].split("%")[0])
    assert change == pytest.approx(3.0 if warp is scaled else 100 * (1.02**-2 - 1), abs=0.15)


def tilted(t, p, angle=0.05):
    c, s = np.cos(angle), np.sin(angle)
    return t, p @ np.array([[c, s], [-s, c]])


def test_a_tilted_camera_is_a_rival_of_a_sideways_push():
    report = close(flights(0, worlds.nothing, warp=tilted), [WEIGHT])
    said = " ".join(r.name + r.reason for done in report.rounds for r in done.rivals)
    said += " ".join(r.effect.name + r.reason for r in report.rounds if r.effect)
    assert "tilt" in said or "camera" in said


def test_a_damped_spring_is_not_called_by_a_wrong_name():
    report = close(tied(0, damping=0.5), [])
    names = [e.name for e in adopted(report)]
    assert set(names) <= {"spring towards the other body", "drag, linear in speed"}


def test_a_slightly_wrong_power_is_not_called_by_a_wrong_name():
    """Declared 1/r^2, in truth 1/r^2.1: whatever is adopted must be a power of the distance."""
    report = close(orbits(0, exponent=2.1), [GRAVITY])
    assert not [e.name for e in adopted(report) if "speed" in e.name]


def test_a_hidden_body_is_found_where_it_is():
    report = close(orbits(0, hidden=(50.0, (25.0, 25.0))), [GRAVITY])
    (effect,) = adopted(report)
    assert effect.kind == "hidden_body"
    found = {c.name: c for c in effect.constants}
    for name, truth in (("x_hidden", 25.0), ("y_hidden", 25.0), ("mass_hidden", 50.0)):
        half = (found[name].high - found[name].low) / 2
        assert found[name].value == pytest.approx(truth, abs=2 * half)
    assert report.total["ratio"].high < 0.4
    assert report.corrections[0]["kind"] == "hidden_body"
    assert report.rounds[-1].verdict == "nothing missing"


def test_a_loss_of_speed_at_soft_contacts_is_named():
    change = effects.effect("dashpot", 0.3, is_declared=False)
    settings = preset("pucks", [change], n_scenes=5, noise=0.005, n_frames=40)
    dataset, truth = make(settings, np.random.default_rng(1))
    report = close(dataset, truth.declared)
    (found,) = adopted(report)
    assert found.law == (
        "c1 * (along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j) "
        "* does_collide(s_i, p_i, s_j, p_j))"
    )
    (constant,) = found.constants
    assert constant.low < -0.3 < constant.high
    assert constant.high - constant.low < 0.1
    assert report.rounds[-1].verdict == "nothing missing"
