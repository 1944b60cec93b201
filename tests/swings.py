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
