"""What commands cost against rows, scenes, bodies: processor time and peak memory of fresh processes.

The data sets are made in closed form (rows, scenes) or by scipy's DOP853 (bodies), the lack is a
linear drag, and every command is run as a user runs it: reading the table and writing the report
are in its cost. `--only close:rows` and `--sizes 1000 10000` choose; exponents are slopes of
log cost over log size through the larger half of the sizes, where the fixed cost is no longer seen.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, save_figure, write_table, write_text

SIGMA = 0.002
"""Noise of a position, m."""
TOML = '[units]\nlength = "m"\ntime = "s"\nmass = "kg"\n\n[axes]\nup = "y"\n'
SPRING, GRAVITY = "-k_j * (p_i - p_j)", "9.81 [m/s^2] * m_i * down"
PULL = "0.02 [N*m^2/kg^2] * m_i * m_j / norm(p_j - p_i)^2 * normalize(p_j - p_i)"


def oscillator(n_rows, rng, is_long=False):
    """A damped bob on a spring: ten periods however many rows, or 30 rows to a second."""
    span = n_rows / 30.0 if is_long else 30.0
    damping = 1.5 / span if is_long else 0.05
    t = np.arange(n_rows) * (span / n_rows)
    rate = -damping / 2 + 1j * np.sqrt(4.0 - damping**2 / 4)
    x, y = (np.real(z * np.exp(rate * t)) for z in (1.0 - 0.2j, 0.3 + 0.5j))
    table = pd.DataFrame({"t": t, "entity": "bob", "x": x, "y": y})
    return pegged(noisy(table, rng), t), ["bob", "peg"], [SPRING]


def throws(n_scenes, rng, n_rows=40):
    """Balls thrown in many scenes, linear drag."""
    drag, t = 0.1, np.linspace(0.0, 1.5, n_rows)
    fade = -np.expm1(-drag * t) / drag
    start = rng.uniform((-1, 1, 1, 2), (1, 2, 4, 8), (n_scenes, 4))
    x = start[:, :1] + start[:, 2:3] * fade
    y = start[:, 1:2] + start[:, 3:] * fade - 9.81 * (t - fade) / drag
    scenes = np.repeat([f"s{k:06d}" for k in range(n_scenes)], n_rows)
    table = pd.DataFrame(
        {"scene": scenes, "t": np.tile(t, n_scenes), "entity": "ball", "x": x.ravel(), "y": y.ravel()}
    )
    return noisy(table, rng), ["ball"], [GRAVITY]


def crowd(n_bodies, rng, n_rows=200):
    """Bodies of 1 kg in one trap, which attract each other, linear drag."""
    k = np.arange(n_bodies) + 1.0
    angle = 2.4 * k  # as seeds of a sunflower: no two are near
    places = 0.35 * np.sqrt(k)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    speeds = 2.0 * places[:, ::-1] * (-1.0, 1.0) * rng.uniform(0.9, 1.1, (n_bodies, 1))

    def rate(t, state):
        p, v = state.reshape(2, n_bodies, 2)
        apart = p[None] - p[:, None]
        cube = (np.square(apart).sum(axis=-1) + np.eye(n_bodies)) ** 1.5
        pull = 0.02 * (apart / cube[..., None]).sum(axis=1)
        return np.concatenate([v.ravel(), (pull - 4.0 * p - 0.05 * v).ravel()])

    t = np.linspace(0.0, 6.0, n_rows)
    first = np.concatenate([places.ravel(), speeds.ravel()])
    found = solve_ivp(rate, (0.0, 6.0), first, "DOP853", t, rtol=1e-9, atol=1e-9)
    tracks = found.y[: 2 * n_bodies].reshape(n_bodies, 2, n_rows)
    names = [f"b{int(i):03d}" for i in k]
    table = pd.DataFrame({
        "t": np.tile(t, n_bodies), "entity": np.repeat(names, n_rows),
        "x": tracks[:, 0].ravel(), "y": tracks[:, 1].ravel(),
    })  # fmt: skip
    return pegged(noisy(table, rng), t), [*names, "peg"], [SPRING, PULL]


def rain(n_bodies, rng, n_rows=200):
    """Balls thrown in one scene that do not feel each other, linear drag."""
    table, _, laws = throws(n_bodies, rng, n_rows)
    table["entity"] = table.pop("scene")
    return table, list(table["entity"].unique()), laws


def pegged(table, t):
    peg = pd.DataFrame({"t": t, "entity": "peg", "x": 0.0, "y": 0.0})
    return pd.concat([table, peg], ignore_index=True)


def noisy(table, rng):
    for axis in ("x", "y"):
        table[axis] += SIGMA * rng.standard_normal(len(table))
    return table


def saved(table, names, folder, kind="csv"):
    """A data set's folder; where there is a spring, it is tied to a peg."""
    folder.mkdir(parents=True)
    if kind == "parquet":
        table.to_parquet(folder / "trajectories.parquet")
    else:
        table.to_csv(folder / "trajectories.csv", index=False, float_format="%.6f")
    bodies = pd.DataFrame({"entity": names, "mass": 1.0, "stiffness": 0.0, "dynamic": 1})
    if "peg" in names:
        bodies.loc[bodies["entity"] == "peg", ["mass", "stiffness", "dynamic"]] = 0.0, 4.0, 0
    bodies.to_csv(folder / "entities.csv", index=False)
    (folder / "dataset.toml").write_text(TOML)


def cost(argv, log):
    """Seconds of processor and wall time and peak MiB of a process, and its exit status."""
    began = time.monotonic()
    with log.open("w") as out:
        process = subprocess.Popen(argv, stdout=out, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return {
        "cpu_s": usage.ru_utime + usage.ru_stime, "wall_s": time.monotonic() - began,
        "peak_mib": usage.ru_maxrss / 1024, "exit": process.returncode,
    }  # fmt: skip
