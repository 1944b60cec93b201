"""Contacts, mats and signs between rows: the motion behind them, and how its derivatives jump."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.fitted_tracks import (
    body,
    differences,
    disc,
    flow_of,
    law_of,
    nodes_of,
    reference,
    scene_of,
)

TOUCH = "does_collide(s_i, p_i, s_j, p_j)"
ON = "is_on(s_i, p_i, s_j, p_j)"
WEIGHT = "c1 * m_i * down"
SPRING = f"c2 * (0.7 [m] - dot(p_i - p_j, e_y)) * e_y * {TOUCH}"
WALL = body("wall", shape="rect_wall", width=10.0, height=1.0, is_static=True)
MAT = body("mat", shape="rect_mat", width=1.0, height=4.0, is_static=True)
ROWS = 0.1 * np.arange(13)

# Law, bodies, their places (static ones behind), velocities of the moving ones, rows.
CASES = {
    "discs": (
        law_of(f"c1 * (p_i - p_j) * {TOUCH}", c1=5.0),
        (disc("a", 0.3), disc("b", 0.4)), [[-0.6, 0.1], [0.6, 0.0]], [[1.5, 0.0], [-1.0, 0.2]],
    ),
    "damped discs": (
        law_of(f"(c1 * (p_i - p_j) - c2 * (v_i - v_j)) * {TOUCH}", c1=9.0, c2=0.8),
        (disc("a", 0.3), disc("b", 0.4)), [[-0.6, 0.1], [0.6, 0.0]], [[1.5, 0.0], [-1.0, 0.2]],
    ),
    "wall": (
        law_of(WEIGHT, SPRING, c1=9.8, c2=100.0),
        (disc("a", 0.2), WALL), [[0.0, 1.0], [0.0, 0.0]], [[0.5, -1.0]],
    ),
    "mat": (
        law_of(f"-c1 * normalize(v_i) * {ON}", c1=0.8),
        (body("a"), MAT), [[-1.0, 0.1], [0.0, 0.0]], [[2.0, 0.3]],
    ),
    "place": (
        law_of("-c1 * (1 + sign(c2 * dot(p_i - p_j, e_x) - c3)) * e_x - c4 * perp(v_i)",
               c1=1.5, c2=1.0, c3=0.47, c4=0.5),
        (body("a"), body("post", is_static=True)), [[0.0, 0.0], [0.0, -1.0]], [[1.3, 0.2]],
    ),
    "speed": (
        law_of("-c1 * sign(c2 * dot(v_i, e_x) - c3) * v_i + c4 * e_x",
               c1=0.7, c2=1.0, c3=1.13, c4=-2.0),
        (body("a"),), [[0.0, 0.0]], [[1.5, 0.2]],
    ),
    "time": (
        law_of("c1 * sign(c2 * t - c3) * e_x", c1=0.7, c2=1.0, c3=0.63),
        (body("a"),), [[0.0, 0.0]], [[1.5, 0.2]],
    ),
}  # fmt: skip




def setting(law, crew, p, v, rows=ROWS, tolerance=1e-10):
    """Nodes on the true track, the mesh chosen there, and that track's states (2, R, d, T)."""
    moving = [k for k, e in enumerate(crew) if not e.is_static]
    p = np.array(p, dtype=float)
    scene = scene_of(rows, crew, p)
    track = reference(law, scene, p[moving], v, np.asarray(rows, dtype=float), max_step=0.02)
    true = np.moveaxis(np.stack(track), 1, -1)
    flow = flow_of(law, [scene], tolerance)
    nodes = nodes_of(flow, p[moving], v)
    nodes[..., 0] = true
    return flow, nodes, flow.mesh(nodes), true


@lru_cache
def case(name):
    return setting(*CASES[name])


def changes(flow, true):
    """Intervals within which a condition changes."""
    held = []
    for row, t in enumerate(flow.chains.times[:, 0]):
        points = flow.points(true[..., row, None], np.array([t]), np.zeros(1, dtype=int))
        held.append(np.concatenate([mode.ravel() for mode in points.modes]))
    return np.flatnonzero((np.array(held[1:]) != np.array(held[:-1])).any(axis=1))


