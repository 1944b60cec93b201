"""Neural models beside the symbolic searches: the paper's Figure 4, rollouts, other worlds.

1 to 10 scenes out of 1 to 80 in five shuffled orders, the same for every method; the paper's
one-step nRMSE on scenes 81 to 100, true properties given. Beside it: running on from two rows to
the end of those scenes, and one-step errors in worlds with other numbers of bodies and other
masses. Needs the extra `neural`; without it the symbolic rows alone: data_efficiency.py.
"""

import functools
import os
from dataclasses import replace

import numpy as np
from common import options, reference_data, run_jobs, write_study
from data_efficiency import (
    BUDGETS,
    COLLIDING,
    LEARNERS,
    PAPER_ZERO,
    TEST,
    learned,
    objective_of,
    training_scenes,
)  # fmt: skip
from neural_judges import free_of_contact, other_worlds, rolled
from neural_summary import EXACT, LONGER, NEURAL, PAPERS, SYMBOLIC, TUNED, summary
from scenes import scenario

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
METHODS = ("zero force", "exhaustive", "cross_entropy", "genetic", *TUNED, *PAPERS, *LONGER)
"""In the order in which they are run: the paper's trainings take longest. "exhaustive" stands for
"exhaustive, sums" too, which begins with it."""
ASKED = {
    ("bounce", "HOGN, tuned"): (1, 2, 5, 10),
    ("bounce", "IN, tuned"): (1, 2, 5, 10),
    ("nbody", "HOGN, longer"): (5, 10),
    **{("bounce", method): () for method in LONGER},
}  # fmt: skip
"""Numbers of scenes at which networks that are not the paper's are asked, where these are not all,
or, of longer trainings, the greatest: where they take long or have little to say."""
EXPLAINED = 1e-12
"""Share of the sum of squares up to which a law leaves nothing to a second one."""
DRAWN = 1e-6
"""Least error of the figure: below it are exact laws, whose rounding says nothing."""
COLOURS = {"zero force": "#555555", "exhaustive": "#222222", "cross_entropy": "#0072b2",
           "genetic": "#56b4e9", "OGN": "#d55e00", "IN": "#009e73", "MLP (force)": "#cc79a7",
           "MLP (position)": "#e69f00", "HOGN": "#7b3294"}  # fmt: skip


# --- methods ----------------------------------------------------------------------------------


def work(folder, name, n_scenes, method, seed, n_draws, divisor):
    """One point of a curve: a row per draw, of exhaustive search two."""
    draws = [training_scenes(name, n_scenes, shuffle) for shuffle in range(1, n_draws + 1)]
    work_on = symbolic if method in SYMBOLIC else neural
    rows = work_on(folder, name, draws, method, seed, divisor)
    point = {"scenario": name, "n_scenes": n_scenes}
    return [{**point, "seed": seed, **row, **successes(row)} for row in rows]


def successes(errors):
    """Whether a law is the true one, constants included, where bodies do not touch and anywhere."""
    return {"success_free": errors["nrmse_test_free"] < EXACT,
            "success": errors["nrmse_test"] < EXACT}  # fmt: skip


def symbolic(_, name, draws, method, seed, __):
    """Rows of a search."""
    rows = []
    for shuffle, scenes in enumerate(draws, 1):
        for label, (best, seconds) in searched(name, scenes, method, seed, shuffle).items():
            row = {"shuffle": shuffle, "method": label, "seconds": round(seconds, 3), "law": ""}
            law = ForceLaw(())
            if best is not None:
                law = ForceLaw((Term(best.formula, best.kind),), best.constants)
                row["law"] = to_text(best.formula)
            rows.append({**row, **errors_on_test(name, law), **other_errors(name, law)})
    return rows


def searched(name, scenes, method, seed, shuffle):
    """The best candidates and processor times of a search: {method: (best, seconds)}."""
    if method == "zero force":
        return {method: (None, 0.0)}
    if method == "exhaustive":
        return exhaustive(name, scenes)
    objective, _ = objective_of(name, scenes)
    entropy = (list(PAPER_ZERO).index(name), len(scenes), shuffle, seed,
               list(LEARNERS).index(method))  # fmt: skip
    outcome = learned(objective, method, LEARNERS[method], seed, BUDGETS[method], entropy)
    return {method: (outcome.best, outcome.seconds)}


def exhaustive(name, scenes):
    """The best single law, and the best sum of forces where no single one explains the scenes.

    A collision in an NBODY scene pulls every single law off.
    """
    objective, missing = objective_of(name, scenes)
    single = certified(objective, missing_inputs=missing)
    found = {"exhaustive": (single.best, single.seconds)}
    sums = found["exhaustive"]
    if single.best.loss > EXPLAINED * objective.total:
        objective, missing = objective_of(name, scenes, "newtonian_sum")
        outcome = certified(objective, missing_inputs=missing)
        sums = (outcome.best, single.seconds + outcome.seconds)
    return {**found, "exhaustive, sums": sums}


