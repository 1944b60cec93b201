"""Data that lack nothing: how often an effect is adopted all the same, and whether p is uniform.

Worlds of pymunk under three declared models (thrown balls, a spring, two light bodies around a
heavy one), with white noise and with noise that has a memory. The loop is closed on each; its tests
of the residual are asked by themselves, as if noise were white; and, without these, the search and
its bootstrap are run for a p-value of every set.
"""

import numpy as np
from common import options, run_jobs, write_study
from made_worlds import FALL, NBODY, SPRING, make_apart, world

from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.bootstrap import bootstrap, strength
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.memory import search_with_memory
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.residual import examine_residual

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


def work(declared, noise_kind, n_scenes, seed, n_bootstrap):
    """One data set: a row."""
    dataset, truth, entropy = data_set(declared, noise_kind, n_scenes, seed)
    loop_rng, observe_rng, search_rng, bootstrap_rng = np.random.default_rng(entropy).spawn(4)
    law = declared_law(dataset, truth.declared)
    pairs = any(term.kind == "pair" for term in law.terms)
    observation = observe(dataset, law, observe_rng, sources=pairs)
    search = EffectSearch(observation, load_grammar("physics"), n_null=0)
    fit = observation.fit(law)
    _, _, proposals = search_with_memory(search, fit, search_rng)
    test = bootstrap(
        search, fit, strength(proposals), bootstrap_rng, alpha=ALPHA, n_max=n_bootstrap
    )
    return [{
        "declared": declared, "noise_kind": noise_kind, "n_scenes": n_scenes, "seed": seed,
        "n_rows": sum(len(s.times) * len(s.dynamic) for s in dataset.scenes),
        "p_value": test.p_value, "n_simulated": test.n_done, "is_tail": test.is_extrapolated,
        **closed(dataset, truth, loop_rng), **residual_tests(observation, fit),
    }]  # fmt: skip


def closed(dataset, truth, rng):
    """What the loop says."""
    report = close_loop(dataset, truth.declared, rng=rng, alpha=ALPHA)
    first = report.rounds[0]
    return {
        "p_effect": first.effect.p_value if first.effect else "", "memory": first.noise_memory,
        "adopted": any(r.adopted for r in report.rounds), "verdict": report.verdict,
        "law": report.law_text if first.adopted else "",
    }  # fmt: skip


def residual_tests(observation, fit):
    """p-values of the tests of the residual under white noise, and of all together."""
    missing = examine_residual(observation, fit, ALPHA)
    kinds = {"smooth part": "smooth", "common effects": "common", "a period": "period"}
    found = {}
    for name, p in missing.tests.items():
        kind = next((short for words, short in kinds.items() if name.startswith(words)), name)
        found.setdefault(f"p_{kind}", []).append(p)
    return {
        **{kind: min(1.0, len(p) * min(p)) for kind, p in found.items()},
        "p_residual": missing.p_value,
    }


def jobs_of(quick, seed):
    """The jobs, every kind of set in turn."""
    jobs, n = [], QUICK_SETS if quick else N_SETS
    for k in range(n):
        declared = list(WORLDS)[k % 3]
        noise_kind = list(MEMORY)[k // 3 % 3]
        jobs.append((declared, noise_kind, 1 + k // 9 % 5, seed + k // 45, 99))
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
    lines += [
        f"\nTests of the residual, {len(white)} sets with white noise, each kind by itself:\n",
        "| test | " + " | ".join(f"p <= {a:g}" for a in ALPHAS) + " |",
        "|---" * (1 + len(ALPHAS)) + "|",
    ]
    for column in ("p_size", "p_autocorrelation", "p_smooth", "p_common", "p_period", "p_residual"):
        p = white[column].dropna()
        shares = " | ".join(f"{(p <= a).mean():.3f}" for a in ALPHAS)
        lines.append(f"| {column[2:]} | {shares} |")
    bounds = [f"{a + 2 * np.sqrt(a * (1 - a) / max(len(white), 1)):.3f}" for a in ALPHAS]
    lines.append("| allowed | " + " | ".join(bounds) + " |")
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
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "null_data")


if __name__ == "__main__":
    main()
