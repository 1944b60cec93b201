"""Do searches that draw laws tell of the same causes as the exhaustive one, in the loop itself?

Sets of `undeclared_effects.py` that lack a force, at one signal-to-noise ratio, each closed
with every search. Compared is what is told of first, by the form of its law, and what it costs.
"""

import time

import numpy as np
from battery_worlds import KINDS, able, noisy, tuned_to
from causes import causes_of
from common import options, run_jobs, write_study
from power import ALPHA
from undeclared_effects import Referee, told_in

from bsp_gp.errors import BspError
from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.close import close_loop
from bsp_gp.physics.bodies import dataset_types

SNR, MAX_ROUNDS = 30.0, 3
SEARCHES = ("exhaustive", "genetic", "cross_entropy", "auto")
NAMES = tuple(name for name, kind in KINDS.items() if not kind.names)


def identity(cause, dataset):
    """What two equal causes share, however they are written."""
    try:
        formula = parse_formula(cause.law, dataset_types(dataset), units=dataset.units)
    except BspError:  # no law, or none that stands alone
        return f"{cause.code}: {cause.text}"
    return canonical_key(formula, dataset.n_dims)


def work(name, search, seed):
    """One data set closed with one search: a row."""
    engine = "mujoco" if seed % 2 and able(name, "mujoco") else "pymunk"
    _, _, exact = tuned_to(name, SNR, seed, engine)
    noise_rng, loop_rng = np.random.default_rng((2, list(KINDS).index(name), seed)).spawn(2)
    dataset = noisy(name, exact, noise_rng)
    started = time.process_time()
    report = close_loop(dataset, exact.declared, rng=loop_rng, alpha=ALPHA,
                        max_rounds=MAX_ROUNDS, search=search)  # fmt: skip
    seconds = time.process_time() - started
    rounds, referee = told_in(report), Referee(name, exact)
    causes = causes_of(rounds[0]) if rounds else []
    return [{
        "effect": name, "search": search, "seed": seed, "verdict": report.verdict,
        "told": str(causes[0]) if causes else "",
        "identity": identity(causes[0], dataset) if causes else "nothing",
        "in_class": any(map(referee.is_right, causes)) or referee.is_law(report),
        "cpu_s": seconds,
    }]  # fmt: skip


def summary(table):
    """Agreement of every search with the exhaustive one."""
    wide = table.pivot_table("identity", ["effect", "seed"], "search", "first")
    lines = [
        "# Searches that draw, in the loop\n",
        f"Undeclared forces, SNR {SNR:g}. Same: the first cause that is told of is the one "
        "of the exhaustive search, by the form of its law.\n",
        "| search | sets | same as exhaustive | named or in class | CPU s |", "|---" * 5 + "|",
    ]  # fmt: skip
    for search, part in table.groupby("search", sort=False):
        both = wide.dropna(subset=["exhaustive", search])
        same = (both["exhaustive"] == both[search]).sum()
        lines.append(f"| {search} | {len(part)} | {same} of {len(both)} | "
                     f"{part['in_class'].sum()} | {part['cpu_s'].median():.1f} |")  # fmt: skip
    for (name, seed), row in wide.iterrows():
        if len(set(row.dropna())) > 1:
            told = table[(table["effect"] == name) & (table["seed"] == seed)]
            lines.append(f"\n{name}, seed {seed}:\n")
            lines += [f"- {r.search}: {r.told}" for r in told.itertuples()]
    return "\n".join(lines) + "\n"


def figure(table):
    """Processor time, search by search."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(5.6, 3.0), layout="constrained")
    names = list(dict.fromkeys(table["search"]))
    ax.boxplot([table.loc[table["search"] == n, "cpu_s"] for n in names], tick_labels=names)
    ax.set(ylabel="CPU s of close", yscale="log")
    return fig


def main():
    def declare(parser):
        parser.add_argument("--sets", type=int, default=20, help="data sets of each kind")
        parser.add_argument("--search", nargs="+", default=list(SEARCHES), choices=SEARCHES)

    args = options(__doc__.splitlines()[0], declare=declare)
    seeds = range(args.seed, args.seed + (1 if args.quick else args.sets))
    jobs = [(name, search, seed) for seed in seeds for name in NAMES for search in args.search]
    table = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "searches_agree")


if __name__ == "__main__":
    main()
