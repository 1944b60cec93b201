"""Table 1: laws learnt from five scenes with unknown properties, tested on scenes 81-100.

Five random training scenes of 1-80, five choices of them x five seeds, noise-free; ten choices
with noise in training and test; and the ablation "EM alone". The unknown properties of the test
scenes are inferred with the learned law, by one step with sigma = the protocol's noise level and
by its literal five steps; errors are averaged over posterior draws.
"""

import time

import numpy as np
from common import options, run_jobs, write_study
from synth import (
    SCENARIOS,
    TEST,
    TOUCHING,
    TRAIN,
    dataset_of,
    five_step,
    grammar_of,
    is_true,
    likelihood_of,
    scenes_of,
    true_law,
    unknowns,
    with_noise,
)

from bsp_gp.errors import BspError
from bsp_gp.inference.e_step import EStep, infer
from bsp_gp.inference.em import CLASS_NATS, EmSettings, fit_em
from bsp_gp.inference.prediction import posterior_nrmse
from bsp_gp.inference.profile import fit_profile

NOISE = {"nbody": 0.01, "bounce": 0.01, "mat": 0.001}
PAPER = {"nbody": (8.05e-1, 1.77), "bounce": (3.16e-2, 5.98e-2), "mat": (5.39e-4, 1.20e-3)}
TEST_STEP = EStep("laplace", n_draws=4000, n_eff=300, max_steps=2000)
FIVE_STEP = EStep("laplace", n_draws=400, n_eff=100, max_steps=250)
N_DRAWS = 100
KIND = ["scenario", "method", "n_train", "noise"]


def jobs_of(quick, seed):
    """Every run: noise-free, with noise, EM alone, more scenes."""
    names = ("mat", "nbody", "bounce")
    if quick:
        out = [(name, "em", 5, 0.0, 0, seed) for name in names]
        return [*out, ("mat", "em", 5, NOISE["mat"], 0, seed), ("mat", "em_alone", 5, 0.0, 0, seed)]
    alone = {"mat": 10, "nbody": 10, "bounce": 5}
    out = []
    for name in names:
        out += [(name, "em", 5, NOISE[name], a, seed) for a in range(10)]
        if name == "mat":
            out += [(name, "em", 10, 0.0, a, seed) for a in range(10)]
        out += [(name, "em", 5, 0.0, a, seed + b) for b in range(5) for a in range(5)]
    for name in names:  # the ablation last
        out += [(name, "em_alone", 5, 0.0, a, seed) for a in range(alone[name])]
    return out


def work(name, method, n_train, noise, shuffle, seed):
    """One run: a row."""
    chosen = np.random.default_rng([7, shuffle]).permutation(np.array(TRAIN))[:n_train]
    noise_rng = np.random.default_rng([8, shuffle])
    rng = np.random.default_rng([9, shuffle, seed])
    train = with_noise(scenes_of(name, chosen), noise, noise_rng)
    test = with_noise(scenes_of(name, TEST), noise, noise_rng)
    likelihood = likelihood_of(name, noise)
    alone = method == "em_alone"
    settings = EmSettings(
        use_beam=not alone, n_starts=1 if alone else 3, refine=False, final=None,
        n_draws=1 if name == "bounce" and not alone else 3,  # its M-step is the dearest
        max_iterations=3,
    )  # fmt: skip
    latents = unknowns(name, train)
    em_rng, true_rng, test_rng = rng.spawn(3)
    started = time.perf_counter()
    em = fit_em(train, latents, grammar_of(name), likelihood, rng=em_rng, settings=settings)
    seconds = time.perf_counter() - started
    misfit = likelihood.misfit(true_law(name), latents, train)
    truth = fit_profile(misfit, latents.sample(12, rng=true_rng))
    members = em.equivalents() if not alone else (em.best,)
    return [{
        "scenario": name, "method": method, "n_train": n_train, "noise": noise, "shuffle": shuffle,
        "seed": seed,
        "recovered": is_true(name, em.best.formula),
        "true_gap": truth.loss - em.best.loss,
        "true_listed": any(is_true(name, f) for c in members for f in (c.formula, *c.ties)),
        "n_class": len(members),
        "law": em.law.text(),
        "scenes": " ".join(map(str, chosen)),
        "touching": int(name == "nbody" and bool(TOUCHING & set(chosen.tolist()))),
        "loss": em.best.loss,
        **scores(name, em.law, test, noise, test_rng),
        "seconds": seconds,
        "n_scored": em.n_scored,
        "class": " | ".join(c.text for c in members),
    }]  # fmt: skip


