"""Are fits right? Made worlds whose truth is known, fitted by nothing but their data and their law.

Tracks are made without the package's engine (`fit_tracks.py`), and the Cramér-Rao bound that a
fit's standard errors are held against is computed from them, not from the fit. Studies:
oscillators, orbits, pushes, exponent, pendulum_noise, laws20 (scipy's fit beside ours) and sbc
(ranks of the truth in the fitted posterior); `--study all` runs them one after the other.
"""

import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from common import options, run_jobs, write_text
from fit_judging import (
    calibrated,
    judge_agreement,
    judge_bound,
    judge_noise,
    judge_within,
)
from fit_laws import CASES, case
from fit_orbits import orbits
from fit_summary import summary
from fit_worlds import exponent, oscillator, pendulum_noise, push

CALIBRATED = (
    "quadratic drag", "damped spring", "central gravity", "pendulum", "periodic push", "screened",
)  # fmt: skip
"""Worlds of the study of ranks."""
PRIOR_WIDTH = 0.15
"""Standard deviation of the logarithm of their constants."""
QUICK_SETS = 8


@dataclass(frozen=True)
class Study:
    """One study: how many sets, of which world, judged how, and what share must pass."""

    n_sets: int
    make: object
    judge: object
    share: float
    asked: str


def _law(rng, index):
    return case(list(CASES)[index % len(CASES)], rng)


def _from_prior(rng, index):
    """A world whose constants are drawn from a prior; the states are drawn by its maker."""
    name = CALIBRATED[index % len(CALIBRATED)]
    world = case(name, rng).world
    factors = np.exp(PRIOR_WIDTH * rng.standard_normal(len(world.truth)))
    truth = {n: float(v * f) for (n, v), f in zip(world.truth.items(), factors, strict=True)}
    return replace(world, kind=name, truth=truth)


def _plain(make):
    return lambda rng, index: make(rng)


STUDIES = {
    "oscillators": Study(
        500, _plain(oscillator), judge_bound, 0.98,
        "joint chi2 below its 99.9 % quantile and standard errors <= 1.2 of the bound in >= 98 %, "
        "no wrong minimum called converged",
    ),
    "orbits": Study(
        300, _plain(orbits), judge_bound, 0.98,
        "joint chi2 below its 99.9 % quantile and standard errors <= 1.2 of the bound in >= 98 %, "
        "no wrong minimum called converged",
    ),
    "pushes": Study(
        200, _plain(push), judge_within("w", 4.0), 1.0, "w within 4 standard errors in all"
    ),
    "exponent": Study(
        100, _plain(exponent), judge_within("n", 3.0), 0.95, "n within 3 sd in >= 95 %"
    ),
    "pendulum_noise": Study(
        50, _plain(pendulum_noise), judge_noise, 1.0,
        "level within 10 % with and without damping, and damping wins, in all",
    ),
    "laws20": Study(
        20, _law, judge_agreement, 1.0,
        "values within 1e-3 standard errors of scipy's, standard errors within 1 %, in all",
    ),
    "sbc": Study(
        200 * len(CALIBRATED), _from_prior, calibrated, 0.98, "ranks uniform in every world",
    ),
}  # fmt: skip


def generators(study, index, seed):
    """Generators of a set's world, and of its noise and its fit."""
    return np.random.default_rng([list(STUDIES).index(study), index, seed]).spawn(2)


def data_world(study, index, seed):
    """The world of one set."""
    return STUDIES[study].make(generators(study, index, seed)[0], index)


def work(study, index, seed, deadline=None):
    """One set: a row."""
    rng = generators(study, index, seed)[1]
    world = data_world(study, index, seed)
    row = {"set": index, "study": study, "seed": seed, **STUDIES[study].judge(world, rng, deadline)}
    if study == "laws20":
        row["kind"] = list(CASES)[index % len(CASES)]
    return [row]


def _declare(parser):
    parser.add_argument("--study", choices=[*STUDIES, "all"], default="all")
    parser.add_argument("--sets", type=int, default=None, help="number of data sets of a study")
    parser.add_argument("--resume", action="store_true", help="go on with the tables in the folder")
    parser.add_argument("--time-limit", type=float, default=60.0, help="for one fit, s")


def _run(name, args):
    study, folder = STUDIES[name], args.out / name
    if (folder / "results.csv").exists() and not args.resume:
        sys.exit(f"{folder / 'results.csv'} exists; go on with --resume, or give another --out")
    n_sets = args.sets or (min(QUICK_SETS, study.n_sets) if args.quick else study.n_sets)
    jobs = [(name, index, args.seed) for index in range(n_sets)]
    table = run_jobs(jobs, partial(work, deadline=args.time_limit), folder, args.workers)
    text = summary(name, study, table)
    write_text(text, folder / "summary.md")
    print(text, flush=True)


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv, _declare)
    if args.out == Path("runs") / Path(sys.argv[0]).stem:
        args.out = Path("runs") / "fit_studies"
    for name in STUDIES if args.study == "all" else (args.study,):
        _run(name, args)


if __name__ == "__main__":
    main()
