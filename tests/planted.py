"""Worlds with a known effect in them, made by scipy's DOP853 and not by our own integrator."""

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.units import UnitSystem

G = 1.0
SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})


def orbit_scene(name, rng, *, drag=0.0, n_light=2, n_times=40, dt=0.15, sigma=0.01):
    """A heavy central body with light ones around it, gravity and linear drag -drag * v."""
    masses = np.array([1000.0, *rng.uniform(1.0, 5.0, n_light)])
    radii = np.linspace(15.0, 30.0, n_light) * rng.uniform(0.95, 1.05, n_light)
    angles = rng.uniform(0, 2 * np.pi, n_light)
    positions = np.zeros((n_light + 1, 2))
    velocities = np.zeros((n_light + 1, 2))
    positions[1:] = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    speeds = np.sqrt(G * masses[0] / radii) * rng.uniform(0.85, 1.1, n_light)
    sense = rng.choice([-1.0, 1.0], n_light)
    velocities[1:] = (speeds * sense)[:, None] * np.stack([-np.sin(angles), np.cos(angles)], axis=1)

    def motion(t, state):
        p, v = state.reshape(2, -1, 2)
        gap = p[None, :] - p[:, None]
        cube = np.sum(gap**2, axis=-1) ** 1.5 + np.eye(len(p))
        a = G * np.einsum("j,ijd->id", masses, gap / cube[..., None]) - drag * v / masses[:, None]
        return np.concatenate([v.ravel(), a.ravel()])

    times = dt * np.arange(n_times)
    start = np.concatenate([positions.ravel(), velocities.ravel()])
    track = solve_ivp(
        motion, (0, times[-1]), start, method="DOP853", t_eval=times, rtol=1e-10, atol=1e-10
    )
    p = track.y.T.reshape(n_times, 2, -1, 2)[:, 0]
    p = p + sigma * rng.standard_normal(p.shape)
    entities = [Entity(f"body{k}", properties={"mass": m}) for k, m in enumerate(masses)]
    return Scene(name, times, p, entities)


def orbit_dataset(seed, *, n_train=4, n_test=6, **options):
    """Scenes split into training and held-out ones; units SI."""
    rng = np.random.default_rng(seed)
    scenes = [
        orbit_scene(str(k), child, **options) for k, child in enumerate(rng.spawn(n_train + n_test))
    ]
    names = [scene.name for scene in scenes]
    return Dataset(
        f"orbits {seed}",
        scenes,
        train=tuple(names[:n_train]),
        test=tuple(names[n_train:]),
        units=SI,
    )


GRAVITY = "1 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
