"""A rod whose pivot or length was typed not quite right, and what is missing beside it."""

import numpy as np
import pytest

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.proposers.anchors import CLEAR, Anchors
from bsp_gp.loop.view import View
from tests.swings import LENGTH, PIVOT, WEIGHT, bob

SIGMA = 1e-3  # of a bob
OFF = np.array([0.007, -0.005])


def held(off=(0.0, 0.0), longer=0.0):
    """A rod to a point that is typed so far from where it is."""
    x, y = PIVOT + np.array(off)
    return f"norm(p_i - ({x:.6f}, {y:.6f})) = {LENGTH + longer:.6f}"


def proposals(data, constraint):
    hypothesis = Hypothesis.from_laws(data, [WEIGHT, constraint])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(0))
    return Anchors().propose(view)


@pytest.mark.parametrize("drag", [0.0, 0.15])
def test_where_a_bob_is_held_is_told_by_its_distances_whatever_else_is_missing(drag):
    data = bob(lambda v: -drag * v, n=150)
    (found,) = proposals(data, held(OFF)).proposals
    assert (found.code, found.kind) == ("origin", "measurement")
    assert found.is_sole and found.judged is not None
    known = found.hypothesis.law.constants
    assert known["pivot_x1"] == pytest.approx(PIVOT[0], abs=4 * SIGMA)
    assert known["pivot_y1"] == pytest.approx(PIVOT[1], abs=4 * SIGMA)



def test_a_length_alone_is_freed_where_that_is_what_is_not_right():
    (found,) = proposals(bob(n=150), held(longer=0.01)).proposals
    assert (found.code, found.kind) == ("length", "constraint")
    assert found.hypothesis.law.constants["L1"] == pytest.approx(LENGTH, abs=SIGMA)


def test_what_was_typed_right_is_seen_as_such():
    family = proposals(bob(n=150), held())
    (found,) = family.proposals
    assert not found.is_sole and found.gain < CLEAR / 4
    assert np.mean(family.null >= family.gain) > 0.01


def test_names_are_fitted_anyway():
    assert not proposals(bob(n=150), "norm(p_i - (X, Y)) = L").proposals


@pytest.mark.slow
def test_a_drag_is_found_beside_an_origin_that_is_off():
    data = bob(lambda v: -0.15 * v, n=150)
    report = bsp_gp.close_loop(
        data, [WEIGHT, held(OFF)], rng=np.random.default_rng(0), n_bootstrap=0
    )
    codes = [done.effect.code for done in report.rounds if done.adopted]
    assert codes == ["origin", "law"]
    assert report.verdict == "effect adopted"
    places = {c.name: c for c in report.constants}
    for name, true in zip(("pivot_x1", "pivot_y1"), PIVOT, strict=True):
        assert places[name].low - SIGMA < true < places[name].high + SIGMA
