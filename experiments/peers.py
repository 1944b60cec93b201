"""Other tools for symbolic regression beside ours: the same laws, from tables and from motion.

Every tool has one set-up for all laws, the best that we know of (`peers_tools.py`), and one budget
of processor time for a run; what of ours is over it counts as failed. Ours gets the motion itself;
of the table it gets every row as a disc beside a fixed one. All laws but one, shifted gravity, are
in one of its grammars: the comparison says what it is worth to have a grammar of mechanics, not
that ours would come upon any law. That of laws with constants inside, `peers_inner.toml`, has 90
forms. Needs the extra `peers` (a tool that is not installed is left out).
"""

import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from common import options, run_jobs, write_study
from peers_tasks import (
    FAR_TOLERANCE,
    N_FRAMES,
    N_SCENES,
    N_TABLE,
    TASKS,
    TOLERANCE,
    dataset_of,
    motion,
    relative,
    table,
    table_scenes,
)
from peers_tools import gplearn, pyoperon, pysindy
from threadpoolctl import threadpool_limits

from bsp_gp.language.formula import walk
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.compare import certified
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search

TOOLS = ("bsp_gp", "pyoperon", "gplearn", "pysindy")
FORMS = ("table", "motion")
BUDGET, QUICK_BUDGET = 60.0, 10.0
"""Processor seconds of a run."""
INNER = str(Path(__file__).with_name("peers_inner.toml"))
EXPLAINED, EXACT = 1e-12, 1e-18
"""Shares of the sum of squares: below the first a grammar suffices, below the second no law of it
can do better."""
COLOURS = {"bsp_gp": "#222222", "pyoperon": "#0072b2", "gplearn": "#d55e00", "pysindy": "#009e73"}
CANNOT = {
    "bsp_gp": "free-form functions (shifted gravity); constants inside only where a grammar of "
              "such laws is given (`peers_inner.toml`: {n_forms} forms, the three laws of that "
              "kind asked for here among them)",
    "pyoperon": "sums over pairs, vectors and units: here a Python callback sums the pairs, "
                "constants are then mutated, and fitted in the final tree only",
    "gplearn": "sums over pairs, vectors and units: here a metric sums the pairs; constants are "
               "drawn, and fitted in the final program only",
    "pysindy": "anything that is not in its dictionary: exponents that are no half-integers, "
               "lengths inside but for a decade of ranges",
}  # fmt: skip
"""What each cannot express or do."""


# --- ours ---------------------------------------------------------------------------------------


def ours(task, form, seed, seconds):
    """Grammars in turn, until one explains the data: single terms, inner constants, sums."""
    parts = motion(task, seed)
    if form == "table":
        parts = [table_scenes(task, x, y) for x, y in table(task, seed)]
    started = time.process_time()
    known, *others = (build_regression(scenes, sigma=1e-3) for scenes in parts)
    types = set(dataset_types(dataset_of(parts[0])))
    best = None
    for name in ("physics", INNER, "newtonian_sum"):
        grammar, missing = load_grammar(name).masked(types, 2)
        objective = Objective(known, grammar, "pair", starts=6)
        if name.endswith(".toml"):
            # No exhaustive search of laws with constants inside: all of its few laws are drawn.
            left = seconds - (time.process_time() - started)
            budget = Budget(seconds=max(left, 1.0), n_steps=100)
            result = run_search(
                Genetic(population=30, offspring=30), objective, budget, keep=1,
                rng=np.random.default_rng((seed, 5)),
                callback=lambda _, o: best_loss(o) <= EXACT * o.total, is_part=True,
            )  # fmt: skip
            candidate = result.best
        else:
            candidate = certified(objective, missing_inputs=missing).best
        if best is None or candidate.loss < best.loss:
            best = candidate
        if best.loss <= EXPLAINED * objective.total or time.process_time() - started > seconds:
            break
    spent = time.process_time() - started
    law = ForceLaw((Term(best.formula, best.kind),), best.constants)
    constants = ", ".join(f"{k} = {v:.6g}" for k, v in best.constants.items())
    errors = [error_of(law, regression, form) for regression in others]
    return {"error": errors[0], "error_far": errors[1], "seconds": round(spent, 3),
            "found": f"{to_text(best.formula)}; {constants}",
            "size": sum(1 for _ in walk(best.formula))}  # fmt: skip


def error_of(law, regression, form):
    """Error over that of no force: of pulls where these are given, else of accelerations."""
    error, target = [], []
    for batch, residual in zip(regression.batches, regression.raw_residuals(law), strict=True):
        factor = 1.0
        if form == "table":
            mass = {scene.name: scene.entities[0].mass for scene in regression.scenes}
            factor = np.array([mass[name] for name in batch.scene_names])[:, None, None]
        error.append((factor * residual)[batch.valid])
        target.append((factor * batch.target)[batch.valid])
    return relative(np.concatenate(error), np.concatenate(target))


def best_loss(objective):
    return min((score.loss for _, score in objective.best.values()), default=np.inf)


# --- the table --------------------------------------------------------------------------------


