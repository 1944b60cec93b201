"""Worlds with other effects in them than tests/planted.py, made by scipy's DOP853 as well.

Every maker takes a seed and returns a Dataset whose declared model (`GRAVITY` there, `WEIGHT`
here) lacks exactly one thing.
"""

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from tests.planted import SI

WEIGHT = "9.81 [m/s^2] * m_i * down"


def moved(motion, start, times):
    """Positions and velocities at `times`, each of shape (T, N, d); start likewise (2, N, d)."""

    def slope(t, state):
        p, v = state.reshape(start.shape)
        return np.concatenate([v.ravel(), motion(t, p, v).ravel()])

    track = solve_ivp(
        slope, (0, times[-1]), start.ravel(), method="DOP853", t_eval=times, rtol=1e-10, atol=1e-10
    )
    states = track.y.T.reshape(len(times), *start.shape)
    return states[:, 0], states[:, 1]


def split_dataset(name, make_scene, seed, n_train=4, n_test=6, **settings):
    """Scenes named by their number; the first ones are trained on."""
    rng = np.random.default_rng(seed)
    scenes = [make_scene(str(k), child) for k, child in enumerate(rng.spawn(n_train + n_test))]
    names = [scene.name for scene in scenes]
    return Dataset(
        f"{name} {seed}",
        scenes,
        train=tuple(names[:n_train]),
        test=tuple(names[n_train:]),
        units=SI,
        **settings,
    )


def flights(
    seed,
    force,
    *,
    sigma=0.005,
    n_times=40,
    dt=0.05,
    n_dims=2,
    same_mass=False,
    noise=None,
    warp=None,
    **split,
):
    """One ball a scene, thrown under its weight and ``force(t, p, v, m, q)``.

    `noise(rng, shape)` draws what is added to positions; `warp(times, positions)` is what the
    camera makes of them.
    """
    axis = n_dims - 1

    def scene(name, rng):
        m = 1.0 if same_mass else rng.uniform(0.3, 3.0)
        q = rng.uniform(0.5, 2.0) * rng.choice([-1.0, 1.0])
        start = np.zeros((2, 1, n_dims))
        start[0, 0, axis] = 20.0
        start[1, 0] = rng.uniform(-6.0, 6.0, n_dims)
        start[1, 0, axis] = rng.uniform(2.0, 8.0)
        weight = np.zeros(n_dims)
        weight[axis] = -9.81

        def motion(t, p, v):
            return weight + force(t, p[0], v[0], m, q)[None] / m

        times = dt * np.arange(n_times)
        p, _ = moved(motion, start, times)
        if warp is not None:
            times, p = warp(times, p)
        p = p + (noise(rng, p.shape) if noise else sigma * rng.standard_normal(p.shape))
        return Scene(name, times, p, [Entity("ball", properties={"mass": m, "charge": q})])

    return split_dataset("flights", scene, seed, up="xyz"[axis], **split)


def quadratic_drag(t, p, v, m, q, c=0.05):
    return -c * np.linalg.norm(v) * v


def linear_drag(t, p, v, m, q, c=0.3):
    return -c * v


def wind(t, p, v, m, q, c=1.0):
    """A push along x that is as large on every ball, whatever its mass."""
    return np.array([c, *np.zeros(len(p) - 1)])


def head_wind(t, p, v, m, q, c=0.3, speed=5.0):
    """Linear drag against moving air: a drag and a uniform push at once."""
    return -c * (v - wind(t, p, v, m, q, speed))


def magnetic(t, p, v, m, q, b=1.0):
    """Across the velocity, with the charge: q b times v turned by +90 degrees."""
    return q * b * np.array([-v[1], v[0]])


def gusts(t, p, v, m, q, c=1.5):
    """A wind that changes with time alone, which no law of place and speed can say."""
    return np.array([c * np.sin(2 * np.pi * t / 1.3), 0.0])


def trap(t, p, v, m, q, k=2.0):
    """A spring to a place where nothing is seen."""
    return -k * (p - np.array([2.0, 15.0]))


def nothing(t, p, v, m, q):
    return np.zeros(len(p))


