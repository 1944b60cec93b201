"""GravityBench (NolanKoblischke/GravityBench) without a language model.

The law of every simulated pair of stars is fitted to its rows, all of them or 100; the 50 questions
are then read off its motion. Answers are held against those of the benchmark, by its thresholds.

    python experiments/scoreboards/gravity_bench.py --repo PATH --out DIR [--share 0.25]
"""

import contextlib
import json
import math
import os
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, whole, write_table

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis

G = 6.6743e-11
STARS = ("star1", "star2")
MOST_ROWS = {"full": 400, "budget": 100}
"""Rows that are fitted: of the full table some, evenly; of the budget all that may be had."""
DAY = 86400.0
LONGEST = 900.0
"""Seconds of a fit at the most."""
GRAVITY = "6.6743e-11 [m^3/kg/s^2] * m_i * M[body] / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
LAWS = {
    "newton": (GRAVITY,),
    "drag": (GRAVITY, "-k * m_i * v_i"),
    "power": ("m_i * M[body] * norm(p_i - p_j)^(-n) * normalize(p_j - p_i)",),
}
MISFIT = 1e-5
"""Part of the extent by which Newton's law may miss the rows, beyond which others are tried."""
UNITS = {"years and AU": ("AU", "yr"), "seconds and centimeters": ("cm", "s")}


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv, declare)
    repo = args.repo.resolve()
    with (repo / "huggingface" / "validation.jsonl").open(encoding="utf-8") as file:
        items = [json.loads(line) for line in file]
    asked = Counter(item["variation_name"] for item in items)
    if args.quick:
        args.share = 0.07
    # Those of which most is asked come first.
    chosen = [name for name, _ in asked.most_common(max(round(args.share * len(asked)), 1))]
    rows = []
    for name in chosen:
        pair = simulated(repo, args.out.resolve() / "simulations", name)
        for mode in args.modes:
            told = kept(args.out / "fits" / f"{safe(name)}-{mode}.json",
                        lambda pair=pair, mode=mode: answers_of(pair, mode))  # fmt: skip
            rows += [scored(i, mode, told) for i in items if i["variation_name"] == name]
            print(name, mode, told["law"], f"{told['cpu_s']:.0f} s", flush=True)
            write_table(rows, args.out / "results.csv")
    table = pd.DataFrame(rows)
    for mode, part in table.groupby("mode"):
        share = 100 * part.is_right.mean()
        print(f"{mode}: {part.is_right.sum()} of {len(part)} asked, {share:.1f} %")
    print(table[~table.is_right][["mode", "task", "variation", "answer", "truth"]].to_string())


def declare(parser):
    parser.add_argument("--repo", type=Path, required=True, help="checkout of the benchmark")
    parser.add_argument("--modes", nargs="+", default=list(MOST_ROWS), choices=list(MOST_ROWS))
    parser.add_argument("--share", type=float, default=1.0, help="of the simulated pairs of stars")


def safe(name):
    return "".join(c if c.isalnum() else "_" for c in name)


def kept(path, make):
    """What was made before, or is made now."""
    if not path.exists():
        told = make()
        with whole(path) as part:
            part.write_text(json.dumps(told), encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


@contextlib.contextmanager
def within(folder):
    here = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)


def simulated(repo, folder, name):
    """A pair of stars of the benchmark, simulated by its own code where it is not yet."""
    if str(repo) not in sys.path:
        sys.path.insert(0, str(repo))
    with within(repo):
        from scripts import scenarios_config
    for part in ("sims", "detailed_sims"):
        (folder / "scenarios" / part).mkdir(parents=True, exist_ok=True)
    with within(folder):
        is_done = Path(f"scenarios/sims/{name}.csv").exists()
        pair = scenarios_config.variations[name].create_binary("", None, skip_simulation=is_done)
    pair.place, pair.max_observations = folder, MOST_ROWS["budget"]
    return pair


