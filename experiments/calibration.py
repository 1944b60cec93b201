"""Are the posteriors calibrated? 500 data sets a scenario, drawn from the prior predictive.

For every data set the unknown properties are drawn from their priors, a scene of the paper's kind
is simulated under the true law with these values and noise of known sigma, and the posterior is
sampled with emcee under the true law. The rank of the true value among the draws must be uniform
(Talts et al. 2018): the empirical distribution of ranks, pooled over exchangeable properties, must
lie in its 99 % simultaneous band, and intervals must cover as often as they say.

The noise enters the motion at every step (the generative model of the one-step likelihood), or the
measurement (the propagated likelihood; beside it GLS alone, which forgets that laws are evaluated
at noisy states).
"""

import time
from dataclasses import replace

import numpy as np
from common import options, run_jobs, write_study
from ranks import coverage, rank_of, simultaneous_band
from synth import SCENARIOS, dataset_of, likelihood_of, scenes_of, true_law, unknowns

from bsp_gp.inference.e_step import EStep, infer
from bsp_gp.physics.bodies import stack

LEVELS = (0.5, 0.9)
CHUNK = 20
"""Data sets of a job."""
PLAN = (
    ("motion", "importance", 500), ("measurement", "importance", 500), ("motion", "emcee", 200),
    ("measurement, GLS alone", "importance", 100),
)  # fmt: skip
"""Where the noise is, how posteriors are sampled, and of how many data sets a scenario."""
GROUPS = ["noise", "method", "scenario"]
E_STEPS = {"importance": EStep("laplace", n_eff=300), "emcee": EStep("emcee", n_eff=300)}


def simulated(name, scene, sigma, kind, rng):
    """The scene moved anew under the true law, in Euler steps from its first two rows.

    "motion": the noise is part of every step; "measurement": it is added at the end.
    """
    law = true_law(name)
    (batch,) = stack([scene])
    receivers = batch.bodies.receivers
    p = np.array(batch.positions)
    v = np.zeros_like(p[0])
    steps = np.diff(batch.times[:, 0])
    noise = sigma * rng.standard_normal(p[:, :, receivers].shape)
    for t in range(1, len(p) - 1):
        v[:, receivers] = (p[t] - p[t - 1])[:, receivers] / steps[t - 1]
        a = law.acceleration(batch.bodies, p[t], v, batch.times[t])
        p[t + 1][:, receivers] = p[t][:, receivers] + steps[t] * (v[:, receivers] + steps[t] * a)
        if kind == "motion":
            p[t + 1][:, receivers] += noise[t + 1]
    if kind != "motion":
        p[:, :, receivers] += noise
    return replace(scene, positions=p[:, 0])


def work(name, kind, method, first, seed):
    """Some data sets: a row for every latent of each."""
    return [row for k in range(first, first + CHUNK) for row in ranked(name, kind, method, k, seed)]


def ranked(name, kind, method, index, seed):
    """One data set: a row for every latent."""
    rng = np.random.default_rng([11, list(SCENARIOS).index(name), index, seed])
    scene = scenes_of(name, [1 + index % 100])[0]
    latents = unknowns(name, [scene])
    truth = latents.sample(1, rng=rng)[0]
    sigma = SCENARIOS[name].level
    made = simulated(name, latents.filled([scene], truth)[0], sigma, kind, rng)
    likelihood = likelihood_of(name, 0.0 if kind == "motion" else sigma)
    if kind == "measurement":
        likelihood = likelihood.for_posterior
    started = time.perf_counter()
    posterior = infer(
        true_law(name), [made], latents, likelihood, rng=rng, settings=E_STEPS[method]
    )
    seconds = time.perf_counter() - started
    intervals = [posterior.interval(level).T for level in LEVELS]
    inside = [(low <= truth) & (truth <= high) for low, high in intervals]
    return [
        {
            "scenario": name, "noise": kind, "method": method, "index": index, "seed": seed,
            "latent": latent,
            "truth": truth[k],
            "rank": rank_of(truth[k], posterior.draws[:, k], posterior.weights, rng=rng),
            "inside_50": bool(inside[0][k]), "inside_90": bool(inside[1][k]),
            "mean": posterior.mean[k], "sd": posterior.sd[k], "n_eff": posterior.n_eff[k],
            "r_hat": posterior.r_hat[k], "converged": posterior.converged, "seconds": seconds,
        }
        for k, latent in enumerate(latents.names)
    ]  # fmt: skip


