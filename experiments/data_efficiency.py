"""Error on held-out scenes against the number of training scenes (the paper's Figure 4).

1 to 10 scenes out of 1 to 80 in five shuffled orders, each with a seed of its own; the paper's
one-step nRMSE on scenes 81 to 100, true properties given. Symbolic searches and zero force; with
the neural models, sums of forces, rollouts and other worlds: neural_efficiency.py.
"""

import numpy as np
from common import options, reference_data, run_jobs, write_study
from scenes import is_true, scenario

from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.search.compare import STRATEGIES, certified, run_one
from bsp_gp.search.cross_entropy import CrossEntropy
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget

SIGMA = 1e-3
TEST = [str(k) for k in range(81, 101)]
COLLIDING = {"nbody": ("82", "84", "97")}
"""Test scenes in which bodies touch: gravity alone leaves 1.2e-2 on all, nothing on the others."""
PAPER = CrossEntropy(
    1000, 10, 800, 200.0, distinct=False, uniform_share=0.0, patience=None, pool=None
)
LEARNERS = {"cross_entropy": STRATEGIES["cross_entropy"], "genetic": STRATEGIES["genetic"],
            "paper": PAPER}  # fmt: skip
BUDGETS = {"cross_entropy": Budget(n_scored=20_000), "genetic": Budget(n_scored=20_000),
           "paper": Budget(n_steps=4)}  # fmt: skip
"""The paper's preset draws one population and four more."""
PAPER_ZERO = {"nbody": 1.768, "bounce": 0.05984, "mat": 0.001199}
COLOURS = {"zero force": "#555555", "exhaustive": "#222222", "cross_entropy": "#0072b2",
           "genetic": "#d55e00", "paper": "#cc79a7"}  # fmt: skip


def training_scenes(name, n_scenes, shuffle):
    """The first scenes of 1 to 80 in an order that depends on the number `shuffle` alone."""
    order = np.random.default_rng(shuffle).permutation(80)[:n_scenes] + 1
    return [scenario(name).scene(str(k)) for k in order]


def objective_of(name, scenes, grammar_name="newtonian"):
    """Noise-free objective of a scenario, and the inputs that its data lack."""
    grammar, missing = load_grammar(grammar_name).masked(scenario(name).types, 2)
    regression = build_regression(scenes, sigma=SIGMA)
    return Objective(regression, grammar, "pair", beta=1e-3), missing


def learned(objective, method, strategy, seed, budget, entropy):
    """Run a learner until exact data are explained or its budget is spent."""
    return run_one(
        objective, method, strategy, seed, budget, rng=np.random.default_rng(entropy),
        is_done=lambda expression, score: score.loss <= 1e-12 * objective.total,
    )  # fmt: skip


def work(name, n_scenes, shuffle, method, seed):
    """One point of a curve: a row."""
    test = [scenario(name).scene(k) for k in TEST]
    if method == "zero force":
        return [row(name, n_scenes, shuffle, method, seed, ForceLaw(()), test)]
    objective, missing = objective_of(name, training_scenes(name, n_scenes, shuffle))
    if method == "exhaustive":
        outcome = certified(objective, missing_inputs=missing)
    else:
        index = list(LEARNERS).index(method)
        entropy = (list(PAPER_ZERO).index(name), n_scenes, shuffle, seed, index)
        outcome = learned(objective, method, LEARNERS[method], seed, BUDGETS[method], entropy)
    return [scored(name, n_scenes, shuffle, method, seed, outcome, test)]


def scored(name, n_scenes, shuffle, method, seed, outcome, test):
    """The row of an outcome."""
    best = outcome.best
    law = ForceLaw((Term(best.formula, best.kind),), best.constants)
    return row(name, n_scenes, shuffle, method, seed, law, test, is_true(name, best.formula),
               outcome.n_evaluated, round(outcome.seconds, 3), to_text(best.formula))  # fmt: skip


