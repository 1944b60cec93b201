"""Worlds for the studies of fits: oscillators, pushes, pair forces, a pendulum's angle.

Every maker is ``maker(rng) -> World``; times, lengths and masses are of many sizes.
"""

import numpy as np
from fit_tracks import Shot, World, growth, integrated, linear, positions_of

from bsp_gp.data.scene import Entity

TIE = "-k * (p_i - p_j)"
STRETCHED = "-k * (norm(p_i - p_j) - l_j) * normalize(p_i - p_j)"
SINE = "-a * m_i * sin(dot(p_i - p_j, e_x) / 1 [m]) * e_x"
"""A pendulum's angle as a place on a line: 1 m is 1 rad."""
TIED, BOND = "-k * tie_j * (p_i - p_j)", "-b * bond_j * (p_i - p_j)"
DAMPING = "-c * v_i"
PUSH = "a * sin(w * t) * e_x"
CLOSEST = 0.2
PAIR = "k * m_i * m_j * norm(p_i - p_j)^n * normalize(p_i - p_j)"


def between(rng, low, high):
    """A number, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def moving(name, mass, **properties):
    return Entity(name, "point", properties={"mass": mass, **properties})


def anchor(**properties):
    return Entity("anchor", "point", is_static=True, properties=properties)


def rows_over(rng, periods, period, low=300, high=5000):
    """Even times over so many periods, at least three rows in each."""
    n = int(between(rng, max(low, 3 * periods), high))
    return np.linspace(0.0, periods * period, n)


def damped(rng, laws, truth, mass, span):
    """Laws and constants with damping in half of the cases: 0.2 to 3 e-folds over the span."""
    if rng.random() < 0.5:
        return laws, truth
    return (*laws, DAMPING), {**truth, "c": rng.uniform(0.2, 3.0) * 2 * mass / span}


# --- oscillators ----------------------------------------------------------------------------------


def oscillator(rng):
    """One of four kinds, 1 to 100 periods of its fastest mode, 300 to 5,000 rows."""
    maker = (_spring, _stretched, _pendulum, _coupled)[rng.integers(4)]
    periods = between(rng, 1.0, 100.0)
    world, size = maker(rng, periods)
    level = between(rng, 0.005, 0.05)
    (shot,) = world.shots
    shot = Shot(shot.times, shot.states, np.array(level * size))
    noise = ("declared", "estimated")[rng.integers(2)]
    facts = {
        "periods": periods, "rows": len(shot.times), "level": level, "noise": noise,
        "damped": "c" in world.truth,
    }  # fmt: skip
    return World(
        world.kind, world.laws, world.truth, world.entities, (shot,), world.track,
        noise, world.fixed, facts=facts,
    )  # fmt: skip


def _begun(rng, shape, size, rate):
    """Places and velocities of a swing of about this size, neither at rest nor at the middle."""
    phase = rng.uniform(0, 2 * np.pi, shape)
    sizes = size * rng.uniform(0.5, 1.0, shape)
    return np.stack([sizes * np.cos(phase), -rate * sizes * np.sin(phase)])


def _of_matrix(blocks, mass):
    """z' = A z of equal masses: places' forces by `blocks(constants)`, damping c."""

    def matrix(constants):
        forces = blocks(constants)
        copies, n, _ = forces.shape
        found = np.zeros((copies, 2 * n, 2 * n))
        found[:, :n, n:] = np.eye(n)
        found[:, n:, :n] = forces / mass
        found[:, n:, n:] = -np.eye(n) * np.reshape(constants.get("c", 0.0), (-1, 1, 1)) / mass
        return found

    return linear(matrix)


def _spring(rng, periods):
    rate, mass, size = between(rng, 0.03, 30.0), between(rng, 0.1, 10.0), between(rng, 0.1, 10.0)
    n_dims = int(rng.integers(1, 3))
    times = rows_over(rng, periods, 2 * np.pi / rate)
    laws, truth = damped(rng, (TIE,), {"k": mass * rate**2}, mass, times[-1])

    def blocks(constants):
        return -constants["k"][:, None, None] * np.eye(n_dims)

    states = _begun(rng, (1, n_dims), size, rate)
    shot = Shot(times, states, np.array(size))
    entities = (moving("bob", mass), anchor())
    return World("spring", laws, truth, entities, (shot,), _of_matrix(blocks, mass),
                 fixed=(0.0, 0.0)), size  # fmt: skip


def _stretched(rng, periods):
    """A spring of some rest length in the plane, which swings around its anchor."""
    rate, mass, length = between(rng, 0.03, 30.0), between(rng, 0.1, 10.0), between(rng, 0.1, 10.0)
    times = rows_over(rng, periods, 2 * np.pi / rate)
    laws, truth = damped(rng, (STRETCHED,), {"k": mass * rate**2}, mass, times[-1])

    def acceleration(t, p, v, c):
        r = np.sqrt(np.square(p).sum(axis=-1, keepdims=True))
        return (-c["k"] * (r - length) * p / r - c.get("c", 0.0) * v) / mass

    angle = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]]) * rng.choice([-1.0, 1.0])
    speeds = rate * length * rng.uniform([-0.5, 0.3], [0.5, 0.9])
    states = np.stack([
        [rng.uniform(0.7, 1.5) * length * along],
        [speeds[0] * along + speeds[1] * across],
    ])  # fmt: skip
    entities = (moving("bob", mass), anchor(rest_length=length))
    return World("stretched spring", laws, truth, entities,
                 (Shot(times, states, np.array(length)),), integrated(acceleration),
                 fixed=(0.0, 0.0)), length  # fmt: skip


def _swinging(mass):
    """The equation of a pendulum's angle with damping c."""

    def acceleration(t, p, v, c):
        return -c["a"] * np.sin(p) - c.get("c", 0.0) / mass * v

    return integrated(acceleration)