@pytest.mark.parametrize("name", CASES)
def test_the_motion_behind_an_event_is_right(name):
    flow, nodes, mesh, true = case(name)
    assert mesh.is_complete and len(changes(flow, true)) >= 1
    ends, _ = flow.run(nodes, mesh)
    error = np.abs(ends - true[..., 1:])
    assert error[0].max() < 1e-7
    assert error[1].max() < 1e-6


@pytest.mark.parametrize("name", CASES)
def test_derivatives_jump_at_an_event(name):
    """By the state before it and by every constant, those that move the threshold among them."""
    flow, nodes, mesh, true = case(name)
    _, transitions = flow.run(nodes, mesh)
    expected = differences(flow, nodes, mesh)
    inside = changes(flow, true)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(transitions, expected, atol=1e-5 * scale)
    assert np.abs(expected[inside]).max() > 1e-3


def test_a_threshold_in_time_moves_the_end_by_the_jump():
    """Behind t = c3 / c2 the force has changed by 2 c1: dv/dc3 = -2 c1 / c2, in closed form."""
    flow, nodes, mesh, _ = case("time")
    _, transitions = flow.run(nodes, mesh)
    for k in range(flow.n_intervals):
        at = 0.63 - flow.start[k]
        inside = 0 < at < flow.length[k]
        left = flow.length[k] - at
        by_threshold = transitions[k][:, flow.n_state + 2]
        expected = [-1.4 * left, 0, -1.4, 0] if inside else np.zeros(4)
        np.testing.assert_allclose(by_threshold, expected, atol=1e-9)


@pytest.mark.slow
def test_several_events_in_one_interval():
    """A body crosses two mats and a threshold in time between two rows."""
    law = law_of(f"-c1 * normalize(v_i) * {ON}", "c2 * sign(c3 * t - c4) * e_y",
                 c1=0.8, c2=0.4, c3=1.0, c4=0.9)  # fmt: skip
    mats = [body(n, shape="rect_mat", width=w, height=4.0, is_static=True)
            for n, w in (("m", 0.5), ("n", 0.7))]  # fmt: skip
    start = [[-1.0, 0.1], [-0.4, 0.0], [0.6, 0.0]]
    crew = (body("a"), *mats)
    rows = 0.05 * np.arange(25)
    _, _, _, true = setting(law, crew, start, [[2.0, 0.0]], rows=rows)
    whole = flow_of(law, [scene_of([0.0, 0.75, 1.2], crew, start)], 1e-10)
    nodes = nodes_of(whole, [[-1.0, 0.1]], [[2.0, 0.0]])
    nodes[:, 0, :, 1, 0] = true[:, 0, :, 15]
    # Steps between rows that see each change: those of the finer rows, put together.
    mesh = whole.mesh(nodes)
    fine = flow_mesh_of_rows(mesh, [15, 9], 0.05)
    ends, transitions = whole.run(nodes, fine)
    np.testing.assert_allclose(ends[:, 0, :, 0], true[:, 0, :, 15], atol=1e-8)
    np.testing.assert_allclose(ends[:, 0, :, 1], true[:, 0, :, 24], atol=1e-8)
    expected = differences(whole, nodes, fine)
    np.testing.assert_allclose(transitions, expected, atol=1e-5)


def flow_mesh_of_rows(mesh, counts, h):
    """A mesh of equal steps, `counts` in each interval (most first)."""
    starts, steps = [], []
    for number in range(max(counts)):
        open_ = sum(count > number for count in counts)
        starts.append(np.full(open_, number * h))
        steps.append(np.full(open_, h))
    none = tuple(np.full(len(own), -1) for own in steps)
    return type(mesh)("rk45", np.arange(len(counts)), tuple(starts), tuple(steps), none)




