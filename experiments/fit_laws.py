"""Twenty laws of every form, each with a world of its own and what is compared of its fit."""

from dataclasses import dataclass, field

import numpy as np
from fit_tracks import Shot, World, integrated
from fit_worlds import anchor, moving

from bsp_gp.data.scene import Entity

CENTRE = (0.0, 0.0)

@dataclass(frozen=True, eq=False)
class Case:
    """A world, what is compared of it, and how its fit must end."""

    world: World
    compared: dict = field(default_factory=dict)
    """Name -> weights of the constants; by default every constant by itself."""
    status: tuple = ("converged",)


def _throws(rng, laws, truth, acceleration, *, n_rows=80, span=2.0, n_shots=2, extra=()):
    """A ball of 0.5 kg thrown n times, noise of 1 cm."""
    shots = [
        Shot(
            np.linspace(0.0, span, n_rows),
            np.array([[[0.0, 10.0]], [rng.uniform([2.0, 1.0], [6.0, 5.0])]]),
            np.array(0.01),
        )
        for _ in range(n_shots)
    ]
    entities = (moving("ball", 0.5, **dict(extra)),)
    return World("", laws, truth, entities, tuple(shots), integrated(acceleration))


def _around(rng, laws, truth, acceleration, *, entities=None, n_rows=100, span=10.0, line=False,
            sigma=0.01):  # fmt: skip
    """A body of 2 kg that moves around or about an anchor in the middle, at 1 m and 1 m/s."""
    place, speed = rng.uniform(0.9, 1.2), rng.uniform(0.7, 0.9)
    states = np.array([[[place, 0.0]], [[0.1, speed]]])
    shot = Shot(np.linspace(0.0, span, n_rows), states[..., :1] if line else states,
                np.array(sigma))  # fmt: skip
    entities = entities or (moving("bob", 2.0), anchor(rest_length=0.6))
    return World("", laws, truth, entities, (shot,), integrated(acceleration), fixed=CENTRE)


def _speed(v):
    return np.sqrt(np.square(v).sum(axis=-1, keepdims=True))


DOWN = np.array([0.0, 1.0])
WEIGHT = "-g * m_i * e_y"


def _falls(name, rng):
    drags = {
        "weight": ((), {}, lambda v, c: 0.0),
        "linear drag": (("-c * v_i",), {"c": 0.2}, lambda v, c: c["c"] * v),
        "quadratic drag": (
            ("-c * norm(v_i) * v_i",), {"c": 0.05}, lambda v, c: c["c"] * _speed(v) * v,
        ),
        "drag of any power": (
            ("-c * norm(v_i)^n * normalize(v_i)",), {"c": 0.05, "n": 1.6},
            lambda v, c: c["c"] * _speed(v) ** (c["n"] - 1) * v,
        ),
        "degenerate sum": (
            ("-(a + b) * v_i",), {"a": 0.15, "b": 0.1}, lambda v, c: (c["a"] + c["b"]) * v,
        ),
        "at a bound": (("-c * v_i",), {"c": 0.02}, lambda v, c: c["c"] * v),
        "magnetic": (
            ("B * q_i * perp(v_i)",), {"B": 0.7},
            lambda v, c: -c["B"] * 1.5 * np.stack([-v[..., 1], v[..., 0]], axis=-1),
        ),
    }  # fmt: skip
    laws, truth, drag = drags[name]

    def acceleration(t, p, v, c):
        return -c["g"] * DOWN - drag(v, c) / 0.5 + 0 * v

    extra = {"charge": 1.5} if name == "magnetic" else {}
    return _throws(rng, (WEIGHT, *laws), {"g": 9.81, **truth}, acceleration, extra=extra)