def errors_on_test(name, law):
    """One-step errors of a law on the test scenes, all and those without contact, m."""
    test = [scenario(name).scene(k) for k in TEST]
    return {"nrmse_test": one_step_nrmse(test, law),
            "nrmse_test_free": one_step_nrmse(free_of_contact(name, test), law)}  # fmt: skip


def other_errors(name, law):
    """Distance of a law when run on over the test scenes, and its errors in other worlds, m."""
    free = free_of_contact(name, [scenario(name).scene(k) for k in TEST])
    gaps = []
    for scene, path in zip(free, rolled(free, law), strict=True):
        gap = np.linalg.norm(path - scene.positions[2:, scene.dynamic], axis=-1).sum()
        gap /= len(scene.entities) * len(path)
        gaps.append(gap if np.isfinite(gap) else np.inf)
    errors = {"rollout": float(np.median(gaps))}
    for label, sets in other_worlds(name).items():
        errors[label] = float(np.mean([one_step_nrmse(scenes, law) for scenes in sets]))
    return errors


def neural(folder, name, draws, method, seed, divisor):
    """Rows of a network, trained on every draw."""
    from neural.training import longer_training, paper_training, train, tuned_training

    model, version = method.split(", ")
    made = {"tuned": tuned_training, "longer": longer_training}
    training = paper_training(model) if version == "paper" else made[version](model, name)
    training = replace(training, n_steps=training.n_steps // divisor)
    entropy = (list(PAPER_ZERO).index(name), len(draws[0]), NEURAL.index(method), seed)
    seeds = [(*entropy, shuffle) for shuffle in range(1, len(draws) + 1)]
    words = (name, len(draws[0]), *method.replace("(", "").replace(")", "").split(), seed)
    checkpoint = folder / "checkpoints" / ("-".join(map(str, words)).replace(",", "") + ".npz")
    trained = train(model, training, draws, seeds, checkpoint)
    rows = neural_errors(name, trained, len(draws[0][0].entities))
    checkpoint.unlink(missing_ok=True)
    seconds = round(trained.seconds / len(draws), 2)
    return [{"shuffle": k + 1, "method": method, "seconds": seconds, "law": "",
             "steps": int(trained.steps[k]), **row} for k, row in enumerate(rows)]  # fmt: skip


def neural_errors(name, trained, n_bodies):
    """Errors of the runs of a network on the test scenes and in other worlds."""
    from neural.scores import can_be_asked, one_step, rollouts, share_predicted
    from neural.worlds import load_worlds

    test = [scenario(name).scene(k) for k in TEST]
    free = free_of_contact(name, test)
    columns = {
        "nrmse_test": one_step(trained, load_worlds(test)).mean(axis=1),
        "nrmse_test_free": one_step(trained, load_worlds(free)).mean(axis=1),
        "share_predicted": share_predicted(trained, load_worlds(test)),
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
    if quick:
        places = [("mat", 1), ("nbody", 1), ("mat", 2), ("nbody", 2), ("bounce", 1)]
        n_draws, divisor = 2, 20
    else:
        # Of the ends BOUNCE last: its networks take longest.
        places = [(name, n) for names in (("mat", "nbody"), ("bounce",)) for n in COUNTS[:2]
                  for name in names]  # fmt: skip
        places += [(name, n) for n in COUNTS[2:] for name in ("mat", "nbody", "bounce")]
        n_draws, divisor = N_DRAWS, 1
    most = {name: max(n for other, n in places if other == name) for name, _ in places}

    def asked(name, n, method):
        return n in ASKED.get((name, method), (most[name],) if method in LONGER else COUNTS)

    jobs = [(name, n, method, seed, n_draws, divisor) for name, n in places for method in METHODS
            if asked(name, n, method)]  # fmt: skip
    # Of least weight for the curves, and they take longest.
    return sorted(jobs, key=lambda job: job[2] in LONGER)


# --- figure -----------------------------------------------------------------------------------


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
    """One panel; the paper's trainings dashed, sums of forces dotted, longer trainings starred."""
    middle_one = (part["method"].nunique() - 1) / 2
    for k, (method, mine) in enumerate(part.groupby("method", sort=False)):
        model, _, version = method.partition(", ")
        error = mine[column].clip(lower=DRAWN, upper=1e12).groupby(mine["n_scenes"])
        middle = error.median()
        at = middle.index + 0.03 * (k - middle_one)  # equal curves show
        style = {"paper": "o--", "sums": "s:", "longer": "*-."}.get(version, "o-")
        ax.plot(at, middle, style, ms=7 if version == "longer" else 3, lw=1.2, color=COLOURS[model],
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