@pytest.mark.parametrize(
    ("law", "crew", "p", "v"),
    [
        (law_of(f"-c1 * normalize(v_i) * {ON}", c1=0.8), (body("a"), MAT),
         [[-1.0, 0.1], [0.0, 0.0]], [[2.0, 0.3]]),
        (law_of(WEIGHT, f"c2 * (p_i - p_c) * {TOUCH}", c1=9.8, c2=60.0), (disc("a", 0.2), WALL),
         [[0.0, 2.0], [0.0, 0.0]], [[0.5, 0.0]]),
    ],
    ids=["mat crossed", "bounce"],
)  # fmt: skip
def test_what_happens_between_two_rows_is_seen(law, crew, p, v):
    """Or the mesh says that it is not complete."""
    flow, nodes, mesh, true = setting(law, crew, p, v, rows=[0.0, 0.2, 0.9, 1.0])
    ends, _ = flow.run(nodes, mesh)
    assert not mesh.is_complete or np.abs(ends - true[..., 1:])[0].max() < 1e-6


def test_a_stiff_contact_is_right_or_refused():
    """A wall that throws the ball back within a row."""
    law = law_of(WEIGHT, SPRING, c1=9.8, c2=1e4)
    rows = 0.05 * np.arange(20)
    flow, nodes, mesh, true = setting(law, *CASES["wall"][1:], rows=rows)
    ends, _ = flow.run(nodes, mesh)
    assert not mesh.is_complete or np.abs(ends - true[..., 1:])[0].max() < 1e-6


@pytest.mark.parametrize("height", [0.6999, 0.7, 0.7001])
def test_a_grazing_contact_does_no_harm(height):
    """Ends and derivatives stay finite, and near those of a free body."""
    law = law_of(f"c1 * (p_i - p_j) * {TOUCH}", c1=5.0)
    crew = (disc("a", 0.3), disc("b", 0.4, is_static=True))
    flow, nodes, mesh, true = setting(law, crew, [[-0.6, height], [0.0, 0.0]], [[1.5, 0.0]])
    assert mesh.is_complete
    ends, transitions = flow.run(nodes, mesh)
    assert np.isfinite(ends).all() and np.isfinite(transitions).all()
    assert np.abs(ends - true[..., 1:]).max() < 0.1
    free = np.abs(transitions[:, :, : flow.n_state]).max()
    assert free < 1e3


@pytest.mark.parametrize("friction", ["normalize(v_i)", "sign(c2 * dot(v_i, e_x)) * e_x"])
def test_a_body_stops_and_stays(friction):
    """From v0 = 0.13 m/s under 2 m/s^2 it stops 0.065 s later, v0^2 / (2 a) further on."""
    constants = {"c1": 2.0, "c2": 1.0} if "c2" in friction else {"c1": 2.0}
    law = law_of(f"-c1 * m_i * {friction}", **constants)
    flow = flow_of(law, [scene_of([0.0, 0.1, 0.2], (body("a"),), [[0.0, 0.0]])], 1e-3)
    nodes = nodes_of(flow, [[0.0, 0.0]], [[0.13, 0.0]])
    nodes[:, 0, 0, 1, 0] = 0.13**2 / 4, 0.0
    ends, transitions = flow.run(nodes, flow.mesh(nodes))
    np.testing.assert_allclose(ends[:, 0, 0], [[0.13**2 / 4] * 2, [0.0] * 2], atol=2e-3)
    np.testing.assert_allclose(transitions[0][[0, 2], 2], [0.13 / 2, 0.0], atol=1e-2)
    assert transitions[0][0, 4] == pytest.approx(-(0.13**2) / 8, rel=0.1)


BELT = law_of("-c1 * m_i * normalize(v_i - (u1 * e_x + u2 * e_y))", c1=2.0, u1=0.4, u2=-0.1)