def _centrals(name, rng):
    towards = "normalize(p_j - p_i)"
    springs = {
        "spring": ("-k * (p_i - p_j)", {"k": 3.0}, lambda r, c: c["k"] * r / 2),
        "stretched spring": (
            "-k * (norm(p_i - p_j) - l_j) * normalize(p_i - p_j)", {"k": 6.0},
            lambda r, c: c["k"] * (r - 0.6) / 2,
        ),
        "central gravity": (
            f"k * m_i / norm(p_i - p_j)^2 * {towards}", {"k": 1.0}, lambda r, c: c["k"] / r**2,
        ),
        "central power": (
            f"k * m_i * norm(p_i - p_j)^n * {towards}", {"k": 1.0, "n": -1.4},
            lambda r, c: c["k"] * r ** c["n"],
        ),
        "screened": (
            f"k * m_i * exp(-norm(p_i - p_j) / h) / norm(p_i - p_j)^2 * {towards}",
            {"k": 2.0, "h": 1.5}, lambda r, c: c["k"] * np.exp(-r / c["h"]) / r**2,
        ),
    }  # fmt: skip
    is_damped = name == "damped spring"
    law, truth, pull = springs["spring" if is_damped else name]
    laws, truth = ((law, "-c * v_i"), {**truth, "c": 0.1}) if is_damped else ((law,), truth)

    def acceleration(t, p, v, c):
        r = _speed(p)
        return -pull(r, c) * p / r - (c["c"] * v / 2 if is_damped else 0.0)

    return _around(rng, laws, truth, acceleration)


def _pendulum(name, rng):
    law = "-a * m_i * sin(dot(p_i - p_j, e_x) / 1 [m]) * e_x"
    return _around(rng, (law,), {"a": 4.0}, lambda t, p, v, c: -c["a"] * np.sin(p), line=True)


def _coupled(name, rng):
    entities = (
        moving("left", 2.0, tie=0.0, bond=1.0), moving("right", 2.0, tie=0.0, bond=1.0),
        anchor(tie=1.0, bond=0.0),
    )  # fmt: skip
    laws = ("-k * tie_j * (p_i - p_j)", "-b * bond_j * (p_i - p_j)")

    def acceleration(t, p, v, c):
        return (-c["k"] * p - c["b"] * (p - p[:, ::-1])) / 2

    states = rng.uniform(0.5, 1.5, (2, 2, 1)) * np.array([[[1.0], [-0.4]], [[0.3], [0.8]]])
    shot = Shot(np.linspace(0.0, 10.0, 100), states, np.array(0.01))
    return World("", laws, {"k": 3.0, "b": 1.0}, entities, (shot,), integrated(acceleration),
                 fixed=CENTRE)  # fmt: skip


def _free_pair(name, rng):
    masses = np.array([2.0, 1.0])

    def acceleration(t, p, v, c):
        apart = p[:, ::-1] - p
        return c["g"] * masses[::-1, None] * apart / _speed(apart) ** 3

    states = np.array([[[-0.4, 0.0], [0.8, 0.0]], [[0.0, -0.4], [0.0, 0.8]]])
    states[1] *= rng.uniform(0.7, 0.9)
    shot = Shot(np.linspace(0.0, 10.0, 100), states, np.array(0.01))
    law = "g * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
    entities = (moving("heavy", 2.0), moving("light", 1.0))
    return World("", (law,), {"g": 0.5}, entities, (shot,), integrated(acceleration))


def _in_time(name, rng):
    laws = {
        "decaying push": ("a * exp(-t / h) * e_x", {"a": 3.0, "h": 1.5},
                          lambda t, c: c["a"] * np.exp(-t / c["h"])),
        "periodic push": ("a * sin(w * t) * e_x", {"a": 3.0, "w": 4.0},
                          lambda t, c: c["a"] * np.sin(c["w"] * t)),
    }  # fmt: skip
    law, truth, push = laws[name]
    along = np.array([1.0, 0.0])
    world = _throws(
        rng, (law,), truth, lambda t, p, v, c: push(t, c) * along / 0.5 + 0 * v,
        n_rows=150, span=5.0, n_shots=1,
    )  # fmt: skip
    mirror = ("a", "w") if "w" in truth else ()
    return World("", world.laws, truth, world.entities, world.shots, world.track, mirror=mirror)


