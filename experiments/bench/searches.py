"""Speed of the searches on one core: rates, stages, memory, growth, and other tools beside them.

All figures are processor time of one run on one machine, and mean something as ratios within it.
"""

import resource
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, run_jobs, write_study
from scenes import scenario

from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.genetic import Genetic
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget, run_search
from bsp_gp.workers import worker_pool

SECONDS = 2.0
SIGMA = 1e-3
STRATEGIES = {"cross_entropy": CrossEntropy(), "genetic": Genetic(), "random": RandomSearch()}
PROBLEMS = ("nbody 1", "bounce 2", "nbody 10", "nbody 100", "made 1000", "bodies 16")
"""Scenario and number of scenes; "made": NBODY scenes of our own making; "bodies": discs."""


def problem(name):
    """Regression and grammar of a problem."""
    what, number = name.split()
    if what == "made" or what == "bodies":
        from bsp_gp.simulate.synth import make, preset

        numbers = {"n_scenes": int(number)} if what == "made" else {"n_bodies": int(number)}
        dataset, _ = make(preset("nbody", **numbers), np.random.default_rng(0))
        scenes, types = list(dataset.scenes), set(dataset_types(dataset))
    else:
        types = scenario(what).types
        scenes = [scenario(what).scene(str(k)) for k in range(1, int(number) + 1)]
    grammar, _ = load_grammar("newtonian").masked(types, 2)
    return build_regression(scenes, sigma=SIGMA), grammar


def memory():
    """Greatest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Stages:
    """Processor time spent inside of named functions, nested calls not counted twice."""

    def __init__(self):
        self.seconds = defaultdict(float)
        self.undo = []
        self.inside = []

    def watch(self, owner, name, stage):
        plain = getattr(owner, name)

        def timed(*args, **kwargs):
            started = time.process_time()
            self.inside.append(0.0)
            try:
                return plain(*args, **kwargs)
            finally:
                spent = time.process_time() - started
                self.seconds[stage] += spent - self.inside.pop()
                if self.inside:
                    self.inside[-1] += spent

        setattr(owner, name, timed)
        self.undo.append((owner, name, plain))

    def stop(self):
        for owner, name, plain in self.undo:
            setattr(owner, name, plain)


def watched():
    """Stages of the learners."""
    from deap import tools

    from bsp_gp.search.columns import Columns

    stages = Stages()
    stages.watch(Pcfg, "sample_crossed", "trees")
    stages.watch(Pcfg, "sample_many", "trees")
    stages.watch(Objective, "_score_new", "constants and book-keeping")
    stages.watch(Columns, "dots_and_sizes", "constants")
    stages.watch(Objective, "score", "evaluation and recognition")
    stages.watch(tools, "selNSGA2", "selection")
    return stages


def learner(name, search, seconds):
    """Rates of a learner within its first seconds, then its stages in a run of their own."""
    regression, grammar = problem(name)
    objective = Objective(regression, grammar, "pair")
    before = memory()
    spent = run_for(objective, search, seconds)
    row = {
        "rows": objective.rows.n_rows, "laws": objective.n_scored, "seconds": spent,
        "laws_per_s": objective.n_scored / spent, "trees_per_s": objective.n_trees / spent,
        "repeats": objective.n_repeats / objective.n_trees, "memory_mb": memory(),
        "grown_mb": memory() - before,
    }  # fmt: skip
    stages = watched()
    again = objective.fresh()
    spent = run_for(again, search, seconds)
    stages.stop()
    for stage, time_in in stages.seconds.items():
        row[f"us_{stage}"] = 1e6 * time_in / again.n_trees
    row["us_variation and the rest"] = 1e6 * (spent - sum(stages.seconds.values())) / again.n_trees
    return row


def run_for(objective, search, seconds):
    started = time.process_time()
    run_search(
        STRATEGIES[search], objective, Budget(n_steps=10**9), rng=np.random.default_rng(0), keep=0,
        callback=lambda *_: time.process_time() - started > seconds,
    )  # fmt: skip
    return time.process_time() - started


def exhaustive(name):
    """Rate of the exhaustive search: the better of two runs."""
    regression, grammar = problem(name)
    times = []
    for _ in range(2):
        started = time.process_time()
        result = search_exhaustive(regression, grammar, kind="pair")
        times.append(time.process_time() - started)
    rows = Objective(regression, grammar, "pair").rows.n_rows
    n = result.n_evaluated
    return {"rows": rows, "laws": n, "seconds": min(times), "laws_per_s": n / min(times),
            "memory_mb": memory()}  # fmt: skip


# --- the plain way, and peers -----------------------------------------------------------------


def plain(name, seconds):
    """Trees compiled by DEAP, evaluated on arrays, constants by scipy's L-BFGS-B."""
    from deap import gp
    from scipy.optimize import minimize

    regression, grammar = problem(name)
    objective = Objective(regression, grammar, "pair")
    rows = objective.rows
    pset, names = _arrays(grammar)
    values = [rows.inputs_for([n], grammar.inputs)[n] for n in names]
    y = objective.y.reshape(-1, rows.n_dims)
    receiver, scale = objective.columns.receiver, objective.columns._scale
    mass = rows.input("m_i", False)[:, None]
    rng = np.random.default_rng(0)
    sampler = Pcfg.uniform(grammar).sampler(rng)
    started, n = time.process_time(), 0
    with np.errstate(all="ignore"):
        while time.process_time() - started < seconds:
            tree = sampler.draw(objective.start, 10)
            text = _call_text(objective.recogniser.formula(tree))
            law = gp.compile(gp.PrimitiveTree.from_string(text, pset), pset)

            def loss(c, law=law):
                force = law(*values, c[0], c[0], c[0]) / mass * scale
                predicted = np.zeros_like(y)
                np.add.at(predicted, receiver, np.broadcast_to(force, scale.shape))
                value = 0.5 * np.square(y - predicted).sum()
                return value if np.isfinite(value) else 1e300

            minimize(loss, [1.0], method="L-BFGS-B")
            n += 1
    spent = time.process_time() - started
    return {"rows": rows.n_rows, "laws": n, "seconds": spent, "laws_per_s": n / spent,
            "memory_mb": memory()}  # fmt: skip


