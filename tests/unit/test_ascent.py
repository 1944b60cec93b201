"""Maxima of functions that cost much, with a cheaper likeness."""

import numpy as np
import pytest

from bsp_gp.fitting.ascent import maximise

TOP = np.array([0.4, -1.2, 2.0])
BOUNDS = [(-3, 3)] * 3


def hill(values, top=TOP):
    d = np.asarray(values) - top
    return -500 * d[0] ** 2 - 40 * np.cosh(d[1]) - 300 * (d[2] - 0.3 * d[0]) ** 2


class Counted:
    def __init__(self, function):
        self.function, self.n_calls = function, 0

    def __call__(self, values):
        self.n_calls += 1
        return self.function(values)


@pytest.mark.parametrize("start", [TOP, TOP + 0.1, [0, 0, 0], [3, 3, -3]])
@pytest.mark.parametrize("shift", [None, 0.01, 1.0])
def test_the_top_is_found_with_and_without_a_likeness(start, shift):
    likeness = None if shift is None else lambda values: hill(values, TOP + shift)
    found, reached = maximise(hill, start, BOUNDS, likeness)
    assert reached == pytest.approx(hill(found), abs=1e-9)
    assert reached > hill(TOP) - 1e-3


def test_a_likeness_spares_the_function():
    far, plain, helped = [2.0, 2.0, -2.0], Counted(hill), Counted(hill)
    maximise(plain, far, BOUNDS)
    maximise(helped, far, BOUNDS, lambda values: hill(values, TOP + 0.01))
    assert helped.n_calls < 0.5 * plain.n_calls


def test_a_likeness_that_misleads_and_a_top_beyond_the_bounds():
    found, _ = maximise(hill, [0, 0, 0], BOUNDS, lambda values: -np.sum(np.square(values)))
    assert found == pytest.approx(TOP, abs=0.01)
    found, _ = maximise(hill, [0, 0, 0], [(-1, 1), (-1, 1), (-1, 1)], hill)
    assert found[1] == -1 and found[2] == 1
    found, _ = maximise(lambda v: -np.inf if v[0] < 0.1 else hill(v), [1, 1, 1], BOUNDS)
    assert found == pytest.approx(TOP, abs=0.01)


def test_a_bound_along_which_the_function_is_bent_otherwise_costs_no_search():
    def held(values):  # grows ever faster towards the bound of its first number
        return 200 * np.exp(values[0]) - 500 * (values[1] - 0.5) ** 2

    count = Counted(held)
    found, _ = maximise(count, [1.0, 0.3], [(-3, 1), (-3, 3)], held)
    assert found == pytest.approx([1.0, 0.5], abs=1e-3)
    assert count.n_calls < 20
