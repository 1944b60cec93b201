"""Random kicks: which forces act beside them, how strong they are, and whether intervals hold.

Tracks of one body in two dimensions under drag and kicks, kicks alone, drag alone, and in a trap
with kicks; the slowest relaxation takes between five rows and a twentieth of the track, and a
place errs by a tenth to one times the way from row to row.
"""

import numpy as np
import pandas as pd
from common import options, run_jobs, write_study

from bsp_gp.fitting.langevin import Track, models_of

N_SETS, QUICK_SETS = 200, 4
N_ROWS = (300, 500, 1000)
KINDS = {
    "drag and kicks": {"kicks", "drag"}, "kicks": {"kicks"}, "drag": {"drag"},
    "trap": {"kicks", "drag", "trap"},
}  # fmt: skip
"""Terms that are to be found."""


def made(kind, seed):
    """A track, and its true numbers."""
    rng = np.random.default_rng([26, list(KINDS).index(kind), seed])
    n_rows, step = int(rng.choice(N_ROWS)), 10 ** rng.uniform(-3, 0)
    slowest = step * np.exp(rng.uniform(np.log(5), np.log(n_rows / 20)))
    ratio = 10 ** rng.uniform(-0.7, 1) if kind == "trap" else 0.0  # w / g^2
    # Of a trap the slower of its two rates, in the drag's.
    slower = ((1 - np.sqrt(complex(1 - 4 * ratio))) / 2).real if ratio else 1.0
    rate = 1 / (slowest * slower)
    length = 10 ** rng.uniform(-7, 0)
    drag = 0.0 if kind == "kicks" else rate
    kicks = 0.0 if kind == "drag" else 2 * rate**3 * length**2
    trap = ratio * rate**2
    noise = length * rate * step * 10 ** rng.uniform(-1, 0)
    places = _driven(rng, n_rows, step, drag, trap, kicks, length * rate)
    places = places + 3 * length + noise * rng.standard_normal(places.shape)
    truth = {"drag_rate": drag, "trap_rate": trap, "kick_power": kicks, "noise": noise}
    if drag:
        truth |= {"diffusion": kicks / 2 / drag**2, "speed_variance": kicks / 2 / drag}
    return Track(step * np.arange(n_rows), places), truth


FINER = 40
"""Steps of the simulation per row."""


def _driven(rng, n_rows, step, drag, trap, kicks, speed):
    """Places (T, 2) by small steps of a splitting scheme, apart from what is tested."""
    h = step / FINER
    keep = np.exp(-drag * h)
    spread = np.sqrt(kicks * ((1 - keep**2) / (2 * drag) if drag else h))
    p = np.zeros(2) if not trap else speed / np.sqrt(trap) * rng.standard_normal(2)
    v = speed * rng.standard_normal(2)
    out = np.empty((n_rows, 2))
    draws = rng.standard_normal((n_rows, FINER, 2)) * spread
    for row in range(n_rows):
        out[row] = p
        for draw in draws[row]:  # half a push, half a way, kicks, half a way, half a push
            v = v - 0.5 * h * trap * p
            p = p + 0.5 * h * v
            v = keep * v + draw
            p = p + 0.5 * h * v
            v = v - 0.5 * h * trap * p
    return out


def work(kind, seed):
    """One track: a row."""
    track, truth = made(kind, seed)
    found = models_of([track])[0]
    row = {
        "kind": kind, "seed": seed, "terms": " ".join(sorted(found.terms)),
        "is_overdamped": found.is_overdamped, "is_right": set(found.terms) == KINDS[kind],
        "has_false_force": not set(found.terms) <= KINDS[kind],
    }  # fmt: skip
    for name, (value, low, high) in found.values.items():
        if truth.get(name) and not (found.is_overdamped and name == "trap_rate"):
            row[name] = value / truth[name]
            row[f"{name}_holds"] = low <= truth[name] <= high
    return [row]


def jobs_of(quick, seed):
    """All kinds, one track of each in turn."""
    n = QUICK_SETS if quick else N_SETS
    return [(kind, seed + k) for k in range(n) for kind in KINDS]


def summary(table):
    """How often the terms are right, and intervals of 90 % hold."""
    lines = ["# Random kicks", ""]
    for kind, part in table.groupby("kind", sort=False):
        lines.append(
            f"- {kind}: {int(part.is_right.sum())} of {len(part)} right, a force that is not there "
            f"in {int(part.has_false_force.sum())}."
        )
    held = table[table.is_right].filter(like="_holds")
    for name in held.columns:
        known = held[name].dropna().astype(bool)
        lines.append(f"- 90 % intervals of {name.removesuffix('_holds')} hold the truth in "
                     f"{int(known.sum())} of {len(known)}.")  # fmt: skip
    return "\n".join(lines) + "\n"


def figure(table):
    """Ratios of what was found to the truth."""
    import matplotlib.pyplot as plt

    names = ["drag_rate", "trap_rate", "kick_power", "diffusion", "noise"]
    names = [n for n in names if n in table and table[n].notna().any()]
    fig, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    ratios = [np.log10(pd.to_numeric(table[n]).dropna()) for n in names]
    axes.boxplot(ratios, orientation="horizontal")
    axes.set_yticks(range(1, len(names) + 1), [n.replace("_", " ") for n in names])
    axes.axvline(0, color="0.6", lw=0.8)
    axes.set_xlabel("found over true, powers of ten")
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "langevin")


if __name__ == "__main__":
    main()