def work(task, form, tool, seed, seconds):
    """One tool on one law: a row; none where the tool is not installed."""
    run = {"bsp_gp": ours, "pyoperon": pyoperon, "gplearn": gplearn, "pysindy": pysindy}[tool]
    try:
        with threadpool_limits(limits=1):
            found = run(TASKS[task], form, seed, seconds)
    except ImportError:
        print(f"{tool} is not installed; left out", file=sys.stderr)
        return []
    success = found["error"] <= TOLERANCE and found["error_far"] <= FAR_TOLERANCE
    # The others are stopped by the budget themselves, ours is not in the midst of a search.
    success = success and (tool != "bsp_gp" or found["seconds"] <= seconds)
    row = {"law": task, "form": form, "tool": tool, "seed": seed, "success": success}
    return [{**row, **found}]


def jobs_of(quick, seed, budget=None):
    """Laws, forms, tools, seeds and seconds."""
    names = ("gravity", "softened gravity") if quick else tuple(TASKS)
    n_seeds = 1 if quick else 5
    seconds = budget or (QUICK_BUDGET if quick else BUDGET)
    return [(name, form, tool, s, seconds) for s in range(seed, seed + n_seeds)
            for form in FORMS for name in names for tool in TOOLS]  # fmt: skip


def summary(table, seconds):
    """Found how often, median time; what each cannot do; versions."""
    lines = ["# Other tools beside ours\n",
             f"A law is found if its error on fresh data is below {TOLERANCE:g} of that of no "
             f"force, and below {FAR_TOLERANCE:g} beyond the range learned from: in twice the box, "
             f"of a contact with twice the radii. Table: up to {N_TABLE} pulls of single pairs; "
             f"motion: {N_SCENES} scenes of four discs, {N_FRAMES} frames. Cells: found / runs, "
             "median error, median processor time, median size (nodes; of pysindy terms). Seeds "
             f"{', '.join(map(str, sorted(set(table['seed']))))}. One budget for all: {seconds:g} "
             "s of processor time a run. What of ours is over it counts as failed; the others are "
             "stopped after the generation or the second under way. A run cut by time is not "
             "reproducible by its seed.\n"]  # fmt: skip
    for form in FORMS:
        part = table[table["form"] == form]
        tools = [tool for tool in TOOLS if tool in set(part["tool"])]
        lines.append(f"\n## From {'a table of pulls' if form == 'table' else 'motion'}\n")
        lines += ["| law | " + " | ".join(tools) + " |", "|---" * (1 + len(tools)) + "|"]
        for name, mine in part.groupby("law", sort=False):
            cells = [cell(mine[mine["tool"] == tool]) for tool in tools]
            lines.append(f"| {name}: {TASKS[name].text} | " + " | ".join(cells) + " |")
    lines += ["\n## What each cannot express or do\n"]
    lines += [f"- {tool}: {CANNOT[tool].format(n_forms=n_forms())}" for tool in TOOLS]
    lines += ["\nVersions: " + ", ".join(f"{tool} {known_version(tool)}" for tool in TOOLS)]
    return "\n".join(lines) + "\n"


def n_forms():
    """Laws of the grammar with constants inside, but for the values of their constants."""
    grammar = load_grammar(INNER)
    return grammar.count(grammar.start["pair"], len(grammar.types))


def cell(some):
    if not len(some):
        return ""
    return (f"{some['success'].sum()}/{len(some)}, {some['error'].median():.1g}, "
            f"{some['seconds'].median():.2g} s, {some['size'].median():.0f}")  # fmt: skip


def known_version(tool):
    try:
        return version(tool)
    except PackageNotFoundError:
        return "not installed"


def figure(table):
    """Error on fresh data against processor time: law by law, one mark a run, hollow if failed."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    names = list(dict.fromkeys(table["law"]))
    fig, axes = plt.subplots(2, len(names), figsize=(0.8 + 2.1 * len(names), 5.6), sharex=True,
                             sharey=True, squeeze=False, layout="constrained")  # fmt: skip
    for axs, form in zip(axes, FORMS, strict=True):
        for ax, name in zip(axs, names, strict=True):
            part = table[(table["form"] == form) & (table["law"] == name)]
            for tool, mine in part.groupby("tool", sort=False):
                for success, marks in mine.groupby(mine["success"].astype(bool)):
                    # Hollow: no law, though it may be close within the range learned from.
                    face = COLOURS[tool] if success else "none"
                    ax.plot(marks["seconds"].clip(lower=0.05), marks["error"].clip(1e-14, 10.0),
                            "o", ms=5, alpha=0.7, mec=COLOURS[tool], mfc=face)  # fmt: skip
            ax.axhline(TOLERANCE, color="#999999", lw=0.8, ls="--")
            ax.set(xscale="log", yscale="log", xlim=(0.05, 300), xticks=(0.1, 1, 10, 100))
            ax.minorticks_off()
            ax.spines[["top", "right"]].set_visible(False)
        axs[0].set_ylabel(f"from {'tables' if form == 'table' else form}\nrelative error")
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(name, fontsize=10)
    for ax in axes[1]:
        ax.set_xlabel("processor time, s")
    handles = [Line2D([], [], marker="o", ls="", color=COLOURS[tool], label=tool)
               for tool in dict.fromkeys(table["tool"])]  # fmt: skip
    fig.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0], declare=lambda parser: parser.add_argument(
        "--budget", type=float, help=f"processor seconds of a run (default: {BUDGET:g}, "
        f"quick {QUICK_BUDGET:g})"))  # fmt: skip
    jobs = jobs_of(args.quick, args.seed, args.budget)
    found = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(found, jobs[0][-1]), figure(found), args.out, "peers")


if __name__ == "__main__":
    main()
