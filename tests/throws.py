"""Thrown balls with linear drag, in closed form: a small data set for tests of whole commands."""

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import save_dataset
from bsp_gp.units import UnitSystem

GRAVITY = "9.81 [m/s^2] * m_i * down"
DRAG = "-c1 * v_i"
MASS, C1 = 0.5, 0.2
SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})


def throws(n_scenes=4, n_times=12, sigma=0.0, seed=0, noise=None, dt=0.05):
    """Balls of 0.5 kg thrown under gravity and a drag of -0.2 kg/s * v."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n_times)[:, None]
    rate, fall = C1 / MASS, np.array([0.0, -9.81 * MASS / C1])
    scenes = []
    for k in range(n_scenes):
        v = np.array([3.0 + k, 4.0 - k])
        p = [0.0, 10.0] + fall * t + (v - fall) / rate * (1 - np.exp(-rate * t))
        p = p + sigma * rng.standard_normal(p.shape)
        ball = Entity("ball", "disc", radius=0.05, properties={"mass": MASS})
        scenes.append(Scene(f"s{k}", t[:, 0], p[:, None], (ball,)))
    return Dataset("throws", tuple(scenes), units=SI, up="y", noise=noise)


def throws_folder(folder, **settings):
    """The same as a folder."""
    return save_dataset(throws(**settings), folder)
