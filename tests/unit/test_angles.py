"""Angles in the place of places: read, unwrapped, with laws that are torques, told in rad."""

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.errors import DataError, LawError
from bsp_gp.fitting.hypothesis import read_law
from tests.swings import LENGTH, PIVOT, WEIGHT, G, bob, swing

SWINGS = "-k * m_i * sin(theta_i)"


def angles(force=lambda v: 0.0, unit="rad", turns=0.0):
    frame = swing(force)
    angle = np.arctan2(frame["x"] - PIVOT[0], PIVOT[1] - frame["y"])
    size = {"rad": 1.0, "deg": np.pi / 180}[unit]
    table = pd.DataFrame({"t": frame["t"], "x": (angle + turns) / size})
    return bsp_gp.Dataset.from_frames(table, units={"length": unit, "time": "s"})


def test_degrees_become_radians_without_jumps():
    frame = pd.DataFrame({"t": np.arange(20) * 0.1, "x": (25.0 * np.arange(20)) % 360})
    data = bsp_gp.Dataset.from_frames(frame, units={"length": "deg", "time": "s"})
    places = data.scenes[0].positions[:, 0, 0]
    np.testing.assert_allclose(np.diff(places), np.radians(25.0))
    assert data.units.is_angle


def test_an_angle_and_places_on_a_rod_give_the_same_answer():
    def force(v):
        return -0.15 * v

    laws = [WEIGHT, "norm(p_i - (0.02, 1.61)) = 0.8", "-c * m_i * v_i"]
    by_place = bsp_gp.fit_law(bob(force), laws).constants[0]
    found = bsp_gp.fit_law(angles(force, "deg"), [SWINGS, "-c * m_i * omega_i"])
    by_angle = {c.name: c for c in found.constants}
    assert by_angle["c"].unit == by_place.unit == "1/s"
    assert abs(by_angle["k"].value - G / LENGTH) < by_angle["k"].high - by_angle["k"].low
    # Noise along the rod tells nothing: both see the same.
    assert abs(by_angle["c"].value - by_place.value) < 0.2 * (by_place.high - by_place.low)
    wide, narrow = (c.high - c.low for c in (by_angle["c"], by_place))
    assert abs(wide / narrow - 1) < 0.2
    assert found.errors.unit == "rad"


def test_dry_friction_in_a_joint_is_a_torque():
    data = angles(lambda v: -0.1 * np.tanh(v / 1e-4))
    found = bsp_gp.fit_law(data, [SWINGS, "-c * m_i * sign(omega_i)"])
    (c,) = (c for c in found.constants if c.name == "c")
    assert abs(c.value - 0.1 / LENGTH) < c.high - c.low
    assert c.unit.startswith("rad") or c.unit == "1/s^2"


def test_forces_in_newtons_are_refused_for_angles():
    with pytest.raises(LawError):
        read_law(angles(), ["9.81 [m/s^2] * m_i"])


@pytest.mark.parametrize(
    ("heading", "units"),
    [
        ("theta", {"theta": "deg", "t": "s"}), ("Winkel (°)", {"t": "s"}),
        ("theta_deg", {"time": "s"}), ("phi", {"length": "deg", "time": "s"}),
    ],
)  # fmt: skip
def test_columns_that_are_called_angles_are_coordinates(heading, units):
    frame = pd.DataFrame({"t": np.arange(9) * 0.1, heading: 10.0 * np.arange(9), "dtheta": 0.0})
    data = bsp_gp.Dataset.from_frames(frame, units=units)
    places = data.scenes[0].positions[:, 0, 0]
    np.testing.assert_allclose(np.diff(places), np.radians(10.0))


def test_several_angles_are_those_of_several_arms():
    frame = pd.DataFrame({"t": np.arange(9) * 0.1, "phi1": np.arange(9.0), "phi2": 1.0})
    data = bsp_gp.Dataset.from_frames(frame, units={"phi1": "rad", "phi2": "rad", "t": "s"})
    assert data.scenes[0].names == ("phi1", "phi2")
    with pytest.raises(DataError, match="one unit"):
        bsp_gp.Dataset.from_frames(frame, units={"phi1": "rad", "phi2": "deg", "t": "s"})


def test_one_unit_stands_for_several_angles_of_a_name(tmp_path):
    table = tmp_path / "arms.csv"
    table.write_text(
        "t,theta1,theta2\n" + "".join(f"{k / 10},{k},{-2 * k}\n" for k in range(9)),
        encoding="utf-8",
    )
    data = bsp_gp.load_dataset(table, units={"theta": "deg", "t": "s"})
    assert data.units.is_angle and set(data.scenes[0].names) == {"theta1", "theta2"}
    assert np.radians(-2.0) == pytest.approx(data.scenes[0].positions[1].min())


def test_an_angle_needs_a_unit():
    frame = pd.DataFrame({"t": np.arange(9) * 0.1, "theta": np.arange(9.0)})
    with pytest.raises(DataError, match="unknown unit"):
        bsp_gp.Dataset.from_frames(frame, units={"t": "s"})


@pytest.mark.parametrize("law", [
    "-c * m_i * omega_i", "-c * m_i * abs(omega_i) * omega_i", "-c * m_i * sign(omega_i)",
    "-k * m_i * sin(theta_i - b)",
])  # fmt: skip
def test_torques_are_told_as_they_are_typed(law):
    assert read_law(angles(), [law]).text(digits=False) == law


def test_the_only_column_with_a_unit_of_angles_is_the_angle():
    """It was asked for by name: the roll of a ship, the bearing of a needle."""
    rolls = [3.0, 2.5, 1.1, -0.6, -2.0, -2.7]
    table = pd.DataFrame({"t (s)": np.arange(6) / 4, "roll (deg)": rolls})
    data = bsp_gp.Dataset.from_frames(table)
    assert data.units.is_angle
    np.testing.assert_allclose(data.scenes[0].positions[0, 0, 0], np.radians(3.0))
    with pytest.raises(DataError, match="no column 'x'"):
        bsp_gp.Dataset.from_frames(table.assign(**{"pitch (deg)": 1.0 + table["t (s)"]}))


def test_a_place_in_an_unknown_unit_is_refused_by_that():
    table = pd.DataFrame({"t (s)": [0.0, 1.0, 2.0], "A_x (flarn)": [1.0, 2.0, 3.0]})
    with pytest.raises(DataError, match=r"'A_x \(flarn\)' has no unit that is known"):
        bsp_gp.Dataset.from_frames(table)
