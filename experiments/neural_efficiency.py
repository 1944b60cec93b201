"""Neural models beside the symbolic searches: the paper's Figure 4, rollouts, other worlds.

1 to 10 scenes out of 1 to 80 in five shuffled orders, the same for every method; the paper's
one-step nRMSE on scenes 81 to 100, true properties given. Beside it: running on from two rows to
the end of those scenes, and one-step errors in worlds with other numbers of bodies and other
masses. Needs the extra `neural`; without it the symbolic rows alone: data_efficiency.py.
"""

import functools
import os
import time
from dataclasses import replace

import numpy as np
from common import options, reference_data, run_jobs, write_study
from data_efficiency import (
    BUDGETS,
    COLLIDING,
    LEARNERS,
    PAPER_ZERO,
    TEST,
    is_true,
    learned,
    objective_of,
    training_scenes,
)  # fmt: skip
from neural_judges import OTHER, free_of_contact, other_worlds, rolled
from scenes import FRESH, scenario

from bsp_gp.language.render import to_text
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.search.compare import certified

# One thread per process, as in the rest of the house: the same digits on every run.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

N_DRAWS = 5
COUNTS = (1, 10, 5, 2, 3, 7, 4, 6, 8, 9)
"""Numbers of training scenes, in the order in which they are run: the ends first."""
SYMBOLIC = ("zero force", "exhaustive", "exhaustive, sums", "cross_entropy", "genetic")
NEURAL = ("MLP (position), paper", "IN, paper", "MLP (force), paper", "OGN, paper",
          "MLP (position), tuned", "IN, tuned", "MLP (force), tuned", "OGN, tuned",
          "HOGN, tuned")  # fmt: skip
METHODS = (*SYMBOLIC, *NEURAL[4:], *NEURAL[:4])
"""In the order in which they are run: the paper's trainings take longest."""
EXPLAINED = 1e-12
"""Share of the sum of squares up to which a law leaves nothing to a second one."""
EXACT = 1e-9
"""One-step nRMSE in metres below which a law is the true one."""
DRAWN = 1e-6
"""Least error of the figure: below it are exact laws, whose rounding says nothing."""
COLOURS = {"zero force": "#555555", "exhaustive": "#222222", "cross_entropy": "#0072b2",
           "genetic": "#56b4e9", "OGN": "#d55e00", "IN": "#009e73", "MLP (force)": "#cc79a7",
           "MLP (position)": "#e69f00", "HOGN": "#7b3294"}  # fmt: skip


# --- methods ----------------------------------------------------------------------------------


def work(folder, name, n_scenes, method, seed, n_draws, divisor):
    """One point of a curve: a row per draw."""
    draws = [training_scenes(name, n_scenes, shuffle) for shuffle in range(1, n_draws + 1)]
    work_on = symbolic if method in SYMBOLIC else neural
    rows = work_on(folder, name, draws, method, seed, divisor)
    return [
        {"scenario": name, "n_scenes": n_scenes, "shuffle": shuffle, "method": method,
         "seed": seed, **row}
        for shuffle, row in enumerate(rows, 1)
    ]  # fmt: skip


def symbolic(_, name, draws, method, seed, __):
    """Rows of a search."""
    rows = []
    for shuffle, scenes in enumerate(draws, 1):
        law, found = ForceLaw(()), {"success": False, "seconds": 0.0, "law": ""}
        if method != "zero force":
            best, seconds = searched(name, scenes, method, seed, shuffle)
            law = ForceLaw((Term(best.formula, best.kind),), best.constants)
            found = {"success": is_right(name, law), "law": to_text(best.formula),
                     "seconds": round(seconds, 3)}  # fmt: skip
        rows.append({**symbolic_errors(name, law), **found})
    return rows


def is_right(name, law):
    """Whether a single law is the scenario's, and whether a sum leaves nothing on `FRESH`."""
    formula = law.terms[0].formula
    if getattr(formula, "operator", None) != "add":
        return is_true(name, formula)
    # No one law of the scenario's can be asked for where bodies touch as well.
    return one_step_nrmse([scenario(name).scene(str(k)) for k in FRESH], law) < EXACT


