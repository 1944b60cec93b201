"""An invisible attractor among five visible discs: found, placed, and not invented.

Scenes of 100 frames with noise of one per cent of their width, with a heavy body at rest that no
camera sees, and without one. The search for a hidden body is asked directly, without the first
test of the residual, so that what it invents is counted at its worst.
"""

import numpy as np
from common import options, run_jobs, write_study
from disc_worlds import ALPHA, sought

N_WITH, N_WITHOUT = 20, 200
QUICK_WITH, QUICK_WITHOUT = 2, 4
FIRST_WITHOUT = 1000
"""Seeds of scenes without a hidden body start here."""


def work(kind, seed):
    """One scene: a row."""
    return [{"kind": kind, "seed": seed, **sought(seed, kind == "with")._asdict()}]


def jobs_of(quick, seed):
    """The jobs, with and without in turn."""
    n_with, n_without = (QUICK_WITH, QUICK_WITHOUT) if quick else (N_WITH, N_WITHOUT)
    first = FIRST_WITHOUT + seed
    return [("with", seed + k) for k in range(n_with)] + [
        ("without", first + k) for k in range(n_without)
    ]


def summary(table):
    """How many are found, how far from their places, and how many are invented."""
    has_one = table["kind"] == "with"
    found = table[has_one & table["is_claimed"]]
    near = int((found["error"] <= 3).sum())
    invented = int(table.loc[~has_one, "is_claimed"].sum())
    return (
        "# An invisible attractor among five discs\n\n"
        f"Found in {len(found)} of {int(has_one.sum())} scenes; the place is within three "
        f"posterior standard deviations in {near} of these (median error "
        f"{found['error'].median():.2f} of them, {found['gap'].median():.3f} m).\n\n"
        f"Invented in {invented} of {int((~has_one).sum())} scenes without one, at level "
        f"{ALPHA:g}.\n"
    )


def figure(table):
    """Errors of places; p-values of scenes without a hidden body."""
    import matplotlib.pyplot as plt

    fig, (left, right) = plt.subplots(1, 2, figsize=(7.6, 3.4), layout="constrained")
    found = table[(table["kind"] == "with") & table["is_claimed"]]
    errors = np.sort(found["error"])
    left.plot(errors, np.arange(1, len(errors) + 1), "o", ms=4, color="#d55e00")
    left.axvline(3, color="0.6", lw=0.8)
    left.set(xlabel="error of the place, posterior standard deviations", ylabel="scenes, in order",
             xlim=(0, None), ylim=(0, None))  # fmt: skip
    p = np.sort(table.loc[table["kind"] == "without", "p_value"])
    right.step(p, np.arange(1, len(p) + 1) / max(len(p), 1), where="post", color="#0072b2")
    right.plot([0, 1], [0, 1], color="0.6", lw=0.8)
    right.set(xlabel="p-value without a hidden body", ylabel="share of scenes up to it",
              xlim=(0, 1), ylim=(0, 1))  # fmt: skip
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "hidden_discs")


if __name__ == "__main__":
    main()
