"""Tables and figure of the open world: by kind, with intervals by resampling whole kinds."""

import numpy as np
from open_judge import OUTCOMES, OUTCOMES_OF_NULL

NULL = "odd noise"
"""Family of sets that lack nothing."""
N_DRAWS = 2000
ENDS = (0.05, 0.95)
NATS = 10.0
"""By which the truth about the noise must beat white noise to be asked for."""
COLOURS = {
    "fact": "#009e73", "class": "#56b4e9", "effective": "#0072b2", "open": "#cccccc",
    "neighbour": "#e69f00", "wrong": "#d55e00", "missed": "#555555", "right_null": "#009e73",
    "false_alarm": "#e69f00", "false_adoption": "#d55e00",
}  # fmt: skip


def interval(kinds, hits, seed=0):
    """Ends of the 90 % interval of a share, whole kinds being drawn again.

    Parameters
    ----------
    kinds : array_like of str
    hits : array_like of bool
    seed : int
    """
    _, index = np.unique(np.asarray(kinds, dtype=str), return_inverse=True)
    counts = np.bincount(index)
    sums = np.bincount(index, np.asarray(hits, dtype=float))
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(counts), size=(N_DRAWS, len(counts)))
    shares = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    return tuple(map(float, np.quantile(shares, ENDS)))


def summary(table):
    """The tables as Markdown: foreign causes, and odd noise on data that lack nothing."""
    is_null = table["family"] == NULL
    lines = [
        "# An open world\n",
        "Fact: the right form, alone. Class: it is among those that are told. Effective: told as a "
        "description. Open: seen or cannot tell, or a class without the truth. Neighbour: one form "
        "stated as fact that is not the truth and acts along the same line. Wrong: another cause "
        "stated as fact. Apart: standard deviations by which the nearest textbook law fails. "
        "Intervals are 90 %, by resampling kinds.\n",
    ]
    lines += _foreign(table[~is_null]) if (~is_null).any() else []
    lines += _nulls(table[is_null]) if is_null.any() else []
    return "\n".join(lines) + "\n"


def _foreign(table):
    head = ["kind", "SNR", "sets", *OUTCOMES, "class without truth", "lead right", "apart", "CPU s"]
    lines = ["## Causes that are not listed\n", _row(head), "|---" * len(head) + "|"]
    for (_, kind), part in table.groupby(["family", "kind"], sort=False):
        lines.append(_row([kind, _ratios(part), *_shares(part, OUTCOMES), *_rest(part)]))
    for (aside, snr), part in table.groupby(["aside", "snr"]):
        name = f"**all{', set aside' if aside else ''}**"
        lines.append(_row([name, f"{snr:g}", *_shares(part, OUTCOMES, True), *_rest(part)]))
    lines.append("")
    for aside, part in table.groupby("aside"):
        is_good = part["outcome"].isin(["fact", "class"]) | _is(part["lead_right"])
        hits = {
            "wrong and confident": part["outcome"] == "wrong",
            "neighbouring form as fact": part["outcome"] == "neighbour",
            "missed at SNR >= 10": (part["outcome"] == "missed") & (part["snr"] >= 10),
            "right, in the class, or the lead right": is_good,
        }
        told = ", ".join(f"{name} {_with_ends(part['kind'], hit)}" for name, hit in hits.items())
        lines.append(f"{len(part)} sets{' set aside' if aside else ''}: {told}.\n")
    return lines


def _rest(part):
    return [
        int(_is(part["is_class_without_truth"]).sum()), f"{_is(part['lead_right']).mean():.0%}",
        f"{part['separation'].median():.1f}", f"{part['cpu_s'].median():.1f}",
    ]  # fmt: skip


def _nulls(table):
    head = ["noise", "sets", *OUTCOMES_OF_NULL, "named", f"named where > {NATS:g} nats", "CPU s"]
    lines = ["## Nothing missing, noise not white\n", _row(head), "|---" * len(head) + "|"]
    for kind, part in table.groupby("kind", sort=False):
        lines.append(_row([kind, *_shares(part, OUTCOMES_OF_NULL), *_named(part)]))
    for aside, part in table.groupby("aside"):
        name = f"**all{', set aside' if aside else ''}**"
        lines.append(_row([name, *_shares(part, OUTCOMES_OF_NULL, True), *_named(part)]))
    return [*lines, ""]


def _named(part):
    clear = part[part["noise_gain"] > NATS]
    of_clear = f"{_is(clear['noise_named']).mean():.0%} of {len(clear)}" if len(clear) else ""
    return [f"{_is(part['noise_named']).mean():.0%}", of_clear, f"{part['cpu_s'].median():.1f}"]


def _is(column):
    """Truth values that a table may have read as text."""
    return column.astype(str) == "True"


def _ratios(part):
    return ", ".join(f"{snr:g}" for snr in sorted(part["snr"].unique()))


def _shares(part, outcomes, with_ends=False):
    """Number of sets, and the share of each outcome."""
    cells = [len(part)]
    for name in outcomes:
        hit = part["outcome"] == name
        text = _with_ends(part["kind"], hit) if with_ends else f"{hit.mean():.0%}"
        cells.append(text if hit.any() or with_ends else "")
    return cells


def _with_ends(kinds, hits):
    low, high = interval(kinds, hits)
    return f"{hits.mean():.1%} ({low:.1%}–{high:.1%})"


def _row(cells):
    return "| " + " | ".join(map(str, cells)) + " |"


def figure(table):
    """Outcomes of each kind as stacked bars."""
    import matplotlib.pyplot as plt

    is_null = table["family"] == NULL
    parts = [(table[~is_null], OUTCOMES), (table[is_null], OUTCOMES_OF_NULL)]
    counts = [max(part["kind"].nunique(), 1) for part, _ in parts]
    fig, axes = plt.subplots(
        2, 1, figsize=(7.5, 0.22 * sum(counts) + 2.2), layout="constrained",
        height_ratios=counts,
    )  # fmt: skip
    for ax, (part, outcomes) in zip(axes, parts, strict=True):
        kinds = list(dict.fromkeys(part["kind"]))
        left = np.zeros(len(kinds))
        for outcome in outcomes:
            hits = part["outcome"] == outcome
            share = np.array([hits[part["kind"] == kind].mean() for kind in kinds])
            ax.barh(kinds, share, left=left, color=COLOURS[outcome], label=outcome)
            left += share
        ax.set(xlim=(0, 1))
        ax.invert_yaxis()
        ax.tick_params(labelsize=7)
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, frameon=False)
    axes[1].set_xlabel("share of data sets")
    return fig
