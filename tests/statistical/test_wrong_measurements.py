"""Motions that lack nothing, measured wrongly: what is named, and what is left open."""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from tests import measured as wrong
from tests import worlds
from tests.measured import SPRING, changed
from tests.planted import GRAVITY
from tests.worlds import WEIGHT, flights, orbits, tied

pytestmark = pytest.mark.slow

SEEDS = range(5)


def close(dataset, laws, seed, **settings):
    return close_loop(dataset, laws, rng=np.random.default_rng(seed), seed=seed, **settings)


def tilted(t, p, angle=0.05):
    c, s = np.cos(angle), np.sin(angle)
    return t, p @ np.array([[c, s], [-s, c]])


def within(constant, value):
    """Whether an estimate is within four standard errors."""
    return abs(constant.value - value) < 4 * (constant.high - constant.low) / 2 / 1.645


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tilted_camera_is_named_and_put_right(seed):
    report = close(flights(seed, worlds.nothing, warp=tilted), [WEIGHT], seed)
    (first, last) = report.rounds
    assert first.adopted and first.effect.name == "a camera that is tilted (its axes rotated)"
    assert within(first.effect.constants[0], 0.05)
    assert last.verdict == "nothing missing"
    assert report.total["ratio"].high < 0.5
    assert [c["kind"] for c in report.corrections] == ["measurement"]
    assert len(report.law.terms) == 1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_slow_clock_is_one_of_three(seed):
    data = flights(seed, worlds.nothing, warp=lambda t, p: (1.02 * t, p))
    (done,) = close(data, [WEIGHT], seed).rounds
    assert done.verdict == "cannot tell" and not done.adopted
    said = {done.effect.name, *done.effect.equivalents}
    assert {"a length scale that is off", "a clock that is off"} <= said
    (clock,) = [r for r in done.rivals if r.name == "a clock that is off"]
    assert abs(clock.delta_bic) < 2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_scale_beside_a_known_length_is_in_the_class(seed):
    """A spring of a known rest length: the scale changes it, and so would a constant push."""
    report = close(changed(tied(seed), wrong.scaled), [SPRING], seed)
    first = report.rounds[0]
    said = {first.effect.name, *first.effect.equivalents, *first.undecided}
    assert "a length scale that is off" in said
    assert report.verdict != "effect adopted" or first.effect.kind == "measurement"


@pytest.mark.parametrize("seed", SEEDS)
def test_swapped_tracks_are_named(seed):
    data = changed(orbits(seed), wrong.swapped, "1")
    report = close(data, [GRAVITY], seed, max_levels=4, n_null=99, max_rounds=2)
    first = report.rounds[0]
    assert first.effect.name == "swapped tracks" and "scene 1" in first.effect.law
    assert not [r for r in report.rounds if r.adopted and r.effect.kind != "measurement"]


def test_nothing_is_corrected_where_nothing_is_wrong():
    for seed in range(20):
        data, law = (
            (flights(seed, worlds.nothing), WEIGHT),
            (orbits(seed), GRAVITY),
            (tied(seed), SPRING),
        )[seed % 3]
        report = close(data, [law], seed)
        assert not report.corrections, (seed, report.corrections)
