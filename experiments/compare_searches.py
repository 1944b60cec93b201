"""Cross-entropy, genetic, random and exhaustive search on the paper's scenes.

Noise-free with 1 to 10 scenes, then with position noise. Success is the true law up to equality
on fresh scenes; regret is taken against the certified optimum of the exhaustive search.
"""

import functools

import numpy as np
from common import options, reference_data, run_jobs, write_study
from scenes import LAWS, is_true, noisy_scenes, scenario

from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.search.compare import STRATEGIES, certified, run_one
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget

SIGMA = 1e-3
"""Standard deviation that noise-free positions are given, so that there is a likelihood."""
NOISES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
NOISY_SCENES = {"nbody": 3, "mat": 3, "bounce": 5}
LIKELIHOODS = {
    "nbody": ("one_step", "one_step_gls"),
    "mat": ("one_step", "one_step_gls"),
    "bounce": ("one_step",),
}
MARGIN = 4.0
"""Rows whose contact is within so many standard deviations of beginning or ending are left out."""
COLOURS = {"exhaustive": "#222222", "cross_entropy": "#0072b2", "genetic": "#d55e00",
           "random": "#999999"}  # fmt: skip


BUDGETS = {"random": Budget(n_scored=60_000), "cross_entropy": Budget(n_scored=30_000),
           "genetic": Budget(n_scored=30_000)}  # fmt: skip
"""The yardstick is given more laws than the learners."""
MOST_RANDOM = 2
"""Scenes up to which the yardstick runs: more of them cost it time and tell nothing new."""


@functools.lru_cache(maxsize=2)
def problem(name, n_scenes, noise, likelihood, noise_seed):
    """Objective of a problem and its certified optimum."""
    dataset = scenario(name)
    scenes = noisy_scenes(name, range(1, n_scenes + 1), noise, noise_seed)
    grammar, missing = load_grammar("newtonian").masked(dataset.types, 2)
    regression = build_regression(
        scenes, method=likelihood, sigma=noise or SIGMA, unsure=MARGIN * noise
    )
    # Exact data need no prior but to choose among equal laws; under noise it is the paper's
    # prior in nats, beta = 1, against a likelihood of known noise.
    objective = Objective(regression, grammar, "pair", beta=1.0 if noise else 1e-3)
    return objective, certified(objective, missing_inputs=missing)


def work(name, n_scenes, noise, likelihood, seed, searches):
    """All searches of one data set from one seed: a row each."""
    objective, optimum = problem(name, n_scenes, noise, likelihood, seed if noise else -1)
    rows = []
    for search in searches.split("+"):
        if search == "exhaustive":
            outcome = optimum
        else:
            index = list(STRATEGIES).index(search)
            entropy = (list(LAWS).index(name), n_scenes, round(1e6 * noise), seed, index)
            outcome = run_one(
                objective, search, STRATEGIES[search], seed, BUDGETS[search],
                rng=np.random.default_rng(entropy),
                is_done=_Done(name, objective, optimum, bool(noise)),
            )  # fmt: skip
        rows.append(row_of(outcome, optimum, name, n_scenes, noise, likelihood, seed))
    return rows


class _Done:
    """Whether a search may stop: exact data are explained, noisy ones as well as certified."""

    def __init__(self, name, objective, optimum, is_noisy):
        self.objective = objective
        self.optimum = optimum
        self.is_noisy = is_noisy

    def __call__(self, expression, score):
        if self.is_noisy:
            return score.cost <= self.optimum.cost + 1e-6
        return score.loss <= 1e-12 * self.objective.total


def row_of(outcome, optimum, name, n_scenes, noise, likelihood, seed):
    """A row of the table."""
    best = outcome.best
    law = ForceLaw((Term(best.formula, best.kind),), best.constants)
    test = [scenario(name).scene(str(k)) for k in range(81, 101)]
    return {
        "scenario": name, "n_scenes": n_scenes, "noise": noise, "likelihood": likelihood,
        "search": outcome.search, "seed": seed, "success": is_true(name, best.formula),
        "n_evaluated": outcome.n_evaluated, "n_trees": outcome.n_trees,
        "seconds": round(outcome.seconds, 3), "n_to_best": outcome.n_to_best,
        "seconds_to_best": round(outcome.seconds_to_best, 3),
        "regret": outcome.cost - optimum.cost, "nrmse_test": one_step_nrmse(test, law),
        "law": to_text(best.formula), "constants": " ".join(f"{v:.7g}" for v in
                                                           best.constants.values()),
    }  # fmt: skip