def _on_a_belt(law, start=(0.53, -0.1), rows=(0.0, 0.1, 0.2)):
    """Where a body ends that came onto a belt, row by row, and derivatives."""
    flow = flow_of(law, [scene_of(rows, (body("a"),), [[0.0, 0.0]])], 1e-3)
    nodes = nodes_of(flow, [[0.0, 0.0]], [start])
    nodes[1, 0, :, 1:, 0] = np.array([[law.constants["u1"]], [law.constants["u2"]]])
    return flow.run(nodes, flow.mesh(nodes))


def test_a_body_stops_on_a_belt_and_is_carried_along():
    """As on a floor at rest, seen from the belt; then it goes on as fast as the belt."""
    ends, transitions = _on_a_belt(BELT)
    after = 0.13**2 / 4 + 0.4 * 0.1
    np.testing.assert_allclose(ends[0, 0, 0], [after, 0.04], atol=1e-9)
    np.testing.assert_allclose(ends[0, 0, 1], [-0.01, -0.01], atol=1e-9)
    np.testing.assert_allclose(ends[1, 0, 0], 0.4, atol=1e-9)
    held, carried = transitions  # rows x, y, v_x, v_y; then c1, u1, u2
    assert held[0, 2] == pytest.approx(0.13 / 2, rel=1e-3)
    np.testing.assert_allclose(held[[2, 3], 5:], 0.0 * np.eye(2) + [[1, 0], [0, 1]], atol=1e-9)
    assert held[0, 4] == pytest.approx(-(0.13**2) / 8, rel=1e-3)
    assert held[0, 5] == pytest.approx(0.1 - 0.13 / 2, rel=1e-3)
    np.testing.assert_allclose(carried[:2, 4:], 0.0, atol=1e-9)


def test_a_body_at_rest_on_a_belt_is_taken_along():
    ends, _ = _on_a_belt(BELT, start=(0.0, 0.0), rows=(0.0, 0.3, 0.6))
    np.testing.assert_allclose(ends[1, 0, :, :], [[0.4, 0.4], [-0.1, -0.1]], atol=1e-9)


def test_drag_against_a_stream_stops_nothing_and_friction_on_a_belt_does():
    assert not flow_of(
        law_of("-c1 * norm(v_i - u * e_x) * normalize(v_i - u * e_x)", c1=1.0, u=0.2),
        [scene_of([0.0, 0.1, 0.2], (body("a"),), [[0.0, 0.0]])], 1e-3,
    ).motion.has_stops  # fmt: skip
    assert flow_of(
        BELT, [scene_of([0.0, 0.1, 0.2], (body("a"),), [[0.0, 0.0]])], 1e-3
    ).motion.has_stops


def test_a_step_that_no_number_of_parts_makes_short_enough_ends_nowhere():
    """Steps chosen under a weak drag, taken under one that stops the body within 1e-3 of them."""
    scene = scene_of([0.0, 0.1, 0.2], (body("a"),), [[0.0, 0.0]])
    weak, strong = (
        flow_of(law_of("-c1 * m_i * norm(v_i)^n * normalize(v_i)", c1=c, n=0.5), [scene], 1e-3)
        for c in (1e-3, 1e3)
    )
    nodes = nodes_of(weak, [[0.0, 0.0]], [[0.13, 0.0]])
    mesh = weak.mesh(nodes)
    assert np.isfinite(weak.run(nodes, mesh)[0]).all()
    assert np.isnan(strong.run(nodes, mesh)[0]).all()
    ends, _ = strong.run(nodes, strong.mesh(nodes))
    np.testing.assert_allclose(ends[1], 0.0, atol=1e-9)


def rubbed(amplitude, stiffness, friction, times):
    """A spring with dry friction from rest: half swings about a shifted centre, then a stop."""
    rate, rest = np.sqrt(stiffness), friction / stiffness
    out, x, begin = np.full(len(times), np.nan), amplitude, 0.0
    while True:
        centre = np.sign(x) * rest
        if abs(x) <= rest:
            out[times >= begin] = x
            return out
        end = begin + np.pi / rate
        part = (times >= begin) & (times < end)
        out[part] = centre + (x - centre) * np.cos(rate * (times[part] - begin))
        x, begin = 2 * centre - x, end