def searched(name, scenes, method, seed, shuffle):
    """The best candidate of a search, and its processor time.

    "exhaustive, sums" goes on to sums of forces where no single law explains the scenes: a
    collision in an NBODY scene pulls every single law off.
    """
    objective, missing = objective_of(name, scenes)
    if method in LEARNERS:
        entropy = (list(PAPER_ZERO).index(name), len(scenes), shuffle, seed,
                   list(LEARNERS).index(method))  # fmt: skip
        outcome = learned(objective, method, LEARNERS[method], seed, BUDGETS[method], entropy)
        return outcome.best, outcome.seconds
    outcome = certified(objective, missing_inputs=missing)
    if method == "exhaustive" or outcome.best.loss <= EXPLAINED * objective.total:
        return outcome.best, outcome.seconds
    objective, missing = objective_of(name, scenes, "newtonian_sum")
    sums = certified(objective, missing_inputs=missing)
    return sums.best, outcome.seconds + sums.seconds


def symbolic_errors(name, law):
    """Errors of a law on the test scenes and in other worlds."""
    test = [scenario(name).scene(k) for k in TEST]
    free = free_of_contact(name, test)
    gaps = []
    for scene, path in zip(free, rolled(free, law), strict=True):
        gap = np.linalg.norm(path - scene.positions[2:, scene.dynamic], axis=-1).sum()
        gap /= len(scene.entities) * len(path)
        gaps.append(gap if np.isfinite(gap) else np.inf)
    errors = {"nrmse_test": one_step_nrmse(test, law), "nrmse_test_free": one_step_nrmse(free, law),
              "rollout": float(np.median(gaps))}  # fmt: skip
    for label, sets in other_worlds(name).items():
        errors[label] = float(np.mean([one_step_nrmse(scenes, law) for scenes in sets]))
    return errors


