"""Speed of log-probabilities of one SYNTH scene on one core, evaluations a second.

Processor time; a batch is the 64 walkers of an ensemble. "product" is the path of laws that are a
product of properties and motion, "general" that of any other law, "five-step" the protocol's,
"track" whole tracks (a product, in the paper's steps), "track, general" those of any other law.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, write_study, write_table
from synth import SCENARIOS, five_step, likelihood_of, scenes_of, true_law, unknowns

from bsp_gp.inference.misfit import DirectMisfit

N_WALKERS = 64


def rate(misfit, values, seconds):
    """Evaluations a second, the best of three runs."""
    misfit.log_likelihood(values)
    best = 0.0
    for _ in range(3):
        count, began = 0, time.process_time()
        while time.process_time() - began < seconds:
            misfit.log_likelihood(values)
            count += len(values)
        best = max(best, count / (time.process_time() - began))
    return best


def run(name, seed, seconds):
    """Rates of every path on the first scene of a scenario: rows of the table."""
    scenes, law = scenes_of(name, [1]), true_law(name)
    latents, likelihood = unknowns(name, scenes), likelihood_of(name)
    values = latents.sample(N_WALKERS, rng=np.random.default_rng(seed))
    paths = {
        "product": likelihood.misfit(law, latents, scenes),
        "general": DirectMisfit(law, latents, likelihood.regression(scenes)),
        "five-step": five_step(name).misfit(law, latents, scenes),
    }
    tracks = replace(likelihood, kind="track", velocities="backward").misfit(law, latents, scenes)
    if tracks.reference is not None:
        general = tracks.reference.bank.direct(law, latents)
        paths = {**paths, "track": tracks, "track, general": general}
    return [
        {"scenario": name, "path": path, "seed": seed, "a_second": rate(misfit, values, seconds)}
        for path, misfit in paths.items()
    ]


def main():
    args = options(__doc__.splitlines()[0])
    seconds = 0.3 if args.quick else 2.0
    rows = [row for name in SCENARIOS for row in run(name, args.seed, seconds)]
    write_table(rows, args.out / "results.csv")
    lines = ["# Log-probabilities of one scene, evaluations a second", "",
             "Asked on NBODY: one-step 20,000, five-step 4,000, track 5,000.", "",
             "| scenario | path | a second |", "|---|---|---|"]  # fmt: skip
    lines += [f"| {r['scenario']} | {r['path']} | {r['a_second']:,.0f} |" for r in rows]
    write_study("\n".join(lines) + "\n", None, args.out)


if __name__ == "__main__":
    main()
