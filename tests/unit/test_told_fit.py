"""`fit` in the units of the data: what it prints, and the numbers that it is given."""

import re

import numpy as np
import pandas as pd
import pytest

from bsp_gp.cli import main
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.tables import dataset_from_frames
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.loop.told import factors_of

CM = {"length": "cm", "time": "s", "mass": "g"}


def swing(tmp_path):
    """A mass of 50 g on a spring of 2 g/s^2 about 30 cm, in cm."""
    t = np.arange(0, 40, 0.5)
    rng = np.random.default_rng(0)
    x = 30 + 5 * np.cos(0.2 * t) + rng.normal(0, 0.01, len(t))
    path = tmp_path / "swing.csv"
    pd.DataFrame({"t": t, "x": x, "y": 0.0}).to_csv(path, index=False)
    return str(path)


def test_a_fit_is_printed_in_the_units_of_the_data(tmp_path, capsys):
    options = ["--units", "length=cm", "time=s", "mass=g", "--property", "mass=50", "--quiet"]
    law = "-k * (p_i - (X, 0 [cm]))"
    ends = ["--start", "X=25", "k=1.5", "--bounds", "X=10..50"]
    assert main(["fit", swing(tmp_path), "--law", law, *options, *ends]) == 0
    out = capsys.readouterr().out
    found = {name: (float(value), unit) for name, value, unit
             in re.findall(r"(?m)^    (\w): +(\S+) ± \S+ (\S+)", out)}  # fmt: skip
    assert found["X"] == (pytest.approx(30, rel=1e-3), "cm")
    assert found["k"] == (pytest.approx(2, rel=1e-2), "g/s^2")
    noise = re.search(r"noise += (\S+), - cm \(estimated\)", out)
    assert float(noise[1]) == pytest.approx(0.01, rel=0.3)
    assert re.search(r"rollout rms += \S+ cm\n", out) and "nan" not in out


def test_a_bound_without_a_unit_is_in_the_unit_that_is_told(tmp_path, capsys):
    options = ["--units", "length=cm", "time=s", "mass=g", "--property", "mass=50", "--quiet"]
    law = "-2 [g/s^2] * (p_i - (X, 0 [cm]))"
    for bound, told in (("X=32..50", "X: at its bound, 32 cm"), ("X=0.32..0.5 [m]", "32 cm")):
        main(["fit", swing(tmp_path), "--law", law, *options, "--bounds", bound])
        assert told in capsys.readouterr().out


def test_factors_are_those_of_what_is_told():
    frame = pd.DataFrame({"t": [0, 1, 2], "x": [0, 1, 4], "y": [0, 1, 2]})
    data = dataset_from_frames(frame, units=CM, properties={"mass": 50})
    law = read_law(data, ["-k * (p_i - (X, Y)) * norm(v_i)^n", "B * perp(v_i)"])
    assert factors_of(law, data.units) == pytest.approx({"X": 0.01, "Y": 0.01, "B": 1e-3})


def test_steps_of_rounded_positions_are_in_the_unit_of_the_data():
    x = np.repeat(np.arange(10.0), 4)
    frame = pd.DataFrame({"t": np.arange(40.0), "x": x, "y": 0.0})
    notes = estimate_noise(dataset_from_frames(frame, units=CM)).notes
    assert any("steps of 1 cm" in note for note in notes)
