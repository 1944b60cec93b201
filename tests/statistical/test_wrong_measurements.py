"""Motions that lack nothing, measured wrongly: what is named, and what is left open."""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from tests import measured as wrong
from tests import worlds
from tests.measured import SPRING, changed
from tests.planted import GRAVITY
from tests.told import adopted, within
from tests.worlds import WEIGHT, flights, orbits, tied

pytestmark = pytest.mark.slow

SEEDS = range(5)


def close(dataset, laws, seed, **settings):
    return close_loop(dataset, laws, rng=np.random.default_rng(seed), seed=seed, **settings)


def tilted(t, p, angle=0.05):
    c, s = np.cos(angle), np.sin(angle)
    return t, p @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tilted_camera_is_named_and_put_right(seed):
    report = close(flights(seed, worlds.nothing, warp=tilted), [WEIGHT], seed)
    first = report.rounds[0]
    rows = {h["code"] for h in first.hypotheses if h["probability"] > 0.05}
    assert "tilt" in rows and first.effect.kind == "measurement"
    if first.effect.code == "tilt":
        assert within(first.effect.constants[0], 0.05)
    assert report.rounds[-1].verdict == "nothing missing"
    assert report.total["ratio"].high < 0.5
    assert len(report.law.terms) == 1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_slow_clock_is_one_of_three(seed):
    data = flights(seed, worlds.nothing, warp=lambda t, p: (1.02 * t, p))
    first = close(data, [WEIGHT], seed).rounds[0]
    assert first.verdict == "cannot tell"
    rows = {h["code"] for h in first.hypotheses if h["probability"] > 0.05}
    assert {"scale", "clock", "number"} <= rows


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_scale_beside_a_known_length_is_in_the_class(seed):
    """A spring of a known rest length: the scale changes it, and so would a constant push."""
    first = close(changed(tied(seed), wrong.scaled), [SPRING], seed).rounds[0]
    rows = {h["code"] for h in first.hypotheses if h["probability"] > 0.01}
    assert "scale" in rows
    assert first.verdict != "effect adopted" or first.effect.kind == "measurement"


@pytest.mark.parametrize("seed", SEEDS)
def test_swapped_tracks_are_named(seed):
    data = changed(orbits(seed), wrong.swapped, "1")
    report = close(data, [GRAVITY], seed, max_levels=4, max_rounds=2)
    assert report.rounds[0].effect.code == "swapped_tracks"
    assert not [e for e in adopted(report) if e.kind != "measurement"]


def test_nothing_is_corrected_where_nothing_is_wrong():
    for seed in range(20):
        data, law = (
            (flights(seed, worlds.nothing), WEIGHT),
            (orbits(seed), GRAVITY),
            (tied(seed), SPRING),
        )[seed % 3]
        report = close(data, [law], seed)
        assert not [e for e in adopted(report) if e.kind == "measurement"], seed
