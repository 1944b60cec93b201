"""What a run of `neural_efficiency.py` says: its tables, and what becomes of the paper's claims.

"Best" is the method of least median test error at that number of scenes: chosen by the test
scenes themselves, for networks and searches alike.
"""

import numpy as np
from data_efficiency import COLLIDING, PAPER_ZERO, TEST
from neural_judges import OTHER

SYMBOLIC = ("zero force", "exhaustive", "exhaustive, sums", "cross_entropy", "genetic")
SEARCHES = SYMBOLIC[1:]
NETWORKS = ("MLP (position)", "IN", "MLP (force)", "OGN", "HOGN")
PAPERS = tuple(f"{network}, paper" for network in NETWORKS[:4])
TUNED = tuple(f"{network}, tuned" for network in NETWORKS)
LONGER = tuple(f"{network}, longer" for network in NETWORKS)
NEURAL = (*PAPERS, *TUNED, *LONGER)
"""The place of a training is part of its seed."""
EXACT = 1e-9
"""One-step nRMSE in metres below which a law is the true one."""
ROUNDING = 1e-12
"""One-step nRMSE in metres below which two laws are equally exact."""
SAME = 0.01
"""Part of the zero force's error within which an error is the same."""
SILENT = 0.1
"""Part of the true forces' mean size below which a network predicts none."""
EXCEPTIONS = {"mat": (1, 2, 3, 4)}
"""Numbers of scenes at which the paper (section 4.1, as printed) excepts its search."""


def summary(table):
    """Readings first, then the tables that they are read from, scenario by scenario."""
    n_draws = table["shuffle"].nunique()
    lines = ["# Neural models and symbolic searches against the number of training scenes\n",
             f"{n_draws} draws of training scenes a point. \"Best\" means of least median error on "
             "the test scenes, for networks and searches alike. Laws have `does_collide` and "
             "`is_on` in their grammar; networks are told shapes and nearest points, as the "
             "paper's are. \"Paper\": its trainings; its Interaction Network differs in its last "
             "network (`neural/models.py`). \"Tuned\": rate and activation for each network and "
             "scenario, loss and hold-out as best for OGN (`neural_tuning.py`, other "
             "scenes); on BOUNCE OGN's for all, and a fifth of the training scenes is held out to "
             "choose the step that is kept. \"Longer\": the same with four times the steps, not "
             "asked everywhere; more of them may help yet. "
             "HOGN, which the paper does not have, is a relative of that network: pair energies, "
             "so that action equals reaction; not asked everywhere either. \"Law found\" means "
             "nothing left on the test scenes: every mat weighs 1 kg, so its mass in a law of MAT "
             "is neither confirmed nor refuted.\n"]  # fmt: skip
    lines += reading(table)
    for name, part in by_scenario(table):
        lines += [f"\n## {name.upper()}\n"]
        for column, where in judged(name):
            lines += errors_table(name, part, column, where)
        for column, where in judged(name):
            lines += number_table(part, column, where)
        lines += exact_table(name, part)
        lines += other_table(name, part)
    lines += times_table(table)
    return "\n".join(lines) + "\n"


def by_scenario(table):
    """(name, rows) of the scenarios that were run, in the paper's order."""
    return [(name, table[table["scenario"] == name]) for name in PAPER_ZERO
            if name in set(table["scenario"])]  # fmt: skip


def judged(name):
    """Columns of the test error of a scenario, and of which scenes each is."""
    every = ("nrmse_test", f"all {len(TEST)} test scenes")
    if name not in COLLIDING:
        return [every]
    return [("nrmse_test_free", f"the {len(TEST) - len(COLLIDING[name])} test scenes without "
             "contact"), every]  # fmt: skip


# --- readings ---------------------------------------------------------------------------------


def reading(table):
    """What the table says to the claims of the paper, and when the error is nothing."""
    lines = ["## Readings\n"]
    for name, part in by_scenario(table):
        for column, where in judged(name):
            lines += [f"- {name.upper()}, {where}. " + " ".join(
                said for said in (lead_line(part, column, EXCEPTIONS.get(name, ())),
                                  exact_line(part, column), ratio_line(part, column)) if said
            )]  # fmt: skip
    for name, part in by_scenario(table):
        if name == "bounce":
            lines += claim_lines(part)
    return lines


def best(part, column, methods):
    """Of least median error at every number of scenes: {n: (method, median)}.

    Medians that are equal to six digits, or all below `ROUNDING`, are equal; the first of the
    methods is named.
    """
    found = {}
    for n, some in part.groupby("n_scenes"):
        median = some.groupby("method")[column].median()
        median = {method: median[method] for method in methods if method in median}
        if median:
            method = min(median, key=lambda m, of=median: float(f"{max(of[m], ROUNDING):.6g}"))
            found[n] = (method, float(median[method]))
    return found


