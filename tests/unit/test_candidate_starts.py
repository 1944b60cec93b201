"""Where fits begin: the likeliest combinations of the values of constants first."""

import itertools

import pytest

from bsp_gp.fitting.starts import _adding_up


@pytest.mark.parametrize("sizes", [(), (3,), (2, 5), (10, 3, 2)])
def test_places_come_in_the_order_of_their_sums(sizes):
    """Without a list of all: of many constants that would be millions."""
    every = sorted(itertools.product(*map(range, sizes)), key=sum)
    sums = range(sum(sizes) - len(sizes) + 1)
    assert [place for total in sums for place in _adding_up(total, list(sizes))] == every