def _pendulum(rng, periods):
    rate, mass, size = between(rng, 0.03, 30.0), between(rng, 0.1, 10.0), rng.uniform(0.3, 2.3)
    times = rows_over(rng, periods, 2 * np.pi / rate)
    laws, truth = damped(rng, (SINE,), {"a": rate**2}, mass, times[-1])
    # Energy of the amplitude `size`, at some phase of the swing.
    place = size * rng.uniform(-1, 1)
    speed = rate * np.sqrt(2 * (np.cos(place) - np.cos(size))) * rng.choice([-1.0, 1.0])
    shot = Shot(times, np.array([[[place]], [[speed]]]), np.array(size))
    return World("pendulum", laws, truth, (moving("bob", mass), anchor()), (shot,),
                 _swinging(mass), fixed=(0.0, 0.0)), size  # fmt: skip


def _coupled(rng, periods):
    """Two bobs on a line, each tied to one anchor, and to one another."""
    rate, mass, size = between(rng, 0.03, 30.0), between(rng, 0.1, 10.0), between(rng, 0.1, 10.0)
    share = between(rng, 0.05, 2.0)
    fast = rate * np.sqrt(1 + 2 * share)
    times = rows_over(rng, periods, 2 * np.pi / fast)
    stiffness = mass * rate**2
    truth = {"k": stiffness, "b": share * stiffness}
    laws, truth = damped(rng, (TIED, BOND), truth, mass, times[-1])

    def blocks(constants):
        k, b = (constants[name][:, None, None] for name in "kb")
        return -k * np.eye(2) - b * np.array([[1.0, -1.0], [-1.0, 1.0]])

    states = _begun(rng, (2, 1), size, rate)
    entities = (
        moving("left", mass, tie=0.0, bond=1.0), moving("right", mass, tie=0.0, bond=1.0),
        anchor(tie=1.0, bond=0.0),
    )  # fmt: skip
    return World("two coupled", laws, truth, entities, (Shot(times, states, np.array(size)),),
                 _of_matrix(blocks, mass), fixed=(0.0, 0.0)), size  # fmt: skip


# --- pushes, pair forces, a pendulum's noise ------------------------------------------------------


