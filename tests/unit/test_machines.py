"""Machines that `make` has: made by scipy, read back, and reproduced by the laws that act."""

import json
import tomllib

import numpy as np
import pytest

import bsp_gp
from bsp_gp.cli import main
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.simulate.machines import MACHINES, made_machine


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_is_made_and_its_model_can_be_declared(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    effect = next(iter(MACHINES[name].effects))
    assert main([
        "make", name, "--frames", "20", "--effect", effect, "--undeclared", "--out", "made",
    ]) == 0  # fmt: skip
    data = bsp_gp.load_dataset("made")
    declared = tomllib.loads((tmp_path / "made-model.toml").read_text())["declare"]
    truth = json.loads((tmp_path / "made-truth" / "truth.json").read_text())
    assert truth["undeclared"] == [effect]
    assert len(read_law(data, truth["acting"]).terms) > len(read_law(data, declared).terms)
    assert not (tmp_path / "made" / "truth.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "effect"), [
    ("driven_cart", "drag"), ("quadrotor_lite", "drag"), ("turntable", "rotation"),
    ("pendulum", "drag"), ("arm", "quadratic"),
])  # fmt: skip
def test_the_laws_that_act_leave_noise_alone(tmp_path, monkeypatch, name, effect):
    monkeypatch.chdir(tmp_path)
    main(["make", name, "--effect", effect, "--frames", "150", "--out", "made", "--seed", "3"])
    data = bsp_gp.load_dataset("made")
    truth = json.loads((tmp_path / "made-truth" / "truth.json").read_text())
    noise = MACHINES[name].noise
    found = bsp_gp.fit_law(data, truth["acting"], noise=noise)
    assert found.status == "converged"
    assert 0.75 < found.chi2_red < 1.3


def test_scenes_and_seeds_are_streams_of_their_own():
    one, two = (made_machine("arm", np.random.default_rng(5), n_scenes=n) for n in (1, 2))
    first = two.table[two.table["scene"] == "1"]
    assert np.array_equal(one.table["theta"], first["theta"])


def test_what_a_machine_does_not_have_is_refused():
    with pytest.raises(SettingsError, match="no effect 'wind'"):
        made_machine("arm", np.random.default_rng(0), effects={"wind": 1.0})
