"""Accelerations of chains are those of the law, and their slopes are its derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.physics.bodies import stack
from tests.fitted_tracks import body, disc, flow_of, law_of, scene_of, values_of

TIMES = np.linspace(0.0, 2.0, 5)
WALL = {"shape": "rect_wall", "width": 4.0, "height": 1.0, "is_static": True}
MAT = {"shape": "rect_mat", "width": 3.0, "height": 5.0, "is_static": True}
TRIO = (body("a", 1.0), body("b", 2.0), body("c", 0.5))
CHARGES = {"properties": {"charge": 0.7}}

CASES = {
    "field": (law_of("-c1 * norm(v_i) * v_i", "c2 * m_i * down", c1=0.3, c2=9.8), TRIO),
    "time": (law_of("c1 * sin(c2 * t) * e_x", "c1 * t * v_i", c1=0.3, c2=4.0), TRIO),
    "pair": (
        law_of("-c1 * m_i * m_j * norm(p_i - p_j)^c2 * normalize(p_i - p_j)", c1=2.0, c2=-2.0),
        TRIO,
    ),
    "pair and field": (law_of("c1 * (v_j - v_i)", "-c1 * v_i", "c2 * e_y", c1=0.2, c2=1.0), TRIO),
    "static sources": (
        law_of("-c1 * (norm(p_i - p_j) - l_j) * normalize(p_i - p_j)", c1=3.0),
        (
            body("a", 2.0, properties={"rest_length": 0.2}),
            body("post", is_static=True, properties={"rest_length": 0.7}),
            body("b", 1.0, properties={"rest_length": 0.4}),
        ),
    ),
    "unknown masses": (
        law_of("-c1 * v_i", "c2 * m_i * down", "c1 * (p_j - p_i)", c1=0.3, c2=9.8),
        (body("a", np.nan), body("b", 2.0), body("post", np.nan, is_static=True)),
    ),
    "own constants": (
        law_of("-c1 * v_i", "c2 * m_i * (p_j - p_i)", c1={"a": 0.1, "b": 0.4, "c": 0.9}, c2=2.0),
        (body("a", np.nan), body("b", 2.0), body("c", 0.5)),
    ),
    "own constants of pairs": (
        law_of("c1 * (p_j - p_i)", c1={"a": 0.1, "b": 0.4, "c": 0.9}), TRIO,
    ),
    "discs": (
        law_of("c1 * (p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)", "-c2 * v_i", c1=5.0, c2=0.2),
        (disc("a", 0.6), disc("b", 0.9), disc("c", 0.7)),
    ),
    "walls and mats": (
        law_of(
            "c1 * (p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)",
            "-c2 * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)", c1=5.0, c2=0.2,
        ),
        (disc("a", 0.6), disc("b", 0.9), body("wall", **WALL), body("mat", **MAT)),
    ),
}  # fmt: skip


def setting(law, crew, n_dims=2, seed=0, **properties):
    """Two scenes of bodies at random places: their flow, the batch, and states (T, S, N, d)."""
    rng = np.random.default_rng(seed)
    scenes = []
    for name in "st":
        places = rng.uniform(-1.5, 1.5, (len(TIMES), len(crew), n_dims))
        places[:, [k for k, e in enumerate(crew) if e.is_static]] = places[:1, [
            k for k, e in enumerate(crew) if e.is_static]]  # fmt: skip
        scenes.append(scene_of(TIMES, crew, places, name))
    (batch,) = stack(scenes, "y")
    flow = flow_of(law, scenes)
    velocities = rng.uniform(-2, 2, batch.positions.shape)
    static = np.setdiff1d(np.arange(len(crew)), batch.bodies.receivers)
    velocities[:, :, static] = 0.0
    return flow, batch, velocities


def points_of(flow, batch, velocities, row):
    """The points of all chains at one row."""
    chains = flow.chains
    names = [e.name for e in batch.scenes[0].entities]
    scene = np.array([[s.name for s in batch.scenes].index(name) for name in chains.scenes])
    own = np.array([[names.index(n) for n in members] for members in chains.bodies])  # (S, R)
    state = np.stack([x[row][scene[:, None], own] for x in (batch.positions, velocities)])
    chain = np.arange(chains.n_chains)
    times = batch.times[row][scene]
    points = flow.points(np.moveaxis(state, 1, -1), times, chain)
    return points, scene, own


def check_acceleration(law, crew, n_dims=2):
    flow, batch, velocities = setting(law, crew, n_dims)
    moved = 0.0
    for row in range(len(TIMES)):
        points, scene, own = points_of(flow, batch, velocities, row)
        expected = law.acceleration(
            batch.bodies, batch.positions[row], velocities[row], batch.times[row]
        )
        place = np.searchsorted(batch.bodies.receivers, own)
        found = np.moveaxis(flow.motion.acceleration(points), -1, 0)
        np.testing.assert_allclose(found, expected[scene[:, None], place], rtol=1e-12, atol=1e-13)
        moved += np.abs(expected).max()
    assert moved > 0


def check_slopes(law, crew, n_dims=2, step=1e-6):
    flow, batch, velocities = setting(law, crew, n_dims)
    motion, n = flow.motion, flow.n_state
    for row in range(len(TIMES)):
        points, _, _ = points_of(flow, batch, velocities, row)
        n_points = len(points.times)
        by_state, by_constant = motion.slopes(points)
        assert by_state.shape == (n_points, n // 2, n)
        flat = points.state.reshape(n, n_points)
        for column in range(n):
            ends = []
            for sign in (step, -step):
                moved = flat.copy()
                moved[column] += sign
                state = moved.reshape(points.state.shape)
                ends.append(motion.acceleration(replace(points, state=state)))
            slope = ((ends[0] - ends[1]) / (2 * step)).reshape(n // 2, n_points).T
            np.testing.assert_allclose(by_state[:, :, column], slope, rtol=1e-6, atol=1e-6)
        values = values_of(law)
        for column in range(len(values)):
            ends = []
            for sign in (step, -step):
                motion.set_constants(values + sign * np.eye(len(values))[column])
                ends.append(motion.acceleration(points))
            motion.set_constants(values)
            slope = ((ends[0] - ends[1]) / (2 * step)).reshape(n // 2, n_points).T
            np.testing.assert_allclose(by_constant[:, :, column], slope, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_accelerations_are_those_of_the_law(name):
    check_acceleration(*CASES[name])


@pytest.mark.parametrize("name", CASES)
def test_slopes_are_differences(name):
    check_slopes(*CASES[name])


SPACE = law_of(
    "c1 * m_i * down", "c2 * q_i * cross(v_i, e_z)", "c2 * cross(p_i - p_j, v_j)",
    n_dims=3, c1=9.8, c2=0.7,
)  # fmt: skip


@pytest.mark.parametrize("check", [check_acceleration, check_slopes])
def test_three_dimensions(check):
    check(SPACE, (body("a", 2.0, **CHARGES), body("b", 3.0, **CHARGES)), n_dims=3)


@pytest.mark.parametrize("check", [check_acceleration, check_slopes])
def test_properties_that_are_vectors(check):
    """A spin of the receiver, and one of a source."""
    law = law_of(
        "c1 * cross(spin_i, v_i)", "c2 * dot(spin_j, p_i - p_j) * spin_i",
        n_dims=3, vectors=("spin",), more=("spin",), c1=0.5, c2=2.0,
    )  # fmt: skip
    spins = [(0.3, -0.2, 0.9), (0.1, 0.8, -0.4)]
    crew = [body(n, 2.0, properties={"spin": s}) for n, s in zip("ab", spins, strict=True)]
    check(law, tuple(crew), n_dims=3)


def test_a_body_of_which_a_property_is_unknown_does_not_feel_the_force():
    law = law_of("c1 * q_i * perp(v_i)", "c2 * m_i * down", c1=0.7, c2=9.8)
    check_acceleration(law, (body("a", 2.0, **CHARGES), body("b", 3.0)))


def test_bodies_are_one_chain_only_where_a_force_passes_between_them():
    pair, field = CASES["pair"][0], CASES["field"][0]
    for law, count, n_moving in ((pair, 2, 3), (field, 6, 1)):
        chains = setting(law, TRIO)[0].chains
        assert (chains.n_chains, chains.n_moving) == (count, n_moving)


def test_conditions_are_asked_of_every_pair():
    law, crew = CASES["discs"]
    flow, batch, velocities = setting(law, crew)
    held = []
    for row in range(len(TIMES)):
        points, _, _ = points_of(flow, batch, velocities, row)
        mode = points.modes[0]
        for s, i, j in np.ndindex(2, 3, 2):
            other = flow.motion.others[i, j]
            gap = np.linalg.norm(batch.positions[row, s, i] - batch.positions[row, s, other])
            assert mode[0, i, j, s] == (gap < crew[i].radius + crew[other].radius)
            held.append(mode[0, i, j, s])
    assert 5 < sum(held) < 55


def test_the_sign_of_a_condition_without_a_change_is_that_of_its_margin():
    law = law_of("-c1 * sign(c3 * dot(v_i, e_x) - c2) * e_x", c1=1.0, c2=0.5, c3=1.0)
    flow, batch, velocities = setting(law, (body("a", 2.0),))
    for row in range(len(TIMES)):
        points, _, _ = points_of(flow, batch, velocities, row)
        speed = points.state[1, 0, 0]
        expected = -np.sign(speed - 0.5) / 2.0
        np.testing.assert_array_equal(flow.motion.acceleration(points)[0, 0], expected)
