"""What commands cost against rows, scenes, bodies: seconds and peak memory of fresh processes.

The data sets are made in closed form (rows, long, scenes, rain) or by scipy's DOP853 (bodies), what
is declared lacks a linear drag, and every command is run as a user runs it: reading the table and
writing the report are in its cost. `--only rows scenes` chooses, `--most 10000` bounds the sizes;
sizes that are in the table of the folder are not run again. Exponents are slopes of log cost over
log size through the larger half of the sizes, less what the smallest size costs.
"""

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, run_jobs, write_study

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
    table = pd.DataFrame({
        "scene": scenes, "t": np.tile(t, n_scenes), "entity": "ball", "x": x.ravel(),
        "y": y.ravel(),
    })  # fmt: skip
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


KINDS = {
    "rows": (oscillator, [SPRING], (900, 10_000, 100_000, 1_000_000)),
    "long": (lambda n, rng: oscillator(n, rng, True), [SPRING], (900, 3_000, 10_000, 30_000)),
    "scenes": (throws, [GRAVITY], (10, 100, 300, 1_000, 3_000)),
    "rain": (rain, [GRAVITY], (3, 10, 30, 100)),
    "bodies": (crowd, [SPRING, PULL], (2, 3, 5, 8)),
}
"""How data sets of a size are made, what is declared, and the sizes."""


def work(kind, size, workers, folder):
    """The row of one command."""
    make, laws, _ = KINDS[kind]
    with tempfile.TemporaryDirectory(dir=folder) as place:
        place = Path(place)
        table, names, _ = make(size, np.random.default_rng([size, 1]))
        saved(table, names, place / "data")
        argv = [sys.executable, "-m", "bsp_gp", "close", str(place / "data"), "--bootstrap", "0"]
        argv += [f"--declare={law}" for law in laws]
        argv += ["--workers", str(workers), "--out", str(place / "report"), "--quiet"]
        found = cost(argv, place / "log")
        if found["exit"]:
            print((place / "log").read_text()[-300:], file=sys.stderr)
    return [{"kind": kind, "size": size, "workers": workers, **found}]


def summary(table):
    """Costs, their ratios from size to size, and exponents, as Markdown."""
    lines = ["| kind | size | CPU s | times the last | wall s | peak MiB |"]
    lines.append("|---|--:|--:|--:|--:|--:|")
    told = []
    for kind, rows in table.groupby("kind", sort=False):
        before = None
        for row in rows.itertuples():
            ratio = "" if before is None else f"{row.cpu_s / before.cpu_s:.2f}"
            ratio += "" if before is None else f" (size {row.size / before.size:.3g})"
            lines.append(
                f"| {kind} | {row.size:,} | {row.cpu_s:.1f} | {ratio} | {row.wall_s:.1f} | "
                f"{row.peak_mib:.0f} |"
            )
            before = row
        told.append(f"{kind}: exponent {exponent(rows):.2f}")
    return "\n".join([*lines, "", *told])


def exponent(rows):
    """Slope of the cost that the size makes."""
    rows = rows.sort_values("size")
    own = rows["cpu_s"].to_numpy()[1:] - rows["cpu_s"].iloc[0]
    size = rows["size"].to_numpy()[1:]
    kept = slice(len(size) // 2 - (len(size) == 2), None)
    if len(size[kept]) < 2 or (own[kept] <= 0).any():
        return np.nan
    return np.polyfit(np.log(size[kept]), np.log(own[kept]), 1)[0]


def drawn(table):
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for kind, rows in table.groupby("kind", sort=False):
        rows = rows.sort_values("size")
        left.loglog(rows["size"], rows["cpu_s"], "o-", label=kind)
        right.loglog(rows["size"], rows["peak_mib"], "o-", label=kind)
    left.set(xlabel="size", ylabel="processor time, s")
    right.set(xlabel="size", ylabel="peak memory, MiB")
    left.legend()
    return figure


def declare(parser):
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--most", type=int, default=10**7, help="largest size")


def main(argv=None):
    args = options(__doc__, argv, declare)
    args.out.mkdir(parents=True, exist_ok=True)
    most = min(args.most, 300) if args.quick else args.most
    jobs = [
        (kind, size, args.workers) for kind in args.only for size in KINDS[kind][2] if size <= most
    ]
    table = run_jobs(jobs, partial(work, folder=args.out), args.out, 1)
    write_study(f"{summary(table)}\n", drawn(table), args.out, "scale")


if __name__ == "__main__":
    main()
