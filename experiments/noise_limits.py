"""How much position noise each likelihood stands before the true law is lost.

The paper's scenes with white position noise of growing size: exhaustive search by one step, one
step with the exact covariance, generalised least squares and the weak form. Then the measured
ball drops: gravity declared, the drag coefficient of every drop by each of them, beside a fit to
the whole track.
"""

import functools
from dataclasses import replace

import numpy as np
from common import options, reference_data, run_jobs, write_study
from scenes import LAWS, is_true, noisy_scenes, scenario

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, declared_law
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.compare import certified
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.search.objective import Objective

METHODS = ("one_step", "one_step_gls", "gls", "weak", "one_step_weak")
N_SCENES = {"nbody": 3, "mat": 3, "bounce": 5}
NOISES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
MARGIN = 4.0
"""Rows whose contact is within so many standard deviations of beginning or ending are left out."""
N_LISTED = 100
"""Laws of the one-step search that the other likelihoods rank where a search is too slow."""
TITLES = {"nbody": "NBODY", "mat": "MAT", "bounce": "BOUNCE"}
COLOURS = {"one_step": "#999999", "one_step_gls": "#e69f00", "gls": "#d55e00",
           "weak": "#0072b2", "one_step_weak": "#56b4e9", "whole track": "#222222"}  # fmt: skip
DECLARED = "9.81 [m/s^2] * m_i * down"
DRAG = "c1 * m_i * norm(v_i) * v_i"


# --- the paper's scenes --------------------------------------------------------------------------


def regression_of(name, noise, seed, method, margin=MARGIN):
    """The data of a problem as one likelihood sees them."""
    scenes = noisy_scenes(name, range(1, N_SCENES[name] + 1), noise, seed)
    return build_regression(scenes, method=method, sigma=noise or 1e-3, unsure=margin * noise)


@functools.lru_cache(maxsize=6)
def listed(name, noise, seed):
    """The laws of lowest cost of the one-step search: (formula, complexity)."""
    grammar, missing = load_grammar("newtonian").masked(scenario(name).types, 2)
    found = search_exhaustive(
        regression_of(name, noise, seed, "one_step"), grammar, kind="pair", missing_inputs=missing
    )
    beta = 1.0 if noise else 1e-3
    ranked = sorted(found.candidates, key=lambda c: c.loss + beta * c.complexity)
    return tuple((c.formula, c.complexity) for c in ranked[:N_LISTED])


def best_listed(regression, laws):
    """Of some laws the one of least loss + complexity."""
    y = regression.target()
    costs = []
    for formula, complexity in laws:
        try:
            column = regression.column(Term(split_linear(formula)[1], "pair"))[0][:, 0]
        except EvaluationError:
            costs.append(np.inf)
            continue
        size = float(column @ column)
        gain = float(column @ y) ** 2 / size if size > 0 else 0.0
        costs.append(0.5 * (float(y @ y) - gain) + complexity)
    return laws[int(np.argmin(costs))][0]


def constant_of(name, regression):
    """Best constant of the true law, and its error, as the likelihood has them."""
    truth = split_linear(parse_formula(LAWS[name], scenario(name).input_types))[1]
    column = regression.column(Term(truth, "pair"))[0][:, 0]
    size = float(column @ column)
    if size == 0:  # no row with a contact is left
        return float("nan"), float("nan"), float("nan")
    value = float(column @ regression.target()) / size
    left = regression.target() - value * column
    return value, size**-0.5, float(left @ left) / regression.n_rows


def synth(name, noise, seed, how):
    """All likelihoods on one noisy data set: a row each."""
    grammar, missing = load_grammar("newtonian").masked(scenario(name).types, 2)
    rows = []
    for method in METHODS:
        regression = regression_of(name, noise, seed, method, 0.0 if how == "kept" else MARGIN)
        if how != "list":
            objective = Objective(regression, grammar, "pair", beta=1.0)
            best = certified(objective, missing_inputs=missing).best.formula
        else:
            # The exact data's list has the true law and its nearest rivals.
            laws = dict(listed(name, 0.0, 0)) | dict(listed(name, noise, seed))
            best = best_listed(regression, tuple(laws.items()))
        value, error, chisqr = constant_of(name, regression)
        widths = regression.widths
        rows.append({
            "data": name, "noise": noise, "seed": seed, "how": how, "method": method,
            "success": is_true(name, best), "law": to_text(best), "constant": value,
            "error": error, "chisqr_per_row": chisqr, "n_rows": regression.n_rows,
            "width_rows": widths.rows if widths else np.nan,
        })  # fmt: skip
    return rows


# --- ball drops ----------------------------------------------------------------------------------