def zero(part, column):
    """Error of no force."""
    return float(part.loc[part["method"] == "zero force", column].median())


def lead_line(part, column, exceptions=()):
    """At how many numbers of scenes the best search errs less than the best network."""
    nets, laws = best(part, column, NEURAL), best(part, column, SEARCHES)
    counts = [n for n in nets if n in laws]
    if not counts:
        return ""
    behind = [n for n in counts if not laws[n][1] < nets[n][1]]
    text = (f"The best search errs less than the best network at {len(counts) - len(behind)} of "
            f"{len(counts)} numbers of scenes")  # fmt: skip
    text += f" (not at {_listed(behind)})" if behind else ""
    own = f"all but {_listed(exceptions)}" if exceptions else "all"
    return f"{text}; in the paper, on all test scenes, at {own} of 10."


def exact_line(part, column):
    """From how many scenes on exhaustive search is exact, in the median and in every draw."""
    method = next((m for m in ("exhaustive, sums", "exhaustive") if (part["method"] == m).any()),
                  None)  # fmt: skip
    if method is None:
        return ""
    n_draws = part["shuffle"].nunique()
    mine = part[part["method"] == method].groupby("n_scenes")[column]
    medians = mine.median().to_dict()
    exact = mine.apply(lambda errors: int((errors < EXACT).sum())).to_dict()
    middle = _from_on({n: error < EXACT for n, error in medians.items()})
    every = _from_on({n: count == n_draws for n, count in exact.items()})
    said = f"below {EXACT:g} m from n = {middle} on" if middle else f"not below {EXACT:g} m"
    # A median hides the draws in which the law was missed.
    every = f"all draws are from n = {every} on" if every else "not all draws are even at the last"
    counts = ", ".join(f"{exact[n]} at n = {n}" for n in exact)
    return (f"The median of exhaustive search{method.removeprefix('exhaustive')} is {said}; "
            f"{every} (of {n_draws}: {counts}).")  # fmt: skip


def exact_counts(part, column):
    """Draws with an error below `EXACT`: {n: {method: count}}."""
    return {n: {m: int((some.loc[some["method"] == m, column] < EXACT).sum()) for m in SEARCHES}
            for n, some in part.groupby("n_scenes")}  # fmt: skip


def _from_on(holds):
    """The least number from which something holds at all that were run, None if at none."""
    start = None
    for n in sorted(holds, reverse=True):
        if not holds[n]:
            break
        start = n
    return start


def _listed(numbers):
    return "n = " + ", ".join(map(str, numbers))


def ratio_line(part, column):
    """How many times the best network's median error is larger, at the most scenes run."""
    nets, laws = best(part, column, NEURAL), best(part, column, SEARCHES)
    counts = [n for n in nets if n in laws]
    if not counts:
        return ""
    n = max(counts)
    (net, error), (law, least) = nets[n], laws[n]
    # Exact laws leave rounding, which says nothing about how much better they are.
    bound = "at least " if least < ROUNDING else ""
    return (f"At n = {n} the best network ({net}) errs by {error:.4g} m, "
            f"{error / zero(part, column):.4f} of zero force, the best search ({law}) by "
            f"{least:.2g} m: {bound}{error / max(least, ROUNDING):.2g} times less.")  # fmt: skip


def verdict(ratio, share):
    """An error over zero force's in words; `share` is of the true forces' mean size."""
    if ratio < 1 - SAME:
        return "below"
    if ratio > 1 + SAME:
        return "above"
    return "equal within 1 %" + (": it predicts no force" if share < SILENT else "")


def claim_lines(part):
    """The paper's claim that on BOUNCE the networks cannot reach zero force with ten scenes."""
    lines = []
    for methods, whose in ((PAPERS, "the paper's trainings"), (NEURAL, "all trainings")):
        nets = best(part, "nrmse_test", methods)
        if not nets:
            continue
        ratios = {n: error / zero(part, "nrmse_test") for n, (_, error) in nets.items()}
        below = [n for n, ratio in ratios.items() if ratio < 1 - SAME]
        same = [n for n, ratio in ratios.items() if abs(ratio - 1) <= SAME]
        said = [f"beaten at {_listed(below)}"] if below else []
        if same:
            mine = [part[(part["method"] == nets[n][0]) & (part["n_scenes"] == n)] for n in same]
            share = max(rows["share_predicted"].median() for rows in mine)
            said += [f"reached within 1 % at {_listed(same)} with forces of {share:.2g} of the "
                     "true ones' size" + (", that is by predicting none" if share < SILENT
                                          else "")]  # fmt: skip
        n = min(ratios, key=ratios.get)
        lines.append(f"- BOUNCE: that networks cannot reach zero force with 10 scenes (paper); "
                     f"{whose}, {_listed(ratios)}: {'; '.join(said) or 'it is not reached'}; "
                     f"least ratio {ratios[n]:.4f} ({nets[n][0]}, n = {n}).")  # fmt: skip
    return lines


