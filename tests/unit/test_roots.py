"""Instants at which functions leave the positive, few or many at once."""

import numpy as np
import pytest

from bsp_gp.physics.engine.roots import FEW, roots

NUMBERS = [1, FEW, FEW + 1, 40]


def margins(places, count):
    """Functions that fall through zero at these places; calls are counted in a list."""

    def margin(length, which):
        count.append(len(which))
        away = places[which] - length
        return np.where(which % 2, np.expm1(3 * away), away**3 + 0.01 * away)

    return margin


@pytest.mark.parametrize("n", NUMBERS)
@pytest.mark.parametrize("sign", [1, -1])
def test_roots_are_found_to_rounding_and_come_just_behind(n, sign):
    places = sign * np.linspace(0.1, 0.9, n)
    high = sign * np.ones(n)

    def margin(length, which):
        return margins(places, [])(length, which) * sign

    before, behind = roots(margin, np.zeros(n), high)
    np.testing.assert_allclose(behind, places, rtol=0, atol=3e-14)
    assert np.all(sign * before <= sign * behind)
    assert np.all(margin(before, np.arange(n)) > 0)
    assert not np.any(margin(behind, np.arange(n)) > 0)


def test_a_first_of_several_roots_is_taken():
    def margin(length, which):
        return np.cos(length * np.pi)

    _, behind = roots(margin, np.zeros(1), np.full(1, 3.0))
    np.testing.assert_allclose(behind, 0.5, atol=1e-13)


@pytest.mark.parametrize("n", NUMBERS)
def test_roots_may_be_asked_for_less_closely_and_cost_less(n):
    places, exact, loose = np.linspace(0.21, 0.93, n), [], []
    low, high = np.zeros(n), np.ones(n)
    roots(margins(places, exact), low, high)
    before, behind = roots(margins(places, loose), low, high, 1e-5)
    assert np.all((before <= places) & (places <= behind))
    assert np.all(behind - before <= 1e-5 * behind)
    assert sum(loose) < sum(exact)


@pytest.mark.parametrize("n", NUMBERS)
def test_a_margin_on_its_edge_already_is_left_at_once(n):
    low = np.linspace(0.1, 0.5, n)
    before, behind = roots(lambda length, which: low[which] - length, low, np.ones(n))
    np.testing.assert_array_equal(behind, low)
    np.testing.assert_array_equal(before, low)


@pytest.mark.parametrize("n", NUMBERS)
def test_what_is_not_finite_behind_ends_where_it_was_looked_for(n):
    def margin(length, which):
        return np.where(length < 0.5, 1.0, np.nan)

    with np.errstate(invalid="ignore"):
        before, behind = roots(margin, np.zeros(n), np.ones(n))
    assert np.all((0.5 <= behind) & (behind <= 1.0) & (before <= behind))


def test_roots_far_nearer_than_their_ends_are_found_as_closely():
    """A body that has as good as stopped when a step begins: the stop is within 1e-9 of it."""
    places = 5e-12 * np.ones(FEW + 1)
    high = 0.015 * np.ones(FEW + 1)
    near = 1e-10 * np.ones(FEW + 1)

    def margin(length, which):
        return 1e-11 * (places[which] - length) * (1 + 0.2 * length)

    before, behind = roots(margin, np.zeros(FEW + 1), high, near)
    np.testing.assert_allclose(before, places, rtol=1e-4)
    np.testing.assert_allclose(behind, places, rtol=1e-4)
