"""A law that speaks of a vertical which nothing declares: y, or z, unless that may be wrong."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset
from bsp_gp.data.vertical import with_vertical
from bsp_gp.units import UnitSystem
from tests.unit.test_response import thrown

NAMES = ["m_i", "down"]


def fallen(*args, **kwargs) -> Dataset:

    return replace(thrown(*args, **kwargs), up=None)


def test_height_is_y_and_that_is_told():
    found = with_vertical(fallen(n_scenes=2, n_rows=30), NAMES)
    assert found.up == "y"
    assert found.notes[-1].startswith("check: y is taken as the height")
    assert "--up=-y" in found.notes[-1]


def test_nothing_is_assumed_where_no_law_asks_or_a_vertical_is_declared():
    plain = fallen(n_scenes=2, n_rows=30)
    assert with_vertical(plain, ["m_i", "v_i"]) is plain
    declared = thrown(n_scenes=2, n_rows=30)
    assert with_vertical(declared, NAMES) is declared


@pytest.mark.parametrize("change", ["turned", "at rest", "pixels"])
def test_nothing_is_assumed_where_it_may_be_wrong(change):

    plain = fallen(n_scenes=2, n_rows=30)
    if change == "pixels":
        plain = replace(plain, units=UnitSystem.from_declared({"length": "px"}))
    else:
        scale = np.array([1.0, -1.0 if change == "turned" else 0.0])
        scenes = [replace(s, positions=s.positions * scale) for s in plain.scenes]
        plain = replace(plain, scenes=tuple(scenes))
    assert with_vertical(plain, NAMES).up is None
