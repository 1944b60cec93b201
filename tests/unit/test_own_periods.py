"""A push with a period is no fact where it has that of the swing, or was not seen to come back."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.periodogram import MOST_ROWS, _lesser, is_of_swing, longest
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


WAVE = "(a1 * cos(w1 * t) + b1 * sin(w1 * t)) * e_x"
STRONG = "(1 + a1 * cos(w1 * t) + b1 * sin(w1 * t)) * (9.81 [m/s^2] * m_i * down)"


def round_of(found, rate, code="period", text=WAVE):
    law = read_law(bob(n=300), [text]).with_constants({"w1": rate, "a1": 1.0, "b1": 1.0})
    after = SimpleNamespace(law=law, channels=found.channels)
    best = SimpleNamespace(id=1, code=code, n_terms=1)
    return SimpleNamespace(
        number=1, entering=found, fits={1: after},
        decision=SimpleNamespace(is_adopted=True, best=best),
    )  # fmt: skip


def test_why_a_push_with_a_period_is_doubted(swung):
    turn, once = 2 * np.pi / 1.94, 2 * np.pi / longest(swung)
    assert doubt_of_periods([round_of(swung, turn)], ()) == "own_period"
    assert doubt_of_periods([round_of(swung, 1.5 * once)], ()) == "few_periods"
    assert doubt_of_periods([round_of(swung, 1.5 * once, "pulsing", STRONG)], ()) == "few_periods"
    assert doubt_of_periods([round_of(swung, 1.5 * once, "law")], ()) == "few_periods"  # of a sum
    assert doubt_of_periods([round_of(swung, turn, "pulsing", STRONG)], ()) == ""
    assert doubt_of_periods([round_of(swung, 5 * turn)], ()) == ""
    assert doubt_of_periods([round_of(swung, turn)], {1}) == ""


def test_one_track_that_swings_at_the_rate_of_a_push_may_be_driven_back():
    data = bob(n=300)
    found = fit(Hypothesis.from_laws(data, []), data)
    turn = 2 * np.pi / 1.94
    assert is_of_swing(turn, found)
    assert not is_of_swing(4.5 * turn, found)


def test_of_long_tracks_a_swing_is_sought_in_means_or_in_their_first_rows():
    """A torsion balance of 61,799 rows took minutes, whatever the time limit was."""
    times = 0.01 * np.arange(50_000)
    slow, fast = np.sin(0.5 * times), np.sin(200.0 * times)
    t, x = _lesser(times, slow)
    assert len(t) <= MOST_ROWS and np.ptp(t) > 0.99 * np.ptp(times)
    assert np.abs(x - np.sin(0.5 * t)).max() < 1e-3
    t, x = _lesser(times, fast)
    assert np.array_equal(x, fast[:MOST_ROWS]) and np.array_equal(t, times[:MOST_ROWS])
    assert len(_lesser(times[:90], fast[:90])[0]) == 90
