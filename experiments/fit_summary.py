"""What the table of a study of fits says, in words and small tables."""

import numpy as np
import pandas as pd
from ranks import simultaneous_band
from scipy.stats import chisquare, kstest

LEVEL = 0.01
"""Of all tests of ranks together."""
N_BINS = 10


def summary(name, study, table):
    """Markdown: how many sets pass, of which kind, how they failed, what they cost."""
    n, passed = len(table), int(table["passed"].sum())
    lines = [f"# {name}", "", f"Asked: {study.asked}.", ""]
    lines += [f"{passed} of {n} sets pass ({100 * passed / n:.1f} %)."]
    is_met = passed >= study.share * n
    if "wrong_converged" in table:
        wrong = int(table["wrong_converged"].sum())
        lines += [f"Wrong minima that are called converged: {wrong}."]
        # Of one constant alone the others may be off: there the share is all that is asked.
        is_met &= wrong == 0 or name not in ("oscillators", "orbits")
    lines += _statuses(table) + [""] + _kinds(table) + _numbers(table) + _costs(table)
    lines += _failures(table)
    if name == "pendulum_noise":
        lines += _noise_lines(table)
    if name == "sbc":
        found, is_uniform = rank_lines(table)
        lines += found
        is_met &= is_uniform
    lines += ["", f"**{name}: {'met' if is_met else 'NOT met'}**"]
    return "\n".join(lines) + "\n"


def _statuses(table):
    names = [c for c in table if c == "status" or c.startswith("status_")]
    return [
        f"{name}: " + ", ".join(f"{k} {v}" for k, v in table[name].value_counts().items()) + "."
        for name in names
    ]


def _kinds(table):
    lines = ["| kind | sets | pass |", "|---|---|---|"]
    for kind, part in table.groupby("kind"):
        lines.append(f"| {kind} | {len(part)} | {int(part['passed'].sum())} |")
    return [*lines, ""]


def _numbers(table):
    """Quantiles of what was measured."""
    shown = [
        c for c in ("chi2", "chi2_red", "se_ratio", "se_ratio_least", "deviation", "value_gap_se",
                    "se_gap", "level_with", "level_without", "gain")
        if c in table and table[c].notna().any()
    ]  # fmt: skip
    if not shown:
        return []
    lines = ["| | median | 10 % | 90 % | largest |", "|---|---|---|---|---|"]
    for name in shown:
        q = np.nanquantile(table[name].astype(float), [0.5, 0.1, 0.9, 1.0])
        lines.append(f"| {name} | " + " | ".join(f"{v:.4g}" for v in q) + " |")
    return [*lines, ""]


def _costs(table):
    names = [c for c in table if c == "cpu_s" or c.startswith("cpu_s_")]
    cost = table[names].sum(axis=1)
    return [
        f"Processor time of a set's fits: median {cost.median():.3g} s, 90 % below "
        f"{cost.quantile(0.9):.3g} s, at most {cost.max():.3g} s."
    ]


def _failures(table, shown=20):
    bad = table[~table["passed"].astype(bool)]
    if not len(bad):
        return []
    columns = [
        c for c in ("set", "kind", "status", "chi2", "chi2_bound", "se_ratio", "deviation",
                    "misfit_gap", "chi2_red", "n_agree", "value_gap_se", "se_gap", "level_with",
                    "level_without", "gain", "cpu_s", "error")
        if c in bad and bad[c].notna().any()
    ]  # fmt: skip
    lines = ["", "Sets that do not pass" + (f" (the first {shown})" if len(bad) > shown else ""),
             "", "| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]  # fmt: skip
    for _, row in bad[columns].head(shown).iterrows():
        cells = [f"{v:.4g}" if isinstance(v, float) else str(v) for v in row]
        lines.append("| " + " | ".join("" if c == "nan" else c for c in cells) + " |")
    return lines


def _noise_lines(table):
    counts = {
        "level right with damping": "level_right", "level right with and without": "both_right",
    }  # fmt: skip
    return [""] + [
        f"{words}: {int((table[column] == True).sum())} of {len(table)}"  # noqa: E712, nan is no
        for words, column in counts.items() if column in table
    ] + [f"damping wins: {int((table['gain'] > 0).sum())} of {len(table)}"
         if "gain" in table else "damping wins: 0"]  # fmt: skip


def rank_lines(table):
    """Are ranks uniform? Chi-squared of ten bins and the distance of the ecdf, by world, constant.

    Returns
    -------
    lines : list of str
    is_uniform : bool
        At a level of 1 % over all of them (Bonferroni).
    """
    found = []
    for kind, part in table.groupby("kind"):
        for column in (c for c in table if c.startswith("rank_")):
            ranks = pd.to_numeric(part[column]).dropna().to_numpy()
            if len(ranks):
                found.append((kind, column[5:], ranks))
    lines = ["", "| world | constant | sets | p of 10 bins | largest deviation | band 99 % | p |",
             "|" + "---|" * 7]  # fmt: skip
    least = 1.0
    for kind, name, ranks in found:
        counts = np.histogram(ranks, bins=N_BINS, range=(0, 1))[0]
        p_bins, distance = chisquare(counts).pvalue, kstest(ranks, "uniform")
        least = min(least, p_bins, distance.pvalue)
        lines.append(
            f"| {kind} | {name} | {len(ranks)} | {p_bins:.3g} | {distance.statistic:.3f} "
            f"| {simultaneous_band(len(ranks)):.3f} | {distance.pvalue:.3g} |"
        )
    n_tests = 2 * len(found)
    lines += ["", f"Least of {n_tests} p-values: {least:.3g}; level {LEVEL / max(n_tests, 1):.2g}."]
    return lines, bool(found and least >= LEVEL / n_tests)
