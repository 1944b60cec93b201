"""A bob on a rod, by scipy: what tests of constraints look at."""

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

import bsp_gp

G, LENGTH, PIVOT = 9.81, 0.8, (0.02, 1.61)
WEIGHT = "9.81 [m/s^2] * m_i * down"
ROD = "norm(p_i - (0.02, 1.61)) = 0.8"


def swing(force=lambda v: 0.0, n=120, dt=0.02, sigma=1e-3, seed=0):
    """Places of a bob of 1 kg on a rod, with noise; a force along its way at a velocity."""
    t = np.arange(n) * dt

    def rate(_, z):
        return [z[1], -G / LENGTH * np.sin(z[0]) + force(LENGTH * z[1]) / LENGTH]

    angle = solve_ivp(
        rate, (0, t[-1]), [1.1, 0.4], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01
    ).y[0]
    x, y = PIVOT[0] + LENGTH * np.sin(angle), PIVOT[1] - LENGTH * np.cos(angle)
    noise = sigma * np.random.default_rng(seed).standard_normal((2, n))
    return pd.DataFrame({"t": t, "x": x + noise[0], "y": y + noise[1]})


def bob(*args, units=("m", "s"), **kwargs):
    return bsp_gp.Dataset.from_frames(
        swing(*args, **kwargs), units=dict(zip(("length", "time"), units, strict=True)), up="y"
    )


def double_bob(
    ratio=1.5, n=240, dt=1 / 60, sigma=1e-3, begin=(0.9, -0.5), entities=None, marks_nail=False
):  # fmt: skip
    """Two bobs: B, `ratio` times as heavy as A, on a rod of 0.25 m to it, A on one of 0.15 m.

    `marks_nail`: what A hangs from is followed as well.
    """
    one, other, t = 0.15, 0.25, np.arange(n) * dt

    def rate(_, z):
        a, b, u, v = z
        c, s = np.cos(a - b), np.sin(a - b)
        matrix = [[(1 + ratio) * one, ratio * other * c], [one * c, other]]
        pulls = G * np.sin(a), G * np.sin(b)
        right = [-ratio * other * v**2 * s - (1 + ratio) * pulls[0], one * u**2 * s - pulls[1]]
        return [u, v, *np.linalg.solve(matrix, right)]

    a, b, *_ = solve_ivp(rate, (0, t[-1]), [*begin, 0, 0], t_eval=t, rtol=1e-10, atol=1e-10).y
    places = {"A": (0.03 + one * np.sin(a), -0.02 - one * np.cos(a))}
    places["B"] = places["A"][0] + other * np.sin(b), places["A"][1] - other * np.cos(b)
    if marks_nail:
        places["nail"] = np.full(n, 0.03), np.full(n, -0.02)
    noise = np.random.default_rng(0)
    frames = [
        pd.DataFrame({"t": t, "entity": name, "x": x + noise.normal(0, sigma, n),
                      "y": y + noise.normal(0, sigma, n)})
        for name, (x, y) in places.items()
    ]  # fmt: skip
    return bsp_gp.Dataset.from_frames(
        pd.concat(frames), entities, units={"length": "m", "time": "s", "mass": "kg"}, up="y"
    )
