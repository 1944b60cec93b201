"""How many experiments part two laws: those that the planner chooses, and those of chance.

Pairs of rival laws are made up; one of them moves the world. After every experiment both are
weighed. Per pair: experiments until the right one is 95 % probable, by the plan and by chance, and
the information of the first planned experiment over what was expected of it.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from common import options, whole, write_table

from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.planning.means import means_from
from bsp_gp.planning.plan import foreseen, log_densities, normals, plan, weights_of
from bsp_gp.planning.rivals import Rival

MOST = 16
SURE = 0.95
PULL = "-k * m_i * q_j * norm(p_i - p_j)^({0}) * normalize(p_i - p_j)"
KINDS = {
    "powers": lambda r: [(PULL.format(-n),) for n in r.choice([1, 1.5, 2, 2.5, 3], 2, False)],
    "screened": lambda r: [
        (PULL.format(-2),),
        (PULL.format(-2) + f" * exp(-norm(p_i - p_j) / {r.uniform(2, 9):.2f} [m])",),
    ],
    "drags": lambda r: [
        (PULL.format(-2), "-c * v_i"), (PULL.format(-2), "-c * norm(v_i) * v_i"),
    ],
    "mass": lambda r: [(PULL.format(-2),), (PULL.format(-2).replace("m_i * ", ""),)],
    "wind": lambda r: [(PULL.format(-1),), (PULL.format(-1), "c * e_x")],
}  # fmt: skip


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv, lambda p: p.add_argument("--pairs", type=int,
                                                                          default=100))  # fmt: skip
    count = 5 if args.quick else args.pairs
    streams = np.random.default_rng(args.seed).spawn(count)
    rows = []
    for k, rng in enumerate(streams):
        began = time.process_time()
        kind = list(KINDS)[k % len(KINDS)]
        rows.append({"pair": k, "kind": kind, **compared(kind, rng),
                     "cpu_s": time.process_time() - began})  # fmt: skip
        print(rows[-1], flush=True)
        write_table(rows, args.out / "results.csv")
    text = summary(rows)
    with whole(args.out / "summary.md") as part:
        part.write_text(text, encoding="utf-8")
    print(text)


def summary(rows):
    """What is asked of the planner."""
    hard = [r for r in rows if r["by_chance"] >= 4]
    halved = [r for r in hard if r["planned"] <= r["by_chance"] / 2]
    realised = np.array([r["realised"] for r in rows])
    expected = np.array([r["expected"] for r in rows])
    chance, planned = (
        np.median([r[n] for r in hard] or [np.nan]) for n in ("by_chance", "planned")
    )
    return (
        f"{len(rows)} pairs; chance needs 4 experiments or more in {len(hard)}: median {chance:g}, "
        f"planned {planned:g}; at most half of them in {len(halved)} of {len(hard)}.\n"
        f"Realised over expected information: {realised.sum() / expected.sum():.2f}.\n"
    )


def world(rng):
    """Means, of which noise and reach differ from pair to pair."""
    return means_from({
        "bodies": {
            "probe": {"x": "1..8", "y": "-4..4", "vx": "-1..1", "vy": "-1..1", "mass": "0.5..2"},
            "source": {"dynamic": 0, "x": 0, "y": 0, "charge": "0.3..3"},
        },
        "look": {"until": "0.5..4", "rows": 8, "noise": float(np.exp(rng.uniform(-4, 0.5)))},
    })  # fmt: skip


def rivals_of(kind, means, rng):
    """Two laws that agree where the source is 3 m away, with constants known to 10 %."""
    data = means.dataset([means.draw(rng).scene("a")])
    out = []
    for texts in KINDS[kind](rng):
        law = read_law(data, list(texts))
        power = float(texts[0].split(")^(")[1].split(")")[0])
        values = {"k": 0.5 * 3.0**-power, "c": rng.uniform(0.05, 0.2)}
        law = law.with_constants({n: values[n] for n in law.names})
        error = np.diag([(0.1 * values[n]) ** 2 for n in law.names])
        out.append(Rival(" + ".join(texts), law, 0.5, tuple(law.names), error))
    return out


def compared(kind, rng):
    """Experiments by plan and by chance until the truth is sure."""
    world_rng, truth_rng, plan_rng, chance_rng = rng.spawn(4)
    means = world(world_rng)
    rivals = rivals_of(kind, means, world_rng)
    truth = int(truth_rng.integers(2))
    draw = {n: float(v[1]) for n, v in rivals[truth].draws(truth_rng, 2).items()}
    real = Rival("", rivals[truth].law.with_constants(draw), 1.0)
    told = {}
    for name, stream in (("planned", plan_rng), ("by_chance", chance_rng)):
        told[name], first = run(name, rivals, real, truth, means, stream)
        if name == "planned":
            told["expected"], told["realised"] = first
    return told


def run(how, rivals, real, truth, means, rng):
    """Experiments until the truth is 95 % probable, and bits of the first, expected and real."""
    weights, first, number = weights_of(rivals), None, 0
    while number < MOST:
        number += 1
        if how == "planned":
            now = [Rival(r.text, r.law, float(w), r.names, r.covariance)
                   for r, w in zip(rivals, weights, strict=False)]  # fmt: skip
            option = plan(now, means, rng=rng, n_tried=30).options[0]
            experiment, expected = option.experiment, option.bits
        else:
            experiment, expected = means.draw(rng), np.nan
        before = weights
        weights = weighed(weights, rivals, real, experiment, means, rng)
        if first is None:
            first = expected, _entropy(before) - _entropy(weights)
        if weights[truth] > SURE:
            break
    return number, first


def _entropy(weights):
    seen = weights[weights > 0]
    return float(-(seen * np.log2(seen)).sum())


def weighed(weights, rivals, real, experiment, means, rng):
    """Probabilities after the rows of an experiment."""
    draws = [r.draws(rng, 48) for r in rivals]
    ((rows, free, sigma),) = foreseen(rivals, draws, [experiment], means, rng)
    ((seen, _, _),) = foreseen([real], [real.draws(rng, 48)], [experiment], means, rng)
    if not np.isfinite(rows[:, 0]).all() or not np.isfinite(seen[0, 0]).all():
        return weights
    y = seen[0, 0] + sigma * rng.standard_normal(len(sigma))
    heights = log_densities(y[None], *normals(rows, free, sigma))[:, 0] + np.log(weights + 1e-300)
    out = np.exp(heights - heights.max())
    return out / out.sum()


if __name__ == "__main__":
    main()