def scores(name, law, test, noise, rng):
    """Test errors of a learned law, with latents inferred under it."""
    latents = unknowns(name, test)
    one_rng, five_rng, *draw_rngs = rng.spawn(4)
    free = [k for k, n in enumerate(TEST) if name != "nbody" or n not in TOUCHING]
    clean = scenes_of(name, TEST)
    out = {}
    likelihoods = [("", likelihood_of(name, noise).for_posterior, TEST_STEP, one_rng, draw_rngs[0])]
    if not noise:
        likelihoods.append(("_5step", five_step(name), FIVE_STEP, five_rng, draw_rngs[1]))
    for label, likelihood, step, step_rng, draw_rng in likelihoods:
        try:
            posterior = infer(law, test, latents, likelihood, rng=step_rng, settings=step)
        except BspError as error:
            print(f"    {name}{label}: {error}")
            continue
        draws = posterior.draw(N_DRAWS, rng=draw_rng)
        errors = posterior_nrmse(law, test, latents, draws)
        mean = posterior_nrmse(law, test, latents, posterior.mean[None])
        out |= {
            f"nrmse_test{label}": errors.mean(),
            f"nrmse_free{label}": errors[free].mean(),
            f"nrmse_at_mean{label}": mean.mean(),
        }
        if noise:
            out["nrmse_vs_clean"] = posterior_nrmse(
                law, test, latents, draws, reference=clean
            ).mean()
    true = posterior_nrmse(true_law(name), test, latents, latents.truth[None])
    out["nrmse_true"] = true.mean()
    return out


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "table1")


def quartiles(values):
    low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75])
    return f"{middle:.3g} ({low:.2g} to {high:.2g})"


def summary(table):
    """Rates and errors of every kind of run, as Markdown."""
    lines = ["# EM with unknown properties on SYNTH (Table 1)", "",
             "E-step: one step, independent errors, sigma = the protocol's noise level; beside it "
             "the protocol's five steps. Noisy data: the covariance of position noise in second "
             "differences. nRMSE: mean over posterior draws; median (quartiles).", ""]  # fmt: skip
    head = ("scenario", "method", "train", "noise", "runs", "form", f"within {CLASS_NATS:g} nats",
            "listed", "nRMSE", "contact-free", "five-step", "at posterior mean", "true law",
            "vs clean", "paper", "zero force", "s")  # fmt: skip
    lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for (name, method, n_train, noise), part in table.groupby(KIND, sort=False):

        def stat(column, part=part):
            known = part[column].notna().any() if column in part else False
            return quartiles(part[column]) if known else ""

        paper, zero = PAPER[name]
        lines.append("| " + " | ".join([
            name, method, str(n_train), f"{noise:g}", str(len(part)),
            f"{int(part.recovered.sum())}/{len(part)}",
            f"{int((part.true_gap <= CLASS_NATS).sum())}/{len(part)}" if method == "em" else "",
            f"{int(part.true_listed.sum())}/{len(part)}",
            stat("nrmse_test"), stat("nrmse_free"), stat("nrmse_test_5step"),
            stat("nrmse_at_mean"), stat("nrmse_true"), stat("nrmse_vs_clean"),
            f"{paper:.3g}" if not noise else "", f"{zero:.3g}" if not noise else "",
            f"{part.seconds.median():.0f}",
        ]) + " |")  # fmt: skip
    mats = table[(table.scenario == "mat") & (table.method == "em")]
    if len(mats):
        lines += ["", "## The class of MAT", "",
                  "Laws within 3 nats of the best, by how many runs list them:", ""]  # fmt: skip
        names = mats["class"].str.split(" | ", regex=False).explode()
        lines += [f"- {count}: `{law}`" for law, count in names.value_counts().head(20).items()]
    return "\n".join(lines) + "\n"


def figure(table):
    """Test error of every run beside the paper's."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(1, 3, figsize=(10, 3.6), constrained_layout=True)
    rng = np.random.default_rng(0)
    for ax, name in zip(axes, SCENARIOS, strict=True):
        mine = table[table.scenario == name]
        groups = [
            ("EM + beam", mine[(mine.method == "em") & (mine.noise == 0) & (mine.n_train == 5)]),
            ("EM alone", mine[(mine.method == "em_alone") & (mine.noise == 0)]),
            (f"noise {NOISE[name]:g} m", mine[(mine.method == "em") & (mine.noise > 0)]),
        ]
        for x, (_, part) in enumerate(groups):
            if len(part):
                jitter = x + rng.uniform(-0.15, 0.15, len(part))
                ax.plot(jitter, part.nrmse_test, "o", color=f"C{x}", ms=4, alpha=0.6, mec="none")
                ax.hlines(
                    part.nrmse_test.median(), x - 0.3, x + 0.3, color="k", lw=1.5, label="median"
                )
        noisy = groups[2][1]
        if len(noisy):
            ax.hlines(
                noisy.nrmse_true.median(), 1.6, 2.4, color="C3", ls=":", lw=2, label="true law"
            )
        paper, zero = PAPER[name]
        ax.axhline(zero, color="0.6", lw=1, label="zero force")
        ax.axhline(paper, color="0.6", lw=1, ls="--", label="paper, no noise")
        ax.set_yscale("log")
        ax.set_xticks(range(3), [f"{n}\n{len(p)} runs" for n, p in groups], fontsize=8)
        ax.set_xlim(-0.6, 2.6)
        ax.set_title(name.upper())
    axes[0].set_ylabel("test nRMSE")
    named = {}
    for ax in axes:
        named |= dict(zip(*ax.get_legend_handles_labels()[::-1], strict=True))
    fig.legend(
        named.values(), named.keys(), loc="outside lower center", ncols=4, fontsize=8, frameon=False
    )
    return fig


if __name__ == "__main__":
    dataset_of("nbody")  # fails early without data
    main()
