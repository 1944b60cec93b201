"""The 27 nonlinear regressions of NIST from both starts: the driver's digits, and scipy's.

Every run begins at the given start, and the driver adds no starts of its own. scipy's methods have
the same derivatives and scale unknowns by columns; once with tolerances of 1e-8, as they come, once
with 1e-15, as sharp as they go. A run is right with six digits in every parameter.
"""

import warnings

from certified import Dense, read_problem
from common import options, reference_data, run_jobs, write_study
from scipy.optimize import least_squares

from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Settings

SOLVERS = ("driver", "lm 1e-8", "lm 1e-15", "trf 1e-8", "trf 1e-15", "dogbox 1e-8",
           "dogbox 1e-15")  # fmt: skip
QUICK = ("Misra1a", "BoxBOD", "MGH09")
MOST = 1000
"""Evaluations, of any solver."""
DIGITS = 6


def work(name, start, solver):
    """One run: a row."""
    problem = read_problem(reference_data("nist_strd") / f"{name}.dat")
    solve = _driver if solver == "driver" else _scipy
    values, status, n_evaluations = solve(problem, problem.starts[start - 1], solver)
    return [
        {
            "problem": name, "level": problem.level, "start": start, "solver": solver,
            "digits": round(problem.digits(values), 2), "status": status,
            "evaluations": n_evaluations,
        }
    ]  # fmt: skip


def _driver(problem, start, _):
    settings = Settings(absolute=0.0, max_linearised=MOST)
    plain = Dense(problem.residual, problem.jacobian)
    found = minimise(plain, start, settings=settings)
    return found.values, found.status, found.n_linearised


def _scipy(problem, start, solver):
    method, tolerance = solver.split()
    tolerance = float(tolerance)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of 1e-15, and of steps that run away
        try:
            found = least_squares(
                problem.residual, start, problem.jacobian, method=method, x_scale="jac",
                ftol=tolerance, xtol=tolerance, gtol=tolerance, max_nfev=MOST,
            )  # fmt: skip
        except ValueError:  # "Residuals are not finite": no result at all
            return start, "nonfinite", 0
    return found.x, "converged" if found.success else "unconverged", found.nfev


def summary(table):
    """Counts of every solver, and the driver's failures, as Markdown."""
    table = table.assign(right=table["digits"] >= DIGITS, said=table["status"] == "converged")
    lines = ["# Certified regressions, 27 problems from two starts", "",
             "| solver | right | wrong, says so | wrong, called converged | evaluations |",
             "|---|---|---|---|---|"]  # fmt: skip
    for solver, part in table.groupby("solver", sort=False):
        wrong = part[~part["right"]]
        lines.append(
            f"| {solver} | {part['right'].sum()} of {len(part)} | {(~wrong['said']).sum()} | "
            f"{wrong['said'].sum()} | {part['evaluations'].sum()} |"
        )
    driver = table[table["solver"] == "driver"]
    lines += ["", "| problem | start | digits | status | evaluations |", "|---|---|---|---|---|"]
    lines += [
        f"| {row.problem} | {row.start} | {row.digits:.1f} | {row.status} | {row.evaluations} |"
        for row in driver.itertuples()
    ]
    return "\n".join(lines) + "\n"


def main():
    args = options(__doc__.splitlines()[0])
    names = sorted(path.stem for path in reference_data("nist_strd").glob("*.dat"))
    names = [name for name in names if not args.quick or name in QUICK]
    jobs = [(name, start, solver) for name in names for start in (1, 2) for solver in SOLVERS]
    text = summary(run_jobs(jobs, work, args.out, args.workers))
    write_study(text, None, args.out)


if __name__ == "__main__":
    main()
