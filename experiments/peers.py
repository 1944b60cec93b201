"""Other tools for symbolic regression beside ours: the same laws, from tables and from motion.

Every tool has one set-up for all laws, the best that we know of; where a tool cannot be told that
forces add up over pairs, that is coded around it by hand. Ours gets the motion itself; of the
table it gets every row as a disc beside a fixed one. Needs the extra `peers` (a tool that is not
installed is left out).
"""

import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from common import options, run_jobs, write_study
from peers_tasks import (
    N_FRAMES,
    N_SCENES,
    N_TABLE,
    TASKS,
    TOLERANCE,
    dataset_of,
    motion,
    pairs_of,
    relative,
    table,
    table_scenes,
)
from threadpoolctl import threadpool_limits

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
EXPLAINED, EXACT = 1e-12, 1e-18
"""Shares of the sum of squares: below the first a grammar suffices, below the second no law of it
can do better."""
ARITHMETIC = "add,sub,mul,div,constant,variable"
COLOURS = {"bsp_gp": "#222222", "pyoperon": "#0072b2", "gplearn": "#d55e00", "pysindy": "#009e73"}
CANNOT = {
    "bsp_gp": "inner constants only where a grammar of such laws is given (`peers_inner.toml`); "
              "no free-form functions",
    "pyoperon": "sums over pairs, vectors and units: here a Python callback sums the pairs, and "
                "constants are then not optimised but mutated",
    "gplearn": "sums over pairs, vectors and units: here a metric sums the pairs; constants are "
               "drawn, not fitted",
    "pysindy": "anything that is not in its dictionary: exponents and lengths inside, contact",
}  # fmt: skip
"""What each cannot express or do."""


# --- ours ---------------------------------------------------------------------------------------


def ours(task, form, seed, seconds):
    """Grammars in turn, until one explains the data: single terms, inner constants, sums."""
    parts = motion(task, seed)
    if form == "table":
        parts = [table_scenes(task, x, y) for x, y in table(task, seed)]
    known, fresh = (build_regression(scenes, sigma=1e-3) for scenes in parts)
    types = set(dataset_types(dataset_of(parts[0])))
    started = time.process_time()
    best = None
    for name in ("physics", str(Path(__file__).with_name("peers_inner.toml")), "newtonian_sum"):
        grammar, missing = load_grammar(name).masked(types, 2)
        objective = Objective(known, grammar, "pair", starts=6)
        if name.endswith(".toml"):
            # No exhaustive search of laws with constants inside: all of its few laws are drawn.
            budget = Budget(seconds=seconds, n_steps=100)
            result = run_search(
                Genetic(population=30, offspring=30), objective, budget, keep=1,
                rng=np.random.default_rng((seed, 5)),
                callback=lambda _, o: best_loss(o) <= EXACT * o.total,
            )  # fmt: skip
            candidate = result.best
        else:
            candidate = certified(objective, missing_inputs=missing).best
        if best is None or candidate.loss < best.loss:
            best = candidate
        if best.loss <= EXPLAINED * objective.total:
            break
    spent = time.process_time() - started
    law = ForceLaw((Term(best.formula, best.kind),), best.constants)
    part = [(b, r) for b, r in zip(fresh.batches, fresh.raw_residuals(law), strict=True)]
    error = np.concatenate([r[b.valid].ravel() for b, r in part])
    target = np.concatenate([b.target[b.valid].ravel() for b, _ in part])
    constants = ", ".join(f"{k} = {v:.6g}" for k, v in best.constants.items())
    return relative(error, target), spent, f"{to_text(best.formula)}; {constants}"


def best_loss(objective):
    return min((score.loss for _, score in objective.best.values()), default=np.inf)


# --- the others -----------------------------------------------------------------------------------


def pull_of(task, form, seed, fit):
    """Let a tool find the pull of a pair; its error on fresh data.

    Parameters
    ----------
    fit : callable
        ``fit(x, y, pairs) -> (predict, text)``; y is None where pulls are not seen, pairs is None
        where they are.
    """
    started = time.process_time()
    if form == "table":
        (x, y), (x_fresh, y_fresh) = table(task, seed)
        predict, text = fit(x, y, None)
        spent = time.process_time() - started
        return relative(predict(x_fresh) - y_fresh, y_fresh), spent, text
    known, fresh = (pairs_of(task, scenes) for scenes in motion(task, seed))
    predict, text = fit(known.x, None, known)
    spent = time.process_time() - started
    factor = scale_of(known, predict(known.x))
    error = factor * fresh.summed(predict(fresh.x)) - fresh.seen
    return relative(error, fresh.seen), spent, f"{factor:.6g} * ({text})"


def scale_of(pairs, pull):
    """The factor with which pulls explain the accelerations best."""
    a = pairs.summed(pull)
    return float((a * pairs.seen).sum() / max((a * a).sum(), 1e-300))


