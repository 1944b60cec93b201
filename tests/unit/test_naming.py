"""Terms in words, and what two ways to write one term have in common."""

import numpy as np
import pytest

from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.naming import form_of
from bsp_gp.physics.bodies import dataset_types
from tests.worlds import WEIGHT, flights, linear_drag

DATA = flights(0, linear_drag)


def form(text):
    return form_of(parse_formula(text, dataset_types(DATA), units=DATA.units))


@pytest.mark.parametrize(
    ("one", "other", "is_one"),
    [
        ("c * v_i", "c * (m_i * inverse(m_i) * v_i)", True),
        ("c * norm(v_i)^2 * normalize(v_i)", "c * norm(v_i) * norm(v_i) * normalize(v_i)", True),
        ("c * v_i / m_i", "c * inverse(m_i) * v_i", True),
        ("c * v_i", "c * norm(v_i) * normalize(v_i)", True),
        ("c * v_i", "c * normalize(v_i)", False),
        ("c * m_i * v_i", "c * v_i", False),
        ("c * v_i", "c * perp(v_i)", False),
        ("c * charge_i * e_x", "c * m_i * e_x", False),
    ],
)
def test_forms(one, other, is_one):
    assert (form(one) == form(other)) == is_one


def test_a_law_is_not_listed_as_one_that_cannot_be_told_from_itself():
    report = close_loop(DATA, [WEIGHT], rng=np.random.default_rng(0), n_null=99, max_rounds=1)
    effect = report.rounds[0].effect
    assert effect.name == "drag, linear in speed"
    assert not any("m_i * inverse(m_i)" in text for text in effect.equivalents)
