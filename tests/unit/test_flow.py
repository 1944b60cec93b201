"""Motion from row to row: where it ends, and how that hangs on its start and on the constants."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bsp_gp.physics.engine.flow as flow_module
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from tests.fitted_tracks import body, differences, flow_of, law_of, nodes_of, reference, scene_of

TIMES = np.array([0.0, 0.3, 0.7, 0.8, 2.0, 2.9])
PAIR = (body("a", 1.0), body("b", 2.0))
PAIR_STATE = ([[0.0, 0.0], [1.2, 0.3]], [[0.1, -0.6], [-0.2, 0.4]])
BALL_STATE = ([[0.4, -0.2]], [[0.7, 0.9]])
GRAVITY = "-c1 * m_i * m_j * norm(p_i - p_j)^(-2) * normalize(p_i - p_j)"
SMOOTH = {
    "spring": (law_of("-c1 * norm(v_i) * v_i", "c2 * m_i * down - c3 * norm(v_i)^2 * perp(v_i)",
                      c1=0.3, c2=9.8, c3=0.5), (body("a", 2.0),), *BALL_STATE),
    "time": (law_of("c1 * sin(c2 * t + c3) * e_x - c1 * t * v_i", c1=0.8, c2=7.0, c3=0.4),
             (body("a", 2.0),), *BALL_STATE),
    "gravity": (law_of(GRAVITY, c1=0.6), PAIR, *PAIR_STATE),
    "power": (law_of("-c1 * norm(p_i - p_j)^c2 * normalize(p_i - p_j)", "-c3 * v_i", c1=0.6, c2=0.7,
                     c3=0.1), PAIR, *PAIR_STATE),
    "space": (law_of("c1 * m_i * down + c2 * cross(v_i, e_z)", n_dims=3, c1=9.8, c2=3.0),
              (body("a", 2.0),), [[0.4, -0.2, 0.1]], [[0.7, 0.9, -0.3]]),
}  # fmt: skip


def setting(name, tolerance=1e-9, **options):
    """A flow whose nodes all have the same state, with its scene and that state."""
    law, crew, p, v = SMOOTH[name]
    scene = scene_of(TIMES, crew, p)
    flow = flow_of(law, [scene], tolerance, **options)
    return flow, nodes_of(flow, p, v), scene, law


def expected_ends(law, scene, flow):
    """(2, R, d, K) by scipy, interval by interval."""
    name = next(n for n, case in SMOOTH.items() if case[0] is law)
    _, _, p, v = SMOOTH[name]
    ends = np.empty((2, len(p), scene.n_dims, flow.n_intervals))
    if flow.chains.n_moving != len(p):
        raise AssertionError("one chain is expected")
    for k, (begin, length) in enumerate(zip(flow.start, flow.length, strict=True)):
        found = reference(law, scene, p, v, np.array([begin, begin + length]))
        ends[..., k] = [track[-1] for track in found]
    return ends


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["rk45", "dop853"])
@pytest.mark.parametrize("name", SMOOTH)
def test_intervals_end_where_scipy_says(name, scheme):
    """Within a few times the tolerance, which is what one step may err by."""
    flow, nodes, scene, law = setting(name, 1e-8)
    ends, _ = flow.run(nodes, flow._mesh(nodes, scheme)[0])
    error = np.abs(ends - expected_ends(law, scene, flow))
    assert error[0].max() < 1e-7
    assert error[1].max() < 1e-6


def test_the_chosen_mesh_is_right_and_costs_what_the_tolerance_asks():
    counts = []
    for tolerance in (1e-3, 1e-7, 1e-11):
        flow, nodes, scene, law = setting("gravity", tolerance)
        mesh = flow.mesh(nodes)
        assert mesh.is_complete
        ends, _ = flow.run(nodes, mesh)
        assert np.abs(ends - expected_ends(law, scene, flow))[0].max() < 10 * tolerance
        counts.append(mesh.counts.sum() * flow_module.SCHEMES[mesh.scheme].n_stages)
        total = np.zeros(flow.n_intervals)
        for size in mesh.steps:
            np.add.at(total, mesh.order[: len(size)], size)
        np.testing.assert_allclose(total, np.diff(TIMES), rtol=1e-14)
    assert counts == sorted(counts) and counts[-1] > 2 * counts[0]


@pytest.mark.parametrize("name", SMOOTH)
def test_transitions_are_differences(name):
    flow, nodes, _, _ = setting(name)
    mesh = flow.mesh(nodes)
    _, transitions = flow.run(nodes, mesh)
    expected = differences(flow, nodes, mesh)
    np.testing.assert_allclose(transitions, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_constants_of_bodies_have_columns_of_their_own():
    law = law_of("-c1 * v_i", "c2 * (p_j - p_i)", c1={"a": 0.1, "b": 0.5}, c2=1.5)
    flow = flow_of(law, [scene_of(TIMES, PAIR, PAIR_STATE[0])])
    nodes = nodes_of(flow, *PAIR_STATE)
    assert flow.n_constants == 3
    mesh = flow.mesh(nodes)
    moved = []
    for entity in ("a", "b"):
        ends = []
        for sign in (1e-6, -1e-6):
            own = dict(law.constants["c1"])
            own[entity] += sign
            flow.motion.set_constants([own["a"], own["b"], 1.5])
            ends.append(flow.run(nodes, mesh, slopes=False)[0])
        moved.append((ends[0] - ends[1]) / 2e-6)
    flow.motion.set_constants([0.1, 0.5, 1.5])
    _, transitions = flow.run(nodes, mesh)
    for k in range(2):
        found = transitions[:, :, flow.n_state + k].T.reshape(moved[k].shape)
        np.testing.assert_allclose(found, moved[k], atol=1e-8)


@pytest.mark.parametrize("name", ["time", "gravity"])
def test_the_papers_steps_are_those_of_its_rollout(name):
    flow, nodes, scene, law = setting(name, paper_steps=True)
    (batch,) = stack([scene], "y")
    _, _, p, v = SMOOTH[name]
    expected = rollout(law, batch, np.array(p)[None], np.array(v)[None], integrator="euler")
    state = nodes[..., 0, 0]
    mesh = flow.mesh(nodes)
    for row in range(len(TIMES) - 1):
        nodes[..., row, 0] = state
        ends, _ = flow.run(nodes, mesh)
        state = ends[..., row]
        np.testing.assert_allclose(state[0], expected[row + 1, 0], rtol=1e-14, atol=1e-14)
    _, transitions = flow.run(nodes, mesh)
    slopes = differences(flow, nodes, mesh)
    np.testing.assert_allclose(transitions, slopes, rtol=1e-6, atol=1e-7)


def test_transitions_over_rows_are_those_over_the_whole():
    """One interval of many steps, and the same cut into three."""
    law, crew, p, v = SMOOTH["gravity"]
    whole = flow_of(law, [scene_of([0.0, 2.9, 3.0], crew, p)], 1e-11)
    nodes = nodes_of(whole, p, v)
    end, transition = whole.run(nodes, whole.mesh(nodes))
    cut = flow_of(law, [scene_of([0.0, 0.8, 2.0, 2.9], crew, p)], 1e-11)
    nodes, n, total = nodes_of(cut, p, v), cut.n_state, None
    for row in range(3):
        ends, moved = cut.run(nodes, cut.mesh(nodes))
        if row < 2:
            nodes[..., row + 1, 0] = ends[..., row]
        own = moved[row]
        total = own if total is None else np.hstack(
            [own[:, :n] @ total[:, :n], own[:, :n] @ total[:, n:] + own[:, n:]]
        )  # fmt: skip
    np.testing.assert_allclose(ends[..., 2], end[..., 0], atol=1e-8)
    np.testing.assert_allclose(transition[0], total, rtol=1e-6, atol=1e-7 * np.abs(total).max())


def test_blocks_of_intervals_change_nothing(monkeypatch):
    flow, nodes, _, _ = setting("gravity")
    mesh = flow.mesh(nodes)
    whole = flow.run(nodes, mesh)
    monkeypatch.setattr(flow_module, "BLOCK", 2)
    for one, two in zip(flow.run(nodes, mesh), whole, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-13, atol=1e-15)


def test_scenes_of_different_lengths_and_gaps_are_each_their_own():
    """A scene ends earlier than the other; intervals run from row to row, seen or not."""
    law, crew, p, v = SMOOTH["gravity"]
    gappy = np.broadcast_to(p, (len(TIMES), 2, 2)).copy()
    gappy[2] = np.nan
    scenes = [scene_of(TIMES, crew, gappy, "long"), scene_of(TIMES[:3], crew, p, "short")]
    flow = flow_of(law, scenes, 1e-10)
    assert flow.n_intervals == 5 + 2
    nodes = nodes_of(flow, p, v)
    ends, transitions = flow.run(nodes, flow.mesh(nodes))
    alone, nodes_alone, _, _ = setting("gravity", 1e-10)
    expected, slopes = alone.run(nodes_alone, alone.mesh(nodes_alone))
    for row in range(5):
        for k in np.flatnonzero(flow.row == row):
            np.testing.assert_allclose(ends[..., k], expected[..., row], atol=1e-8)
            np.testing.assert_allclose(transitions[k], slopes[row], atol=1e-6)


def test_a_source_that_moves_along_a_measured_track():
    times = np.linspace(0.0, 3.0, 31)
    hand = body("hand", is_static=True)
    track = np.ones((31, 2, 2))
    track[:, 1, 1] = 0.0
    track[:, 1, 0] = np.sin(2 * times)
    law = law_of("-c1 * (p_i - p_j) - c2 * (v_i - v_j)", c1=4.0, c2=0.5)
    flow = flow_of(law, [scene_of(times, (body("a"), hand), track)], 1e-10)
    nodes = nodes_of(flow, [[0.3, 0.1]], [[0.0, 0.2]])
    ends, transitions = flow.run(nodes, flow.mesh(nodes))

    def slope(t, y):
        place, speed = np.array([np.sin(2 * t), 0.0]), np.array([2 * np.cos(2 * t), 0.0])
        return [*y[2:], *(-4.0 * (y[:2] - place) - 0.5 * (y[2:] - speed))]

    for k in range(5, 25):  # the spline is less good at its ends
        found = solve_ivp(
            slope, (times[k], times[k + 1]), [0.3, 0.1, 0.0, 0.2], rtol=1e-12, atol=1e-12
        )
        np.testing.assert_allclose(ends[..., k].ravel(), found.y[:, -1], atol=1e-8)
    np.testing.assert_allclose(transitions, differences(flow, nodes, flow.mesh(nodes)), atol=1e-7)


def test_motion_goes_back_as_it_came():
    flow, nodes, _, _ = setting("gravity", 1e-11)
    begin, end = np.array([0.2]), np.array([2.5])
    chain = np.zeros(1, dtype=int)
    state = nodes[..., 0, :1]
    there = flow.advance(state, chain, begin, end)
    back = flow.advance(there, chain, end, begin)
    assert np.abs(there - state).max() > 0.1
    np.testing.assert_allclose(back, state, atol=1e-8)
    law, _, p, v = SMOOTH["gravity"]
    expected = reference(law, setting("gravity")[2], p, v, np.array([0.2, 2.5]))
    np.testing.assert_allclose(there[..., 0], [x[-1] for x in expected], atol=1e-8)


@lru_cache
def kepler(eccentricity, tolerance):
    """An orbit from its farthest point once around: it must come back."""
    law = law_of(GRAVITY, c1=1.0)
    crew = (body("a", 1e-3), body("sun", 1.0, is_static=True))
    farthest = np.array([1.0 + eccentricity, 0.0])
    speed = np.sqrt((1 - eccentricity) / (1 + eccentricity))
    times = [0.0, 2 * np.pi, 7.0]
    flow = flow_of(law, [scene_of(times, crew, [farthest, [0.0, 0.0]])], tolerance)
    nodes = nodes_of(flow, [farthest], [[0.0, speed]])
    mesh = flow.mesh(nodes)
    return flow.run(nodes, mesh)[0][..., 0] - nodes[..., 0, 0], mesh


ENCOUNTERS = [(e, tol) for e in (0.0, 0.5, 0.9, 0.99, 0.999, 0.99999, 1.0) for tol in (1e-4, 1e-8)]
@pytest.mark.slow
@pytest.mark.parametrize(
    ("eccentricity", "tolerance"),
    ENCOUNTERS,
)
def test_close_encounters_are_right_or_refused(eccentricity, tolerance):
    """An orbit comes back to where it was, to some two hundred steps' errors, or is refused."""
    error, mesh = kepler(eccentricity, tolerance)
    if mesh.is_complete:
        assert np.abs(error[0]).max() < 200 * tolerance


def test_ordinary_orbits_are_followed_and_a_head_on_collision_is_refused():
    assert all(kepler(eccentricity, 1e-8)[1].is_complete for eccentricity in (0.0, 0.5, 0.9))
    assert not kepler(1.0, 1e-8)[1].is_complete


def test_a_mesh_is_as_fine_as_one_with_no_more_steps():
    flow, nodes, _, _ = setting("gravity", 1e-6)
    fine, _, _, _ = setting("gravity", 1e-11)
    coarse, finer = (f._mesh(nodes, "dop853")[0] for f in (flow, fine))
    assert finer.is_as_fine_as(coarse) and not coarse.is_as_fine_as(finer)
    assert not replace(finer, is_complete=False).is_as_fine_as(coarse)
    assert not replace(finer, scheme="rk45").is_as_fine_as(coarse)