def jobs_of(quick, seed):
    """The jobs, those with a figure to meet first; neighbours share their certified optimum."""
    seeds = range(seed, seed + (2 if quick else 10))
    learners = "exhaustive+cross_entropy+genetic"
    least = {"nbody": 1, "mat": 2, "bounce": 2}
    figured = {"nbody": (0.01, 0.1), "mat": (0.001,), "bounce": (0.01,)}

    def exact(name, n_scenes):
        with_random = n_scenes <= MOST_RANDOM and not (quick and name == "bounce")
        searches = learners + "+random" * with_random
        return [(name, n_scenes, 0.0, "one_step", s, searches) for s in seeds]

    def noisy(name, noise):
        return [
            (name, NOISY_SCENES[name], noise, likelihood, s, learners)
            for likelihood in LIKELIHOODS[name]
            for s in seeds
        ]

    jobs = [job for name, n in least.items() for job in exact(name, n)]
    jobs += [job for name in figured for noise in figured[name][:1 if quick else None]
             for job in noisy(name, noise)]  # fmt: skip
    if not quick:
        # The exact covariance is slow to search on NBODY, and decides nothing there.
        jobs += [job for name in figured for noise in NOISES if noise not in figured[name]
                 for job in noisy(name, noise)
                 if (name, job[3]) != ("nbody", "one_step_gls")]  # fmt: skip
        jobs += [job for name in least for n in range(1, 11) if n != least[name]
                 for job in exact(name, n)]  # fmt: skip
    return jobs


def summary(table):
    """The figures as text."""
    lines = ["# Searches side by side\n", "Success and laws to success, noise-free:\n"]
    lines += ["| scenario | scenes | search | success | laws to success (median, max) | "
              "seconds (median, max) | regret (median) | repeats |",
              "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    exact = table[table["noise"] == 0]
    for (name, n, search), part in exact.groupby(["scenario", "n_scenes", "search"], sort=False):
        good = part[part["success"]]
        laws = f"{good['n_to_best'].median():,.0f}, {good['n_to_best'].max():,.0f}" if len(
            good) else "–"  # fmt: skip
        seconds = f"{part['seconds'].median():.2f}, {part['seconds'].max():.2f}"
        repeats = 1 - part["n_evaluated"].sum() / part["n_trees"].sum()
        lines.append(
            f"| {name} | {n} | {search} | {part['success'].sum()} of {len(part)} | {laws} | "
            f"{seconds} | {part['regret'].median():.2g} | {repeats:.0%} |"
        )
    lines += ["\nSuccess under position noise (rows with an unsure contact left out):\n",
              "| scenario | scenes | likelihood | search | "
              + " | ".join(f"{noise:g}" for noise in sorted(set(table["noise"]) - {0.0})) + " |",
              "|---" * (4 + len(set(table["noise"]) - {0.0})) + "|"]  # fmt: skip
    noisy = table[table["noise"] > 0]
    for key, part in noisy.groupby(["scenario", "n_scenes", "likelihood", "search"], sort=False):
        cells = []
        for noise in sorted(set(noisy["noise"])):
            some = part[part["noise"] == noise]["success"]
            cells.append(f"{some.sum()} of {len(some)}" if len(some) else "")
        lines.append(f"| {' | '.join(map(str, key))} | {' | '.join(cells)} |")
    lines.append(
        "\nThe paper's search needs 1 scene for NBODY and 10 for MAT, and does not find BOUNCE's "
        "law within 10 scenes (its section 4.1). Seconds are processor time. Regret is cost minus "
        "that of the certified optimum at up to eight levels; learners may use ten."
    )
    return "\n".join(lines) + "\n"


def figure(table):
    """Laws to success against scenes; success against noise."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(11, 6.4), layout="constrained")
    titles = {"nbody": "NBODY", "mat": "MAT", "bounce": "BOUNCE"}
    for column, (name, title) in enumerate(titles.items()):
        top, bottom = axes[:, column]
        exact = table[(table["scenario"] == name) & (table["noise"] == 0)]
        for search, part in exact.groupby("search", sort=False):
            good = part[part["success"]].groupby("n_scenes")["n_to_best"]
            if not len(good):
                continue
            middle = good.median()
            style = {"color": COLOURS[search], "label": search.replace("_", "-")}
            top.plot(middle.index, middle, marker="o", ms=4, **style)
            top.fill_between(middle.index, good.quantile(0.25), good.quantile(0.75), alpha=0.2,
                             color=COLOURS[search], lw=0)  # fmt: skip
        top.set(title=title, yscale="log", xlabel="training scenes", xticks=range(1, 11, 3))
        noisy = table[(table["scenario"] == name) & (table["noise"] > 0)]
        for (search, likelihood), part in noisy.groupby(["search", "likelihood"], sort=False):
            rate = part.groupby("noise")["success"].mean()
            dash = "-" if likelihood == "one_step" else "--"
            bottom.plot(rate.index, rate, dash, marker="o", ms=4, color=COLOURS[search])
        bottom.set(xscale="log", ylim=(-0.05, 1.05), xlabel="position noise (sd)")
    axes[0, 0].set_ylabel("scored laws to the true law")
    axes[1, 0].set_ylabel("share of runs that find it")
    axes[1, 0].plot([], [], "-", color="#555555", label="independent errors")
    axes[1, 0].plot([], [], "--", color="#555555", label="covariance of differences")
    axes[0, 0].legend(fontsize=8, frameon=False)
    axes[1, 0].legend(fontsize=8, frameon=False)
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "compare_searches")


if __name__ == "__main__":
    reference_data("synth")
    main()
