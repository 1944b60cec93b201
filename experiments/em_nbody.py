"""Fig. 6: EM on NBODY, three scenes, the heavy mass known, light masses U(0.02, 9).

Twenty random draws of three training scenes without contact. A table of every draw, and the
posterior of a mass with the law at every iteration of the first one.
"""

import time

import numpy as np
from common import options, run_jobs, write_study
from synth import TOUCHING, TRAIN, grammar_of, is_true, likelihood_of, scenes_of, unknowns

from bsp_gp.inference.e_step import EStep
from bsp_gp.inference.em import EmSettings, fit_em

POOL = [n for n in TRAIN if n not in TOUCHING]


def run(draw, seed):
    """One draw of scenes: its row of the table, and the result of EM."""
    chosen = np.random.default_rng([6, draw]).choice(POOL, 3, replace=False)
    scenes = scenes_of("nbody", chosen)
    latents = unknowns("nbody", scenes)
    settings = EmSettings(final=EStep(n_eff=500))
    started, cpu = time.perf_counter(), time.process_time()
    em = fit_em(
        scenes, latents, grammar_of("nbody"), likelihood_of("nbody"),
        rng=np.random.default_rng([66, draw, seed]), settings=settings,
    )  # fmt: skip
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu
    inside = [
        bool(low <= item.truth <= high)
        for item, (low, high) in zip(latents.items, em.posterior.interval(), strict=True)
    ]
    return {
        "draw": draw, "seed": seed, "scenes": " ".join(map(str, chosen)),
        "recovered": is_true("nbody", em.best.formula), "law": em.law.text(),
        "loss": em.best.loss, "n_class": len(em.equivalents()), "n_iterations": len(em.trace) - 1,
        "largest_mass_error": float(np.abs(em.best.profile.values - latents.truth).max()),
        "covered_90": float(np.mean(inside)), "n_scored": em.n_scored,
        "seconds": seconds, "cpu_s": cpu,
    }, em  # fmt: skip


def work(draw, seed):
    """The row of one draw."""
    return [run(draw, seed)[0]]


def main():
    args = options(__doc__.splitlines()[0])
    jobs = [(draw, args.seed) for draw in range(2 if args.quick else 20)]
    table = run_jobs(jobs, work, args.out, args.workers)
    lines = [
        "# EM on NBODY with unknown light masses (Fig. 6)", "",
        f"- true form recovered in {int(table.recovered.sum())} of {len(table)} draws of three "
        "scenes without contact (paper: 8 of 10)",
        f"- seconds of CPU a draw: median {table.cpu_s.median():.1f}, most {table.cpu_s.max():.1f}",
        f"- largest error of a mass at the joint optimum: {table.largest_mass_error.max():.2g} kg",
        f"- 90 % intervals hold the true mass in {100 * table.covered_90.mean():.0f} % (data "
        "without noise, likelihood with sigma = 0.01)",
    ]  # fmt: skip
    write_study("\n".join(lines) + "\n", figure(run(0, args.seed)[1]), args.out, "fig6")


def figure(em):
    """Posterior of a mass at every iteration, with the law."""
    import matplotlib.pyplot as plt

    steps = [step for step in em.trace if step.start == 0]
    fig, axes = plt.subplots(
        1, len(steps), figsize=(3.4 * len(steps), 3.2), constrained_layout=True
    )
    name = em.posterior.names[0]
    for ax, step in zip(np.atleast_1d(axes), steps, strict=True):
        k = step.posterior.names.index(name)
        ax.hist(
            step.posterior.draws[:, k], bins=30, density=True,
            weights=step.posterior.weights, color="C0", alpha=0.8,
        )  # fmt: skip
        ax.axvline(step.posterior.truth[k], color="k", lw=1, label="true")
        law = step.law.latex() if step.law.terms else r"\mathbf{F}_i = \mathbf{0}"
        title = f"iteration {step.iteration}" if step.iteration else "zero force: the prior"
        ax.set_title(f"{title}\n${law}$" if len(law) < 150 else title, fontsize=8, pad=16)
        ax.set_xlabel(f"{name}, kg")
    np.atleast_1d(axes)[0].set_ylabel("posterior density")
    np.atleast_1d(axes)[0].legend(fontsize=8, loc="lower left", framealpha=1)
    return fig


if __name__ == "__main__":
    main()
