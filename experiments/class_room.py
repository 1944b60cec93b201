"""What is filmed and logged in class rooms, nothing declared: is it named, and is it honest?

Twelve kinds of recordings of 8 to 150 rows by closed forms and scipy, with the errors of films and
motion sensors: falls, throws, coffee filters, spheres in a liquid, carts that coast, climb or meet,
springs, pendulums, flywheels, balls that bounce.

    python experiments/class_room.py --seeds 4 --first 10
"""

import argparse
import json
import time

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.constancy import shape_of
from bsp_gp.loop.proposers.exponents import power_of
from bsp_gp.units import Unit

G = 9.81
SI, ANGLE = {"length": "m", "time": "s"}, {"x": "rad", "t": "s"}
TYPES = input_types({"mass": Unit.of(kg=1)})
SPEED = parse_formula("norm(v_i)", TYPES)
LINEAR, SQUARED, RUB = "v_i", "norm(v_i)^2 * normalize(v_i)", "normalize(v_i)"


def followed(rates, start, t, **more):
    """Places of a motion ``rates(place, velocity)`` from a start, (n, d)."""
    n = len(start) // 2
    found = solve_ivp(
        lambda _, z: [*z[n:], *np.atleast_1d(rates(z[:n], z[n:]))], (0, t[-1]), start,
        t_eval=t, rtol=1e-9, atol=1e-12, **more,
    )  # fmt: skip
    return found.y[:n].T


def fall(rng):
    t = np.arange(rng.integers(8, 16)) / 30
    return t, {"y": 1.8 - 0.5 * G * t**2}, 0.003, ["e_y"]


def coffee_filter(rng):
    t, fastest = np.arange(rng.integers(20, 32)) / 25, rng.uniform(1, 2)
    y = 2 - fastest**2 / G * np.log(np.cosh(G * t / fastest))
    return t, {"y": y}, 0.004, ["e_y", SQUARED]


def throw(rng):
    t, speed, way = np.arange(rng.integers(12, 25)) / 30, rng.uniform(2.5, 4), rng.uniform(0.7, 1.2)
    y = 1 + speed * np.sin(way) * t - 0.5 * G * t**2
    return t, {"x": speed * np.cos(way) * t, "y": y}, 0.004, ["e_y"]


def throw_with_drag(rng):
    t, k = np.arange(40) / 25, rng.uniform(0.08, 0.2)
    x, y = followed(lambda p, v: np.array([0, -G]) - k * np.hypot(*v) * v, [0, 1, 6, 8], t).T
    return t, {"x": x, "y": y}, 0.006, ["e_y", SQUARED]


def incline(rng):
    t, slope = np.arange(60) / 20, G * np.sin(np.radians(rng.uniform(3, 8)))
    x = followed(lambda p, v: -slope - 0.2 * np.sign(v), [0, 1.4], t, max_step=0.01)
    return t, {"x": x[:, 0]}, 0.002, ["e_x", RUB]


def coasting(rng):
    t, rub, speed = np.arange(40) / 20, rng.uniform(0.15, 0.35), rng.uniform(0.8, 1.2)
    return t, {"x": 0.2 + speed * t - 0.5 * rub * t**2}, 0.0015, ["e_x"]


def spring(rng):
    t, k, c = np.arange(150) / 25, rng.uniform(15, 40), rng.uniform(0.05, 0.3)
    x = followed(lambda p, v: -k * p - c * v, [0.08, 0], t)
    law = ["origin + centre * e_x - p_i", LINEAR]
    return t, {"x": 0.52 + x[:, 0]}, 0.001, law


def pendulum(rng):
    t, length, c = np.arange(120) / 30, rng.uniform(0.4, 1.2), rng.uniform(0.02, 0.1)
    turn = followed(lambda p, v: -G / length * np.sin(p) - c * v, [rng.uniform(0.15, 0.6), 0], t)
    x, y = length * np.sin(turn[:, 0]), -length * np.cos(turn[:, 0])
    return t, {"x": x, "y": y}, 0.002, ["e_y", LINEAR]