def drops():
    """Drag coefficient (1/m) of every drop by each method; gravity is declared."""
    dataset = load_dataset(reference_data("measured", "ball_drops"))
    sigma = np.array(estimate_noise(dataset).sigma)
    term = Term(parse_formula(DRAG, dataset_types(dataset)), "field")
    law = declared_law(dataset, [DECLARED]).plus(term, {"c1": -0.01})
    rows = []
    for scene in dataset.scenes:
        alone = replace(dataset, scenes=(scene,), train=(), test=(), noise=tuple(sigma))
        whole = fit(Hypothesis.from_laws(alone, law), alone)
        found = {"whole track": (whole.values[0], whole.covariance[0, 0] ** 0.5, np.nan)}
        for method in ("one_step", "one_step_gls", "gls", "weak"):
            regression = build_regression(
                [scene], method=method, sigma=sigma, up=dataset.up, sources=False
            )
            solved = fit_constants(regression, law)
            width = regression.widths.seconds if regression.widths else np.nan
            found[method] = (solved.values[0], solved.covariance[0, 0] ** 0.5, width)
        rows += [
            {"data": "drops", "scene": scene.name, "method": method, "constant": value,
             "error": error, "width_s": width}
            for method, (value, error, width) in found.items()
        ]  # fmt: skip
    return rows


# --- the table -----------------------------------------------------------------------------------


def work(data, *job):
    """Rows of one job."""
    return drops() if data == "drops" else synth(data, *job)


def jobs_of(quick, seed):
    """The jobs, seed by seed; on NBODY searches of correlated errors are few, on BOUNCE none."""
    seeds = range(seed, seed + (2 if quick else 10))
    noises = (0.001, 0.03, 0.3) if quick else NOISES
    jobs = [("drops",)]
    for s in seeds:
        jobs += [("mat", noise, s, "search") for noise in noises]
        jobs += [("nbody", noise, s, "list") for noise in noises]
        if not quick or s == seed:
            jobs += [("bounce", noise, s, "list") for noise in (noises[1:2] if quick else noises)]
    # A friction that begins a row late is a small error: does leaving that row out help?
    jobs += [("mat", noise, s, "kept") for s in seeds for noise in noises]
    if not quick:
        jobs += [("nbody", noise, s, "search") for s in seeds[:3] for noise in (0.1, 1.0)]
    return jobs


def balls(table):
    """Per method: distance to the whole-track fit, and agreement of the two drops of a ball."""
    part = table[table["data"] == "drops"].copy()
    whole = part[part["method"] == "whole track"].set_index("scene")
    part["ball"] = part["scene"].str.replace(r"_drop\d+$", "", regex=True)
    out = []
    for method, some in part.groupby("method", sort=False):
        base = whole.loc[some["scene"]]
        shift = (some["constant"].to_numpy() - base["constant"].to_numpy()) / base["error"]
        pairs = [p for _, p in some.groupby("ball") if len(p) == 2]
        apart = [p["constant"].diff().iloc[1] / np.hypot(*p["error"]) for p in pairs]
        spread = [abs(p["constant"].diff().iloc[1]) for p in pairs]
        out.append({
            "method": method, "shift": float(np.sqrt(np.mean(shift**2))),
            "bias": float(np.mean(shift)),
            "error": float(np.median(some["error"] / base["error"].to_numpy())),
            "apart": float(np.sqrt(np.mean(np.square(apart)))),
            "spread": float(np.median(spread)), "forward": int((some["constant"] > 0).sum()),
            "width": float(some["width_s"].median()), "n": len(some),
        })  # fmt: skip
    return out


def _short(value):
    return f"{value:.2g}" if value < 100 else f"{value:,.0f}"


