"""Is a name that is told with a probability of 0.9 right in nine of ten data sets?

Reads the tables of the open world and of the battery, sets in which a cause was told of, and
compares the probability beside its name with how often it is right: in bins, with the calibration
error (mean distance of both, bins weighted by their sets). Families set aside stand apart.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from common import options, write_study, write_table
from scipy import stats

EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 1.0)
LEVEL = 0.9


def told(path):
    """Probability of a name, and whether it is right, of the sets of one study that tell one."""
    table = pd.read_csv(path, keep_default_na=False, na_values=[""])
    missing = sorted({"probability", "right", "told"} - set(table))
    if missing:
        sys.exit(f"{path} has no column {missing[0]!r}: it is of an older study; run that anew")
    table = table[table["told"].notna() & table["probability"].notna()]
    aside = table["aside"] if "aside" in table else pd.Series(False, index=table.index)
    return pd.DataFrame({
        "probability": table["probability"].astype(float),
        "right": table["right"].astype(str) == "True", "aside": aside.astype(str) == "True",
    })  # fmt: skip


def bins(table):
    """Of every bin its sets, mean probability, share that is right, and 90 % interval of it."""
    rows = []
    index = np.clip(np.digitize(table["probability"], EDGES) - 1, 0, len(EDGES) - 2)
    for k in np.unique(index):
        part = table[index == k]
        n, hits = len(part), int(part["right"].sum())
        low, high = stats.beta.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], hits + 0.5, n - hits + 0.5)
        rows.append({
            "from": EDGES[k], "to": EDGES[k + 1], "sets": n,
            "told": float(part["probability"].mean()), "right": hits / n,
            "low": float(low), "high": float(high),
        })  # fmt: skip
    return pd.DataFrame(rows)


def calibration_error(found):
    """Mean distance of what is told and what is right over bins, weighted by their sets."""
    return float(np.average((found["told"] - found["right"]).abs(), weights=found["sets"]))


def summary(parts):
    """The tables as Markdown."""
    lines = ["# Is a probability what it says?\n"]
    for name, found in parts.items():
        error, count = calibration_error(found), int(found["sets"].sum())
        lines += [
            f"\n## {name}: {count} names, calibration error {error:.3f}\n",
            "| probability | sets | told | right | 90 % |", "|---" * 5 + "|",
        ]  # fmt: skip
        lines += [
            f"| {r['from']:g}–{r['to']:g} | {r['sets']:.0f} | {r['told']:.2f} | {r['right']:.2f} "
            f"| {r['low']:.2f}–{r['high']:.2f} |"
            for _, r in found.iterrows()
        ]
    return "\n".join(lines) + "\n"


def figure(parts):
    """Share that is right against the probability that was told."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(4.4, 4.2), layout="constrained")
    ax.plot([0, 1], [0, 1], color="0.7", lw=1)
    for (name, found), colour in zip(parts.items(), ("#0072b2", "#d55e00"), strict=False):
        ends = np.abs([found["right"] - found["low"], found["high"] - found["right"]])
        ax.errorbar(found["told"], found["right"], ends, fmt="o", ms=4, color=colour, label=name)
        for _, row in found.iterrows():
            at = (row["told"], row["right"])
            ax.annotate(f"{row['sets']:.0f}", at, (4, -9), textcoords="offset points", fontsize=7)
    ax.set(xlim=(0, 1), ylim=(0, 1), xlabel="probability that is told", ylabel="share right")
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(frameon=False, fontsize=8)
    return fig


def declare(parser):
    parser.add_argument(
        "studies", type=Path, nargs="+", help="folders of open_world and undeclared_effects"
    )


def main():
    args = options(__doc__.splitlines()[0], declare=declare)
    table = pd.concat([told(folder / "results.csv") for folder in args.studies])
    parts = {
        name: bins(part)
        for name, part in (("all", table[~table["aside"]]), ("set aside", table[table["aside"]]))
        if len(part)
    }
    write_table(table, args.out / "names.csv")
    write_study(summary(parts), figure(parts), args.out, "reliability")


if __name__ == "__main__":
    main()
