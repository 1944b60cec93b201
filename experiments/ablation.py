"""What units and translation invariance are worth (the paper's Figure 5).

The curves of data_efficiency.py by cross-entropy search with the grammar of Newtonian physics,
and without translation invariance, without units, without either; the same budget for all.
"""

from common import options, reference_data, run_jobs, write_study
from data_efficiency import (
    TEST,
    figure,
    learned,
    objective_of,
    points,
    scored,
    summary,
    training_scenes,
)
from scenes import scenario

from bsp_gp.search.compare import STRATEGIES
from bsp_gp.search.run import Budget

GRAMMARS = {
    "both": "newtonian",
    "units only": "newtonian_no_translation",
    "translation only": "newtonian_no_units",
    "neither": "newtonian_free",
}
COLOURS = {"both": "#0072b2", "units only": "#009e73", "translation only": "#e69f00",
           "neither": "#d55e00"}  # fmt: skip
BUDGET = Budget(n_scored=20_000)


def work(name, n_scenes, shuffle, prior, seed):
    """One point of a curve: a row."""
    objective, _ = objective_of(name, training_scenes(name, n_scenes, shuffle), GRAMMARS[prior])
    entropy = (n_scenes, shuffle, seed, list(GRAMMARS).index(prior))
    outcome = learned(objective, prior, STRATEGIES["cross_entropy"], seed, BUDGET, entropy)
    test = [scenario(name).scene(k) for k in TEST]
    return [scored(name, n_scenes, shuffle, prior, seed, outcome, test)]


def main():
    args = options(__doc__.splitlines()[0])
    reference_data("synth")
    jobs = [(*point, prior, args.seed + point[-1] - 1) for point in points(args.quick)
            for prior in GRAMMARS]  # fmt: skip
    table = run_jobs(jobs, work, args.out, args.workers).rename(columns={"method": "prior"})
    text = summary(table, "Priors of the grammar", "prior")
    write_study(text, figure(table, "prior", COLOURS), args.out, "ablation")


if __name__ == "__main__":
    main()
