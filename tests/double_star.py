"""A double star with a drag, integrated by scipy: masses and drag are what tests infer."""

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.inference.latents import latents_of
from bsp_gp.inference.priors import Prior
from bsp_gp.units import UnitSystem

SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
PULL = "1.0 [m^3/(kg s^2)] * m_i * m_j * (p_j - p_i) / norm(p_j - p_i)^3"
DRAG = "-c * v_i"
MASSES, C = (2.0, 1.0), 0.01
PRIOR = Prior("uniform", 0.2, 9.0)


def motion(times, state, masses=MASSES, c=C):
    """Places (T, 2, 2) from a state (places, then velocities, of both)."""
    masses = np.array(masses)

    def slope(_, y):
        p, v = y.reshape(2, 2, 2)
        gap = p[1] - p[0]
        pull = gap / np.linalg.norm(gap) ** 3
        a = np.array([masses[1] * pull, -masses[0] * pull]) - c * v / masses[:, None]
        return np.concatenate([v.ravel(), a.ravel()])

    found = solve_ivp(
        slope, (times[0], times[-1]), state, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-13
    )
    return found.y[:4].T.reshape(-1, 2, 2)


def start(eccentricity):
    """State at the periastron of a relative orbit of half axis 1 m."""
    m1, m2 = MASSES
    r = 1 - eccentricity
    v = np.sqrt((m1 + m2) * (1 + eccentricity) / (1 - eccentricity))
    share = np.array([-m2, m1]) / (m1 + m2)
    return np.array([share[0] * r, 0, share[1] * r, 0, 0, share[0] * v, 0, share[1] * v])


def dataset(seed=0, *, eccentricity=0.3, revolutions=4, epochs=40, noise=1e-3, latents=()):
    """One recording, `epochs` rows a revolution."""
    rng = np.random.default_rng([7, seed])
    period = 2 * np.pi / np.sqrt(sum(MASSES))
    times = np.linspace(0, revolutions * period, revolutions * epochs + 1)
    places = motion(times, start(eccentricity))
    places = places + noise * rng.standard_normal(places.shape)
    stars = [Entity(n, properties={"mass": m}) for n, m in zip("AB", MASSES, strict=True)]
    scene = Scene("s", times, places, stars)
    return Dataset("double star", (scene,), units=SI, latents=latents, noise=(noise, noise))


def law_of(data, c=C):
    law = read_law(data, [PULL, DRAG])
    return law.with_constants({"c": c})


def masses_of(data):
    return latents_of(data.scenes, "mass", PRIOR)
