"""What is known of laws before any data: one vector is one cause, and what drives is rarer."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp import Dataset
from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposers.priors import cost_of, drives, is_passed_once
from bsp_gp.physics.force import split_linear
from bsp_gp.search.candidate import Candidate

TYPES = input_types(PROPERTY_UNITS, up="y")


def candidate(text, nats):
    formula = parse_formula(text, TYPES)
    name = split_linear(formula)[0]
    return Candidate(formula, "field", {name: 1.0}, 0.0, nats, 0.0, 1.0)


def test_components_of_one_vector_cost_once():
    x, y = candidate("c1 * e_x", 3), candidate("c1 * e_y", 4)
    assert cost_of([x, y]) == 4
    assert cost_of([x, candidate("c1 * (norm(v_i) * e_y)", 5)]) == 8
    springs = [candidate("c1 * (x_i * e_x)", 3), candidate("c1 * (y_i * e_y)", 3)]
    assert cost_of(springs) == 6


@pytest.mark.parametrize(
    ("text", "is_along"),
    [
        ("c1 * v_i", True),
        ("c1 * (norm(v_i)^2 * normalize(v_i))", True),
        ("c1 * (m_i * normalize(v_i))", True),
        ("c1 * perp(v_i)", False),
        ("c1 * (norm(v_i) * e_x)", False),
        ("c1 * (p_i - origin)", False),
    ],
)
def test_what_drives_pushes_along_the_velocity(text, is_along):
    assert drives(parse_formula(text, TYPES), 2.0) == is_along
    assert not drives(parse_formula(text, TYPES), -2.0)


@pytest.mark.parametrize(
    ("text", "way", "is_once"),
    [
        ("c1 * (centre_x - x_i) * e_x", "on", True),
        ("c1 * (centre_x - x_i) * e_x", "forth and back", False),
        ("c1 * (sign(x_i - centre_x) * e_x)", "on", False),
        ("c1 * (inverse(abs(centre_x - x_i)) * v_i)", "on", False),
    ],
)
def test_no_spring_shows_before_what_it_pulls_turns(text, way, is_once):
    t = np.linspace(0, 1, 30)
    x = t if way == "on" else np.sin(7 * t)
    data = Dataset.from_frames(
        pd.DataFrame({"t": t, "entity": "cup", "x": x}), units={"length": "m", "time": "s"}
    )
    assert is_passed_once(parse_formula(text, TYPES), {"x"}, data) == is_once
