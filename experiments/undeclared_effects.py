"""The battery: what data lack that a declared model does not know, and what the loop says it is.

Sixteen kinds, each as strong as makes its signal-to-noise ratio the one asked for (defined as in
`power.py`): nine forces, two forces at once, a body that is not seen, and five wrong measurements.
Counted is whether the right one is named, whether it is in the class that is told of, and whether
one name is given alone and is not true.
"""

import time
from dataclasses import replace

import numpy as np
from battery_worlds import AS_IT_IS, KINDS, able, noisy, tuned_to
from causes import Judge, causes_of, is_adopted
from common import of_share, options, run_jobs, take_share, write_study
from power import ALPHA, FORCES

from bsp_gp.loop.close import close_loop

SNRS = (10.0, 5.0, 30.0)
WANTED_SNR = 10.0
N_SEEDS = 20
MAX_ROUNDS = 3
QUICK = ("linear drag", "tilted camera", "hidden body", "clock")
NOT_TOLD = ("seen or cannot tell", "nothing missing")
OTHER = ("another law", "another measurement")
FAMILIES = {
    "period": "periodic push", "exponent": "changed exponent", "hidden_body": "hidden body",
    "scale": "length scale", "tilt": "tilted camera", "clock": "clock", "delay": "delay of a body",
    "swapped_tracks": "swapped tracks",
}  # fmt: skip
"""Kinds by codes, for what is told and is not right; of other codes the law says it."""


class Referee:
    """Compares what a loop tells with the truth of one data set."""

    def __init__(self, name, exact):
        self.kind = KINDS[name]
        dataset, truth = exact.dataset, exact.truth

        def judge(*effects):
            settings = replace(truth.settings, effects=effects)
            return Judge(dataset, replace(truth, settings=settings), exact.declared)

        parts = () if self.kind.names else truth.effects
        self.parts = [judge(part) for part in parts]
        self.whole = judge(*parts)
        self.same = [judge(effect) for effect in self.kind.same]

    def is_named(self, cause):
        """Whether a cause is the right one: of two, either, or both in one law."""
        if self.kind.names:
            return cause.code in self.kind.names and self.kind.of in cause.text
        return bool(self.parts_in(cause))

    def parts_in(self, cause):
        """The undeclared forces that a cause is, by number."""
        found = {k for k, part in enumerate(self.parts) if part.is_form(cause)}
        if not found and len(self.parts) > 1 and self.whole.is_form(cause):
            return set(range(len(self.parts)))
        return found

    def is_right(self, cause):
        """Whether a cause is the right one, or does the same."""
        return self.is_named(cause) or any(judge.is_form(cause) for judge in self.same)

    def is_law(self, report):
        """Whether the law that was adopted is the truth."""
        adopted = [done.effect for done in report.rounds if is_adopted(done)]
        if not self.parts or not adopted or any(e.kind not in FORCES for e in adopted):
            return False
        return self.whole.refitted(report.law) is not None

    def taken_for(self, cause):
        """The kind that a cause is, or `OTHER`."""
        if cause.code in FAMILIES:
            return FAMILIES[cause.code]
        terms, start = self.whole.terms(cause)
        if not terms:
            return OTHER[1]
        law = self.whole.declared
        for term in terms:
            law = law.plus(term, start)
        name = self.whole.name_of(law)
        return name if name in KINDS and not KINDS[name].names else OTHER[0]


def told_in(report):
    """The rounds that tell of a cause which noise alone does not show."""
    return [done for done in report.rounds if causes_of(done) and done.missing.p_value <= ALPHA]


def score(referee, report):
    """What of a report is right: the columns of a row."""
    rounds = told_in(report)
    causes = [causes_of(done) for done in rounds]
    first = causes[0][0] if causes else None
    if len(referee.parts) > 1:
        is_named = referee.is_law(report)
        told = set().union(*(referee.parts_in(of_round[0]) for of_round in causes))
        is_in_class = is_named or len(told) == len(referee.parts)
        is_in_class |= bool(causes) and any(map(referee.whole.is_form, causes[0][1:]))
    else:
        is_named = first is not None and (referee.is_named(first) or referee.is_law(report))
        is_in_class = is_named or (first is not None and any(map(referee.is_right, causes[0])))
    alone = [
        told[0] for done, told in zip(rounds, causes, strict=True)
        if done.verdict == "effect adopted" and len(told) == 1
    ]  # fmt: skip
    return {
        "verdict": report.verdict, "adopted": any(map(is_adopted, report.rounds)),
        "told": str(first) if first else "", "code": first.code if first else "",
        "told_kind": rounds[0].effect.kind if first else "", "told_law": first.law if first else "",
        "n_class": len({str(cause) for cause in causes[0]}) if first else 0,
        "taken_for": "" if is_named or first is None else referee.taken_for(first),
        "probability": rounds[0].effect.probability if first else np.nan, "right": is_named,
        "named": is_named, "in_class": is_in_class,
        "wrong_confident": any(not referee.is_named(c) for c in alone) and not is_named,
    }  # fmt: skip


def family(row):
    """The column of a row in the confusion matrix."""
    if row["named"]:
        return row["effect"]
    is_told = isinstance(row["told"], str) and (row["adopted"] or row["in_class"])
    if not is_told:
        return NOT_TOLD[row["verdict"] == "nothing missing"]
    return row["taken_for"]


def work(name, engine, snr, seed):
    """One data set: a row."""
    strength, found, exact = tuned_to(name, snr, seed, engine)
    noise_rng, loop_rng = np.random.default_rng((2, list(KINDS).index(name), seed)).spawn(2)
    dataset = noisy(name, exact, noise_rng)
    started = time.process_time()
    report = close_loop(dataset, exact.declared, rng=loop_rng, alpha=ALPHA, max_rounds=MAX_ROUNDS)
    seconds = time.process_time() - started
    return [{
        "effect": name, "engine": engine, "snr": snr, "snr_found": found, "seed": seed,
        "strength": strength, **score(Referee(name, exact), report),
        "ratio": report.total["ratio"].value, "law": report.law_text,
        "reason": report.rounds[0].reason, "cpu_s": seconds,
    }]  # fmt: skip


