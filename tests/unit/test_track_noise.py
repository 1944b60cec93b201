"""A declared memory of the noise."""


import numpy as np
import pytest

from bsp_gp.data.folder import save_dataset
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError
from bsp_gp.units import UnitSystem

SIGMA = np.array([0.02, 0.05])


def scene(n=400, step=0.1, sigma=None):
    times = step * np.arange(float(n))
    return Scene("a", times, np.zeros((n, 1, 2)), [Entity("ball")], sigma=sigma)


def test_a_declared_memory_is_read_in_the_units_of_the_data_and_written(tmp_path):
    (tmp_path / "trajectories.csv").write_text("t,x,y\n0,0,0\n10,1,2\n20,2,5\n30,3,9\n")
    (tmp_path / "dataset.toml").write_text(
        'noise_memory = 40\n[units]\ntime = "ms"\nlength = "m"\n'
    )
    dataset = load_dataset(tmp_path)
    assert dataset.noise_memory == pytest.approx(0.04)
    save_dataset(dataset, tmp_path / "again")
    assert load_dataset(tmp_path / "again").noise_memory == pytest.approx(0.04)
    (tmp_path / "dataset.toml").write_text("noise_memory = -1\n")
    with pytest.raises(DataError, match="noise_memory must not be negative"):
        load_dataset(tmp_path)
    units = UnitSystem.from_declared({})
    assert Dataset("plain", (scene(),), units=units).noise_memory is None
