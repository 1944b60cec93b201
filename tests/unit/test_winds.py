"""A medium that moves: found where declared drag acts against it, and told with its velocity."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.loop.proposers.pulsing import Pulsing
from bsp_gp.loop.proposers.winds import Winds
from bsp_gp.report.page import page_of
from tests.loop_views import view_of

DRAG, ROLL = 0.08, 0.15
UNITS = {"length": "m", "time": "s", "mass": "kg"}


def runs(wind=(0.0, 0.0), sigma=0.02):
    """Carts that roll out over a plain, each in another direction."""
    frames, t = {}, np.linspace(0.0, 6.0, 60)
    for k in range(6):
        angle = 1.1 * k

        def rate(_, state):
            v = state[2:]
            past = v - np.asarray(wind)
            return [*v, *(-DRAG * np.linalg.norm(past) * past - ROLL * v / np.linalg.norm(v))]

        start = [0.0, 0.0, 5.0 * np.cos(angle), 5.0 * np.sin(angle)]
        places = solve_ivp(rate, (0, 6), start, t_eval=t, rtol=1e-9, atol=1e-9).y[:2]
        places = places + sigma * np.random.default_rng(k).standard_normal(places.shape)
        frames[f"r{k}"] = pd.DataFrame({"t": t, "x": places[0], "y": places[1]})
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    return bsp_gp.Dataset.from_frames(frames, bodies, units=UNITS, train=list(frames)[:-1])


LAWS = ("-c * norm(v_i) * v_i", "-f * m_i * normalize(v_i)")


def test_a_wind_is_proposed_with_its_way_and_in_still_air_it_promises_little():
    (found,) = _winds(view_of(runs((0.4, -0.2)), *LAWS))
    assert found.promise > 20.0
    assert found.starts["wind_x1"] > 0 > found.starts["wind_y1"]  # far off: drag gives way too
    assert all(p.promise < 5.0 for p in Winds().propose(view_of(runs(), *LAWS)).proposals)


def _winds(view):
    return [p for p in Winds().propose(view).proposals if p.code == "wind"]


def test_friction_of_constant_size_knows_no_wind():
    assert not _winds(view_of(runs(), LAWS[1]))


def thrown(belt, friction=2.0, sigma=1.7e-3):
    """Discs that are thrown onto a belt and come to rest on it."""
    frames, t = {}, np.linspace(0.0, 1.2, 73)
    for k in range(5):
        angle, rng = 1.3 * k + 0.2, np.random.default_rng(k)

        def rate(_, state):
            past = state[2:] - np.asarray(belt)
            return [*state[2:], *(-friction * past / np.hypot(np.linalg.norm(past), 1e-3))]

        start = [0.0, 0.0, 1.1 * np.cos(angle), 1.1 * np.sin(angle)]
        places = solve_ivp(
            rate, (0, 1.2), start, t_eval=t, method="LSODA", rtol=1e-8, atol=1e-9
        ).y[:2]  # fmt: skip
        places = places + sigma * rng.standard_normal(places.shape)
        frames[f"r{k}"] = pd.DataFrame({"t": t, "x": places[0], "y": places[1]})
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    return bsp_gp.Dataset.from_frames(frames, bodies, units=UNITS, train=list(frames)[:-1])


def test_a_belt_is_proposed_with_its_velocity_and_a_floor_at_rest_is_none():
    (found,) = Winds().propose(view_of(thrown((0.45, 0.0)), "-c * normalize(v_i)")).proposals
    assert found.code == "belt" and found.promise > 50.0
    assert found.starts["ground_x1"] == pytest.approx(0.45, abs=0.1)
    assert found.starts["ground_y1"] == pytest.approx(0.0, abs=0.1)
    rest = Winds().propose(view_of(thrown((0.0, 0.0)), "-c * normalize(v_i)")).proposals
    assert all(p.promise < 5.0 for p in rest)


@pytest.mark.slow
def test_a_belt_is_adopted_with_its_velocity():
    report = bsp_gp.close_loop(thrown((0.45, 0.0)), "-c * normalize(v_i)", rng=0, n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert found["ground_x1"].value == pytest.approx(0.45, abs=0.02)
    assert found["ground_y1"].value == pytest.approx(0.0, abs=0.02)
    assert found["c"].value == pytest.approx(2.0, rel=0.03)
    assert page_of(report).rounds[0].effect.name.startswith("a ground that moves under the bodies")


def test_a_brake_that_pulses_never_drives():
    for proposal in Pulsing().propose(view_of(runs(), *LAWS)).proposals:
        bounds = {name: b for name, b in proposal.bounds.items() if name[0] in "ab"}
        assert list(bounds.values()) == [(-1.0, 1.0)] * 2


@pytest.mark.slow
def test_a_wind_is_adopted_with_its_velocity():
    report = bsp_gp.close_loop(runs((0.4, -0.2)), LAWS, rng=0, n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert found["wind_x1"].value == pytest.approx(0.4, abs=0.05)
    assert found["wind_y1"].value == pytest.approx(-0.2, abs=0.05)
    assert found["wind_x1"].unit == "m/s"
    assert found["c"].value == pytest.approx(DRAG, rel=0.05)
    name = page_of(report).rounds[0].effect.name
    assert name.startswith("a medium that moves (a wind, a current), (0.") and name.endswith("m/s")


def test_a_wind_along_the_one_axis_of_motion():
    t, tracks = np.linspace(0.0, 6.0, 60), {}
    for k, sign in enumerate((1, -1, 1, -1)):

        def rate(_, state):
            past = state[1] - 0.4
            return [state[1], -DRAG * abs(past) * past]

        x = solve_ivp(rate, (0, 6), [0.0, sign * (4.0 + k)], t_eval=t, rtol=1e-9).y[0]
        noise = 0.02 * np.random.default_rng(k).standard_normal(60)
        tracks[f"r{k}"] = pd.DataFrame({"t": t, "x": x + noise})
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    data = bsp_gp.Dataset.from_frames(tracks, bodies, units=UNITS)
    (found,) = _winds(view_of(data, LAWS[0]))
    assert set(found.starts) == {"wind_x1"}  # nothing is told of another axis
    assert found.promise > 20.0


def kicked_balls(rng):
    """Three kicks of a ball in a wind, nothing declared, in space."""
    times, wind, rows = np.arange(60) / 30, np.array([-3.0, 2.0, 0.0]), []
    for kick in range(3):
        first = [0, 0, 0.2, rng.uniform(15, 22), rng.uniform(-3, 3), rng.uniform(8, 12)]

        def rate(_, s):
            past = s[3:] - wind
            return [*s[3:], *([0, 0, -9.81] - 0.014 * np.linalg.norm(past) * past)]

        path = solve_ivp(rate, (0, times[-1]), first, t_eval=times, rtol=1e-9).y[:3]
        path = path + 0.01 * rng.standard_normal(path.shape)
        rows.append(pd.DataFrame(dict(zip("xyz", path, strict=True))).assign(t=times, scene=kick))
    return bsp_gp.Dataset.from_frames(pd.concat(rows), units={"length": "m", "time": "s"})


@pytest.mark.slow
def test_a_drag_in_a_wind_is_found_where_nothing_is_declared():
    """It was told as a spring to a point four kilometres below, and a camera that drifts."""
    report = bsp_gp.close_loop(
        kicked_balls(np.random.default_rng(1)), (), rng=np.random.default_rng(0), n_bootstrap=0
    )
    assert report.verdict == "effect adopted"
    assert "drag in a wind" in bsp_gp.summary_text(report)
    found = {c.name: c for c in report.constants}
    assert found["u_x1"].value == pytest.approx(-3.0, abs=0.4)
    assert found["u_y1"].value == pytest.approx(2.0, abs=0.2)


def skydiver(rng):
    """A fall from 4 km, seen every second, in air that thins by a factor of e in 8.5 km."""
    times = np.arange(60.0)
    height = solve_ivp(
        lambda _, s: [s[1], -9.81 + 3.4e-3 * np.exp(-s[0] / 8500) * s[1] ** 2],
        (0, times[-1]), [4000.0, 0.0], t_eval=times, rtol=1e-9,
    ).y[0]  # fmt: skip
    frame = pd.DataFrame({"t": times, "y": height + 2.0 * rng.standard_normal(60)})
    return bsp_gp.Dataset.from_frames(
        frame, units={"length": "m", "time": "s"}, properties={"mass": "1[kg]"}
    )


@pytest.mark.slow
def test_air_thins_with_the_height():
    """The first 14 s were left out as a hand's, and the rest told as a push upwards."""
    report = bsp_gp.close_loop(skydiver(np.random.default_rng(0)), (), rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    found = {c.name: c for c in report.constants}
    assert found["D1"].value == pytest.approx(8500, rel=0.15)
    assert found["c2"].value == pytest.approx(-9.81, abs=0.5)
    assert "linear in speed" not in bsp_gp.summary_text(report)


@pytest.mark.slow
def test_what_sinks_at_a_steady_speed_soon_falls_by_its_weight():
    """A few rows tell of it: a force that fades with a length had been told."""
    times = np.arange(0.0, 1.5, 0.02)
    drop = 9.81 / 13 * (times - (1 - np.exp(-13 * times)) / 13)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(times))
    data = bsp_gp.Dataset.from_frames(
        pd.DataFrame({"t": times, "y": 1.2 - drop + noise}), units={"length": "m", "time": "s"},
        properties={"mass": "1[kg]"},
    )  # fmt: skip
    report = bsp_gp.close_loop(data, (), rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert "uniform push along y; drag" in bsp_gp.summary_text(report)