def _arrays(grammar):
    """Untyped DEAP primitives on NumPy arrays for the operators of a grammar."""
    from deap import gp

    from bsp_gp.language.operators import OPERATORS, Type

    names = [n for n in grammar.inputs if any(n in rule.inputs for rule in grammar.rules)]
    pset = gp.PrimitiveSet("plain", len(names) + 3)
    renamed = dict(zip([f"ARG{k}" for k in range(len(names) + 3)],
                       [*names, "c1", "c2", "c3"], strict=True))  # fmt: skip
    pset.renameArguments(**renamed)

    def of(operator):
        def call(*args):
            shapes = ["vector" if np.ndim(a) == 2 else "scalar" for a in args]
            return operator.evaluate(tuple(Type(s, None) for s in shapes), *args)

        return call

    for name, operator in OPERATORS.items():
        pset.addPrimitive(of(operator), operator.arity, name=name)
    return pset, names


def _call_text(formula):
    """A formula as nested calls, ``mul(c1, m_i)``."""
    from bsp_gp.language.formula import Call, Number

    if isinstance(formula, Call):
        return f"{formula.operator}({', '.join(map(_call_text, formula.args))})"
    return repr(formula.value) if isinstance(formula, Number) else formula.name


def pair_table():
    """Size of the force between pairs of NBODY scene 1 against masses and distance."""
    regression, grammar = problem("nbody 1")
    rows = Objective(regression, grammar, "pair").rows
    m_i, m_j = rows.input("m_i", False), rows.input("m_j", False)
    gap = rows.input("p_i", True) - rows.input("p_j", True)
    r = np.sqrt((gap**2).sum(axis=1))
    return np.column_stack([m_i, m_j, r]), 8167.007 * m_i * m_j / r**2


def pyoperon(seconds):
    """Evaluations a second of pyoperon (C++, float32), constants by Levenberg-Marquardt."""
    from pyoperon.sklearn import SymbolicRegressor

    x, y = pair_table()
    model = SymbolicRegressor(
        allowed_symbols="add,sub,mul,div,constant,variable", optimizer_iterations=5,
        population_size=1000, generations=10**6, max_evaluations=10**9,
        max_time=max(1, int(seconds)), n_threads=1, random_state=0,
    )  # fmt: skip
    started = time.process_time()
    model.fit(x, y)
    spent = time.process_time() - started
    n = int(model.stats_["evaluation_count"])
    return {"rows": len(y), "laws": n, "seconds": spent, "laws_per_s": n / spent,
            "memory_mb": memory()}  # fmt: skip