def row(
    name, n_scenes, shuffle, method, seed, law, test, success=False, n=0, seconds=0.0, text=""
):
    """A row of the table."""
    free = [scene for scene in test if scene.name not in COLLIDING.get(name, ())]
    return {
        "scenario": name, "n_scenes": n_scenes, "shuffle": shuffle, "method": method,
        "seed": seed, "nrmse_test": one_step_nrmse(test, law),
        "nrmse_test_free": one_step_nrmse(free, law), "success": success, "n_evaluated": n,
        "seconds": seconds, "law": text,
    }  # fmt: skip


def points(quick):
    """(scenario, number of scenes, order) of the curves."""
    shuffles = range(1, 2 if quick else 6)
    counts = (1, 2) if quick else range(1, 11)
    return [(name, n, s) for name in PAPER_ZERO for n in counts for s in shuffles]


def jobs_of(quick, seed):
    """The jobs; every order of the scenes has a seed of its own."""
    methods = ("zero force", "exhaustive", *LEARNERS)
    return [(*point, method, seed + point[-1] - 1) for point in points(quick) for method in methods]


def summary(table, title, column="method"):
    """Median [quartiles] of the test error, and how often the true law was found."""
    lines = [f"# {title}\n"]
    for name, part in table.groupby("scenario", sort=False):
        counts = sorted(set(part["n_scenes"]))
        lines += [f"\n{name.upper()} (zero force in the paper: {PAPER_ZERO[name]}): median "
                  "[quartiles] of the test nRMSE; true law found\n",
                  f"| {column} | " + " | ".join(map(str, counts)) + " |",
                  "|---" * (1 + len(counts)) + "|"]  # fmt: skip
        for method, mine in part.groupby(column, sort=False):
            cells = []
            for n in counts:
                some = mine[mine["n_scenes"] == n]
                low, middle, high = np.quantile(some["nrmse_test"], [0.25, 0.5, 0.75])
                cell = f"{middle:.2g} [{low:.2g}, {high:.2g}]"
                if name in COLLIDING:
                    cell += f"; {some['nrmse_test_free'].median():.2g} without contact"
                if some["law"].notna().any():
                    cell += f"; {some['success'].sum()}/{len(some)}"
                cells.append(cell)
            lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def figure(table, column="method", colours=COLOURS):
    """Median and 25 to 75 % band against the number of training scenes."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, 3, figsize=(11, 3.7), layout="constrained")
    for ax, name in zip(axes, PAPER_ZERO, strict=True):
        mine = table[table["scenario"] == name]
        methods = list(dict.fromkeys(mine[column]))
        for method, part in mine.groupby(column, sort=False):
            aside = 0.06 * (methods.index(method) - (len(methods) - 1) / 2)  # equal curves show
            # Exact laws leave rounding; below 1e-12 there is nothing to tell apart.
            error = part["nrmse_test"].clip(lower=1e-12).groupby(part["n_scenes"])
            ax.plot(error.median().index + aside, error.median(), "o-", ms=4, color=colours[method],
                    label=method.replace("_", "-"))  # fmt: skip
            if name in COLLIDING:
                free = part["nrmse_test_free"].clip(lower=1e-12).groupby(part["n_scenes"]).median()
                ax.plot(free.index + aside, free, ":", color=colours[method])
            ax.fill_between(error.median().index + aside, error.quantile(0.25),
                            error.quantile(0.75), color=colours[method],
                            alpha=0.2, lw=0)  # fmt: skip
        ax.set(title=name.upper(), yscale="log", xlabel="training scenes", ylim=(4e-13, None),
               xticks=sorted(set(mine["n_scenes"])))  # fmt: skip
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("nRMSE on scenes 81–100")
    axes[0].plot([], [], ":", color="#555555", label="17 scenes without contact")
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8,
               frameon=False)  # fmt: skip
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    reference_data("synth")
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    text = summary(table, "Error against the number of training scenes")
    write_study(text, figure(table), args.out, "data_efficiency")


if __name__ == "__main__":
    main()