def test_a_spring_with_dry_friction_turns_round_and_stops():
    times = 0.09 * np.arange(90)
    law = law_of("-c1 * m_i * (p_i - p_j)", "-c2 * m_i * normalize(v_i)", c1=4.0, c2=0.9)
    crew = (body("a"), body("b", is_static=True))
    x = rubbed(1.0, 4.0, 0.9, times)
    step = 1e-6
    v = (rubbed(1.0, 4.0, 0.9, times + step) - x) / step
    v[x == x[-1]] = 0.0
    scene = scene_of(times, crew, [[1.0, 0.0], [0.0, 0.0]])
    flow = flow_of(law, [scene], 1e-9)
    nodes = np.zeros((2, 1, 2, len(times), 1))
    nodes[0, 0, 0, :, 0], nodes[1, 0, 0, :, 0] = x, v
    mesh = flow.mesh(nodes)
    ends, _ = flow.run(nodes, mesh)
    assert mesh.is_complete and mesh.counts.max() < 40
    np.testing.assert_allclose(ends[0, 0, 0], x[1:], atol=3e-6)


@pytest.mark.parametrize("friction", [0.9, -0.2])
def test_derivatives_by_what_goes_aside_are_digits_where_a_body_turns_round(friction):
    """Also just before its stop, and where what is taken for friction drives it."""
    times = np.arange(0.0, 3.0, 0.09)
    law = law_of("-c1 * m_i * (p_i - p_j)", "-c2 * m_i * normalize(v_i)", c1=4.0, c2=friction)
    crew = (body("a"), body("b", is_static=True))
    scene = scene_of(times, crew, [[1.0, 0.0], [0.0, 0.0]])
    flow = flow_of(law, [scene], 1e-9)
    nodes = nodes_of(flow, [[1.0, 0.0]], [[0.5, 0.0]])
    for row in range(len(times) - 1):
        nodes[..., row + 1, 0] = flow.run(nodes, flow.mesh(nodes))[0][..., row]
    mesh = flow.mesh(nodes)
    moved = flow.run(nodes, mesh)[1]
    assert np.abs(moved).max() < 10
    turned = np.sign(nodes[1, 0, 0, 1:, 0]) != np.sign(nodes[1, 0, 0, :-1, 0])
    # What drives a body turns it aside ever faster as it slows down: nothing is linear there.
    for k in np.flatnonzero(turned & (friction > 0)):
        start = nodes[:, 0, :, k, 0].copy()
        start[1, 1] = 1e-3 * abs(start[1, 0])

        def rate(t, y):
            p, v = y[:2], y[2:]
            return np.concatenate([v, -4 * p - friction * v / np.linalg.norm(v)])

        true = solve_ivp(rate, (0, 0.09), start.ravel(), "LSODA", rtol=1e-9, atol=1e-12)
        assert moved[k, 1, 3] == pytest.approx(true.y[1, -1] / start[1, 1], abs=0.02)


def test_a_body_that_stays_in_contact_has_no_event():
    """Inside a mat all along: the derivatives are smooth ones."""
    law = law_of(f"-c1 * v_i * {ON}", c1=0.8)
    flow, nodes, mesh, _ = setting(law, (body("a"), MAT), [[0.0, 0.1], [0, 0]], [[0.2, 0.1]])
    _, transitions = flow.run(nodes, mesh)
    decay = np.exp(-0.8 * flow.length)
    np.testing.assert_allclose(transitions[:, 2, 2], decay, rtol=1e-8)
    np.testing.assert_allclose(transitions[:, 3, 3], decay, rtol=1e-8)