def gplearn(seconds):
    """Programs a second of gplearn (Python), correlation as its metric, no inner constants."""
    import warnings

    from gplearn.genetic import SymbolicRegressor

    x, y = pair_table()
    started = time.process_time()
    generations = 4
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        SymbolicRegressor(
            population_size=500, generations=generations, metric="pearson", random_state=0,
            stopping_criteria=2.0, function_set=("add", "sub", "mul", "div"),
        ).fit(x, y)  # fmt: skip
    spent = time.process_time() - started
    n = 500 * generations
    return {"rows": len(y), "laws": n, "seconds": spent, "laws_per_s": n / spent,
            "memory_mb": memory()}  # fmt: skip


# --- the table --------------------------------------------------------------------------------


def work(tool, name, seconds):
    """One measurement in a process of its own, so that memory is its own."""
    with worker_pool(1, own_process=True) as pool:
        row = pool.submit(measured, tool, name, seconds).result()
    return [] if row is None else [{"tool": tool, "problem": name, **row}]


def measured(tool, name, seconds):
    """The row of a tool; None where it is not installed."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        if tool in STRATEGIES:
            return learner(name, tool, seconds)
        if tool == "exhaustive":
            return exhaustive(name)
        if tool == "deap + scipy":
            return plain(name, seconds)
        try:
            return {"pyoperon": pyoperon, "gplearn": gplearn}[tool](seconds)
        except ImportError:
            return None


def jobs_of(quick):
    """Tools and problems; the exhaustive search where it takes less than minutes."""
    problems = PROBLEMS[:2] if quick else PROBLEMS
    jobs = [(tool, p, SECONDS) for p in problems for tool in STRATEGIES]
    jobs += [("exhaustive", p, SECONDS) for p in problems if p not in ("nbody 100", "made 1000")]
    jobs += [("deap + scipy", p, SECONDS) for p in problems[:2]]
    jobs += [(tool, "pair table of nbody 1", SECONDS) for tool in ("pyoperon", "gplearn")]
    return jobs


def summary(table):
    """The table as text, and ratios."""
    lines = ["# Speed on one core (processor time)\n",
             "| tool | problem | rows | laws/s | trees/s | repeats | greatest memory, MB |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for row in table.itertuples():
        known = row.trees_per_s == row.trees_per_s
        trees = f"{row.trees_per_s:,.0f} | {row.repeats:.0%}" if known else " | "
        lines.append(f"| {row.tool} | {row.problem} | {row.rows:,.0f} | {row.laws_per_s:,.0f} | "
                     f"{trees} | {row.memory_mb:,.0f} |")  # fmt: skip
    stages = [c for c in table.columns if c.startswith("us_")]
    lines += ["\nMicroseconds per tree, repeats included:\n",
              "| search | problem | " + " | ".join(c[3:] for c in stages) + " |",
              "|---" * (2 + len(stages)) + "|"]  # fmt: skip
    for _, row in table[table["tool"].isin(list(STRATEGIES))].iterrows():
        cells = ["" if row[c] != row[c] else f"{row[c]:.1f}" for c in stages]
        lines.append(f"| {row['tool']} | {row['problem']} | " + " | ".join(cells) + " |")
    plain_rates = table[table["tool"] == "deap + scipy"].set_index("problem")["laws_per_s"]
    lines += ["\nTimes the rate of plain DEAP + SciPy in this run, which scores repeats again:\n",
              "| tool | problem | different laws | trees |", "|---|---|---|---|"]  # fmt: skip
    for row in table.itertuples():
        if row.problem in plain_rates and row.tool != "deap + scipy":
            laws, trees = (v / plain_rates[row.problem] for v in (row.laws_per_s, row.trees_per_s))
            cell = f"{trees:,.0f}" if trees == trees else ""
            lines.append(f"| {row.tool} | {row.problem} | {laws:,.0f} | {cell} |")
    return "\n".join(lines) + "\n"


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick), work, args.out, 1)
    write_study(summary(table), None, args.out)


if __name__ == "__main__":
    main()