def jobs_of(quick, seed, share=1.0):
    """The jobs; every other seed by the second engine where it has the effect."""
    names, snrs = (QUICK, (WANTED_SNR,)) if quick else (KINDS, SNRS)
    has_second = {name: able(name, "mujoco") for name in names}
    seeds = range(seed, seed + (1 if quick else of_share(N_SEEDS, share)))
    return [
        (name, "mujoco" if s % 2 and has_second[name] else "pymunk", snr, s)
        for snr in snrs for s in seeds for name in names
        if snr == WANTED_SNR or KINDS[name].strength != AS_IT_IS
    ]  # fmt: skip


def _cells(part):
    return [
        len(part), f"{part['snr_found'].median():.3g}", f"{part['adopted'].mean():.0%}",
        f"{part['named'].mean():.0%}", f"{part['in_class'].mean():.0%}",
        f"{part['wrong_confident'].mean():.1%}", f"{part['n_class'].median():.0f}",
        f"{part['ratio'].median():.2f}", f"{part['cpu_s'].median():.1f}",
    ]  # fmt: skip


def summary(table):
    """Rates of each kind at each SNR."""
    lines = [
        "# What a declared model does not know: named, in the class, wrong\n",
        "Named: the first effect that is told of, or the adopted law, is the right one; of two "
        "forces, both are in the adopted law. In class: it is among those that are said not to be "
        "told apart; of two forces, each is told of in some round, or both are among them. Wrong "
        "and confident: one name is adopted, nothing stands beside it, and it is not true. An "
        "effect that noise alone "
        f"might show (p > {ALPHA:g}) is not told of. Swapped tracks have no strength: they stand "
        f"at SNR {WANTED_SNR:g} with the one they have.\n",
        "| SNR | kind | sets | SNR found | adopted | named | named or in class "
        "| wrong and confident | size of class | error after / before | CPU s |",
        "|---" * 11 + "|",
    ]
    for snr in sorted(table["snr"].unique()):
        rows = table[table["snr"] == snr]
        for name, part in [*rows.groupby("effect", sort=False), ("**all**", rows)]:
            lines.append("| " + " | ".join(map(str, [f"{snr:g}", name, *_cells(part)])) + " |")
    failed = table[~table["in_class"]]
    if len(failed):
        lines += ["\n## Neither named nor in the class\n",
                  "| kind | SNR | seed | verdict | told of | law |", "|---" * 6 + "|"]  # fmt: skip
        for row in failed.astype(object).fillna("").itertuples():
            cells = (row.effect, f"{row.snr:g}", row.seed, row.verdict, row.told, row.told_law)
            lines.append("| " + " | ".join(str(c).replace("|", "/") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def figure(table):
    """Confusion matrix at the SNR of most interest: truth against what is told."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import to_rgb

    at = WANTED_SNR if (table["snr"] == WANTED_SNR).any() else table["snr"].iloc[0]
    table = table[table["snr"] == at]
    table = table.assign(family=[family(row) for row in table.to_dict("records")])
    rows = [name for name in KINDS if name in set(table["effect"])]
    columns = [*KINDS, *OTHER, *NOT_TOLD]
    colours = {"right": "#009e73", "in the class": "#56b4e9", "not right": "#d55e00",
               "none told": "#999999"}  # fmt: skip
    fig, ax = plt.subplots(figsize=(9.6, 0.34 * len(rows) + 2.6), layout="constrained")
    for y, name in enumerate(rows):
        of_kind = table[table["effect"] == name]
        for told, part in of_kind.groupby("family"):
            x, share = columns.index(told), len(part) / len(of_kind)
            sort = "not right"
            if told in NOT_TOLD:
                sort = "none told"
            elif part["named"].all():
                sort = "right"
            elif part["in_class"].mean() >= 0.5:
                sort = "in the class"
            depth = 0.25 + 0.75 * share
            face = 1 - depth * (1 - np.array(to_rgb(colours[sort])))
            ax.add_patch(plt.Rectangle((x - 0.5, y - 0.5), 1, 1, color=face, lw=0))
            ax.text(x, y, f"{100 * share:.0f}", ha="center", va="center", fontsize=8)
        for x, column in ((0.4, "in_class"), (1.6, "wrong_confident")):
            share = f"{100 * of_kind[column].mean():.0f}"
            ax.text(len(columns) + x, y, share, va="center", ha="right", fontsize=8)
    for x, label in ((0.1, "in class"), (1.3, "wrong, confident")):
        ax.text(len(columns) + x, -0.7, label, fontsize=8, rotation=50)
    ax.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, -0.5),
           xlabel=f"told of (% of {len(table)} data sets, SNR {at:g})", ylabel="truth")  # fmt: skip
    ax.set_xticks(range(len(columns)), columns, rotation=50, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(rows)), rows)
    ax.tick_params(length=0, labelsize=8)
    ax.set_xticks(np.arange(len(columns)) - 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows)) - 0.5, minor=True)
    ax.grid(which="minor", color="0.85", lw=0.5)
    ax.tick_params(which="minor", length=0)
    ax.spines[:].set_visible(False)
    for label, colour in colours.items():
        ax.plot([], [], "s", color=colour, label=label)
    fig.legend(loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0], declare=take_share)
    table = run_jobs(jobs_of(args.quick, args.seed, args.share), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "confusion")


if __name__ == "__main__":
    main()