def test_constants_of_bodies_move_thresholds_of_their_own():
    law = law_of("-c1 * sign(c2 * t - c3) * v_i", c1=0.7, c2=1.0, c3={"a": 0.42, "b": 0.77})
    crew = (body("a"), body("b"))
    flow = flow_of(law, [scene_of(ROWS, crew, [[0.0, 0.0], [1.0, 0.0]])], 1e-10)
    nodes = nodes_of(flow, [[0.2, 0.1]], [[1.0, -0.5]])
    mesh = flow.mesh(nodes)
    _, transitions = flow.run(nodes, mesh)
    expected = differences(flow, nodes, mesh)
    np.testing.assert_allclose(transitions, expected, atol=1e-6)
    assert np.abs(expected[:, :, -2:]).max() > 0.1



FRICTIONS = ["normalize(v_i)", "sign(c2 * dot(v_i, e_x)) * e_x"]


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_body_at_rest_sets_out_when_the_drive_exceeds_friction(friction, way):
    """Pulled by 2 t, held by 0.9: at rest until t = 0.45, then x = (t - 0.45)^3 / 3."""
    rows = 0.1 * np.arange(12)
    fixed = {"c2": 1.0} if "c2" in friction else {}
    law = law_of(f"-c1 * m_i * {friction}", "c3 * m_i * t * e_x", c1=0.9, c3=2.0 * way, **fixed)
    flow = flow_of(law, [scene_of(rows, (body("a"),), [[0.3, 0.0]])], 1e-9)
    gone = np.maximum(rows - 0.45, 0.0)
    x, v = 0.3 + way * gone**3 / 3, way * gone**2
    nodes = np.zeros((2, 1, 2, len(rows), 1))
    nodes[0, 0, 0, :, 0], nodes[1, 0, 0, :, 0] = x, v
    mesh = flow.mesh(nodes)
    ends, transitions = flow.run(nodes, mesh)
    assert mesh.is_complete and mesh.counts[:4].max() == 1  # a rest costs a step, however long
    np.testing.assert_allclose(ends[0, 0, 0], x[1:], atol=1e-7)
    np.testing.assert_allclose(ends[1, 0, 0], v[1:], atol=1e-6)
    held = transitions[:4]
    np.testing.assert_array_equal(held[:, 2, 4:], 0.0)  # a held velocity knows no constant


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_body_stops_rests_and_sets_out_again(friction, way):
    """From 0.3 m/s under 0.9 of friction and a pull of 0.6 t: at rest from 0.382 to 1.5 s."""
    stop, begin = 1.5 - np.sqrt(1.25), 1.5

    def track(t):
        slid = np.minimum(t, stop)
        gone = np.maximum(t - begin, 0.0)
        v = 0.3 - 0.9 * slid + 0.3 * slid**2 + 0.3 * gone**2
        return 0.3 * slid - 0.45 * slid**2 + 0.1 * slid**3 + 0.1 * gone**3, v * (t < stop) + (
            0.3 * gone**2
        )

    rows = 0.13 * np.arange(16)
    fixed = {"c2": 1.0} if "c2" in friction else {}
    law = law_of(f"-c1 * m_i * {friction}", "c3 * m_i * t * e_x", c1=0.9, c3=0.6 * way, **fixed)
    flow = flow_of(law, [scene_of(rows, (body("a"),), [[0.0, 0.0]])], 1e-9)
    nodes = np.zeros((2, 1, 2, len(rows), 1))
    nodes[0, 0, 0, :, 0], v = (way * part for part in track(rows))
    nodes[1, 0, 0, :, 0] = np.where((rows > stop) & (rows < begin), 0.0, v)
    mesh = flow.mesh(nodes)
    ends, transitions = flow.run(nodes, mesh)
    assert mesh.is_complete and mesh.counts.max() < 12
    np.testing.assert_allclose(ends[0, 0, 0], nodes[0, 0, 0, 1:, 0], atol=1e-7)
    np.testing.assert_allclose(ends[1, 0, 0], nodes[1, 0, 0, 1:, 0], atol=1e-6)
    (k,) = np.flatnonzero((rows[:-1] < stop) & (rows[1:] > stop))
    np.testing.assert_allclose(transitions[k, [0, 2], 2], [stop - rows[k], 0.0], atol=1e-6)
