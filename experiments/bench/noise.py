"""Time to whiten tracks' errors, white and correlated parts together, other libraries beside it.

One evaluation is what a restricted likelihood asks of every noise that it tries: the covariance
factorised anew, its determinant, and the Gram matrix of ten columns and a residual in its metric;
times irregular, variances told row by row; one long track, and many short ones. celerite2, tinygp
and statsmodels are timed where they are installed (`pip install celerite2 tinygp statsmodels`).
celerite2 takes one track after the other, statsmodels one column of one track; tinygp takes tracks
of one length together (vmap), and the time that jax compiles is left out.
"""

import importlib.util
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, write_table, write_text

from bsp_gp.fitting.whitening import Whitener

N_COLUMNS = 10
MEMORY, AMPLITUDE = 5.0, 1.0


def ours(times, variance, rows):
    """Gram matrix and log-determinant by `Whitener`."""
    whitener = Whitener(times, variance, [AMPLITUDE], MEMORY)
    white = whitener.whiten(rows).reshape(len(rows), -1)
    return white @ white.T, whitener.log_det


def track_by_track(evaluate):
    """A function of one track, for all of them."""

    def evaluate_all(times, variance, rows):
        tracks = zip(times.T, variance.T, np.moveaxis(rows, -1, 0), strict=True)
        found = [evaluate(*(np.ascontiguousarray(x) for x in track)) for track in tracks]
        return sum(gram for gram, _ in found), sum(log_det for _, log_det in found)

    return evaluate_all


def by_celerite2(times, variance, rows):
    """The same by celerite2; it applies the inverse."""
    import celerite2

    kernel = celerite2.terms.RealTerm(a=AMPLITUDE**2, c=1.0 / MEMORY)
    process = celerite2.GaussianProcess(kernel)
    process.compute(times, diag=variance)
    columns = np.ascontiguousarray(rows.T)
    return rows @ process.apply_inverse(columns), process._log_det


def by_tinygp():
    """The same by tinygp, compiled."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from tinygp.kernels import quasisep
    from tinygp.noise import Diagonal
    from tinygp.solvers import QuasisepSolver

    def evaluate(times, variance, rows):
        kernel = AMPLITUDE**2 * quasisep.Exp(scale=MEMORY)
        solver = QuasisepSolver(kernel, times, Diagonal(variance))
        white = solver.solve_triangular(rows.T)
        return white.T @ white, 2.0 * jnp.log(solver.factor.diag.d).sum()

    together = jax.jit(lambda *args: [x.sum(axis=0) for x in jax.vmap(evaluate, (1, 1, 2))(*args)])
    return lambda *args: [np.asarray(x) for x in together(*args)]


def by_statsmodels(times, variance, rows):
    """The same by the Kalman filter of statsmodels, a column at a time."""
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter

    rho = np.exp(-np.diff(times, append=times[-1]) / MEMORY)
    white = []
    for row in rows:
        kalman = KalmanFilter(k_endog=1, k_states=1)
        kalman.bind(np.array(row)[:, None])
        kalman["design", 0, 0] = kalman["selection", 0, 0] = 1.0
        kalman["obs_cov"] = variance[None, None]
        kalman["transition"] = rho[None, None]
        kalman["state_cov"] = (AMPLITUDE * (1.0 - rho**2))[None, None]
        kalman.initialize_known(np.zeros(1), np.array([[AMPLITUDE**2]]))
        found = kalman.filter()
        white.append(found.forecasts_error[0] / np.sqrt(found.forecasts_error_cov[0, 0]))
    white = np.array(white)
    return white @ white.T, np.log(found.forecasts_error_cov[0, 0]).sum()


def methods():
    """Name and function of everything that is installed."""
    found = {"bsp_gp": ours}
    if importlib.util.find_spec("celerite2"):
        found["celerite2"] = track_by_track(by_celerite2)
    if importlib.util.find_spec("tinygp"):
        found["tinygp"] = by_tinygp()
    if importlib.util.find_spec("statsmodels"):
        found["statsmodels"] = track_by_track(by_statsmodels)
    return found


def timed(evaluate, args, n_runs):
    """Least processor time of some runs, s, and what they found."""
    found, best = evaluate(*args), np.inf
    for _ in range(n_runs):
        began = time.process_time()
        found = evaluate(*args)
        best = min(best, time.process_time() - began)
    return best, found


def run(n_tracks, n_rows, seed, n_runs):
    """Times of every method: rows of the table."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, (n_rows, n_tracks)), axis=0)
    rows = rng.standard_normal((N_COLUMNS + 1, n_rows, n_tracks))
    args = times, rng.uniform(0.5, 1.0, times.shape), rows
    table, first = [], None
    for name, evaluate in methods().items():
        seconds, (gram, log_det) = timed(evaluate, args, n_runs)
        first = first or (gram, log_det, seconds)
        differs = max(np.abs(gram / first[0] - 1).max(), abs(log_det / first[1] - 1))
        row = {"tracks": n_tracks, "rows": n_rows, "seed": seed, "method": name}
        table.append({**row, "ms": 1e3 * seconds, "ratio": seconds / first[2], "differs": differs})
    return table


def main():
    args = options(__doc__.splitlines()[0])
    args.out = Path("runs") / "bench-noise" if args.out == Path("runs/noise") else args.out
    sizes = [(1, 1000), (1, 10_000), (50, 20)]
    sizes += [] if args.quick else [(1, 100_000), (1000, 20)]
    table = [row for size in sizes for row in run(*size, args.seed, 3 if args.quick else 7)]
    write_table(table, args.out / "results.csv")
    lines = [f"# White and correlated noise: {N_COLUMNS} columns and a residual, one core", "",
             "| tracks | rows of each | method | ms | ratio | differs |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    lines += [
        f"| {r['tracks']:,} | {r['rows']:,} | {r['method']} | {r['ms']:.2f} | {r['ratio']:.1f} | "
        f"{r['differs']:.0e} |"
        for r in table
    ]
    text = "\n".join(lines) + "\n"
    write_text(text, args.out / "summary.md")
    print(text)


if __name__ == "__main__":
    main()