# --- tables -----------------------------------------------------------------------------------


def spread(values):
    """Median [quartiles]; empty if there are none, and said if there is no answer."""
    # Motion that left the range of numbers counts as far, not as unknown.
    values = np.minimum(np.asarray(values, dtype=float), 1e300)
    if not len(values):
        return ""
    if np.isnan(values).any():
        return "cannot be asked"
    low, middle, high = ("inf" if x > 1e299 else f"{x:.3g}"
                         for x in np.quantile(values, [0.25, 0.5, 0.75]))  # fmt: skip
    return f"{middle} [{low}, {high}]"


def header(*titles):
    return ["| " + " | ".join(titles) + " |", "|---" * len(titles) + "|"]


def errors_table(name, part, column, where):
    """Test nRMSE against the number of scenes."""
    counts = sorted(set(part["n_scenes"]))
    rows = [f"\nMedian [quartiles] of the nRMSE on {where}, m (zero force in the paper, on all: "
            f"{PAPER_ZERO[name]})\n"]  # fmt: skip
    rows += header("method", *map(str, counts))
    for method, mine in part.groupby("method", sort=False):
        cells = [spread(mine.loc[mine["n_scenes"] == n, column]) for n in counts]
        rows.append(f"| {method} | " + " | ".join(cells) + " |")
    return rows


def number_table(part, column, where):
    """The best network against zero force and against the best search, number by number."""
    nets, laws, none = best(part, column, NEURAL), best(part, column, SEARCHES), zero(part, column)
    if not nets:
        return []
    rows = [f"\nThe best network on {where}; predicted: mean size of its forces over the true "
            "ones', median, on all test scenes\n"]  # fmt: skip
    rows += header("n", "best network", "error, m", "over zero force's", "predicted",
                   "against zero force", "best search", "error, m")  # fmt: skip
    for n, (net, error) in nets.items():
        mine = part[(part["method"] == net) & (part["n_scenes"] == n)]
        share, ratio = mine["share_predicted"].median(), error / none
        law = f"{laws[n][0]} | {laws[n][1]:.4g}" if n in laws else " | "
        rows.append(f"| {n} | {net} | {error:.4g} | {ratio:.4f} | {share:.3g} | "
                    f"{verdict(ratio, share)} | {law} |")  # fmt: skip
    return rows


def exact_table(name, part):
    """How often a search found the law: draws with a test error below `EXACT`."""
    counts = [exact_counts(part, column) for column, _ in judged(name)]
    where = " / on ".join(where for _, where in judged(name))
    rows = [f"\nLaw found, of {part['shuffle'].nunique()} draws: error below {EXACT:g} m, "
            f"constants included, on {where}\n"]  # fmt: skip
    rows += header("search", *map(str, counts[0]))
    for method in SEARCHES:
        cells = [" / ".join(str(c[n][method]) for c in counts) for n in counts[0]]
        rows.append(f"| {method} | " + " | ".join(cells) + " |")
    return rows


def other_table(name, part):
    """Rollouts and other worlds at the most scenes run."""
    n = max(part.loc[part["method"].isin(NEURAL), "n_scenes"], default=max(part["n_scenes"]))
    rows = [f"\nAt n = {n}, median [quartiles], m: mean distance from the track over 49 steps run "
            "on without correction (median scene), and one-step nRMSE in worlds with "
            f"{_words(name)}; such masses lie outside those trained on\n"]  # fmt: skip
    rows += header("method", "rollout", "other numbers of bodies", "other masses")
    for method, mine in part[part["n_scenes"] == n].groupby("method", sort=False):
        cells = [spread(mine[c]) for c in ("rollout", "other numbers", "other masses")]
        rows.append(f"| {method} | " + " | ".join(cells) + " |")
    return rows


def _words(name):
    said = [", ".join(f"{k} = {v}" for k, v in numbers.items())
            for changes in OTHER[name].values() for numbers in changes]  # fmt: skip
    return "; ".join(said)


def times_table(table):
    """Processor time of a run."""
    counts = sorted(set(table["n_scenes"]))
    rows = ["\n## Processor time of one run, seconds (median)\n",
            "A network's includes its share of the compilation, which the draws of a point have in "
            "common.\n"]  # fmt: skip
    rows += header("scenario", "method", *map(str, counts))
    for name, part in by_scenario(table):
        for method, mine in part.groupby("method", sort=False):
            if method == "zero force":
                continue
            seconds = mine.groupby("n_scenes")["seconds"].median()
            cells = [f"{seconds[n]:.2g}" if n in seconds else "" for n in counts]
            rows.append(f"| {name} | {method} | " + " | ".join(cells) + " |")
    return rows