def _contact(name, rng):
    """A soft disc that runs into another, which stands."""
    reach = 1.0
    disc = Entity("disc", "disc", radius=0.4, properties={"mass": 2.0})
    post = Entity("post", "disc", radius=0.6, is_static=True)
    law = (
        "h * (R_i + R_j - norm(p_i - p_j)) * does_collide(s_i, p_i, s_j, p_j) "
        "* normalize(p_i - p_j)"
    )

    def acceleration(t, p, v, c):
        r = _speed(p)
        return c["h"] * np.maximum(reach - r, 0.0) * p / r / 2

    states = np.array([[[-2.5, rng.uniform(0.2, 0.4)]], [[1.5, 0.0]]])
    shot = Shot(np.linspace(0.0, 4.0, 160), states, np.array(0.005))
    return World("", (law,), {"h": 60.0}, (disc, post), (shot,), integrated(acceleration),
                 fixed=CENTRE)  # fmt: skip


def _mat(name, rng):
    """A puck that slides over a mat and off again, along x, in closed form."""
    half, friction = 1.0, 0.5
    puck = Entity("puck", "disc", radius=0.05, properties={"mass": 0.3})
    mat = Entity("mat", "rect_mat", width=2 * half, height=4.0, is_static=True,
                 properties={"friction": friction})  # fmt: skip

    def track(times, c, states):
        t = (times - times[0])[None]
        x, v = states[:, 0, 0, :1], states[:, 1, 0, :1]
        slowing = c["c"][:, None] * friction
        enters = (-half - x) / v
        crossing = (v - np.sqrt(v**2 - 4 * slowing * half)) / slowing
        inside = np.clip(t - enters, 0.0, crossing)
        after = np.maximum(t - enters - crossing, 0.0)
        before = np.minimum(t, enters)
        along = x + v * (before + inside + after)
        along = along - slowing * (inside**2 / 2 + after * crossing)
        across = states[:, 0, 0, 1:] + 0 * t
        return np.stack([along, across], axis=-1)[:, :, None]

    shots = []
    for _ in range(2):
        states = np.array([[[-1.5, 0.2]], [[rng.uniform(1.6, 2.2), 0.0]]])
        shots.append(Shot(np.linspace(0.0, 2.4, 120), states[..., :1], np.array(0.003)))

    def along_x(times, c, states):
        full = np.concatenate([states, np.zeros_like(states)], axis=-1)
        return track(times, c, full)[..., :1]

    law = "-c * m_i * mu_j * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)"
    return World("", (law,), {"c": 1.2}, (puck, mat), tuple(shots), along_x, fixed=CENTRE)


CASES = {
    **dict.fromkeys(("weight", "linear drag", "quadratic drag", "drag of any power",
                     "degenerate sum", "at a bound", "magnetic"), _falls),
    **dict.fromkeys(("spring", "damped spring", "stretched spring", "central gravity",
                     "central power", "screened"), _centrals),
    **dict.fromkeys(("decaying push", "periodic push"), _in_time),
    "pendulum": _pendulum, "two coupled": _coupled, "free pair": _free_pair,
    "contact": _contact, "mat": _mat,
}  # fmt: skip


def case(name, rng):
    """One of the twenty."""
    world = CASES[name](name, rng)
    settings = {}
    if name == "degenerate sum":
        settings["compared"] = {"g": (1.0, 0.0, 0.0), "a + b": (0.0, 1.0, 1.0)}
    if name == "at a bound":  # which shuts out the truth by some standard errors
        world.bounds["c"] = (0.025, 1.0)
        settings = {"compared": {"g": (1.0, 0.0)}, "status": ("at_bound",)}
    compared = {n: row for n, row in zip(world.truth, np.eye(len(world.truth)), strict=True)}
    return Case(world, **{"compared": compared, **settings})