def neural(folder, name, draws, method, seed, divisor):
    """Rows of a network, trained on every draw."""
    from neural.training import paper_training, train, tuned_training

    model, version = method.split(", ")
    training = {"paper": paper_training, "tuned": tuned_training}[version](model)
    training = replace(training, n_steps=training.n_steps // divisor)
    entropy = (list(PAPER_ZERO).index(name), len(draws[0]), NEURAL.index(method), seed)
    seeds = [(*entropy, shuffle) for shuffle in range(1, len(draws) + 1)]
    words = (name, len(draws[0]), *method.replace("(", "").replace(")", "").split(), seed)
    checkpoint = folder / "checkpoints" / ("-".join(map(str, words)).replace(",", "") + ".npz")
    started = time.process_time()
    trained = train(model, training, draws, seeds, checkpoint)
    seconds = (time.process_time() - started) / len(draws)
    rows = neural_errors(name, trained, len(draws[0][0].entities))
    checkpoint.unlink(missing_ok=True)
    for row, steps in zip(rows, trained.steps, strict=True):
        row.update(seconds=round(seconds, 2), steps=int(steps))
    return rows


def neural_errors(name, trained, n_bodies):
    """Errors of the runs of a network on the test scenes and in other worlds."""
    from neural.scores import can_be_asked, one_step, rollouts
    from neural.worlds import load_worlds

    test = [scenario(name).scene(k) for k in TEST]
    free = free_of_contact(name, test)
    columns = {
        "nrmse_test": one_step(trained, load_worlds(test)).mean(axis=1),
        "nrmse_test_free": one_step(trained, load_worlds(free)).mean(axis=1),
        "rollout": np.median(rollouts(trained, load_worlds(free)), axis=1),
    }
    for label, sets in other_worlds(name).items():
        worlds = [load_worlds(scenes) for scenes in sets]
        if all(can_be_asked(trained.model, w, n_bodies) for w in worlds):
            errors = [one_step(trained, w).mean(axis=1) for w in worlds]
            columns[label] = np.mean(errors, axis=0)
        else:
            columns[label] = np.full(trained.n_runs, np.nan)
    return [{label: float(x[k]) for label, x in columns.items()} for k in range(trained.n_runs)]


def jobs_of(quick, seed):
    """The jobs: the ends of the curves first, so that an early look has something to see."""
    counts, names = ((1, 2), ("mat", "nbody")) if quick else (COUNTS, ("mat", "nbody", "bounce"))
    n_draws, divisor = (2, 20) if quick else (N_DRAWS, 1)
    places = [(name, n) for n in counts for name in names]
    ends = (1, 10)
    places.sort(key=lambda p: (0, p[0] == "bounce") if p[1] in ends else (counts.index(p[1]), 0))
    return [(name, n, method, seed, n_draws, divisor)
            for name, n in places for method in METHODS]  # fmt: skip


# --- table and figure ---------------------------------------------------------------------------


def summary(table):
    """Median [quartiles] of every error, the ratio at the most scenes, and run times."""
    lines = ["# Neural models and symbolic searches against the number of training scenes\n"]
    for name in PAPER_ZERO:
        part = table[table["scenario"] == name]
        if len(part):
            lines += [f"\n## {name.upper()}\n"]
            if name in COLLIDING:
                lines += errors_table(name, part, "nrmse_test_free", "17 scenes without contact")
            lines += errors_table(name, part, "nrmse_test", "all 20 scenes")
            lines += ["", ratio_line(name, part)]
            lines += other_table(name, part)
    lines += times_table(table)
    return "\n".join(lines) + "\n"


def errors_table(name, part, column, where):
    """Test nRMSE against the number of scenes."""
    counts = sorted(set(part["n_scenes"]))
    rows = [f"\nMedian [quartiles] of the test nRMSE, {where}, m (zero force in the paper, on all: "
            f"{PAPER_ZERO[name]})\n",
            "| method | " + " | ".join(map(str, counts)) + " |",
            "|---" * (1 + len(counts)) + "|"]  # fmt: skip
    for method, mine in part.groupby("method", sort=False):
        cells = []
        for n in counts:
            errors = mine.loc[mine["n_scenes"] == n, column]
            if len(errors):
                low, middle, high = np.quantile(errors, [0.25, 0.5, 0.75])
                cells.append(f"{middle:.2g} [{low:.2g}, {high:.2g}]")
            else:
                cells.append("")
        rows.append(f"| {method} | " + " | ".join(cells) + " |")
    return rows


def ratio_line(name, part):
    """How many times the best network's median error is larger, at the most scenes run."""
    column = "nrmse_test_free" if name in COLLIDING else "nrmse_test"
    neural_part = part[part["method"].isin(NEURAL)]
    if not len(neural_part):
        return ""
    n = max(neural_part["n_scenes"])
    median = part[part["n_scenes"] == n].groupby("method")[column].median()
    best_net = median[median.index.isin(NEURAL)].idxmin()
    best_law = median[median.index.isin(SYMBOLIC[1:])].idxmin()
    zero = median["zero force"]
    # Exact laws leave rounding; below 1e-12 m there is nothing to tell apart.
    ratio = median[best_net] / max(median[best_law], 1e-12)
    return (f"At n = {n} the best network ({best_net}) errs by {median[best_net]:.2g} m, "
            f"{median[best_net] / zero:.2g} of zero force; the best search ({best_law}) by "
            f"{median[best_law]:.2g}: {ratio:.1g} times less.")  # fmt: skip


def other_table(name, part):
    """Rollouts and other worlds at the most scenes run."""
    n = max(part.loc[part["method"].isin(NEURAL), "n_scenes"], default=max(part["n_scenes"]))
    columns = ["rollout", "other numbers", "other masses"]
    rows = [f"\nAt n = {n}, medians, m: mean distance from the track over 49 steps run on "
            "without correction (median scene), and one-step nRMSE in worlds with "
            f"{_words(name)}\n",
            "| method | rollout | other numbers of bodies | other masses |",
            "|---|---|---|---|"]  # fmt: skip
    for method, mine in part[part["n_scenes"] == n].groupby("method", sort=False):
        cells = [mine[c].median() for c in columns]
        cells = ["cannot be asked" if c != c else f"{c:.2g}" for c in cells]
        rows.append(f"| {method} | " + " | ".join(cells) + " |")
    return rows


def _words(name):
    said = [", ".join(f"{k} = {v}" for k, v in numbers.items())
            for changes in OTHER[name].values() for numbers in changes]  # fmt: skip
    return "; ".join(said)


def times_table(table):
    """Processor time of a run."""
    counts = sorted(set(table["n_scenes"]))
    rows = ["\n## Processor time of one run, seconds (median)\n",
            "| scenario | method | " + " | ".join(map(str, counts)) + " |",
            "|---" * (2 + len(counts)) + "|"]  # fmt: skip
    by_scenario = table.sort_values("scenario", kind="stable")
    for (name, method), mine in by_scenario.groupby(["scenario", "method"], sort=False):
        if method == "zero force":
            continue
        seconds = mine.groupby("n_scenes")["seconds"].median()
        cells = [f"{seconds[n]:.2g}" if n in seconds else "" for n in counts]
        rows.append(f"| {name} | {method} | " + " | ".join(cells) + " |")
    return rows


def figure(table):
    """Median and 25 to 75 % band against the number of training scenes; rollouts below."""
    import matplotlib.pyplot as plt

    names = [name for name in PAPER_ZERO if name in set(table["scenario"])]
    fig, axes = plt.subplots(2, len(names), figsize=(1 + 3.6 * len(names), 7.4), squeeze=False,
                             layout="constrained")  # fmt: skip
    for ax, name in zip(axes[0], names, strict=True):
        column = "nrmse_test_free" if name in COLLIDING else "nrmse_test"
        panel(ax, table[table["scenario"] == name], column)
        ax.set(title=name.upper() + (" (without contact)" if name in COLLIDING else ""))
    for ax, name in zip(axes[1], names, strict=True):
        panel(ax, table[table["scenario"] == name], "rollout")
        # Displacement networks leave the range of numbers; how far says nothing.
        ax.set(xlabel="training scenes", ylim=(None, 1e6))
    axes[0, 0].set_ylabel("one-step nRMSE on scenes 81–100, m")
    axes[1, 0].set_ylabel("distance over 49 steps run on, m")
    known = {}
    for ax in axes[0]:
        known.update({line.get_label(): line for line in ax.get_lines()})
    fig.legend(known.values(), known, loc="outside lower center", ncols=5, fontsize=8,
               frameon=False)  # fmt: skip
    return fig


def panel(ax, part, column):
    """One panel; the paper's trainings dashed, sums of forces dotted."""
    middle_one = (part["method"].nunique() - 1) / 2
    for k, (method, mine) in enumerate(part.groupby("method", sort=False)):
        model, _, version = method.partition(", ")
        error = mine[column].clip(lower=DRAWN, upper=1e12).groupby(mine["n_scenes"])
        middle = error.median()
        at = middle.index + 0.03 * (k - middle_one)  # equal curves show
        style = {"paper": "o--", "sums": "s:"}.get(version, "o-")
        ax.plot(at, middle, style, ms=3, lw=1.2, color=COLOURS[model],
                label=method.replace("_", "-"))  # fmt: skip
        ax.fill_between(at, error.quantile(0.25), error.quantile(0.75), color=COLOURS[model],
                        alpha=0.12, lw=0)  # fmt: skip
    ax.set(yscale="log", xticks=sorted(set(part["n_scenes"])))
    top = ax.get_ylim()[1]
    decades = [k for k in range(-4, 8, 2) if 10.0**k < top]
    ax.set_yticks([DRAWN, *(10.0**k for k in decades)],
                  ["$<10^{-6}$", *(f"$10^{{{k}}}$" for k in decades)])  # fmt: skip
    ax.minorticks_off()
    ax.set_ylim(0.4 * DRAWN, top)
    ax.spines[["top", "right"]].set_visible(False)


def main():
    args = options(__doc__.splitlines()[0])
    reference_data("synth")
    try:
        import jax  # noqa: F401
        import optax  # noqa: F401
    except ImportError:
        raise SystemExit(
            "the networks need jax and optax: pip install 'bsp_gp[neural]'; "
            "data_efficiency.py has the symbolic searches without them"
        ) from None
    table = run_jobs(
        jobs_of(args.quick, args.seed), functools.partial(work, args.out), args.out, args.workers
    )
    write_all(table, args.out)


def write_all(table, out):
    """Summary and figure of a table."""
    rank = {method: k for k, method in enumerate((*SYMBOLIC, *NEURAL))}
    table = table.sort_values("method", key=lambda column: column.map(rank), kind="stable")
    write_study(summary(table), figure(table), out, "neural_efficiency")


if __name__ == "__main__":
    main()
