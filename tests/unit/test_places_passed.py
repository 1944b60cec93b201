"""Places at which a force is infinite: no body passes them, on a line or through a plane."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.search.inner import InnerSearch


@pytest.mark.parametrize(
    ("axis", "is_passed"), [("x", [False, True, True]), ("y", [False, True, False])]
)
def test_a_plane_is_passed_where_bodies_are_on_both_sides_along_its_own_axis(axis, is_passed):
    """Of planes across y it was asked whether bodies are on both sides along x."""
    types = input_types(PROPERTY_UNITS, up="y")
    form = parse_formula(f"inverse(abs(centre_{axis} - dot(p_i - origin, e_{axis}))) * v_i", types)
    search = SimpleNamespace(axes="xy", span=(np.array([0.0, 0.0]), np.array([9.0, 2.0])))
    at = np.array([-1.0, 1.0, 5.0])
    found = InnerSearch._is_passed(
        search, SimpleNamespace(term=SimpleNamespace(formula=form)), {f"centre_{axis}": at}
    )
    assert found.tolist() == is_passed