def tied(seed, *, k=8.0, rest=1.0, damping=0.0, sigma=0.003, n_times=50, dt=0.05, **split):
    """A body on a spring to an anchor that is seen; nothing else acts, or a dashpot."""

    def scene(name, rng):
        m = rng.uniform(0.5, 2.0)
        angle = rng.uniform(0, 2 * np.pi)
        start = np.zeros((2, 1, 2))
        start[0, 0] = rng.uniform(1.2, 2.5) * np.array([np.cos(angle), np.sin(angle)])
        start[1, 0] = rng.uniform(-2.0, 2.0, 2)

        def motion(t, p, v):
            r = np.linalg.norm(p)
            return (-k * (r - rest) * p / r - damping * v) / m

        times = dt * np.arange(n_times)
        p, _ = moved(motion, start, times)
        p = p + sigma * rng.standard_normal(p.shape)
        p = np.concatenate([p, np.zeros_like(p)], axis=1)
        # A property of its own that both have: the rest length of the spring, stiffness unknown.
        ball = Entity("ball", properties={"mass": m, "rest_length": rest})
        post = Entity("post", is_static=True, properties={"rest_length": rest})
        return Scene(name, times, p, [ball, post])

    return split_dataset("tied", scene, seed, **split)


def orbits(
    seed,
    *,
    exponent=2.0,
    extra=None,
    hidden=None,
    charges=False,
    sigma=0.01,
    n_times=40,
    dt=0.15,
    **split,
):
    """A heavy body and two light ones; pull 1000 m / r^exponent, and ``extra(t, p, v, m, q)``.

    `hidden` is the mass and place of a body at rest that no camera sees.
    """

    def scene(name, rng):
        masses = np.array([1000.0, *rng.uniform(1.0, 5.0, 2)])
        q = np.array([0.0, *rng.uniform(1.0, 3.0, 2)]) if charges else np.zeros(3)
        radii = np.array([15.0, 30.0]) * rng.uniform(0.9, 1.1, 2)
        angles = rng.uniform(0, 2 * np.pi, 2)
        start = np.zeros((2, 3, 2))
        start[0, 1:] = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        speeds = np.sqrt(1000.0 / radii ** (exponent - 1)) * rng.uniform(0.85, 1.1, 2)
        speeds *= rng.choice([-1.0, 1.0], 2)
        start[1, 1:] = speeds[:, None] * np.stack([-np.sin(angles), np.cos(angles)], axis=1)

        def motion(t, p, v):
            gap = p[None, :] - p[:, None]
            r = np.linalg.norm(gap, axis=-1) + np.eye(3)
            a = np.einsum("j,ijd->id", masses, gap / r[..., None] ** (exponent + 1))
            if extra is not None:
                a = a + extra(t, p, v, masses, q) / masses[:, None]
            if hidden is not None:
                away = np.asarray(hidden[1]) - p
                a = a + hidden[0] * away / np.linalg.norm(away, axis=1, keepdims=True) ** 3
            return a

        times = dt * np.arange(n_times)
        p, _ = moved(motion, start, times)
        p = p + sigma * rng.standard_normal(p.shape)
        entities = [
            Entity(f"body{k}", properties={"mass": m, **({"charge": q[k]} if charges else {})})
            for k, m in enumerate(masses)
        ]
        return Scene(name, times, p, entities)

    return split_dataset("orbits", scene, seed, **split)


def repulsion(t, p, v, m, q, c=300.0):
    """Coulomb's force between charges of one sign."""
    gap = p[:, None] - p[None, :]
    r = np.linalg.norm(gap, axis=-1) + np.eye(len(p))
    return c * np.einsum("i,j,ijd->id", q, q, gap / r[..., None] ** 3)


def red_noise(rng, shape, sigma=0.02, memory=0.8):
    """Position errors with a memory: an autoregressive series along time."""
    out = sigma * rng.standard_normal(shape)
    for k in range(1, shape[0]):
        out[k] = memory * out[k - 1] + np.sqrt(1 - memory**2) * out[k]
    return out


def heavy_noise(rng, shape, sigma=0.005):
    """Student's t with three degrees of freedom: now and then a gross outlier."""
    return sigma * rng.standard_t(3, shape)
