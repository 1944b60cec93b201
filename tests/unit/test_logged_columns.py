"""Columns beside the tracks that nobody named: which are asked, and what is found of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.data.logged import asked_of
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.report.naming import describe
from bsp_gp.units import DIMENSIONLESS

SIGMA = 5e-4


def _run(force, start, log, n=240, step=0.025):
    """Times, places and values of a log of a cart under a force of place, speed and log."""
    times = step * np.arange(n)
    found = solve_ivp(
        lambda t, s: (s[1], force(s[0], s[1], log(t))), (0, times[-1]), start, t_eval=times,
        rtol=1e-9, atol=1e-11, max_step=0.05,
    )  # fmt: skip
    return times, found.y[0], log(times)


def _table(rng, run, name, spread):
    times, places, values = run
    return pd.DataFrame({
        "t": times, "x": places + SIGMA * rng.standard_normal(len(times)),
        name: values + spread * rng.standard_normal(len(times)),
    })  # fmt: skip


def _made(name, force, logs, spread, starts=((0.0, 0.8), (0.1, 0.5), (-0.2, 1.0), (0.0, -0.7))):
    rng = np.random.default_rng(5)
    tables = {
        f"run{k}": _table(rng, _run(force, start, log), name, spread)
        for k, (start, log) in enumerate(zip(starts, logs, strict=True))
    }
    return bsp_gp.Dataset.from_frames(tables, units={"length": "m", "time": "s"})


def _waves(middle, size):
    """Logs that go up and down, another way in every run."""
    return [
        lambda t, k=k: middle + size * np.sin((0.6 + 0.35 * k) * t + k) for k in range(4)
    ]  # fmt: skip


def fan():
    """A cart that a fan pushes with the square of its speed, beside a known drag."""
    return _made(
        "Fan (1/s)", lambda x, v, w: -0.3 * v + 2e-3 * w**2, _waves(12.0, 6.0), 0.02,
        starts=((0.0, 0.1), (0.2, 0.0), (0.0, -0.3), (0.1, 0.2)),
    )  # fmt: skip


def warm():
    """A cart beside a thermometer that has nothing to do with it."""
    return _made("Temperature", lambda x, v, w: -0.3 * v, _waves(21.0, 1.5), 0.05)


def dense():
    """A drag that goes with a density."""
    return _made(
        "Density (kg/m^3)", lambda x, v, w: -0.25 * w * v * abs(v), _waves(1.2, 0.7), 0.005
    )


def _asked(frame, **settings):
    data = bsp_gp.Dataset.from_frames({"one": frame}, units={"length": "m", "time": "s"})
    return asked_of(data, **settings)


@pytest.fixture
def track():
    rng, t = np.random.default_rng(3), 0.02 * np.arange(300)
    x = np.sin(2 * t) * np.exp(-0.1 * t) + 1e-3 * rng.standard_normal(300)
    y = 0.3 * t + 0.1 * np.cos(3 * t) + 1e-3 * rng.standard_normal(300)
    return pd.DataFrame({"t": t, "x": x, "y": y})


def test_a_log_is_a_measured_input_and_told(track):
    track["Coil current (A)"] = 0.5 + 0.2 * np.sin(0.7 * track.t)
    data = _asked(track)
    assert data.logged["Coil_current"][0] == "Coil current"
    assert data.property_units["Coil_current"].text() == "A"
    assert data.scenes[0].inputs["Coil_current"].shape == (300, 1)
    assert any("'Coil current' as Coil_current" in note for note in data.notes)
    assert not any("not used" in note for note in data.notes)


def test_nothing_is_asked_before_the_loop(track):
    track["current"] = 0.5 + 0.2 * np.sin(0.7 * track.t)
    data = bsp_gp.Dataset.from_frames({"one": track})
    assert not data.scenes[0].inputs and "not used: current" in data.notes


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("counter", lambda f: np.arange(len(f)) + 17.0),
        ("stamp", lambda f: 1.7e9 + 1000 * f.t),
        ("nothing", lambda f: np.full(len(f), 4.2)),
        ("px", lambda f: np.round(640 + 300 * f.x)),
        ("slope", lambda f: np.gradient(f.x, f.t)),
        ("rapidity", lambda f: np.hypot(np.gradient(f.x, f.t), np.gradient(f.y, f.t))),
        ("jolt", lambda f: np.gradient(np.gradient(f.x, f.t), f.t)),
        ("kinetic", lambda f: np.gradient(f.x, f.t) ** 2 + np.gradient(f.y, f.t) ** 2),
        ("far", lambda f: np.hypot(f.x, f.y)),
        ("likelihood", lambda f: 0.9 + 0.1 * np.cos(f.t)),
        ("ax", lambda f: np.cos(f.t)),
        ("a", lambda f: np.cos(1.7 * f.t)),  # smoothed as the program does it
        ("GPS speed (m/s)", lambda f: np.cos(f.t)),
        ("words", lambda f: ["a"] * len(f)),
    ],
)
def test_what_follows_from_the_motion_is_not_asked(track, name, make):
    track[name] = make(track)
    assert not _asked(track).logged


def test_the_same_twice_is_asked_once(track):
    track["celsius"] = 20 + np.sin(0.9 * track.t)
    track["fahrenheit"] = 1.8 * track.celsius + 32
    assert list(_asked(track).logged) == ["celsius"]


def test_who_wants_none_says_so(track):
    track["current"] = np.sin(0.7 * track.t)
    assert not _asked(track, exclude=("current",)).logged
    ignored = bsp_gp.Dataset.from_frames({"one": track}, columns={"current": "ignore"})
    assert not asked_of(ignored).logged


def test_gaps_of_a_log_are_bridged_and_names_of_laws_kept(track):
    track["k"] = np.where(np.arange(300) % 3, np.nan, np.sin(0.7 * track.t))
    data = _asked(track)
    assert list(data.logged) == ["k_logged"]


def test_a_log_that_some_scene_lacks_is_not_asked(track):
    more = track.assign(current=np.sin(0.7 * track.t))
    data = bsp_gp.Dataset.from_frames({"one": more, "two": more.assign(current=np.nan)})
    assert not asked_of(data).logged


def test_files_need_not_have_the_same_further_columns(track, tmp_path):
    track.assign(current=1.0).to_csv(tmp_path / "one.csv", index=False)
    track.to_csv(tmp_path / "two.csv", index=False)
    data = bsp_gp.load_dataset([tmp_path / "one.csv", tmp_path / "two.csv"])
    assert not asked_of(data).logged


def test_laws_that_were_found_are_read_with_their_columns(track, tmp_path):
    track["Coil current (A)"] = 0.5 + 0.2 * np.sin(0.7 * track.t)
    track.to_csv(tmp_path / "one.csv", index=False)
    data = bsp_gp.load_dataset(tmp_path / "one.csv", uses=["c1", "Coil_current"])
    assert "Coil_current" in data.scenes[0].inputs
    assert not asked_of(data, {"Coil_current"}).logged


def test_a_drag_is_told_with_its_column(track):
    track["current"] = np.sin(0.7 * track.t)
    types = dataset_types(_asked(track))
    name = describe(parse_formula("c1 * (current * v_i)", types), -1.0)
    assert name == "drag, linear in speed, proportional to the logged column 'current'"
    name = describe(parse_formula("c1 * (square(current) * normalize(v_i))", types), -1.0)
    assert "friction of constant size, proportional to the square of" in name


@pytest.mark.slow
def test_a_fan_that_pushes_is_found():
    found = bsp_gp.close_loop(fan(), "-c1 * v_i", rng=0, n_bootstrap=0)
    assert found.rounds[0].effect.law.replace(" ", "") in ("c2*(Fan^2*e_x)", "c2*Fan^2*e_x")


@pytest.mark.slow
def test_a_drag_that_goes_with_a_density_is_found():
    found = bsp_gp.close_loop(dense(), rng=0, n_bootstrap=0)
    assert "Density *" in found.rounds[0].effect.law and "norm(v_i)^2" in found.rounds[0].effect.law


@pytest.mark.slow
def test_a_temperature_that_changes_nothing_is_not_found():
    found = bsp_gp.close_loop(warm(), "-c1 * v_i", rng=0, n_bootstrap=0)
    assert found.verdict == "nothing missing"


def test_a_body_that_is_seen_once_has_no_motion_that_a_column_follows():
    """It has no velocity either: an error of numbers ended the run."""
    places = np.full((5, 2, 2), np.nan)
    places[:, 0] = [[0.0, 0.0], [0.1, 0.2], [0.3, 0.1], [0.2, 0.4], [0.5, 0.5]]
    places[2, 1] = 1.0
    fan = np.repeat([[1.0], [3.0], [2.0], [5.0], [7.0]], 2, axis=1)
    bodies = (Entity("cart"), Entity("seen once"))
    scene = Scene("s", 0.1 * np.arange(5), places, bodies, logs={"Fan": fan})
    data = Dataset("d", (scene,), logged={"Fan": ("Fan", DIMENSIONLESS)})
    assert set(asked_of(data).logged) == {"Fan"}
    places[:, 0] = np.nan
    places[0, 0] = 0.0
    alone = Dataset("d", (replace(scene, positions=places),), logged=data.logged)
    assert not asked_of(alone).logged


@pytest.mark.parametrize("kind", ["way", "next way", "distance"])
def test_the_way_of_a_track_is_no_cause(kind):
    rng, t = np.random.default_rng(2), np.arange(80) / 30
    x = np.round(30 * t + rng.normal(0, 0.05, 80), 2)
    y = np.round(np.abs(40 * np.sin(3 * t)) + rng.normal(0, 0.05, 80), 2)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    values = {
        "way": way, "next way": np.append(way[1:] + 38.6, 0.0),
        "distance": np.hypot(x - x[0], y - y[0]),
    }  # fmt: skip
    frame = pd.DataFrame({"t": t, "x": x, "y": y, "Length [m]": np.round(values[kind], 2)})
    assert not _asked(frame).logged
    frame["Length [m]"] += 0.2 * way.max() * np.sin(11 * t)
    assert list(_asked(frame).logged) == ["Length"]
