"""A push with a period is no fact where it has that of the swing, or was not seen to come back."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.periodogram import is_of_swing, longest
from bsp_gp.loop.writing_up import doubt_of_periods
from tests.swings import ROD, WEIGHT, bob
from tests.unit.test_response import GRAVITY, thrown


@pytest.fixture(scope="module")
def swung():
    data = bob(n=300)  # six seconds, a turn every 1.9 s
    return fit(Hypothesis.from_laws(data, [WEIGHT, ROD]), data)


def test_a_push_has_the_period_of_the_swing_or_it_has_not(swung):
    turn = 2 * np.pi / 1.94
    assert is_of_swing(turn, swung)
    assert is_of_swing(1.1 * turn, swung)
    assert is_of_swing(3 * turn, swung)  # what drives it back has another form
    assert not is_of_swing(1.5 * turn, swung)
    assert not is_of_swing(5 * turn, swung)


def test_what_does_not_swing_has_no_period_of_its_own():
    data = thrown(n_scenes=2, n_rows=40)
    found = fit(Hypothesis.from_laws(data, [GRAVITY]), data)
    assert not any(is_of_swing(rate, found) for rate in np.linspace(1.0, 20.0, 9))


def round_of(found, rate, code="period", number=1):
    after = SimpleNamespace(law=SimpleNamespace(constants={"w1": rate}), channels=found.channels)
    best = SimpleNamespace(id=1, code=code)
    return SimpleNamespace(
        number=number, entering=found, fits={1: after},
        proposals={1: SimpleNamespace(starts={"w1": rate})},
        decision=SimpleNamespace(is_adopted=True, best=best),
    )  # fmt: skip


def test_why_a_push_with_a_period_is_doubted(swung):
    turn, once = 2 * np.pi / 1.94, 2 * np.pi / longest(swung)
    assert doubt_of_periods([round_of(swung, turn)], ()) == "own_period"
    assert doubt_of_periods([round_of(swung, 1.5 * once)], ()) == "few_periods"
    assert doubt_of_periods([round_of(swung, 1.5 * once, "pulsing")], ()) == "few_periods"
    assert doubt_of_periods([round_of(swung, turn, "pulsing")], ()) == ""
    assert doubt_of_periods([round_of(swung, 5 * turn)], ()) == ""
    assert doubt_of_periods([round_of(swung, turn)], {1}) == ""
