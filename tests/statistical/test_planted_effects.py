"""A drag planted in orbits: is it found, named and sized, and left alone if it cannot be said?"""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from tests.planted import GRAVITY, orbit_dataset
from tests.told import adopted, is_law

DRAG = 0.05
NO_SPEED = ("t", "v_i", "v_j")


def found(seed, exclude=("t",)):
    return close_loop(
        orbit_dataset(seed, drag=DRAG), [GRAVITY], rng=np.random.default_rng(seed), exclude=exclude
    )


def pull(report):
    """Error of the fitted drag in standard deviations."""
    (c,) = report.rounds[0].effect.constants
    return (c.value + DRAG) / ((c.high - c.low) / 2 / 1.6448536)


def is_named(report, seed):
    effects = adopted(report)
    return len(effects) == 1 and is_law(effects[0], "c * v_i", orbit_dataset(seed, drag=DRAG))


@pytest.mark.slow
def test_a_drag_is_named_and_sized():
    report = found(0)
    assert is_named(report, 0)
    assert abs(pull(report)) < 3
    assert report.total["ratio"].value <= 0.2
    assert report.rounds[1].verdict == "nothing missing"


@pytest.mark.long
def test_a_drag_that_no_allowed_law_can_say_is_not_adopted():
    report = found(4, NO_SPEED)
    assert not [e for e in adopted(report) if e.code == "law" and e.is_fact]


@pytest.mark.long
def test_in_nineteen_of_twenty():
    reports = [found(seed) for seed in range(20)]
    named = [r for seed, r in enumerate(reports) if is_named(r, seed)]
    assert len(named) >= 19
    pulls = [pull(r) for r in named]
    print("pulls", np.round(pulls, 2))
    assert sum(abs(p) < 3 for p in pulls) >= 19
    # And the intervals are no wider than they need be: chi-squared of 20 pulls within 0.1 %.
    assert 5.9 < np.sum(np.square(pulls)) * 20 / len(pulls) < 45.3
    assert all(r.total["ratio"].value <= 0.2 for r in named)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_without_speeds_nothing_is_adopted(seed):
    report = found(seed, NO_SPEED)
    assert not [e for e in adopted(report) if e.code == "law" and e.is_fact]