def main():
    args = options(__doc__.splitlines()[0])
    jobs = [
        (name, kind, method, first, args.seed)
        for kind, method, n in PLAN
        for name in ("mat", "nbody", "bounce")
        for first in range(0, CHUNK if args.quick else n, CHUNK)
    ]
    table = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "calibration")


def summary(table):
    """Ranks and coverage of every kind of run, as Markdown."""
    lines = ["# Calibration", "",
             "Ranks of the true values among posterior draws, pooled over exchangeable latents of "
             "a data set; the band holds an empirical distribution of that many independent "
             "uniform numbers with 99 %. Coverage with its distance from nominal in standard "
             "errors (latents of one data set counted as dependent).", "",
             "| scenario | noise in | E-step | data sets | latents | largest deviation | band 99 % "
             "| inside | cover 50 % | cover 90 % | not converged | s a data set |",
             "|" + "---|" * 12]  # fmt: skip
    for (kind, method, name), part in table.groupby(GROUPS, sort=False):
        ranks = part["rank"].to_numpy()
        band = simultaneous_band(len(ranks), 0.99)
        ordered = np.sort(ranks)
        n = len(ordered)
        worst = max((np.arange(1, n + 1) / n - ordered).max(), (ordered - np.arange(n) / n).max())
        covers = []
        for level in LEVELS:
            share, error = coverage(part[f"inside_{level * 100:.0f}"], part["index"])
            covers.append(f"{100 * share:.1f} % ({(share - level) / error:+.1f} se)")
        lines.append(
            f"| {name} | {kind} | {method} | {part['index'].nunique()} | {n} | {worst:.4f} "
            f"| {band:.4f} | {'yes' if worst <= band else 'NO'} | {covers[0]} | {covers[1]} | "
            f"{int((~part.converged.astype(bool)).sum())} | "
            f"{part.seconds.median():.2f} |"
        )
    return "\n".join(lines) + "\n"


def figure(table):
    """Distance of the distribution of ranks from a uniform one, and its band."""
    import matplotlib.pyplot as plt

    groups = list(table.groupby(GROUPS, sort=False))
    kinds = list(dict.fromkeys(key[:2] for key, _ in groups))
    fig, axes = plt.subplots(
        len(kinds), 3, figsize=(10, 3.2 * len(kinds)), sharex=True, squeeze=False,
        constrained_layout=True,
    )  # fmt: skip
    for ax in axes.ravel():
        ax.axis("off")
    columns = {"mat": 0, "nbody": 1, "bounce": 2}
    for (kind, method, name), part in groups:
        ax = axes[kinds.index((kind, method)), columns[name]]
        ax.axis("on")
        ranks = np.sort(part["rank"].to_numpy())
        n = len(ranks)
        band = simultaneous_band(n, 0.99)
        ax.axhspan(-band, band, color="0.88", label="99 % band")
        ax.step(ranks, np.arange(1, n + 1) / n - ranks, where="post", lw=1.2)
        ax.axhline(0, color="k", lw=0.6)
        ax.set_title(f"{name.upper()}, {n} latents\nnoise in the {kind}; {method}", fontsize=9)
        ax.set_ylim(-2 * band, 2 * band)
    for ax in axes[-1]:
        ax.set_xlabel("rank of the true value")
    for ax in axes[:, 0]:
        ax.set_ylabel("empirical - uniform")
    axes[0, 0].legend(fontsize=8, loc="upper right")
    return fig


if __name__ == "__main__":
    dataset_of("mat")  # fails early without data
    main()
