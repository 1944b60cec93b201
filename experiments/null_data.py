"""Data that lack nothing: how often an effect is adopted all the same, and whether p is uniform.

Worlds of pymunk under three declared models (thrown balls, a spring, two light bodies around a
heavy one), with white noise and with noise that has a memory. The loop is closed on each; p is the
chance that noise alone shows as much as the best of everything that was tried.
"""

from collections import Counter

import numpy as np
from causes import is_adopted
from common import of_share, options, run_jobs, take_share, write_study
from made_worlds import FALL, NBODY, SPRING, make_apart, world

from bsp_gp.loop.close import close_loop

ALPHA = 0.01
ALPHAS = (0.01, 0.05, 0.1, 0.2)
MEMORY = {"white": 0.0, "memory 0.5": 0.5, "memory 0.8": 0.8}
"""Correlation of one frame's error with the next one's."""
WORLDS = {"fall": FALL, "spring": SPRING, "nbody": {**NBODY, "n_frames": 20, "dt": 0.3}}
"""Preset and what is changed in it: at most 300 rows a set."""
N_SETS = 500
QUICK_SETS = 6


def data_set(declared, noise_kind, n_scenes, seed):
    """A data set of its declared model and nothing else."""
    settings = world(
        declared, WORLDS[declared], n_scenes=n_scenes, memory=MEMORY[noise_kind], is_declared=False
    )
    entropy = (list(WORLDS).index(declared), list(MEMORY).index(noise_kind), n_scenes, seed)
    return *make_apart(settings, entropy), entropy


def work(declared, noise_kind, n_scenes, seed):
    """One data set: a row."""
    dataset, truth, entropy = data_set(declared, noise_kind, n_scenes, seed)
    loop_rng = np.random.default_rng(entropy).spawn(1)[0]
    report = close_loop(dataset, truth.declared, rng=loop_rng, alpha=ALPHA)
    first = report.rounds[0]
    # Beside noise of another kind, what is left is asked for in the round after.
    asked = next((r for r in report.rounds if not is_noise(r)), report.rounds[-1])
    return [{
        "declared": declared, "noise_kind": noise_kind, "n_scenes": n_scenes, "seed": seed,
        "n_rows": sum(len(s.times) * len(s.dynamic) for s in dataset.scenes),
        "p_value": asked.missing.p_value, "p_first": first.missing.p_value,
        "p_effect": first.effect.p_value if first.effect else "",
        "memory": report.noise["correlated"], "adopted": any(map(is_adopted, report.rounds)),
        "verdict": report.verdict, "law": report.law_text if any(map(is_adopted, report.rounds))
        else "", "code": first.effect.code if first.effect else "", "reason": first.reason,
        "findings": " ".join(finding["code"] for finding in first.noise_findings),
    }]  # fmt: skip


def is_noise(done):
    """Whether a round has found noise of another kind, and nothing else."""
    return done.effect is not None and done.effect.code == "noise" and done.adopted


def jobs_of(quick, seed, share=1.0):
    """The jobs, every kind of set in turn."""
    jobs, n = [], QUICK_SETS if quick else of_share(N_SETS, share)
    for k in range(n):
        declared = list(WORLDS)[k % 3]
        noise_kind = list(MEMORY)[k // 3 % 3]
        jobs.append((declared, noise_kind, 1 + k // 9 % 5, seed + k // 45))
    return jobs


def summary(table):
    """How often something was adopted, and the shares of small p-values."""
    n, adopted = len(table), int(table["adopted"].sum())
    lines = [
        "# Data that lack nothing\n",
        f"{n} sets, level {ALPHA:g}: adopted in {adopted} "
        f"(allowed {n * ALPHA + 2 * np.sqrt(n * ALPHA * (1 - ALPHA)):.1f}: "
        "two standard errors above the level).\n",
        "| sets | number | adopted | " + " | ".join(f"p <= {a:g}" for a in ALPHAS) + " |",
        "|---" * (3 + len(ALPHAS)) + "|",
    ]
    parts = [("all", table)]
    parts += [(f"{a}, {b}", t) for (a, b), t in table.groupby(["declared", "noise_kind"])]
    for name, part in parts:
        shares = [f"{(part['p_value'] <= a).mean():.3f}" for a in ALPHAS]
        cells = [name, str(len(part)), str(int(part["adopted"].sum())), *shares]
        lines.append("| " + " | ".join(cells) + " |")
    bounds = [f"{a + 2 * np.sqrt(a * (1 - a) / n):.3f}" for a in ALPHAS]
    lines.append("| allowed | | | " + " | ".join(bounds) + " |")
    white = table[table["noise_kind"] == "white"]
    found = Counter(code for codes in white["findings"].dropna() for code in codes.split())
    told = ", ".join(f"{code} in {n}" for code, n in found.items()) or "nothing"
    lines.append(
        f"\nFound in the noise of {len(white)} sets where it is white, each at {ALPHA:g}: {told}."
    )
    return "\n".join(lines) + "\n"


def figure(table):
    """Share of p-values up to a level against the level."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(4.6, 4.4), layout="constrained")
    levels = np.linspace(0, 1, 101)
    n = len(table) / table["noise_kind"].nunique()
    error = 2 * np.sqrt(levels * (1 - levels) / n)
    ax.fill_between(levels, levels - error, levels + error, color="#cccccc", lw=0,
                    label="uniform, 2 standard errors")  # fmt: skip
    colours = dict(zip(MEMORY, ("#0072b2", "#e69f00", "#d55e00"), strict=True))
    for kind, part in table.groupby("noise_kind", sort=False):
        p = np.sort(part["p_value"])
        ax.step(p, np.arange(1, len(p) + 1) / len(p), where="post", color=colours[kind], label=kind)
    ax.set(xlabel="level", ylabel="share of p-values up to it", xlim=(0, 1), ylim=(0, 1))
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, fontsize=8)
    return fig


def main():
    args = options(__doc__.splitlines()[0], declare=take_share)
    table = run_jobs(jobs_of(args.quick, args.seed, args.share), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "null_data")


if __name__ == "__main__":
    main()