def sphere_in_liquid(rng):
    t, tau = np.arange(40) / 30, rng.uniform(0.05, 0.15)
    return t, {"y": -7 * tau * (t - tau * (1 - np.exp(-t / tau)))}, 0.001, ["e_y", LINEAR]


def flywheel(rng):
    t, c, d = np.arange(100) * 0.1, rng.uniform(0.05, 0.1), rng.uniform(0.5, 1.0)
    turn = (30 + d / c) / c * (1 - np.exp(-c * t)) - d / c * t
    return t, {"x": turn}, 0.02, [LINEAR, RUB]


def carts_that_meet(rng):
    t = np.arange(60) / 30

    def rates(p, v):
        push = 400 * max(0.0, 0.1 - (p[1] - p[0]))
        return [-push, push]

    x = followed(rates, [0, 0.7, 0.6, 0], t, max_step=0.005)
    touch = "0.5 * (1 + sign(L1 - norm(p_i - p_j))) * (L1 - norm(p_i - p_j)) * normalize(p_i - p_j)"
    return t, {"x1": x[:, 0], "x2": x[:, 1]}, 0.002, [touch]


def bouncing(rng):
    keeps, steps, y, v, seen = rng.uniform(0.75, 0.85), 200, 1.2, 0.0, []
    for _ in range(90 * steps):
        seen.append(y)
        v -= G / 30 / steps
        y += v / 30 / steps
        if y < 0 and v < 0:
            y, v = -y, -keeps * v
    return np.arange(90) / 30, {"y": np.array(seen)[::steps]}, 0.003, ["e_y"]


ONE_WAY = (coasting, flywheel)
"""Nothing turns back there: a steady push along x is friction as well."""
KINDS = (fall, coffee_filter, throw, throw_with_drag, incline, coasting, spring, pendulum,
         sphere_in_liquid, flywheel, carts_that_meet, bouncing)  # fmt: skip


def shapes_of(formulas, kind):
    """Forms of forces, but for their constants."""
    told = [(power_of(SPEED, f), *shape_of(f, SPEED)) for f in formulas]
    return [str(each).replace(RUB, "e_x") for each in told] if kind in ONE_WAY else told


def judged(report, truth, kind):
    """What became of a recording.

    "right"; "open" where another form, or power, is told with the class it is of, or that the data
    do not tell; "fact" where another form is stated as one.
    """
    shapes = shapes_of((term.formula for term in report.law.terms), kind)
    if report.verdict == "effect adopted" and sorted(shapes) == sorted(truth):
        return "right"
    told = [r.effect for r in report.rounds if r.adopted and r.effect is not None]
    is_stated = report.verdict == "effect adopted" and all(e.is_fact for e in told)
    return "fact" if is_stated else "open"


def main():
    """Run the study, one line of JSON a recording, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    args = parser.parse_args()
    rows = []
    for seed in range(args.first, args.first + args.seeds):
        for number, kind in enumerate(KINDS):
            rng = np.random.default_rng([seed, number])
            t, places, error, law = kind(rng)
            truth = shapes_of((parse_formula(f"c1 * ({text})", TYPES) for text in law), kind)
            frame = pd.DataFrame({"t": t})
            for name, values in places.items():
                frame[name] = values + rng.normal(0, error, len(t))
            data = Dataset.from_frames(frame, units=ANGLE if kind is flywheel else SI)
            began = time.process_time()
            report = close_loop(data, "nothing", rng=rng, n_bootstrap=0)
            rows.append({
                "kind": kind.__name__, "seed": seed, "verdict": report.verdict,
                "outcome": judged(report, truth, kind), "law": report.law_text,
                "cpu_s": round(time.process_time() - began, 1),
            })  # fmt: skip
            print(json.dumps(rows[-1]), flush=True)
    for kind in KINDS:
        own = [row["outcome"] for row in rows if row["kind"] == kind.__name__]
        told = ", ".join(f"{what} {own.count(what)}" for what in ("right", "open", "fact"))
        print(f"{kind.__name__}: {told} of {len(own)}")
    print(f"CPU s in the median: {np.median([row['cpu_s'] for row in rows]):.1f}")


if __name__ == "__main__":
    main()
