"""What is said of bodies beside the data."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.errors import DataError, LawError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.physics.force import needs_masses

SPRING = "-8 [N/m] * x_i * e_x"
NO_MASS = "every body is taken as 1 kg"


@pytest.fixture
def spring(tmp_path, monkeypatch):
    """A glider of 0.5 kg between springs of 8 N/m."""
    monkeypatch.chdir(tmp_path)
    t = 0.05 * np.arange(80)
    noise = np.random.default_rng(1).normal(scale=1e-4, size=80)
    frame = pd.DataFrame({"Time (s)": t, "Position (m)": 0.2 * np.cos(4 * t) + noise})
    frame.to_csv("spring.csv", index=False)
    return "spring.csv"


def two(properties=None, **units):
    t = 0.1 * np.arange(6)
    frame = pd.concat(pd.DataFrame({"t": t, "entity": n, "x": s * np.cos(t), "y": s * np.sin(t)})
                      for n, s in (("star1", 1.0), ("star2", -1.5)))  # fmt: skip
    return bsp_gp.Dataset.from_frames(
        frame, units={"length": "au", "time": "yr", **units}, properties=properties
    )


def masses(dataset):
    return {e.name: e.mass for e in dataset.scenes[0].entities}


@pytest.mark.parametrize(
    "said", [0.3058, "0.3058", "0.3058[kg]", "305.8 [g]", {"object": "305.8[g]"}]
)
def test_a_mass_beside_a_table(spring, said):
    data = bsp_gp.load_dataset(spring, units={"mass": "kg"}, properties={"mass": said})
    assert masses(data) == {"object": pytest.approx(0.3058)}
    assert not any(NO_MASS in note for note in data.notes)


def test_a_unit_of_its_own_calibrates_masses(spring):
    data = bsp_gp.load_dataset(spring, properties={"mass": "500[g]"})
    assert data.units.declared["mass"] == "kg"
    read_law(data, SPRING)


def test_masses_of_stars_in_their_unit():
    sun = two({"mass": "star1:0.5,star2:2"}, mass="Msun")
    found = masses(sun)
    assert found["star2"] == pytest.approx(4 * found["star1"]) == pytest.approx(3.9768e30, rel=1e-3)
    read_law(sun, "6.6743e-11 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)")


def test_any_property_may_be_said():
    data = two({"mu": {"star1": 0.2, "star2": 0.3}, "stretch": "0.1[m]"})
    assert data.scenes[0].entities[1].properties["mu"] == 0.3
    read_law(data, "k * stretch_i * mu_j * normalize(p_i - p_j)")


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"mass": "sun:1"}, "no such body; present are star1, star2"),
        ({"mass": "-1"}, "mass of entity 'star1' must be positive"),
        ({"mass": "1[m]"}, "unit of mass must be one of kg"),
        ({"mass": "1[kgg]"}, "unknown unit"),
        ({"mass": "heavy"}, r'properties=\{"mass": "0.3"\}'),
        ({"mass": "1,2"}, "given twice"),
        ({"radius": "1"}, "entities.csv"),
        ({"p": 1}, "cannot be given"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(said, message):
    with pytest.raises(DataError, match=message):
        two(said)


def test_the_error_for_a_missing_property_says_how_to_give_it():
    with pytest.raises(LawError, match=r'properties=\{"mass": "star1:1.2,star2:0.8"\}'):
        read_law(two(), "G * m_i * m_j * normalize(p_j - p_i)")


def test_newtons_without_a_mass_name_the_option(spring, capsys):
    assert main(["fit", spring, "--law", SPRING]) == 2
    assert "--property mass=0.3[kg]" in capsys.readouterr().err


def test_one_kilogram_is_told_and_only_where_it_counts(spring, capsys):
    units = ["--units", "length=m", "time=s", "mass=kg"]
    assert main(["check", spring, *units]) == 0
    assert NO_MASS in capsys.readouterr().out
    assert main(["fit", spring, "--law", SPRING, *units]) == 0
    told = capsys.readouterr()
    assert f"bsp-gp: note: no mass is given: {NO_MASS}" in told.err and NO_MASS in told.out
    assert main(["fit", spring, "--law", "-k * m_i * x_i * e_x"]) == 0
    told = capsys.readouterr()
    assert NO_MASS not in told.err + told.out
    assert main(["fit", spring, "--law", "-k * x_i * e_x", "--property", "mass=0.5[kg]"]) == 0
    told = capsys.readouterr()
    assert NO_MASS not in told.err + told.out and "k: 8.0" in told.out


@pytest.mark.slow
def test_the_report_says_it_first(spring, capsys):
    words = ["close", spring, "--declare", SPRING, "--units", "length=m", "time=s", "mass=kg",
             "--max-rounds", "1", "--max-levels", "2", "--quiet", "--bootstrap", "0"]  # fmt: skip
    assert main(words) == 0
    assert "Check: no mass is given" in " ".join(capsys.readouterr().out.split())
    notes = json.loads(Path("spring-report/report.json").read_bytes())["dataset"]["notes"]
    assert any(NO_MASS in note for note in notes)


@pytest.mark.parametrize(
    ("law", "needs"),
    [
        ("9.81 [m/s^2] * m_i * e_x", False),
        ("-k * m_i * v_i", False),
        ("-k * v_i", True),
        ("-0.1 [kg/s] * v_i", True),
        ("G * m_i * m_i * e_x", True),
    ],
)
def test_which_laws_need_masses(spring, law, needs):
    data = bsp_gp.load_dataset(spring, units={"mass": "kg"})
    assert needs_masses(read_law(data, law)) is needs


@pytest.mark.parametrize("law", ["-k * p_i", "-p_i * k", "8 [1/s^2] * m_i * p_i"])
def test_a_place_alone_is_the_way_from_the_origin(spring, law):
    data = bsp_gp.load_dataset(spring)
    meant = law.replace("p_i", "(p_i - origin)")
    assert read_law(data, law).terms == read_law(data, meant).terms


def jumps(**settings):
    """Two scenes of one body each, called after who it is."""
    t = 0.1 * np.arange(6)
    frame = pd.concat(pd.DataFrame({"t": t, "scene": n, "x": s * t, "y": t**2})
                      for n, s in (("Huber", 1.0), ("Kraft", 2.0)))  # fmt: skip
    return bsp_gp.Dataset.from_frames(frame, units={"length": "m", "time": "s"}, **settings)


def test_a_property_may_be_that_of_the_lone_body_of_a_scene():
    data = jumps(properties={"mass": "Huber:61.5,Kraft:63.4"})
    assert [s.entities[0].mass for s in data.scenes] == [61.5, 63.4]
    with pytest.raises(DataError, match="no such body"):
        jumps(properties={"mass": "Huber:61.5,Moser:58"})


def test_columns_are_called_as_laws_call_them(tmp_path):
    """A unit at the end of a name belongs to it where a law or a unit says so."""
    t = 0.1 * np.arange(6)
    pd.DataFrame({"time_s": t, "hand_x_mm": t, "hand_y_mm": t**2, "goal_mm": 80.0}).to_csv(
        tmp_path / "reach.csv", index=False
    )
    columns = {"t": "time_s", "x": "hand_x_mm", "y": "hand_y_mm"}
    units = {"length": "mm", "time": "s", "goal_mm": "mm"}
    data = bsp_gp.load_dataset(tmp_path / "reach.csv", columns=columns, units=units)
    assert read_law(data, "-c * (p_i - goal_mm * e_x)").names == ("c",)


def test_who_says_which_column_is_one_coordinate_has_said_all(tmp_path):
    t = 0.1 * np.arange(6)
    pd.DataFrame({"ms": 1000 * t, "alt": t**2, "aux": 8000 - t}).to_csv(
        tmp_path / "flight.csv", index=False
    )
    columns, units = {"t": "ms", "y": "alt"}, {"length": "m", "time": "ms"}
    data = bsp_gp.load_dataset(tmp_path / "flight.csv", columns=columns, units=units)
    assert any("motion along y" in note for note in data.notes)
    frame = pd.read_csv(tmp_path / "flight.csv").rename(columns={"ms": "t", "alt": "y"})
    frame.to_csv(tmp_path / "flight.csv", index=False)
    with pytest.raises(DataError, match="aux"):
        bsp_gp.load_dataset(tmp_path / "flight.csv", units=units)


def test_the_inertia_of_what_turns_is_a_mass_in_kg_m2(tmp_path):
    t = 0.05 * np.arange(40)
    frame = pd.DataFrame({"t": t, "theta": np.cos(t)})
    units = {"theta": "rad", "time": "s"}
    data = bsp_gp.Dataset.from_frames(frame, units=units, properties={"mass": "210[kg cm^2]"})
    assert masses(data) == {"object": pytest.approx(0.021)}
    listed = frame.assign(mass=210.0)
    data = bsp_gp.Dataset.from_frames(listed, units={**units, "mass": "kg cm^2"})
    assert masses(data) == {"object": pytest.approx(0.021)}
    with pytest.raises(DataError, match="must be one of kg"):
        two({"mass": "2[kg m^2]"})


def test_a_unit_is_put_to_the_number_in_front_and_to_no_exponent_like_it(spring):
    """Of -2 and ^2 both got the unit of the factor: "an exponent must be dimensionless"."""
    data = bsp_gp.load_dataset(spring, properties={"mass": "0.5[kg]"})
    law = read_law(data, "-2 * norm(v_i)^2 * normalize(v_i)")
    assert law.text() == "-2 [kg/m] * norm(v_i)^2 * normalize(v_i)"
