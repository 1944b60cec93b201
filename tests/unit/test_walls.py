"""Floors and walls: bounces in the motion, in fits, and found in tracks."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import LawError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.jumps import jumps, nodes_between, scatter
from bsp_gp.fitting.parts.walls import read_wall
from bsp_gp.fitting.rolling import flow_of, roll
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.walls import Walls, jumps_in, walls_at
from bsp_gp.loop.turn import Turn
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from tests.bouncing import bounces, flights
from tests.loop_views import throws, view_of
from tests.planted import SI

WEIGHT = "-9.81 [m/s^2] * m_i * e_y"
WALL = {"floor": 0.03, "kept": 0.8, "along": 0.95}


def law_with(dataset, **values):
    law = read_law(dataset, [WEIGHT, "bounce(y_i > h, e, k, tilt)"])
    return law.with_constants({"h": 0.03, "e": 0.8, "k": 0.95, "tilt": 0.0, **values})


def rolled(dataset, law, first):
    (chains,) = build_chains(law, dataset.scenes, dataset.up, dataset.velocity)
    return roll(law, chains, first, np.full(chains.n_chains, 1e-7))


def start(velocity=0.0, height=1.2):
    state = np.zeros((2, 1, 2, 1))
    state[0, 0, :, 0], state[1, 0, 0, 0] = (0.1, height), velocity
    return state


def test_a_ball_bounces_as_its_parabolas_say():
    data = bounces(np.random.default_rng(0), n_rows=110, **WALL)
    track = rolled(data, law_with(data), start(0.4))[0, 0, :, :, 0].T
    exact = flights([0.1, 1.2], [0.4, 0.0], data.scenes[0].times, **WALL)
    assert track == pytest.approx(exact, abs=1e-6)


@pytest.mark.slow
def test_a_ball_comes_to_rest_on_the_floor():
    data = bounces(np.random.default_rng(0), n_rows=300, **WALL)
    track = rolled(data, law_with(data, e=0.5), start())[0, 0, 1, :, 0]
    assert np.isfinite(track).all()
    assert track[-100:] == pytest.approx(np.full(100, 0.03), abs=1e-4)
    assert track.min() > 0.03 - 2e-4


@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_derivatives_through_a_bounce_are_those_of_differences(tilt):
    data = bounces(np.random.default_rng(1), n_rows=60, sigma=0.0, **WALL)
    law = law_with(data, tilt=tilt).plus(read_law(data, ["c * norm(v_i) * m_i * v_i"]).terms[0],
                                         {"c": -0.2})  # fmt: skip
    names = [(name, "") for name in law.names]
    (chains,) = build_chains(law, data.scenes, data.up, data.velocity)
    flow = Flow(Motion(law, chains, names), np.full(1, 1e-10))
    values = np.array([law.constants[name] for name, _ in names])
    nodes = roll(law, chains, start(0.4, 0.9), np.full(1, 1e-9))
    flow.motion.set_constants(values)
    mesh = flow.quick_mesh(nodes)
    assert mesh.n_hits.sum() >= 1

    def ends(nodes, values):
        flow.motion.set_constants(values)
        return flow.run(nodes, mesh, slopes=False)[0].reshape(4, -1).T

    flow.motion.set_constants(values)
    found = flow.run(nodes, mesh)[1]
    step = 1e-6
    for k in range(4):
        moved = [nodes.copy(), nodes.copy()]
        for sign, own in zip((1, -1), moved, strict=True):
            own.reshape(4, -1)[k] += sign * step
        slope = (ends(moved[0], values) - ends(moved[1], values)) / (2 * step)
        assert found[:, :, k] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    for k in range(len(values)):
        change = step * np.eye(len(values))[k]
        slope = (ends(nodes, values + change) - ends(nodes, values - change)) / (2 * step)
        assert found[:, :, 4 + k] == pytest.approx(slope, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_declared_floor_is_fitted_with_its_errors(seed):
    data = bounces(np.random.default_rng(seed), **WALL)
    found = fit(Hypothesis.from_laws(data, [WEIGHT, "bounce(y_i > h, e, k)"]), data)
    assert found.status == "converged"
    assert found.chi2_red == pytest.approx(1.0, abs=4 * np.sqrt(2 / found.n_rows))
    off = (found.values - [0.03, 0.8, 0.95, 0.0]) / found.errors
    assert np.abs(off).max() < 4


def test_rows_beside_a_contact_are_on_the_right_side_of_it():
    """A node just behind the floor that a ball had left in its own past fitted as well."""
    for seed in range(4):
        data = bounces(np.random.default_rng(10 + seed), dt=1 / 30, n_rows=75, **WALL)
        found = fit(Hypothesis.from_laws(data, [WEIGHT, "bounce(y_i > h, e, k)"]), data)
        places = found.nodes[0][0, 0, 1] - found.values[0]
        assert places.min() > -1e-3 * 0.002 - 3 * found.errors[0]


def test_jumps_are_found_where_bodies_are_hit_and_nowhere_else():
    data = bounces(np.random.default_rng(2), **WALL)
    scene = data.scenes[0]
    found = jumps(scene.times, scene.positions[:, 0])
    assert len(found) >= 3
    for jump in found:
        assert jump.place[1] == pytest.approx(0.03, abs=0.01)
        assert -jump.after[1] / jump.before[1] == pytest.approx(0.8, abs=0.05)
    t = np.linspace(0, 8, 400)
    orbit = np.stack([np.cos(t * 2), 0.5 * np.sin(t * 2)], axis=1)
    orbit += 0.002 * np.random.default_rng(0).standard_normal(orbit.shape)
    assert jumps(t, orbit) == []


def test_turns_of_a_wide_swing_are_no_jumps():
    """A bead on a hoop that turns, from 75 degrees, was held between two walls."""
    t = np.arange(0, 3, 0.025)

    def pull(_, s):
        return [s[1], np.sin(s[0]) * (110.25 * np.cos(s[0]) - 81.75) - 0.4 * s[1]]

    track = solve_ivp(pull, (0, 3), [1.3, 0], t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    for seed in range(5):
        noise = 0.0175 * np.random.default_rng(seed).standard_normal(len(t))
        assert jumps(t, (track + noise)[:, None]) == []


def test_turns_of_a_swing_that_has_few_rows_are_no_jumps():
    """Two carts between springs, six rows a turn, were hit by walls at three of them."""
    t = np.arange(553) * 0.03
    track = 0.02 * np.cos(2 * np.pi * t / 0.18) * np.cos(2 * np.pi * t / 11.0)
    for seed in range(3):
        noise = 0.002 * np.random.default_rng(seed).standard_normal(len(t))
        assert jumps(t, (track + noise)[:, None]) == []


def test_bodies_are_fast_where_they_meet_a_wall():
    """A tracker that trembles where a piston turns back had been eight hits of a wall."""
    t = np.arange(600) / 120.0
    track = -np.cos(2 * np.pi * t / 0.39) * np.exp(-0.1 * t)
    for time in (0.39, 0.78, 1.17, 1.56):  # a row or two that lag behind
        track[np.abs(t - time) < 0.012] += 0.012
    scene = Scene("1", t, np.stack([0 * t, track], axis=1)[:, None], (Entity("piston"),))
    data = Dataset("tremble", (scene,))
    assert jumps_in(data.scenes)[0]
    assert walls_at(jumps_in(data.scenes)[0], data) == {}


def test_states_are_read_off_one_side_of_a_jump():
    data = bounces(np.random.default_rng(3), sigma=1e-5, **WALL)
    law = law_with(data)
    (chains,) = build_chains(law, data.scenes, data.up, data.velocity)
    exact = roll(law, chains, start(0.4, data.scenes[0].positions[0, 0, 1]), np.full(1, 1e-8))
    nodes = nodes_between(chains, np.zeros_like(exact), {})
    early = chains.times[:, 0] < 1.0
    assert nodes[1, 0, 1, early, 0] == pytest.approx(exact[1, 0, 1, early, 0], abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6])
def test_one_bounce_is_enough_however_smooth_a_track_is(seed):
    """Noise with a memory would take up the whole of it: nothing was said to be missing."""
    data = bounces(np.random.default_rng(seed), n_rows=45, dt=1 / 30, sigma=0.006, kept=0.7,
                   noise=False)  # fmt: skip
    report = bsp_gp.close_loop(data, [], rng=np.random.default_rng(0), n_bootstrap=0)
    assert [done.effect.code for done in report.rounds if done.adopted] == ["bounce"]
    found = {c.name: c for c in report.constants}
    weight = found["c1"]
    assert abs(weight.value + 9.81) < 2 * (weight.high - weight.low)
    assert abs(found["e1"].value - 0.7) < 0.02


def test_nothing_is_proposed_where_nothing_bounces():
    family = Walls().propose(view_of(throws(np.random.default_rng(0))))
    assert family.proposals == ()


@pytest.mark.parametrize("damping", [0.0, 0.1], ids=["whole", "but for a damping"])
def test_turns_that_the_law_explains_are_no_walls(damping):
    rng, times = np.random.default_rng(4), np.arange(60) * 0.05
    along = 0.3 * np.exp(-damping * times) * np.cos(9.0 * times)
    places = np.stack([along, np.zeros(60)], axis=1)[:, None]
    places[..., 0] += 0.002 * rng.standard_normal((60, 1))
    scene = Scene("1", times, places, (Entity("bob"),))
    assert len(jumps(times, places[:, 0])) > 2
    dataset = Dataset("spring", (scene,), units=SI)
    law = "k * (origin - p_i)"
    assert Walls().propose(view_of(dataset, law)).proposals == ()


def test_a_wall_that_nothing_meets_is_no_cause():
    data = throws(np.random.default_rng(0))
    known = Hypothesis.from_laws(data, ["-g * m_i * e_y"])
    turn = SimpleNamespace(hypotheses={0: known})
    proposal = SimpleNamespace(hypothesis=known + read_wall(data, "bounce(y_i > h, e)"))

    def is_idle(*errors, proposal=proposal):
        parameters = (("g", ""), ("h", ""), ("e", ""))
        found = SimpleNamespace(is_failed=False, parameters=parameters, errors=np.array(errors))
        return Turn._is_idle(turn, proposal, found)

    assert is_idle(0.1, np.inf, np.inf)
    assert not is_idle(0.1, 0.01, np.inf)
    assert not is_idle(np.inf, 0.01, 0.1)
    memory = SimpleNamespace(parameters=(SimpleNamespace(name="memory"),))
    noise = SimpleNamespace(hypothesis=SimpleNamespace(parts=(*known.parts, memory)))
    assert not is_idle(0.1, 0.1, 0.1, proposal=noise)  # its numbers are none of the fit's


@pytest.mark.slow
def test_a_bouncing_ball_is_told_with_its_weight():
    data = bounces(np.random.default_rng(5), noise=False, **WALL)
    report = close_loop(data, "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "bounce"
    true = {"h1": 0.03, "e1": 0.8, "k1": 0.95, "c1": -9.81}
    for constant in report.constants:
        if constant.name in true:
            width = constant.high - constant.low
            assert constant.low - width < true[constant.name] < constant.high + width


@pytest.mark.slow
def test_a_ball_that_comes_to_rest_is_told_by_its_flights():
    data = bounces(np.random.default_rng(6), noise=False, n_rows=200, floor=0.03, kept=0.6)
    report = close_loop(data, "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert "ball lies still[0, " in report.rounds[0].effect.name
    values = {c.name: c.value for c in report.constants}
    assert values["e1"] == pytest.approx(0.6, abs=0.01)
    assert values["c1"] == pytest.approx(-9.81, abs=0.1)


def cart(seed):
    """A cart with linear drag between two bumpers, by the exact solution between bounces."""
    rng, c, times = np.random.default_rng(seed), 0.08, np.arange(300) / 30
    x, v, t0, track = 0.3, 0.6, 0.0, []
    for t in times:
        while True:
            room = (1.2 - x) if v > 0 else -x
            hit = -np.log1p(-room * c / v) / c if abs(v) / c > abs(room) else np.inf
            if t - t0 < hit:
                break
            x, v, t0 = x + room, -0.9 * v * np.exp(-c * hit), t0 + hit
        track.append(x + v * (1 - np.exp(-c * (t - t0))) / c)
    seen = np.array(track) + 0.001 * rng.standard_normal(len(times))
    places = np.stack([seen, np.zeros_like(seen)], axis=1)
    return places, times


@pytest.mark.slow
def test_a_cart_between_two_bumpers_is_told_with_its_drag():
    places, times = cart(1)
    scene = Scene("run", times, places[:, None], (Entity("cart", properties={"mass": 1.0}),))
    report = close_loop(Dataset("cart", (scene,), units=SI), "nothing", rng=0, n_bootstrap=0)
    values = {c.name: c.value for c in report.constants}
    assert sorted(values) == ["c1", "e1", "e2", "h1", "h2"]
    assert sorted([values["h1"], values["h2"]]) == pytest.approx([0.0, 1.2], abs=0.003)
    assert values["e1"] == pytest.approx(0.9, abs=0.01)
    assert values["c1"] == pytest.approx(-0.08, abs=0.003)


@pytest.mark.parametrize(
    "text", ["bounce(y_i)", "bounce(z_i > h, e)", "bounce(y_i > h, 0.8)", "bounce(y_i = h)",
             "bounce(y_i > 3x, e)", "bounce(y_i > h, a, b, c, d)", "bounce(y_i > 3 [s], e)",
             "bounce(y_i > 3 [m, e)", "bounce(y_i > 2*3 [m], e)"],
)  # fmt: skip
def test_a_wall_that_says_no_place_is_refused_with_what_is_right(text):
    data = bounces(np.random.default_rng(0))
    with pytest.raises(LawError, match="bounce"):
        read_law(data, [text])


@pytest.mark.parametrize("place, at", [("0.2", 0.2), ("-25 [cm]", -0.25), ("0.2[m]", 0.2)])
def test_the_place_of_a_wall_may_have_a_unit(place, at):
    data = bounces(np.random.default_rng(0))
    (wall,) = read_law(data, [f"bounce(y_i > {place}, e)"]).frame
    assert wall.parameters[0].start == pytest.approx(at)


def test_a_wall_is_written_as_it_is_typed():
    data = bounces(np.random.default_rng(0))
    law = read_law(data, ["bounce(y_i > h, e, k, tilt)", WEIGHT])
    assert law.text(digits=False).endswith("bounce(y_i > h, e, k, tilt)")
    again = read_law(data, [law.frame[0].describe()])
    assert again.frame[0].names == law.frame[0].names
    assert flow_of(law_with(data), build_chains(law, data.scenes, None, None)[0],
                   np.full(1, 1e-6)).motion.walls is not None  # fmt: skip


def test_what_is_kept_along_a_floor_is_not_read_off_noise():
    """A ball that fell straight began with none of it kept, and its fit came to no end."""
    times = np.arange(219) / 120
    wall = {"floor": 0.09, "kept": 0.67, "along": 0.8}
    rng = np.random.default_rng(6)
    seen = flights([0.0, 1.3], [0.0, 0.0], times, **wall)
    seen = seen + 0.0027 * rng.standard_normal(seen.shape)
    scene = Scene("0", times, seen[:, None], (Entity("ball", properties={"mass": 1.0}),))
    family = Walls().propose(view_of(Dataset("ball", (scene,), units=SI), "nothing"))
    found = family.proposals[0].hypothesis.parameters
    starts = {p.name: p.start for p in found}
    assert starts["k1"] == 1.0
    assert starts["e1"] == pytest.approx(0.67, abs=0.03)



def drops(seed, sigma=0.025):
    """A ball dropped four times, its height alone, read off with errors as large as it falls."""
    rng, t, scenes = np.random.default_rng(seed), np.arange(100) / 60, []
    for k in range(4):
        heights = flights([rng.uniform(0.9, 1.4)], [0.0], t, kept=0.8)
        heights = np.column_stack([np.zeros(100), heights[:, 0] + sigma * rng.standard_normal(100)])
        scenes.append(Scene(str(k), t, heights[:, None], (Entity("ball"),)))
    return Dataset("drops", tuple(scenes), units=SI)


def test_bounces_that_errors_hide_show_by_many_rows_and_where_a_wall_is_known():
    data = drops(8)
    alone, known = (
        sum(len(jumps(s.times, s.positions[:, 0], levels)) for s in data.scenes)
        for levels in ({}, {(1, 1): 0.0})
    )
    assert 2 <= alone < known
    t = data.scenes[0].times
    swing = np.random.default_rng(9).normal(np.cos(5 * t), 0.025)[:, None]
    assert jumps(t, swing, {(0, 1): -1.0}) == []


def test_a_ball_that_bounces_in_noise_is_told():
    report = close_loop(drops(8), WEIGHT, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "bounce"
    (kept,) = (c for c in report.constants if c.name == "e1")
    assert kept.value == pytest.approx(0.8, abs=1.5 * (kept.high - kept.low))
    assert report.rounds[-1].reason == "not_significant"


@pytest.mark.slow
def test_a_puck_in_a_box_meets_four_smooth_walls():
    """With all numbers of four walls no fit ended, and a power of a distance was told instead."""
    step, place, speed, places = 1 / 6000, np.array([0.3, 0.4]), np.array([0.9, 0.65]), []
    for k in range(24_000):
        if k % 100 == 0:
            places.append(place.copy())
        speed = speed * (1 - 0.05 * step)
        place = place + speed * step
        for axis, end in enumerate((1.2, 0.8)):
            beyond = place[axis] - np.clip(place[axis], 0.0, end)
            if beyond * speed[axis] > 0:
                speed[axis] *= -0.9
    places = np.array(places) + 1e-3 * np.random.default_rng(2).standard_normal((240, 2))
    data = Dataset.from_frames(
        pd.DataFrame({"t": np.arange(240) / 60, "x": places[:, 0], "y": places[:, 1]}),
        units={"length": "m", "time": "s"},
    )
    report = close_loop(data, (), rng=np.random.default_rng(0), n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "bounce"
    found = sorted(c.value for c in report.constants if c.name.startswith("h"))
    np.testing.assert_allclose(found, [0.0, 0.0, 0.8, 1.2], atol=3e-3)


def test_a_run_in_which_a_body_only_stands_says_nothing_of_walls():
    """Its places are exact, and no error of a force follows from them."""
    data = bounces(np.random.default_rng(3), n_scenes=2, n_rows=110, **WALL)
    still = Scene("still", data.scenes[0].times, np.full((110, 1, 2), 0.5), (Entity("ball"),))
    data = Dataset("runs", (*data.scenes, still), noise=(0.002, 0.002), units=SI)
    proposals = Walls().propose(view_of(data, "0 [N] * e_x")).proposals
    assert proposals and all(np.isfinite(proposal.gain) for proposal in proposals)
    assert scatter(still.positions[:, 0]) == 0.0


def test_a_row_that_is_off_in_many_turns_is_no_wall():
    """Of 252 turns of a pendulum one was a bounce, and each side was followed as a flight."""
    t = np.arange(2000) / 50
    x = 0.4 * np.cos(3.0 * t) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    body = Entity("bob", properties={"mass": 1.0})
    data = Dataset("swing", (Scene("1", t, np.stack([x, 0 * x], axis=1)[:, None], (body,)),))
    side = SimpleNamespace(
        place=np.array([-0.4, 0.0]), before=np.array([-1.0, 0.0]), after=np.array([0.8, 0.0]),
        error=1e-3,
    )  # fmt: skip
    assert walls_at([side], data) == {}
    assert walls_at([side] * 12, data)