def summary(table):
    """The figures as text."""
    synth = table[table["data"] != "drops"]
    noises = sorted(synth["noise"].unique())
    head = " | ".join(f"{noise:g}" for noise in noises)
    lines = [
        "# Noise limits\n",
        "Data sets on which the true law is found (loss + complexity). *search*: of all laws of "
        f"the grammar; *list*: of the best {N_LISTED} laws of the one-step search and of the "
        "search on exact data, the true one among them; *kept*: a search with all rows, those with "
        f"a contact within {MARGIN:g} standard deviations of beginning or ending too.\n",
        f"| data | how | likelihood | {head} |",
        "|---" * (3 + len(noises)) + "|",
    ]
    for (data, how, method), part in synth.groupby(["data", "how", "method"], sort=False):
        cells = []
        for noise in noises:
            some = part[part["noise"] == noise]["success"].astype(bool)
            cells.append(f"{some.sum()} of {len(some)}" if len(some) else "")
        lines.append(f"| {TITLES[data]} | {how} | {method} | {' | '.join(cells)} |")
    lines += ["\nConstant of the true law: median over data sets ÷ its exact value, and the "
              "root mean square of its errors ÷ their standard errors.\n",
              f"| data | likelihood | {head} |", "|---" * (2 + len(noises)) + "|"]  # fmt: skip
    exact = {name: _exact(name) for name in synth["data"].unique()}
    once = synth[synth["how"] != "kept"].drop_duplicates(["data", "noise", "seed", "method"])
    for (data, method), part in once.groupby(["data", "method"], sort=False):
        cells = []
        for noise in noises:
            some = part[part["noise"] == noise].dropna(subset=["constant"])
            z = (some["constant"] - exact[data]) / some["error"]
            ratio = some["constant"].median() / exact[data]
            cells.append(f"{ratio:.3g}; {_short(np.sqrt(np.mean(z**2)))}" if len(some) else "–")
        lines.append(f"| {TITLES[data]} | {method} | {' | '.join(cells)} |")
    rows = balls(table)
    lines += [
        f"\nBall drops, {rows[0]['n']} drops, gravity declared: the drag coefficient by each "
        "likelihood. Shift: root mean square (and mean) distance from the whole-track fit in its "
        "standard errors. Agreement: root mean square difference of the two drops of a ball in "
        "standard errors, 1 where errors are right; median absolute difference.\n",
        "| likelihood | shift | standard error ÷ whole track's | agreement | 1/m | push forward |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r['method']} | {_short(r['shift'])} ({r['bias']:+.3g}) | {r['error']:.2g} | "
        f"{r['apart']:.2g} | {r['spread']:.2g} | {r['forward']} |"
        for r in rows
    ]
    widths = once[once["method"].isin(["weak"])].groupby(["data", "noise"])["width_rows"].median()
    text = "; ".join(
        f"{TITLES[data]} " + ", ".join(f"{n:g}: {widths[data, n]:.3g}" for n in noises
                                       if (data, n) in widths)
        for data in exact
    )  # fmt: skip
    drop_width = next(r["width"] for r in rows if r["method"] == "weak")
    lines.append(
        f"\nWidths that the weak form chose, in rows (median): {text}. Drops: {drop_width:.2g} s."
    )
    return "\n".join(lines) + "\n"


@functools.lru_cache(maxsize=3)
def _exact(name):
    """Constant of the true law on exact data."""
    return constant_of(name, regression_of(name, 0.0, 0, "one_step"))[0]


def figure(table):
    """Success against noise; drag coefficients against those of the whole track."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(11, 6.6), layout="constrained")
    for column, (name, title) in enumerate(TITLES.items()):
        part = table[table["data"] == name]
        top, bottom = axes[:, column]
        for k, (method, some) in enumerate(part.groupby("method", sort=False)):
            style = {"color": COLOURS[method], "marker": "o", "ms": 7 - k, "lw": 3 - 0.5 * k}
            shown = some[some["how"] == some["how"].iloc[0]]
            rate = shown.groupby("noise")["success"].mean()
            top.plot(rate.index, rate, label=method.replace("_", " "), **style)
            if column < 2:
                ratio = shown.groupby("noise")["constant"].median() / _exact(name)
                bottom.plot(ratio.index, ratio, **style)
        top.set(title=title, xscale="log", ylim=(-0.07, 1.07), xlabel="position noise (sd)")
        if column < 2:
            bottom.axhline(1.0, color="#bbbbbb", lw=0.8, zorder=0)
            bottom.set(xscale="log", ylim=(0.0, 2.0), xlabel="position noise (sd)")
    part = table[table["data"] == "drops"]
    whole = part[part["method"] == "whole track"].set_index("scene")
    ax = axes[1, 2]
    for k, (method, some) in enumerate(part.groupby("method", sort=False)):
        if method in ("one_step_gls", "gls", "weak"):
            base = whole.loc[some["scene"], "constant"].to_numpy()
            apart = 1e3 * (base - some["constant"])
            ax.errorbar(-1e3 * base + 0.4 * (k - 3), apart, 1e3 * some["error"], fmt="o", ms=4,
                        lw=1, color=COLOURS[method])  # fmt: skip
    ax.axhline(0.0, color="#bbbbbb", lw=0.8, zorder=0)
    ax.set(title="Ball drops", xlabel="drag coefficient of the whole track (1/km)",
           ylabel="difference from it (1/km)")  # fmt: skip
    axes[0, 0].set_ylabel("share of data sets with the true law")
    axes[1, 0].set_ylabel("constant of the true law ÷ exact")
    axes[0, 0].legend(fontsize=8, frameon=False, loc="lower left")
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "noise_limits")


if __name__ == "__main__":
    reference_data("synth")
    main()