def push(rng):
    """A body pushed by a sin(w t), w from 0.05 to 0.9 of pi/dt; noise 0.1 to 5 % of the wiggle."""
    n, dt, mass = int(rng.integers(100, 601)), between(rng, 0.003, 3.0), between(rng, 0.1, 10.0)
    share = rng.uniform(0.05, 0.9)
    w, size = share * np.pi / dt, between(rng, 0.01, 10.0)
    times = dt * np.arange(n)
    truth = {"a": size * mass * w**2, "w": w}

    def track(times, c, states):
        a, w = (c[name][:, None, None, None] for name in "aw")
        t = (times - times[0])[None, :, None, None]
        p, v = np.moveaxis(states, 1, 0)[:, :, None]
        return p + v * t + a / mass / w * (t - np.sin(w * t) / w)

    # The push itself makes a drift of a/(m w), which the free velocity takes back but for a rest.
    drift = -size * w + 10 * size / times[-1] * rng.uniform(-1, 1)
    states = np.array([[[size * rng.uniform(-5, 5)]], [[drift]]])
    level = between(rng, 0.001, 0.05)
    noise = ("declared", "estimated")[rng.integers(2)]
    facts = {"share": share, "rows": n, "level": level, "noise": noise}
    return World(
        "push", (PUSH,), truth, (moving("body", mass),),
        (Shot(times, states, np.array(level * size)),), track, noise, mirror=("a", "w"),
        facts=facts,
    )  # fmt: skip


def exponent(rng):
    """Two or three free bodies under k m_i m_j r^n, 100 epochs, noise 0.5 to 2 % of their distance.

    Two in three attract one another (n from -2.5 to 1.5, far from circles, so that the distance
    changes); the others fly apart or past one another. Closer encounters than `CLOSEST` of that
    distance, and chaos, are drawn anew.
    """
    while True:
        world = _pairs(rng)
        try:
            if _closest(world) >= CLOSEST * world.facts["size"] and growth(world) <= 3.0:
                return world
        except ArithmeticError:  # a collision
            continue


def _closest(world):
    (shot,) = world.shots
    often = np.linspace(shot.times[0], shot.times[-1], 1000)
    places = positions_of(world, Shot(often, shot.states, shot.sigma))
    apart = places[:, :, None] - places[:, None]
    first, second = np.triu_indices(places.shape[1], 1)
    return np.sqrt(np.square(apart).sum(axis=-1))[:, first, second].min()


def _pairs(rng):
    n_bodies, n = int(rng.integers(2, 4)), rng.uniform(-2.5, 1.5)
    sign = rng.choice([-1.0, -1.0, 1.0])
    size, rate = between(rng, 0.1, 10.0), between(rng, 0.1, 10.0)
    masses = rng.uniform(0.5, 2.0, n_bodies)
    k = sign * rate**2 * size ** (1 - n) / masses.sum()

    def acceleration(t, p, v, c):
        apart = p[:, :, None] - p[:, None, :]
        square = np.square(apart).sum(axis=-1) + np.eye(n_bodies)
        pulls = c["k"] * masses * square ** ((c["n"] - 1) / 2)
        return (pulls[..., None] * apart).sum(axis=2)

    angles = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n_bodies) / n_bodies
    places = size / np.sqrt(n_bodies) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    places *= rng.uniform(0.8, 1.25, (n_bodies, 1))
    spin = rate * rng.uniform(0.5, 0.85) * rng.choice([-1.0, 1.0])
    speeds = spin * np.stack([-places[:, 1], places[:, 0]], axis=-1)
    speeds -= 0.5 * (sign > 0) * rate * places
    times = np.linspace(0.0, 2 * np.pi / rate * rng.uniform(1.0, 3.0), 100)
    level = between(rng, 0.005, 0.02)
    entities = tuple(moving(f"b{j}", mass) for j, mass in enumerate(masses))
    shot = Shot(times, np.stack([places, speeds]), np.array(level * size))
    facts = {
        "size": size, "bodies": n_bodies, "exponent": n, "attracts": bool(sign < 0),
        "level": level,
    }  # fmt: skip
    return World("pair force", (PAIR,), {"k": k, "n": n}, entities, (shot,),
                 integrated(acceleration), facts=facts)  # fmt: skip


def pendulum_noise(rng):
    """The angle of a damped pendulum: 900 rows at 30 a second, white noise of 8 mrad."""
    rate, size, n = rng.uniform(3.0, 8.0), rng.uniform(0.2, 1.2), 900
    times = np.arange(n) / 30.0
    mass = 0.5
    truth = {"a": rate**2, "c": rng.uniform(0.2, 1.5) * 2 * mass / times[-1]}
    states = np.array([[[size]], [[rate * size * rng.uniform(-0.3, 0.3)]]])
    return World(
        "pendulum angle", (SINE, DAMPING), truth, (moving("bob", mass), anchor()),
        (Shot(times, states, np.array(0.008)),), _swinging(mass), "estimated", (0.0, 0.0),
        facts={"amplitude": size},
    )  # fmt: skip
