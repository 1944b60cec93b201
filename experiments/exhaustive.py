"""Exhaustive search on the paper's scenes: laws scored, seconds, what comes out on top."""

import time

import numpy as np
from common import options, reference_data, write_table
from scenes import with_noise

from bsp_gp.data.tables import load_dataset
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.exhaustive import search_exhaustive

CASES = (
    ("nbody", (1,), 0.0),
    ("nbody", (1, 2, 3), 0.01),
    ("mat", (1,), 0.0),
    ("mat", (1, 2), 0.0),
    ("bounce", (1,), 0.0),
    ("bounce", (1, 2), 0.0),
)


def run(scenario, numbers, noise, seed):
    """One search; the row of the table."""
    dataset = load_dataset(reference_data("synth", scenario))
    rng = np.random.default_rng(seed)
    scenes = [with_noise(dataset.scene(str(k)), noise, rng) for k in numbers]
    types = dataset_types(dataset)
    grammar, missing = load_grammar("newtonian").masked(set(types), dataset.n_dims)
    regression = build_regression(scenes)
    started = time.perf_counter()
    result = search_exhaustive(regression, grammar, kind="pair", missing_inputs=missing)
    seconds = time.perf_counter() - started
    return {
        "scenario": scenario, "scenes": " ".join(map(str, numbers)), "noise": noise,
        "laws": result.n_evaluated, "seconds": seconds, "laws_per_s": result.n_evaluated / seconds,
        "law": to_text(result.best.formula), "constant": next(iter(result.best.constants.values())),
        "left": 2 * result.best.loss / result.best.total, "ties": len(result.best.ties),
        "next_left": 2 * result.candidates[1].loss / result.best.total,
        "certificate": result.certificate.text(),
    }  # fmt: skip


def main():
    args = options(__doc__)
    rows = []
    for scenario, numbers, noise in CASES[: 3 if args.quick else None]:
        row = run(scenario, numbers, noise, args.seed)
        rows.append(row)
        print(
            f"{scenario:7s} scenes {row['scenes']:6s} noise {noise:<5g} {row['laws']:>10,} laws in "
            f"{row['seconds']:.2f} s = {row['laws_per_s']:>9,.0f}/s; left {row['left']:.1e} "
            f"(next {row['next_left']:.1e}), {row['ties']} ties\n        "
            f"{row['constant']:.7g}: {row['law']}"
        )
    write_table(rows, args.out / "results.csv")
    print(f"table: {args.out / 'results.csv'}")


if __name__ == "__main__":
    main()
