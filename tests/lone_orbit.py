"""A star that goes round what nobody sees, by Kepler's equation."""

import numpy as np
from scipy.optimize import newton

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.units import UnitSystem, parse_unit

MASS = 2.0
"""Of what it goes round, in masses of the Sun."""
HALF_AXIS, ECCENTRICITY, TURNED = 8.0, 0.4, 1.8
"""au, none, rad."""
PERIOD = float(np.sqrt(HALF_AXIS**3 / MASS))
"""Years."""
PLACE = (3.0, -2.0)
"""Of the unseen body, au."""


def places(years):
    """Places of the star (T, 2), au."""
    mean = 2 * np.pi * (np.asarray(years) / PERIOD + 0.8)
    e = ECCENTRICITY
    anomaly = newton(lambda x: x - e * np.sin(x) - mean, mean, lambda x: 1 - e * np.cos(x))
    x = HALF_AXIS * (np.cos(anomaly) - e)
    y = HALF_AXIS * np.sqrt(1 - e * e) * np.sin(anomaly)
    c, s = np.cos(TURNED), np.sin(TURNED)
    return np.stack([c * x - s * y, s * x + c * y], axis=1) + PLACE


def dataset(seed=0, *, snr=30.0, unit="au", n_epochs=38, periods=1.2):
    """One recording with quoted errors, declared in some unit."""
    rng = np.random.default_rng([26, seed])
    years = np.sort(rng.uniform(0, periods * PERIOD, n_epochs))
    sigma = HALF_AXIS / snr
    seen = places(years) + sigma * rng.standard_normal((n_epochs, 2))
    au, year = parse_unit("au")[0], parse_unit("yr")[0]
    scene = Scene(
        "orbit", years * year, au * seen[:, None], (Entity("star"),),
        sigma=np.full((n_epochs, 1, 2), au * sigma),
    )  # fmt: skip
    units = UnitSystem.from_declared({"length": unit, "time": "yr"})
    return Dataset("orbit", (scene,), units=units)
