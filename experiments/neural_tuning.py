"""The tuning pass behind the tuned networks: OGN at several rates, activations, minibatches.

Trained on scenes 1 to 5 and 6 to 10, judged on scenes 41 to 80; the test scenes 81 to 100 of the
curves are not looked at.
"""

import os
from dataclasses import replace

from common import options, reference_data, run_jobs, write_text
from scenes import scenario

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)
DRAWS = (range(1, 6), range(6, 11))
JUDGES = range(41, 81)
SETTINGS = [(rate, activation, 98) for rate in (1e-3, 3e-3) for activation in ("relu", "silu")]
SETTINGS += [(1e-3, "relu", 0)]
"""Rate, activation, rows of a step (0: all)."""
MODEL = "OGN"


def work(name, rate, activation, batch, n_steps):
    """Errors of one setting, a row per draw."""
    from neural.scores import one_step
    from neural.training import train, tuned_training
    from neural.worlds import load_worlds

    base = tuned_training(MODEL)
    training = replace(base, n_steps=n_steps, rate=rate, batch=batch,
                       inputs=replace(base.inputs, activation=activation))  # fmt: skip
    draws = [[scenario(name).scene(str(k)) for k in draw] for draw in DRAWS]
    trained = train(MODEL, training, draws, seeds=[(7, k) for k in range(len(draws))])
    judges = load_worlds([scenario(name).scene(str(k)) for k in JUDGES])
    errors = one_step(trained, judges).mean(axis=1)
    return [{"scenario": name, "rate": rate, "activation": activation,
             "batch": batch or "all", "draw": k + 1, "nrmse": float(errors[k]),
             "step": int(trained.steps[k])} for k in range(len(draws))]  # fmt: skip


def summary(table):
    """Mean error of every setting, relative to the best of its scenario."""
    keys = ["rate", "activation", "batch"]
    mean = table.groupby(["scenario", *keys])["nrmse"].mean()
    best = mean.groupby("scenario").transform("min")
    wide = (mean / best).unstack("scenario")
    order = wide.mean(axis=1).sort_values().index
    head = list(wide.columns)
    lines = ["# Tuning: error on scenes 41 to 80 over the least of the column\n",
             "| rate | activation | batch | " + " | ".join(head) + " | mean |",
             "|---" * (4 + len(head)) + "|"]  # fmt: skip
    for key in order:
        cells = [f"{x:.2f}" for x in wide.loc[key]]
        lines.append(f"| {' | '.join(map(str, key))} | {' | '.join(cells)} | "
                     f"{wide.loc[key].mean():.2f} |")  # fmt: skip
    return "\n".join(lines) + "\n"


def main():
    args = options(__doc__.splitlines()[0])
    reference_data("synth")
    names, n_steps = (("mat",), 100) if args.quick else (("mat", "nbody", "bounce"), 2000)
    jobs = [(name, *setting, n_steps) for name in names for setting in SETTINGS]
    text = summary(run_jobs(jobs, work, args.out, args.workers))
    print(text)
    write_text(text, args.out / "summary.md")
    print(f"table and summary: {args.out}")


if __name__ == "__main__":
    main()
