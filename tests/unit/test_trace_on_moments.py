"""The trace: in which direction and on which variable a force is left."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.loop.trace import Channel, Trace, trace
from bsp_gp.report.traces import trace_sentence
from tests.loop_views import throws, view_of


def trace_of(move, **more):
    return trace(view_of(throws(np.random.default_rng(11), n_scenes=6, move=move, **more)))


def test_a_push_in_time_is_traced_to_its_axis_and_the_clock():
    def push(t, mass):  # 0.3 sin(2 pi t) along x
        w = 2 * np.pi
        return 0.3 * (t / w - np.sin(w * t) / w**2)[:, None] * [1, 0]

    found = trace_of(push, sigma=0.0005)
    best = found.channels[0]
    assert (best.direction, best.variable) == ("e_x", "time")
    assert best.p_value < 1e-12
    assert best.share == pytest.approx(1, abs=0.1)
    at, values, errors = map(np.array, (found.at, found.values, found.errors))
    inner = slice(1, -1)
    off = (values - 0.3 * np.sin(2 * np.pi * at))[inner] / np.hypot(errors[inner], 0.02)
    assert np.abs(off).max() < 4


def test_a_push_that_differs_from_body_to_body_is_told_for_each():
    pushes = iter([0.4, -0.4] * 6)

    def push(t, mass):
        return 0.5 * next(pushes) * np.square(t)[:, None] * [0, 1]

    found = trace_of(push, n_bodies=2)
    best = found.channels[0]
    assert (best.direction, best.variable) == ("e_y", "body")
    assert found.at == ("1", "2")
    assert found.values == pytest.approx((0.4, -0.4), abs=0.05)
    assert best.rank == 2


def test_a_constant_push_needs_no_variable():
    def push(t, mass):
        return 0.5 * 0.1 * np.square(t)[:, None] * [1, 0]

    found = trace_of(push)
    best = found.channels[0]
    assert (best.direction, best.variable, best.n_functions) == ("e_x", "", 1)
    assert np.allclose(found.values, 0.1, atol=0.02)
    assert np.all(np.array(found.errors) < 0.02)


def test_noise_alone_leaves_no_channel_with_evidence():
    found = trace_of(None)
    assert len(found.channels) > 15
    assert all(c.evidence < 3 for c in found.channels)
    assert {c.variable for c in found.channels} == {"", "time", "x", "y", "speed", "scene"}
    assert {c.direction for c in found.channels} == {"along", "across", "e_x", "e_y"}


def test_other_bodies_make_lines_and_distances():
    found = trace_of(None, n_bodies=3)
    assert {"line", "line:1", "line:2", "line:3"} <= {c.direction for c in found.channels}
    assert all(
        c.direction.startswith("line") for c in found.channels if c.variable == "distance"
    )


def test_what_a_trace_says_has_no_share_that_is_not_known():
    """It was told of "a push along across_x" and of "- of it"."""
    best = Channel("across_x", "time", 4, 4, 90.0, 1e-9, math.nan, 30.0)
    assert trace_sentence(Trace((best,))) == (
        "What was missing is best described as a push across the velocity and x that changes with "
        "time (p < 0.0001)."
    )
    assert "(40 % of it, p" in trace_sentence(Trace((replace(best, share=0.4),)))