def misfit(pairs, pull):
    """Share of the accelerations' sum of squares that pulls leave, with their best factor."""
    if not np.isfinite(pull).all():
        return 1.0
    a = pairs.summed(np.asarray(pull, dtype=float))
    size = (a * a).sum()
    if not 0 < size < np.inf:
        return 1.0
    return float(1 - (a * pairs.seen).sum() ** 2 / (size * (pairs.seen**2).sum()))


def pyoperon(task, form, seed, seconds):
    """C++ genetic programming; constants by Levenberg-Marquardt where pulls are seen.

    Arithmetic alone first, then more functions: each has half of the time.
    """
    import pyoperon as op
    from pyoperon.sklearn import SymbolicRegressor

    class Summed(SymbolicRegressor):
        """Judged by the accelerations that summed pairs make."""

        def _init_evaluator(self, objective, problem, dtable, uncertainty):
            rows = op.Range(0, len(self.pairs.x))

            def judge(_, individual):
                pull = op.Evaluate(dtable, individual.Genotype, self.data, rows)
                return [misfit(self.pairs, pull)]

            return op.UserDefinedEvaluator(problem, judge)

    def once(x, y, pairs, symbols):
        common = {
            "allowed_symbols": symbols, "population_size": 1000, "generations": 10**6,
            "max_evaluations": 10**9, "max_length": 25, "epsilon": 1e-9, "n_threads": 1,
            "max_time": max(1, int(seconds / 2)), "random_state": seed,
        }  # fmt: skip
        if pairs is None:
            return SymbolicRegressor(optimizer_iterations=10, **common).fit(x, y)
        # "c2" asks for no scaling of the model; the evaluator above takes its place.
        model = Summed(objectives=["c2"], optimizer_iterations=0, add_model_scale_term=False,
                       add_model_intercept_term=False, **common)  # fmt: skip
        model.pairs, model.data = pairs, op.Dataset(np.asfortranarray(np.column_stack((x, y))))
        return model.fit(x, y)

    def fit(x, y, pairs):
        best = None
        # Where pulls are not seen a target is asked for all the same, and not looked at.
        target = np.arange(len(x)) % 2 * 1.0 if y is None else y
        for symbols in (ARITHMETIC, ARITHMETIC + ",square,sqrt,pow,exp,fmax"):
            model = once(x, target, pairs, symbols)
            pull = np.asarray(model.predict(x), dtype=float)
            left = misfit(pairs, pull) if pairs else relative(pull - y, y) ** 2
            if best is None or left < best[0]:
                best = (left, model)
            if left < 1e-10:
                break
        model = best[1]
        text = model.get_model_string(model.model_, precision=5)
        return lambda x: np.asarray(model.predict(x), dtype=float), text

    return pull_of(task, form, seed, fit)


def gplearn(task, form, seed, seconds):
    """Genetic programming in Python, warm-started generation by generation until time is up."""
    import warnings

    from gplearn.fitness import make_fitness
    from gplearn.functions import make_function
    from gplearn.genetic import SymbolicRegressor

    def exp(x):
        return np.exp(np.clip(x, -50, 50))

    def fit(x, y, pairs):
        def judge(y, y_pred, _):
            # gplearn tries the metric on two rows first.
            return 1.0 if pairs is None or len(y_pred) != len(x) else misfit(pairs, y_pred)

        summed = make_fitness(function=judge, greater_is_better=False, wrap=False)
        metric = "pearson" if pairs is None else summed
        functions = ("add", "sub", "mul", "div", "sqrt", "inv", "max",
                     make_function(function=exp, name="exp", arity=1, wrap=False))  # fmt: skip
        model = SymbolicRegressor(
            population_size=1000, generations=1, metric=metric, function_set=functions,
            stopping_criteria=1 - 1e-9 if pairs is None else 1e-9, const_range=(-10.0, 10.0),
            parsimony_coefficient=1e-4, init_depth=(2, 5), random_state=seed, warm_start=True,
        )  # fmt: skip
        dummy = np.arange(len(x)) % 2 * 1.0 if y is None else y
        started = time.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            model.fit(x, dummy)
            while time.process_time() - started < seconds and not done(model, pairs):
                model.set_params(generations=model.generations + 1)
                model.fit(x, dummy)
        program = model._program
        slope, offset = 1.0, 0.0
        if y is not None:
            slope, offset = np.polyfit(program.execute(x), y, 1)

        def predict(x):
            with np.errstate(all="ignore"):
                return slope * program.execute(x) + offset

        return predict, f"{slope:.6g} * {program} + {offset:.3g}" if y is not None else str(program)

    return pull_of(task, form, seed, fit)


def done(model, pairs):
    """Whether gplearn's best program explains the data."""
    best = model.run_details_["best_fitness"][-1]
    return best >= 1 - 1e-9 if pairs is None else best <= 1e-9


