"""The command ``bsp-gp sweep``: the loop on many data sets."""

import argparse
from collections import Counter
from functools import partial

from bsp_gp.cli_inputs import excluded_inputs, read_dataset, read_loop_settings
from bsp_gp.errors import BspError

READING = (
    "units", "columns", "property", "sky", "up", "fps", "dt", "train", "test", "noise", "command",
)  # fmt: skip
"""Options that say how a data set is read."""


def read_as(options, path):
    """A data set, read with options of the command line."""
    return read_dataset(argparse.Namespace(**options, data=[str(path)]))


def run_sweep(args, laws, workers, progress):
    """Close the loop on every data set that the arguments lead to.

    Returns
    -------
    text : str
        What was found how often, and where the table is.
    n_defects : int
        Data sets on which bsp_gp failed by its own fault.
    """
    from bsp_gp.fitting.hypothesis import read_law
    from bsp_gp.language.grammar import load_grammar
    from bsp_gp.sweep import find_datasets, sweep

    datasets = find_datasets(args.datasets)
    read = partial(read_as, {name: getattr(args, name) for name in READING})
    grammar = load_grammar(args.grammar)
    settings = {"grammar": args.grammar, **read_loop_settings(args)}
    for path in datasets.values():  # slips in what is common to all show at the first that is read
        try:
            first = read(path)
        except (BspError, OSError):
            continue
        settings["exclude"] = excluded_inputs(args, grammar, first)
        if not first.latents:
            read_law(first, laws)
        break
    rows = sweep(
        datasets, laws, args.out, workers=workers, resume=args.resume, overwrite=args.overwrite,
        read=read, progress=progress, **settings,
    )  # fmt: skip
    counts = Counter(row["verdict"] or "no verdict" for row in rows)
    found = Counter(row["effect"] for row in rows if row["effect"])
    lines = [f"{count:6,d}  {name}" for name, count in counts.most_common()]
    lines += [f"{count:6,d}  found: {name}" for name, count in found.most_common(5)]
    return "\n".join(lines), sum("a defect of bsp_gp" in row["error"] for row in rows)
