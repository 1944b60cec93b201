"""What counts as the form of a law on the public scoreboards."""

import sys
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.units import Unit

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture(scope="module")
def board():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS / "scoreboards"))
        patch.syspath_prepend(str(EXPERIMENTS))
        import forms
        import newton_bench

        yield newton_bench, forms
    for name in ("newton_bench", "forms", "common"):
        sys.modules.pop(name, None)


def test_exponents_are_rounded_and_strengths_are_not(board):
    _, forms = board
    formula = parse_formula(
        "c * m_j^a * norm(p_i - p_j)^n * normalize(p_i - p_j)",
        input_types({"mass": Unit.of(kg=1)}),
    )
    law = ForceLaw((Term(formula, "pair"),), {"c": 2.0437, "a": 1.2961, "n": -2.6049})
    rounded = forms.with_rounded_powers(law).constants
    assert dict(rounded) == {"c": 2.0437, "a": 1.3, "n": -2.6}


@pytest.mark.parametrize(
    ("found", "true", "is_form"),
    [
        (lambda a, b, r: a * b * r**-2.7, lambda a, b, r: a * b * r**-np.e, True),
        (lambda a, b, r: 2.001 * a * b**2 + 2 * b * a**2, lambda a, b, r: a * b * (a + b), True),
        (lambda a, b, r: a * b * r**-2.1, lambda a, b, r: a * b * r**-2.0, False),
        (lambda a, b, r: a * b / r**2 + 0.01 * r, lambda a, b, r: a * b / r**2, False),
        (lambda a, b, r: -a * b / r**2, lambda a, b, r: a * b / r**2, False),
    ],
)
def test_a_form_is_right_up_to_a_constant_and_the_rounding_of_exponents(
    board, found, true, is_form
):
    points = 10.0 ** np.random.default_rng(0).uniform(-1, 1, (300, 3))
    ratio = found(*points.T) / true(*points.T)
    assert board[0]._is_constant(ratio, points) == is_form