def answers_of(pair, mode):
    """The answers to all questions about a pair, the law that was found, and the time it took."""
    began = time.process_time()
    table = pair.df
    if mode == "full":
        stride = np.unique(np.linspace(0, len(table) - 1, MOST_ROWS[mode]).astype(int))
        table = table.iloc[stride]
    else:
        pair.row_wise_results.df = pair.row_wise_results.df.iloc[:0]
        pair.number_of_observations_requested = 0
        with within(pair.place):
            is_si = pair.units_string not in UNITS
            last = float(pair.df["time"].iloc[-1] if is_si else pair.maxtime)
            asked = np.linspace(0.0, last, MOST_ROWS[mode]).tolist()
            pair.observe_row(asked, len(asked))
        table = pair.row_wise_results.df.astype(float)
    # The observation tool shows rows of the simulation's own file, in SI whatever the prompt says.
    length, clock = UNITS.get(pair.units_string, ("m", "s")) if mode == "full" else ("m", "s")
    frames = [
        table[["time", *(f"{star}_{a}" for a in "xyz")]]
        .set_axis(["t", "x", "y", "z"], axis=1)
        .assign(entity=star, scene="orbit")
        for star in STARS
    ]
    data = bsp_gp.Dataset.from_frames(
        pd.concat(frames), units={"length": length, "time": clock, "mass": "kg"}
    )
    fits = {"newton": fitted(data, "newton")}
    extent = float(np.ptp(data.scenes[0].positions))
    if not missed(fits["newton"]) < MISFIT * extent:
        fits |= {name: fitted(data, name) for name in ("drag", "power")}
    best = min(fits, key=lambda name: missed(fits[name]))
    told = {"law": best, "missed": missed(fits[best]) / extent, "answers": {}}
    if math.isfinite(told["missed"]):
        told["answers"] = told_of(best, fits[best], data)
    return told | {"cpu_s": time.process_time() - began}


def fitted(data, name):
    return fit(Hypothesis.from_laws(data, LAWS[name]), data, deadline=LONGEST)


def missed(found):
    """How far a fit is off the rows, m; inf where it is none."""
    left = found.residual[np.isfinite(found.residual)]
    is_one = found.status != "nonfinite" and len(left)
    return float(np.sqrt(np.mean(left**2))) if is_one else math.inf


def told_of(kind, found, data):
    """Answers by question, SI."""
    values = found.law.constants
    pulls = np.array([values["M[body]"][star] for star in STARS])
    power = values.get("n", 2.0)
    strength = pulls if kind == "power" else G * pulls
    drag = values.get("k", 0.0)
    (scene,) = data.scenes
    span = scene.times[-1] - scene.times[0]
    (chains,), (nodes,) = found.groups, found.nodes
    order = [list(chains.bodies[0]).index(star) for star in STARS]
    start = nodes[..., 0, 0][:, order]

    def motion(t, y):
        p, v = y.reshape(2, 2, -1)
        gap = p[1] - p[0]
        pull = strength[:, None] * np.array([gap, -gap]) / np.linalg.norm(gap) ** (power + 1)
        return np.concatenate([v, pull - drag * v]).ravel()

    times = np.linspace(0.0, span, 60001)
    y = solve_ivp(motion, (0, span), start.ravel(), t_eval=times, rtol=1e-10, atol=1e-3,
                  method="DOP853").y.T  # fmt: skip
    p, v = np.moveaxis(y.reshape(len(times), 2, 2, -1), 0, 2).reshape(2, 2, len(times), -1)
    return answers(kind, times, p, v, pulls, strength, power, drag)


