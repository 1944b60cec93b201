"""Constraints: read, kept by tracks, with exact derivatives, and fitted."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.errors import LawError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.parts.constraints import read_constraint
from bsp_gp.fitting.response import respond
from bsp_gp.fitting.rolling import roll
from bsp_gp.fitting.starts import first_nodes
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from tests.swings import LENGTH, PIVOT, ROD, WEIGHT, G, bob, swing


def double_pendulum(t, lengths=(0.5, 0.4), masses=(0.3, 0.2), start=(1.2, 0.5, 0.0, 0.0)):
    """Places of both bobs by the mass matrix, (T, 2, 2), and their velocities at first."""
    (a, b), (m, k) = lengths, masses

    def rate(_, z):
        one, two, p, q = z
        d = one - two
        matrix = [[(m + k) * a * a, k * a * b * np.cos(d)], [k * a * b * np.cos(d), k * b * b]]
        right = [
            -k * a * b * np.sin(d) * q * q - (m + k) * G * a * np.sin(one),
            k * a * b * np.sin(d) * p * p - k * G * b * np.sin(two),
        ]
        return [p, q, *np.linalg.solve(matrix, right)]

    angles = solve_ivp(rate, (0, t[-1]), start, t_eval=t, rtol=1e-11, atol=1e-12).y[:2]
    first = a * np.stack([np.sin(angles[0]), -np.cos(angles[0])], axis=1)
    second = first + b * np.stack([np.sin(angles[1]), -np.cos(angles[1])], axis=1)
    return np.stack([first, second], axis=1)


def two_bobs(t, places, **entities):
    frame = pd.concat([
        pd.DataFrame({"t": t, "entity": name, "x": places[:, k, 0], "y": places[:, k, 1]})
        for k, name in enumerate(("upper", "lower"))
    ])  # fmt: skip
    crew = pd.DataFrame({"entity": ["upper", "lower"], **entities})
    return bsp_gp.Dataset.from_frames(
        frame, crew, units={"length": "m", "time": "s", "mass": "kg"}, up="y"
    )


def test_two_rods_move_as_a_double_pendulum():
    t = np.arange(100) * 0.02
    places = double_pendulum(t)
    data = two_bobs(t, places, mass=[0.3, 0.2])
    law = read_law(
        data, [WEIGHT, "norm(p_upper - (0, 0)) = 0.5", "norm(p_lower - p_upper) = 0.4"]
    )
    (chains,) = build_chains(law, data.scenes, data.up)
    assert chains.n_moving == 2  # a rod couples them
    first = np.stack([places[0], np.zeros((2, 2))])[..., None]
    nodes = roll(law, chains, first, np.array([1e-9]))
    assert np.abs(np.moveaxis(nodes[0, ..., 0], -1, 0) - places).max() < 1e-6


def test_a_spherical_pendulum_keeps_its_length_and_energy():
    t = np.arange(80) * 0.02
    turn = np.stack([0.3 * np.cos(t), 0.3 * np.sin(t), -0.5 + 0 * t], axis=1)
    frame = pd.DataFrame(dict(zip("txyz", (t, *turn.T), strict=True)))
    data = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"}, up="z")
    law = read_law(data, [WEIGHT, "norm(p_i - (0, 0, 0)) = 0.5830951894845300"])
    (chains,) = build_chains(law, data.scenes, data.up)
    first = np.array([[[0.3, 0.0, -0.5]], [[0.0, 1.1, 0.0]]])[..., None]
    nodes = roll(law, chains, first, np.array([1e-10]))[:, 0, :, :, 0]
    assert np.abs(np.linalg.norm(nodes[0], axis=0) - 0.58309518948453).max() < 1e-9
    energy = np.square(nodes[1]).sum(axis=0) / 2 + G * nodes[0, 2]
    assert np.ptp(energy) < 1e-7


@pytest.mark.parametrize("drag", ["-c * m_i * v_i", "-c * m_i * normalize(v_i)"])
def test_derivatives_are_exact_also_across_a_stop(drag):
    data = bob(lambda v: -0.1 * np.sign(v), n=40)
    law = read_law(data, [WEIGHT, "norm(p_i - (0.02, 1.61)) = L", drag])
    (chains,) = build_chains(law, data.scenes, data.up)
    motion = Motion(law, chains, [("L", ""), ("c", "")])
    flow, values = Flow(motion, np.array([1e-12])), np.array([LENGTH, 0.1])
    motion.set_constants(values)
    nodes = flow.held(first_nodes(chains))
    _, moved = flow.run(nodes, flow.mesh(nodes))
    kept = flow.tangent(nodes, flow.row, flow.chain)
    total = moved[:, :, :4] @ kept
    total[:, :, 4:] += moved[:, :, 4:]

    def ends(column, by):
        near, constants = nodes.copy(), values.copy()
        if column < 4:
            near.reshape(4, *near.shape[3:])[column] += by
        else:
            constants[column - 4] += by
        motion.set_constants(constants)
        near = flow.held(near)
        return flow.run(near, flow.mesh(near), slopes=False)[0].reshape(4, -1).T

    for column in range(6):
        measured = (ends(column, 1e-6) - ends(column, -1e-6)) / 2e-6
        np.testing.assert_allclose(total[:, :, column], measured, rtol=1e-4, atol=1e-4)


RODS = ("norm(p_i - (0.02, 1.61)) = L", "norm(p_i - (0.02 [m] + a * t, 1.61 [m])) = L",
        "2 * x_i + y_i = L")  # fmt: skip


@pytest.mark.parametrize("constraint", RODS)
@pytest.mark.parametrize(
    "forces",
    [(), (WEIGHT, "-c * m_i * v_i"), (WEIGHT, "-c * m_i * normalize(v_i)"), ("c * t * e_x",)],
)
def test_a_constraint_within_the_formulas_of_a_law_is_that_beside_them(
    constraint, forces, monkeypatch
):
    """Of one body, so that motion on it runs compiled; friction runs along it in both."""
    data = bob(n=30)
    law = read_law(data, [*forces, constraint])
    law = law.with_values([(name, "") for name in law.names], [0.3] * len(law.names))
    (chains,) = build_chains(law, data.scenes, data.up)
    parameters = [(name, "") for name in law.names]
    within = Motion(law, chains, parameters)
    monkeypatch.setattr("bsp_gp.physics.engine.motion.lone_constraint", lambda *_: None)
    beside = Motion(law, chains, parameters)
    assert within.is_folded and not beside.is_folded
    nodes, found = first_nodes(chains), []
    row, chain = np.nonzero(np.isfinite(chains.times))
    for motion in (within, beside):
        motion.set_constants(np.array([law.constants[name] for name in law.names]))
        flow = Flow(motion, np.array([1e-12]))
        held = flow.held(nodes)
        points = flow.points(held[..., row, chain], chains.times[row, chain], chain)
        found.append((motion.acceleration(points), *motion.slopes(points)))
    for one, other in zip(*found, strict=True):
        scale = max(np.abs(other).max(), 1.0)
        np.testing.assert_allclose(one, other, atol=1e-9 * scale)


def test_a_force_that_a_rod_takes_up_whole_stays_beside_the_formulas():
    """What is left of it is rounding, which must not pass for an influence."""
    data = bob(n=30)
    law = read_law(data, [WEIGHT, "c * (p_i - (0.02 [m] * e_x + 1.61 [m] * e_y) - origin)", ROD])
    (chains,) = build_chains(law, data.scenes, data.up)
    motion = Motion(law, chains, [("c", "")])
    assert not motion.is_folded
    motion.set_constants(np.array([2.0]))
    flow = Flow(motion, np.array([1e-12]))
    row, chain = np.nonzero(np.isfinite(chains.times))
    held = flow.held(first_nodes(chains))[..., row, chain]
    assert not motion.slopes(flow.points(held, chains.times[row, chain], chain))[1].any()


def test_derivatives_of_a_body_that_has_another_place_in_every_scene_and_is_not_in_all():
    t, rng = np.arange(6) * 0.05, np.random.default_rng(0)
    crews = {"1": ("bob", "free"), "2": ("free", "bob"), "3": ("free", "lone")}
    rows = [
        pd.DataFrame({"scene": scene, "t": t, "entity": name, "x": at + 0.3 * t, "y": 0.2 - t * t})
        for scene, names in crews.items()
        for at, name in zip(rng.uniform(0.3, 0.9, 2), names, strict=True)
    ]  # fmt: skip
    crew = pd.DataFrame({"entity": ["bob", "free", "lone"], "mass": [0.2, 0.3, 0.4]})
    data = bsp_gp.Dataset.from_frames(
        pd.concat(rows), crew, units={"length": "m", "time": "s", "mass": "kg"}, up="y"
    )
    law = read_law(data, [WEIGHT, "-k * (p_i - p_j)", "norm(p_bob - (0, a)) = L"])
    (chains,) = build_chains(law, data.scenes, data.up)
    motion = Motion(law, chains, [("L", ""), ("a", ""), ("k", "")])
    values = np.array([0.7, 0.1, 0.8])
    motion.set_constants(values)
    flow = Flow(motion, np.full(chains.n_chains, 1e-12))
    row, chain = np.nonzero(np.isfinite(chains.times))
    state = first_nodes(chains)[..., row, chain]

    def asked(state):
        return motion.acceleration(flow.points(state, chains.times[row, chain], chain))

    by_state, by_constant = motion.slopes(flow.points(state, chains.times[row, chain], chain))
    for column in range(8):
        change = np.zeros((8, 1))
        change[column] = 1e-6
        change = change.reshape(2, 2, 2, 1)
        measured = (asked(state + change) - asked(state - change)).reshape(4, -1).T / 2e-6
        np.testing.assert_allclose(by_state[:, :, column], measured, rtol=1e-5, atol=1e-6)
    for column in range(3):
        two = []
        for sign in (1, -1):
            motion.set_constants(values + sign * 1e-6 * np.eye(3)[column])
            two.append(asked(state).reshape(4, -1).T)
        np.testing.assert_allclose(
            by_constant[:, :, column], (two[0] - two[1]) / 2e-6, rtol=1e-5, atol=1e-6
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "force"),
    [
        ("-c * m_i * v_i", lambda v: -0.15 * v),
        ("-c * m_i * normalize(v_i)", lambda v: -0.15 * np.tanh(v / 1e-4)),
    ],
)
def test_rod_and_friction_are_fitted_together(law, force):
    found = bsp_gp.fit_law(bob(force), [WEIGHT, "norm(p_i - (a, b)) = L", law])
    assert found.status == "converged"
    truth = {"a": PIVOT[0], "b": PIVOT[1], "L": LENGTH, "c": 0.15}
    for constant in found.constants:
        assert abs(constant.value - truth[constant.name]) < 3 * (constant.high - constant.low) / 2
    units = {c.name: c.unit for c in found.constants}
    assert units["L"] == units["a"] == "m"
    assert found.errors.rollout_rmse < 3e-3
    # A rod takes a place and a velocity from the two axes.
    assert found.n_free == 4 + 2


def test_beside_a_law_that_is_far_off_a_rod_still_takes_up_what_acts_along_it():
    data = replace(bob(lambda v: -0.15 * v, dt=1 / 30, sigma=2e-4), noise=(2e-4, 2e-4))
    found = fit(Hypothesis.from_laws(data, [WEIGHT, "norm(p_i - (a, b)) = L"]), data)
    assert found.chi2_red > 1e3  # friction was not declared
    left, _ = respond(found, data).left()
    # Two numbers of a row, of which the rod takes one up.
    assert len(left) < 1.1 * len(data.scenes[0].times)
    assert left @ left < found.chisqr


def test_units_of_the_data_are_those_of_bare_numbers():
    frame = swing()
    frame[["x", "y"]] *= 100
    data = bsp_gp.Dataset.from_frames(frame, units={"length": "cm", "time": "s"}, up="y")
    found = bsp_gp.fit_law(data, ["g * m_i * down", "norm(p_i - (2, 161)) = 80"])
    (g,) = found.constants
    assert g.unit.startswith("cm") or g.low < G < g.high
    assert found.status == "converged"


def test_an_incline_leaves_what_acts_along_it():
    t = np.arange(60) * 0.02
    slope = np.arctan(0.5)
    way = 0.5 * G * np.sin(slope) * t**2
    noise = 1e-3 * np.random.default_rng(1).standard_normal((2, 60))
    frame = pd.DataFrame({
        "t": t, "x": -np.cos(slope) * way + noise[0], "y": -np.sin(slope) * way + noise[1]
    })  # fmt: skip
    data = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"}, up="y")
    found = bsp_gp.fit_law(data, ["g * m_i * down", "y_i = 0.5 * x_i"])
    (g,) = found.constants
    assert abs(g.value - G) < 3 * (g.high - g.low) / 2
    assert found.n_free == 3


def test_law_tells_its_constraints():
    law = Hypothesis.from_laws(bob(n=20), [WEIGHT, ROD]).law
    assert law.text().endswith(f"down, {ROD}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("norm(p_i - (0, 1)) >= 0.8", "a string"),
        ("norm(p_i - (0, 1, 2)) = 0.8", "2 coordinates"),
        ("norm(v_i) = 1 [m/s]", "place p_i"),
        ("p_i - (0, 1) = v_i", "constraint"),
        ("norm(p_i - (0, 1)) = 2 [s]", "constraint"),
        ("norm(p_i - (0, 1)) = L[scene]", "not there yet"),
        ("1 = 2 = 3", "one equation"),
    ],
)
def test_what_is_no_constraint_is_refused(text, said):
    with pytest.raises(LawError, match=said):
        read_constraint(bob(n=20), text)


def test_bodies_must_be_named_and_have_masses():
    t = np.arange(10) * 0.02
    places = double_pendulum(t)
    with pytest.raises(LawError, match="masses must be known"):
        read_constraint(two_bobs(t, places), "norm(p_i - p_j) = 0.4")
    data = two_bobs(t, places, mass=[0.3, 0.2])
    assert read_constraint(data, "norm(p_i - p_j) = 0.4").pairs == (("upper", "lower"),)
    with pytest.raises(LawError, match="name them"):
        third = pd.DataFrame({"t": t, "entity": "third", "x": t, "y": t})
        frame = pd.concat([third] + [
            pd.DataFrame({"t": t, "entity": n, "x": places[:, k, 0], "y": places[:, k, 1]})
            for k, n in enumerate(("upper", "lower"))
        ])  # fmt: skip
        more = bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"}, up="y")
        read_constraint(more, "norm(p_i - p_j) = 0.4")


def test_a_name_with_a_blank_is_typed_with_a_line():
    t = np.arange(10) * 0.02
    places = double_pendulum(t)
    frames = [
        pd.DataFrame({"t": t, "entity": name, "x": places[:, k, 0], "y": places[:, k, 1]})
        for k, name in enumerate(("mass A", "mass B"))
    ]
    data = bsp_gp.Dataset.from_frames(
        pd.concat(frames), units={"length": "m", "time": "s", "mass": "kg"},
        properties={"mass": 0.1},
    )  # fmt: skip
    pairs = read_constraint(data, "norm(p_mass_B - p_mass_A) = L").pairs
    assert pairs == (("mass B", "mass A"),)


def test_simulated_tracks_stay_on_the_rod():
    data = bob(n=60)
    made = bsp_gp.simulate_law(data, [WEIGHT, ROD])
    away = made.scenes[0].positions[:, 0] - np.array(PIVOT)
    assert np.abs(np.linalg.norm(away, axis=1) - LENGTH).max() < 1e-8


def on_a_string(t, state, drag, length=0.8):
    """Places of a bob on a string about the origin that goes slack, and loses what pulls it taut.

    Free flight and a swing at one distance in turn, per unit of mass.
    """
    state, begin, is_taut, out = np.array(state, float), 0.0, False, np.full((len(t), 2), np.nan)

    def pull(p, v):  # what keeps the distance; below zero it is slack
        return (np.array([0.0, -G]) - drag * v) @ p / length**2 + v @ v / length**2

    def rate(_, z):
        p, v = z[:2], z[2:]
        a = np.array([0.0, -G]) - drag * v
        return [*v, *(a - pull(p, v) * p if is_taut else a)]

    def ends(_, z):
        return pull(z[:2], z[2:]) if is_taut else length - np.hypot(*z[:2])

    ends.terminal, ends.direction = True, -1
    while begin < t[-1]:
        found = solve_ivp(rate, (begin, t[-1]), state, events=ends, rtol=1e-10, atol=1e-11,
                          dense_output=True)  # fmt: skip
        own = (t >= begin) & (t <= found.t[-1])
        out[own] = found.sol(t[own])[:2].T
        begin, state = found.t[-1], found.y[:, -1].copy()
        if not is_taut:
            way = state[:2] / np.hypot(*state[:2])
            state[2:] -= way * (way @ state[2:])
        is_taut = not is_taut and pull(state[:2], state[2:]) > 0
        state[:2] *= 1 - 1e-9 * (not is_taut)
    return out


def strung(states=((0.3, 0.2, 0.5, 1.0), (0.0, -0.8, 5.6, 0.0), (-0.4, 0.3, 1.2, 0.0))):
    t, rng = np.arange(120) / 60, np.random.default_rng(1)
    frames = []
    for k, state in enumerate(states, 1):
        p = on_a_string(t, state, 0.3) + (0.0, 1.0) + 1e-3 * rng.standard_normal((len(t), 2))
        frames.append(pd.DataFrame({"scene": str(k), "t": t, "x": p[:, 0], "y": p[:, 1]}))
    return bsp_gp.Dataset.from_frames(
        pd.concat(frames), units={"length": "m", "time": "s"}, up="y"
    )


def test_a_string_pulls_while_it_is_taut():
    data = strung(((0.3, 0.2, 0.5, 1.0),))
    law = read_law(data, [WEIGHT, "norm(p_i - (0, 1)) <= L"])
    assert not law.frame and 0.79 < law.constants["L"] < 0.81
    for place, speed, pulls in (((0.0, 0.3), (0, 0), False), ((0.0, 0.19), (0, 0), True)):
        p, v = np.array([[place]]), np.array([[speed]], float)
        (batch,) = stack(data.scenes, data.up)
        known = law.with_constants({"L": 0.8})
        force = known.acceleration(batch.bodies, p, v, np.zeros(1))[0, 0]
        assert (force[1] > -G + 1e-9) == pulls and force[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x_i <= 0.3", "a distance that is not exceeded"),
        ("norm(p_i - p_j) <= 0.3 <= 0.5", "a distance that is not exceeded"),
    ],
)
def test_what_is_no_string_is_refused(text, said):
    with pytest.raises(LawError, match=said):
        read_law(strung(((0.3, 0.2, 0.5, 1.0),)), [WEIGHT, text])


@pytest.mark.slow
@pytest.mark.parametrize("pivot", ["(0, 1)", "(a, b)"])
def test_a_string_that_goes_slack_is_fitted(pivot):
    laws = [WEIGHT, f"norm(p_i - {pivot}) <= L", "-c * m_i * v_i"]
    fitted = bsp_gp.fit_law(strung(), laws)
    found = {c.name: c for c in fitted.constants}
    assert fitted.status == "converged"
    # It stretches a little: by less than the places are off.
    assert found["L"].value == pytest.approx(0.8, abs=1e-3)
    assert found["c"].value == pytest.approx(0.3, abs=3 * (found["c"].high - found["c"].low))


@pytest.mark.slow
def test_a_string_that_goes_slack_is_a_law():
    """An elastic cord: free flight while it is slack."""
    stiffness, length, mass, sigma = 60.0, 0.5, 0.2, 1e-3

    def rate(_, z):
        far = np.hypot(*z[:2])
        pull = stiffness / mass * max(far - length, 0.0) / far
        return [z[2], z[3], -pull * z[0], -G - pull * z[1]]

    t = np.arange(80) * 0.02
    track = solve_ivp(
        rate, (0, t[-1]), [0.3, 0.1, 1.0, 2.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.002
    ).y[:2]  # fmt: skip
    assert 0.2 < (np.hypot(*track) > length).mean() < 0.8
    track = track + sigma * np.random.default_rng(0).standard_normal(track.shape)
    rows = [
        pd.DataFrame({"t": t, "entity": "bob", "x": track[0], "y": track[1]}),
        pd.DataFrame({"t": t, "entity": "hook", "x": 0.0, "y": 0.0}),
    ]
    bodies = pd.DataFrame({"entity": ["bob", "hook"], "mass": [mass, np.nan], "dynamic": [1, 0]})
    data = bsp_gp.Dataset.from_frames(
        pd.concat(rows), bodies, units={"length": "m", "time": "s", "mass": "kg"}, up="y"
    )
    cord = (
        "-K * (1 + sign(norm(p_i - p_j) - L)) * (norm(p_i - p_j) - L) * normalize(p_i - p_j)"
    )
    found = {c.name: c for c in bsp_gp.fit_law(data, [WEIGHT, cord]).constants}
    for name, true in (("K", stiffness / 2), ("L", length)):
        assert abs(found[name].value - true) < 2 * (found[name].high - found[name].low)
        assert found[name].high - found[name].low < 0.02 * true
