"""Other tools for symbolic regression beside ours: the same laws, from tables and from motion.

Every tool has one set-up for all laws, the best that we know of (`peers_tools.py`), and one budget
of processor time for a run; what of ours is over it counts as failed. Ours gets the motion itself;
of the table it gets every row as a disc beside a fixed one. It searches its shipped grammar as the
loop does, stage by stage; the last four laws are no form of it. Needs the extra `peers` (a tool
that is not installed is left out).
"""

import sys
import time
from importlib.metadata import PackageNotFoundError, version

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

from bsp_gp.errors import EvaluationError
from bsp_gp.language.formula import Call, Constant, rename_constants, walk
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.compare import certified
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.inner import ZOOMS, InnerSearch, read_forms
from bsp_gp.search.objective import Objective
from bsp_gp.search.shapes import ShapeSearch, read_ways

TOOLS = ("bsp_gp", "pyoperon", "gplearn", "pysindy")
FORMS = ("table", "motion")
BUDGET, QUICK_BUDGET = 60.0, 10.0
"""Processor seconds of a run."""
EXPLAINED = 1e-12
"""Part of the sum of squares below which a law explains the data."""
LEVELS, BRED = 8, 15_000
"""Of derivations of laws without inner constants; shapes that are bred in each way."""
MOST_FORMS, MOST_LEADS = 8, 3
"""Forms whose constants are fitted, and of these such beside which others are sought."""
COLOURS = {"bsp_gp": "#222222", "pyoperon": "#0072b2", "gplearn": "#d55e00", "pysindy": "#009e73"}
CANNOT = {
    "bsp_gp": "functions that neither its forms with constants inside nor its rules for shapes "
              "of one variable can say",
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
    """The shipped grammar until a law explains the data: exhaustive, constants inside, sums, drawn.

    What is drawn are laws of the grammar's rules with constants inside, by cross-entropy and by
    genetic programming, which set out from the best before them.
    """
    parts = motion(task, seed)
    if form == "table":
        parts = [table_scenes(task, x, y) for x, y in table(task, seed)]
    started = time.process_time()
    known, *others = (build_regression(scenes, sigma=1e-3) for scenes in parts)
    tried = Tried(known, dataset_of(parts[0]), np.random.default_rng((seed, 5)))
    for stage in (tried.enumerated, tried.inside, tried.shaped, tried.beside, tried.sums):
        stage()
        if tried.is_explained or time.process_time() - started > seconds:
            break
    spent = time.process_time() - started
    law, loss = tried.best
    constants = ", ".join(f"{k} = {v:.6g}" for k, v in law.constants.items())
    errors = [error_of(law, regression, form) for regression in others]
    return {"error": errors[0], "error_far": errors[1], "seconds": round(spent, 3),
            "found": " + ".join(to_text(term.formula) for term in law.terms) + f"; {constants}",
            "size": sum(1 for term in law.terms for _ in walk(term.formula))}  # fmt: skip


class Tried:
    """Laws between pairs that were tried on a regression, stage by stage.

    Attributes
    ----------
    best : (ForceLaw, float)
        The law that leaves least, and half the sum of squares that it leaves.
    """

    def __init__(self, known, dataset, rng):
        types = dataset_types(dataset)
        grammar = load_grammar("physics")
        self.grammar, self.missing = grammar.masked(set(types), 2)
        self.known, self.rng, self.best = known, rng, (None, np.inf)
        self.objective = Objective(known, self.grammar, "pair")
        target = self.objective.y
        self.forms = [form for form in read_forms(grammar, dataset, (), set(types))
                      if form.term.kind == "pair"]  # fmt: skip
        self.shapes = grammar.shapes
        self.ways = read_ways(grammar, dataset, (), types, set(types))
        self.search = InnerSearch(
            known, target, np.zeros((len(target), 0)), lambda columns: columns,
            np.ones(2, dtype=bool), grammar.inside["ranges"], types,
        )  # fmt: skip
        self.leads = []

    @property
    def is_explained(self):
        return self.best[1] <= EXPLAINED * self.objective.total

    def take(self, law):
        """Fit the constants of a law, and keep it if it leaves less than the best."""
        try:
            fit = fit_constants(self.objective.projected, law, starts=3)
        except EvaluationError:
            return
        if fit.loss < self.best[1]:
            self.best = fit.law, fit.loss

    def enumerated(self):
        """All products of the grammar, with their certificate."""
        found = search_exhaustive(
            self.known, self.grammar, kind="pair", max_levels=LEVELS, missing_inputs=self.missing
        ).best  # fmt: skip
        self.take(ForceLaw((Term(found.formula, "pair"),), found.constants))

    def sums(self):
        """Sums of laws without inner constants."""
        grammar, missing = load_grammar("newtonian_sum").masked(self.search._types.keys(), 2)
        found = certified(Objective(self.known, grammar, "pair"), missing_inputs=missing).best
        self.take(ForceLaw((Term(found.formula, found.kind),), found.constants))

    def inside(self):
        """The forms of the grammar with constants inside, each where it does best."""
        self.leads = self.scanned(self.search)
        for scan in self.leads:
            self.take(law_of([(self.search, scan)]))

    def shaped(self):
        """Shapes of one variable, bred on profiles, simple ones first."""
        ways = [way for way in self.ways if way.term.kind == "pair"]
        shapes = ShapeSearch(self.shapes, self.search, ways, BRED, chance=0.0)
        found = shapes.run(lambda levels, seeds: Genetic(max_levels=levels, seeds=seeds), self.rng)
        for shape in found:
            term = shape.form.term
            term = Term(Call("mul", Constant("c1"), term.formula), term.kind)
            self.take(ForceLaw((term,), {"c1": 1.0, **shape.at}))
            if self.is_explained:
                return

    def beside(self):
        """Two of them at once."""
        for lead in self.leads[:MOST_LEADS]:
            other = self.search.besides(self.search.linearised(lead))
            for scan in self.scanned(other)[:MOST_LEADS]:
                self.take(law_of([(self.search, lead), (other, scan)]))

    def scanned(self, search):
        """Scans of all forms, likeliest first, looked at closely."""
        found = [scan for form in self.forms if (scan := search.scan(form)) is not None]
        for zoom in range(ZOOMS):
            found = sorted(found, key=lambda scan: -scan.promise)[: max(80 >> zoom, 8)]
            found = [search.closer(scan, zoom) for scan in found]
        return sorted(found, key=lambda scan: -scan.promise)[:MOST_FORMS]


def law_of(scans):
    """A sum of forms with constants where their grids have them."""
    terms, constants = [], {}
    for k, (search, scan) in enumerate(scans, 1):
        names = {axis.name: f"{axis.name}{k}" for axis in scan.axes} | {"c": f"c{k}"}
        formula = Call("mul", Constant("c"), scan.form.term.formula)
        terms.append(Term(rename_constants(formula, names), "pair"))
        constants |= {names[a.name]: float(a.values(x))
                      for a, x in zip(scan.axes, scan.at, strict=True)}  # fmt: skip
        constants[f"c{k}"] = search.strength(scan)
    return ForceLaw(tuple(terms), constants)


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
    lines += [f"- {tool}: {CANNOT[tool]}" for tool in TOOLS]
    lines += ["\nVersions: " + ", ".join(f"{tool} {known_version(tool)}" for tool in TOOLS)]
    return "\n".join(lines) + "\n"


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
