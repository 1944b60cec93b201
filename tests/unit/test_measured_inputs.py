"""Numbers that were logged beside the tracks, thrust and wind, are inputs of laws."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.operators import Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.physics.force import split_linear
from bsp_gp.report.page import page_of
from bsp_gp.report.recording import data_text
from bsp_gp.units import Unit

MASS, DRAG = 0.5, 0.3
UNITS = {"length": "m", "time": "s", "thrust": "N", "wind_x": "m/s", "wind_y": "m/s"}
FALL, LIFT = "9.81 [m/s^2] * m_i * down", "thrust * up"
WIND_DRAG = "c * (norm(v_i - wind) * (v_i - wind))"


def thrust(t, phase):
    return MASS * 9.81 + 1.5 * np.sin(2.1 * t + phase)


def wind(t, phase):
    return np.array([2.0 * np.cos(1.3 * t + phase), 0.6 * np.sin(0.9 * t + 2 * phase)])


def flown(phase, times, drag=DRAG, start=(0, 1, 0.5, 0)):
    """Places of a body under thrust in a wind, (T, 2)."""

    def rate(t, state):
        past = state[2:] - wind(t, phase)
        push = np.array([0.0, thrust(t, phase) / MASS - 9.81])
        return [*state[2:], *(push - drag / MASS * np.linalg.norm(past) * past)]

    span = times[[0, -1]]
    return solve_ivp(rate, span, start, t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T


def flight(phase, drag=DRAG, sigma=1e-3, n=150, in_newtons=1.0):
    """Such a flight, as its log has it."""
    t = np.arange(n) * 0.02
    track = flown(phase, t, drag).T
    track = track + sigma * np.random.default_rng(int(10 * phase)).standard_normal(track.shape)
    blown = wind(t, phase)
    return pd.DataFrame({
        "t": t, "x": track[0], "y": track[1], "thrust": thrust(t, phase) * in_newtons,
        "wind_x": blown[0], "wind_y": blown[1],
    })  # fmt: skip


def flights(units=UNITS, **settings):
    frames = {f"s{k}": flight(phase, **settings) for k, phase in enumerate((0.0, 0.7, 1.9))}
    bodies = pd.DataFrame({"entity": ["object"], "mass": [MASS]})
    return bsp_gp.Dataset.from_frames(
        frames, bodies, units=units | {"mass": "kg"}, up="y", train=["s0", "s1"]
    )  # fmt: skip


def test_a_law_names_a_thrust_and_a_wind():
    found = bsp_gp.fit_law(flights(), [FALL, LIFT, WIND_DRAG])
    (constant,) = found.constants
    assert abs(constant.value + DRAG) < 2 * (constant.high - constant.low) < 0.02
    assert found.noise["sigma"][0] == pytest.approx(1e-3, rel=0.1)
    assert found.errors.rollout_rmse < 3e-3  # of the flight that is held out


def test_simulated_flights_take_the_inputs_at_other_times():
    data = flights(drag=0.0, sigma=0.0)
    law = bsp_gp.fit_law(data, [FALL, LIFT]).law
    scene = data.scenes[0]
    times = scene.times[:-1] + 0.01
    later = law.simulate(scene, times=times, up="y", states={"object": ([0, 1], [0.5, 0])})
    assert later.inputs["thrust"][0, 0] == pytest.approx(np.mean(scene.inputs["thrust"][:2, 0]))
    # Straight lines between logged values take up to 2e-4 of 3 m/s^2 from a push, for 3 s.
    np.testing.assert_allclose(later.positions[:, 0], flown(0.0, times, 0.0), atol=3e-3)
    assert np.abs(later.positions[:, 0] - scene.positions[:-1, 0]).max() > 0.01


def test_units_are_those_declared_and_a_folder_keeps_them(tmp_path):
    data = flights(UNITS | {"thrust": "mN"}, in_newtons=1000.0)
    bsp_gp.save_dataset(data, tmp_path / "log")
    again = bsp_gp.load_dataset(tmp_path / "log")
    for one in (data, again):
        assert one.scenes[0].inputs["thrust"][0, 0] == pytest.approx(MASS * 9.81)
        assert one.scenes[0].inputs["wind"].shape == (150, 1, 2)


def test_columns_without_a_declared_unit_are_no_inputs():
    data = flights({"length": "m", "time": "s"})
    assert data.scenes[0].inputs == {}


@pytest.mark.slow
def test_the_drag_against_the_wind_is_found_with_its_thrust():
    data = flights(sigma=0.01)
    report = bsp_gp.close_loop(data, [FALL, LIFT], rng=np.random.default_rng(0), n_bootstrap=0)
    effect = next(done.effect for done in report.rounds if done.adopted)
    assert "norm(v_i - wind)" in " ".join([effect.name, *effect.equivalents])
    (constant,) = report.constants
    assert constant.value == pytest.approx(-DRAG, rel=0.05)


def pushed(folder, heading="Force (N)", runs=("",)):
    """A cart under a logged force, as a sensor's program exports it."""
    t = np.arange(60) * 0.05
    columns = {}
    for k, run in enumerate(runs):
        force = np.cos(2.0 * t + k)
        place = 0.1 * t - np.cos(2.0 * t + k) / 4.0 / 0.5
        for name, values in (("Time (s)", t), ("Position (m)", place), (heading, force)):
            columns[run + name] = values
    path = folder / "cart.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_a_column_that_a_law_names_is_an_input_if_its_heading_has_the_unit(tmp_path, capsys):
    path = pushed(tmp_path)
    assert bsp_gp.load_dataset(path).scenes[0].inputs == {}
    data = bsp_gp.load_dataset(path, uses=["Force", "c"])
    assert set(data.scenes[0].inputs) == {"Force"}
    assert any("laws name 'Force'" in note for note in data.notes)
    law = ["--property", "mass=0.5[kg]", "--law", "Force * e_x", "--law", "-c * v_i"]
    assert main(["fit", str(path), *law, "--out", str(tmp_path / "fit"), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "    c: " in said and "    Force: " not in said


def test_a_column_without_a_unit_that_a_law_names_is_told(tmp_path):
    data = bsp_gp.load_dataset(pushed(tmp_path, "Force"), uses=["Force"])
    assert data.scenes[0].inputs == {}
    assert any("units={" in note and "Force" in note for note in data.notes)


@pytest.mark.parametrize("said", [{"uses": ["Force"]}, {"units": {"Force": "N"}}])
def test_every_run_of_a_table_has_its_own_log(tmp_path, said):
    path = pushed(tmp_path, runs=("Run 1: ", "Run 2: "))
    data = bsp_gp.load_dataset(path, **said)
    assert [scene.name for scene in data.scenes] == ["Run 1", "Run 2"]
    first = [scene.inputs["Force"][0, 0] for scene in data.scenes]
    assert first == pytest.approx([1.0, np.cos(1.0)])
    assert any("not used: Force (N)" in note for note in bsp_gp.load_dataset(path).notes)


def test_a_name_that_laws_cannot_use_is_refused():
    frame = flight(0.0).rename(columns={"thrust": "thrust_i"})
    with pytest.raises(DataError, match="thrust_i.*name that laws can use"):
        bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s", "thrust_i": "N"})


def test_what_is_an_input_is_not_said_to_be_unused(tmp_path):
    flight(0.0).assign(junk=1.0).to_csv(tmp_path / "log.csv", index=False)
    data = bsp_gp.load_dataset(tmp_path / "log.csv", units=UNITS)
    unused = [note for note in data.notes if "not used" in note]
    assert len(unused) == 1 and "junk" in unused[0]


def glide(k, along=0.15, across=0.31, sigma=0.01):
    """A hull that turns as it glides, with another drag across it than along it."""
    t = np.arange(80) * 0.1

    def turn(time):
        return 0.4 * k + 0.25 * time

    def rate(time, state):
        own = np.array([np.cos(turn(time)), np.sin(turn(time))])
        v = state[2:]
        return [*v, *(-across * v - (along - across) * (v @ own) * own)]

    start = [0.0, 0.0, np.cos(0.3 + 0.4 * k), np.sin(0.3 + 0.4 * k)]
    places = solve_ivp(rate, t[[0, -1]], start, t_eval=t, rtol=1e-9, atol=1e-9).y[:2]
    places = places + sigma * np.random.default_rng(k).standard_normal(places.shape)
    angle = np.degrees(turn(t))
    return pd.DataFrame({"t": t, "x": places[0], "y": places[1], "heading": angle})


@pytest.mark.slow
def test_a_hull_has_another_drag_across_it(tmp_path):
    frames = {f"s{k}": glide(k) for k in range(4)}
    bodies = pd.DataFrame({"entity": ["object"], "mass": [1.0]})
    units = {"length": "m", "time": "s", "mass": "kg", "heading": "deg"}
    data = bsp_gp.Dataset.from_frames(frames, bodies, units=units, train=["s0", "s1", "s2"])
    report = bsp_gp.close_loop(data, "-c * v_i", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted" and len(report.constants) == 2
    found = {c.name: c.value for c in report.constants}
    assert found["c"] == pytest.approx(0.31, abs=0.02)
    assert found["c1"] == pytest.approx(0.31 - 0.15, abs=0.02)
    name = page_of(report).rounds[0].effect.name
    assert name == "force along the axis of heading, as speed along the axis of heading"
    bsp_gp.write_report(report, tmp_path / "report")
    again = page_of(bsp_gp.load_report(tmp_path / "report"))
    assert again.rounds[0].effect.name == name


def test_a_heading_that_is_not_used_is_told(tmp_path):
    path = tmp_path / "glide.csv"
    glide(1).to_csv(path, index=False)
    notes = " ".join(bsp_gp.load_dataset(path, units={"length": "m", "time": "s"}).notes)
    assert "--units heading=deg makes it an input" in notes


def test_the_name_of_an_input_is_set_upright_and_whole():
    types = STATE_INPUTS | {"heading_deg": Type("scalar", Unit.of())}
    formula = parse_formula("cos(heading_deg) * e_x", types)
    assert r"\mathrm{heading\ deg}" in to_latex(formula)


def test_an_input_may_be_called_as_the_file_calls_it_and_is_told(tmp_path):
    rows = "".join(f"{k / 10},{np.cos(k / 10):.4f},{k % 7},{k}\n" for k in range(40))
    path = tmp_path / "pushed.csv"
    path.write_text(f"t (s),x (m),Force (N),volts\n{rows}")
    for name in ("Force", "Force (N)"):
        data = load_dataset(path, units={name: "kN", "x (m)": "cm", "volts": "V"})
        (scene,) = data.scenes
        assert scene.inputs["Force"].max() == 6000 and scene.positions.max() == 0.01
        assert "Input Force: measured, from 0 to 6.000 kN" in data_text(data)
        assert "Input volts: measured, from 0 to 39.00 V" in data_text(data)
    assert "Input" not in data_text(load_dataset(path))


def driven(k, rng, n=120):
    """A pendulum with a motor, whose torque per moment of inertia was logged."""
    t = np.arange(n) * 0.05

    def torque(time):
        return 3.0 * np.sin(1.9 * time + k) + 2.0 * np.cos(3.1 * time + 2 * k)

    def rate(time, state):
        theta, omega = state
        return omega, -9.0 * np.sin(theta) + 0.8 * torque(time) - 0.15 * omega

    swing = solve_ivp(rate, (0, t[-1]), (0.5 + 0.2 * k, 0.0), t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    return pd.DataFrame({"t": t, "theta": swing + 0.003 * rng.standard_normal(n), "u": torque(t)})


@pytest.mark.slow
def test_what_a_motor_was_told_is_found_beside_what_drives_back():
    """Of a driven pendulum powers of the torque times powers of the speed were tried alone."""
    rng = np.random.default_rng(0)
    runs = {f"run {k}": driven(k, rng) for k in range(4)}
    units = {"theta": "rad", "t": "s", "u": "rad/s^2"}
    data = bsp_gp.Dataset.from_frames(runs, units=units)
    report = bsp_gp.close_loop(data, "nothing", rng=0, n_bootstrap=0)
    terms = {to_text(split_linear(term.formula)[1]) for term in report.fit.law.terms}
    assert any("u * e_x" in text for text in terms) and any("sin(" in text for text in terms)
    told = [c.value for c in report.constants if abs(c.value - 0.8) < 0.05]
    assert len(told) == 1 and report.total["ratio"].value < 0.1
