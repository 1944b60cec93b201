"""A double arm that was measured: its friction, on pieces of the swing that no fit has seen."""

import numpy as np
import pytest

from experiments.measured_arms import run, theirs

pytestmark = pytest.mark.long


def test_friction_of_the_joints_predicts_better_than_the_published_model(shared_data):
    path = shared_data / "measured" / "arm_pendulum" / "double.csv"
    if not path.is_file():
        pytest.skip(f"no measured arms in {path}")
    table = run(path, n_train=4, models=("none", "viscous"))
    mrad = table.pivot(index="model", columns="piece", values="mrad")
    assert (mrad.loc["viscous"] < mrad.loc["theirs"]).sum() >= 3
    assert (mrad.loc["viscous"] < mrad.loc["none"]).all()
    ours, couplings = table[table["model"] == "viscous"].iloc[0], theirs()[1]
    for name, value in couplings.items():
        np.testing.assert_allclose(ours[name], value, rtol=0.004)
    for name, value in zip(("phi1", "phi2"), theirs()[0]["pull"], strict=True):
        np.testing.assert_allclose(ours[f"k[body] {name}"], value, rtol=0.004)