def pysindy(task, form, seed, seconds):
    """Sequentially thresholded regression on a dictionary of monomials; the pair sum by hand.

    The threshold is the one whose terms err least on the last fifth of the rows, the fewest
    terms among equals.
    """
    from pysindy import STLSQ

    def fit(x, y, pairs):
        columns = dictionary(x)
        names = list(columns)
        if pairs is None:
            theta, target = np.column_stack(list(columns.values())), y
        else:
            theta = np.column_stack([pairs.summed(c).ravel() for c in columns.values()])
            target = pairs.seen.ravel()
        scale = np.linalg.norm(theta, axis=0)
        cut = len(target) * 4 // 5
        best = None
        for threshold in np.linalg.norm(target) * np.logspace(-6, -0.5, 23):
            model = STLSQ(threshold=threshold, alpha=0.0, max_iter=50)
            weights = fitted(model, theta[:cut] / scale, target[:cut]) / scale
            error = relative(theta[cut:] @ weights - target[cut:], target[cut:])
            key = (max(error, 1e-9), int((weights != 0).sum()))
            if best is None or key < best[0]:
                best = (key, weights)
        weights = best[1]
        text = " + ".join(f"{w:.5g} {n}" for w, n in zip(weights, names, strict=True) if w)
        return lambda x: np.column_stack(list(dictionary(x).values())) @ weights, text or "0"

    return pull_of(task, form, seed, fit)


def fitted(model, theta, target):
    """Weights; zero where the threshold leaves no term."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return model.fit(theta, target[:, None]).coef_[0]


def dictionary(x):
    """Products of masses, whole powers of the distance."""
    m_i, m_j, r = x[:, 0], x[:, 1], x[:, 2]
    masses = {"1": 1.0 + 0 * r, "m_i": m_i, "m_j": m_j, "m_i m_j": m_i * m_j}
    return {f"{name} r^{k}": m * r**k for name, m in masses.items() for k in range(-4, 5)}


# --- the table --------------------------------------------------------------------------------


def work(task, form, tool, seed, seconds):
    """One tool on one law: a row; none where the tool is not installed."""
    run = {"bsp_gp": ours, "pyoperon": pyoperon, "gplearn": gplearn, "pysindy": pysindy}[tool]
    try:
        with threadpool_limits(limits=1):
            error, spent, found = run(TASKS[task], form, seed, seconds)
    except ImportError:
        print(f"{tool} is not installed; left out", file=sys.stderr)
        return []
    row = {"law": task, "form": form, "tool": tool, "seed": seed, "error": error}
    return [{**row, "success": error <= TOLERANCE, "seconds": round(spent, 3), "found": found}]


def jobs_of(quick, seed):
    """Laws, forms, tools, seeds and seconds."""
    names = ("gravity", "softened gravity") if quick else tuple(TASKS)
    n_seeds, seconds = (1, 3.0) if quick else (5, 30.0)
    return [(name, form, tool, s, seconds) for s in range(seed, seed + n_seeds)
            for form in FORMS for name in names for tool in TOOLS]  # fmt: skip


def summary(table, seconds):
    """Found how often, median time; what each cannot do; versions."""
    lines = ["# Other tools beside ours\n",
             f"A law is found if its error on fresh data is below {TOLERANCE:g} of that of no "
             f"force. Table: up to {N_TABLE} pulls of single pairs; motion: {N_SCENES} scenes of "
             f"four discs, {N_FRAMES} frames. Cells: found / runs, median error, median processor "
             f"time. Seeds {', '.join(map(str, sorted(set(table['seed']))))}; at most {seconds:g} "
             "s a run (pyoperon by the clock; ours for laws with constants inside).\n"]  # fmt: skip
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
            f"{some['seconds'].median():.2g} s")  # fmt: skip


def known_version(tool):
    try:
        return version(tool)
    except PackageNotFoundError:
        return "not installed"


def figure(table):
    """Error on fresh data against processor time: law by law, one mark a run."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(table["law"]))
    fig, axes = plt.subplots(2, len(names), figsize=(0.8 + 2.1 * len(names), 5.6), sharex=True,
                             sharey=True, squeeze=False, layout="constrained")  # fmt: skip
    for axs, form in zip(axes, FORMS, strict=True):
        for ax, name in zip(axs, names, strict=True):
            part = table[(table["form"] == form) & (table["law"] == name)]
            for tool, mine in part.groupby("tool", sort=False):
                error = mine["error"].clip(1e-14, 10.0)
                ax.plot(mine["seconds"].clip(lower=0.05), error, "o", ms=5, alpha=0.7, mew=0,
                        color=COLOURS[tool], label=tool)  # fmt: skip
            ax.axhline(TOLERANCE, color="#999999", lw=0.8, ls="--")
            ax.set(xscale="log", yscale="log", xlim=(0.05, 300), xticks=(0.1, 1, 10, 100))
            ax.minorticks_off()
            ax.spines[["top", "right"]].set_visible(False)
        axs[0].set_ylabel(f"from {'tables' if form == 'table' else form}\nrelative error")
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(name, fontsize=10)
    for ax in axes[1]:
        ax.set_xlabel("processor time, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    jobs = jobs_of(args.quick, args.seed)
    found = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(found, jobs[0][-1]), figure(found), args.out, "peers")


if __name__ == "__main__":
    main()