def answers(kind, t, p, v, pulls, strength, power, drag):
    """The 50 questions, from the motion (2, T, 3) of both stars and the constants of the law."""
    m1, m2 = pulls[1], pulls[0]  # each is pulled by the other's mass
    total = m1 + m2
    gap, speed = p[1] - p[0], v[1] - v[0]
    r = np.linalg.norm(gap, axis=1)
    h = float(np.linalg.norm(np.cross(gap[0], speed[0])))
    energy = 0.5 * speed[0] @ speed[0] - G * total / r[0]
    a = -G * total / (2 * energy)
    e = math.sqrt(max(1 + 2 * energy * h**2 / (G * total) ** 2, 0.0))
    out = {
        "linear_drag": 1 / drag if drag else math.inf, "modified_gravity_power_law": power - 2,
        "kepler_3rd_law": kind != "power", "is_bound": bool(energy < 0),
        "eccentricity": e, "semi_major_axis": a, "apoastron": a * (1 + e),
        "periastron": a * (1 - e), "mass_star1": m1, "mass_star2": m2, "total_mass": total,
        "mass_largest_star": max(m1, m2), "mass_ratio": m1 / m2, "reduced_mass": m1 * m2 / total,
        "specific_angular_momentum": h, "area_swept_over_time_apo": h / 2,
        "area_swept_over_time_peri": h / 2,
    }  # fmt: skip
    speeds, pull = np.linalg.norm(v, axis=2), strength[:, None] / r**power
    turn = np.linalg.norm(np.cross(gap, speed), axis=1) / r**2
    for k, mass in enumerate((m1, m2)):
        for least, name in ((np.min, "min"), (np.max, "max")):
            out[f"{name}_velocity_star{k + 1}"] = least(speeds[k])
            out[f"{name}_momentum_star{k + 1}"] = mass * least(speeds[k])
            out[f"{name}_acceleration_star{k + 1}"] = least(pull[k])
            out[f"{name}_angular_velocity_star{k + 1}"] = least(turn)
    kinetic = float(np.mean(0.5 * m1 * speeds[0] ** 2 + 0.5 * m2 * speeds[1] ** 2))
    potential = float(np.mean(-G * m1 * m2 / r))
    out["K+U"] = kinetic + potential
    out["virial_theorem"] = bool(abs(2 * kinetic + potential) < 0.01 * abs(potential))
    if energy < 0:
        out |= _of_orbit(t, r, speeds, pull, a, e, m1, m2)
    return {name: x if isinstance(x, bool) else float(x) for name, x in out.items()}


def _of_orbit(t, r, speeds, pull, a, e, m1, m2):
    """Questions about one revolution."""
    total, out = m1 + m2, {}
    period = 2 * math.pi * math.sqrt(a**3 / (G * total))
    b, ratio = a * math.sqrt(max(1 - e**2, 0.0)), (m1 / m2) ** (1 / 3)
    out["period"], out["semi_minor_axis"] = period, b
    out["multiply_mass_period"] = (period / (21 * DAY)) ** 2
    out["roche_lobe_radius"] = 0.49 * a * ratio**2 / (0.6 * ratio**2 + math.log(1 + ratio))
    for star, mass in (("star1", m2), ("star2", m1)):
        share = mass / total
        out[f"semi_major_axis_{star}"], out[f"semi_minor_axis_{star}"] = share * a, share * b
        out[f"orbital_area_{star}"] = math.pi * share**2 * a * b
        out[f"avg_distance_COM_{star}"] = share * a * (1 + e**2 / 2)
    # Of a revolution the anomaly E is even: t = P (E - e sin E) / 2 pi.
    anomaly = np.linspace(0, 2 * math.pi, 20001)
    when = period * (anomaly - e * np.sin(anomaly)) / (2 * math.pi)
    way = np.hypot(a * np.sin(anomaly), b * np.cos(anomaly))
    path = np.concatenate([[0.0], np.cumsum(0.5 * (way[1:] + way[:-1]))])
    for part in (20, 70):
        out[f"travel_time_orbital_{part}per_path"] = np.interp(part / 100 * path[-1], path, when)
    force = 1 / (1 - e * np.cos(anomaly)) ** 2
    mean = np.trapezoid(force, when) / period
    below = (force < mean).astype(float)
    out["time_fraction_acceleraton_below_mean"] = np.trapezoid(below, when) / period
    return out


def scored(item, mode, told):
    """One row of the table."""
    answer, truth = told["answers"].get(item["scenario_name"]), item["true_answer"]
    share = float(item[f"{mode}_obs_threshold_percent"]) / 100
    if truth in ("True", "False"):
        error, is_right = math.nan, str(answer) == truth
    else:
        error = math.inf if answer is None else abs(answer / float(truth) - 1)
        is_right = bool(error <= share)
    return {
        "mode": mode, "task": item["scenario_name"], "variation": item["variation_name"],
        "answer": answer, "truth": truth, "error": error, "threshold": share,
        "is_right": is_right, "law": told["law"], "cpu_s": told["cpu_s"],
    }  # fmt: skip


if __name__ == "__main__":
    main()
