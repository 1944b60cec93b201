"""Compiled loops compute what NumPy does with the same tapes."""

import numpy as np
import pytest

from bsp_gp.language.operators import OPERATORS
from bsp_gp.physics.engine import kernel
from bsp_gp.physics.engine.compiled import Compiled
from bsp_gp.physics.engine.flow import SCHEMES
from bsp_gp.physics.engine.graph import UFUNCS
from tests.fitted_tracks import body, flow_of, law_of, scene_of
from tests.unit.test_flow import nodes_of
from tests.unit.test_motion import CASES, points_of, setting


def slow(flow):
    """The same flow without compiled loops."""
    flow.motion.compiled = None
    flow.is_compiled = flow.is_carried = False
    return flow


def test_all_operations_are_compiled():
    assert set(kernel.OPS) == set(UFUNCS)


@pytest.mark.parametrize("op", sorted(kernel.OPS))
def test_operations_are_those_of_numpy(op):
    x = np.array([-np.inf, -2.5, -1.0, -0.0, 0.0, 1e-9, 0.3, 1.0, 4.0, np.inf, np.nan])
    x, y = (part.ravel().copy() for part in np.meshgrid(x, x))
    found, function = np.empty(len(x)), UFUNCS[op]
    kernel._operate(kernel.OPS[op], x, y, found, len(x))
    with np.errstate(all="ignore"):
        wanted = function(x, y) if getattr(function, "nin", 1) == 2 else function(x)
    error = 1e-13 if op.startswith("bessel") else 1e-14
    np.testing.assert_allclose(found, wanted.astype(float), rtol=error)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_and_derivatives_are_those_of_numpy(name, scheme):
    law, crew = CASES[name]
    flow, batch, velocities = setting(law, crew)
    points, *_ = points_of(flow, batch, velocities, 1)
    points = points.pick(np.arange(flow.chains.n_chains).repeat(9))  # more than one row of lanes
    h = np.linspace(0.001, 0.02, len(points.times))
    first = np.random.default_rng(1).normal(
        size=(flow.n_state, flow.n_state + flow.n_constants, len(h))
    )
    found = []
    for own in (flow, slow(setting(law, crew)[0])):
        own.is_sparse = True
        end, stages, rates = own.step(SCHEMES[scheme], points, h)
        assert (stages.inputs is None) == (own is not flow)
        total = own.step_slopes(SCHEMES[scheme], stages, h, first.copy())
        found.append((end, rates, total, *own.motion.slope_rows(points)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)


def test_runs_beside_a_source_that_moves_are_those_of_numpy():
    times = np.linspace(0.0, 3.0, 31)
    track = np.ones((31, 2, 2))
    track[:, 1] = np.stack([np.sin(2 * times), 0.1 * times], axis=-1)
    law = law_of("-c1 * (p_i - p_j) - c2 * (v_i - v_j)", c1=4.0, c2=0.5)
    scenes = [scene_of(times, (body("a"), body("hand", is_static=True)), track)]
    nodes = nodes_of(flow_of(law, scenes, 1e-10), [[0.3, 0.1]], [[0.0, 0.2]])
    mesh = flow_of(law, scenes, 1e-10).mesh(nodes)
    found = [flow.run(nodes, mesh) for flow in (flow_of(law, scenes), slow(flow_of(law, scenes)))]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)


def test_operators_of_users_are_left_to_numpy(monkeypatch):
    flow, *_ = setting(*CASES["field"])
    assert Compiled.can_take(flow.motion)
    tape = flow.motion.programs[0].value
    tape.line = [("hinge", *row[1:]) for row in tape.line]
    assert not Compiled.can_take(flow.motion)
    assert "hinge" not in OPERATORS
