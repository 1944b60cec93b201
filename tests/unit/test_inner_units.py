"""Units of constants inside of laws: of what they are added to, or make a pure number."""

import pytest

from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.force import Term, constant_units
from bsp_gp.units import Unit

TYPES = input_types({"mass": Unit.of(kg=1)})
X = "dot(p_i - origin, e_x)"


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("c * exp(-norm(p_i - p_j) / L) * (v_i - v_j)", {"L": "m", "c": "kg/s"}),
        ("c * exp(-(norm(p_i - p_j) / L)^2) * (p_i - p_j)", {"L": "m", "c": "kg/s^2"}),
        ("c * inverse(1 + norm(v_i) / u) * v_i", {"u": "m/s", "c": "kg/s"}),
        (f"c * sin(({X} - h) / D) * e_x", {"h": "m", "D": "m", "c": "kg m/s^2"}),
        ("a * cos(w * t) * e_x", {"w": "1/s", "a": "kg m/s^2"}),
        (f"c * (({X} - h)^2 + D^2)^-1.5 * e_x", {"h": "m", "D": "m", "c": "kg m^4/s^2"}),
        ("c * norm(v_i)^n * normalize(v_i)", {}),
        ("m_i * (W^2 * (p_i - origin) - 2 * W * perp(v_i))", {"W": "1/s"}),
        (
            "m_i * (-1 * cross(A * e_x + B * e_y, cross(A * e_x + B * e_y, p_i - origin)) "
            "- 2 * cross(A * e_x + B * e_y, v_i))", {"A": "1/s", "B": "1/s"},
        ),
    ],
)
def test_units_of_constants_inside(text, units):
    found = constant_units(Term(parse_formula(text, TYPES)))
    assert {name: str(unit) for name, unit in found.items()} == units
