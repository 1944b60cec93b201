"""Companions of stars by their velocities along the line of sight, found and invented.

Made-up recordings: 25 to 150 nights in seasons over 200 to 3,000 days, errors of 1.4 to 3 m/s that
are quoted, a trembling of the star of up to 4 m/s that is not; one companion, two or none, on
circles and ellipses, its velocity 2 to 20 times the error of a night, its period from 3 days to two
thirds of the recording.

    python experiments/companions.py --sets 60 --seed 100
"""

import argparse
import json
import math
import time

import numpy as np

from bsp_gp.data.scene import SIGHT, Dataset, Entity, FirstState, Scene
from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.orbits import Orbit
from bsp_gp.loop.close import close_loop
from bsp_gp.units import UnitSystem

DAY = 86400.0
NAMES = ("P", "K", "longitude", "e", "omega")
NEAR = 3.0
"""Standard errors within which a period is right, and at the least a hundredth of it."""
Z_90 = 1.645


def star(rng, count):
    """Velocities of a star with so many companions, and their periods in days.

    Returns
    -------
    dataset : Dataset
    periods : list of float
    """
    n, span = int(rng.integers(40, 240)), rng.uniform(200, 3000)
    days = np.sort(rng.uniform(0, span, n))
    days = np.unique(np.floor(days[days % 365 < 220]))
    days = days + rng.normal(0.4, 0.08, len(days))
    quoted, trembling = rng.uniform(1.4, 3.0, len(days)), rng.uniform(0, 4)
    total, periods = np.zeros(len(days)), []
    for _ in range(count):
        period = math.exp(rng.uniform(math.log(3), math.log(span / 1.5)))
        size = rng.uniform(2, 20) * math.hypot(2, trembling)
        shape = min(rng.choice([0.0, rng.beta(0.9, 3)]), 0.9)
        values = (period, size, rng.uniform(0, 6.28), shape, rng.uniform(0, 6.28))
        part = Orbit(tuple(map(Parameter, NAMES)), 0.0)
        total += part.added(days, dict(zip(NAMES, values, strict=True)))[0]
        periods.append(period)
    seen = total + rng.normal(0, np.hypot(quoted, trembling)) + rng.uniform(-20, 20)
    zero, blank = np.zeros((1, 2)), np.zeros((len(days), 1))
    scene = Scene(
        "star", days * DAY, np.stack([seen[:, None], blank], axis=2), (Entity("star"),),
        sigma=np.stack([quoted[:, None], blank + np.nan], axis=2), first=FirstState(zero, zero),
    )  # fmt: skip
    units = UnitSystem.from_declared({"length": "m/s", "time": "day"})
    return Dataset("star", (scene,), units=units, velocity=SIGHT), periods


def judged(report, periods):
    """What became of a star: "right", "part" (true ones alone), "wrong" or "none"."""
    found = [c for c in report.constants if c.name[0] == "P" and c.name[1:].isdigit()]
    if report.verdict not in ("effect adopted", "effective law") or not found:
        return "none"
    left = list(periods)
    for c in found:
        error = max(NEAR * (c.high - c.low) / 2 / Z_90 / DAY, 0.01 * c.value / DAY)
        near = [p for p in left if abs(p - c.value / DAY) < error]
        if not near:
            return "wrong"
        left.remove(near[0])
    return "part" if left else "right"


def main():
    """Run the study, one line of JSON a star, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=60)
    parser.add_argument("--seed", type=int, default=100)
    args = parser.parse_args()
    rows = []
    for k, stream in enumerate(np.random.default_rng(args.seed).spawn(args.sets)):
        count = k % 3
        dataset, periods = star(stream, count)
        began = time.process_time()
        report = close_loop(dataset, "nothing", rng=stream, n_bootstrap=0)
        rows.append({
            "companions": count, "nights": len(dataset.scenes[0].times),
            "verdict": report.verdict, "outcome": judged(report, periods),
            "cpu_s": round(time.process_time() - began, 1),
        })  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    for count in range(3):
        own = [row["outcome"] for row in rows if row["companions"] == count]
        told = ", ".join(f"{what} {own.count(what)}" for what in ("right", "part", "wrong", "none"))
        print(f"{count} companions: {told} of {len(own)}")
    print(f"CPU s in the median: {np.median([row['cpu_s'] for row in rows]):.1f}")


if __name__ == "__main__":
    main()
