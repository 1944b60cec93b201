"""Numbers of declared terms: what was rounded as it was typed is no cause to be doubted."""

import re

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.exponents import rounding_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name
from tests.planted import SI

TIMES = np.arange(240) / 60.0


def swings(stiffness=8.01846, sigma=1e-5):
    """A body on two springs, its attraction known to more digits than anybody types."""
    rng, rate = np.random.default_rng(2), np.sqrt(stiffness)
    places = np.stack([0.2 * np.cos(rate * TIMES), 0.1 * np.sin(rate * TIMES)], axis=1)[:, None]
    places = places + sigma * rng.standard_normal(places.shape)
    return Dataset("swings", (Scene("1", TIMES, places, (Entity("disc"),)),), units=SI)


@pytest.mark.parametrize(
    ("text", "rounding"),
    [
        ("-9.81 [m/s^2] * m_i * e_y", 0.5 / 981),
        ("8.018 [1/s^2] * m_i * (origin - p_i)", 0.5 / 8018),
        ("0.5 [1/s^2] * m_i * (origin - p_i)", 0.0), ("100 [1/s^2] * m_i * (origin - p_i)", 0.0),
        ("6.674e-11 [m/s^2] * m_i * e_y", 0.5 / 6674), ("c * m_i * e_y", 0.0),
    ],
)  # fmt: skip
def test_what_numbers_may_be_off_by_is_half_a_last_digit(text, rounding):
    formula = parse_formula(text, dataset_types(swings()))
    assert rounding_of(formula) == pytest.approx(rounding)


@pytest.mark.slow
def test_a_number_that_was_rounded_is_told_as_that():
    report = close_loop(swings(), "8.018 [1/s^2] * m_i * (origin - p_i)", rng=0, n_bootstrap=0)
    effect = report.rounds[0].effect
    assert effect.code == "number"
    assert effect.name.endswith("within its last digit")
    assert report.rounds[0].adopted
    assert report.constants[0].value == pytest.approx(8.01846 / 8.018 - 1, abs=4e-5)
    assert report.rounds[-1].reason == "not_significant"


def damped(stiffness, damping, sigma=1e-3):
    """A body on a spring let go at rest in several places, linear drag, per unit mass."""
    rng, scenes = np.random.default_rng(3), []
    rate = -damping / 2 + 1j * np.sqrt(stiffness - damping**2 / 4)
    for k, start in enumerate((0.2, -0.1, 0.15)):
        z = start * (1 + 1j * np.real(rate) / np.imag(rate))
        x = np.real(z * np.exp(rate * TIMES)) + sigma * rng.standard_normal(len(TIMES))
        places = np.column_stack([x, np.zeros_like(x)])[:, None]
        scenes.append(Scene(str(k), TIMES, places, (Entity("cart"),)))
    return Dataset("damped", tuple(scenes), units=SI)


@pytest.mark.slow
def test_declared_numbers_that_are_all_wrong_are_told_together():
    laws = ("-16 [1/s^2] * m_i * (p_i - origin)", "-6 [1/s] * m_i * v_i")
    report = close_loop(damped(10.6, 1.7), laws, rng=0, n_bootstrap=0)
    effect = report.rounds[0].effect
    assert (report.verdict, effect.code) == ("effect adopted", "number")
    assert effect.name.startswith("numbers of ")
    changed = {c.name: c.value for c in report.constants}
    assert -16 * (1 + changed["s1"]) == pytest.approx(-10.6, abs=0.05)
    assert -6 * (1 + changed["s2"]) == pytest.approx(-1.7, abs=0.05)
    stiffness = re.match(r"-(10\.\d+) \[1/s\^2\] \* m_i", report.law_text)
    assert float(stiffness[1]) == pytest.approx(10.6, abs=0.05)


def test_a_changed_number_is_printed_where_a_number_leads_the_term():
    types = dataset_types(swings())
    law = parse_formula("(1 + s1) * (-9.81 [m/s^2] * m_i * e_y)", types)
    assert to_text(law, {"s1": 0.5}) == "-14.715 [m/s^2] * m_i * e_y"
    named = parse_formula("(1 + s1) * (pi * m_i * e_y)", types)
    assert to_text(named, {"s1": 0.5}) == "(1 + 0.5) * (pi * m_i * e_y)"
    assert to_text(law) == "(1 + s1) * (-9.81 [m/s^2] * m_i * e_y)"


def test_a_new_constant_is_none_that_bodies_have_of_their_own():
    data = swings()
    law = read_law(data, ["c1[body] * v_i"])
    assert fresh_name(law) == "c2"
